//! A board with all lines busy on the model of its chip, on each clock that it may have to live with: what its tasks wait
//! and take at the longest is measured by it.

use std::{collections::BTreeMap, fs, path::Path};

use anyhow::Result;
use trueup_core::cnc::Control;

use crate::{
    chip::{self, ModelRunReport},
    plc_requests,
};

/// A clock: its name, the options of the model for it, how long to live in ms, the speed of the PLC's line, and what a byte of
/// that takes in µs.
pub type ClockScenario =
    (&'static str, &'static [&'static str], &'static str, &'static [&'static str], f64);

const FAST_MODBUS_OPTIONS: &[&str] = &["--low", "PB5", "--modbus-baud", "115200"];

/// All of them.
pub const CLOCK_SCENARIOS: [ClockScenario; 3] = [
    ("168 MHz", &[], "900", FAST_MODBUS_OPTIONS, 95.0),
    ("144 MHz", &["--hse-dead"], "900", FAST_MODBUS_OPTIONS, 95.0),
    // Its start takes two thirds of a second.
    ("16 MHz", &["--hse-dead", "--pll-dead"], "1400", &[], 573.0),
];

/// All lines are open and busy, a PLC engages, and `Zero` is taken and stored.
///
/// It is for a clock, `later_ms` later than at the earliest.
#[must_use]
pub(crate) fn build_full_load_script(clock: &ClockScenario, later_ms: u32) -> String {
    // When the board is up, so that the PLC's bytes find a receiver.
    let from_ms = if clock.0 == "16 MHz" { 720 } else { 250 };
    let read = plc_requests::build_read_request_hex();
    let (opened_ms, from_ms) = (700 + later_ms, from_ms + later_ms);
    let mut script =
        format!("0 control 0\n0 positions 500\n150 say S8\\rO\\r\n{opened_ms} say S8\\rO\\r\n");
    for (counter, at) in (0..).zip((from_ms..from_ms + 1_000).step_by(90)) {
        let zero = at > from_ms + 350;
        let control =
            if counter < 3 { Control::REFERENCED } else { Control { zero, ..Control::ENGAGED } };
        let write = plc_requests::build_write_request_hex(control, counter);
        script += &format!("{at} modbus {write}\n{} modbus {read}\n", at + 45);
    }
    script
}

/// Runs an image on the model with all lines busy, on a clock.
///
/// # Errors
/// As [`chip::run`].
pub fn run(
    model: &Path,
    image: &Path,
    clock: &ClockScenario,
    later_ms: u32,
) -> Result<ModelRunReport> {
    let (_, dead, ms, line, _) = *clock;
    let file = tempfile::NamedTempFile::new()?;
    fs::write(file.path(), build_full_load_script(clock, later_ms))?;
    let path = file.path().to_string_lossy();
    let own = ["--bor", "--ms", ms, "--masked", "--script", &path];
    chip::run(model, image, &[&own[..], dead, line].concat())
}

/// Returns the longest turn of each exception's handler in µs, of its own and from beginning to end.
#[must_use]
pub fn parse_max_handler_times_us(report: &ModelRunReport) -> BTreeMap<u32, [f64; 2]> {
    let (_, rest) =
        report.stdout.split_once("turns at the longest, by exception: ").unwrap_or_default();
    let turns = rest.lines().next().unwrap_or_default().split(", ");
    let turns = turns.filter_map(|turn| {
        let (number, times) = turn.strip_suffix(" µs")?.split_once(": ")?;
        let (own, whole) = times.split_once(" of ")?;
        Some((number.parse().ok()?, [own.parse().ok()?, whole.parse().ok()?]))
    });
    turns.collect()
}
