//! `trueup program` on the real LinuxCNC: it runs the program that measures, a virtual machine moves as
//! its joints are sent, the indicator is read by itself wherever the machine stands as the run file says,
//! and `trueup fit` gets back what was put into that machine. Nothing is touched by hand in between.
//!
//! ```text
//! plan ─► LinuxCNC ─ every servo cycle ─► twin ─ at each dwell ─► run file, filled in ─► fit
//! ```
//!
//! Travel and soft limits are the same: a program that goes too far stops with LinuxCNC's error.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod cycles;
mod stops;
mod touches;

use std::{
    borrow::Cow,
    collections::BTreeMap,
    fs, mem,
    path::Path,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use cycles::Cycles;
use stops::begin_and_pass_the_stop;
use trueup_emulator::{
    linuxcnc::{
        headless_linuxcnc::{HeadlessLinuxCnc, SamplerGuard},
        simulated_joints::{self, AxisIniLines},
    },
    setup::{self, LockedLinuxCnc},
};
use trueup_fit::{FitReport, pitch, straightness, straightness_report, thermal, warmup};
use trueup_machine::{
    Machine as Believed, MachineFile, RunFile,
    applied_offsets::UncompensatedRun,
    machine_file::{LinearAxis, writer::MachineFileEdit},
    model::{pitch_error_um, spline_value_um},
};
use trueup_program::{
    Control, MeasurementKind, MeasurementOptions, MeasurementPlan, MeasuringInstrument, control,
    create_plans, template,
};
use trueup_twin::{
    Scenario,
    instrument::Instrument,
    machine::{DriveCommand, SimulatedMachine},
};

/// Recorder of its commands in each servo cycle.
const RECORDER: &str = "\
loadrt sampler depth=16000 cfg=ffff
addf sampler.0 servo-thread
net x sampler.0.pin.0
net y sampler.0.pin.1
net z sampler.0.pin.2
net speed spindle.0.speed-out => sampler.0.pin.3
";
/// The gantry's travel in mm, which are also the control's soft limits.
const TRAVEL_MM: [f64; 3] = [14_300.0, 3_000.0, 2_500.0];
const BELIEVED: &str = "\
[machine]
name = \"gantry\"
kind = \"3-axis\"
[axis.x]
travel_mm = [0.0, 14300.0]
[axis.x.thermal]
mode = \"position\"
sensor = \"temp_screw_c\"
reference_c = 23.0
[axis.y]
travel_mm = [0.0, 3000.0]
[axis.z]
travel_mm = [0.0, 2500.0]
";
/// Standard deviation of the indicator in µm.
const NOISE_UM: f64 = 0.3;
/// How long a program stands for a reading, in s.
const DWELL_S: f64 = 0.1;
/// A reading comes within this many seconds of the one before.
const TIMEOUT_S: u64 = 30;

/// Reads a row: what the template does not give comes from the machine and its instruments.
fn read<'n>(
    machine: &mut SimulatedMachine,
    instruments: &mut BTreeMap<&'n str, Instrument>,
    (names, row): (&[&'n str], &str),
    began_s: f64,
    [x, y, z]: [f64; 3],
) -> Option<Vec<String>> {
    let time_s = machine.time_s();
    let errors = machine.tip_error_um();
    let elongation_um = machine.elongation_um();
    let temperatures: Vec<(String, f64)> =
        machine.read_temperatures_c().into_iter().map(|(name, c)| (name.into(), c)).collect();
    let cells = names.iter().zip(row.split(',')).map(|(name, cell)| {
        let value = match *name {
            "time_s" => time_s - began_s,
            "measured_elongation_um" => instruments.get_mut(name)?.read(time_s, elongation_um, 0.0),
            "measured_dx_um" => instruments.get_mut(name)?.read(time_s, errors[0], x),
            "measured_dy_um" => instruments.get_mut(name)?.read(time_s, errors[1], y),
            "measured_dz_um" => instruments.get_mut(name)?.read(time_s, errors[2], z),
            _ if !cell.is_empty() => return Some(cell.to_string()),
            other => temperatures.iter().find(|(name, _)| name == other)?.1,
        };
        Some(value.to_string())
    });
    cells.collect()
}

/// Returns what LinuxCNC and the virtual machine make of a plan: the run file, filled in. A second of LinuxCNC is
/// `factor` seconds of the machine.
fn measure(
    rig: &mut Rig,
    plan: &MeasurementPlan,
    scenario: &Scenario,
    factor: f64,
) -> Result<String> {
    let Rig { cnc, cycles, .. } = rig;
    let program = control::generate_program(plan, Control::LinuxCnc)?;
    fs::write(cnc.folder().join(&program.0), program.1)?;
    let text = template::run_file_templates(plan).remove(0).1;
    // What stands before the columns is for the reader.
    let mut table = text.lines().skip_while(|line| line.starts_with('#'));
    let header = table.next().context("a header")?;
    let names: Vec<&str> = header.split(',').collect();
    let mut filled = format!("{header}\n");
    let mut rows = table.zip(plan.readings());

    let mut machine = SimulatedMachine::new(scenario, 1);
    let mut instruments: BTreeMap<&str, Instrument> = names
        .iter()
        .filter(|name| name.starts_with("measured_"))
        .map(|name| (*name, Instrument::new(&scenario.instrument, name, 1)))
        .collect();
    begin_and_pass_the_stop(cnc, cycles, &program.0)?;
    let (mut was_there, mut began_s) = (false, None);
    let mut next = rows.next();
    let mut silent_s = 0.0;
    let (mut before, mut stands) = ([f64::NAN; 3], Vec::new());
    let moves = plan.extent_mm() != [None; 3];
    loop {
        let [x, y, z, speed] = cycles.next()?;
        let position_mm = [x, y, z];
        let command = DriveCommand { position_mm, spindle_rpm: speed, ..DriveCommand::default() };
        machine.step(0.001 * factor, &command);
        if speed > 0.0 && began_s.is_none() {
            began_s = Some(machine.time_s());
        }
        if position_mm == before && stands.last() != Some(&position_mm) {
            stands.push(position_mm);
        }
        before = position_mm;
        silent_s += 0.001;
        let Some((row, reading)) = next else { break };
        let is_due = if moves {
            let directions = machine.axes().directions();
            let is_at = |axis: usize| {
                reading.position_mm[axis].is_none_or(|mm| {
                    (mm - position_mm[axis]).abs() < 1e-5
                        && f64::from(reading.direction[axis]) == directions[axis]
                })
            };
            let is_there = (0..3).all(is_at);
            let was_there = mem::replace(&mut was_there, is_there);
            // Once for each time that it comes there. A dwell is by the wall's clock, and servo cycles are late on a
            // loaded computer: the one in which the joints arrive may be all that is left of it.
            is_there && !was_there
        } else {
            // Nothing moves: the clock says when.
            began_s.is_some_and(|began| machine.time_s() - began >= reading.dwelt_s * factor)
        };
        if is_due {
            let began_s = began_s.unwrap_or(0.0);
            let cells = read(&mut machine, &mut instruments, (&names, row), began_s, position_mm);
            filled += &(cells.context("a column that the machine does not have")?.join(",") + "\n");
            next = rows.next();
            silent_s = 0.0;
            stands.clear();
        }
        // A loaded computer falls behind with what the recorder says: the program may have ended before.
        if silent_s > TIMEOUT_S as f64 {
            let (is_busy, log) = (cnc.is_program_running(), cnc.recent_log());
            bail!(
                "{}: no reading at {reading:?}; LinuxCNC stands at {position_mm:?}, busy {is_busy:?}, stood \
                 at {stands:?}\n{log}",
                plan.name
            );
        }
    }
    let read = Instant::now();
    while cnc.is_program_running()? {
        ensure!(
            read.elapsed().as_secs() < TIMEOUT_S,
            "{} does not end: {}",
            plan.name,
            cnc.recent_log()
        );
        thread::sleep(Duration::from_millis(50));
    }
    println!("{}: {} readings by themselves", plan.name, plan.readings().len());
    Ok(filled)
}

/// LinuxCNC, and what its recorder says of each servo cycle.
struct Rig {
    cnc: HeadlessLinuxCnc,
    cycles: Cycles,
    recorder: SamplerGuard,
}

impl Rig {
    fn end(mut self) -> Result<()> {
        drop(self.recorder);
        self.cnc.close()
    }
}

fn start(linuxcnc: LockedLinuxCnc) -> Result<Rig> {
    start_with(linuxcnc, RECORDER)
}

fn start_with(linuxcnc: LockedLinuxCnc, hal: &str) -> Result<Rig> {
    let axes = TRAVEL_MM.map(|travel_mm| AxisIniLines {
        limits: format!(
            "MIN_LIMIT = -0.0001\nMAX_LIMIT = {}\nMAX_VELOCITY = 5000\nMAX_ACCELERATION = 50000\n",
            travel_mm + 0.0001
        ),
        joint: String::new(),
    });
    let cnc = simulated_joints::start(linuxcnc, &axes, hal, &[])?;
    let (recorder, cycles) = cnc.start_sampler()?;
    Ok(Rig { cnc, cycles: Cycles::of(cycles), recorder })
}

fn believed() -> Believed {
    MachineFile::parse(BELIEVED, Path::new("gantry.toml")).expect("a machine file")
}

fn scenario(what: &str) -> Scenario {
    let text = format!(
        "name = \"a gantry to be measured\"\nmeasure = [\"dx\"]\n[instrument]\nnoise_um = {NOISE_UM}\n\
         [ambient]\nmean_c = 20.0\n[thermometer.screw]\nat = \"screw_x\"\nlag_s = 0.0\nnoise_c = 0.01\nquantum_c = 0.0\n\
         [axis.x]\nscrew_heating_c = 0.0\n{what}\n[[segment]]\nkind = \"spindle\"\nduration_s = 60.0\n"
    );
    Scenario::parse(&text, Path::new("s.toml")).unwrap_or_else(|bad| panic!("{bad:?}\n{text}"))
}

fn run_of(text: &str) -> UncompensatedRun<'static> {
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
    UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("no bridge").0
}

/// Returns what is asked for alike: moves of 60 m/min, and short dwells.
fn options(axes: &[LinearAxis]) -> MeasurementOptions {
    MeasurementOptions {
        axes: axes.to_vec(),
        feeds_mm_per_min: vec![60_000.0],
        dwell_s: DWELL_S,
        gauge: Some(MeasuringInstrument::Laser),
        approach_mm_per_min: 60_000.0,
        ..MeasurementOptions::default()
    }
}

fn made(kind: MeasurementKind, options: &MeasurementOptions) -> Result<Vec<MeasurementPlan>> {
    Ok(create_plans(kind, &believed(), options)?.0)
}

fn machine_of(edits: &[&MachineFileEdit]) -> Result<Believed> {
    let mut text = BELIEVED.to_string();
    for edit in edits {
        text = edit.apply(&text, Path::new("m.toml"))?;
    }
    Ok(MachineFile::parse(&text, Path::new("m.toml"))?)
}

fn holds(report: &FitReport, name: &str, truth: f64) {
    let found = report.parameter(name).unwrap_or_else(|| panic!("{name}: {report:?}"));
    println!("{found}; true {truth}");
    let [low, high] = found.ci95.expect("it was fitted");
    assert!(low <= truth && truth <= high, "{found} does not hold {truth}");
}

fn rms(um: &[f64]) -> f64 {
    (um.iter().map(|x| x * x).sum::<f64>() / um.len() as f64).sqrt()
}

const X: LinearAxis = LinearAxis::X;
const Y: LinearAxis = LinearAxis::Y;

#[test]
#[ignore = "long: the real LinuxCNC"]
fn backlash_is_got_back_from_its_program() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let mut rig = start(control)?;
    let plan = made(MeasurementKind::Backlash, &options(&[X]))?.remove(0);
    let run = run_of(&measure(&mut rig, &plan, &scenario("backlash_um = 6.0"), 1.0)?);
    let fit = pitch::fit_backlash(&run, X, &pitch::PitchFitOptions::default())?;
    assert_eq!(fit.report.rows_used, 42);
    holds(&fit.report, "width_um", 6.0);
    rig.end()
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn pitch_and_backlash_are_got_back_from_their_program() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let mut rig = start(control)?;
    let plan = made(MeasurementKind::Pitch, &options(&[Y]))?.remove(0);
    let truth = |mm: f64| 5.0 * mm / 1000.0;
    let machine =
        scenario("[axis.y]\nscrew_heating_c = 0.0\npitch_um_per_m = 5.0\nbacklash_um = 4.0");
    let run = run_of(&measure(&mut rig, &plan, &machine, 1.0)?);
    let fit = pitch::fit(&run, Y, &pitch::PitchFitOptions::default())?;
    holds(&fit.report, "width_um", 4.0);
    let table = fit.pitch.context("a table")?;
    let off: Vec<f64> = plan
        .readings()
        .iter()
        .filter_map(|reading| reading.position_mm[1])
        .map(|mm| pitch_error_um(&table, mm, 1.0) - truth(mm))
        .collect();
    // A point of the table rests on ten readings; four standard errors of one.
    let largest = off.iter().fold(0.0_f64, |largest, um| largest.max(um.abs()));
    println!("the table is {:.3} um RMS, at most {largest:.3} um, beside the truth", rms(&off));
    assert!(largest < 4.0 * NOISE_UM / 10_f64.sqrt(), "{off:?}");
    rig.end()
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn straightness_is_got_back_and_holds_on_the_diagonal() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let mut rig = start(control)?;
    let machine = scenario(
        "[[straightness]]\nerror = \"z\"\nalong = \"x\"\npoints = [[0.0, 0.0], [3000.0, 40.0], \
         [7000.0, -20.0], [11000.0, 30.0], [14300.0, 0.0]]\n[[straightness]]\nerror = \"z\"\n\
         along = \"y\"\npoints = [[0.0, 0.0], [1000.0, 9.0], [2000.0, -6.0], [3000.0, 0.0]]\n",
    );
    let mut edits = Vec::new();
    let there_and_back = |axis, step_mm| {
        let requested =
            MeasurementOptions { repeats: Some(2), step_mm: Some(step_mm), ..options(&[axis]) };
        made(MeasurementKind::Straightness, &requested)
    };
    for plan in [there_and_back(X, 400.0)?, there_and_back(Y, 120.0)?].concat() {
        let run = run_of(&measure(&mut rig, &plan, &machine, 1.0)?);
        let requested = straightness::StraightnessFitOptions::default();
        let report = straightness_report::fit_curve(&run, Some("dz"), |_| Ok(None), &requested)?;
        let left = report.held_out.context("positions left out")?;
        println!("{}: {:.3} um RMS at held-out positions", plan.name, left.rms_um);
        assert!(left.rms_um < 1.2 * NOISE_UM, "{left:?}");
        edits.push(report.edit);
    }
    let fitted = machine_of(&edits.iter().collect::<Vec<_>>())?;
    assert_eq!(fitted.straightness.len(), 2);
    let at = |axis: LinearAxis, mm: f64| {
        let curve = fitted.straightness.iter().find(|curve| curve.along == axis);
        curve.map_or(f64::NAN, |curve| spline_value_um(&curve.spline, mm))
    };
    let once = MeasurementOptions { repeats: Some(1), ..options(&[X, Y]) };
    let plan = made(MeasurementKind::Diagonal, &once)?.remove(0);
    let text = measure(&mut rig, &plan, &machine, 1.0)?;
    let run = run_of(&text);
    let column = |name| run.column(name).expect("it was written");
    let (x, y, dz) = (column("x_mm"), column("y_mm"), column("measured_dz_um"));
    let left: Vec<f64> = (0..run.row_count()).map(|n| dz[n] - at(X, x[n]) - at(Y, y[n])).collect();
    println!("diagonal: {:.2} um RMS, {:.3} after both curves", rms(dz), rms(&left));
    assert!(rms(&left) < 1.2 * NOISE_UM);
    rig.end()
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn a_warm_up_is_got_back_from_its_program() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let mut rig = start(control)?;
    // Two hours in 24 s.
    let factor = 300.0;
    let options = MeasurementOptions {
        dwell_s: 0.1,
        every_s: Some(0.4),
        heat_s: Some(24.0),
        spindle_rpm: Some(12_000.0),
        ..MeasurementOptions::default()
    };
    let plan = made(MeasurementKind::Warmup, &options)?.remove(0);
    let text = measure(&mut rig, &plan, &scenario("[spindle]"), factor)?;
    let run = run_of(&text);
    let fit = warmup::fit(std::slice::from_ref(&run), None)?;
    let left = fit.held_out.context("blocks left out")?;
    let grown = fit.before.context("it was measured")?;
    println!("{:?}: {grown:?}, left out {left:?}", fit.parameters);
    assert!(fit.verdict.is_usable() && left.rms_um < 0.1 * grown.rms_um, "{left:?}");
    rig.end()
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn the_growth_of_an_axis_is_got_back_from_its_program() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let mut rig = start(control)?;
    // Twenty minutes in 8 s: strokes of 1 m at 60 m/min are 2.4 m/min of the machine's.
    let factor = 150.0;
    let requested = MeasurementOptions {
        heat_s: Some(8.0),
        heat_feed_mm_per_min: 60_000.0,
        repeats: Some(4),
        ..options(&[X])
    };
    let plan = made(MeasurementKind::AxisHeat, &requested)?.remove(0);
    let machine = scenario("");
    let machine = Scenario {
        axis: machine
            .axis
            .into_iter()
            .map(|(name, mut axis)| {
                axis.screw_heating_c = 15.0;
                axis.screw_um_per_m_per_c = 11.5;
                (name, axis)
            })
            .collect(),
        ..machine
    };
    let run = run_of(&measure(&mut rig, &plan, &machine, factor)?);
    let fit =
        thermal::fit(std::slice::from_ref(&run), X, None, &thermal::ThermalFitOptions::default())?;
    println!("{:?} {:?}", fit.parameters, fit.warnings);
    holds(&fit, "slope_um_per_m_per_c", 11.5);
    rig.end()
}
