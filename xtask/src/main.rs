//! The project's own commands. Their work is in `trueup-emulator`; here are only their messages.

mod demo;
#[cfg(test)]
mod tests;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::UNIX_EPOCH,
};

use anyhow::{Context as _, Result, bail};
use clap::{Args, Parser, Subcommand};
use trueup_campaigns::faulty_machine::SeparableFaultMachine;
use trueup_checks::{
    api_docs, book, campaign, debian_package, release, structure, timing_bounds,
    verify::{self, TestTier},
};
use trueup_demo::{campaign::CampaignStatistics, stepped_board::BoardSource};
use trueup_emulator::{
    benchmark, chip,
    firmware_images::{self, Board},
    linuxcnc, memory_usage, release_images, setup, slot_images,
};
use trueup_machine::{InputFileError, MachineFile};

use demo::{DemoArgs, run_demo};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "The project's own commands")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Finds what is wrong in a measured run, and shows on an emulated board what mending it brings.
    Demo(DemoArgs),
    /// Hides faults in many virtual machines, and counts how often the demonstration's second act is right.
    Hidden {
        /// How many machines.
        #[arg(long, default_value_t = 200)]
        seeds: u64,
        /// The first seed.
        #[arg(long, default_value_t = 0)]
        first: u64,
        /// How many machines that change their tools, after those.
        #[arg(long, default_value_t = 12)]
        tools: u64,
        /// On the emulated board, and not on its application in this process.
        #[arg(long)]
        board: bool,
    },
    /// Runs the quick tier of every kind of test: host, emulated board, real clients.
    Verify(VerifyArgs),
    /// Runs a virtual bridge for any client, until Ctrl-C.
    Virtual(VirtualArgs),
    /// Runs the flashable image on the model of its chip: its log here, its serial line on a TCP port.
    Chip(ChipArgs),
    /// Lets the real LinuxCNC cut on a virtual machine that the bridge corrects.
    #[command(name = "linuxcnc")]
    LinuxCnc(LinuxCncArgs),
    /// Prints the size of the firmware images.
    Size,
    /// Bounds the time of every task of the flashable image, on each clock, next to the longest that the model of the
    /// chip sees.
    Bounds {
        /// Print the longest path of this task instead: its functions, by the time of their own.
        #[arg(long, value_name = "TASK")]
        path: Option<String>,
        /// The clock of the path in MHz.
        #[arg(long, value_name = "MHZ", default_value_t = 168)]
        clock: u32,
        /// The path with the largest calibration.
        #[arg(long)]
        largest: bool,
    },
    /// Builds the firmware images that an installed `trueup` carries, in target/carried.
    Images,
    /// Builds the image that is flashed, boot program and slot A, and the file that updates a board, in target/images.
    ///
    /// TRUEUP_MACHINE=M.toml links a machine file in, TRUEUP_FIRMWARE_VERSION states another version than the project's.
    /// TRUEUP_KEY names the public key that boards check updates with, TRUEUP_SIGNING_KEY its private half; without them the
    /// key is that of developers, whose private half everybody has.
    Firmware,
    /// Counts instructions on the emulated board, and compares its frames with the host's.
    Measure,
    /// Hides each effect in the virtual machine's data, and counts how often it is named right: the
    /// long run, some minutes to an hour.
    Scorecard {
        /// Draws of each effect.
        #[arg(default_value_t = 20)]
        seeds: u32,
    },
    /// Draws circles with faults, and counts how often `trueup fit circle` names all of them and nothing else.
    Circles {
        /// How many; a third as many sound ones after them.
        #[arg(long, default_value_t = 300)]
        circles: u32,
    },
    /// Draws machines with all errors of a volume, and prints how much of the error `trueup fit volume` takes away.
    Volumes {
        /// How many.
        #[arg(long, default_value_t = 100)]
        volumes: u32,
        /// The first seed.
        #[arg(long, default_value_t = 0)]
        first: u32,
        /// How an error goes over its axis.
        #[arg(long, default_value = "polynomials", value_parser = ["polynomials", "waves", "walk"])]
        law: String,
    },
    /// Compares the board's errors of the volume with homogeneous transforms in Python.
    VolumeBoard {
        /// At how many poses.
        #[arg(long, default_value_t = 1_000_000)]
        poses: u32,
    },
    /// Lets the simulated bridge live through faults and restarts for a thousand million ticks, 12 days of
    /// a board.
    Soak {
        /// How many ticks of a millisecond.
        #[arg(long, default_value_t = 1_000_000_000)]
        ticks: u64,
        /// The first seed, each lives for ten minutes; the one that a failure has printed repeats it.
        #[arg(long, default_value_t = 1_000)]
        seed: u32,
    },
    /// Fuzzes what comes from outside: calibrations, flash, SDO, both ends of the line, files, plants.
    Fuzz {
        /// For each of them.
        #[arg(long, default_value_t = 15)]
        minutes: u64,
    },
    /// Changes the code that a board runs in places drawn at random, and counts how many changes its tests
    /// find: a minute or so for each.
    Mutants {
        /// How many.
        #[arg(long, default_value_t = 300)]
        draw: usize,
        /// Draws the same again.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// All changes of the functions between an input and an offset instead, on the simulator alone.
        #[arg(long, conflicts_with_all = ["draw", "seed"])]
        simulator: bool,
    },
    /// Counts circles of files, long files and functions, dependencies on higher layers, and the words of documents;
    /// fails above the limits.
    Structure,
    /// Draws names of the source at random, for a reader who judges whether each is the field's term.
    Names {
        /// How many.
        #[arg(long, default_value_t = 60)]
        count: usize,
        /// The same names again.
        #[arg(long)]
        seed: Option<u64>,
        /// Draws from the sources of another project instead: what readers reject there shows how strict they are.
        #[arg(long)]
        root: Option<PathBuf>,
    },
    /// Makes the Debian package of the host tool, in target/debian.
    Deb {
        /// Then installs it into an empty Debian, uses the tool there, and removes it; as root, with debootstrap.
        #[arg(long = "try")]
        is_tried: bool,
    },
    /// Makes what is handed out with a release, in target/release-files: archives, Debian package, images, parts lists,
    /// licences, known vulnerabilities, declarations, SHA-256, signatures. Builds in two folders and compares.
    ///
    /// Fails in the end if something was skipped, such as a platform without its tool chain; the rest is there.
    Release {
        /// Signs each file with this key (`trueup sign --new KEY.pem` makes one).
        #[arg(long, value_name = "KEY.pem")]
        key: Option<PathBuf>,
        /// Only what is built, once, in this folder.
        #[arg(long, conflicts_with = "key")]
        once: bool,
    },
    /// Makes web pages of the book, docs/book, in target/book.
    Book,
    /// Makes the documentation of all crates for programmers in target/doc, with a front page.
    Doc,
    /// Gets what this machine lacks: target, QEMU, Python clients.
    Setup,
}

#[derive(Args)]
#[command(args_conflicts_with_subcommands = true)]
struct LinuxCncArgs {
    /// Where the bridge runs.
    #[arg(long, value_enum, default_value_t)]
    on: linuxcnc::BridgePlatform,
    /// Where its offsets enter LinuxCNC.
    #[arg(long, value_enum, default_value_t)]
    by: linuxcnc::OffsetEntryPoint,
    #[command(subcommand)]
    command: Option<LinuxCncCommand>,
}

#[derive(Subcommand)]
enum LinuxCncCommand {
    /// Lets drawn events happen to it while offsets act, and judges every servo cycle: half an hour.
    Abuse {
        /// How many servo cycles of a millisecond, all ways together.
        #[arg(long, default_value_t = 1_000_000)]
        cycles: u64,
        /// How many events at least.
        #[arg(long, default_value_t = 1_000)]
        events: u64,
        /// Draws the same events again; others each time by default.
        #[arg(long)]
        seed: Option<u64>,
        /// How offsets enter, with commas between.
        #[arg(long, default_value = "joint,eoffset,no-board")]
        ways: String,
    },
    /// Cuts the same circle without the bridge and with it, from what a ball bar says of the first: three minutes.
    Circle,
    /// Goes through the loop's staircase again and again without LinuxCNC: by how much the backlash goes up and down.
    Repeat {
        /// How often, with each of two machine files.
        #[arg(long, default_value_t = 100)]
        runs: u64,
    },
}

#[derive(Args)]
struct VerifyArgs {
    /// The long tier: long tests, LinuxCNC, the distribution's compiler.
    #[arg(long)]
    long: bool,
    /// Every test: both tiers.
    #[arg(long, conflicts_with = "long")]
    all: bool,
}

#[derive(Args)]
struct VirtualArgs {
    /// The machine file.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    #[command(flatten)]
    options: trueup_virtual_bridge::BridgeOptions,
}

#[derive(Args)]
#[command(after_help = "For instance:\n  \
    cargo xtask chip                        then: trueup bridge info --port tcp:127.0.0.1:3333\n  \
    cargo xtask chip --ms 2000 --hse-dead   two seconds with a dead crystal, and the report\n\
    All options of the model: crates/bench/chip/README.md. TRUEUP_MACHINE=M.toml chooses the machine file.")]
struct ChipArgs {
    /// Options of the model. Without --ms it runs until Ctrl-C, without --serial on port 3333.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "OPTION")]
    options: Vec<String>,
}

fn main() -> ExitCode {
    // `cargo virtual -- --run R.csv`: the alias has had its own `--`, so this one arrives here, where
    // it would turn all options behind it into words.
    let words = std::env::args_os().filter(|word| word != "--");
    let result = match Cli::parse_from(words).command {
        Command::Demo(options) => run_demo(&options),
        Command::Hidden { seeds, first, tools, board } => {
            run_hidden_fault_campaign(seeds, first, tools, board)
        }
        Command::Verify(VerifyArgs { all: true, .. }) => verify::run(TestTier::All),
        Command::Verify(VerifyArgs { long: true, .. }) => verify::run(TestTier::Long),
        Command::Verify(_) => verify::run(TestTier::Quick),
        Command::Virtual(options) => run_virtual_bridge(options),
        Command::Chip(ChipArgs { options }) => run_chip_model(options),
        Command::LinuxCnc(options) => run_linuxcnc_command(options),
        Command::Size => memory_usage::build_size_report()
            .map(|report| trueup_output::write_line_best_effort(report.trim_end())),
        Command::Bounds { path, clock, largest } => match path {
            Some(task) => timing_bounds::build_longest_path_report(&task, clock, largest),
            None => timing_bounds::build_timing_report(),
        }
        .map(|report| trueup_output::write_line_best_effort(report.trim_end())),
        Command::Images => release_images::build_bundled_images()
            .map(|folder| trueup_output::write_line_best_effort(folder.display())),
        Command::Firmware => release_images::build_flashable_files().map(|built| {
            trueup_output::write_line_best_effort(built.image.display());
            trueup_output::write_line_best_effort(built.update.display());
        }),
        Command::Measure => benchmark::run_benchmark(benchmark::TEST_VECTOR_COUNT)
            .and_then(|measured| measured.print_and_write_json()),
        Command::Scorecard { seeds } => verify::run_scorecard(seeds),
        Command::Fuzz { minutes } => campaign::run_fuzz_targets(minutes),
        Command::Mutants { simulator: true, .. } => campaign::run_simulator_mutation_campaign(),
        Command::Mutants { draw, seed, .. } => campaign::run_mutation_campaign(draw, seed),
        Command::Circles { circles } => campaign::run_circle_campaign(circles),
        Command::Volumes { volumes, first, law } => {
            campaign::run_volume_campaign(volumes, first, &law)
        }
        Command::VolumeBoard { poses } => campaign::run_volume_board_campaign(poses),
        Command::Soak { ticks, seed } => campaign::run_soak_campaign(ticks, seed),
        Command::Names { count, seed, root } => {
            let root = root.unwrap_or_else(setup::project_root);
            print_random_names(count, seed.unwrap_or_else(random_seed), &root)
        }
        Command::Structure => structure::check_structure(&setup::project_root())
            .map(|report| trueup_output::write_line_best_effort(report.trim_end())),
        Command::Deb { is_tried } => build_deb(is_tried),
        Command::Release { once: true, .. } => release::build_release_files(),
        Command::Release { key, .. } => create_release(key.as_deref()),
        Command::Book => {
            book::render_book().map(|page| trueup_output::write_line_best_effort(page.display()))
        }
        Command::Doc => api_docs::build_api_docs(false)
            .map(|page| trueup_output::write_line_best_effort(page.display())),
        Command::Setup => setup::install_all_dependencies(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            trueup_output::write_diagnostic(format_args!("error: {error:#}"));
            // What the user can mend in a file is distinguished from everything else.
            ExitCode::from(if error.is::<InputFileError>() { 2 } else { 1 })
        }
    }
}

fn build_deb(is_tried: bool) -> Result<()> {
    let package = debian_package::build_host_package()?;
    if is_tried {
        debian_package::test_install(&package)?;
    }
    trueup_output::write_line_best_effort(package.display());
    Ok(())
}

fn create_release(key: Option<&Path>) -> Result<()> {
    let made = release::create_release(key)?;
    for file in &made.files {
        trueup_output::write_line_best_effort(made.folder.join(file).display());
    }
    if made.skipped.is_empty() {
        return Ok(());
    }
    bail!("the release is not whole: {}", made.skipped.join("\n"))
}

fn run_chip_model(mut options: Vec<String>) -> Result<()> {
    let Some(model) = chip::build_model()? else {
        let (major, minor) = chip::MIN_COMPILER_VERSION;
        bail!("the model of the chip needs Rust {major}.{minor} or newer");
    };
    // Without a machine file of the user's, one that is named: the example's constants give no offset.
    let image = match std::env::var_os("TRUEUP_MACHINE") {
        Some(_) => firmware_images::build_board_image(Board::Stm32f405)?,
        None => {
            let machine = setup::project_root().join("data/paper_spindle.toml");
            slot_images::build_flashable_files_for_machine(
                &machine,
                slot_images::firmware_version()?,
            )?
            .image
        }
    };
    let has = |options: &[String], what: &str| options.iter().any(|option| option == what);
    if !has(&options, "--serial") {
        options.extend(["--serial", "3333"].map(Into::into));
    }
    if !has(&options, "--ms") {
        // A week of the board: the process that started it ends it.
        options.extend(["--ms", "604800000"].map(Into::into));
    }
    if !chip::run_interactive(&model, &image, &options)? {
        bail!("the report has a violation: the chip would not do what the image requests");
    }
    Ok(())
}

fn print_random_names(count: usize, seed: u64, root: &Path) -> Result<()> {
    let (names, of) = structure::declared_names::draw_names(root, count, seed)?;
    trueup_output::write_line_best_effort(format_args!("{count} of {of} names, --seed {seed}"));
    for structure::declared_names::DeclaredName { kind, name, place, .. } in names {
        trueup_output::write_line_best_effort(format_args!("{kind:<7} {name:<40} {place}"));
    }
    Ok(())
}

fn run_linuxcnc_command(LinuxCncArgs { on, by, command }: LinuxCncArgs) -> Result<()> {
    match command {
        None => {
            linuxcnc::run_loop_and_write_report(linuxcnc::CompensationRoute { on, by }).map(drop)
        }
        Some(LinuxCncCommand::Abuse { cycles, events, seed, ways }) => {
            campaign::run_linuxcnc_stress_test(
                cycles,
                events,
                seed.unwrap_or_else(random_seed),
                &ways,
            )
        }
        Some(LinuxCncCommand::Circle) => campaign::run_linuxcnc_circular_test(),
        Some(LinuxCncCommand::Repeat { runs }) => {
            linuxcnc::repeatability::run_repeatability_test(runs)
        }
    }
}

/// Another one each time.
fn random_seed() -> u64 {
    UNIX_EPOCH.elapsed().unwrap_or_default().as_micros() as u64 % 1_000_000
}

fn run_hidden_fault_campaign(seeds: u64, first: u64, tools: u64, on_board: bool) -> Result<()> {
    let boards = match on_board {
        true => BoardSource::Emulated(firmware_images::build_virtual_board_image()?),
        false => BoardSource::InProcess,
    };
    type TestCaseSampler = fn(u64) -> Result<SeparableFaultMachine>;
    let all: [(u64, &str, TestCaseSampler); 2] = [
        (seeds, "", SeparableFaultMachine::draw),
        (tools, "that change their tools: ", SeparableFaultMachine::draw_with_tool_growth),
    ];
    for (seeds, which, draw) in all {
        let mut campaign = CampaignStatistics::default();
        for seed in first..first + seeds {
            trueup_output::write_line_best_effort(campaign.run_and_record(&boards, &draw(seed)?)?);
        }
        if seeds > 0 {
            trueup_output::write_line_best_effort(format_args!(
                "{which}{}",
                campaign.format_summary()
            ));
        }
    }
    Ok(())
}

fn run_virtual_bridge(args: VirtualArgs) -> Result<()> {
    let shipped = || setup::project_root().join("data/paper_spindle.toml");
    let machine = MachineFile::read(&args.machine.unwrap_or_else(shipped))?;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("signal handler")?;
    trueup_virtual_bridge::run(
        &machine,
        &args.options,
        firmware_images::build_virtual_board_image,
        stop,
    )
}
