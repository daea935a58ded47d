//! Takes the offsets of a bridge back to 0, by `Control` with `Engage` 0, as a CNC does.
//!
//! Only where no CNC commands the bridge. Where one does, the offsets are its own: it may be cutting, a second sender on its
//! line would cast doubt on both, and one on another line is not believed. Then nothing is sent, and the answer says
//! where to disengage. A CNC that has disengaged takes its offset back by itself: that is waited for.

use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use trueup_canopen::dictionary::Authority;
use trueup_core::cnc::{Control, Quality};

use crate::{
    load::{REMNANT_MARGIN, link_timeout},
    object::{self, ACCEPTED, AUTHORITY, NOT_AVAILABLE, OFFSET, QUALITY},
    session::Session,
};

/// From one look at the offsets to the next.
const LOOK: Duration = Duration::from_millis(100);
/// For so long no offset need come nearer to 0 before it counts as standing still: the slowest slew limit is one of
/// some µm in a minute, and a bridge answers in 10 nm.
const STANDS_STILL: Duration = Duration::from_secs(10);

/// The outcome of taking the offsets back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disengaged {
    /// Nothing was followed; nothing was sent.
    AtRest(Quality),
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
    Stands([Option<i32>; 3]),
}

/// Takes the offsets back, at the slew limit of the calibration. `progress` receives X, Y and Z in nm.
///
/// # Errors
/// The line breaks, or the bridge does not answer.
pub fn disengage(
    session: &mut Session,
    progress: &mut dyn FnMut([Option<i32>; 3]),
) -> Result<Disengaged> {
    let found = quality(session)?;
    if is_at_rest(found) {
        return Ok(Disengaged::AtRest(found));
    }
    let from_nm = offsets(session)?;
    // One that has disengaged takes its offset back already.
    let is_commanded = is_commanded(session)?;
    if !is_commanded {
        session.transmit(Control::default());
    }
    let start = Instant::now();
    let size = |all: [Option<i32>; 3]| all.into_iter().flatten().map(i32::unsigned_abs).max();
    let (mut smallest, mut fell) = (size(from_nm), start);
    let outcome = loop {
        let now_nm = offsets(session)?;
        let quality = quality(session)?;
        if is_commanded && !is_at_rest(quality) && quality != Quality::RampingOut {
            break Disengaged::CncCommands(now_nm);
        }
        if is_at_rest(quality) {
            break Disengaged::Done { from_nm, took: start.elapsed() };
        }
        progress(now_nm);
        if size(now_nm) < smallest {
            (smallest, fell) = (size(now_nm), Instant::now());
        }
        if fell.elapsed() > STANDS_STILL {
            break Disengaged::Stands(now_nm);
        }
        let look = Instant::now() + LOOK;
        while session.next_event(look)?.is_some() {}
    };
    session.end_service();
    Ok(outcome)
}

/// Returns whether a CNC commands the bridge. One that has just left counts until its link timeout is over.
fn is_commanded(session: &mut Session) -> Result<bool> {
    let accepted = object::number(session, ACCEPTED)?;
    let ends = Instant::now() + link_timeout(session)? + REMNANT_MARGIN;
    loop {
        if object::number(session, ACCEPTED)? != accepted {
            return Ok(true);
        }
        let authority = object::number(session, AUTHORITY)?;
        if authority == Authority::NoMaster as u32 {
            return Ok(false);
        }
        // The service switch hides who commands; a CNC's frames would have been counted by now.
        if Instant::now() > ends {
            return Ok(authority != Authority::SwitchOpen as u32);
        }
    }
}

fn quality(session: &mut Session) -> Result<Quality> {
    let number = object::number(session, QUALITY)?;
    let quality = u8::try_from(number).ok().and_then(Quality::from_wire);
    quality.context("the bridge sends an unknown quality")
}

const fn is_at_rest(quality: Quality) -> bool {
    matches!(quality, Quality::Off | Quality::Fault)
}

/// X, Y and Z in nm; `None`: not available.
fn offsets(session: &mut Session) -> Result<[Option<i32>; 3]> {
    let mut all = [None; 3];
    for (place, at) in all.iter_mut().zip(OFFSET) {
        let nm = object::number(session, at)?.cast_signed();
        *place = (nm != NOT_AVAILABLE).then_some(nm);
    }
    Ok(all)
}
