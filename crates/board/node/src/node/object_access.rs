//! The node's own values behind the object dictionary.

use trueup_canopen::{
    dictionary::{
        CLEAR_REFERENCE_SIGNATURE, CrashDetail, DROP_CALIBRATION_SIGNATURE, ELONGATION_SUBINDEX,
        EntryContent, NOT_AVAILABLE, RESTORE_REFERENCE_SIGNATURE, ReceiverCounter,
    },
    sdo::{AbortCode, ObjectAccess, ObjectValue},
};
use trueup_core::{
    bridge::ReferenceErrors,
    cnc::OffsetQuality,
    units::{Nanometres, Temperature},
};
use trueup_link::{layout::NO_TEMPERATURE_RAW, status::StatusItem};
use trueup_store::{calibration::calibration_crc, calibration_load::LoadError};

use super::Node;

impl Node<'_> {
    /// Returns whether no offset is followed: only then may the board be changed under it.
    pub(super) fn is_offset_inactive(&self) -> bool {
        matches!(self.last.quality, OffsetQuality::Off | OffsetQuality::Fault)
    }

    /// Returns a process value in thousandths of its unit.
    fn process_value(&self, number: u8) -> Option<i32> {
        if number.saturating_add(1) == ELONGATION_SUBINDEX {
            return self.state.elongation().map(|elongation| elongation.0);
        }
        let Temperature(temperature) = self.state.temperature(number)?;
        const HALF_MILLIKELVIN: i32 = Temperature::PER_MILLIKELVIN / 2;
        temperature
            .saturating_add(HALF_MILLIKELVIN)
            .checked_div_euclid(Temperature::PER_MILLIKELVIN)
    }

    fn receiver_counter(&self, counter: ReceiverCounter) -> u32 {
        let counters = self.receiver.counters();
        match counter {
            ReceiverCounter::Accepted => counters.accepted,
            ReceiverCounter::Malformed => counters.malformed,
            ReceiverCounter::Crc => counters.crc_errors,
            ReceiverCounter::Sequence => counters.sequence_errors,
            ReceiverCounter::Lost => counters.lost,
        }
    }

    /// RMS noise in thousandths of a code, 65,535 at the most: the second differences have six times its variance.
    fn rms_noise_millicodes(&self) -> u32 {
        let squares = u64::from(self.noise.squares).saturating_mul(1_000_000);
        let mean = squares.checked_div(u64::from(self.noise.count).saturating_mul(6));
        // The root of 64 bits would take 400 bytes more.
        u32::try_from(mean.unwrap_or(0)).unwrap_or(u32::MAX).isqrt()
    }

    // Not a part of its caller, which has dealt with some of these: the compiler would put a trap
    // where they cannot come, and no trap may be reachable from a frame (host-tests, no_panic).
    #[inline(never)]
    fn entry_value(&self, what: EntryContent) -> Result<u32, AbortCode> {
        let signed = |number: i32| number.cast_unsigned();
        let nanometres = |length: Nanometres| signed(length.0);
        let reference = self.state.reference();
        Ok(match what {
            EntryContent::Fixed(number) => number,
            EntryContent::SerialNumber => self.board.serial_number,
            EntryContent::ErrorRegister => self.faults(&self.last).error_register().into(),
            EntryContent::ErrorCount => {
                u32::try_from(self.emergencies.history_len()).unwrap_or(u32::MAX)
            }
            EntryContent::Error(number) => {
                self.emergencies.history_entry(number).ok_or(AbortCode::NoData)?
            }
            EntryContent::Inhibit => self.emergencies.inhibit_time_100us().into(),
            EntryContent::ConsumerHeartbeat => self.consumer.to_object_value(),
            EntryContent::ProducerHeartbeat => self.heartbeat.period_ms.into(),
            EntryContent::Offset(axis) => {
                let offset = self.last.offset.and_then(|all| all.get(usize::from(axis)).copied());
                offset.map_or(signed(NOT_AVAILABLE), nanometres)
            }
            EntryContent::Quality => self.last.quality as u32,
            EntryContent::Flags => self.last.flags.0.into(),
            EntryContent::Age => self.last.age_ms.into(),
            EntryContent::Faults => self.faults(&self.last).low_half_word().into(),
            EntryContent::AllFaults => self.faults(&self.last).low_word(),
            EntryContent::HighFaults => self.faults(&self.last).high_word(),
            EntryContent::StateBits => self.faults(&self.last).state_bits().0,
            EntryContent::ResetReason => self.board.start.reason as u32,
            EntryContent::CrashDetail(what) => {
                self.board.start.stop.detail_value(what).ok_or(AbortCode::NoData)?
            }
            EntryContent::Resets(reason) => self.board.start.reset_count(reason).into(),
            EntryContent::Commit => self.board.commit,
            EntryContent::Authority => self.write_authority() as u32,
            EntryContent::Clock => self.now.0,
            EntryContent::ReferenceElongation => nanometres(reference.elongation),
            EntryContent::Reference(axis) => {
                let axis = reference.axes.get(usize::from(axis)).ok_or(AbortCode::NoSubindex)?;
                nanometres(axis.rounded())
            }
            EntryContent::HasReference => (reference != ReferenceErrors::default()).into(),
            EntryContent::Learned(part) => {
                let part =
                    self.state.learned_changes().current_amounts().get(usize::from(part)).copied();
                signed(part.ok_or(AbortCode::NoSubindex)?.into())
            }
            EntryContent::Tool => self.state.conditions().0.unwrap_or_default().tool.into(),
            EntryContent::Conditions => self.state.conditions().0.unwrap_or_default().bits.into(),
            EntryContent::ConditionsOrigin => match self.state.conditions() {
                (_, true) => 2,
                (last, false) => last.is_some().into(),
            },
            EntryContent::Noise => self.rms_noise_millicodes(),
            EntryContent::ReceiverCounter(counter) => self.receiver_counter(counter),
            EntryContent::RunningCrc => calibration_crc(self.blob),
            EntryContent::NewCrc => self.new_crc,
            EntryContent::Utc => self.utc_s(),
            EntryContent::MachineBoard(word) => {
                let word = self.machine_identity().board.get(usize::from(word)).copied();
                word.ok_or(AbortCode::NoSubindex)?
            }
            EntryContent::Input(number) => {
                signed(self.process_value(number).unwrap_or(NOT_AVAILABLE))
            }
            EntryContent::InputStatus(number) => self.process_value(number).is_none().into(),
            EntryContent::OfferedElongation => {
                let offered = self.offer.reference();
                offered.map_or(signed(NOT_AVAILABLE), |offer| nanometres(offer.elongation))
            }
            EntryContent::Offered(axis) => {
                let axes = self.offer.reference().map(|reference| reference.axes);
                let axis = axes.and_then(|axes| axes.get(usize::from(axis)).copied());
                axis.map_or(signed(NOT_AVAILABLE), |axis| nanometres(axis.rounded()))
            }
            EntryContent::ReferenceUtc => {
                self.offer.reference_write().map_or(0, |write| write.utc_s)
            }
            EntryContent::ReferenceOrigin => self.offer.origin_code().into(),
            EntryContent::ReferenceAge => self.reference_age_s().unwrap_or(u32::MAX),
            EntryContent::FirmwareReceived
            | EntryContent::FirmwareTag
            | EntryContent::FirmwareRefused
            | EntryContent::RunningSlot
            | EntryContent::SlotVersion(_)
            | EntryContent::SlotStatus(_)
            | EntryContent::FirmwareFloor
            | EntryContent::SlotChoice => self.firmware.entry_value(what)?,
            EntryContent::Forget
            | EntryContent::DropNew
            | EntryContent::FirmwareHeader
            | EntryContent::FirmwareImage => return Err(AbortCode::WriteOnly),
            EntryContent::Text(_)
            | EntryContent::Running
            | EntryContent::New
            | EntryContent::WriteLog
            | EntryContent::MachineName
            | EntryContent::MachineSerial => return Err(AbortCode::NoData),
        })
    }
}

impl Node<'_> {
    /// Returns what a status frame about this item says.
    pub(super) fn status_item(&self, number: u8) -> StatusItem {
        let short = |number: u32| u16::try_from(number).unwrap_or(u16::MAX);
        let counters = self.receiver.counters();
        match number {
            pair @ 0..=3 => {
                let first = pair.saturating_mul(2);
                let both = [first, first.saturating_add(1)];
                StatusItem::Temperatures {
                    pair,
                    centi_c: both.map(|channel| self.temperature_centi_c(channel)),
                }
            }
            4 => StatusItem::Elongation(self.state.elongation()),
            5 => StatusItem::Refused {
                damaged: short(counters.crc_errors),
                out_of_sequence: short(counters.sequence_errors),
            },
            6 => StatusItem::Received {
                malformed: short(counters.malformed),
                lost: short(counters.lost),
            },
            7 => StatusItem::Board {
                noise_thousandths: short(self.rms_noise_millicodes()),
                faults: self.faults(&self.last).low_half_word(),
            },
            8 => StatusItem::State(self.faults(&self.last).state_bits()),
            9 => StatusItem::Reset {
                reason: self.board.start.reason,
                free_stack: self.board.free_stack,
            },
            _ => StatusItem::Calibration(self.running_calibration_crc()),
        }
    }

    /// Returns a temperature in 0.01 °C.
    // Once in the image, not once for each channel.
    #[inline(never)]
    pub(super) fn temperature_centi_c(&self, channel: u8) -> Option<i16> {
        const UNITS_PER_CENTIKELVIN: i32 = 10 * Temperature::PER_MILLIKELVIN;
        let Temperature(temperature) = self.state.temperature(channel)?;
        let rounded =
            temperature.saturating_add(UNITS_PER_CENTIKELVIN / 2).div_euclid(UNITS_PER_CENTIKELVIN);
        // The ends are beyond what a thermometer reads.
        i16::try_from(rounded).ok().filter(|centi_c| i32::from(*centi_c) != NO_TEMPERATURE_RAW)
    }
}

/// Returns the abort code that a master gets for a calibration that is not loaded.
pub(super) const fn load_abort_code(error: LoadError) -> AbortCode {
    match error {
        LoadError::TooLong => AbortCode::TooLong,
        LoadError::Busy => AbortCode::DeviceState,
        LoadError::Rejected => AbortCode::Value,
        LoadError::NotStored => AbortCode::CannotStore,
    }
}

impl ObjectAccess for Node<'_> {
    fn read(&self, what: EntryContent) -> Result<ObjectValue<'_>, AbortCode> {
        Ok(ObjectValue::Bytes(match what {
            EntryContent::Text(text) => text.as_bytes(),
            EntryContent::CrashDetail(CrashDetail::File) => self.board.start.stop.file_name(),
            EntryContent::Running if !self.blob.is_empty() => self.blob,
            EntryContent::WriteLog if !self.log.as_bytes().is_empty() => self.log.as_bytes(),
            EntryContent::MachineName if !self.machine_identity().machine.is_empty() => {
                self.machine_identity().machine
            }
            EntryContent::MachineSerial if !self.machine_identity().serial.is_empty() => {
                self.machine_identity().serial
            }
            EntryContent::New => self.slot.stored_blob().ok_or(AbortCode::NoData)?,
            number => return self.entry_value(number).map(ObjectValue::Number),
        }))
    }

    fn write(&mut self, what: EntryContent, number: u32) -> Result<(), AbortCode> {
        let short = || u16::try_from(number).map_err(|_| AbortCode::Value);
        // A stranger on the bus must not change it, nor anybody under a tool that cuts.
        self.check_change_allowed()?;
        match what {
            EntryContent::ErrorCount if number == 0 => self.emergencies.clear_history(),
            EntryContent::Inhibit => self.emergencies.set_inhibit_time_100us(short()?),
            EntryContent::ConsumerHeartbeat => self.consumer.set_object_value(number)?,
            EntryContent::ProducerHeartbeat => {
                self.heartbeat.period_ms = short()?;
                self.heartbeat.since_ms = 0;
            }
            EntryContent::Utc => self.set_utc_s(number),
            EntryContent::ReferenceElongation => self.stage_reference_part(0, number)?,
            EntryContent::Reference(axis) => {
                self.stage_reference_part(axis.saturating_add(1), number)?
            }
            EntryContent::Forget if number == RESTORE_REFERENCE_SIGNATURE => {
                self.offer_transferred_reference()?
            }
            EntryContent::Forget if number != CLEAR_REFERENCE_SIGNATURE => {
                return Err(AbortCode::Value);
            }
            EntryContent::Forget => self.clear_learned_changes_and_reference(),
            EntryContent::DropNew if number != DROP_CALIBRATION_SIGNATURE => {
                return Err(AbortCode::Value);
            }
            EntryContent::DropNew => self.request_calibration_drop()?,
            _ => return Err(AbortCode::Value),
        }
        Ok(())
    }

    fn open(&mut self, what: EntryContent, size: Option<u32>) -> Result<(), AbortCode> {
        self.check_change_allowed()?;
        match what {
            EntryContent::FirmwareHeader | EntryContent::FirmwareImage => {
                self.open_firmware(what, size)
            }
            _ if self.has_pending_firmware() => Err(AbortCode::DeviceState),
            _ => self.slot.open(size).map_err(load_abort_code),
        }
    }

    fn append(&mut self, what: EntryContent, bytes: &[u8]) -> Result<(), AbortCode> {
        match what {
            EntryContent::FirmwareHeader | EntryContent::FirmwareImage => {
                self.append_firmware(bytes)
            }
            _ => self.slot.append(bytes).map_err(load_abort_code),
        }
    }

    fn has_room_for_block(&self, what: EntryContent) -> bool {
        match what {
            EntryContent::FirmwareHeader | EntryContent::FirmwareImage => self.has_block_capacity(),
            // Its buffer takes all of it.
            _ => true,
        }
    }

    fn close(&mut self, what: EntryContent) -> Result<(), AbortCode> {
        self.check_change_allowed()?;
        if matches!(what, EntryContent::FirmwareHeader | EntryContent::FirmwareImage) {
            return self.close_firmware();
        }
        self.log.set_load_origin(!self.master.is_master_cnc());
        self.slot.close().map_err(load_abort_code)
    }
}
