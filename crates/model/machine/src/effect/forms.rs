//! Parts of the forms that causes have on the board: an angle at a lever, heat behind a lag, a late
//! thermometer.

use trueup_core::term::SpeedPower;

use crate::file::{
    axis::LinearAxis,
    keys::term::{COLUMN, REFERENCE_C, TIME_CONSTANT_S, UM_PER_C},
    straightness::BSpline,
    table::table,
};

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
    pub angle: Angle,
}

/// An angle over the position of an axis, in µrad.
#[derive(Clone, Debug, PartialEq)]
pub enum Angle {
    /// c·P/1000, c in µrad/m.
    Line(f64),
    /// A spline, its control points in µrad: µm at a lever of a metre.
    Curve(BSpline),
}

table! {
    /// c·(lag_τ(T) − T_ref): what something adds that follows a temperature.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Heat {
        /// T: a column `temp_<name>_c`.
        column: String = COLUMN.of(Column).required();
        /// c, in µm/K.
        um_per_c: f64 = UM_PER_C.required();
        /// τ in s; 0: no lag.
        time_constant_s: f64 = TIME_CONSTANT_S.or("0.0");
        /// T_ref in °C.
        reference_c: f64 = REFERENCE_C.required();
    }
}

/// c·lag_τ((n/1000)^power): what something adds that the spindle's speed heats, cold at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedHeat {
    /// The power of n.
    pub power: SpeedPower,
    /// c, in µm at 1000 r/min.
    pub um_per_unit: f64,
    /// τ in s; 0: no lag.
    pub time_constant_s: f64,
}

/// Returns how hard a spindle of this speed heats: (n/1000)^power.
#[must_use]
pub fn heating(power: SpeedPower, rpm: f64) -> f64 {
    let krpm = rpm.abs() / 1000.0;
    match power {
        SpeedPower::First => krpm,
        SpeedPower::Second => krpm * krpm,
    }
}

/// How late a thermometer is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Late {
    /// By how much, in s; above 0: the time constant of its lag, or the delay.
    pub by_s: f64,
    /// In which way.
    pub form: LateForm,
}

/// In which way a thermometer is late.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LateForm {
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
pub enum Times {
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
