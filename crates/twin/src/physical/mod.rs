//! Machines with physical faults: no fault is written in the terms of a diagnosis.
//!
//! A fault is a change of what the virtual machine tool is: a conductance, a length, a stiffness, the
//! place of a thermometer. What it does to the record follows from the physics of [`crate::spindle`],
//! [`crate::axes`] and [`crate::sensors`], together with all other faults of that machine. Which cause a
//! diagnosis has to name for it is said elsewhere, in `docs/physical-faults.md`; nothing here knows
//! the causes.

mod fault;

pub use fault::Fault;
