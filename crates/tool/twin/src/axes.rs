//! The linear axes: what is measured at the tool when they move.
//!
//! The error of an axis, actual minus commanded, is the sum of
//!
//! - heat: expansion·(T − T₀)·(P − origin), T that of the screw, which friction heats by the speed, or
//!   that of the scale, which follows the air; each with a time constant of its own;
//! - pitch: a slope, a curve through points, a wave with the period of the screw;
//! - backlash: 0 where it came from below, +B where it came from above. After a reversal it is taken up
//!   over a way s₀ (pre-sliding, Dahl's law): b ← b∞ + (b − b∞)·e^(−|ΔP|/s₀). Or it is a gap, which the
//!   screw crosses before the table follows: b ← b − ΔP held to 0…B. Under small movements to and fro
//!   Dahl's law creeps to B/2, as is known of it; a gap does not, so an axis that is corrected all the
//!   time should have one. A scale on the axis sees all of it;
//! - straightness: a curve over the position of another axis; squareness: a slope over it;
//! - Abbe: an angle along one axis times the arm at which another one stands.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    cubic_spline::CubicSpline,
    scenario_error::{RuleViolation, keys},
};

/// The axes' names, by number.
pub const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];

/// A linear axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AxisName {
    /// X, number 0.
    X,
    /// Y, number 1.
    Y,
    /// Z, number 2.
    Z,
}

impl AxisName {
    /// 0, 1 or 2.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }
}

/// Where the position of an axis is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Feedback {
    /// On the screw: its heat and its backlash are errors.
    #[default]
    Screw,
    /// By a scale: the scale's heat is an error, backlash is none.
    Scale,
}

/// An axis as a scenario describes it. Every error is 0 by default but for the expansion.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AxisConfig {
    /// Where the position is measured.
    pub feedback: Feedback,
    /// Expansion of the screw in µm/(m·K).
    pub screw_um_per_m_per_c: f64,
    /// How much warmer than the air the screw becomes at 1 m/min, in K.
    pub screw_heating_c: f64,
    /// Time constant of the screw in s.
    pub screw_lag_s: f64,
    /// Expansion of the scale in µm/(m·K).
    pub scale_um_per_m_per_c: f64,
    /// Time constant with which the scale follows the air, in s.
    pub scale_lag_s: f64,
    /// The temperature at which the axis is right, in °C.
    pub reference_c: f64,
    /// Where screw or scale are held, in mm.
    pub origin_mm: f64,
    /// Slope of the position error in µm/m.
    pub pitch_um_per_m: f64,
    /// Position errors in µm over mm, smooth between.
    pub pitch: CubicSpline,
    /// Amplitude of the periodic error in µm.
    pub periodic_um: f64,
    /// Its period in mm, above 0: the pitch of the screw.
    pub periodic_mm: f64,
    /// Its phase at 0 mm in degrees.
    pub periodic_phase_deg: f64,
    /// Amplitude of its second harmonic in µm.
    pub periodic_second_um: f64,
    /// Error of an approach from above, in µm.
    pub backlash_um: f64,
    /// How this grows along the axis, in µm/m.
    pub backlash_um_per_m: f64,
    /// s₀: the way over which it is taken up, in mm; 0: at once.
    pub pre_sliding_mm: f64,
    /// Whether it is a gap instead, of this width at every place.
    pub gap: bool,
}

impl Default for AxisConfig {
    fn default() -> Self {
        Self {
            feedback: Feedback::Screw,
            screw_um_per_m_per_c: 11.5,
            screw_heating_c: 0.6,
            screw_lag_s: 1500.0,
            scale_um_per_m_per_c: 10.0,
            scale_lag_s: 5400.0,
            reference_c: 20.0,
            origin_mm: 0.0,
            pitch_um_per_m: 0.0,
            pitch: CubicSpline::default(),
            periodic_um: 0.0,
            periodic_mm: 10.0,
            periodic_phase_deg: 0.0,
            periodic_second_um: 0.0,
            backlash_um: 0.0,
            backlash_um_per_m: 0.0,
            pre_sliding_mm: 0.0,
            gap: false,
        }
    }
}

impl AxisConfig {
    /// The first rule that is broken.
    pub(crate) fn check(&self) -> Result<(), RuleViolation> {
        if self.periodic_mm <= 0.0 {
            return Err(RuleViolation::new(
                "periodic_mm",
                format!("must be above 0, not {}", self.periodic_mm),
            ));
        }
        if self.gap && (self.backlash_um < 0.0 || self.backlash_um_per_m != 0.0) {
            let rule = "takes a backlash_um of at least 0, the same everywhere".to_string();
            return Err(RuleViolation::new("gap", rule));
        }
        RuleViolation::require_non_negative(
            &keys!(self: screw_heating_c, screw_lag_s, scale_lag_s, pre_sliding_mm),
        )
    }
}

/// The error of one axis along another.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(rename = "Straightness", deny_unknown_fields)]
pub struct StraightnessConfig {
    /// The axis that is in error.
    pub error: AxisName,
    /// The axis that moves.
    pub along: AxisName,
    /// The error in µm over the position in mm, smooth between the points.
    #[serde(default)]
    pub points: CubicSpline,
    /// The slope in µm/m: the squareness of the two.
    #[serde(default)]
    pub um_per_m: f64,
}

/// An angle along one axis that shows at the end of an arm.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Abbe {
    /// The axis that is in error.
    pub error: AxisName,
    /// The axis that moves.
    pub along: AxisName,
    /// The axis whose position is the arm.
    pub arm: AxisName,
    /// Where on it the arm is 0, in mm.
    #[serde(default)]
    pub arm_zero_mm: f64,
    /// The angle in µm/m (microradians) over the position in mm, smooth between the points.
    pub points: CubicSpline,
}

/// All axes of a scenario.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AxesConfig {
    /// The axes by their names.
    pub axes: BTreeMap<AxisName, AxisConfig>,
    /// Errors of one axis along another.
    pub straightness: Vec<StraightnessConfig>,
    /// Angles and arms.
    pub abbe: Vec<Abbe>,
}

/// The state of one axis.
#[derive(Clone, Debug)]
struct AxisState {
    position_mm: f64,
    /// +1 or −1.
    direction: f64,
    screw_c: f64,
    scale_c: f64,
    lost_um: f64,
}

/// The axes on their way through a run.
#[derive(Clone, Debug)]
pub struct SimulatedAxes {
    config: AxesConfig,
    states: [AxisState; 3],
}

impl SimulatedAxes {
    /// Everything at `start_c`; the axes at `start_mm`, having come from below.
    #[must_use]
    pub fn new(config: &AxesConfig, start_mm: [f64; 3], start_c: f64) -> Self {
        let states = start_mm.map(|position_mm| AxisState {
            position_mm,
            direction: 1.0,
            screw_c: start_c,
            scale_c: start_c,
            lost_um: 0.0,
        });
        Self { config: config.clone(), states }
    }

    /// Moves to `position_mm` over `dt_s` (above 0) in air of `ambient_c`.
    pub fn step(&mut self, dt_s: f64, position_mm: [f64; 3], ambient_c: f64) {
        for (axis, state) in self.states.iter_mut().enumerate() {
            let way_mm = position_mm[axis] - state.position_mm;
            state.position_mm = position_mm[axis];
            if way_mm != 0.0 {
                state.direction = way_mm.signum();
            }
            let Some(config) = self.config.axes.get(&ALL_AXES[axis]) else { continue };
            let m_per_min = way_mm.abs() * 0.06 / dt_s;
            let heated_c = ambient_c + config.screw_heating_c * m_per_min;
            relax_exponentially(&mut state.screw_c, heated_c, dt_s, config.screw_lag_s);
            relax_exponentially(&mut state.scale_c, ambient_c, dt_s, config.scale_lag_s);
            let width_um = config.backlash_um
                + config.backlash_um_per_m * (state.position_mm - config.origin_mm) / 1000.0;
            let settled_um = if state.direction < 0.0 { width_um } else { 0.0 };
            if config.gap {
                state.lost_um = (state.lost_um - way_mm * 1000.0).clamp(0.0, config.backlash_um);
            } else if way_mm != 0.0 {
                relax_exponentially(
                    &mut state.lost_um,
                    settled_um,
                    way_mm.abs(),
                    config.pre_sliding_mm,
                );
            }
        }
    }

    /// The directions of the last moves, +1 or −1.
    #[must_use]
    pub fn directions(&self) -> [f64; 3] {
        self.states.each_ref().map(|state| state.direction)
    }

    /// Where the axes stand, in mm.
    #[must_use]
    pub fn position_mm(&self) -> [f64; 3] {
        self.states.each_ref().map(|state| state.position_mm)
    }

    /// Returns the temperature of a screw, in °C.
    #[must_use]
    pub(crate) fn screw_temperature_c(&self, axis: AxisName) -> f64 {
        self.states[axis.index()].screw_c
    }

    /// Returns the temperature of a scale, in °C.
    #[must_use]
    pub(crate) fn scale_temperature_c(&self, axis: AxisName) -> f64 {
        self.states[axis.index()].scale_c
    }

    /// Returns the current error of X, Y and Z, in µm, without the tool's.
    #[must_use]
    pub fn error_um(&self) -> [f64; 3] {
        let mut error_um = [0.0; 3];
        for (axis, error_um) in error_um.iter_mut().enumerate() {
            if let Some(config) = self.config.axes.get(&ALL_AXES[axis]) {
                *error_um += self.states[axis].positioning_error_um(config);
            }
        }
        let at_mm = self.position_mm();
        for curve in &self.config.straightness {
            let along_mm = at_mm[curve.along.index()];
            error_um[curve.error.index()] +=
                curve.points.evaluate(along_mm) + curve.um_per_m * along_mm / 1000.0;
        }
        for abbe in &self.config.abbe {
            let arm_m = (at_mm[abbe.arm.index()] - abbe.arm_zero_mm) / 1000.0;
            error_um[abbe.error.index()] += abbe.points.evaluate(at_mm[abbe.along.index()]) * arm_m;
        }
        error_um
    }
}

const ALL_AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

impl AxisState {
    /// Returns the error of this axis along itself.
    fn positioning_error_um(&self, config: &AxisConfig) -> f64 {
        let at_mm = self.position_mm;
        let from_origin_m = (at_mm - config.origin_mm) / 1000.0;
        let (expansion, temperature_c, lost_um) = match config.feedback {
            Feedback::Screw => (config.screw_um_per_m_per_c, self.screw_c, self.lost_um),
            Feedback::Scale => (config.scale_um_per_m_per_c, self.scale_c, 0.0),
        };
        let turns = at_mm / config.periodic_mm;
        let angle = std::f64::consts::TAU * turns + config.periodic_phase_deg.to_radians();
        expansion * (temperature_c - config.reference_c) * from_origin_m
            + config.pitch_um_per_m * from_origin_m
            + config.pitch.evaluate(at_mm)
            + config.periodic_um * angle.sin()
            + config.periodic_second_um * (2.0 * angle).sin()
            + lost_um
    }
}

/// `value` on its way to `settled`, of which e^(−step/constant) is left; both in s, or both in mm.
fn relax_exponentially(value: &mut f64, settled: f64, step: f64, constant: f64) {
    let left = if constant > 0.0 { (-step / constant).exp() } else { 0.0 };
    *value = settled + (*value - settled) * left;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_is_crossed_before_the_table_follows() {
        let z = AxisConfig { backlash_um: 9.0, gap: true, ..AxisConfig::default() };
        let config = AxesConfig { axes: [(AxisName::Z, z)].into(), ..AxesConfig::default() };
        let mut axes = SimulatedAxes::new(&config, [0.0; 3], 20.0);
        let mut at = |um: f64| {
            axes.step(1.0, [0.0, 0.0, um / 1000.0], 20.0);
            (axes.error_um()[2] * 1e6).round() / 1e6
        };
        // The screw goes up 50 µm, comes back 4, shakes there, comes back further, goes up again.
        assert_eq!([at(50.0), at(46.0), at(46.5), at(46.0)], [0.0, 4.0, 3.5, 4.0]);
        assert_eq!([at(40.0), at(43.0), at(60.0)], [9.0, 6.0, 0.0]);
    }
}
