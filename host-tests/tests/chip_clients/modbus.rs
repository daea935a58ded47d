//! The RS-485 line of the flashable image: a PLC engages it, and what it polls is of one cycle.

use anyhow::{Context as _, Result, ensure};
use trueup_core::cnc::{Control, Quality};
use trueup_emulator::plc;
use trueup_modbus::input::Input;

use super::{
    blocks::offset,
    support::{FAST_MACHINE, chip::Chip},
};

/// The switch for 115 200 Bd, and a master that has it.
const FAST: [&str; 4] = ["--low", "PB5", "--modbus-baud", "115200"];

/// The bytes of what was said, if it is of this kind.
fn said(event: &str, kind: &str) -> Option<(f64, Vec<u8>)> {
    let (at, rest) = event.split_once(' ')?;
    let hex = rest.strip_prefix(kind)?.strip_prefix(' ')?;
    let bytes = (0..hex.len() / 2).map(|n| u8::from_str_radix(&hex[2 * n..2 * n + 2], 16).ok());
    Some((at.parse().ok()?, bytes.collect::<Option<_>>()?))
}

/// Polls for so long, a read and a write each 20 ms, while the sensor changes in every millisecond; how many reads.
/// Each is whole, and says what the two CAN frames of one cycle say.
fn polled(until_ms: u32) -> Result<Option<usize>> {
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(None) };
    let read = plc::read();
    let mut script = "0 control 0\n0 spindle 0\n0 positions 0\n500 slope 200\n".to_string();
    let times = (300..until_ms - 30).step_by(20);
    for (counter, at) in (0..).zip(times.clone()) {
        let control = if counter < 5 { Control::REFERENCED } else { Control::ENGAGED };
        script +=
            &format!("{at} modbus {}\n{} modbus {read}\n", plc::write(control, counter), at + 9);
    }
    let report = chip.live(until_ms, &script, &FAST)?;
    ensure!(report.clean, "a violation:\n{}", report.said);
    for wrong in ["nothing drives", "collides", "overrun, a byte"] {
        ensure!(!report.said.contains(wrong), "{}", report.said);
    }
    let wait = report.said.lines().find(|line| line.contains("RS-485")).context("it is told")?;
    println!("{}", wait.trim());
    let cycles: Vec<(f64, i32)> = report
        .events
        .iter()
        .filter_map(|event| said(event, "can 281"))
        .map(|(at, data)| Some((at, offset(&data.try_into().ok()?))))
        .collect::<Option<_>>()
        .context("frames of eight bytes")?;
    let answers = report.events.iter().filter_map(|event| said(event, "modbus"));
    let mut first = None;
    let (mut reads, mut live) = (0, 0);
    for (at, bytes) in answers.filter(|(_, bytes)| bytes.get(1) == Some(&4)) {
        let words: Vec<u16> =
            bytes[3..59].as_chunks().0.iter().map(|it| u16::from_be_bytes(*it)).collect();
        let block = Input::decode(&words.try_into().expect("28 registers")).context("half old")?;
        reads += 1;
        let (Some(offsets), Quality::Live) = (block.output.offset, block.output.quality) else {
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
    }
    ensure!(reads == times.count() && live > reads / 2, "{live} of {reads} are live");
    Ok(Some(reads))
}

#[test]
fn what_a_plc_polls_is_of_one_cycle_while_values_change_every_millisecond() -> Result<()> {
    println!("{:?} reads, none half old", polled(1_500)?);
    Ok(())
}

#[test]
#[ignore = "long: nine seconds of the board, half a minute as slow as the model is"]
fn of_400_polls_none_is_half_old() -> Result<()> {
    println!("{:?} reads, none half old", polled(9_000)?);
    Ok(())
}
