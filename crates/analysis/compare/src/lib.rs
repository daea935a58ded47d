//! One machine at two times, or at many.
//!
//! | module | does |
//! |---|---|
//! | [`run_comparison`] | two runs, place by place: the difference, its interval, and the law that it follows |
//! | [`trend`] | a constant over dated files: how fast it changes, and when to measure again |
//! | [`dated_constants`] | which constants a file holds, and of which day it is |
//! | [`html_report`] | both as pages with pictures |
#![forbid(unsafe_code)]

pub mod dated_constants;
pub mod html_report;
pub mod run_comparison;
pub mod thermal_expansion;
pub mod trend;
