//! A machine, its CNC and the bridge between them, of which any input may fail: the hand that breaks one thing
//! at a time. The growth, the temperatures and the positions are made here, not by the bridge's laws.

use std::{f64::consts::TAU, sync::OnceLock};

use trueup_canopen::emergency::{Fault, decode};
use trueup_core::{
    bridge::TickInput,
    calibration::{AxisModel, AxisThermalModel, Calibration, MachineIdentity},
    cnc::{AxisPosition, Control, LinearAxis, Output, SpindleState, TravelDirection},
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT},
    kinematics::Kinematics,
    lag::SmoothingFactor,
    limits::CompensationLimits,
    pitch_table::PitchErrorTable,
    reversal::Interval,
    thermometer::{RawTemperatureReading, Thermometer},
    tool_direction::ToolDirection,
    units::{AdcCode, Nanometres, Position, Rpm, Temperature},
};
use trueup_link::{frame::Frame, frames, layout::EMERGENCY_ID};
use trueup_node::node::{Interface, Node};

use crate::spindle_model::{KnownSpindle, law};

/// A code is this many nanometres of growth; the sensor reads this many codes without any.
const NM_PER_CODE: f64 = 122.0;
const ZERO_CODE: f64 = 600.0;
/// The growth of the spindle and its time constant: after 5 minutes it cools by 12 nm/s, as fast as the paper's spindle
/// warms on the average (80 µm in two hours).
const GROWTH_NM: f64 = 40_000.0;
const TAU_S: f64 = 900.0;
/// The spindle's thermometer, and that of X.
pub const SPINDLE_CHANNEL: usize = 2;
pub const AXIS_CHANNEL: usize = 4;
/// Raw units of a thermometer per kelvin: a nanometre of growth is about one for the spindle, two for the axis.
const RAW_PER_K: f64 = 4_096.0;
const SPINDLE_NM_PER_K: f64 = 4_000.0;
const AXIS_NM_PER_K: f64 = 2_000.0;
const SPEED: u16 = 12_000;
/// The rapid traverse of X in 10 nm a millisecond: 6 m/min.
const RAPID: u32 = 10_000;

/// 20 µm a metre over 1 m.
fn table() -> PitchErrorTable<'static> {
    let points: Vec<[u8; 4]> = (0..11).map(|n| (n * 2_000 * 256_i32).to_le_bytes()).collect();
    PitchErrorTable {
        start: Position(0),
        step: Interval::new(10_000_000),
        forward: Box::leak(points.into()),
        reverse: None,
    }
}

pub fn calibration() -> Calibration<'static> {
    let linear = Thermometer::Linear { zero: 0, slope: 1_000, shift: 0 };
    let mut thermometers = [None; TEMPERATURE_CHANNEL_COUNT];
    thermometers[SPINDLE_CHANNEL] = Some(linear);
    thermometers[AXIS_CHANNEL] = Some(linear);
    let none = SmoothingFactor::NO_LAG;
    let spindle = KnownSpindle {
        zero_code: ZERO_CODE,
        nm_per_code: NM_PER_CODE,
        channel: SPINDLE_CHANNEL as u8,
        nm_per_kelvin: SPINDLE_NM_PER_K,
        lag: none,
        growth_nm: GROWTH_NM,
        tau_s: TAU_S,
    };
    let x = AxisModel {
        thermal: Some(AxisThermalModel {
            channel: AXIS_CHANNEL as u8,
            smoothing: none,
            smoothing_falling: none,
            origin: Position(0),
            law: law(AXIS_NM_PER_K),
        }),
        pitch: Some(table()),
        rapid: RAPID,
        ..AxisModel::default()
    };
    Calibration {
        thermometers,
        spindle: spindle.model(),
        kinematics: Kinematics { zero: ToolDirection::DOWN, axes: [None; 2] },
        axes: [x, AxisModel::default(), AxisModel::default()],
        straightness: Default::default(),
        squareness: Default::default(),
        volume: None,
        terms: Default::default(),
        limits: CompensationLimits {
            max: [200_000, 200_000, 500_000].map(Nanometres),
            slew_nm_per_s: 20_000,
            link_timeout_ms: 500,
            hold_ms: 2_000,
            rejoin_nm_per_s: 10,
            learned: Default::default(),
        },
        cold_within: Temperature(Temperature::PER_KELVIN / 2),
        guards: Default::default(),
        names: MachineIdentity::default(),
    }
}

/// Part that may fail.
#[rustfmt::skip]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part { Sensor, SpindleThermometer, AxisThermometer, Position, Control, Speed, Blocks }

/// How.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Off,
    Open,
    Short,
    Stuck,
    Garbage,
    Bias,
    Drift,
    Slow,
    Delayed,
    Intermittent,
}

impl Kind {
    pub const ALL: [Self; 10] = [
        Self::Off,
        Self::Open,
        Self::Short,
        Self::Stuck,
        Self::Garbage,
        Self::Bias,
        Self::Drift,
        Self::Slow,
        Self::Delayed,
        Self::Intermittent,
    ];

    /// Returns what a number becomes: `bias` is its size, and the drift that of a minute; `lasts_ms`: how long the
    /// fault has been there; `then`: what it was when it began; `late`: what it was a second ago; `slow`: after 5 s.
    fn bend(self, now: f64, number: &Number, bias: f64, lasts_ms: u32) -> f64 {
        match self {
            Self::Bias => now + bias,
            Self::Drift => now + bias * f64::from(lasts_ms) / 60_000.0,
            Self::Stuck => number.then,
            Self::Slow => number.slow,
            Self::Delayed => number.late.front().copied().unwrap_or(now),
            _ => now,
        }
    }
}

/// The past of a number.
#[derive(Clone, Default)]
struct Number {
    then: f64,
    slow: f64,
    late: std::collections::VecDeque<f64>,
}

impl Number {
    fn live(&mut self, now: f64, is_faulty: bool) {
        if self.late.is_empty() {
            self.slow = now;
        }
        if !is_faulty {
            self.then = now;
            self.slow = now;
        }
        self.slow += (now - self.slow) / 5_000.0;
        self.late.push_back(now);
        if self.late.len() > 1_000 {
            self.late.pop_front();
        }
    }
}

/// The rig. Time is the count of ticks.
pub struct Rig {
    pub node: Node<'static>,
    pub ms: u32,
    /// The part that fails, how, and since when.
    pub fault: Option<(Part, Kind, u32)>,
    pub engage: bool,
    /// The sensor's cable is off too: the bridge runs on its fall-back.
    pub blind: bool,
    pub heat: f64,
    pub runs: bool,
    /// Of the spindle while it runs, in r/min.
    pub speed: u16,
    pub noise_codes: f64,
    /// How far X is from where it usually goes, in mm.
    pub offset_mm: f64,
    /// Emergencies of faults that have come, with their time.
    pub emergencies: Vec<(u32, Fault)>,
    pub last: Output,
    /// Channels of the two thermometers.
    pub channels: [usize; 2],
    /// Where the CNC is.
    pub line: Interface,
    seed: u64,
    counters: [u8; 3],
    repeated: Option<Frame>,
    growth: Number,
    spindle_k: Number,
    axis_k: Number,
    place: Number,
    code: f64,
}

impl Rig {
    pub fn new(seed: u64) -> Self {
        Self {
            node: Node::new(calibration().into()),
            ms: 0,
            fault: None,
            engage: false,
            blind: false,
            heat: 0.0,
            runs: true,
            speed: SPEED,
            noise_codes: 1.0,
            offset_mm: 0.0,
            emergencies: Vec::new(),
            last: Output::default(),
            channels: [SPINDLE_CHANNEL, AXIS_CHANNEL],
            line: Interface::Can,
            seed: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
            counters: [0; 3],
            repeated: None,
            growth: Number::default(),
            spindle_k: Number::default(),
            axis_k: Number::default(),
            place: Number::default(),
            code: 0.0,
        }
    }

    pub fn bits(&mut self) -> u64 {
        self.seed ^= self.seed << 13;
        self.seed ^= self.seed >> 7;
        self.seed ^= self.seed << 17;
        self.seed
    }

    /// 0 to below 1.
    fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Normal numbers of variance 1, a block of them, from a table: a hundred million blocks are asked for.
    fn normals(&mut self) -> [f64; CODES_PER_TICK] {
        static TABLE: OnceLock<Vec<f64>> = OnceLock::new();
        let table = TABLE.get_or_init(|| {
            // Box and Muller, over as many places as there are.
            let normal = |n: u64| {
                let [a, b] = [n, n * 40_503].map(|n| ((n % 65_536) as f64 + 0.5) / 65_536.0);
                (-2.0 * a.ln()).sqrt() * (b * TAU).cos()
            };
            (0..65_536).map(normal).collect()
        });
        let mut normals = [0.0; CODES_PER_TICK];
        for four in normals.chunks_mut(4) {
            // The low bits of the state alone are poor.
            let mut bits = self.bits().wrapping_mul(0x2545_F491_4F6C_DD1D);
            for normal in four {
                *normal = table[usize::from(bits as u16)];
                bits >>= 16;
            }
        }
        normals
    }

    /// Returns the fault of this part, and how long it has been there.
    fn fault_of(&self, part: Part) -> Option<(Kind, u32)> {
        let (of, kind, since) = self.fault?;
        (of == part && self.ms >= since).then(|| (kind, self.ms - since))
    }

    pub fn grown_nm(&self) -> f64 {
        self.heat * GROWTH_NM
    }

    fn codes(&mut self) -> Option<[AdcCode; CODES_PER_TICK]> {
        let fault = self.fault_of(Part::Sensor);
        let turn = if self.runs { 10.0 } else { 0.0 };
        let grown = ZERO_CODE + self.grown_nm() / NM_PER_CODE;
        self.growth.live(grown, fault.is_some());
        let level = fault.map_or(grown, |(kind, lasts)| {
            // 10 µm, and 10 µm a minute.
            kind.bend(grown, &self.growth, 10_000.0 / NM_PER_CODE, lasts)
        });
        let blocks = self.fault_of(Part::Blocks);
        let normals = self.normals();
        let turns = f64::from(self.speed) / 60_000.0;
        // From code to code it turns by the same angle.
        let (sine_step, cosine_step) = (turns / 20.0 * TAU).sin_cos();
        let (mut sine, mut cosine) = (f64::from(self.ms) * turns * TAU).sin_cos();
        let codes = core::array::from_fn(|n| {
            let alive = level + turn * sine + self.noise_codes * normals[n];
            (sine, cosine) =
                (sine * cosine_step + cosine * sine_step, cosine * cosine_step - sine * sine_step);
            let alive = alive.round().clamp(0.0, 4_095.0);
            let code = match fault {
                _ if self.blind => 0.0,
                Some((Kind::Off | Kind::Open, _)) => 0.0,
                Some((Kind::Short, _)) => 4_095.0,
                Some((Kind::Stuck, _)) => self.code,
                Some((Kind::Garbage, _)) => (self.uniform() * 4_096.0).floor(),
                Some((Kind::Intermittent, lasts)) if lasts % 200 < 30 => 0.0,
                _ => alive,
            };
            if fault.is_none() {
                self.code = code;
            }
            AdcCode(code as u16)
        });
        let arrives = match blocks {
            None | Some((Kind::Bias | Kind::Drift | Kind::Stuck | Kind::Garbage, _)) => true,
            Some((Kind::Off | Kind::Open | Kind::Short, _)) => false,
            Some((Kind::Slow, lasts)) => lasts % 10 == 0,
            Some((Kind::Delayed, lasts)) => lasts > 1_000,
            Some((Kind::Intermittent, lasts)) => lasts % 2 == 0,
        };
        arrives.then_some(codes)
    }

    fn raw(&mut self, part: Part, kelvin: f64) -> RawTemperatureReading {
        let fault = self.fault_of(part);
        let number = match part {
            Part::SpindleThermometer => &mut self.spindle_k,
            _ => &mut self.axis_k,
        };
        number.live(kelvin, fault.is_some());
        let Some((kind, lasts)) = fault else {
            return RawTemperatureReading((kelvin * RAW_PER_K) as i32);
        };
        let bent = kind.bend(kelvin, number, 5.0, lasts);
        let drawn = self.uniform() * 200.0 - 50.0;
        match kind {
            Kind::Off | Kind::Open | Kind::Short => RawTemperatureReading::NONE,
            Kind::Intermittent if lasts % 1_000 < 300 => RawTemperatureReading::NONE,
            Kind::Garbage => RawTemperatureReading((drawn * RAW_PER_K) as i32),
            _ => RawTemperatureReading((bent * RAW_PER_K) as i32),
        }
    }

    /// Returns whether a frame goes out now: every `period_ms`, or later, or not.
    fn sends(&mut self, part: Part, period_ms: u32) -> bool {
        let due = |every: u32| self.ms.is_multiple_of(every);
        match self.fault_of(part) {
            Some((Kind::Off | Kind::Open | Kind::Short, _)) => false,
            Some((Kind::Slow, _)) => due(400),
            Some((Kind::Delayed, lasts)) => lasts > 1_000 && due(period_ms),
            Some((Kind::Intermittent, _)) => due(period_ms) && self.bits().is_multiple_of(2),
            _ => due(period_ms),
        }
    }

    fn receive(&mut self, frame: &Frame) {
        // What is refused is the business of the receiver.
        self.node.receive(self.line, frame).ok();
    }

    fn next(&mut self, number: usize) -> u8 {
        let counter = self.counters[number];
        self.counters[number] = counter.wrapping_add(1);
        counter
    }

    fn speak(&mut self) {
        let control = Control { engage: self.engage, ..Control::REFERENCED };
        if self.sends(Part::Control, 20) {
            let counter = self.next(0);
            let frame = frames::encode_control(control, counter);
            let frame = match self.fault_of(Part::Control) {
                Some((Kind::Stuck, _)) => self.repeated.unwrap_or(frame),
                Some((Kind::Garbage, _)) => {
                    let data: [u8; 8] = self.bits().to_le_bytes();
                    Frame::new(frame.id(), &data[..frame.len().into()]).expect("as long")
                }
                _ => frame,
            };
            self.repeated = Some(frame);
            self.receive(&frame);
        }
        if self.sends(Part::Speed, 20) {
            let true_speed = if self.runs { self.speed } else { 0 };
            let speed = match self.fault_of(Part::Speed) {
                Some((Kind::Garbage, _)) => (self.bits() % 24_000) as u16,
                Some((Kind::Bias, _)) => true_speed + 120,
                Some((Kind::Drift, lasts)) => true_speed + (lasts / 100) as u16,
                _ => true_speed,
            };
            let counter = self.next(1);
            self.receive(&frames::encode_spindle(
                SpindleState { speed: Rpm(speed), load_n: 0 },
                counter,
            ));
        }
        // ±100 mm about 500 mm, once in 10 s.
        let t_s = f64::from(self.ms) / 1_000.0;
        let place_mm = 500.0 + self.offset_mm + 100.0 * (t_s * TAU / 10.0).sin();
        let fault = self.fault_of(Part::Position);
        self.place.live(place_mm, fault.is_some());
        if self.sends(Part::Position, 4) {
            let place_mm = match fault {
                Some((Kind::Garbage, _)) => self.uniform() * 1_000.0,
                Some((kind, lasts)) => kind.bend(place_mm, &self.place, 10.0, lasts),
                None => place_mm,
            };
            let position = Position((place_mm * 100_000.0) as i32);
            let counter = self.next(2);
            let received = AxisPosition {
                axis: LinearAxis::X,
                position,
                direction: TravelDirection::Positive,
            };
            self.receive(&frames::encode_position(received, counter));
        }
    }

    /// A millisecond of life.
    pub fn live(&mut self) {
        self.ms += 1;
        let target = if self.runs { 1.0 } else { 0.0 };
        self.heat += (target - self.heat) * 1e-3 / TAU_S;
        self.speak();
        let codes = self.codes();
        let spindle_c = 20.0 + self.grown_nm() / SPINDLE_NM_PER_K;
        // A kelvin a minute, for half an hour up and then down: what rose for eight hours was no thermometer.
        let minutes = f64::from(self.ms) / 60_000.0 % 60.0;
        let axis_c = 22.0 + minutes.min(60.0 - minutes);
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        let [spindle, axis] = self.channels;
        raw[spindle] = self.raw(Part::SpindleThermometer, spindle_c);
        raw[axis] = self.raw(Part::AxisThermometer, axis_c);
        if codes.is_some() {
            let input = TickInput {
                codes: codes.as_ref(),
                temperatures: Some(&raw),
                ..TickInput::default()
            };
            self.tick(1, input);
        }
        if self.ms.is_multiple_of(10)
            && let Some(behind_ms) = self.node.advance_clock(10)
        {
            self.tick(behind_ms, TickInput { temperatures: Some(&raw), ..TickInput::default() });
        }
    }

    fn tick(&mut self, elapsed_ms: u32, input: TickInput<'_>) {
        self.node.tick(elapsed_ms, input);
        self.last = *self.node.last_output();
        let frames = self.node.next_service_frame();
        if let Some(frame) = frames.filter(|frame| frame.id() == EMERGENCY_ID)
            && let Ok(emergency) = decode(&frame)
            && emergency.code != 0
        {
            self.emergencies.push((self.ms, emergency.fault));
        }
    }

    pub fn run(&mut self, ms: u32) {
        (0..ms).for_each(|_| self.live());
    }

    /// As a CNC: three times not engaged, then engaged, until the offset has arrived.
    pub fn engaged(seed: u64) -> Self {
        Self::engaged_over(Interface::Can, seed)
    }

    /// Returns the same, with the CNC on this line.
    pub fn engaged_over(line: Interface, seed: u64) -> Self {
        Self { line, ..Self::new(seed) }.into_engaged()
    }

    /// Returns the same, with this as the largest offset of X, whose rapid traverse is not stated.
    pub fn engaged_within(x_nm: i32, seed: u64) -> Self {
        let mut narrow = calibration();
        narrow.limits.max[0] = Nanometres(x_nm);
        narrow.axes[0].rapid = 0;
        Self { node: Node::new(narrow.into()), ..Self::new(seed) }.into_engaged()
    }

    pub fn into_engaged(mut self) -> Self {
        self.run(500);
        self.engage = true;
        self.run(3_000);
        self
    }

    /// Returns what a CNC applies on X and Z, in nm: nothing where nothing is available.
    pub fn applied_nm(&self) -> [i32; 2] {
        let [x, _, z] = self.last.offset.unwrap_or_default();
        [x.0, z.0]
    }
}
