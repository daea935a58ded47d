//! A table that was measured several times is claimed by its repeats: the places differ by more than they
//! scatter (F at 1 %), and every held-out cycle gains. How it does between its points is another question,
//! which the places answer that are held out in turn.

use trueup_machine::effect::Effect;
use trueup_numerics::repeats::{InterpolationCheck, TableLaw, check_interpolation, select_table};

use crate::{
    judgement::context::JudgementContext,
    repeats::TargetPositions,
    search::table_from_repeats::{residual_readings, without_own_axis_terms},
    term_kind::TermKind,
};

/// Positions to measure next, at most: a cycle of the standard has about as many.
const MAX_SUGGESTED_POSITIONS: usize = 12;

/// The evidence of the repeats for a table.
#[derive(Clone, Debug)]
pub(crate) struct RepeatEvidence {
    /// Whether they bear it out.
    pub is_confirmed: bool,
    /// How it does between its points.
    pub between: Option<InterpolationAccuracy>,
}

/// The accuracy of a table between its points.
#[derive(Clone, Debug)]
pub(crate) struct InterpolationAccuracy {
    /// Each inner place predicted by its neighbours, in µm.
    pub found: InterpolationCheck,
    /// The name of the axis.
    pub axis: &'static str,
    /// Where to measure, in mm, rising.
    pub next_mm: Vec<f64>,
}

/// Returns what the repeats say of `cause` if it is a table; none where nothing was repeated.
pub(crate) fn evaluate_repeats(
    case: &JudgementContext<'_>,
    cause: &TermKind,
) -> Option<RepeatEvidence> {
    let table = cause.as_pitch_table()?;
    let problem = case.problem;
    if problem.groups.size != 1 {
        return None;
    }
    let model = &case.found.fitted.model;
    let targets =
        TargetPositions::from_rows(&problem.data, problem.groups.first_row.iter().copied())?;
    let readings = residual_readings(&targets, problem, &without_own_axis_terms(model));
    let none = vec![false; readings.len()];
    let is_step = |kind: &TermKind| {
        kind.as_pitch_table().is_none() && kind.cause().is_some_and(Effect::depends_on_direction)
    };
    let law = match &table.reverse_um {
        Some(_) => TableLaw::EachSide,
        None if model.parts.iter().any(|part| is_step(&part.kind)) => TableLaw::TableAndStep,
        None => TableLaw::Table,
    };
    let decision = select_table(&readings, &none, targets.at_mm.len(), &[law]);
    let trial = decision.law_test(law)?;
    let between = check_interpolation(&targets.at_mm, &readings, &none, law);
    Some(RepeatEvidence {
        is_confirmed: trial.is_significant() && trial.has_gain_in_every_block(),
        between: between.map(|found| InterpolationAccuracy {
            found,
            axis: targets.own.name(),
            next_mm: suggest_positions_mm(&targets.at_mm),
        }),
    })
}

/// Returns a position in each gap between the places, or in as many evenly chosen: not all in the middle, so that
/// they have no common distance that an error could repeat with.
fn suggest_positions_mm(at_mm: &[f64]) -> Vec<f64> {
    /// The fraction by which the golden section moves on: no two of a few come near each other.
    const INVERSE_GOLDEN_RATIO: f64 = 0.618_034;
    let gaps = at_mm.len().saturating_sub(1);
    let count = gaps.min(MAX_SUGGESTED_POSITIONS);
    (0..count)
        .map(|n| {
            let gap = n * gaps / count;
            let [low, high] = [at_mm[gap], at_mm[gap + 1]];
            // In the middle half of the gap.
            let share = 0.25 + 0.5 * (INVERSE_GOLDEN_RATIO * (n + 1) as f64).fract();
            let digits = 10_f64.powi(if high - low < 1.0 { 3 } else { 1 });
            ((low + share * (high - low)) * digits).round() / digits
        })
        .collect()
}

impl InterpolationAccuracy {
    /// Returns what is known, in a sentence; none where the line predicts them.
    pub(crate) fn sentence(&self) -> Option<String> {
        let InterpolationCheck { inner, line, nothing, .. } = self.found;
        let figures = format!(
            "the line between its neighbours misses a held-out point by {line:.1} µm RMS, no \
             table at all by {nothing:.1} µm"
        );
        if !self.found.has_enough_interior_positions() {
            return Some(format!(
                "What it is worth between its points is not known: {inner} inner points are too few to show it ({figures})."
            ));
        }
        self.found
            .is_interpolation_doubtful()
            .then(|| format!("At its points it holds; between them it is doubted: {figures}."))
    }

    /// Returns the measurement that decides, where it is open.
    pub(crate) fn next_test(&self) -> Option<String> {
        self.sentence()?;
        let next: Vec<String> = self.next_mm.iter().map(f64::to_string).collect();
        Some(format!(
            "Measure between the points as well, three cycles both ways: {}_mm = {}.",
            self.axis,
            next.join(", ")
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_to_measure_next_are_in_the_gaps_and_at_uneven_distances() {
        let at: Vec<f64> = (0..9).map(|n| -20.0 + 5.0 * f64::from(n)).collect();
        let next = suggest_positions_mm(&at);
        assert_eq!(next.len(), 8);
        let mut steps = Vec::new();
        for (n, mm) in next.iter().enumerate() {
            assert!((at[n] + 1.0..at[n + 1] - 1.0).contains(mm), "{next:?}");
            steps.extend(n.checked_sub(1).map(|before| mm - next[before]));
        }
        let (least, most) =
            steps.iter().fold((f64::MAX, 0.0_f64), |(a, b), s| (a.min(*s), b.max(*s)));
        assert!(most - least > 1.0, "{steps:?}");
        // Of many gaps not more than a cycle has.
        let many: Vec<f64> = (0..41).map(f64::from).collect();
        assert_eq!(suggest_positions_mm(&many).len(), MAX_SUGGESTED_POSITIONS);
    }
}
