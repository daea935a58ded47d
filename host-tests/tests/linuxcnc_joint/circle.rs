//! `cargo xtask linuxcnc circle`: the same circle through the real LinuxCNC, without the bridge and with it.
//!
//! ```text
//! trueup program circle ─► LinuxCNC ─ drives, every servo cycle ─► virtual machine ─ ball bar ─► run file
//!         with the bridge ◄─ trueup linuxcnc setup ◄─ fitted machine file ◄─ trueup fit circle ◄────┘
//! ```
//!
//! The virtual machine has squareness, scale, backlash, straightness and the wave of a screw, and the fit sees nothing of it but
//! the readings of a ball bar. The bridge is the component without a board at the joints: it runs in the servo thread and the machine is
//! stepped by servo cycles, so a busy computer changes no figure.

use std::{
    f64::consts::TAU,
    fs,
    io::{BufRead as _, BufReader},
    path::Path,
    process::{Command as Process, Stdio},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::Value;
use trueup_emulator::{
    host_programs,
    linuxcnc::headless_linuxcnc::{DISPLAY_PROGRAM, HeadlessLinuxCnc},
    setup::{self, LockedLinuxCnc},
};
use trueup_twin::{
    Scenario,
    instrument::Instrument,
    machine::{DriveCommand, SimulatedMachine},
};

use super::{
    no_board::{install, is_live},
    stock_files::INI,
    tool,
};

/// The targets in percent: of G(b) by ISO 230-4, and of the backlash of each axis.
const MIN_ROUNDER: f64 = 80.0;
const MIN_OF_BACKLASH: f64 = 95.0;
const RADIUS_MM: f64 = 100.0;
const FEED_MM_PER_MIN: f64 = 3_000.0;
/// The names of the program, and of the run file that comes with it.
const PROGRAM: &str = "circle_xy.ngc";
const RUN: &str = "circle-xy.csv";
const CYCLE_S: f64 = 1e-3;
/// More messages than LinuxCNC has at its start.
const MESSAGES: u32 = 10;
/// Four turns at the feed take 50 s.
const TIMEOUT: Duration = Duration::from_secs(300);

/// The axes and joints of the configuration: nothing has to be searched at homing.
const AXIS: &str = "\
MIN_LIMIT = -120
MAX_LIMIT = 120
MAX_VELOCITY = 60
MAX_ACCELERATION = 1000
";
const JOINT: &str = "\
TYPE = LINEAR
FERROR = 1
MIN_FERROR = 0.25
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME = 0
HOME_SEQUENCE = 0
";
/// Records what the drives of X and Y get.
const RECORDER: &str = "\
loadrt sampler depth=16000 cfg=ff
addf sampler.0 servo-thread
net Xpos => sampler.0.pin.0
net Ypos => sampler.0.pin.1
";
/// The user's knowledge of the machine.
const KNOWN: &str = "\
[machine]
name = \"mill\"
kind = \"3-axis\"
[axis.x]
travel_mm = [-110.0, 110.0]
feedback = \"screw\"
[axis.y]
travel_mm = [-110.0, 110.0]
feedback = \"screw\"
[limits]
max_um = { x = 200.0, y = 200.0, z = 200.0 }
slew_um_per_s = 1200.0
";
/// The machine itself, and the ball bar. Its screws stay cold.
const TRUE: &str = "\
name = \"a mill\"
measure = [\"dx\"]
[ambient]
mean_c = 20.0
[axis.x]
screw_heating_c = 0.0
pitch_um_per_m = 35.0
periodic_um = 0.8
periodic_mm = 10.0
periodic_phase_deg = 40.0
backlash_um = 8.0
gap = true
[axis.y]
screw_heating_c = 0.0
pitch_um_per_m = -25.0
backlash_um = 5.0
gap = true
[[straightness]]
error = \"x\"
along = \"y\"
points = [[-110.0, 0.0], [0.0, 0.0], [110.0, 0.0]]
um_per_m = 70.0
[[straightness]]
error = \"y\"
along = \"x\"
points = [[-110.0, -3.0], [-60.0, 2.0], [-10.0, 1.0], [50.0, -3.0], [110.0, 2.0]]
[instrument]
noise_um = 0.1
[[segment]]
kind = \"spindle\"
duration_s = 1.0
";

/// LinuxCNC in a folder of its own; with the bridge where there is a `machine` file for it.
fn start(
    control: LockedLinuxCnc,
    machine: Option<&str>,
    program: &str,
) -> Result<HeadlessLinuxCnc> {
    let folder = HeadlessLinuxCnc::create_config_folder()?;
    let path = |name: &str| folder.path().join(name);
    let here = folder.path().to_str().context("a temporary folder has a plain name")?;
    let mut ini = INI.replace("FOLDER", here).replace("SCREEN", DISPLAY_PROGRAM);
    ini = ini.replace("MAX_LINEAR_VELOCITY = 53", "MAX_LINEAR_VELOCITY = 100");
    for (joint, axis) in ["X", "Y", "Z"].iter().enumerate() {
        ini += &format!("[AXIS_{axis}]\n{AXIS}[JOINT_{joint}]\n{JOINT}{AXIS}");
    }
    for (name, text) in
        [("stock.ini", &*ini), ("own.hal", RECORDER), ("sim.tbl", ""), (PROGRAM, program)]
    {
        fs::write(path(name), text)?;
    }
    if let Some(machine) = machine {
        fs::write(path("machine.toml"), machine)?;
        fs::copy(host_programs::build_trueup()?, path("trueup"))?;
        install(folder.path())?;
        let (ini, machine) = (path("stock.ini"), path("machine.toml"));
        let (ini, machine) = (ini.to_string_lossy(), machine.to_string_lossy());
        tool(
            &["linuxcnc", "setup", &ini, "--by", "joint", "--machine", &machine, "--no-board"],
            0,
        )?;
    }
    HeadlessLinuxCnc::start(folder, "stock.ini", control)
}

/// Runs the program with all its stops; returns what the drives of X and Y got in each servo cycle, in mm.
fn cut(cnc: &mut HeadlessLinuxCnc, with_bridge: bool) -> Result<Vec<[f64; 2]>> {
    let (recorder, lines) = cnc.start_sampler()?;
    let reader: JoinHandle<Result<Vec<[f64; 2]>>> = thread::spawn(move || {
        let (mut cycles, mut lines, mut line) = (Vec::new(), BufReader::new(lines), String::new());
        // It is ended in the middle of a line.
        while lines.read_line(&mut line)? > 0 && line.ends_with('\n') {
            ensure!(!line.contains("overrun"), "the recorder was overrun");
            let words: Vec<f64> =
                line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
            let [_, x_mm, y_mm] = words[..] else { bail!("a line of the recorder is {line:?}") };
            cycles.push([x_mm, y_mm]);
            line.clear();
        }
        Ok(cycles)
    });
    cnc.power_on_and_home()?;
    if with_bridge {
        is_live(cnc)?;
        ensure!(cnc.read_pin("motion.feed-inhibit")? == 0.0, "the feed is held");
        // Until then it was, and LinuxCNC has a message of it for the operator: one is taken at each look.
        for _ in 0..MESSAGES {
            cnc.is_program_running().ok();
        }
    }
    // From the centre the first two stops would be one for the screen.
    cnc.send_request_with_argument("mdi", "text", "G53 G0 X-20 Y-10")?;
    cnc.start_program(PROGRAM)?;
    let begun = Instant::now();
    while cnc.is_program_running()? {
        if cnc.is_program_paused()? {
            cnc.resume_program()?;
        }
        ensure!(begun.elapsed() < TIMEOUT, "{PROGRAM} does not end: {}", cnc.recent_log());
        thread::sleep(Duration::from_millis(100));
    }
    // What the recorder holds back for a moment.
    thread::sleep(Duration::from_millis(500));
    drop(recorder);
    let cycles = reader.join().ok().context("the reader has panicked")??;
    cnc.close()?;
    Ok(cycles)
}

/// Where the tool tip is in each servo cycle, in mm.
fn tips(cycles: &[[f64; 2]], scenario: &Scenario) -> Vec<[f64; 2]> {
    let mut machine = SimulatedMachine::new(scenario, 1);
    let tip = |&[x, y]: &[f64; 2]| {
        machine
            .step(CYCLE_S, &DriveCommand { position_mm: [x, y, 0.0], ..DriveCommand::default() });
        let [dx, dy, _] = machine.tip_error_um();
        [x + dx * 1e-3, y + dy * 1e-3]
    };
    cycles.iter().map(tip).collect()
}

/// A reading of the ball bar: degree of the circle, direction, radial deviation in µm.
struct CircleReading {
    degree: usize,
    direction: f64,
    dr_um: f64,
}

/// Reads the ball bar as the rows of a run file ask for it; returns the filled run file as well.
fn measure(
    rows: &str,
    tips: &[[f64; 2]],
    scenario: &Scenario,
) -> Result<(String, Vec<CircleReading>)> {
    let mut bar = Instrument::new(&scenario.instrument, "measured_dr_um", 1);
    let mut lines = rows.lines().skip_while(|line| line.starts_with('#'));
    let header = lines.next().context("a header")?;
    let column = |name: &str| {
        header
            .split(',')
            .position(|column| column == name)
            .with_context(|| format!("no column {name}"))
    };
    let [at_x, at_y, at_direction] = [column("x_mm")?, column("y_mm")?, column("dir")?];
    ensure!(header.ends_with("measured_dr_um"), "the reading is not last: {header}");
    let (mut filled, mut readings, mut next) = (format!("{header}\n"), Vec::new(), 0);
    let off = |[x, y]: [f64; 2]| x.hypot(y) - RADIUS_MM;
    let is_on = |tip: [f64; 2]| off(tip).abs() < 0.5;
    let turn = |from: f64, to: f64| (to - from + 1.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
    let angle = |[x, y]: [f64; 2]| y.atan2(x);
    for line in lines {
        let cells: Vec<f64> =
            line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect();
        let (place, direction) = ([cells[at_x], cells[at_y]], cells[at_direction]);
        // The two servo cycles with this angle between them, on the way in this direction.
        let passes = |pair: &[[f64; 2]]| {
            let left = direction * turn(angle(pair[0]), angle(place));
            let step = direction * turn(angle(pair[0]), angle(pair[1]));
            is_on(pair[0]) && is_on(pair[1]) && (0.0..0.1).contains(&left) && left < step
        };
        next += tips[next..].windows(2).position(passes).with_context(|| {
            format!(
                "row {}: the tip does not pass {place:?} in direction {direction}",
                readings.len()
            )
        })?;
        let share =
            turn(angle(tips[next]), angle(place)) / turn(angle(tips[next]), angle(tips[next + 1]));
        let dr_um = 1e3 * (off(tips[next]) * (1.0 - share) + off(tips[next + 1]) * share);
        let dr_um = bar.read(next as f64 * CYCLE_S, dr_um, 0.0);
        filled += &format!("{line}{dr_um:.3}\n");
        let degree = angle(place).to_degrees().round().rem_euclid(360.0) as usize;
        readings.push(CircleReading { degree, direction, dr_um });
    }
    Ok((filled, readings))
}

/// Returns the error of X and of Y behind a reversal, in µm, by least squares of the difference of both directions:
/// B_x·sgn(sin φ)·cos φ − B_y·sgn(cos φ)·sin φ. A reading behind a reversal while the gap closes is one of 360.
fn backlash_um(readings: &[CircleReading]) -> [f64; 2] {
    let mut sums = vec![[(0.0, 0.0); 2]; 360];
    for it in readings {
        let of_direction = &mut sums[it.degree][usize::from(it.direction > 0.0)];
        *of_direction = (of_direction.0 + it.dr_um, of_direction.1 + 1.0);
    }
    let (mut a, mut b) = ([[0.0; 2]; 2], [0.0; 2]);
    for (degree, [cw, ccw]) in sums.iter().enumerate() {
        let (sine, cosine) = (degree as f64).to_radians().sin_cos();
        // On an axis the sign of the other share is that of rounding.
        if cw.1 == 0.0 || ccw.1 == 0.0 || degree % 90 == 0 {
            continue;
        }
        let difference = ccw.0 / ccw.1 - cw.0 / cw.1;
        let row = [sine.signum() * cosine, -cosine.signum() * sine];
        for i in 0..2 {
            b[i] += row[i] * difference;
            for j in 0..2 {
                a[i][j] += row[i] * row[j];
            }
        }
    }
    let determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0];
    [
        (b[0] * a[1][1] - b[1] * a[0][1]) / determinant,
        (b[1] * a[0][0] - b[0] * a[1][0]) / determinant,
    ]
}

/// Returns what `trueup fit circle --json` says of a run file; the fitted machine file goes to `output`.
fn fit(run: &Path, machine: Option<&Path>, output: &Path) -> Result<Value> {
    let mut command = Process::new(host_programs::build_trueup()?);
    command.args(["fit", "circle", "--json", "--quiet", "--run"]).arg(run).arg("-o").arg(output);
    if let Some(machine) = machine {
        command.arg("--machine").arg(machine);
    }
    let done = command.stdin(Stdio::null()).output()?;
    // 3: structure without a name is left, which is an answer.
    ensure!(
        matches!(done.status.code(), Some(0 | 3)),
        "{}: {}",
        run.display(),
        String::from_utf8_lossy(&done.stderr)
    );
    Ok(serde_json::from_slice(&done.stdout)?)
}

/// Returns by how many percent of `before` a figure has become smaller.
fn reduction(before: f64, after: f64) -> f64 {
    100.0 * (1.0 - after.abs() / before.abs())
}

#[test]
#[ignore = "campaign: cargo xtask linuxcnc circle"]
fn campaign_the_same_circle_is_rounder_with_the_bridge() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let scenario = Scenario::parse(TRUE, Path::new("true.toml"))?;
    let work = setup::project_root().join("target/linuxcnc-circle");
    fs::create_dir_all(&work)?;
    let path = |name: &str| work.join(name);
    let known = path("machine.toml");
    fs::write(&known, KNOWN)?;
    let (radius, feed) = (RADIUS_MM.to_string(), FEED_MM_PER_MIN.to_string());
    let (folder, file) = (path("measure"), known.to_string_lossy());
    tool(
        &["program", "circle", "--machine", &file, "--for", "linuxcnc", "--radius", &radius]
            .into_iter()
            .chain(["--feed", &feed, "-o", &folder.to_string_lossy()])
            .collect::<Vec<_>>(),
        0,
    )?;
    let program = fs::read_to_string(folder.join(PROGRAM))?;
    let rows = fs::read_to_string(folder.join(RUN))?;

    let mut cnc = start(control, None, &program)?;
    let tips_before = tips(&cut(&mut cnc, false)?, &scenario);
    let (run, readings_before) = measure(&rows, &tips_before, &scenario)?;
    fs::write(path("without.csv"), run)?;
    let fitted = path("fitted.toml");
    let before = fit(&path("without.csv"), Some(&known), &fitted)?;

    let mut cnc = start(cnc.shut_down()?, Some(&fs::read_to_string(&fitted)?), &program)?;
    let tips_after = tips(&cut(&mut cnc, true)?, &scenario);
    let (run, readings_after) = measure(&rows, &tips_after, &scenario)?;
    fs::write(path("with.csv"), run)?;
    let after = fit(&path("with.csv"), None, &path("left.toml"))?;

    println!("named: {}; left: {}", before["planes"][0]["causes"], after["planes"][0]["causes"]);
    println!("{:<34} {:>9} {:>9} {:>9}", "µm", "without", "with", "gone");
    let show = |name: &str, before: f64, after: f64| {
        let gone = reduction(before, after);
        println!("{name:<34} {before:>9.2} {after:>9.2} {gone:>7.1} %");
        gone
    };
    let figure = |of: &Value, name: &str| of["planes"][0]["iso230_4"].pointer(name)?.as_f64();
    let mut rounder = f64::NAN;
    for (name, pointer) in [
        ("G counter-clockwise", "/g_um/ccw"),
        ("G clockwise", "/g_um/cw"),
        ("G(b), both directions", "/g_both_um"),
    ] {
        let [before, after] = [&before, &after].map(|report| figure(report, pointer));
        rounder = show(name, before.context(name)?, after.context(name)?);
    }
    let widths = [&readings_before, &readings_after].map(|readings| backlash_um(readings));
    let of_x = show("backlash of X on the circle", widths[0][0], widths[1][0]);
    let of_y = show("backlash of Y on the circle", widths[0][1], widths[1][1]);
    println!("Run files, machine files and pages with the polar plots: target/linuxcnc-circle");
    ensure!(
        rounder >= MIN_ROUNDER,
        "{rounder:.1} % rounder, at least {MIN_ROUNDER} % are required"
    );
    let least = of_x.min(of_y);
    ensure!(
        least >= MIN_OF_BACKLASH,
        "{least:.1} % of the backlash, {MIN_OF_BACKLASH} % are required"
    );
    Ok(())
}
