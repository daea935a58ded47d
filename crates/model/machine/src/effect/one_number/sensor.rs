//! Errors of the displacement sensor, and what speed and load add to the growth.

use super::{Declared, Neutral, OneNumber, one_number};
use crate::{
    effect::{
        cause_spec::{Input, Nonlinear, OnBoard, Stage, Target},
        data_view::{DataView, StartValues, spread},
    },
    file::spindle::ElongationSource,
};

const GAUGE_BLOCKS: &str =
    "Move the sensor's target by known gauge blocks over its whole range, up and down.";

const OF_ELONGATION: OneNumber = OneNumber { home: Target::Elongation, ..OneNumber::USUAL };

/// Returns whether the sensor shows a growth.
fn senses(survey: &dyn DataView) -> bool {
    survey.source() == Some(ElongationSource::Sensor) && spread(survey.law()) > 0.0
}

one_number! {
    /// A shift of what is predicted: p + o.
    SensorOffset {
        /// o, in µm.
        offset_um = OFFSET_UM
    }
}

impl Declared for SensorOffset {
    const IT: OneNumber = OneNumber {
        name: "sensor-offset",
        law: Some(|_, _| 1.0),
        on_board: |um| vec![OnBoard::Offset(um)],
        from_board: |own, form, constant_um| match form {
            OnBoard::Offset(um) if own.is_none() => Some(um + std::mem::take(constant_um)),
            _ => None,
        },
        propose: |survey| {
            let is_free = survey.quantity().axis().is_none() && !survey.has_constant();
            is_free.then(|| (0.0, StartValues::none()))
        },
        sentence: |um| format!("The zero of the sensor is off by {um:+.2} µm."),
        next_test: GAUGE_BLOCKS,
        ..OF_ELONGATION
    };
}

one_number! {
    /// A factor: g·p.
    SensorGain {
        /// g; 1: no change.
        gain = GAIN
    }
}

impl Declared for SensorGain {
    const IT: OneNumber = OneNumber {
        name: "sensor-gain",
        stage: Stage::Factor,
        neutral: Neutral::At(1.0),
        inputs: &[Input::Predicted],
        // A gain that turns the sign, or is off by more than a factor of five, is another machine's.
        amplitude_limits: Some([-0.8, 4.0]),
        law: Some(|_, x| x[0]),
        on_board: |gain| vec![OnBoard::Gain(gain)],
        from_board: |_, form, _| match *form {
            OnBoard::Gain(gain) => Some(gain),
            _ => None,
        },
        propose: |survey| senses(survey).then(|| (1.0, StartValues::none())),
        sentence: |more| {
            let gain = 1.0 + more;
            format!("The tool moves {gain:.4} µm for each micrometre that the sensor shows.")
        },
        next_test: GAUGE_BLOCKS,
        ..OF_ELONGATION
    };
}

one_number! {
    /// A parabola: p + c·p².
    SensorCurvature {
        /// c, in 1/µm.
        per_um = PER_UM
    }
}

impl Declared for SensorCurvature {
    const IT: OneNumber = OneNumber {
        name: "sensor-curvature",
        stage: Stage::Bend,
        inputs: &[Input::Predicted],
        law: Some(|_, x| x[0] * x[0]),
        on_board: |per_um| vec![OnBoard::Curvature(per_um)],
        from_board: |_, form, _| match *form {
            OnBoard::Curvature(per_um) => Some(per_um),
            _ => None,
        },
        propose: |survey| senses(survey).then(|| (0.0, StartValues::none())),
        sentence: |per_um| {
            let um = per_um * 2500.0;
            format!("The sensor's characteristic is bent: at 50 µm it is off by {um:+.2} µm.")
        },
        next_test: GAUGE_BLOCKS,
        ..OF_ELONGATION
    };
}

one_number! {
    /// A limit: min(p, limit).
    SensorSaturation {
        /// The largest elongation that it shows, in µm.
        limit_um = LIMIT_UM
    }
}

impl Declared for SensorSaturation {
    const IT: OneNumber = OneNumber {
        name: "sensor-saturation",
        stage: Stage::Limit,
        inputs: &[Input::Predicted],
        nonlinear: &[Nonlinear::Limit],
        // A missing p is not above the limit, and stays missing.
        law: Some(|limit_um, x| if x[0] > limit_um[0] { limit_um[0] - x[0] } else { 0.0 }),
        on_board: |limit_um| vec![OnBoard::Saturation(limit_um)],
        from_board: |_, form, _| match *form {
            OnBoard::Saturation(limit_um) => Some(limit_um),
            _ => None,
        },
        propose: |survey| senses(survey).then(|| (0.0, StartValues::at(quantiles(survey.law())))),
        sentence: |limit_um| format!("The sensor shows nothing above {limit_um:.1} µm."),
        next_test: "Stop the spindle, then read the sensor against a dial gauge just below and above the limit.",
        ..OF_ELONGATION
    };
}

one_number! {
    /// A parabola of the speed: p + c·(n/1000)², n in r/min.
    CentrifugalGrowth {
        /// c, in µm at 1000 r/min.
        um_per_krpm2 = UM_PER_KRPM2
    }
}

impl Declared for CentrifugalGrowth {
    const IT: OneNumber = OneNumber {
        name: "centrifugal-growth",
        tier: 1,
        inputs: &[Input::Speed],
        law: Some(|_, x| (x[0] / 1000.0).powi(2)),
        on_board: |um_per_krpm2| vec![OnBoard::Speed(um_per_krpm2)],
        from_board: |_, form, _| match *form {
            OnBoard::Speed(um_per_krpm2) => Some(um_per_krpm2),
            _ => None,
        },
        propose: |survey| {
            let is_there = survey.grows() && survey.varies("spindle_rpm");
            is_there.then(|| (0.0, StartValues::none()))
        },
        sentence: |um| {
            format!("Speed itself stretches the spindle: {:+.3} µm at 10 000 r/min.", um * 100.0)
        },
        next_test: "Change the speed quickly, up and down: what comes at once is not heat.",
        ..OF_ELONGATION
    };
}

one_number! {
    /// A compliance: p − c·load, load in N, positive where it pushes the tool back.
    CuttingLoad {
        /// c, in µm/N.
        um_per_n = UM_PER_N
    }
}

impl Declared for CuttingLoad {
    const IT: OneNumber = OneNumber {
        name: "cutting-load",
        tier: 1,
        inputs: &[Input::Load],
        law: Some(|_, x| -x[0]),
        on_board: |um_per_n| vec![OnBoard::Load(-um_per_n)],
        from_board: |_, form, _| match form {
            OnBoard::Load(um_per_n) => Some(-um_per_n),
            _ => None,
        },
        propose: |survey| {
            let is_there = survey.grows() && survey.varies("load_n");
            is_there.then(|| (0.0, StartValues::none()))
        },
        sentence: |um| format!("The cut pushes the tool back by {:.2} µm for 1000 N.", um * 1000.0),
        next_test: "Press on the tool with a force gauge at standstill and read the dial.",
        ..OF_ELONGATION
    };
}

/// Limits to try: where a part of what is predicted is above.
fn quantiles(values: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
    if sorted.len() < 8 {
        return Vec::new();
    }
    [0.2, 0.35, 0.5, 0.6, 0.7, 0.78, 0.84, 0.9, 0.94, 0.97].map(at).to_vec()
}
