//! `dependence`: an error that depends on a recorded input by no law that has a physical name.
//!
//! ```text
//! level   p + aₖ·f where the column is level k           an unseen level adds `level_default`, else 0;
//!                                                        a switch (0, 1) may act behind a lag
//! line    p + c·(x − x₀)·f                                goes on outside the fitted range
//! hinge   p + c·max(0, x − from)·f                        goes on outside the fitted range
//! f       1, (n/1000)², P/1000 of the own axis, the growth by the sensor's own law (elongation only), or y − y₀ of a
//!         second column, a temperature or the load
//! ```
//!
//! x is the value of a column that no other cause reads: a pressure, a flow, a switch, a tool number. The CNC
//! sends a board the tool and its switches: levels of these are compensated ([`Form::Level`]). What no board
//! reads explains and is not compensated.

use super::{
    page::{
        Definition, Entry, Home, Input, Nonlinear, OnBoard, Page, Parameter, Times, Value, number,
    },
    survey::{Settings, Survey, spread},
};
use crate::{
    file::{LinearAxis, Tools, read::Section, spindle::ElongationSource},
    tool::TOOL_COLUMN,
    location::BadInput,
};
use board::{Levels, by_category, levels_of};
use times::LOAD;
use values::{SWITCH, bends, first, levels, tools, zero_of};

mod board;
mod times;
mod values;

/// How the error depends on the column.
#[derive(Clone, Debug, PartialEq)]
pub enum Form {
    /// A value for each level; where f is 1 the first level adds nothing.
    Level {
        /// Values of the column.
        levels: Vec<f64>,
        /// a of each level.
        added: Vec<f64>,
        /// a of every other value.
        otherwise: f64,
        /// Time constant in s by which a switch acts; 0 of all else.
        lag_s: f64,
    },
    /// Proportional to the column.
    Line {
        /// c.
        slope: f64,
        /// x₀, in the column's unit.
        reference: f64,
    },
    /// Proportional to the column from a value on.
    Hinge {
        /// c.
        slope: f64,
        /// In the column's unit.
        from: f64,
        /// Range of `from` in a search.
        range: [f64; 2],
    },
}

/// A dependence on a column.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// The column.
    pub column: String,
    /// How the error depends on it.
    pub form: Form,
    /// What the dependence is multiplied by.
    pub times: Times,
}

impl Dependence {
    /// The name of the form in files.
    #[must_use]
    pub fn form_name(&self) -> &'static str {
        match self.form {
            Form::Level { .. } => "level",
            Form::Line { .. } => "line",
            Form::Hinge { .. } => "hinge",
        }
    }

    /// Puts the numbers of `[spindle.tools]` in the place of labels: a term that was found before its label had a number
    /// holds for that tool from then on.
    pub(crate) fn number_labels(&mut self, tools: &Tools) {
        let Form::Level { levels, .. } = &mut self.form else { return };
        for level in levels.iter_mut().filter(|_| self.column == TOOL_COLUMN) {
            let numbered = tools.codes().find(|(code, _)| code == level);
            *level = numbered.map_or(*level, |(_, number)| number.into());
        }
    }

    /// How many levels, from the first on, have no amplitude: a constant could not be told from theirs.
    fn without_amplitude(&self) -> usize {
        usize::from(self.times == Times::One)
    }

    /// Returns a at this value of the column.
    fn level(&self, value: f64) -> f64 {
        let Form::Level { levels, added, otherwise, .. } = &self.form else { return 0.0 };
        let found = levels.iter().zip(added).find(|(level, _)| **level == value);
        found.map_or(*otherwise, |(_, added)| *added)
    }

    /// Returns what it is on a board, if a board runs it.
    fn by_category(&self) -> Option<OnBoard> {
        let Form::Level { levels, otherwise, lag_s, .. } = &self.form else { return None };
        let of = |level: f64| (level, self.level(level));
        by_category(&self.column, &self.times, levels, of, [*otherwise, *lag_s])
    }

    fn factor(&self, x: &[f64]) -> f64 {
        match (&self.times, x.get(1)) {
            (Times::Speed2, Some(rpm)) => (rpm / 1000.0).powi(2),
            (Times::Position, Some(mm)) => mm / 1000.0,
            (Times::Growth, Some(um)) => *um,
            (Times::Column { reference, .. }, Some(value)) => value - reference,
            _ => 1.0,
        }
    }
}

impl Page for Dependence {
    fn entries(&self) -> Vec<Entry> {
        let [slope_key, level_key] = self.times.keys();
        let mut entries = vec![
            ("column", Value::Text(self.column.clone())),
            ("form", Value::Text(self.form_name().into())),
        ];
        entries.extend(self.times.name().map(|name| ("times", Value::Text(name.into()))));
        if let Times::Column { reference, .. } = self.times {
            entries.push(("times_reference", Value::Number(reference)));
        }
        match &self.form {
            Form::Level { levels, added, otherwise, lag_s } => {
                entries.push(("levels", Value::Numbers(levels.clone())));
                entries.push((level_key, Value::Numbers(added.clone())));
                for (key, value) in [("level_default", *otherwise), ("lag_s", *lag_s)] {
                    entries.extend((value != 0.0).then_some((key, Value::Number(value))));
                }
            }
            Form::Line { slope, reference } => {
                entries.push((slope_key, Value::Number(*slope)));
                entries.push(("reference", Value::Number(*reference)));
            }
            Form::Hinge { slope, from, .. } => {
                entries.push((slope_key, Value::Number(*slope)));
                entries.push(("from", Value::Number(*from)));
            }
        }
        entries
    }

    fn home(&self) -> Home {
        match self.times {
            Times::Growth => Home::Elongation,
            Times::Position => Home::Axis,
            Times::One | Times::Speed2 | Times::Column { .. } => Home::Any,
        }
    }

    fn is_compensated(&self) -> bool {
        self.by_category().is_some()
    }

    fn on_board(&self) -> Vec<OnBoard> {
        self.by_category().into_iter().collect()
    }

    fn tier(&self) -> u8 {
        1
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        let first = match self.form {
            Form::Level { lag_s, .. } if lag_s != 0.0 => {
                Input::Switch { column: &self.column, lag_s }
            }
            _ => Input::Column(&self.column),
        };
        let mut inputs = vec![first];
        inputs.extend(self.times.input());
        inputs
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        if matches!(self.form, Form::Hinge { .. }) { &[Nonlinear::Bend] } else { &[] }
    }

    fn nonlinear_limits(&self) -> Option<[f64; 2]> {
        match self.form {
            Form::Hinge { range, .. } => Some(range),
            _ => None,
        }
    }

    fn amplitudes(&self) -> usize {
        match &self.form {
            Form::Level { levels, .. } => levels.len() - self.without_amplitude(),
            Form::Line { .. } | Form::Hinge { .. } => 1,
        }
    }

    fn values(&self) -> Vec<f64> {
        match &self.form {
            Form::Level { added, .. } => added[self.without_amplitude()..].to_vec(),
            Form::Line { slope, .. } => vec![*slope],
            Form::Hinge { slope, from, .. } => vec![*from, *slope],
        }
    }

    fn set(&mut self, values: &[f64]) {
        let first = self.without_amplitude();
        match &mut self.form {
            Form::Level { added, .. } => {
                added.iter_mut().skip(first).zip(values).for_each(|(added, value)| *added = *value);
            }
            Form::Line { slope, .. } => *slope = values[0],
            Form::Hinge { slope, from, .. } => {
                if let [at, value] = *values {
                    (*from, *slope) = (at, value);
                } else {
                    *slope = values[values.len() - 1];
                }
            }
        }
    }

    /// The zero of a line, or of a category, is arbitrary: of a pressure or of a tool it is not known where it
    /// adds nothing. A switch that is off adds nothing, and a hinge nothing below its bend.
    fn has_reference(&self) -> bool {
        let is_arbitrary = match &self.form {
            Form::Level { levels, .. } => *levels != SWITCH,
            Form::Line { .. } => true,
            Form::Hinge { .. } => false,
        };
        is_arbitrary && self.times == Times::One
    }

    fn sentence(&self, values: &[f64]) -> String {
        let mut found = self.clone();
        found.set(values);
        let (column, unit) = (&self.column, self.times.unit());
        let how = match &found.form {
            Form::Level { levels, added, .. } => {
                let each = levels.iter().zip(added).skip(self.without_amplitude());
                let each: Vec<String> = each
                    .map(|(level, added)| format!("{added:+.3}{unit} at {column} = {level}"))
                    .collect();
                let against = match self.times {
                    Times::One => format!(", compared with {}", levels[0]),
                    _ => String::new(),
                };
                each.join(", ") + &against
            }
            Form::Line { slope, .. } => format!("{slope:+.4}{unit} for each unit of {column}"),
            Form::Hinge { slope, from, .. } => {
                format!("{slope:+.4}{unit} for each unit of {column} above {from:.4}")
            }
        };
        format!("The error depends on {column}: {how}. No physical law with a name fits.")
    }

    fn next_test(&self) -> &'static str {
        "Change this column alone, twice, with all else at rest, and read before and after each change."
    }

    fn parameters(&self, values: &[f64]) -> Vec<Parameter> {
        let [slope_key, level_key] = self.times.keys();
        match &self.form {
            Form::Level { levels, .. } => {
                let mut added = vec![0.0; self.without_amplitude()];
                added.extend_from_slice(values);
                let record = vec![
                    ("levels", Some(Value::Numbers(levels.clone()))),
                    (level_key, Some(Value::Numbers(added))),
                ];
                vec![Parameter::Record(level_key, record)]
            }
            Form::Line { reference, .. } => vec![
                Parameter::Fitted(slope_key, 0, 0.0),
                Parameter::Fixed("reference", *reference),
            ],
            Form::Hinge { .. } => {
                vec![Parameter::Fitted(slope_key, 1, 0.0), Parameter::Fitted("from", 0, 0.0)]
            }
        }
    }
}

impl Definition for Dependence {
    const NAME: &'static str = "dependence";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[
            "column",
            "form",
            "times",
            "levels",
            "level_um",
            "level_um_per_krpm2",
            "level_factor",
            "level_um_per_m",
            "level_um_per_unit",
            "um_per_unit",
            "um_per_unit_per_krpm2",
            "factor_per_unit",
            "um_per_unit_per_m",
            "um_per_unit_per_unit",
            "times_reference",
            "level_default",
            "lag_s",
            "reference",
            "from",
        ]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        let column = section.required("column", section.text("column")?)?.to_string();
        let times = match section.text("times")? {
            None => Times::One,
            Some(name) => match Times::ALL.into_iter().find(|(known, _)| *known == name) {
                Some((_, times)) => times,
                None => Times::Column {
                    column: name.into(),
                    reference: section.number("times_reference")?.unwrap_or(0.0),
                },
            },
        };
        let [slope_key, level_key] = times.keys();
        const FORMS: [(&str, u8); 3] = [("level", 0), ("line", 1), ("hinge", 2)];
        let form = match section.required("form", section.choice("form", &FORMS)?)? {
            0 => {
                let levels = section.required("levels", section.numbers("levels")?)?;
                let added = section.required(level_key, section.numbers(level_key)?)?;
                let is_repeated = |n: usize| levels[..n].contains(&levels[n]);
                if levels.len() < 2 || (0..levels.len()).any(is_repeated) {
                    return Err(section.bad("levels", "takes at least two different values"));
                }
                if added.len() != levels.len() {
                    return Err(section.bad(level_key, "takes a value for each of levels"));
                }
                if times == Times::One && added[0] != 0.0 {
                    let rule = "begins with 0: the first of levels adds nothing";
                    return Err(section.bad(level_key, rule));
                }
                let lag_s = section.not_negative("lag_s")?.unwrap_or(0.0);
                if lag_s != 0.0 && !levels.iter().all(|level| SWITCH.contains(level)) {
                    let rule = "belongs to levels of 0 and 1: a condition that acts behind a lag";
                    return Err(section.bad("lag_s", rule));
                }
                let otherwise = section.number("level_default")?.unwrap_or(0.0);
                Form::Level { levels, added, otherwise, lag_s }
            }
            1 => Form::Line {
                slope: number(section, slope_key)?,
                reference: section.number("reference")?.unwrap_or(0.0),
            },
            _ => {
                let from = number(section, "from")?;
                Form::Hinge { slope: number(section, slope_key)?, from, range: [from; 2] }
            }
        };
        Ok(Self { column, form, times })
    }

    fn law(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let factor = self.factor(x);
        match &self.form {
            Form::Level { levels, otherwise, lag_s, .. } => {
                // Which level a missing value is, is not known.
                if x[0].is_nan() {
                    add(0, f64::NAN);
                }
                let first = self.without_amplitude();
                if *lag_s != 0.0 {
                    // On its way from off to on.
                    for (number, level) in levels.iter().enumerate().skip(first) {
                        let share = if *level == 0.0 { 1.0 - x[0] } else { x[0] };
                        add(number - first, share * factor);
                    }
                    return;
                }
                match levels.iter().position(|level| *level == x[0]) {
                    Some(number) if number >= first => add(number - first, factor),
                    // What is no amplitude is added as it is.
                    None if *otherwise != 0.0 => add(usize::MAX, otherwise * factor),
                    _ => {}
                }
            }
            Form::Line { reference, .. } => add(0, (x[0] - reference) * factor),
            Form::Hinge { from, .. } => {
                let from = nonlinear.first().copied().unwrap_or(*from);
                let above = x[0] - from;
                // A missing value stays one.
                add(0, if above < 0.0 { 0.0 } else { above } * factor);
            }
        }
    }

    fn from_board(_: Option<LinearAxis>, form: &OnBoard, _: &mut f64) -> Option<Self> {
        let Levels { column, levels, added, otherwise, lag_s, times } = levels_of(form)?;
        Some(Self { column, form: Form::Level { levels, added, otherwise, lag_s }, times })
    }

    fn propose(survey: &dyn Survey, with: &mut dyn FnMut(Self, Settings)) {
        let mut times = vec![Times::One];
        if survey.varies("spindle_rpm") {
            times.push(Times::Speed2);
        }
        let is_sensed = survey.source() == Some(ElongationSource::Sensor);
        if is_sensed && survey.quantity().axis().is_none() && spread(survey.law()) > 0.0 {
            times.push(Times::Growth);
        }
        if survey.moves() {
            times.push(Times::Position);
        }
        let all: Vec<(&str, &[f64])> =
            survey.others().into_iter().filter_map(|name| varying(survey, name)).collect();
        let known = survey.temperatures().into_iter().chain([LOAD]);
        let known: Vec<(&str, &[f64])> = known.filter_map(|name| varying(survey, name)).collect();
        for (number, &(column, values)) in all.iter().enumerate() {
            let levels = if column == TOOL_COLUMN { tools(values) } else { levels(values) };
            // A product is the same the other way round; a category is never the second factor.
            let later = all.iter().enumerate().filter(|(n, (_, values))| {
                (levels.is_some() && *n != number || *n > number) && self::levels(values).is_none()
            });
            let second = known.iter().chain(later.map(|(_, it)| it)).map(|(name, values)| {
                Times::Column { column: (*name).into(), reference: zero_of(values) }
            });
            for times in times.iter().cloned().chain(second) {
                let is_alone = times == Times::One;
                let is_second = times.column().is_some();
                let mut propose = |form, settings| {
                    with(Self { column: column.into(), form, times: times.clone() }, settings);
                };
                if levels.is_some() {
                    // A tool that never turned says nothing of what it does at speed.
                    let acting = acting(survey, values, &times);
                    let levels = if column == TOOL_COLUMN { tools(&acting) } else { self::levels(&acting) };
                    let Some(levels) = levels else { continue };
                    let added = vec![0.0; levels.len()];
                    let form = Form::Level { levels, added, otherwise: 0.0, lag_s: 0.0 };
                    propose(form, Settings::none());
                    continue;
                }
                // The number of a tool is no amount.
                if column == TOOL_COLUMN {
                    continue;
                }
                let reference = if is_alone { first(values) } else { zero_of(values) };
                propose(Form::Line { slope: 0.0, reference }, Settings::none());
                let bends = bends(values);
                if let [low, .., high] = bends[..]
                    && !is_second
                {
                    let hinge = Form::Hinge { slope: 0.0, from: low, range: [low, high] };
                    propose(hinge, Settings::at(bends));
                }
            }
        }
    }
}

/// The values of a column in the rows in which what it is multiplied by is not 0.
fn acting(survey: &dyn Survey, values: &[f64], times: &Times) -> Vec<f64> {
    let factor = match times {
        Times::Speed2 => survey.column("spindle_rpm"),
        Times::Growth => Some(survey.law()),
        _ => None,
    };
    let acts = |row: usize| factor.is_none_or(|factor| factor[row] != 0.0);
    values.iter().enumerate().filter(|(row, _)| acts(*row)).map(|(_, value)| *value).collect()
}

/// A column that has different values.
fn varying<'s>(survey: &'s dyn Survey, name: &'s str) -> Option<(&'s str, &'s [f64])> {
    survey.column(name).filter(|values| spread(values) > 0.0).map(|values| (name, values))
}

#[cfg(test)]
mod tests;
