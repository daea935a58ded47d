//! The staircase of the loop again and again, without LinuxCNC: by how much its backlash goes up and down from run to run.
//!
//! The board's own code and the machine of the loop, with other noise of the thermometers and of the sensor each time. Two
//! machine files: the one that was measured, and the same with the backlash that the machine has. So what the
//! measurement of the width costs and what the noise of the instruments costs are apart.

use anyhow::{Context as _, Result};
use trueup_machine::{CompiledCalibration, Machine, compile};
use trueup_twin::{
    axes::AxisName,
    machine::{self, SimulatedMachine as Twin},
};

use super::{
    config::{STAIRCASE_DWELL_S, STAIRCASE_FEED_MM_PER_MIN, STAIRCASE_HEIGHTS_MM},
    host_bridge::HostBridge,
    machine_measurement::{self, LOOP_SEED, MeasuredMachine},
};
use crate::host_programs;

/// A millisecond, as a servo cycle has it.
const SERVO_PERIOD_S: f64 = 1e-3;
/// Cycles at the end of a dwell over which the error is averaged, as in the loop.
const AVERAGED_CYCLES: usize = 50;
/// The staircase is gone through this often. The last time counts: the screw is as warm as in the loop then.
const STAIRCASE_REPEATS: usize = 2;

/// The heights of the staircase with the cycle in which each is reached and left.
struct StaircasePath {
    z_mm: Vec<f64>,
    dwells: Vec<(f64, bool, usize)>,
}

impl StaircasePath {
    fn new() -> Self {
        let (mut z_mm, mut dwells, mut at_mm) = (vec![], vec![], 0.0);
        let step_mm = STAIRCASE_FEED_MM_PER_MIN / 60.0 * SERVO_PERIOD_S;
        let turn = STAIRCASE_HEIGHTS_MM[STAIRCASE_HEIGHTS_MM.len() - 1] + 40.0;
        let stairs = || {
            STAIRCASE_HEIGHTS_MM
                .iter()
                .chain(std::iter::once(&turn))
                .chain(STAIRCASE_HEIGHTS_MM.iter().rev())
        };
        for &next_mm in (0..STAIRCASE_REPEATS).flat_map(|_| stairs()) {
            let steps = ((next_mm - at_mm).abs() / step_mm).ceil();
            z_mm.extend((1..=steps as usize).map(|n| at_mm + (next_mm - at_mm) * n as f64 / steps));
            z_mm.extend(vec![next_mm; (STAIRCASE_DWELL_S / SERVO_PERIOD_S) as usize]);
            dwells.push((next_mm, next_mm > at_mm, z_mm.len()));
            at_mm = next_mm;
        }
        Self { z_mm, dwells }
    }
}

/// Returns the reduction of the backlash in a run, in percent, as the loop states it.
fn simulate_backlash_reduction_percent(
    compiled: &CompiledCalibration,
    file: &Machine,
    path: &StaircasePath,
    seed: u64,
) -> Result<f64> {
    let scenario = machine_measurement::load_twin_scenario()?;
    let mut with = Twin::new(&scenario, seed);
    let mut without = with.clone();
    let mut bridge = HostBridge::new(compiled, file, seed)?;
    let mut offset_mm = 0.0;
    let mut errors: Vec<[f64; 2]> = Vec::with_capacity(path.z_mm.len());
    for &z_mm in &path.z_mm {
        let celsius = with.read_temperatures_c().into_iter();
        let celsius = celsius.map(|(name, celsius)| (name.to_owned(), celsius)).collect();
        let volts = with.read_sensor_volts().context("the machine has a sensor")?;
        let offset = bridge.step([0.0, 0.0, z_mm], volts, &celsius);
        offset_mm = offset.map_or(offset_mm, |[_, _, z_mm]| z_mm);
        let driven =
            |z_mm| machine::DriveCommand { position_mm: [0.0, 0.0, z_mm], ..Default::default() };
        with.step(SERVO_PERIOD_S, &driven(z_mm + offset_mm));
        without.step(SERVO_PERIOD_S, &driven(z_mm));
        errors.push([without.tip_error_um()[2], with.tip_error_um()[2] + offset_mm * 1e3]);
    }
    let of_last = &path.dwells[path.dwells.len() / STAIRCASE_REPEATS * (STAIRCASE_REPEATS - 1)..];
    let mean = |end: usize, of: usize| {
        errors[end - AVERAGED_CYCLES..end].iter().map(|both| both[of]).sum::<f64>()
            / AVERAGED_CYCLES as f64
    };
    let largest = |of: usize| {
        let width = |z_mm: f64| {
            let at = |up| {
                of_last
                    .iter()
                    .find(|entry| entry.0 == z_mm && entry.1 == up)
                    .map(|entry| mean(entry.2, of))
            };
            at(true).zip(at(false)).map_or(f64::NAN, |(below, above)| (above - below).abs())
        };
        STAIRCASE_HEIGHTS_MM.into_iter().map(width).fold(0.0, f64::max)
    };
    Ok(100.0 * (1.0 - largest(1) / largest(0)))
}

/// Goes through the staircase `count` times with each machine file, and prints the reductions.
///
/// # Errors
/// The machine cannot be measured.
pub fn run_repeatability_test(count: u64) -> Result<()> {
    let trueup = host_programs::build_trueup()?;
    let work = tempfile::tempdir()?;
    let measured: MeasuredMachine = machine_measurement::measure_machine(&trueup, work.path())?;
    let mut exact = measured.machine.clone();
    let width_um = &mut exact.axes[2].backlash.as_mut().context("Z has its backlash")?.width_um;
    let of_machine_um = machine_measurement::load_twin_scenario()?.axis[&AxisName::Z].backlash_um;
    let as_measured_um = std::mem::replace(width_um, of_machine_um);
    let path = StaircasePath::new();
    for (name, file) in [
        (format!("width as measured, {as_measured_um:.2} um"), &measured.machine),
        (format!("width of the machine, {of_machine_um:.2} um"), &exact),
    ] {
        let compiled = compile(file)?;
        let mut all: Vec<f64> = (0..count)
            .map(|n| simulate_backlash_reduction_percent(&compiled, file, &path, LOOP_SEED + n))
            .collect::<Result<_>>()?;
        all.sort_by(f64::total_cmp);
        let at = |share: f64| all[((all.len() - 1) as f64 * share).round() as usize];
        trueup_output::write_line_best_effort(format_args!(
            "{name}: {count} runs, least {:.2} %, 5 % below {:.2} %, half below {:.2} %, 95 % below {:.2} %, largest {:.2} %",
            at(0.0),
            at(0.05),
            at(0.5),
            at(0.95),
            at(1.0),
        ));
    }
    Ok(())
}
