//! The demonstration: its options, its progress, and what it writes.

use std::{
    fs,
    path::PathBuf,
    time::{Duration, Instant},
};

use anyhow::Result;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use trueup_campaigns::faulty_machine::SeparableFaultMachine;
use trueup_demo::{
    hidden_fault_demo::run_hidden_fault_demo,
    html_report,
    measured_run_demo::{MeasuredRunInput, run_measured_run_demo},
    stepped_board::BoardSource,
    summary::DemoSummary,
};
use trueup_emulator::{firmware_images, setup};
use trueup_machine::{MachineFile, RunFile};

use crate::random_seed;

#[derive(Args)]
pub(crate) struct DemoArgs {
    /// Your machine file, in the place of the paper's.
    #[arg(long, value_name = "M.toml", requires = "run")]
    machine: Option<PathBuf>,
    /// Your run file.
    #[arg(long, value_name = "RUN.csv", requires = "machine")]
    run: Option<PathBuf>,
    /// Draws the hidden fault of act two, and draws it again; another one each time by default.
    #[arg(long)]
    seed: Option<u64>,
    /// The folder for summary.json and report.html; target/demo by default.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Runs the demonstration, and writes its page and figures.
pub(crate) fn run_demo(options: &DemoArgs) -> Result<()> {
    let image = firmware_images::build_virtual_board_image()?;
    let started = Instant::now();
    let root = setup::project_root();
    let or = |path: &Option<PathBuf>, own: &str| path.clone().unwrap_or_else(|| root.join(own));
    let path = or(&options.machine, "data/paper_spindle.toml");
    let source = MachineFile::read_text(&path)?;
    let run = RunFile::read(&or(&options.run, "data/spindle_paper_table1.csv"))?;
    let folder = or(&options.out, "target/demo");
    let boards = BoardSource::Emulated(image);

    let bar = progress_bar()?;
    let asked = MeasuredRunInput { source: &source, path: &path, run: &run, quantity: None };
    let one = run_measured_run_demo(&boards, &asked, &mut |what, share| {
        show_progress(&bar, what, share)
    })?;
    bar.finish_and_clear();
    trueup_output::write_line_best_effort(one.to_text());

    // One's own data are played alone, unless a seed is requested.
    let seed = options.seed.or_else(|| options.machine.is_none().then(random_seed));
    let two = match seed {
        None => None,
        Some(seed) => {
            trueup_output::write_line_best_effort(format_args!(
                "A machine is drawn and broken by seed {seed}."
            ));
            let bar = progress_bar()?;
            let hidden = SeparableFaultMachine::draw(seed)?;
            let two = run_hidden_fault_demo(&boards, &hidden, &mut |what, share| {
                show_progress(&bar, what, share)
            })?;
            bar.finish_and_clear();
            trueup_output::write_line_best_effort(two.to_text());
            Some(two)
        }
    };

    let outcome = two.as_ref().map(|two| &two.outcome);
    let summary = DemoSummary::new(&one, outcome, boards.name(), started.elapsed().as_secs_f64());
    fs::create_dir_all(&folder)?;
    if let Some(two) = &two {
        fs::write(folder.join("act-two.svg"), html_report::render_hidden_fault_svg(two))?;
    }
    fs::write(folder.join("summary.json"), serde_json::to_string_pretty(&summary)? + "\n")?;
    fs::write(folder.join("report.html"), html_report::render_page(&one, two.as_ref()))?;
    fs::write(folder.join("extended.toml"), &one.extended)?;
    let shown_at = folder.strip_prefix(&root).unwrap_or(&folder);
    trueup_output::write_line_best_effort(format_args!(
        "{} frames read as a CNC reads them, {} damaged or lost.\nThe page: {}   The figures: {}",
        summary.frames,
        summary.e2e_errors,
        shown_at.join("report.html").display(),
        shown_at.join("summary.json").display()
    ));
    Ok(())
}

/// Returns a progress bar that is drawn.
fn progress_bar() -> Result<ProgressBar> {
    let style = ProgressStyle::with_template("[{bar:30}] {percent:>3} % {msg}")?;
    let bar = ProgressBar::new(100).with_style(style);
    bar.enable_steady_tick(Duration::from_millis(200));
    Ok(bar)
}

fn show_progress(bar: &ProgressBar, what: &str, share: f64) {
    if !what.is_empty() {
        bar.set_message(what.to_string());
    }
    if share.is_finite() {
        bar.set_position((100.0 * share) as u64);
    }
}
