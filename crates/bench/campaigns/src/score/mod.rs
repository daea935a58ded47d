//! The score of an answer of `trueup diagnose` to a drawn case.
//!
//! This part alone of the crate knows the diagnosis, by its public result: no drawing uses it
//! (`cargo xtask structure` counts each use elsewhere).
//!
//! | module | scores the answer to |
//! |---|---|
//! | [`hidden`] | a hidden effect, or two |
//! | [`pairs`] | every pair of causes that one machine can have |
//! | [`inputs`] | an effect of recorded inputs that is in no list |
//! | [`physical`] | a machine with physical faults |
//! | [`shipped`] | a shipped scenario |
//! | [`key`] | a record whose causes are known by physics |

pub mod hidden;
pub mod inputs;
pub mod key;
pub mod pairs;
pub mod physical;
pub mod shipped;
