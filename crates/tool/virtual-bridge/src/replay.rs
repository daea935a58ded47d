//! A run file as the machine would live it: at each millisecond the sensor's volts, the speed, what
//! the temperature channels deliver, and where the axes stand.
//!
//! A row holds from its time until the next row's; the last one holds for ever. Without a column
//! `time_s` each row lasts a fixed time. A missing value keeps the one before it.

use std::collections::BTreeMap;

use trueup_core::{
    channels::RawTemperatures,
    cnc::{AxisPosition, Conditions, Control, Heading, LinearAxis, Rotary},
    dimensions::CHANNELS,
    pt100,
    thermometer::Raw,
    units::{MicroDegrees, Position, Rpm, Temperature},
};
use trueup_machine::{
    file::{ElongationSource, Machine, TOOL_COLUMN},
    inputs::{TemperatureInput, TemperatureKind},
    location::BadInput,
    run_file::RunFile,
};

/// How long a row lasts in a run without `time_s`, unless it is said otherwise.
pub(crate) const DEFAULT_ROW_S: f64 = 1.0;

/// The column that a gauge at the tool shows.
pub(crate) const GAUGED_COLUMN: &str = "measured_elongation_um";
/// The columns of X, Y and Z.
const POSITIONS: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
/// The columns of the direction of approach of X, Y and Z.
const DIRECTIONS: [&str; 3] = ["dir_x", "dir_y", "dir_z"];
/// The largest angle that the wire carries, either way.
const LARGEST_ANGLE_DEG: f64 = 262.143;

/// The state of the machine at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Situation {
    /// The displacement sensor's output.
    pub sensor_volts: f64,
    /// The spindle's speed, where it is known.
    pub speed: Option<Rpm>,
    /// The deliveries of the temperature channels.
    pub temperatures: RawTemperatures,
    /// Where X, Y and Z are sent, as far as the run says.
    pub positions: [Option<AxisPosition>; 3],
    /// Where the rotary axes of the head are sent, if the run says so.
    pub rotary: Option<Rotary>,
    /// The tool and the conditions, if the run says one of them.
    pub conditions: Option<Conditions>,
    /// The CNC's control message, where the CNC is not a client of the serial line.
    pub control: Option<Control>,
}

/// A run, ready to be played.
#[derive(Clone, Debug)]
pub struct Replay {
    /// From when on each situation holds, rising from 0.
    from_s: Vec<f64>,
    situations: Vec<Situation>,
    /// The growth at the tool in each row, in µm; empty if the run does not state it.
    growths_um: Vec<f64>,
    /// When each channel was read, and what it delivered: between two readings a mass goes from one to the other.
    readings: [Vec<(f64, Raw)>; CHANNELS],
}

impl Replay {
    /// Prepares a run for this machine. The sensor's counts are needed only where the spindle's
    /// growth is measured by it; a machine without a sensor gets 0 V.
    ///
    /// # Errors
    /// A column that is needed is missing, empty at the start, or outside what the sensor or the
    /// wire can carry; with its place.
    pub fn new(run: &RunFile, machine: &Machine, row_s: f64) -> Result<Self, BadInput> {
        let inputs = machine.inputs.as_ref();
        let sensor = inputs.and_then(|inputs| inputs.sensor.as_ref());
        let needs_sensor = machine.spindle.source == Some(ElongationSource::Sensor);
        if needs_sensor {
            run.require("sensor_counts")?;
        }
        let counts = sensor.zip(run.column("sensor_counts"));
        let speeds = run.column("spindle_rpm");
        let times = run.column("time_s");
        let mut columns = Columns::of(run, machine);
        let mut replay = Self {
            from_s: Vec::new(),
            situations: Vec::new(),
            growths_um: run.column(GAUGED_COLUMN).map_or_else(Vec::new, <[f64]>::to_vec),
            readings: Default::default(),
        };
        let mut now = Situation::default();
        let mut start = None;
        for row in 0..run.rows() {
            if let Some((sensor, count)) = counts.map(|(sensor, counts)| (sensor, counts[row])) {
                if count.is_nan() && row == 0 && needs_sensor {
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
            }
            if let Some(speed) = speeds.map(|speeds| speeds[row]).filter(|speed| !speed.is_nan()) {
                let rpm = rpm(speed).ok_or_else(|| {
                    run.bad(row, "spindle_rpm", format!("{speed} is outside 0…65535"))
                })?;
                now.speed = Some(rpm);
            }
            columns.take(row, &mut now)?;
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
            columns.add_readings(row, time - start, &mut replay.readings);
            replay.from_s.push(time - start);
            replay.situations.push(now);
        }
        Ok(replay)
    }

    /// Returns whether a replay for this machine plays the column `name`.
    #[must_use]
    pub fn uses(machine: &Machine, name: &str) -> bool {
        let inputs = machine.inputs.as_ref();
        match name {
            "time_s" | "spindle_rpm" => true,
            "sensor_counts" => inputs.is_some_and(|inputs| inputs.sensor.is_some()),
            _ if POSITIONS.contains(&name) || DIRECTIONS.contains(&name) => true,
            TOOL_COLUMN => true,
            _ => {
                inputs.is_some_and(|inputs| {
                    inputs.temperatures.contains_key(name) || inputs.conditions.contains_key(name)
                }) || machine.angle_axes().iter().any(|axis| angle_column(axis.name()) == name)
            }
        }
    }

    /// Returns what the machine does at a time in seconds from the start.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Situation {
        let next = self.from_s.partition_point(|&from| from <= time_s);
        let mut now = self.situations[next.saturating_sub(1)];
        for (raw, readings) in now.temperatures.iter_mut().zip(&self.readings) {
            *raw = between(readings, time_s).unwrap_or(*raw);
        }
        now
    }

    /// Returns the growth at the tool at a time in seconds from the start, in µm: the newest value of the run, 0 before
    /// the first one; `None` if the run does not state it.
    #[must_use]
    pub fn growth_um(&self, time_s: f64) -> Option<f64> {
        let next = self.from_s.partition_point(|&from| from <= time_s);
        let so_far = self.growths_um.get(..next.max(1))?;
        Some(so_far.iter().rev().copied().find(|um| !um.is_nan()).unwrap_or(0.0))
    }
}

/// Returns what a channel delivers at a time between two of its readings; `None` before the first and after the last.
#[allow(clippy::cast_possible_truncation, reason = "between two integers")]
fn between(readings: &[(f64, Raw)], time_s: f64) -> Option<Raw> {
    let next = readings.partition_point(|&(at, _)| at <= time_s);
    let (&(from_s, Raw(from)), &(to_s, Raw(to))) =
        (readings.get(next.checked_sub(1)?)?, readings.get(next)?);
    let share = (time_s - from_s) / (to_s - from_s);
    Some(Raw((f64::from(from) + share * (f64::from(to) - f64::from(from))).round() as i32))
}

fn angle_column(axis: impl std::fmt::Display) -> String {
    format!("{axis}_deg")
}

/// The positions of an axis, and its directions where the run has them.
type Travelled<'r> = (&'r [f64], Option<&'r [f64]>);

/// The columns of temperatures, positions and angles that a run has and the machine uses.
struct Columns<'r> {
    run: &'r RunFile,
    temperatures: Vec<(&'r [f64], TemperatureInput)>,
    /// Position, direction, and the position in the row before.
    axes: [Option<Travelled<'r>>; 3],
    before_mm: [Option<f64>; 3],
    /// The head's axes in their order.
    angles: Vec<(String, Option<&'r [f64]>)>,
    angles_deg: [Option<f64>; 2],
    tool: Option<&'r [f64]>,
    /// Columns of conditions with their bits.
    conditions: Vec<(&'r [f64], u8)>,
}

impl<'r> Columns<'r> {
    fn of(run: &'r RunFile, machine: &Machine) -> Self {
        let inputs = machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
        let turning = machine.angle_axes().into_iter().map(|axis| angle_column(axis.name()));
        Self {
            run,
            temperatures: inputs
                .filter_map(|(name, input)| Some((run.column(name)?, *input)))
                .collect(),
            axes: std::array::from_fn(|axis| {
                Some((run.column(POSITIONS[axis])?, run.column(DIRECTIONS[axis])))
            }),
            before_mm: [None; 3],
            angles: turning.map(|name| (name.clone(), run.column(&name))).collect(),
            angles_deg: [None; 2],
            tool: run.column(TOOL_COLUMN),
            conditions: machine
                .inputs
                .iter()
                .flat_map(|inputs| &inputs.conditions)
                .filter_map(|(name, input)| Some((run.column(name)?, input.bit)))
                .collect(),
        }
    }

    /// Adds what the channels are read to be in a row.
    fn add_readings(&self, row: usize, time_s: f64, readings: &mut [Vec<(f64, Raw)>; CHANNELS]) {
        for (column, input) in &self.temperatures {
            if let Some(readings) = readings.get_mut(usize::from(input.channel))
                && !column[row].is_nan()
            {
                readings.push((time_s, raw(input.kind, column[row])));
            }
        }
    }

    /// Applies the changes of a row.
    fn take(&mut self, row: usize, now: &mut Situation) -> Result<(), BadInput> {
        for (column, input) in &self.temperatures {
            if !column[row].is_nan() {
                deliver(&mut now.temperatures, input, column[row]);
            }
        }
        for (n, column) in self.axes.iter().enumerate() {
            let Some((positions, directions)) = column else { continue };
            let mm = match positions[row] {
                missing if missing.is_nan() => self.before_mm[n],
                there => Some(there),
            };
            let Some(mm) = mm else { continue };
            let position = whole(mm * f64::from(Position::PER_MILLIMETRE)).ok_or_else(|| {
                self.run.bad(row, POSITIONS[n], format!("{mm} is beyond the wire's ±21 474 mm"))
            })?;
            let stated = directions.map(|directions| directions[row]);
            let moved = mm - self.before_mm[n].unwrap_or(mm);
            let direction = heading(stated.filter(|stated| !stated.is_nan()).unwrap_or(moved));
            let axis = LinearAxis::ALL[n];
            now.positions[n] = Some(AxisPosition { axis, position: Position(position), direction });
            self.before_mm[n] = Some(mm);
        }
        for ((name, column), angle) in self.angles.iter().zip(&mut self.angles_deg) {
            let Some(deg) = column.map(|column| column[row]).filter(|deg| !deg.is_nan()) else {
                continue;
            };
            if deg.abs() > LARGEST_ANGLE_DEG {
                let rule = format!("{deg} is beyond the wire's ±{LARGEST_ANGLE_DEG}°");
                return Err(self.run.bad(row, name, rule));
            }
            *angle = Some(deg);
        }
        let known = self.angles_deg.iter().flatten().count();
        if known > 0 && known == self.angles.len() {
            let micro = |deg: Option<f64>| {
                let micro_degrees = deg.unwrap_or(0.0) * f64::from(MicroDegrees::PER_DEGREE);
                MicroDegrees(whole(micro_degrees).unwrap_or(0))
            };
            now.rotary = Some(Rotary { angles: self.angles_deg.map(micro) });
        }
        self.take_conditions(row, now)
    }
}

impl Columns<'_> {
    /// Tool and conditions; a missing value is that of the row before.
    fn take_conditions(&self, row: usize, now: &mut Situation) -> Result<(), BadInput> {
        if self.tool.is_none() && self.conditions.is_empty() {
            return Ok(());
        }
        let said = now.conditions.get_or_insert_default();
        if let Some(tool) = self.tool.map(|tools| tools[row]).filter(|tool| !tool.is_nan()) {
            let number = whole(tool).and_then(|tool| u16::try_from(tool).ok());
            said.tool = number.ok_or_else(|| {
                let rule = "is a label that has no number in [spindle.tools]";
                self.run.bad(row, TOOL_COLUMN, rule)
            })?;
        }
        for (column, bit) in &self.conditions {
            let bit = 1_u16 << bit;
            match column[row] {
                1.0 => said.bits |= bit,
                0.0 => said.bits &= !bit,
                _ => {}
            }
        }
        Ok(())
    }
}

fn heading(sign: f64) -> Heading {
    match sign {
        sign if sign > 0.0 => Heading::Positive,
        sign if sign < 0.0 => Heading::Negative,
        _ => Heading::Standing,
    }
}

/// Returns the nearest integer, if the board has it.
#[allow(clippy::cast_possible_truncation, reason = "checked to be in range")]
fn whole(value: f64) -> Option<i32> {
    let rounded = value.round();
    (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&rounded).then_some(rounded as i32)
}

/// Lets a channel deliver a temperature.
fn deliver(temperatures: &mut RawTemperatures, input: &TemperatureInput, celsius: f64) {
    if let Some(channel) = temperatures.get_mut(usize::from(input.channel)) {
        *channel = raw(input.kind, celsius);
    }
}

/// Returns what the channels deliver at these temperatures, by the names of their columns. Those that are
/// not named deliver nothing.
#[must_use]
pub fn raw_temperatures(
    inputs: &BTreeMap<String, TemperatureInput>,
    celsius: &BTreeMap<String, f64>,
) -> RawTemperatures {
    let mut delivered = [Raw::NONE; CHANNELS];
    for (name, input) in inputs {
        if let Some(&celsius) = celsius.get(name) {
            deliver(&mut delivered, input, celsius);
        }
    }
    delivered
}

/// Returns what a channel delivers at a temperature in °C. A PT100 has not the steps of its converter here. A value beyond
/// its integer delivers the end of it, which no channel takes for a temperature.
#[must_use]
#[allow(clippy::cast_possible_truncation, reason = "a cast from f64 saturates")]
pub fn raw(kind: TemperatureKind, celsius: f64) -> Raw {
    match kind {
        TemperatureKind::Pt100 => {
            let t = Temperature((celsius * f64::from(Temperature::PER_KELVIN)).round() as i32);
            Raw(pt100::resistance(t).0)
        }
        TemperatureKind::Linear(line) => {
            let (zero_codes, codes_per_c) = line.in_codes();
            let codes = zero_codes + codes_per_c * celsius;
            // The lowest number means that nothing was delivered.
            Raw(((codes * 256.0).round() as i32).max(i32::MIN + 1))
        }
    }
}

/// Returns a speed as the wire carries it; either direction of rotation.
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
    use trueup_machine::MachineFile;

    const LIMITS: &str = "[limits]\nmax_um = { x = 200.0, y = 200.0, z = 500.0 }\n\
        slew_um_per_s = 20.0\nlink_timeout_ms = 500\nhold_ms = 2000\n";

    fn machine(text: &str) -> Machine {
        MachineFile::parse(&format!("{text}{LIMITS}"), Path::new("m.toml")).expect("a good machine")
    }

    fn with_sensor() -> Machine {
        machine(
            "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
             [inputs]\nsensor = { volts_full_scale = 10, counts_full_scale = 32768, divider = 0.33 }\n\
             [spindle]\nsource = \"sensor\"\n\
             [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.015\n",
        )
    }

    fn replay_on(machine: &Machine, text: &str) -> Result<Replay, BadInput> {
        let run = RunFile::from_reader(text.as_bytes(), Path::new("run.csv"))?;
        Replay::new(&run, machine, DEFAULT_ROW_S)
    }

    fn replay(text: &str) -> Result<Replay, BadInput> {
        replay_on(&with_sensor(), text)
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
        assert_eq!(replay.growth_um(1.0), None, "the run does not say");
    }

    #[test]
    fn a_gauge_shows_the_newest_value_of_the_run() {
        let text = "time_s,sensor_counts,measured_elongation_um\n0,0,\n1,0,2.5\n2,0,\n3,0,4\n";
        let replay = replay(text).expect("a good run");
        let shown = [-1.0, 0.5, 1.0, 2.5, 9.0].map(|time| replay.growth_um(time));
        assert_eq!(shown, [0.0, 0.0, 2.5, 2.5, 4.0].map(Some));
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

    fn without_sensor() -> Machine {
        machine(
            "[machine]\nname = \"m\"\nkind = \"head-head\"\nhead_axes = [\"c\", \"a\"]\n\
             [inputs]\n\
             temp_screw_c = { channel = 2, kind = \"pt100\" }\n\
             temp_bed_c = { channel = 5, kind = \"linear\", zero_counts = 4000.0, \
             counts_per_c = 16.0 }\n",
        )
    }

    #[test]
    fn temperatures_come_as_their_channels_deliver_them() {
        let text = "temp_screw_c,temp_bed_c,temp_else_c\n25,23.5,1\n,24.5,1\n";
        let replay = replay_on(&without_sensor(), text).expect("it needs no sensor");
        let delivered = |time| replay.at(time).temperatures;
        // IEC 60751: 109.734656 ohms at 25 °C; 4000 + 16·23.5 counts in 1/256.
        assert!((delivered(0.0)[2].0 - 109_734_656).abs() <= 1);
        assert_eq!(delivered(0.0)[5], Raw(4376 * 256));
        assert_eq!(delivered(1.0)[5], Raw(4392 * 256));
        assert_eq!(delivered(0.25)[5], Raw(4380 * 256), "between two rows by a straight line");
        assert_eq!(delivered(9.0)[5], Raw(4392 * 256), "the last row is held");
        assert_eq!(delivered(1.0)[2], delivered(0.0)[2], "a missing value keeps the one before");
        assert_eq!(delivered(0.0)[0], Raw::NONE);
        assert_eq!(replay.at(0.0).sensor_volts, 0.0);
        let uses = |name| Replay::uses(&without_sensor(), name);
        assert!(uses("temp_screw_c") && uses("a_deg") && uses("dir_x"));
        assert!(!uses("temp_else_c") && !uses("b_deg") && !uses("sensor_counts"));
    }

    #[test]
    fn an_axis_heads_where_the_run_says_or_else_where_it_moves() {
        let text = "x_mm,y_mm,dir_y,a_deg,c_deg\n1,1,-1,,90\n3,1,-1,-33.3335,90\n2,1,1,,\n2,,1,,\n";
        let replay = replay_on(&without_sensor(), text).expect("a good run");
        let at = |row: f64, axis: usize| {
            let there = replay.at(row).positions[axis].expect("a position");
            (there.position.0, there.direction as i8)
        };
        let x: Vec<_> = (0..4).map(|row| at(f64::from(row), 0)).collect();
        assert_eq!(x, [(100_000, 0), (300_000, 1), (200_000, -1), (200_000, 0)]);
        let y: Vec<_> = (0..4).map(|row| at(f64::from(row), 1)).collect();
        assert_eq!(y, [(100_000, -1), (100_000, -1), (100_000, 1), (100_000, 1)]);
        assert_eq!(replay.at(0.0).positions[2], None);
        assert_eq!(replay.at(0.0).rotary, None, "one angle is not yet known");
        // In the order of the head's axes: C, then A.
        let angles = [90_000_000, -33_333_500].map(MicroDegrees);
        assert_eq!(replay.at(2.0).rotary, Some(Rotary { angles }));
    }
}
