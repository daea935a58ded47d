//! `trueup learn`: constants that follow the machine, from readings that it takes itself.

mod probe_reading;

use std::{
    fs,
    io::{self, BufReader},
    path::{Path, PathBuf},
    time::SystemTime,
};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::{Value, json};
use trueup_learn::{
    DailyChange, LearnableConstant, LearnerState, LearningLimits, LearningResult, LiveUpdate,
    MachineIdentity, learn_from_run, live_update,
};
use trueup_machine::{Machine, MachineFile, RunFile, machine_file::Quantity};

use crate::{
    CommandOutcome, UserError,
    choice::by_name,
    diagnose::parse_positive,
    input_files,
    output::{self, FileTransaction},
    report,
};

/// A state grows by some kilobytes with each change; a larger file is none.
const MAX_STATE_BYTES: u64 = 256 << 20;

/// Lets the constants of a machine file follow the machine: slowly, within bounds, never by one reading.
///
/// The readings are the rows of a record in which measured_…_um has a value. They are of a probe on
/// a ball or a block, a tool setter, or a laser barrier. Your machine file stays as it is; what was
/// learned is written to another one, and what is known to a .learn.json next to that. Load the new
/// file when the machine is at rest; what [limits.learned] permits trueup linuxcnc --learned sends
/// to the bridge while it runs.
///
/// The state belongs to one machine (its serial number, else its name) and one quantity. Comments, limits and other keys of
/// your machine file change nothing in it; a constant that you change begins anew alone.
///
/// Exit 3: an event was reported (a crash, a changed part, a moved thermometer). Also: no reading
/// of the record was used, or a bound was reached.
#[derive(Args)]
pub struct LearnArgs {
    /// Your machine file.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    /// A record with readings, in the order in which they were taken; - is standard input.
    #[arg(long, value_name = "RUN.csv", required_unless_present = "undo")]
    run: Vec<PathBuf>,
    /// A value probed just now, in µm: a reading for the last row of the record, which is not older than a minute.
    #[arg(long, value_name = "UM", requires = "run", allow_negative_numbers = true, value_parser = parse_finite_number)]
    reading_um: Option<f64>,
    /// The machine file with what was learned.
    #[arg(long, value_name = "LEARNED.toml")]
    output: PathBuf,
    /// The quantity to learn, where the record measures several.
    #[arg(long, value_parser = by_name(Quantity::ALL, Quantity::name))]
    quantity: Option<Quantity>,
    /// No constant changes by more than this much of itself, in percent.
    #[arg(long, value_name = "PERCENT", default_value_t = 100.0 * LearningLimits::default().share, value_parser = parse_positive)]
    limit_percent: f64,
    /// Together they change the correction nowhere by more, in µm.
    #[arg(long, value_name = "UM", default_value_t = LearningLimits::default().total_um, value_parser = parse_positive)]
    limit_um: f64,
    /// One reading changes it by no more, in µm.
    #[arg(long, value_name = "UM", default_value_t = LearningLimits::default().step_um, value_parser = parse_positive)]
    step_um: f64,
    /// Takes the last day's change back.
    #[arg(long, conflicts_with = "run")]
    undo: bool,
    /// Begins anew: what was learned becomes a backup, LEARNED.learn.json.bak.
    #[arg(long, conflicts_with = "undo")]
    reset: bool,
}

fn parse_finite_number(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| value.is_finite());
    value.ok_or_else(|| "must be a number".into())
}

/// The current value of a constant.
struct LearnedConstant<'a> {
    key: &'a str,
    unit: String,
    file: f64,
    learned: f64,
    half_width: f64,
}

/// Learns from the records, or takes the last change back.
pub fn run(args: &LearnArgs, as_json: bool) -> Result<CommandOutcome> {
    let source = MachineFile::read_text(&args.machine)?;
    let known = args.output.with_extension("learn.json");
    let mut inputs: Vec<&Path> = vec![&args.machine];
    inputs.extend(args.run.iter().map(PathBuf::as_path));
    for path in [&known, &args.output] {
        output::check_output_path(path, &inputs)?;
    }
    let machine = input_files::parse_machine(&source, &args.machine)?;
    check_output_machine_identity(&args.output, &machine)?;
    let (mut memory, mut is_backup_due) =
        if args.reset { (None, known.exists()) } else { load_learner_state(&known)? };
    if args.undo {
        return undo_last_change(args, &source, &known, memory);
    }
    if args.reading_um.is_some() && args.run.len() > 1 {
        return Err(UserError("--reading-um: give one --run, that of this moment".into()).into());
    }
    let limits = LearningLimits {
        share: args.limit_percent / 100.0,
        total_um: args.limit_um,
        step_um: args.step_um,
    };
    let mut outcome = CommandOutcome::Done;
    // All records are learned from, or none: a command that is refused leaves the files as they were.
    let mut all = Vec::new();
    for path in &args.run {
        let run = match args.reading_um {
            Some(um) => {
                let run = probe_reading::read_record_with_reading(
                    path,
                    args.quantity,
                    um,
                    SystemTime::now(),
                )?;
                input_files::prepare_run(run, Some(&machine))?
            }
            None => read_run(path, &machine)?,
        };
        let learned =
            learn_from_run(&source, &args.machine, &run, args.quantity, memory.take(), &limits)?;
        memory = Some(learned.memory.clone());
        is_backup_due |= learned.has_restarted;
        let new = input_files::check_machine_before_write(
            &learned.machine,
            &args.output,
            Some(&machine),
        )?;
        all.push((path, learned, new));
    }
    if let Some((_, last, _)) = all.last() {
        if is_backup_due {
            let backup = back_up_state(&known)?;
            report::print_warning(format_args!("{}: what was known until now", backup.display()));
        }
        save_outputs(args, &inputs, &known, &last.machine, &last.memory)?;
    }
    for (path, learned, new) in &all {
        let live = LiveUpdate::from_difference(&machine, new);
        if as_json {
            output::print(serde_json::to_string_pretty(&learning_json(
                learned,
                live.as_ref().ok(),
            ))?)?;
        } else {
            print(path, learned)?;
            print_live_update(live.ok())?;
        }
        let is_refused =
            !learned.readings.iter().any(|reading| reading.used) && !learned.readings.is_empty();
        if is_refused || learned.is_held || !learned.news.is_empty() {
            outcome = CommandOutcome::NotMet;
        }
    }
    if !as_json {
        output::print(format_args!("{}", args.output.display()))?;
    }
    Ok(outcome)
}

fn read_run(path: &Path, machine: &Machine) -> Result<RunFile> {
    if path == Path::new("-") {
        let run = RunFile::from_reader(BufReader::new(io::stdin()), Path::new("standard input"))?;
        return Ok(input_files::prepare_run(run, Some(machine))?);
    }
    let mut read = input_files::read_runs_for_fit(&[path.to_path_buf()], Some(machine))?;
    read.pop().context("one run file is one run")
}

/// Refuses an output that is the machine file of another machine.
fn check_output_machine_identity(output: &Path, machine: &Machine) -> Result<()> {
    let Ok(text) = fs::read_to_string(output) else { return Ok(()) };
    let Ok(there) = MachineFile::parse(&text, output) else { return Ok(()) };
    let (there, this) =
        (MachineIdentity::from_machine(&there), MachineIdentity::from_machine(machine));
    if there.is_same_as(&this) {
        return Ok(());
    }
    let rule = format!(
        "{}: belongs to {}, --machine to {}: give each machine its own --output",
        output.display(),
        there.description(),
        this.description()
    );
    Err(UserError(rule).into())
}

/// Returns what is known from before, `None` where there is no such file yet, and whether it is of an older form.
fn load_learner_state(path: &Path) -> Result<(Option<LearnerState>, bool)> {
    let bad = |rule: String| UserError(format!("{}: {rule}", path.display()));
    if fs::metadata(path).is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
        return Ok((None, false));
    }
    let text = input_files::read_text(path, MAX_STATE_BYTES)?;
    let memory = LearnerState::from_json(&text);
    let memory =
        memory.map_err(|rule| bad(format!("is not what trueup learn has written: {rule}")))?;
    Ok((Some(memory), LearnerState::is_previous_schema(&text)))
}

/// Copies the state to the first backup that is not there yet.
fn back_up_state(known: &Path) -> Result<PathBuf> {
    let named = |number: usize| {
        let end = if number == 0 { "bak".into() } else { format!("bak{number}") };
        let mut name = known.as_os_str().to_os_string();
        name.push(format!(".{end}"));
        PathBuf::from(name)
    };
    let free = (0..).map(named).find(|path| !path.exists()).unwrap_or_else(|| named(0));
    fs::copy(known, &free)
        .map_err(|error| UserError(format!("{}: cannot be written: {error}", free.display())))?;
    Ok(free)
}

/// Both files; what is known first, for with it the other can be made again.
fn save_outputs(
    args: &LearnArgs,
    inputs: &[&Path],
    known: &Path,
    machine: &str,
    memory: &LearnerState,
) -> Result<()> {
    let json = memory.to_json()?;
    let mut set = FileTransaction::new(inputs);
    set.add_text(known, &json)?;
    set.add_text(&args.output, machine)?;
    set.commit()
}

fn undo_last_change(
    args: &LearnArgs,
    source: &str,
    known: &Path,
    memory: Option<LearnerState>,
) -> Result<CommandOutcome> {
    let bad = |rule: &str| UserError(format!("{}: {rule}", known.display()));
    let mut memory = memory.ok_or_else(|| bad("is not there, so nothing was learned"))?;
    let undone = memory.undo_last_change().map_err(|rule| bad(&rule))?;
    let machine = memory.apply_to_source(source, &args.machine).ok_or_else(|| {
        bad("was learned with another machine file, or with an earlier version of this one")
    })?;
    save_outputs(args, &[&args.machine], known, &machine, &memory)?;
    for (place, from, to) in &undone.values {
        output::print(format_args!("{}: {to} is {from} again", memory.value_key(*place)))?;
    }
    Ok(CommandOutcome::Done)
}

fn current_constants(learned: &LearningResult) -> Vec<LearnedConstant<'_>> {
    let memory = &learned.memory;
    let values = memory.applied_constant_values().into_iter().zip(&learned.half_widths);
    memory
        .constants
        .iter()
        .zip(values)
        .filter_map(|(constant, (value, half_width))| {
            let LearnableConstant { key, believed, .. } = constant;
            let (unit, half_width) = (constant.unit(), *half_width);
            Some(LearnedConstant { key, unit, file: *believed, learned: value?, half_width })
        })
        .collect()
}

fn learning_json(learned: &LearningResult, live: Option<&LiveUpdate>) -> Value {
    let constants: Vec<Value> = current_constants(learned)
        .iter()
        .map(|constant| json!({"key": constant.key, "file": constant.file, "learned": constant.learned, "half_width": constant.half_width}))
        .collect();
    // Not what was known before: that is for --undo.
    let memory = &learned.memory;
    let listed = |change: &DailyChange| {
        let values = change.values.iter();
        let values: Vec<Value> =
            values.map(|(place, from, to)| json!([memory.value_key(*place), from, to])).collect();
        json!({"at": change.at, "constants": values, "is_undo": change.is_undo})
    };
    let changes: Vec<Value> = memory.changes.iter().map(listed).collect();
    json!({
        "used": learned.readings.iter().filter(|reading| reading.used).count(),
        "readings": learned.readings,
        "constants": constants,
        "changes": changes,
        "events": memory.events,
        "new_events": learned.news,
        "seen": learned.seen,
        "notes": learned.notes,
        "live": live.map(|change| json!({"told": live_update::describe_amounts(&change.amounts.map(i32::from)), "by_new_file": change.rest})),
    })
}

/// Prints the parts that a bridge on the user's file can take; nothing for a file that is not for a board.
fn print_live_update(live: Option<LiveUpdate>) -> Result<()> {
    let Some(LiveUpdate { amounts, rest }) = live else { return Ok(()) };
    if let Some(text) = live_update::describe_amounts(&amounts.map(i32::from)) {
        output::print(format_args!("  trueup linuxcnc --learned sends to the bridge: {text}"))?;
    }
    rest.iter().try_for_each(|line| output::print(format_args!("  {line}")))
}

fn print(path: &Path, learned: &LearningResult) -> Result<()> {
    let used = learned.readings.iter().filter(|reading| reading.used).count();
    let all = learned.readings.len();
    output::print(format_args!("{}: {used} of {all} readings used", path.display()))?;
    for it in learned.readings.iter() {
        if let Some(reason) = &it.reason {
            output::print(format_args!("  row {}: {:.1} µm, {reason}", it.row, it.measured_um))?;
        }
    }
    for LearnedConstant { key, unit, file, learned, half_width } in current_constants(learned) {
        let places = trueup_page::decimals_for_half_width(half_width);
        output::print(format_args!(
            "  {key}: {file} {unit} in your file, {learned:.places$} {unit} learned, ± {half_width:.places$} {unit}"
        ))?;
    }
    for event in &learned.news {
        output::print(format_args!("  event: {}", event.describe()))?;
    }
    learned.notes.iter().try_for_each(|note| output::print(format_args!("  {note}")))
}
