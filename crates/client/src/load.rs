//! A calibration to the board: sent, read back, and put to use.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, Result, bail};
use trueup_canopen::dictionary::{Authority, BACK};
use trueup_link::{
    frame::Frame,
    frames::{self, State},
    layout::NMT_ID,
    slcan::Event,
};

use crate::{
    object::{self, AUTHORITY, NEW, NEW_CRC, RUNNING, RUNNING_CRC, UTC},
    session::Session,
};

/// How long the bridge may take to hear that it may be written to.
const LEAVE_TIMEOUT: Duration = Duration::from_secs(2);
/// NMT: node 1 restarts.
const RESET_NODE: [u8; 2] = [0x81, 1];
/// How long the bridge may take to send its first heartbeat after that.
const BOOT_TIMEOUT: Duration = Duration::from_secs(5);

/// What is being done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The calibration is sent.
    Sending,
    /// What the bridge has stored is read back.
    ReadingBack,
}

/// Stores the calibration `blob` of this CRC for the next start and reads it back. `progress` hears the
/// bytes of each step.
///
/// # Errors
/// The bridge refuses, the line breaks, or what is stored is not what was sent.
pub fn store(
    session: &mut Session,
    blob: &[u8],
    crc: u32,
    progress: &mut dyn FnMut(Step, usize),
) -> Result<()> {
    ask_leave(session)?;
    // For the log of writes; a board of an older version has no such object.
    if let Ok(since) = SystemTime::now().duration_since(UNIX_EPOCH)
        && let Ok(utc_s) = u32::try_from(since.as_secs())
    {
        object::write(session, UTC, &utc_s.to_le_bytes(), |_| ()).ok();
    }
    object::write(session, NEW, blob, |sent| progress(Step::Sending, sent))
        .context("the calibration is not loaded")?;
    let back = object::read(session, NEW, |got, _| progress(Step::ReadingBack, got))?;
    let stored_crc = object::number(session, NEW_CRC)?;
    if back != blob || stored_crc != crc {
        bail!("what the bridge has stored is not what was sent; load it again");
    }
    Ok(())
}

/// Gives the bridge the reference of the board whose place it takes, in nm: the elongation, X, Y, Z.
///
/// # Errors
/// The bridge refuses, as one of an older version does; the line breaks; or another one is in force then.
pub fn put_reference(session: &mut Session, nm: [i32; 4]) -> Result<()> {
    ask_leave(session)?;
    for (at, nm) in object::REFERENCE.into_iter().zip(nm) {
        object::write(session, at, &nm.to_le_bytes(), |_| ())?;
    }
    object::write(session, object::KEY, &BACK.to_le_bytes(), |_| ())?;
    session.end_service();
    let mut in_force = [0; 4];
    for (at, nm) in object::REFERENCE.into_iter().zip(&mut in_force) {
        *nm = object::number(session, at)?.cast_signed();
    }
    if in_force != nm {
        bail!("the reference in force is not what was written");
    }
    Ok(())
}

/// The calibration that the bridge runs on; `None`: it has no valid one. `progress` hears how many bytes
/// have come, and of how many.
///
/// # Errors
/// The line breaks, or the bridge does not give it.
pub fn running(
    session: &mut Session,
    progress: impl FnMut(usize, Option<u32>),
) -> Result<Option<Vec<u8>>> {
    match object::number(session, RUNNING_CRC)? {
        0 => Ok(None),
        _ => object::read(session, RUNNING, progress).map(Some),
    }
}

/// Lets the bridge restart; the CRC of the calibration that it then runs on, which should be `wanted`. A
/// bridge that is slow to hear of its restart still answers for the old one, so one answer is not believed.
///
/// # Errors
/// The bridge does not come back.
pub fn restart(session: &mut Session, wanted: u32) -> Result<u32> {
    session.send(&Frame::new(NMT_ID, &RESET_NODE).context("a frame of two bytes")?)?;
    // A CNC that comes back is to be the only master.
    session.end_service();
    let deadline = Instant::now() + BOOT_TIMEOUT;
    loop {
        let told =
            wait_for_boot(session, deadline).and_then(|()| object::number(session, RUNNING_CRC));
        match told {
            Ok(running) if running == wanted || Instant::now() > deadline => return Ok(running),
            Err(error) if Instant::now() > deadline => return Err(error),
            _ => {}
        }
    }
}

/// Whatever changes a bridge needs `Service`. Where there is a CNC only its own counts: the operator
/// is asked for it. Where there is none, or no longer, the session says it.
fn ask_leave(session: &mut Session) -> Result<()> {
    let deadline = Instant::now() + LEAVE_TIMEOUT;
    let (none, given) = (Authority::NoMaster as u32, Authority::Service as u32);
    let mut asks = false;
    loop {
        match object::number(session, AUTHORITY)? {
            authority if authority == given => return Ok(()),
            authority if authority == none && !asks => {
                asks = true;
                session.allow_service();
            }
            _ if Instant::now() > deadline => bail!(
                "the CNC on this bridge's line does not allow it: set Service there (LinuxCNC: the pin \
                 trueup.0.service) with Engage off, and load again"
            ),
            _ => {}
        }
    }
}

/// Until the bridge is up again: an SLCAN channel has to be opened again.
fn wait_for_boot(session: &mut Session, deadline: Instant) -> Result<()> {
    // A board that stores or supervises takes up to 10 ms to hear of it.
    let restarts = Instant::now() + Duration::from_millis(50);
    while session.next_event(restarts)?.is_some() {}
    session.reopen().context("the bridge does not come back after its restart")?;
    while let Some(event) = session.next_event(deadline.max(restarts))? {
        let Event::Frame(frame) = event else { continue };
        if frames::decode_heartbeat(&frame).is_ok_and(|state| state != State::BootUp) {
            return Ok(());
        }
    }
    bail!("the bridge sends no heartbeat after its restart")
}
