//! Run files read with a progress bar, where one is long and there is a terminal; a table that is none, but that
//! `import` reads, is refused with the line to type.

use std::{io::BufReader, path::Path};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trueup_import::is_foreign_format;
use trueup_machine::{InputFileError, Location, RunFile, bounded_read, run_file::is_known_column};
use trueup_output::escape::shell_quote;

/// A run above this is worth a progress bar: about a second of work.
pub const MIN_PROGRESS_BAR_BYTES: u64 = 16 << 20;

/// A table above this is not tried as one that `import` could read.
const MAX_IMPORT_PROBE_BYTES: u64 = 16 << 20;

/// Reads the run file at `path`.
pub fn read(path: &Path) -> Result<RunFile, InputFileError> {
    let read = read_run(path);
    let is_run = |run: &RunFile| run.columns().iter().any(|column| is_known_column(&column.name));
    match read {
        Ok(run) if is_run(&run) => Ok(run),
        // A pipe has been read.
        other
            if !path.metadata().is_ok_and(|metadata| {
                metadata.is_file() && metadata.len() <= MAX_IMPORT_PROBE_BYTES
            }) =>
        {
            other
        }
        other => match bounded_read::read(path, MAX_IMPORT_PROBE_BYTES) {
            Ok(bytes) if is_machine_file(&bytes) => Err(not_a_run_file_error(path)),
            Ok(bytes) if is_foreign_format(&bytes, path) => Err(import_required_error(path)),
            _ => other,
        },
    }
}

/// Returns true if the text has the section that every machine file has.
fn is_machine_file(bytes: &[u8]) -> bool {
    bytes.split(|byte| *byte == b'\n').any(|line| line.trim_ascii().starts_with(b"[machine]"))
}

/// Returns the error for a machine file in the place of a run file.
fn not_a_run_file_error(path: &Path) -> InputFileError {
    InputFileError::new(
        Location::start_of_file(path),
        "is a machine file, and a run file is needed here",
    )
    .with_help(
        "--machine takes the machine file; a run file is a CSV file with a header of column names",
    )
}

/// Returns the error for a table that `import` reads.
fn import_required_error(path: &Path) -> InputFileError {
    let run = path.with_extension("run.csv");
    let name = |path: &Path| shell_quote(&path.to_string_lossy());
    InputFileError::new(
        Location::start_of_file(path),
        "is no run file, but a table that can be imported",
    )
    .with_help(format!("trueup import {} -o {}", name(path), name(&run)))
}

fn read_run(path: &Path) -> Result<RunFile, InputFileError> {
    let file = RunFile::open(path)?;
    let bytes = file_size(path);
    let bar = create_progress_bar("reading", bytes, bytes);
    let run = RunFile::from_reader(BufReader::with_capacity(1 << 16, bar.wrap_read(file)), path);
    bar.finish_and_clear();
    run
}

/// Returns the size of the run; 0 where it is not a plain file.
pub fn file_size(path: &Path) -> u64 {
    path.metadata().map_or(0, |metadata| metadata.len())
}

/// Returns a bar of `steps` on standard error; none for a short run, or without a terminal.
pub fn create_progress_bar(what: &'static str, steps: u64, run_bytes: u64) -> ProgressBar {
    if run_bytes < MIN_PROGRESS_BAR_BYTES {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}");
    ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what)
}
