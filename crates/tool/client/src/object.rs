//! Objects of the bridge, read and written by SDO over an open session.

use std::{
    iter,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
pub use trueup_canopen::dictionary::{NOT_AVAILABLE, TASKS};
use trueup_canopen::emergency::Faults;
use trueup_canopen::sdo::Abort;
pub use trueup_canopen::sdo::client::At;
use trueup_canopen::sdo::client::{
    BlockDownload, ClientError, Download, MAX_UPLOAD, Progress, Upload, give_up,
};
use trueup_core::learned::PARTS;
use trueup_link::{frame::Frame, frames, slcan::Event};
use trueup_output::escape::one_line;

use crate::{
    session::Session,
    timeout_policy::{LOOK, TimeoutPolicy},
};

/// The kind of device.
pub const NAME: At = (0x1008, 0);
/// The version of its hardware.
pub const HARDWARE: At = (0x1009, 0);
/// The version of its firmware.
pub const SOFTWARE: At = (0x100A, 0);
/// A hash of the number that its chip has from its factory.
pub const SERIAL_NUMBER: At = (0x1018, 4);
/// The offsets of X, Y and Z in nm; [`NOT_AVAILABLE`] where none is.
pub const OFFSET: [At; 3] = [(0x2000, 1), (0x2000, 2), (0x2000, 3)];
/// The quality, as in `OffsetZ`.
pub const QUALITY: At = (0x2001, 1);
/// The faults 0 to 31, a bit each, and those from 32 on.
const FAULTS: [At; 2] = [(0x2001, 9), (0x2001, 10)];
/// How many values the state has, and how many since the faults from 32 on are one of them: a firmware up to 0.2.0 has
/// its commit there.
const STATE_VALUES: (At, u32) = ((0x2001, 0), 11);
/// The state that a CNC must know next to the offsets, a bit each.
pub const STATE_BITS: At = (0x2001, 6);
/// Why the board last started.
pub const RESET_REASON: At = (0x2001, 7);
/// Where the last start stopped: program counter, link register, CFSR, address, and a panic's line.
pub const STOP: [At; 5] = [(0x2002, 1), (0x2002, 2), (0x2002, 3), (0x2002, 4), (0x2002, 5)];
/// The end of the name of a panic's file.
pub const STOP_FILE: At = (0x2002, 6);
/// The task that ran when the last start stopped: a number of
/// [`TASKS`], 0 if it is not known.
pub const STOP_TASK: At = (0x2002, 7);
/// How often the board has started since power-on: the first of the reasons.
pub const RESETS: At = (0x2003, 1);
/// Frames of the CNC that were accepted.
pub const ACCEPTED: At = (0x2030, 1);
/// Who may write: a number of [`Authority`](trueup_canopen::dictionary::Authority).
pub(crate) const AUTHORITY: At = (0x2001, 8);
/// The reference in force, in nm: the elongation, X, Y, Z. Written, they wait for [`KEY`].
pub(crate) const REFERENCE: [At; 4] = [(0x2010, 1), (0x2010, 2), (0x2010, 3), (0x2010, 4)];
/// Forgets the reference, or offers the operator the one that was written.
pub const KEY: At = (0x2010, 6);
/// Whether a reference is in force.
pub(crate) const HAS_REFERENCE: At = (0x2010, 5);
/// The reference that is offered to the operator, in nm: the elongation, X, Y, Z; [`NOT_AVAILABLE`] where none is.
pub(crate) const OFFERED_REFERENCE: [At; 4] = [(0x2010, 7), (0x2010, 8), (0x2010, 9), (0x2010, 10)];
/// When the reference was taken, in force or offered: seconds since 1970 (UTC); 0: it is not known.
pub(crate) const REFERENCE_UTC: At = (0x2010, 11);
/// By which kind of write and over which line: the lower byte and the one above it.
pub(crate) const REFERENCE_ORIGIN: At = (0x2010, 12);
/// How long ago, in s; the largest number: it is not known.
pub(crate) const REFERENCE_AGE: At = (0x2010, 13);
/// The learned values as they are applied: shares of growth, X, Y, Z in 10⁻⁵, the zero of the growth in nm.
pub const LEARNED: [At; PARTS] = [(0x2011, 1), (0x2011, 2), (0x2011, 3), (0x2011, 4), (0x2011, 5)];
/// The tool, the conditions, and whose they are: 0 not known or no term needs them, 1 the CNC's, 2 lost.
pub const CONDITIONS: [At; 3] = [(0x2012, 1), (0x2012, 2), (0x2012, 3)];
/// The elongation in thousandths of a µm, as of this moment.
pub const ELONGATION: At = (0x9130, trueup_canopen::dictionary::ELONGATION_INPUT);
/// The calibration that the bridge runs on.
pub const RUNNING: At = (0x2100, 1);
/// The calibration for the next start.
pub const NEW: At = (0x2100, 2);
/// The CRC of the running calibration; 0: it has no valid one.
pub const RUNNING_CRC: At = (0x2100, 3);
/// The CRC of the calibration for the next start; 0: none was loaded.
pub const NEW_CRC: At = (0x2100, 4);

/// Drops the calibration for the next start.
pub(crate) const DROP_NEW: At = (0x2100, 5);
/// Name of the machine that the running calibration is for.
pub const MACHINE_NAME: At = (0x2101, 1);
/// Serial number of that machine.
pub const MACHINE_SERIAL: At = (0x2101, 2);
/// The last writes to the board.
pub const WRITES: At = (0x2110, 1);
/// Seconds since 1970 (UTC).
pub(crate) const UTC: At = (0x2110, 2);
/// The header of a new firmware. Written, the other slot is erased.
pub(crate) const FIRMWARE_HEADER: At = (0x2120, 1);
/// The bytes of a new firmware from [`FIRMWARE_RECEIVED`] on.
pub(crate) const FIRMWARE_IMAGE: At = (0x2120, 2);
/// Bytes of the new firmware that have come, its header included; 0: none is under way.
pub(crate) const FIRMWARE_RECEIVED: At = (0x2120, 3);
/// Tag of the firmware under way.
pub(crate) const FIRMWARE_TAG: At = (0x2120, 4);
/// Why the last one was refused: a number of [`Refusal`](trueup_boot::refusal::Refusal), 0: it was not.
pub(crate) const FIRMWARE_REFUSED: At = (0x2120, 5);
/// The firmware slot that runs: 0 A, 1 B.
pub(crate) const RUNNING_SLOT: At = (0x2121, 1);
/// The versions in slot A and B; 0: none.
pub(crate) const SLOT_VERSION: [At; 2] = [(0x2121, 2), (0x2121, 3)];
/// The status of slot A and B in the lower byte, and starts on trial in the upper one.
pub(crate) const SLOT_STATUS: [At; 2] = [(0x2121, 4), (0x2121, 5)];
/// The oldest firmware version that may start.
pub(crate) const FIRMWARE_FLOOR: At = (0x2121, 6);
/// Why the boot program chose the slot that runs: a [`Choice`](trueup_boot::handover::Choice); 0: it does not say.
pub(crate) const SLOT_CHOICE: At = (0x2121, 7);

/// No answer has come, and for how long it was waited for.
#[derive(Debug, thiserror::Error)]
#[error("object {:04X}:{}: no answer in {:.0} s", .0.0, .0.1, .1.as_secs_f64())]
struct NoAnswer(At, Duration);

/// An object comes more slowly than any bridge sends; after this many bytes.
#[derive(Debug, thiserror::Error)]
#[error("object {:04X}:{}: {} bytes have come, too slowly; is it a bridge?", .0.0, .0.1, .1)]
struct TooSlow(At, u32);

/// The most bytes of a text: names and versions have at most 64.
const MAX_TEXT: u32 = 256;
/// A transfer may last so long, and this for each byte more: a bridge that is emulated on a busy computer sends a segment of
/// seven bytes in less than 0.35 s.
const TRANSFER_TIME: Duration = Duration::from_secs(30);
const TIME_PER_BYTE: Duration = Duration::from_millis(50);

/// Reads an object. `progress` receives how many bytes have come, and of how many.
///
/// A frame may be lost on the line, and reading changes nothing: it is tried twice. No object is read beyond
/// [`MAX_UPLOAD`] bytes, nor slower than a bridge can be.
///
/// # Errors
/// The bridge refuses or does not answer, or the line is broken.
pub fn read(
    session: &mut Session,
    at: At,
    progress: impl FnMut(usize, Option<u32>),
) -> Result<Vec<u8>> {
    read_at_most(session, at, MAX_UPLOAD, progress)
}

fn read_at_most(
    session: &mut Session,
    at: At,
    most: u32,
    mut progress: impl FnMut(usize, Option<u32>),
) -> Result<Vec<u8>> {
    let mut read = read_once(session, at, most, &mut progress);
    if read.as_ref().is_err_and(may_be_the_line) {
        session.send(&give_up(at))?;
        read = read_once(session, at, most, &mut progress);
    }
    if read.as_ref().is_err_and(is_endless) {
        session.send(&give_up(at))?;
    }
    read
}

fn is_endless(error: &anyhow::Error) -> bool {
    error.is::<TooSlow>()
        || matches!(
            error.downcast_ref(),
            Some(ClientError::TooLong { .. } | ClientError::TooShort { .. })
        )
}

/// Returns whether a frame may be lost, so that the same may be answered when it is asked for again.
pub(crate) fn may_be_the_line(error: &anyhow::Error) -> bool {
    error.is::<NoAnswer>()
        || error.downcast_ref::<ClientError>().is_some_and(ClientError::may_be_the_line)
}

fn read_once(
    session: &mut Session,
    at: At,
    most: u32,
    progress: &mut impl FnMut(usize, Option<u32>),
) -> Result<Vec<u8>> {
    let (mut upload, first) = Upload::start_at_most(at, most);
    let mut bytes = Vec::new();
    let start = Instant::now();
    transfer(session, at, first, TimeoutPolicy::from, |frame| {
        let next = upload.receive(frame, &mut bytes)?;
        let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        if start.elapsed() > TRANSFER_TIME + TIME_PER_BYTE * count {
            return Err(TooSlow(at, count).into());
        }
        progress(bytes.len(), upload.announced());
        Ok((next, Vec::new()))
    })?;
    Ok(bytes)
}

/// Reads a number of up to 32 bits.
///
/// # Errors
/// As [`read`]; it has no byte, or more than four.
pub fn number(session: &mut Session, at: At) -> Result<u32> {
    let bytes = read_at_most(session, at, 4, |_, _| ())?;
    if bytes.is_empty() {
        return Err(ClientError::TooShort { at }.into());
    }
    let mut number = [0; 4];
    number.iter_mut().zip(bytes).for_each(|(place, byte)| *place = byte);
    Ok(u32::from_le_bytes(number))
}

/// Returns the faults of the bridge.
///
/// # Errors
/// As [`number`].
pub fn faults(session: &mut Session) -> Result<Faults> {
    let [low, high] = FAULTS;
    let (values, with_high) = STATE_VALUES;
    let has_high = number(session, values)? >= with_high;
    let high = if has_high { number(session, high)? } else { 0 };
    Ok(Faults::from_words(number(session, low)?, high))
}

/// Reads a text, control and bidirectional characters escaped: who answers may be no bridge.
///
/// # Errors
/// As [`read`].
pub fn text(session: &mut Session, at: At) -> Result<String> {
    let bytes = read_at_most(session, at, MAX_TEXT, |_, _| ())?;
    Ok(one_line(&String::from_utf8_lossy(&bytes)))
}

/// Writes an object. `progress` receives how many bytes were sent.
///
/// # Errors
/// The bridge refuses or does not answer, or the line is broken.
pub fn write(
    session: &mut Session,
    at: At,
    data: &[u8],
    mut progress: impl FnMut(usize),
) -> Result<()> {
    let (mut download, first) = Download::start(at, data);
    transfer(session, at, first, TimeoutPolicy::from, |frame| {
        let next = download.receive(frame)?;
        progress(download.sent());
        Ok((next, Vec::new()))
    })
}

/// Writes an object in blocks of segments, with an answer to a block and not to each segment, to a bridge that may
/// erase a firmware slot before it answers. A bridge that knows no blocks gets segments. `progress` receives how many bytes
/// were sent; an error of it ends the transfer.
///
/// # Errors
/// As [`write()`]; that of `progress`.
pub(crate) fn write_in_blocks(
    session: &mut Session,
    at: At,
    data: &[u8],
    mut progress: impl FnMut(usize) -> Result<()>,
) -> Result<()> {
    let (mut download, first) = BlockDownload::start(at, data);
    let written = transfer(session, at, first, TimeoutPolicy::over_an_erase, |frame| {
        let next = download.receive(frame)?;
        let more = iter::from_fn(|| download.more()).collect();
        if next != Progress::Unchanged {
            progress(download.sent())?;
        }
        Ok((next, more))
    });
    if !written.as_ref().is_err_and(knows_no_blocks) {
        return written;
    }
    let (mut download, first) = Download::start(at, data);
    transfer(session, at, first, TimeoutPolicy::over_an_erase, |frame| {
        let next = download.receive(frame)?;
        if next != Progress::Unchanged {
            progress(download.sent())?;
        }
        Ok((next, Vec::new()))
    })
}

fn knows_no_blocks(error: &anyhow::Error) -> bool {
    let command = Abort::Command.code();
    matches!(error.downcast_ref(), Some(ClientError::Aborted { code, .. }) if *code == command)
}

fn transfer(
    session: &mut Session,
    at: At,
    first: Frame,
    patience_from: fn(Instant) -> TimeoutPolicy,
    mut hear: impl FnMut(&Frame) -> Result<(Progress, Vec<Frame>)>,
) -> Result<()> {
    session.send(&first).context("while asking for an object")?;
    let mut patience = patience_from(Instant::now());
    loop {
        let event = session.next_event(Instant::now() + LOOK)?;
        let frame = match &event {
            Some(Event::Frame(frame)) => Some(frame),
            _ => None,
        };
        let is_beat = frame.is_some_and(|frame| frames::decode_heartbeat(frame).is_ok());
        patience.look(Instant::now(), is_beat);
        let (next, more) = frame.map_or(Ok((Progress::Unchanged, Vec::new())), &mut hear)?;
        match next {
            Progress::Unchanged if patience.is_over() => {
                return Err(NoAnswer(at, patience.listened()).into());
            }
            Progress::Unchanged => {}
            Progress::Ask(request) => {
                session.send(&request)?;
                more.iter().try_for_each(|frame| session.send(frame))?;
                patience = patience_from(Instant::now());
            }
            Progress::Done => return Ok(()),
        }
    }
}
