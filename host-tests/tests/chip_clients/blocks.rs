//! The same codes give the same offsets: on the flashable image behind the model's converter and DMA, on the
//! host, and on the virtual board.
//!
//! A pattern of codes repeats every 100 ms, so after a while the offsets do. Where the chip's blocks of 20 codes
//! begin in it is not known: the one place where both agree is found, and there they agree in every block.

use std::f64::consts::TAU;

use anyhow::{Context as _, Result, ensure};
use trueup_core::{
    bridge::TickInput,
    cnc::{Control, SpindleState},
    design_parameters::CODES_PER_TICK,
    units::{AdcCode, Rpm},
};
use trueup_emulator::{
    board::{MAX_BATCH_BLOCKS, VirtualBoard},
    firmware_images,
};
use trueup_link::{frame::Frame, frames};
use trueup_machine::{CompiledCalibration, MachineFile, compile};
use trueup_node::node::{Interface, Node};
use trueup_pipe::{Block, FRAMES_PER_BLOCK};

use super::support::{FAST_MACHINE, chip::Chip};

/// Blocks until the pattern begins anew.
const PERIOD: usize = 100;
const CODES: usize = PERIOD * CODES_PER_TICK;
/// Blocks until every filter has forgotten what was before, and the CNC has engaged.
const SETTLED: usize = 700;
const SPEED: u16 = 3_000;

/// Slower than the slew limit, and no two parts of it alike.
fn pattern() -> Vec<u16> {
    let mut random = 1_u32;
    let code = |n: usize| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let turn = TAU * n as f64 / CODES as f64;
        let mean = 1_100.0 + 40.0 * turn.sin() + 15.0 * (3.0 * turn).cos();
        mean as u16 + (random >> 30) as u16
    };
    (0..CODES).map(code).collect()
}

fn compiled() -> Result<CompiledCalibration> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("machine.toml");
    std::fs::write(&path, FAST_MACHINE)?;
    Ok(compile(&MachineFile::read(&path)?)?)
}

/// Returns the offset in Z of an `OffsetZ`, in 10 nm.
pub fn offset(data: &[u8; 8]) -> i32 {
    ((u64::from_le_bytes(*data) << 20).cast_signed() >> 44) as i32
}

/// Blocks from a place in the pattern on, with a CNC that engages after 250 of them.
fn blocks(pattern: &[u16], from: usize) -> Vec<Block> {
    let codes = |n: usize| {
        std::array::from_fn(|i| AdcCode(pattern[(from + n * CODES_PER_TICK + i) % CODES]))
    };
    let sent = |n: usize| {
        let mut sent = [None; FRAMES_PER_BLOCK];
        let counter = (n / 20) as u8;
        match n % 20 {
            0 => {
                let control = Control { engage: n >= 250, ..Control::REFERENCED };
                sent[0] = Some(frames::encode_control(control, counter));
            }
            10 => {
                let spindle = SpindleState { speed: Rpm(SPEED), load_n: 0 };
                sent[0] = Some(frames::encode_spindle(spindle, counter));
            }
            _ => {}
        }
        sent
    };
    let all = 0..SETTLED + PERIOD;
    all.map(|n| Block { codes: codes(n), frames: sent(n), ..Block::default() }).collect()
}

/// Returns the offsets of one period, once it is settled.
fn settled<'f>(sent: impl Iterator<Item = &'f Frame>) -> Vec<i32> {
    let offsets = sent.filter(|frame| frame.id() == 0x281).map(|frame| offset(frame.data()));
    offsets.skip(SETTLED).collect()
}

fn on_the_host(compiled: &CompiledCalibration, blocks: &[Block]) -> Vec<i32> {
    let mut node = Node::new(compiled.calibration().into());
    let mut sent = Vec::new();
    for block in blocks {
        for frame in block.frames.iter().flatten() {
            node.receive(Interface::Can, frame).expect("nothing of it is refused");
        }
        let input = TickInput { codes: Some(&block.codes), ..TickInput::default() };
        sent.extend(node.tick(1, input));
    }
    settled(sent.iter())
}

fn on_the_virtual_board(compiled: &CompiledCalibration, blocks: &[Block]) -> Result<Vec<i32>> {
    let image = firmware_images::build_virtual_board_image()?;
    let mut board = VirtualBoard::boot(&image, compiled.blob())?;
    let mut sent = Vec::new();
    for batch in blocks.chunks(MAX_BATCH_BLOCKS as usize) {
        sent.extend(board.step(batch)?.into_iter().map(|(_, frame)| frame));
    }
    Ok(settled(sent.iter()))
}

#[test]
fn the_same_codes_give_the_same_offsets_on_the_chip_the_host_and_the_virtual_board() -> Result<()> {
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(()) };
    let pattern = pattern();
    let words: Vec<String> = pattern.iter().map(ToString::to_string).collect();
    let script =
        format!("0 flags 2\n0 rpm {SPEED}\n250 flags 3\n300 pattern {}\n", words.join(" "));
    let report = chip.live(1_000, &script, &[])?;
    ensure!(report.clean, "a violation:\n{}", report.stdout);
    let of = |event: &String| {
        let hex = event.split_once(" can 281 ")?.1;
        let byte = |n: usize| u8::from_str_radix(&hex[2 * n..2 * n + 2], 16).ok();
        let mut data = [0; 8];
        for (n, place) in data.iter_mut().enumerate() {
            *place = byte(n)?;
        }
        Some(offset(&data))
    };
    let all: Vec<i32> = report.events.iter().filter_map(of).collect();
    let on_the_chip = &all[all.len() - PERIOD..];

    let compiled = compiled()?;
    let mut found = Vec::new();
    for from in 0..CODES_PER_TICK {
        let on_the_host = on_the_host(&compiled, &blocks(&pattern, from));
        let agrees = |first: &usize| {
            (0..PERIOD).all(|n| on_the_host[(first + n) % PERIOD] == on_the_chip[n])
        };
        found.extend((0..PERIOD).filter(agrees).map(|first| (from, first)));
    }
    let [(from, first)] = found[..] else {
        anyhow::bail!("they agree at {found:?}; on the chip {on_the_chip:?}")
    };
    let emulated = on_the_virtual_board(&compiled, &blocks(&pattern, from))?;
    let differ = (0..PERIOD).find(|n| emulated[(first + n) % PERIOD] != on_the_chip[*n]);
    ensure!(differ.is_none(), "block {differ:?} differs on the virtual board");
    let (least, most) = on_the_chip
        .iter()
        .fold((i32::MAX, i32::MIN), |(least, most), value| (least.min(*value), most.max(*value)));
    println!(
        "{PERIOD} offsets of {least}…{most} × 10 nm are the same on chip, host and virtual board"
    );
    most.checked_sub(least).filter(|range| *range > 500).context("they hardly move")?;
    Ok(())
}
