//! Objects of the bridge, read and written by SDO over an open session.

use std::{
    iter,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use trueup_canopen::dictionary::{
    CrashDetail, ELONGATION_SUBINDEX, EntryContent, ReceiverCounter, find_address,
    find_address_by_name,
};
pub use trueup_canopen::dictionary::{NOT_AVAILABLE, ObjectAddress, TASK_NAMES};
use trueup_canopen::emergency::Faults;
use trueup_canopen::sdo::AbortCode;
use trueup_canopen::sdo::client::{
    BlockDownload, DEFAULT_MAX_UPLOAD_BYTES, Download, SdoClientError, TransferProgress, Upload,
    timeout_abort_frame,
};
use trueup_core::learned_changes::LEARNED_PART_COUNT;
use trueup_link::{frame::Frame, frames, slcan::AdapterMessage};
use trueup_output::escape::escape_line;

use crate::{
    session::Session,
    timeout_policy::{POLL_INTERVAL, TimeoutPolicy},
};

/// The commit of the image's source: the first 32 bits of its hash; 0: the image does not know.
pub const COMMIT: ObjectAddress = find_address(EntryContent::Commit);
/// The same of a firmware up to 0.2.0, where this one has the faults from 32 on. A number, for no table of today may move it.
pub(crate) const LEGACY_COMMIT: ObjectAddress = (0x2001, 10);
/// The kind of device.
pub const DEVICE_NAME: ObjectAddress = find_address_by_name("Manufacturer device name");
/// The version of its hardware.
pub const HARDWARE_VERSION: ObjectAddress = find_address_by_name("Manufacturer hardware version");
/// The version of its firmware.
pub const SOFTWARE_VERSION: ObjectAddress = find_address_by_name("Manufacturer software version");
/// A hash of the number that its chip has from its factory.
pub const SERIAL_NUMBER: ObjectAddress = find_address(EntryContent::SerialNumber);
/// The offsets of X, Y and Z in nm; [`NOT_AVAILABLE`] where none is.
pub const OFFSETS: [ObjectAddress; 3] = [
    find_address(EntryContent::Offset(0)),
    find_address(EntryContent::Offset(1)),
    find_address(EntryContent::Offset(2)),
];
/// The quality, as in `OffsetZ`.
pub const QUALITY: ObjectAddress = find_address(EntryContent::Quality);
/// The faults 0 to 31, a bit each, and those from 32 on.
const FAULTS: [ObjectAddress; 2] =
    [find_address(EntryContent::AllFaults), find_address(EntryContent::HighFaults)];
/// How many values the state has, and how many since the commit comes behind the faults from 32 on: a firmware up to
/// 0.2.0 has its commit in their place.
const HIGH_FAULTS_STATE_COUNT: (ObjectAddress, u32) = ((COMMIT.0, 0), COMMIT.1 as u32);
/// The state that a CNC must know next to the offsets, a bit each.
pub const STATE_BITS: ObjectAddress = find_address(EntryContent::StateBits);
/// Why the board last started.
pub const RESET_REASON: ObjectAddress = find_address(EntryContent::ResetReason);
/// Where the last start stopped: program counter, link register, CFSR, address, and a panic's line.
pub const CRASH_DETAILS: [ObjectAddress; 5] = [
    find_address(EntryContent::CrashDetail(CrashDetail::ProgramCounter)),
    find_address(EntryContent::CrashDetail(CrashDetail::LinkRegister)),
    find_address(EntryContent::CrashDetail(CrashDetail::FaultStatus)),
    find_address(EntryContent::CrashDetail(CrashDetail::Address)),
    find_address(EntryContent::CrashDetail(CrashDetail::Line)),
];
/// The end of the name of a panic's file.
pub const CRASH_FILE_NAME: ObjectAddress =
    find_address(EntryContent::CrashDetail(CrashDetail::File));
/// The task that ran when the last start stopped: a number of
/// [`TASK_NAMES`], 0 if it is not known.
pub const CRASH_TASK: ObjectAddress = find_address(EntryContent::CrashDetail(CrashDetail::Task));
/// How often the board has started since power-on: the first of the reasons.
pub const FIRST_RESET_COUNT: ObjectAddress = find_address(EntryContent::Resets(0));
/// Frames of the CNC that were accepted.
pub(crate) const ACCEPTED_FRAMES: ObjectAddress =
    find_address(EntryContent::ReceiverCounter(ReceiverCounter::Accepted));
/// Who may write: a number of [`WriteAuthority`](trueup_canopen::dictionary::WriteAuthority).
pub(crate) const WRITE_AUTHORITY: ObjectAddress = find_address(EntryContent::Authority);
/// The reference in force, in nm: the elongation, X, Y, Z. Written, they wait for [`REFERENCE_COMMAND`].
pub(crate) const REFERENCE_COMPONENTS: [ObjectAddress; 4] = [
    find_address(EntryContent::ReferenceElongation),
    find_address(EntryContent::Reference(0)),
    find_address(EntryContent::Reference(1)),
    find_address(EntryContent::Reference(2)),
];
/// Forgets the reference, or offers the operator the one that was written.
pub(crate) const REFERENCE_COMMAND: ObjectAddress = find_address(EntryContent::Forget);
/// Whether a reference is in force.
pub(crate) const REFERENCE_ACTIVE: ObjectAddress = find_address(EntryContent::HasReference);
/// The reference that is offered to the operator, in nm: the elongation, X, Y, Z; [`NOT_AVAILABLE`] where none is.
pub(crate) const OFFERED_REFERENCE_COMPONENTS: [ObjectAddress; 4] = [
    find_address(EntryContent::OfferedElongation),
    find_address(EntryContent::Offered(0)),
    find_address(EntryContent::Offered(1)),
    find_address(EntryContent::Offered(2)),
];
/// When the reference was taken, in force or offered: seconds since 1970 (UTC); 0: it is not known.
pub(crate) const REFERENCE_UTC_SECONDS: ObjectAddress = find_address(EntryContent::ReferenceUtc);
/// By which kind of write and over which line: the lower byte and the one above it.
pub(crate) const REFERENCE_ORIGIN: ObjectAddress = find_address(EntryContent::ReferenceOrigin);
/// How long ago, in s; the largest number: it is not known.
pub(crate) const REFERENCE_AGE_SECONDS: ObjectAddress = find_address(EntryContent::ReferenceAge);
/// The learned values as they are applied: shares of growth, X, Y, Z in 10⁻⁵, the zero of the growth in nm.
pub const LEARNED_VALUES: [ObjectAddress; LEARNED_PART_COUNT] = [
    find_address(EntryContent::Learned(0)),
    find_address(EntryContent::Learned(1)),
    find_address(EntryContent::Learned(2)),
    find_address(EntryContent::Learned(3)),
    find_address(EntryContent::Learned(4)),
];
/// The tool, the conditions, and whose they are: 0 not known or no term needs them, 1 the CNC's, 2 lost.
pub const CONDITIONS: [ObjectAddress; 3] = [
    find_address(EntryContent::Tool),
    find_address(EntryContent::Conditions),
    find_address(EntryContent::ConditionsOrigin),
];
/// The elongation in thousandths of a µm, as of this moment. Inputs count from 0, their sub-indices from 1.
pub const ELONGATION: ObjectAddress = find_address(EntryContent::Input(ELONGATION_SUBINDEX - 1));
/// The calibration that the bridge runs on.
pub const RUNNING_CALIBRATION: ObjectAddress = find_address(EntryContent::Running);
/// The calibration for the next start.
pub const PENDING_CALIBRATION: ObjectAddress = find_address(EntryContent::New);
/// The CRC of the running calibration; 0: it has no valid one.
pub const RUNNING_CRC: ObjectAddress = find_address(EntryContent::RunningCrc);
/// The CRC of the calibration for the next start; 0: none was loaded.
pub const PENDING_CRC: ObjectAddress = find_address(EntryContent::NewCrc);

/// Drops the calibration for the next start.
pub(crate) const DROP_PENDING_COMMAND: ObjectAddress = find_address(EntryContent::DropNew);
/// Name of the machine that the running calibration is for.
pub const MACHINE_NAME: ObjectAddress = find_address(EntryContent::MachineName);
/// Serial number of that machine.
pub const MACHINE_SERIAL: ObjectAddress = find_address(EntryContent::MachineSerial);
/// The last writes to the board.
pub const WRITE_LOG: ObjectAddress = find_address(EntryContent::WriteLog);
/// Seconds since 1970 (UTC).
pub(crate) const UTC_SECONDS: ObjectAddress = find_address(EntryContent::Utc);
/// The header of a new firmware. Written, the other slot is erased.
pub(crate) const FIRMWARE_HEADER: ObjectAddress = find_address(EntryContent::FirmwareHeader);
/// The bytes of a new firmware from [`FIRMWARE_BYTES_RECEIVED`] on.
pub(crate) const FIRMWARE_IMAGE: ObjectAddress = find_address(EntryContent::FirmwareImage);
/// Bytes of the new firmware that have come, its header included; 0: none is under way.
pub(crate) const FIRMWARE_BYTES_RECEIVED: ObjectAddress =
    find_address(EntryContent::FirmwareReceived);
/// Tag of the firmware under way.
pub(crate) const FIRMWARE_TAG: ObjectAddress = find_address(EntryContent::FirmwareTag);
/// Why the last one was refused: a number of [`FirmwareRejectReason`](trueup_boot::reject_reason::FirmwareRejectReason), 0: it was not.
pub(crate) const FIRMWARE_REJECT_REASON: ObjectAddress =
    find_address(EntryContent::FirmwareRefused);
/// The firmware slot that runs: 0 A, 1 B.
pub(crate) const RUNNING_SLOT: ObjectAddress = find_address(EntryContent::RunningSlot);
/// The versions in slot A and B; 0: none.
pub(crate) const SLOT_VERSIONS: [ObjectAddress; 2] =
    [find_address(EntryContent::SlotVersion(0)), find_address(EntryContent::SlotVersion(1))];
/// The status of slot A and B in the lower byte, and starts on trial in the upper one.
pub(crate) const SLOT_STATUSES: [ObjectAddress; 2] =
    [find_address(EntryContent::SlotStatus(0)), find_address(EntryContent::SlotStatus(1))];
/// The oldest firmware version that may start.
pub(crate) const MIN_FIRMWARE_VERSION: ObjectAddress = find_address(EntryContent::FirmwareFloor);
/// Why the boot program chose the slot that runs: a [`StartInfo`](trueup_boot::handover::StartInfo); 0: it does not say.
pub(crate) const SLOT_CHOICE: ObjectAddress = find_address(EntryContent::SlotChoice);

/// No answer has come, and for how long it was waited for.
#[derive(Debug, thiserror::Error)]
#[error("object {:04X}:{}: no answer in {:.0} s", .0.0, .0.1, .1.as_secs_f64())]
struct ResponseTimeoutError(ObjectAddress, Duration);

/// An object comes more slowly than any bridge sends; after this many bytes.
#[derive(Debug, thiserror::Error)]
#[error("object {:04X}:{}: {} bytes have come, too slowly; is it a bridge?", .0.0, .0.1, .1)]
struct TransferTooSlowError(ObjectAddress, u32);

/// The most bytes of a text: names and versions have at most 64.
const MAX_TEXT_BYTES: u32 = 256;
/// A transfer may last so long, and this for each byte more: a bridge that is emulated on a busy computer sends a segment of
/// seven bytes in less than 0.35 s.
const TRANSFER_BASE_TIMEOUT: Duration = Duration::from_secs(30);
const TRANSFER_TIMEOUT_PER_BYTE: Duration = Duration::from_millis(50);

/// Reads an object. `progress` receives how many bytes have come, and of how many.
///
/// A frame may be lost on the line, and reading changes nothing: it is tried twice. No object is read beyond
/// [`DEFAULT_MAX_UPLOAD_BYTES`] bytes, nor slower than a bridge can be.
///
/// # Errors
/// The bridge refuses or does not answer, or the line is broken.
pub fn read(
    session: &mut Session,
    at: ObjectAddress,
    progress: impl FnMut(usize, Option<u32>),
) -> Result<Vec<u8>> {
    read_with_size_limit(session, at, DEFAULT_MAX_UPLOAD_BYTES, progress)
}

fn read_with_size_limit(
    session: &mut Session,
    at: ObjectAddress,
    most: u32,
    mut progress: impl FnMut(usize, Option<u32>),
) -> Result<Vec<u8>> {
    let mut read = read_once(session, at, most, &mut progress);
    if read.as_ref().is_err_and(is_transmission_error) {
        session.send(&timeout_abort_frame(at))?;
        read = read_once(session, at, most, &mut progress);
    }
    if read.as_ref().is_err_and(is_transfer_left_open) {
        session.send(&timeout_abort_frame(at))?;
    }
    read
}

fn is_transfer_left_open(error: &anyhow::Error) -> bool {
    error.is::<TransferTooSlowError>()
        || matches!(
            error.downcast_ref(),
            Some(SdoClientError::TooLong { .. } | SdoClientError::TooShort { .. })
        )
}

/// Returns whether a frame may be lost, so that the same may be answered when it is asked for again.
pub(crate) fn is_transmission_error(error: &anyhow::Error) -> bool {
    error.is::<ResponseTimeoutError>()
        || error.downcast_ref::<SdoClientError>().is_some_and(SdoClientError::is_transmission_error)
}

fn read_once(
    session: &mut Session,
    at: ObjectAddress,
    most: u32,
    progress: &mut impl FnMut(usize, Option<u32>),
) -> Result<Vec<u8>> {
    let (mut upload, first) = Upload::start_with_size_limit(at, most);
    let mut bytes = Vec::new();
    let start = Instant::now();
    transfer(session, at, first, TimeoutPolicy::new, |frame| {
        let next = upload.receive(frame, &mut bytes)?;
        let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        if start.elapsed() > TRANSFER_BASE_TIMEOUT + TRANSFER_TIMEOUT_PER_BYTE * count {
            return Err(TransferTooSlowError(at, count).into());
        }
        progress(bytes.len(), upload.indicated_size());
        Ok((next, Vec::new()))
    })?;
    Ok(bytes)
}

/// Reads a number of up to 32 bits.
///
/// # Errors
/// As [`read`]; it has no byte, or more than four.
pub fn read_number(session: &mut Session, at: ObjectAddress) -> Result<u32> {
    let bytes = read_with_size_limit(session, at, 4, |_, _| ())?;
    if bytes.is_empty() {
        return Err(SdoClientError::TooShort { at }.into());
    }
    let mut number = [0; 4];
    number.iter_mut().zip(bytes).for_each(|(place, byte)| *place = byte);
    Ok(u32::from_le_bytes(number))
}

/// Returns the faults of the bridge.
///
/// # Errors
/// As [`read_number`].
pub fn read_faults(session: &mut Session) -> Result<Faults> {
    let [low, high] = FAULTS;
    let (values, with_high) = HIGH_FAULTS_STATE_COUNT;
    let has_high = read_number(session, values)? >= with_high;
    let high = if has_high { read_number(session, high)? } else { 0 };
    Ok(Faults::from_words(read_number(session, low)?, high))
}

/// Reads a text, control and bidirectional characters escaped: who answers may be no bridge.
///
/// # Errors
/// As [`read`].
pub fn read_text(session: &mut Session, at: ObjectAddress) -> Result<String> {
    let bytes = read_with_size_limit(session, at, MAX_TEXT_BYTES, |_, _| ())?;
    Ok(escape_line(&String::from_utf8_lossy(&bytes)))
}

/// Writes an object. `progress` receives how many bytes were sent.
///
/// # Errors
/// The bridge refuses or does not answer, or the line is broken.
pub fn write(
    session: &mut Session,
    at: ObjectAddress,
    data: &[u8],
    mut progress: impl FnMut(usize),
) -> Result<()> {
    let (mut download, first) = Download::start(at, data);
    transfer(session, at, first, TimeoutPolicy::new, |frame| {
        let next = download.receive(frame)?;
        progress(download.bytes_sent());
        Ok((next, Vec::new()))
    })
}

/// Writes an object in blocks of segments, with an answer to a block and not to each segment, to a bridge that may
/// erase a firmware slot before it answers. A bridge that knows no blocks gets segments. `progress` receives how many bytes
/// were sent; an error of it ends the transfer.
///
/// # Errors
/// As [`write()`]; that of `progress`.
pub(crate) fn block_download(
    session: &mut Session,
    at: ObjectAddress,
    data: &[u8],
    mut progress: impl FnMut(usize) -> Result<()>,
) -> Result<()> {
    let (mut download, first) = BlockDownload::start(at, data);
    let written = transfer(session, at, first, TimeoutPolicy::for_flash_erase, |frame| {
        let next = download.receive(frame)?;
        let more = iter::from_fn(|| download.next_segment()).collect();
        if next != TransferProgress::Unchanged {
            progress(download.bytes_sent())?;
        }
        Ok((next, more))
    });
    if !written.as_ref().is_err_and(is_block_transfer_unsupported) {
        return written;
    }
    let (mut download, first) = Download::start(at, data);
    transfer(session, at, first, TimeoutPolicy::for_flash_erase, |frame| {
        let next = download.receive(frame)?;
        if next != TransferProgress::Unchanged {
            progress(download.bytes_sent())?;
        }
        Ok((next, Vec::new()))
    })
}

fn is_block_transfer_unsupported(error: &anyhow::Error) -> bool {
    let command = AbortCode::Command.code();
    matches!(error.downcast_ref(), Some(SdoClientError::Aborted { code, .. }) if *code == command)
}

fn transfer(
    session: &mut Session,
    at: ObjectAddress,
    first: Frame,
    timeout_from: fn(Instant) -> TimeoutPolicy,
    mut receive: impl FnMut(&Frame) -> Result<(TransferProgress, Vec<Frame>)>,
) -> Result<()> {
    session.send(&first).context("while asking for an object")?;
    let mut timeout = timeout_from(Instant::now());
    loop {
        let event = session.next_event(Instant::now() + POLL_INTERVAL)?;
        let frame = match &event {
            Some(AdapterMessage::Frame(frame)) => Some(frame),
            _ => None,
        };
        let is_beat = frame.is_some_and(|frame| frames::decode_heartbeat(frame).is_ok());
        timeout.record_poll(Instant::now(), is_beat);
        let (next, more) =
            frame.map_or(Ok((TransferProgress::Unchanged, Vec::new())), &mut receive)?;
        match next {
            TransferProgress::Unchanged if timeout.is_expired() => {
                return Err(ResponseTimeoutError(at, timeout.listening_time()).into());
            }
            TransferProgress::Unchanged => {}
            TransferProgress::Request(request) => {
                session.send(&request)?;
                more.iter().try_for_each(|frame| session.send(frame))?;
                timeout = timeout_from(Instant::now());
            }
            TransferProgress::Done => return Ok(()),
        }
    }
}
