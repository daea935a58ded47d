//! Machine files and runs as every command reads them: what is unlikely in them is said, what is impossible
//! is refused unless the user accepts it (`--accept KEY`).

use std::{
    cell::RefCell,
    path::{Path, PathBuf},
    sync::OnceLock,
};

use trueup_machine::{
    BadInput, Machine, MachineFile, RunFile, bounded,
    check::{self, Finding, Grade, Summary},
    trusted::{trusted, with_directions, without_fault_values},
};

use crate::{UserError, report, runs, summary};

static ACCEPTED: OnceLock<Vec<String>> = OnceLock::new();

thread_local! {
    /// Keys and columns accepted when the job of this thread was submitted.
    static ACCEPTED_FOR_JOB: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// Sets the keys and columns that are accepted on this thread, together with those of the command line.
pub fn accept_for_job(keys: &[String]) {
    ACCEPTED_FOR_JOB.set(keys.to_vec());
}

/// Sets, once at the start, the keys and columns whose impossible values the user accepts.
pub fn accept(keys: &[String]) {
    // A second time cannot be: there is one command line.
    _ = ACCEPTED.set(keys.to_vec());
}

/// Returns the keys and columns whose impossible values the user accepts.
pub fn accepted() -> Vec<String> {
    let of_command = ACCEPTED.get().into_iter().flatten().cloned();
    of_command.chain(ACCEPTED_FOR_JOB.with_borrow(Clone::clone)).collect()
}

/// Reads the machine file at `path`, and says in short what is unlikely in it.
pub fn machine(path: &Path) -> Result<Machine, BadInput> {
    parsed(&MachineFile::read_text(path)?, path)
}

/// Parses and checks the text of a machine file in the same way as [`machine`].
pub fn parsed(source: &str, path: &Path) -> Result<Machine, BadInput> {
    let machine = MachineFile::parse(source, path)?;
    if let Some(refused) = check::refusal(&check::ranges(&machine), &accepted()) {
        return Err(refused);
    }
    report::in_short(path, &check::machine(&machine));
    report::in_detail(|| summary::in_words(&machine, &Summary::of(&machine)));
    Ok(machine)
}

/// Holds a machine file that is about to be written against the ranges of machines: warns of what is unlikely
/// and was not in `before` already.
///
/// # Errors
/// `text` is no machine file, or has an impossible value that is not accepted.
pub fn to_be_written(text: &str, path: &Path, before: Option<&Machine>) -> anyhow::Result<Machine> {
    let machine = MachineFile::parse(text, path)?;
    let known = before.map(check::ranges).unwrap_or_default();
    let is_new = |it: &Finding| {
        known.iter().all(|old| old.key != it.key || old.warning.what != it.warning.what)
    };
    let found: Vec<Finding> = check::ranges(&machine).into_iter().filter(is_new).collect();
    refuse_or_warn(&path.display().to_string(), &found)?;
    Ok(machine)
}

/// The same for values without a line of a file: of a calibration, or of a file that is not there yet.
pub fn refuse_or_warn(name: &str, found: &[Finding]) -> Result<(), UserError> {
    if let Some(refused) = check::refusal(found, &accepted()) {
        let each = refused.one_by_one().map(|BadInput { rule, help, .. }| match help {
            Some(help) => format!("{rule}. {help}"),
            None => rule,
        });
        let all = each.collect::<Vec<_>>().join("; ");
        return Err(UserError(format!("{name}: not written or used: {all}")));
    }
    for Finding { warning, grade, .. } in found {
        let accepted = if *grade == Grade::Impossible { " (accepted)" } else { "" };
        report::warn(format_args!("{name}: {}{accepted}. {}", warning.what, warning.help));
    }
    Ok(())
}

/// Reads the run at `path`, and says in short what is unlikely in it, by itself and compared with `machine`.
pub fn run(path: &Path, machine: Option<&Machine>) -> Result<RunFile, BadInput> {
    usable(runs::read(path)?, machine)
}

/// Reads run files for a command that finds constants from them: a column that is unlikely in the unit of its name,
/// or a clock that was set, is refused too, since a constant found from it is wrong. Each run is judged next to the others.
pub fn runs_to_fit(paths: &[PathBuf], machine: Option<&Machine>) -> Result<Vec<RunFile>, BadInput> {
    let read: Vec<RunFile> = paths.iter().map(|path| runs::read(path)).collect::<Result<_, _>>()?;
    for run in &read {
        refuse_slips(&without_fault_values(run.clone()).0, machine, &read)?;
    }
    read.into_iter().map(|run| usable(run, machine)).collect()
}

/// Says what is unlikely in `run`, and gives it without fault values of thermometers and with the directions
/// that its positions imply.
///
/// # Errors
/// A column is impossible in the unit of its name, and not accepted.
pub fn usable(run: RunFile, machine: Option<&Machine>) -> Result<RunFile, BadInput> {
    let run = with_tool_numbers(run, machine)?;
    let path = run.path().to_path_buf();
    let (run, reported) = trusted(run, machine);
    report::in_short(&path, &reported);
    refuse_units(&run, machine)?;
    report::in_short(&path, &check::run(&run, machine));
    report::remarks(&check::remarks(&run));
    Ok(run)
}

fn with_tool_numbers(run: RunFile, machine: Option<&Machine>) -> Result<RunFile, BadInput> {
    match machine {
        Some(machine) => run.with_names_of(machine).with_tool_numbers(machine),
        None => Ok(run),
    }
}

fn refuse_units(run: &RunFile, machine: Option<&Machine>) -> Result<(), BadInput> {
    check::refusal(&check::slips(run, machine, &[]), &accepted()).map_or(Ok(()), Err)
}

fn refuse_slips(
    run: &RunFile,
    machine: Option<&Machine>,
    others: &[RunFile],
) -> Result<(), BadInput> {
    let found = check::slips(run, machine, others).into_iter();
    let refused: Vec<Finding> =
        found.map(|finding| Finding { grade: Grade::Impossible, ..finding }).collect();
    check::refusal(&refused, &accepted()).map_or(Ok(()), Err)
}

/// Reads run files as [`runs_to_fit`] does, for a command that looks after the names of the columns and the faults of
/// thermometers itself.
pub fn runs_of_known_names(paths: &[PathBuf], machine: &Machine) -> Result<Vec<RunFile>, BadInput> {
    of_known_names(paths.iter().map(|path| runs::read(path)).collect::<Result<_, _>>()?, machine)
}

/// The same for runs that are read already.
pub fn of_known_names(runs: Vec<RunFile>, machine: &Machine) -> Result<Vec<RunFile>, BadInput> {
    let named = |run: RunFile| {
        let path = run.path().to_path_buf();
        let (run, reported) =
            with_directions(with_tool_numbers(run, Some(machine))?, Some(machine));
        report::in_short(&path, &reported);
        Ok(run)
    };
    let runs: Vec<RunFile> = runs.into_iter().map(named).collect::<Result<_, BadInput>>()?;
    for run in &runs {
        let (sound, _) = without_fault_values(run.clone());
        refuse_slips(&sound, Some(machine), &runs)?;
        report::in_short(run.path(), &check::values(&sound, Some(machine), &runs));
        report::remarks(&check::remarks(&sound));
    }
    Ok(runs)
}

/// Reads a file of at most this many bytes: a device named by mistake has no end.
pub fn bytes(path: &Path, most: u64) -> Result<Vec<u8>, UserError> {
    bounded::read(path, most)
        .map_err(|error| UserError(format!("{}: {}", path.display(), error.rule)))
}

/// Reads a text of at most this many bytes.
pub fn text(path: &Path, most: u64) -> Result<String, UserError> {
    let rule = |_| UserError(format!("{}: is not UTF-8 text", path.display()));
    String::from_utf8(bytes(path, most)?).map_err(rule)
}
