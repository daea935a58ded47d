//! What keeps the project in order: the structure of its source, counted.
#![forbid(unsafe_code)]

pub mod structure;
