//! A run file as the machine would live it: at each millisecond the sensor's volts and the speed.
//!
//! A row holds from its time until the next row's; the last one holds for ever. Without a column
//! `time_s` each row lasts a fixed time. A missing value keeps the one before it.

use trueup_core::units::Rpm;
use trueup_machine::{inputs::SensorInput, place::BadInput, run_file::RunFile};

/// How long a row lasts in a run without `time_s`, unless it is said otherwise.
pub const DEFAULT_ROW_S: f64 = 1.0;

/// The columns that a replay uses; the board has no use for others yet.
pub const USED_COLUMNS: [&str; 3] = ["time_s", "sensor_counts", "spindle_rpm"];

/// What the machine does at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Situation {
    /// The displacement sensor's output.
    pub sensor_volts: f64,
    /// The spindle's speed, where it is known.
    pub speed: Option<Rpm>,
}

/// A run, ready to be played.
#[derive(Clone, Debug)]
pub struct Replay {
    /// From when on each situation holds, rising from 0.
    from_s: Vec<f64>,
    situations: Vec<Situation>,
}

impl Replay {
    /// Prepares a run for a machine whose sensor is wired like this.
    ///
    /// # Errors
    /// A column that is needed is missing, empty at the start, or outside what the sensor or the
    /// wire can carry; with its place.
    pub fn new(run: &RunFile, sensor: &SensorInput, row_s: f64) -> Result<Self, BadInput> {
        let counts = run.require("sensor_counts")?;
        let speeds = run.column("spindle_rpm");
        let times = run.column("time_s");
        let mut replay = Self { from_s: Vec::new(), situations: Vec::new() };
        let mut now = Situation::default();
        let mut start = None;
        for (row, &count) in counts.iter().enumerate() {
            if count.is_nan() && row == 0 {
                return Err(run.bad(row, "sensor_counts", "needs a value in the first row"));
            }
            if !count.is_nan() {
                if !sensor.is_in_range(count) {
                    let largest = sensor.counts_full_scale;
                    let rule = format!("{count} is outside 0…{largest}");
                    return Err(run.bad(row, "sensor_counts", rule));
                }
                now.sensor_volts = sensor.volts_from_counts(count);
            }
            if let Some(speed) = speeds.map(|speeds| speeds[row]).filter(|speed| !speed.is_nan()) {
                let rpm = rpm(speed).ok_or_else(|| {
                    run.bad(row, "spindle_rpm", format!("{speed} is outside 0…65535"))
                })?;
                now.speed = Some(rpm);
            }
            let time = match times.map(|times| times[row]) {
                None => row_s * row as f64,
                Some(time) if time.is_nan() => {
                    return Err(run.bad(
                        row,
                        "time_s",
                        "is missing: a row without a time cannot be replayed",
                    ));
                }
                Some(time) => time,
            };
            let start = *start.get_or_insert(time);
            replay.from_s.push(time - start);
            replay.situations.push(now);
        }
        Ok(replay)
    }

    /// What the machine does at a time in seconds from the start.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Situation {
        let next = self.from_s.partition_point(|&from| from <= time_s);
        self.situations[next.saturating_sub(1)]
    }

    /// When the last row begins.
    #[must_use]
    pub fn last_row_s(&self) -> f64 {
        self.from_s.last().copied().unwrap_or_default()
    }
}

/// A speed as the wire carries it; either direction of rotation.
#[must_use]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked to be in range"
)]
pub fn rpm(speed: f64) -> Option<Rpm> {
    let rounded = speed.abs().round();
    (rounded <= f64::from(u16::MAX)).then_some(Rpm(rounded as u16))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const SENSOR: SensorInput =
        SensorInput { volts_full_scale: 10.0, counts_full_scale: 32768.0, divider: 0.33 };

    fn replay(text: &str) -> Result<Replay, BadInput> {
        let run = RunFile::from_reader(text.as_bytes(), Path::new("run.csv"))?;
        Replay::new(&run, &SENSOR, DEFAULT_ROW_S)
    }

    #[test]
    fn a_row_holds_until_the_next_and_the_last_for_ever() {
        let replay = replay("time_s,sensor_counts,spindle_rpm\n5,0,\n6,16384,300\n8,,-24000\n")
            .expect("a good run");
        let volts = |time| replay.at(time).sensor_volts;
        assert_eq!([volts(0.0), volts(0.999), volts(1.0), volts(1e9)], [0.0, 0.0, 5.0, 5.0]);
        assert_eq!(replay.at(0.5).speed, None);
        assert_eq!(replay.at(2.9).speed, Some(Rpm(300)));
        assert_eq!(replay.at(3.0).speed, Some(Rpm(24_000)));
        assert_eq!(replay.last_row_s(), 3.0);
    }

    #[test]
    fn what_the_sensor_cannot_give_is_refused_with_its_place() {
        let error =
            replay("spindle_rpm,sensor_counts\n0,5048\n0,40000\n").expect_err("beyond 10 V");
        assert_eq!(error.to_string(), "run.csv:3:3: sensor_counts 40000 is outside 0…32768");
        let error = replay("sensor_counts,spindle_rpm\n1,70000\n").expect_err("beyond 16 bits");
        assert!(error.to_string().starts_with("run.csv:2:3: spindle_rpm 70000"), "{error}");
        let error = replay("spindle_rpm\n1\n").expect_err("no sensor");
        assert!(error.to_string().contains("sensor_counts"), "{error}");
    }
}
