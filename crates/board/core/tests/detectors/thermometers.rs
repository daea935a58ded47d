//! Thermometers: dead ones, ones that jump, ones that stop, and sound ones.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use trueup_core::{
    freeze_detector::FROZEN_AFTER_READINGS,
    index_set::IndexSet,
    temperature_channels::{TemperatureChannel, TemperatureChannels},
    temperature_rate::{DEFAULT_RATE_DECIKELVIN_PER_MIN, TemperatureRateLimit},
    thermometer::{RawTemperatureReading, Thermometer},
    units::Temperature,
};

use crate::{NOISES, hours, random::Random};

#[test]
fn three_thousand_dead_thermometers_are_found_at_the_fourth_reading_and_none_before() {
    let mut random = Random::new(20);
    for _ in 0..3_000 {
        let celsius = random.between(-20.0, 120.0);
        let micro_ohms = |c: f64| {
            RawTemperatureReading((100e6 * (1.0 + 3.9083e-3 * c - 5.775e-7 * c * c)).round() as i32)
        };
        let mut channel = TemperatureChannel::default();
        for _ in 0..10 {
            let reading = micro_ohms(celsius + 0.03 * random.normal());
            channel.receive(Thermometer::Pt100.convert(reading).ok());
            assert!(!channel.is_faulty());
        }
        // A wire that is off, a short circuit, a converter that does not answer: anywhere beyond −65…408 °C.
        let dead = match random.bits() % 3 {
            0 => RawTemperatureReading(random.between(249.1e6, 2e9) as i32),
            1 => RawTemperatureReading(random.between(0.0, 73.9e6) as i32),
            _ => RawTemperatureReading::NONE,
        };
        let readings = (1..=10).find(|_| {
            channel.receive(Thermometer::Pt100.convert(dead).ok());
            channel.is_faulty()
        });
        assert_eq!(readings, Some(4), "{dead:?}");
    }
}

/// Returns how often a channel is bad, for `readings` readings a tenth of a second apart.
fn bad_readings(readings: impl Iterator<Item = f64>) -> usize {
    let mut channels = TemperatureChannels::default();
    let received = readings.map(|celsius| {
        channels
            .receive(0, Some(Temperature((celsius * f64::from(Temperature::PER_KELVIN)) as i32)));
        channels.has_valid_last_reading(0)
    });
    received.filter(|is_good| !is_good).count()
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
        let mut channel = TemperatureChannel::default();
        (0..10).for_each(|_| channel.receive(step(40.0)));
        // Three are sparks.
        (0..draw % 4).for_each(|_| channel.receive(step(40.0 + by)));
        assert_eq!(channel.temperature(), step(40.0), "after {} of {by} K", draw % 4);
        channel.receive(step(40.0));
        // One that stays is reported, and then taken for what it is.
        let mut received = |_: &u32| {
            channel.receive(step(40.0 + by));
            channel.is_faulty()
        };
        assert_eq!((1..=10).find(&mut received), Some(4), "{by} K");
        assert_eq!((5..=10).find(|count| !received(count)), Some(7), "{by} K");
        // Any that do not agree are no temperature.
        let mut wild = TemperatureChannel::default();
        (0..10).for_each(|_| wild.receive(step(40.0)));
        for reading in 1..=40 {
            let now = if reading % 2 == 0 { 40.0 + by } else { 40.0 - by };
            wild.receive(step(now));
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
        let mut channel = TemperatureChannel::default();
        first.iter().for_each(|reading| channel.receive(*reading));
        channel.receive(step(20));
        assert!(!channel.is_faulty() && channel.temperature() == step(20), "after {first:?}");
    }
}

/// Returns the limit of a PT100 that a law uses, where none is stated.
fn default_limit() -> TemperatureRateLimit {
    TemperatureRateLimit::new(
        DEFAULT_RATE_DECIKELVIN_PER_MIN,
        Thermometer::Pt100.resolution(),
        IndexSet::default(),
    )
}

#[test]
fn three_thousand_steps_and_ramps_that_no_mass_can_make_are_found_and_none_is_believed() {
    let mut random = Random::new(23);
    let limit = default_limit();
    for _ in 0..3_000 {
        // From a step of a kelvin to a ramp of a fifth above the limit that ends a kelvin or more away.
        let by =
            random.between(1.2, 60.0) * if random.bits().is_multiple_of(2) { 1.0 } else { -1.0 };
        let per_reading = (12.0 / 600.0_f64).max(random.between(0.0, 1.0).powi(4) * by.abs());
        let noise = STEP_C * random.between(0.0, 3.0);
        let mut channel = TemperatureChannel::default();
        let mut read = |channel: &mut TemperatureChannel, celsius: f64| {
            let reading = (celsius + noise * random.normal()) * f64::from(Temperature::PER_KELVIN);
            channel.receive_reading_with_limit(Ok(Temperature(reading as i32)), &limit, false);
            channel.is_uncertain()
        };
        (0..100).for_each(|_| _ = read(&mut channel, 40.0));
        let ramp = |n: u32| 40.0 + by.signum() * (per_reading * f64::from(n)).min(by.abs());
        let readings = (1..2_000).find(|n| read(&mut channel, ramp(*n)));
        let believed =
            f64::from(channel.temperature().unwrap().0) / f64::from(Temperature::PER_KELVIN);
        // What a mass can do meanwhile, the tolerance, and the noise.
        let rise = 10.0 / 600.0 * f64::from(readings.unwrap_or(u32::MAX));
        assert!((believed - 40.0).abs() < rise + 0.6 + 6.0 * noise, "{by} K by {per_reading}");
    }
}

/// Readings of thermometers whose noise is this many of a converter's steps, on parts that stand, warm up and cool down.
struct Thermometers {
    random: Random,
    noise: f64,
    celsius: [f64; 3],
    target: [f64; 3],
}

/// 1/32 K, as of a MAX31865.
const STEP_C: f64 = 0.031_25;

impl Thermometers {
    fn new(noise: f64, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let celsius = [20.0, 20.0, 20.0].map(|celsius| celsius + STEP_C * random.uniform());
        Self { random, noise, celsius, target: celsius }
    }

    /// The next readings, a tenth of a second later; those before `from` are as they were.
    fn read(&mut self, channels: &mut TemperatureChannels, last: &mut [f64; 3], from: usize) {
        for (number, last) in last.iter_mut().enumerate() {
            if self.random.uniform() < 1e-4 {
                let far =
                    if self.random.uniform() < 0.5 { 0.0 } else { self.random.between(0.0, 25.0) };
                self.target[number] = 20.0 + far;
            }
            self.celsius[number] += (self.target[number] - self.celsius[number]) / 6_000.0;
            let exact = self.celsius[number] / STEP_C + self.noise * self.random.normal();
            if number >= from {
                *last = exact.round() * STEP_C;
            }
            let reading = *last * f64::from(Temperature::PER_KELVIN);
            channels.receive_reading_with_limit(
                number,
                Ok(Temperature(reading as i32)),
                &default_limit(),
            );
        }
    }
}

#[test]
fn a_thermometer_that_stops_is_found_in_40_s_next_to_one_that_goes_on() {
    let mut found = 0;
    for draw in 0..1_000 {
        let noise = Random::new(40 + draw).between(0.6, 3.0);
        let mut sound = Thermometers::new(noise, 50_000 + draw);
        let (mut channels, mut last) = (TemperatureChannels::default(), [0.0; 3]);
        // Eight minutes.
        (0..4_800).for_each(|_| sound.read(&mut channels, &mut last, 0));
        let within = u32::from(FROZEN_AFTER_READINGS) + 5;
        let is_reported = (0..within).any(|_| {
            sound.read(&mut channels, &mut last, 1);
            channels.is_faulty(0)
        });
        found += u32::from(is_reported);
    }
    println!("thermometer stuck: {found} of 1000 found within 40.5 s");
    assert!(found >= 999);
}

fn sound_thermometers(hours: f64) {
    for noise in NOISES {
        let mut sound = Thermometers::new(noise, (1_000.0 * noise) as u64);
        let (mut channels, mut last) = (TemperatureChannels::default(), [0.0; 3]);
        for reading in 0..(hours * 36_000.0) as u64 {
            sound.read(&mut channels, &mut last, 0);
            let faulty = (0..3).any(|number| channels.is_faulty(number));
            let faulty = faulty || channels.uncertain_channels() != IndexSet::default();
            assert!(!faulty, "noise of {noise} steps: an alarm at reading {reading}");
        }
        println!("thermometers, noise of {noise} steps: no false alarm in {hours} h");
    }
}

#[test]
fn a_sound_thermometer_is_believed_at_every_noise() {
    sound_thermometers(hours(30.0));
}
