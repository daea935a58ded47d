//! Many machines of one series.
//!
//! | module | does |
//! |---|---|
//! | [`store`] | the folder, and how a file becomes visible whole |
//! | [`job`] | what is submitted, under an identifier that follows from its content |
//! | `lease` | which worker has a job |
//! | [`worker`] | threads that do jobs, one result each; where the jobs stand |
//! | [`nats`] | the same jobs on a NATS server, for workers on any computer |
//! | [`result`] | results, compared with their checksums |
//! | [`constants`] | constants with their errors, out of a diagnosis |
//! | [`structure`] | one structure of the model for all machines |
//! | [`pool`] | one constant on many machines: mean, spread, shrunk values |
//! | [`outliers`] | a machine that is unlike the others |
//! | [`drift`] | a constant of one machine over its days |
//! | `causes`, `next` | a cause over the series; which machine to measure next |
//! | [`record`] | a result of one machine as the series takes it |
//! | [`series`], [`report`] | all of it together: `fleet.json` |
//! | [`html_page`] | the same as one page with pictures |
#![forbid(unsafe_code)]

mod causes;
pub mod constants;
pub mod drift;
pub mod html_page;
pub mod job;
mod lease;
pub mod nats;
mod next_measurement;
pub mod outliers;
pub mod pool;
pub mod record;
pub mod report;
pub mod result;
pub mod series;
pub mod store;
pub mod structure;
pub mod worker;
