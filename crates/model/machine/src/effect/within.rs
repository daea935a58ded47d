//! A cause that acts only where a recorded input is in a range: "only above 10,500 r/min".
//!
//! The term adds what the cause does where the input is in the range, and 0 elsewhere; where the input is missing, so
//! is the sum. The cause keeps its name.

use super::{
    Effect,
    cause_spec::{
        CauseSpec, Entry, Host, Input, Nonlinear, Parameter, Stage, Target, Times, Value,
    },
    data_view::{DataView, StartValues, spread},
    dependence::{Dependence, Form, SPEED},
    law::Columns,
    one_number::CentrifugalGrowth,
};
use crate::file::keys::term::{LEVELS, WHERE_ABOVE, WHERE_BELOW, WHERE_COLUMN};
use crate::{
    file::{
        axis::LinearAxis,
        read::{Section, is_temperature_column},
    },
    location::BadInput,
};

/// Most values of an input at which a range may begin.
const MAX_CUTS: usize = 9;

/// How often an input must pass a bound: in and out three times. A single occurrence is an event of the run.
const MIN_CROSSINGS: usize = 6;

/// Which side of the bound is inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Above it.
    Above,
    /// Below it.
    Below,
}

impl Side {
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
pub struct Within {
    /// The cause; it is only added.
    pub effect: Box<Effect>,
    /// The column whose range it is.
    pub column: String,
    /// Which side of `bound` is inside.
    pub side: Side,
    /// In the column's unit.
    pub bound: f64,
}

impl Within {
    /// Returns `effect`, within the range that `section` states for it, if it does.
    pub(crate) fn read(section: &Section<'_>, effect: Effect) -> Result<Effect, BadInput> {
        let mut sides = [Side::Above, Side::Below].into_iter().filter_map(|side| {
            section.number(side.key()).transpose().map(|bound| bound.map(|bound| (side, bound)))
        });
        let (range, second) = (sides.next().transpose()?, sides.next().transpose()?);
        let column = section.text(WHERE_COLUMN.name)?;
        let is_level =
            matches!(&effect, Effect::Dependence(Dependence { form: Form::Constant { .. }, .. }));
        match (column, range) {
            (None, None) if is_level => {
                Err(section
                    .bad(LEVELS.name, "is missing: a level without levels needs where_column"))
            }
            (None, None) => Ok(effect),
            (None, Some((side, _))) => Err(section.bad(side.key(), "needs where_column")),
            (Some(_), None) => {
                Err(section.bad(WHERE_COLUMN.name, "needs where_above or where_below"))
            }
            (Some(_), Some(_)) if second.is_some() => {
                Err(section
                    .bad(WHERE_BELOW.name, "does not go with where_above: state one of them"))
            }
            (Some(_), Some(_)) if effect.stage() != Stage::Sum => {
                let rule = "belongs to causes that are added: this one changes the model's own law";
                Err(section.bad(WHERE_COLUMN.name, rule))
            }
            (Some(column), Some((side, bound))) => Ok(Effect::Within(Self {
                effect: Box::new(effect),
                column: column.into(),
                side,
                bound,
            })),
        }
    }

    /// Returns what is read of the run for the range.
    fn input(&self) -> Input<'_> {
        let axis =
            LinearAxis::ALL.into_iter().find(|axis| self.column == format!("{}_mm", axis.name()));
        match (&self.column[..], axis) {
            (_, Some(axis)) => Input::Position(axis),
            (SPEED, _) => Input::Speed,
            ("load_n", _) => Input::Load,
            (column, _) if is_temperature_column(column) => {
                Input::Temperature { column, lag_s: 0.0 }
            }
            (column, _) => Input::Column(column),
        }
    }

    /// Returns 1 inside, 0 outside, and NaN where the value is missing.
    fn share(&self, value: f64) -> f64 {
        let is_inside = match self.side {
            Side::Above => value > self.bound,
            Side::Below => value < self.bound,
        };
        match (value.is_nan(), is_inside) {
            (true, _) => f64::NAN,
            (_, true) => 1.0,
            (_, false) => 0.0,
        }
    }

    /// Returns what each amplitude of 1 adds, in µm, row by row.
    pub(super) fn columns(&self, nonlinear: &[f64], source: &dyn Columns) -> Vec<Vec<f64>> {
        let mut columns = self.effect.columns(nonlinear, source);
        columns.iter_mut().for_each(|column| self.mask(column, source));
        columns
    }

    /// Returns what it adds with these values, in µm, row by row.
    pub(super) fn sum(&self, values: &[f64], source: &dyn Columns) -> Vec<f64> {
        let mut sum_um = self.effect.sum(values, source);
        self.mask(&mut sum_um, source);
        sum_um
    }

    fn mask(&self, column_um: &mut [f64], source: &dyn Columns) {
        let values = source.column(&self.input());
        for (um, value) in column_um.iter_mut().zip(values.iter()) {
            // What is missing outside the range is not needed there.
            *um = match self.share(*value) {
                0.0 => 0.0,
                share => *um * share,
            };
        }
    }

    /// Returns what it adds where the inputs are `x`, that of the range last, in µm.
    pub(super) fn at_row(&self, values: &[f64], x: &[f64]) -> f64 {
        let Some((value, x)) = x.split_last() else { return f64::NAN };
        match self.share(*value) {
            0.0 => 0.0,
            share => share * self.effect.at_row(values, x),
        }
    }
}

impl CauseSpec for Within {
    fn entries(&self) -> Vec<Entry> {
        let mut entries = self.effect.entries();
        entries.push((WHERE_COLUMN.name, Value::Text(self.column.clone())));
        entries.push((self.side.key(), Value::Number(self.bound)));
        entries
    }

    fn home(&self) -> Target {
        self.effect.home()
    }

    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        self.effect.refusal(host)
    }

    fn is_compensated(&self) -> bool {
        false
    }

    fn tier(&self) -> u8 {
        1
    }

    fn inputs<'a>(&'a self, nonlinear: &[f64]) -> Vec<Input<'a>> {
        let mut inputs = self.effect.inputs(nonlinear);
        inputs.push(self.input());
        inputs
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        self.effect.nonlinear()
    }

    fn nonlinear_limits(&self) -> Option<[f64; 2]> {
        self.effect.nonlinear_limits()
    }

    fn amplitudes(&self) -> usize {
        self.effect.amplitudes()
    }

    fn amplitude_limits(&self) -> Option<[f64; 2]> {
        self.effect.amplitude_limits()
    }

    fn values(&self) -> Vec<f64> {
        self.effect.values()
    }

    fn set(&mut self, values: &[f64]) {
        self.effect.set(values);
    }

    fn has_reference(&self) -> bool {
        self.effect.has_reference()
    }

    fn sentence(&self, values: &[f64]) -> String {
        let Self { column, side, bound, .. } = self;
        let sentence = self.effect.sentence(values);
        // As many places as any column of a run file has.
        let bound = (bound * 1e6).round() / 1e6;
        format!("{sentence} It acts only where {column} is {} {bound}.", side.name())
    }

    fn next_test(&self) -> &'static str {
        "Measure on both sides of the bound and near it, with all else at rest, twice."
    }

    fn parameters(&self, values: &[f64]) -> Vec<Parameter> {
        self.effect.parameters(values)
    }
}

/// Proposes what acts only in a range: a constant, and growth by the speed.
pub(super) fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Effect, StartValues)) {
    let columns = survey.others().into_iter().chain(survey.temperatures()).chain([SPEED, "load_n"]);
    for column in columns {
        let Some(values) = survey.column(column).filter(|values| spread(values) > 0.0) else {
            continue;
        };
        let cuts = cuts(values);
        let searched = (cuts.len().max(1) as f64).ln();
        for bound in cuts.into_iter().filter(|bound| crossings(values, *bound) >= MIN_CROSSINGS) {
            let mut add = |effect: Effect, side: Side| {
                let (effect, column) = (Box::new(effect), column.into());
                let within = Within { effect, column, side, bound };
                with(Effect::Within(within), StartValues { searched, ..StartValues::none() });
            };
            let mut level = |times| {
                let form = Form::Constant { added: 0.0 };
                let level = Dependence { form, times, ..Dependence::of(column) };
                add(Effect::Dependence(level), Side::Above);
            };
            level(Times::One);
            if survey.grows() && spread(survey.law()) > 0.0 {
                level(Times::Growth);
            }
            if survey.grows() && survey.varies(SPEED) {
                let growth = || Effect::CentrifugalGrowth(CentrifugalGrowth { um_per_krpm2: 0.0 });
                add(growth(), Side::Above);
                add(growth(), Side::Below);
            }
        }
    }
}

/// Returns how often the values pass a bound.
fn crossings(values: &[f64], bound: f64) -> usize {
    let mut sides = values.iter().filter(|value| value.is_finite()).map(|value| *value > bound);
    let Some(mut side) = sides.next() else { return 0 };
    sides.filter(|next| std::mem::replace(&mut side, *next) != *next).count()
}

/// Returns where a range may begin: between the values of a column that has few, else at equal shares of the rows.
fn cuts(values: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let mut different = sorted.clone();
    different.dedup();
    // A switch is a category.
    if different.len() < 3 {
        return Vec::new();
    }
    let middle = |pair: &[f64]| 0.5 * (pair[0] + pair[1]);
    if different.len() <= MAX_CUTS + 1 {
        return different.windows(2).map(middle).collect();
    }
    let at = |n: usize| sorted[n * (sorted.len() - 1) / (MAX_CUTS + 1)];
    let mut cuts: Vec<f64> = (1..=MAX_CUTS)
        .filter_map(|n| {
            let next = different.partition_point(|value| *value <= at(n));
            Some(0.5 * (different.get(next - 1)? + different.get(next)?))
        })
        .collect();
    cuts.dedup();
    cuts
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
        let within = Within { effect, column: SPEED.into(), side: Side::Above, bound: 10_500.0 };
        let at = |within: &Within, rpm: f64| within.at_row(&within.values(), &[rpm, rpm]);
        assert!((at(&within, 12_000.0) - 2.88).abs() < 1e-12);
        assert_eq!(at(&within, 10_000.0), 0.0);
        assert!(at(&within, f64::NAN).is_nan(), "on which side it was is not known");
        let below = Within { side: Side::Below, ..within };
        assert!((at(&below, 10_000.0) - 2.0).abs() < 1e-12);
        assert_eq!(at(&below, 12_000.0), 0.0);
    }

    #[test]
    fn a_range_begins_between_two_values_that_differ() {
        assert_eq!(cuts(&[0.0, 1.0, 0.0, 1.0]), [0.0; 0], "a switch is a category");
        assert_eq!(cuts(&[0.0, 8000.0, 12_000.0, 8000.0]), [4000.0, 10_000.0]);
        let many: Vec<f64> = (0..101).map(f64::from).collect();
        assert_eq!(cuts(&many), [10.5, 20.5, 30.5, 40.5, 50.5, 60.5, 70.5, 80.5, 90.5]);
    }
}
