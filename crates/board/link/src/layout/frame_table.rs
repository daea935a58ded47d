//! Every frame and signal of `trueup.dbc`, declared once: the constants of `layout` follow from
//! this table, and `dbc` prints the file from it. The board's image holds no more of it than the
//! constants that the code uses.
//!
//! All signals have Intel byte order and the offset 0.
#![cfg_attr(not(test), expect(dead_code, reason = "only a test prints the file"))]

use super::{
    CONDITIONS_PERIOD_MS, CONTROL_PERIOD_MS, HEARTBEAT_PERIOD_MS, MICRO_DEGREES_PER_BIT,
    NANOMETRES_PER_BIT, NO_ELONGATION_RAW, NO_OFFSET_RAW, NO_TEMPERATURE_RAW, OFFSET_PERIOD_MS,
    POSITION_PERIOD_MS, ROTARY_PERIOD_MS, SPINDLE_PERIOD_MS, STATUS_PERIOD_MS,
};
use crate::{
    frames::NmtState,
    signal::Signal,
    status::{FrameRejectReason, MAX_ITEM_NUMBER, ResetReason},
};
use trueup_core::{
    cnc::{OffsetQuality, TravelDirection},
    units::{MicroDegrees, NANOMETRES_PER_MICROMETRE, Position},
};

/// One frame.
pub(crate) struct FrameSpec {
    pub id: u16,
    pub name: &'static str,
    pub len: u8,
    /// `Bridge` or `CNC`; the other one receives it.
    pub sender: &'static str,
    /// Milliseconds from one to the next, at least; 0: sent by the event alone.
    pub period_ms: u32,
    /// Without the sentence on the protection.
    pub comment: &'static str,
    /// Those that it shares with other frames, and its own.
    pub signals: [&'static [SignalSpec]; 2],
}

/// One signal.
#[derive(Clone, Copy)]
pub(crate) struct SignalSpec {
    pub name: &'static str,
    pub place: Signal,
    pub multiplexing: Multiplexing,
    /// Numerator and denominator, a power of ten, of the value of one bit.
    pub factor: (i32, i32),
    pub unit: &'static str,
    /// The smallest and the largest raw value.
    pub range: (i64, i64),
    /// Raw values with a name.
    pub names: &'static [(i32, &'static str)],
    pub comment: &'static str,
}

/// Whether a signal is in every frame of its identifier.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Multiplexing {
    None,
    /// It says which item the frame carries.
    Selector,
    /// It is in frames of this item.
    Item(u8),
}

impl FrameSpec {
    pub fn signals(&self) -> impl Iterator<Item = &'static SignalSpec> {
        self.signals.into_iter().flatten()
    }

    pub fn is_protected(&self) -> bool {
        self.signals().any(|signal| signal.name == "Crc")
    }
}

/// Returns a signal at this place, whose bits count 1 each and may have any value.
const fn unscaled_signal(place: Signal) -> SignalSpec {
    let range = if !place.signed && place.length == 32 {
        (0, u32::MAX as i64)
    } else {
        (place.min_raw() as i64, place.max_raw() as i64)
    };
    SignalSpec {
        name: "",
        place,
        multiplexing: Multiplexing::None,
        factor: (1, 1),
        unit: "",
        range,
        names: &[],
        comment: "",
    }
}

const fn unsigned_signal(start: u8, length: u8) -> SignalSpec {
    unscaled_signal(Signal::unsigned(start, length))
}

const fn signed_signal(start: u8, length: u8) -> SignalSpec {
    unscaled_signal(Signal::signed(start, length))
}

const fn offset(start: u8) -> SignalSpec {
    signed_signal(start, 20)
        .with_factor_and_unit(NANOMETRES_PER_BIT, NANOMETRES_PER_MICROMETRE, "um")
        .with_symmetric_range()
        .named(&[(NO_OFFSET_RAW, "NotAvailable")])
}

const fn temperature(place: Signal, item: u8) -> SignalSpec {
    unscaled_signal(place)
        .with_multiplexer_value(item)
        .with_factor_and_unit(1, 100, "degC")
        .with_symmetric_range()
        .named(&[(NO_TEMPERATURE_RAW, "NotAvailable")])
}

impl SignalSpec {
    const fn with_multiplexer_value(self, item: u8) -> Self {
        Self { multiplexing: Multiplexing::Item(item), ..self }
    }

    const fn with_multiplexer_role(self) -> Self {
        Self { multiplexing: Multiplexing::Selector, ..self }
    }

    const fn with_factor_and_unit(
        self,
        numerator: i32,
        denominator: i32,
        unit: &'static str,
    ) -> Self {
        Self { factor: (numerator, denominator), unit, ..self }
    }

    const fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    const fn with_range(self, min: i32, max: i32) -> Self {
        Self { range: (min as i64, max as i64), ..self }
    }

    /// Leaves out the smallest raw value, which means "not available".
    const fn with_symmetric_range(self) -> Self {
        self.with_range(self.place.min_raw().saturating_add(1), self.place.max_raw())
    }

    const fn named(self, names: &'static [(i32, &'static str)]) -> Self {
        Self { names, ..self }
    }

    const fn with_name_and_comment(self, name: &'static str, comment: &'static str) -> Self {
        Self { name, comment, ..self }
    }
}

/// Numbers and names: of an enum, or as written.
macro_rules! names {
    ($enum:ident: $($name:ident)*) => { &[$(($enum::$name as i32, stringify!($name))),*] };
    ($($number:literal $name:ident,)*) => { &[$(($number, stringify!($name))),*] };
}

/// The table from an entry for each frame (identifier: name, bytes, sender, period, signals that it
/// shares, comment) and one for each signal of its own (name: place, comment). The identifiers and
/// the places with `as` become public constants.
macro_rules! frames {
    ($($id:ident = $number:literal: $frame:literal, $len:literal, $sender:ident, $period:expr, $shared:expr,
        $about:literal {
        $($name:literal $(as $place:ident)?: $spec:expr, $comment:expr;)*
    })*) => {
        /// Every frame, by rising identifier.
        pub(crate) const FRAMES: &[FrameSpec] = &[$(FrameSpec {
            id: $id,
            name: $frame,
            len: $len,
            sender: stringify!($sender),
            period_ms: $period,
            comment: $about,
            signals: [$shared, &[$($spec.with_name_and_comment($name, $comment)),*]],
        }),*];
        $(
            #[doc = $about]
            pub const $id: u16 = $number;
        )*
        $($($(
            #[doc = $comment]
            pub const $place: Signal = $spec.place;
        )?)*)*
    };
}

macro_rules! temperature {
    ($channel:literal) => {
        concat!(
            "Temperature of channel ",
            $channel,
            " of the machine file. Raw -32768 means not available: nothing is connected there, or \
             it cannot be believed."
        )
    };
}

macro_rules! constant {
    ($axis:literal) => {
        concat!(
            "The offset of ",
            $axis,
            " is this + OffsetSlope",
            $axis,
            " * (P - P0), P0 the origin_mm of its thermal law: everything but the slope. For a \
             control that multiplies by its own position. Raw -32768 means not available. Sent \
             only by a bridge with a law of temperature that grows along an axis."
        )
    };
}

macro_rules! slope {
    ($axis:literal) => {
        concat!("Of the offset of ", $axis, ": minus the slope of the error; um for one metre.")
    };
}

macro_rules! condition {
    ($bit:literal) => {
        concat!("1: the condition with bit = ", $bit, " in the machine file holds.")
    };
}

/// E2E CRC, in every protected frame.
pub const CRC: Signal = Signal::unsigned(0, 16);
/// E2E counter, in every protected frame.
pub const E2E_COUNTER: Signal = Signal::unsigned(16, 8);
/// Position of a linear axis: one bit is one unit of [`Position`].
pub const POSITION: Signal = Signal::signed(24, 32);
/// Which way that axis travels.
pub const DIRECTION: Signal = Signal::signed(56, 2);
/// The first of a status frame's two temperatures, in 0.01 °C.
pub const FIRST_TEMPERATURE: Signal = Signal::signed(32, 16);
/// The second one.
pub const SECOND_TEMPERATURE: Signal = Signal::signed(48, 16);
/// The first of a status frame's two counts.
pub const FIRST_COUNT: Signal = Signal::unsigned(32, 16);
/// The second one.
pub const SECOND_COUNT: Signal = Signal::unsigned(48, 16);
/// The constant of an axis's offset, in 0.1 µm.
pub const OFFSET_CONSTANT: Signal = Signal::signed(32, 16);
/// The slope of an axis's offset, in 0.1 µm/m.
pub const OFFSET_SLOPE: Signal = Signal::signed(48, 16);
/// All conditions.
pub const CONDITIONS: Signal = Signal::unsigned(CONDITION_0.start, 16);

const CRC_SPEC: SignalSpec =
    unscaled_signal(CRC).with_name_and_comment("Crc", "E2E profile 5 CRC-16, low byte first.");
const CYCLE_PROTECTION_SIGNALS: &[SignalSpec] = &[
    CRC_SPEC,
    unscaled_signal(E2E_COUNTER)
        .with_name_and_comment("Counter", "Counts cycles, 255 is followed by 0."),
];
const FRAME_COUNTER_SPEC: SignalSpec = unscaled_signal(E2E_COUNTER)
    .with_name_and_comment("Counter", "Counts frames of this identifier, 255 is followed by 0.");
const PROTECTION_SIGNALS: &[SignalSpec] = &[CRC_SPEC, FRAME_COUNTER_SPEC];
const POSITION_SIGNALS: &[SignalSpec] = &[
    CRC_SPEC,
    FRAME_COUNTER_SPEC,
    unscaled_signal(POSITION).with_factor_and_unit(1, Position::PER_MILLIMETRE, "mm").with_name_and_comment(
        "Position",
        "Commanded machine position without the external offset: with feedback the offset would \
         chase itself. 10 nm a bit.",
    ),
    unscaled_signal(DIRECTION)
        .with_range(TravelDirection::Negative as i32, TravelDirection::Positive as i32)
        .named(names!(TravelDirection: Negative Standing Positive))
        .with_name_and_comment(
            "Direction",
            "Which way the axis travels. Raw -2 has no meaning: the frame is refused.",
        ),
];

const QUALITY_NAMES: &[(i32, &str)] =
    names!(OffsetQuality: Off Live TemperatureModel WarmUpModel Hold RampingOut Fault);
const REJECT_REASON_NAMES: &[(i32, &str)] =
    names!(FrameRejectReason: None Malformed Damaged Repeated WrongSequence);
const RESET_REASON_NAMES: &[(i32, &str)] = names!(ResetReason: Unknown PowerOn Pin Watchdog Software
    BrownOut Panic HardFault Crystal StackOverflow Registers);
const NMT_STATE_NAMES: &[(i32, &str)] = names!(NmtState: BootUp Stopped Operational PreOperational);
/// The faults of `trueup_canopen`, which needs this crate; a test there compares them with the file.
const FAULT_NAMES: &[(i32, &str)] = names! {
    0 NoCalibration, 1 Sensor, 2 SamplesMissing, 3 CncLost, 4 HeartbeatLost, 5 SpeedUnknown,
    6 OutsideTable, 7 Clamped, 8 Degraded, 9 Crystal, 10 Pll, 11 Can, 12 WatchdogReset, 13 Store,
    14 Restarted, 15 HeatUnknown, 16 OlderCalibration, 17 ExampleConstants, 18 ForeignMachine,
    19 SecondMaster, 20 CanWarning, 21 CanPassive, 22 CanOff, 23 SupplyOff, 24 SourceDead,
    25 CalibrationUnfit, 26 ZeroRefused, 27 Stopped, 28 SelfTest, 29 PositionJump,
    30 LearnedRefused, 31 SensorOdd, 32 PlaceLost, 33 Thermometer0, 34 Thermometer1,
    35 Thermometer2, 36 Thermometer3, 37 Thermometer4, 38 Thermometer5, 39 Thermometer6,
    40 Thermometer7, 41 TemperatureRate0, 42 TemperatureRate1, 43 TemperatureRate2,
    44 TemperatureRate3, 45 TemperatureRate4, 46 TemperatureRate5, 47 TemperatureRate6,
    48 TemperatureRate7, 49 ReferenceOffered, 50 CalibrationChanged, 51 ConditionsLost,
};

frames! {
    EMERGENCY_ID = 0x081: "Emergency", 8, Bridge, 0, &[],
        "CANopen emergency (CiA 301) of node 1: sent once when a fault comes and once, with the error code 0, when \
         it has gone; at most one every 10 ms. Not protected. CANopen SDO (identifiers 0x601 and 0x581) and \
         network management are described by trueup.eds." {
        "ErrorCode" as EMERGENCY_CODE: unsigned_signal(0, 16),
            "Code of the fault that has come; 0: the fault named by Fault has gone.";
        "ErrorRegister" as EMERGENCY_REGISTER: unsigned_signal(16, 8),
            "CANopen error register of the faults that are there: bit 0 any, bit 4 communication, bit 7 the board.";
        "Fault" as EMERGENCY_FAULT: unsigned_signal(24, 8).named(FAULT_NAMES), "Which fault has come or gone.";
        "Flags" as EMERGENCY_FLAGS: unsigned_signal(32, 8), "The flags of that moment, as in OffsetZ.";
        "Quality" as EMERGENCY_QUALITY: unsigned_signal(40, 8).with_range(0, OffsetQuality::Fault as i32).named(QUALITY_NAMES),
            "The quality of that moment, as in OffsetZ.";
    }
    OFFSET_XY_ID = 0x181: "OffsetXY", 8, Bridge, OFFSET_PERIOD_MS, CYCLE_PROTECTION_SIGNALS,
        "First half of a cycle's offsets. It shares Counter with OffsetZ: apply both or neither." {
        "OffsetX" as OFFSET_X: offset(24),
            "To be added to the commanded X. 10 nm a bit. Raw -524288 means not available.";
        "OffsetY" as OFFSET_Y: offset(44),
            "To be added to the commanded Y. 10 nm a bit. Raw -524288 means not available.";
    }
    POSITION_X_ID = 0x201: "PositionX", 8, CNC, POSITION_PERIOD_MS, POSITION_SIGNALS,
        "Where X is sent, up to 500 times a second." {}
    SPINDLE_ID = 0x202: "Spindle", 8, CNC, SPINDLE_PERIOD_MS, PROTECTION_SIGNALS,
        "What the spindle does, up to 50 times a second." {
        "Speed" as SPEED: unsigned_signal(24, 16).unit("r/min"), "Spindle speed, whichever way it turns.";
        "Load" as LOAD: signed_signal(40, 16).unit("N"), "Axial cutting force; pushing the tool back is positive.";
    }
    OFFSET_Z_ID = 0x281: "OffsetZ", 8, Bridge, OFFSET_PERIOD_MS, CYCLE_PROTECTION_SIGNALS,
        "Second half of a cycle's offsets. It shares Counter with OffsetXY: apply both or neither." {
        "OffsetZ" as OFFSET_Z: offset(24),
            "To be added to the commanded Z. 10 nm a bit. Raw -524288 means not available.";
        "Quality" as QUALITY: unsigned_signal(44, 4).with_range(0, OffsetQuality::Fault as i32).named(QUALITY_NAMES),
            "How good the offsets of X, Y and Z are, and what a CNC does. Off: offset 0. Live: every configured \
             input is fresh. TemperatureModel, WarmUpModel: by a fall-back; apply it, warn the operator. Hold: an \
             input or the CNC is lost; apply it, warn. RampingOut: the same. Fault: not available, or waiting \
             after a start; take the own offset to 0 by a ramp and send Engage 0 until it is there, then 1.";
        "Flags" as FLAGS: unsigned_signal(48, 8),
            "Why the offsets are not simply the full correction. Bit 0: an axis stands at its largest permitted \
             offset. Bit 1: an axis is on its way at the slew limit. Bit 2: the sensor or a thermometer reads \
             outside its range, or the sensor never changes. Bit 3: samples are missing. Bit 4: the CNC sent before and is silent now, or a needed position or angle is missing. Bit 5: no fresh \
             spindle speed. Bit 6: a position is outside its table, whose end value is held. Bit 7: the board runs \
             on a fall-back (crystal, PLL or CAN dead).";
        "Age" as SAMPLE_AGE: unsigned_signal(56, 8).unit("ms"),
            "Age of the oldest input that the offsets rest on: the newest sample, and the positions and angles of \
             axes that move; 255 stands for all beyond.";
    }
    POSITION_Y_ID = 0x301: "PositionY", 8, CNC, POSITION_PERIOD_MS, POSITION_SIGNALS,
        "Where Y is sent, up to 500 times a second." {}
    CONTROL_ID = 0x302: "Control", 8, CNC, CONTROL_PERIOD_MS, PROTECTION_SIGNALS,
        "The CNC's sign of life, up to 50 times a second. Nothing is engaged before the first; without one for the \
         link timeout the CNC counts as lost." {
        "Engage" as ENGAGE: unsigned_signal(24, 1),
            "1: the operator requests offsets. After every start of the bridge it counts only once it was 0 in three \
             frames in a row; raise it only while the offset that is applied is 0.";
        "Referenced" as REFERENCED: unsigned_signal(25, 1),
            "1: the axes are referenced (homed); before that no offset is given.";
        "Zero" as ZERO: unsigned_signal(26, 1),
            "From 0 to 1, while Referenced is 1: take the present error as the reference. It counts once it was 1 \
             in three frames in a row; one that is shorter or refused is an emergency.";
        "Service" as SERVICE: unsigned_signal(27, 1),
            "1: a master may write to the bridge (a calibration, its settings, a restart) while Engage is 0 and no offset is applied.";
        "Confirm" as CONFIRM: unsigned_signal(28, 1),
            "From 0 to 1, and 1 in three frames in a row: the operator answers one question of StateBits, the \
             first that is set of bits 4, 2 and 1: the calibration is meant for this machine, the older one is \
             right, the machine is cold.";
        "LearnedPart" as LEARNED_PART: unsigned_signal(29, 3),
            "Which part of the correction Learned changes, also while Engage is 1: 1 the growth of the spindle, 2, \
             3, 4 the expansion of X, Y, Z, 5 the zero of the growth; 0: none, and earlier values stay. They are lost with the power, so send each again and again, one a frame. Send 0 of a part to take it back.";
        "Learned" as LEARNED: signed_signal(32, 16).with_factor_and_unit(1, 1_000, ""),
            "Change of the part relative to the calibration: in percent of itself, the zero in um. Refused beyond the caps that the calibration states; an emergency reports it. The bridge goes there by 0.001 in \
             100 ms.";
        "LearnedCrc" as LEARNED_CRC: unsigned_signal(48, 16),
            "The lower 16 bits of CalibrationCrc (Status, item 10): what is meant for another calibration is \
             refused.";
    }
    STATUS_ID = 0x381: "Status", 8, Bridge, STATUS_PERIOD_MS, PROTECTION_SIGNALS,
        "Status of the bridge, ten frames a second: Item states what a frame is about, each of the eleven in turn, so each comes every 1.1 s. It changes no offset; a CNC may leave it alone." {
        "Item" as STATUS_ITEM: unsigned_signal(24, 4).with_range(0, MAX_ITEM_NUMBER as i32).with_multiplexer_role(),
            "What this frame is about: 0 to 3 two temperatures, 4 the elongation, 5 and 6 the frames of the CNC, 7 \
             the board, 8 its state, 9 its last reset, 10 its calibration, 11 to 13 the offset of X, Y, Z as \
             constant and slope.";
        "LastRefused" as LAST_REFUSED: unsigned_signal(28, 4)
                .with_range(0, FrameRejectReason::WrongSequence as i32)
                .named(REJECT_REASON_NAMES),
            "Why a frame of the CNC was last refused.";
        "Temperature0": temperature(FIRST_TEMPERATURE, 0), temperature!(0);
        "Temperature1": temperature(SECOND_TEMPERATURE, 0), temperature!(1);
        "Temperature2": temperature(FIRST_TEMPERATURE, 1), temperature!(2);
        "Temperature3": temperature(SECOND_TEMPERATURE, 1), temperature!(3);
        "Temperature4": temperature(FIRST_TEMPERATURE, 2), temperature!(4);
        "Temperature5": temperature(SECOND_TEMPERATURE, 2), temperature!(5);
        "Temperature6": temperature(FIRST_TEMPERATURE, 3), temperature!(6);
        "Temperature7": temperature(SECOND_TEMPERATURE, 3), temperature!(7);
        "Elongation" as ELONGATION: signed_signal(32, 32).with_multiplexer_value(4)
                .with_factor_and_unit(1, NANOMETRES_PER_MICROMETRE, "um")
                .with_symmetric_range()
                .named(&[(NO_ELONGATION_RAW, "NotAvailable")]),
            "Elongation of the spindle by its sensor, before the reference that Zero has taken and before the \
             limits. Raw -2147483648 means not available.";
        "Damaged": unscaled_signal(FIRST_COUNT).with_multiplexer_value(5),
            "Frames of the CNC with a wrong CRC since the start. This and the other counts stop at 65535.";
        "OutOfSequence": unscaled_signal(SECOND_COUNT).with_multiplexer_value(5),
            "Frames of the CNC that were repeated or out of sequence since the start.";
        "Malformed": unscaled_signal(FIRST_COUNT).with_multiplexer_value(6),
            "Frames of the CNC with a wrong length or a value without meaning since the start.";
        "Lost": unscaled_signal(SECOND_COUNT).with_multiplexer_value(6),
            "Frames of the CNC that never came, from the gaps in its counters, since the start.";
        "Noise": unscaled_signal(FIRST_COUNT).with_multiplexer_value(7).with_factor_and_unit(1, 1_000, ""),
            "RMS noise of the sensor in codes of the converter, over the last second.";
        "Faults": unscaled_signal(SECOND_COUNT).with_multiplexer_value(7),
            "What is wrong now: the bit of each of the faults 0 to 15 is its number in Emergency.Fault; objects \
             0x2001:09 and 0x2001:0A have all.";
        "StateBits" as STATE_BITS: unsigned_signal(32, 32).with_multiplexer_value(8),
            "State of the bridge for the CNC in addition to the offsets, 0 where all is well. Bit 0: restarted; the engage sequence \
             (Engage 0, 0, 0, then 1) is not complete. Bit 1: the heat stored in the machine before the start is not known. Bit 2: the newest calibration is damaged, an older one waits for Confirm. Bit 3: the \
             constants of the example, never an offset. Bit 4: the calibration names another machine or board and \
             waits for Confirm. Bit 5: a second master sends Control. Bit 6: CAN warning. Bit 7: CAN error \
             passive. Bit 8: CAN bus off. Bit 9: a fall-back clock. Bit 10: the supply is off. Bit 11: the store \
             fails. Bit 12: a source of the elongation that is not in use is dead. Bit 13: what is measured no \
             longer fits the calibration. Bit 14: the board is damaged. Bit 15: a position out of reach. Bit 16: \
             the sensor jumped, or its run-out changed. Bit 17: an older reference is offered and waits for \
             Confirm or Zero. Bit 18: the calibration was changed while no CNC was sending and waits for Confirm. \
             Bit 19: a thermometer changed faster than its mass can and is not believed. Bit 20: Conditions are \
             lost. Each comes as an emergency as well.";
        "ResetReason": unscaled_signal(FIRST_COUNT).with_multiplexer_value(9).with_range(0, ResetReason::Crystal as i32).named(RESET_REASON_NAMES),
            "Why the board last started.";
        "FreeStack": unscaled_signal(SECOND_COUNT).with_multiplexer_value(9).unit("byte"), "Bytes of the stack that were never used.";
        "CalibrationCrc" as CALIBRATION_CRC: unsigned_signal(32, 32).with_multiplexer_value(10),
            "CRC of the calibration that the bridge runs on, as compile and show print it; 0: it has none.";
        "OffsetConstantX": unscaled_signal(OFFSET_CONSTANT).with_multiplexer_value(11).with_factor_and_unit(1, 10, "um").with_symmetric_range(), constant!("X");
        "OffsetSlopeX": unscaled_signal(OFFSET_SLOPE).with_multiplexer_value(11).with_factor_and_unit(1, 10, "um/m"), slope!("X");
        "OffsetConstantY": unscaled_signal(OFFSET_CONSTANT).with_multiplexer_value(12).with_factor_and_unit(1, 10, "um").with_symmetric_range(), constant!("Y");
        "OffsetSlopeY": unscaled_signal(OFFSET_SLOPE).with_multiplexer_value(12).with_factor_and_unit(1, 10, "um/m"), slope!("Y");
        "OffsetConstantZ": unscaled_signal(OFFSET_CONSTANT).with_multiplexer_value(13).with_factor_and_unit(1, 10, "um").with_symmetric_range(), constant!("Z");
        "OffsetSlopeZ": unscaled_signal(OFFSET_SLOPE).with_multiplexer_value(13).with_factor_and_unit(1, 10, "um/m"), slope!("Z");
    }
    POSITION_Z_ID = 0x401: "PositionZ", 8, CNC, POSITION_PERIOD_MS, POSITION_SIGNALS,
        "Where Z is sent, up to 500 times a second." {}
    CONDITIONS_ID = 0x402: "Conditions", 8, CNC, CONDITIONS_PERIOD_MS, PROTECTION_SIGNALS,
        "The tool in the spindle and the conditions of the machine, up to 20 times a second; needed where the \
         calibration depends on them. Without one for four link timeouts they are lost: the offset is held, then \
         goes by the defaults of the machine file at the slew limit." {
        "Tool" as TOOL: unsigned_signal(24, 16),
            "Number of the tool in the spindle, as [spindle.tools] of the machine file has it; 0: none.";
        "Condition0" as CONDITION_0: unsigned_signal(40, 1), condition!(0);
        "Condition1": unsigned_signal(41, 1), condition!(1);
        "Condition2": unsigned_signal(42, 1), condition!(2);
        "Condition3": unsigned_signal(43, 1), condition!(3);
        "Condition4": unsigned_signal(44, 1), condition!(4);
        "Condition5": unsigned_signal(45, 1), condition!(5);
        "Condition6": unsigned_signal(46, 1), condition!(6);
        "Condition7": unsigned_signal(47, 1), condition!(7);
        "Condition8": unsigned_signal(48, 1), condition!(8);
        "Condition9": unsigned_signal(49, 1), condition!(9);
        "Condition10": unsigned_signal(50, 1), condition!(10);
        "Condition11": unsigned_signal(51, 1), condition!(11);
        "Condition12": unsigned_signal(52, 1), condition!(12);
        "Condition13": unsigned_signal(53, 1), condition!(13);
        "Condition14": unsigned_signal(54, 1), condition!(14);
        "Condition15": unsigned_signal(55, 1), condition!(15);
    }
    ROTARY_ID = 0x501: "Rotary", 8, CNC, ROTARY_PERIOD_MS, PROTECTION_SIGNALS,
        "Where the rotary axes that carry the spindle are sent, up to 500 times a second." {
        "Angle1" as ANGLE_1: signed_signal(24, 20).with_factor_and_unit(MICRO_DEGREES_PER_BIT, MicroDegrees::PER_DEGREE, "deg"),
            "Commanded angle of the first of the machine file's head_axes, counted from the frame to the tool. An \
             axis that turns on and on is sent within one turn. 0 if there is none.";
        "Angle2" as ANGLE_2: signed_signal(44, 20).with_factor_and_unit(MICRO_DEGREES_PER_BIT, MicroDegrees::PER_DEGREE, "deg"),
            "Commanded angle of the second of the machine file's head_axes, as Angle1.";
    }
    HEARTBEAT_ID = 0x701: "Heartbeat", 1, Bridge, HEARTBEAT_PERIOD_MS, &[],
        "CANopen heartbeat (CiA 301) of node 1. Not protected." {
        "State" as NMT_STATE: unsigned_signal(0, 7).named(NMT_STATE_NAMES),
            "CANopen state of the bridge. Bit 7 of the byte is reserved and sent as 0.";
    }
}
