//! The measurement that distinguishes a value of a cause from others that do as well: at which positions, or times.

use trueup_machine::effect::NonlinearParameter;

use crate::{
    diagnosis::value_range::min_max, fit::FitProblem, judgement::Caveat, term_kind::ModelPart,
};

/// Places over two periods of the shortest wave, a quarter of it apart.
const SEPARATING_POSITION_COUNT: i32 = 9;

/// Returns what decides between the first value of `part` and its aliases, if `doubt` is of these.
pub(super) fn describe_alias_test(
    problem: &FitProblem,
    part: &ModelPart,
    doubt: &Caveat,
) -> Option<String> {
    let Caveat::Alias(others) = doubt else { return None };
    let own = part.values[0];
    match part.kind.nonlinear_parameters().first()? {
        NonlinearParameter::Period => {
            let [low, high] = min_max(problem.data.own_position_mm()?.iter().copied());
            Some(describe_separating_positions(own, others, [low, high]))
        }
        NonlinearParameter::TimeConstant => Some(describe_separating_times(own, others)),
        _ => None,
    }
}

/// Waves that are one on the places that were measured are apart a quarter of the shortest period further on.
fn describe_separating_positions(own_mm: f64, others_mm: &[f64], [low, high]: [f64; 2]) -> String {
    let shortest_mm = others_mm.iter().copied().fold(own_mm, f64::min);
    let quarter_mm = shortest_mm / 4.0;
    let first_mm = (low + high) / 2.0 - f64::from(SEPARATING_POSITION_COUNT / 2) * quarter_mm;
    let places: Vec<f64> =
        (0..SEPARATING_POSITION_COUNT).map(|n| first_mm + f64::from(n) * quarter_mm).collect();
    let decimals = if quarter_mm < 1.0 { 3 } else { 1 };
    format!(
        "Measure at {} mm, a quarter of the shortest of these periods apart: there they differ.",
        format_list(&places, decimals)
    )
}

/// Where the answers of two lags to a sudden change differ most,
///
/// ```text
/// t = ln(τ₂/τ₁)·τ₁·τ₂/(τ₂ − τ₁)
/// ```
///
/// and the same for each alias.
fn describe_separating_times(own_s: f64, others_s: &[f64]) -> String {
    let most = |other_s: &f64| (other_s / own_s).ln() * own_s * other_s / (other_s - own_s);
    let mut times: Vec<f64> = others_s.iter().map(most).filter(|value| value.is_finite()).collect();
    times.sort_unstable_by(f64::total_cmp);
    format!(
        "Change the input at once, hold it, and read {} s later, and once nothing moves any more: \
         there these time constants differ most.",
        format_list(&times, 0)
    )
}

fn format_list(values: &[f64], decimals: usize) -> String {
    let each: Vec<String> = values.iter().map(|value| format!("{value:.decimals$}")).collect();
    each.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_periods_of_the_shortest_wave_are_read_in_quarters_about_the_middle() {
        let asked = describe_separating_positions(177.7, &[8.8], [0.0, 400.0]);
        assert!(
            asked.starts_with("Measure at 191.2, 193.4, 195.6, 197.8, 200.0, 202.2"),
            "{asked}"
        );
    }

    #[test]
    fn two_lags_are_told_apart_where_their_answers_differ_most() {
        let asked = describe_separating_times(100.0, &[400.0]);
        // ln 4·100·400/300
        assert!(asked.contains("read 185 s later"), "{asked}");
        let apart = |t: f64| (-t / 400.0_f64).exp() - (-t / 100.0_f64).exp();
        assert!(apart(185.0) > apart(175.0) && apart(185.0) > apart(195.0));
    }
}
