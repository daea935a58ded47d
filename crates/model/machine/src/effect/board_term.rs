//! The forms that causes have on the board, and their parts: an angle at a lever, heat behind a lag, a late
//! thermometer.

use trueup_core::term::SpeedExponent;

use crate::{
    keys::{
        table::table,
        term::{COLUMN, REFERENCE_C, TIME_CONSTANT_S, UM_PER_C},
    },
    sections::{AngleProfile, LinearAxis, PitchErrorTable, ThermalLaw},
    spline::BSpline,
};

/// The board's forms in the user's units: what a term is compiled to.
#[derive(Clone, Debug, PartialEq)]
pub enum BoardTerm {
    /// + µm.
    Offset(f64),
    /// g·p.
    Gain(f64),
    /// + c·p², c in 1/µm.
    Curvature(f64),
    /// At most this many µm.
    Saturation(f64),
    /// + c·(lag_τ(T) − T_ref).
    Heat(TemperatureResponse),
    /// + c·(lag_τ(T) − T_ref)·P/1000, P of the own axis, c in µm/(m·K).
    HeatSlope(TemperatureResponse),
    /// + c·lag_τ((n/1000)^power).
    SpeedHeat(SpeedHeatResponse),
    /// + a·(1 − e^(−(t − start)/τ)); 0 before the start.
    Time {
        /// a.
        amplitude_um: f64,
        /// τ, above 0.
        time_constant_s: f64,
        /// In the run's `time_s`; the board's own start where it runs.
        start_s: f64,
    },
    /// + c·(n/1000)², c in µm.
    Speed(f64),
    /// + c·load, c in µm/N.
    Load(f64),
    /// + c·P/1000, P of the own axis, c in µm/m.
    OwnPosition(f64),
    /// + c·P/1000, P of another axis.
    Position {
        /// Of P.
        axis: LinearAxis,
        /// c.
        um_per_m: f64,
    },
    /// + w + c·P/1000 after an approach in the negative direction, P of the own axis.
    Reversed {
        /// w.
        width_um: f64,
        /// c.
        um_per_m: f64,
    },
    /// A table of the own axis.
    Table(PitchErrorTable),
    /// A spline over an axis.
    Curve(LinearAxis, BSpline),
    /// The thermal law of the own axis, where it has none.
    Thermal(ThermalLaw),
    /// + θ(P)·(L − L₀)/1000.
    Tilt(Tilt),
    /// + a·sin(2π·h·P/L + φ), P of the own axis.
    Wave {
        /// L, above 0.
        period_mm: f64,
        /// h, at least 1.
        harmonic: u32,
        /// a.
        amplitude_um: f64,
        /// φ.
        phase_deg: f64,
    },
    /// + a·f, a by the number of the tool.
    Tool {
        /// The tools with their a, no number twice.
        tools: Vec<(u16, f64)>,
        /// a of every other tool.
        other: f64,
        /// f.
        times: Multiplier,
    },
    /// + a·f, a by a condition.
    Condition {
        /// The column of the condition.
        column: String,
        /// a while it does not hold.
        off: f64,
        /// a while it holds.
        on: f64,
        /// The time constant by which it acts, in s.
        lag_s: f64,
        /// f.
        times: Multiplier,
    },
}

/// θ(P)·(L − L₀)/1000: what an axis that tilts does at a lever.
#[derive(Clone, Debug, PartialEq)]
pub struct Tilt {
    /// Of P: the axis that tilts; `None`: the own one.
    pub along: Option<LinearAxis>,
    /// Of L: another axis.
    pub lever: LinearAxis,
    /// L₀ in mm.
    pub origin_mm: f64,
    /// θ.
    pub angle: AngleProfile,
}

table! {
    /// c·(lag_τ(T) − T_ref): what something adds that follows a temperature.
    #[derive(Clone, Debug, PartialEq)]
    pub struct TemperatureResponse {
        /// T: a column `temp_<name>_c`.
        column: String = COLUMN.with_value_type(Column).required();
        /// c, in µm/K.
        um_per_c: f64 = UM_PER_C.required();
        /// τ in s; 0: no lag.
        time_constant_s: f64 = TIME_CONSTANT_S.with_default("0.0");
        /// T_ref in °C.
        reference_c: f64 = REFERENCE_C.required();
    }
}

/// c·lag_τ((n/1000)^power): what something adds that the spindle's speed heats, cold at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedHeatResponse {
    /// The power of n.
    pub power: SpeedExponent,
    /// c, in µm at 1000 r/min.
    pub um_per_unit: f64,
    /// τ in s; 0: no lag.
    pub time_constant_s: f64,
}

/// Returns how hard a spindle of this speed heats: (n/1000)^power.
#[must_use]
pub fn relative_heat_input(power: SpeedExponent, rpm: f64) -> f64 {
    let krpm = rpm.abs() / 1000.0;
    match power {
        SpeedExponent::First => krpm,
        SpeedExponent::Second => krpm * krpm,
    }
}

/// How late a thermometer is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermometerDelay {
    /// By how much, in s; above 0: the time constant of its lag, or the delay.
    pub by_s: f64,
    /// In which way.
    pub form: DelayKind,
}

/// In which way a thermometer is late.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DelayKind {
    /// It shows what was.
    Delay,
    /// It follows by a first-order lag.
    Lag {
        /// Over which time the slope is taken that undoes it, as a share of the time constant, 0…1; at
        /// least from row to row.
        slope_over: f64,
    },
}

/// The factor that a dependence on a column is multiplied by: f.
#[derive(Clone, Debug, PartialEq)]
pub enum Multiplier {
    /// 1.
    One,
    /// (n/1000)², n the speed of the spindle in r/min.
    Speed2,
    /// The growth by the sensor's own law.
    Growth,
    /// P/1000, P the position of the own axis in mm.
    Position,
    /// y − y₀.
    Column {
        /// The second column.
        column: String,
        /// y₀, in its unit.
        reference: f64,
        /// Range of y₀ in a search; where it is one value, y₀ is fixed.
        range: [f64; 2],
    },
}
