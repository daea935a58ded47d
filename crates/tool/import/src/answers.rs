//! Questions about a file that only the user can answer, and the answers from flags, a terminal or a map of headers.

use trueup_machine::{InputFileError, Location};
use trueup_output::escape::shell_quote;

use crate::{number::DecimalSeparator, timestamp::DateOrder};

/// The circle of a table that has angles alone.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleGeometry {
    /// The commanded radius.
    pub radius_mm: f64,
    /// The commanded centre along both axes.
    pub centre_mm: [f64; 2],
    /// The axes of the plane, the angle counted from the first to the second: `['x', 'y']`.
    pub axes: [char; 2],
    /// Whether the whole table was measured clockwise; `None`: the order of its rows says it.
    pub is_clockwise: Option<bool>,
}

/// The user's answers about a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportAnswers {
    /// The sign before the decimals.
    pub decimal: Option<DecimalSeparator>,
    /// The order of the numbers of a date.
    pub date: Option<DateOrder>,
    /// Column and unit. A column is named by its header, its number from 1, or its name in the run file.
    pub units: Vec<(String, String)>,
    /// Column and name in the run file; `-` leaves it out.
    pub columns: Vec<(String, String)>,
    /// Columns whose sign is turned.
    pub negate: Vec<String>,
    /// The label of the encoding.
    pub encoding: Option<String>,
    /// The sheet of a workbook.
    pub sheet: Option<String>,
    /// Counts of the sensor for one volt.
    pub counts_per_v: Option<f64>,
    /// A step of an hour is a change to or from summer time.
    pub summer_time: Option<bool>,
    /// Every second run of the file goes back.
    pub there_and_back: Option<bool>,
    /// The circle of a table of angles.
    pub circle: Option<CircleGeometry>,
    /// Columns that a map names: a file of its kind need not have them.
    pub of_map: Vec<String>,
}

/// The topic of a question.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum QuestionTopic {
    /// The sign before the decimals.
    Decimal,
    /// The order of the numbers of a date.
    Date,
    /// The unit of this column.
    Unit(String),
    /// The name of this column in the run file.
    Column(String),
    /// The sheet of a workbook.
    Sheet,
    /// Counts of the sensor for one volt.
    CountsPerV,
    /// Whether a step of an hour is summer time.
    SummerTime,
    /// Whether every second run goes back.
    Runs,
}

/// A question that the file leaves open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Question {
    /// Where it arises.
    pub place: Location,
    /// The question, a sentence without its stop.
    pub text: String,
    /// Its topic.
    pub topic: QuestionTopic,
    /// Values that may be given.
    pub choices: Vec<String>,
    /// Other values than the choices may be given.
    pub is_open: bool,
}

impl Question {
    /// Returns the flag that answers it, with its first choice and the others in brackets.
    #[must_use]
    pub fn flag(&self) -> String {
        let first = self.choices.first().map_or("N", String::as_str);
        let others = self.choices.get(1..).unwrap_or_default();
        let others =
            if others.is_empty() { String::new() } else { format!(" (or {})", others.join(", ")) };
        let value = match &self.topic {
            QuestionTopic::Decimal => format!("--decimal {first}"),
            QuestionTopic::Date => format!("--date {first}"),
            QuestionTopic::Unit(column) => format!("--unit {}", quoted_assignment(column, first)),
            QuestionTopic::Column(column) => {
                format!("--column {}", quoted_assignment(column, first))
            }
            QuestionTopic::Sheet => format!("--sheet {}", shell_quote(first)),
            QuestionTopic::CountsPerV => {
                "--counts-per-v N, or --machine M.toml, which has the input's scale".into()
            }
            QuestionTopic::SummerTime => format!("--summer-time {first}"),
            QuestionTopic::Runs => format!("--runs {first}"),
        };
        value + &others
    }

    /// Returns the question as an error of the file.
    #[must_use]
    pub fn into_error(self) -> InputFileError {
        let help = format!("Add {}", self.flag());
        InputFileError::new(self.place, self.text).with_help(help)
    }
}

fn quoted_assignment(column: &str, value: &str) -> String {
    shell_quote(&format!("{column}={value}"))
}

impl DecimalSeparator {
    /// Returns the sign of this name.
    #[must_use]
    pub(crate) fn from_name(name: &str) -> Option<Self> {
        match name {
            "comma" | "," => Some(Self::Comma),
            "point" | "." => Some(Self::Point),
            _ => None,
        }
    }

    /// Returns its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Comma => "comma",
            Self::Point => "point",
        }
    }
}

impl DateOrder {
    /// Returns the order of this name.
    #[must_use]
    pub(crate) fn from_name(name: &str) -> Option<Self> {
        [Self::DayMonth, Self::MonthDay, Self::Year].into_iter().find(|order| order.name() == name)
    }

    /// Returns its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::DayMonth => "dmy",
            Self::MonthDay => "mdy",
            Self::Year => "ymd",
        }
    }
}

impl ImportAnswers {
    /// Takes `value` as the answer to a question about `topic`.
    ///
    /// # Errors
    /// The value is none that answers it.
    pub fn record_answer(&mut self, topic: &QuestionTopic, value: &str) -> Result<(), String> {
        let value = value.trim();
        let wrong = |rule: &str| format!("must be {rule}, not {value}");
        match topic {
            QuestionTopic::Decimal => {
                self.decimal = Some(
                    DecimalSeparator::from_name(value).ok_or_else(|| wrong("comma or point"))?,
                )
            }
            QuestionTopic::Date => {
                self.date =
                    Some(DateOrder::from_name(value).ok_or_else(|| wrong("dmy, mdy or ymd"))?)
            }
            QuestionTopic::Unit(column) => {
                if crate::unit::parse(value).is_none()
                    && !crate::column_meaning::is_clock_format(value)
                {
                    return Err(wrong("a unit, such as mm, µm, inch, °C, °F, K, s, min"));
                }
                self.units.push((column.clone(), value.into()));
            }
            QuestionTopic::Column(column) => self.columns.push((column.clone(), value.into())),
            QuestionTopic::Sheet => self.sheet = Some(value.into()),
            QuestionTopic::CountsPerV => {
                let number =
                    value.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0);
                self.counts_per_v = Some(number.ok_or_else(|| wrong("a number above 0"))?);
            }
            QuestionTopic::SummerTime => match value {
                "yes" => self.summer_time = Some(true),
                "no" => self.summer_time = Some(false),
                _ => return Err(wrong("yes or no")),
            },
            QuestionTopic::Runs => match value {
                "one-way" => self.there_and_back = Some(false),
                "there-and-back" => self.there_and_back = Some(true),
                _ => return Err(wrong("one-way or there-and-back")),
            },
        }
        Ok(())
    }

    /// Returns these answers, and for what they leave open those of `other`.
    #[must_use]
    pub fn merge(mut self, other: Self) -> Self {
        self.decimal = self.decimal.or(other.decimal);
        self.date = self.date.or(other.date);
        self.units.extend(other.units);
        self.columns.extend(other.columns);
        self.negate.extend(other.negate);
        self.of_map.extend(other.of_map);
        self.encoding = self.encoding.or(other.encoding);
        self.sheet = self.sheet.or(other.sheet);
        self.counts_per_v = self.counts_per_v.or(other.counts_per_v);
        self.summer_time = self.summer_time.or(other.summer_time);
        self.there_and_back = self.there_and_back.or(other.there_and_back);
        self.circle = self.circle.or(other.circle);
        self
    }
}

/// Why a file was not read.
#[derive(Clone, Debug, PartialEq)]
pub enum ImportError {
    /// It breaks a rule.
    Bad(InputFileError),
    /// These questions are open, at least one.
    Open(Vec<Question>),
}

impl From<InputFileError> for ImportError {
    fn from(error: InputFileError) -> Self {
        Self::Bad(error)
    }
}
