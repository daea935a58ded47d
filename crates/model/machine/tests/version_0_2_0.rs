//! Calibrations and predictions that version 0.2.0 has made, held against those of today: the lines "machine file",
//! "calibration" and "firmware" of the compatibility policy (`docs/reference.md`).
//!
//! `host-tests/corpus/0.2.0` has the files, and how they were made. Its machine files are those that 0.2.0 shipped, and
//! three with every kind of record that it knew.

use std::{
    fs,
    path::{Path, PathBuf},
};

use trueup_core::{
    bridge::TickInput,
    cnc::{AxisPosition, Control, LinearAxis, RotaryAxisAngles, TravelDirection},
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT},
    temperature_channels::RawTemperatures,
    thermometer::RawTemperatureReading,
    units::{AdcCode, MicroDegrees, Position, Rpm},
};
use trueup_link::frames;
use trueup_machine::{
    Machine, MachineFile, RunFile, compile,
    decompile::decompile_to_toml,
    inputs::{LinearInput, TemperatureInputKind},
    predict::RunPredictor,
    schema,
};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_store::{
    calibration::{MAX_BLOB_SIZE, decode},
    calibration_load::LoadSlot,
};

/// Machine files of 0.2.0, without their endings.
const NAMES: [&str; 9] = [
    "all",
    "axes",
    "base",
    "chip_faults",
    "gantry",
    "paper_spindle",
    "spindle",
    "trueup_gantry",
    "warmup",
];
/// By how much a shown calibration may compile to something else, in nm: curves and tables of temperature have no
/// inverse to the bit (`show_round_trip`).
const SHOWN_WITHIN_NM: f64 = 0.1;
/// What the thermometers have, in °C.
const SHOP_C: f64 = 25.0;
/// The same for `gantry`, whose beam gives nothing above 5.4 °C.
const GANTRY_C: f64 = 5.0;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../host-tests/corpus/0.2.0")
}

fn machine(name: &str) -> Machine {
    MachineFile::read(&folder().join(name).with_extension("toml"))
        .unwrap_or_else(|error| panic!("{error}"))
}

fn blob(name: &str) -> Vec<u8> {
    fs::read(folder().join(name).with_extension("bin")).expect("it was committed")
}

/// The one key that was in a machine file of 0.2.0 and not in its calibration: a board checks positions by it since.
const RAPID: &str = "rapid_mm_per_min = 15000.0\n";

#[test]
fn every_machine_file_of_0_2_0_compiles_to_its_bytes_but_for_the_rapid_traverse() {
    for name in NAMES {
        let path = folder().join(name).with_extension("toml");
        let text = fs::read_to_string(&path).expect("it was committed");
        let bytes = |text: &str| {
            let machine = MachineFile::parse(text, &path).unwrap_or_else(|error| panic!("{error}"));
            compile(&machine).unwrap_or_else(|error| panic!("{error}")).blob().to_vec()
        };
        let then = blob(name);
        assert!(bytes(&text.replace(RAPID, "")) == then, "{name}: the bytes are others");
        assert_eq!(bytes(&text) == then, !text.contains(RAPID), "{name}");
    }
}

#[test]
fn every_calibration_of_0_2_0_is_shown_and_compiles_back() {
    for name in NAMES {
        let blob = blob(name);
        let shown = decompile_to_toml(&decode(&blob).unwrap_or_else(|error| panic!("{error}")));
        let nm = shown.largest_difference_nm.unwrap_or_else(|reason| panic!("{name}: {reason}"));
        let machine = machine(name);
        let compiled = compile(&machine).unwrap_or_else(|error| panic!("{error}"));
        // What the file's own compilation costs counts in both.
        assert!(nm <= compiled.largest_difference_nm + SHOWN_WITHIN_NM, "{name}: {nm}");
        let shown = MachineFile::parse(&shown.toml, Path::new("shown.toml")).expect("it compiles");
        assert_eq!((&shown.name, &shown.serial), (&machine.name, &machine.serial), "{name}");
        assert_eq!(shown.kind, machine.kind, "{name}");
        assert_eq!(shown.spindle.source, machine.spindle.source, "{name}");
    }
}

#[test]
fn a_board_takes_and_runs_every_calibration_of_0_2_0() {
    for name in NAMES {
        let blob = blob(name);
        let mut buffer = [0; MAX_BLOB_SIZE];
        let mut slot = LoadSlot::new(&mut buffer);
        slot.open(u32::try_from(blob.len()).ok()).expect("the buffer takes it");
        slot.append(&blob).expect("it was opened");
        slot.close().expect("all has come");
        let mut load = slot.take_load().expect("it is whole");
        assert_eq!(load.validate_blob(), Ok(&blob[..]), "{name}");
        let calibration = decode(&blob).expect("as above");
        let mut node = Node::new(NodeConfiguration { blob: &blob, ..calibration.into() });
        let c = if name == "gantry" { GANTRY_C } else { SHOP_C };
        run(&mut node, &thermometers_at(c, &machine(name)));
        assert!(node.last_output().offset.is_some(), "{name}: {:?}", node.last_output());
    }
}

/// Returns what the thermometers of a machine deliver at a temperature.
fn thermometers_at(c: f64, machine: &Machine) -> RawTemperatures {
    let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
    for input in machine.inputs.iter().flat_map(|inputs| inputs.temperatures.values()) {
        raw[usize::from(input.channel)] = RawTemperatureReading(match input.kind {
            // IEC 60751, in µΩ.
            TemperatureInputKind::Pt100 => (1e8 * (1.0 + 3.9083e-3 * c - 5.775e-7 * c * c)) as i32,
            // In 1/256 counts.
            TemperatureInputKind::Linear(LinearInput { zero_counts, counts_per_c, .. }) => {
                (256.0 * (zero_counts + c * counts_per_c)) as i32
            }
        });
    }
    raw
}

/// Lets a board run for two seconds, with a CNC that engages it where its axes stand.
fn run(node: &mut Node<'_>, temperatures: &RawTemperatures) {
    // A reading that never changes is a fault.
    let codes: [AdcCode; CODES_PER_TICK] =
        std::array::from_fn(|code| AdcCode(if code.is_multiple_of(2) { 727 } else { 728 }));
    for ms in 0_u32..2_000 {
        if ms.is_multiple_of(20) {
            let counter = u8::try_from(ms / 20).expect("below 100");
            let control = Control { engage: counter >= 3, ..Control::REFERENCED };
            let mut frames = vec![frames::encode_control(control, counter)];
            frames.push(frames::encode_rotary(
                RotaryAxisAngles { angles: [MicroDegrees(0); 2] },
                counter,
            ));
            frames.extend(LinearAxis::ALL.map(|axis| {
                let (position, direction) = (Position(0), TravelDirection::Positive);
                frames::encode_position(AxisPosition { axis, position, direction }, counter)
            }));
            for frame in frames {
                node.receive(Interface::Can, &frame).expect("in order");
            }
        }
        let input = TickInput {
            codes: Some(&codes),
            speed: Some(Rpm(12_000)),
            temperatures: ms.is_multiple_of(100).then_some(temperatures),
        };
        node.tick(1, input);
        while node.next_service_frame().is_some() {}
    }
}

/// The columns that `predict` adds, of the model and of the board's arithmetic: what a key means, in µm.
#[test]
fn every_machine_file_of_0_2_0_predicts_what_it_did() {
    let run = RunFile::read(&folder().join("run.csv")).expect("a run file");
    for name in NAMES {
        let machine = machine(name);
        let predictor = RunPredictor::new(&machine, &run).unwrap_or_else(|error| panic!("{error}"));
        let mut written = Vec::new();
        predictor.write_csv(&mut written, || {}).expect("a vector takes everything");
        let now = String::from_utf8(written).expect("a run file");
        let path = folder().join(name).with_extension("csv");
        let then = fs::read_to_string(path).expect("it was committed");
        let (now, then) = (predicted(&now), predicted(&then));
        assert_eq!(now.len(), then.len(), "{name}");
        for (row, (now, then)) in now.iter().zip(&then).enumerate() {
            assert_eq!(now, then, "{name}, row {row}");
        }
    }
}

/// Returns the columns that are predicted, row by row, the names first.
fn predicted<'a>(csv: &'a str) -> Vec<Vec<&'a str>> {
    let is_predicted = |name: &str| name.starts_with("predicted_") || name.starts_with("bridge_");
    let head = csv.lines().next().unwrap_or_default().split(',');
    let chosen: Vec<bool> = head.map(is_predicted).collect();
    let cells = |row: &'a str| row.split(',').zip(&chosen).filter(|(_, chosen)| **chosen);
    csv.lines().map(|row| cells(row).map(|(cell, _)| cell).collect()).collect()
}

/// Returns the first columns of a table, row by row: section, key and what `columns` choose.
fn table_rows<'a>(table: &'a str, columns: &[usize]) -> Vec<Vec<&'a str>> {
    let mut section = "";
    let mut found = Vec::new();
    for row in table.lines().skip(2) {
        let cells: Vec<&str> = row.split('|').skip(1).map(str::trim).collect();
        if cells[0].starts_with("**") {
            section = cells[0];
        }
        let chosen = columns.iter().map(|&column| cells[column]);
        found.push([section, cells[0]].into_iter().chain(chosen).collect());
    }
    found
}

/// Keys with their units and defaults, columns of runs with their units. A range may grow, a text may become clearer.
#[test]
fn every_key_and_column_of_0_2_0_is_there_with_its_unit_and_default() {
    let read = |name: &str| fs::read_to_string(folder().join(name)).expect("it was committed");
    for (then, now, columns, count) in [
        (read("keys.txt"), schema::machine_file_markdown(), &[1, 3][..], 100),
        (read("columns.txt"), schema::run_columns_markdown(), &[1], 26),
    ] {
        let (then, now) = (table_rows(&then, columns), table_rows(&now, columns));
        assert_eq!(then.len(), count, "all were compared");
        for row in then {
            assert!(now.contains(&row), "{row:?} is gone");
        }
    }
}
