//! Takes the offsets of a bridge back to 0, by `Control` with `Engage` 0, as a CNC does.
//!
//! Only where no CNC commands the bridge. Where one does, the offsets are its own: it may be cutting, a second sender on its
//! line would cast doubt on both, and one on another line is not believed. Then nothing is sent, and the answer says
//! where to disengage. A CNC that has disengaged takes its offset back by itself: that is waited for.

use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use trueup_canopen::dictionary::WriteAuthority;
use trueup_core::cnc::{Control, OffsetQuality};

use crate::{
    calibration_load::{STALE_SERVICE_MARGIN, read_link_timeout},
    sdo_object::{self, ACCEPTED_FRAMES, NOT_AVAILABLE, OFFSETS, QUALITY, WRITE_AUTHORITY},
    session::Session,
};

/// From one look at the offsets to the next.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// After this time without an offset coming nearer to 0 it counts as standing still: the slowest slew limit is one of
/// some µm in a minute, and a bridge answers in 10 nm.
const STANDSTILL_TIMEOUT: Duration = Duration::from_secs(10);

/// The outcome of taking the offsets back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DisengageOutcome {
    /// Nothing was followed; nothing was sent.
    AtRest(OffsetQuality),
    /// They were these, in nm, and are 0, or not available any more.
    Done {
        /// X, Y and Z when it began.
        from_nm: [Option<i32>; 3],
        /// How long it took.
        took: Duration,
    },
    /// A CNC commands the bridge; nothing was sent.
    CncCommands([Option<i32>; 3]),
    /// They do not come nearer to 0: the bridge follows another sender.
    Stalled([Option<i32>; 3]),
}

/// Takes the offsets back, at the slew limit of the calibration. `progress` receives X, Y and Z in nm.
///
/// # Errors
/// The line breaks, or the bridge does not answer.
pub fn disengage(
    session: &mut Session,
    progress: &mut dyn FnMut([Option<i32>; 3]),
) -> Result<DisengageOutcome> {
    let found = read_quality(session)?;
    if is_offset_inactive(found) {
        return Ok(DisengageOutcome::AtRest(found));
    }
    let from_nm = read_offsets_nm(session)?;
    // One that has disengaged takes its offset back already.
    let is_cnc_commanding = is_cnc_commanding(session)?;
    if !is_cnc_commanding {
        session.start_sending_control_frames(Control::default());
    }
    let start = Instant::now();
    let size = |all: [Option<i32>; 3]| all.into_iter().flatten().map(i32::unsigned_abs).max();
    let (mut smallest, mut fell) = (size(from_nm), start);
    let outcome = loop {
        let now_nm = read_offsets_nm(session)?;
        let quality = read_quality(session)?;
        if is_cnc_commanding && !is_offset_inactive(quality) && quality != OffsetQuality::RampingOut
        {
            break DisengageOutcome::CncCommands(now_nm);
        }
        if is_offset_inactive(quality) {
            break DisengageOutcome::Done { from_nm, took: start.elapsed() };
        }
        progress(now_nm);
        if size(now_nm) < smallest {
            (smallest, fell) = (size(now_nm), Instant::now());
        }
        if fell.elapsed() > STANDSTILL_TIMEOUT {
            break DisengageOutcome::Stalled(now_nm);
        }
        let look = Instant::now() + POLL_INTERVAL;
        while session.next_event(look)?.is_some() {}
    };
    session.stop_sending_service_frames();
    Ok(outcome)
}

/// Returns whether a CNC commands the bridge. One that has just left counts until its link timeout is over.
fn is_cnc_commanding(session: &mut Session) -> Result<bool> {
    let accepted = sdo_object::read_number(session, ACCEPTED_FRAMES)?;
    let ends = Instant::now() + read_link_timeout(session)? + STALE_SERVICE_MARGIN;
    loop {
        if sdo_object::read_number(session, ACCEPTED_FRAMES)? != accepted {
            return Ok(true);
        }
        let authority = sdo_object::read_number(session, WRITE_AUTHORITY)?;
        if authority == WriteAuthority::NoMaster as u32 {
            return Ok(false);
        }
        // The service switch hides who commands; a CNC's frames would have been counted by now.
        if Instant::now() > ends {
            return Ok(authority != WriteAuthority::SwitchOpen as u32);
        }
    }
}

fn read_quality(session: &mut Session) -> Result<OffsetQuality> {
    let number = sdo_object::read_number(session, QUALITY)?;
    let quality = u8::try_from(number).ok().and_then(OffsetQuality::from_wire);
    quality.context("the bridge sends an unknown quality")
}

const fn is_offset_inactive(quality: OffsetQuality) -> bool {
    matches!(quality, OffsetQuality::Off | OffsetQuality::Fault)
}

/// X, Y and Z in nm; `None`: not available.
fn read_offsets_nm(session: &mut Session) -> Result<[Option<i32>; 3]> {
    let mut all = [None; 3];
    for (place, at) in all.iter_mut().zip(OFFSETS) {
        let nm = sdo_object::read_number(session, at)?.cast_signed();
        *place = (nm != NOT_AVAILABLE).then_some(nm);
    }
    Ok(all)
}
