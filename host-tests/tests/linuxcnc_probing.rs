//! The macros that probe, in the real LinuxCNC: three joints, a surface at a fixed height of the machine, an external
//! offset that acts. Whatever coordinates, units and modes the job has, the surface is the same; nothing
//! moves towards it faster than a probing move may, and the job's modes are as they were.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{fs, path::Path};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use trueup_emulator::{
    linuxcnc::{
        headless_linuxcnc::HeadlessLinuxCnc,
        simulated_joints::{self, AxisIniLines, ControlSettings},
    },
    setup,
};

/// Joint position at which the probe closes, in mm.
const SURFACE_MM: f64 = -100.0;
/// The external offset of Z in mm.
const OFFSET_MM: f64 = 0.05;
/// The servo thread sees the contact up to a period late: 5 µm at 300 mm/min.
const LATE_MM: f64 = 0.006;
/// Approaches have 500 mm/min, in mm/s; and the arithmetic.
const FASTEST_MM_PER_S: f64 = 500.0 / 60.0 + 0.01;
/// Z closes the probe; its lowest position and its fastest way down are kept.
const WIRES: &str = "\
loadrt comp names=touch
loadrt ddt names=speed
loadrt minmax names=lowest,fastest
addf touch servo-thread
addf speed servo-thread
addf lowest servo-thread
addf fastest servo-thread
net z => touch.in0 speed.in lowest.in
net z-speed speed.out => fastest.in
net touched touch.out => motion.probe-input
setp axis.z.eoffset-enable 1
";
/// Stands in for the learner: writes the reading down.
const M110: &str = "#!/bin/sh\necho \"$1\" >>FOLDER/readings.txt\n";

/// A LinuxCNC in one unit, homed and on, with the offset applied.
struct Cnc {
    headless: HeadlessLinuxCnc,
    /// mm in a unit of the machine.
    mm: f64,
}

impl Cnc {
    fn start(units: &str) -> Result<Option<Self>> {
        let Some(control) = setup::install_and_lock_linuxcnc()? else {
            println!("skipped: this distribution has no package of LinuxCNC");
            return Ok(None);
        };
        let mm = if units == "mm" { 1.0 } else { 25.4 };
        let axis = |offset: &str| AxisIniLines {
            limits: format!(
                "MIN_LIMIT = {}\nMAX_LIMIT = {}\nMAX_VELOCITY = {}\nMAX_ACCELERATION = {}\n{offset}",
                -300.0 / mm,
                300.0 / mm,
                200.0 / mm,
                2_000.0 / mm
            ),
            joint: String::new(),
        };
        let axes = [axis(""), axis(""), axis("OFFSET_AV_RATIO = 0.1\n")];
        let folder = setup::project_root().join("integrations/linuxcnc");
        let mut files = Vec::new();
        for name in ["trueup_probe.ngc", "trueup_touch_off.ngc"] {
            files.push((name.to_string(), fs::read_to_string(folder.join(name))?));
        }
        files.push(("M110".to_string(), M110.replace("FOLDER", "\"$(dirname \"$0\")\"")));
        let settings = ControlSettings {
            units,
            rs274ngc: "FEATURES = 8\nSUBROUTINE_PATH = FOLDER\nUSER_M_PATH = FOLDER\n",
        };
        let mut headless =
            simulated_joints::start_with_settings(control, settings, &axes, WIRES, &files)?;
        headless.run_halcmd(&format!("setp axis.z.eoffset-scale {}", 1e-6 / mm))?;
        headless.run_halcmd(&format!("setp axis.z.eoffset-counts {}", OFFSET_MM * 1e6))?;
        headless.wait_for_pins("the offset", 20, &["axis.z.eoffset"], |seen| {
            (seen[0] * mm - OFFSET_MM).abs() < 1e-6
        })?;
        let mut cnc = Self { headless, mm };
        cnc.surface(SURFACE_MM)?;
        Ok(Some(cnc))
    }

    /// Puts the surface at this height.
    fn surface(&mut self, mm: f64) -> Result<()> {
        self.headless.run_halcmd(&format!("setp touch.in1 {}", mm / self.mm)).map(drop)
    }

    fn mdi(&mut self, text: &str) -> Result<()> {
        self.headless.send_request_with_argument("mdi", "text", text).map(drop)
    }

    /// Metric, no offset of any kind, Z 10 mm above the surface.
    fn plain(&mut self) -> Result<()> {
        self.mdi("G21 G90 G94 G17 G49 G92.1 G54")?;
        for system in 1..=9 {
            self.mdi(&format!("G10 L2 P{system} X0 Y0 Z0 R0"))?;
        }
        self.mdi("G53 G0 Z-90")?;
        self.mdi("G1 F123.4")
    }

    fn stat(&mut self) -> Result<Value> {
        self.headless.send_request(&json!({ "do": "stat" }))
    }

    /// Z of the active work offset in mm.
    fn work_mm(&mut self) -> Result<f64> {
        Ok(self.stat()?["g5x"][2].as_f64().context("no work offset")? * self.mm)
    }

    /// Runs these lines, with the lowest position and the fastest way down in mm and mm/s; an error of LinuxCNC is one.
    fn run(&mut self, lines: &str) -> Result<[f64; 2]> {
        for name in ["lowest", "fastest"] {
            self.headless.run_halcmd(&format!("setp {name}.reset 1"))?;
        }
        // A servo thread that comes late would never see a reset that is withdrawn at once, and the way to the
        // start would count as the job's.
        let pins = ["lowest.in", "lowest.min", "fastest.in", "fastest.min"];
        self.headless.wait_for_pins("the reset", 20, &pins, |seen| {
            seen[0] == seen[1] && seen[2] == seen[3]
        })?;
        for name in ["lowest", "fastest"] {
            self.headless.run_halcmd(&format!("setp {name}.reset 0"))?;
        }
        fs::write(self.headless.folder().join("job.ngc"), format!("{lines}\nM2\n"))?;
        self.stat()?;
        self.headless.start_program("job.ngc")?;
        while self.headless.is_program_running()? {
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        // An error may stand behind a message.
        for _ in 0..5 {
            self.headless.is_program_running()?;
        }
        let seen = self.headless.read_pins(&["lowest.min", "fastest.min"])?;
        Ok([seen[0] * self.mm, -seen[1] * self.mm])
    }

    /// Returns what the learner was given since the last time, in µm.
    fn readings(&mut self) -> Result<Vec<f64>> {
        let path = self.headless.folder().join("readings.txt");
        let text = fs::read_to_string(&path).unwrap_or_default();
        fs::remove_file(&path).ok();
        Ok(text.lines().map(str::parse).collect::<Result<_, _>>()?)
    }

    /// Returns the modes of the job, F included to a millionth, and where Z stands in mm; as MDI has them.
    fn modes(&mut self) -> Result<(Value, f64)> {
        let stat = self.stat()?;
        let mut codes = stat["gcodes"].as_array().context("no modes")?.clone();
        // The last block's code that is no mode.
        codes.remove(1);
        // With inverse time each block has an F of its own.
        let has_feed = !codes.contains(&json!(930));
        let feed = stat["settings"][0].as_f64().filter(|_| has_feed).unwrap_or_default();
        let z_mm = self.headless.read_pin("axis.z.pos-cmd")? * self.mm;
        Ok((json!([codes, (feed * 1e6).round(), stat["settings"][1]]), z_mm))
    }
}

/// All that a job may have left, as lines after [`Cnc::plain`].
const JOBS: [&str; 12] = [
    "G10 L2 P1 Z-20",
    "G10 L2 P1 Z3",
    "G10 L2 P2 Z-35\nG55",
    "G10 L2 P9 Z7\nG59.3",
    "G43.1 Z12",
    "G92 Z5",
    "G10 L2 P1 X3 Y4 R30",
    "G20",
    "G20 G91 G18",
    "G20 G93",
    "G95 F0.123",
    "G10 L2 P1 Z-20 R45\nG20\nG43.1 Z1.5\nG92 Z2\nG91",
];

#[test]
#[ignore = "long: the real LinuxCNC"]
fn a_surface_gives_the_same_reading_whatever_coordinates_the_job_has() -> Result<()> {
    for units in ["mm", "inch"] {
        let Some(mut cnc) = Cnc::start(units)? else { return Ok(()) };
        // The unit of the machine matters where the program's does.
        for job in if units == "mm" { &JOBS[..] } else { &JOBS[7..] } {
            cnc.plain()?;
            for line in job.lines() {
                cnc.mdi(line)?;
            }
            let before = cnc.modes()?;
            cnc.readings()?;
            cnc.mdi(&format!("o<trueup_probe> call [{SURFACE_MM}] [3] [300]"))?;
            let (after, readings) = (cnc.modes()?, cnc.readings()?);
            println!("{units}, {job:?}: {readings:?} um");
            ensure!(readings.len() == 1, "{units}, {job:?}: {readings:?}");
            ensure!(readings[0].abs() < LATE_MM * 1e3, "{units}, {job:?}: {readings:?}");
            ensure!(before.0 == after.0, "{units}, {job:?}: modes {} -> {}", before.0, after.0);
            ensure!((before.1 - after.1).abs() < 1e-4, "{units}, {job:?}: Z {before:?} {after:?}");
        }
        // How it moves, and what a program has left afterwards.
        cnc.plain()?;
        let [lowest_mm, fastest] = cnc.run(
            "G10 L2 P1 Z-20\nG1 F777.7\nG53 G0 Z-60\no<trueup_probe> call [-100] [3] [300]\n\
             o1 if [[#<_motion_mode> NE 0] OR [#<_feed> NE 777.7]]\n(ABORT, the modes are others)\n\
             o1 endif",
        )?;
        println!("{units}: down to {lowest_mm} mm at up to {fastest} mm/s");
        ensure!(lowest_mm > SURFACE_MM - 0.1, "{units}: down to {lowest_mm} mm");
        cnc.readings()?;
        fails_without_stopping_the_job(&mut cnc)?;
        cnc.headless.close()?;
    }
    Ok(())
}

/// No contact, contact on the way, a probe that is closed, a call that cannot be right: it says why, there is
/// no reading, and the job goes on with the modes that it had.
fn fails_without_stopping_the_job(cnc: &mut Cnc) -> Result<()> {
    let job = |call: &str| {
        format!(
            "G20 G91\nG1 F12.34\no<trueup_probe> call {call}\n\
             o1 if [[#<_metric> OR #<_absolute>] OR [[#<_motion_mode> NE 10] OR [#<_feed> NE 12.34]]]\n\
             (ABORT, the modes are others)\no1 endif\nG21 G90\nG53 G0 Z-50"
        )
    };
    for (surface_mm, call, phrase, moves) in [
        (-200.0, "[-100] [3] [300]", "no contact down to", true),
        (-93.0, "[-100] [3] [300]", "contact on the way", true),
        (-50.0, "[-100] [3] [300]", "the probe is closed", false),
        (-100.0, "[-80] [3] [300]", "below the surface", false),
        (-100.0, "[-299] [3] [300]", "beyond the limits", false),
        (-100.0, "[-100] [0] [300]", "clearance 0.2 mm or more", false),
        (-100.0, "[-100] [3]", "feed above 0", false),
    ] {
        cnc.surface(-299.0)?;
        cnc.plain()?;
        cnc.surface(surface_mm)?;
        if !moves {
            cnc.stat()?;
            cnc.mdi(&format!("o<trueup_probe> call {call}"))?;
            let message = cnc.stat()?["said"].to_string();
            ensure!(message.contains(phrase), "{phrase}: {message}");
        }
        let [lowest_mm, fastest] = cnc.run(&job(call)).with_context(|| phrase.to_string())?;
        println!("{phrase}: down to {lowest_mm:.3} mm at {fastest:.3} mm/s");
        ensure!(fastest < FASTEST_MM_PER_S, "{phrase}: {fastest} mm/s downwards");
        ensure!(moves || lowest_mm > -90.0 + OFFSET_MM - 1e-3, "{phrase}: down to {lowest_mm} mm");
        ensure!(cnc.readings()?.is_empty(), "{phrase}: a reading");
        let z_mm = cnc.headless.read_pin("axis.z.pos-cmd")? * cnc.mm;
        ensure!((z_mm + 50.0).abs() < 1e-3, "{phrase}: the job goes on, Z at {z_mm} mm");
    }
    cnc.surface(SURFACE_MM)
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn touching_off_is_right_in_both_units_on_both_machines_with_offset_and_tool() -> Result<()> {
    for units in ["mm", "inch"] {
        let Some(mut cnc) = Cnc::start(units)? else { return Ok(()) };
        for (program, unit) in [("G21", 1.0), ("G20", 25.4)] {
            for before_mm in [0.0, -50.0] {
                for tool_mm in [0.0, 12.0] {
                    cnc.plain()?;
                    cnc.mdi(&format!("G10 L2 P1 Z{before_mm}"))?;
                    cnc.mdi(program)?;
                    if tool_mm != 0.0 {
                        cnc.mdi(&format!("G43.1 Z{}", tool_mm / unit))?;
                    }
                    let before = cnc.modes()?;
                    cnc.mdi("o<trueup_touch_off> call [30] [300]")?;
                    let (after, work_mm) = (cnc.modes()?, cnc.work_mm()?);
                    let right_mm = SURFACE_MM - OFFSET_MM - tool_mm;
                    let case = format!("{units}, {program}, {before_mm}, tool {tool_mm}");
                    println!("{case}: {work_mm:.5}, right {right_mm}");
                    let late_mm = right_mm - work_mm;
                    ensure!((-1e-4..LATE_MM).contains(&late_mm), "{case}: {work_mm}");
                    ensure!(before.0 == after.0, "{case}: modes {} -> {}", before.0, after.0);
                    ensure!((before.1 - after.1).abs() < 1e-4, "{case}: Z {before:?} {after:?}");
                }
            }
        }
        // Another system, shifted and turned; a height that is not 0; G54 stays.
        cnc.plain()?;
        for line in ["G10 L2 P1 Z-7", "G10 L2 P3 Z-20 R30", "G56 G92 Z1", "G20 G91"] {
            cnc.mdi(line)?;
        }
        cnc.mdi("o<trueup_touch_off> call [30] [300] [7.5]")?;
        cnc.mdi("G21 G90")?;
        cnc.mdi("G0 Z8")?;
        let z_mm = cnc.headless.read_pin("axis.z.pos-cmd")? * cnc.mm;
        let late_mm = SURFACE_MM - OFFSET_MM + 0.5 - z_mm;
        ensure!((-1e-4..LATE_MM).contains(&late_mm), "{units}: Z8 is at {z_mm} mm");
        cnc.mdi("G92.1 G54")?;
        let work_mm = cnc.work_mm()?;
        ensure!((work_mm + 7.0).abs() < 1e-6, "{units}: G54 is {work_mm}");
        stops_the_job_with_the_old_zero(&mut cnc)?;
        cnc.headless.close()?;
    }
    Ok(())
}

/// A touch-off that fails stops the program, and leaves zero and modes.
fn stops_the_job_with_the_old_zero(cnc: &mut Cnc) -> Result<()> {
    for (surface_mm, call, phrase) in [
        (-200.0, "[30] [300]", "no contact down to"),
        (-50.0, "[30] [300]", "the probe is closed"),
        (-100.0, "[250] [300]", "beyond the limit"),
        (-100.0, "[30]", "distance and feed above 0"),
    ] {
        cnc.surface(-299.0)?;
        cnc.plain()?;
        cnc.mdi("G10 L2 P1 Z-7")?;
        cnc.mdi("G20 G91")?;
        cnc.surface(surface_mm)?;
        let (before, work_mm) = (cnc.modes()?, cnc.work_mm()?);
        cnc.stat()?;
        cnc.mdi(&format!("o<trueup_touch_off> call {call}"))?;
        let message = cnc.stat()?["said"].to_string();
        let (after, now_mm) = (cnc.modes()?, cnc.work_mm()?);
        ensure!(message.contains(phrase), "{phrase}: {message}");
        ensure!(before.0 == after.0, "{phrase}: modes {} -> {}", before.0, after.0);
        ensure!(work_mm == now_mm, "{phrase}: the work offset is {now_mm}");
        ensure!((before.1 - after.1).abs() < 1e-4, "{phrase}: Z {before:?} {after:?}");
        let stopped = cnc.run(&format!("G21\no<trueup_touch_off> call {call}\nG53 G0 Z-50"));
        let error = stopped.err().with_context(|| format!("{phrase}: the job goes on"))?;
        ensure!(format!("{error:#}").contains(phrase), "{phrase}: {error:#}");
    }
    cnc.surface(SURFACE_MM)
}

#[test]
fn the_interpreter_alone_probes_in_machine_coordinates_and_keeps_the_modes() -> Result<()> {
    // The interpreter reads the pins of a LinuxCNC that runs, or that was killed.
    let Some(_linuxcnc) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: LinuxCNC is not packaged here");
        return Ok(());
    };
    let rs274 = trueup_emulator::process::find_on_path("rs274").context("LinuxCNC has it")?;
    let folder = tempfile::tempdir()?;
    let here = folder.path();
    let macros = setup::project_root().join("integrations/linuxcnc");
    fs::copy(macros.join("trueup_probe.ngc"), here.join("trueup_probe.ngc"))?;
    fs::write(here.join("t.ini"), "[RS274NGC]\nFEATURES = 8\nSUBROUTINE_PATH = .\n")?;
    let lines = |job: &str| -> Result<Vec<String>> {
        let call = "o<trueup_probe> call [-100] [5] [300]\n(DEBUG, after #<_feed> #<_metric> #<_absolute>)";
        fs::write(here.join("t.ngc"), format!("G21 G90 G94 F77.77\n{job}\n{call}\nM2\n"))?;
        interpret(&rs274, here)
    };
    for (job, shift_mm, after) in [
        ("", 0.0, "after 77.770000 1.000000 1.000000"),
        ("G10 L2 P1 Z-20\nG54", -20.0, "after 77.770000 1.000000 1.000000"),
        ("G43.1 Z12", 12.0, "after 77.770000 1.000000 1.000000"),
        ("G92 Z3", -3.0, "after 77.770000 1.000000 1.000000"),
        ("G10 L2 P1 Z-20\nG54\nG20 G91 F3.125", -20.0, "after 3.125000 0.000000 0.000000"),
    ] {
        let text = lines(job)?;
        let probes: Vec<&String> =
            text.iter().filter(|line| line.contains("STRAIGHT_PROBE")).collect();
        // The stand-in for a machine stops a quarter of a millimetre short.
        let target = |mm: f64| format!("STRAIGHT_PROBE(0.0000, 0.0000, {:.4},", mm - shift_mm);
        ensure!(probes.len() >= 2, "{job:?}: {text:?}");
        ensure!(probes[0].contains(&target(-95.0)), "{job:?}: {probes:?}");
        ensure!(probes[1].contains(&target(-105.0)), "{job:?}: {probes:?}");
        ensure!(text.iter().any(|line| line.contains(after)), "{job:?}: {text:?}");
        let rapid: Vec<usize> = (0..text.len())
            .filter(|&at| text[at].contains("STRAIGHT_TRAVERSE") && !text[at].contains("COMMENT"))
            .collect();
        let last_probe = text.iter().rposition(|line| line.contains("STRAIGHT_PROBE"));
        ensure!(rapid.iter().all(|&at| Some(at) > last_probe), "{job:?}: rapid before: {text:?}");
    }
    // What cannot be right: no word of motion.
    for job in ["M3 S100", "G53 G1 Z-120", "G41.1 D6"] {
        let text = lines(job)?;
        let called = text.iter().position(|line| line.contains("trueup_probe: not probed"));
        let called = called.with_context(|| format!("{job:?}: no reason in {text:?}"))?;
        ensure!(!text.iter().any(|line| line.contains("PROBE(")), "{job:?}: {text:?}");
        ensure!(text.len() > called + 1, "{job:?}: it goes on");
    }
    Ok(())
}

/// Runs `t.ngc` through the interpreter; what it would let the machine do.
fn interpret(rs274: &Path, folder: &Path) -> Result<Vec<String>> {
    let done = std::process::Command::new(rs274)
        .args(["-g", "-i", "t.ini", "t.ngc"])
        .current_dir(folder)
        .env("LANG", "C")
        .output()?;
    let text = String::from_utf8_lossy(&done.stdout).into_owned();
    ensure!(text.contains("PROGRAM_END"), "{text}{}", String::from_utf8_lossy(&done.stderr));
    Ok(text.lines().map(str::to_owned).collect())
}
