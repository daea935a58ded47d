//! One machine at two times, or at many.
//!
//! | module | does |
//! |---|---|
//! | [`compare`] | two runs, place by place: the difference, its interval, and the law that it follows |
//! | [`trend`] | a constant over dated files: how fast it changes, and when to measure again |
//! | [`dated`] | which constants a file holds, and of which day it is |
//! | [`page`] | both as pages with pictures |
#![forbid(unsafe_code)]

pub mod compare;
pub mod dated;
pub mod page;
pub mod thermal_expansion;
pub mod trend;
