//! Errors of an axis over its position and direction, and of the clock.

use super::{Declared, OneNumber, one_number};
use crate::{
    effect::{
        cause_spec::{Definition, Input, Nonlinear, OnBoard, Stage, Target},
        data_view::{DataView, StartValues},
        drift::Drift,
    },
    model::pitch::is_reverse,
};

const FROM_BOTH_SIDES: &str =
    "Approach one position seven times from each side, at mid-travel and near both ends.";

const OF_AXIS: OneNumber = OneNumber { home: Target::Axis, ..OneNumber::USUAL };

/// A backlash where the axis has a screw and was approached from both sides.
fn backlash(survey: &dyn DataView) -> Option<(f64, StartValues)> {
    let has_backlash = survey.moves() && survey.turns() && survey.has_screw();
    has_backlash.then(|| (0.0, StartValues::none()))
}

one_number! {
    /// A slope along the own axis: p + c·P/1000.
    PitchScale {
        /// c, in µm/m.
        um_per_m = UM_PER_M
    }
}

impl Declared for PitchScale {
    const IT: OneNumber = OneNumber {
        name: "pitch-scale",
        inputs: &[Input::OwnPosition],
        law: Some(|_, x| x[0] / 1000.0),
        on_board: |um_per_m| match um_per_m {
            // The constant alone.
            0.0 => Vec::new(),
            _ => vec![OnBoard::OwnPosition(um_per_m)],
        },
        from_board: |own, form, constant_um| match form {
            // The constant alone.
            OnBoard::Offset(um) if own.is_some() => {
                *constant_um += um;
                Some(0.0)
            }
            OnBoard::OwnPosition(um_per_m) => Some(*um_per_m),
            _ => None,
        },
        propose: |survey| survey.moves().then(|| (0.0, StartValues::none())),
        sentence: |um| format!("The scale or the screw is off by {um:+.2} µm for each metre."),
        next_test: "Measure once more by ISO 230-2 at targets that are no multiples of the screw's pitch.",
        repair: Some(
            "Before you correct it, look at what can be repaired: the pretension of a screw between two bearings, and a \
             screw or scale that is not parallel to the guide.",
        ),
        same_in_one_pass: Some(Drift::NAME),
        against: &[
            (
                "reference-temperature",
                "While the expansion is linear both are the same error for each metre at every temperature: no measurement of \
                 the axis distinguishes them, and either correction removes it. Look where the reference temperature comes \
                 from (20 °C by ISO 1), and measure a certified length to know whether the scale is right.",
            ),
            (
                "expansion-slope",
                "Measure the axis cold and warm: a scale stays, an expansion grows with temperature.",
            ),
        ],
        ..OF_AXIS
    };
}

one_number! {
    /// A width: p + w where the axis was approached in the negative direction.
    Backlash {
        /// w, in µm.
        width_um = WIDTH_UM
    }
}

impl Declared for Backlash {
    const IT: OneNumber = OneNumber {
        name: "backlash",
        inputs: &[Input::OwnDirection],
        law: Some(|_, x| if is_reverse(x[0]) { 1.0 } else { 0.0 }),
        on_board: |width_um| vec![OnBoard::Reversed { width_um, um_per_m: 0.0 }],
        from_board: |_, form, _| match *form {
            OnBoard::Reversed { width_um, um_per_m: 0.0 } => Some(width_um),
            _ => None,
        },
        propose: backlash,
        sentence: |um| {
            format!("Approached in the negative direction the axis stands {um:+.2} µm further.")
        },
        next_test: FROM_BOTH_SIDES,
        ..OF_AXIS
    };
}

one_number! {
    /// A backlash that grows along the axis: p + c·P/1000 where it was approached in the negative direction.
    PositionDependentBacklash {
        /// c, in µm/m.
        um_per_m = UM_PER_M
    }
}

impl Declared for PositionDependentBacklash {
    const IT: OneNumber = OneNumber {
        name: "position-dependent-backlash",
        inputs: &[Input::OwnPosition, Input::OwnDirection],
        law: Some(|_, x| if is_reverse(x[1]) { x[0] / 1000.0 } else { 0.0 }),
        on_board: |um_per_m| vec![OnBoard::Reversed { width_um: 0.0, um_per_m }],
        from_board: |_, form, _| match *form {
            OnBoard::Reversed { um_per_m, .. } if um_per_m != 0.0 => Some(um_per_m),
            _ => None,
        },
        propose: backlash,
        sentence: |um| format!("The backlash changes by {um:+.2} µm over a metre of the axis."),
        next_test: FROM_BOTH_SIDES,
        ..OF_AXIS
    };
}

one_number! {
    /// A shift in time, after all else: p(t − shift), linear between rows, before the first its value.
    ///
    /// A measurement can come late for many reasons: a filter, a slow gauge. It cannot come early but
    /// by another clock: a shift below 0 is looked for only where the run has the gauge's own clock next to
    /// `time_s`, `gauge_time_s`.
    TimeShift {
        /// Positive: the measurement comes later than the prediction; in s.
        shift_s = SHIFT_S
    }
}

impl Declared for TimeShift {
    const IT: OneNumber = OneNumber {
        name: "time-shift",
        stage: Stage::Shift,
        tier: 2,
        is_compensated: false,
        inputs: &[Input::Time],
        nonlinear: &[Nonlinear::Shift],
        propose: |survey| (survey.predicted_spread() > 0.0).then(|| (0.0, survey.shifts())),
        sentence: |s| {
            format!("The measurement and the model's inputs are {s:.1} s apart: two clocks differ.")
        },
        next_test: "Write the gauge's own clock into the run (gauge_time_s, beside time_s), and compare the two \
                    clocks at the start and the end.",
        ..OneNumber::USUAL
    };
}
