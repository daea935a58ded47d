//! The world outside the chip: the sensor, the thermometers, the CNC on the bus, the host on the serial line.

use crate::{
    frame::{CanFrame, build_protected_frame},
    max31865::RtdConverter,
    script::{RANDOM_SEED, StimulusScript},
    serial_line::{Parity, SerialLine},
    simulation_time::{NEVER, ms_to_ticks},
};
use std::collections::VecDeque;

/// Volts of VDDA and VREF+ at which codes are given.
pub const NOMINAL_SUPPLY_V: f64 = 3.3;
/// Volts of this chip's internal reference: what its factory value of 1502 says (DS8626, at 3.3 V).
const VREFINT_V: f64 = 1502.0 / 4095.0 * 3.3;
/// DS8626, temperature sensor: volts at 25 °C, and a kelvin more; this chip is at 30 °C.
const TEMPERATURE_SENSOR_V25: f64 = 0.76;
const TEMPERATURE_SENSOR_V_PER_C: f64 = 0.0025;
/// Volts of VBAT; the converter sees half of it (DS8626, VBAT monitoring).
const VBAT_V: f64 = 3.0;

/// Returns the next of a sequence that looks like chance, 0 to 1.
fn random_fraction(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

/// The inputs of a run and their times.
#[derive(Clone, Debug, Default)]
pub struct StimulusPlan {
    /// Mean code of the sensor before the step.
    pub code: f64,
    /// Mean code of the sensor after the step.
    pub code_after: f64,
    /// When the step comes.
    pub step_at: u64,
    /// Peak of the noise in codes.
    pub noise: f64,
    /// The CNC speaks from here; nothing if NEVER.
    pub cnc_from: u64,
    /// When the CNC sets Engage.
    pub engage_at: u64,
    /// When the CNC sets Zero.
    pub zero_at: u64,
    /// The CNC falls silent here.
    pub cnc_until: u64,
    /// The spindle's speed, in 1/min.
    pub rpm: u16,
    /// Said by the host on the serial line: (when, bytes).
    pub says: Vec<(u64, Vec<u8>)>,
    /// Positions a second for each of X, Y and Z.
    pub positions: u64,
    /// More frames for the bus, as (when, frame): SDO, strangers.
    pub frames: Vec<(u64, CanFrame)>,
}

/// A bit for each of the eight places of a thermometer.
const ALL_RTDS: u32 = 0xff;

/// Surroundings of the chip.
pub struct World {
    /// The inputs of the run.
    pub plan: StimulusPlan,
    /// Frequency of the crystal at OSC, in Hz.
    pub crystal_hz: u64,
    /// Frequency of LSI, in Hz.
    pub lsi_hz: u64,
    /// Frequency of the crystal on OSC32, in Hz.
    pub lse_hz: u64,
    /// VBAT has a battery of its own.
    pub battery: bool,
    /// The serial line of the CNC, and the RS-485 line of a PLC.
    pub wires: [SerialLine; 2],
    /// Pins that a switch holds at ground: port, pin.
    pub low: Vec<(usize, u32)>,
    /// The flash takes its largest times instead of its typical ones.
    pub slow_flash: bool,
    /// VDDA and VREF+, volts: what the converters measure by.
    pub supply: f64,
    /// Volts at the converters' inputs 0 to 15, but for the sensor's.
    pub inputs: [f64; 16],
    /// The eight places of a thermometer.
    pub rtds: Vec<RtdConverter>,
    /// The places that have a converter, a bit each.
    pub populated: u32,
    /// When the world's next millisecond comes.
    pub next_at: u64,
    /// Frames that others will send: from when on, and which.
    pub queue: VecDeque<(u64, CanFrame)>,
    /// Frames that the board has sent, with the time of their end.
    pub log: Vec<(u64, CanFrame)>,
    /// The script, if there is one.
    pub script: Option<StimulusScript>,
    pub(crate) counters: [u8; 5],
    pub(crate) rng: u64,
    slow_rng: u64,
    /// The changes of the status LED's pin: when, and whether it is low.
    pub lamp: Vec<(u64, bool)>,
}

impl World {
    /// Returns the world at power-on.
    pub fn new(plan: StimulusPlan) -> World {
        let mut serial = SerialLine::new(921_600.0);
        for (t, bytes) in &plan.says {
            serial.to_board.extend(bytes.iter().map(|b| (*t, *b)));
        }
        // What Modbus over serial line V1.02 has as default (2.5.1, 3.1): 19 200 Bd, even parity.
        let mut rs485 = SerialLine::new(19_200.0);
        rs485.parity = Parity::Even;
        rs485.drive = Some((1, 12));
        let mut queue: VecDeque<(u64, CanFrame)> = plan.frames.iter().copied().collect();
        queue.make_contiguous().sort_by_key(|f| f.0);
        World {
            next_at: ms_to_ticks(1),
            plan,
            crystal_hz: 8_000_000,
            lsi_hz: 32_000,
            lse_hz: 32_768,
            battery: false,
            wires: [serial, rs485],
            low: Vec::new(),
            slow_flash: false,
            supply: NOMINAL_SUPPLY_V,
            inputs: [0.0; 16],
            rtds: (0..8).map(|n| RtdConverter::new(Some(20.0 + 3.0 * f64::from(n)))).collect(),
            populated: ALL_RTDS,
            queue,
            log: Vec::new(),
            counters: [0; 5],
            rng: RANDOM_SEED,
            slow_rng: RANDOM_SEED,
            lamp: Vec::new(),
            script: None,
        }
    }
    pub(crate) fn next_random_fraction(&mut self) -> f64 {
        random_fraction(&mut self.rng)
    }
    /// Returns what a channel of a converter gives, of 12 bits.
    pub(crate) fn sample_adc_code(&mut self, channel: u32, now: u64) -> u32 {
        let volts = match channel {
            0 => return self.sample_sensor_code(now),
            16 => TEMPERATURE_SENSOR_V25 + TEMPERATURE_SENSOR_V_PER_C * 5.0,
            17 => VREFINT_V,
            18 => VBAT_V / 2.0,
            input => self.inputs.get(input as usize).copied().unwrap_or_default(),
        };
        let dither =
            0.5 * (random_fraction(&mut self.slow_rng) + random_fraction(&mut self.slow_rng) - 1.0);
        (volts / self.supply * 4095.0 + dither + 0.5).clamp(0.0, 4095.0) as u32
    }
    /// The sensor is given in codes, as they are with the nominal supply.
    fn sample_sensor_code(&mut self, now: u64) -> u32 {
        let scale = NOMINAL_SUPPLY_V / self.supply;
        if let Some(s) = &mut self.script {
            return s.sample_sensor(now, scale);
        }
        let mean = if now < self.plan.step_at { self.plan.code } else { self.plan.code_after };
        let r = (self.next_random_fraction() + self.next_random_fraction() - 1.0) * self.plan.noise;
        (scale * mean + r + 0.5).clamp(0.0, 4095.0) as u32
    }
    pub(crate) fn external_pin_level(&self, port: usize, pin: u32) -> Option<bool> {
        if self.low.contains(&(port, pin)) {
            return Some(false);
        }
        matches!((port, pin), (0, 10) | (1, 8) | (1, 11)).then_some(true)
    }
    pub(crate) fn is_pulled_up(&self, _port: usize, _pin: u32) -> bool {
        true
    }
    pub(crate) fn next_can_frame_time(&self) -> u64 {
        self.queue.front().map_or(NEVER, |f| f.0)
    }
    pub(crate) fn peek_can_frame(&self, now: u64) -> Option<CanFrame> {
        self.queue.front().filter(|f| f.0 <= now).map(|f| f.1)
    }
    pub(crate) fn pop_can_frame(&mut self) {
        self.queue.pop_front();
    }
    pub(crate) fn record_can_frame(&mut self, now: u64, frame: CanFrame) {
        self.log.push((now, frame));
    }
    pub(crate) fn queue_protected_frame(&mut self, now: u64, id: u32, counter: usize, body: &[u8]) {
        let frame = build_protected_frame(id, self.counters[counter], body);
        self.counters[counter] = self.counters[counter].wrapping_add(1);
        self.queue_can_frame(now, frame);
    }
    /// Puts a frame of the CNC's on the bus at that time.
    pub(crate) fn queue_can_frame(&mut self, at: u64, f: CanFrame) {
        let n = self.queue.partition_point(|q| q.0 <= at);
        self.queue.insert(n, (at, f));
    }
}
