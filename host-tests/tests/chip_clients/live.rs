//! A board whose time goes on only as far as it is let, in a world that is played as it goes.

use std::{
    io::{ErrorKind, Read as _, Write as _},
    net::TcpStream,
    time::Duration,
};

use anyhow::{Result, ensure};
use trueup_emulator::lockstep_chip::LockstepChip;
use trueup_link::{
    layout::STATUS_ID,
    receiver::{OffsetReceiver, StatusReceiver},
    slcan::{AdapterMessage, SlcanClient},
    status::StatusItem,
};

use crate::{CODE, FAST_MACHINE, GROWN_UM, support::chip::Chip};

/// The line is silent when nothing comes for so long of the wall.
const SILENCE: Duration = Duration::from_millis(500);

/// Pairs of offsets, and the newest elongation in µm, that have come until nothing comes any more.
fn first_offset(line: &mut TcpStream) -> Result<(u32, Option<f64>)> {
    let (mut client, mut bytes) = (SlcanClient::default(), [0; 4096]);
    let (mut offsets, mut status) = (OffsetReceiver::new(), StatusReceiver::default());
    let (mut pairs, mut grown_um) = (0, None);
    loop {
        let length = match line.read(&mut bytes) {
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                return Ok((pairs, grown_um));
            }
            length => length?,
        };
        ensure!(length > 0, "the line is closed");
        for event in bytes[..length].iter().filter_map(|byte| client.receive(*byte)) {
            let AdapterMessage::Frame(frame) = event else { continue };
            if frame.id() != STATUS_ID {
                pairs += u32::from(matches!(offsets.accept(&frame), Ok(Some(_))));
            } else if let StatusItem::Elongation(Some(grown)) = status.accept(&frame)?.item {
                grown_um = Some(f64::from(grown.0) / 1e3);
            }
        }
    }
}

#[test]
fn a_board_lives_as_long_as_it_is_let_in_the_world_that_is_played() -> Result<()> {
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(()) };
    let mut board = LockstepChip::start(&chip.model, &chip.image, 0)?;
    board.advance(500)?;
    let mut line = TcpStream::connect(("127.0.0.1", board.port()))?;
    line.set_read_timeout(Some(SILENCE))?;
    line.write_all(b"S8\rO\r")?;
    board.apply_script_line(&format!("code {CODE}"))?;
    // A reader gets it before its queue is full.
    let mut elongation_um = None;
    for _ in 0..4 {
        board.advance(400)?;
        let (pairs, grown_um) = first_offset(&mut line)?;
        ensure!((395..=401).contains(&pairs), "{pairs} pairs in 400 ms");
        elongation_um = grown_um.or(elongation_um);
    }
    let grown_um = elongation_um.expect("it comes every 1.1 s");
    // A code is 0.12 µm.
    ensure!((grown_um - GROWN_UM).abs() < 0.12, "{grown_um} for {GROWN_UM}");
    assert_eq!(first_offset(&mut line)?.0, 0, "its time stands");
    board.power_off()
}
