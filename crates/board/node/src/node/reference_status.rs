//! The reference of the calibration: in force, or offered to the operator. And a calibration for the next start
//! that is dropped again.
//!
//! A reference is offered where tools may have been touched off with another one since it was taken: its
//! calibration was loaded again ([`trueup_store::reference`]), or it comes from a saved file. Until the operator
//! confirms it, declines it ([`trueup_canopen::dictionary::CLEAR_REFERENCE_SIGNATURE`]) or sets `Zero`, none is in force, and
//! nothing is available. A reference is never larger than a correction may be
//! ([`trueup_core::bridge::Bridge::is_reference_permitted`]), wherever it comes from.

use trueup_canopen::{emergency::Fault, sdo::AbortCode};
use trueup_core::{
    bridge::ReferenceErrors,
    units::{FineNanometres, Nanometres, TimestampMs},
};
use trueup_store::{
    reference::ReferenceStatus,
    write_log::{WriteKind, WriteRecord},
};

use super::{Interface, Node};

/// Result of a `Zero`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ZeroOutcome {
    /// The reference is another one now.
    Taken(ReferenceErrors),
    /// It is as it was: an input is missing, the error is larger than a correction may be, or it has not changed.
    Unchanged,
}

/// The reference that is offered, and where the one comes from that counts.
#[derive(Debug, Default)]
pub(super) struct OfferedReference {
    reference: Option<ReferenceErrors>,
    /// A reference of another board in nm, as far as it was written: the elongation, X, Y and Z.
    written: [Option<Nanometres>; 4],
    /// The write that has taken the reference, in force or offered; `None`: it is not known.
    taken: Option<WriteRecord>,
    /// It was in this start.
    was_now: bool,
    /// The board has to store what holds now.
    is_new: bool,
}

impl OfferedReference {
    pub(crate) const fn has_offered_reference(&self) -> bool {
        self.reference.is_some()
    }

    pub const fn reference(&self) -> Option<ReferenceErrors> {
        self.reference
    }

    pub(crate) const fn reference_write(&self) -> Option<WriteRecord> {
        self.taken
    }

    /// Kind and line of that write, as the log has them; 0: it is not known.
    pub(crate) fn origin_code(&self) -> u16 {
        self.taken.map_or(0, |write| u16::from_le_bytes([write.what as u8, write.origin as u8]))
    }
}

impl<'a> Node<'a> {
    /// Returns what came of the last `Zero`, once.
    pub fn take_zero_outcome(&mut self) -> Option<ZeroOutcome> {
        self.zero.take()
    }

    /// Returns the error that counts as none.
    #[must_use]
    pub fn reference(&self) -> ReferenceErrors {
        self.state.reference()
    }

    /// Takes up what the board has stored for the running calibration, and the write that has taken its reference.
    /// Returns whether the reference is permitted; one that is not does not count, and is reported.
    pub fn restore_reference_status(
        &mut self,
        standing: ReferenceStatus,
        taken: Option<WriteRecord>,
    ) -> bool {
        let ReferenceStatus { reference, is_offered, is_changed } = standing;
        if is_changed {
            self.require_confirmation(Fault::CalibrationChanged);
        }
        if !self.permits_reference(&reference) {
            self.set_fault(Fault::Store);
            return false;
        }
        let about = reference.elongation.0.cast_unsigned();
        self.offer.taken = taken.filter(|write| write.about == about);
        if is_offered {
            self.offer.reference = Some(reference);
            self.require_confirmation(Fault::ReferenceOffered);
        } else {
            self.state.set_reference(reference);
        }
        true
    }

    /// Returns what the board is to store for the running calibration, once after each change.
    pub fn take_reference_status(&mut self) -> Option<ReferenceStatus> {
        core::mem::take(&mut self.offer.is_new).then(|| ReferenceStatus {
            reference: self.offer.reference.unwrap_or_else(|| self.state.reference()),
            is_offered: self.offer.has_offered_reference(),
            is_changed: self.questions.contains(Fault::CalibrationChanged),
        })
    }

    pub(super) fn schedule_reference_status_store(&mut self) {
        self.offer.is_new = true;
    }

    fn permits_reference(&self, reference: &ReferenceErrors) -> bool {
        self.bridge.as_ref().is_none_or(|bridge| bridge.is_reference_permitted(reference))
    }

    /// Another reference is in force: what was offered is not any more.
    pub(super) fn end_reference_offer(
        &mut self,
        now: ReferenceErrors,
        what: WriteKind,
        line: Option<Interface>,
    ) {
        let about = if what == WriteKind::Forgotten { 0 } else { now.elongation.0.cast_unsigned() };
        let write = self.new_write_record(what, about, line);
        self.push_write(write);
        let taken = (what == WriteKind::Zeroed).then_some(write);
        self.offer =
            OfferedReference { taken, was_now: true, is_new: true, ..OfferedReference::default() };
        self.questions = self.questions.without_fault(Fault::ReferenceOffered);
        self.update_inhibition();
    }

    /// The operator takes the reference that is offered.
    pub(super) fn accept_reference_offer(&mut self) {
        if let Some(reference) = self.offer.reference.take() {
            self.state.set_reference(reference);
            self.offer.is_new = true;
        }
    }

    /// The machine is at rest: what was learned goes at once, and the reference, in force or offered.
    pub(super) fn clear_learned_changes_and_reference(&mut self) {
        self.state.clear_learned_changes();
        // Again and again it would only fill the flash.
        if self.offer.has_offered_reference()
            || self.state.reference() != ReferenceErrors::default()
        {
            self.state.set_reference(ReferenceErrors::default());
            self.supply.reset_baseline_level();
            self.zero = Some(ZeroOutcome::Taken(ReferenceErrors::default()));
            self.end_reference_offer(
                ReferenceErrors::default(),
                WriteKind::Forgotten,
                self.log.request_interface(),
            );
        }
    }

    /// Keeps a part of another board's reference until the rest of it is there.
    pub(super) fn stage_reference_part(&mut self, part: u8, number: u32) -> Result<(), AbortCode> {
        let nm = Nanometres(number.cast_signed());
        let mut alone = ReferenceErrors::default();
        match part.checked_sub(1).and_then(|axis| alone.axes.get_mut(usize::from(axis))) {
            None => alone.elongation = nm,
            // Beyond 8 mm it is no such error, and more than any limit.
            Some(axis) => *axis = to_fine_nanometres(nm).ok_or(AbortCode::Value)?,
        }
        if !self.permits_reference(&alone) {
            return Err(AbortCode::Value);
        }
        *self.offer.written.get_mut(usize::from(part)).ok_or(AbortCode::NoSubindex)? = Some(nm);
        Ok(())
    }

    /// Offers the operator the reference that was written. None is in force meanwhile.
    pub(super) fn offer_transferred_reference(&mut self) -> Result<(), AbortCode> {
        // A reference without one of its parts is not valid.
        let [Some(elongation), Some(x), Some(y), Some(z)] = self.offer.written else {
            return Err(AbortCode::DeviceState);
        };
        let back = ReferenceErrors { elongation, axes: [x, y, z].map(Nanometres::to_fine) };
        let write = self.new_write_record(
            WriteKind::Offered,
            elongation.0.cast_unsigned(),
            self.log.request_interface(),
        );
        self.push_write(write);
        self.state.set_reference(ReferenceErrors::default());
        self.offer = OfferedReference {
            reference: Some(back),
            taken: Some(write),
            was_now: true,
            is_new: true,
            ..OfferedReference::default()
        };
        self.require_confirmation(Fault::ReferenceOffered);
        Ok(())
    }

    /// Seconds since the reference was taken; `None`: it is not known.
    pub(super) fn reference_age_s(&self) -> Option<u32> {
        let taken = self.offer.taken?;
        match (taken.utc_s, self.utc_s()) {
            (0, _) | (_, 0) => {}
            (then, now) => return Some(now.saturating_sub(then)),
        }
        self.offer.was_now.then(|| self.now.duration_ms_since(TimestampMs(taken.at_ms)) / 1_000)
    }

    /// Drops the calibration for the next start, once the board has stored the running one anew.
    pub(super) fn request_calibration_drop(&mut self) -> Result<(), AbortCode> {
        if self.new_crc == 0 || self.slot.stored_blob().is_none() || self.blob.is_empty() {
            return Err(AbortCode::DeviceState);
        }
        self.drops_new = true;
        Ok(())
    }

    /// Returns the running calibration where it is to be stored anew, once; [`Self::finish_calibration_drop`] is to follow.
    pub fn take_calibration_to_restore(&mut self) -> Option<&'a [u8]> {
        core::mem::take(&mut self.drops_new).then_some(self.blob)
    }

    /// Whether it has: then the calibration for the next start is the running one again.
    pub fn finish_calibration_drop(&mut self, is_stored: bool) {
        if !is_stored {
            self.set_fault(Fault::Store);
            return;
        }
        self.log_write(WriteKind::Cancelled, self.new_crc, self.log.request_interface());
        self.new_crc = 0;
        // It is stored, so nothing looks at it.
        self.slot.open(None).ok();
    }
}

/// Returns a length in fine units, if they hold it.
fn to_fine_nanometres(nm: Nanometres) -> Option<FineNanometres> {
    nm.0.checked_mul(FineNanometres::PER_NANOMETRE).map(FineNanometres)
}
