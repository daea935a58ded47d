//! `trueup compare`: two runs place by place.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use trueup_compare::{
    html_report,
    run_comparison::{PositionDifference, RunComparison, compare_runs},
    thermal_expansion::remove_thermal_expansion,
};
use trueup_machine::machine_file::Quantity;

use crate::{
    CommandOutcome, UserError,
    choice::by_name,
    diagnose::parse_positive,
    input_files,
    output::{self, FileTransaction},
    provenance,
};

/// Compares two runs of one program place by place: unloaded against cut, this year against last.
///
/// Exit 3: with --limit-um, a place differs by more, beyond the scatter of the readings.
#[derive(Args)]
pub struct CompareArgs {
    /// The earlier run.
    #[arg(value_name = "A.csv")]
    a: PathBuf,
    /// The later one.
    #[arg(value_name = "B.csv")]
    b: PathBuf,
    /// The quantity to compare, where the runs measure several.
    #[arg(long, value_parser = by_name(Quantity::ALL, Quantity::name))]
    quantity: Option<Quantity>,
    /// The machine file: the expansion of its axes is taken off both runs.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// No place may differ by more, in µm, the shift of all taken off.
    #[arg(long, value_name = "UM", value_parser = parse_positive)]
    limit_um: Option<f64>,
    /// A folder for comparison.json and report.html.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Half widths (95 %) by which a place is beyond the limit: of some dozens of places none is so by chance.
const MIN_EXCESS_HALF_WIDTHS: f64 = 2.0;
/// This many places are printed; all of them are in the JSON and on the page.
const MAX_LISTED_PLACES: usize = 12;

/// Compares the two runs.
pub fn run(args: &CompareArgs, as_json: bool) -> Result<CommandOutcome> {
    let machine = args.machine.as_ref().map(|path| input_files::read_machine(path)).transpose()?;
    let (a, b) = (
        input_files::read_run(&args.a, machine.as_ref())?,
        input_files::read_run(&args.b, machine.as_ref())?,
    );
    let [(a, first), (b, second)] =
        [a, b].map(|run| remove_thermal_expansion(&run, machine.as_ref()));
    let mut it = compare_runs(&a, &b, args.quantity)?;
    if first != second {
        // The expansion of one run alone would be a difference.
        return Err(UserError(format!(
            "{}: {first} {}: {second}",
            args.a.display(),
            args.b.display()
        ))
        .into());
    }
    it.sentences.push(first);
    let json = serde_json::to_string_pretty(&it)?;
    if let Some(folder) = &args.out {
        output::create_folder(folder)?;
        let names = [&args.a, &args.b].map(|path| path.display().to_string());
        let inputs = [args.a.as_path(), args.b.as_path()];
        let html = html_report::build_comparison_page(
            &it,
            [&names[0], &names[1]],
            &provenance::provenance_from_files(&inputs)?,
        );
        let mut set = FileTransaction::new(&inputs);
        set.add_texts(folder, [("comparison.json", format!("{json}\n")), ("report.html", html)])?;
        set.commit()?;
    }
    if as_json {
        output::print(json)?;
    } else {
        print(&it, args.limit_um)?;
    }
    // Runs that do not differ beyond their scatter are equal, unless a place is beyond the limit by more than its interval.
    let is_met = args.limit_um.is_none_or(|limit| {
        let is_beyond = |place: &PositionDifference| {
            place.half_width_um.is_some_and(|half| {
                place.difference_um.abs() - MIN_EXCESS_HALF_WIDTHS * half > limit
            })
        };
        it.max_um <= limit || !it.differs && !it.places.iter().any(is_beyond)
    });
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

fn print(it: &RunComparison, limit_um: Option<f64>) -> Result<()> {
    output::print(match (it.differs, it.cause) {
        (true, Some(cause)) => format!("they differ: {cause}"),
        (true, None) => "they differ".into(),
        (false, _) => "no difference beyond the scatter of the readings".into(),
    })?;
    for sentence in &it.sentences {
        output::print(format_args!("  {sentence}"))?;
    }
    let scatter =
        it.repeatability_um.map_or(String::new(), |um| format!("; a reading scatters by {um:.2}"));
    output::print(format_args!(
        "{} at {} places: {:.2} µm RMS, largest {:.2}{scatter}",
        it.quantity,
        it.places.len(),
        it.rms_um,
        it.max_um
    ))?;
    let halves = it.places.iter().filter_map(|place| place.half_width_um);
    let widest_um = halves.fold(0.0, f64::max);
    if let Some(limit_um) = limit_um.filter(|limit| !it.differs && widest_um > *limit) {
        output::print(format_args!(
            "  these readings know a place to ± {widest_um:.2} µm only: whether {limit_um} µm is met is not shown; read each position more often"
        ))?;
    }
    let mut places: Vec<_> = it.places.iter().collect();
    places.sort_by(|a, b| b.difference_um.abs().total_cmp(&a.difference_um.abs()));
    for place in places.iter().take(if it.differs { MAX_LISTED_PLACES } else { 0 }) {
        let way = ["downwards", "", "upwards"][usize::try_from(place.direction + 1).unwrap_or(1)];
        let half = place.half_width_um.map_or(String::new(), |half| format!(" ± {half:.2}"));
        output::print(format_args!(
            "  {} mm {way}: {:+.2}{half} µm",
            place.at_mm, place.difference_um
        ))?;
    }
    Ok(())
}
