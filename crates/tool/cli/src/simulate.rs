//! `trueup simulate`: what the virtual machine tool measures in a scenario.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;
use trueup_machine::{
    InputFileError, Location, bounded_read, machine_file::MAX_MACHINE_FILE_BYTES,
};
use trueup_twin::{Scenario, simulate};

use crate::{CommandOutcome, output};

/// More rows than this are worth a progress bar: about a second of work.
const MIN_PROGRESS_BAR_ROWS: f64 = 50_000.0;

/// Writes what the virtual machine tool would measure: a run file with known causes.
#[derive(Args)]
pub struct SimulateArgs {
    /// The scenario: the machine, its faults, the sensors, and what is done.
    #[arg(long, value_name = "S.toml")]
    scenario: PathBuf,
    /// The seed of all random numbers: the same seed gives the same run, to the byte.
    #[arg(long, value_name = "N")]
    seed: u64,
    /// Where to write the run.
    #[arg(long, value_name = "RUN.csv")]
    output: PathBuf,
}

/// Runs the scenario.
pub fn run(args: &SimulateArgs, as_json: bool) -> Result<CommandOutcome> {
    let SimulateArgs { scenario: path, seed, output: to } = args;
    let bad = |line, column, rule: &str| {
        InputFileError::new(Location { file: path.clone(), line, column }, rule)
    };
    let bytes = bounded_read::read(path, MAX_MACHINE_FILE_BYTES)?;
    let text = String::from_utf8(bytes).map_err(|error| {
        let valid = String::from_utf8_lossy(&error.as_bytes()[..error.utf8_error().valid_up_to()]);
        let place = Location::from_byte_offset(path, &valid, valid.len());
        InputFileError::new(place, "is not UTF-8 text")
    })?;
    let scenario =
        Scenario::parse(&text, path).map_err(|error| bad(error.line, error.column, &error.rule))?;
    let bar = create_progress_bar(scenario.estimated_row_count());
    let table = simulate(&scenario, *seed, || bar.inc(1));
    bar.finish_and_clear();
    output::write_atomically(to, &[path], |out| table.write_csv(out))?;
    if as_json {
        output::print(json!({
            "output": to.to_string_lossy(),
            "scenario": scenario.name,
            "seed": seed,
            "rows": table.row_count(),
            "columns": table.column_names().collect::<Vec<_>>(),
        }))?;
    } else {
        let columns: Vec<&str> = table.column_names().collect();
        let rows = table.row_count();
        output::print(format_args!("{}: {rows} rows of {}", to.display(), columns.join(", ")))?;
    }
    Ok(CommandOutcome::Done)
}

/// Returns a bar on standard error; none for a short run, or without a terminal.
fn create_progress_bar(rows: f64) -> ProgressBar {
    if rows < MIN_PROGRESS_BAR_ROWS {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}");
    // A number of rows is whole and far below what a u64 holds.
    ProgressBar::with_draw_target(Some(rows as u64), ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message("simulating")
}
