//! The world outside the chip: the sensor, the thermometers, the CNC on the bus, the host on the serial line.

use crate::{
    frame::{Frame, protected},
    max31865::Rtd,
    script::Script,
    time::{NEVER, ms},
    wire::{Parity, Wire},
};
use std::collections::VecDeque;

/// Volts of VDDA and VREF+ at which codes are given.
pub const NOMINAL_SUPPLY: f64 = 3.3;
/// Volts of this chip's internal reference: what its factory value of 1502 says (DS8626, at 3.3 V).
const VREFINT: f64 = 1502.0 / 4095.0 * 3.3;
/// DS8626, temperature sensor: volts at 25 °C, and a kelvin more; this chip is at 30 °C.
const TEMPERATURE_25: f64 = 0.76;
const TEMPERATURE_SLOPE: f64 = 0.0025;
/// Volts of VBAT; the converter sees half of it (DS8626, VBAT monitoring).
const BATTERY: f64 = 3.0;

/// Returns the next of a sequence that looks like chance, 0 to 1.
fn part(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

/// The inputs of a run and their times.
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
    /// The crystal on OSC32, and whether VBAT has a battery of its own.
    pub lse_hz: u64,
    pub battery: bool,
    /// The serial line of the CNC, and the RS-485 line of a PLC.
    pub wires: [Wire; 2],
    /// Pins that a switch holds at ground: port, pin.
    pub low: Vec<(usize, u32)>,
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
    pub script: Option<Script>,
    pub(crate) counters: [u8; 5],
    pub(crate) rng: u64,
    slow_rng: u64,
    pub lamp: Vec<(u64, bool)>,
}

impl World {
    pub fn new(plan: Plan) -> World {
        let mut serial = Wire::new(921_600.0);
        for (t, bytes) in &plan.says {
            serial.to_board.extend(bytes.iter().map(|b| (*t, *b)));
        }
        // What Modbus over serial line V1.02 has as default (2.5.1, 3.1): 19 200 Bd, even parity.
        let mut rs485 = Wire::new(19_200.0);
        rs485.parity = Parity::Even;
        rs485.drive = Some((1, 12));
        let mut queue: VecDeque<(u64, Frame)> = plan.frames.iter().copied().collect();
        queue.make_contiguous().sort_by_key(|f| f.0);
        World {
            next_at: ms(1),
            plan,
            crystal_hz: 8_000_000,
            lsi_hz: 32_000,
            lse_hz: 32_768,
            battery: false,
            wires: [serial, rs485],
            low: Vec::new(),
            slow_flash: false,
            supply: NOMINAL_SUPPLY,
            inputs: [0.0; 16],
            rtds: (0..8).map(|n| Rtd::new(Some(20.0 + 3.0 * f64::from(n)))).collect(),
            populated: 0xff,
            queue,
            log: Vec::new(),
            counters: [0; 5],
            rng: 0x9e37_79b9_7f4a_7c15,
            slow_rng: 0x9e37_79b9_7f4a_7c15,
            lamp: Vec::new(),
            script: None,
        }
    }
    pub(crate) fn random(&mut self) -> f64 {
        part(&mut self.rng)
    }
    /// Returns what a channel of a converter gives, of 12 bits.
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
        if self.low.contains(&(port, pin)) {
            return Some(false);
        }
        matches!((port, pin), (0, 10) | (1, 8) | (1, 11)).then_some(true)
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
