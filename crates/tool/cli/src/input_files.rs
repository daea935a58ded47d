//! Machine files and runs as every command reads them: what is unlikely in them is reported, what is impossible
//! is refused unless the user accepts it (`--accept KEY`).

use std::{
    cell::RefCell,
    path::{Path, PathBuf},
    sync::OnceLock,
};

use trueup_machine::{
    InputFileError, Machine, MachineFile, RunFile, bounded_read,
    check::{self, ImplausibleValue, MachineSummary, Plausibility},
    preprocessing::{preprocess_run, with_approach_directions, without_fault_values},
};

use crate::{UserError, report, run_reader, summary};

static ACCEPTED_KEYS: OnceLock<Vec<String>> = OnceLock::new();

thread_local! {
    /// Keys and columns accepted when the job of this thread was submitted.
    static JOB_ACCEPTED_KEYS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// Sets the keys and columns that are accepted on this thread, together with those of the command line.
pub fn set_job_accepted_keys(keys: &[String]) {
    JOB_ACCEPTED_KEYS.set(keys.to_vec());
}

/// Sets, once at the start, the keys and columns whose impossible values the user accepts.
pub fn set_accepted_keys(keys: &[String]) {
    // A second time cannot be: there is one command line.
    _ = ACCEPTED_KEYS.set(keys.to_vec());
}

/// Returns the keys and columns whose impossible values the user accepts.
pub fn accepted_keys() -> Vec<String> {
    let of_command = ACCEPTED_KEYS.get().into_iter().flatten().cloned();
    of_command.chain(JOB_ACCEPTED_KEYS.with_borrow(Clone::clone)).collect()
}

/// Reads the machine file at `path`, and says in short what is unlikely in it.
pub fn read_machine(path: &Path) -> Result<Machine, InputFileError> {
    parse_machine(&MachineFile::read_text(path)?, path)
}

/// Parses and checks the text of a machine file in the same way as [`read_machine`].
pub fn parse_machine(source: &str, path: &Path) -> Result<Machine, InputFileError> {
    let machine = MachineFile::parse(source, path)?;
    if let Some(refused) = check::combine_rejected_findings(
        &check::list_implausible_values(&machine),
        &accepted_keys(),
    ) {
        return Err(refused);
    }
    report::print_brief_warnings(path, &check::machine_warnings(&machine));
    report::print_details(|| {
        summary::summary_text(&machine, &MachineSummary::from_machine(&machine))
    });
    Ok(machine)
}

/// Holds a machine file that is about to be written against the ranges of machines: warns of what is unlikely
/// and was not in `before` already.
///
/// # Errors
/// `text` is no machine file, or has an impossible value that is not accepted.
pub fn check_machine_before_write(
    text: &str,
    path: &Path,
    before: Option<&Machine>,
) -> anyhow::Result<Machine> {
    let machine = MachineFile::parse(text, path)?;
    let known = before.map(check::list_implausible_values).unwrap_or_default();
    let is_new = |finding: &ImplausibleValue| {
        known.iter().all(|old| old.key != finding.key || old.warning.what != finding.warning.what)
    };
    let found: Vec<ImplausibleValue> =
        check::list_implausible_values(&machine).into_iter().filter(is_new).collect();
    report_implausible_values(&path.display().to_string(), &found)?;
    Ok(machine)
}

/// The same for values without a line of a file: of a calibration, or of a file that is not there yet.
pub fn report_implausible_values(name: &str, found: &[ImplausibleValue]) -> Result<(), UserError> {
    if let Some(refused) = check::combine_rejected_findings(found, &accepted_keys()) {
        let each =
            refused.into_single_errors().map(|InputFileError { rule, help, .. }| match help {
                Some(help) => format!("{rule}. {help}"),
                None => rule,
            });
        let all = each.collect::<Vec<_>>().join("; ");
        return Err(UserError(format!("{name}: not written or used: {all}")));
    }
    for ImplausibleValue { warning, grade, .. } in found {
        let accepted = if *grade == Plausibility::Impossible { " (accepted)" } else { "" };
        report::print_warning(format_args!("{name}: {}{accepted}. {}", warning.what, warning.help));
    }
    Ok(())
}

/// Reads the run at `path`, and says in short what is unlikely in it, by itself and compared with `machine`.
pub fn read_run(path: &Path, machine: Option<&Machine>) -> Result<RunFile, InputFileError> {
    prepare_run(run_reader::read(path)?, machine)
}

/// Reads run files for a command that finds constants from them: a column that is unlikely in the unit of its name,
/// or a clock that was set, is refused too, since a constant found from it is wrong. Each run is judged next to the others.
pub fn read_runs_for_fit(
    paths: &[PathBuf],
    machine: Option<&Machine>,
) -> Result<Vec<RunFile>, InputFileError> {
    let read: Vec<RunFile> =
        paths.iter().map(|path| run_reader::read(path)).collect::<Result<_, _>>()?;
    for run in &read {
        reject_implausible_columns(&without_fault_values(run.clone()).0, machine, &read)?;
    }
    read.into_iter().map(|run| prepare_run(run, machine)).collect()
}

/// Says what is unlikely in `run`, and gives it without fault values of thermometers and with the directions
/// that its positions imply.
///
/// # Errors
/// A column is impossible in the unit of its name, and not accepted.
pub fn prepare_run(run: RunFile, machine: Option<&Machine>) -> Result<RunFile, InputFileError> {
    let run = with_tool_numbers(run, machine)?;
    let path = run.path().to_path_buf();
    let (run, reported) = preprocess_run(run, machine);
    report::print_brief_warnings(&path, &reported);
    reject_impossible_columns(&run, machine)?;
    report::print_brief_warnings(&path, &check::run_warnings(&run, machine));
    report::print_remarks(&check::run_remarks(&run));
    Ok(run)
}

fn with_tool_numbers(run: RunFile, machine: Option<&Machine>) -> Result<RunFile, InputFileError> {
    match machine {
        Some(machine) => run.with_machine_columns(machine).with_tool_numbers(machine),
        None => Ok(run),
    }
}

fn reject_impossible_columns(
    run: &RunFile,
    machine: Option<&Machine>,
) -> Result<(), InputFileError> {
    check::combine_rejected_findings(
        &check::find_implausible_columns(run, machine, &[]),
        &accepted_keys(),
    )
    .map_or(Ok(()), Err)
}

fn reject_implausible_columns(
    run: &RunFile,
    machine: Option<&Machine>,
    others: &[RunFile],
) -> Result<(), InputFileError> {
    let found = check::find_implausible_columns(run, machine, others).into_iter();
    let refused: Vec<ImplausibleValue> = found
        .map(|finding| ImplausibleValue { grade: Plausibility::Impossible, ..finding })
        .collect();
    check::combine_rejected_findings(&refused, &accepted_keys()).map_or(Ok(()), Err)
}

/// Reads run files as [`read_runs_for_fit`] does, for a command that looks after the names of the columns and the faults of
/// thermometers itself.
pub fn read_runs_lenient(
    paths: &[PathBuf],
    machine: &Machine,
) -> Result<Vec<RunFile>, InputFileError> {
    prepare_runs_lenient(
        paths.iter().map(|path| run_reader::read(path)).collect::<Result<_, _>>()?,
        machine,
    )
}

/// The same for runs that are read already.
pub fn prepare_runs_lenient(
    runs: Vec<RunFile>,
    machine: &Machine,
) -> Result<Vec<RunFile>, InputFileError> {
    let named = |run: RunFile| {
        let path = run.path().to_path_buf();
        let (run, reported) =
            with_approach_directions(with_tool_numbers(run, Some(machine))?, Some(machine));
        report::print_brief_warnings(&path, &reported);
        Ok(run)
    };
    let runs: Vec<RunFile> = runs.into_iter().map(named).collect::<Result<_, InputFileError>>()?;
    for run in &runs {
        let (sound, _) = without_fault_values(run.clone());
        reject_implausible_columns(&sound, Some(machine), &runs)?;
        report::print_brief_warnings(
            run.path(),
            &check::value_warnings(&sound, Some(machine), &runs),
        );
        report::print_remarks(&check::run_remarks(&sound));
    }
    Ok(runs)
}

/// Reads a file of at most this many bytes: a device named by mistake has no end.
pub fn read_bytes(path: &Path, most: u64) -> Result<Vec<u8>, UserError> {
    bounded_read::read(path, most)
        .map_err(|error| UserError(format!("{}: {}", path.display(), error.rule)))
}

/// Reads a text of at most this many bytes.
pub fn read_text(path: &Path, most: u64) -> Result<String, UserError> {
    let rule = |_| UserError(format!("{}: is not UTF-8 text", path.display()));
    String::from_utf8(read_bytes(path, most)?).map_err(rule)
}
