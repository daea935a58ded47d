//! `trueup import`: a table of a spreadsheet, a logger or an instrument as a run file. Its interpretation is printed;
//! what only the user knows is asked on a terminal, and named as a flag elsewhere.

use std::{
    io::{IsTerminal as _, stdin},
    path::{Path, PathBuf},
};

use anyhow::{Error, Result};
use clap::Args;
use dialoguer::{Input, Select};
use serde_json::json;
use trueup_import::{
    CircleGeometry, ImportAnswers, ImportError, ImportedRun, MAX_IMPORT_FILE_BYTES, Question,
    QuestionTopic, header_map, import,
};
use trueup_machine::{InputFileError, MachineFile, bounded_read};
use trueup_output::escape::{escape_line, shell_quote};

use crate::{
    CommandOutcome, UserError, input_files,
    output::{self, FileTransaction},
    report,
};

/// Reads a table of a spreadsheet, a logger or an instrument, and writes it as a run file.
///
/// csv, tsv, txt, xlsx, xls, ods; LinuxCNC .comp, Renishaw .rtl, height maps of RepRapFirmware and Klipper. On a terminal
/// what can be read in two ways is asked; elsewhere it ends with 2 and names the flag. It prints what it has understood.
#[derive(Args)]
#[command(after_help = "Examples:
  trueup import readings.xlsx -o run.csv
  trueup import messung.csv -o run.csv --decimal comma --column Messuhr=measured_dx_um --unit Messuhr=mil
  trueup import monday.csv -o run.csv --map logger.toml       writes logger.toml, and reuses it")]
pub struct ImportArgs {
    /// The table.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Where to write the run file; `-` is standard output.
    #[arg(long, value_name = "RUN.csv")]
    output: PathBuf,
    /// The answers for files of this kind: read if it is there, written or completed by new answers.
    #[arg(long, value_name = "MAP.toml")]
    map: Option<PathBuf>,
    /// The sign before the decimals.
    #[arg(long, value_parser = ["comma", "point"])]
    decimal: Option<String>,
    /// The order of the numbers of a date.
    #[arg(long, value_parser = ["dmy", "mdy", "ymd"])]
    date: Option<String>,
    /// The unit of a column, by its header, its number or its name in the run file: 'Messuhr=µm', '3=inch', 'Zeit=h:mm'.
    #[arg(long, value_name = "COLUMN=UNIT")]
    unit: Vec<String>,
    /// The name of a column in the run file: 'Messuhr=measured_dx_um'; '-' leaves it out.
    #[arg(long, value_name = "COLUMN=NAME")]
    column: Vec<String>,
    /// Turn the sign of a column: a gauge that counts the other way round.
    #[arg(long, value_name = "COLUMN")]
    negate: Vec<String>,
    /// The encoding, where it is recognised wrongly: utf-8, utf-16le, latin1, windows-1252, iso-8859-15.
    #[arg(long)]
    encoding: Option<String>,
    /// The sheet of a workbook.
    #[arg(long)]
    sheet: Option<String>,
    /// Counts of the sensor for one volt: sensor columns in V or mV become counts.
    #[arg(long, value_name = "COUNTS")]
    counts_per_v: Option<String>,
    /// The machine file, whose `[inputs]` state the scale of the sensor.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// Whether a step of the clock by an hour is the change of summer time.
    #[arg(long, value_parser = ["yes", "no"])]
    summer_time: Option<String>,
    /// Whether every second run of an instrument's file goes back, where the file does not say it.
    #[arg(long, value_parser = ["there-and-back", "one-way"])]
    runs: Option<String>,
    #[command(flatten)]
    circle: CircleTableArgs,
    /// Replace a file that is there with other content.
    #[arg(long)]
    overwrite: bool,
}

/// The circle of a table of angles and radial deviations, of a ball bar.
#[derive(Args)]
struct CircleTableArgs {
    /// The commanded radius in mm of a table that has angles and radial deviations: they become positions on the circle.
    #[arg(long, value_name = "MM", value_parser = crate::diagnose::parse_positive)]
    radius: Option<f64>,
    /// The commanded centre in mm along both axes of the plane.
    #[arg(long, value_name = "U,V", requires = "radius", value_parser = parse_centre, allow_hyphen_values = true, default_value = "0,0")]
    centre: [f64; 2],
    /// The plane; the angle counts from its first axis to the second one.
    #[arg(long, requires = "radius", value_parser = ["xy", "yz", "zx"], default_value = "xy")]
    plane: String,
    /// The direction of the whole table. Default: the order of its rows.
    #[arg(long, requires = "radius", value_parser = ["ccw", "cw"])]
    direction: Option<String>,
}

impl CircleTableArgs {
    fn to_circle(&self) -> Option<CircleGeometry> {
        let mut axes = self.plane.chars();
        let mut axis = || axes.next().unwrap_or('x');
        Some(CircleGeometry {
            radius_mm: self.radius?,
            centre_mm: self.centre,
            axes: [axis(), axis()],
            is_clockwise: self.direction.as_ref().map(|direction| direction == "cw"),
        })
    }
}

fn parse_centre(text: &str) -> Result<[f64; 2], String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    match numbers[..] {
        [u, v] if u.is_finite() && v.is_finite() => Ok([u, v]),
        _ => Err("must be two numbers in mm, as in 250,180".into()),
    }
}

/// Imports the table.
pub fn run(args: &ImportArgs, as_json: bool) -> Result<CommandOutcome> {
    let requests = !as_json && stdin().is_terminal() && trueup_output::is_stdout_terminal();
    output::check_output_path(&args.output, &[&args.file])?;
    if requests && !args.overwrite && args.output.is_file() {
        return Err(already_exists_error(&args.output).into());
    }
    let bytes = bounded_read::read(&args.file, MAX_IMPORT_FILE_BYTES)
        .map_err(|error| table_error(error, as_json))?;
    let map_text = match &args.map {
        Some(path) if path.exists() => Some(input_files::read_text(path, 1 << 20)?),
        _ => None,
    };
    let known = match (&map_text, &args.map) {
        (Some(text), Some(path)) => header_map::parse(text, path)?,
        _ => ImportAnswers::default(),
    };
    let mut answers = answers_from_flags(args)?.merge(known);
    let imported = loop {
        match import(&bytes, &args.file, &answers) {
            Ok(imported) => break imported,
            Err(ImportError::Bad(error)) => return Err(table_error(error, as_json)),
            Err(ImportError::Open(questions)) if requests => {
                for question in questions {
                    let value = prompt_for_answer(&question)?;
                    answers.record_answer(&question.topic, &value).map_err(UserError)?;
                }
            }
            Err(ImportError::Open(questions)) => {
                return Err(report_open_questions(questions, as_json));
            }
        }
    };
    write(args, &imported, &answers, map_text.as_deref())?;
    print(args, &imported, as_json)?;
    Ok(CommandOutcome::Done)
}

/// Returns the answers that the flags give.
fn answers_from_flags(args: &ImportArgs) -> Result<ImportAnswers> {
    let mut answers = ImportAnswers {
        negate: args.negate.clone(),
        encoding: args.encoding.clone(),
        sheet: args.sheet.clone(),
        circle: args.circle.to_circle(),
        ..ImportAnswers::default()
    };
    let mut flag = |name: &str, topic: QuestionTopic, value: &str| {
        answers
            .record_answer(&topic, value)
            .map_err(|rule| UserError(format!("--{name} {value}: {rule}")))
    };
    let given = [
        ("decimal", QuestionTopic::Decimal, &args.decimal),
        ("date", QuestionTopic::Date, &args.date),
        ("counts-per-v", QuestionTopic::CountsPerV, &args.counts_per_v),
        ("summer-time", QuestionTopic::SummerTime, &args.summer_time),
        ("runs", QuestionTopic::Runs, &args.runs),
    ];
    for (name, topic, value) in given {
        value.as_ref().map_or(Ok(()), |value| flag(name, topic, value))?;
    }
    type TopicConstructor = fn(String) -> QuestionTopic;
    let columns: [(&str, &Vec<String>, TopicConstructor); 2] = [
        ("unit", &args.unit, QuestionTopic::Unit),
        ("column", &args.column, QuestionTopic::Column),
    ];
    for (name, pairs, topic) in columns {
        for pair in pairs {
            let (column, value) = pair.rsplit_once('=').ok_or_else(|| {
                UserError(format!(
                    "--{name} {pair}: must be a column, = and its {name}: Messuhr=µm"
                ))
            })?;
            flag(name, topic(column.trim().into()), value)?;
        }
    }
    if let Some(path) = &args.machine {
        let machine = MachineFile::read(path)?;
        let sensor = machine.inputs.as_ref().and_then(|inputs| inputs.sensor.as_ref());
        let per_v = sensor.map(|sensor| sensor.counts_full_scale / sensor.volts_full_scale);
        answers.counts_per_v = answers.counts_per_v.or(per_v);
    }
    Ok(answers)
}

/// Returns the value that the user chooses or types.
fn prompt_for_answer(question: &Question) -> Result<String> {
    const OTHER_CHOICE: &str = "another one";
    let prompt = format!("line {}: {}", question.place.line, escape_line(&question.text));
    let is_column = matches!(question.topic, QuestionTopic::Column(_));
    let mut items: Vec<String> =
        question.choices.iter().map(|choice| escape_line(choice)).collect();
    if is_column && !question.choices.iter().any(|choice| choice == "-") {
        items.push("- (leave it out)".into());
    }
    if question.is_open {
        items.push(OTHER_CHOICE.into());
    }
    if items.len() > 1 {
        let chosen = Select::new().with_prompt(&prompt).items(&items).default(0).interact()?;
        if let Some(choice) = question.choices.get(chosen) {
            return Ok(choice.clone());
        }
        if items[chosen] != OTHER_CHOICE {
            return Ok("-".into());
        }
    }
    let prompt = match question.topic {
        QuestionTopic::CountsPerV => format!("{prompt}. Counts for one volt"),
        QuestionTopic::Column(_) => "Name in the run file".into(),
        _ => "Unit".into(),
    };
    let topic = question.topic.clone();
    let read = |text: &String| ImportAnswers::default().record_answer(&topic, text);
    Input::new().with_prompt(prompt).validate_with(read).interact_text().map_err(Error::from)
}

/// Returns an error of the table on one line, with what to do.
fn table_error(error: InputFileError, as_json: bool) -> Error {
    if as_json {
        return error.into();
    }
    let stop = if error.rule.ends_with('?') { "" } else { "." };
    let help = error.help.as_ref().map_or(String::new(), |help| {
        let mut letters = help.chars();
        let first = letters.next().map(|c| c.to_uppercase().to_string()).unwrap_or_default();
        format!("{stop} {first}{}", letters.as_str())
    });
    UserError(format!("{error}{help}")).into()
}

/// Returns the open questions, each on a line with its flag, at most three lines.
fn report_open_questions(questions: Vec<Question>, as_json: bool) -> Error {
    const MAX_ERROR_LINES: usize = 3;
    let more = questions.len().saturating_sub(MAX_ERROR_LINES);
    let shown = if more > 0 { MAX_ERROR_LINES - 1 } else { questions.len() };
    let flags: Vec<String> = questions[shown..].iter().map(Question::flag).collect();
    let mut errors: Vec<InputFileError> =
        questions.into_iter().take(shown).map(Question::into_error).collect();
    if as_json {
        return InputFileError::combine(errors)
            .map_or_else(|| UserError(String::new()).into(), Error::from);
    }
    let last = match flags.is_empty() {
        true => errors.pop().map(|error| table_error(error, false)),
        false => Some(UserError(format!("and {}", flags.join("; "))).into()),
    };
    errors.into_iter().for_each(|error| report::print_error(table_error(error, false)));
    last.unwrap_or_else(|| UserError("a question is open".into()).into())
}

fn already_exists_error(path: &Path) -> UserError {
    let rule = "is there already: give another name, or --overwrite to replace it";
    UserError(format!("{}: {rule}", path.display()))
}

/// Writes the run file, and the map with what it lacks.
fn write(
    args: &ImportArgs,
    imported: &ImportedRun,
    answers: &ImportAnswers,
    map_text: Option<&str>,
) -> Result<()> {
    let there = std::fs::read_to_string(&args.output).ok();
    let is_other = args.output.is_file() && there.as_deref() != Some(imported.run.as_str());
    if is_other && !args.overwrite {
        return Err(already_exists_error(&args.output).into());
    }
    let inputs = [args.file.as_path()];
    let mut set = FileTransaction::new(&inputs);
    if let Some(path) = &args.map {
        let text =
            header_map::merge_answers(map_text.unwrap_or_default(), answers).map_err(UserError)?;
        set.add_text(path, &text)?;
    }
    set.add_text(&args.output, &imported.run)?;
    set.commit()
}

/// Prints what was understood.
fn print(args: &ImportArgs, imported: &ImportedRun, as_json: bool) -> Result<()> {
    let ImportedRun { rows, form, columns, skipped: omitted, notes, .. } = imported;
    if as_json {
        let columns: Vec<_> = columns
            .iter()
            .map(|column| {
                json!({
                    "header": column.header, "name": column.name, "unit_before": column.unit_before,
                    "unit_after": column.unit_after, "samples": column.samples,
                })
            })
            .collect();
        return output::print(json!({
            "output": args.output, "rows": rows, "form": form, "columns": columns,
            "left_out": omitted, "notes": notes,
        }));
    }
    output::print(format_args!("{}: {}, {rows} rows", args.file.display(), form.join(", ")))?;
    let unit = |preview: &trueup_import::ColumnPreview| match (
        preview.unit_before.as_str(),
        preview.unit_after.as_str(),
    ) {
        ("", "") => "no unit".to_string(),
        ("", after) => after.to_string(),
        (before, after) if before == after => after.to_string(),
        (before, after) => format!("{before} → {after}"),
    };
    let table: Vec<[String; 4]> = columns
        .iter()
        .map(|column| {
            let samples = column.samples.iter().map(|[before, after]| match before == after {
                true => before.clone(),
                false => format!("{before} → {after}"),
            });
            [
                column.header.clone(),
                column.name.clone(),
                unit(column),
                samples.collect::<Vec<_>>().join("; "),
            ]
        })
        .collect();
    let head = ["in the file", "in the run file", "unit", "first values"].map(String::from);
    let lines: Vec<&[String; 4]> = std::iter::once(&head).chain(&table).collect();
    let width =
        |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    let widths = [width(0), width(1), width(2)];
    for line in lines {
        let [a, b, c, d] = line;
        let [wide_a, wide_b, wide_c] = widths;
        output::print(format_args!("  {a:wide_a$}  {b:wide_b$}  {c:wide_c$}  {d}"))?;
    }
    for (header, why) in omitted {
        output::print(format_args!("   skipped: {header} ({why})"))?;
    }
    for note in notes {
        output::print(format_args!("  {note}"))?;
    }
    if columns.iter().all(|column| !column.name.starts_with("measured_")) {
        report::print_warning(
            "no column is a measured error or growth: `fit` and `diagnose` need one (--column)",
        );
    }
    if output::is_standard_output(&args.output) {
        return Ok(());
    }
    let next = shell_quote(&args.output.to_string_lossy());
    output::print(format_args!("{}: written. Next: trueup check {next}", args.output.display()))
}
