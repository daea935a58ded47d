//! The columns of a circle's causes, in closed form: the table on top of [`super`].

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::record::{CircleReading, CircleRecord};

/// Half widths of a Gaussian: √(2·ln 2).
const GAUSSIAN_HWHM_PER_STD: f64 = 1.177_410_022_515_474_6;

/// The width of x·e^(1 − x) at half its height.
const SURGE_FWHM: f64 = 2.446_385;

/// Sine or cosine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WavePhase {
    /// The cosine.
    Cosine,
    /// The sine.
    Sine,
}

/// The parameter of the circle that drifts with the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriftingParameter {
    /// The radius.
    Radius,
    /// The centre along the first axis.
    CentreU,
    /// The centre along the second axis.
    CentreV,
}

impl DriftingParameter {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Radius, Self::CentreU, Self::CentreV];
}

/// The shape of a reversal spike over the angle since the reversal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpikeShape {
    /// A jump that decays exponentially.
    Exponential,
    /// A jump that decays along a line.
    LinearDecay,
    /// Half a period of a sine behind the reversal.
    HalfSine,
    /// x·e^(1 − x): it rises and decays behind the reversal.
    Surge,
    /// A Gaussian around the reversal.
    Gauss,
}

impl SpikeShape {
    /// All shapes.
    pub const ALL: [Self; 5] =
        [Self::Exponential, Self::LinearDecay, Self::HalfSine, Self::Surge, Self::Gauss];

    /// Returns its value `since` the reversal, an angle in −π…π, for a width at half its height; its peak is 1.
    #[must_use]
    pub fn evaluate(self, since: f64, width: f64) -> f64 {
        match self {
            Self::Gauss => (-0.5 * (since / width * 2.0 * GAUSSIAN_HWHM_PER_STD).powi(2)).exp(),
            _ if since < 0.0 => 0.0,
            Self::Exponential => (-since / width * std::f64::consts::LN_2).exp(),
            Self::LinearDecay => (1.0 - since / (2.0 * width)).max(0.0),
            Self::Surge => {
                let scaled = since / width * SURGE_FWHM;
                scaled * (1.0 - scaled).exp()
            }
            Self::HalfSine if since < 1.5 * width => (PI * since / (1.5 * width)).sin(),
            Self::HalfSine => 0.0,
        }
    }
}

/// A column. An axis is 0, the first of the plane, or 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CircleTerm {
    /// The radius of a set-up.
    Radius(usize),
    /// The centre of a set-up along an axis.
    Centre(usize, usize),
    /// sin 2φ.
    Squareness,
    /// cos 2φ.
    Scale,
    /// The step of an axis at its reversals; the coefficient is B.
    Backlash(usize),
    /// The step of the other axis at the reversals of this one.
    Lateral(usize),
    /// s·sin 2φ.
    Servo,
    /// A harmonic from 3 on: a straightness.
    Form(u8, WavePhase),
    /// Growth with time, from 0 at the middle of the record; the coefficient is what the whole record has.
    Drift(DriftingParameter),
    /// A peak at one place of an axis in one direction.
    Spike {
        /// The axis that reverses.
        axis: usize,
        /// True at its positive end.
        is_positive: bool,
        /// +1 or −1.
        sense: f64,
        /// Its shape.
        shape: SpikeShape,
        /// Its width at half its height, in rad.
        width: f64,
    },
    /// A part of an error that is periodic in the position.
    Cyclic {
        /// The axis.
        axis: usize,
        /// Its period.
        period_mm: f64,
        /// Its part.
        wave: WavePhase,
    },
}

impl CircleTerm {
    /// Returns the value of its column in a row.
    #[must_use]
    pub fn evaluate(self, row: &CircleReading, record: &CircleRecord) -> f64 {
        let (sin, cos) = row.angle.sin_cos();
        let along = |axis: usize| if axis == 0 { cos } else { sin };
        match self {
            Self::Radius(setup) => f64::from(row.setup == setup),
            Self::Centre(setup, axis) => f64::from(row.setup == setup) * along(axis),
            Self::Squareness => 2.0 * sin * cos,
            Self::Scale => cos * cos - sin * sin,
            Self::Backlash(axis) => 0.5 * backlash_sign(axis, row) * along(axis),
            Self::Lateral(axis) => 0.5 * backlash_sign(axis, row) * along(1 - axis),
            Self::Servo => row.sense * 2.0 * sin * cos,
            Self::Form(number, wave) => {
                let (sin, cos) = (f64::from(number) * row.angle).sin_cos();
                if wave == WavePhase::Sine { sin } else { cos }
            }
            Self::Drift(of) => {
                record.centred_time_fraction(row)
                    * match of {
                        DriftingParameter::Radius => 1.0,
                        DriftingParameter::CentreU => cos,
                        DriftingParameter::CentreV => sin,
                    }
            }
            Self::Spike { axis, is_positive, sense, shape, width } => {
                if sense * row.sense < 0.0 {
                    return 0.0;
                }
                shape.evaluate(angle_since_reversal_rad(row, axis, is_positive), width)
            }
            Self::Cyclic { axis, period_mm, wave } => {
                let (sin, cos) = (TAU * row.at_mm[axis] / period_mm).sin_cos();
                along(axis) * if wave == WavePhase::Sine { sin } else { cos }
            }
        }
    }

    /// Returns its column.
    #[must_use]
    pub(crate) fn basis_column(self, record: &CircleRecord) -> Vec<f64> {
        record.rows.iter().map(|row| self.evaluate(row, record)).collect()
    }
}

/// Returns +1 where the axis moves in the negative direction, else −1.
fn backlash_sign(axis: usize, row: &CircleReading) -> f64 {
    let (sin, cos) = row.angle.sin_cos();
    let velocity = if axis == 0 { -sin } else { cos } * row.sense;
    if velocity < 0.0 { 1.0 } else { -1.0 }
}

/// Returns the angle that was travelled since a reversal of `axis`, negative ahead of it, in −π…π.
#[must_use]
pub(crate) fn angle_since_reversal_rad(row: &CircleReading, axis: usize, is_positive: bool) -> f64 {
    let end = if is_positive { 0.0 } else { PI };
    let turned = row.sense * (row.angle - end - FRAC_PI_2 * axis as f64);
    turned - TAU * (turned / TAU).round()
}

/// Returns the travel of `axis` behind its last reversal, in mm, at the row before: 0 within `step` of a reversal, in rad.
#[must_use]
pub(crate) fn travel_since_reversal_mm(
    row: &CircleReading,
    axis: usize,
    radius_mm: f64,
    step: f64,
) -> f64 {
    let since = [true, false].map(|end| angle_since_reversal_rad(row, axis, end)).into_iter();
    let last = since.filter(|angle| *angle >= -step).fold(f64::INFINITY, f64::min);
    radius_mm * (1.0 - (last - step).max(0.0).cos())
}
