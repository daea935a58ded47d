//! The shipped scenarios, diagnosed with the machine file of a user who knows little, and their answer keys by physics
//! (`docs/physical-faults.md`).

use std::path::Path;

use trueup_diagnose::{Diagnosis, diagnose};
use trueup_machine::{MachineFile, RunFile, machine_file::Quantity};
use trueup_twin::{Scenario, simulate};

use super::answer_key::{AnswerKey, TrueCause};

/// A scenario with the file that its user has.
pub struct ShippedScenario {
    /// The scenario and the quantity, as in tables.
    pub name: &'static str,
    scenario: &'static str,
    machine: &'static str,
    quantity: Quantity,
    /// Returns the answer key.
    pub key: fn() -> AnswerKey,
}

const AXIS_SCENARIO_TOML: &str = include_str!("../../../../../data/scenario-axis.toml");
const WARMUP_SCENARIO_TOML: &str = include_str!("../../../../../data/scenario-warmup.toml");
const SCREW_AXIS_MACHINE_TOML: &str = "[machine]\nname = \"an axis\"\nkind = \"3-axis\"\n\
                     [axis.x]\nfeedback = \"screw\"\n";
/// The law of the paper, and the coil as the sensor's temperature.
const PAPER_SPINDLE_MACHINE_TOML: &str = "[machine]\nname = \"a spindle\"\nkind = \"3-axis\"\n\
                     [spindle]\nsource = \"sensor\"\n\
                     [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\n\
                     um_per_count = 0.0152587890625\ntemperature = \"temp_coil_c\"\n";

/// Both shipped scenarios, the axis by two quantities.
pub const SHIPPED_SCENARIOS: [ShippedScenario; 3] = [
    ShippedScenario {
        name: "scenario-axis dx",
        scenario: AXIS_SCENARIO_TOML,
        machine: SCREW_AXIS_MACHINE_TOML,
        quantity: Quantity::Dx,
        key: axis_dx_answer_key,
    },
    ShippedScenario {
        name: "scenario-axis dy",
        scenario: AXIS_SCENARIO_TOML,
        machine: SCREW_AXIS_MACHINE_TOML,
        quantity: Quantity::Dy,
        key: axis_dy_answer_key,
    },
    ShippedScenario {
        name: "scenario-warmup",
        scenario: WARMUP_SCENARIO_TOML,
        machine: PAPER_SPINDLE_MACHINE_TOML,
        quantity: Quantity::Elongation,
        key: warmup_answer_key,
    },
];

/// The instrument of the axis drifts by this much.
const INSTRUMENT_DRIFT: TrueCause = TrueCause { cause: "drift", inside: Some(("um_per_h", 0.05)) };

fn axis_dx_answer_key() -> AnswerKey {
    AnswerKey {
        allowed: vec![
            TrueCause::named("axis-expansion"),
            TrueCause::named("thermometer-lag"),
            TrueCause::named("pitch-scale"),
            TrueCause::named("pitch-error"),
            TrueCause::named("backlash"),
            INSTRUMENT_DRIFT,
            TrueCause { cause: "pitch-periodic", inside: Some(("period_mm", 10.0)) },
        ],
        needed: vec![&["axis-expansion"], &["backlash", "pitch-error"]],
    }
}

fn axis_dy_answer_key() -> AnswerKey {
    AnswerKey {
        allowed: vec![
            TrueCause::named("straightness"),
            TrueCause::named("cross-axis"),
            INSTRUMENT_DRIFT,
        ],
        needed: vec![&["straightness"]],
    }
}

fn warmup_answer_key() -> AnswerKey {
    let heat: &[&str] = &["extra-heat-path", "slow-mode"];
    AnswerKey {
        allowed: ["sensor-gain", "sensor-temperature-drift", "cutting-load"]
            .into_iter()
            .chain(heat.iter().copied())
            .map(TrueCause::named)
            .collect(),
        needed: vec![&["cutting-load"], &["sensor-gain"], heat],
    }
}

impl ShippedScenario {
    /// Diagnoses the record of `seed`.
    ///
    /// # Panics
    /// A shipped scenario can be diagnosed.
    #[must_use]
    pub fn run_diagnosis(&self, seed: u64) -> Diagnosis {
        let scenario = Scenario::parse(self.scenario, Path::new(self.name)).expect("it is shipped");
        let machine =
            MachineFile::parse(self.machine, Path::new("machine.toml")).expect("a machine file");
        let text = simulate(&scenario, seed, || {}).to_csv();
        let run = RunFile::from_reader(text.as_bytes(), Path::new("run.csv")).expect("a run file");
        diagnose(&machine, &[run], &[], Some(self.quantity), &mut |_, _| {})
            .expect("it can be compared")
    }
}
