//! The RS-485 line of the flashable image: masters of other people read and engage it, and what is polled is of one
//! cycle.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{
    ffi::OsStr,
    process::{Command, Stdio},
};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use trueup_core::cnc::{Control, OffsetQuality};
use trueup_emulator::{chip::RunningChipModel, plc_requests, setup};
use trueup_modbus::input_block::InputBlock;

use super::{
    CODE, GROWN_UM, LONG,
    blocks::offset,
    support::{FAST_MACHINE, chip::Chip},
};

/// The switch for 115 200 Bd, and a master that has it.
pub const FAST: [&str; 4] = ["--low", "PB5", "--modbus-baud", "115200"];

/// Returns the bytes of the message, if it is of this kind.
pub fn sent_frame(event: &str, kind: &str) -> Option<(f64, Vec<u8>)> {
    let (at, rest) = event.split_once(' ')?;
    let hex = rest.strip_prefix(kind)?.strip_prefix(' ')?;
    let bytes = (0..hex.len() / 2).map(|n| u8::from_str_radix(&hex[2 * n..2 * n + 2], 16).ok());
    Some((at.parse().ok()?, bytes.collect::<Option<_>>()?))
}

/// Returns how long this many bytes take at 115 200 Bd.
fn answer_ms(bytes: usize) -> f64 {
    11.0 * 1e3 * bytes as f64 / 115_200.0
}

/// Polls for so long, a read and a write each 20 ms, while the sensor changes in every millisecond; how many reads.
/// Each is whole, and says what the two CAN frames of one cycle say.
fn polled(until_ms: u32) -> Result<Option<usize>> {
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(None) };
    let read = plc_requests::build_read_request_hex();
    let mut script = "0 control 0\n0 spindle 0\n0 positions 0\n500 slope 200\n".to_string();
    let times = (300..until_ms - 30).step_by(20);
    for (counter, at) in (0..).zip(times.clone()) {
        let control = if counter < 5 { Control::REFERENCED } else { Control::ENGAGED };
        script += &format!(
            "{at} modbus {}\n{} modbus {read}\n",
            plc_requests::build_write_request_hex(control, counter),
            at + 9
        );
    }
    let report = chip.live(until_ms, &script, &FAST)?;
    ensure!(report.clean, "a violation:\n{}", report.stdout);
    for wrong in ["nothing drives", "collides", "overrun, a byte"] {
        ensure!(!report.stdout.contains(wrong), "{}", report.stdout);
    }
    let wait =
        report.stdout.lines().find(|line| line.contains("RS-485")).context("it is reported")?;
    println!("{}", wait.trim());
    let cycles: Vec<(f64, i32)> = report
        .events
        .iter()
        .filter_map(|event| sent_frame(event, "can 281"))
        .map(|(at, data)| Some((at, offset(&data.try_into().ok()?))))
        .collect::<Option<_>>()
        .context("frames of eight bytes")?;
    let answers = report.events.iter().filter_map(|event| sent_frame(event, "modbus"));
    let mut first = None;
    let (mut reads, mut live) = (0, 0);
    let mut latest_ms = 0.0_f64;
    for (at, bytes) in answers.filter(|(_, bytes)| bytes.get(1) == Some(&4)) {
        let words: Vec<u16> =
            bytes[3..59].as_chunks().0.iter().map(|bytes| u16::from_be_bytes(*bytes)).collect();
        let block =
            InputBlock::decode(&words.try_into().expect("28 registers")).context("half old")?;
        reads += 1;
        let (Some(offsets), OffsetQuality::Live) = (block.output.offset, block.output.quality)
        else {
            continue;
        };
        live += 1;
        // A frame leaves its mailbox up to 0.4 ms behind its tick: one that is due may not have gone yet.
        let gone = cycles.iter().filter(|(sent, _)| *sent < at - 0.4).count();
        let lead = usize::from(block.counter) - gone;
        let first = *first.get_or_insert(lead);
        ensure!(first.abs_diff(lead) <= 1, "counter {} at {at} ms", block.counter);
        let is_of = |cycle: usize| cycles[cycle - 1].1 * 10 == offsets[2].0;
        let cycle = usize::from(block.counter) - first;
        ensure!(
            is_of(cycle) || is_of(cycle + 1),
            "{block:?} beside {:?}",
            &cycles[cycle - 2..cycle + 2]
        );
        latest_ms = latest_ms.max(at + answer_ms(bytes.len()) - cycles[cycle - 1].0);
    }
    println!(
        "from a cycle on CAN to the end of the answer that has it {latest_ms:.1} ms at the most"
    );
    ensure!(latest_ms < 30.0, "{latest_ms} ms");
    ensure!(reads == times.count() && live > reads / 2, "{live} of {reads} are live");
    Ok(Some(reads))
}

#[test]
fn what_a_plc_polls_is_of_one_cycle_while_values_change_every_millisecond() -> Result<()> {
    println!("{:?} reads, none half old", polled(1_500)?);
    Ok(())
}

#[test]
#[ignore = "long: 434 polls in nine seconds of the board, which take twenty"]
fn of_400_polls_none_is_half_old() -> Result<()> {
    println!("{:?} reads, none half old", polled(9_000)?);
    Ok(())
}

/// The switch for no parity and two stop bits, and a master that has them: a pseudo terminal refuses parity.
const NO_PARITY: [&str; 3] = ["--low", "PB6", "--modbus-no-parity"];

/// Returns what masters of other people saw of the image, at 19 200 Bd; nothing else is on its lines.
fn masters(more: &[&OsStr]) -> Result<Option<Value>> {
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(None) };
    let code = CODE.to_string();
    let sensor = ["--code", &code, "--code-after", &code, "--no-cnc"];
    let options = [&LONG[..], &sensor, &NO_PARITY].concat();
    // There before a board waits for them.
    let (python, mbpoll) = (setup::ensure_python()?, setup::ensure_mbpoll()?);
    let line = RunningChipModel::start_with_modbus(&chip.model, &chip.image, &options)?;
    let output = Command::new(python)
        .arg(setup::project_root().join("host-tests/python/board_masters.py"))
        .arg(line.port.to_string())
        .arg(mbpoll)
        .args(more)
        .stdin(Stdio::null())
        .output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let saw = serde_json::from_slice(&output.stdout)?;
    println!("{saw:#}");
    Ok(Some(saw))
}

#[test]
#[ignore = "long: two masters' session at 19 200 Bd, as slow as the model is"]
fn pymodbus_and_mbpoll_read_the_whole_block_of_the_flashable_image_and_engage_it() -> Result<()> {
    let Some(saw) = masters(&[])? else { return Ok(()) };
    assert_eq!(saw["wrong"], json!([]), "every block is whole");
    assert_eq!(saw["released"]["quality"], 6, "nobody has engaged it");
    let is_grown = |report: &Value| {
        let z = report["offset_um"][2].as_f64().unwrap_or(f64::NAN);
        (z - GROWN_UM).abs() < 0.3 && report["quality"] == 1
    };
    assert!(is_grown(&saw["live"]), "the growth is undone: {}", saw["live"]);
    let expected = json!({
        "coils": 1, "one register": 1, "behind the end": 2, "a part": 2, "elsewhere": 2,
    });
    assert_eq!(saw["exceptions"], expected);
    assert_eq!(saw["acknowledged"], json!([null, null]), "and not used:");
    let after = &saw["after faults"];
    assert!(is_grown(after), "nothing moved: {after}");
    assert_eq!((&after["refused"], &after["last_refused"]), (&json!(2), &json!(3)));
    let registers = saw["mbpoll"].as_array().context("the registers")?;
    // The layout; quality 1, 4 or 5: the PLC has gone, and its offset with it.
    assert_eq!((registers.len(), &registers[0]), (28, &json!(1)));
    assert_eq!(saw["mbpoll is whole"], true, "{registers:?}");
    Ok(())
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn mb2hal_reads_the_flashable_image_with_the_sample_that_is_delivered() -> Result<()> {
    let Some(_linuxcnc) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let sample = setup::project_root().join("integrations/modbus/mb2hal_rtu.ini");
    let Some(saw) = masters(&["--mb2hal".as_ref(), sample.as_ref()])? else { return Ok(()) };
    let registers = saw["mb2hal"].as_array().context("the registers")?;
    assert_eq!((registers.len(), &registers[0]), (28, &json!(1)));
    // "Not available" on X, quality 6: nobody has engaged it.
    assert_eq!([2, 3, 8].map(|n| registers[n].as_u64()), [32_768, 0, 6].map(Some));
    assert_eq!(saw["mb2hal is whole"], true, "{registers:?}");
    Ok(())
}
