//! The role of each column of a table in the run file, or the questions that are open.

mod apart;

use std::path::Path;

use trueup_machine::{BadInput, run_file::is_known_column};
use trueup_output::escape::shell_word;

use crate::{
    answers::{Answers, Question, Refused, Topic},
    cells::Counts,
    layout::{Layout, Source},
    meaning::{self, Header, Meaning, Target},
    unit::{self, Dimension, Unit},
};

/// The role of a column in the run file.
#[derive(Clone, Debug)]
pub(crate) enum Role {
    /// Numbers in a unit.
    Number { target: Target, unit: Unit, per_base: f64 },
    /// Numbers as they are.
    Bare(Target),
    /// +1 and −1.
    Direction(Target),
    /// 1 and 0.
    Switch(Target),
    /// Moments: dates, times of day, or the date of such times.
    Moments { target: Target, form: String },
    /// A date that belongs to the moments of another column.
    DateOf,
    /// Times as numbers whose size says whether they are Unix time; the unit where it is stated.
    Elapsed { target: Target, unit: Option<Unit> },
    /// The actual position, from which the error of this name is computed.
    Actual { target: Target, unit: Unit, position: usize },
    /// Left out, and why.
    Ignored(&'static str),
}

/// A column with its role.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) header: String,
    pub(crate) role: Role,
    pub(crate) is_negated: bool,
}

/// A column on the way to its role.
struct Draft<'l> {
    source: &'l Source,
    counts: Counts,
    unit_text: String,
    unit: Option<Unit>,
    meaning: Meaning,
    /// The user has given its name.
    is_named: bool,
}

/// Returns the answer that names this column: by its header, its name without the unit, its number, or its target.
pub(crate) fn answer_for<'a>(
    answers: &'a [(String, String)],
    at: usize,
    header: &str,
    target: &str,
) -> Option<&'a str> {
    let found = answers.iter().find(|(column, _)| is_named(column, at, header, target));
    found.map(|(_, value)| value.as_str())
}

/// Returns true if `column` names the column number `at` (from 0).
pub(crate) fn is_named(column: &str, at: usize, header: &str, target: &str) -> bool {
    let same = |a: &str, b: &str| !a.is_empty() && a.to_lowercase() == b.to_lowercase();
    let column = column.trim();
    same(column, header)
        || same(column, &meaning::split(header).name)
        || same(column, target)
        || column.parse() == Ok(at + 1)
}

/// Returns what becomes of each column.
///
/// # Errors
/// Questions that only the user can answer; or a column or an answer that cannot be used.
pub(crate) fn plan(layout: &Layout, answers: &Answers, path: &Path) -> Result<Vec<Plan>, Refused> {
    let mut drafts: Vec<Draft<'_>> =
        (0..layout.columns.len()).map(|at| draft(layout, at, answers)).collect::<Result<_, _>>()?;
    check_answers(&drafts, answers, path)?;
    let mut questions = Vec::new();
    axes(&mut drafts, &mut questions);
    let position = |drafts: &[Draft<'_>], axis: char| {
        let name = format!("{axis}_mm");
        drafts
            .iter()
            .position(|it| matches!(&it.meaning, Meaning::Known(target) if target.name == name))
    };
    let has_time = drafts.iter().any(|draft| {
        draft.counts.stamps > 0
            && matches!(&draft.meaning, Meaning::Known(target) if target.name == "time_s")
    });
    let mut plans = Vec::new();
    for at in 0..drafts.len() {
        let draft = &drafts[at];
        let position = match &draft.meaning {
            Meaning::Actual(Some(axis)) => position(&drafts, *axis),
            _ => None,
        };
        let role = match role(draft, position, has_time, answers) {
            Ok(role) => role,
            Err(Refused::Open(open)) => {
                questions.extend(open);
                Role::Ignored("")
            }
            Err(bad) => return Err(bad),
        };
        let header = draft.source.header.clone();
        let target = target_of(&role).map_or("", |target| target.name.as_str());
        let is_negated = answers.negate.iter().any(|column| is_named(column, at, &header, target));
        plans.push(Plan { header, role, is_negated });
    }
    if !questions.is_empty() {
        return Err(Refused::Open(questions));
    }
    apart::name_apart(&mut plans, layout)?;
    Ok(plans)
}

/// Returns the column of the run file that a role makes.
pub(crate) fn target_of(role: &Role) -> Option<&Target> {
    match role {
        Role::Number { target, .. }
        | Role::Bare(target)
        | Role::Direction(target)
        | Role::Switch(target)
        | Role::Moments { target, .. }
        | Role::Elapsed { target, .. }
        | Role::Actual { target, .. } => Some(target),
        Role::DateOf | Role::Ignored(_) => None,
    }
}

fn draft<'l>(layout: &'l Layout, at: usize, answers: &Answers) -> Result<Draft<'l>, BadInput> {
    let source = &layout.columns[at];
    let counts = Counts::of(layout.rows.iter().map(|row| &row.cells[at]));
    let parts = if source.unit.is_empty() {
        meaning::split(&source.header)
    } else {
        let name = meaning::split(&source.header).name;
        Header { name, unit: source.unit.clone() }
    };
    let given = answer_for(&answers.columns, at, &source.header, "");
    let written = match parts.unit.as_str() {
        // Its name says the unit that its values have.
        _ if source.unit.is_empty() && is_known_column(&source.header) => String::new(),
        "" => counts.unit.clone().unwrap_or_default(),
        unit => unit.to_string(),
    };
    let meant = meaning::understand(&source.header, &parts.name, unit::parse(&written));
    let target = match (given, &meant) {
        (Some(name), _) => name,
        (None, Meaning::Known(target)) => &target.name,
        _ => "",
    };
    let stated = answer_for(&answers.units, at, &source.header, target);
    let unit_text = stated.map_or(written, String::from);
    let unit = unit::parse(&unit_text);
    let meaning = match (given, &source.meaning) {
        (Some("-"), _) => Meaning::Nothing,
        (Some(name), _) => {
            let is_name = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_');
            if !is_name {
                let rule = format!("{name} is no name for a column: letters, digits and _");
                return Err(BadInput::new(source.place.clone(), rule));
            }
            Meaning::Known(Target::of(name))
        }
        (None, Some(meaning)) => meaning.clone(),
        (None, None) => meaning::understand(&source.header, &parts.name, unit),
    };
    Ok(Draft { source, counts, unit_text, unit, meaning, is_named: given.is_some() })
}

/// Every answer names a column of the file.
fn check_answers(drafts: &[Draft<'_>], answers: &Answers, path: &Path) -> Result<(), BadInput> {
    let target = |draft: &Draft<'_>| match &draft.meaning {
        Meaning::Known(target) => target.name.clone(),
        Meaning::Other(name) => name.clone(),
        _ => String::new(),
    };
    let is_there = |column: &str| {
        drafts
            .iter()
            .enumerate()
            .any(|(at, draft)| is_named(column, at, &draft.source.header, &target(draft)))
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
            let place = place.unwrap_or_else(|| trueup_machine::Location::start_of(path));
            Err(BadInput::new(place, format!("there is no column {column}"))
                .with_help(format!("there are: {}", there.join(", "))))
        }
    }
}

/// Gives positions, directions and errors their axes, or asks for them.
fn axes(drafts: &mut [Draft<'_>], questions: &mut Vec<Question>) {
    let ask = |draft: &Draft<'_>, text: &str, choices: &[&str]| Question {
        place: draft.source.place.clone(),
        text: format!("{} {text}", draft.source.header),
        topic: Topic::Column(draft.source.header.clone()),
        choices: choices.iter().map(ToString::to_string).collect(),
        is_open: true,
    };
    let actual_axis = drafts.iter().find_map(|draft| match draft.meaning {
        Meaning::Actual(axis) => axis,
        _ => None,
    });
    let known = |drafts: &[Draft<'_>]| -> Vec<char> {
        let axes = ['x', 'y', 'z'].into_iter();
        axes.filter(|axis| {
            let name = format!("{axis}_mm");
            drafts
                .iter()
                .any(|it| matches!(&it.meaning, Meaning::Known(target) if target.name == name))
        })
        .collect()
    };
    let mut has_open_position = false;
    for draft in drafts.iter_mut() {
        if draft.meaning == Meaning::Position {
            match actual_axis {
                Some(axis) => draft.meaning = Meaning::Known(Target::of(&format!("{axis}_mm"))),
                None => {
                    has_open_position = true;
                    questions.push(ask(
                        draft,
                        "is a position of which axis?",
                        &["x_mm", "y_mm", "z_mm"],
                    ));
                }
            }
        }
    }
    let positions = known(drafts);
    let only = if let [axis] = positions[..] { Some(axis) } else { None };
    let has_measured = drafts.iter().any(|draft| {
        draft.meaning == Meaning::Measured
            || matches!(&draft.meaning, Meaning::Known(target) if target.name.starts_with("measured_"))
    });
    for draft in drafts.iter_mut() {
        match draft.meaning {
            Meaning::Actual(_) if has_measured => draft.meaning = Meaning::Nothing,
            Meaning::Actual(None) if only.is_some() => draft.meaning = Meaning::Actual(only),
            Meaning::Actual(None) if has_open_position => {}
            Meaning::Actual(_) if positions.is_empty() => {
                questions.push(ask(
                    draft,
                    "is a position of which axis?",
                    &["x_mm", "y_mm", "z_mm"],
                ));
            }
            Meaning::Actual(None) => {
                questions.push(ask(draft, "is an actual position of which axis?", &["-"]));
            }
            Meaning::Direction => match only {
                Some(axis) => draft.meaning = Meaning::Known(Target::of(&format!("dir_{axis}"))),
                None if has_open_position => {}
                None => questions.push(ask(
                    draft,
                    "is the direction of which axis?",
                    &["dir_x", "dir_y", "dir_z"],
                )),
            },
            Meaning::Measured => {
                let mut choices = vec![
                    "measured_dx_um",
                    "measured_dy_um",
                    "measured_dz_um",
                    "measured_elongation_um",
                ];
                // The likeliest first: along the axis that moves, of a spindle where none does.
                match only {
                    Some('y') => choices.swap(0, 1),
                    Some('z') => choices.swap(0, 2),
                    None if positions.is_empty() && !has_open_position => choices.swap(0, 3),
                    _ => {}
                }
                questions.push(ask(
                    draft,
                    "is the error in which direction (actual minus commanded)?",
                    &choices,
                ));
            }
            _ => {}
        }
    }
}

fn role(
    draft: &Draft<'_>,
    position: Option<usize>,
    has_time: bool,
    answers: &Answers,
) -> Result<Role, Refused> {
    let Draft { source, counts, unit, .. } = draft;
    let is_moments = counts.stamps > 0 && counts.stamps >= counts.numbers;
    let target = match &draft.meaning {
        Meaning::Nothing => return Ok(Role::Ignored("it is no quantity of a run")),
        Meaning::Date if is_moments && has_time => return Ok(Role::DateOf),
        Meaning::Date if is_moments => Target::of("time_s"),
        Meaning::Date if counts.others > 0 => {
            let rule = format!("{} holds no dates that are known", source.header);
            return Err(BadInput::new(source.place.clone(), rule)
                .with_help("write 2026-04-03, 03.04.2026 or 04/03/2026")
                .into());
        }
        Meaning::Date => return Ok(Role::Ignored("it is no date that is known")),
        // Their questions are asked already.
        Meaning::Position | Meaning::Measured | Meaning::Direction | Meaning::Actual(None) => {
            return Ok(Role::Ignored(""));
        }
        Meaning::Actual(Some(axis)) => {
            let unit = numeric_unit(draft, Dimension::Length, None)?;
            let target = Target::of(&format!("measured_d{axis}_um"));
            let Some(position) = position else { return Ok(Role::Ignored("")) };
            return Ok(Role::Actual { target, unit, position });
        }
        Meaning::Other(name) => other_target(name, draft),
        Meaning::Known(target) => target.clone(),
    };
    let is_time = matches!(target.name.as_str(), "time_s" | "gauge_time_s");
    if is_moments {
        return role_of_moments(draft, target, is_time);
    }
    if target.name.starts_with("dir_") {
        return Ok(Role::Direction(target));
    }
    if counts.numbers == 0 && counts.switches > 0 && counts.others == 0 {
        return Ok(Role::Switch(target));
    }
    if counts.is_text() || (counts.numbers == 0 && counts.others > 0) {
        if draft.is_named || matches!(&draft.meaning, Meaning::Known(_)) {
            let rule = format!("{} holds words, no numbers", source.header);
            let help =
                format!("leave it out: --column {}", shell_word(&format!("{}=-", source.header)));
            return Err(BadInput::new(source.place.clone(), rule).with_help(help).into());
        }
        return Ok(Role::Ignored("it is text"));
    }
    if counts.numbers == 0 {
        return Ok(Role::Ignored("it has no value"));
    }
    let own = (source.header == target.name).then(|| own_unit(&target)).flatten();
    if is_time {
        let unit = match (draft.unit, own) {
            (Some(unit), _) if unit.dimension == Dimension::Time => Some(unit),
            (Some(unit), _) => return Err(wrong_unit(draft, unit, &target)),
            (None, own) => own,
        };
        return Ok(Role::Elapsed { target, unit });
    }
    let Some(dimension) = target.dimension else {
        // A user's own name keeps the values; a converted one says its unit.
        return Ok(match unit {
            Some(unit) if source.header != target.name && !draft.is_named => {
                Role::Number { target, unit: *unit, per_base: 1.0 }
            }
            _ => Role::Bare(target),
        });
    };
    if dimension == Dimension::Counts
        && let Some(volts) = unit.filter(|unit| unit.dimension == Dimension::Voltage)
    {
        let Some(per_v) = answers.counts_per_v else {
            return Err(Refused::Open(vec![Question {
                place: source.place.clone(),
                text: format!("{} is in {}, the run file has counts", source.header, volts.name),
                topic: Topic::CountsPerV,
                choices: Vec::new(),
                is_open: true,
            }]));
        };
        return Ok(Role::Number { target, unit: volts, per_base: per_v });
    }
    let unit = numeric_unit(draft, dimension, own)?;
    let per_base = target.per_base;
    Ok(Role::Number { target, unit, per_base })
}

/// Returns the role of a column whose values are dates or times of day.
fn role_of_moments(draft: &Draft<'_>, target: Target, is_time: bool) -> Result<Role, Refused> {
    let Draft { source, unit_text, .. } = draft;
    if is_time {
        let is_form = meaning::is_clock_form(unit_text);
        let form = if is_form { unit_text.clone() } else { String::new() };
        return Ok(Role::Moments { target, form });
    }
    if !draft.is_named {
        return Ok(Role::Ignored("it is a time, and no clock of the run"));
    }
    let rule = format!("{} holds times, no numbers", source.header);
    Err(BadInput::new(source.place.clone(), rule).into())
}

/// Returns the unit that a name of the run file states itself.
fn own_unit(target: &Target) -> Option<Unit> {
    let dimension = target.dimension?;
    match target.unit() {
        "µm" => unit::parse("µm"),
        _ => Some(Unit::base(dimension)),
    }
}

fn wrong_unit(draft: &Draft<'_>, unit: Unit, target: &Target) -> Refused {
    let rule =
        format!("{} is in {}, which is no unit of {}", draft.source.header, unit.name, target.name);
    BadInput::new(draft.source.place.clone(), rule)
        .with_help("give the column another name, --column, or its unit, --unit")
        .into()
}

/// Returns the unit of a column of numbers.
fn numeric_unit(
    draft: &Draft<'_>,
    dimension: Dimension,
    own: Option<Unit>,
) -> Result<Unit, Refused> {
    match (draft.unit, own) {
        (Some(unit), _) if unit.dimension == dimension => Ok(unit),
        (Some(unit), _) => Err(wrong_unit(
            draft,
            unit,
            &Target { dimension: Some(dimension), ..Target::of(dimension.suffix()) },
        )),
        (None, Some(own)) => Ok(own),
        (None, None) => {
            Err(Refused::Open(vec![unit_question(draft.source, &draft.unit_text, dimension)]))
        }
    }
}

/// Returns the question for the unit of a column.
pub(crate) fn unit_question(source: &Source, written: &str, dimension: Dimension) -> Question {
    let text = match written {
        "" => format!("{} states no unit", source.header),
        unit => format!("{} is in \"{unit}\", which is no unit that is known", source.header),
    };
    Question {
        place: source.place.clone(),
        text,
        topic: Topic::Unit(source.header.clone()),
        choices: dimension.offers().iter().map(ToString::to_string).collect(),
        is_open: true,
    }
}

fn other_target(name: &str, draft: &Draft<'_>) -> Target {
    let unknown = draft.unit.is_none() && !draft.unit_text.is_empty();
    let name = match unknown {
        true => {
            format!("{name}_{}", meaning::slug(&draft.unit_text)).trim_end_matches('_').to_string()
        }
        false => name.to_string(),
    };
    let name = if name.is_empty() { "other".into() } else { name };
    Target { name, dimension: None, per_base: 1.0 }
}
