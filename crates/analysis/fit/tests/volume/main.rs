//! `fit volume` on machines whose errors are drawn, by instruments that read them with noise and in set-ups that are not stated.

#![allow(clippy::print_stdout)]

mod campaign;
mod drawn;
mod forms;
mod measured;
mod rules;
mod signs;
