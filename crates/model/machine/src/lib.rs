//! The user's model of the machine, and the measurements on it.
//!
//! The user's side of the project: text files in, `f64` in the user's units (µm, °C, counts), and
//! at the far end the integers that the board runs. Nothing here runs on the board.
//!
//! A module needs only modules above it in this list (`cargo xtask structure` counts circles of modules): keys, sections and
//! causes are the parts of a machine file, the file is made of them, and all else works on what was read.
//!
//! | module | does |
//! |---|---|
//! | [`location`] | where in a user's file something is wrong, and which rule it breaks |
//! | [`bounded_read`] | opens and reads files of the user's within bounds |
//! | [`tool_column`] | the column of a run that names the tool |
//! | `known_columns` | the columns of a run that have a meaning |
//! | `unit_conversion` | the user's units in those of the board |
//! | `keys` | what a key of the machine file is: declared, read strictly, written |
//! | [`inputs`] | from PLC counts to volts, ADC codes and readings |
//! | `spline` | a B-spline and its value |
//! | `sections` | the sections that name no cause, each with its type, keys, reader and writer |
//! | [`effect`] | why a machine is not as its model says: a cause is one page |
//! | [`file`](machine_file) | reads the whole machine file into a [`Machine`], and writes it |
//! | [`model`] | the reference: what the model says of a run, row by row, in `f64` |
//! | [`run_file`] | reads a run file (CSV) into columns |
//! | [`schema`] | every key and column, for editors and for the reference |
//! | [`thermometer_faults`] | a thermometer's fault values, distinguished from temperatures |
//! | [`envelope`] | how far its corrections may go from a start on, and which terms leave what is possible |
//! | [`compile`](mod@compile) | a [`Machine`] in the integers of the board, and back |
//! | [`decompile`] | a calibration written as a machine file |
//! | [`template`] | a machine file to begin with |
//! | [`predict`] | a run with what the model and the board's integers say of each row |
//! | [`applied_offsets`] | what a bridge applied while a run was measured, taken out again |
//! | [`check`] | what a file will do, and what in it is unlikely to be meant |
//! | [`preprocessing`] | a run without fault values, with directions of approach that the positions imply |
#![forbid(unsafe_code)]

pub mod applied_offsets;
pub mod bounded_read;
pub mod check;
pub mod compile;
pub mod decompile;
pub mod effect;
pub mod envelope;
pub mod inputs;
mod keys;
mod known_columns;
pub mod location;
pub mod machine_file;
pub mod model;
pub mod predict;
pub mod preprocessing;
pub mod run_file;
pub mod schema;
mod sections;
mod spline;
pub mod template;
pub mod thermometer_faults;
pub mod tool_column;
mod unit_conversion;

pub use compile::{CompiledCalibration, compile};
pub use machine_file::{Machine, MachineFile};

pub use location::{InputFileError, Location};
pub use run_file::RunFile;
