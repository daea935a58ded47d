//! The bridge without a board in the real LinuxCNC: the component is built and installed by `trueup linuxcnc component`,
//! a stock configuration is checked and set up, and LinuxCNC corrects itself in its servo thread.

use std::{
    fs,
    io::{BufRead as _, BufReader},
    path::Path,
    sync::mpsc::{self, Receiver},
    thread,
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{
    host_programs,
    linuxcnc::headless_linuxcnc::{DISPLAY_PROGRAM, HeadlessLinuxCnc, SamplerGuard},
    setup::{self, LockedLinuxCnc},
};

use trueup_store::retained_state::{self, RETAINED_COPY_SIZE};

use super::{
    stock_files::{OWN, ini},
    texts, tool,
};

/// A screw whose error rises and falls by 100 µm every 10 mm, backlash, and a sensor.
const MACHINE: &str = "\
[machine]
name = \"stock\"
kind = \"3-axis\"
[inputs]
sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.328 }
[spindle]
source = \"sensor\"
[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.0152587890625
[axis.x.pitch]
start_mm = -50.0
step_mm = 10.0
forward_um = [0.0, 100.0, 0.0, 100.0, 0.0, 100.0, 0.0, 100.0, 0.0, 100.0, 0.0]
[axis.y.backlash]
width_um = 6.0
[limits]
max_um = { x = 200.0, y = 200.0, z = 500.0 }
slew_um_per_s = 1200.0
link_timeout_ms = 500
hold_ms = 2000
";
/// The sensor: 1.54 V are the zero of the machine file, and each 0.01 V is half a micrometre; its noise is a quick sine.
const SENSOR: &str = "\
loadrt siggen
addf siggen.0.update servo-thread
setp siggen.0.frequency 171.3
setp siggen.0.amplitude 0.002
setp siggen.0.offset 1.5405273
net trueup-sensor-v siggen.0.sine
";
/// A servo period of a joint.
#[derive(Clone, Copy, Debug)]
struct Cycle {
    place_mm: f64,
    goal_um: f64,
    now_um: f64,
}

/// Returns the error of X, in µm.
pub(crate) fn error_um(x_mm: f64) -> f64 {
    let place = (x_mm + 50.0).rem_euclid(20.0);
    if place <= 10.0 { 10.0 * place } else { 200.0 - 10.0 * place }
}

/// Builds and installs the component.
pub(crate) fn install(folder: &Path) -> Result<()> {
    setup::ensure_linuxcnc_dev()?;
    let (library, out) = (host_programs::build_servo_library()?, folder.join("trueup_node"));
    let (library, out) = (library.to_string_lossy(), out.to_string_lossy());
    let words = ["linuxcnc", "component", "--out", &out, "--library", &library, "--install"];
    ensure!(tool(&words, 0)?.contains("installed: trueup_node"), "it says so");
    Ok(())
}

/// Starts a stock configuration, which is checked, set up, taken out to the byte, and set up again.
pub(crate) fn start(control: LockedLinuxCnc, by: &str, period_us: u32) -> Result<HeadlessLinuxCnc> {
    let folder = HeadlessLinuxCnc::create_config_folder()?;
    let path = |name: &str| folder.path().join(name);
    let here = folder.path().to_str().context("a temporary folder has a plain name")?;
    let period = format!("SERVO_PERIOD = {period_us}000");
    let text = ini().replace("FOLDER", here).replace("SCREEN", DISPLAY_PROGRAM);
    fs::write(path("stock.ini"), text.replace("SERVO_PERIOD = 1000000", &period))?;
    fs::write(path("own.hal"), format!("{OWN}{SENSOR}"))?;
    fs::write(path("sim.tbl"), "")?;
    fs::write(path("machine.toml"), MACHINE)?;
    // LinuxCNC starts `trueup linuxcnc keep` by its name.
    fs::copy(host_programs::build_trueup()?, path("trueup"))?;
    install(folder.path())?;
    let (ini, machine) = (path("stock.ini"), path("machine.toml"));
    let (ini, machine) = (ini.to_string_lossy(), machine.to_string_lossy());
    let before = texts(folder.path())?;
    let message =
        tool(&["linuxcnc", "check", &ini, "--by", by, "--machine", &machine, "--no-board"], 0)?;
    ensure!(by != "joint" || message.contains("a reversal of 6 um takes 11.0 ms"), "{message}");
    let setup = ["linuxcnc", "setup", &ini, "--by", by, "--machine", &machine, "--no-board"];
    tool(&setup, 0)?;
    let blob = path("trueup_calibration.bin");
    ensure!(blob.is_file(), "the calibration is written");
    ensure!(tool(&setup, 0)?.contains("nothing was changed"), "setup twice changes nothing");
    tool(&["linuxcnc", "setup", &ini, "--remove"], 0)?;
    ensure!(texts(folder.path())? == before, "taken out, the files are the same to the byte");
    ensure!(!blob.is_file(), "and the calibration is gone");
    tool(&setup, 0)?;
    HeadlessLinuxCnc::start(folder, "stock.ini", control)
}

/// Checks that LinuxCNC has shown no message: a start is no alarm.
pub(crate) fn silent(cnc: &mut HeadlessLinuxCnc) -> Result<()> {
    let message = &cnc.send_request(&serde_json::json!({"do": "stat"}))?["said"];
    ensure!(message.as_array().is_some_and(Vec::is_empty), "LinuxCNC shows {message}");
    Ok(())
}

/// Waits until offsets are live and act.
pub(crate) fn is_live(cnc: &mut HeadlessLinuxCnc) -> Result<()> {
    cnc.power_on_and_home()?;
    let names = ["trueup.0.quality", "trueup.0.applied", "trueup.0.fault"];
    cnc.wait_for_pins("the offsets are live", 20, &names, |seen| seen == [1.0, 1.0, 0.0])?;
    silent(cnc)
}

/// Records a joint, what the component asks for, and what acts.
fn record(cnc: &mut HeadlessLinuxCnc, joint: usize) -> Result<(SamplerGuard, Receiver<Cycle>)> {
    for (pin, signal) in ["cmd", "offset", "now"].iter().enumerate() {
        cnc.run_halcmd(&format!("net trueup-j{joint}-{signal} => sampler.0.pin.{pin}"))?;
    }
    let (sampler, lines) = cnc.start_sampler()?;
    let (sender, cycles) = mpsc::channel();
    thread::spawn(move || {
        for line in BufReader::new(lines).lines().map_while(Result::ok) {
            let words: Vec<f64> =
                line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
            let [_, place_mm, goal, now, ..] = words[..] else { continue };
            if sender.send(Cycle { place_mm, goal_um: goal * 1e3, now_um: now * 1e3 }).is_err() {
                return;
            }
        }
    });
    Ok((sampler, cycles))
}

/// Returns by how many servo periods an offset follows the position, and how far it is from it then, in µm RMS.
fn lag(cycles: &[Cycle], offset_um: fn(&Cycle) -> f64) -> (usize, f64) {
    let rms = |lag: usize| {
        let moved = cycles.windows(2).map(|two| (two[1].place_mm - two[0].place_mm).abs() > 1e-3);
        let rows = cycles.iter().enumerate().skip(lag + 1).zip(moved.skip(lag));
        let squares: Vec<f64> = rows
            .filter(|(_, moves)| *moves)
            .map(|((at, cycle), _)| {
                (offset_um(cycle) + error_um(cycles[at - lag].place_mm)).powi(2)
            })
            .collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    };
    let all: Vec<(usize, f64)> = (0..10).map(|lag| (lag, rms(lag))).collect();
    all.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or_default()
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn without_a_board_the_servo_thread_corrects_a_stock_configuration_in_time() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else { return Ok(()) };
    let mut cnc = start(control, "joint", 1_000)?;
    let (_sampler, cycles) = record(&mut cnc, 0)?;
    is_live(&mut cnc)?;
    // Taken here, the sensor's elongation is the reference: Z stays.
    cnc.send_request_with_argument("mdi", "text", "G53 G0 X-44")?;
    cycles.try_iter().for_each(drop);
    for x in [44, -44, 44] {
        cnc.send_request_with_argument("mdi", "text", format!("G53 G1 F1500 X{x}"))?;
    }
    let cycles: Vec<Cycle> = cycles.try_iter().collect();
    let (goal, act) = (lag(&cycles, |cycle| cycle.goal_um), lag(&cycles, |cycle| cycle.now_um));
    println!(
        "{} cycles; asked for {goal:?} and acting {act:?} (periods, um RMS) after the position",
        cycles.len()
    );
    ensure!(cycles.len() > 5_000 && goal.0 == 0 && goal.1 < 0.05, "{goal:?}");
    ensure!(act.0 <= 1 && act.1 < 0.1, "{act:?}");
    let heat = cnc.folder().join("trueup_heat.bin");
    let bytes = fs::read(&heat).with_context(|| format!("{} is kept", heat.display()))?;
    let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
    copies.as_flattened_mut().copy_from_slice(&bytes);
    ensure!(retained_state::load(&copies).is_some(), "a copy of the heat is whole");
    cnc.close()
}

/// Returns how many servo periods each change of the offset by 6 µm takes, from the period that begins to ask for it until it
/// is there. The node asks for it by the slew limit of the machine file.
fn reversals(cycles: &[Cycle]) -> Vec<usize> {
    const NEAR_UM: f64 = 0.05;
    /// A reversal is looked at for so many periods; it stays where it came to.
    const WITHIN: usize = 50;
    let mut took = Vec::new();
    let mut at = 1;
    while at < cycles.len() {
        let from_um = cycles[at - 1].goal_um;
        if (cycles[at].goal_um - from_um).abs() > NEAR_UM {
            let is_off = |cycle: &Cycle| ((cycle.now_um - from_um).abs() - 6.0).abs() > NEAR_UM;
            let next = &cycles[at..cycles.len().min(at + WITHIN)];
            took.push(next.iter().rposition(is_off).map_or(0, |last| last + 1));
            at += WITHIN;
        }
        at += 1;
    }
    took
}

/// The backlash of Y: a reversal by the limits that 20 % of headroom leave, at each of the longer servo periods.
#[test]
#[ignore = "long: the real LinuxCNC"]
fn without_a_board_a_reversal_is_over_in_13_ms_and_longer_periods_correct_as_well() -> Result<()> {
    for period_us in [1_000, 2_000, 4_000] {
        let Some(control) = setup::install_and_lock_linuxcnc()? else { return Ok(()) };
        let mut cnc = start(control, "joint", period_us)?;
        let (_sampler, cycles) = record(&mut cnc, 1)?;
        is_live(&mut cnc)?;
        cycles.try_iter().for_each(drop);
        let names =
            ["trueup-mv.offset-current-0", "trueup-mv.offset-current-1", "trueup.0.applied"];
        for (line, x_mm, y_mm) in [
            ("G53 G1 F1500 X-45 Y5", -0.05, 0.0),
            ("G53 G1 F1500 Y0", -0.05, -0.006),
            ("G53 G1 F1500 X-42 Y5", -0.08, 0.0),
        ] {
            cnc.send_request_with_argument("mdi", "text", line)?;
            cnc.wait_for_pins(line, 10, &names, |seen| {
                (seen[0] - x_mm).abs() < 2e-5 && (seen[1] - y_mm).abs() < 2e-5 && seen[2] == 1.0
            })?;
        }
        thread::sleep(std::time::Duration::from_millis(300));
        let took = reversals(&cycles.try_iter().collect::<Vec<_>>());
        let ms: Vec<f64> =
            took.iter().map(|cycles| *cycles as f64 * f64::from(period_us) / 1e3).collect();
        println!("servo period {period_us} us: reversals of 6 um take {ms:?} ms");
        // The target at 1 ms; speed and goal change once a period.
        let limit = 9.0 + 4.0 * f64::from(period_us) / 1e3;
        ensure!(ms.len() >= 2 && ms.iter().all(|delay| *delay <= limit), "{period_us}: {ms:?}");
        cnc.close()?;
    }
    Ok(())
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn without_a_board_external_offsets_act_at_half_a_millisecond() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else { return Ok(()) };
    let mut cnc = start(control, "eoffset", 500)?;
    is_live(&mut cnc)?;
    let names = ["axis.x.eoffset", "axis.y.eoffset", "trueup.0.applied"];
    for (line, x_mm, y_mm) in
        [("G53 G1 F1500 X-45 Y5", -0.05, 0.0), ("G53 G1 F1500 Y0", -0.05, -0.006)]
    {
        cnc.send_request_with_argument("mdi", "text", line)?;
        cnc.wait_for_pins(line, 10, &names, |seen| {
            (seen[0] - x_mm).abs() < 2e-5 && (seen[1] - y_mm).abs() < 2e-5 && seen[2] == 1.0
        })?;
    }
    cnc.close()
}
