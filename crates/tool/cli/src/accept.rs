//! `trueup accept`: a run without and a run with compensation, what is gone, and which constant to change.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use trueup_accept::{AcceptanceCriteria, AcceptanceResult, evaluate_acceptance};
use trueup_machine::{MachineFile, machine_file::Quantity};

use crate::{
    CommandOutcome,
    choice::by_name,
    input_files, next_commands,
    output::{self, FileTransaction},
    provenance, report,
};

/// Compares a run without compensation with one with it, and says which constant to change by how much.
///
/// Exit 3: not as much of the error is gone as is required, or one is larger than is allowed.
#[derive(Args)]
pub struct AcceptArgs {
    /// The run without compensation.
    #[arg(long, value_name = "A.csv")]
    off: PathBuf,
    /// The same run with it.
    #[arg(long, value_name = "B.csv")]
    on: PathBuf,
    /// This much of the RMS error must be gone, in percent.
    #[arg(long, value_name = "PERCENT", default_value_t = 90.0, value_parser = parse_percent)]
    require: f64,
    /// No error may be larger, in µm.
    #[arg(long, value_name = "UM", value_parser = crate::diagnose::parse_positive)]
    limit_um: Option<f64>,
    /// The quantity to compare, where the runs measure several.
    #[arg(long, value_parser = by_name(Quantity::ALL, Quantity::name))]
    quantity: Option<Quantity>,
    /// The machine file that the bridge ran: with it the answer says which constants to change.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// The folder for acceptance.json, report.html and, where a constant is to be changed, adjusted.toml.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Also write the picture of both runs alone, as SVG.
    #[arg(long, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
}

fn parse_percent(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| (0.0..=100.0).contains(value));
    value.ok_or_else(|| "must be a number from 0 to 100".into())
}

pub fn run(args: &AcceptArgs, as_json: bool) -> Result<CommandOutcome> {
    let source = args.machine.as_deref().map(MachineFile::read_text).transpose()?;
    let believed = match (&source, &args.machine) {
        (Some(source), Some(path)) => {
            Some((source.as_str(), input_files::parse_machine(source, path)?))
        }
        _ => None,
    };
    // The file has the numbers of the tools that a run names by labels.
    let machine = believed.as_ref().map(|(_, machine)| machine);
    let (off, on) =
        (input_files::read_run(&args.off, machine)?, input_files::read_run(&args.on, machine)?);
    let limits = AcceptanceCriteria { require_percent: args.require, limit_um: args.limit_um };
    let believed = believed.as_ref().map(|(source, machine)| (*source, machine));
    let acceptance = evaluate_acceptance(&off, &on, args.quantity, believed, limits)?;
    acceptance.notes.iter().for_each(report::print_warning);
    if let Some(text) = acceptance.adjusted_machine_file() {
        let before = believed.map(|(_, machine)| machine);
        input_files::check_machine_before_write(text, &args.out.join("adjusted.toml"), before)?;
    }
    let name = believed.map_or("the compensation", |(_, machine)| machine.name.as_str());
    write(args, &acceptance, name)?;
    if as_json {
        output::print(serde_json::to_string_pretty(&acceptance)?)?;
    } else {
        print_acceptance(args, &acceptance)?;
    }
    Ok(if acceptance.passed { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

fn write(args: &AcceptArgs, acceptance: &AcceptanceResult, name: &str) -> Result<()> {
    output::create_folder(&args.out)?;
    let mut inputs: Vec<&Path> = vec![&args.off, &args.on];
    inputs.extend(args.machine.as_deref());
    let mut texts = vec![
        ("acceptance.json", serde_json::to_string_pretty(acceptance)? + "\n"),
        (
            "report.html",
            acceptance.render_html(
                name,
                &provenance::provenance_from_files(&inputs)?,
                &next_commands(args, acceptance),
            ),
        ),
    ];
    let mut set = FileTransaction::new(&inputs);
    match acceptance.adjusted_machine_file() {
        Some(text) => texts.push(("adjusted.toml", text.to_string())),
        // That of an earlier acceptance would change a machine that has passed.
        None => set.remove(&args.out.join("adjusted.toml"))?,
    }
    set.add_texts(&args.out, texts)?;
    if let Some(picture) = &args.picture {
        set.add_text(picture, &acceptance.render_chart_svg())?;
    }
    set.commit()
}

/// Returns the lines to be typed next.
fn next_commands(args: &AcceptArgs, it: &AcceptanceResult) -> Vec<String> {
    let adjusted = args.out.join("adjusted.toml");
    match (it.adjusted_machine_file(), it.passed) {
        (Some(_), _) => next_commands::deployment_commands(&adjusted, &args.out),
        (None, true) => vec![next_commands::bridge_save_command(&args.out)],
        (None, false) => Vec::new(),
    }
}

fn print_acceptance(args: &AcceptArgs, it: &AcceptanceResult) -> Result<()> {
    output::print(if it.passed { "passed" } else { "not passed" })?;
    output::print(format_args!(
        "{}, {} readings: {:.2} µm RMS without, {:.2} with: {:.1} % gone; largest {:.2} and {:.2} µm",
        it.quantity,
        it.rows,
        it.before.rms_um,
        it.after.rms_um,
        100.0 * it.reduction,
        it.before.max_um,
        it.after.max_um
    ))?;
    for sentence in it.unmet.iter().chain(&it.advice.sentences) {
        output::print(format_args!("  {sentence}"))?;
    }
    next_commands::print_next_commands(&next_commands(args, it))?;
    output::print(format_args!("{}", args.out.join("report.html").display()))
}
