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
    boot_state::{BootState, ImageStatus, MAX_TRIAL_STARTS},
    flash_layout::Slot,
    image_check::{Image, ImageDefect, VerifyingKey, check_image, read_header},
    journal::Journal,
};

/// How the last start ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartOutcome {
    /// The power was off, had dipped, or the reset pin was pulled; or nothing is known of it.
    PowerCycle,
    /// The watchdog or the image itself has reset the board.
    Reset,
}

/// Speed of the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockSpeed {
    /// Full: every signature is verified.
    Full,
    /// The PLL is dead: for an image whose signature held when it was written, the CRC is enough.
    Slow,
}

/// Why a slot starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartReason {
    /// It is the newest, and confirmed.
    Newest,
    /// It is on trial: which start of [`MAX_TRIAL_STARTS`] this is.
    Trial(u8),
    /// It is not confirmed, but there is none to go back to.
    OnlyImage,
    /// The newest one does not hold, or failed its trial, or is incomplete.
    RolledBack,
    /// It failed its trial or is incomplete, and no other one holds.
    LastResort,
}

/// The image that starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StartSelection {
    /// The image; its slot is in its header.
    pub image: Image,
    /// Why it starts.
    pub reason: StartReason,
    /// Status of the image in the other slot; `None`: it has no valid header.
    pub other: Option<ImageStatus>,
}

/// A slot that may start.
#[derive(Clone, Copy)]
struct SlotCandidate {
    image: Image,
    status: ImageStatus,
}

/// Chooses the image that starts, and commits what its start changes; `None`: no slot holds one. `between` is
/// called after each part of 256 bytes that is checked.
///
/// A flash of the records that takes nothing any more keeps no board from starting: what was believed before is then
/// decided by, and a trial, which could not be counted, is not begun if there is another image.
pub fn select_image<R: NorFlash, S: ReadNorFlash, K: VerifyingKey>(
    journal: &mut Journal<R>,
    slots: &mut S,
    key: &K,
    ending: StartOutcome,
    clock: ClockSpeed,
    mut between: impl FnMut(),
) -> Option<StartSelection> {
    journal.settle().ok();
    let headers = Slot::ALL.map(|slot| read_header(slots, slot, journal.state().floor));
    let state = evaluate_trial(journal.state(), &headers, ending);
    journal.commit(state).ok();
    let candidates = order_candidates(&state, &headers);
    let mut holds = |candidate: &SlotCandidate, is_trusted: bool| {
        let key = if is_trusted && candidate.status.is_verified() { None } else { Some(key) };
        check_image(slots, &candidate.image, key, &mut between).is_ok()
    };
    let is_slow = clock == ClockSpeed::Slow;
    let all = || candidates.iter().flatten();
    // On a slow clock first those whose signature is known to hold; a slow start is better than none.
    let known = |candidate: &&SlotCandidate| {
        candidate.status.is_preferred() && (!is_slow || candidate.status.is_verified())
    };
    let chosen = all().filter(known).find(|candidate| holds(candidate, is_slow));
    let chosen = chosen.or_else(|| all().find(|candidate| holds(candidate, is_slow)))?;
    let other = all().find(|candidate| candidate.image != chosen.image);
    let is_newest =
        other.is_none_or(|other| other.image.header.version <= chosen.image.header.version);
    let start = |candidate: &SlotCandidate, reason| {
        let other = all().find(|other| other.image != candidate.image).map(|other| other.status);
        Some(StartSelection { image: candidate.image, reason, other })
    };
    let starts = match chosen.status {
        ImageStatus::New | ImageStatus::Verified => 1,
        ImageStatus::Trial(starts) | ImageStatus::Announced(starts) => starts.saturating_add(1),
        ImageStatus::Confirmed if is_newest => return start(chosen, StartReason::Newest),
        ImageStatus::Confirmed => return start(chosen, StartReason::RolledBack),
        ImageStatus::Loading | ImageStatus::Rejected => {
            return start(chosen, StartReason::LastResort);
        }
    };
    // The other one is only to be there: its signature is verified when it starts.
    let Some(back) =
        other.filter(|candidate| candidate.status.is_preferred() && holds(candidate, true))
    else {
        return start(chosen, StartReason::OnlyImage);
    };
    let image = &chosen.image;
    let on_trial = state.with_status(image.header.slot, image.tag, ImageStatus::Trial(starts));
    if journal.commit(on_trial).is_err() && back.status == ImageStatus::Confirmed {
        return start(back, StartReason::RolledBack);
    }
    start(chosen, StartReason::Trial(starts))
}

/// Returns the state after the trial, if there was one, is judged by how it ended.
fn evaluate_trial(
    state: BootState,
    headers: &[Result<Image, ImageDefect>; 2],
    ending: StartOutcome,
) -> BootState {
    let mut judged = state;
    for slot in Slot::ALL {
        let Ok(image) = slot.element_of(headers) else { continue };
        let has_failed = match state.status(slot, image.tag) {
            ImageStatus::Trial(starts) => {
                ending == StartOutcome::Reset || starts >= MAX_TRIAL_STARTS
            }
            ImageStatus::Announced(starts) => starts >= MAX_TRIAL_STARTS,
            _ => false,
        };
        if has_failed {
            judged = judged.with_status(slot, image.tag, ImageStatus::Rejected);
        }
    }
    judged
}

/// Returns the candidates in the order in which they are tried: eligible before others, then the newest; of
/// one version the confirmed.
fn order_candidates(
    state: &BootState,
    headers: &[Result<Image, ImageDefect>; 2],
) -> [Option<SlotCandidate>; 2] {
    let [a, b] = Slot::ALL.map(|slot| {
        let image = (*slot.element_of(headers)).ok()?;
        Some(SlotCandidate { image, status: state.status(slot, image.tag) })
    });
    let rank = |candidate: Option<SlotCandidate>| {
        candidate.map(|SlotCandidate { image, status }| {
            (status.is_preferred(), image.header.version, status == ImageStatus::Confirmed)
        })
    };
    if rank(b) > rank(a) { [b, a] } else { [a, b] }
}

#[cfg(test)]
mod key_change;
#[cfg(test)]
mod tests;
