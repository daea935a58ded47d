//! The role of each column of a table in the run file, or the questions that are open.

mod axis_assignment;
mod disambiguation;

use std::path::Path;

use trueup_machine::{InputFileError, run_file::is_known_column};
use trueup_output::escape::shell_quote;

use crate::{
    answers::{ImportAnswers, ImportError, Question, QuestionTopic},
    cell_kinds::CellCounts,
    column_meaning::{self, ColumnMeaning, ParsedHeader, TargetColumn},
    layout::{SourceColumn, SourceTable},
    unit::{self, Dimension, Unit},
};

/// The role of a column in the run file.
#[derive(Clone, Debug)]
pub(crate) enum ColumnRole {
    /// Numbers in a unit.
    Number { target: TargetColumn, unit: Unit, per_base: f64 },
    /// Numbers as they are.
    Unconverted(TargetColumn),
    /// +1 and −1.
    Direction(TargetColumn),
    /// 1 and 0.
    Switch(TargetColumn),
    /// Moments: dates, times of day, or the date of such times.
    Timestamps { target: TargetColumn, form: String },
    /// A date that belongs to the moments of another column.
    AssociatedDate,
    /// Times as numbers whose size says whether they are Unix time; the unit where it is stated.
    Elapsed { target: TargetColumn, unit: Option<Unit> },
    /// The actual position, from which the error of this name is computed.
    Actual { target: TargetColumn, unit: Unit, position: usize },
    /// Not imported, and why.
    Ignored(&'static str),
}

/// A column with its role.
#[derive(Clone, Debug)]
pub(crate) struct ColumnMapping {
    pub(crate) header: String,
    pub(crate) role: ColumnRole,
    pub(crate) is_negated: bool,
}

/// A column on the way to its role.
struct ColumnInference<'l> {
    source: &'l SourceColumn,
    counts: CellCounts,
    unit_text: String,
    unit: Option<Unit>,
    meaning: ColumnMeaning,
    /// The user has given its name.
    is_named: bool,
}

/// Returns the answer that names this column: by its header, its name without the unit, its number, or its target.
pub(crate) fn find_answer<'a>(
    answers: &'a [(String, String)],
    at: usize,
    header: &str,
    target: &str,
) -> Option<&'a str> {
    let found = answers.iter().find(|(column, _)| matches_column(column, at, header, target));
    found.map(|(_, value)| value.as_str())
}

/// Returns true if `column` names the column number `at` (from 0).
pub(crate) fn matches_column(column: &str, at: usize, header: &str, target: &str) -> bool {
    let same = |a: &str, b: &str| !a.is_empty() && a.to_lowercase() == b.to_lowercase();
    let column = column.trim();
    same(column, header)
        || same(column, &column_meaning::split_header(header).name)
        || same(column, target)
        || column.parse() == Ok(at + 1)
}

/// Returns what becomes of each column.
///
/// # Errors
/// Questions that only the user can answer; or a column or an answer that cannot be used.
pub(crate) fn map_columns(
    layout: &SourceTable,
    answers: &ImportAnswers,
    path: &Path,
) -> Result<Vec<ColumnMapping>, ImportError> {
    let mut drafts: Vec<ColumnInference<'_>> = (0..layout.columns.len())
        .map(|at| infer_column(layout, at, answers))
        .collect::<Result<_, _>>()?;
    reject_unknown_columns(&drafts, answers, path)?;
    let mut questions = Vec::new();
    axis_assignment::assign_axes(&mut drafts, &mut questions);
    let position = |drafts: &[ColumnInference<'_>], axis: char| {
        let name = format!("{axis}_mm");
        drafts.iter().position(
            |draft| matches!(&draft.meaning, ColumnMeaning::Known(target) if target.name == name),
        )
    };
    let has_time = drafts.iter().any(|draft| {
        draft.counts.stamps > 0
            && matches!(&draft.meaning, ColumnMeaning::Known(target) if target.name == "time_s")
    });
    let mut plans = Vec::new();
    for at in 0..drafts.len() {
        let draft = &drafts[at];
        let position = match &draft.meaning {
            ColumnMeaning::Actual(Some(axis)) => position(&drafts, *axis),
            _ => None,
        };
        let role = match determine_role(draft, position, has_time, answers) {
            Ok(role) => role,
            Err(ImportError::Open(open)) => {
                questions.extend(open);
                ColumnRole::Ignored("")
            }
            Err(bad) => return Err(bad),
        };
        let header = draft.source.header.clone();
        let target = target_column(&role).map_or("", |target| target.name.as_str());
        let is_negated =
            answers.negate.iter().any(|column| matches_column(column, at, &header, target));
        plans.push(ColumnMapping { header, role, is_negated });
    }
    if !questions.is_empty() {
        return Err(ImportError::Open(questions));
    }
    disambiguation::disambiguate_column_names(&mut plans, layout)?;
    Ok(plans)
}

/// Returns the column of the run file that a role makes.
pub(crate) fn target_column(role: &ColumnRole) -> Option<&TargetColumn> {
    match role {
        ColumnRole::Number { target, .. }
        | ColumnRole::Unconverted(target)
        | ColumnRole::Direction(target)
        | ColumnRole::Switch(target)
        | ColumnRole::Timestamps { target, .. }
        | ColumnRole::Elapsed { target, .. }
        | ColumnRole::Actual { target, .. } => Some(target),
        ColumnRole::AssociatedDate | ColumnRole::Ignored(_) => None,
    }
}

fn infer_column<'l>(
    layout: &'l SourceTable,
    at: usize,
    answers: &ImportAnswers,
) -> Result<ColumnInference<'l>, InputFileError> {
    let source = &layout.columns[at];
    let counts = CellCounts::from_cells(layout.rows.iter().map(|row| &row.cells[at]));
    let parts = if source.unit.is_empty() {
        column_meaning::split_header(&source.header)
    } else {
        let name = column_meaning::split_header(&source.header).name;
        ParsedHeader { name, unit: source.unit.clone() }
    };
    let given = find_answer(&answers.columns, at, &source.header, "");
    let written = match parts.unit.as_str() {
        // Its name says the unit that its values have.
        _ if source.unit.is_empty() && is_known_column(&source.header) => String::new(),
        "" => counts.unit.clone().unwrap_or_default(),
        unit => unit.to_string(),
    };
    let meant = column_meaning::classify_column(&source.header, &parts.name, unit::parse(&written));
    let target = match (given, &meant) {
        (Some(name), _) => name,
        (None, ColumnMeaning::Known(target)) => &target.name,
        _ => "",
    };
    let stated = find_answer(&answers.units, at, &source.header, target);
    let unit_text = stated.map_or(written, String::from);
    let unit = unit::parse(&unit_text);
    let meaning = match (given, &source.meaning) {
        (Some("-"), _) => ColumnMeaning::Nothing,
        (Some(name), _) => {
            let is_name = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_');
            if !is_name {
                let rule = format!("{name} is no name for a column: letters, digits and _");
                return Err(InputFileError::new(source.place.clone(), rule));
            }
            ColumnMeaning::Known(TargetColumn::from_name(name))
        }
        (None, Some(meaning)) => meaning.clone(),
        (None, None) => column_meaning::classify_column(&source.header, &parts.name, unit),
    };
    Ok(ColumnInference { source, counts, unit_text, unit, meaning, is_named: given.is_some() })
}

/// Every answer names a column of the file.
fn reject_unknown_columns(
    drafts: &[ColumnInference<'_>],
    answers: &ImportAnswers,
    path: &Path,
) -> Result<(), InputFileError> {
    let target = |draft: &ColumnInference<'_>| match &draft.meaning {
        ColumnMeaning::Known(target) => target.name.clone(),
        ColumnMeaning::Other(name) => name.clone(),
        _ => String::new(),
    };
    let is_there = |column: &str| {
        drafts
            .iter()
            .enumerate()
            .any(|(at, draft)| matches_column(column, at, &draft.source.header, &target(draft)))
    };
    let named = answers
        .units
        .iter()
        .chain(&answers.columns)
        .map(|(column, _)| column)
        .chain(&answers.negate);
    let mut needed = named.into_iter().filter(|column| !answers.of_map.contains(column));
    match needed.find(|column| !is_there(column)) {
        None => Ok(()),
        Some(column) => {
            let there: Vec<&str> =
                drafts.iter().map(|draft| draft.source.header.as_str()).collect();
            let place = drafts.first().map(|draft| draft.source.place.clone());
            let place = place.unwrap_or_else(|| trueup_machine::Location::start_of_file(path));
            Err(InputFileError::new(place, format!("there is no column {column}"))
                .with_help(format!("there are: {}", there.join(", "))))
        }
    }
}

fn determine_role(
    draft: &ColumnInference<'_>,
    position: Option<usize>,
    has_time: bool,
    answers: &ImportAnswers,
) -> Result<ColumnRole, ImportError> {
    let ColumnInference { source, counts, unit, .. } = draft;
    let is_moments = counts.stamps > 0 && counts.stamps >= counts.numbers;
    let target = match &draft.meaning {
        ColumnMeaning::Nothing => return Ok(ColumnRole::Ignored("it is no quantity of a run")),
        ColumnMeaning::Date if is_moments && has_time => return Ok(ColumnRole::AssociatedDate),
        ColumnMeaning::Date if is_moments => TargetColumn::from_name("time_s"),
        ColumnMeaning::Date if counts.others > 0 => {
            let rule = format!("{} holds no dates that are known", source.header);
            return Err(InputFileError::new(source.place.clone(), rule)
                .with_help("write 2026-04-03, 03.04.2026 or 04/03/2026")
                .into());
        }
        ColumnMeaning::Date => return Ok(ColumnRole::Ignored("it is no date that is known")),
        // Their questions are asked already.
        ColumnMeaning::Position
        | ColumnMeaning::Measured
        | ColumnMeaning::Direction
        | ColumnMeaning::Actual(None) => {
            return Ok(ColumnRole::Ignored(""));
        }
        ColumnMeaning::Actual(Some(axis)) => {
            let unit = resolve_column_unit(draft, Dimension::Length, None)?;
            let target = TargetColumn::from_name(&format!("measured_d{axis}_um"));
            let Some(position) = position else { return Ok(ColumnRole::Ignored("")) };
            return Ok(ColumnRole::Actual { target, unit, position });
        }
        ColumnMeaning::Other(name) => unknown_target(name, draft),
        ColumnMeaning::Known(target) => target.clone(),
    };
    let is_time = matches!(target.name.as_str(), "time_s" | "gauge_time_s");
    if is_moments {
        return determine_timestamp_role(draft, target, is_time);
    }
    if target.name.starts_with("dir_") {
        return Ok(ColumnRole::Direction(target));
    }
    if counts.numbers == 0 && counts.switches > 0 && counts.others == 0 {
        return Ok(ColumnRole::Switch(target));
    }
    if counts.is_mostly_text() || (counts.numbers == 0 && counts.others > 0) {
        if draft.is_named || matches!(&draft.meaning, ColumnMeaning::Known(_)) {
            let rule = format!("{} holds words, no numbers", source.header);
            let help =
                format!("leave it out: --column {}", shell_quote(&format!("{}=-", source.header)));
            return Err(InputFileError::new(source.place.clone(), rule).with_help(help).into());
        }
        return Ok(ColumnRole::Ignored("it is text"));
    }
    if counts.numbers == 0 {
        return Ok(ColumnRole::Ignored("it has no value"));
    }
    let own = (source.header == target.name).then(|| stated_unit(&target)).flatten();
    if is_time {
        let unit = match (draft.unit, own) {
            (Some(unit), _) if unit.dimension == Dimension::Time => Some(unit),
            (Some(unit), _) => return Err(wrong_unit_error(draft, unit, &target)),
            (None, own) => own,
        };
        return Ok(ColumnRole::Elapsed { target, unit });
    }
    let Some(dimension) = target.dimension else {
        // A user's own name keeps the values; a converted one says its unit.
        return Ok(match unit {
            Some(unit) if source.header != target.name && !draft.is_named => {
                ColumnRole::Number { target, unit: *unit, per_base: 1.0 }
            }
            _ => ColumnRole::Unconverted(target),
        });
    };
    if dimension == Dimension::Counts
        && let Some(volts) = unit.filter(|unit| unit.dimension == Dimension::Voltage)
    {
        let Some(per_v) = answers.counts_per_v else {
            return Err(ImportError::Open(vec![Question {
                place: source.place.clone(),
                text: format!("{} is in {}, the run file has counts", source.header, volts.name),
                topic: QuestionTopic::CountsPerV,
                choices: Vec::new(),
                is_open: true,
            }]));
        };
        return Ok(ColumnRole::Number { target, unit: volts, per_base: per_v });
    }
    let unit = resolve_column_unit(draft, dimension, own)?;
    let per_base = target.per_base;
    Ok(ColumnRole::Number { target, unit, per_base })
}

/// Returns the role of a column whose values are dates or times of day.
fn determine_timestamp_role(
    draft: &ColumnInference<'_>,
    target: TargetColumn,
    is_time: bool,
) -> Result<ColumnRole, ImportError> {
    let ColumnInference { source, unit_text, .. } = draft;
    if is_time {
        let is_form = column_meaning::is_clock_format(unit_text);
        let form = if is_form { unit_text.clone() } else { String::new() };
        return Ok(ColumnRole::Timestamps { target, form });
    }
    if !draft.is_named {
        return Ok(ColumnRole::Ignored("it is a time, and no clock of the run"));
    }
    let rule = format!("{} holds times, no numbers", source.header);
    Err(InputFileError::new(source.place.clone(), rule).into())
}

/// Returns the unit that a name of the run file states itself.
fn stated_unit(target: &TargetColumn) -> Option<Unit> {
    let dimension = target.dimension?;
    match target.unit() {
        "µm" => unit::parse("µm"),
        _ => Some(Unit::base_unit(dimension)),
    }
}

fn wrong_unit_error(draft: &ColumnInference<'_>, unit: Unit, target: &TargetColumn) -> ImportError {
    let rule =
        format!("{} is in {}, which is no unit of {}", draft.source.header, unit.name, target.name);
    InputFileError::new(draft.source.place.clone(), rule)
        .with_help("give the column another name, --column, or its unit, --unit")
        .into()
}

/// Returns the unit of a column of numbers.
fn resolve_column_unit(
    draft: &ColumnInference<'_>,
    dimension: Dimension,
    own: Option<Unit>,
) -> Result<Unit, ImportError> {
    match (draft.unit, own) {
        (Some(unit), _) if unit.dimension == dimension => Ok(unit),
        (Some(unit), _) => Err(wrong_unit_error(
            draft,
            unit,
            &TargetColumn {
                dimension: Some(dimension),
                ..TargetColumn::from_name(dimension.column_suffix())
            },
        )),
        (None, Some(own)) => Ok(own),
        (None, None) => {
            Err(ImportError::Open(vec![unit_question(draft.source, &draft.unit_text, dimension)]))
        }
    }
}

/// Returns the question for the unit of a column.
pub(crate) fn unit_question(
    source: &SourceColumn,
    written: &str,
    dimension: Dimension,
) -> Question {
    let text = match written {
        "" => format!("{} states no unit", source.header),
        unit => format!("{} is in \"{unit}\", which is no unit that is known", source.header),
    };
    Question {
        place: source.place.clone(),
        text,
        topic: QuestionTopic::Unit(source.header.clone()),
        choices: dimension.suggested_units().iter().map(ToString::to_string).collect(),
        is_open: true,
    }
}

fn unknown_target(name: &str, draft: &ColumnInference<'_>) -> TargetColumn {
    let unknown = draft.unit.is_none() && !draft.unit_text.is_empty();
    let suffixed = || format!("{name}_{}", column_meaning::slugify(&draft.unit_text));
    let name = if unknown { suffixed().trim_end_matches('_').into() } else { name.to_string() };
    let name = if name.is_empty() { "other".into() } else { name };
    TargetColumn { name, dimension: None, per_base: 1.0 }
}
