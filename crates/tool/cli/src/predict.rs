//! `trueup predict`: a run with what the model and the bridge say of each row.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde_json::json;
use trueup_machine::predict::{PredictionSummary, RunPredictor};

use crate::{CommandOutcome, input_files, output, report, run_reader};

/// Adds to each row of a run what the model and the bridge's arithmetic say.
///
/// Exit 3: somewhere the bridge is further from the model than `compile` has promised.
#[derive(Args)]
#[command(after_help = "Example:
  trueup predict --machine mill/mill.toml --run mill/warmup-off.csv -o predicted.csv")]
pub struct PredictArgs {
    /// The machine file.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    /// The run file.
    #[arg(long, value_name = "RUN.csv")]
    run: PathBuf,
    /// Where to write the run with the predictions.
    #[arg(long, value_name = "OUT.csv")]
    output: PathBuf,
}

/// Predicts the run by the machine file.
pub fn run(args: &PredictArgs, as_json: bool) -> Result<CommandOutcome> {
    let PredictArgs { machine: machine_path, run: run_path, output: to } = args;
    let machine = input_files::read_machine(machine_path)?;
    let run = input_files::read_run(run_path, Some(&machine))?;
    let predictor = RunPredictor::new(&machine, &run)?;
    if let Some(why) = predictor.bridge_error() {
        report::print_warning(format_args!(
            "{}: the bridge's columns stay empty: {why}",
            machine_path.display()
        ));
    }
    if !predictor.missing_columns().is_empty() {
        report::print_warning(format_args!(
            "{}: the run lacks these columns, and what depends on them stays empty: {}",
            run_path.display(),
            predictor.missing_columns().join(", ")
        ));
    }
    let bar = run_reader::create_progress_bar(
        "writing",
        run.row_count() as u64,
        run_reader::file_size(run_path),
    );
    let written = output::write_atomically(to, &[machine_path, run_path], |out| {
        predictor.write_csv(out, || bar.inc(1))
    })?;
    bar.finish_and_clear();
    let broken = describe_guarantee_violation(&predictor, &written);
    if let Some(how) = &broken {
        let row = written.broken_promise.map_or(0, |(row, _)| row);
        report::print_warning(format_args!("{}: {how}", run.value_location(row, "time_s")));
    }
    print(&predictor, &written, to, as_json)?;
    Ok(if broken.is_some() { CommandOutcome::NotMet } else { CommandOutcome::Done })
}

/// Returns how the bridge is further from the model than `compile` has promised, if it is.
fn describe_guarantee_violation(
    predictor: &RunPredictor<'_>,
    written: &PredictionSummary,
) -> Option<String> {
    let ((_, nm), promised_nm) = (written.broken_promise?, predictor.difference_bound_nm()?);
    Some(format!(
        "the bridge is {nm:.1} nm from the model, and compile has promised {promised_nm:.1}: the row exceeds the range of the board's numbers"
    ))
}

fn print(
    predictor: &RunPredictor<'_>,
    written: &PredictionSummary,
    to: &Path,
    as_json: bool,
) -> Result<()> {
    if let Some(place) = &written.first_out_of_range {
        let rows = written.rows_out_of_range;
        report::print_warning(format_args!(
            "{place}: sensor_counts is outside the input's range in {rows} rows"
        ));
    }
    if as_json {
        output::print(json!({
            "output": to.to_string_lossy(),
            "rows": written.rows,
            "rows_without_counts": written.rows_without_counts,
            "rows_out_of_range": written.rows_out_of_range,
            "largest_difference_nm": written.largest_difference_nm,
            "largest_arithmetic_nm": written.largest_arithmetic_nm,
            "not_run": predictor.unsupported_features(),
        }))?;
        return Ok(());
    }
    output::print(format_args!("{}: {} rows", to.display(), written.rows))?;
    if written.rows_without_counts > 0 {
        let rows = written.rows_without_counts;
        output::print(format_args!("{rows} of them without sensor_counts, not predicted"))?;
    }
    if let Some(nm) = written.largest_difference_nm {
        output::print(format_args!("largest difference of the bridge from the model: {nm:.3} nm"))?;
    }
    let not_run = predictor.unsupported_features();
    if let (Some(nm), false) = (written.largest_arithmetic_nm, not_run.is_empty()) {
        output::print(format_args!(
            "{nm:.3} nm of it is the board's arithmetic; the rest is what the board does not run: {}",
            not_run.join(", ")
        ))?;
    }
    Ok(())
}
