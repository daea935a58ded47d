//! The detectors of a board's own inputs, drawn: how many of this many faults each finds in its stated time, and how
//! often it cries where nothing is wrong. `docs/detectors.md` has the times and what the statistics promise.
//!
//! The sensor that is made here shares nothing with the twin: growth, run-out, noise, in codes.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]
// A test may count and round as it likes: what overflows panics.
#![allow(clippy::arithmetic_side_effects, clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod random;
mod thermometers;

use std::{env, f64::consts::TAU, thread};

use trueup_core::{
    design_parameters::CODES_PER_TICK,
    run_out_monitor::{MIN_BASELINE_WINDOWS, RUN_OUT_WINDOW_MS, RunOutMonitor},
    sensor_health::SensorHealthMonitor,
    units::{AdcCode, READING_UNITS_PER_CODE, Rpm, SensorReading},
};

use crate::random::Random;

type Block = [AdcCode; CODES_PER_TICK];

/// A sensor in codes before a spindle that runs, stands, and grows.
struct Sensor {
    random: Random,
    noise: f64,
    level: f64,
    target: f64,
    tau_ms: f64,
    /// Amplitude, and where it goes: no spindle is at another speed in a moment.
    run_out: f64,
    run_out_then: f64,
    hz: f64,
    /// In turns.
    angle: f64,
    /// Cosine and sine of how far the spindle turns from the start of a block to each of its codes.
    within: [(f32, f32); CODES_PER_TICK],
    turns: bool,
    next_change: u64,
    ms: u64,
}

impl Sensor {
    fn new(noise: f64, seed: u64) -> Self {
        let random = Random::new(seed);
        Self {
            random,
            noise,
            level: 700.0,
            target: 700.0,
            tau_ms: 1.0,
            run_out: 0.0,
            run_out_then: 0.0,
            hz: 0.0,
            angle: 0.0,
            within: [(1.0, 0.0); CODES_PER_TICK],
            turns: false,
            next_change: 0,
            ms: 0,
        }
    }

    /// The spindle starts, stops, or takes another speed.
    fn change(&mut self) {
        self.turns = !self.turns || self.random.uniform() < 0.3;
        // 5 to 400 turns a second, run-out of 0.2 to 5 µm; growth of up to 80 µm with a time constant of 1 to 30 minutes.
        self.hz = self.random.between(5.5, 400.0);
        self.within = core::array::from_fn(|n| {
            let (sine, cosine) = (TAU * self.hz * n as f64 / 20e3).sin_cos();
            (cosine as f32, sine as f32)
        });
        self.run_out_then = if self.turns { self.random.between(1.6, 41.0) } else { 0.0 };
        self.target = if self.turns { self.random.between(700.0, 1_350.0) } else { 700.0 };
        self.tau_ms = self.random.between(60_000.0, 1_800_000.0);
        // For 2 s to a quarter of an hour, short ones as often as long ones.
        self.next_change = self.ms + (2_000.0 * 450.0_f64.powf(self.random.uniform())) as u64;
    }

    fn speed(&self) -> Rpm {
        Rpm(if self.turns { (60.0 * self.hz) as u16 } else { 0 })
    }

    /// Without run-out and noise.
    fn reading(&self) -> SensorReading {
        SensorReading((self.level * f64::from(READING_UNITS_PER_CODE)) as i32)
    }

    fn block(&mut self) -> Block {
        if self.ms >= self.next_change {
            self.change();
        }
        self.ms += 1;
        self.level += (self.target - self.level) / self.tau_ms;
        self.run_out += (self.run_out_then - self.run_out) / 50.0;
        let (sine, cosine) = (TAU * self.angle).sin_cos();
        let (sine, cosine) = (sine as f32, cosine as f32);
        self.angle = (self.angle + self.hz / 1e3).fract();
        let (level, run_out, noise) = (self.level as f32, self.run_out as f32, self.noise as f32);
        let normals = self.random.normals();
        core::array::from_fn(|n| {
            let (further_cosine, further_sine) = self.within[n];
            let run_out = run_out * (sine * further_cosine + cosine * further_sine);
            let code = level + run_out + noise * normals[n];
            AdcCode((code + 0.5).clamp(0.0, 4_095.0) as u16)
        })
    }
}

/// Alarms of a sensor that is well, over this many hours.
fn false_alarms(noise: f64, hours: f64, seed: u64) -> u64 {
    let (mut sensor, mut health) = (Sensor::new(noise, seed), SensorHealthMonitor::default());
    let mut run_out = RunOutMonitor::default();
    let (mut was_well, mut was_odd) = (false, false);
    let mut alarms = 0;
    for ms in 0..(hours * 3.6e6) as u64 {
        let block = sensor.block();
        let is_well = health.check_and_clean_codes(&block, sensor.turns).is_some();
        match sensor.speed() {
            Rpm(0) => run_out.record_standstill(),
            speed => run_out.receive(&block, sensor.reading(), speed),
        }
        let is_odd = health.has_jumped() || run_out.is_anomalous();
        // A quiet sensor is not believed until its first change, which is no alarm.
        if was_well && !is_well || is_odd && !was_odd {
            println!("noise {noise}, seed {seed}: an alarm at {ms} ms");
            alarms += 1;
        }
        was_odd = is_odd;
        was_well |= is_well;
        if !is_well && was_well {
            was_well = false;
        }
    }
    alarms
}

/// From the LSB in which a sensor's noise drowns to that of three codes RMS.
const NOISES: [f64; 4] = [0.05, 0.3, 1.0, 3.0];

/// Returns how many hours to try, by `TRUEUP_SOAK_HOURS` or else `default`.
fn hours(default: f64) -> f64 {
    env::var("TRUEUP_SOAK_HOURS").map_or(default, |text| text.parse().expect("a number"))
}

fn sound_sensors(hours: f64) {
    let tries = NOISES.map(|noise| {
        thread::spawn(move || {
            let alarms = false_alarms(noise, hours, (100.0 * noise) as u64);
            println!("noise of {noise} codes: {alarms} false alarms in {hours} h");
            alarms
        })
    });
    assert_eq!(tries.map(|thread| thread.join().expect("no panic")), [0; 4]);
}

#[test]
fn a_sound_sensor_is_believed_at_every_noise() {
    sound_sensors(0.05);
}

#[test]
#[ignore = "campaign: cargo xtask soak"]
fn campaign_a_sound_sensor_is_believed_for_hundreds_of_hours() {
    sound_sensors(hours(300.0));
}

/// A fault of the sensor: what a code becomes, after how many milliseconds it is found, and what is drawn.
struct Detector {
    name: &'static str,
    found_within_ms: u32,
    bend: fn(AdcCode, &mut SampleFault) -> AdcCode,
    /// Whether the spindle has to turn for it to be judged, where noise is below 0.3 codes.
    needs_life: bool,
    is_reported: fn(&SensorHealthMonitor) -> bool,
}

/// Not at all: the codes are not believed.
const BY_ITS_CODES: fn(&SensorHealthMonitor) -> bool = |_| false;

/// The state of a fault.
struct SampleFault {
    stuck: AdcCode,
    number: u32,
    /// Of a jump, in codes.
    by: i16,
}

const DETECTORS: [Detector; 6] = [
    Detector {
        name: "open",
        found_within_ms: 1,
        bend: |_, _| AdcCode(0),
        needs_life: false,
        is_reported: BY_ITS_CODES,
    },
    Detector {
        name: "short",
        found_within_ms: 1,
        bend: |_, _| AdcCode(4_095),
        needs_life: false,
        is_reported: BY_ITS_CODES,
    },
    Detector {
        name: "slew in range",
        found_within_ms: 1,
        bend: |code, fault| AdcCode(code.0.saturating_add_signed(fault.by)),
        needs_life: false,
        is_reported: SensorHealthMonitor::has_jumped,
    },
    Detector {
        // Even ones over the whole range, as of a converter that is lost.
        name: "wild",
        found_within_ms: 2,
        bend: |_, fault| {
            fault.number = fault.number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            AdcCode(9 + (((fault.number >> 16) * 4_078) >> 16) as u16)
        },
        needs_life: false,
        is_reported: BY_ITS_CODES,
    },
    Detector {
        // As of a divider whose wire touches now and then: 16 more railed codes than a quarter of the good ones.
        name: "range",
        found_within_ms: 4,
        bend: |code, fault| {
            fault.number += 1;
            if fault.number % 4 == 0 { code } else { AdcCode(4_095) }
        },
        needs_life: false,
        is_reported: BY_ITS_CODES,
    },
    Detector {
        name: "stuck",
        found_within_ms: 202,
        bend: |_, fault| fault.stuck,
        needs_life: true,
        is_reported: BY_ITS_CODES,
    },
];

fn found(detector: &Detector, draws: u32, seed: u64) -> u32 {
    let mut found = 0;
    let mut random = Random::new(seed);
    for draw in 0..draws {
        let least = if detector.needs_life { 0.3 } else { 0.05 };
        let noise = random.between(least, 3.0);
        let mut sensor = Sensor::new(noise, (seed << 32) + u64::from(draw));
        sensor.level = random.between(100.0, 3_900.0);
        sensor.change();
        let mut health = SensorHealthMonitor::default();
        // A sensor of little noise has to have been seen for a while: 0.3 codes are in balance 0.73 to 1.
        let lived = random.between(1_800.0, 4_000.0) as u64;
        sensor.next_change = u64::MAX;
        // More than twelve times what noise of three codes makes of second differences, by either way.
        let by =
            if random.bits().is_multiple_of(2) { 100.0 } else { -100.0 } * random.between(1.0, 5.0);
        let mut fault = SampleFault { stuck: AdcCode(0), number: draw, by: by as i16 };
        // Not beyond a rail.
        sensor.level = sensor.level.clamp(650.0, 3_400.0);
        sensor.target = sensor.level;
        for _ in 0..lived {
            let block = sensor.block();
            fault.stuck = block[CODES_PER_TICK - 1];
            health.check_and_clean_codes(&block, sensor.turns);
        }
        let ms = (1..=detector.found_within_ms).find(|_| {
            let block = sensor.block().map(|code| (detector.bend)(code, &mut fault));
            health.check_and_clean_codes(&block, sensor.turns).is_none()
                || (detector.is_reported)(&health)
        });
        found += u32::from(ms.is_some());
    }
    println!("{}: {found} of {draws} found within {} ms", detector.name, detector.found_within_ms);
    found
}

/// Spikes of one to three codes: they are found where the filter gets what stood before them.
fn found_spikes(draws: u32, seed: u64) -> u32 {
    let mut found = 0;
    let mut random = Random::new(seed);
    for draw in 0..draws {
        let noise = random.between(0.05, 3.0);
        let mut sensor = Sensor::new(noise, (seed << 32) + u64::from(draw));
        sensor.change();
        (sensor.next_change, sensor.target) = (u64::MAX, sensor.level);
        let mut health = SensorHealthMonitor::default();
        for _ in 0..500 {
            health.check_and_clean_codes(&sensor.block(), sensor.turns);
        }
        let mut block = sensor.block();
        let whole = block;
        let (first, length) = (1 + random.bits() as usize % 16, 1 + random.bits() as usize % 3);
        let by =
            if random.bits().is_multiple_of(2) { 80.0 } else { -80.0 } * random.between(1.0, 7.0);
        for code in &mut block[first..first + length] {
            *code = AdcCode(code.0.saturating_add_signed(by as i16));
        }
        let passed = health.check_and_clean_codes(&block, sensor.turns).copied();
        let is_mended = passed.is_some_and(|passed| {
            passed.iter().zip(&whole).all(|(a, b)| a.0.abs_diff(b.0) <= 32) && !health.has_jumped()
        });
        found += u32::from(is_mended);
    }
    println!("spike: {found} of {draws} mended");
    found
}

/// Run-out that goes to 0.4 of what it was, or fivefold and above 5 µm.
fn found_run_outs(draws: u32, seed: u64) -> u32 {
    let mut found = 0;
    let mut random = Random::new(seed);
    for draw in 0..draws {
        // It has to stand out of the noise.
        let noise = random.between(0.05, 0.5);
        let mut sensor = Sensor::new(noise, (seed << 32) + u64::from(draw));
        while !sensor.turns {
            sensor.change();
        }
        (sensor.next_change, sensor.target) = (u64::MAX, sensor.level);
        sensor.run_out_then = sensor.run_out_then.max(4.0);
        sensor.run_out = sensor.run_out_then;
        let mut run_out = RunOutMonitor::default();
        let mut lives = |sensor: &mut Sensor, windows: u32, until_odd: bool| {
            (0..windows * u32::from(RUN_OUT_WINDOW_MS)).any(|_| {
                let block = sensor.block();
                run_out.receive(&block, sensor.reading(), sensor.speed());
                until_odd && run_out.is_anomalous()
            })
        };
        lives(&mut sensor, u32::from(MIN_BASELINE_WINDOWS) + 1, false);
        let grown = (5.0 * sensor.run_out).max(55.0);
        sensor.run_out_then = if draw % 2 == 0 { 0.4 * sensor.run_out } else { grown };
        found += u32::from(lives(&mut sensor, 3, true));
    }
    println!("run-out: {found} of {draws} found within 3 s");
    found
}

/// `of_run_out`: draws of that detector, each of which is 20 s of a sensor.
fn every_detector(draws: u32, of_run_out: u32) {
    assert!(u64::from(found_spikes(draws, 30)) * 1_000 >= u64::from(draws) * 999);
    assert!(u64::from(found_run_outs(of_run_out, 31)) * 1_000 >= u64::from(of_run_out) * 999);
    for (seed, detector) in (10..).zip(&DETECTORS) {
        let found = found(detector, draws, seed);
        assert!(u64::from(found) * 1_000 >= u64::from(draws) * 999, "{}", detector.name);
    }
}

#[test]
fn every_detector_finds_its_fault_in_time() {
    every_detector(100, 20);
}

#[test]
#[ignore = "campaign: cargo xtask soak"]
fn campaign_every_detector_finds_3000_faults_in_time() {
    every_detector(3_000, 3_000);
}
