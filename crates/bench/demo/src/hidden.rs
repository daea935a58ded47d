//! A machine with hidden faults, drawn by a seed: one to three physical faults of the virtual machine
//! tool, each at least three times the noise, and each separable from every rival law by the record it makes.
//!
//! Nothing here knows the diagnosis. Whether faults can be separated is computed from what they really do to
//! the record ([`crate::rivals`]); which causes name a fault is read from `docs/physical-faults.md`.

use std::path::Path;

use anyhow::Result;
use trueup_campaigns::physical::{Fault, Kind, Plant};
use trueup_machine::{MachineFile, RunFile, predict::Predictor};
use trueup_twin::{
    noise::{Stream, rms},
    path::legs,
    scenario::Scenario,
    simulate,
};

use crate::{
    rivals::{Gaps, Record, gaps},
    table::{parsed, with_columns, without_readings},
};

/// The smallest fault that is hidden, as a multiple of the RMS of the noise: one that a record of this length shows.
pub(crate) const MIN_RATIO: f64 = 3.0;
/// Faults are drawn from a little above that to this multiple of the noise.
const RATIOS: [f64; 2] = [1.1 * MIN_RATIO, 10.0];
/// A fault that must be larger than this to be seen is none of this machine: as in
/// `docs/physical-faults.md`, a room that swings by more, in K, is no room.
const LARGEST_SIZE: f64 = 8.0;
/// Minimum difference of BIC from each rival law: Kass and Raftery (1995) call it
/// strong; the rule of a diagnosis as well.
pub(crate) const MIN_GAP: f64 = 6.0;
/// A bridge's monitor writes down all the time what the bridge knows: a row at least so often, in s, also
/// while an axis works and no gauge is read. A scale that follows its air for hours has done so between
/// the measurements too.
const MONITOR_S: f64 = 60.0;
/// Maximum number of machines drawn for a seed until one can be separated.
const TRIES: u64 = 200;

/// A fault that is drawn.
#[derive(Clone, Debug)]
pub struct SampledFault {
    /// The fault.
    pub fault: Fault,
    /// How much of it ([`Fault`]).
    pub size: f64,
    /// RMS of what it does to the record, over that of the noise.
    pub ratio: f64,
    /// Its effect in each row of the first day, in µm, read or not.
    pub um: Vec<f64>,
}

/// A machine with hidden faults.
#[derive(Clone, Debug)]
pub struct Hidden {
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

/// Returns the causes that name `fault`: one or two, from the table of `docs/physical-faults.md`.
#[must_use]
pub fn causes(fault: Fault) -> Vec<&'static str> {
    const DOCUMENT: &str = include_str!("../../../../docs/physical-faults.md");
    let begins = format!("| `{}` |", fault.name());
    let row = DOCUMENT.lines().find_map(|line| line.strip_prefix(&begins));
    let cell = row.and_then(|row| row.split('|').next()).unwrap_or_default();
    cell.split('`').skip(1).step_by(2).collect()
}

impl Hidden {
    /// Returns the machine of `seed`.
    ///
    /// # Errors
    /// The faults of no drawn machine can be separated.
    pub fn draw(seed: u64) -> Result<Self> {
        let machine = |stream: &mut Stream| {
            let count = stream.whole(1, 3);
            let kinds: Vec<Kind> =
                Kind::ALL.into_iter().filter(|kind| of_machine(*kind).len() >= count).collect();
            (stream.pick(&kinds), count)
        };
        Self::draw_of(seed, "hidden fault", machine, None)
    }

    /// Returns the machine of `seed` that changes its tools, of which each grows with the speed in its own way; another
    /// fault may be hidden together with that.
    ///
    /// # Errors
    /// The faults of no drawn machine can be separated.
    pub fn draw_with_tools(seed: u64) -> Result<Self> {
        let machine = |stream: &mut Stream| (Kind::ToolSpindle, stream.whole(1, 2));
        Self::draw_of(seed, "hidden tools", machine, Some(Fault::ToolGrowth))
    }

    /// Draws kind and number of faults by `machine`, until its faults, `first` among them, can be separated.
    fn draw_of(
        seed: u64,
        purpose: &str,
        machine: impl Fn(&mut Stream) -> (Kind, usize),
        first: Option<Fault>,
    ) -> Result<Self> {
        for attempt in 0..TRIES {
            let mut stream = Stream::new(seed, &format!("{purpose} {attempt}"));
            let (kind, count) = machine(&mut stream);
            // Far from the seeds of other draws.
            let plant = Plant::draw(kind, seed.wrapping_mul(TRIES).wrapping_add(attempt));
            let mut hidden = Self { seed, plant, faults: Vec::new(), noise_um: 0.0, gap: 0.0 };
            hidden.noise_um = hidden.rms_read(&hidden.left(&hidden.plant.day(0, &[]), 0)?);
            let mut choice = of_machine(kind);
            for number in 0..count {
                if choice.is_empty() {
                    break;
                }
                let wanted = first.filter(|_| number == 0);
                let place = wanted.and_then(|first| choice.iter().position(|it| *it == first));
                let place = place.unwrap_or_else(|| stream.whole(0, choice.len() - 1));
                let fault = choice.swap_remove(place);
                // Each fault has to be named by a finding of its own.
                let own = causes(fault);
                choice.retain(|other| causes(*other).iter().all(|cause| !own.contains(cause)));
                let target = stream.log_uniform(RATIOS[0], RATIOS[1]);
                hidden.faults.extend(hidden.sized(fault, target)?);
            }
            if hidden.faults.len() == count {
                let gaps = hidden.gaps()?;
                hidden.gap = gaps.instead;
                // A law of no fault next to the right ones must not better them.
                if hidden.gap >= MIN_GAP && gaps.beside >= 0.0 {
                    return Ok(hidden);
                }
            }
        }
        anyhow::bail!("seed {seed}: none of {TRIES} machines has faults that can be told apart")
    }

    /// Returns all faults with their sizes.
    #[must_use]
    pub fn sizes(&self) -> Vec<(Fault, f64)> {
        self.faults.iter().map(|drawn| (drawn.fault, drawn.size)).collect()
    }

    /// Returns the log of the bridge's monitor over a day, together with the readings of the gauge, as a run
    /// file; `is_true`: by a gauge without an error.
    ///
    /// # Errors
    /// None that is known.
    pub fn record(&self, day: u64, is_true: bool) -> Result<RunFile> {
        let mut scenario = self.plant.day(day, &self.sizes());
        if is_true {
            scenario.instrument.noise_um = 0.0;
            scenario.instrument.quantum_um = 0.0;
        }
        let run = self.monitored(&scenario, day)?;
        let is_read = self.is_read(&scenario, day);
        let run = without_readings(&run, &self.measured(), |row| !is_read[row])?;
        // What lies between two measurements is of the next one.
        let Some(runs) = run.column("run") else { return Ok(run) };
        let mut runs = runs.to_vec();
        for row in (0..runs.len().saturating_sub(1)).rev().filter(|row| !is_read[*row]) {
            runs[row] = runs[row + 1];
        }
        with_columns(&run, &[("run".into(), runs)])
    }

    /// `run` with 0 in the place of each reading.
    ///
    /// # Errors
    /// There is no gauge.
    pub(crate) fn unread(&self, run: &RunFile) -> Result<RunFile> {
        let nothing = run.require(&self.measured())?.iter().map(|um| 0.0 * um).collect();
        with_columns(run, &[(self.measured(), nothing)])
    }

    /// Returns the rows of a day, the gauge read in all of them.
    fn monitored(&self, scenario: &Scenario, day: u64) -> Result<RunFile> {
        let mut scenario = scenario.clone();
        scenario.interval_s = MONITOR_S;
        let csv = simulate(&scenario, self.plant.seed_of_day(day), || {}).to_csv();
        let run = parsed(&csv, "run.csv")?;
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
    fn is_read(&self, scenario: &Scenario, day: u64) -> Vec<bool> {
        let Scenario { segment, repeat, start_mm, .. } = scenario;
        let legs = legs(segment, *repeat, *start_mm, MONITOR_S, self.plant.seed_of_day(day));
        let is_axis = self.is_axis();
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

    fn is_axis(&self) -> bool {
        self.plant.quantity != "elongation"
    }

    /// RMS over the rows of the first day that are read.
    fn rms_read(&self, um: &[f64]) -> f64 {
        let is_read = self.is_read(&self.plant.day(0, &[]), 0);
        rms(&um
            .iter()
            .zip(is_read)
            .filter(|(_, read)| *read)
            .map(|(um, _)| *um)
            .collect::<Vec<f64>>())
    }

    /// `fault` at a size at which it does `target` times the noise; none where this machine does not
    /// show it so large.
    fn sized(&self, fault: Fault, target: f64) -> Result<Option<SampledFault>> {
        let mut drawn = self.at(fault, 1.0)?;
        for _ in 0..8 {
            if (drawn.ratio / target - 1.0).abs() < 0.05 {
                break;
            }
            // What a fault does is nearly in proportion to its size.
            let size = (drawn.size * target / drawn.ratio).min(2.0 * LARGEST_SIZE);
            drawn = self.at(fault, size)?;
        }
        Ok((drawn.size <= LARGEST_SIZE && drawn.ratio >= MIN_RATIO).then_some(drawn))
    }

    fn at(&self, fault: Fault, size: f64) -> Result<SampledFault> {
        let with = self.left(&self.plant.day(0, &[(fault, size)]), 0)?;
        let without = self.left(&self.plant.day_without(0, fault, size), 0)?;
        let um: Vec<f64> = with.iter().zip(without).map(|(with, other)| with - other).collect();
        Ok(SampledFault { fault, size, ratio: self.rms_read(&um) / self.noise_um, um })
    }

    /// Measured minus predicted by the file in every row, in µm; the zero of an axis's gauge does not count.
    fn left(&self, scenario: &Scenario, day: u64) -> Result<Vec<f64>> {
        let run = self.monitored(scenario, day)?;
        let predicted = self.predicted(&run)?;
        let measured = run.require(&self.measured())?;
        let mut left: Vec<f64> = measured.iter().zip(predicted).map(|(m, p)| m - p).collect();
        if self.is_axis() {
            let is_read = self.is_read(scenario, day);
            let read = || left.iter().zip(&is_read).filter(|(_, read)| **read).map(|(um, _)| um);
            let mean = read().sum::<f64>() / read().count() as f64;
            left.iter_mut().for_each(|um| *um -= mean);
        }
        Ok(left)
    }

    /// Returns the column of the gauge.
    #[must_use]
    pub fn measured(&self) -> String {
        format!("measured_{}_um", self.plant.quantity)
    }

    /// Computes the prediction of the user's file, in µm.
    fn predicted(&self, run: &RunFile) -> Result<Vec<f64>> {
        let machine = MachineFile::parse(&self.plant.machine, Path::new("machine.toml"))?;
        let predictor = Predictor::new(&machine, run)?;
        let place = usize::from(self.is_axis());
        Ok(predictor.rows().map(|row| row.model.all()[place]).collect())
    }

    /// Returns how far the right answer is from others.
    fn gaps(&self) -> Result<Gaps> {
        let run = self.record(0, false)?;
        let record = Record {
            predicted_um: self.predicted(&run)?,
            is_read: &self.is_read(&self.plant.day(0, &self.sizes()), 0),
            is_axis: self.is_axis(),
            run: &run,
        };
        let signatures: Vec<(Fault, &[f64])> =
            self.faults.iter().map(|drawn| (drawn.fault, drawn.um.as_slice())).collect();
        Ok(gaps(&record, &signatures, self.noise_um))
    }
}

/// Returns the faults of the machine itself: the gauge is none of its parts.
fn of_machine(kind: Kind) -> Vec<Fault> {
    kind.faults().iter().copied().filter(|fault| *fault != Fault::GaugeDrift).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_has_its_causes_in_the_document() {
        for &fault in Fault::ALL {
            assert!((1..=2).contains(&causes(fault).len()), "{}", fault.name());
        }
    }

    #[test]
    fn what_is_drawn_is_seen_and_can_be_told_and_a_seed_repeats_it() {
        for seed in 0..4 {
            let hidden = Hidden::draw(seed).expect("can be told");
            assert!((1..=3).contains(&hidden.faults.len()));
            assert!(hidden.gap >= MIN_GAP, "{}", hidden.gap);
            assert!(hidden.faults.iter().all(|drawn| drawn.ratio >= MIN_RATIO));
            let again = Hidden::draw(seed).expect("can be told");
            assert_eq!(again.sizes(), hidden.sizes());
        }
    }
}
