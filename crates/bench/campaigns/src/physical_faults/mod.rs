//! Machines with physical faults: no fault is written in the terms of a diagnosis.
//!
//! ```text
//! Plant (a machine, drawn) ─► .machine: the file of its user, who believes it healthy
//!      │
//!      └─ .day(number, &[(Fault, size)]) ─► Scenario ─► simulate ─► a run file
//! ```
//!
//! A fault is a change of what the virtual machine tool is: a conductance, a length, a stiffness, the
//! place of a thermometer. Its effect on the record follows from the physics of [`trueup_twin::spindle`],
//! [`trueup_twin::axes`] and [`trueup_twin::sensors`], together with all other faults of that machine. Without a
//! fault the machine file predicts every row but for the noise of gauge and sensors. Which cause a
//! diagnosis has to name for a fault is stated elsewhere, in `docs/physical-faults.md`; nothing here
//! knows the causes.

mod axis;
mod fault;
mod machine_kind;
mod plant;
mod spindle;

pub use fault::PhysicalFault;
pub use machine_kind::MachineKind;
pub use plant::Plant;
