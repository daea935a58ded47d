//! The score of an answer of `trueup diagnose` to a drawn case.
//!
//! This part alone of the crate knows the diagnosis, by its public result: no drawing uses it
//! (`cargo xtask structure` counts each use elsewhere).
//!
//! | module | scores the answer to |
//! |---|---|
//! | [`hidden_effect`] | a hidden effect, or two |
//! | [`cause_pairs`] | every pair of causes that one machine can have |
//! | [`input_dependence`] | an effect of recorded inputs that is in no list |
//! | [`physical_faults`] | a machine with physical faults |
//! | [`shipped_scenarios`] | a shipped scenario |
//! | [`answer_key`] | a record whose causes are known by physics |

pub mod answer_key;
pub mod cause_pairs;
pub mod hidden_effect;
pub mod input_dependence;
pub mod physical_faults;
pub mod shipped_scenarios;
