//! A new firmware to a board: its header, for which the board checks and erases the other slot, then the bytes behind
//! it, and the restart.
//!
//! ```text
//!   how much has come? ─► none of this file ─► header ──┐      a frame is lost: look again, a few times
//!           ▲        └──► some of it ─────► the rest ───┼──► verified by the board
//!           └───────────── not answered, or busy ◄──────┘
//! ```
//!
//! So a line that was cut costs nothing that has come: the same command goes on behind it, as long as the board was not
//! restarted. What runs meanwhile stays unchanged.

use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use trueup_boot::{
    boot_state::ImageStatus, flash_layout::Slot, image_header::HEADER_SIZE,
    reject_reason::FirmwareRejectReason,
};
use trueup_canopen::sdo::{
    AbortCode,
    client::{SdoClientError, timeout_abort_frame},
};

use crate::{
    calibration_load::{require_service, restart_and_poll_until},
    firmware_file::SlotFirmware,
    firmware_slots::FirmwareSlots,
    sdo_object::{
        self, FIRMWARE_BYTES_RECEIVED, FIRMWARE_HEADER, FIRMWARE_IMAGE, FIRMWARE_REJECT_REASON,
        FIRMWARE_TAG,
    },
    session::Session,
};

/// Tries in a row that bring the board no byte, before an update is given up.
const MAX_IDLE_TRIES: u32 = 5;
/// From one try to the next: a board that verifies an image takes up to 0.4 s at full speed.
const RETRY_DELAY: Duration = Duration::from_secs(1);

/// The board refuses the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the board refuses it{}", reject_reason_text(*.reason))]
pub struct FirmwareRejectedError {
    /// Its reason; `None`: one of a later version.
    pub reason: Option<FirmwareRejectReason>,
}

fn reject_reason_text(reason: Option<FirmwareRejectReason>) -> String {
    match reason.map(|reason| (reason, reject_reason_remedy(reason))) {
        None => " for a reason that this tool does not know: update the tool".into(),
        Some((reason, "")) => format!(": {reason}"),
        Some((reason, remedy)) => format!(": {reason}. {remedy}"),
    }
}

impl FirmwareRejectedError {
    /// Returns whether another file may be taken: the board itself is well.
    #[must_use]
    pub const fn is_board_intact(&self) -> bool {
        !matches!(self.reason, Some(FirmwareRejectReason::Flash | FirmwareRejectReason::NotStored))
    }
}

/// Returns what to do about a refusal, where its words do not say it.
const fn reject_reason_remedy(reason: FirmwareRejectReason) -> &'static str {
    match reason {
        FirmwareRejectReason::Signature => {
            "Take the file of the board's maker; one that is signed with another key needs a new boot program by the probe"
        }
        FirmwareRejectReason::NoHeader
        | FirmwareRejectReason::Length
        | FirmwareRejectReason::Damaged => "The line may have damaged it: update again",
        FirmwareRejectReason::OtherSlot => "The board has restarted meanwhile: update again",
        FirmwareRejectReason::BelowFloor
        | FirmwareRejectReason::OwnFloor
        | FirmwareRejectReason::NotNewer => "Take a newer file",
        FirmwareRejectReason::Flash | FirmwareRejectReason::NotStored => {
            "Update again; if it stays so, the flash of the board is worn: replace the board"
        }
        FirmwareRejectReason::Format
        | FirmwareRejectReason::Unconfirmed
        | FirmwareRejectReason::NoSlots => "",
    }
}

/// An update that has ended before all of it was on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "interrupted near byte {received} of {length}: the board keeps what has come, and runs on as before. The same command \
     goes on there; after a restart of the board it begins anew"
)]
pub(crate) struct TransferInterruptedError {
    /// Bytes that the board has acknowledged, the header included; a block of them more or less.
    pub received: u32,
    /// Bytes of the whole.
    pub length: u32,
}

/// The way of an update that has arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransferReport {
    /// Bytes that an earlier command had sent; 0: it began anew.
    pub resumed_from: u32,
}

/// Ends a transfer that an earlier command has left open: a board that waits for segments would take the next question for one.
///
/// # Errors
/// The line breaks.
pub fn abort_open_transfer(session: &mut Session) -> Result<()> {
    session.send(&timeout_abort_frame(FIRMWARE_IMAGE))
}

/// Sends a firmware to the slot that does not run, from the byte on that the board does not have yet. The board then
/// starts it next. `progress` receives the bytes that the board has, or is just being sent, the header included; an
/// error of it ends the update.
///
/// # Errors
/// [`FirmwareRejectedError`]; `TransferInterruptedError` in front of the reason, where the board has a part; the board may not be written to; the
/// line breaks.
pub fn store_firmware(
    session: &mut Session,
    firmware: &SlotFirmware,
    progress: &mut dyn FnMut(u32) -> Result<()>,
) -> Result<TransferReport> {
    let length = firmware.image.header.length;
    let mut reached = 0;
    send_firmware(session, firmware, &mut reached, progress).map_err(|error| {
        if reached == 0 || error.is::<FirmwareRejectedError>() {
            return error;
        }
        error.context(TransferInterruptedError { received: reached, length })
    })
}

/// Does the same; `reached` receives the bytes that the board has acknowledged.
fn send_firmware(
    session: &mut Session,
    firmware: &SlotFirmware,
    reached: &mut u32,
    progress: &mut dyn FnMut(u32) -> Result<()>,
) -> Result<TransferReport> {
    let mut resumed_from = None;
    let (mut is_under_way, mut idle_tries) = (false, 0);
    loop {
        require_service(session)?;
        let begin = received_bytes(session, firmware)?;
        if resumed_from.is_none() {
            is_under_way = begin > 0;
        }
        let resumed_from = *resumed_from.get_or_insert(begin);
        if begin > *reached {
            idle_tries = 0;
        }
        *reached = begin;
        if begin == firmware.image.header.length && is_verified(session, firmware)? {
            return Ok(TransferReport { resumed_from });
        }
        let is_header = begin == 0;
        let rest = firmware.bytes.get(begin as usize..).unwrap_or_default();
        let (at, data) = match is_header {
            true => (FIRMWARE_HEADER, rest.get(..HEADER_SIZE).unwrap_or(rest)),
            false => (FIRMWARE_IMAGE, rest),
        };
        let mut requested = begin;
        let sent = sdo_object::block_download(session, at, data, |count| {
            // The header counts once the board has checked it and erased the slot.
            if !is_header {
                *reached = requested;
            }
            requested = begin.saturating_add(u32::try_from(count).unwrap_or(u32::MAX));
            progress(requested)
        });
        match sent {
            // A board that drops it again, as one does that restarts, is not to erase its flash for ever.
            Ok(()) if is_header && idle_tries + 1 >= MAX_IDLE_TRIES => bail!(
                "the board accepted the header {MAX_IDLE_TRIES} times and lost it: check whether it restarts by itself"
            ),
            Ok(()) if is_header => (is_under_way, idle_tries) = (true, idle_tries + 1),
            Ok(()) => return Ok(TransferReport { resumed_from }),
            Err(error) => {
                // In a block a board takes whatever comes for a segment.
                session.send(&timeout_abort_frame(at))?;
                let is_value = has_abort_code(&error, AbortCode::Value);
                if !is_value && !is_transient_error(&error) {
                    return Err(error);
                }
                if let Some(refused) = read_rejection(session, is_under_way || is_value)? {
                    return Err(refused.into());
                }
                if is_value {
                    return Err(error);
                }
                if *reached > begin {
                    idle_tries = 0;
                }
                idle_tries += 1;
                if idle_tries >= MAX_IDLE_TRIES {
                    return Err(error);
                }
                let end = Instant::now() + RETRY_DELAY;
                while session.next_event(end)?.is_some() {}
            }
        }
    }
}

/// Restarts a board and waits until it answers again. Returns its slots: it runs from `slot`, or has rejected what is
/// there, or has answered from the other one for 5 s.
///
/// # Errors
/// The board does not come back.
pub fn restart(session: &mut Session, slot: Slot) -> Result<FirmwareSlots> {
    require_service(session)?;
    restart_and_poll_until(
        session,
        |client| FirmwareSlots::read(client)?.context("the board has no firmware slots any more"),
        |now| now.running == slot || now.slot_info(slot).status == Some(ImageStatus::Rejected),
    )
}

/// Returns how many bytes of this firmware the board has; 0: it has none of it.
fn received_bytes(session: &mut Session, firmware: &SlotFirmware) -> Result<u32> {
    let received = sdo_object::read_number(session, FIRMWARE_BYTES_RECEIVED)?;
    let is_possible = (HEADER_SIZE..=firmware.bytes.len()).contains(&(received as usize));
    if !is_possible || sdo_object::read_number(session, FIRMWARE_TAG)? != firmware.image.tag {
        return Ok(0);
    }
    Ok(received)
}

/// Returns whether the board has verified what it has received whole.
fn is_verified(session: &mut Session, firmware: &SlotFirmware) -> Result<bool> {
    let slots =
        FirmwareSlots::read(session)?.context("the board has no firmware slots any more")?;
    Ok(slots.slot_info(firmware.image.header.slot).status == Some(ImageStatus::Verified))
}

/// Returns the refusal of the firmware under way. An earlier one stays readable until a header is accepted, so none
/// counts before.
fn read_rejection(
    session: &mut Session,
    is_under_way: bool,
) -> Result<Option<FirmwareRejectedError>> {
    if !is_under_way {
        return Ok(None);
    }
    let number = sdo_object::read_number(session, FIRMWARE_REJECT_REASON)?;
    let reason = u8::try_from(number).ok().and_then(FirmwareRejectReason::from_number);
    Ok((number != 0).then_some(FirmwareRejectedError { reason }))
}

/// Returns whether the same may be taken a moment later: a frame was lost, or the board is at a step.
fn is_transient_error(error: &anyhow::Error) -> bool {
    sdo_object::is_transmission_error(error)
        || has_abort_code(error, AbortCode::DeviceState)
        || has_abort_code(error, AbortCode::CannotStore)
}

fn has_abort_code(error: &anyhow::Error, abort: AbortCode) -> bool {
    matches!(error.downcast_ref(), Some(SdoClientError::Aborted { code, .. }) if *code == abort.code())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_refusal_says_why_and_what_to_do() {
        for reason in FirmwareRejectReason::ALL {
            let refused = FirmwareRejectedError { reason: Some(reason) };
            let text = refused.to_string();
            assert!(text.starts_with("the board refuses it: "), "{text}");
            // In its own words, or behind them.
            let has_remedy = text.contains(". ") || reason.to_string().contains(':');
            assert!(has_remedy, "{text}");
            assert_eq!(
                refused.is_board_intact(),
                !matches!(reason, FirmwareRejectReason::Flash | FirmwareRejectReason::NotStored)
            );
        }
        assert!(FirmwareRejectedError { reason: None }.to_string().contains("update the tool"));
    }
}
