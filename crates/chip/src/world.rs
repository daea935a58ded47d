//! What is outside the chip: the sensor, the thermometers, the CNC on the bus, the host on the serial line.

use crate::{
    frame::{Frame, protected},
    max31865::Rtd,
    script::Script,
    time::{NEVER, ms},
};
use std::collections::VecDeque;
use std::io::Write;
use std::net::{TcpListener, TcpStream};

/// Volts of VDDA and VREF+ at which codes are given.
pub const NOMINAL_SUPPLY: f64 = 3.3;
/// Volts of this chip's internal reference: what its factory value of 1502 says (DS8626, at 3.3 V).
const VREFINT: f64 = 1502.0 / 4095.0 * 3.3;
/// DS8626, temperature sensor: volts at 25 °C, and a kelvin more; this chip is at 30 °C.
const TEMPERATURE_25: f64 = 0.76;
const TEMPERATURE_SLOPE: f64 = 0.0025;
/// Volts of VBAT; the converter sees half of it (DS8626, VBAT monitoring).
const BATTERY: f64 = 3.0;

/// The next of a sequence that looks like chance, 0 to 1.
fn part(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

/// What the run plays.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Mean code of the sensor before and after the step.
    pub code: f64,
    pub code_after: f64,
    pub step_at: u64,
    /// Peak of the noise in codes.
    pub noise: f64,
    /// The CNC speaks from here; nothing if NEVER.
    pub cnc_from: u64,
    pub engage_at: u64,
    pub zero_at: u64,
    /// The CNC falls silent here.
    pub cnc_until: u64,
    pub rpm: u16,
    /// Said by the host on the serial line: (when, bytes).
    pub says: Vec<(u64, Vec<u8>)>,
    /// Positions a second for each of X, Y and Z.
    pub positions: u64,
    /// More frames for the bus, as (when, frame): SDO, strangers.
    pub frames: Vec<(u64, Frame)>,
}

pub struct World {
    pub plan: Plan,
    pub crystal_hz: u64,
    pub lsi_hz: u64,
    pub baud: f64,
    pub slow_flash: bool,
    /// VDDA and VREF+, volts: what the converters measure by.
    pub supply: f64,
    /// Volts at the converters' inputs 0 to 15, but for the sensor's.
    pub inputs: [f64; 16],
    pub rtds: Vec<Rtd>,
    pub populated: u32,
    pub next_at: u64,
    pub queue: VecDeque<(u64, Frame)>,
    pub log: Vec<(u64, Frame)>,
    pub serial: Vec<(u64, u8)>,
    pub to_board: VecDeque<(u64, u8)>,
    pub script: Option<Script>,
    pub(crate) counters: [u8; 5],
    pub(crate) rng: u64,
    slow_rng: u64,
    pub lamp: Vec<(u64, bool)>,
    pub port: Option<TcpListener>,
    pub(crate) client: Option<TcpStream>,
}

impl World {
    pub fn new(plan: Plan) -> World {
        let mut to_board: VecDeque<(u64, u8)> = VecDeque::new();
        for (t, bytes) in &plan.says {
            to_board.extend(bytes.iter().map(|b| (*t, *b)));
        }
        let mut queue: VecDeque<(u64, Frame)> = plan.frames.iter().copied().collect();
        queue.make_contiguous().sort_by_key(|f| f.0);
        World {
            next_at: ms(1),
            plan,
            crystal_hz: 8_000_000,
            lsi_hz: 32_000,
            baud: 921_600.0,
            slow_flash: false,
            supply: NOMINAL_SUPPLY,
            inputs: [0.0; 16],
            rtds: (0..8).map(|n| Rtd::new(Some(20.0 + 3.0 * f64::from(n)))).collect(),
            populated: 0xff,
            queue,
            log: Vec::new(),
            serial: Vec::new(),
            to_board,
            counters: [0; 5],
            rng: 0x9e37_79b9_7f4a_7c15,
            slow_rng: 0x9e37_79b9_7f4a_7c15,
            lamp: Vec::new(),
            port: None,
            client: None,
            script: None,
        }
    }
    pub(crate) fn random(&mut self) -> f64 {
        part(&mut self.rng)
    }
    /// What a channel of a converter gives, of 12 bits.
    pub(crate) fn code(&mut self, channel: u32, now: u64) -> u32 {
        let volts = match channel {
            0 => return self.sensor_code(now),
            16 => TEMPERATURE_25 + TEMPERATURE_SLOPE * 5.0,
            17 => VREFINT,
            18 => BATTERY / 2.0,
            input => self.inputs.get(input as usize).copied().unwrap_or_default(),
        };
        let dither = 0.5 * (part(&mut self.slow_rng) + part(&mut self.slow_rng) - 1.0);
        (volts / self.supply * 4095.0 + dither + 0.5).clamp(0.0, 4095.0) as u32
    }
    /// The sensor is given in codes, as they are with the nominal supply.
    fn sensor_code(&mut self, now: u64) -> u32 {
        let scale = NOMINAL_SUPPLY / self.supply;
        if let Some(s) = &mut self.script {
            return s.sample(now, scale);
        }
        let mean = if now < self.plan.step_at { self.plan.code } else { self.plan.code_after };
        let r = (self.random() + self.random() - 1.0) * self.plan.noise;
        (scale * mean + r + 0.5).clamp(0.0, 4095.0) as u32
    }
    pub(crate) fn level(&self, port: usize, pin: u32) -> Option<bool> {
        matches!((port, pin), (0, 10) | (1, 8)).then_some(true)
    }
    pub(crate) fn pulled_up(&self, _port: usize, _pin: u32) -> bool {
        true
    }
    pub(crate) fn can_ready(&self) -> u64 {
        self.queue.front().map_or(NEVER, |f| f.0)
    }
    pub(crate) fn can_head(&self, now: u64) -> Option<Frame> {
        self.queue.front().filter(|f| f.0 <= now).map(|f| f.1)
    }
    pub(crate) fn can_pop(&mut self) {
        self.queue.pop_front();
    }
    pub(crate) fn heard(&mut self, now: u64, frame: Frame) {
        self.log.push((now, frame));
    }
    pub(crate) fn byte(&mut self, now: u64, b: u8) {
        self.serial.push((now, b));
        if let Some(c) = &mut self.client
            && c.write_all(&[b]).is_err()
        {
            self.client = None;
        }
    }
    pub(crate) fn byte_at(&self, _now: u64) -> Option<u64> {
        self.to_board.front().map(|b| b.0)
    }
    pub(crate) fn byte_take(&mut self) -> Option<u8> {
        self.to_board.pop_front().map(|b| b.1)
    }
    pub(crate) fn say(&mut self, now: u64, id: u32, counter: usize, body: &[u8]) {
        let frame = protected(id, self.counters[counter], body);
        self.counters[counter] = self.counters[counter].wrapping_add(1);
        self.put(now, frame);
    }
    /// Puts a frame of the CNC's on the bus at that time.
    pub(crate) fn put(&mut self, at: u64, f: Frame) {
        let n = self.queue.partition_point(|q| q.0 <= at);
        self.queue.insert(n, (at, f));
    }
}
