//! The board runs the model that `diagnose` has extended: a held-out run is played to the emulated board with
//! the calibration of the machine file as it was believed, and with that of `extended.toml`. The part that the
//! offsets leave of the measured error, before and after, is the gain in the offsets themselves; it is
//! the gain that the diagnosis has predicted.
//!
//! Where nothing of the model has a memory, the rows of a run may follow each other faster than they
//! were measured (its temperatures then go from row to row as fast as a board believes); where something
//! lags, time passes as it did.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{fmt::Write as _, path::Path};

use trueup_campaigns::hidden_effects::{HiddenCause, draw_test_case};
use trueup_core::{
    cnc::{Control, Output, SpindleState},
    temperature_channels::RawTemperatures,
    thermometer::RawTemperatureReading,
};
use trueup_diagnose::{Diagnosis, diagnose};
use trueup_emulator::{
    analogue_front_end::AnalogueFrontEnd,
    board::{MAX_BATCH_BLOCKS, VirtualBoard},
    cnc_emulator::{CncEmulator, ReceivedFrames},
    firmware_images,
    replay::RunReplay,
    setup,
};
use trueup_link::{frames, receiver::OffsetReceiver};
use trueup_machine::{Machine, MachineFile, RunFile, compile};
use trueup_measured_data::find_measured_file as data;
use trueup_pipe::Block;

/// The gain may be off its prediction by this share of it.
const SHARE: f64 = 0.05;
/// How long a row of a run without memory is held: filter and slew have come to rest by then.
const ROW_S: f64 = 0.8;
/// Before it the temperatures go to the row at nearly the fastest change that a board believes.
const SWEPT_C_PER_S: f64 = 9.0;
const COUNTS_PER_C: f64 = 16.0;
/// The part of a run with a memory that is played, from its start.
const PLAYED_S: f64 = 2_700.0;
const DIVIDER: f64 = 0.33;

/// Returns the machine file with what a board needs next to the model: an input for each thermometer of the
/// run, and limits that do not bind.
fn on_a_board(model: &str, run: &RunFile) -> String {
    let mut text = model.to_string();
    text.push_str("\n[inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 32768, ");
    writeln!(text, "divider = {DIVIDER} }}").expect("a string grows");
    let thermometers = run.columns().iter().map(|column| column.name.as_str());
    let thermometers = thermometers.filter(|name| name.starts_with("temp_"));
    for (channel, name) in thermometers.take(8).enumerate() {
        write!(text, "{name} = {{ channel = {channel}, kind = \"linear\", zero_counts = 1000, ")
            .and_then(|()| writeln!(text, "counts_per_c = {COUNTS_PER_C}, max_c_per_min = 600 }}"))
            .expect("a string grows");
    }
    text.push_str("[limits]\nmax_um = { x = 4000, y = 4000, z = 4000 }\nslew_um_per_s = 10000\n");
    text
}

fn machine(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// Returns a run as text, and what is taken of it.
fn run(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("run.csv")).expect("a run file")
}

/// Returns the rows of a run for which `is_taken` holds, counted from 0.
fn rows(text: &str, is_taken: impl Fn(usize) -> bool) -> String {
    let mut lines = text.lines();
    let mut taken = lines.next().expect("a header").to_string() + "\n";
    for (_, line) in lines.enumerate().filter(|(row, _)| is_taken(*row)) {
        taken.push_str(line);
        taken.push('\n');
    }
    taken
}

/// Returns what the board's offsets leave of the measured error, row for row, in µm.
fn left_by_the_board(
    machine: &Machine,
    run: &RunFile,
    quantity: &str,
    row_s: Option<f64>,
) -> Vec<f64> {
    let compiled = compile(machine).expect("what was extended compiles");
    let image = firmware_images::build_virtual_board_image().expect("the image builds");
    let mut board = VirtualBoard::boot(&image, compiled.blob()).expect("the board boots");
    let mut front_end = AnalogueFrontEnd::new(DIVIDER, 1);
    let (mut stand_in, received) = (CncEmulator::default(), ReceivedFrames::default());
    let mut offsets = OffsetReceiver::new();
    let replay = RunReplay::new(run, machine, 1.0).expect("it can be replayed");
    let times = run.column("time_s").map_or_else(
        || (0..run.row_count()).map(|row| row as f64).collect(),
        |times| times.iter().map(|time| time - times[0]).collect::<Vec<f64>>(),
    );
    let loads = run.column("load_n");
    let measured = run.column(&format!("measured_{quantity}_um")).expect("measured");
    let (mut ms, mut counter, mut left, mut reached) = (0_u32, 0_u8, Vec::new(), None);
    for row in 0..run.row_count() {
        let now = replay.snapshot_at(times[row]);
        let from = reached.replace(now.temperatures).unwrap_or(now.temperatures);
        let (held_s, swept_s) = match row_s {
            Some(row_s) => {
                let swept_s = swept_s(from, now.temperatures);
                (row_s + swept_s, swept_s)
            }
            // A row holds until the next; its prediction is that of the end of such a time.
            None if row == 0 => (ROW_S, 0.0),
            None => (times[row] - times[row - 1], 0.0),
        };
        let load_n = loads.map_or(0.0, |loads| loads[row]);
        let mut last: Option<Output> = None;
        let held_ms = (held_s * 1000.0).round() as u32;
        let mut to_go = held_ms;
        while to_go > 0 {
            let batch = to_go.min(MAX_BATCH_BLOCKS);
            to_go -= batch;
            let passed_s = f64::from(held_ms - to_go) / 1000.0;
            let share = if passed_s < swept_s { passed_s / swept_s } else { 1.0 };
            let temperatures = between(from, now.temperatures, share);
            let blocks: Vec<Block> = (0..batch)
                .map(|_| {
                    let mut frames = stand_in.next_frames(&now, &received);
                    if ms.is_multiple_of(20) {
                        let control = Control { engage: ms >= 60, ..Control::REFERENCED };
                        frames[4] = Some(frames::encode_control(control, counter));
                    } else if ms % 20 == 10 {
                        let speed = now.speed.unwrap_or_default();
                        let spindle = SpindleState { speed, load_n: load_n.round() as i16 };
                        frames[4] = Some(frames::encode_spindle(spindle, counter));
                        counter = counter.wrapping_add(1);
                    }
                    ms += 1;
                    Block {
                        codes: front_end.convert_block(|_| now.sensor_volts),
                        speed: None,
                        temperatures,
                        frames,
                        ..Block::default()
                    }
                })
                .collect();
            for (_, frame) in board.step(&blocks).expect("the board lives") {
                last = offsets.accept(&frame).expect("whole frames").or(last);
            }
        }
        let last = last.expect("an output a millisecond");
        let offset = last.offset.expect("available").map(|nm| f64::from(nm.0) / 1000.0);
        // An offset is minus the error; a spindle that has grown is lifted.
        let corrected_um = match quantity {
            "elongation" => offset[2],
            "dx" => -offset[0],
            "dy" => -offset[1],
            "dz" => -offset[2],
            other => unreachable!("no quantity: {other}"),
        };
        left.push(measured[row] - corrected_um);
    }
    left
}

/// Returns how long the temperatures take from row to row.
fn swept_s(from: RawTemperatures, to: RawTemperatures) -> f64 {
    let counts = from.iter().zip(to).map(|(from, to)| from.0.abs_diff(to.0)).max();
    f64::from(counts.unwrap_or_default()) / COUNTS_PER_C / SWEPT_C_PER_S
}

fn between(from: RawTemperatures, to: RawTemperatures, share: f64) -> RawTemperatures {
    let mut now = to;
    for (raw, RawTemperatureReading(from)) in now.iter_mut().zip(from) {
        let to = f64::from(raw.0);
        raw.0 = (f64::from(from) + share * (to - f64::from(from))).round() as i32;
    }
    now
}

fn rms(values: &[f64]) -> f64 {
    let there: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    (there.iter().map(|value| value * value).sum::<f64>() / there.len() as f64).sqrt()
}

/// Plays `holdout` with the believed and with the extended model, and compares the gain with that
/// which `predict` states for the same rows.
fn check(name: &str, believed: &str, training: &[RunFile], holdout: &str, has_memory: bool) {
    let held_out = run(holdout);
    let believed = on_a_board(believed, &held_out);
    let diagnosis: Diagnosis = diagnose(
        &machine(&believed),
        training,
        std::slice::from_ref(&held_out),
        None,
        &mut |_, _| {},
    )
    .expect("comparable");
    let report = &diagnosis.report;
    let quantity = report.quantity.clone();
    let named: Vec<&str> = report.findings.iter().map(|finding| finding.cause.as_str()).collect();
    let extended = diagnosis
        .render_extended_toml(&believed, Path::new("m.toml"))
        .expect("the machine file is one");
    assert_ne!(extended, believed, "{name}: nothing was added ({named:?})");
    let row_s = (!has_memory).then_some(ROW_S);
    let before = rms(&left_by_the_board(&machine(&believed), &held_out, &quantity, row_s));
    let after = rms(&left_by_the_board(&machine(&extended), &held_out, &quantity, row_s));
    let gain = 1.0 - after / before;
    let predicted = 1.0 - report.after.compensated_holdout_rms_um / report.before.holdout_rms_um;
    println!(
        "{name}: {named:?}, {} rows held out: {:.3} → {:.3} µm predicted, {before:.3} → {after:.3} µm \
         left by the board's offsets; gain {predicted:.4} and {gain:.4}",
        held_out.row_count(),
        report.before.holdout_rms_um,
        report.after.compensated_holdout_rms_um,
    );
    assert!(predicted > 0.1, "{name}: a gain to speak of, not {predicted}");
    assert!((gain - predicted).abs() <= SHARE * predicted, "{name}: {gain} for {predicted}");
}

/// A hidden effect of the virtual machine; the truth is not read.
fn hidden(cause: HiddenCause, seed: u64, has_memory: bool) {
    let test_case = draw_test_case(cause, 10.0, seed);
    let training: Vec<RunFile> = test_case.runs.iter().map(|text| run(text)).collect();
    let holdout = if has_memory {
        let whole = run(&test_case.holdout);
        let times = whole.column("time_s").expect("it has a time").to_vec();
        rows(&test_case.holdout, |row| times[row] - times[0] <= PLAYED_S)
    } else {
        // One in a few rows is enough.
        let every = test_case.holdout.lines().count().div_ceil(60);
        rows(&test_case.holdout, |row| row.is_multiple_of(every))
    };
    check(cause.name(), &test_case.machine, &training, &holdout, has_memory);
}

#[test]
#[ignore = "long: two terms, each diagnosed and played to the emulated board"]
fn the_gain_of_a_spindles_and_an_axiss_terms_is_in_the_offsets() {
    hidden(HiddenCause::CentrifugalGrowth, 1, false);
    hidden(HiddenCause::PositionDependentBacklash, 1, false);
}

#[test]
#[ignore = "campaign: cargo test -p trueup-host-tests --features emulator --test extended_on_board campaign_ -- --ignored"]
fn campaign_the_gain_of_other_terms_is_in_the_offsets() {
    hidden(HiddenCause::SensorGain, 1, false);
    hidden(HiddenCause::SensorTemperatureDrift, 1, false);
    hidden(HiddenCause::CuttingLoad, 2, false);
    hidden(HiddenCause::ExpansionSlope, 1, false);
    hidden(HiddenCause::PitchPeriodic, 1, false);
    hidden(HiddenCause::Straightness, 1, false);
}

#[test]
#[ignore = "long: half a minute of the emulated board"]
fn the_gain_of_a_lag_is_in_the_offsets() {
    hidden(HiddenCause::ThermalLag, 2, true);
}

#[test]
fn the_gain_on_measured_machines_is_in_the_offsets() {
    let path = setup::project_root().join("data/spindle_paper_table1.csv");
    let table = std::fs::read_to_string(path).expect("the project's own");
    let paper = "[machine]\nname = \"paper\"\nkind = \"3-axis\"\n[spindle]\nsource = \"sensor\"\n\
                 [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = \
                 0.0152587890625\n";
    let known = [run(&rows(&table, |row| !row.is_multiple_of(3)))];
    check("paper's Table 1", paper, &known, &rows(&table, |row| row.is_multiple_of(3)), false);

    let axis = "[machine]\nname = \"axis\"\nkind = \"3-axis\"\n";
    let Some(path) = data("ess_iso230/z.csv") else { return };
    let text = std::fs::read_to_string(path).expect("a text file");
    let cycle = run(&text).column("run").expect("cycles").to_vec();
    let known = [run(&rows(&text, |row| cycle[row] <= 3.0))];
    check("ISO 230-2 z", axis, &known, &rows(&text, |row| cycle[row] > 3.0), false);
}
