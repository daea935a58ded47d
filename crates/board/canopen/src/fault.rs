//! The faults of a bridge, each declared once: number, error code, word, error register, state bit.
//!
//! Each source of a fault has a code of its own, so that a second loss is reported while the first lasts. The
//! number is the place in the list; it stands in byte 3 of an emergency and is the bit in objects 0x2001:09 (numbers 0
//! to 31) and 0x2001:0A (from 32 on). A new fault is added at the end.

use trueup_link::status::StateBits;

/// Bits of the error register (CiA 301), in addition to bit 0, which any fault sets.
mod error_register {
    pub const NONE: u8 = 0;
    pub const VOLTAGE: u8 = 1 << 2;
    pub const COMMUNICATION: u8 = 1 << 4;
    /// Specific to the manufacturer: the board itself.
    pub const MANUFACTURER_SPECIFIC: u8 = 1 << 7;
}

/// Declares the faults: name, error code, word, error register, and state bit where the CNC has one.
macro_rules! faults {
    ($($(#[$doc:meta])* $name:ident $code:literal $word:literal $register:ident $($state:ident)?;)*) => {
        /// A fault of the bridge.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Fault {
            $($(#[$doc])* $name,)*
        }

        impl Fault {
            /// Every fault, by its number.
            pub const ALL: [Self; [$($code),*].len()] = [$(Self::$name),*];

            /// Returns its error code. The upper byte is the class of CiA 301: 31 the supply, 50 hardware of the
            /// device, 61 its software, 63 its data, 70 an additional module, 81 communication, 82 its protocol, 90
            /// from outside, FF specific to the device.
            #[must_use]
            pub const fn code(self) -> u16 {
                match self {
                    $(Self::$name => $code,)*
                }
            }

            /// Returns its word, as tools print it.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                }
            }

            /// Returns its bit in the error register, in addition to bit 0.
            #[must_use]
            pub const fn error_register_bit(self) -> u8 {
                match self {
                    $(Self::$name => error_register::$register,)*
                }
            }

            /// Returns its bits in the state that the CNC sees; none for a fault that is no condition of it.
            #[must_use]
            pub const fn state_bits(self) -> StateBits {
                match self {
                    $(Self::$name => state_bits!($($state)?),)*
                }
            }
        }
    };
}

macro_rules! state_bits {
    () => {
        StateBits(0)
    };
    ($state:ident) => {
        StateBits::$state
    };
}

faults! {
    /// There is no valid calibration: nothing can be computed.
    NoCalibration 0x6300 "no-calibration" MANUFACTURER_SPECIFIC;
    /// The sensor reads outside its range, never changes, or reads what no sensor gives.
    Sensor 0x7001 "sensor" NONE;
    /// The converter has stopped or was overrun.
    SamplesMissing 0x7002 "samples-missing" NONE;
    /// The CNC's `Control` was received before and is missing now.
    CncLost 0x8100 "cnc-lost" COMMUNICATION;
    /// The node of object 0x1016 was received before and is silent now.
    HeartbeatLost 0x8130 "heartbeat-lost" COMMUNICATION;
    /// No fresh spindle speed.
    SpeedUnknown 0x9001 "speed-unknown" NONE;
    /// A position is outside its table.
    OutsideTable 0xFF01 "outside-table" NONE;
    /// An axis stands at its largest permitted offset.
    Clamped 0xFF02 "clamped" NONE;
    /// The board runs on a fall-back, and none of the next three says which.
    Degraded 0x5000 "degraded" MANUFACTURER_SPECIFIC;
    /// The crystal did not start.
    Crystal 0x5001 "crystal" MANUFACTURER_SPECIFIC FALLBACK_CLOCK;
    /// The PLL did not lock.
    Pll 0x5002 "pll" MANUFACTURER_SPECIFIC FALLBACK_CLOCK;
    /// The CAN controller does not answer.
    Can 0x5003 "can" MANUFACTURER_SPECIFIC;
    /// The last reset came from the watchdog.
    WatchdogReset 0x6101 "watchdog-reset" MANUFACTURER_SPECIFIC;
    /// The store of the board does not take what is to be kept.
    Store 0x5004 "store" MANUFACTURER_SPECIFIC STORE_FAILING;
    /// The board has restarted, and the CNC's engage sequence is not complete since.
    Restarted 0x6102 "restarted" MANUFACTURER_SPECIFIC RESTARTED;
    /// The heat that the machine has kept from before the start is not known.
    HeatUnknown 0xFF03 "heat-unknown" NONE HEAT_UNKNOWN;
    /// The newest calibration is damaged; an older one waits for `Confirm`.
    OlderCalibration 0x6301 "older-calibration" MANUFACTURER_SPECIFIC OLDER_CALIBRATION;
    /// The board runs on the constants of the example, and gives no offset.
    ExampleConstants 0x6302 "example-constants" MANUFACTURER_SPECIFIC EXAMPLE_CONSTANTS;
    /// The calibration names another machine or board, and waits for `Confirm`.
    ForeignMachine 0x6303 "foreign-machine" MANUFACTURER_SPECIFIC FOREIGN_MACHINE;
    /// A second master sends `Control`.
    SecondMaster 0x8201 "second-master" COMMUNICATION SECOND_MASTER;
    /// The CAN controller counts more errors than CAN calls harmless.
    CanWarning 0x8110 "can-warning" COMMUNICATION CAN_WARNING;
    /// The CAN controller is error passive.
    CanPassive 0x8120 "can-passive" COMMUNICATION CAN_ERROR_PASSIVE;
    /// The CAN controller is off the bus.
    CanOff 0x8140 "can-off" COMMUNICATION CAN_BUS_OFF;
    /// The supply of the sensor is outside its range.
    SupplyOff 0x3100 "supply-off" VOLTAGE SUPPLY_OUT_OF_RANGE;
    /// A source of the elongation that is not in use is dead.
    SourceDead 0x7003 "source-dead" NONE SOURCE_DEAD;
    /// The measured growth no longer fits the calibration.
    CalibrationUnfit 0xFF04 "calibration-unfit" NONE CALIBRATION_UNFIT;
    /// A `Zero` was not taken: the axes are not referenced, or an input is missing.
    ZeroRefused 0xFF05 "zero-refused" NONE;
    /// The last start ended by a panic, a hard fault, a stack overflow or a register that had changed.
    Stopped 0x6103 "stopped" MANUFACTURER_SPECIFIC;
    /// The board has found its image or its RAM damaged, and gives no offset.
    SelfTest 0x5005 "self-test" MANUFACTURER_SPECIFIC SELF_TEST_FAILED;
    /// A position is where its axis cannot have come so fast, and is not believed.
    PositionJump 0xFF06 "position-jump" NONE POSITION_JUMP;
    /// A learned change was not taken: of another calibration, of no part, or beyond its cap.
    LearnedRefused 0xFF07 "learned-refused" NONE;
    /// The sensor does what no spindle does: a jump, or another run-out at the same speed.
    SensorOdd 0x7004 "sensor-odd" NONE SENSOR_ANOMALOUS;
    /// A position, an angle or an operating point that the calibration needs is missing, while `Control` comes.
    PlaceLost 0x8101 "place-lost" COMMUNICATION;
    /// The thermometer of channel 0 is open, short, at a rail, silent or stuck.
    Thermometer0 0x7010 "thermometer-0" NONE;
    /// The same of channel 1.
    Thermometer1 0x7011 "thermometer-1" NONE;
    /// The same of channel 2.
    Thermometer2 0x7012 "thermometer-2" NONE;
    /// The same of channel 3.
    Thermometer3 0x7013 "thermometer-3" NONE;
    /// The same of channel 4.
    Thermometer4 0x7014 "thermometer-4" NONE;
    /// The same of channel 5.
    Thermometer5 0x7015 "thermometer-5" NONE;
    /// The same of channel 6.
    Thermometer6 0x7016 "thermometer-6" NONE;
    /// The same of channel 7.
    Thermometer7 0x7017 "thermometer-7" NONE;
    /// The thermometer of channel 0 changed faster than the mass that it measures can, and is not believed.
    TemperatureRate0 0x7020 "temperature-rate-0" NONE TEMPERATURE_RATE_EXCEEDED;
    /// The same of channel 1.
    TemperatureRate1 0x7021 "temperature-rate-1" NONE TEMPERATURE_RATE_EXCEEDED;
    /// The same of channel 2.
    TemperatureRate2 0x7022 "temperature-rate-2" NONE TEMPERATURE_RATE_EXCEEDED;
    /// The same of channel 3.
    TemperatureRate3 0x7023 "temperature-rate-3" NONE TEMPERATURE_RATE_EXCEEDED;
    /// The same of channel 4.
    TemperatureRate4 0x7024 "temperature-rate-4" NONE TEMPERATURE_RATE_EXCEEDED;
    /// The same of channel 5.
    TemperatureRate5 0x7025 "temperature-rate-5" NONE TEMPERATURE_RATE_EXCEEDED;
    /// The same of channel 6.
    TemperatureRate6 0x7026 "temperature-rate-6" NONE TEMPERATURE_RATE_EXCEEDED;
    /// The same of channel 7.
    TemperatureRate7 0x7027 "temperature-rate-7" NONE TEMPERATURE_RATE_EXCEEDED;
    /// An older reference is offered for the calibration, and waits for `Confirm` or `Zero`.
    ReferenceOffered 0x6304 "reference-offered" MANUFACTURER_SPECIFIC REFERENCE_OFFERED;
    /// The calibration was changed while no CNC was received, and waits for `Confirm`.
    CalibrationChanged 0x6305 "calibration-changed" MANUFACTURER_SPECIFIC CALIBRATION_CHANGED;
    /// The tool and the conditions that the calibration needs are missing, while `Control` comes.
    ConditionsLost 0x8102 "conditions-lost" COMMUNICATION CONDITIONS_LOST;
}

impl Fault {
    /// The loss of the thermometer of each channel.
    pub const THERMOMETER_FAULTS: [Self; 8] = [
        Self::Thermometer0,
        Self::Thermometer1,
        Self::Thermometer2,
        Self::Thermometer3,
        Self::Thermometer4,
        Self::Thermometer5,
        Self::Thermometer6,
        Self::Thermometer7,
    ];
    /// A change of each channel that is too fast.
    pub const TEMPERATURE_RATE_FAULTS: [Self; 8] = [
        Self::TemperatureRate0,
        Self::TemperatureRate1,
        Self::TemperatureRate2,
        Self::TemperatureRate3,
        Self::TemperatureRate4,
        Self::TemperatureRate5,
        Self::TemperatureRate6,
        Self::TemperatureRate7,
    ];
}

/// Some faults: bit n is [`Fault::ALL`]`[n]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults(u64);

const _: () = assert!(Fault::ALL.len() <= 64, "a bit each");

impl Faults {
    /// Returns the faults 0 to 31, a bit each, as object 0x2001:09 has them.
    #[must_use]
    pub const fn low_word(self) -> u32 {
        let [a, b, c, d, ..] = self.0.to_le_bytes();
        u32::from_le_bytes([a, b, c, d])
    }

    /// Returns the faults from 32 on, a bit each, as object 0x2001:0A has them.
    #[must_use]
    pub const fn high_word(self) -> u32 {
        let [.., a, b, c, d] = self.0.to_le_bytes();
        u32::from_le_bytes([a, b, c, d])
    }

    /// Returns the faults 0 to 15, as the status and object 0x2001:04 have them.
    #[must_use]
    pub const fn low_half_word(self) -> u16 {
        let [low, high, ..] = self.0.to_le_bytes();
        u16::from_le_bytes([low, high])
    }

    /// Returns the faults of both words, 0x2001:09 and 0x2001:0A.
    #[must_use]
    pub fn from_words(low: u32, high: u32) -> Self {
        Self(u64::from(high) << 32 | u64::from(low))
    }

    /// Returns the bits that a CNC must know in addition to the offsets.
    #[must_use]
    pub fn state_bits(self) -> StateBits {
        let bit =
            |bits: StateBits, fault: Fault| bits.with_if(self.contains(fault), fault.state_bits());
        Fault::ALL.into_iter().fold(StateBits::default(), bit)
    }

    /// Returns these, and `fault` if `condition` holds.
    #[must_use]
    pub const fn with_fault_if(self, condition: bool, fault: Fault) -> Self {
        if condition { Self(self.0 | 1 << fault as u32) } else { self }
    }

    /// Returns these without `fault`.
    #[must_use]
    pub const fn without_fault(self, fault: Fault) -> Self {
        Self(self.0 & !(1 << fault as u32))
    }

    /// Returns whether `fault` is among them.
    #[must_use]
    pub const fn contains(self, fault: Fault) -> bool {
        self.0 & 1 << fault as u32 != 0
    }

    /// Returns the faults that are in either.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the error register of CiA 301.
    #[must_use]
    pub fn error_register(self) -> u8 {
        Fault::ALL
            .into_iter()
            .filter(|fault| self.contains(*fault))
            .fold(0, |register, fault| register | 1 | fault.error_register_bit())
    }
}
