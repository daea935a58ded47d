//! The flashable image, unmodified, on the model of its chip (`crates/bench/chip`): healthy, and with each part
//! dead that has a fall-back. The model knows the manuals and not the firmware, so what it finds counts.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod other_model;
mod power_cuts;
mod starts;
#[path = "../support/mod.rs"]
mod support;
mod waits;

use std::{path::PathBuf, sync::OnceLock};

use trueup_canopen::emergency::Fault;
use trueup_emulator::{
    chip::{self, ModelRunReport},
    firmware_images, setup,
};
/// Returns the model and the image; `None`: this compiler is too old for the model.
fn parts() -> Option<&'static (PathBuf, PathBuf)> {
    static PARTS: OnceLock<Option<(PathBuf, PathBuf)>> = OnceLock::new();
    PARTS
        .get_or_init(|| {
            let model = chip::build_model().expect("the model builds")?;
            let machine = setup::project_root().join("data/paper_spindle.toml");
            Some((
                model,
                firmware_images::build_standalone_image(&machine).expect("the image builds"),
            ))
        })
        .as_ref()
}

/// Runs the image with these options; `None` where the model cannot be built.
fn run(options: &[&str]) -> Option<ModelRunReport> {
    let Some((model, image)) = parts() else {
        println!("skipped: the model of the chip needs a newer compiler");
        return None;
    };
    Some(chip::run(model, image, options).expect("the model runs"))
}

/// Returns the first line in which these parts follow each other.
fn line<'r>(report: &'r ModelRunReport, parts: &[&str]) -> Option<&'r str> {
    report.stdout.lines().find(|line| {
        let mut rest = *line;
        parts.iter().all(|part| match rest.find(part) {
            Some(at) => {
                rest = &rest[at + part.len()..];
                true
            }
            None => false,
        })
    })
}

/// Panics unless some line has these parts, in this order.
fn assert_reported(report: &ModelRunReport, parts: &[&str]) {
    assert!(line(report, parts).is_some(), "nothing like {parts:?} in\n{}", report.stdout);
}

/// Panics unless both offsets came once a millisecond, none damaged and none missing. The first and the last
/// may each have waited for two frames of the CNC on the bus, 0.26 ms.
fn sends_every_millisecond(report: &ModelRunReport) {
    for id in ["181: ", "281: "] {
        let line = line(report, &[id, "wrong CRC 0, counter jumps 0"]).expect("frames, all whole");
        let words: Vec<&str> = line.split_whitespace().collect();
        let after = |word: &str| words.iter().position(|other| *other == word).map(|at| at + 1);
        let mean: f64 = words[after("every").expect("the mean")].parse().expect("a number");
        let count: f64 = words[1].parse().expect("a number");
        assert!((mean - 1.0).abs() * (count - 1.0) < 0.52, "{line}");
    }
}

/// Panics unless nothing was done that silicon would not do.
fn is_clean(report: &ModelRunReport) {
    assert!(report.clean, "a violation:\n{}", report.stdout);
}

/// Panics unless the log says it.
fn logs(report: &ModelRunReport, text: &str) {
    let is_logged = report.log.iter().any(|line| line.contains(text));
    assert!(is_logged, "the log does not say {text:?}:\n{}", report.log.join("\n"));
}

#[test]
fn a_healthy_board_sends_an_offset_every_millisecond_and_is_live() {
    let Some(report) = run(&["--bor", "--ms", "900"]) else { return };
    is_clean(&report);
    assert_reported(&report, &["CAN: 1000000 bit/s, sample point 85.7"]);
    sends_every_millisecond(&report);
    assert_reported(&report, &["OffsetZ at", "quality 1", "(last)"]);
}

#[test]
fn a_sensor_that_sees_200_codes_more_lifts_the_tool_by_24_56_micrometres() {
    let options = ["--bor", "--ms", "2700", "--engage-ms", "300", "--zero-ms", "500"];
    let Some(report) =
        run(&[&options[..], &["--step-ms", "1000", "--code-after", "1200"]].concat())
    else {
        return;
    };
    is_clean(&report);
    let last = line(&report, &["OffsetZ at", "(last)"]).expect("an offset");
    let words: Vec<&str> = last.split_whitespace().collect();
    let at = words.iter().position(|word| *word == "µm,").expect("its unit");
    let offset: f64 = words[at - 1].parse().expect("a number");
    // 200 of the 4071.2 codes that 10 V are behind the divider, over 500 µm, as an offset upwards. Of the noise of ±1 code a revolution's mean of
    // 400 codes leaves 0.01 µm at the most.
    assert!((offset - 24.563).abs() < 0.03, "{last}");
}

#[test]
fn what_zero_has_taken_is_stored_and_taken_up_at_the_next_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let flash = folder.path().join("flash");
    let flash = flash.to_str().expect("a plain name");
    let first = ["--ms", "1400", "--flash", flash, "--zero-ms", "900", "--engage-ms", "1100"];
    let Some(report) = run(&first) else { return };
    is_clean(&report);
    logs(&report, "stored: elongation");
    let second = ["--ms", "800", "--flash", flash, "--engage-ms", "500"];
    let Some(report) = run(&second) else { return };
    is_clean(&report);
    logs(&report, "taken up: elongation");
    assert_reported(&report, &["OffsetZ at", " 0.0", "µm, quality 1", "(last)"]);
}

/// Returns the number of the model's chip, hashed as FNV-1a is described; not that of every other board.
fn hash_of_the_number() -> u32 {
    let number = [0x31, 0, 0x2a, 0, 0x0b, 0x47, 0x33, 0x32, 0x36, 0x35, 0x39, 0x35_u8];
    number
        .iter()
        .fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(16_777_619))
}

#[test]
fn the_serial_line_answers_as_slcan_does() {
    let Some(report) = run(&["--bor", "--ms", "500", "--say", "300", "V\\rN\\rS8\\rO\\r"]) else {
        return;
    };
    is_clean(&report);
    assert_reported(&report, &["serial: \"V1013"]);
    assert_reported(&report, &["serial: \"t2818"]);
    let hash = hash_of_the_number();
    assert_reported(&report, &[&format!("serial: \"N{:04X}", (hash >> 16) ^ (hash & 0xffff))]);
}

#[test]
fn a_canopen_master_reads_the_device_type_and_the_boards_own_serial_number() {
    let ask = ["--frame", "200", "601#4000100000000000", "--frame", "220", "601#4018100400000000"];
    let Some(report) = run(&[&["--bor", "--ms", "300"], &ask[..]].concat()) else { return };
    is_clean(&report);
    assert_reported(&report, &["581 at", "[43, 00, 10, 00"]);
    let answer = format!(" can 581 43181004{:08x}", hash_of_the_number().swap_bytes());
    assert!(report.events.iter().any(|event| event.contains(&answer)), "no {answer}");
}

/// Runs the image with a client that opens the channel as soon as the board receives: it is up after some 90 ms,
/// and looks at its lines 10 ms later.
fn run_recorded_from_the_start(options: &[&str]) -> Option<ModelRunReport> {
    let opens = ["88", "90", "92", "94", "96", "98", "100"].map(|at| ["--say", at, "S8\\rO\\r"]);
    run(&[&["--bor"], opens.as_flattened(), options].concat())
}

/// Returns the faults that were reported as emergencies on the serial line, by their places in the list of faults.
fn emergencies(report: &ModelRunReport) -> Vec<u8> {
    let of = |event: &String| {
        let data = event.split(" serial t0818").nth(1)?;
        let code = u16::from_str_radix(&format!("{}{}", &data[2..4], &data[..2]), 16).ok()?;
        let fault = u8::from_str_radix(&data[6..8], 16).ok()?;
        (code != 0).then_some(fault)
    };
    report.events.iter().filter_map(of).collect()
}

#[test]
fn a_bus_without_a_partner_is_reported_and_not_waited_for() {
    let Some(report) = run_recorded_from_the_start(&["--can-alone", "--ms", "600"]) else { return };
    is_clean(&report);
    assert_reported(&report, &["TEC 128"]);
    let found = emergencies(&report);
    assert!(found.contains(&(Fault::CanPassive as u8)), "{found:?}");
    assert!(!found.contains(&(Fault::CanOff as u8)), "{found:?}");
}

#[test]
fn a_bus_that_destroys_every_frame_is_reported_and_come_back_to() {
    let Some(report) = run_recorded_from_the_start(&["--can-short", "--ms", "600"]) else { return };
    is_clean(&report);
    assert_reported(&report, &["back from bus-off by itself"]);
    let found = emergencies(&report);
    assert!(found.contains(&(Fault::CanOff as u8)), "{found:?}");
}

#[test]
fn a_dominant_bus_is_reported_and_not_disturbed() {
    let Some(report) = run_recorded_from_the_start(&["--can-stuck", "--ms", "600"]) else { return };
    is_clean(&report);
    assert_reported(&report, &["CAN: 0 sent"]);
    let found = emergencies(&report);
    assert!(found.contains(&(Fault::CanOff as u8)), "{found:?}");
}

#[test]
fn an_error_of_the_flash_does_not_hold_up_the_next_zero() {
    let zero = ["--ms", "1000", "--zero-ms", "700", "--engage-ms", "800"];
    let Some(report) = run(&[&["--bor", "--stray-flash-write", "500"], &zero[..]].concat()) else {
        return;
    };
    is_clean(&report);
    assert_reported(&report, &["24 words programmed"]);
    logs(&report, "stored: elongation");
}

/// Runs the image in a world by script.
fn run_script(script: &str, options: &[&str]) -> Option<ModelRunReport> {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("script");
    std::fs::write(&file, script).expect("it is written");
    let file = file.to_str().expect("a plain name");
    run(&[&["--bor", "--script", file], options].concat())
}

/// Returns the number before a word, on the first line that has it.
fn number(report: &ModelRunReport, word: &str) -> f64 {
    let line = line(report, &[word]).unwrap_or_else(|| panic!("no {word:?} in\n{}", report.stdout));
    let before = line.split(word).next().unwrap_or_default();
    let last = before.split_whitespace().last().unwrap_or_default();
    last.parse().unwrap_or_else(|_| panic!("no number before {word:?} in {line:?}"))
}

#[test]
fn with_an_open_channel_the_processor_is_busy_for_12_percent_at_most() {
    let Some(report) = run(&["--bor", "--ms", "1500", "--say", "300", "S8\\rO\\r"]) else { return };
    is_clean(&report);
    assert!(number(&report, " bytes sent") > 20_000.0, "{}", report.stdout);
    let busy = line(&report, &["busy "]).expect("it says how busy it is");
    let busy = busy.split("busy ").nth(1).and_then(|rest| rest.split(' ').next());
    let busy: f64 = busy.and_then(|number| number.parse().ok()).expect("a number");
    assert!(busy <= 12.0, "{busy} %");
}

#[test]
fn foreign_and_damaged_lines_move_nothing() {
    // The master is on the bus. `Control` with a wrong CRC, cut short and too long; the bridge's own offset; an
    // extended, a remote and an unknown frame; identifiers that are none; text; a line without an end.
    let lines = [
        "t30280000000000000000",
        "t3028AAAA07",
        "t3028FFFFFFFFFFFFFFFFFFFF",
        "t18180000000000000000",
        "T0000030280000000000000000",
        "r3028",
        "t12380011223344556677",
        "t9998",
        "tXYZ8",
        "hello",
        &"t".repeat(300),
    ];
    let mut script =
        String::from("0 flags 2\n200 flags 3\n240 flags 7\n300 flags 3\n300 say S8\\rO\\r\n");
    for (number, line) in lines.iter().cycle().take(10 * lines.len()).enumerate() {
        script += &format!("{} say {line}\\r\n", 500 + 4 * number);
    }
    let Some(report) = run_script(&script, &["--ms", "1100"]) else { return };
    is_clean(&report);
    assert_reported(&report, &["resets []"]);
    assert_reported(&report, &["OffsetZ at", "quality 1", "(last)"]);
    assert!(number(&report, " received,") > 4_000.0, "{}", report.stdout);
    // What comes damaged is noise, and no second master.
    assert!(emergencies(&report).is_empty(), "{:?}", emergencies(&report));
    let offsets = offsets_z(&report, 480.0);
    let first = offsets.first().expect("an offset").1;
    let last = offsets.last().expect("an offset").1;
    // Noise of ±1 code leaves 0.01 µm.
    assert!((last - first).abs() < 0.05, "{first} µm, then {last} µm");
}

#[test]
fn in_a_flood_at_the_rate_of_the_line_zero_is_stored_and_no_byte_is_lost() {
    let script = "0 flags 2\n200 flags 3\n300 say O\\r\n400 serial_flood V\\r\n600 flags 7\n";
    let Some(report) = run_script(script, &["--ms", "900"]) else { return };
    is_clean(&report);
    assert_reported(&report, &["24 words programmed"]);
    assert_reported(&report, &["resets []"]);
    assert!(number(&report, " received,") > 40_000.0, "{}", report.stdout);
    assert_eq!(number(&report, " overruns"), 0.0, "{}", report.stdout);
}

#[test]
fn where_the_dma_of_the_serial_line_does_not_move_the_line_is_polled() {
    let options =
        ["--serial-dma-stuck", "--ms", "400", "--say", "250", "V\\r", "--say", "270", "V\\r"];
    let Some(report) = run(&[&["--bor"], &options[..]].concat()) else { return };
    is_clean(&report);
    assert_reported(&report, &["serial: \"V1013"]);
    logs(&report, "dead: DMA of the serial line, bytes come in by interrupt");
    logs(&report, "dead: DMA of the serial line, bytes go out by polling");
}

/// Returns the offsets in Z on the bus from that time on: time in ms, µm.
fn offsets_z(report: &ModelRunReport, from_ms: f64) -> Vec<(f64, f64)> {
    let of = |event: &String| {
        let (time, data) = event.split_once(" can 281 ")?;
        let time: f64 = time.parse().ok()?;
        let bytes: [u8; 8] =
            std::array::from_fn(|n| u8::from_str_radix(&data[2 * n..2 * n + 2], 16).expect("hex"));
        let raw = (u64::from_le_bytes(bytes) >> 24 & 0xf_ffff) as i32;
        (time >= from_ms).then_some((time, f64::from(raw << 12 >> 12) / 100.0))
    };
    report.events.iter().filter_map(of).collect()
}

#[test]
fn a_supply_that_sags_is_corrected_up_to_3_percent_and_reported_beyond() {
    // The sensor in the middle of its range, where 2 % of the scale are 4.9 µm; the level that readings
    // count from is known 1.3 s after the start.
    let script = "0 flags 2\n0 code 2000\n200 flags 3\n240 flags 7\n300 flags 3\n\
                  1700 supply 3.267\n2700 supply 3.234\n4200 supply 3.135\n";
    let Some(report) = run_script(script, &["--ms", "4600"]) else { return };
    is_clean(&report);
    let last = *offsets_z(&report, 4190.0).first().expect("an offset");
    let before = *offsets_z(&report, 1690.0).first().expect("an offset");
    assert!((last.1 - before.1).abs() < 0.1, "{before:?}, then {last:?}");
    let emergency_ms = report.events.iter().find(|event| event.contains(" can 081 0031"));
    let emergency_ms = emergency_ms.and_then(|event| event.split(' ').next()?.parse::<f64>().ok());
    let emergency_ms = emergency_ms.expect("an emergency");
    assert!((4200.0..4400.0).contains(&emergency_ms), "{emergency_ms} ms");
    assert_reported(&report, &["OffsetZ at", "quality 4, flags 0x04", "(last)"]);
}

#[test]
fn a_supply_other_than_at_the_factory_is_a_remark_in_the_log() {
    for (volts, remarked) in [("3.30", false), ("3.15", false), ("3.12", true), ("3.48", true)] {
        let Some(report) = run(&["--bor", "--ms", "150", "--supply", volts]) else { return };
        is_clean(&report);
        let log = report.log.iter().find_map(|line| line.split("supply: ").nth(1));
        let log = log.expect("it says what the supply is");
        let millivolts: f64 = log.split(' ').next().and_then(|part| part.parse().ok()).expect("mV");
        // A code of 1502, and the rounding of the factory's value.
        let volts: f64 = volts.parse().expect("volts");
        assert!((millivolts / 1e3 - volts).abs() < 0.005, "{volts} V: {log}");
        assert_eq!(log.contains("expected 3300"), remarked, "{volts} V: {log}");
        assert!(!emergencies(&report).contains(&(Fault::SupplyOff as u8)));
    }
}

#[test]
#[ignore = "long: builds two more images"]
fn a_linear_input_is_read_and_the_sensor_does_not_notice() {
    let Some((model, _)) = parts() else {
        return println!("skipped: the model of the chip needs a newer compiler");
    };
    let folder = tempfile::tempdir().expect("a folder");
    let plain = std::fs::read_to_string(setup::project_root().join("data/paper_spindle.toml"));
    let plain = plain.expect("the machine file");
    let input = "[inputs]\ntemp_coil_c = { channel = 3, kind = \"linear\", zero_counts = 200.0, \
                 counts_per_c = 40.0 }\n";
    let runs = [plain.clone(), plain.replace("[inputs]\n", input)].map(|text| {
        let file = folder.path().join("machine.toml");
        std::fs::write(&file, text).expect("it is written");
        let image = firmware_images::build_standalone_image(&file).expect("the image builds");
        let options = ["--bor", "--ms", "1500", "--code", "1700", "--input", "4", "1.3"];
        let report = chip::run(model, &image, &options).expect("the model runs");
        is_clean(&report);
        sends_every_millisecond(&report);
        report
    });
    let [without, with] = &runs;
    // 1.3 V of 3.3 are 1613.2 codes: (1613.2 − 200)/40.
    assert_reported(with, &["3: 35.3"]);
    assert_reported(with, &["ADC2: channel 4"]);
    assert_eq!(offsets_z(with, 100.0).len(), offsets_z(without, 100.0).len());
    let values = |report: &ModelRunReport| -> Vec<f64> {
        offsets_z(report, 100.0).into_iter().map(|(_, offset)| offset).collect()
    };
    assert_eq!(values(with), values(without), "the same codes give the same offsets");
    let [without, with] = [without, with].map(|report| number(report, " µs (at"));
    println!("a block of samples waits {without} µs at the longest, with the input {with} µs");
    assert!(with < without + 10.0);
}

#[test]
#[ignore = "long: a minute of the board"]
fn a_healthy_minute_with_everything_on_has_no_violation_and_no_remark() {
    is_healthy_for("60000");
}

#[test]
#[ignore = "campaign: cargo xtask soak, ten minutes of the board"]
fn campaign_ten_healthy_minutes_with_everything_on_have_no_violation_and_no_remark() {
    is_healthy_for("600000");
}

fn is_healthy_for(ms: &str) {
    // Both lines, positions as often as there can be, thermometers, a `Zero`.
    let options = ["--bor", "--ms", ms, "--say", "100", "S8\\rO\\r", "--engage-ms", "400"];
    let more = ["--zero-ms", "2000", "--positions", "500", "--noise", "2", "--quiet"];
    let Some(report) = run(&[&options[..], &more].concat()) else { return };
    is_clean(&report);
    for grade in ["== Remark: 0", "== Unmodelled: 0", "resets []"] {
        assert_reported(&report, &[grade]);
    }
    sends_every_millisecond(&report);
    assert_reported(&report, &["OffsetZ at", "quality 1", "(last)"]);
    assert_eq!(number(&report, " overruns"), 0.0, "{}", report.stdout);
}
