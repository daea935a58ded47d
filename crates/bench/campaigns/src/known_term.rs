//! Challenges of a second diagnosis: the machine file has a cause already, as a `[[term]]` with the values that were
//! drawn, and the data have that and something new; or the term of the file is no longer true.
//!
//! The term is written here from the drawn truth, not taken from a first diagnosis: what the second
//! one answers does not depend on how well the first one went.

use std::fmt::Write as _;

use crate::hidden_effects::{
    ExpectedDiagnosis, HiddenCause, HiddenEffect, TestCase, draw_test_case,
    draw_test_case_with_cause_pair,
};

/// Returns the causes that the file may have: those with a name whose term a board corrects.
pub fn compensated_causes() -> impl Iterator<Item = HiddenCause> {
    let is_a_term = |cause: &HiddenCause| {
        cause.expected_diagnosis() == ExpectedDiagnosis::Compensated
            && cause.name() == cause.expected_name()
    };
    HiddenCause::ALL.iter().copied().filter(is_a_term)
}

/// Returns all pairs (in the file, newly hidden) that one machine can have.
#[must_use]
pub fn known_and_new_cause_pairs() -> Vec<(HiddenCause, HiddenCause)> {
    let is_named = |cause: &&HiddenCause| {
        matches!(
            cause.expected_diagnosis(),
            ExpectedDiagnosis::Compensated | ExpectedDiagnosis::Reported
        )
    };
    let all = || HiddenCause::ALL.iter().filter(is_named).copied();
    compensated_causes()
        .flat_map(|a| all().map(move |b| (a, b)))
        .filter(|(a, b)| a.is_compatible_with(*b))
        .collect()
}

/// Returns the challenge with `known` in the file and in the data, and `new` in the data alone: the answer is
/// `new`. `None` where no machine has both.
#[must_use]
pub fn draw_test_case_with_known_term(
    known: HiddenCause,
    new: HiddenCause,
    ratio: f64,
    seed: u64,
) -> Option<TestCase> {
    let mut challenge = draw_test_case_with_cause_pair(known, new, ratio, seed)?;
    let [a, b] = &challenge.truth.effects[..] else { return None };
    let (a, b) = (a.clone(), b.clone());
    challenge.machine += &format_term(&a, &challenge);
    let truth = &mut challenge.truth;
    add_elementwise(&mut truth.believed_um, &a.um);
    add_elementwise(&mut truth.holdout_believed_um, &a.holdout_um);
    truth.effect_um.clone_from(&b.um);
    truth.holdout_effect_um.clone_from(&b.holdout_um);
    truth.expected = b.cause.expected_diagnosis();
    truth.effects = vec![b];
    Some(challenge)
}

/// Returns the challenge with `cause` in the data and in the file, where it has half of its size: what is not
/// in the file is about `ratio` times the noise.
#[must_use]
pub fn draw_test_case_with_changed_term(cause: HiddenCause, ratio: f64, seed: u64) -> TestCase {
    let mut challenge = draw_test_case(cause, 2.0 * ratio, seed);
    let mut old = challenge.truth.effects[0].clone();
    halve_effect_parameters(&mut old, &challenge);
    challenge.machine += &format_term(&old, &challenge);
    let truth = &mut challenge.truth;
    // What could be gained is not known by halves: a time constant is no factor.
    truth.holdout_effect_um.clear();
    truth.effects[0].parameters.clear();
    challenge
}

fn add_elementwise(sum: &mut [f64], um: &[f64]) {
    for (sum, um) in sum.iter_mut().zip(um) {
        *sum += um;
    }
}

/// Half the way to where the term does nothing.
fn halve_effect_parameters(effect: &mut HiddenEffect, challenge: &TestCase) {
    let slope = machine_file_value(&challenge.machine, "slope_um_per_m_per_c");
    let constant = machine_file_value(&challenge.machine, "constant_um_per_c");
    let most_um = challenge.truth.believed_um.iter().copied().fold(f64::MIN, f64::max);
    for (name, value) in &mut effect.parameters {
        let nothing = match *name {
            "gain" | "scale" => 1.0,
            "limit_um" => most_um,
            "um_per_m_per_c" => slope,
            "um_per_c" if effect.cause == HiddenCause::ExpansionConstant => constant,
            "shift_c"
            | "offset_um"
            | "per_um"
            | "um_per_c"
            | "amplitude_um"
            | "um_per_krpm2"
            | "um_per_n"
            | "um_per_m"
            | "width_um"
            | "second_amplitude_um"
            | "urad_per_m" => 0.0,
            // Next to an amplitude the time constant stays; alone it is what ages.
            "time_constant_s" if effect.cause == HiddenCause::ThermalLag => 0.0,
            "time_constant_s"
                if matches!(
                    effect.cause,
                    HiddenCause::GrowthRate | HiddenCause::CoolingAsymmetry
                ) =>
            {
                // Where it does nothing is the believed one; this is a clear change wherever that is.
                *value *= 1.8;
                continue;
            }
            _ => continue,
        };
        *value = nothing + (*value - nothing) / 2.0;
    }
    for (name, values) in &mut effect.tables {
        if !["knots_mm", "feeds_mm_per_min"].contains(name) {
            values.iter_mut().for_each(|value| *value /= 2.0);
        }
    }
}

/// Returns the number that the file has under `key`; 0 where it has none.
fn machine_file_value(machine: &str, key: &str) -> f64 {
    let mut lines = machine.lines();
    let value = lines.find_map(|line| line.strip_prefix(key)?.strip_prefix(" = "));
    value.map_or(0.0, |value| value.parse().expect("the twin writes numbers"))
}

/// Returns `effect` as a `[[term]]` of the machine file, by the table of causes (`docs/reference.md`).
fn format_term(effect: &HiddenEffect, challenge: &TestCase) -> String {
    let cause = effect.cause;
    let mut text = format!(
        "\n[[term]]\ncause = \"{}\"\nquantity = \"{}\"\n",
        cause.name(),
        challenge.quantity
    );
    let mut key = |name: &str, value: String| {
        writeln!(text, "{name} = {value}").expect("a String takes all text");
    };
    let of = |name: &str| effect.parameter(name).unwrap_or(0.0);
    let axis = |column: &str| format!("{:?}", column.trim_end_matches("_mm"));
    let column = effect.column.as_deref().unwrap_or_default();
    match cause {
        HiddenCause::PitchPeriodic => {
            let degrees = |name: &str| of(name).to_degrees();
            key("period_mm", format!("{:?}", of("period_mm")));
            key("harmonic", "[1, 2]".into());
            key("amplitude_um", format!("{:?}", [of("amplitude_um"), of("second_amplitude_um")]));
            key("phase_deg", format!("{:?}", [degrees("phase_rad"), degrees("second_phase_rad")]));
            return text;
        }
        HiddenCause::Straightness => key("along", axis(column)),
        HiddenCause::CrossAxis => key("axis", axis(column)),
        HiddenCause::AngularError => key("lever", axis(column)),
        HiddenCause::SensorTemperatureDrift
        | HiddenCause::ExtraHeatPath
        | HiddenCause::AxisExpansion => {
            key("column", format!("{column:?}"));
        }
        HiddenCause::SlowMode if !column.is_empty() => key("column", format!("{column:?}")),
        _ => {}
    }
    for (name, value) in &effect.parameters {
        key(name, format!("{value:?}"));
    }
    for (name, values) in &effect.tables {
        if *name == "knots_mm" {
            key("order", "4".into());
        }
        key(name, format!("{values:?}"));
    }
    text
}
