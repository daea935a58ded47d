//! Many machines of one series.
//!
//! | module | does |
//! |---|---|
//! | [`store`] | the folder, and how a file becomes visible whole |
//! | [`job`] | what is submitted, under an identifier that follows from its content |
//! | `lease` | which worker has a job |
//! | [`worker`] | threads that do jobs, one result each; where the jobs stand |
//! | [`nats`] | the same jobs on a NATS server, for workers on any computer |
//! | [`job_result`] | results, compared with their checksums |
//! | [`findings`] | constants with their errors, out of a diagnosis |
//! | [`structure`] | one structure of the model for all machines |
//! | [`random_effects`] | one constant on many machines: mean, spread, shrunk values |
//! | [`outliers`] | a machine that is unlike the others |
//! | [`drift`] | a constant of one machine over its days |
//! | `causes`, `next` | a cause over the series; which machine to measure next |
//! | [`record`] | a result of one machine as the series takes it |
//! | [`series`], [`report`] | all of it together: `fleet.json` |
//! | [`html_report`] | the same as one page with pictures |
#![forbid(unsafe_code)]

mod cause_summary;
pub mod drift;
pub mod findings;
pub mod html_report;
pub mod job;
pub mod job_result;
mod lease;
pub mod nats;
mod next_measurement;
pub mod outliers;
pub mod random_effects;
pub mod record;
pub mod report;
pub mod series;
pub mod store;
pub mod structure;
pub mod worker;
