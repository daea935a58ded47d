//! The node's own values behind the object dictionary.

use trueup_canopen::{
    dictionary::{BACK, Counter, DROP, ELONGATION_INPUT, FORGET, NOT_AVAILABLE, ObjectKind, Stop},
    sdo::{Abort, ObjectValue, Objects},
};
use trueup_core::{
    bridge::Reference,
    cnc::Quality,
    units::{Nanometres, Temperature},
};
use trueup_link::{layout::NO_TEMPERATURE_RAW, status::Item};
use trueup_store::{calibration::identity, load::LoadError};

use super::Node;

impl Node<'_> {
    /// Sets the serial number of the identity object (0x1018:04), 0…2³² − 1: a board of its own has its own.
    pub fn set_serial_number(&mut self, number: u32) {
        self.serial_number = number;
    }

    /// Returns whether no offset is followed: only then may the board be changed under it.
    pub(super) fn is_at_rest(&self) -> bool {
        matches!(self.last.quality, Quality::Off | Quality::Fault)
    }

    /// Returns a process value in thousandths of its unit.
    fn input(&self, number: u8) -> Option<i32> {
        if number.saturating_add(1) == ELONGATION_INPUT {
            return self.state.elongation().map(|elongation| elongation.0);
        }
        let Temperature(temperature) = self.state.temperature(number)?;
        const HALF: i32 = Temperature::PER_MILLIKELVIN / 2;
        temperature.saturating_add(HALF).checked_div_euclid(Temperature::PER_MILLIKELVIN)
    }

    fn counter(&self, counter: Counter) -> u32 {
        let counters = self.receiver.counters();
        match counter {
            Counter::Accepted => counters.accepted,
            Counter::Malformed => counters.malformed,
            Counter::Crc => counters.crc_errors,
            Counter::Sequence => counters.sequence_errors,
            Counter::Lost => counters.lost,
        }
    }

    /// RMS noise in thousandths of a code, 65,535 at the most: the second differences have six times its variance.
    fn noise_thousandths(&self) -> u32 {
        let squares = u64::from(self.noise.squares).saturating_mul(1_000_000);
        let mean = squares.checked_div(u64::from(self.noise.count).saturating_mul(6));
        // The root of 64 bits would take 400 bytes more.
        u32::try_from(mean.unwrap_or(0)).unwrap_or(u32::MAX).isqrt()
    }

    // Not a part of its caller, which has dealt with some of these: the compiler would put a trap
    // where they cannot come, and no trap may be reachable from a frame (host-tests, no_panic).
    #[inline(never)]
    fn number(&self, what: ObjectKind) -> Result<u32, Abort> {
        let signed = |number: i32| number.cast_unsigned();
        let nanometres = |length: Nanometres| signed(length.0);
        let reference = self.state.reference();
        Ok(match what {
            ObjectKind::Fixed(number) => number,
            ObjectKind::SerialNumber => self.serial_number,
            ObjectKind::ErrorRegister => self.faults(&self.last).register().into(),
            ObjectKind::ErrorCount => u32::try_from(self.emergencies.count()).unwrap_or(u32::MAX),
            ObjectKind::Error(number) => self.emergencies.error(number).ok_or(Abort::NoData)?,
            ObjectKind::Inhibit => self.emergencies.inhibit().into(),
            ObjectKind::ConsumerHeartbeat => self.consumer.setting(),
            ObjectKind::ProducerHeartbeat => self.heartbeat_period_ms.into(),
            ObjectKind::Offset(axis) => {
                let offset = self.last.offset.and_then(|all| all.get(usize::from(axis)).copied());
                offset.map_or(signed(NOT_AVAILABLE), nanometres)
            }
            ObjectKind::Quality => self.last.quality as u32,
            ObjectKind::Flags => self.last.flags.0.into(),
            ObjectKind::Age => self.last.age_ms.into(),
            ObjectKind::Faults => self.faults(&self.last).low_bits().into(),
            ObjectKind::AllFaults => self.faults(&self.last).low_word(),
            ObjectKind::HighFaults => self.faults(&self.last).high_word(),
            ObjectKind::StateBits => self.faults(&self.last).state().0,
            ObjectKind::ResetReason => self.start.reason as u32,
            ObjectKind::Stop(what) => self.start.stop.number(what).ok_or(Abort::NoData)?,
            ObjectKind::Resets(reason) => self.start.resets(reason).into(),
            ObjectKind::Commit => self.commit,
            ObjectKind::Authority => self.authority() as u32,
            ObjectKind::Clock => self.now.0,
            ObjectKind::ReferenceElongation => nanometres(reference.elongation),
            ObjectKind::Reference(axis) => {
                let axis = reference.axes.get(usize::from(axis)).ok_or(Abort::NoSubindex)?;
                nanometres(axis.rounded())
            }
            ObjectKind::HasReference => (reference != Reference::default()).into(),
            ObjectKind::Learned(part) => {
                let part = self.state.learned().now().get(usize::from(part)).copied();
                signed(part.ok_or(Abort::NoSubindex)?.into())
            }
            ObjectKind::Tool => self.state.conditions().0.unwrap_or_default().tool.into(),
            ObjectKind::Conditions => self.state.conditions().0.unwrap_or_default().bits.into(),
            ObjectKind::ConditionsOrigin => match self.state.conditions() {
                (_, true) => 2,
                (last, false) => last.is_some().into(),
            },
            ObjectKind::Noise => self.noise_thousandths(),
            ObjectKind::Counter(counter) => self.counter(counter),
            ObjectKind::RunningCrc => identity(self.blob),
            ObjectKind::NewCrc => self.new_crc,
            ObjectKind::Utc => self.utc_s(),
            ObjectKind::MachineBoard(word) => {
                let word = self.names().board.get(usize::from(word)).copied();
                word.ok_or(Abort::NoSubindex)?
            }
            ObjectKind::Input(number) => signed(self.input(number).unwrap_or(NOT_AVAILABLE)),
            ObjectKind::InputStatus(number) => self.input(number).is_none().into(),
            ObjectKind::OfferedElongation => {
                let offered = self.offer.reference();
                offered.map_or(signed(NOT_AVAILABLE), |it| nanometres(it.elongation))
            }
            ObjectKind::Offered(axis) => {
                let axes = self.offer.reference().map(|it| it.axes);
                let axis = axes.and_then(|axes| axes.get(usize::from(axis)).copied());
                axis.map_or(signed(NOT_AVAILABLE), |axis| nanometres(axis.rounded()))
            }
            ObjectKind::ReferenceUtc => self.offer.taken().map_or(0, |write| write.utc_s),
            ObjectKind::ReferenceOrigin => self.offer.origin().into(),
            ObjectKind::ReferenceAge => self.reference_age_s().unwrap_or(u32::MAX),
            ObjectKind::FirmwareReceived
            | ObjectKind::FirmwareTag
            | ObjectKind::FirmwareRefused
            | ObjectKind::RunningSlot
            | ObjectKind::SlotVersion(_)
            | ObjectKind::SlotStatus(_)
            | ObjectKind::FirmwareFloor
            | ObjectKind::SlotChoice => self.firmware.number(what)?,
            ObjectKind::Forget
            | ObjectKind::DropNew
            | ObjectKind::FirmwareHeader
            | ObjectKind::FirmwareImage => return Err(Abort::WriteOnly),
            ObjectKind::Text(_)
            | ObjectKind::Running
            | ObjectKind::New
            | ObjectKind::WriteLog
            | ObjectKind::MachineName
            | ObjectKind::MachineSerial => {
                return Err(Abort::NoData);
            }
        })
    }
}

impl Node<'_> {
    /// Returns what a status frame about this item says.
    pub(super) fn item(&self, number: u8) -> Item {
        let short = |number: u32| u16::try_from(number).unwrap_or(u16::MAX);
        let counters = self.receiver.counters();
        match number {
            pair @ 0..=3 => {
                let first = pair.saturating_mul(2);
                let both = [first, first.saturating_add(1)];
                Item::Temperatures { pair, centi_c: both.map(|channel| self.centi_c(channel)) }
            }
            4 => Item::Elongation(self.state.elongation()),
            5 => Item::Refused {
                damaged: short(counters.crc_errors),
                out_of_sequence: short(counters.sequence_errors),
            },
            6 => {
                Item::Received { malformed: short(counters.malformed), lost: short(counters.lost) }
            }
            7 => Item::Board {
                noise_thousandths: short(self.noise_thousandths()),
                faults: self.faults(&self.last).low_bits(),
            },
            8 => Item::State(self.faults(&self.last).state()),
            9 => Item::Reset { reason: self.start.reason, free_stack: self.free_stack },
            _ => Item::Calibration(self.running_crc()),
        }
    }

    /// Returns a temperature in 0.01 °C.
    // Once in the image, not once for each channel.
    #[inline(never)]
    pub(super) fn centi_c(&self, channel: u8) -> Option<i16> {
        const STEP: i32 = 10 * Temperature::PER_MILLIKELVIN;
        let Temperature(temperature) = self.state.temperature(channel)?;
        let rounded = temperature.saturating_add(STEP / 2).div_euclid(STEP);
        // The ends are beyond what a thermometer reads.
        i16::try_from(rounded).ok().filter(|it| i32::from(*it) != NO_TEMPERATURE_RAW)
    }
}

/// Returns the abort code that a master gets for a calibration that is not loaded.
pub(super) const fn abort(error: LoadError) -> Abort {
    match error {
        LoadError::TooLong => Abort::TooLong,
        LoadError::Busy => Abort::DeviceState,
        LoadError::Refused => Abort::Value,
        LoadError::NotStored => Abort::CannotStore,
    }
}

impl Objects for Node<'_> {
    fn read(&self, what: ObjectKind) -> Result<ObjectValue<'_>, Abort> {
        Ok(ObjectValue::Bytes(match what {
            ObjectKind::Text(text) => text.as_bytes(),
            ObjectKind::Stop(Stop::File) => self.start.stop.file(),
            ObjectKind::Running if !self.blob.is_empty() => self.blob,
            ObjectKind::WriteLog if !self.log.bytes().is_empty() => self.log.bytes(),
            ObjectKind::MachineName if !self.names().machine.is_empty() => self.names().machine,
            ObjectKind::MachineSerial if !self.names().serial.is_empty() => self.names().serial,
            ObjectKind::New => self.slot.stored().ok_or(Abort::NoData)?,
            number => return self.number(number).map(ObjectValue::Number),
        }))
    }

    fn write(&mut self, what: ObjectKind, number: u32) -> Result<(), Abort> {
        let short = || u16::try_from(number).map_err(|_| Abort::Value);
        // A stranger on the bus must not change it, nor anybody under a tool that cuts.
        self.allow_change()?;
        match what {
            ObjectKind::ErrorCount if number == 0 => self.emergencies.clear(),
            ObjectKind::Inhibit => self.emergencies.set_inhibit(short()?),
            ObjectKind::ConsumerHeartbeat => self.consumer.set(number)?,
            ObjectKind::ProducerHeartbeat => {
                self.heartbeat_period_ms = short()?;
                self.since_heartbeat_ms = 0;
            }
            ObjectKind::Utc => self.set_utc_s(number),
            ObjectKind::ReferenceElongation => self.write_part(0, number)?,
            ObjectKind::Reference(axis) => self.write_part(axis.saturating_add(1), number)?,
            ObjectKind::Forget if number == BACK => self.offer_written()?,
            ObjectKind::Forget if number != FORGET => return Err(Abort::Value),
            ObjectKind::Forget => self.forget(),
            ObjectKind::DropNew if number != DROP => return Err(Abort::Value),
            ObjectKind::DropNew => self.drop_new()?,
            _ => return Err(Abort::Value),
        }
        Ok(())
    }

    fn open(&mut self, what: ObjectKind, size: Option<u32>) -> Result<(), Abort> {
        self.allow_change()?;
        match what {
            ObjectKind::FirmwareHeader | ObjectKind::FirmwareImage => {
                self.open_firmware(what, size)
            }
            _ if self.firmware_waits() => Err(Abort::DeviceState),
            _ => self.slot.open(size).map_err(abort),
        }
    }

    fn append(&mut self, what: ObjectKind, bytes: &[u8]) -> Result<(), Abort> {
        match what {
            ObjectKind::FirmwareHeader | ObjectKind::FirmwareImage => self.append_firmware(bytes),
            _ => self.slot.append(bytes).map_err(abort),
        }
    }

    fn is_ready(&self, what: ObjectKind) -> bool {
        match what {
            ObjectKind::FirmwareHeader | ObjectKind::FirmwareImage => self.is_firmware_ready(),
            // Its buffer takes all of it.
            _ => true,
        }
    }

    fn close(&mut self, what: ObjectKind) -> Result<(), Abort> {
        self.allow_change()?;
        if matches!(what, ObjectKind::FirmwareHeader | ObjectKind::FirmwareImage) {
            return self.close_firmware();
        }
        self.log.loads(!self.master.is_cnc());
        self.slot.close().map_err(abort)
    }
}
