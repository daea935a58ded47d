//! Lines of LinuxCNC's recorder on each servo cycle. It is always read, or it would be overrun; and no wait for it is
//! without an end.

use std::{
    io::{BufRead as _, BufReader},
    process::ChildStdout,
    sync::mpsc::{self, Receiver},
    thread,
    time::Duration,
};

use anyhow::{Context as _, Result, bail, ensure};

/// LinuxCNC commands something in each servo cycle; on a busy computer the recorder is late.
const TIMEOUT: Duration = Duration::from_secs(20);

/// Servo cycles on end that no program of these tests stands, in one place, before its end.
const STANDS: u32 = 1000;
/// Servo cycles after which it stands at the latest.
const LATEST: u32 = 20_000;

/// The lines of the recorder.
pub struct Cycles(Receiver<String>);

impl Cycles {
    /// Reads the recorder until it ends.
    pub fn of(recorder: ChildStdout) -> Self {
        let (give, take) = mpsc::channel();
        thread::spawn(move || {
            for line in BufReader::new(recorder).lines().map_while(Result::ok) {
                if give.send(line).is_err() {
                    break;
                }
            }
        });
        Self(take)
    }

    /// Returns where X, Y and Z are sent in the next cycle, in mm, and the spindle's speed in r/min.
    pub fn next(&mut self) -> Result<[f64; 4]> {
        let line = self.0.recv_timeout(TIMEOUT).context("LinuxCNC's recorder is silent")?;
        commanded(&line)
    }

    /// Waits until the recorder has reported for [`STANDS`] cycles on end that all stand here: its next report is new.
    pub fn wait_for_stand(&mut self, at: &[f64]) -> Result<()> {
        let mut stood = 0;
        for _ in 0..LATEST {
            stood = if is_at(&self.next()?, at) { stood + 1 } else { 0 };
            if stood == STANDS {
                return Ok(());
            }
        }
        bail!("LinuxCNC does not stand at {at:?}")
    }

    /// Returns the first of the cycles so far in which something stood elsewhere.
    pub fn first_elsewhere(&mut self, at: &[f64]) -> Result<Option<[f64; 4]>> {
        let cycles: Vec<_> =
            self.0.try_iter().map(|line| commanded(&line)).collect::<Result<_>>()?;
        Ok(cycles.into_iter().find(|cycle| !is_at(cycle, at)))
    }
}

/// A tenth of a micrometre is what [`commanded`] keeps.
fn is_at(cycle: &[f64; 4], at: &[f64]) -> bool {
    cycle.iter().zip(at).all(|(is, at)| (is - at).abs() < 2e-4)
}

fn commanded(line: &str) -> Result<[f64; 4]> {
    ensure!(!line.contains("overrun"), "the recorder was overrun");
    let values = line.split_whitespace().skip(1).map(str::parse::<f64>);
    let values: Vec<f64> = values.collect::<Result<_, _>>().with_context(|| line.to_string())?;
    let &[x, y, z, speed] = &values[..] else { bail!("a line of the recorder is {line:?}") };
    // To a tenth of a micrometre: the last decimals of what is written are no reversal.
    let [x, y, z] = [x, y, z].map(|mm| (mm * 1e4).round() / 1e4);
    Ok([x, y, z, speed])
}
