//! Errors of the displacement sensor, and what speed and load add to the growth.

use super::{NeutralValue, ScalarCause, ScalarCauseDefinition, define_scalar_cause};
use crate::{
    effect::{
        cause_spec::{BoardTerm, LawInput, NonlinearParameter, PredictionStage, Target},
        data_view::{DataView, StartValues, peak_to_peak},
    },
    sections::ElongationSource,
};

const GAUGE_BLOCK_TEST: &str =
    "Move the sensor's target by known gauge blocks over its whole range, up and down.";

const ELONGATION_CAUSE_DEFAULTS: ScalarCause =
    ScalarCause { target: Target::Elongation, ..ScalarCause::DEFAULT };

/// Returns whether the sensor shows a growth.
fn has_sensor_elongation(survey: &dyn DataView) -> bool {
    survey.elongation_source() == Some(ElongationSource::Sensor)
        && peak_to_peak(survey.source_elongation_um()) > 0.0
}

define_scalar_cause! {
    /// A shift of what is predicted: p + o.
    SensorOffset {
        /// o, in µm.
        offset_um = OFFSET_UM
    }
}

impl ScalarCauseDefinition for SensorOffset {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "sensor-offset",
        law: Some(|_, _| 1.0),
        on_board: |um| vec![BoardTerm::Offset(um)],
        from_board: |own, form, constant_um| match form {
            BoardTerm::Offset(um) if own.is_none() => Some(um + std::mem::take(constant_um)),
            _ => None,
        },
        propose: |survey| {
            let is_free = survey.quantity().axis().is_none() && !survey.has_constant();
            is_free.then(|| (0.0, StartValues::linear_only()))
        },
        sentence: |um| format!("The zero of the sensor is off by {um:+.2} µm."),
        next_test: GAUGE_BLOCK_TEST,
        ..ELONGATION_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// A factor: g·p.
    SensorGain {
        /// g; 1: no change.
        gain = GAIN
    }
}

impl ScalarCauseDefinition for SensorGain {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "sensor-gain",
        stage: PredictionStage::Factor,
        neutral: NeutralValue::At(1.0),
        inputs: &[LawInput::Predicted],
        // A gain that turns the sign, or is off by more than a factor of five, is another machine's.
        amplitude_bounds: Some([-0.8, 4.0]),
        law: Some(|_, x| x[0]),
        on_board: |gain| vec![BoardTerm::Gain(gain)],
        from_board: |_, form, _| match *form {
            BoardTerm::Gain(gain) => Some(gain),
            _ => None,
        },
        propose: |survey| has_sensor_elongation(survey).then(|| (1.0, StartValues::linear_only())),
        sentence: |more| {
            let gain = 1.0 + more;
            format!("The tool moves {gain:.4} µm for each micrometre that the sensor shows.")
        },
        next_test: GAUGE_BLOCK_TEST,
        ..ELONGATION_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// A parabola: p + c·p².
    SensorCurvature {
        /// c, in 1/µm.
        per_um = PER_UM
    }
}

impl ScalarCauseDefinition for SensorCurvature {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "sensor-curvature",
        stage: PredictionStage::Bend,
        inputs: &[LawInput::Predicted],
        law: Some(|_, x| x[0] * x[0]),
        on_board: |per_um| vec![BoardTerm::Curvature(per_um)],
        from_board: |_, form, _| match *form {
            BoardTerm::Curvature(per_um) => Some(per_um),
            _ => None,
        },
        propose: |survey| has_sensor_elongation(survey).then(|| (0.0, StartValues::linear_only())),
        sentence: |per_um| {
            let um = per_um * 2500.0;
            format!("The sensor's characteristic is bent: at 50 µm it is off by {um:+.2} µm.")
        },
        next_test: GAUGE_BLOCK_TEST,
        ..ELONGATION_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// A limit: min(p, limit).
    SensorSaturation {
        /// The largest elongation that it shows, in µm.
        limit_um = LIMIT_UM
    }
}

impl ScalarCauseDefinition for SensorSaturation {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "sensor-saturation",
        stage: PredictionStage::Limit,
        inputs: &[LawInput::Predicted],
        nonlinear: &[NonlinearParameter::Limit],
        // A missing p is not above the limit, and stays missing.
        law: Some(|limit_um, x| if x[0] > limit_um[0] { limit_um[0] - x[0] } else { 0.0 }),
        on_board: |limit_um| vec![BoardTerm::Saturation(limit_um)],
        from_board: |_, form, _| match *form {
            BoardTerm::Saturation(limit_um) => Some(limit_um),
            _ => None,
        },
        propose: |survey| {
            has_sensor_elongation(survey).then(|| {
                (
                    0.0,
                    StartValues::from_values(saturation_start_values(
                        survey.source_elongation_um(),
                    )),
                )
            })
        },
        sentence: |limit_um| format!("The sensor shows nothing above {limit_um:.1} µm."),
        next_test: "Stop the spindle, then read the sensor against a dial gauge just below and above the limit.",
        ..ELONGATION_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// A parabola of the speed: p + c·(n/1000)², n in r/min.
    CentrifugalGrowth {
        /// c, in µm at 1000 r/min.
        um_per_krpm2 = UM_PER_KRPM2
    }
}

impl ScalarCauseDefinition for CentrifugalGrowth {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "centrifugal-growth",
        tier: 1,
        inputs: &[LawInput::Speed],
        law: Some(|_, x| (x[0] / 1000.0).powi(2)),
        on_board: |um_per_krpm2| vec![BoardTerm::Speed(um_per_krpm2)],
        from_board: |_, form, _| match *form {
            BoardTerm::Speed(um_per_krpm2) => Some(um_per_krpm2),
            _ => None,
        },
        propose: |survey| {
            let is_there = survey.includes_elongation() && survey.is_varying("spindle_rpm");
            is_there.then(|| (0.0, StartValues::linear_only()))
        },
        sentence: |um| {
            format!("Speed itself stretches the spindle: {:+.3} µm at 10 000 r/min.", um * 100.0)
        },
        next_test: "Change the speed quickly, up and down: what comes at once is not heat.",
        ..ELONGATION_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// A compliance: p − c·load, load in N, positive where it pushes the tool back.
    CuttingLoad {
        /// c, in µm/N.
        um_per_n = UM_PER_N
    }
}

impl ScalarCauseDefinition for CuttingLoad {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "cutting-load",
        tier: 1,
        inputs: &[LawInput::Load],
        law: Some(|_, x| -x[0]),
        on_board: |um_per_n| vec![BoardTerm::Load(-um_per_n)],
        from_board: |_, form, _| match form {
            BoardTerm::Load(um_per_n) => Some(-um_per_n),
            _ => None,
        },
        propose: |survey| {
            let is_there = survey.includes_elongation() && survey.is_varying("load_n");
            is_there.then(|| (0.0, StartValues::linear_only()))
        },
        sentence: |um| format!("The cut pushes the tool back by {:.2} µm for 1000 N.", um * 1000.0),
        next_test: "Press on the tool with a force gauge at standstill and read the dial.",
        ..ELONGATION_CAUSE_DEFAULTS
    };
}

/// Limits to try: where a part of what is predicted is above.
fn saturation_start_values(values: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
    if sorted.len() < 8 {
        return Vec::new();
    }
    [0.2, 0.35, 0.5, 0.6, 0.7, 0.78, 0.84, 0.9, 0.94, 0.97].map(at).to_vec()
}
