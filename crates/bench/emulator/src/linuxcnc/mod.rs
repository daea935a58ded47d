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
//! | CNC | Debian's `linuxcnc-uspace`, no screen, no privileges, real time | [`headless`], [`config`] |
//! | component | `trueup linuxcnc`, wired by `integrations/linuxcnc/trueup.hal` | |
//! | bridge | the firmware in QEMU, or the image that is flashed on the model of its chip | [`bridge`] |
//! | its link in QEMU | CAN through the pipes of the samples, SLCAN before it | [`adapter`] |
//! | machine | the twin: heat, guides, screws, spindle, sensors | [`plant`], `machine.toml` |
//! | machine file | measured on the twin, fitted, diagnosed | [`measured`] |
//! | figures | from every servo cycle | [`figures`], [`page`] |
//! | how far the backlash goes up and down | the staircase without LinuxCNC, again and again | [`repeat`] |
//!
//! Tests that need a control and no bridge start the LinuxCNC of [`three_joints`].
//!
//! What is compressed, and how. In QEMU: in the warm-up a second of the wall is up to `COMPRESSION`
//! seconds of board and machine; LinuxCNC stays in real time and its G-code waits for the machine's clock.
//! The board counts silence of the CNC in its own time, so it gets `[limits]` that are as many times
//! longer, and LinuxCNC gets every 257th pair of offsets. All motion is cut at real time.
//!
//! On the model of the chip a second of the board is some of the wall, by a factor that is measured first.
//! The motion is slower by it (see [`config`]) and every figure is taken in the board's time. The board
//! itself cannot be hurried, so in the warm-up the machine is: it lives `COMPRESSION` seconds in one
//! of the board, whose machine file has time constants as many times shorter. No limit of anybody is other.
//!
//! Without a board it is the same: the servo thread is in real time, and the machine file has short time constants from the
//! start, because LinuxCNC reads it once. While the axes move the machine is cold, and they decide nothing.

pub mod adapter;
pub mod bridge;
mod by_setup;
pub mod config;
pub mod figures;
pub mod headless;
mod left_over;
pub mod measured;
mod on_host;
pub mod page;
pub mod plant;
pub mod repeat;
pub mod three_joints;

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
use trueup_twin::machine::Machine as Twin;

use self::{
    bridge::{Bridge, Images, Wiring},
    figures::{Figures, Run},
    headless::Headless,
    measured::{LOOP_SEED, Measured},
    plant::Plant,
};
use crate::{chip, firmware, programs, setup};

/// How many times faster the machine lives through the warm-up: in QEMU than the wall, with the board, if
/// this computer is fast enough; on the model of the chip than the board.
pub(crate) const COMPRESSION: u32 = 72;

/// Where the bridge runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum On {
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
pub enum By {
    /// As external offsets, by the HAL files of `integrations/linuxcnc`.
    #[default]
    Eoffset,
    /// Between joint and drive, as `trueup linuxcnc setup` writes it.
    Joint,
}

/// A way from the machine to LinuxCNC's drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Way {
    /// Where the bridge runs.
    pub on: On,
    /// Where its offsets enter.
    pub by: By,
}

impl Way {
    /// Where the page and the figures go.
    fn folder(self) -> String {
        let on = match self.on {
            On::Qemu => "",
            On::Chip => "-chip",
            On::Servo => "-servo",
        };
        let by = if self.by == By::Joint { "-joint" } else { "" };
        format!("target/linuxcnc{on}{by}")
    }

    /// Returns whether `trueup linuxcnc setup` writes the HAL files.
    fn is_set_up(self) -> bool {
        self.on == On::Servo || self.by == By::Joint
    }
}

/// The warm-up in seconds of the machine.
pub(crate) const WARM_UP_S: u32 = 7_200;
/// The first pass of the path, without compensation, and the second, with it; then the warm-up.
pub(crate) const PASSES: [u32; 3] = [1, 2, 3];
/// A part of a program may take so long.
const PATIENCE: Duration = Duration::from_secs(180);
/// The warm-up may take this many times as long as planned, on a computer that is too slow.
const SLOWEST: u32 = 6;
const SEED: u64 = 77;

/// Runs the whole; `None` where the distribution has no package of LinuxCNC, or the compiler is too old for
/// the model of the chip.
///
/// # Errors
/// Something does not run. What is not reached is not an error here: [`Figures::check`] says it.
pub fn run(way: Way) -> Result<Option<Figures>> {
    let on = way.on;
    let started = Instant::now();
    let Some(control) = setup::linuxcnc()? else { return Ok(None) };
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {elapsed} {msg}")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    let announce = |what: &str| {
        // Also where nobody watches a bar.
        bar.suspend(|| {
            trueup_output::diagnostic(format_args!(
                "{:>4.0} s  {what}",
                started.elapsed().as_secs_f64()
            ))
        });
        bar.set_message(what.to_owned());
    };

    let Some((trueup, measured, images)) = prepared(way, &announce)? else { return Ok(None) };

    announce("starting the bridge and LinuxCNC");
    let twin = measured::twin()?;
    let inputs = measured.machine.inputs.as_ref().context("the machine file has its inputs")?;
    let sensor = inputs.sensor.as_ref().context("the machine file has a sensor")?;
    let temperatures = inputs.temperatures.clone();
    let wiring = Wiring { temperatures, divider: sensor.divider, seed: SEED };
    let bridge = Bridge::start(images, wiring)?;
    let slower = bridge.slower();
    if slower > 1 {
        announce(&format!(
            "a second of the board is given {slower} of the wall, and so is the CNC's"
        ));
    }
    let mut plant = Plant::start(bridge, Twin::new(&twin, LOOP_SEED))?;
    let mut cnc = start(&trueup, &plant, &measured, way, control)?;
    let (sampler, cycles) = cnc.sample()?;
    plant.listen(cycles);
    cnc.switch_on()?;

    announce("the path without compensation");
    cnc.set("trueup.0.enable", 0)?;
    cut(&mut cnc, &mut plant, "path-1.ngc")?;
    announce("the path with compensation");
    cnc.set("trueup.0.enable", 1)?;
    engaged(&mut cnc, &mut plant)?;
    cut(&mut cnc, &mut plant, "path-2.ngc")?;

    announce(&format!("two hours of warm-up, {COMPRESSION} times as fast"));
    // Without a board the machine file is that of the warm-up from the start.
    if on != On::Servo {
        plant.swap();
        thread::sleep(Duration::from_secs(2) * slower);
    }
    engaged(&mut cnc, &mut plant)?;
    // Its HAL files say that the bridge was away.
    cnc.ask(&json!({ "do": "stat" }))?;
    let warm_up = Instant::now();
    warm_up_phase(&mut cnc, &mut plant)?;
    let warm_up_wall_s = warm_up.elapsed().as_secs_f64();
    announce("five axes, at real time");
    while cnc.is_busy()? {
        plant.check()?;
        ensure!(warm_up.elapsed() < PATIENCE * SLOWEST * slower, "the program does not end");
        thread::sleep(Duration::from_millis(50));
    }
    // Without a board there is no line.
    let of_line: &[&str] = match on {
        On::Servo => &[],
        On::Qemu | On::Chip => &["crc-errors", "seq-errors", "lost", "malformed"],
    };
    let names = [of_line, &["fault"]].concat();
    let pins: Vec<String> = names.iter().map(|name| format!("trueup.0.{name}")).collect();
    let errors = cnc.pins(&pins.iter().map(String::as_str).collect::<Vec<_>>())?;
    announce("ending");
    drop(sampler);
    cnc.end()?;
    let log = plant.take_log();
    let (cycles, account) = plant.finish()?;
    bar.finish_and_clear();
    let run = Run {
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
    Figures::of(&run).map(Some)
}

/// Builds the bridge and the tool, and measures the machine; `None`: the compiler is too old for the model of the chip.
fn prepared(way: Way, announce: &impl Fn(&str)) -> Result<Option<(PathBuf, Measured, Images)>> {
    announce("building the firmware and the host tool");
    let trueup = programs::trueup()?;
    // The image, the program that is the chip, or the library of the component.
    let firmware = match way.on {
        On::Qemu => Some(firmware::build_virtual()?),
        On::Chip => chip::build()?,
        On::Servo => Some(programs::servo_library()?),
    };
    let Some(firmware) = firmware else { return Ok(None) };
    announce("measuring the machine, fitting its machine file");
    let measured = {
        let work = tempfile::tempdir()?;
        measured::measure(&trueup, work.path())?
    };
    let images = match way.on {
        On::Qemu => Images::Qemu(firmware, blobs(&measured)?),
        On::Chip => {
            announce("building the images of this machine");
            Images::Chip(firmware, images(&measured, &way.folder())?)
        }
        On::Servo => Images::Servo(firmware),
    };
    Ok(Some((trueup, measured, images)))
}

/// Runs it, writes `target/linuxcnc/`, or `-chip`, `-servo`, `-joint` behind that, and prints the figures.
///
/// # Errors
/// It does not run, or a figure is not reached; with the figure.
pub fn run_and_publish(way: Way) -> Result<Option<u32>> {
    let Some(figures) = run(way)? else {
        trueup_output::line(
            "skipped: there is no package of LinuxCNC, or the compiler is too old for the chip",
        );
        return Ok(None);
    };
    let shown = way.folder();
    let folder = setup::root().join(&shown);
    fs::create_dir_all(&folder)?;
    fs::write(folder.join("summary.json"), serde_json::to_string_pretty(&figures)? + "\n")?;
    fs::write(folder.join("report.html"), page::page(&figures))?;
    trueup_output::line(figures.table());
    trueup_output::line(format_args!(
        "\nThe picture: {shown}/report.html   The figures: {shown}/summary.json"
    ));
    figures.check().map(Some)
}

/// Returns the calibrations for real time and for compressed time, which differ in the limits that count
/// board time.
fn blobs(measured: &Measured) -> Result<[Vec<u8>; 2]> {
    let mut slow: Machine = MachineFile::parse(&measured.text, Path::new("extended.toml"))?;
    slow.limits.link_timeout_ms *= COMPRESSION;
    slow.limits.hold_ms *= COMPRESSION;
    let blob = |machine: &Machine| -> Result<Vec<u8>> { Ok(compile(machine)?.blob().to_vec()) };
    Ok([blob(&measured.machine)?, blob(&slow)?])
}

/// Returns the images for the machine, and for the same machine that lives faster, which differ in the time constants.
fn images(measured: &Measured, folder: &str) -> Result<[PathBuf; 2]> {
    let folder = setup::root().join(folder);
    fs::create_dir_all(&folder)?;
    let image = |name: &str, text: &str| -> Result<PathBuf> {
        let machine = folder.join(name).with_extension("toml");
        fs::write(&machine, text)?;
        firmware::build_for(&machine)
    };
    let hurried = measured.hurried(COMPRESSION)?;
    Ok([image("machine", &measured.text)?, image("hurried", &hurried)?])
}

fn start(
    trueup: &Path,
    plant: &Plant,
    measured: &Measured,
    way: Way,
    control: setup::LinuxCnc,
) -> Result<Headless> {
    let (slower, slew_um_per_s) = (plant.slower(), measured.machine.limits.slew_um_per_s);
    let folder = Headless::new_folder()?;
    fs::copy(trueup, folder.path().join("trueup"))?;
    if way.is_set_up() {
        return by_setup::start(plant, measured, way, folder, control);
    }
    let here = folder.path().to_str().context("a temporary folder has a plain name")?.to_owned();
    let sample =
        |name: &str| fs::read_to_string(setup::root().join("integrations/linuxcnc").join(name));
    let texts = [
        ("loop.ini", config::ini(Some(plant.address()), &here, slower)),
        ("machine.hal", config::machine_hal()),
        ("trueup_watchdog.hal", sample("trueup_watchdog.hal")?),
        ("trueup.hal", config::trueup_hal(&sample("trueup.hal")?, slew_um_per_s, slower)),
        ("loop.hal", config::angles_hal() + &config::loop_hal(By::Eoffset)),
        ("machine.toml", measured.text.clone()),
    ];
    for (name, text) in texts.into_iter().chain(programs_of(slower)) {
        fs::write(folder.path().join(name), text)?;
    }
    Headless::start(folder, "loop.ini", control)
}

/// Returns the programs and the table of tools.
fn programs_of(slower: u32) -> [(&'static str, String); 4] {
    [
        ("loop.tbl", String::new()),
        ("path-1.ngc", config::path(PASSES[0], slower)),
        ("path-2.ngc", config::path(PASSES[1], slower)),
        ("warm.ngc", config::warm(PASSES[2], slower)),
    ]
}

/// Runs a program to its end.
fn cut(cnc: &mut Headless, plant: &mut Plant, program: &str) -> Result<()> {
    cnc.begin(program)?;
    let begun = Instant::now();
    while cnc.is_busy().with_context(|| cnc.said())? {
        plant.check()?;
        let patience = PATIENCE * plant.slower();
        ensure!(begun.elapsed() < patience, "{program} is not done after {patience:?}");
        thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

/// Waits until the bridge is live and LinuxCNC has applied what it says.
fn engaged(cnc: &mut Headless, plant: &mut Plant) -> Result<()> {
    let begun = Instant::now();
    loop {
        let pins = cnc.pins(&["trueup.0.quality", "trueup.0.applied", "trueup.0.fault"])?;
        if pins == [1.0, 1.0, 0.0] {
            return Ok(());
        }
        plant.check()?;
        ensure!(
            begun.elapsed() < PATIENCE,
            "the bridge is not live: quality, applied, fault are {pins:?}; the board's last word is \
             {:?}; {}",
            plant.take_log().last(),
            cnc.said()
        );
        thread::sleep(Duration::from_millis(100));
    }
}

/// Two hours of the machine.
fn warm_up_phase(cnc: &mut Headless, plant: &mut Plant) -> Result<()> {
    let lived_s = |plant: &Plant| plant.latest().map_or(0.0, |cycle| cycle.time_s);
    cnc.begin("warm.ngc")?;
    let begun = Instant::now();
    while plant.latest().is_none_or(|cycle| cycle.phase != config::phase::WARM_UP) {
        plant.check()?;
        ensure!(begun.elapsed() < PATIENCE, "the warm-up does not begin");
        thread::sleep(Duration::from_millis(5));
    }
    let from_s = lived_s(plant);
    // It runs up at real time: growth by speed comes within seconds.
    while plant.latest().is_none_or(|cycle| cycle.spindle_rpm < config::SPINDLE_RPM) {
        plant.check()?;
        ensure!(begun.elapsed() < PATIENCE, "the spindle does not run up");
        thread::sleep(Duration::from_millis(5));
    }
    plant.set_factor(COMPRESSION);
    while lived_s(plant) - from_s < f64::from(WARM_UP_S) {
        plant.check()?;
        cnc.is_busy()?;
        ensure!(begun.elapsed() < PATIENCE * SLOWEST * plant.slower(), "the warm-up does not end");
        thread::sleep(Duration::from_millis(20));
    }
    plant.set_factor(1);
    // At real time again before the axes move.
    thread::sleep(Duration::from_millis(300) * plant.slower());
    cnc.set("motion.digital-in-00", 1)
}
