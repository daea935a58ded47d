//! `Status`: what the bridge says of itself while it runs, one item a frame, ten frames a second, so
//! that each item comes every 1.1 s. Items 11 to 13 come from a bridge whose axes grow along their way alone, and then
//! each item comes every 1.5 s and the state (8) at least every 0.9 s: [`ITEM_SEQUENCE`].
//!
//! | item | bits 32…47 | bits 48…63 |
//! |---|---|---|
//! | 0…3 | temperature of channel 0, 2, 4, 6 in 0.01 °C | of channel 1, 3, 5, 7 |
//! | 4 | elongation of the spindle, 32 bits, in 0.001 µm | |
//! | 5 | frames of the CNC that were damaged | that were repeated or out of sequence |
//! | 6 | frames of the CNC with a wrong length or value | that never came |
//! | 7 | RMS noise of the sensor in 0.001 codes | faults 0…15, a bit each: the numbers of `Fault` in the DBC |
//! | 8 | state, 32 bits: [`StateBits`] | |
//! | 9 | reason of the last reset: [`ResetReason`] | bytes of the stack that were never used |
//! | 10 | CRC of the running calibration, 32 bits; 0: there is none | |
//! | 11…13 | constant of the offset of X, Y, Z in 0.1 µm | its slope in 0.1 µm/m |
//!
//! The most negative number of a temperature and of the elongation means "not available"; counts
//! stop at 65 535. Every frame says in bits 28…31 why a frame of the CNC was last refused, and is
//! protected as the offsets are.

use trueup_core::units::Nanometres;

use crate::{
    frame::Frame,
    frames::{self, DecodeError},
    layout::{
        CALIBRATION_CRC, ELONGATION, FIRST_COUNT, FIRST_TEMPERATURE, LAST_REFUSED,
        NO_ELONGATION_RAW, NO_OFFSET_CONSTANT_RAW, NO_TEMPERATURE_RAW, OFFSET_CONSTANT,
        OFFSET_SLOPE, SECOND_COUNT, SECOND_TEMPERATURE, STATE_BITS, STATUS_ID, STATUS_ITEM,
    },
};

/// The largest number of an item.
pub const MAX_ITEM_NUMBER: u8 = 13;

/// How many frames it takes until each item has come, with slopes.
pub const STATUS_FRAMES_PER_CYCLE: u8 = 15;

/// The items in the order in which they come; without a slope only the first [`ITEM_COUNT_WITHOUT_SLOPES`] of them.
pub const ITEM_SEQUENCE: [u8; STATUS_FRAMES_PER_CYCLE as usize] =
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 8];
/// How many of [`ITEM_SEQUENCE`] a bridge without a slope sends.
pub const ITEM_COUNT_WITHOUT_SLOPES: u8 = 11;
/// Axes that a slope is sent of.
const SLOPE_AXIS_COUNT: u8 = 3;

/// Content of a `Status` frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Why a frame of the CNC was last refused.
    pub last_refused: FrameRejectReason,
    /// The item that this frame carries.
    pub item: StatusItem,
}

/// Why a frame of the CNC was refused. The numbers are those on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum FrameRejectReason {
    /// None was refused since the start.
    #[default]
    None = 0,
    /// Its length or a value in it is wrong.
    Malformed = 1,
    /// Its CRC is wrong: damaged, or sent under another identifier.
    Damaged = 2,
    /// It has the counter of the frame before.
    Repeated = 3,
    /// Its counter has moved too far.
    WrongSequence = 4,
}

impl FrameRejectReason {
    /// Returns the reason with this number on the wire.
    #[must_use]
    pub const fn from_wire(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::None,
            1 => Self::Malformed,
            2 => Self::Damaged,
            3 => Self::Repeated,
            4 => Self::WrongSequence,
            _ => return None,
        })
    }
}

/// Item of a `Status` frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatusItem {
    /// Two temperature channels.
    Temperatures {
        /// Which two, 0…3: channels 2·n and 2·n + 1. A larger number counts as 3.
        pair: u8,
        /// In 0.01 °C; `None`: not available.
        centi_c: [Option<i16>; 2],
    },
    /// The elongation of the spindle by its sensor; `None`: not available.
    Elongation(Option<Nanometres>),
    /// Frames of the CNC whose protection does not hold, since the start.
    Refused {
        /// Their CRC was wrong.
        damaged: u16,
        /// They were repeated or out of sequence.
        out_of_sequence: u16,
    },
    /// Other frames of the CNC, since the start.
    Received {
        /// Their length or a value in them was wrong.
        malformed: u16,
        /// They never came.
        lost: u16,
    },
    /// How the board is.
    Board {
        /// RMS noise of the raw codes in thousandths of a code.
        noise_thousandths: u16,
        /// Faults, bit n is fault n of the DBC's `Fault`; those from 16 on are in
        /// [`StatusItem::State`].
        faults: u16,
    },
    /// Conditions of the bridge that a CNC must know in addition to the offsets.
    State(StateBits),
    /// How the board came to run.
    Reset {
        /// Why it last started.
        reason: ResetReason,
        /// Bytes of the stack that were never used; 65 535 stands for all beyond.
        free_stack: u16,
    },
    /// CRC of the running calibration; 0: there is none.
    Calibration(u32),
    /// The offset of an axis in two parts: constant + slope·(P − P₀), P₀ the `origin_mm` of its thermal law.
    Slope {
        /// X, Y, Z: 0…2. A larger number counts as 2.
        axis: u8,
        /// In 0.1 µm; `None`: not available.
        constant: Option<i16>,
        /// In 0.1 µm/m.
        slope: i16,
    },
}

/// Conditions of the bridge that a CNC must know in addition to the offsets: one bit each, 0 where all is well.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StateBits(pub u32);

impl StateBits {
    /// It has restarted, and `Engage` has not been received as 0, 0, 0 and then 1 since.
    pub const RESTARTED: Self = Self(1 << 0);
    /// The heat that the machine has kept from before the start is not known.
    pub const HEAT_UNKNOWN: Self = Self(1 << 1);
    /// The newest calibration is damaged; an older one is loaded and waits for `Confirm`.
    pub const OLDER_CALIBRATION: Self = Self(1 << 2);
    /// It runs on the constants of the example: no offset is ever given.
    pub const EXAMPLE_CONSTANTS: Self = Self(1 << 3);
    /// The calibration names another machine or board, and waits for `Confirm`.
    pub const FOREIGN_MACHINE: Self = Self(1 << 4);
    /// A second master sends `Control`.
    pub const SECOND_MASTER: Self = Self(1 << 5);
    /// The CAN controller counts more errors than CAN calls harmless (96).
    pub const CAN_WARNING: Self = Self(1 << 6);
    /// The CAN controller is error passive.
    pub const CAN_ERROR_PASSIVE: Self = Self(1 << 7);
    /// The CAN controller is off the bus.
    pub const CAN_BUS_OFF: Self = Self(1 << 8);
    /// The board runs on a clock other than its crystal's.
    pub const FALLBACK_CLOCK: Self = Self(1 << 9);
    /// The supply of the sensor is outside its range.
    pub const SUPPLY_OUT_OF_RANGE: Self = Self(1 << 10);
    /// The store does not take what is to be kept.
    pub const STORE_FAILING: Self = Self(1 << 11);
    /// A source of the elongation that is not in use is dead.
    pub const SOURCE_DEAD: Self = Self(1 << 12);
    /// The measurements no longer fit the calibration.
    pub const CALIBRATION_UNFIT: Self = Self(1 << 13);
    /// The board has found itself damaged: its image or its RAM. It gives no offset.
    pub const SELF_TEST_FAILED: Self = Self(1 << 14);
    /// A position is where its axis cannot have come so fast, and is not believed.
    pub const POSITION_JUMP: Self = Self(1 << 15);
    /// The sensor shows something that no spindle does: a jump, or another run-out at the same speed.
    pub const SENSOR_ANOMALOUS: Self = Self(1 << 16);
    /// An older reference of the calibration is offered, and waits for `Confirm` or `Zero`.
    pub const REFERENCE_OFFERED: Self = Self(1 << 17);
    /// The calibration was changed while no CNC was received, and waits for `Confirm`.
    pub const CALIBRATION_CHANGED: Self = Self(1 << 18);
    /// A thermometer changed faster than the mass that it measures can, and is not believed.
    pub const TEMPERATURE_RATE_EXCEEDED: Self = Self(1 << 19);
    /// Tool and conditions are lost: a hold, then the stated defaults.
    pub const CONDITIONS_LOST: Self = Self(1 << 20);
    /// Every bit that has a meaning, with its word.
    pub const NAMES: [(Self, &'static str); 21] = [
        (Self::RESTARTED, "restarted"),
        (Self::HEAT_UNKNOWN, "heat-unknown"),
        (Self::OLDER_CALIBRATION, "older-calibration"),
        (Self::EXAMPLE_CONSTANTS, "example-constants"),
        (Self::FOREIGN_MACHINE, "foreign-machine"),
        (Self::SECOND_MASTER, "second-master"),
        (Self::CAN_WARNING, "can-warning"),
        (Self::CAN_ERROR_PASSIVE, "can-passive"),
        (Self::CAN_BUS_OFF, "can-off"),
        (Self::FALLBACK_CLOCK, "fall-back-clock"),
        (Self::SUPPLY_OUT_OF_RANGE, "supply-off"),
        (Self::STORE_FAILING, "store-failing"),
        (Self::SOURCE_DEAD, "source-dead"),
        (Self::CALIBRATION_UNFIT, "calibration-unfit"),
        (Self::SELF_TEST_FAILED, "self-test"),
        (Self::POSITION_JUMP, "position-jump"),
        (Self::SENSOR_ANOMALOUS, "sensor-odd"),
        (Self::REFERENCE_OFFERED, "reference-offered"),
        (Self::CALIBRATION_CHANGED, "calibration-changed"),
        (Self::TEMPERATURE_RATE_EXCEEDED, "temperature-rate"),
        (Self::CONDITIONS_LOST, "conditions-lost"),
    ];

    /// These bits, and `other` if `condition` holds.
    #[must_use]
    pub const fn with_if(self, condition: bool, other: Self) -> Self {
        if condition { Self(self.0 | other.0) } else { self }
    }

    /// Returns whether every bit of `other` is set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// Why the board last started. The numbers are those on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum ResetReason {
    /// The board does not say.
    #[default]
    Unknown = 0,
    /// The supply was switched on.
    PowerOn = 1,
    /// The reset pin.
    Pin = 2,
    /// The watchdog: a task hung.
    Watchdog = 3,
    /// The firmware itself, because a master or a load requested it.
    Software = 4,
    /// The supply was too low for a moment.
    BrownOut = 5,
    /// The firmware stopped itself: a panic.
    Panic = 6,
    /// The core stopped it: a hard fault.
    HardFault = 7,
    /// The crystal stopped.
    Crystal = 8,
    /// The stack ran into its guard.
    StackOverflow = 9,
    /// A register of the chip was found other than it was set up.
    Registers = 10,
}

impl ResetReason {
    /// How many there are; the numbers on the wire are those below.
    pub const COUNT: usize = 11;

    /// Returns the reason with this number on the wire.
    #[must_use]
    pub const fn from_wire(number: u16) -> Option<Self> {
        Some(match number {
            0 => Self::Unknown,
            1 => Self::PowerOn,
            2 => Self::Pin,
            3 => Self::Watchdog,
            4 => Self::Software,
            5 => Self::BrownOut,
            6 => Self::Panic,
            7 => Self::HardFault,
            8 => Self::Crystal,
            9 => Self::StackOverflow,
            10 => Self::Registers,
            _ => return None,
        })
    }

    /// In a word.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::PowerOn => "power-on",
            Self::Pin => "pin",
            Self::Watchdog => "watchdog",
            Self::Software => "software",
            Self::BrownOut => "brown-out",
            Self::Panic => "panic",
            Self::HardFault => "hard-fault",
            Self::Crystal => "crystal",
            Self::StackOverflow => "stack-overflow",
            Self::Registers => "registers",
        }
    }
}

/// Returns the frame that says this. `counter` counts the frames of this identifier.
///
/// ```
/// use trueup_link::status::{self, StatusItem, FrameRejectReason, Status};
/// let item = StatusItem::Temperatures { pair: 1, centi_c: [Some(2_345), None] };
/// let frame = status::encode(&Status { last_refused: FrameRejectReason::Damaged, item }, 7);
/// // Item 1, reason 2, 2345 = 0x0929, and 0x8000 for "not available".
/// assert_eq!(frame.data()[2..], [0x07, 0x21, 0x29, 0x09, 0x00, 0x80]);
/// assert_eq!(status::decode(&frame)?.item, item);
/// # Ok::<(), trueup_link::frames::DecodeError>(())
/// ```
#[must_use]
pub fn encode(status: &Status, counter: u8) -> Frame {
    let mut data = [0; 8];
    LAST_REFUSED.insert(&mut data, status.last_refused as i32);
    let number = match status.item {
        StatusItem::Temperatures { pair, centi_c: [low, high] } => {
            FIRST_TEMPERATURE.insert(&mut data, low.map_or(NO_TEMPERATURE_RAW, i32::from));
            SECOND_TEMPERATURE.insert(&mut data, high.map_or(NO_TEMPERATURE_RAW, i32::from));
            pair.min(3)
        }
        StatusItem::Elongation(elongation) => {
            ELONGATION
                .insert(&mut data, elongation.map_or(NO_ELONGATION_RAW, |elongation| elongation.0));
            4
        }
        StatusItem::Refused { damaged, out_of_sequence } => {
            insert_counts(&mut data, 5, damaged, out_of_sequence)
        }
        StatusItem::Received { malformed, lost } => insert_counts(&mut data, 6, malformed, lost),
        StatusItem::Board { noise_thousandths, faults } => {
            insert_counts(&mut data, 7, noise_thousandths, faults)
        }
        StatusItem::State(StateBits(bits)) => {
            STATE_BITS.insert(&mut data, bits.cast_signed());
            8
        }
        StatusItem::Reset { reason, free_stack } => {
            insert_counts(&mut data, 9, reason as u16, free_stack)
        }
        StatusItem::Calibration(crc) => {
            CALIBRATION_CRC.insert(&mut data, crc.cast_signed());
            10
        }
        StatusItem::Slope { axis, constant, slope } => {
            OFFSET_CONSTANT.insert(&mut data, constant.map_or(NO_OFFSET_CONSTANT_RAW, i32::from));
            OFFSET_SLOPE.insert(&mut data, slope.into());
            axis.min(SLOPE_AXIS_COUNT.saturating_sub(1)).saturating_add(ITEM_COUNT_WITHOUT_SLOPES)
        }
    };
    STATUS_ITEM.insert(&mut data, number.into());
    frames::build_protected_frame(STATUS_ID, counter, data)
}

fn insert_counts(data: &mut [u8; 8], item: u8, low: u16, high: u16) -> u8 {
    FIRST_COUNT.insert(data, low.into());
    SECOND_COUNT.insert(data, high.into());
    item
}

/// Returns what a `Status` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or an item or a reason that has no meaning.
pub fn decode(frame: &Frame) -> Result<Status, DecodeError> {
    let data = frames::checked_frame_data(frame, STATUS_ID, 8)?;
    let reason = frames::extract_byte(LAST_REFUSED, data);
    let last_refused = FrameRejectReason::from_wire(reason)
        .ok_or(DecodeError::Value { signal: "LastRefused", raw: reason.into() })?;
    let count = |signal: crate::signal::Signal| {
        let [low, high, ..] = signal.extract(data).to_le_bytes();
        u16::from_le_bytes([low, high])
    };
    let temperature = |signal: crate::signal::Signal| {
        let raw = signal.extract(data);
        i16::try_from(raw).ok().filter(|_| raw != NO_TEMPERATURE_RAW)
    };
    let item = match frames::extract_byte(STATUS_ITEM, data) {
        pair @ 0..=3 => {
            let centi_c = [FIRST_TEMPERATURE, SECOND_TEMPERATURE].map(temperature);
            StatusItem::Temperatures { pair, centi_c }
        }
        4 => {
            let raw = ELONGATION.extract(data);
            StatusItem::Elongation((raw != NO_ELONGATION_RAW).then_some(Nanometres(raw)))
        }
        5 => StatusItem::Refused {
            damaged: count(FIRST_COUNT),
            out_of_sequence: count(SECOND_COUNT),
        },
        6 => StatusItem::Received { malformed: count(FIRST_COUNT), lost: count(SECOND_COUNT) },
        7 => {
            StatusItem::Board { noise_thousandths: count(FIRST_COUNT), faults: count(SECOND_COUNT) }
        }
        8 => StatusItem::State(StateBits(STATE_BITS.extract(data).cast_unsigned())),
        9 => {
            let raw = count(FIRST_COUNT);
            let reason = ResetReason::from_wire(raw)
                .ok_or(DecodeError::Value { signal: "ResetReason", raw: raw.into() })?;
            StatusItem::Reset { reason, free_stack: count(SECOND_COUNT) }
        }
        10 => StatusItem::Calibration(CALIBRATION_CRC.extract(data).cast_unsigned()),
        number @ ITEM_COUNT_WITHOUT_SLOPES..=MAX_ITEM_NUMBER => {
            let short = |signal: crate::signal::Signal| i16::try_from(signal.extract(data));
            StatusItem::Slope {
                axis: number.saturating_sub(ITEM_COUNT_WITHOUT_SLOPES),
                constant: short(OFFSET_CONSTANT)
                    .ok()
                    .filter(|raw| i32::from(*raw) != NO_OFFSET_CONSTANT_RAW),
                slope: short(OFFSET_SLOPE).unwrap_or_default(),
            }
        }
        other => return Err(DecodeError::Value { signal: "Item", raw: other.into() }),
    };
    Ok(Status { last_refused, item })
}

#[cfg(test)]
mod tests;
