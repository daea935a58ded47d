//! The detectors of a board's own inputs, drawn: how many of so many faults each finds in its stated time, and how
//! often it cries where nothing is wrong. `docs/detectors.md` has the times and what the statistics promise.
//!
//! The sensor that is made here shares nothing with the twin: growth, run-out, noise, in codes.

// A test may count and round as it likes: what overflows panics.
#![allow(clippy::arithmetic_side_effects, clippy::cast_possible_truncation, clippy::cast_sign_loss)]

use std::{env, f64::consts::TAU, sync::OnceLock, thread};

use trueup_core::{
    channels::{Channel, Channels},
    dimensions::CODES_PER_TICK,
    health::Health,
    thermometer::{Raw, Thermometer},
    units::{Code, Temperature},
};

type Block = [Code; CODES_PER_TICK];

/// A generator of random numbers; normal ones are from a table: a thousand million codes are asked for.
struct Random {
    state: u64,
    normal: &'static [f32],
}

impl Random {
    fn new(seed: u64) -> Self {
        static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
        let seeded = |seed: u64| seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let normal = TABLE.get_or_init(|| {
            let mut random = Self { state: seeded(0), normal: &[] };
            let normal = |_| {
                // Box and Muller.
                let (a, b) = (1.0 - random.uniform(), random.uniform());
                ((-2.0 * a.ln()).sqrt() * (TAU * b).cos()) as f32
            };
            (0..1 << 16).map(normal).collect()
        });
        Self { state: seeded(seed), normal }
    }

    fn bits(&mut self) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        self.state
    }

    /// 0 to below 1.
    fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.uniform()
    }

    fn normal(&mut self) -> f64 {
        self.normal[(self.bits() >> 48) as usize].into()
    }

    /// Those of a block, four of a draw.
    fn normals(&mut self) -> [f32; CODES_PER_TICK] {
        let mut normals = [0.0; CODES_PER_TICK];
        for four in normals.chunks_mut(4) {
            // The low bits of the state alone are poor.
            let mut bits = self.bits().wrapping_mul(0x2545_F491_4F6C_DD1D);
            for normal in four {
                *normal = self.normal[usize::from(bits as u16)];
                bits >>= 16;
            }
        }
        normals
    }
}

/// A sensor in codes before a spindle that runs, stands, and grows.
struct Sensor {
    random: Random,
    noise: f64,
    level: f64,
    target: f64,
    tau_ms: f64,
    run_out: f64,
    hz: f64,
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
            hz: 0.0,
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
        self.run_out = if self.turns { self.random.between(1.6, 41.0) } else { 0.0 };
        self.target = if self.turns { self.random.between(700.0, 1_350.0) } else { 700.0 };
        self.tau_ms = self.random.between(60_000.0, 1_800_000.0);
        // For 2 s to a quarter of an hour, short ones as often as long ones.
        self.next_change = self.ms + (2_000.0 * 450.0_f64.powf(self.random.uniform())) as u64;
    }

    fn block(&mut self) -> Block {
        if self.ms >= self.next_change {
            self.change();
        }
        self.ms += 1;
        self.level += (self.target - self.level) / self.tau_ms;
        let (mut sine, mut cosine) = (0.0, 0.0);
        if self.turns {
            let angle = TAU * (self.hz * self.ms as f64 / 1e3).fract();
            (sine, cosine) = (angle.sin() as f32, angle.cos() as f32);
        }
        let (level, run_out, noise) = (self.level as f32, self.run_out as f32, self.noise as f32);
        let normals = self.random.normals();
        core::array::from_fn(|n| {
            let (further_cosine, further_sine) = self.within[n];
            let run_out = run_out * (sine * further_cosine + cosine * further_sine);
            let code = level + run_out + noise * normals[n];
            Code((code + 0.5).clamp(0.0, 4_095.0) as u16)
        })
    }
}

/// Alarms of a sensor that is well, over so many hours.
fn false_alarms(noise: f64, hours: f64, seed: u64) -> u64 {
    let (mut sensor, mut health) = (Sensor::new(noise, seed), Health::default());
    let mut was_well = false;
    let mut alarms = 0;
    for ms in 0..(hours * 3.6e6) as u64 {
        let block = sensor.block();
        let is_well = health.check(&block, sensor.turns).is_some();
        // A quiet sensor is not believed until its first change, which is no alarm.
        if was_well && !is_well {
            println!("noise {noise}, seed {seed}: an alarm at {ms} ms");
            alarms += 1;
        }
        was_well |= is_well;
        if !is_well && was_well {
            was_well = false;
        }
    }
    alarms
}

/// From the LSB in which a sensor's noise drowns to that of three codes RMS.
const NOISES: [f64; 4] = [0.05, 0.3, 1.0, 3.0];

fn sound_sensors(hours: f64) {
    let tries = NOISES.map(|noise| {
        thread::spawn(move || {
            let alarms = false_alarms(noise, hours, (100.0 * noise) as u64);
            println!("noise of {noise} codes: {alarms} false alarms in {hours} h");
            alarms
        })
    });
    assert_eq!(tries.map(|it| it.join().expect("no panic")), [0; 4]);
}

#[test]
fn a_sound_sensor_is_believed_at_every_noise() {
    sound_sensors(0.05);
}

#[test]
#[ignore = "campaign: cargo xtask soak"]
fn campaign_a_sound_sensor_is_believed_for_hundreds_of_hours() {
    let hours = env::var("TRUEUP_SOAK_HOURS").map_or(300.0, |it| it.parse().expect("a number"));
    sound_sensors(hours);
}

/// A fault of the sensor: what a code becomes, after how many milliseconds it is found, and what is drawn.
struct Detector {
    name: &'static str,
    found_within_ms: u32,
    bend: fn(Code, &mut Fault) -> Code,
    /// Whether the spindle has to turn for it to be judged, where noise is below 0.3 codes.
    needs_life: bool,
}

/// What a fault remembers.
struct Fault {
    stuck: Code,
    number: u32,
}

const DETECTORS: [Detector; 4] = [
    Detector { name: "open", found_within_ms: 1, bend: |_, _| Code(0), needs_life: false },
    Detector { name: "short", found_within_ms: 1, bend: |_, _| Code(4_095), needs_life: false },
    Detector {
        // As of a divider whose wire touches now and then: 16 more railed codes than a quarter of the good ones.
        name: "range",
        found_within_ms: 4,
        bend: |code, fault| {
            fault.number += 1;
            if fault.number % 4 == 0 { code } else { Code(4_095) }
        },
        needs_life: false,
    },
    Detector { name: "stuck", found_within_ms: 202, bend: |_, it| it.stuck, needs_life: true },
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
        let mut health = Health::default();
        // A sensor of little noise has to have been seen for a while: 0.3 codes are in balance 0.73 to 1.
        let lived = random.between(1_800.0, 4_000.0) as u64;
        sensor.next_change = u64::MAX;
        let mut fault = Fault { stuck: Code(0), number: 0 };
        for _ in 0..lived {
            let block = sensor.block();
            fault.stuck = block[CODES_PER_TICK - 1];
            health.check(&block, sensor.turns);
        }
        let ms = (1..=detector.found_within_ms).find(|_| {
            let block = sensor.block().map(|code| (detector.bend)(code, &mut fault));
            health.check(&block, sensor.turns).is_none()
        });
        found += u32::from(ms.is_some());
    }
    println!("{}: {found} of {draws} found within {} ms", detector.name, detector.found_within_ms);
    found
}

fn every_detector(draws: u32) {
    for (seed, detector) in (10..).zip(&DETECTORS) {
        let found = found(detector, draws, seed);
        assert!(u64::from(found) * 1_000 >= u64::from(draws) * 999, "{}", detector.name);
    }
}

#[test]
fn every_detector_finds_its_fault_in_time() {
    every_detector(100);
}

#[test]
#[ignore = "campaign: cargo xtask soak"]
fn campaign_every_detector_finds_3000_faults_in_time() {
    every_detector(3_000);
}

#[test]
fn three_thousand_dead_thermometers_are_found_at_the_fourth_reading_and_none_before() {
    let mut random = Random::new(20);
    for _ in 0..3_000 {
        let celsius = random.between(-20.0, 120.0);
        let micro_ohms =
            |c: f64| Raw((100e6 * (1.0 + 3.9083e-3 * c - 5.775e-7 * c * c)).round() as i32);
        let mut channel = Channel::default();
        for _ in 0..10 {
            let reading = micro_ohms(celsius + 0.03 * random.normal());
            channel.hear(Thermometer::Pt100.read(reading).ok());
            assert!(!channel.is_faulty());
        }
        // A wire that is off, a short circuit, a converter that does not answer: anywhere beyond −65…408 °C.
        let dead = match random.bits() % 3 {
            0 => Raw(random.between(249.1e6, 2e9) as i32),
            1 => Raw(random.between(0.0, 73.9e6) as i32),
            _ => Raw::NONE,
        };
        let readings = (1..=10).find(|_| {
            channel.hear(Thermometer::Pt100.read(dead).ok());
            channel.is_faulty()
        });
        assert_eq!(readings, Some(4), "{dead:?}");
    }
}

/// How often a channel is bad, for `readings` readings a tenth of a second apart.
fn bad_readings(readings: impl Iterator<Item = f64>) -> usize {
    let mut channels = Channels::default();
    let heard = readings.map(|celsius| {
        channels.hear(0, Some(Temperature((celsius * f64::from(Temperature::PER_KELVIN)) as i32)));
        channels.is_current(0)
    });
    heard.filter(|is_good| !is_good).count()
}

#[test]
fn three_thousand_thermometers_that_jump_are_found_at_the_fourth_reading_and_sound_ones_never() {
    let mut random = Random::new(21);
    let mut beyond = || {
        let by = random.between(10.5, 120.0);
        if random.bits().is_multiple_of(2) { by } else { -by }
    };
    let step =
        |celsius: f64| Some(Temperature((celsius * f64::from(Temperature::PER_KELVIN)) as i32));
    for draw in 0..3_000 {
        let by = beyond();
        let mut channel = Channel::default();
        (0..10).for_each(|_| channel.hear(step(40.0)));
        // Three are sparks.
        (0..draw % 4).for_each(|_| channel.hear(step(40.0 + by)));
        assert_eq!(channel.temperature(), step(40.0), "after {} of {by} K", draw % 4);
        channel.hear(step(40.0));
        // One that stays is told, and then taken for what it is.
        let mut heard = |_: &u32| {
            channel.hear(step(40.0 + by));
            channel.is_faulty()
        };
        assert_eq!((1..=10).find(&mut heard), Some(4), "{by} K");
        assert_eq!((5..=10).find(|it| !heard(it)), Some(7), "{by} K");
        // Any that do not agree are no temperature.
        let mut wild = Channel::default();
        (0..10).for_each(|_| wild.hear(step(40.0)));
        for reading in 1..=40 {
            let now = if reading % 2 == 0 { 40.0 + by } else { 40.0 - by };
            wild.hear(step(now));
            assert_eq!(wild.is_faulty(), reading >= 4);
        }
    }
    // A probe of a second or slower that is thrown from anything between ice and boiling coolant into the other.
    let mut random = Random::new(22);
    for _ in 0..3_000 {
        let (from, to) = (random.between(0.0, 100.0), random.between(0.0, 100.0));
        let tau_s = random.between(1.0, 60.0);
        let rest = |n: u32| (-0.1 * f64::from(n.saturating_sub(10)) / tau_s).exp();
        let sound = (0..200).map(|n| to + (from - to) * rest(n) + 0.03 * random.normal());
        assert_eq!(bad_readings(sound), 0, "from {from} to {to} °C by {tau_s} s");
    }
}

#[test]
fn a_thermometer_whose_first_results_are_none_or_unsettled_is_believed_at_the_first_that_is_right()
{
    let step = |celsius: i32| Some(Temperature(celsius * Temperature::PER_KELVIN));
    for first in [&[][..], &[None], &[None, None, None], &[None, step(-40)], &[step(300), step(90)]]
    {
        let mut channel = Channel::default();
        first.iter().for_each(|it| channel.hear(*it));
        channel.hear(step(20));
        assert!(!channel.is_faulty() && channel.temperature() == step(20), "after {first:?}");
    }
}
