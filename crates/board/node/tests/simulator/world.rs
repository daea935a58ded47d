//! The world of a bridge: a spindle that grows, thermometers, a CNC that obeys the rules of the
//! README, faults of all of them, restarts. Drawn from a seed alone.
//!
//! Nothing here is the bridge's own: growth is the exact solution of a first-order heat in `f64`, the
//! CNC is written from the README.

use trueup_core::{
    bridge::{ReferenceErrors, TickInput},
    cnc::{CncMessage, Control, OffsetQuality, Output},
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT},
    temperature_channels::RawTemperatures,
    thermometer::RawTemperatureReading,
    units::AdcCode,
};
use trueup_link::{frame::Frame, frames, receiver::ReceiveError};
use trueup_node::{
    node::{Interface, Node},
    test_vectors::XorShift32,
};
use trueup_store::{
    reference::ReferenceStatus,
    retained_state::{self, RETAINED_COPY_SIZE, RetainedCopies},
};

mod judge;

use crate::axis::Axis;
use crate::machine::{
    Cnc, GrowingSpindle, NM_PER_CODE, SLEW_NM_PER_MS, WIRE_NM, ZERO_CODE, calibration,
};

/// A fault that lasts for a while.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorldFault {
    None,
    SensorOpen,
    SensorShort,
    SensorStuck,
    SensorRail,
    Spikes,
    NoBlocks,
    FewBlocks,
    ThermometerOpen,
    BothOpen,
    PositionsStop,
    CncSilent,
    CncLetsGo,
    DamagedFrames,
    LostFrames,
    SecondMaster,
    OtherLine,
}

const FAULTS: [WorldFault; 17] = [
    WorldFault::None,
    WorldFault::SensorOpen,
    WorldFault::SensorShort,
    WorldFault::SensorStuck,
    WorldFault::SensorRail,
    WorldFault::Spikes,
    WorldFault::NoBlocks,
    WorldFault::FewBlocks,
    WorldFault::ThermometerOpen,
    WorldFault::BothOpen,
    WorldFault::PositionsStop,
    WorldFault::CncSilent,
    WorldFault::CncLetsGo,
    WorldFault::DamagedFrames,
    WorldFault::LostFrames,
    WorldFault::SecondMaster,
    WorldFault::OtherLine,
];

/// Record of a run, so that it can be judged by what it has been through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    pub ticks: u64,
    pub restarts: u32,
    pub power_cuts: u32,
    pub zeros: u32,
    /// Starts with another table.
    pub tables: u32,
    /// Ticks of each quality.
    pub qualities: [u64; 7],
    /// The largest difference between offset and error while live and not on its way, in nm.
    pub worst_live_nm: i32,
    /// FNV-1a over everything that was sent.
    pub checksum: u64,
}

/// The reference that `Zero` has taken last, as the machine was.
#[derive(Clone, Copy, Debug)]
struct Zeroed {
    reference: ReferenceErrors,
    /// Growth and error of X in nm; `None`: a fall-back was in use.
    truth_nm: Option<[f64; 2]>,
}

/// A world and its bridge.
pub struct World {
    seed: u32,
    random: XorShift32,
    node: Node<'static>,
    ram: Box<RetainedCopies>,
    spindle: GrowingSpindle,
    axis: Axis,
    /// Which table is loaded.
    table: usize,
    /// The last `Zero` with each.
    zeroed: [Zeroed; 2],
    /// Since a block of samples, a set of temperatures, a `Control` that was believed, in ms.
    block_ms: u32,
    temperatures_ms: u32,
    control_ms: u32,
    /// Milliseconds without a block that the node was not given yet: its clock is this much behind.
    untold_ms: u32,
    cnc: Cnc,
    fault: WorldFault,
    fault_ms: u32,
    /// The tick in which the fault came.
    began: u64,
    /// Of the last tick: what went out, and its counter.
    before: Option<Output>,
    /// Milliseconds since the start of the node, with all inputs well.
    well_ms: u32,
    since_start_ms: u32,
    released: u32,
    engaged_after_release: bool,
    room_c: f64,
    /// Where a new source took over, and how long ago.
    joined: Option<(i32, u32)>,
    /// The tick of the last `Zero`.
    zero_tick: u64,
    /// Something was kept in RAM since the last power cut.
    has_retained: bool,
    /// Frames in which the CNC still says `Zero`.
    zero_frames: u32,
    pub seen: Seen,
}

impl World {
    pub fn new(seed: u32) -> Self {
        let random = XorShift32::new(seed.wrapping_mul(0x9E37_79B9) | 1);
        Self {
            seed,
            random,
            node: Node::new(calibration(0).into()),
            ram: Box::new([[0; RETAINED_COPY_SIZE]; 2]),
            spindle: GrowingSpindle { heat: 0.0, runs: true },
            axis: Axis::default(),
            table: 0,
            zeroed: [Zeroed { reference: ReferenceErrors::default(), truth_nm: Some([0.0; 2]) }; 2],
            block_ms: 0,
            temperatures_ms: 0,
            control_ms: 0,
            untold_ms: 0,
            cnc: Cnc::new(),
            fault: WorldFault::None,
            fault_ms: 5_000,
            began: 0,
            before: None,
            well_ms: 0,
            since_start_ms: 0,
            released: 0,
            engaged_after_release: false,
            room_c: 21.0,
            joined: None,
            zero_tick: 0,
            has_retained: false,
            zero_frames: 0,
            seen: Seen { checksum: 0xcbf2_9ce4_8422_2325, ..Seen::default() },
        }
    }

    /// One in this many.
    fn chance(&mut self, one_in: u32) -> bool {
        self.random.next_below(one_in) == 0
    }

    fn codes(&mut self) -> [AdcCode; CODES_PER_TICK] {
        let level = ZERO_CODE + self.spindle.grown_nm() / NM_PER_CODE;
        let fault = self.fault;
        let random = &mut self.random;
        let spike = random.next_below(20) as usize;
        core::array::from_fn(|n| {
            let noise = f64::from(random.next_signed_within(1_000)) / 1_000.0;
            let code = (level + noise).round().clamp(0.0, 4_095.0) as u16;
            AdcCode(match fault {
                WorldFault::SensorOpen | WorldFault::BothOpen => 0,
                WorldFault::SensorShort => 4_095,
                WorldFault::SensorStuck => 777,
                WorldFault::SensorRail if n % 4 != 3 => 0,
                WorldFault::SensorRail => 20,
                WorldFault::Spikes if n == spike => 4_095,
                _ => code,
            })
        })
    }

    fn raw(&self) -> RawTemperatures {
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        let counts = |celsius: f64| RawTemperatureReading((celsius * 256.0).round() as i32);
        // The housing follows at once; its own law has the lag.
        let front = self.room_c + if self.spindle.runs { 15.0 } else { 0.0 };
        raw[4] = counts(self.room_c);
        if !matches!(self.fault, WorldFault::ThermometerOpen | WorldFault::BothOpen) {
            raw[2] = counts(front);
        }
        raw
    }

    fn next_fault(&mut self) {
        self.fault_ms = self.fault_ms.saturating_sub(1);
        if self.fault_ms > 0 {
            return;
        }
        let is_well = self.fault == WorldFault::None;
        let drawn = self.random.next_below(FAULTS.len() as u32) as usize;
        self.fault = if is_well { FAULTS[drawn] } else { WorldFault::None };
        self.fault_ms = 200 + self.random.next_below(if is_well { 6_000 } else { 9_000 });
        self.began = self.seen.ticks;
        self.spindle.runs = !self.chance(4);
        let drawn = self.random.next_u32() >> 8;
        self.axis.turn(drawn);
        self.cnc.is_engage_requested = self.fault != WorldFault::CncLetsGo;
    }

    fn restart(&mut self) {
        self.seen.restarts += 1;
        let cut = self.chance(4);
        if cut {
            self.seen.power_cuts += 1;
            for byte in self.ram.iter_mut().flatten() {
                *byte = self.random.next_u32().to_le_bytes()[1];
            }
        }
        // A calibration that was loaded counts from the next start; a reference belongs to its own.
        if self.chance(3) {
            self.seen.tables += 1;
            self.table = 1 - self.table;
        }
        self.node = Node::new(calibration(self.table).into());
        self.node.restore_reference_status(
            ReferenceStatus::in_force(self.zeroed[self.table].reference),
            None,
        );
        self.axis.forget();
        let stored = retained_state::load(&self.ram);
        // Nothing has been kept since the last cut, or all of it is lost.
        self.has_retained &= !cut;
        assert_eq!(stored.is_some(), self.has_retained, "{}", self.place());
        self.node.resume(stored.as_ref(), 0);
        (self.before, self.since_start_ms, self.released) = (None, 0, 0);
        (self.engaged_after_release, self.well_ms) = (false, 0);
    }

    fn place(&self) -> String {
        format!("seed {}, tick {}, {:?}", self.seed, self.seen.ticks, self.fault)
    }

    /// Sends the frames of the CNC and of strangers in this millisecond.
    fn speak(&mut self) {
        if self.fault == WorldFault::CncSilent {
            return;
        }
        self.speak_of_the_axis();
        if !self.seen.ticks.is_multiple_of(20) {
            return;
        }
        if self.zero_frames == 0 && self.chance(400) {
            self.zero_frames = 5;
        }
        let zero = self.zero_frames > 0;
        self.zero_frames = self.zero_frames.saturating_sub(1);
        let (mut control, spindle) = (self.cnc.control(zero), self.cnc.spindle(self.spindle.runs));
        if let Some(arrived) = self.carry(control) {
            control = arrived;
            let before = self.node.reference();
            let received = self.node.receive(Interface::Can, &control);
            let decoded = frames::decode_control(&control).expect("its own length");
            self.note_control(&received, decoded.engage);
            self.note_zero(before);
            self.node.receive(Interface::Can, &spindle).ok();
        }
        let stranger = match self.fault {
            WorldFault::SecondMaster => Interface::Can,
            WorldFault::OtherLine => Interface::Serial,
            _ => return,
        };
        let engage = self.chance(2);
        let control = Control { engage, zero: true, ..Control::REFERENCED };
        let counter = self.cnc.counters[0].wrapping_add(self.random.next_below(4) as u8);
        let before = self.node.reference();
        let received = self.node.receive(stranger, &frames::encode_control(control, counter));
        self.note_control(&received, engage);
        // Where the CNC asks for it in the same moment, it is the CNC's, whichever frame completes it.
        assert!(
            zero || self.node.reference() == before,
            "a stranger takes a Zero: {}",
            self.place()
        );
        self.note_zero(before);
    }

    /// Follows the engage sequence of any sender: a stranger on the same line cannot be distinguished from the
    /// CNC by one frame.
    fn note_control(&mut self, received: &Result<Option<CncMessage>, ReceiveError>, engage: bool) {
        match received {
            Ok(None) => return,
            Ok(Some(_)) if !engage => self.released += 1,
            Ok(Some(_)) => {
                self.engaged_after_release |= self.released >= 3;
                self.released = 0;
            }
            Err(_) => self.released = 0,
        }
        if received.is_ok() {
            self.control_ms = 0;
        }
    }

    /// Remembers what a `Zero` has taken, if one has.
    fn note_zero(&mut self, before: ReferenceErrors) {
        let reference = self.node.reference();
        if reference != before {
            self.seen.zeros += 1;
            (self.joined, self.zero_tick) = (None, self.seen.ticks);
            // What was just broken may still be in the filter.
            let is_live = self.node.last_output().quality == OffsetQuality::Live
                && self.fault == WorldFault::None
                && self.lasts_ms() > 500;
            let truth_nm = || Some([self.spindle.grown_nm(), self.axis.error_nm(self.table)?]);
            let truth_nm = is_live.then(truth_nm).flatten();
            self.zeroed[self.table] = Zeroed { reference, truth_nm };
        }
    }

    /// Returns what of a frame arrives.
    fn carry(&mut self, frame: Frame) -> Option<Frame> {
        let is_hit = self.chance(3);
        match self.fault {
            WorldFault::LostFrames if is_hit => None,
            WorldFault::DamagedFrames if is_hit => {
                let mut data = *frame.data();
                data[self.random.next_below(8) as usize] ^= 1 << self.random.next_below(8);
                Some(Frame::new(frame.id(), &data).expect("8 bytes"))
            }
            _ => Some(frame),
        }
    }

    fn speak_of_the_axis(&mut self) {
        if let Some(frame) = self.axis.speak(self.seen.ticks)
            && self.fault != WorldFault::PositionsStop
            && let Some(frame) = self.carry(frame)
            && self.node.receive(Interface::Can, &frame).is_ok_and(|received| received.is_some())
        {
            self.axis.was_received();
        }
    }

    /// A millisecond.
    pub fn tick(&mut self) {
        self.seen.ticks += 1;
        self.since_start_ms += 1;
        for age in [&mut self.block_ms, &mut self.temperatures_ms, &mut self.control_ms] {
            *age = age.saturating_add(1);
        }
        self.axis.live();
        self.next_fault();
        self.spindle.live();
        if self.chance(40_000) {
            self.restart();
        }
        self.speak();
        let (codes, raw) = (self.codes(), self.raw());
        let phase = self.seen.ticks % 10;
        let has_block = match self.fault {
            WorldFault::NoBlocks => false,
            WorldFault::FewBlocks => phase == 0,
            _ => true,
        };
        if has_block {
            let temperatures = phase == 5 || self.fault == WorldFault::FewBlocks;
            let temperatures = temperatures.then_some(&raw);
            self.one(1, TickInput { codes: Some(&codes), speed: None, temperatures });
        } else {
            self.untold_ms += 1;
        }
        if phase == 9
            && let Some(behind_ms) = self.node.advance_clock(10)
        {
            self.untold_ms = 0;
            self.one(behind_ms, TickInput { temperatures: Some(&raw), ..TickInput::default() });
        }
        if self.seen.ticks.is_multiple_of(1_000) {
            retained_state::save_state(&mut self.ram, &self.node.retained_state(), None);
            self.has_retained = true;
        }
        let was = self.cnc.applied_nm;
        self.cnc.live();
        let step = (self.cnc.applied_nm - was).abs();
        assert!(step <= SLEW_NM_PER_MS + WIRE_NM, "the CNC steps by {step}: {}", self.place());
    }

    fn one(&mut self, elapsed_ms: u32, input: TickInput<'_>) {
        if input.codes.is_some() {
            self.block_ms = 0;
        }
        if input.temperatures.is_some() {
            self.temperatures_ms = 0;
        }
        let sent = self.node.tick(elapsed_ms, input);
        for frame in sent.iter().chain(&self.node.next_service_frame()) {
            for byte in frame.data() {
                self.seen.checksum =
                    (self.seen.checksum ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
            self.cnc.receive(frame);
        }
        let output = *self.node.last_output();
        // What the CNC has of it is the same, rounded to a bit of 10 nm.
        if let (Some(received), Some(offset)) =
            (self.cnc.received.and_then(|received| received.offset), output.offset)
        {
            let off = (received[2].0 - offset[2].0).abs();
            assert!(off <= WIRE_NM / 2, "the wire says {}: {}", received[2].0, self.place());
        }
        self.seen.qualities[output.quality as usize] += 1;
        self.judge(elapsed_ms, &output);
        self.before = Some(output);
    }

    /// Returns how long the fault has been there.
    fn lasts_ms(&self) -> u32 {
        u32::try_from(self.seen.ticks - self.began).unwrap_or(u32::MAX)
    }
}
