//! The firmware slots of a board: versions, status, and why the last start chose the one that runs.

use std::fmt;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use trueup_boot::{
    boot_state::{ImageStatus, MAX_TRIAL_STARTS},
    flash_layout::Slot,
    handover::StartInfo,
    image_header::FirmwareVersion,
    start::StartReason,
};
use trueup_canopen::sdo::{AbortCode, client::SdoClientError};

use crate::{
    firmware_file::{FirmwareFile, SlotFirmware},
    sdo_object::{
        self, MIN_FIRMWARE_VERSION, RUNNING_SLOT, SLOT_CHOICE, SLOT_STATUSES, SLOT_VERSIONS,
    },
    session::Session,
};

/// The content of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlotInfo {
    /// `None`: no valid header is there.
    pub version: Option<FirmwareVersion>,
    /// `None`: a status of a later version of the board.
    pub status: Option<ImageStatus>,
}

/// Both slots of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirmwareSlots {
    /// The one that runs.
    pub running: Slot,
    /// A, B.
    pub slots: [SlotInfo; 2],
    /// The oldest version that may start.
    pub floor: FirmwareVersion,
    /// The reason that the boot program has handed over; `None`: it has not, because it is older than that.
    pub reported: Option<StartInfo>,
}

/// Why the last start chose the slot that runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotChoiceReason {
    /// It is confirmed, and there is no other one.
    Only,
    /// It is confirmed, and no older than the other one.
    Newest,
    /// It is on trial: which start of [`MAX_TRIAL_STARTS`] this is.
    Trial(u8),
    /// It was on trial, in this start of [`MAX_TRIAL_STARTS`], and has been confirmed since.
    TrialPassed(u8),
    /// It is not confirmed, but there is none to go back to.
    Alone,
    /// It had none to go back to, and has been confirmed since.
    AloneConfirmed,
    /// It is confirmed; the newer one has come since, and waits for the next start.
    NewerWaits,
    /// It is confirmed; the newer one failed its trial.
    NewerRejected,
    /// It is confirmed; the newer one has not come whole.
    NewerIncomplete,
    /// It is confirmed; the newer one was passed over.
    NewerPassedOver,
    /// It failed its trial or is incomplete, but the other one does not hold.
    LastResort,
    /// The board reports a status that this tool does not know.
    Unknown,
}

/// Why a board must not get a file, found before anything is erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnsuitableFirmwareError {
    /// The file has no part for the slot that is to be written.
    #[error(
        "the board runs from slot {}, so slot {} is to be written, and the file has no part for it. Take the file with both \
         parts",
        .running.name(),
        .running.other().name()
    )]
    NoPart {
        /// The slot that runs, and stays.
        running: Slot,
    },
    /// It would never start.
    #[error(
        "the file has version {file}, which is not newer than {running}, which runs: it would never start. Take a newer \
         file; the probe or the ROM loader writes any version"
    )]
    NotNewer {
        /// The version of the file.
        file: FirmwareVersion,
        /// The version that runs.
        running: FirmwareVersion,
    },
    /// It must not start.
    #[error(
        "the file has version {file}, which is older than {floor}, the oldest that may start. Take a newer file"
    )]
    BelowFloor {
        /// The version of the file.
        file: FirmwareVersion,
        /// The oldest version that may start.
        floor: FirmwareVersion,
    },
    /// The firmware that runs is on trial, and the other slot holds the one to go back to.
    #[error(
        "the firmware that runs is on trial, and the other slot holds the one to go back to. Engage, let it give offsets for \
         a minute, then update"
    )]
    OnTrial,
}

impl SlotInfo {
    /// Returns the status in one word, as JSON has it.
    #[must_use]
    pub(crate) const fn status_name(&self) -> &'static str {
        match self.status {
            None => "unknown",
            Some(ImageStatus::Loading) => "loading",
            Some(_) if self.version.is_none() => "empty",
            Some(ImageStatus::New) => "new",
            Some(ImageStatus::Verified) => "verified",
            Some(ImageStatus::Trial(_) | ImageStatus::Announced(_)) => "trial",
            Some(ImageStatus::Confirmed) => "confirmed",
            Some(ImageStatus::Rejected) => "rejected",
        }
    }

    /// Returns how often it has started on trial; `None`: it is not on trial.
    #[must_use]
    pub(crate) const fn trial_start_count(&self) -> Option<u8> {
        match self.status {
            Some(ImageStatus::Trial(starts) | ImageStatus::Announced(starts)) => Some(starts),
            _ => None,
        }
    }

    /// Returns whether it starts before one that is incomplete or has failed.
    fn is_eligible(&self) -> bool {
        self.version.is_some() && self.status.is_some_and(ImageStatus::is_preferred)
    }

    fn to_json(self) -> Value {
        json!({
            "version": self.version.map(|version| version.to_string()),
            "status": self.status_name(),
            "starts": self.trial_start_count(),
        })
    }
}

impl fmt::Display for SlotInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(version) = self.version {
            write!(f, "{version}, ")?;
        }
        match (self.trial_start_count(), self.status_name()) {
            (Some(starts), _) => write!(f, "on trial, start {starts} of {MAX_TRIAL_STARTS}"),
            (None, word) => f.write_str(match word {
                "loading" => "loading: it has not come whole",
                "new" => "new: a probe or the ROM loader has written it",
                "verified" => "verified: it waits for the next start",
                "rejected" => "rejected: it failed its trial",
                "unknown" => "in a status that this tool does not know: update the tool",
                word => word,
            }),
        }
    }
}

impl fmt::Display for SlotChoiceReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = match self {
            Self::Only => "it is confirmed, and the only one",
            Self::Newest => "it is confirmed, and the newest",
            Self::Trial(starts) => {
                return write!(
                    f,
                    "it is the newest, and on trial: start {starts} of {MAX_TRIAL_STARTS}. Engage and let it give offsets for a \
                     minute; until then a crash or a hang goes back to the other one"
                );
            }
            Self::TrialPassed(starts) => {
                return write!(
                    f,
                    "it is the newest, and was on trial: start {starts} of {MAX_TRIAL_STARTS}; it has been confirmed since"
                );
            }
            Self::AloneConfirmed => "there was none to go back to; it has been confirmed since",
            Self::Alone => "it is not confirmed, and there is none to go back to",
            Self::NewerWaits => "it is confirmed; the newer one waits for the next start",
            Self::NewerRejected => "it is confirmed; the newer one failed its trial",
            Self::NewerIncomplete => "it is confirmed; the newer one has not come whole",
            Self::NewerPassedOver => {
                "it is confirmed; the newer one was skipped. Its CRC or signature is wrong, its start could not be recorded, or the PLL is dead and its signature was never verified"
            }
            Self::LastResort => {
                "it failed its trial or has not come whole, but no other one may start: update it"
            }
            Self::Unknown => "the slots are in a status that this tool does not know: update it",
        };
        f.write_str(words)
    }
}

impl FirmwareSlots {
    /// Reads the slots of a board; `None`: it has none.
    ///
    /// # Errors
    /// The line breaks, or the board reports a slot that is neither.
    pub fn read(session: &mut Session) -> Result<Option<Self>> {
        let running = match sdo_object::read_number(session, RUNNING_SLOT) {
            Err(error) if is_slot_access_unsupported(&error) => return Ok(None),
            running => running?,
        };
        let running = Slot::ALL.into_iter().find(|slot| u32::from(slot.number()) == running);
        let running = running.context("the bridge runs from a slot that is neither A nor B")?;
        let slots = [read_slot_info(session, Slot::A)?, read_slot_info(session, Slot::B)?];
        let floor = FirmwareVersion(sdo_object::read_number(session, MIN_FIRMWARE_VERSION)?);
        let reported = match sdo_object::read_number(session, SLOT_CHOICE) {
            Err(error) if is_slot_access_unsupported(&error) => None,
            word => StartInfo::decode(word?),
        };
        Ok(Some(Self { running, slots, floor, reported }))
    }

    /// Returns the content of a slot.
    #[must_use]
    pub const fn slot_info(&self, slot: Slot) -> &SlotInfo {
        slot.element_of(&self.slots)
    }

    /// Returns why the last start chose the slot that runs: as the boot program has it, else by what the slots hold.
    #[must_use]
    pub fn choice_reason(&self) -> SlotChoiceReason {
        self.reported.map_or_else(
            || self.inferred_choice_reason(),
            |choice| self.reported_choice_reason(choice),
        )
    }

    /// Returns the reason of the boot program, with what has happened since.
    fn reported_choice_reason(&self, StartInfo { reason, other }: StartInfo) -> SlotChoiceReason {
        let (ours, spare) = (self.slot_info(self.running), self.slot_info(self.running.other()));
        let is_confirmed = ours.status == Some(ImageStatus::Confirmed);
        let waits = spare.version > ours.version && spare.status == Some(ImageStatus::Verified);
        match (reason, other) {
            (StartReason::Trial(start), _) if is_confirmed => SlotChoiceReason::TrialPassed(start),
            (StartReason::Trial(start), _) => SlotChoiceReason::Trial(start),
            (StartReason::OnlyImage, _) if is_confirmed => SlotChoiceReason::AloneConfirmed,
            (StartReason::OnlyImage, _) => SlotChoiceReason::Alone,
            (StartReason::Newest, _) if waits => SlotChoiceReason::NewerWaits,
            (StartReason::Newest, None) => SlotChoiceReason::Only,
            (StartReason::Newest, Some(_)) => SlotChoiceReason::Newest,
            (StartReason::RolledBack, Some(ImageStatus::Rejected)) => {
                SlotChoiceReason::NewerRejected
            }
            (StartReason::RolledBack, Some(ImageStatus::Loading)) => {
                SlotChoiceReason::NewerIncomplete
            }
            (StartReason::RolledBack, _) => SlotChoiceReason::NewerPassedOver,
            (StartReason::LastResort, _) => SlotChoiceReason::LastResort,
        }
    }

    /// Returns why the slot that runs was probably chosen, by the rules of `trueup_boot::start` and what the slots hold
    /// now. It cannot know a dead PLL, records that take nothing, or a trial that was passed since.
    fn inferred_choice_reason(&self) -> SlotChoiceReason {
        let (ours, other) = (self.slot_info(self.running), self.slot_info(self.running.other()));
        let Some(status) = ours.status else { return SlotChoiceReason::Unknown };
        match status {
            ImageStatus::Trial(starts) | ImageStatus::Announced(starts) => {
                SlotChoiceReason::Trial(starts)
            }
            ImageStatus::New | ImageStatus::Verified => SlotChoiceReason::Alone,
            ImageStatus::Loading | ImageStatus::Rejected => SlotChoiceReason::LastResort,
            // A new one that comes has no header yet, or is one of a version that is known.
            ImageStatus::Confirmed if other.version.is_none() => SlotChoiceReason::Only,
            ImageStatus::Confirmed if other.version <= ours.version => SlotChoiceReason::Newest,
            ImageStatus::Confirmed => match other.status {
                None => SlotChoiceReason::Unknown,
                Some(ImageStatus::Verified) => SlotChoiceReason::NewerWaits,
                Some(ImageStatus::Rejected) => SlotChoiceReason::NewerRejected,
                Some(ImageStatus::Loading) => SlotChoiceReason::NewerIncomplete,
                Some(
                    ImageStatus::New
                    | ImageStatus::Trial(_)
                    | ImageStatus::Announced(_)
                    | ImageStatus::Confirmed,
                ) => SlotChoiceReason::NewerPassedOver,
            },
        }
    }

    /// Returns the part of a file that the board is to get.
    ///
    /// # Errors
    /// [`UnsuitableFirmwareError`]: the board would refuse it, or never start it.
    pub fn select_firmware_for_spare_slot<'f>(
        &self,
        file: &'f FirmwareFile,
    ) -> Result<&'f SlotFirmware, UnsuitableFirmwareError> {
        let spare = self.running.other();
        let part = file
            .part_for_slot(spare)
            .ok_or(UnsuitableFirmwareError::NoPart { running: self.running })?;
        let (version, floor) = (file.version(), self.floor);
        let ours = self.slot_info(self.running);
        if let Some(running) = ours.version.filter(|running| version <= *running) {
            return Err(UnsuitableFirmwareError::NotNewer { file: version, running });
        }
        if version < floor {
            return Err(UnsuitableFirmwareError::BelowFloor { file: version, floor });
        }
        // One whose status is not known is the board's to refuse.
        let is_confirmed = ours.status.is_none_or(|status| status == ImageStatus::Confirmed);
        if !is_confirmed && self.slot_info(spare).is_eligible() {
            return Err(UnsuitableFirmwareError::OnTrial);
        }
        Ok(part)
    }

    /// Returns both slots as JSON.
    #[must_use]
    pub fn to_json(&self) -> Value {
        json!({
            "running": self.running.name(),
            "a": self.slot_info(Slot::A).to_json(),
            "b": self.slot_info(Slot::B).to_json(),
            "oldest_version": self.floor.to_string(),
            "chosen_because": self.choice_reason().to_string(),
            "choice_reported": self.reported.is_some(),
        })
    }
}

fn read_slot_info(session: &mut Session, slot: Slot) -> Result<SlotInfo> {
    let version = sdo_object::read_number(session, *slot.element_of(&SLOT_VERSIONS))?;
    let [status, starts, ..] =
        sdo_object::read_number(session, *slot.element_of(&SLOT_STATUSES))?.to_le_bytes();
    Ok(SlotInfo {
        version: (version != 0).then_some(FirmwareVersion(version)),
        status: ImageStatus::decode([status, starts]),
    })
}

/// Returns whether a board has refused an object because it has no slots.
fn is_slot_access_unsupported(error: &anyhow::Error) -> bool {
    let codes =
        [AbortCode::NoData, AbortCode::NoObject, AbortCode::NoSubindex].map(AbortCode::code);
    matches!(error.downcast_ref(), Some(SdoClientError::Aborted { code, .. }) if codes.contains(code))
}

#[cfg(test)]
mod tests {
    use super::*;

    const OLD: Option<FirmwareVersion> = Some(FirmwareVersion::new(1, 0, 0, 0));
    const NEW: Option<FirmwareVersion> = Some(FirmwareVersion::new(1, 1, 0, 0));
    const LATER: Option<FirmwareVersion> = Some(FirmwareVersion::new(1, 2, 0, 0));

    /// The board runs from B.
    fn state(
        ours: (Option<FirmwareVersion>, ImageStatus),
        other: (Option<FirmwareVersion>, ImageStatus),
    ) -> FirmwareSlots {
        let content =
            |(version, status): (_, ImageStatus)| SlotInfo { version, status: Some(status) };
        let slots = [content(other), content(ours)];
        FirmwareSlots { running: Slot::B, slots, floor: FirmwareVersion(0), reported: None }
    }

    #[test]
    fn without_a_report_a_start_is_explained_by_statuses_and_versions() {
        use ImageStatus::{Announced, Confirmed, Loading, New, Rejected, Trial, Verified};
        for (ours, other, choice) in [
            ((OLD, Confirmed), (None, New), SlotChoiceReason::Only),
            ((OLD, Confirmed), (None, Loading), SlotChoiceReason::Only),
            ((NEW, Confirmed), (OLD, Confirmed), SlotChoiceReason::Newest),
            ((NEW, Confirmed), (NEW, Verified), SlotChoiceReason::Newest),
            ((NEW, Confirmed), (OLD, Rejected), SlotChoiceReason::Newest),
            ((NEW, Trial(2)), (OLD, Confirmed), SlotChoiceReason::Trial(2)),
            ((NEW, Announced(5)), (OLD, Confirmed), SlotChoiceReason::Trial(5)),
            ((OLD, New), (None, New), SlotChoiceReason::Alone),
            ((NEW, Verified), (OLD, Rejected), SlotChoiceReason::Alone),
            ((OLD, Confirmed), (NEW, Verified), SlotChoiceReason::NewerWaits),
            ((OLD, Confirmed), (NEW, Rejected), SlotChoiceReason::NewerRejected),
            ((OLD, Confirmed), (NEW, Loading), SlotChoiceReason::NewerIncomplete),
            ((OLD, Confirmed), (NEW, New), SlotChoiceReason::NewerPassedOver),
            ((OLD, Confirmed), (NEW, Trial(1)), SlotChoiceReason::NewerPassedOver),
            ((OLD, Confirmed), (NEW, Announced(1)), SlotChoiceReason::NewerPassedOver),
            ((OLD, Confirmed), (NEW, Confirmed), SlotChoiceReason::NewerPassedOver),
            ((NEW, Rejected), (OLD, Confirmed), SlotChoiceReason::LastResort),
            ((NEW, Loading), (None, New), SlotChoiceReason::LastResort),
        ] {
            assert_eq!(state(ours, other).choice_reason(), choice, "{ours:?} {other:?}");
        }
        let mut later = state((OLD, Confirmed), (NEW, Confirmed));
        later.slots[0].status = None;
        assert_eq!(later.choice_reason(), SlotChoiceReason::Unknown);
        later.slots[1].status = None;
        assert_eq!(later.choice_reason(), SlotChoiceReason::Unknown);
    }

    #[test]
    fn the_reason_of_the_boot_program_counts_and_what_has_happened_since() {
        use ImageStatus::{Confirmed, Loading, New, Rejected, Trial, Verified};
        use SlotChoiceReason as Chosen;
        use StartReason as Reason;
        for (reason, other, ours, spare, choice, derived) in [
            // Where the derivation agrees.
            (Reason::Newest, None, Confirmed, (None, New), Chosen::Only, true),
            (Reason::Newest, Some(Rejected), Confirmed, (OLD, Rejected), Chosen::Newest, true),
            (Reason::Trial(2), Some(Confirmed), Trial(2), (OLD, Confirmed), Chosen::Trial(2), true),
            (Reason::OnlyImage, None, New, (None, New), Chosen::Alone, true),
            (
                Reason::RolledBack,
                Some(Rejected),
                Confirmed,
                (LATER, Rejected),
                Chosen::NewerRejected,
                true,
            ),
            (
                Reason::RolledBack,
                Some(Loading),
                Confirmed,
                (LATER, Loading),
                Chosen::NewerIncomplete,
                true,
            ),
            (Reason::RolledBack, Some(New), Confirmed, (LATER, New), Chosen::NewerPassedOver, true),
            (Reason::LastResort, None, Rejected, (None, New), Chosen::LastResort, true),
            (
                Reason::Newest,
                Some(Confirmed),
                Confirmed,
                (LATER, Verified),
                Chosen::NewerWaits,
                true,
            ),
            // Where it cannot know.
            (
                Reason::RolledBack,
                Some(Verified),
                Confirmed,
                (LATER, Verified),
                Chosen::NewerPassedOver,
                false,
            ),
            (
                Reason::RolledBack,
                Some(Rejected),
                Confirmed,
                (LATER, Verified),
                Chosen::NewerRejected,
                false,
            ),
            (
                Reason::Trial(3),
                Some(Confirmed),
                Confirmed,
                (OLD, Confirmed),
                Chosen::TrialPassed(3),
                false,
            ),
            (Reason::OnlyImage, None, Confirmed, (None, New), Chosen::AloneConfirmed, false),
        ] {
            let mut state = state((NEW, ours), spare);
            assert_eq!(state.choice_reason() == choice, derived, "{reason:?} {other:?} {spare:?}");
            state.reported = Some(StartInfo { reason, other });
            assert_eq!(state.choice_reason(), choice, "{reason:?} {other:?} {spare:?}");
        }
    }

    #[test]
    fn a_slot_is_described_in_words() {
        let word = |version, status| SlotInfo { version, status }.to_string();
        for (version, status, words) in [
            (None, Some(ImageStatus::New), "empty"),
            (None, Some(ImageStatus::Loading), "loading: it has not come whole"),
            (OLD, Some(ImageStatus::New), "1.0.0, new: a probe or the ROM loader has written it"),
            (OLD, Some(ImageStatus::Verified), "1.0.0, verified: it waits for the next start"),
            (OLD, Some(ImageStatus::Trial(2)), "1.0.0, on trial, start 2 of 5"),
            (OLD, Some(ImageStatus::Announced(3)), "1.0.0, on trial, start 3 of 5"),
            (OLD, Some(ImageStatus::Confirmed), "1.0.0, confirmed"),
            (OLD, Some(ImageStatus::Rejected), "1.0.0, rejected: it failed its trial"),
        ] {
            assert_eq!(word(version, status), words);
        }
        assert!(word(OLD, None).contains("update the tool"));
    }
}
