//! The decision which slot starts, and why.
//!
//! ```text
//!   reset ─► settle the state ─► judge the last trial ─► both headers ─► in this order, the first that holds:
//!            1. eligible images (neither incomplete nor failed), the newest first
//!            2. the others, the newest first: a board never stays silent while a signed image is there
//! ```
//!
//! An image that is not confirmed starts on trial if there is another one to go back to. Its start is committed
//! before it runs. Without another one nothing is counted: it would start in any case.

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};

use crate::{
    inspect::{Defect, Image, Key, check_image, read_header},
    journal::Journal,
    layout::Slot,
    record::{MAX_STARTS, State, Status},
};

/// How the last start ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The power was off, had dipped, or the reset pin was pulled; or nothing is known of it.
    PowerCycle,
    /// The watchdog or the image itself has reset the board.
    Reset,
}

/// Speed of the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Full: every signature is verified.
    Full,
    /// The PLL is dead: for an image whose signature held when it was written, the CRC is enough.
    Slow,
}

/// Why a slot starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// It is the newest, and confirmed.
    Newest,
    /// It is on trial: which start of [`MAX_STARTS`] this is.
    Trial(u8),
    /// It is not confirmed, but there is none to go back to.
    Alone,
    /// The newest one does not hold, or failed its trial, or is incomplete.
    WentBack,
    /// It failed its trial or is incomplete, and no other one holds.
    LastResort,
}

/// The image that starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// The image; its slot is in its header.
    pub image: Image,
    /// Why it starts.
    pub reason: Reason,
    /// Status of the image in the other slot; `None`: it has no valid header.
    pub other: Option<Status>,
}

/// A slot that may start.
#[derive(Clone, Copy)]
struct Candidate {
    image: Image,
    status: Status,
}

/// Chooses the image that starts, and commits what its start changes; `None`: no slot holds one. `between` is
/// called after each part of 256 bytes that is checked.
///
/// A flash of the records that takes nothing any more keeps no board from starting: what was believed before is then
/// decided by, and a trial, which could not be counted, is not begun if there is another image.
pub fn choose<R: NorFlash, S: ReadNorFlash, K: Key>(
    journal: &mut Journal<R>,
    slots: &mut S,
    key: &K,
    ending: Ending,
    clock: Clock,
    mut between: impl FnMut(),
) -> Option<Start> {
    journal.settle().ok();
    let headers = Slot::BOTH.map(|slot| read_header(slots, slot, journal.state().floor));
    let state = judge(journal.state(), &headers, ending);
    journal.commit(state).ok();
    let candidates = ordered(&state, &headers);
    let mut holds = |it: &Candidate, is_trusted: bool| {
        let key = if is_trusted && it.status.is_verified() { None } else { Some(key) };
        check_image(slots, &it.image, key, &mut between).is_ok()
    };
    let is_slow = clock == Clock::Slow;
    let all = || candidates.iter().flatten();
    // On a slow clock first those whose signature is known to hold; a slow start is better than none.
    let known = |it: &&Candidate| it.status.is_eligible() && (!is_slow || it.status.is_verified());
    let chosen = all().filter(known).find(|it| holds(it, is_slow));
    let chosen = chosen.or_else(|| all().find(|it| holds(it, is_slow)))?;
    let other = all().find(|it| it.image != chosen.image);
    let is_newest = other.is_none_or(|it| it.image.header.version <= chosen.image.header.version);
    let start = |it: &Candidate, reason| {
        let other = all().find(|other| other.image != it.image).map(|other| other.status);
        Some(Start { image: it.image, reason, other })
    };
    let starts = match chosen.status {
        Status::New | Status::Verified => 1,
        Status::Trial(starts) | Status::Announced(starts) => starts.saturating_add(1),
        Status::Confirmed if is_newest => return start(chosen, Reason::Newest),
        Status::Confirmed => return start(chosen, Reason::WentBack),
        Status::Loading | Status::Rejected => return start(chosen, Reason::LastResort),
    };
    // The other one is only to be there: its signature is verified when it starts.
    let Some(back) = other.filter(|it| it.status.is_eligible() && holds(it, true)) else {
        return start(chosen, Reason::Alone);
    };
    let image = &chosen.image;
    let on_trial = state.with(image.header.slot, image.tag, Status::Trial(starts));
    if journal.commit(on_trial).is_err() && back.status == Status::Confirmed {
        return start(back, Reason::WentBack);
    }
    start(chosen, Reason::Trial(starts))
}

/// Returns the state after the trial, if there was one, is judged by how it ended.
fn judge(state: State, headers: &[Result<Image, Defect>; 2], ending: Ending) -> State {
    let mut judged = state;
    for slot in Slot::BOTH {
        let Ok(image) = slot.of(headers) else { continue };
        let has_failed = match state.status(slot, image.tag) {
            Status::Trial(starts) => ending == Ending::Reset || starts >= MAX_STARTS,
            Status::Announced(starts) => starts >= MAX_STARTS,
            _ => false,
        };
        if has_failed {
            judged = judged.with(slot, image.tag, Status::Rejected);
        }
    }
    judged
}

/// Returns the candidates in the order in which they are tried: eligible before others, then the newest; of
/// one version the confirmed.
fn ordered(state: &State, headers: &[Result<Image, Defect>; 2]) -> [Option<Candidate>; 2] {
    let [a, b] = Slot::BOTH.map(|slot| {
        let image = (*slot.of(headers)).ok()?;
        Some(Candidate { image, status: state.status(slot, image.tag) })
    });
    let rank = |it: Option<Candidate>| {
        it.map(|Candidate { image, status }| {
            (status.is_eligible(), image.header.version, status == Status::Confirmed)
        })
    };
    if rank(b) > rank(a) { [b, a] } else { [a, b] }
}

#[cfg(test)]
mod key_change;
#[cfg(test)]
mod tests;
