//! From fitted parts to the terms of a machine file.

use trueup_machine::{
    effect::{self, Effect, Heat, Wave},
    machine_file::{BSpline, Pitch, Quantity, Term},
};

use crate::{
    data::Data,
    model::{Kind, Model, Part, own_thermal},
};

/// The terms of `model`, in the order in which they are to be applied. Where the zero of the
/// measurement goes: into the reference temperature of the first term that has one, else to the
/// last term.
pub(crate) fn terms(data: &Data, model: &Model) -> Vec<Term> {
    let mut terms: Vec<Term> = model
        .parts
        .iter()
        .filter_map(|part| {
            let is_of_elongation = part.kind.is_of_elongation(data);
            let quantity = if is_of_elongation { Quantity::Elongation } else { data.quantity };
            Some(Term { quantity, constant_um: 0.0, effect: effect(data, part)? })
        })
        .collect();
    let Some(mut constant_um) = model.constant_um.filter(|constant| *constant != 0.0) else {
        return terms;
    };
    let along = |quantity: Quantity| {
        if quantity == data.quantity {
            return 1.0;
        }
        // The tool stands still where this is asked: its direction is that of any row.
        data.along.iter().copied().find(|along| *along != 0.0).unwrap_or(1.0)
    };
    for term in &mut terms {
        let factor = along(term.quantity);
        if let Some(heat) = term.effect.heat_mut() {
            let shift_c = constant_um / (heat.um_per_c * factor);
            if shift_c.abs() < 1000.0 {
                heat.reference_c -= shift_c;
                constant_um = 0.0;
                break;
            }
        }
    }
    let own = terms.iter().rposition(|term| term.quantity == data.quantity);
    let last = own.or_else(|| terms.len().checked_sub(1));
    if let (Some(last), true) = (last, constant_um != 0.0) {
        let term = &mut terms[last];
        term.constant_um = constant_um / along(term.quantity);
    }
    terms
}

fn effect(data: &Data, part: &Part) -> Option<Effect> {
    let value = |index: usize| part.values.get(index).copied().unwrap_or(0.0);
    Some(match &part.kind {
        Kind::SensorOffset => Effect::SensorOffset(effect::SensorOffset { offset_um: value(0) }),
        Kind::SensorGain => Effect::SensorGain(effect::SensorGain { gain: 1.0 + value(0) }),
        Kind::SensorCurvature => {
            Effect::SensorCurvature(effect::SensorCurvature { per_um: value(0) })
        }
        Kind::SensorSaturation => {
            Effect::SensorSaturation(effect::SensorSaturation { limit_um: value(0) })
        }
        Kind::SensorTemperatureDrift { column } => {
            Effect::SensorTemperatureDrift(effect::SensorTemperatureDrift(Heat {
                column: column.clone(),
                um_per_c: value(0),
                time_constant_s: 0.0,
                reference_c: data.reference_c(column),
            }))
        }
        Kind::TimeShift => Effect::TimeShift(effect::TimeShift { shift_s: value(0) }),
        Kind::ThermalLag => Effect::ThermalLag(effect::ThermalLag { time_constant_s: value(0) }),
        Kind::SlowMode => Effect::SlowMode(effect::SlowMode::InTime {
            amplitude_um: value(1),
            time_constant_s: value(0),
            start_s: data.start_s,
        }),
        Kind::SlowModeOf { column } => Effect::SlowMode(effect::SlowMode::OfColumn(Heat {
            column: column.clone(),
            um_per_c: value(1),
            time_constant_s: value(0),
            reference_c: data.reference_c(column),
        })),
        Kind::ExtraHeatPath { column, has_lag } => {
            Effect::ExtraHeatPath(effect::ExtraHeatPath(Heat {
                column: column.clone(),
                um_per_c: value(usize::from(*has_lag)),
                time_constant_s: if *has_lag { value(0) } else { 0.0 },
                reference_c: data.reference_c(column),
            }))
        }
        Kind::GrowthAmplitude => {
            Effect::GrowthAmplitude(effect::GrowthAmplitude { scale: 1.0 + value(0) })
        }
        Kind::GrowthRate => Effect::GrowthRate(effect::GrowthRate { time_constant_s: value(0) }),
        Kind::CoolingAsymmetry => {
            Effect::CoolingAsymmetry(effect::CoolingAsymmetry { time_constant_s: value(0) })
        }
        Kind::ExpansionSlope => {
            let believed = own_thermal(data).map_or(0.0, |it| it.slope_um_per_m_per_c);
            Effect::ExpansionSlope(effect::ExpansionSlope { um_per_m_per_c: believed + value(0) })
        }
        Kind::ReferenceTemperature => {
            Effect::ReferenceTemperature(effect::ReferenceTemperature { shift_c: value(0) })
        }
        Kind::CentrifugalGrowth => {
            Effect::CentrifugalGrowth(effect::CentrifugalGrowth { um_per_krpm2: value(0) })
        }
        Kind::CuttingLoad => Effect::CuttingLoad(effect::CuttingLoad { um_per_n: value(0) }),
        Kind::PitchScale => Effect::PitchScale(effect::PitchScale { um_per_m: value(0) }),
        Kind::PitchError { start_mm, step_mm, points, both_ways } => {
            Effect::PitchError(effect::PitchError(Pitch {
                start_mm: *start_mm,
                step_mm: *step_mm,
                forward_um: part.values[..*points].to_vec(),
                reverse_um: both_ways.then(|| part.values[*points..].to_vec()),
            }))
        }
        Kind::PitchPeriodic { harmonics } => Effect::PitchPeriodic(effect::PitchPeriodic {
            period_mm: value(0),
            waves: waves(harmonics, &part.values[1..]),
        }),
        Kind::Backlash => Effect::Backlash(effect::Backlash { width_um: value(0) }),
        Kind::PositionDependentBacklash => {
            Effect::PositionDependentBacklash(effect::PositionDependentBacklash {
                um_per_m: value(0),
            })
        }
        Kind::Straightness { along, knots_mm } => Effect::Straightness(effect::Straightness {
            along: *along,
            spline: BSpline {
                order: 4,
                knots_mm: knots_mm.clone(),
                control_um: part.values.clone(),
            },
        }),
        Kind::CrossAxis { axis } => {
            Effect::CrossAxis(effect::CrossAxis { axis: *axis, um_per_m: value(0) })
        }
        Kind::Step => Effect::Step(effect::Step { at_s: value(0), size_um: value(1) }),
        Kind::Drift => Effect::Drift(effect::Drift { um_per_h: value(0) }),
        Kind::ReferenceInstrument { is_angled, reading } => {
            // A reading is not known when it is predicted, but for that of the position.
            let is_known = data.quantity != Quantity::Elongation && reading.is_none();
            let start = part.kind.nonlinear().len();
            Effect::ReferenceInstrument(effect::ReferenceInstrument {
                description: instrument(*is_angled, part),
                period_mm: value(0),
                origin_mm: (*is_angled && is_known).then(|| value(1)),
                read: effect::Read::Position,
                waves: if is_known { waves(&[1], &part.values[start..]) } else { Vec::new() },
            })
        }
        Kind::Curve { .. } => return None,
    })
}

/// What is wrong with the instrument, for people.
pub(crate) fn instrument(is_angled: bool, part: &Part) -> String {
    let start = part.kind.nonlinear().len();
    let amplitude = part.values[start].hypot(part.values[start + 1]);
    if is_angled {
        format!(
            "the reference instrument's own error: a wave of {amplitude:.1} µm whose period changes \
             with the distance, as that of an instrument that looks at an angle"
        )
    } else {
        format!(
            "the reference instrument's own error: a wave of {amplitude:.2} µm that repeats every \
             {:.3} µm of its reading",
            part.values[0]
        )
    }
}

/// a·sin + b·cos as an amplitude and a phase.
fn waves(harmonics: &[u32], amplitudes: &[f64]) -> Vec<Wave> {
    harmonics
        .iter()
        .zip(amplitudes.chunks(2))
        .map(|(&harmonic, pair)| Wave {
            harmonic,
            amplitude_um: pair[0].hypot(pair[1]),
            phase_deg: pair[1].atan2(pair[0]).to_degrees(),
        })
        .collect()
}
