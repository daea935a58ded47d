//! `trueup trust`: whether the calibration still fits.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use trueup_learn::calibration_monitoring::{CalibrationMonitoringReport, monitor_calibration};
use trueup_machine::machine_file::Quantity;

use crate::{CommandOutcome, choice::by_name, diagnose::parse_positive, input_files, output};

/// Watches whether a record still fits the machine file, and says which measurement to take where it does not.
///
/// Readings are compared with the model. If there are none, the displacement sensor is compared
/// with the model of temperature or of time that the file has too. Either of the two may be the
/// source. The usual scatter is taken from a record of the time when the calibration was right. Bad
/// readings raise no alarm, there or here: they are listed.
///
/// Exit 3: the calibration no longer fits.
#[derive(Args)]
pub struct TrustArgs {
    /// The machine file that was right then.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    /// A record from when it was right: at least 40 readings.
    #[arg(long, value_name = "THEN.csv")]
    calibrated: PathBuf,
    /// The record to look at.
    #[arg(long, value_name = "RUN.csv")]
    run: PathBuf,
    /// The quantity to look at, where the records measure several.
    #[arg(long, value_parser = by_name(Quantity::ALL, Quantity::name))]
    quantity: Option<Quantity>,
    /// This many hours of records pass on average between two false alarms.
    #[arg(long, value_name = "HOURS", default_value_t = 1000.0, value_parser = parse_positive)]
    false_alarm_h: f64,
}

/// Watches the record.
pub fn run(args: &TrustArgs, as_json: bool) -> Result<CommandOutcome> {
    let machine = input_files::read_machine(&args.machine)?;
    let then = input_files::read_run(&args.calibrated, Some(&machine))?;
    let now = input_files::read_run(&args.run, Some(&machine))?;
    let found = monitor_calibration(&machine, &then, &now, args.quantity, args.false_alarm_h)?;
    if as_json {
        output::print(serde_json::to_string_pretty(&found)?)?;
    } else {
        print(&found)?;
    }
    Ok(if found.alarm.is_some() { CommandOutcome::NotMet } else { CommandOutcome::Done })
}

fn print(found: &CalibrationMonitoringReport) -> Result<()> {
    match &found.alarm {
        None => output::print("the calibration fits")?,
        Some(alarm) => {
            let when = alarm.time_s.map_or(String::new(), |time_s| format!(", {time_s:.0} s"));
            output::print(format_args!(
                "the calibration no longer fits: row {}{when}, {:+.1} µm",
                alarm.row, alarm.moved_um
            ))?;
            output::print(format_args!("  {}", alarm.next))?;
        }
    }
    if !found.outliers.is_empty() {
        let rows: Vec<String> = found.outliers.iter().map(ToString::to_string).collect();
        output::print(format_args!("  excluded as outliers: rows {}", rows.join(", ")))?;
    }
    output::print(format_args!(
        "  {} rows; usual scatter {:.2} µm; a false alarm once in {:.0} hours",
        found.rows, found.noise.sigma_um, found.false_alarm_h
    ))
}
