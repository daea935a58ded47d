//! A gauge at the tool of a virtual bridge: what the machine does by the run file, less what the CNC has taken away by
//! the offsets. With it a run without and a run with compensation can be measured on a computer alone.
//!
//! It sends as gauges do: a value a line, in µm, to each client of its port.

use std::{
    io::Write as _,
    net::{TcpListener, TcpStream},
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::Duration,
};

use anyhow::{Context as _, Result};
use trueup_core::cnc::Output;
use trueup_machine::{Machine, machine_file::MachineKind};

use crate::plant::BoardResponse;

/// From one value to the next.
const GAUGE_SEND_PERIOD: Duration = Duration::from_millis(100);

/// The parts of a reading, in µm along the tool.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ReadingComponents {
    growth_um: f64,
    /// How far the offsets have moved what carries the gauge's counterpart: the housing, on a lathe the turret.
    moved_um: f64,
}

/// The gauge; its copies show the same.
#[derive(Clone, Debug)]
pub struct SimulatedGauge {
    /// `None`: the run file does not say what the tool does.
    shown: Arc<Mutex<Option<ReadingComponents>>>,
    tool_direction: [f64; 3],
    /// The part that the offsets move.
    carrier: &'static str,
}

impl SimulatedGauge {
    /// Returns the gauge of a machine, which shows nothing yet.
    #[must_use]
    pub fn new(machine: &Machine) -> Self {
        let carrier = if machine.kind == MachineKind::Lathe { "turret" } else { "housing" };
        Self { shown: Arc::default(), tool_direction: machine.tool_direction, carrier }
    }

    /// Takes what the tool does at this moment, and the newest offsets, if there are some.
    pub(crate) fn update(&self, growth_um: Option<f64>, output: Option<&Output>) {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(growth_um) = growth_um else {
            *shown = None;
            return;
        };
        let moved_um = match output.map(BoardResponse::from) {
            // No frame has come: the axis stands where it stood.
            None => shown.map_or(0.0, |components| components.moved_um),
            Some(BoardResponse { offset_um, .. }) => {
                let along = offset_um.iter().zip(self.tool_direction);
                along.map(|(offset, direction)| offset.unwrap_or(0.0) * direction).sum()
            }
        };
        *shown = Some(ReadingComponents { growth_um, moved_um });
    }

    fn reading_components(&self) -> Option<ReadingComponents> {
        *self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns what is left at the tool, in µm.
    fn residual_um(&self) -> Option<f64> {
        self.reading_components().map(|components| components.growth_um + components.moved_um)
    }

    /// Returns both readings in words.
    #[must_use]
    pub fn describe(&self) -> String {
        match self.reading_components() {
            Some(it) => format!(
                "a gauge at the tool shows {:+.2} µm, one at the {} {:+.2} µm (+ the way the tool points)",
                it.growth_um + it.moved_um,
                self.carrier,
                it.moved_um
            ),
            None => "the run has no measured_elongation_um that a gauge could show".into(),
        }
    }

    /// Sends readings to each client that connects to `address`, `HOST:PORT`.
    ///
    /// # Errors
    /// The port is in use.
    pub fn listen(&self, address: &str) -> Result<()> {
        let listener = TcpListener::bind(address).with_context(|| {
            format!(
                "cannot listen at tcp:{address}; is another program, or another bridge, using it?"
            )
        })?;
        trueup_output::write_diagnostic(format_args!(
            "the gauge is at tcp:{}, in µm",
            listener.local_addr()?
        ));
        let gauge = self.clone();
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let gauge = gauge.clone();
                thread::spawn(move || gauge.send_readings(stream));
            }
        });
        Ok(())
    }

    /// Until the other side has gone.
    fn send_readings(&self, mut stream: TcpStream) {
        loop {
            if let Some(um) = self.residual_um()
                && writeln!(stream, "{um:.2}").is_err()
            {
                return;
            }
            thread::sleep(GAUGE_SEND_PERIOD);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::{BufRead as _, BufReader},
        path::Path,
    };

    use trueup_core::{
        cnc::{OffsetFlags, OffsetQuality},
        units::Nanometres,
    };
    use trueup_machine::MachineFile;

    use super::*;

    fn machine(kind: &str) -> Machine {
        let text = format!("[machine]\nname = \"m\"\nkind = \"{kind}\"\n");
        MachineFile::parse(&text, Path::new("m.toml")).expect("a machine file")
    }

    fn lifted(nm: i32) -> Output {
        let offset = Some([0, 0, nm].map(Nanometres));
        Output { offset, quality: OffsetQuality::Live, flags: OffsetFlags::NONE, age_ms: 1 }
    }

    #[test]
    fn an_offset_takes_the_growth_away_and_is_kept_until_the_next_one() {
        let gauge = SimulatedGauge::new(&machine("3-axis"));
        assert!(gauge.describe().contains("no measured_elongation_um"), "{}", gauge.describe());
        gauge.update(Some(42.0), None);
        assert_eq!(gauge.residual_um(), Some(42.0));
        gauge.update(Some(42.0), Some(&lifted(40_000)));
        gauge.update(Some(42.5), None);
        assert_eq!(gauge.residual_um(), Some(2.5));
        assert!(gauge.describe().contains("tool shows +2.50 µm, one at the housing -40.00 µm"));
        // None is given: the CNC has taken it back.
        gauge.update(Some(42.5), Some(&Output { offset: None, ..lifted(0) }));
        assert_eq!(gauge.residual_um(), Some(42.5));
        assert!(SimulatedGauge::new(&machine("lathe")).carrier == "turret");
    }

    #[test]
    fn it_says_a_value_a_line() {
        let gauge = SimulatedGauge::new(&machine("lathe"));
        let free = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
        let address = free.expect("a free port").to_string();
        gauge.listen(&address).expect("it was free");
        gauge.update(Some(7.125), Some(&lifted(5_000)));
        let stream = TcpStream::connect(&address).expect("it listens");
        let line = BufReader::new(stream).lines().next().expect("a line").expect("text");
        assert_eq!(line, "2.12");
    }
}
