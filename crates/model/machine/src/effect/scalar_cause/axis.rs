//! Errors of an axis over its position and direction, and of the clock.

use super::{ScalarCause, ScalarCauseDefinition, define_scalar_cause};
use crate::{
    effect::{
        cause_spec::{BoardTerm, LawInput, NonlinearParameter, PredictionStage, Target},
        data_view::{DataView, StartValues},
    },
    sections::axis::is_negative_direction,
};

const BIDIRECTIONAL_TEST: &str =
    "Approach one position seven times from each side, at mid-travel and near both ends.";

const AXIS_CAUSE_DEFAULTS: ScalarCause =
    ScalarCause { target: Target::Axis, ..ScalarCause::DEFAULT };

/// A backlash where the axis has a screw and was approached from both sides, be it at one place.
fn propose_backlash(survey: &dyn DataView) -> Option<(f64, StartValues)> {
    let has_backlash = survey.is_bidirectional() && survey.has_screw_feedback();
    has_backlash.then(|| (0.0, StartValues::linear_only()))
}

/// One that differs from place to place.
fn propose_uneven_backlash(survey: &dyn DataView) -> Option<(f64, StartValues)> {
    propose_backlash(survey).filter(|_| survey.has_own_axis_moved())
}

define_scalar_cause! {
    /// A slope along the own axis: p + c·P/1000.
    PitchScale {
        /// c, in µm/m.
        um_per_m = UM_PER_M
    }
}

impl ScalarCauseDefinition for PitchScale {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "pitch-scale",
        inputs: &[LawInput::OwnPosition],
        law: Some(|_, x| x[0] / 1000.0),
        on_board: |um_per_m| match um_per_m {
            // The constant alone.
            0.0 => Vec::new(),
            _ => vec![BoardTerm::OwnPosition(um_per_m)],
        },
        from_board: |own, form, constant_um| match form {
            // The constant alone.
            BoardTerm::Offset(um) if own.is_some() => {
                *constant_um += um;
                Some(0.0)
            }
            BoardTerm::OwnPosition(um_per_m) => Some(*um_per_m),
            _ => None,
        },
        propose: |survey| survey.has_own_axis_moved().then(|| (0.0, StartValues::linear_only())),
        sentence: |um| format!("The scale or the screw is off by {um:+.2} µm for each metre."),
        next_test: "Measure once more by ISO 230-2 at targets that are no multiples of the screw's pitch.",
        repair: Some(
            "Before you correct it, look at what can be repaired. That is the pretension of a \
             screw between two bearings, and a screw or scale that is not parallel to the guide.",
        ),
        against: &[
            (
                "reference-temperature",
                "While the expansion is linear both are the same error for each metre at every \
                 temperature. No measurement of the axis distinguishes them, and either \
                 correction removes it. Look where the reference temperature comes from (20 °C \
                 by ISO 1), and measure a certified length to know whether the scale is right.",
            ),
            (
                "expansion-slope",
                "Measure the axis cold and warm: a scale stays, an expansion grows with temperature.",
            ),
        ],
        ..AXIS_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// A width: p + w where the axis was approached in the negative direction.
    Backlash {
        /// w, in µm.
        width_um = WIDTH_UM
    }
}

impl ScalarCauseDefinition for Backlash {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "backlash",
        inputs: &[LawInput::OwnDirection],
        law: Some(|_, x| if is_negative_direction(x[0]) { 1.0 } else { 0.0 }),
        on_board: |width_um| vec![BoardTerm::Reversed { width_um, um_per_m: 0.0 }],
        from_board: |_, form, _| match *form {
            BoardTerm::Reversed { width_um, um_per_m: 0.0 } => Some(width_um),
            _ => None,
        },
        propose: propose_backlash,
        sentence: |um| {
            format!("Approached in the negative direction the axis stands {um:+.2} µm further.")
        },
        next_test: BIDIRECTIONAL_TEST,
        ..AXIS_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// A backlash that grows along the axis: p + c·P/1000 where it was approached in the negative direction.
    PositionDependentBacklash {
        /// c, in µm/m.
        um_per_m = UM_PER_M
    }
}

impl ScalarCauseDefinition for PositionDependentBacklash {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "position-dependent-backlash",
        inputs: &[LawInput::OwnPosition, LawInput::OwnDirection],
        law: Some(|_, x| if is_negative_direction(x[1]) { x[0] / 1000.0 } else { 0.0 }),
        on_board: |um_per_m| vec![BoardTerm::Reversed { width_um: 0.0, um_per_m }],
        from_board: |_, form, _| match *form {
            BoardTerm::Reversed { um_per_m, .. } if um_per_m != 0.0 => Some(um_per_m),
            _ => None,
        },
        propose: propose_uneven_backlash,
        sentence: |um| format!("The backlash changes by {um:+.2} µm over a metre of the axis."),
        next_test: BIDIRECTIONAL_TEST,
        ..AXIS_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
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

impl ScalarCauseDefinition for TimeShift {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "time-shift",
        stage: PredictionStage::Shift,
        tier: 2,
        is_compensable: false,
        inputs: &[LawInput::Time],
        nonlinear: &[NonlinearParameter::Shift],
        propose: |survey| {
            (survey.predicted_peak_to_peak_um() > 0.0)
                .then(|| (0.0, survey.time_shift_start_values()))
        },
        sentence: |s| {
            format!("The measurement and the model's inputs are {s:.1} s apart: two clocks differ.")
        },
        next_test: "Write the gauge's own clock into the run (gauge_time_s, in addition to time_s), and compare the two \
                    clocks at the start and the end.",
        ..ScalarCause::DEFAULT
    };
}
