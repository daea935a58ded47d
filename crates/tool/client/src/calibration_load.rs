//! A calibration to the board: sent, read back, and put to use.

use std::time::{Duration, Instant};

use anyhow::{Context as _, Error, Result, bail};
use trueup_canopen::dictionary::{
    CLEAR_REFERENCE_SIGNATURE, DROP_CALIBRATION_SIGNATURE, RESTORE_REFERENCE_SIGNATURE,
    WriteAuthority,
};
use trueup_link::{
    frame::Frame,
    frames::{self, NmtState},
    layout::NMT_ID,
    slcan::AdapterMessage,
};

use trueup_store::calibration::{MAX_LINK_TIMEOUT_MS, calibration_crc, decode};

use crate::{
    reference::{BridgeReference, ReferenceNm, unix_time_s},
    sdo_object::{
        self, ACCEPTED_FRAMES, DROP_PENDING_COMMAND, PENDING_CALIBRATION, PENDING_CRC,
        RUNNING_CALIBRATION, RUNNING_CRC, UTC_SECONDS, WRITE_AUTHORITY,
    },
    session::Session,
};

/// How long the bridge may take to learn that it may be written to.
const SERVICE_TIMEOUT: Duration = Duration::from_secs(2);
/// How long the bridge may take to believe a service switch that is closed, after its start.
const SERVICE_SWITCH_TIMEOUT: Duration = Duration::from_millis(300);
/// How much longer than the link timeout the `Service` of a client that has left may stand.
pub(crate) const STALE_SERVICE_MARGIN: Duration = Duration::from_millis(500);
/// How long the bridge may take to drop a calibration that it has stored.
const DROP_PENDING_TIMEOUT: Duration = Duration::from_secs(3);
/// NMT: node 1 restarts.
const RESET_NODE: [u8; 2] = [0x81, 1];
/// How long the bridge may take to answer after that: one whose new firmware hangs goes back to the other within 2 s. The
/// rest is for a slow computer.
const BOOT_TIMEOUT: Duration = Duration::from_secs(15);
/// How long it may then go on to answer for what ran before.
const SETTLE_TIMEOUT: Duration = Duration::from_secs(5);
/// How long its heartbeat, of each 100 ms, may stay away before its channel is opened again: the restart may have come
/// behind the opening.
const HEARTBEAT_TIMEOUT: Duration = Duration::from_secs(3);

/// A step of storing a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreStep {
    /// The calibration is sent.
    Sending,
    /// The stored calibration is read back.
    ReadingBack,
}

/// Stores the calibration `blob` of this CRC for the next start and reads it back. `progress` receives the
/// bytes of each step. A calibration that is not stored as it was sent is dropped again.
///
/// # Errors
/// The bridge refuses, the line breaks, or what is stored is not what was sent.
pub fn store_calibration(
    session: &mut Session,
    blob: &[u8],
    crc: u32,
    progress: &mut dyn FnMut(StoreStep, usize),
) -> Result<()> {
    require_service(session)?;
    // For the log of writes; a board of an older version has no such object.
    if let Some(utc_s) = unix_time_s() {
        sdo_object::write(session, UTC_SECONDS, &utc_s.to_le_bytes(), |_| ()).ok();
    }
    sdo_object::write(session, PENDING_CALIBRATION, blob, |sent| progress(StoreStep::Sending, sent))
        .context("the calibration is not loaded")
        .and_then(|()| verify_stored_calibration(session, blob, crc, progress))
        .map_err(|error| discard_failed_load(session, error))
}

/// Whether the bridge has stored what was sent.
fn verify_stored_calibration(
    session: &mut Session,
    blob: &[u8],
    crc: u32,
    progress: &mut dyn FnMut(StoreStep, usize),
) -> Result<()> {
    let back = sdo_object::read(session, PENDING_CALIBRATION, |got, _| {
        progress(StoreStep::ReadingBack, got)
    })?;
    let stored_crc = sdo_object::read_number(session, PENDING_CRC)?;
    if back != blob || stored_crc != crc {
        bail!("what the bridge has stored is not what was sent; load it again");
    }
    Ok(())
}

/// A load has failed: nothing of it is to be used from the next start. Returns the error, with what is left to do
/// where it cannot be dropped.
pub fn discard_failed_load(session: &mut Session, error: Error) -> Error {
    match drop_pending_calibration(session) {
        Ok(_) => error,
        Err(why) => error.context(format!(
            "a calibration may be left for the next start ({why:#}): trueup bridge pending shows it, and with --cancel \
             drops it"
        )),
    }
}

/// Drops the calibration that waits for the next start; its CRC, `None`: none waits.
///
/// # Errors
/// The bridge refuses or cannot, the line breaks, or it is not permitted.
pub fn drop_pending_calibration(session: &mut Session) -> Result<Option<u32>> {
    let pending = sdo_object::read_number(session, PENDING_CRC)?;
    if pending == 0 {
        return Ok(None);
    }
    require_service(session)?;
    sdo_object::write(
        session,
        DROP_PENDING_COMMAND,
        &DROP_CALIBRATION_SIGNATURE.to_le_bytes(),
        |_| (),
    )?;
    let deadline = Instant::now() + DROP_PENDING_TIMEOUT;
    while sdo_object::read_number(session, PENDING_CRC)? != 0 {
        if Instant::now() > deadline {
            bail!("the bridge does not drop it: its store takes nothing more");
        }
    }
    Ok(Some(pending))
}

/// Offers the operator the reference of the board whose place this bridge takes, in nm. A bridge of version 0.2 takes it
/// at once. Returns what holds then.
///
/// # Errors
/// The bridge refuses, as one of an older version does, or one that is larger than its `max_um`; the line breaks; or
/// another one is offered then.
pub fn offer_reference(session: &mut Session, nm: ReferenceNm) -> Result<BridgeReference> {
    require_service(session)?;
    for (at, nm) in sdo_object::REFERENCE_COMPONENTS.into_iter().zip(nm) {
        sdo_object::write(session, at, &nm.to_le_bytes(), |_| ())?;
    }
    sdo_object::write(
        session,
        sdo_object::REFERENCE_COMMAND,
        &RESTORE_REFERENCE_SIGNATURE.to_le_bytes(),
        |_| (),
    )?;
    session.stop_sending_service_frames();
    let now = BridgeReference::read(session)?;
    if now.effective_value() != Some(nm) {
        bail!("the reference that the bridge offers is not the one that was written");
    }
    Ok(now)
}

/// Drops the reference of the bridge, or declines the one that is offered, and what was learned.
///
/// # Errors
/// The bridge refuses, the line breaks, or it is still there.
pub fn forget_reference(session: &mut Session) -> Result<()> {
    require_service(session)?;
    sdo_object::write(
        session,
        sdo_object::REFERENCE_COMMAND,
        &CLEAR_REFERENCE_SIGNATURE.to_le_bytes(),
        |_| (),
    )?;
    session.stop_sending_service_frames();
    if BridgeReference::read(session)?.effective_value().is_some() {
        bail!("the reference is still there");
    }
    Ok(())
}

/// Returns the calibration that the bridge runs on; `None`: it has no valid one. `progress` receives how many bytes
/// have come, and of how many.
///
/// # Errors
/// The line breaks, or the bridge does not give it.
pub fn read_running_calibration(
    session: &mut Session,
    progress: impl FnMut(usize, Option<u32>),
) -> Result<Option<Vec<u8>>> {
    match sdo_object::read_number(session, RUNNING_CRC)? {
        0 => Ok(None),
        crc => {
            let blob = sdo_object::read(session, RUNNING_CALIBRATION, progress)?;
            if calibration_crc(&blob) != crc {
                bail!(
                    "the calibration that the bridge has sent is not the one of its CRC {crc:08x}: try again"
                );
            }
            Ok(Some(blob))
        }
    }
}

/// Returns the same for a bridge that nothing was written to before: its CNC, or else the session, has to allow it.
///
/// # Errors
/// As [`restart`], or it is not permitted.
pub fn restart_with_permission(session: &mut Session, requested: u32) -> Result<u32> {
    require_service(session)?;
    restart(session, requested)
}

/// Lets the bridge restart; the CRC of the calibration that it then runs on, which should be `requested`. A
/// bridge that is slow to learn of its restart still answers for the old one, so one answer is not believed.
///
/// # Errors
/// The bridge does not come back.
pub fn restart(session: &mut Session, requested: u32) -> Result<u32> {
    restart_and_poll_until(
        session,
        |client| sdo_object::read_number(client, RUNNING_CRC),
        |running| *running == requested,
    )
}

/// Lets the bridge restart, and asks it until the answer is the expected one, or until another one has lasted for
/// [`SETTLE_TIMEOUT`]. Returns the last answer.
///
/// # Errors
/// As [`restart`].
pub(crate) fn restart_and_poll_until<T>(
    session: &mut Session,
    mut ask: impl FnMut(&mut Session) -> Result<T>,
    is_expected: impl Fn(&T) -> bool,
) -> Result<T> {
    session.send(&Frame::new(NMT_ID, &RESET_NODE).context("a frame of two bytes")?)?;
    // A CNC that comes back is to be the only master.
    session.stop_sending_service_frames();
    let deadline = Instant::now() + BOOT_TIMEOUT;
    let mut settles = None;
    loop {
        let answer = wait_for_boot(session).and_then(|()| ask(session));
        let now = Instant::now();
        match answer {
            Ok(answer) if is_expected(&answer) => return Ok(answer),
            Ok(answer) if now > *settles.get_or_insert(now + SETTLE_TIMEOUT) => return Ok(answer),
            Err(error) if now > deadline => return Err(error),
            _ => {}
        }
    }
}

/// Whatever changes a bridge needs `Service`. Where there is a CNC only its own counts: the operator
/// is asked for it. Where there is none, or no longer, the session says it.
///
/// `Service` of a tool that has just left still stands for the link timeout. It is a CNC's only if frames of a CNC
/// come.
pub(crate) fn require_service(session: &mut Session) -> Result<()> {
    let begin = Instant::now();
    let [none, given, open] =
        [WriteAuthority::NoMaster, WriteAuthority::Service, WriteAuthority::SwitchOpen]
            .map(|authority| authority as u32);
    // Its own, which an earlier step has begun.
    let mut sends = session.is_sending_service_frames();
    let accepted = sdo_object::read_number(session, ACCEPTED_FRAMES)?;
    let mut remnant_ends = None;
    loop {
        let authority = sdo_object::read_number(session, WRITE_AUTHORITY)?;
        if authority == open && begin.elapsed() > SERVICE_SWITCH_TIMEOUT {
            bail!(
                "close the service switch at the board (PB7 to ground): its calibration allows no write without \
                 it; then try again"
            );
        }
        if authority == given {
            if sends || sdo_object::read_number(session, ACCEPTED_FRAMES)? != accepted {
                return Ok(());
            }
            // A PLC's blocks are not among these frames: what lasts is no remnant.
            let ends = match remnant_ends {
                Some(ends) => ends,
                None => begin + read_link_timeout(session)? + STALE_SERVICE_MARGIN,
            };
            if Instant::now() > ends {
                return Ok(());
            }
            remnant_ends = Some(ends);
            continue;
        }
        if authority == none && !sends {
            sends = true;
            session.start_sending_service_frames();
        }
        let remnant = remnant_ends.map_or(Duration::ZERO, |ends| ends - begin);
        if begin.elapsed() > SERVICE_TIMEOUT + remnant {
            bail!(
                "the CNC on this bridge's line does not allow it: set Service there (LinuxCNC: the pin \
                 trueup.0.service) with Engage off, and try again"
            );
        }
    }
}

/// Returns the link timeout of the running calibration.
pub(crate) fn read_link_timeout(session: &mut Session) -> Result<Duration> {
    let blob = read_running_calibration(session, |_, _| ())?.unwrap_or_default();
    // Without one that can be read: the largest.
    let ms =
        decode(&blob).map_or(MAX_LINK_TIMEOUT_MS, |calibration| calibration.limits.link_timeout_ms);
    Ok(Duration::from_millis(ms.into()))
}

/// Waits until the bridge is up, for a few seconds: an SLCAN channel has to be opened again.
fn wait_for_boot(session: &mut Session) -> Result<()> {
    // A board that stores or supervises takes up to 10 ms to learn of it.
    let restarts = Instant::now() + Duration::from_millis(50);
    while session.next_event(restarts)?.is_some() {}
    session.reopen_channel().context("the bridge does not come back after its restart")?;
    let deadline = Instant::now() + HEARTBEAT_TIMEOUT;
    while let Some(event) = session.next_event(deadline)? {
        let AdapterMessage::Frame(frame) = event else { continue };
        if frames::decode_heartbeat(&frame).is_ok_and(|state| state != NmtState::BootUp) {
            return Ok(());
        }
    }
    bail!("the bridge sends no heartbeat after its restart")
}
