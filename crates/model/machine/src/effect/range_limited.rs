//! A cause that acts only where a recorded input is in a range: "only above 10,500 r/min".
//!
//! The term adds what the cause does where the input is in the range, and 0 elsewhere; where the input is missing, so
//! is the sum. The cause keeps its name.

use super::{
    Effect,
    cause_spec::{
        BoardRepresentation, Candidate, Explanation, FindingParameter, FitSpec, LawInput,
        Multiplier, PhysicalLaw, PredictionStage, Target, TermContext, TermEntry, Value,
    },
    data_view::{DataView, StartValues, peak_to_peak},
    dependence::{Dependence, DependenceForm, SPEED_COLUMN},
    law_evaluation::ColumnSource,
    scalar_cause::CentrifugalGrowth,
};
use crate::{
    keys::{
        reader::{Section, is_temperature_column},
        term::{LEVELS, WHERE_ABOVE, WHERE_BELOW, WHERE_COLUMN},
    },
    location::InputFileError,
    sections::LinearAxis,
};

/// Most values of an input at which a range may begin.
const MAX_THRESHOLDS: usize = 9;

/// How often an input must pass a bound: in and out three times. A single occurrence is an event of the run.
const MIN_CROSSINGS: usize = 6;

/// Which side of the bound is inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoundSide {
    /// Above it.
    Above,
    /// Below it.
    Below,
}

impl BoundSide {
    /// Its name: `above`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Above => "above",
            Self::Below => "below",
        }
    }

    fn key(self) -> &'static str {
        match self {
            Self::Above => WHERE_ABOVE.name,
            Self::Below => WHERE_BELOW.name,
        }
    }
}

/// A cause in a range.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeLimited {
    /// The cause; it is only added.
    pub effect: Box<Effect>,
    /// The column whose range it is.
    pub column: String,
    /// Which side of `bound` is inside.
    pub side: BoundSide,
    /// In the column's unit.
    pub bound: f64,
}

impl RangeLimited {
    /// Returns `effect`, within the range that `section` states for it, if it does.
    pub(crate) fn read(section: &Section<'_>, effect: Effect) -> Result<Effect, InputFileError> {
        let mut sides = [BoundSide::Above, BoundSide::Below].into_iter().filter_map(|side| {
            section.number(side.key()).transpose().map(|bound| bound.map(|bound| (side, bound)))
        });
        let (range, second) = (sides.next().transpose()?, sides.next().transpose()?);
        let column = section.text(WHERE_COLUMN.name)?;
        let is_level = matches!(
            &effect,
            Effect::Dependence(Dependence { form: DependenceForm::Constant { .. }, .. })
        );
        match (column, range) {
            (None, None) if is_level => Err(section
                .key_error(LEVELS.name, "is missing: a level without levels needs where_column")),
            (None, None) => Ok(effect),
            (None, Some((side, _))) => Err(section.key_error(side.key(), "needs where_column")),
            (Some(_), None) => {
                Err(section.key_error(WHERE_COLUMN.name, "needs where_above or where_below"))
            }
            (Some(_), Some(_)) if second.is_some() => Err(section
                .key_error(WHERE_BELOW.name, "does not go with where_above: state one of them")),
            (Some(_), Some(_)) if effect.stage() != PredictionStage::Sum => {
                let rule = "belongs to causes that are added: this one changes the model's own law";
                Err(section.key_error(WHERE_COLUMN.name, rule))
            }
            (Some(column), Some((side, bound))) => Ok(Effect::RangeLimited(Self {
                effect: Box::new(effect),
                column: column.into(),
                side,
                bound,
            })),
        }
    }

    /// Returns what is read of the run for the range.
    fn input(&self) -> LawInput<'_> {
        let axis = LinearAxis::ALL.into_iter().find(|axis| self.column == axis.column_name());
        match (&self.column[..], axis) {
            (_, Some(axis)) => LawInput::Position(axis),
            (SPEED_COLUMN, _) => LawInput::Speed,
            ("load_n", _) => LawInput::Load,
            (column, _) if is_temperature_column(column) => {
                LawInput::Temperature { column, lag_s: 0.0 }
            }
            (column, _) => LawInput::Column(column),
        }
    }

    /// Returns 1 inside, 0 outside, and NaN where the value is missing.
    fn indicator(&self, value: f64) -> f64 {
        let is_inside = match self.side {
            BoundSide::Above => value > self.bound,
            BoundSide::Below => value < self.bound,
        };
        match (value.is_nan(), is_inside) {
            (true, _) => f64::NAN,
            (_, true) => 1.0,
            (_, false) => 0.0,
        }
    }

    /// Returns what each amplitude of 1 adds, in µm, row by row.
    pub(super) fn unit_effect_columns(
        &self,
        nonlinear: &[f64],
        source: &dyn ColumnSource,
    ) -> Vec<Vec<f64>> {
        let mut columns = self.effect.unit_effect_columns(nonlinear, source);
        columns.iter_mut().for_each(|column| self.mask_outside_range(column, source));
        columns
    }

    /// Returns what it adds with these values, in µm, row by row.
    pub(super) fn sum_effects(&self, values: &[f64], source: &dyn ColumnSource) -> Vec<f64> {
        let mut sum_um = self.effect.sum_effects(values, source);
        self.mask_outside_range(&mut sum_um, source);
        sum_um
    }

    fn mask_outside_range(&self, column_um: &mut [f64], source: &dyn ColumnSource) {
        let values = source.column(&self.input());
        for (um, value) in column_um.iter_mut().zip(values.iter()) {
            // What is missing outside the range is not needed there.
            *um = match self.indicator(*value) {
                0.0 => 0.0,
                share => *um * share,
            };
        }
    }

    /// Returns what it adds where the inputs are `x`, that of the range last, in µm.
    pub(super) fn evaluate_at(&self, values: &[f64], x: &[f64]) -> f64 {
        let Some((value, x)) = x.split_last() else { return f64::NAN };
        match self.indicator(*value) {
            0.0 => 0.0,
            share => share * self.effect.evaluate_at(values, x),
        }
    }
}

impl RangeLimited {
    /// Returns its keys in a `[[term]]`.
    pub(super) fn entries(&self) -> Vec<TermEntry> {
        let mut entries = self.effect.entries();
        entries.push((WHERE_COLUMN.name, Value::Text(self.column.clone())));
        entries.push((self.side.key(), Value::Number(self.bound)));
        entries
    }
}

impl PhysicalLaw for RangeLimited {
    fn target(&self) -> Target {
        self.effect.target()
    }

    fn refusal(&self, host: &TermContext<'_>) -> Option<String> {
        self.effect.refusal(host)
    }

    fn inputs<'a>(&'a self, nonlinear: &[f64]) -> Vec<LawInput<'a>> {
        let mut inputs = self.effect.inputs(nonlinear);
        inputs.push(self.input());
        inputs
    }
}

impl BoardRepresentation for RangeLimited {
    fn is_compensable(&self) -> bool {
        false
    }
}

impl Candidate for RangeLimited {
    fn fit_spec(&self) -> FitSpec {
        FitSpec { tier: 1, list_length: None, is_of_instrument: false, ..self.effect.fit_spec() }
    }

    fn values(&self) -> Vec<f64> {
        self.effect.values()
    }

    fn set_values(&mut self, values: &[f64]) {
        self.effect.set_values(values);
    }
}

impl Explanation for RangeLimited {
    fn describe(&self, values: &[f64]) -> String {
        let Self { column, side, bound, .. } = self;
        let sentence = self.effect.describe(values);
        // As many places as any column of a run file has.
        let bound = (bound * 1e6).round() / 1e6;
        format!("{sentence} It acts only where {column} is {} {bound}.", side.name())
    }

    fn next_test(&self) -> &'static str {
        "Measure on both sides of the bound and near it, with all else at rest, twice."
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        self.effect.parameters(values)
    }
}

/// Proposes what acts only in a range: a constant, and growth by the speed.
pub(super) fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Effect, StartValues)) {
    let columns = survey
        .unknown_columns()
        .into_iter()
        .chain(survey.temperature_columns())
        .chain([SPEED_COLUMN, "load_n"]);
    for column in columns {
        let Some(values) = survey.column(column).filter(|values| peak_to_peak(values) > 0.0) else {
            continue;
        };
        let threshold_candidates = threshold_candidates(values);
        let searched = (threshold_candidates.len().max(1) as f64).ln();
        for bound in threshold_candidates
            .into_iter()
            .filter(|bound| count_crossings(values, *bound) >= MIN_CROSSINGS)
        {
            let mut add = |effect: Effect, side: BoundSide| {
                let (effect, column) = (Box::new(effect), column.into());
                let within = RangeLimited { effect, column, side, bound };
                with(
                    Effect::RangeLimited(within),
                    StartValues { searched, ..StartValues::linear_only() },
                );
            };
            let mut level = |times| {
                let form = DependenceForm::Constant { added: 0.0 };
                let level = Dependence { form, times, ..Dependence::from_column(column) };
                add(Effect::Dependence(level), BoundSide::Above);
            };
            level(Multiplier::One);
            if survey.includes_elongation() && peak_to_peak(survey.source_elongation_um()) > 0.0 {
                level(Multiplier::Growth);
            }
            if survey.includes_elongation() && survey.is_varying(SPEED_COLUMN) {
                let growth = || Effect::CentrifugalGrowth(CentrifugalGrowth { um_per_krpm2: 0.0 });
                add(growth(), BoundSide::Above);
                add(growth(), BoundSide::Below);
            }
        }
    }
}

/// Returns how often the values pass a bound.
fn count_crossings(values: &[f64], bound: f64) -> usize {
    let mut sides = values.iter().filter(|value| value.is_finite()).map(|value| *value > bound);
    let Some(mut side) = sides.next() else { return 0 };
    sides.filter(|next| std::mem::replace(&mut side, *next) != *next).count()
}

/// Returns where a range may begin: between the values of a column that has few, else at equal shares of the rows.
fn threshold_candidates(values: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let mut different = sorted.clone();
    different.dedup();
    // A switch is a category.
    if different.len() < 3 {
        return Vec::new();
    }
    let middle = |pair: &[f64]| 0.5 * (pair[0] + pair[1]);
    if different.len() <= MAX_THRESHOLDS + 1 {
        return different.windows(2).map(middle).collect();
    }
    let at = |n: usize| sorted[n * (sorted.len() - 1) / (MAX_THRESHOLDS + 1)];
    let mut threshold_candidates: Vec<f64> = (1..=MAX_THRESHOLDS)
        .filter_map(|n| {
            let next = different.partition_point(|value| *value <= at(n));
            Some(0.5 * (different.get(next - 1)? + different.get(next)?))
        })
        .collect();
    threshold_candidates.dedup();
    threshold_candidates
}

#[cfg(test)]
mod tests {
    //! At rows worked out by hand.

    use super::*;

    /// 0.02 µm × 144 at 12,000 r/min, nothing at 10,000.
    #[test]
    fn a_law_in_a_range_adds_nothing_outside_it() {
        let growth = CentrifugalGrowth { um_per_krpm2: 0.02 };
        let effect = Box::new(Effect::CentrifugalGrowth(growth));
        let within = RangeLimited {
            effect,
            column: SPEED_COLUMN.into(),
            side: BoundSide::Above,
            bound: 10_500.0,
        };
        let at =
            |within: &RangeLimited, rpm: f64| within.evaluate_at(&within.values(), &[rpm, rpm]);
        assert!((at(&within, 12_000.0) - 2.88).abs() < 1e-12);
        assert_eq!(at(&within, 10_000.0), 0.0);
        assert!(at(&within, f64::NAN).is_nan(), "on which side it was is not known");
        let below = RangeLimited { side: BoundSide::Below, ..within };
        assert!((at(&below, 10_000.0) - 2.0).abs() < 1e-12);
        assert_eq!(at(&below, 12_000.0), 0.0);
    }

    #[test]
    fn a_range_begins_between_two_values_that_differ() {
        assert_eq!(threshold_candidates(&[0.0, 1.0, 0.0, 1.0]), [0.0; 0], "a switch is a category");
        assert_eq!(threshold_candidates(&[0.0, 8000.0, 12_000.0, 8000.0]), [4000.0, 10_000.0]);
        let many: Vec<f64> = (0..101).map(f64::from).collect();
        assert_eq!(
            threshold_candidates(&many),
            [10.5, 20.5, 30.5, 40.5, 50.5, 60.5, 70.5, 80.5, 90.5]
        );
    }
}
