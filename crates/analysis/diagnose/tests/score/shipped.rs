//! The shipped scenarios, diagnosed with the machine file of a user who knows little, and what is
//! right of them by physics (`docs/physical-faults.md`).

use std::path::Path;

use trueup_diagnose::{Diagnosis, diagnose};
use trueup_machine::{MachineFile, RunFile, file::Quantity};
use trueup_twin::{Scenario, simulate};

use crate::key::{Key, True};

/// A scenario with the file that its user has.
pub struct Shipped {
    pub name: &'static str,
    pub scenario: &'static str,
    pub machine: &'static str,
    pub quantity: Quantity,
    pub key: fn() -> Key,
}

const AXIS: &str = include_str!("../../../../../data/scenario-axis.toml");
const WARMUP: &str = include_str!("../../../../../data/scenario-warmup.toml");
const SCREW: &str = "[machine]\nname = \"an axis\"\nkind = \"3-axis\"\n\
                     [axis.x]\nfeedback = \"screw\"\n";
/// The law of the paper, and the coil as the sensor's temperature.
const PAPER: &str = "[machine]\nname = \"a spindle\"\nkind = \"3-axis\"\n\
                     [spindle]\nsource = \"sensor\"\n\
                     [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\n\
                     um_per_count = 0.0152587890625\ntemperature = \"temp_coil_c\"\n";

/// Both, the axis by two quantities.
pub const ALL: [Shipped; 3] = [
    Shipped {
        name: "scenario-axis dx",
        scenario: AXIS,
        machine: SCREW,
        quantity: Quantity::Dx,
        key: axis_along,
    },
    Shipped {
        name: "scenario-axis dy",
        scenario: AXIS,
        machine: SCREW,
        quantity: Quantity::Dy,
        key: axis_across,
    },
    Shipped {
        name: "scenario-warmup",
        scenario: WARMUP,
        machine: PAPER,
        quantity: Quantity::Elongation,
        key: warmup,
    },
];

/// The instrument of the axis drifts by this much.
const DRIFT: True = True { cause: "drift", inside: Some(("um_per_h", 0.05)) };

fn axis_along() -> Key {
    Key {
        allowed: vec![
            True::named("axis-expansion"),
            True::named("thermometer-lag"),
            True::named("pitch-scale"),
            True::named("pitch-error"),
            True::named("backlash"),
            DRIFT,
            True { cause: "pitch-periodic", inside: Some(("period_mm", 10.0)) },
        ],
        needed: vec![&["axis-expansion"], &["backlash", "pitch-error"]],
    }
}

fn axis_across() -> Key {
    Key {
        allowed: vec![True::named("straightness"), True::named("cross-axis"), DRIFT],
        needed: vec![&["straightness"]],
    }
}

fn warmup() -> Key {
    let heat: &[&str] = &["extra-heat-path", "slow-mode"];
    Key {
        allowed: ["sensor-gain", "sensor-temperature-drift", "cutting-load"]
            .into_iter()
            .chain(heat.iter().copied())
            .map(True::named)
            .collect(),
        needed: vec![&["cutting-load"], &["sensor-gain"], heat],
    }
}

impl Shipped {
    /// Returns what is said of the record of `seed`.
    pub fn diagnosed(&self, seed: u64) -> Diagnosis {
        let scenario = Scenario::parse(self.scenario, Path::new(self.name)).expect("it is shipped");
        let machine =
            MachineFile::parse(self.machine, Path::new("machine.toml")).expect("a machine file");
        let text = simulate(&scenario, seed, || {}).to_csv();
        let run = RunFile::from_reader(text.as_bytes(), Path::new("run.csv")).expect("a run file");
        diagnose(&machine, &[run], &[], Some(self.quantity), &mut |_, _| {})
            .expect("it can be compared")
    }
}
