//! `dependence`: an error that depends on a recorded input by no law that has a physical name.
//!
//! ```text
//! level   p + aₖ·f where x is level k                    an unseen level adds `level_default`, else 0
//! line    p + c·(x − x₀)·f                                goes on outside the fitted range
//! hinge   p + c·max(0, x − from)·f                        goes on outside the fitted range
//! curve   p + straight lines through (atₖ, aₖ)            holds its end values
//! x       a column, or the difference of two temperatures; of a switch (0, 1) and of a line behind a lag
//! f       1, (n/1000)², P/1000 of the own axis, the growth by the sensor's own law (elongation only), or y − y₀ of a
//!         second column, a temperature or the load
//! ```
//!
//! The column is one that no other cause reads: a pressure, a flow, a switch, a tool number; of a hinge, a curve or a
//! difference also a temperature. The CNC sends a board the tool and its switches: levels of these are compensated
//! ([`DependenceForm::Level`]), and so is a difference, as heat of two thermometers. All else explains and is not compensated.

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, Multiplier, NonlinearParameter, PhysicalLaw, Target,
        TermEntry, Value, format_duration,
    },
    data_view::{DataView, StartValues},
};
use crate::{
    keys::{
        plausible_range::{PlausibleRange, USER_UNIT_RANGE},
        reader::{Section, is_temperature_column},
        term::{
            AT, COLUMN, CONSTANT_UM, CURVE_UM, FORM, FROM, LAG_S, LEVEL_DEFAULT, LEVELS, MINUS,
            REFERENCE, TIMES, TIMES_REFERENCE,
        },
    },
    location::InputFileError,
    sections::{LinearAxis, ToolGrowthList},
    tool_column::TOOL_COLUMN,
};
use column_values::SWITCH_LEVELS;
use multiplier::LOAD_COLUMN;
pub(super) use multiplier::SPEED_COLUMN;
use proposal::propose;
use reader::read;

mod board_terms;
mod column_values;
mod multiplier;
mod proposal;
mod reader;

/// How the error depends on the column.
#[derive(Clone, Debug, PartialEq)]
pub enum DependenceForm {
    /// A value for each level; where f is 1 the first level adds nothing.
    Level {
        /// Values of the column.
        levels: Vec<f64>,
        /// a of each level.
        added: Vec<f64>,
        /// a of every other value.
        otherwise: f64,
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
    /// The same everywhere, in a range of the column ([`RangeLimited`](crate::effect::RangeLimited)).
    Constant {
        /// a, in µm.
        added: f64,
    },
    /// A value at some places, straight lines between them; the first adds nothing.
    Curve {
        /// Values of the column, rising.
        at: Vec<f64>,
        /// a there, in µm.
        added: Vec<f64>,
    },
}

/// A dependence on a column.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// The column.
    pub column: String,
    /// The column that is taken away from it: the other one of two temperatures.
    pub minus: Option<String>,
    /// Time constant in s by which it acts; 0: at once.
    pub lag_s: f64,
    /// How the error depends on it.
    pub form: DependenceForm,
    /// The factor that the dependence is multiplied by.
    pub times: Multiplier,
}

impl Dependence {
    /// Returns a line over a column that adds nothing.
    pub(super) fn from_column(column: &str) -> Self {
        let form = DependenceForm::Line { slope: 0.0, reference: 0.0 };
        Self { column: column.into(), minus: None, lag_s: 0.0, form, times: Multiplier::One }
    }

    /// Returns the name of the form in files.
    #[must_use]
    pub fn form_name(&self) -> &'static str {
        match self.form {
            DependenceForm::Level { .. } | DependenceForm::Constant { .. } => "level",
            DependenceForm::Line { .. } => "line",
            DependenceForm::Hinge { .. } => "hinge",
            DependenceForm::Curve { .. } => "curve",
        }
    }

    /// Returns whether it takes two inputs together, or bends or lags behind one so that it imitates other laws.
    pub(super) fn is_flexible(&self) -> bool {
        let has_laws = self.column == SPEED_COLUMN || is_temperature_column(&self.column);
        let is_late_line = self.has_lag() && matches!(self.form, DependenceForm::Line { .. });
        self.minus.is_some() || has_laws || is_late_line
    }

    fn has_lag(&self) -> bool {
        self.lag_s != 0.0
    }

    /// Returns its nonlinear value, but for that of a hinge.
    fn nonlinear_value(&self) -> Option<f64> {
        match self.times {
            Multiplier::Column { reference, .. }
                if self.times.fitted_reference_range().is_some() =>
            {
                Some(reference)
            }
            _ => self.has_lag().then_some(self.lag_s),
        }
    }

    /// Returns what is read of a column that it depends on.
    fn column_input<'a>(&self, column: &'a str, lag_s: f64) -> LawInput<'a> {
        match (column, lag_s) {
            (SPEED_COLUMN, _) => LawInput::Speed,
            (LOAD_COLUMN, _) => LawInput::Load,
            _ if is_temperature_column(column) => LawInput::Temperature { column, lag_s },
            (_, 0.0) => LawInput::Column(column),
            _ => LawInput::Lagged { column, lag_s },
        }
    }

    /// Puts the numbers of `[spindle.tools]` in the place of labels: a term that was found before its label had a number
    /// holds for that tool from then on.
    pub(crate) fn resolve_tool_labels(&mut self, tools: &ToolGrowthList) {
        let DependenceForm::Level { levels, .. } = &mut self.form else { return };
        for level in levels.iter_mut().filter(|_| self.column == TOOL_COLUMN) {
            let numbered = tools.numbered_label_codes().find(|(code, _)| code == level);
            *level = numbered.map_or(*level, |(_, number)| number.into());
        }
    }

    /// Returns how many levels, from the first on, have no amplitude: a constant could not be distinguished from theirs.
    fn reference_level_count(&self) -> usize {
        usize::from(self.times == Multiplier::One)
    }

    fn multiplier_value(&self, nonlinear: &[f64], x: Option<&f64>) -> f64 {
        match (&self.times, x) {
            (Multiplier::Speed2, Some(rpm)) => (rpm / 1000.0).powi(2),
            (Multiplier::Position, Some(mm)) => mm / 1000.0,
            (Multiplier::Growth, Some(um)) => *um,
            (Multiplier::Column { reference, range, .. }, Some(value)) => {
                let fitted = nonlinear.first().filter(|_| range[0] < range[1]);
                value - fitted.unwrap_or(reference)
            }
            _ => 1.0,
        }
    }
}

impl FileRepresentation for Dependence {
    const NAME: &'static str = "dependence";

    fn range_override(key: &str) -> Option<PlausibleRange> {
        (key == CONSTANT_UM.name).then_some(USER_UNIT_RANGE)
    }

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        reader::DEPENDENCE_KEYS
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        read(section)
    }

    fn entries(&self) -> Vec<TermEntry> {
        let [slope_key, level_key] = self.times.keys();
        let mut entries = vec![
            (COLUMN.name, Value::Text(self.column.clone())),
            (FORM.name, Value::Text(self.form_name().into())),
        ];
        entries.extend(self.minus.clone().map(|column| (MINUS.name, Value::Text(column))));
        entries.extend(self.times.name().map(|name| (TIMES.name, Value::Text(name.into()))));
        if let Multiplier::Column { reference, .. } = self.times {
            entries.push((TIMES_REFERENCE.name, Value::Number(reference)));
        }
        match &self.form {
            DependenceForm::Level { levels, added, otherwise } => {
                entries.push((LEVELS.name, Value::Numbers(levels.clone())));
                entries.push((level_key.name, Value::Numbers(added.clone())));
                let other = (LEVEL_DEFAULT.name, Value::Number(*otherwise));
                entries.extend((*otherwise != 0.0).then_some(other));
            }
            DependenceForm::Line { slope, reference } => {
                entries.push((slope_key.name, Value::Number(*slope)));
                entries.push((REFERENCE.name, Value::Number(*reference)));
            }
            DependenceForm::Hinge { slope, from, .. } => {
                entries.push((slope_key.name, Value::Number(*slope)));
                entries.push((FROM.name, Value::Number(*from)));
            }
            DependenceForm::Constant { added } => {
                entries.push((level_key.name, Value::Numbers(vec![*added])))
            }
            DependenceForm::Curve { at, added } => {
                entries.push((AT.name, Value::Numbers(at.clone())));
                entries.push((CURVE_UM.name, Value::Numbers(added.clone())));
            }
        }
        entries.extend(self.has_lag().then_some((LAG_S.name, Value::Number(self.lag_s))));
        entries
    }
}

impl PhysicalLaw for Dependence {
    fn target(&self) -> Target {
        match self.times {
            Multiplier::Growth => Target::Elongation,
            Multiplier::Position => Target::Axis,
            Multiplier::One | Multiplier::Speed2 | Multiplier::Column { .. } => Target::Any,
        }
    }

    fn inputs(&self, nonlinear: &[f64]) -> Vec<LawInput<'_>> {
        let lag_s = match nonlinear.first() {
            Some(lag_s) if self.has_lag() => *lag_s,
            _ => 0.0,
        };
        let columns = [Some(&self.column), self.minus.as_ref()];
        let mut inputs: Vec<LawInput<'_>> =
            columns.into_iter().flatten().map(|column| self.column_input(column, lag_s)).collect();
        inputs.extend(self.times.input());
        inputs
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let (x, factor) = match self.minus {
            Some(_) => (x[0] - x[1], self.multiplier_value(nonlinear, x.get(2))),
            None => (x[0], self.multiplier_value(nonlinear, x.get(1))),
        };
        match &self.form {
            DependenceForm::Level { levels, otherwise, .. } => {
                // Which level a missing value is, is not known.
                if x.is_nan() {
                    add(0, f64::NAN);
                }
                let first = self.reference_level_count();
                if self.has_lag() {
                    // On its way from off to on.
                    for (number, level) in levels.iter().enumerate().skip(first) {
                        let share = if *level == 0.0 { 1.0 - x } else { x };
                        add(number - first, share * factor);
                    }
                    return;
                }
                match levels.iter().position(|level| *level == x) {
                    Some(number) if number >= first => add(number - first, factor),
                    // What is no amplitude is added unscaled.
                    None if *otherwise != 0.0 => add(usize::MAX, otherwise * factor),
                    _ => {}
                }
            }
            DependenceForm::Line { reference, .. } => add(0, (x - reference) * factor),
            DependenceForm::Hinge { from, .. } => {
                let from = nonlinear.first().copied().unwrap_or(*from);
                let above = x - from;
                // A missing value stays one.
                add(0, if above < 0.0 { 0.0 } else { above } * factor);
            }
            DependenceForm::Constant { .. } => add(0, if x.is_nan() { x } else { 1.0 }),
            DependenceForm::Curve { at, .. } => {
                let above = at.partition_point(|place| *place <= x).clamp(1, at.len() - 1);
                let [low, high] = [at[above - 1], at[above]];
                let share = ((x - low) / (high - low)).clamp(0.0, 1.0);
                if above > 1 {
                    add(above - 2, 1.0 - share);
                }
                add(above - 1, share);
            }
        }
    }
}

impl BoardRepresentation for Dependence {
    fn is_compensable(&self) -> bool {
        !self.board_terms().is_empty()
    }

    fn board_terms(&self) -> Vec<BoardTerm> {
        self.category_term().into_iter().chain(self.heat_terms()).collect()
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        Self::from_board_term(form)
    }
}

impl Candidate for Dependence {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            tier: 1,
            nonlinear: match self.form {
                DependenceForm::Hinge { .. } => &[NonlinearParameter::Bend],
                _ if self.times.fitted_reference_range().is_some() => &[NonlinearParameter::Bend],
                _ if self.has_lag() => &[NonlinearParameter::TimeConstant],
                _ => &[],
            },
            nonlinear_parameter_bounds: match self.form {
                DependenceForm::Hinge { range, .. } => Some(range),
                _ => self.times.fitted_reference_range(),
            },
            amplitudes: match &self.form {
                DependenceForm::Level { levels, .. } => levels.len() - self.reference_level_count(),
                DependenceForm::Line { .. }
                | DependenceForm::Hinge { .. }
                | DependenceForm::Constant { .. } => 1,
                DependenceForm::Curve { at, .. } => at.len() - 1,
            },
            // The zero of a line, or of a category, is arbitrary: of a pressure or of a tool it is not known where it
            // adds nothing. A switch that is off adds nothing, and a hinge nothing below its bend.
            has_reference: {
                let is_arbitrary = match &self.form {
                    DependenceForm::Level { levels, .. } => *levels != SWITCH_LEVELS,
                    DependenceForm::Line { .. } | DependenceForm::Curve { .. } => true,
                    DependenceForm::Hinge { .. } | DependenceForm::Constant { .. } => false,
                };
                is_arbitrary && self.times == Multiplier::One
            },
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        let amplitudes = match &self.form {
            DependenceForm::Level { added, .. } => added[self.reference_level_count()..].to_vec(),
            DependenceForm::Line { slope, .. } => vec![*slope],
            DependenceForm::Hinge { slope, from, .. } => vec![*from, *slope],
            DependenceForm::Constant { added } => vec![*added],
            DependenceForm::Curve { added, .. } => added[1..].to_vec(),
        };
        self.nonlinear_value().into_iter().chain(amplitudes).collect()
    }

    fn set_values(&mut self, values: &[f64]) {
        let first = self.reference_level_count();
        let amplitudes = values.len().saturating_sub(self.fit_spec().amplitudes);
        let values = match self.form {
            DependenceForm::Hinge { .. } => values,
            _ => {
                match (&mut self.times, &values[..amplitudes]) {
                    (Multiplier::Column { reference, range, .. }, [value, ..])
                        if range[0] < range[1] =>
                    {
                        *reference = *value;
                    }
                    (_, [value, ..]) if self.lag_s != 0.0 => self.lag_s = *value,
                    _ => {}
                }
                &values[amplitudes..]
            }
        };
        match &mut self.form {
            DependenceForm::Curve { added, .. } => {
                added.iter_mut().skip(1).zip(values).for_each(|(added, value)| *added = *value);
            }
            DependenceForm::Level { added, .. } => {
                added.iter_mut().skip(first).zip(values).for_each(|(added, value)| *added = *value);
            }
            DependenceForm::Line { slope, .. } => *slope = values[0],
            DependenceForm::Constant { added } => *added = values[0],
            DependenceForm::Hinge { slope, from, .. } => {
                if let [at, value] = *values {
                    (*from, *slope) = (at, value);
                } else {
                    *slope = values[values.len() - 1];
                }
            }
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        propose(survey, with);
    }
}

impl Explanation for Dependence {
    fn describe(&self, values: &[f64]) -> String {
        let mut found = self.clone();
        found.set_values(values);
        let unit = self.times.unit();
        let column = match &self.minus {
            Some(minus) => &format!("{} − {minus}", self.column),
            None => &self.column,
        };
        let how = match &found.form {
            DependenceForm::Level { levels, added, .. } => {
                let each = levels.iter().zip(added).skip(self.reference_level_count());
                let each: Vec<String> = each
                    .map(|(level, added)| format!("{added:+.3}{unit} at {column} = {level}"))
                    .collect();
                let against = match self.times {
                    Multiplier::One => format!(", compared with {}", levels[0]),
                    _ => String::new(),
                };
                each.join(", ") + &against
            }
            DependenceForm::Line { slope, .. } => {
                format!("{slope:+.4}{unit} for each unit of {column}")
            }
            DependenceForm::Hinge { slope, from, .. } => {
                format!("{slope:+.4}{unit} for each unit of {column} above {from:.4}")
            }
            DependenceForm::Constant { added } => format!("{added:+.3}{unit}"),
            DependenceForm::Curve { at, added } => {
                let each = at.iter().zip(added);
                let each: Vec<String> =
                    each.map(|(at, added)| format!("{added:+.2}{unit} at {at:.4}")).collect();
                format!("{}, straight lines between them", each.join(", "))
            }
        };
        let behind = if self.has_lag() {
            format!(", behind a time constant of {}", format_duration(found.lag_s))
        } else {
            String::new()
        };
        format!("The error depends on {column}: {how}{behind}. No physical law with a name fits.")
    }

    fn next_test(&self) -> &'static str {
        "Change this column alone, twice, with all else at rest, and read before and after each change."
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let [slope_key, level_key] = self.times.keys().map(|key| key.name);
        let late = self.fit_spec().nonlinear.len();
        let list = |key, places, at: &Vec<f64>, without| {
            let mut added = vec![0.0; without];
            added.extend_from_slice(&values[late..]);
            let record = vec![
                (places, Some(Value::Numbers(at.clone()))),
                (key, Some(Value::Numbers(added))),
            ];
            vec![FindingParameter::Record(key, record)]
        };
        let mut all = match &self.form {
            DependenceForm::Level { levels, .. } => {
                list(level_key, "levels", levels, self.reference_level_count())
            }
            DependenceForm::Curve { at, .. } => list("curve_um", "at", at, 1),
            DependenceForm::Constant { .. } => vec![FindingParameter::Fitted(level_key, 0, 0.0)],
            DependenceForm::Line { reference, .. } => vec![
                FindingParameter::Fitted(slope_key, late, 0.0),
                FindingParameter::Fixed("reference", *reference),
            ],
            DependenceForm::Hinge { .. } => {
                vec![
                    FindingParameter::Fitted(slope_key, 1, 0.0),
                    FindingParameter::Fitted("from", 0, 0.0),
                ]
            }
        };
        all.extend(self.has_lag().then_some(FindingParameter::Fitted("lag_s", 0, 0.0)));
        let reference = FindingParameter::Fitted("times_reference", 0, 0.0);
        all.extend(self.times.fitted_reference_range().map(|_| reference));
        all
    }
}

#[cfg(test)]
mod tests;
