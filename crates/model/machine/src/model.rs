//! The reference model in `f64`: what the board's integers are measured against.
//!
//! | module | part |
//! |---|---|
//! | `elongation` | the tool's growth, by sensor, warm-up or temperature |
//! | `kinematics` | the tool direction, along which the growth is laid |
//! | `thermal` | an axis's growth with a temperature |
//! | `lag` | the first-order lag of a temperature |
//! | `late` | the part's temperature where its thermometer is late |
//! | `pitch` | an axis's position errors and its backlash |
//! | `straightness` | the error of one axis along another, curved and straight |
//! | `volume` | angular errors and lines of rotary axes, by their levers |
//! | `term` | what a diagnosis has added |
//!
//! A run is stepped through row by row, because lags and the warm-up are states. The error of an
//! axis, actual minus commanded, is the sum of its parts:
//!
//! ```text
//! Δx = thermal + pitch + backlash + δx(y) + δx(z) + squareness + volume + s·V_x
//! ```
//!
//! and likewise on Y and Z. Then come the terms of a diagnosis: those of the elongation before it is
//! laid along the tool, those of an axis after the sum. A value that is missing (NaN) makes what depends on it NaN, and nothing
//! else.

mod elongation;
mod kinematics;
mod lag;
mod pitch;
mod reversal;
mod squareness;
mod term;
mod thermal;
mod thermometer_delay;
mod tool_growth;
mod volume;

pub use crate::{sections::axis::is_negative_direction, spline::spline_value_um};
pub use elongation::{
    WarmupState, elongation_um, heat_input, sensor_counts_from_elongation,
    temperature_elongation_um, warmup_elongation_um,
};
pub use kinematics::{
    compensation_offset_um, elongation_error_um, rotate_about_axis, tool_direction,
};
pub use lag::Lag;
pub use pitch::{backlash_um, dual_pitch_error_um, pitch_error_um};
pub use reversal::max_over_compensation_um;
pub use squareness::squareness_error_um;

pub use term::{
    FallingTimeConstants, apply_constant_terms, shift_series, shift_series_at_rows, time_shift_s,
};
pub use thermal::{thermal_constant_and_slope, thermal_error_um};
pub use thermometer_delay::{
    part_temperature_c, part_temperature_columns, part_temperature_from_means_c,
};
pub(crate) use tool_growth::tool_growth_term;
pub use volume::volumetric_error_um;

use std::borrow::Cow;

use term::TermLags;
use thermometer_delay::DelayedParts;

use crate::{
    effect::Quantity,
    machine_file::{Machine, Term},
    sections::{ElongationSource, LinearAxis, SensorModel},
};

/// The inputs of one row of a run, as far as they are known. A missing one is NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowInputs<'a> {
    /// `None` where the run has no such column.
    pub time_s: Option<f64>,
    /// The number of the repeat; `None` where the run has no such column.
    pub run: Option<f64>,
    /// The displacement sensor, in the PLC's counts.
    pub sensor_counts: f64,
    /// `None` where the run has no such column: the spindle runs from the first row.
    pub spindle_rpm: Option<f64>,
    /// The axial cutting force, pushing the tool back is positive; `None` where the run has no such
    /// column.
    pub load_n: Option<f64>,
    /// The feed at which the position was approached; above 0.
    pub feed_mm_per_min: f64,
    /// Temperatures in °C by the name of their column.
    pub temperatures_c: &'a [(&'a str, f64)],
    /// Other columns that a term reads, by their names.
    pub others: &'a [(&'a str, f64)],
    /// X, Y and Z.
    pub position_mm: [f64; 3],
    /// A, B and C.
    pub angle_deg: [f64; 3],
    /// The direction of approach of X, Y and Z: +1 or −1; a missing one is +1.
    pub direction: [f64; 3],
    /// The length of the tool in the spindle; `None` where the run has no such column: that of the machine file.
    pub tool_length_mm: Option<f64>,
}

impl RowInputs<'_> {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self {
        time_s: None,
        run: None,
        sensor_counts: f64::NAN,
        spindle_rpm: None,
        load_n: None,
        feed_mm_per_min: f64::NAN,
        temperatures_c: &[],
        others: &[],
        position_mm: [f64::NAN; 3],
        angle_deg: [f64::NAN; 3],
        direction: [f64::NAN; 3],
        tool_length_mm: None,
    };

    /// Returns the temperature of `column`; NaN if it is missing.
    #[must_use]
    pub fn temperature_c(&self, column: &str) -> f64 {
        let found = self.temperatures_c.iter().find(|(name, _)| *name == column);
        found.map_or(f64::NAN, |&(_, temperature_c)| temperature_c)
    }

    /// Returns the value of another `column`; NaN if it is missing.
    #[must_use]
    pub(crate) fn other_column_value(&self, column: &str) -> f64 {
        let found = self.others.iter().find(|(name, _)| *name == column);
        found.map_or(f64::NAN, |&(_, value)| value)
    }
}

impl Default for RowInputs<'_> {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

/// One side's values for one row, in µm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorValues {
    /// Positive when the tool grows out of the spindle.
    pub elongation_um: f64,
    /// The error of the tool tip on X, Y and Z.
    pub error_um: [f64; 3],
}

impl ErrorValues {
    /// Returns the quantities `elongation`, `dx`, `dy`, `dz`, in this order.
    #[must_use]
    pub fn to_array(self) -> [f64; 4] {
        let [dx, dy, dz] = self.error_um;
        [self.elongation_um, dx, dy, dz]
    }
}

/// The model's values for one row by where they come from, in µm; arrays are X, Y and Z. A part
/// that the machine does not have is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorComponents {
    /// The tool's growth, along the tool.
    pub elongation_um: f64,
    /// The tool direction, of length 1.
    pub tool_direction: [f64; 3],
    /// The error of the tool's growth.
    pub tool_um: [f64; 3],
    /// The error of each axis's growth with its temperature.
    pub thermal_um: [f64; 3],
    /// The position errors of each axis.
    pub pitch_um: [f64; 3],
    /// The error of the approach in the negative direction.
    pub backlash_um: [f64; 3],
    /// The straightness of the two other axes, across them.
    pub straightness_um: [f64; 3],
    /// The angles to the two other axes.
    pub squareness_um: [f64; 3],
    /// Angular errors and location errors of rotary axes, by their levers to the tool tip.
    pub volumetric_error_um: [f64; 3],
    /// The effect of a diagnosis's terms on the error of each axis; those of the elongation are in
    /// it.
    pub terms_um: [f64; 3],
}

impl ErrorComponents {
    /// Returns the error on X, Y and Z: the sum of the parts.
    #[must_use]
    pub fn error_um(&self) -> [f64; 3] {
        let parts = [
            self.thermal_um,
            self.pitch_um,
            self.backlash_um,
            self.straightness_um,
            self.squareness_um,
            self.volumetric_error_um,
            self.tool_um,
            self.terms_um,
        ];
        [0, 1, 2].map(|axis| parts.iter().map(|part| part[axis]).sum())
    }

    /// Elongation and error.
    #[must_use]
    pub fn to_error_values(&self) -> ErrorValues {
        ErrorValues { elongation_um: self.elongation_um, error_um: self.error_um() }
    }
}

/// The model of a machine on its way through a run.
#[derive(Clone, Debug)]
pub struct ReferenceModel<'m> {
    /// With the constants that its terms say are right.
    machine: Cow<'m, Machine>,
    falling: FallingTimeConstants,
    late: DelayedParts,
    /// The time of the newest row that had one.
    time_s: Option<f64>,
    state: ModelState,
}

/// The state that the rows before have left behind.
#[derive(Clone, Debug, Default)]
struct ModelState {
    warmup: WarmupState,
    spindle_lag: Lag,
    axis_lags: [Lag; 3],
    terms: TermLags,
}

impl<'m> ReferenceModel<'m> {
    /// At the start of a run: cold, and all lags settled at the first row.
    #[must_use]
    pub fn new(machine: &'m Machine) -> Self {
        Self::from_machine(Cow::Borrowed(machine))
    }

    /// Returns the same, with a machine of its own.
    #[must_use]
    pub fn from_owned(machine: Machine) -> ReferenceModel<'static> {
        ReferenceModel::from_machine(Cow::Owned(machine))
    }

    /// Returns the same, of a machine that may be its own.
    pub(crate) fn from_machine(machine: Cow<'m, Machine>) -> Self {
        let (mut machine, falling) = apply_constant_terms(machine);
        if !machine.terms.is_sorted_by_key(|term| term.effect.stage()) {
            machine.to_mut().terms.sort_by_key(|term| term.effect.stage());
        }
        let late = DelayedParts::from_machine(&machine);
        Self { machine, falling, late, time_s: None, state: ModelState::default() }
    }

    /// Returns the model's values for the next row of the run, but for a `time-shift`, which needs the whole
    /// run ([`shift_series`]). Where time runs back, the run starts anew.
    pub fn step(&mut self, situation: &RowInputs<'_>) -> ErrorComponents {
        let time_s = situation.time_s.unwrap_or(f64::NAN);
        if !time_s.is_nan() {
            if self.time_s.is_some_and(|before_s| time_s < before_s) {
                self.state = ModelState::default();
            }
            self.time_s = Some(time_s);
        }
        let elongation_um = self.elongation_um(time_s, situation);
        let ModelState { terms, .. } = &mut self.state;
        let mut with_terms =
            |quantity, p_um| terms.apply(&self.machine.terms, quantity, time_s, situation, p_um);
        let mut parts = ErrorComponents {
            elongation_um: with_terms(Quantity::Elongation, elongation_um),
            tool_direction: tool_direction(
                self.machine.tool_direction,
                &self.machine.head_axes,
                situation.angle_deg,
            ),
            ..ErrorComponents::default()
        };
        // Without growth it does not matter where the tool points.
        if self.machine.has_elongation() {
            parts.tool_um = elongation_error_um(parts.elongation_um, parts.tool_direction);
        }
        for axis in LinearAxis::ALL {
            self.add_axis_error(axis, time_s, situation, &mut parts);
        }
        let at = |axis: LinearAxis| situation.position_mm[axis.index()];
        for curve in &self.machine.straightness {
            parts.straightness_um[curve.error.index()] +=
                spline_value_um(&curve.spline, at(curve.along));
        }
        for angle in self.machine.nonzero_squareness_errors() {
            parts.squareness_um[angle.error.index()] += squareness_error_um(angle, at(angle.along));
        }
        let volume = &self.machine.volume;
        let tool = volume.tool.with_length(situation.tool_length_mm);
        parts.volumetric_error_um =
            volumetric_error_um(&self.machine, tool, situation.position_mm, situation.angle_deg);
        let ModelState { terms, .. } = &mut self.state;
        let sum_um = parts.error_um();
        for axis in LinearAxis::ALL {
            let (of, p_um) = (Quantity::from_axis(axis), sum_um[axis.index()]);
            let with_um = terms.apply(&self.machine.terms, of, time_s, situation, p_um);
            parts.terms_um[axis.index()] = with_um - p_um;
        }
        parts
    }

    fn elongation_um(&mut self, time_s: f64, situation: &RowInputs<'_>) -> f64 {
        let spindle = &self.machine.spindle;
        match spindle.source {
            None => 0.0,
            Some(ElongationSource::Sensor) => spindle
                .sensor
                .as_ref()
                .map_or(f64::NAN, |sensor| elongation_um(sensor, situation.sensor_counts)),
            Some(ElongationSource::Warmup) => spindle.warmup.as_ref().map_or(f64::NAN, |model| {
                // Without a column of speeds it runs, at the speed that the model is rated for.
                let rated_rpm = model.rated_rpm.unwrap_or(1.0);
                let spindle_rpm = situation.spindle_rpm.unwrap_or(rated_rpm);
                self.state.warmup.step(model, time_s, spindle_rpm)
            }),
            Some(ElongationSource::Temperature) => {
                spindle.temperature.as_ref().map_or(f64::NAN, |model| {
                    let measured_c = self.late.driving_temperature_c(
                        Quantity::Elongation,
                        &model.sensor,
                        situation,
                    );
                    let lags_s = [model.lag_s, self.falling.spindle_s.unwrap_or(model.lag_s)];
                    let lag = &mut self.state.spindle_lag;
                    let temperature_c = lag.step_asymmetric(lags_s, time_s, measured_c);
                    temperature_elongation_um(model, temperature_c)
                })
            }
        }
    }

    fn add_axis_error(
        &mut self,
        which: LinearAxis,
        time_s: f64,
        situation: &RowInputs<'_>,
        parts: &mut ErrorComponents,
    ) {
        let index = which.index();
        let axis = &self.machine.axes[index];
        let position_mm = situation.position_mm[index];
        let direction = situation.direction[index];
        if let Some(thermal) = &axis.thermal {
            let of = Quantity::from_axis(which);
            let measured_c = self.late.driving_temperature_c(of, &thermal.sensor, situation);
            let lags_s = [thermal.lag_s, self.falling.axes_s[index].unwrap_or(thermal.lag_s)];
            let lag = &mut self.state.axis_lags[index];
            let temperature_c = lag.step_asymmetric(lags_s, time_s, measured_c);
            parts.thermal_um[index] = thermal_error_um(thermal, temperature_c, position_mm);
        }
        if let Some(pitch) = &axis.pitch {
            parts.pitch_um[index] = match &axis.dual {
                None => pitch_error_um(pitch, position_mm, direction),
                Some(dual) => {
                    let across_mm = situation.position_mm[dual.across.index()];
                    dual_pitch_error_um(pitch, dual, position_mm, across_mm, direction)
                }
            };
        }
        if let Some(backlash) = &axis.backlash {
            parts.backlash_um[index] = backlash_um(backlash, direction);
        }
    }
}

/// Returns the columns of a run without which [`ReferenceModel`] has no values for `machine`: `time_s` where
/// there is a lag or a warm-up, `sensor_counts`, temperatures, positions, angles, in this order,
/// then what its terms need beyond that. `dir_*` is never among them, because it may be missing,
/// and `spindle_rpm` only for a term.
#[must_use]
pub fn required_columns(machine: &Machine) -> Vec<String> {
    let (machine, falling) = apply_constant_terms(Cow::Borrowed(machine));
    let falls = falling.spindle_s.into_iter().chain(falling.axes_s.into_iter().flatten());
    let (mut is_timed, mut has_counts) = (falls.count() > 0, false);
    let mut temperatures = Vec::new();
    let spindle = &machine.spindle;
    match spindle.source {
        None => {}
        Some(ElongationSource::Sensor) => has_counts = true,
        Some(ElongationSource::Warmup) => is_timed = true,
        Some(ElongationSource::Temperature) => temperatures
            .extend(spindle.temperature.as_ref().map(|model| (&model.sensor, model.lag_s))),
    }
    let thermal = machine.axes.iter().filter_map(|axis| axis.thermal.as_ref());
    temperatures.extend(thermal.map(|thermal| (&thermal.sensor, thermal.lag_s)));
    is_timed |= temperatures.iter().any(|&(_, lag_s)| lag_s != 0.0);
    let mut names: Vec<String> = temperatures.into_iter().map(|(name, _)| name.clone()).collect();
    names.sort_unstable();
    names.dedup();

    let mut columns = Vec::new();
    columns.extend(is_timed.then(|| "time_s".to_string()));
    columns.extend(has_counts.then(|| "sensor_counts".to_string()));
    columns.append(&mut names);
    let positions = LinearAxis::ALL.into_iter().filter(|&axis| machine.needs_position(axis));
    columns.extend(positions.map(|axis| axis.column_name()));
    let mut turning = if machine.has_elongation() { machine.head_axes.clone() } else { Vec::new() };
    for axis in machine.volume_rotary_axes() {
        if !turning.contains(&axis) {
            turning.push(axis);
        }
    }
    columns.extend(turning.iter().map(|axis| format!("{}_deg", axis.name())));
    for column in term::required_term_columns(&machine.terms) {
        if !columns.contains(&column) {
            columns.push(column);
        }
    }
    columns
}

impl Machine {
    /// Returns the elongation in µm by the displacement sensor: 0 where it is not the source, NaN for a
    /// missing count.
    #[must_use]
    pub fn elongation_um(&self, sensor_counts: f64) -> f64 {
        match (self.spindle.source, &self.spindle.sensor) {
            (Some(ElongationSource::Sensor), Some(sensor)) => elongation_um(sensor, sensor_counts),
            _ => 0.0,
        }
    }

    /// Returns the law of the displacement sensor, where the board runs it: it is the source of the
    /// elongation, or connected and so what the board falls back to.
    #[must_use]
    pub fn board_sensor_model(&self) -> Option<&SensorModel> {
        let source = self.spindle.source?;
        let is_connected = self.inputs.as_ref().is_some_and(|inputs| inputs.sensor.is_some());
        let is_run = source == ElongationSource::Sensor || is_connected;
        self.spindle.sensor.as_ref().filter(|_| is_run)
    }

    /// Returns whether there is anything that the tool grows by.
    #[must_use]
    pub fn has_elongation(&self) -> bool {
        self.spindle.source.is_some()
            || self.spindle.tools.is_some()
            || self.terms.iter().any(|term| term.quantity == Quantity::Elongation)
    }

    /// Returns the machine without the terms that only explain: what the board is to correct.
    #[must_use]
    pub fn with_only_compensated_terms(&self) -> Cow<'_, Self> {
        let is_compensated = |term: &Term| term.effect.is_compensable();
        if self.terms.iter().all(is_compensated) {
            return Cow::Borrowed(self);
        }
        let mut machine = self.clone();
        machine.terms.retain(is_compensated);
        Cow::Owned(machine)
    }

    /// Returns the angles between axes that are not right: what is written as 0 needs no position.
    fn nonzero_squareness_errors(&self) -> impl Iterator<Item = &crate::sections::Squareness> {
        self.squareness.iter().filter(|angle| angle.um_per_m != 0.0)
    }

    /// Returns whether any part of the model depends on where `axis` is.
    fn needs_position(&self, axis: LinearAxis) -> bool {
        let own = &self.axes[axis.index()];
        own.pitch.is_some()
            || own.thermal.as_ref().is_some_and(|thermal| thermal.mode.has_position_term())
            || self
                .axes
                .iter()
                .any(|other| other.dual.as_ref().is_some_and(|dual| dual.across == axis))
            || self.straightness.iter().any(|curve| curve.along == axis)
            || self.nonzero_squareness_errors().any(|angle| angle.along == axis)
            || self.volume_needs_position(axis)
    }
}
