//! `trueup trend`: constants over dated files.

use std::{
    fs,
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::Result;
use clap::Args;
use trueup_compare::{
    dated_constants, html_report, thermal_expansion::remove_thermal_expansion, trend::fit_trends,
};

use crate::{
    CommandOutcome, UserError,
    diagnose::parse_positive,
    input_files,
    output::{self, FileTransaction},
    provenance, report,
};

/// Shows how backlash, pitch and other constants change over dated run files or machine files, and when to
/// measure again.
///
/// The day is in a file's name, 2026-11-22 or 20261122.
#[derive(Args)]
pub struct TrendArgs {
    /// The folder with the files, .csv and .toml.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// A change that matters, in the unit of the constant. Default: the smallest that one measurement can show.
    #[arg(long, value_name = "UM", value_parser = parse_positive)]
    limit_um: Option<f64>,
    /// The machine file: the expansion of its axes is taken off run files that have a temperature.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// The day of the report, such as 2026-11-22. Default: today on this computer (UTC).
    #[arg(long, value_name = "DATE", value_parser = parse_day)]
    today: Option<dated_constants::EpochDay>,
    /// A folder for trend.json and report.html.
    #[arg(long, value_name = "OUT")]
    out: Option<PathBuf>,
}

/// Parses a day as it is written.
pub fn parse_day(text: &str) -> Result<dated_constants::EpochDay, String> {
    dated_constants::find_date_in_file_name(text).ok_or_else(|| "is no date like 2026-11-22".into())
}

/// Returns the day of this computer.
fn today() -> Option<dated_constants::EpochDay> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    dated_constants::EpochDay::try_from(since.as_secs() / 86_400).ok()
}

/// Reads the folder and reports the trends.
pub fn run(args: &TrendArgs, as_json: bool) -> Result<CommandOutcome> {
    let bad = |rule: String| UserError(format!("{}: {rule}", args.folder.display()));
    let entries =
        fs::read_dir(&args.folder).map_err(|error| bad(format!("cannot be read: {error}")))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    let machine = args.machine.as_ref().map(|path| input_files::read_machine(path)).transpose()?;
    let today = args.today.or_else(today);
    let mut notes: Vec<String> = Vec::new();
    let mut days = Vec::new();
    let mut read = Vec::new();
    for path in paths {
        let kind = path.extension().and_then(|kind| kind.to_str()).unwrap_or_default().to_string();
        let name =
            path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if !matches!(kind.as_str(), "csv" | "toml") {
            continue;
        }
        let Some(day) = dated_constants::find_date_in_file_name(&name) else {
            report::print_warning(format_args!(
                "{name}: skipped, its name has no date like 2026-11-22"
            ));
            continue;
        };
        // A day west of Greenwich is still yesterday, one east of it may be tomorrow.
        if let Some(today) = today.filter(|today| day > today + 1) {
            return Err(bad(format!(
                "{name} is of a day in the future (today is {}): correct its date, or give --today",
                dated_constants::format_day(today)
            ))
            .into());
        }
        let constants = match kind.as_str() {
            "toml" => dated_constants::machine_constants(&input_files::read_machine(&path)?),
            _ => {
                let run = input_files::read_run(&path, machine.as_ref())?;
                let (run, note) = remove_thermal_expansion(&run, machine.as_ref());
                if !notes.contains(&note) {
                    notes.push(note);
                }
                let run_constants = dated_constants::estimate_run_constants(&run);
                notes.extend(run_constants.outliers.iter().map(|(place, um)| {
                    format!("{}:{}: {um:+.1} µm, excluded as an outlier", name, place.line)
                }));
                run_constants.constants
            }
        };
        if constants.is_empty() {
            report::print_warning(format_args!(
                "{name}: skipped, it has no backlash, pitch or growth"
            ));
            continue;
        }
        days.push((day, constants));
        read.push(path);
    }
    if days.is_empty() {
        return Err(bad("has no dated .csv or .toml with a constant in it".into()).into());
    }
    let found = fit_trends(&days, args.limit_um, today);
    let json = serde_json::to_string_pretty(&found)?;
    if let Some(folder) = &args.out {
        output::create_folder(folder)?;
        let mut inputs: Vec<&Path> = read.iter().map(PathBuf::as_path).collect();
        inputs.extend(args.machine.as_deref());
        let origin = provenance::provenance_from_files(&inputs)?;
        let html =
            html_report::build_trends_page(&found, &args.folder.display().to_string(), &origin);
        let mut set = FileTransaction::new(&[]);
        set.add_texts(folder, [("trend.json", format!("{json}\n")), ("report.html", html)])?;
        set.commit()?;
    }
    if as_json {
        output::print(json)?;
    } else {
        for it in &found {
            output::print(format_args!("{}: {}", it.name, it.sentence))?;
            for point in &it.points {
                let half = point.half_width.map_or(String::new(), |half| format!(" ± {half:.2}"));
                output::print(format_args!("  {} {:.2}{half}", point.date, point.value))?;
            }
        }
        notes.iter().try_for_each(output::print)?;
    }
    Ok(CommandOutcome::Done)
}
