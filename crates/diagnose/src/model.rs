//! The model and its terms in columns: what `trueup predict` does row by row, fast enough to be tried
//! thousands of times.
//!
//! Each cause is a [`Kind`] with values: first those that enter nonlinearly (a time constant, a
//! period, a limit), then amplitudes, all of which are 0 where there is no effect. The order is
//! fixed: constants of the model, then gain, curvature and saturation of the source, then what is
//! added, then the shift in time. `trueup predict` gives the same figures from the terms in
//! `extended.toml` (tested).

use trueup_machine::{
    machine_file::{LinearAxis, Quantity, Thermal},
    model::shifted,
};

use crate::{
    columns::basis,
    data::Data,
    laws::{axis, elongation},
};

/// A cause with what is fixed about it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Kind {
    SensorOffset,
    SensorGain,
    SensorCurvature,
    SensorSaturation,
    SensorTemperatureDrift {
        column: String,
    },
    TimeShift,
    ThermalLag,
    /// In time.
    SlowMode,
    /// Of a column in use.
    SlowModeOf {
        column: String,
    },
    ExtraHeatPath {
        column: String,
        has_lag: bool,
    },
    GrowthAmplitude,
    GrowthRate,
    CoolingAsymmetry,
    ExpansionSlope,
    ReferenceTemperature,
    CentrifugalGrowth,
    CuttingLoad,
    PitchScale,
    PitchError {
        start_mm: f64,
        step_mm: f64,
        points: usize,
        both_ways: bool,
    },
    PitchPeriodic {
        harmonics: Vec<u32>,
    },
    Backlash,
    PositionDependentBacklash,
    Straightness {
        along: LinearAxis,
        knots_mm: Vec<f64>,
    },
    CrossAxis {
        axis: LinearAxis,
    },
    Step,
    Drift,
    /// Waves of C/(P + P₀), P the reading: a column of it, or else the position; of an elongation,
    /// waves of the reading itself, which is about what is predicted.
    ReferenceInstrument {
        is_angled: bool,
        reading: Option<String>,
    },
    /// A test of structure and no cause: a curve over a column.
    Curve {
        column: String,
        knots: Vec<f64>,
        by_direction: bool,
        /// The curve grows with this column.
        times: Option<String>,
    },
}

/// A cause and its values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    pub kind: Kind,
    pub values: Vec<f64>,
}

/// Terms and a constant, on top of what the machine file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Model {
    pub parts: Vec<Part>,
    /// The zero of the measurement, where it is arbitrary.
    pub constant_um: Option<f64>,
}

/// How a value is varied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    Linear,
    Logarithmic,
}

impl Kind {
    /// The name of the cause.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::SensorOffset => "sensor-offset",
            Self::SensorGain => "sensor-gain",
            Self::SensorCurvature => "sensor-curvature",
            Self::SensorSaturation => "sensor-saturation",
            Self::SensorTemperatureDrift { .. } => "sensor-temperature-drift",
            Self::TimeShift => "time-shift",
            Self::ThermalLag => "thermal-lag",
            Self::SlowMode | Self::SlowModeOf { .. } => "slow-mode",
            Self::ExtraHeatPath { .. } => "extra-heat-path",
            Self::GrowthAmplitude => "growth-amplitude",
            Self::GrowthRate => "growth-rate",
            Self::CoolingAsymmetry => "cooling-asymmetry",
            Self::ExpansionSlope => "expansion-slope",
            Self::ReferenceTemperature => "reference-temperature",
            Self::CentrifugalGrowth => "centrifugal-growth",
            Self::CuttingLoad => "cutting-load",
            Self::PitchScale => "pitch-scale",
            Self::PitchError { .. } => "pitch-error",
            Self::PitchPeriodic { .. } => "pitch-periodic",
            Self::Backlash => "backlash",
            Self::PositionDependentBacklash => "position-dependent-backlash",
            Self::Straightness { .. } => "straightness",
            Self::CrossAxis { .. } => "cross-axis",
            Self::Step => "step",
            Self::Drift => "drift",
            Self::ReferenceInstrument { .. } => "reference-instrument",
            Self::Curve { .. } => "structure",
        }
    }

    /// The column that the cause hangs on, where there is a choice.
    pub(crate) fn column(&self) -> Option<String> {
        match self {
            Self::SensorTemperatureDrift { column }
            | Self::SlowModeOf { column }
            | Self::ExtraHeatPath { column, .. }
            | Self::Curve { column, .. } => Some(column.clone()),
            Self::CentrifugalGrowth => Some("spindle_rpm".into()),
            Self::CuttingLoad => Some("load_n".into()),
            Self::CrossAxis { axis } | Self::Straightness { along: axis, .. } => {
                Some(format!("{}_mm", axis.name()))
            }
            _ => None,
        }
    }

    /// Whether a board may correct it: not what only happened once, nor what is not the machine's.
    pub(crate) fn is_compensated(&self) -> bool {
        !matches!(
            self,
            Self::Drift | Self::Step | Self::TimeShift | Self::ReferenceInstrument { .. }
        )
    }

    /// Its nonlinear values.
    pub(crate) fn nonlinear(&self) -> &'static [Scale] {
        use Scale::{Linear, Logarithmic};
        match self {
            Self::SensorSaturation | Self::TimeShift | Self::Step => &[Linear],
            Self::ThermalLag
            | Self::SlowMode
            | Self::SlowModeOf { .. }
            | Self::ExtraHeatPath { has_lag: true, .. }
            | Self::GrowthRate
            | Self::CoolingAsymmetry
            | Self::PitchPeriodic { .. }
            | Self::ReferenceInstrument { is_angled: false, .. } => &[Logarithmic],
            Self::ReferenceInstrument { is_angled: true, .. } => &[Logarithmic, Linear],
            _ => &[],
        }
    }

    /// Whether its first value is a time constant.
    pub(crate) fn has_time_constant(&self) -> bool {
        matches!(
            self,
            Self::ThermalLag
                | Self::SlowMode
                | Self::SlowModeOf { .. }
                | Self::ExtraHeatPath { has_lag: true, .. }
                | Self::GrowthRate
                | Self::CoolingAsymmetry
        )
    }

    /// How many amplitudes it has.
    pub(crate) fn amplitudes(&self) -> usize {
        match self {
            Self::SensorSaturation
            | Self::TimeShift
            | Self::ThermalLag
            | Self::GrowthRate
            | Self::CoolingAsymmetry => 0,
            Self::PitchError { points, both_ways, .. } => {
                if *both_ways {
                    2 * points
                } else {
                    *points
                }
            }
            Self::PitchPeriodic { harmonics } => 2 * harmonics.len(),
            Self::ReferenceInstrument { .. } => 2,
            Self::Straightness { knots_mm, .. } => knots_mm.len() - 4,
            Self::Curve { knots, by_direction, .. } => {
                if *by_direction {
                    2 * knots.len()
                } else {
                    knots.len()
                }
            }
            _ => 1,
        }
    }

    /// How many neighbours are in each of the lists that its values are, if they are.
    pub(crate) fn list_length(&self) -> Option<usize> {
        match self {
            Self::PitchError { points, .. } => Some(*points),
            Self::Curve { knots, .. } => Some(knots.len()),
            Self::Straightness { .. } => Some(self.amplitudes()),
            _ => None,
        }
    }

    /// What it counts for where simplicity counts.
    pub(crate) fn degrees(&self) -> usize {
        self.nonlinear().len() + self.amplitudes()
    }

    /// 0: a constant of the machine's own model, or of the axis's; 1: something else that was
    /// recorded; 2: time alone, or the instrument; 3: no cause.
    pub(crate) fn tier(&self) -> u8 {
        match self {
            Self::SlowMode
            | Self::SlowModeOf { .. }
            | Self::ExtraHeatPath { .. }
            | Self::CoolingAsymmetry
            | Self::CentrifugalGrowth
            | Self::CuttingLoad
            | Self::Straightness { .. }
            | Self::CrossAxis { .. } => 1,
            Self::TimeShift | Self::Step | Self::Drift | Self::ReferenceInstrument { .. } => 2,
            Self::Curve { .. } => 3,
            _ => 0,
        }
    }

    /// Whether its reference (a temperature, a start) is its own, and with it a constant.
    pub(crate) fn has_reference(&self) -> bool {
        matches!(
            self,
            Self::SensorTemperatureDrift { .. }
                | Self::SlowMode
                | Self::SlowModeOf { .. }
                | Self::ExtraHeatPath { .. }
        )
    }

    /// Whether it may change the constants of the machine's own model, or the source's law.
    fn replaces(&self) -> bool {
        matches!(
            self,
            Self::ThermalLag
                | Self::GrowthRate
                | Self::CoolingAsymmetry
                | Self::ExpansionSlope
                | Self::ReferenceTemperature
        )
    }

    /// Where in the fixed order it comes.
    pub(crate) fn rank(&self) -> u8 {
        match self {
            _ if self.replaces() => 0,
            Self::SensorGain | Self::GrowthAmplitude => 1,
            Self::SensorCurvature => 2,
            Self::SensorSaturation => 3,
            Self::TimeShift => 5,
            _ => 4,
        }
    }

    /// Whether it only adds its columns, whatever the rest of the model is.
    pub(crate) fn is_added(&self) -> bool {
        self.rank() == 4
    }

    /// Whether it changes the elongation, which then goes along the tool; else the axis.
    pub(crate) fn is_of_elongation(&self, data: &Data) -> bool {
        if data.quantity == Quantity::Elongation {
            return true;
        }
        let axis_is_thermal = own_thermal(data).is_some();
        match self {
            Self::SensorOffset
            | Self::SensorGain
            | Self::SensorCurvature
            | Self::SensorSaturation
            | Self::SensorTemperatureDrift { .. }
            | Self::GrowthAmplitude
            | Self::GrowthRate
            | Self::CentrifugalGrowth
            | Self::CuttingLoad => true,
            Self::ThermalLag | Self::CoolingAsymmetry => !axis_is_thermal,
            Self::SlowMode | Self::SlowModeOf { .. } | Self::ExtraHeatPath { .. } => {
                data.has_elongation && data.along.iter().any(|along| *along != 0.0)
            }
            _ => false,
        }
    }
}

/// The thermal section of the quantity's own axis.
pub(crate) fn own_thermal(data: &Data) -> Option<&Thermal> {
    data.quantity.axis().and_then(|axis| data.machine.axes[axis.index()].thermal.as_ref())
}

/// Constants of the machine's model that are not as believed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Changed {
    pub lag_s: Option<f64>,
    pub fall_s: Option<f64>,
    pub rate_s: Option<f64>,
    pub slope: f64,
    pub shift_c: f64,
}

impl Model {
    /// The parts in their fixed order.
    pub(crate) fn sort(&mut self) {
        self.parts.sort_by_key(|part| part.kind.rank());
    }

    pub(crate) fn has(&self, kind: &Kind) -> bool {
        self.parts.iter().any(|part| part.kind == *kind)
    }

    fn changed(&self) -> Changed {
        let mut changed = Changed::default();
        for Part { kind, values } in &self.parts {
            match kind {
                Kind::ThermalLag => changed.lag_s = Some(values[0]),
                Kind::GrowthRate => changed.rate_s = Some(values[0]),
                Kind::CoolingAsymmetry => changed.fall_s = Some(values[0]),
                Kind::ExpansionSlope => changed.slope += values[0],
                Kind::ReferenceTemperature => changed.shift_c += values[0],
                _ => {}
            }
        }
        changed
    }

    /// The prediction of each row.
    pub(crate) fn predict(&self, data: &Data) -> Vec<f64> {
        match self.shift_s() {
            Some(shift_s) => shifted_rows(data, &self.unshifted(data.whole()), shift_s),
            None => self.unshifted(data),
        }
    }

    /// By how much all of it is late.
    pub(crate) fn shift_s(&self) -> Option<f64> {
        let part = self.parts.iter().find(|part| part.kind == Kind::TimeShift)?;
        Some(part.values[0])
    }

    /// The prediction of each row, as if nothing were late.
    pub(crate) fn unshifted(&self, data: &Data) -> Vec<f64> {
        let changed = self.changed();
        let mut elongation = elongation(data, changed);
        let mut axis = axis(data, changed);
        for part in &self.parts {
            let is_of_elongation = part.kind.is_of_elongation(data);
            let p = if is_of_elongation { &mut elongation } else { &mut axis };
            match part.kind {
                Kind::TimeShift => {}
                Kind::SensorSaturation => {
                    let limit = part.values[0];
                    p.iter_mut().for_each(|p| {
                        if *p > limit {
                            *p = limit;
                        }
                    });
                }
                _ if part.kind.replaces() => {}
                _ => {
                    let start = part.kind.nonlinear().len();
                    let columns = basis(&part.kind, &part.values[..start], data, p);
                    for (column, amplitude) in columns.iter().zip(&part.values[start..]) {
                        if *amplitude != 0.0 {
                            p.iter_mut().zip(column).for_each(|(p, c)| *p += amplitude * c);
                        }
                    }
                }
            }
        }
        let constant = self.constant_um.unwrap_or(0.0);
        elongation
            .iter()
            .zip(&data.along)
            .zip(&axis)
            .map(|((e, along), a)| if *along == 0.0 { *a } else { e * along + a } + constant)
            .collect()
    }
}

/// The rows of `data` of a prediction for the whole that they were drawn from, `shift_s` late: what is
/// predicted at another time may be of a row that was not drawn.
pub(crate) fn shifted_rows(data: &Data, whole_um: &[f64], shift_s: f64) -> Vec<f64> {
    let whole = data.whole();
    let shifted = match &whole.time_s {
        Some(time_s) => shifted_all(whole, time_s, whole_um, shift_s),
        None => whole_um.to_vec(),
    };
    match &data.whole {
        Some(drawn) => drawn.pick(&shifted),
        None => shifted,
    }
}

fn shifted_all(data: &Data, time_s: &[f64], sum: &[f64], shift_s: f64) -> Vec<f64> {
    // Files may overlap in time without running back; each is shifted for itself.
    let mut out = Vec::with_capacity(sum.len());
    let mut start = 0;
    for file in 0..data.files {
        let end = data.file.partition_point(|&there| there <= file);
        out.extend(shifted(&time_s[start..end], &sum[start..end], shift_s));
        start = end;
    }
    out
}
