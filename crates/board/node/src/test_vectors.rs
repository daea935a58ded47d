//! Random inputs of a node, the same on every machine: what proves that board and host compute the
//! same to the bit.
//!
//! A vector is one millisecond: frames from the CNC as often as the wire has them, positions that
//! walk and now and then jump, codes, temperatures. Faults come in phases of 4 s, so long that the
//! link is given up, the offset held, and the hold ends, and go in phases of 4 s. Every frame that
//! the node sends goes into an FNV-1a checksum. The random
//! numbers are xorshift32 (Marsaglia 2003, shifts 13, 17 and 5).

use heapless::Vec;
use trueup_core::{
    bridge::TickInput,
    calibration::Calibration,
    cnc::{
        AxisPosition, Control, LinearAxis, MachineConditions, RotaryAxisAngles, SpindleState,
        TravelDirection,
    },
    design_parameters::CODES_PER_TICK,
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    temperature_channels::RawTemperatures,
    term::Effect,
    thermometer::RawTemperatureReading,
    units::{AdcCode, MicroDegrees, Position, Rpm},
};
use trueup_link::{
    frame::Frame,
    frames::{self, CONDITIONS_PERIOD_MS, CONTROL_PERIOD_MS, POSITION_PERIOD_MS, ROTARY_PERIOD_MS},
};

use crate::node::{Interface, Node, OffsetFrames};

/// Where X, Y and Z go, from 0, in positions: a large gantry, and a little beyond its tables.
const AXIS_TRAVELS: [u32; 3] = [1_435_000_000, 301_000_000, 251_000_000];
/// A PT100 at 20 °C in micro-ohms, and a linear chain at 20 °C in 1/256 codes: 4000 + 16·20 counts of
/// 10 V/32768 behind a divider of 0.328.
const READINGS_AT_20_C: [u32; 2] = [107_793_500, 137_403];
/// And up to 40 K above.
const MAX_TEMPERATURE_RISE_MK: u32 = 40_000;

/// Milliseconds of a phase, as a power of two: 4 s, longer than the default silence after which the
/// CNC is lost (0.5 s) and the hold after that (2 s) together.
const PHASE_MS_LOG2: u32 = 12;
/// The faults of every other phase, in turn.
const INJECTED_FAULT_SEQUENCE: [InjectedFault; 6] = [
    InjectedFault::NoPositions,
    InjectedFault::NoAngles,
    InjectedFault::SilentCnc,
    InjectedFault::Disengaged,
    InjectedFault::SensorAtRail,
    InjectedFault::NoTemperatures,
];
/// Vectors until every fault has been there, with the phase before each.
pub const VECTORS_PER_FAULT_CYCLE: u32 = (2 * INJECTED_FAULT_COUNT) << PHASE_MS_LOG2;
#[allow(clippy::cast_possible_truncation, reason = "6")]
const INJECTED_FAULT_COUNT: u32 = INJECTED_FAULT_SEQUENCE.len() as u32;

/// A fault that lasts for a while.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum InjectedFault {
    None,
    NoPositions,
    /// Neither angles nor `Conditions`.
    NoAngles,
    /// Neither `Control` nor `Spindle`.
    SilentCnc,
    /// `Engage` is not set.
    Disengaged,
    /// Its codes are at the upper rail.
    SensorAtRail,
    NoTemperatures,
}

impl InjectedFault {
    fn from_vector_index(vector: u32) -> Self {
        let phase = vector >> PHASE_MS_LOG2;
        let number = (phase >> 1).checked_rem(INJECTED_FAULT_COUNT).unwrap_or(0) as usize;
        match INJECTED_FAULT_SEQUENCE.get(number) {
            Some(fault) if phase & 1 == 1 => *fault,
            _ => Self::None,
        }
    }
}

/// A source of numbers that look random.
#[derive(Clone, Copy, Debug)]
pub struct XorShift32(u32);

impl XorShift32 {
    /// Returns the numbers that begin with this seed; 0 counts as 1.
    #[must_use]
    pub const fn new(seed: u32) -> Self {
        Self(if seed == 0 { 1 } else { seed })
    }

    /// Returns the next number.
    pub const fn next_u32(&mut self) -> u32 {
        self.0 ^= self.0.wrapping_shl(13);
        self.0 ^= self.0.wrapping_shr(17);
        self.0 ^= self.0.wrapping_shl(5);
        self.0
    }

    /// Returns the next number, from 0 to below `end`.
    #[allow(clippy::cast_possible_truncation, reason = "the high word of a product of two words")]
    pub fn next_below(&mut self, end: u32) -> u32 {
        (u64::from(self.next_u32()).wrapping_mul(u64::from(end)) >> 32) as u32
    }

    /// Returns the next number, up to `most` either way.
    pub fn next_signed_within(&mut self, most: u32) -> i32 {
        let span = most.wrapping_mul(2).wrapping_add(1);
        self.next_below(span).wrapping_sub(most).cast_signed()
    }
}

/// A node and the generator of its inputs.
#[derive(Debug)]
pub struct TestVectorRunner<'a> {
    node: Node<'a>,
    random: XorShift32,
    /// Whether faults are among the inputs: lost frames, dead sensors, a CNC that lets go.
    faults: bool,
    number: u32,
    position: [u32; 3],
    level: u32,
    codes: [AdcCode; CODES_PER_TICK],
    temperatures: RawTemperatures,
    /// How far each is above the coldest, in millikelvin.
    warmth_mk: [u32; TEMPERATURE_CHANNEL_COUNT],
    /// Frames that the CNC sends in this millisecond.
    sent: Vec<Frame, 7>,
    /// Of the three positions, the angles, the spindle, the control, tool and conditions.
    counters: [u8; 7],
    /// Whether the calibration depends on tool and conditions, which are sent then.
    has_conditions: bool,
    checksum: u64,
}

impl<'a> TestVectorRunner<'a> {
    /// Returns a node that has just been switched on.
    #[must_use]
    pub fn new(calibration: Calibration<'a>, seed: u32, faults: bool) -> Self {
        let mut node = Node::new(calibration.into());
        let mut terms = calibration.terms.iter().flatten();
        let has_conditions =
            terms.any(|term| matches!(term.effect, Effect::Tool(_) | Effect::Condition(_)));
        for frame in frames::disengaged_control_frames() {
            // In order: none is refused.
            node.receive(Interface::Can, &frame).ok();
        }
        Self {
            node,
            random: XorShift32::new(seed),
            faults,
            number: 0,
            position: AXIS_TRAVELS.map(|reach| reach >> 1),
            level: 700,
            codes: [AdcCode(0); CODES_PER_TICK],
            temperatures: [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT],
            warmth_mk: [MAX_TEMPERATURE_RISE_MK >> 1; TEMPERATURE_CHANNEL_COUNT],
            sent: Vec::new(),
            // After the three of `Control` above.
            counters: [0, 0, 0, 0, 0, 3, 0],
            has_conditions,
            checksum: 0xcbf2_9ce4_8422_2325,
        }
    }

    /// Draws the next vector.
    pub fn draw_vector(&mut self) {
        self.number = self.number.wrapping_add(1);
        self.sent.clear();
        let fault = if self.faults {
            InjectedFault::from_vector_index(self.number)
        } else {
            InjectedFault::None
        };
        if self.is_due(POSITION_PERIOD_MS) && fault != InjectedFault::NoPositions {
            (0..3).for_each(|number| self.queue_position_frame(number));
        }
        if self.is_due(ROTARY_PERIOD_MS) && fault != InjectedFault::NoAngles {
            let angles =
                [180_000_000, 110_000_000].map(|most| self.random.next_signed_within(most));
            let angles = angles.map(MicroDegrees);
            self.queue_frame(3, |counter| {
                frames::encode_rotary(RotaryAxisAngles { angles }, counter)
            });
        }
        if self.is_due(CONTROL_PERIOD_MS) && fault != InjectedFault::SilentCnc {
            let speed = Rpm(18_000_u16.wrapping_add(self.level.to_le_bytes()[0].into()));
            self.queue_frame(4, |counter| {
                frames::encode_spindle(SpindleState { speed, load_n: 0 }, counter)
            });
            let engage = fault != InjectedFault::Disengaged;
            // Now and then for some frames, so that it is believed.
            let zero = self.faults && self.number & 0x0FFF < 200;
            let control = Control { engage, zero, ..Control::REFERENCED };
            self.queue_frame(5, |counter| frames::encode_control(control, counter));
        }
        if self.has_conditions
            && self.is_due(CONDITIONS_PERIOD_MS)
            && fault != InjectedFault::NoAngles
        {
            let bytes = self.random.next_u32().to_le_bytes();
            let (tool, bits) = (u16::from(bytes[0] & 63), u16::from_le_bytes([bytes[2], bytes[3]]));
            self.queue_frame(6, |counter| {
                frames::encode_conditions(MachineConditions { tool, bits }, counter)
            });
        }
        self.update_sensors(fault);
    }

    fn is_due(&self, period_ms: u32) -> bool {
        self.number.checked_rem(period_ms) == Some(0)
    }

    /// The node receives the frames of the vector that was prepared.
    #[inline]
    pub fn receive(&mut self) {
        for frame in &self.sent {
            // A refusal is one of the things that are compared.
            self.node.receive(Interface::Can, frame).ok();
        }
    }

    fn queue_position_frame(&mut self, number: usize) {
        let Some(&reach) = AXIS_TRAVELS.get(number) else { return };
        let random = &mut self.random;
        let jump = random.next_below(16) == 0;
        let (target, walk) = (random.next_below(reach), random.next_signed_within(50_000));
        let Some(position) = self.position.get_mut(number) else { return };
        let heading = if walk < 0 { TravelDirection::Negative } else { TravelDirection::Positive };
        *position =
            if jump { target } else { position.wrapping_add_signed(walk).min(AXIS_TRAVELS[0]) };
        let axis = LinearAxis::ALL.get(number).copied().unwrap_or(LinearAxis::X);
        let position = Position(position.cast_signed());
        let sent = AxisPosition { axis, position, direction: heading };
        self.queue_frame(number, |counter| frames::encode_position(sent, counter));
    }

    /// Counts, builds, and at times damages a frame.
    fn queue_frame(&mut self, number: usize, build: impl FnOnce(u8) -> Frame) {
        let Some(counter) = self.counters.get_mut(number) else { return };
        let mut frame = build(*counter);
        *counter = counter.wrapping_add(1);
        if self.faults && self.random.next_below(128) == 0 {
            let mut data = *frame.data();
            let [.., last] = &mut data;
            *last ^= 0x40;
            frame = Frame::new(frame.id(), &data).unwrap_or(frame);
        }
        // There is room for one of each kind.
        self.sent.push(frame).ok();
    }

    fn update_sensors(&mut self, fault: InjectedFault) {
        let random = &mut self.random;
        self.level = self.level.wrapping_add_signed(random.next_signed_within(4)).clamp(100, 3_900);
        let level = if fault == InjectedFault::SensorAtRail { 4_095 } else { self.level };
        let noise = random.next_u32();
        for (bit, code) in self.codes.iter_mut().enumerate() {
            let [low, high, ..] = level
                .wrapping_add(noise.wrapping_shr(u32::try_from(bit).unwrap_or(0)) & 1)
                .to_le_bytes();
            *code = AdcCode(u16::from_le_bytes([low, high]));
        }
        let channels = self.temperatures.iter_mut().zip(&mut self.warmth_mk);
        for (number, (temperature, warmth_mk)) in channels.enumerate() {
            // Slowly, as heat is: a thermometer that jumps is not believed.
            let walked = warmth_mk.saturating_add_signed(random.next_signed_within(2));
            *warmth_mk = walked.min(MAX_TEMPERATURE_RISE_MK);
            let [pt100, linear] = READINGS_AT_20_C;
            // 0.3851 Ω in a kelvin, 1.99 codes of 256.
            let raw = match number {
                1 => linear.wrapping_add(warmth_mk.wrapping_mul(509) / 1_000),
                _ => pt100.wrapping_add(warmth_mk.wrapping_mul(385)),
            };
            let raw = if fault == InjectedFault::NoTemperatures {
                RawTemperatureReading::NONE
            } else {
                RawTemperatureReading(raw.cast_signed())
            };
            *temperature = raw;
        }
    }

    /// Runs the tick of the vector that was prepared.
    #[inline]
    pub fn tick(&mut self) -> OffsetFrames {
        let input = TickInput {
            codes: Some(&self.codes),
            speed: None,
            temperatures: Some(&self.temperatures),
        };
        self.node.tick(1, input)
    }

    /// Takes sent frames into the checksum.
    pub fn update_checksum(&mut self, frames: &[Frame]) {
        const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;
        for frame in frames {
            let bytes = frame.id().to_le_bytes().into_iter().chain([frame.len()]);
            for byte in bytes.chain(*frame.data()) {
                self.checksum = (self.checksum ^ u64::from(byte)).wrapping_mul(FNV_PRIME);
            }
        }
    }

    /// Returns the checksum of all frames that were taken.
    #[must_use]
    pub const fn checksum(&self) -> u64 {
        self.checksum
    }

    /// Returns the node that takes the vectors.
    #[must_use]
    pub const fn node(&self) -> &Node<'a> {
        &self.node
    }
}

/// Returns the checksum of what a node with this calibration sends over this many vectors, faults among them.
#[must_use]
pub fn compute_checksum(calibration: Calibration<'_>, vectors: u32) -> u64 {
    let mut run = TestVectorRunner::new(calibration, 0x7275_6574, true);
    for _ in 0..vectors {
        run.draw_vector();
        run.receive();
        let frames = run.tick();
        run.update_checksum(&frames);
    }
    run.checksum()
}

#[cfg(test)]
mod tests;
