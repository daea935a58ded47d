//! A real CNC in the loop: Debian's LinuxCNC moves a virtual gantry, the bridge's real firmware
//! corrects it, and what counts is where the tool tip truly is.
//!
//! ```text
//!            ┌───────────── trueup linuxcnc (HAL) ◄─── SLCAN ◄─── adapter ◄─ CAN ─┐
//!            ▼ external offset     └─ positions, angles, speed ──────────────► board (QEMU)
//!       LinuxCNC ─ motor positions ─► twin ─ volts, temperatures ──────────────────┘
//!                                      └─► true error of the tool tip ─► figures, report
//! ```
//!
//! | part | is | file |
//! |---|---|---|
//! | CNC | Debian's `linuxcnc-uspace`, no screen, no privileges, real time | [`headless_linuxcnc`], [`config`] |
//! | component | `trueup linuxcnc`, wired by `integrations/linuxcnc/trueup.hal` | |
//! | bridge | the firmware in QEMU, or the image that is flashed on the model of its chip | `emulated_bridge` |
//! | its link in QEMU | CAN through the pipes of the samples, SLCAN before it | `slcan_adapter` |
//! | machine | the twin: heat, guides, screws, spindle, sensors | [`plant`], `machine.toml` |
//! | machine file | measured on the twin, fitted, diagnosed | `machine_measurement` |
//! | figures | from every servo cycle | [`loop_results`], [`html_report`] |
//! | how far the backlash goes up and down | the staircase without LinuxCNC, again and again | [`repeatability`] |
//!
//! Tests that need a control and no bridge start the LinuxCNC of [`simulated_joints`].
//!
//! What is compressed, and how. In QEMU: in the warm-up a second of the wall is up to `TIME_COMPRESSION`
//! seconds of board and machine; LinuxCNC stays in real time and its G-code waits for the machine's clock.
//! The board counts silence of the CNC in its own time, so it gets `[limits]` that are as many times
//! longer, and LinuxCNC gets every 257th pair of offsets. All motion is cut at real time.
//!
//! On the model of the chip a second of the board is some of the wall, by a factor that is measured first.
//! The motion is slower by it (see [`config`]) and every figure is taken in the board's time. The board
//! itself cannot be hurried, so in the warm-up the machine is: it lives `TIME_COMPRESSION` seconds in one
//! of the board, whose machine file has time constants as many times shorter. No limit of anybody is other.
//!
//! Without a board it is the same: the servo thread is in real time, and the machine file has short time constants from the
//! start, because LinuxCNC reads it once. While the axes move the machine is cold, and they decide nothing.

pub mod config;
mod emulated_bridge;
pub mod headless_linuxcnc;
mod host_bridge;
pub mod html_report;
pub mod loop_results;
pub(crate) mod machine_measurement;
pub mod plant;
pub mod repeatability;
mod setup_config;
pub mod simulated_joints;
mod slcan_adapter;

use std::{
    fs,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::json;
use trueup_machine::{Machine, MachineFile, compile};
use trueup_twin::machine::SimulatedMachine as Twin;

use self::{
    emulated_bridge::{BridgeArtefacts, BridgeWiring, EmulatedBridge},
    headless_linuxcnc::HeadlessLinuxCnc,
    loop_results::{LoopFigures, RunRecord},
    machine_measurement::{LOOP_SEED, MeasuredMachine},
    plant::RunningPlant,
};
use crate::{chip, firmware_images, host_programs, setup};

/// How many times faster the machine lives through the warm-up: in QEMU than the wall, with the board, if
/// this computer is fast enough; on the model of the chip than the board.
pub(crate) const TIME_COMPRESSION: u32 = 72;

/// Where the bridge runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum BridgePlatform {
    /// The image for the emulator, in QEMU.
    #[default]
    Qemu,
    /// The image that is flashed, on the model of its chip: several times slower.
    Chip,
    /// No board: the bridge runs in LinuxCNC's servo thread.
    Servo,
}

/// Where the offsets enter LinuxCNC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum OffsetEntryPoint {
    /// As external offsets, by the HAL files of `integrations/linuxcnc`.
    #[default]
    Eoffset,
    /// Between joint and drive, as `trueup linuxcnc setup` writes it.
    Joint,
}

/// A way from the machine to LinuxCNC's drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CompensationRoute {
    /// Where the bridge runs.
    pub on: BridgePlatform,
    /// Where its offsets enter.
    pub by: OffsetEntryPoint,
}

impl CompensationRoute {
    /// Where the page and the figures go.
    fn output_folder(self) -> String {
        let on = match self.on {
            BridgePlatform::Qemu => "",
            BridgePlatform::Chip => "-chip",
            BridgePlatform::Servo => "-servo",
        };
        let by = if self.by == OffsetEntryPoint::Joint { "-joint" } else { "" };
        format!("target/linuxcnc{on}{by}")
    }

    /// Returns whether `trueup linuxcnc setup` writes the HAL files.
    fn has_hal_files_from_setup(self) -> bool {
        self.on == BridgePlatform::Servo || self.by == OffsetEntryPoint::Joint
    }
}

/// The warm-up in seconds of the machine.
pub(crate) const WARM_UP_DURATION_S: u32 = 7_200;
/// The first pass of the path, without compensation, and the second, with it; then the warm-up.
pub(crate) const PASS_NUMBERS: [u32; 3] = [1, 2, 3];
/// A part of a program may take so long.
const NC_PROGRAM_TIMEOUT: Duration = Duration::from_secs(180);
/// The warm-up may take this many times as long as planned, on a computer that is too slow.
const WARM_UP_TIMEOUT_FACTOR: u32 = 6;
const CONVERTER_NOISE_SEED: u64 = 77;

/// Runs the whole; `None` where the distribution has no package of LinuxCNC, or the compiler is too old for
/// the model of the chip.
///
/// # Errors
/// Something does not run. What is not reached is not an error here: `Figures::ensure_all_checks_passed` says it.
pub fn run(way: CompensationRoute) -> Result<Option<LoopFigures>> {
    let on = way.on;
    let started = Instant::now();
    let Some(control) = setup::install_and_lock_linuxcnc()? else { return Ok(None) };
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {elapsed} {msg}")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    let announce = |what: &str| {
        // Also where no progress bar is shown.
        bar.suspend(|| {
            trueup_output::write_diagnostic(format_args!(
                "{:>4.0} s  {what}",
                started.elapsed().as_secs_f64()
            ))
        });
        bar.set_message(what.to_owned());
    };

    let Some((trueup, measured, images)) = prepare_bridge_and_machine(way, &announce)? else {
        return Ok(None);
    };

    announce("starting the bridge and LinuxCNC");
    let twin = machine_measurement::load_twin_scenario()?;
    let inputs = measured.machine.inputs.as_ref().context("the machine file has its inputs")?;
    let sensor = inputs.sensor.as_ref().context("the machine file has a sensor")?;
    let temperatures = inputs.temperatures.clone();
    let wiring = BridgeWiring { temperatures, divider: sensor.divider, seed: CONVERTER_NOISE_SEED };
    let bridge = EmulatedBridge::start(images, wiring)?;
    let slower = bridge.slowdown_factor();
    if slower > 1 {
        announce(&format!(
            "a second of the board is given {slower} of the wall, and so is the CNC's"
        ));
    }
    let mut plant = RunningPlant::start(bridge, Twin::new(&twin, LOOP_SEED))?;
    let mut cnc = start_linuxcnc(&trueup, &plant, &measured, way, control)?;
    let (sampler, cycles) = cnc.start_sampler()?;
    plant.attach_sampler(cycles);
    cnc.power_on_and_home()?;

    announce("the path without compensation");
    cnc.set_pin("trueup.0.enable", 0)?;
    run_program(&mut cnc, &mut plant, "path-1.ngc")?;
    announce("the path with compensation");
    cnc.set_pin("trueup.0.enable", 1)?;
    wait_until_engaged(&mut cnc, &mut plant)?;
    run_program(&mut cnc, &mut plant, "path-2.ngc")?;

    announce(&format!("two hours of warm-up, {TIME_COMPRESSION} times as fast"));
    // Without a board the machine file is that of the warm-up from the start.
    if on != BridgePlatform::Servo {
        plant.restart_for_warm_up();
        thread::sleep(Duration::from_secs(2) * slower);
    }
    wait_until_engaged(&mut cnc, &mut plant)?;
    // Its HAL files say that the bridge was away.
    cnc.send_request(&json!({ "do": "stat" }))?;
    let warm_up = Instant::now();
    run_warm_up_phase(&mut cnc, &mut plant)?;
    let warm_up_wall_s = warm_up.elapsed().as_secs_f64();
    announce("five axes, at real time");
    while cnc.is_program_running()? {
        plant.check_running()?;
        ensure!(
            warm_up.elapsed() < NC_PROGRAM_TIMEOUT * WARM_UP_TIMEOUT_FACTOR * slower,
            "the program does not end"
        );
        thread::sleep(Duration::from_millis(50));
    }
    // Without a board there is no line.
    let of_line: &[&str] = match on {
        BridgePlatform::Servo => &[],
        _ => &["crc-errors", "seq-errors", "lost", "malformed"],
    };
    let names = [of_line, &["fault"]].concat();
    let pins: Vec<String> = names.iter().map(|name| format!("trueup.0.{name}")).collect();
    let errors = cnc.read_pins(&pins.iter().map(String::as_str).collect::<Vec<_>>())?;
    announce("ending");
    drop(sampler);
    cnc.close()?;
    let log = plant.take_log();
    let (cycles, account) = plant.finish()?;
    bar.finish_and_clear();
    let run = RunRecord {
        way,
        slower,
        cycles,
        account,
        warm_up_wall_s,
        errors: names.into_iter().map(str::to_owned).zip(errors).collect(),
        machine_file: measured.text,
        findings: measured.findings,
        slew_um_per_s: measured.machine.limits.slew_um_per_s,
        wall_s: started.elapsed().as_secs_f64(),
        log,
    };
    LoopFigures::from_run(&run).map(Some)
}

/// Builds the bridge and the tool, and measures the machine; `None`: the compiler is too old for the model of the chip.
fn prepare_bridge_and_machine(
    way: CompensationRoute,
    announce: &impl Fn(&str),
) -> Result<Option<(PathBuf, MeasuredMachine, BridgeArtefacts)>> {
    announce("building the firmware and the host tool");
    let trueup = host_programs::build_trueup()?;
    // The image, the program that is the chip, or the library of the component.
    let firmware = match way.on {
        BridgePlatform::Qemu => Some(firmware_images::build_virtual_board_image()?),
        BridgePlatform::Chip => chip::build_model()?,
        BridgePlatform::Servo => Some(host_programs::build_servo_library()?),
    };
    let Some(firmware) = firmware else { return Ok(None) };
    announce("measuring the machine, fitting its machine file");
    let measured = {
        let work = tempfile::tempdir()?;
        machine_measurement::measure_machine(&trueup, work.path())?
    };
    let images = match way.on {
        BridgePlatform::Qemu => {
            BridgeArtefacts::Qemu(firmware, compile_calibration_blobs(&measured)?)
        }
        BridgePlatform::Chip => {
            announce("building the images of this machine");
            BridgeArtefacts::Chip(firmware, build_images(&measured, &way.output_folder())?)
        }
        BridgePlatform::Servo => BridgeArtefacts::Servo(firmware),
    };
    Ok(Some((trueup, measured, images)))
}

/// Runs it, writes `target/linuxcnc/`, or `-chip`, `-servo`, `-joint` behind that, and prints the figures.
///
/// # Errors
/// It does not run, or a figure is not reached; with the figure.
pub fn run_loop_and_write_report(way: CompensationRoute) -> Result<Option<u32>> {
    let Some(figures) = run(way)? else {
        trueup_output::write_line_best_effort(
            "skipped: there is no package of LinuxCNC, or the compiler is too old for the chip",
        );
        return Ok(None);
    };
    let shown = way.output_folder();
    let folder = setup::project_root().join(&shown);
    fs::create_dir_all(&folder)?;
    fs::write(folder.join("summary.json"), serde_json::to_string_pretty(&figures)? + "\n")?;
    fs::write(folder.join("report.html"), html_report::render_page(&figures))?;
    trueup_output::write_line_best_effort(figures.format_table());
    trueup_output::write_line_best_effort(format_args!(
        "\nThe picture: {shown}/report.html   The figures: {shown}/summary.json"
    ));
    figures.ensure_all_checks_passed().map(Some)
}

/// Returns the calibrations for real time and for compressed time, which differ in the limits that count
/// board time.
fn compile_calibration_blobs(measured: &MeasuredMachine) -> Result<[Vec<u8>; 2]> {
    let mut slow: Machine = MachineFile::parse(&measured.text, Path::new("extended.toml"))?;
    slow.limits.link_timeout_ms *= TIME_COMPRESSION;
    slow.limits.hold_ms *= TIME_COMPRESSION;
    let blob = |machine: &Machine| -> Result<Vec<u8>> { Ok(compile(machine)?.blob().to_vec()) };
    Ok([blob(&measured.machine)?, blob(&slow)?])
}

/// Returns the images for the machine, and for the same machine that lives faster, which differ in the time constants.
fn build_images(measured: &MeasuredMachine, folder: &str) -> Result<[PathBuf; 2]> {
    let folder = setup::project_root().join(folder);
    fs::create_dir_all(&folder)?;
    let image = |name: &str, text: &str| -> Result<PathBuf> {
        let machine = folder.join(name).with_extension("toml");
        fs::write(&machine, text)?;
        firmware_images::build_standalone_image(&machine)
    };
    let hurried = measured.time_compressed_machine_file(TIME_COMPRESSION)?;
    Ok([image("machine", &measured.text)?, image("hurried", &hurried)?])
}

fn start_linuxcnc(
    trueup: &Path,
    plant: &RunningPlant,
    measured: &MeasuredMachine,
    way: CompensationRoute,
    control: setup::LockedLinuxCnc,
) -> Result<HeadlessLinuxCnc> {
    let (slower, slew_um_per_s) = (plant.slowdown_factor(), measured.machine.limits.slew_um_per_s);
    let folder = HeadlessLinuxCnc::create_config_folder()?;
    fs::copy(trueup, folder.path().join("trueup"))?;
    if way.has_hal_files_from_setup() {
        return setup_config::start(plant, measured, way, folder, control);
    }
    let here = folder.path().to_str().context("a temporary folder has a plain name")?.to_owned();
    let sample = |name: &str| {
        fs::read_to_string(setup::project_root().join("integrations/linuxcnc").join(name))
    };
    let texts = [
        ("loop.ini", config::ini_file(Some(plant.address()), &here, slower)),
        ("machine.hal", config::machine_hal()),
        ("trueup_watchdog.hal", sample("trueup_watchdog.hal")?),
        ("trueup.hal", config::trueup_hal(&sample("trueup.hal")?, slew_um_per_s, slower)),
        (
            "loop.hal",
            config::angle_and_load_hal() + &config::sampler_hal(OffsetEntryPoint::Eoffset),
        ),
        ("machine.toml", measured.text.clone()),
    ];
    for (name, text) in texts.into_iter().chain(nc_programs_and_tool_table(slower)) {
        fs::write(folder.path().join(name), text)?;
    }
    HeadlessLinuxCnc::start(folder, "loop.ini", control)
}

/// Returns the programs and the table of tools.
fn nc_programs_and_tool_table(slower: u32) -> [(&'static str, String); 4] {
    [
        ("loop.tbl", String::new()),
        ("path-1.ngc", config::path_program(PASS_NUMBERS[0], slower)),
        ("path-2.ngc", config::path_program(PASS_NUMBERS[1], slower)),
        ("warm.ngc", config::warm_up_program(PASS_NUMBERS[2], slower)),
    ]
}

/// Runs a program to its end.
fn run_program(cnc: &mut HeadlessLinuxCnc, plant: &mut RunningPlant, program: &str) -> Result<()> {
    cnc.start_program(program)?;
    let begun = Instant::now();
    while cnc.is_program_running().with_context(|| cnc.recent_log())? {
        plant.check_running()?;
        let timeout = NC_PROGRAM_TIMEOUT * plant.slowdown_factor();
        ensure!(begun.elapsed() < timeout, "{program} is not done after {timeout:?}");
        thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

/// Waits until the bridge is live and LinuxCNC has applied what it says.
fn wait_until_engaged(cnc: &mut HeadlessLinuxCnc, plant: &mut RunningPlant) -> Result<()> {
    let begun = Instant::now();
    loop {
        let pins = cnc.read_pins(&["trueup.0.quality", "trueup.0.applied", "trueup.0.fault"])?;
        if pins == [1.0, 1.0, 0.0] {
            return Ok(());
        }
        plant.check_running()?;
        ensure!(
            begun.elapsed() < NC_PROGRAM_TIMEOUT,
            "the bridge is not live: quality, applied, fault are {pins:?}; the board's last word is \
             {:?}; {}",
            plant.take_log().last(),
            cnc.recent_log()
        );
        thread::sleep(Duration::from_millis(100));
    }
}

/// Two hours of the machine.
fn run_warm_up_phase(cnc: &mut HeadlessLinuxCnc, plant: &mut RunningPlant) -> Result<()> {
    let lived_s = |plant: &RunningPlant| plant.latest_cycle().map_or(0.0, |cycle| cycle.time_s);
    cnc.start_program("warm.ngc")?;
    let begun = Instant::now();
    while plant.latest_cycle().is_none_or(|cycle| cycle.phase != config::phase::WARM_UP) {
        plant.check_running()?;
        ensure!(begun.elapsed() < NC_PROGRAM_TIMEOUT, "the warm-up does not begin");
        thread::sleep(Duration::from_millis(5));
    }
    let from_s = lived_s(plant);
    // It runs up at real time: growth by speed comes within seconds.
    while plant.latest_cycle().is_none_or(|cycle| cycle.spindle_rpm < config::SPINDLE_RPM) {
        plant.check_running()?;
        ensure!(begun.elapsed() < NC_PROGRAM_TIMEOUT, "the spindle does not run up");
        thread::sleep(Duration::from_millis(5));
    }
    plant.set_time_compression(TIME_COMPRESSION);
    while lived_s(plant) - from_s < f64::from(WARM_UP_DURATION_S) {
        plant.check_running()?;
        cnc.is_program_running()?;
        ensure!(
            begun.elapsed() < NC_PROGRAM_TIMEOUT * WARM_UP_TIMEOUT_FACTOR * plant.slowdown_factor(),
            "the warm-up does not end"
        );
        thread::sleep(Duration::from_millis(20));
    }
    plant.set_time_compression(1);
    // At real time again before the axes move.
    thread::sleep(Duration::from_millis(300) * plant.slowdown_factor());
    cnc.set_pin("motion.digital-in-00", 1)
}
