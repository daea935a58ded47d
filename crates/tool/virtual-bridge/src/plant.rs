//! The other program that plays the machine: one JSON line a step, both ways.
//!
//! Down come the time, the sensor's volts, temperatures and the spindle speed; up go the offsets
//! that the board gives at that time. The two are in lock-step: the plant decides how fast time
//! passes.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader, ErrorKind, Read as _, Write},
    net::TcpStream,
    time::Duration,
};

use anyhow::{Context as _, Result, anyhow, bail};
use serde::{Deserialize, Serialize};
use trueup_machine::inputs::TemperatureInput;

use crate::replay::{self, MachineSnapshot};

/// One step of the machine.
#[derive(Debug, Deserialize)]
#[serde(rename = "Step")]
struct PlantStep {
    /// Seconds, never less than in the step before.
    pub t_s: f64,
    /// The displacement sensor's output.
    pub sensor_v: f64,
    /// Temperatures by column name; those that the machine has no input for are not used.
    #[serde(default)]
    pub temps_c: BTreeMap<String, f64>,
    /// The spindle's speed.
    #[serde(default)]
    pub spindle_rpm: Option<f64>,
}

/// The board's answer to the plant.
#[derive(Debug, Default, Serialize)]
pub struct BoardResponse {
    /// Offsets on X, Y and Z; `null` where they are not available.
    pub offset_um: [Option<f64>; 3],
    /// As on the wire.
    pub quality: u8,
}

/// A connected plant.
pub struct Plant {
    lines: BufReader<TcpStream>,
    /// The line that is being read.
    bytes: Vec<u8>,
    number: usize,
    peer: String,
    last_s: Option<f64>,
    temperatures: BTreeMap<String, TemperatureInput>,
    /// The board's last answer; a step too short for a new word repeats it.
    pub last_answer: BoardResponse,
}

/// A step has a few numbers; a longer line has no end.
const MAX_LINE_BYTES: u64 = 1 << 16;
/// How often a plant that thinks is looked after.
const READ_POLL_INTERVAL: Duration = Duration::from_millis(200);

impl Plant {
    /// Connects to the plant, which listens. `temperatures` are the machine's channels by the names
    /// under which the plant states them.
    ///
    /// # Errors
    /// No plant listens there.
    pub fn connect(
        address: &str,
        temperatures: BTreeMap<String, TemperatureInput>,
    ) -> Result<Self> {
        let stream = TcpStream::connect(address)
            .with_context(|| format!("no plant listens at tcp:{address}"))?;
        // A step is one short line: it must not wait for more.
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(READ_POLL_INTERVAL))?;
        let peer = format!("plant at tcp:{address}");
        Ok(Self {
            lines: BufReader::new(stream),
            bytes: Vec::new(),
            number: 0,
            peer,
            last_s: None,
            temperatures,
            last_answer: BoardResponse::default(),
        })
    }

    /// Returns the next step: what the machine does, and for how many milliseconds. `None` when the plant
    /// has closed the line, or when `is_over` says so, which is called while the plant thinks.
    ///
    /// # Errors
    /// A line that is not a step, or time that runs back; with its number.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked before")]
    pub fn next_step(
        &mut self,
        mut is_over: impl FnMut() -> Result<bool>,
    ) -> Result<Option<(MachineSnapshot, u32)>> {
        self.bytes.clear();
        loop {
            let room = MAX_LINE_BYTES.saturating_sub(self.bytes.len() as u64);
            match (&mut self.lines).take(room).read_until(b'\n', &mut self.bytes) {
                Ok(_) if self.bytes.len() as u64 >= MAX_LINE_BYTES => bail!(
                    "{}, line {}: is longer than {MAX_LINE_BYTES} bytes",
                    self.peer,
                    self.number.saturating_add(1)
                ),
                Ok(0) if self.bytes.is_empty() => return Ok(None),
                Ok(_) => break,
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                {
                    if is_over()? {
                        return Ok(None);
                    }
                }
                Err(error) => return Err(error).context("the line to the plant is broken"),
            }
        }
        self.number += 1;
        let place = format!("{}, line {}", self.peer, self.number);
        let Ok(line) = std::str::from_utf8(&self.bytes) else {
            bail!("{place}: this is not UTF-8")
        };
        let step: PlantStep = serde_json::from_str(line)
            .map_err(|error| anyhow!("{place}, column {}: {error}", error.column()))?;
        let last_s = self.last_s.unwrap_or(step.t_s - 0.001);
        let ms = ((step.t_s - last_s) * 1_000.0).round();
        if !(0.0..=3_600_000.0).contains(&ms) {
            bail!("{place}: t_s goes from {last_s} to {}; a step is 0 to 3600 s", step.t_s);
        }
        if !(0.0..=100.0).contains(&step.sensor_v.abs()) {
            bail!("{place}: sensor_v {} is not a voltage that a sensor gives", step.sensor_v);
        }
        let speed = step
            .spindle_rpm
            .map(|speed| {
                replay::round_to_rpm(speed)
                    .ok_or_else(|| anyhow!("{place}: spindle_rpm {speed} is outside 0…65535"))
            })
            .transpose()?;
        // The sub-millisecond rest stays in the account, so no time is lost over many steps.
        self.last_s = Some(last_s + ms / 1_000.0);
        let situation = MachineSnapshot {
            sensor_volts: step.sensor_v,
            speed,
            temperatures: replay::raw_temperatures_from_celsius(&self.temperatures, &step.temps_c),
            ..MachineSnapshot::default()
        };
        Ok(Some((situation, ms as u32)))
    }

    /// Sends the board's answer to the last step.
    ///
    /// # Errors
    /// The line is broken.
    pub(crate) fn send_response(&mut self) -> Result<()> {
        let mut line = serde_json::to_string(&self.last_answer)?;
        line.push('\n');
        self.lines.get_mut().write_all(line.as_bytes()).context("the plant no longer listens")
    }
}
