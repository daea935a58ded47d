//! Machines with one to five faults, which may hide each other.

use std::{convert::Infallible, path::Path};

use trueup_machine::{MachineFile, RunFile, predict::RunPredictor};
use trueup_twin::{
    noise::{RandomStream, rms},
    simulate,
};

use super::{FAULT_TO_NOISE_RATIO_RANGE, SampledFault, find_fault_at_noise_ratio};
use crate::{
    orthogonal_component::orthogonal_component_rms,
    physical_faults::{MachineKind, PhysicalFault, Plant},
};

/// A machine with one to five faults, some of which may imitate others.
pub struct MultiFaultMachine {
    /// The machine.
    pub plant: Plant,
    /// Its faults.
    pub faults: Vec<SampledFault>,
    /// RMS in µm of what the healthy machine's file leaves of the healthy machine.
    pub noise_um: f64,
}

impl MultiFaultMachine {
    /// Returns the machine of `seed` with 1 to 5 faults.
    #[must_use]
    pub fn draw(seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "physical faults");
        let count = 1 + (seed % 5) as usize;
        let kinds: Vec<MachineKind> = MachineKind::SAMPLED_KINDS
            .into_iter()
            .filter(|kind| kind.possible_faults().len() >= count)
            .collect();
        let mut case = Self::new_without_faults(stream.choose(&kinds), seed);
        let mut left = case.plant.kind.possible_faults().to_vec();
        while case.faults.len() < count && !left.is_empty() {
            let fault = left.swap_remove(stream.uniform_integer(0, left.len() - 1));
            let target =
                stream.log_uniform(FAULT_TO_NOISE_RATIO_RANGE[0], FAULT_TO_NOISE_RATIO_RANGE[1]);
            let Ok::<_, Infallible>(drawn) = find_fault_at_noise_ratio(target, |size| {
                Ok(case.simulate_fault_at_size(fault, size))
            });
            case.faults.extend(drawn);
        }
        case
    }

    /// Returns the machine of `seed` without a fault.
    #[must_use]
    pub fn without_fault(seed: u64) -> Self {
        Self::new_without_faults(
            MachineKind::SAMPLED_KINDS[(seed % MachineKind::SAMPLED_KINDS.len() as u64) as usize],
            seed,
        )
    }

    fn new_without_faults(kind: MachineKind, seed: u64) -> Self {
        let mut case = Self { plant: Plant::draw(kind, seed), faults: Vec::new(), noise_um: 0.0 };
        case.noise_um =
            rms(&case.compute_residuals_um(&case.plant.machine, &case.record_day(0), true));
        case
    }

    fn simulate_fault_at_size(&self, fault: PhysicalFault, size: f64) -> SampledFault {
        let seed = self.plant.day_seed(0);
        let with =
            simulate(&self.plant.scenario_for_day(0, &[(fault, size)]), seed, || {}).to_csv();
        let without =
            simulate(&self.plant.scenario_without_fault(0, fault, size), seed, || {}).to_csv();
        let [with, without] =
            [with, without].map(|csv| self.compute_residuals_um(&self.plant.machine, &csv, true));
        let um: Vec<f64> = with.iter().zip(without).map(|(with, other)| with - other).collect();
        SampledFault { fault, size, ratio: rms(&um) / self.noise_um, um }
    }

    /// Computes the RMS, over that of the noise, of the part of a fault's effect that no linear combination of the others and
    /// a constant has.
    pub(crate) fn orthogonal_component_to_noise_ratio(&self, of: usize) -> f64 {
        let others = self.faults.iter().enumerate().filter(|(number, _)| *number != of);
        let others: Vec<&[f64]> = others.map(|(_, other)| &other.um[..]).collect();
        orthogonal_component_rms(&self.faults[of].um, &others) / self.noise_um
    }

    /// Returns the record of a day, as a run file.
    pub(crate) fn record_day(&self, day: u64) -> String {
        // Another day has another gauge: what is corrected is the machine.
        let own =
            self.faults.iter().filter(|fault| day == 0 || fault.fault != PhysicalFault::GaugeDrift);
        let faults: Vec<(PhysicalFault, f64)> =
            own.map(|drawn| (drawn.fault, drawn.size)).collect();
        simulate(&self.plant.scenario_for_day(day, &faults), self.plant.day_seed(day), || {})
            .to_csv()
    }

    /// Computes measured minus predicted by the file `machine`, row by row, in µm; the zero of an axis's gauge
    /// is set anew each day and does not count. `all`: with the terms that only explain.
    pub(crate) fn compute_residuals_um(&self, machine: &str, csv: &str, all: bool) -> Vec<f64> {
        let machine = MachineFile::parse(machine, Path::new("machine.toml"))
            .unwrap_or_else(|bad| panic!("{bad}\n{machine}"));
        let run = RunFile::from_reader(csv.as_bytes(), Path::new("run.csv")).expect("a run file");
        let predictor = RunPredictor::new(&machine, &run).expect("all that it needs is there");
        let quantity = if self.plant.quantity == "elongation" { 0 } else { 1 };
        let column = format!("measured_{}_um", self.plant.quantity);
        let measured = run.column(&column).expect("the twin measures it");
        let rows = predictor.predictions().zip(measured).map(|(row, measured)| {
            let values = if all { row.model } else { row.compensated };
            measured - values.to_array()[quantity]
        });
        let left: Vec<f64> = rows.filter(|left| !left.is_nan()).collect();
        let mean = left.iter().sum::<f64>() / left.len() as f64;
        let zero = if self.plant.quantity == "elongation" { 0.0 } else { mean };
        left.into_iter().map(|um| um - zero).collect()
    }
}
