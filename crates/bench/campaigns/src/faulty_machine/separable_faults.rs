//! A machine with hidden faults, drawn by a seed: one to three physical faults of the virtual machine
//! tool, each at least three times the noise, and each separable from every rival law by the record it makes.
//!
//! Whether faults can be diagnosed is computed from what they really do to the record ([`super::alternatives`]).

use std::path::Path;

use anyhow::Result;
use trueup_machine::{MachineFile, RunFile, predict::RunPredictor};
use trueup_twin::{
    noise::{RandomStream, rms},
    path::build_legs,
    scenario::Scenario,
    simulate,
};

use super::{
    FAULT_TO_NOISE_RATIO_RANGE, SampledFault,
    alternatives::{BicDifferences, PredictedRecord, compute_bic_differences},
    expected_causes, find_fault_at_noise_ratio,
};
use crate::{
    physical_faults::{MachineKind, PhysicalFault, Plant},
    run_file::{parse_run, with_columns, without_readings},
};

/// Minimum difference of BIC from each rival law: Kass and Raftery (1995) call it
/// strong; the rule of a diagnosis as well.
const MIN_BIC_DIFFERENCE: f64 = 6.0;
/// A bridge's monitor writes down all the time what the bridge knows: a row at least so often, in s, also
/// while an axis works and no gauge is read. A scale that follows its air for hours has done so between
/// the measurements too.
const MONITOR_INTERVAL_S: f64 = 60.0;
/// Maximum number of machines drawn for a seed until one can be diagnosed.
const MAX_DRAWS_PER_SEED: u64 = 200;

/// A machine with hidden faults.
#[derive(Clone, Debug)]
pub struct SeparableFaultMachine {
    /// The seed of its draws.
    pub seed: u64,
    /// The machine.
    pub plant: Plant,
    /// Its faults.
    pub faults: Vec<SampledFault>,
    /// RMS in µm of what the file leaves of the machine without a fault.
    pub noise_um: f64,
    /// By how much the nearest answer is worse in which a fault is not named, as a difference of BIC.
    pub gap: f64,
}

impl SeparableFaultMachine {
    /// Returns the machine of `seed`.
    ///
    /// # Errors
    /// The faults of no drawn machine can be diagnosed.
    pub fn draw(seed: u64) -> Result<Self> {
        let machine = |stream: &mut RandomStream| {
            let count = stream.uniform_integer(1, 3);
            let kinds: Vec<MachineKind> = MachineKind::SAMPLED_KINDS
                .into_iter()
                .filter(|kind| possible_machine_faults(*kind).len() >= count)
                .collect();
            (stream.choose(&kinds), count)
        };
        Self::draw_until_separable(seed, "hidden fault", machine, None)
    }

    /// Returns the machine of `seed` that changes its tools, of which each grows with the speed in its own way; another
    /// fault may be hidden together with that.
    ///
    /// # Errors
    /// The faults of no drawn machine can be diagnosed.
    pub fn draw_with_tool_growth(seed: u64) -> Result<Self> {
        let machine =
            |stream: &mut RandomStream| (MachineKind::ToolSpindle, stream.uniform_integer(1, 2));
        Self::draw_until_separable(seed, "hidden tools", machine, Some(PhysicalFault::ToolGrowth))
    }

    /// Draws kind and number of faults by `machine`, until its faults, `first` among them, can be diagnosed.
    fn draw_until_separable(
        seed: u64,
        purpose: &str,
        machine: impl Fn(&mut RandomStream) -> (MachineKind, usize),
        first: Option<PhysicalFault>,
    ) -> Result<Self> {
        for attempt in 0..MAX_DRAWS_PER_SEED {
            let mut stream = RandomStream::new(seed, &format!("{purpose} {attempt}"));
            let (kind, count) = machine(&mut stream);
            // Far from the seeds of other draws.
            let plant =
                Plant::draw(kind, seed.wrapping_mul(MAX_DRAWS_PER_SEED).wrapping_add(attempt));
            let mut hidden = Self { seed, plant, faults: Vec::new(), noise_um: 0.0, gap: 0.0 };
            hidden.noise_um = hidden.rms_of_read_rows(
                &hidden.simulate_residuals_um(&hidden.plant.scenario_for_day(0, &[]), 0)?,
            );
            let mut choice = possible_machine_faults(kind);
            for number in 0..count {
                if choice.is_empty() {
                    break;
                }
                let requested = first.filter(|_| number == 0);
                let place = requested
                    .and_then(|first| choice.iter().position(|candidate| *candidate == first));
                let place = place.unwrap_or_else(|| stream.uniform_integer(0, choice.len() - 1));
                let fault = choice.swap_remove(place);
                // Each fault has to be named by a finding of its own.
                let own = expected_causes(fault);
                choice.retain(|other| {
                    expected_causes(*other).iter().all(|cause| !own.contains(cause))
                });
                let target = stream
                    .log_uniform(FAULT_TO_NOISE_RATIO_RANGE[0], FAULT_TO_NOISE_RATIO_RANGE[1]);
                let drawn = find_fault_at_noise_ratio(target, |size| {
                    hidden.simulate_fault_at_size(fault, size)
                })?;
                hidden.faults.extend(drawn);
            }
            if hidden.faults.len() == count {
                let gaps = hidden.bic_differences()?;
                hidden.gap = gaps.instead;
                // A law of no fault next to the right ones must not better them.
                if hidden.gap >= MIN_BIC_DIFFERENCE && gaps.beside >= 0.0 {
                    return Ok(hidden);
                }
            }
        }
        anyhow::bail!(
            "seed {seed}: none of {MAX_DRAWS_PER_SEED} machines has faults that can be diagnosed"
        )
    }

    /// Returns all faults with their sizes.
    #[must_use]
    pub fn fault_sizes(&self) -> Vec<(PhysicalFault, f64)> {
        self.faults.iter().map(|drawn| (drawn.fault, drawn.size)).collect()
    }

    /// Returns the log of the bridge's monitor over a day, together with the readings of the gauge, as a run
    /// file; `is_true`: by a gauge without an error.
    ///
    /// # Errors
    /// None that is known.
    pub fn record_day(&self, day: u64, is_true: bool) -> Result<RunFile> {
        let mut scenario = self.plant.scenario_for_day(day, &self.fault_sizes());
        if is_true {
            scenario.instrument.noise_um = 0.0;
            scenario.instrument.quantum_um = 0.0;
        }
        let run = self.simulate_monitor_record(&scenario, day)?;
        let is_read = self.gauge_read_mask(&scenario, day);
        let run = without_readings(&run, &self.measured_column_name(), |row| !is_read[row])?;
        // What lies between two measurements is of the next one.
        let Some(runs) = run.column("run") else { return Ok(run) };
        let mut runs = runs.to_vec();
        for row in (0..runs.len().saturating_sub(1)).rev().filter(|row| !is_read[*row]) {
            runs[row] = runs[row + 1];
        }
        with_columns(&run, &[("run".into(), runs)])
    }

    /// Returns `run` with 0 in the place of each reading.
    ///
    /// # Errors
    /// There is no gauge.
    pub fn run_with_zeroed_readings(&self, run: &RunFile) -> Result<RunFile> {
        let nothing =
            run.require_column(&self.measured_column_name())?.iter().map(|um| 0.0 * um).collect();
        with_columns(run, &[(self.measured_column_name(), nothing)])
    }

    /// Returns the rows of a day, the gauge read in all of them.
    fn simulate_monitor_record(&self, scenario: &Scenario, day: u64) -> Result<RunFile> {
        let mut scenario = scenario.clone();
        scenario.interval_s = MONITOR_INTERVAL_S;
        let csv = simulate(&scenario, self.plant.day_seed(day), || {}).to_csv();
        let run = parse_run(&csv, "run.csv")?;
        // The first row has what comes next, and of a machine that has not begun: it stands still.
        let still = ["spindle_rpm", "load_n"].into_iter().filter_map(|name| {
            let mut values = run.column(name)?.to_vec();
            *values.first_mut()? = 0.0;
            Some((name.to_string(), values))
        });
        with_columns(&run, &still.collect::<Vec<(String, Vec<f64>)>>())
    }

    /// In which of these rows the gauge is read: an axis is measured where it stands at a target, a spindle
    /// always.
    fn gauge_read_mask(&self, scenario: &Scenario, day: u64) -> Vec<bool> {
        let Scenario { segment, repeat, start_mm, .. } = scenario;
        let legs =
            build_legs(segment, *repeat, *start_mm, MONITOR_INTERVAL_S, self.plant.day_seed(day));
        let is_axis = self.is_axis_measured();
        let mut at_mm = *start_mm;
        let mut is_read = Vec::new();
        for leg in legs {
            let stands = at_mm == leg.to_mm;
            at_mm = leg.to_mm;
            if leg.row_of_run.is_some() {
                is_read.push(!is_axis || stands);
            }
        }
        is_read
    }

    fn is_axis_measured(&self) -> bool {
        self.plant.quantity != "elongation"
    }

    /// RMS over the rows of the first day that are read.
    fn rms_of_read_rows(&self, um: &[f64]) -> f64 {
        let is_read = self.gauge_read_mask(&self.plant.scenario_for_day(0, &[]), 0);
        rms(&um
            .iter()
            .zip(is_read)
            .filter(|(_, read)| *read)
            .map(|(um, _)| *um)
            .collect::<Vec<f64>>())
    }

    fn simulate_fault_at_size(&self, fault: PhysicalFault, size: f64) -> Result<SampledFault> {
        let with =
            self.simulate_residuals_um(&self.plant.scenario_for_day(0, &[(fault, size)]), 0)?;
        let without =
            self.simulate_residuals_um(&self.plant.scenario_without_fault(0, fault, size), 0)?;
        let um: Vec<f64> = with.iter().zip(without).map(|(with, other)| with - other).collect();
        Ok(SampledFault { fault, size, ratio: self.rms_of_read_rows(&um) / self.noise_um, um })
    }

    /// Measured minus predicted by the file in every row, in µm; the zero of an axis's gauge does not count.
    fn simulate_residuals_um(&self, scenario: &Scenario, day: u64) -> Result<Vec<f64>> {
        let run = self.simulate_monitor_record(scenario, day)?;
        let predicted = self.predict_um(&run)?;
        let measured = run.require_column(&self.measured_column_name())?;
        let mut left: Vec<f64> = measured.iter().zip(predicted).map(|(m, p)| m - p).collect();
        if self.is_axis_measured() {
            let is_read = self.gauge_read_mask(scenario, day);
            let read = || left.iter().zip(&is_read).filter(|(_, read)| **read).map(|(um, _)| um);
            let mean = read().sum::<f64>() / read().count() as f64;
            left.iter_mut().for_each(|um| *um -= mean);
        }
        Ok(left)
    }

    /// Returns the column of the gauge.
    #[must_use]
    pub fn measured_column_name(&self) -> String {
        format!("measured_{}_um", self.plant.quantity)
    }

    /// Computes the prediction of the user's file, in µm.
    fn predict_um(&self, run: &RunFile) -> Result<Vec<f64>> {
        let machine = MachineFile::parse(&self.plant.machine, Path::new("machine.toml"))?;
        let predictor = RunPredictor::new(&machine, run)?;
        let place = usize::from(self.is_axis_measured());
        Ok(predictor.predictions().map(|row| row.model.to_array()[place]).collect())
    }

    /// Returns how far the right answer is from others.
    fn bic_differences(&self) -> Result<BicDifferences> {
        let run = self.record_day(0, false)?;
        let record = PredictedRecord {
            predicted_um: self.predict_um(&run)?,
            is_read: &self.gauge_read_mask(&self.plant.scenario_for_day(0, &self.fault_sizes()), 0),
            is_axis: self.is_axis_measured(),
            run: &run,
        };
        let signatures: Vec<(PhysicalFault, &[f64])> =
            self.faults.iter().map(|drawn| (drawn.fault, drawn.um.as_slice())).collect();
        Ok(compute_bic_differences(&record, &signatures, self.noise_um))
    }
}

/// Returns the faults of the machine itself: the gauge is none of its parts.
fn possible_machine_faults(kind: MachineKind) -> Vec<PhysicalFault> {
    kind.possible_faults()
        .iter()
        .copied()
        .filter(|fault| *fault != PhysicalFault::GaugeDrift)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faulty_machine::MIN_FAULT_TO_NOISE_RATIO;

    #[test]
    fn what_is_drawn_is_seen_and_can_be_told_and_a_seed_repeats_it() {
        for seed in 0..4 {
            let hidden = SeparableFaultMachine::draw(seed).expect("can be diagnosed");
            assert!((1..=3).contains(&hidden.faults.len()));
            assert!(hidden.gap >= MIN_BIC_DIFFERENCE, "{}", hidden.gap);
            assert!(hidden.faults.iter().all(|drawn| drawn.ratio >= MIN_FAULT_TO_NOISE_RATIO));
            let again = SeparableFaultMachine::draw(seed).expect("can be diagnosed");
            assert_eq!(again.fault_sizes(), hidden.fault_sizes());
        }
    }
}
