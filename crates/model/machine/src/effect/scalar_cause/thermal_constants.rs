//! Constants of the machine's own thermal laws that are others than believed.

use super::{NeutralValue, ScalarCause, ScalarCauseDefinition, define_scalar_cause};
use crate::{
    effect::{
        cause_spec::{
            BoardTerm, LawInput, NonlinearParameter, PredictionStage, Target, format_duration,
        },
        data_view::{
            FINE_TIME_CONSTANT_GRID_POINTS, StartValues, TIME_CONSTANT_GRID_POINTS, peak_to_peak,
        },
    },
    sections::ElongationSource,
};

const WARMUP_COOLDOWN_TEST: &str =
    "Record a start from cold and a stop from warm, each until nothing moves any more.";

/// A constant of the own axis's thermal law.
const AXIS_CAUSE_DEFAULTS: ScalarCause =
    ScalarCause { target: Target::Axis, stage: PredictionStage::Constant, ..ScalarCause::DEFAULT };

/// A time constant of a law.
const TIME_CONSTANT_CAUSE_DEFAULTS: ScalarCause = ScalarCause {
    target: Target::OwnThermometer,
    stage: PredictionStage::Constant,
    is_positive: true,
    nonlinear: &[NonlinearParameter::TimeConstant],
    next_test: WARMUP_COOLDOWN_TEST,
    ..ScalarCause::DEFAULT
};

define_scalar_cause! {
    /// A factor of the growth: s·p.
    GrowthAmplitude {
        /// s; 1: no change.
        scale = SCALE
    }
}

impl ScalarCauseDefinition for GrowthAmplitude {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "growth-amplitude",
        target: Target::Elongation,
        stage: PredictionStage::Factor,
        neutral: NeutralValue::At(1.0),
        inputs: &[LawInput::Predicted],
        // A growth that is not within a factor of two of what is believed is not the same growth: another path carries
        // it.
        amplitude_bounds: Some([-0.5, 1.0]),
        law: Some(|_, x| x[0]),
        on_board: |scale| vec![BoardTerm::Gain(scale)],
        propose: |survey| {
            let source = survey.elongation_source();
            let grows =
                matches!(source, Some(ElongationSource::Temperature | ElongationSource::Warmup));
            (grows && peak_to_peak(survey.source_elongation_um()) > 0.0)
                .then(|| (1.0, StartValues::linear_only()))
        },
        sentence: |more| format!("The growth is {:.3} times that of the model.", 1.0 + more),
        next_test: "Repeat the run at another speed and compare the factor.",
        ..ScalarCause::DEFAULT
    };
}

define_scalar_cause! {
    /// A warm-up without an end: Smax·(1 − e^(−(t − t₁)/τ)) after t₁, in place of the one with (t₂ − t₁)/k.
    GrowthRate {
        /// τ, in s; above 0.
        time_constant_s = TIME_CONSTANT_S
    }
}

impl ScalarCauseDefinition for GrowthRate {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "growth-rate",
        target: Target::Elongation,
        refusal: |host| {
            let is_warmup = host.spindle.source == Some(ElongationSource::Warmup);
            (host.quantity.axis().is_some() || !is_warmup)
                .then(|| "needs [spindle] source = \"warmup\"".into())
        },
        correct: |time_constant_s, constants| {
            /// So large an exponent makes the warm-up an exponential without an end: 1 − e^(−40) is 1.
            const SATURATED_EXPONENT: f64 = 40.0;
            if let Some(warmup) =
                constants.spindle.as_mut().and_then(|spindle| spindle.warmup.as_mut())
            {
                warmup.exponent = SATURATED_EXPONENT;
                warmup.warm_s = warmup.lag_s + SATURATED_EXPONENT * time_constant_s;
            }
        },
        propose: |survey| {
            (survey.elongation_source() == Some(ElongationSource::Warmup))
                .then(|| (0.0, survey.time_constant_start_values(FINE_TIME_CONSTANT_GRID_POINTS)))
        },
        sentence: |s| {
            format!("The spindle warms up with a time constant of {}.", format_duration(s))
        },
        ..TIME_CONSTANT_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// Another lag while it falls: the lag, or the warm-up, with τ.
    CoolingAsymmetry {
        /// τ, in s; above 0.
        time_constant_s = TIME_CONSTANT_S
    }
}

impl ScalarCauseDefinition for CoolingAsymmetry {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "cooling-asymmetry",
        stage: PredictionStage::FallingTimeConstants,
        tier: 1,
        nonlinear: &[NonlinearParameter::FallingTimeConstant],
        refusal: |host| {
            let is_warmup = host.quantity.axis().is_none()
                && host.spindle.source == Some(ElongationSource::Warmup);
            (!host.has_thermometer() && !is_warmup)
                .then(|| "needs a lag or a warm-up to change".into())
        },
        correct: |time_constant_s, constants| {
            *constants.falling_s = Some(time_constant_s);
            if let Some(warmup) =
                constants.spindle.as_mut().and_then(|spindle| spindle.warmup.as_mut())
            {
                warmup.cool_s = Some(time_constant_s);
            }
        },
        propose: |survey| {
            let is_warmup = survey.elongation_source() == Some(ElongationSource::Warmup);
            let stood = || survey.column("spindle_rpm").is_some_and(|rpm| rpm.contains(&0.0));
            let lags =
                |believed_s| believed_s > 0.0 || survey.has_cause(ThermalLag::DEFINITION.name);
            (survey.modelled_lag_s().is_some_and(lags) || is_warmup && stood())
                .then(|| (0.0, survey.time_constant_start_values(FINE_TIME_CONSTANT_GRID_POINTS)))
        },
        sentence: |s| {
            format!("It cools down with a time constant of its own: {}.", format_duration(s))
        },
        ..TIME_CONSTANT_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// Another lag: p from the temperature behind a lag of τ.
    ThermalLag {
        /// τ in place of the believed one, in s; above 0.
        time_constant_s = TIME_CONSTANT_S
    }
}

impl ScalarCauseDefinition for ThermalLag {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "thermal-lag",
        refusal: |host| {
            (!host.has_thermometer()).then(|| {
                format!(
                    "needs a temperature on which {} depends: [spindle] source = \"temperature\", or \
                     [axis.*.thermal]",
                    host.quantity.name()
                )
            })
        },
        correct: |time_constant_s, constants| {
            let spindle =
                constants.spindle.as_mut().and_then(|spindle| spindle.temperature.as_mut());
            if let Some(model) = spindle {
                model.lag_s = time_constant_s;
            }
            if let Some(thermal) = &mut constants.thermal {
                thermal.lag_s = time_constant_s;
            }
        },
        propose: |survey| {
            let believed_s = survey.modelled_lag_s()?;
            // A thermometer that is late and a part that is late are one lateness, early or late.
            if survey.has_cause("thermometer-lag") {
                return None;
            }
            let count = if believed_s > 0.0 {
                FINE_TIME_CONSTANT_GRID_POINTS
            } else {
                TIME_CONSTANT_GRID_POINTS
            };
            Some((0.0, survey.time_constant_start_values(count)))
        },
        sentence: |s| {
            format!(
                "The machine grows later than its thermometer warms, by a time constant of {}.",
                format_duration(s)
            )
        },
        ..TIME_CONSTANT_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// Another constant: c·(T − T_ref) in the mode "constant" or "both".
    ExpansionConstant {
        /// c in place of the believed one, in µm/K; any sign: positive where the warm axis goes too far.
        um_per_c = UM_PER_C
    }
}

impl ScalarCauseDefinition for ExpansionConstant {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "expansion-constant",
        neutral: NeutralValue::Believed,
        // A table has no constant to correct, and the mode "position" does not use it.
        refusal: |host| {
            let is_used = host.thermal.is_none_or(|thermal| thermal.mode.has_constant_term());
            host.thermal_constant_rejection_reason().or_else(|| {
                (!is_used)
                    .then(|| "corrects a constant that the mode \"position\" does not use".into())
            })
        },
        correct: |um_per_c, constants| {
            if let Some(thermal) = &mut constants.thermal {
                thermal.constant_um_per_c = um_per_c;
            }
        },
        propose: |survey| {
            let thermal = survey.active_thermal_law()?;
            (thermal.mode.has_constant_term() && thermal.table.is_none())
                .then(|| (thermal.constant_um_per_c, StartValues::linear_only()))
        },
        sentence: |um_per_c| {
            format!(
                "All of the axis shifts with its temperature, wherever it stands: by {um_per_c:+.3} µm/K more than \
                 believed."
            )
        },
        next_test: "Measure one place of the axis over a warm-up of at least 5 K until it is steady, then over the cool-down.",
        against: &[(
            "expansion-slope",
            "Measure the axis at both ends, cold and warm: a constant moves both ends alike, a slope \
             moves them apart.",
        )],
        ..AXIS_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// Another slope: c·(T − T_ref)·(P − P₀)/1000.
    ExpansionSlope {
        /// c in place of the believed one, in µm/(m·K).
        um_per_m_per_c = UM_PER_M_PER_C
    }
}

impl ScalarCauseDefinition for ExpansionSlope {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "expansion-slope",
        neutral: NeutralValue::Believed,
        // Another reference moves a table along the temperature; another slope has no place in it.
        refusal: |host| host.thermal_constant_rejection_reason(),
        correct: |um_per_m_per_c, constants| {
            if let Some(thermal) = &mut constants.thermal {
                thermal.slope_um_per_m_per_c = um_per_m_per_c;
            }
        },
        propose: |survey| {
            let thermal = survey.active_thermal_law().filter(|_| survey.has_own_axis_moved())?;
            (thermal.mode.has_position_term() && thermal.table.is_none())
                .then(|| (thermal.slope_um_per_m_per_c, StartValues::linear_only()))
        },
        sentence: |um| format!("The axis expands by {um:+.3} µm/(m·K) more than believed."),
        next_test: "Measure the axis at both ends at two temperatures that are at least 5 K apart.",
        ..AXIS_CAUSE_DEFAULTS
    };
}

define_scalar_cause! {
    /// Another reference: c·(T − T_ref − shift)·(P − P₀)/1000.
    ReferenceTemperature {
        /// Added to the believed T_ref, in K.
        shift_c = SHIFT_C
    }
}

impl ScalarCauseDefinition for ReferenceTemperature {
    const DEFINITION: ScalarCause = ScalarCause {
        name: "reference-temperature",
        refusal: |host| {
            host.thermal.is_none().then(|| "needs [axis.*.thermal] of the quantity's axis".into())
        },
        correct: |shift_c, constants| {
            if let Some(thermal) = &mut constants.thermal {
                thermal.shift_reference_temperature(shift_c);
            }
        },
        propose: |survey| {
            let thermal = survey.active_thermal_law().filter(|_| survey.has_own_axis_moved())?;
            thermal.mode.has_position_term().then(|| (0.0, StartValues::linear_only()))
        },
        sentence: |shift_c| {
            format!(
                "The axis is right at another temperature, {shift_c:+.2} K from the believed one."
            )
        },
        next_test: "Find the source of the reference temperature. It is the gauge's own (20 °C \
            by ISO 1), the scale's, or the one at which the axis was last set. While the \
            expansion is linear no measurement of the axis distinguishes a wrong one from a \
            wrong scale. Both are the same error for each metre at every temperature, and \
            either correction removes it.",
        ..AXIS_CAUSE_DEFAULTS
    };
}
