//! The score of an answer to a machine with physical faults ([`crate::faulty_machine`]): by its name, and by what it is worth
//! on another day. `docs/physical-faults.md` gives the reasons.

use std::{fmt, path::Path};

use trueup_diagnose::diagnose;
use trueup_machine::{MachineFile, RunFile};
use trueup_twin::noise::rms;

use super::answer_key::{AnswerComparison, AnswerKey, TrueCause};
use crate::{
    faulty_machine::{MultiFaultMachine, expected_causes},
    physical_faults::{MachineKind, PhysicalFault},
};

/// On another day the answer must not leave more than this many times what the file leaves: the rule of
/// the answer for a hold-out.
const MIN_HARM_RMS_RATIO: f64 = 1.05;

/// Returns the right answer to the record of `machine`.
fn answer_key(machine: &MultiFaultMachine) -> AnswerKey {
    let needed: Vec<&[&str]> =
        machine.faults.iter().map(|drawn| expected_causes(drawn.fault)).collect();
    AnswerKey { allowed: needed.concat().into_iter().map(TrueCause::named).collect(), needed }
}

/// Diagnoses the first day of `machine`, and scores the answer by its names and by the second day.
///
/// # Panics
/// The files of a drawn machine can be read and compared.
#[must_use]
pub fn diagnose_and_score(machine: &MultiFaultMachine) -> PhysicalFaultScore {
    let path = Path::new("machine.toml");
    let file =
        MachineFile::parse(&machine.plant.machine, path).expect("the twin writes machine files");
    let run = RunFile::from_reader(machine.record_day(0).as_bytes(), Path::new("run.csv"))
        .expect("the twin writes run files");
    let diagnosis =
        diagnose(&file, &[run], &[], None, &mut |_, _| {}).expect("the record can be compared");
    let extended =
        diagnosis.render_extended_toml(&machine.plant.machine, path).expect("a machine file");
    let second = machine.record_day(1);
    let faults = machine.faults.iter().enumerate();
    PhysicalFaultScore {
        kind: machine.plant.kind,
        faults: faults
            .map(|(of, drawn)| {
                (drawn.fault, drawn.ratio, machine.orthogonal_component_to_noise_ratio(of))
            })
            .collect(),
        comparison: answer_key(machine).compare(&diagnosis.report),
        before_um: rms(&machine.compute_residuals_um(&machine.plant.machine, &second, false)),
        after_um: rms(&machine.compute_residuals_um(&extended, &second, false)),
    }
}

/// The score of an answer to a machine with physical faults.
pub struct PhysicalFaultScore {
    /// The kind of machine.
    pub kind: MachineKind,
    /// Each with its RMS over that of the noise, whole and without what others could do as well.
    pub faults: Vec<(PhysicalFault, f64, f64)>,
    /// The answer compared with its key.
    pub comparison: AnswerComparison,
    /// RMS on the second day with the file as it was, in µm.
    pub before_um: f64,
    /// The same with what the answer corrects.
    pub after_um: f64,
}

impl PhysicalFaultScore {
    /// Returns whether each fault does as much as the noise that no mixture of the others could do: where two
    /// move the tool in the same way, this record cannot distinguish them.
    #[must_use]
    pub fn is_distinguishable(&self) -> bool {
        self.faults.iter().all(|(.., own)| *own >= 1.0)
    }

    /// Returns whether the second day is worse than with the file as it was.
    #[must_use]
    pub fn is_harmed(&self) -> bool {
        self.after_um > MIN_HARM_RMS_RATIO * self.before_um
    }
}

impl fmt::Display for PhysicalFaultScore {
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
            if self.is_distinguishable() { "" } else { " that go together" },
            self.comparison,
            self.before_um,
            self.after_um,
            if self.is_harmed() { " HARM" } else { "" }
        )
    }
}
