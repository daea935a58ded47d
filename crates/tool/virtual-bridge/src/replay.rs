//! A run file as the machine would live it: at each millisecond the sensor's volts, the speed, what
//! the temperature channels deliver, and where the axes stand.
//!
//! A row holds from its time until the next row's; the last one holds for ever. Without a column
//! `time_s` each row lasts a fixed time. A missing value keeps the one before it.

use std::collections::BTreeMap;

use trueup_core::{
    cnc::{
        AxisPosition, Control, LinearAxis, MachineConditions, RotaryAxisAngles, TravelDirection,
    },
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    pt100,
    temperature_channels::RawTemperatures,
    thermometer::RawTemperatureReading,
    units::{MicroDegrees, Position, Rpm, Temperature},
};
use trueup_machine::{
    inputs::{TemperatureInput, TemperatureInputKind},
    location::InputFileError,
    machine_file::{ElongationSource, Machine},
    run_file::RunFile,
    tool_column::TOOL_COLUMN,
};

/// How long a row lasts in a run without `time_s`, unless stated otherwise.
pub(crate) const DEFAULT_ROW_DURATION_S: f64 = 1.0;

/// The column that a gauge at the tool shows.
pub(crate) const GAUGE_COLUMN: &str = "measured_elongation_um";
/// The columns of X, Y and Z.
const POSITION_COLUMNS: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
/// The columns of the direction of approach of X, Y and Z.
const DIRECTION_COLUMNS: [&str; 3] = ["dir_x", "dir_y", "dir_z"];
/// The largest angle that the wire carries, either way.
const MAX_WIRE_ANGLE_DEG: f64 = 262.143;

/// The state of the machine at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MachineSnapshot {
    /// The displacement sensor's output.
    pub sensor_volts: f64,
    /// The spindle's speed, where it is known.
    pub speed: Option<Rpm>,
    /// The deliveries of the temperature channels.
    pub temperatures: RawTemperatures,
    /// Where X, Y and Z are sent, as far as the run says.
    pub positions: [Option<AxisPosition>; 3],
    /// Where the rotary axes of the head are sent, if the run says so.
    pub rotary: Option<RotaryAxisAngles>,
    /// The tool and the conditions, if the run says one of them.
    pub conditions: Option<MachineConditions>,
    /// The CNC's control message, where the CNC is not a client of the serial line.
    pub control: Option<Control>,
}

/// A run, ready to be played.
#[derive(Clone, Debug)]
pub struct RunReplay {
    /// From when on each situation holds, rising from 0.
    from_s: Vec<f64>,
    situations: Vec<MachineSnapshot>,
    /// The growth at the tool in each row, in µm; empty if the run does not state it.
    growths_um: Vec<f64>,
    /// When each channel was read, and what it delivered: between two readings a mass goes from one to the other.
    readings: [Vec<(f64, RawTemperatureReading)>; TEMPERATURE_CHANNEL_COUNT],
}

impl RunReplay {
    /// Prepares a run for this machine. The sensor's counts are needed only where the spindle's
    /// growth is measured by it; a machine without a sensor gets 0 V.
    ///
    /// # Errors
    /// A column that is needed is missing, empty at the start, or outside what the sensor or the
    /// wire can carry; with its place.
    pub fn new(run: &RunFile, machine: &Machine, row_s: f64) -> Result<Self, InputFileError> {
        let inputs = machine.inputs.as_ref();
        let sensor = inputs.and_then(|inputs| inputs.sensor.as_ref());
        let needs_sensor = machine.spindle.source == Some(ElongationSource::Sensor);
        if needs_sensor {
            run.require_column("sensor_counts")?;
        }
        let counts = sensor.zip(run.column("sensor_counts"));
        let speeds = run.column("spindle_rpm");
        let times = run.column("time_s");
        let mut columns = ReplayColumns::from_run(run, machine);
        let mut replay = Self {
            from_s: Vec::new(),
            situations: Vec::new(),
            growths_um: run.column(GAUGE_COLUMN).map_or_else(Vec::new, <[f64]>::to_vec),
            readings: Default::default(),
        };
        let mut now = MachineSnapshot::default();
        let mut start = None;
        for row in 0..run.row_count() {
            if let Some((sensor, count)) = counts.map(|(sensor, counts)| (sensor, counts[row])) {
                if count.is_nan() && row == 0 && needs_sensor {
                    return Err(run.value_error(
                        row,
                        "sensor_counts",
                        "needs a value in the first row",
                    ));
                }
                if !count.is_nan() {
                    if !sensor.is_in_range(count) {
                        let largest = sensor.counts_full_scale;
                        let rule = format!("{count} is outside 0…{largest}");
                        return Err(run.value_error(row, "sensor_counts", rule));
                    }
                    now.sensor_volts = sensor.volts_from_counts(count);
                }
            }
            if let Some(speed) = speeds.map(|speeds| speeds[row]).filter(|speed| !speed.is_nan()) {
                let rpm = round_to_rpm(speed).ok_or_else(|| {
                    run.value_error(row, "spindle_rpm", format!("{speed} is outside 0…65535"))
                })?;
                now.speed = Some(rpm);
            }
            columns.apply_row(row, &mut now)?;
            let time = match times.map(|times| times[row]) {
                None => row_s * row as f64,
                Some(time) if time.is_nan() => {
                    return Err(run.value_error(
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
    pub(crate) fn uses_column(machine: &Machine, name: &str) -> bool {
        let inputs = machine.inputs.as_ref();
        match name {
            "time_s" | "spindle_rpm" => true,
            "sensor_counts" => inputs.is_some_and(|inputs| inputs.sensor.is_some()),
            _ if POSITION_COLUMNS.contains(&name) || DIRECTION_COLUMNS.contains(&name) => true,
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
    pub fn snapshot_at(&self, time_s: f64) -> MachineSnapshot {
        let next = self.from_s.partition_point(|&from| from <= time_s);
        let mut now = self.situations[next.saturating_sub(1)];
        for (raw, readings) in now.temperatures.iter_mut().zip(&self.readings) {
            *raw = interpolate_reading(readings, time_s).unwrap_or(*raw);
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
fn interpolate_reading(
    readings: &[(f64, RawTemperatureReading)],
    time_s: f64,
) -> Option<RawTemperatureReading> {
    let next = readings.partition_point(|&(at, _)| at <= time_s);
    let (&(from_s, RawTemperatureReading(from)), &(to_s, RawTemperatureReading(to))) =
        (readings.get(next.checked_sub(1)?)?, readings.get(next)?);
    let share = (time_s - from_s) / (to_s - from_s);
    Some(RawTemperatureReading(
        (f64::from(from) + share * (f64::from(to) - f64::from(from))).round() as i32,
    ))
}

fn angle_column(axis: impl std::fmt::Display) -> String {
    format!("{axis}_deg")
}

/// The positions of an axis, and its directions where the run has them.
type AxisColumns<'r> = (&'r [f64], Option<&'r [f64]>);

/// The columns of temperatures, positions and angles that a run has and the machine uses.
struct ReplayColumns<'r> {
    run: &'r RunFile,
    temperatures: Vec<(&'r [f64], TemperatureInput)>,
    /// Position, direction, and the position in the row before.
    axes: [Option<AxisColumns<'r>>; 3],
    before_mm: [Option<f64>; 3],
    /// The head's axes in their order.
    angles: Vec<(String, Option<&'r [f64]>)>,
    angles_deg: [Option<f64>; 2],
    tool: Option<&'r [f64]>,
    /// Columns of conditions with their bits.
    conditions: Vec<(&'r [f64], u8)>,
}

impl<'r> ReplayColumns<'r> {
    fn from_run(run: &'r RunFile, machine: &Machine) -> Self {
        let inputs = machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
        let turning = machine.angle_axes().into_iter().map(|axis| angle_column(axis.name()));
        Self {
            run,
            temperatures: inputs
                .filter_map(|(name, input)| Some((run.column(name)?, *input)))
                .collect(),
            axes: std::array::from_fn(|axis| {
                Some((run.column(POSITION_COLUMNS[axis])?, run.column(DIRECTION_COLUMNS[axis])))
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
    fn add_readings(
        &self,
        row: usize,
        time_s: f64,
        readings: &mut [Vec<(f64, RawTemperatureReading)>; TEMPERATURE_CHANNEL_COUNT],
    ) {
        for (column, input) in &self.temperatures {
            if let Some(readings) = readings.get_mut(usize::from(input.channel))
                && !column[row].is_nan()
            {
                readings.push((time_s, raw_reading_from_celsius(input.kind, column[row])));
            }
        }
    }

    /// Applies the changes of a row.
    fn apply_row(&mut self, row: usize, now: &mut MachineSnapshot) -> Result<(), InputFileError> {
        for (column, input) in &self.temperatures {
            if !column[row].is_nan() {
                set_raw_temperature(&mut now.temperatures, input, column[row]);
            }
        }
        for (n, column) in self.axes.iter().enumerate() {
            let Some((positions, directions)) = column else { continue };
            let mm = match positions[row] {
                missing if missing.is_nan() => self.before_mm[n],
                there => Some(there),
            };
            let Some(mm) = mm else { continue };
            let position =
                round_to_i32(mm * f64::from(Position::PER_MILLIMETRE)).ok_or_else(|| {
                    self.run.value_error(
                        row,
                        POSITION_COLUMNS[n],
                        format!("{mm} is beyond the wire's ±21 474 mm"),
                    )
                })?;
            let stated = directions.map(|directions| directions[row]);
            let moved = mm - self.before_mm[n].unwrap_or(mm);
            let direction =
                travel_direction(stated.filter(|stated| !stated.is_nan()).unwrap_or(moved));
            let axis = LinearAxis::ALL[n];
            now.positions[n] = Some(AxisPosition { axis, position: Position(position), direction });
            self.before_mm[n] = Some(mm);
        }
        for ((name, column), angle) in self.angles.iter().zip(&mut self.angles_deg) {
            let Some(deg) = column.map(|column| column[row]).filter(|deg| !deg.is_nan()) else {
                continue;
            };
            if deg.abs() > MAX_WIRE_ANGLE_DEG {
                let rule = format!("{deg} is beyond the wire's ±{MAX_WIRE_ANGLE_DEG}°");
                return Err(self.run.value_error(row, name, rule));
            }
            *angle = Some(deg);
        }
        let known = self.angles_deg.iter().flatten().count();
        if known > 0 && known == self.angles.len() {
            let micro = |deg: Option<f64>| {
                let micro_degrees = deg.unwrap_or(0.0) * f64::from(MicroDegrees::PER_DEGREE);
                MicroDegrees(round_to_i32(micro_degrees).unwrap_or(0))
            };
            now.rotary = Some(RotaryAxisAngles { angles: self.angles_deg.map(micro) });
        }
        self.update_tool_and_conditions(row, now)
    }
}

impl ReplayColumns<'_> {
    /// Tool and conditions; a missing value is that of the row before.
    fn update_tool_and_conditions(
        &self,
        row: usize,
        now: &mut MachineSnapshot,
    ) -> Result<(), InputFileError> {
        if self.tool.is_none() && self.conditions.is_empty() {
            return Ok(());
        }
        let conditions = now.conditions.get_or_insert_default();
        if let Some(tool) = self.tool.map(|tools| tools[row]).filter(|tool| !tool.is_nan()) {
            let number = round_to_i32(tool).and_then(|tool| u16::try_from(tool).ok());
            conditions.tool = number.ok_or_else(|| {
                let rule = "is a label that has no number in [spindle.tools]";
                self.run.value_error(row, TOOL_COLUMN, rule)
            })?;
        }
        for (column, bit) in &self.conditions {
            let bit = 1_u16 << bit;
            match column[row] {
                1.0 => conditions.bits |= bit,
                0.0 => conditions.bits &= !bit,
                _ => {}
            }
        }
        Ok(())
    }
}

fn travel_direction(sign: f64) -> TravelDirection {
    match sign {
        sign if sign > 0.0 => TravelDirection::Positive,
        sign if sign < 0.0 => TravelDirection::Negative,
        _ => TravelDirection::Standing,
    }
}

/// Returns the nearest integer, if the board has it.
#[allow(clippy::cast_possible_truncation, reason = "checked to be in range")]
fn round_to_i32(value: f64) -> Option<i32> {
    let rounded = value.round();
    (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&rounded).then_some(rounded as i32)
}

/// Lets a channel deliver a temperature.
fn set_raw_temperature(temperatures: &mut RawTemperatures, input: &TemperatureInput, celsius: f64) {
    if let Some(channel) = temperatures.get_mut(usize::from(input.channel)) {
        *channel = raw_reading_from_celsius(input.kind, celsius);
    }
}

/// Returns what the channels deliver at these temperatures, by the names of their columns. Those that are
/// not named deliver nothing.
#[must_use]
pub fn raw_temperatures_from_celsius(
    inputs: &BTreeMap<String, TemperatureInput>,
    celsius: &BTreeMap<String, f64>,
) -> RawTemperatures {
    let mut delivered = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
    for (name, input) in inputs {
        if let Some(&celsius) = celsius.get(name) {
            set_raw_temperature(&mut delivered, input, celsius);
        }
    }
    delivered
}

/// Returns what a channel delivers at a temperature in °C. A PT100 has not the steps of its converter here. A value beyond
/// its integer delivers the end of it, which no channel takes for a temperature.
#[must_use]
#[allow(clippy::cast_possible_truncation, reason = "a cast from f64 saturates")]
pub fn raw_reading_from_celsius(kind: TemperatureInputKind, celsius: f64) -> RawTemperatureReading {
    match kind {
        TemperatureInputKind::Pt100 => {
            let t = Temperature((celsius * f64::from(Temperature::PER_KELVIN)).round() as i32);
            RawTemperatureReading(pt100::resistance_from_temperature(t).0)
        }
        TemperatureInputKind::Linear(line) => {
            let (zero_codes, codes_per_c) = line.linear_coefficients_in_codes();
            let codes = zero_codes + codes_per_c * celsius;
            // The lowest number means that nothing was delivered.
            RawTemperatureReading(((codes * 256.0).round() as i32).max(i32::MIN + 1))
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
pub(crate) fn round_to_rpm(speed: f64) -> Option<Rpm> {
    let rounded = speed.abs().round();
    (rounded <= f64::from(u16::MAX)).then_some(Rpm(rounded as u16))
}

#[cfg(test)]
mod tests;
