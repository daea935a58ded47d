//! The messages between the bridge and the CNC, apart from how they look on the wire.

use crate::{
    learned_changes::LearnedChangeRequest,
    units::{MicroDegrees, Nanometres, Position, Rpm},
};

/// A valid message from the CNC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CncMessage {
    /// The CNC's sign of life, and what it allows the bridge to do.
    Control(Control),
    /// Speed and load of the spindle.
    Spindle(SpindleState),
    /// Where a linear axis is sent.
    Position(AxisPosition),
    /// Where the rotary axes of the head are sent.
    Rotary(RotaryAxisAngles),
    /// The tool and the switches of the machine.
    Conditions(MachineConditions),
}

/// The CNC's sign of life, and what it allows the bridge to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Control {
    /// The operator wants offsets.
    pub engage: bool,
    /// The axes are referenced (homed): before that no offset is given.
    pub referenced: bool,
    /// Take the present error as the reference, at the moment this turns from false to true.
    pub zero: bool,
    /// The operator allows that a master writes to the bridge while nothing is engaged.
    pub service: bool,
    /// The operator confirms what the bridge requires, at the moment this turns from false
    /// to true.
    pub confirm: bool,
    /// A learned change of a part of the correction.
    pub learned: LearnedChangeRequest,
}

impl Control {
    /// The operator wants offsets, and the axes are referenced.
    pub const ENGAGED: Self = Self {
        engage: true,
        referenced: true,
        zero: false,
        service: false,
        confirm: false,
        learned: LearnedChangeRequest { part: 0, amount: 0, calibration: 0 },
    };
    /// The axes are referenced, and nothing else.
    pub const REFERENCED: Self = Self { engage: false, ..Self::ENGAGED };
}

/// Speed and load of the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpindleState {
    /// Speed in r/min, 0…65 535, whichever way it turns.
    pub speed: Rpm,
    /// Axial cutting force in newtons; pushing the tool back is positive.
    pub load_n: i16,
}

/// The tool in the spindle, and the switches of the machine that a correction may depend on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MachineConditions {
    /// The number of the tool; 0: none.
    pub tool: u16,
    /// A bit for each condition.
    pub bits: u16,
}

impl MachineConditions {
    /// Returns whether the condition of this bit, 0…15, holds.
    #[must_use]
    pub const fn is_set(self, bit: u8) -> bool {
        self.bits & 1_u16.wrapping_shl(bit as u32) != 0
    }
}

/// A linear axis of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinearAxis {
    /// X.
    X,
    /// Y.
    Y,
    /// Z.
    Z,
}

impl LinearAxis {
    /// All three, in their order everywhere.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];
}

/// Where a linear axis is sent.
///
/// The position is the commanded one *without* the external offset: with it, the offset would
/// become the input of the next offset and chase itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisPosition {
    /// The axis whose position it is.
    pub axis: LinearAxis,
    /// Commanded position in machine coordinates, in 10 nm: ±21.47 m.
    pub position: Position,
    /// Which way the axis came there, as the CNC says.
    pub direction: TravelDirection,
}

/// Which way a linear axis heads. The numbers are those on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(i8)]
pub enum TravelDirection {
    /// Towards smaller positions.
    Negative = -1,
    /// Nowhere, or the CNC does not say.
    #[default]
    Standing = 0,
    /// Towards larger positions.
    Positive = 1,
}

impl TravelDirection {
    /// Returns the heading with this number on the wire.
    #[must_use]
    pub const fn from_wire(number: i8) -> Option<Self> {
        Some(match number {
            -1 => Self::Negative,
            0 => Self::Standing,
            1 => Self::Positive,
            _ => return None,
        })
    }
}

/// Where the rotary axes of the head are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RotaryAxisAngles {
    /// Commanded angles, in the order of the machine's head axes: from the frame to the tool.
    pub angles: [MicroDegrees; 2],
}

/// How good an offset is. The numbers are those on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum OffsetQuality {
    /// Not engaged, the offset is 0.
    #[default]
    Off = 0,
    /// Every configured input is fresh.
    Live = 1,
    /// From the temperature model.
    TemperatureModel = 2,
    /// From the warm-up model.
    WarmUpModel = 3,
    /// An input or the CNC is lost: the last offset is held for a while.
    Hold = 4,
    /// On the way to 0, at the slew limit.
    RampingOut = 5,
    /// No offset can be given: not available.
    Fault = 6,
}

impl OffsetQuality {
    /// Returns the quality with this number on the wire.
    #[must_use]
    pub fn from_wire(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::Off,
            1 => Self::Live,
            2 => Self::TemperatureModel,
            3 => Self::WarmUpModel,
            4 => Self::Hold,
            5 => Self::RampingOut,
            6 => Self::Fault,
            _ => return None,
        })
    }
}

/// Why an offset is not simply the full correction: one bit a reason, as on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OffsetFlags(pub u8);

impl OffsetFlags {
    /// Nothing to report.
    pub const NONE: Self = Self(0);
    /// An axis stands at its largest permitted offset.
    pub const CLAMPED: Self = Self(1 << 0);
    /// An axis is still on its way to its target at the slew limit.
    pub const SLEWING: Self = Self(1 << 1);
    /// The sensor reads outside its range, or a reading that never changes.
    pub const SENSOR_FAULT: Self = Self(1 << 2);
    /// Samples are missing: the converter has stopped or was overrun.
    pub const SAMPLES_MISSING: Self = Self(1 << 3);
    /// The CNC was received before and is silent now.
    pub const CNC_LOST: Self = Self(1 << 4);
    /// No fresh spindle speed: run-out is averaged over 200 ms, not over revolutions.
    pub const SPEED_UNKNOWN: Self = Self(1 << 5);
    /// A position is outside its table, and the end value is held.
    pub const OUTSIDE_TABLE: Self = Self(1 << 6);
    /// The board runs on a fall-back: a dead crystal, PLL or CAN controller.
    pub const BOARD_DEGRADED: Self = Self(1 << 7);

    /// These flags and `other`.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// These flags, and `other` if `condition` holds.
    #[must_use]
    pub const fn with_if(self, condition: bool, other: Self) -> Self {
        if condition { self.union(other) } else { self }
    }

    /// Returns whether every flag of `other` is set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// The output of one tick to the CNC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Output {
    /// The offset that the CNC adds to its command on X, Y and Z; `None`: not available.
    pub offset: Option<[Nanometres; 3]>,
    /// How good it is.
    pub quality: OffsetQuality,
    /// Why it is not simply the full correction.
    pub flags: OffsetFlags,
    /// Milliseconds since the newest sample that the offset rests on; 255 stands for all beyond.
    pub age_ms: u8,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_of_a_heading_and_a_quality_on_the_wire_is_its_own_and_no_other_is_one() {
        for number in i8::MIN..=i8::MAX {
            let heading = TravelDirection::from_wire(number);
            assert_eq!(heading.is_some(), (-1..=1).contains(&number), "{number}");
            assert!(heading.is_none_or(|heading| heading as i8 == number), "{number}");
        }
        for number in 0..=u8::MAX {
            let quality = OffsetQuality::from_wire(number);
            assert_eq!(quality.is_some(), number <= 6, "{number}");
            assert!(quality.is_none_or(|quality| quality as u8 == number), "{number}");
        }
    }

    #[test]
    fn a_flag_that_is_set_again_stays_and_several_are_there_when_each_is() {
        let both = OffsetFlags::CLAMPED.union(OffsetFlags::CNC_LOST);
        assert_eq!(both.union(OffsetFlags::CLAMPED), both);
        assert_eq!(
            both.with_if(true, OffsetFlags::CNC_LOST).with_if(false, OffsetFlags::SLEWING),
            both
        );
        assert!(both.contains(both) && both.contains(OffsetFlags::CLAMPED));
        assert!(!OffsetFlags::CLAMPED.contains(both));
    }

    #[test]
    fn each_flag_has_a_bit_of_its_own_in_their_order() {
        let all = [
            OffsetFlags::CLAMPED,
            OffsetFlags::SLEWING,
            OffsetFlags::SENSOR_FAULT,
            OffsetFlags::SAMPLES_MISSING,
            OffsetFlags::CNC_LOST,
            OffsetFlags::SPEED_UNKNOWN,
            OffsetFlags::OUTSIDE_TABLE,
            OffsetFlags::BOARD_DEGRADED,
        ];
        for (number, flag) in all.into_iter().enumerate() {
            assert_eq!(flag, OffsetFlags(1 << number));
        }
    }
}
