//! A calibration over the board's serial line, as a user would load it: by SDO, read back, restarted.
//!
//! The board lives on meanwhile, its CNC disengaged.

use std::{
    os::unix::net::UnixStream,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use anyhow::{Context as _, Result, anyhow, ensure};
use trueup_client::{calibration_load, session::Session};
use trueup_core::cnc::Control;
use trueup_emulator::board::VirtualBoard;
use trueup_link::frames;
use trueup_machine::compile::CompiledCalibration;
use trueup_pipe::Block;

/// A read that finds nothing gives up after this, as on a serial device.
const SERIAL_READ_TIMEOUT: Duration = Duration::from_millis(20);
/// Milliseconds that the board lives through at a time.
const BOARD_STEP_MS: u32 = 20;

/// Loads `calibration` into `board` and lets it restart; the number of the CNC's next frame.
///
/// # Errors
/// The board refuses, or does not come back with it.
pub(crate) fn load_calibration(
    board: &mut VirtualBoard,
    calibration: &CompiledCalibration,
) -> Result<u8> {
    let reader: UnixStream = board.try_clone_serial()?;
    reader.set_read_timeout(Some(SERIAL_READ_TIMEOUT))?;
    let writer = board.try_clone_serial()?;
    let is_done = AtomicBool::new(false);
    thread::scope(|scope| {
        let living = scope.spawn(|| run_until_done(board, &is_done));
        let loaded =
            Session::open_on_stream((Box::new(reader), Box::new(writer))).and_then(|session| {
                let mut session = session;
                calibration_load::store_calibration(
                    &mut session,
                    calibration.blob(),
                    calibration.crc(),
                    &mut |_, _| {},
                )?;
                let running = calibration_load::restart(&mut session, calibration.crc())?;
                session.close();
                ensure!(
                    running == calibration.crc(),
                    "the board restarts with another calibration"
                );
                Ok(())
            });
        is_done.store(true, Ordering::Relaxed);
        let counter = living.join().map_err(|_| anyhow!("the board's thread has panicked"))??;
        loaded.context("the calibration could not be loaded over the line")?;
        Ok(counter)
    })
}

/// Lets the board live until it is done; the number of the next frame.
fn run_until_done(board: &mut VirtualBoard, is_done: &AtomicBool) -> Result<u8> {
    let mut counter = 0_u8;
    while !is_done.load(Ordering::Relaxed) {
        let mut blocks = vec![Block::default(); BOARD_STEP_MS as usize];
        let control = Control { referenced: true, service: true, ..Control::default() };
        blocks[0].frames[4] = Some(frames::encode_control(control, counter));
        counter = counter.wrapping_add(1);
        board.step(&blocks)?;
    }
    Ok(counter)
}
