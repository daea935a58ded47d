//! Emergencies (CiA 301): every fault of the bridge is told once when it comes and once when it has
//! gone.
//!
//! | bytes | content |
//! |---|---|
//! | 0–1 | error code, see [`Fault::code`]; 0x0000: the fault of byte 3 has gone |
//! | 2 | error register, of what is left: bit 0 any fault, bit 2 the supply, bit 4 communication, bit 7 the board |
//! | 3 | which fault: its place in [`Fault::ALL`] |
//! | 4 | the flags, as in `OffsetZ` |
//! | 5 | the quality, as in `OffsetZ` |
//! | 6–7 | 0 |
//!
//! Between two emergencies at least the inhibit time passes. A fault that comes and goes meanwhile
//! is told all the same, so a flickering one costs no more of the bus than a lasting one, and none
//! is overlooked.

use trueup_core::cnc::{Flags, Output, Quality};
use trueup_link::{
    frame::Frame,
    frames::{self, DecodeError},
    layout::{
        EMERGENCY_CODE, EMERGENCY_FAULT, EMERGENCY_FLAGS, EMERGENCY_ID, EMERGENCY_INHIBIT_MS,
        EMERGENCY_QUALITY, EMERGENCY_REGISTER,
    },
    status::StateBits,
};

/// Emergencies that are remembered.
pub const HISTORY: usize = 8;

/// What can be wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Fault {
    /// There is no valid calibration: nothing can be computed.
    NoCalibration = 0,
    /// The sensor or a thermometer reads outside its range, or the sensor never changes.
    Sensor,
    /// The converter has stopped or was overrun.
    SamplesMissing,
    /// The CNC was heard before and is silent now, or does not send what is needed.
    CncLost,
    /// The node of object 0x1016 was heard before and is silent now.
    HeartbeatLost,
    /// No fresh spindle speed.
    SpeedUnknown,
    /// A position is outside its table.
    OutsideTable,
    /// An axis stands at its largest permitted offset.
    Clamped,
    /// The board runs on a fall-back, and none of the next three says which.
    Degraded,
    /// The crystal did not start.
    Crystal,
    /// The PLL did not lock.
    Pll,
    /// The CAN controller does not answer.
    Can,
    /// The last reset came from the watchdog.
    WatchdogReset,
    /// The store of the board does not take what is to be kept.
    Store,
    /// The board has restarted, and the CNC's engage sequence is not complete since.
    Restarted,
    /// What heat the machine has kept from before the start is not known.
    HeatUnknown,
    /// The newest calibration is damaged; an older one waits for `Confirm`.
    OlderCalibration,
    /// The board runs on the constants of the example, and gives no offset.
    ExampleConstants,
    /// The calibration names another machine or board, and waits for `Confirm`.
    ForeignMachine,
    /// A second master sends `Control`.
    SecondMaster,
    /// The CAN controller counts more errors than CAN calls harmless.
    CanWarning,
    /// The CAN controller is error passive.
    CanPassive,
    /// The CAN controller is off the bus.
    CanOff,
    /// The supply of the sensor is outside its range.
    SupplyOff,
    /// A source of the elongation that is not in use is dead.
    SourceDead,
    /// What is measured no longer fits the calibration.
    CalibrationUnfit,
    /// A `Zero` was not taken: the axes are not referenced, or an input is missing.
    ZeroRefused,
    /// The last start ended by a panic, a hard fault, a stack overflow or a register that had changed.
    Stopped,
    /// The board has found its image or its RAM damaged, and gives no offset.
    SelfTest,
    /// A position is where its axis cannot have come so fast, and is not believed.
    PositionJump,
    /// A learned change was not taken: of another calibration, of no part, or beyond its cap.
    LearnedRefused,
    /// The sensor tells of something that no spindle does: a jump, or another run-out at the same speed.
    SensorOdd,
}

impl Fault {
    /// Every fault, by its number.
    pub const ALL: [Self; 32] = [
        Self::NoCalibration,
        Self::Sensor,
        Self::SamplesMissing,
        Self::CncLost,
        Self::HeartbeatLost,
        Self::SpeedUnknown,
        Self::OutsideTable,
        Self::Clamped,
        Self::Degraded,
        Self::Crystal,
        Self::Pll,
        Self::Can,
        Self::WatchdogReset,
        Self::Store,
        Self::Restarted,
        Self::HeatUnknown,
        Self::OlderCalibration,
        Self::ExampleConstants,
        Self::ForeignMachine,
        Self::SecondMaster,
        Self::CanWarning,
        Self::CanPassive,
        Self::CanOff,
        Self::SupplyOff,
        Self::SourceDead,
        Self::CalibrationUnfit,
        Self::ZeroRefused,
        Self::Stopped,
        Self::SelfTest,
        Self::PositionJump,
        Self::LearnedRefused,
        Self::SensorOdd,
    ];

    /// Its error code. The upper byte is the class of CiA 301: 31 the supply, 50 hardware of the device, 61 its
    /// software, 63 its data, 70 an additional module, 81 communication, 82 its protocol, 90 from outside, FF
    /// specific to the device.
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::NoCalibration => 0x6300,
            Self::Sensor => 0x7001,
            Self::SamplesMissing => 0x7002,
            Self::CncLost => 0x8100,
            Self::HeartbeatLost => 0x8130,
            Self::SpeedUnknown => 0x9001,
            Self::OutsideTable => 0xFF01,
            Self::Clamped => 0xFF02,
            Self::Degraded => 0x5000,
            Self::Crystal => 0x5001,
            Self::Pll => 0x5002,
            Self::Can => 0x5003,
            Self::WatchdogReset => 0x6101,
            Self::Store => 0x5004,
            Self::Restarted => 0x6102,
            Self::HeatUnknown => 0xFF03,
            Self::OlderCalibration => 0x6301,
            Self::ExampleConstants => 0x6302,
            Self::ForeignMachine => 0x6303,
            Self::SecondMaster => 0x8201,
            Self::CanWarning => 0x8110,
            Self::CanPassive => 0x8120,
            Self::CanOff => 0x8140,
            Self::SupplyOff => 0x3100,
            Self::SourceDead => 0x7003,
            Self::CalibrationUnfit => 0xFF04,
            Self::ZeroRefused => 0xFF05,
            Self::Stopped => 0x6103,
            Self::SelfTest => 0x5005,
            Self::PositionJump => 0xFF06,
            Self::LearnedRefused => 0xFF07,
            Self::SensorOdd => 0x7004,
        }
    }

    /// Its bit in the error register, beside bit 0, which any fault sets.
    const fn register(self) -> u8 {
        match self {
            Self::CncLost
            | Self::HeartbeatLost
            | Self::SecondMaster
            | Self::CanWarning
            | Self::CanPassive
            | Self::CanOff => 1 << 4,
            Self::NoCalibration
            | Self::Degraded
            | Self::Crystal
            | Self::Pll
            | Self::Can
            | Self::WatchdogReset
            | Self::Store
            | Self::Restarted
            | Self::OlderCalibration
            | Self::ExampleConstants
            | Self::ForeignMachine
            | Self::Stopped
            | Self::SelfTest => 1 << 7,
            // The voltage bit of CiA 301.
            Self::SupplyOff => 1 << 2,
            Self::Sensor
            | Self::SamplesMissing
            | Self::SpeedUnknown
            | Self::OutsideTable
            | Self::Clamped
            | Self::HeatUnknown
            | Self::SourceDead
            | Self::CalibrationUnfit
            | Self::ZeroRefused
            | Self::PositionJump
            | Self::LearnedRefused
            | Self::SensorOdd => 0,
        }
    }
}

/// Some faults: bit n is [`Fault::ALL`]`[n]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults(u32);

impl Faults {
    /// A bit each: bit n is set for [`Fault::ALL`]`[n]`.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// The first sixteen of them, as the status and object 0x2001:04 have them; 0x2001:09 has all.
    #[must_use]
    pub const fn low_bits(self) -> u16 {
        let [low, high, ..] = self.0.to_le_bytes();
        u16::from_le_bytes([low, high])
    }

    /// The same for the CNC: what it must know beside the offsets.
    #[must_use]
    pub fn state(self) -> StateBits {
        let bit = |bits: StateBits, (fault, bit)| bits.with_if(self.has(fault), bit);
        [
            (Fault::Restarted, StateBits::RESTARTED),
            (Fault::HeatUnknown, StateBits::HEAT_UNKNOWN),
            (Fault::OlderCalibration, StateBits::OLDER_CALIBRATION),
            (Fault::ExampleConstants, StateBits::EXAMPLE_CONSTANTS),
            (Fault::ForeignMachine, StateBits::FOREIGN_MACHINE),
            (Fault::SecondMaster, StateBits::SECOND_MASTER),
            (Fault::CanWarning, StateBits::CAN_WARNING),
            (Fault::CanPassive, StateBits::CAN_PASSIVE),
            (Fault::CanOff, StateBits::CAN_OFF),
            (Fault::Crystal, StateBits::FALL_BACK_CLOCK),
            (Fault::Pll, StateBits::FALL_BACK_CLOCK),
            (Fault::SupplyOff, StateBits::SUPPLY_OFF),
            (Fault::Store, StateBits::STORE_FAILING),
            (Fault::SourceDead, StateBits::SOURCE_DEAD),
            (Fault::CalibrationUnfit, StateBits::CALIBRATION_UNFIT),
            (Fault::SelfTest, StateBits::SELF_TEST),
            (Fault::PositionJump, StateBits::POSITION_JUMP),
            (Fault::SensorOdd, StateBits::SENSOR_ODD),
        ]
        .into_iter()
        .fold(StateBits::default(), bit)
    }

    /// These, and `fault` if `condition` holds.
    #[must_use]
    pub const fn with_if(self, condition: bool, fault: Fault) -> Self {
        if condition { Self(self.0 | 1 << fault as u32) } else { self }
    }

    /// These but `fault`.
    #[must_use]
    pub const fn without(self, fault: Fault) -> Self {
        Self(self.0 & !(1 << fault as u32))
    }

    /// Whether `fault` is among them.
    #[must_use]
    pub const fn has(self, fault: Fault) -> bool {
        self.0 & 1 << fault as u32 != 0
    }

    /// Those that an output tells of.
    #[must_use]
    pub const fn of(output: &Output) -> Self {
        Self(0)
            .with_if(output.flags.contains(Flags::SENSOR_FAULT), Fault::Sensor)
            .with_if(output.flags.contains(Flags::SAMPLES_MISSING), Fault::SamplesMissing)
            .with_if(output.flags.contains(Flags::CNC_LOST), Fault::CncLost)
            .with_if(output.flags.contains(Flags::SPEED_UNKNOWN), Fault::SpeedUnknown)
            .with_if(output.flags.contains(Flags::OUTSIDE_TABLE), Fault::OutsideTable)
            .with_if(output.flags.contains(Flags::CLAMPED), Fault::Clamped)
    }

    /// The faults that are in either.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The error register of CiA 301.
    #[must_use]
    pub fn register(self) -> u8 {
        Fault::ALL
            .into_iter()
            .filter(|fault| self.has(*fault))
            .fold(0, |register, fault| register | 1 | fault.register())
    }
}

/// What an emergency says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// The error code; 0: the fault has gone.
    pub code: u16,
    /// The error register of what is left.
    pub register: u8,
    /// Which fault has come or gone.
    pub fault: Fault,
    /// The flags of that moment.
    pub flags: Flags,
    /// The quality of that moment.
    pub quality: Quality,
}

/// The frame that says this.
#[must_use]
pub fn encode(emergency: &Emergency) -> Frame {
    let mut data = [0; 8];
    EMERGENCY_CODE.insert(&mut data, emergency.code.into());
    EMERGENCY_REGISTER.insert(&mut data, emergency.register.into());
    EMERGENCY_FAULT.insert(&mut data, emergency.fault as i32);
    EMERGENCY_FLAGS.insert(&mut data, emergency.flags.0.into());
    EMERGENCY_QUALITY.insert(&mut data, emergency.quality as i32);
    Frame::full(EMERGENCY_ID, data)
}

/// What an emergency frame says. It is not protected: it informs, and nothing rests on it.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a fault or quality that has no meaning.
pub fn decode(frame: &Frame) -> Result<Emergency, DecodeError> {
    let data = frames::data_of(frame, EMERGENCY_ID, 8)?;
    let [low, high, ..] = EMERGENCY_CODE.extract(data).to_le_bytes();
    let (fault, quality) =
        (frames::byte(EMERGENCY_FAULT, data), frames::byte(EMERGENCY_QUALITY, data));
    Ok(Emergency {
        code: u16::from_le_bytes([low, high]),
        register: frames::byte(EMERGENCY_REGISTER, data),
        fault: Fault::ALL
            .into_iter()
            .find(|it| *it as u8 == fault)
            .ok_or(DecodeError::Value { signal: "Fault", raw: fault.into() })?,
        flags: Flags(frames::byte(EMERGENCY_FLAGS, data)),
        quality: Quality::from_wire(quality)
            .ok_or(DecodeError::Value { signal: "Quality", raw: quality.into() })?,
    })
}

/// What is told of the faults, and what was.
#[derive(Clone, Debug)]
pub struct Emergencies {
    /// Told as there.
    told: Faults,
    /// There at some time since they were last told as gone.
    seen: Faults,
    history: heapless::Deque<u32, HISTORY>,
    /// In 0.1 ms.
    inhibit: u16,
    since_ms: u32,
}

impl Default for Emergencies {
    fn default() -> Self {
        Self {
            told: Faults::default(),
            seen: Faults::default(),
            history: heapless::Deque::new(),
            inhibit: default_inhibit(),
            since_ms: u32::MAX,
        }
    }
}

fn default_inhibit() -> u16 {
    u16::try_from(EMERGENCY_INHIBIT_MS.saturating_mul(10)).unwrap_or(u16::MAX)
}

impl Emergencies {
    /// Sets the shortest time between two emergencies to what it is at the start.
    pub fn reset_inhibit(&mut self) {
        self.inhibit = default_inhibit();
    }

    /// Notes the faults of a tick.
    pub fn note(&mut self, elapsed_ms: u32, now: Faults) {
        self.since_ms = self.since_ms.saturating_add(elapsed_ms);
        self.seen = self.seen.and(now);
    }

    /// The next emergency, if one is due and may be sent.
    pub fn next(&mut self, now: Faults, output: &Output) -> Option<Frame> {
        if self.since_ms.saturating_mul(10) < self.inhibit.into() {
            return None;
        }
        let has_come = |fault: &Fault| self.seen.has(*fault) && !self.told.has(*fault);
        let has_gone = |fault: &Fault| self.told.has(*fault) && !now.has(*fault);
        let (fault, code) = if let Some(fault) = Fault::ALL.into_iter().find(has_come) {
            (fault, fault.code())
        } else {
            (Fault::ALL.into_iter().find(has_gone)?, 0)
        };
        let bit = 1 << fault as u32;
        if code == 0 {
            self.told.0 &= !bit;
            self.seen.0 &= !bit;
        } else {
            self.told.0 |= bit;
            self.remember(code, fault);
        }
        self.since_ms = 0;
        let (register, flags, quality) = (self.told.register(), output.flags, output.quality);
        Some(encode(&Emergency { code, register, fault, flags, quality }))
    }

    /// The error code below, the fault's number above it.
    fn remember(&mut self, code: u16, fault: Fault) {
        if self.history.is_full() {
            self.history.pop_back();
        }
        // There is room now.
        self.history.push_front(u32::from(code) | (fault as u32) << 16).ok();
    }

    /// How many errors are remembered.
    #[must_use]
    pub fn count(&self) -> usize {
        self.history.len()
    }

    /// A remembered error, the newest being 0: the code, and in bits 16…23 the fault.
    #[must_use]
    pub fn error(&self, number: u8) -> Option<u32> {
        self.history.iter().nth(number.into()).copied()
    }

    /// Forgets the errors of the past.
    pub fn clear(&mut self) {
        self.history.clear();
    }

    /// The shortest time between two emergencies in 0.1 ms.
    #[must_use]
    pub const fn inhibit(&self) -> u16 {
        self.inhibit
    }

    /// Sets the shortest time between two emergencies, in 0.1 ms; 0: none.
    pub const fn set_inhibit(&mut self, tenths_of_ms: u16) {
        self.inhibit = tenths_of_ms;
    }
}

#[cfg(test)]
mod tests;
