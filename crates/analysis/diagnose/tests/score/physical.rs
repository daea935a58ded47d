//! Machines with physical faults, drawn so that each fault is seen; which causes name them, and what
//! an answer is worth on another day. `docs/physical-faults.md` says why.

use std::{fmt, path::Path};

use trueup_campaigns::physical::{MachineKind, PhysicalFault, Plant};
use trueup_diagnose::diagnose;
use trueup_machine::{MachineFile, RunFile, predict::Predictor};
use trueup_twin::{
    noise::{RandomStream, rms},
    simulate,
};

use crate::{
    key::{Key, KeyComparison, True},
    own::own_rms,
};

/// Returns the causes that may be named for `fault`: one or two, by physics. They were written down before the
/// first diagnosis of such a machine, and are not changed to fit a result.
#[must_use]
pub fn causes(fault: PhysicalFault) -> &'static [&'static str] {
    match fault {
        PhysicalFault::SensorGain => &["sensor-gain"],
        PhysicalFault::CoilTemperature => &["sensor-temperature-drift"],
        PhysicalFault::UnseenHolder => &["extra-heat-path", "slow-mode"],
        PhysicalFault::AxialStiffness => &["cutting-load"],
        PhysicalFault::SpeedGrowth => &["centrifugal-growth"],
        PhysicalFault::ToolGrowth => &["dependence", "centrifugal-growth"],
        PhysicalFault::ColdTool => &["extra-heat-path", "slow-mode"],
        PhysicalFault::LostCooling => &["growth-amplitude", "growth-rate"],
        PhysicalFault::Room => &["extra-heat-path", "axis-expansion"],
        PhysicalFault::ScrewHeating => &["axis-expansion"],
        PhysicalFault::Mounting => &["cross-axis"],
        PhysicalFault::Wear => &["backlash", "position-dependent-backlash"],
        PhysicalFault::MisplacedThermometer => &["thermal-lag"],
        PhysicalFault::GaugeDrift => &["drift"],
    }
}

/// No fault is smaller, in RMS of the noise.
pub const MIN_FAULT_NOISE_RATIO: f64 = 3.0;
/// Faults are drawn from a little above that to this many times the noise.
const RATIOS: [f64; 2] = [1.1 * MIN_FAULT_NOISE_RATIO, 10.0];
/// A fault that must be larger to be seen is none of this machine: a room that swings by more than
/// this, in K, is no room.
const LARGEST_SIZE: f64 = 8.0;
/// On another day the answer must not leave more than this many times what the file leaves: the rule of
/// the answer for a hold-out.
pub const HARM: f64 = 1.05;

/// A fault that is drawn.
#[derive(Clone, Debug)]
pub struct SampledFault {
    pub fault: PhysicalFault,
    /// How much of it ([`PhysicalFault`]).
    pub size: f64,
    /// The record with it minus that without it, in µm.
    pub um: Vec<f64>,
    /// RMS of that over that of the noise.
    pub ratio: f64,
}

/// A machine with faults.
pub struct Case {
    pub plant: Plant,
    pub faults: Vec<SampledFault>,
    /// RMS in µm of what the healthy machine's file leaves of the healthy machine.
    pub noise_um: f64,
}

impl Case {
    /// Returns the machine of `seed` with 1 to 5 faults.
    pub fn draw(seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "physical faults");
        let count = 1 + (seed % 5) as usize;
        let kinds: Vec<MachineKind> = MachineKind::SAMPLED_KINDS
            .into_iter()
            .filter(|kind| kind.possible_faults().len() >= count)
            .collect();
        let mut case = Self::healthy_of(stream.choose(&kinds), seed);
        let mut left = case.plant.kind.possible_faults().to_vec();
        while case.faults.len() < count && !left.is_empty() {
            let fault = left.swap_remove(stream.uniform_integer(0, left.len() - 1));
            let target = stream.log_uniform(RATIOS[0], RATIOS[1]);
            case.faults.extend(case.sized(fault, target));
        }
        case
    }

    /// Returns the machine of `seed` without a fault.
    pub fn healthy(seed: u64) -> Self {
        Self::healthy_of(
            MachineKind::SAMPLED_KINDS[(seed % MachineKind::SAMPLED_KINDS.len() as u64) as usize],
            seed,
        )
    }

    fn healthy_of(kind: MachineKind, seed: u64) -> Self {
        let mut case = Self { plant: Plant::draw(kind, seed), faults: Vec::new(), noise_um: 0.0 };
        case.noise_um = rms(&case.left(&case.plant.machine, &case.record(0), true));
        case
    }

    /// `fault` at a size at which the record differs by `target` times the noise from that of the
    /// machine without it. `None` where this machine does not show it.
    fn sized(&self, fault: PhysicalFault, target: f64) -> Option<SampledFault> {
        let mut drawn = self.at(fault, 1.0);
        for _ in 0..8 {
            if (drawn.ratio / target - 1.0).abs() < 0.05 {
                break;
            }
            // What a fault does is nearly in proportion to its size.
            drawn = self.at(fault, (drawn.size * target / drawn.ratio).min(2.0 * LARGEST_SIZE));
        }
        (drawn.size <= LARGEST_SIZE && drawn.ratio >= MIN_FAULT_NOISE_RATIO).then_some(drawn)
    }

    fn at(&self, fault: PhysicalFault, size: f64) -> SampledFault {
        let seed = self.plant.day_seed(0);
        let with =
            simulate(&self.plant.scenario_for_day(0, &[(fault, size)]), seed, || {}).to_csv();
        let without =
            simulate(&self.plant.scenario_without_fault(0, fault, size), seed, || {}).to_csv();
        let [with, without] = [with, without].map(|csv| self.left(&self.plant.machine, &csv, true));
        let um: Vec<f64> = with.iter().zip(without).map(|(with, other)| with - other).collect();
        SampledFault { fault, size, ratio: rms(&um) / self.noise_um, um }
    }

    /// RMS over that of the noise of what a fault does and no mixture of the others, and a constant,
    /// could do: by how much it can be distinguished.
    fn own_ratio(&self, of: usize) -> f64 {
        let others = self.faults.iter().enumerate().filter(|(number, _)| *number != of);
        let others: Vec<&[f64]> = others.map(|(_, other)| &other.um[..]).collect();
        own_rms(&self.faults[of].um, &others) / self.noise_um
    }

    /// Returns the record of a day, as a run file.
    pub fn record(&self, day: u64) -> String {
        // Another day has another gauge: what is corrected is the machine.
        let own =
            self.faults.iter().filter(|fault| day == 0 || fault.fault != PhysicalFault::GaugeDrift);
        let faults: Vec<(PhysicalFault, f64)> =
            own.map(|drawn| (drawn.fault, drawn.size)).collect();
        simulate(&self.plant.scenario_for_day(day, &faults), self.plant.day_seed(day), || {})
            .to_csv()
    }

    /// Measured minus predicted by the file `machine`, row by row, in µm; the zero of an axis's gauge
    /// is set anew each day and does not count. `all`: with the terms that only explain.
    fn left(&self, machine: &str, csv: &str, all: bool) -> Vec<f64> {
        let machine = MachineFile::parse(machine, Path::new("machine.toml"))
            .unwrap_or_else(|bad| panic!("{bad}\n{machine}"));
        let run = RunFile::from_reader(csv.as_bytes(), Path::new("run.csv")).expect("a run file");
        let predictor = Predictor::new(&machine, &run).expect("all that it needs is there");
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

    /// Returns what is right to say.
    pub fn key(&self) -> Key {
        let needed: Vec<&[&str]> = self.faults.iter().map(|drawn| causes(drawn.fault)).collect();
        Key { allowed: needed.concat().into_iter().map(True::named).collect(), needed }
    }

    /// Returns what `trueup diagnose` says of the first day, and what that is worth on the second.
    pub fn judged(&self) -> Judged {
        let path = Path::new("machine.toml");
        let machine =
            MachineFile::parse(&self.plant.machine, path).expect("the twin writes machine files");
        let run = RunFile::from_reader(self.record(0).as_bytes(), Path::new("run.csv"))
            .expect("the twin writes run files");
        let diagnosis = diagnose(&machine, &[run], &[], None, &mut |_, _| {})
            .expect("the record can be compared");
        let extended =
            diagnosis.render_extended_toml(&self.plant.machine, path).expect("a machine file");
        let second = self.record(1);
        Judged {
            kind: self.plant.kind,
            faults: (0..self.faults.len())
                .map(|index| {
                    (self.faults[index].fault, self.faults[index].ratio, self.own_ratio(index))
                })
                .collect(),
            told: self.key().of(&diagnosis.report),
            before_um: rms(&self.left(&self.plant.machine, &second, false)),
            after_um: rms(&self.left(&extended, &second, false)),
        }
    }
}

/// An answer and what it was worth.
pub struct Judged {
    pub kind: MachineKind,
    /// Each with its RMS over that of the noise, whole and without what others could do as well.
    pub faults: Vec<(PhysicalFault, f64, f64)>,
    pub told: KeyComparison,
    /// RMS on the second day with the file as it was, in µm.
    pub before_um: f64,
    /// The same with what the answer corrects.
    pub after_um: f64,
}

impl Judged {
    /// Returns whether each fault does as much as the noise that no mixture of the others could do: where two
    /// move the tool in the same way, this record cannot distinguish them.
    pub fn can_be_told(&self) -> bool {
        self.faults.iter().all(|(.., own)| *own >= 1.0)
    }

    /// Returns whether the second day is worse than with the file as it was.
    pub fn is_harmed(&self) -> bool {
        self.after_um > HARM * self.before_um
    }
}

impl fmt::Display for Judged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let faults = self
            .faults
            .iter()
            .map(|(fault, ratio, own)| format!("{} {ratio:.1}/{own:.1}", fault.name()));
        write!(
            f,
            "{} [{}]{}: {}, second day {:.2} -> {:.2} µm{}",
            self.kind.name(),
            faults.collect::<Vec<String>>().join(", "),
            if self.can_be_told() { "" } else { " that go together" },
            self.told,
            self.before_um,
            self.after_um,
            if self.is_harmed() { " HARM" } else { "" }
        )
    }
}
