//! The filter's promises, measured from the sensor's volts to nanometres: noise, run-out, step,
//! arithmetic, and the inverter's carrier. Every figure that the documentation states is printed
//! here (`cargo test -p trueup-host-tests --test filter_figures -- --show-output`).

use std::{f64::consts::TAU, iter::repeat_with};

use rustfft::{FftPlanner, num_complex::Complex};
use trueup_core::{
    design_parameters::CODES_PER_TICK,
    run_out_filter::RunOutFilter,
    units::{AdcCode, READING_UNITS_PER_CODE, Rpm},
};
use trueup_emulator::analogue_front_end::{AnalogueFrontEnd, SAMPLE_RATE_HZ};

/// The paper's sensor: 500 µm over 4096 codes and over 10 V.
const NM_PER_CODE: f64 = 500_000.0 / 4096.0;
const NM_PER_VOLT: f64 = 50_000.0;
const DIVIDER: f64 = 0.33;

type Block = [AdcCode; CODES_PER_TICK];

/// Readings in nanometres, one a millisecond, from the first one that the filter gives.
fn filtered(blocks: impl Iterator<Item = Block>, known: Option<Rpm>) -> impl Iterator<Item = f64> {
    let mut filter = RunOutFilter::new();
    blocks.filter_map(move |codes| {
        let reading = filter.tick(&codes, known)?;
        Some(f64::from(reading.0) / f64::from(READING_UNITS_PER_CODE) * NM_PER_CODE)
    })
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (squares, count) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    (squares / f64::max(count, 1.0)).sqrt()
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).fold(0.0, f64::max)
}

/// Returns a code of the ideal converter, without noise.
fn ideal(nm: f64) -> AdcCode {
    AdcCode((nm / NM_PER_CODE).round().clamp(0.0, 4095.0) as u16)
}

#[test]
fn white_noise_of_one_lsb_leaves_30_nm_at_1_khz_and_5_nm_below_10_hz() {
    const LEVEL_VOLTS: f64 = 1.540_7;
    const SAMPLES: usize = 1 << 15;
    for rpm in [0, 300, 301, 1_000, 3_333, 6_000, 12_000, 18_001, 24_000] {
        let mut front_end = AnalogueFrontEnd::new(DIVIDER, u64::from(rpm) + 1);
        let blocks = repeat_with(|| front_end.convert_block(|_| LEVEL_VOLTS));
        let error: Vec<f64> = filtered(blocks, Some(Rpm(rpm)))
            .take(SAMPLES)
            .map(|nm| nm - LEVEL_VOLTS * NM_PER_VOLT)
            .collect();
        let all = rms(error.iter().copied());

        let mut spectrum: Vec<Complex<f64>> = error.iter().map(|&e| e.into()).collect();
        FftPlanner::new().plan_fft_forward(SAMPLES).process(&mut spectrum);
        // Both halves of the spectrum, the mean included; Parseval.
        let power = |bin: usize| spectrum[bin].norm_sqr() / (SAMPLES as f64).powi(2);
        let below_10_hz = 10 * SAMPLES / 1_000;
        let slow = (power(0) + (1..=below_10_hz).map(|bin| 2.0 * power(bin)).sum::<f64>()).sqrt();

        println!("noise at {rpm:>5} r/min: {all:5.2} nm RMS at 1 kHz, {slow:4.2} nm in 0–10 Hz");
        assert!(all <= 30.0 && slow <= 5.0, "{all} {slow}");
    }
}

/// Run-out in nanometres: ±5 µm with 20 % second and 10 % third harmonic.
fn run_out(turns: f64) -> f64 {
    let angle = TAU * turns;
    5_000.0 * (angle.sin() + 0.2 * (2.0 * angle + 0.4).sin() + 0.1 * (3.0 * angle + 1.9).sin())
}

#[test]
fn run_out_leaves_20_nm_at_any_speed_even_if_it_is_known_to_1_percent() {
    const LEVEL_NM: f64 = 77_077.0;
    let mut worst = (0.0, 0, 0.0);
    for rpm in (300..=24_000_u16).step_by(37).chain([24_000]) {
        for known in [0.99, 1.0, 1.01] {
            let mut n = 0.0;
            let blocks = repeat_with(|| -> Block {
                std::array::from_fn(|_| {
                    n += 1.0;
                    ideal(LEVEL_NM + run_out(n / SAMPLE_RATE_HZ * f64::from(rpm) / 60.0))
                })
            });
            let known_rpm = Rpm((f64::from(rpm) * known).round() as u16);
            let revolution_ms = 60_000 / usize::from(rpm);
            let readings = filtered(blocks, Some(known_rpm)).take(4 * revolution_ms + 200);
            let left = largest(readings.map(|nm| nm - LEVEL_NM));
            if left > worst.0 {
                worst = (left, rpm, known);
            }
        }
    }
    let (left, rpm, known) = worst;
    println!("run-out: largest rest {left:.2} nm, at {rpm} r/min known as {known} of it");
    assert!(left <= 20.0, "{left}");
}

#[test]
fn a_step_has_settled_to_1_percent_after_5_revolutions_and_20_ms() {
    const STEP_NM: f64 = 100_000.0;
    let mut slowest: f64 = 0.0;
    for rpm in (300..=24_000_u16).step_by(150) {
        let revolution_ms = 60_000.0 / f64::from(rpm);
        let before = (3.0 * revolution_ms) as usize + 5;
        let mut ms = 0;
        let blocks = repeat_with(|| {
            ms += 1;
            [ideal(100_000.0 + if ms > before { STEP_NM } else { 0.0 }); CODES_PER_TICK]
        });
        // The filter gives nothing for its first ticks: count them to place the step.
        let readings: Vec<f64> = filtered(blocks, Some(Rpm(rpm)))
            .take(before + (8.0 * revolution_ms) as usize)
            .collect();
        let end = *readings.last().expect("readings");
        let last_off = readings.iter().rposition(|nm| (nm - end).abs() > STEP_NM / 100.0);
        let first_given = (2.0 * revolution_ms).ceil() as usize;
        let settled_ms = (last_off.expect("it was off before the step") + 1 + first_given) - before;
        let allowed = 5.0 * revolution_ms + 20.0;
        slowest = slowest.max(settled_ms as f64 / allowed);
        assert!(settled_ms as f64 <= allowed, "{settled_ms} ms at {rpm} r/min");
    }
    println!("step: slowest takes {slowest:.2} of 5 revolutions and 20 ms");
}

/// Returns the filter in `f64`, from its definition: sums of four, two means over exactly one revolution
/// with fractional ends, every fifth value.
fn reference(codes: &[f64], revolution: f64) -> Vec<Option<f64>> {
    let mean = |values: &[f64]| -> Option<f64> {
        let whole = revolution.floor() as usize;
        let part = revolution.fract();
        let older = values.len().checked_sub(whole)?;
        let end = if part > 0.0 { part * values[older.checked_sub(1)?] } else { 0.0 };
        Some((values[older..].iter().sum::<f64>() + end) / revolution)
    };
    let mut samples = Vec::new();
    let mut means = Vec::new();
    let mut out = Vec::new();
    for (n, four) in codes.chunks_exact(4).enumerate() {
        samples.push(four.iter().sum::<f64>() / 4.0);
        means.extend(mean(&samples));
        if n % 5 == 4 {
            out.push(mean(&means));
        }
    }
    out
}

/// Separates the rest of run-out into the filter's and the converter's: the same input without
/// rounding to codes, through the filter's definition.
#[test]
fn without_rounding_to_codes_run_out_leaves_a_nanometre() {
    let mut worst: f64 = 0.0;
    for rpm in (300..=24_000_u16).step_by(790).chain([24_000]) {
        let turns_per_sample = f64::from(rpm) / 60.0 / SAMPLE_RATE_HZ;
        let ms = 3 * 60_000 / u32::from(rpm) + 50;
        let input: Vec<f64> =
            (0..ms * 20).map(|n| run_out(f64::from(n) * turns_per_sample)).collect();
        for known in [0.99, 1.0, 1.01] {
            let readings = reference(&input, 300_000.0 / (f64::from(rpm) * known).max(300.0));
            worst = worst.max(largest(readings.into_iter().flatten()));
        }
    }
    println!("run-out that is not rounded to codes: largest rest {worst:.2} nm");
    assert!(worst <= 2.0, "{worst}");
}

#[test]
fn the_arithmetic_is_within_2_nm_of_f64_over_the_whole_input_range() {
    let mut random = 1_u32;
    let mut next = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        random >> 20
    };
    const MS: u32 = 460;
    let noise: Vec<AdcCode> = (0..MS * 20).map(|_| AdcCode(next() as u16)).collect();
    type Signal = Box<dyn Fn(u32) -> u16>;
    let signals: [(&str, Signal); 5] = [
        ("full scale", Box::new(|_| 4095)),
        ("zero", Box::new(|_| 0)),
        ("ramp over the range", Box::new(|n| (n * 4095 / (MS * 20)) as u16)),
        ("full-scale square wave", Box::new(|n| if n / 73 % 2 == 0 { 0 } else { 4095 })),
        ("random codes", Box::new(move |n| noise[n as usize].0)),
    ];
    let mut worst: f64 = 0.0;
    for (name, signal) in &signals {
        let codes: Vec<AdcCode> = (0..MS * 20).map(|n| AdcCode(signal(n))).collect();
        let levels: Vec<f64> = codes.iter().map(|code| f64::from(code.0)).collect();
        let mut worst_here: f64 = 0.0;
        for rpm in [300_u16, 301, 437, 999, 2_500, 7_919, 12_345, 23_999, 24_000, 60_000] {
            let exact = reference(&levels, 300_000.0 / f64::from(rpm));
            let mut filter = RunOutFilter::new();
            for (codes, exact) in codes.chunks_exact(20).zip(exact) {
                let block: &Block = codes.try_into().expect("chunks of 20");
                let ours = filter.tick(block, Some(Rpm(rpm)));
                assert_eq!(ours.is_some(), exact.is_some());
                if let (Some(ours), Some(exact)) = (ours, exact) {
                    let error = f64::from(ours.0) / f64::from(READING_UNITS_PER_CODE) - exact;
                    worst_here = worst_here.max(error.abs() * NM_PER_CODE);
                }
            }
        }
        println!("arithmetic: {name}: largest difference from f64 {worst_here:.3} nm");
        worst = worst.max(worst_here);
    }
    assert!(worst <= 2.0, "{worst}");
}

#[test]
fn an_inverters_carrier_leaves_60_nm_behind_the_low_pass_and_micrometres_without() {
    const LEVEL_VOLTS: f64 = 1.7;
    const CARRIER_VOLTS: f64 = 0.1;
    let shift = |low_pass: bool, hz: f64, phase: f64, rpm: u16| {
        let mut front_end = AnalogueFrontEnd::new(DIVIDER, 5);
        if !low_pass {
            front_end = front_end.without_low_pass();
        }
        let volts = move |t: f64| LEVEL_VOLTS + CARRIER_VOLTS * (TAU * hz * t + phase).cos();
        let blocks = repeat_with(|| front_end.convert_block(volts));
        let readings: Vec<f64> = filtered(blocks, Some(Rpm(rpm))).skip(50).take(1_000).collect();
        readings.iter().sum::<f64>() / readings.len() as f64 - LEVEL_VOLTS * NM_PER_VOLT
    };
    for hz in [16_000.0, 20_000.0, 40_000.0] {
        let (mut with, mut without) = (0.0_f64, 0.0_f64);
        for rpm in [0, 1_237, 24_000] {
            for phase in (0..8).map(|eighth| TAU * f64::from(eighth) / 8.0) {
                with = with.max(shift(true, hz, phase, rpm).abs());
            }
            without = without.max(shift(false, hz, 0.0, rpm).abs());
        }
        println!(
            "carrier at {hz:>6} Hz: {with:5.1} nm with the low-pass, {without:6.1} nm without"
        );
        assert!(with <= 60.0, "{with}");
        // What folds onto 0 Hz is untouched by any digital filter: 0.1 V are 5 µm.
        if hz >= SAMPLE_RATE_HZ {
            assert!(without > 4_900.0, "{without}");
        }
    }
}

#[test]
fn the_first_reading_is_no_ramp_from_zero() {
    const LEVEL_VOLTS: f64 = 4.0;
    for rpm in [0, 300, 24_000] {
        let mut front_end = AnalogueFrontEnd::new(DIVIDER, 9);
        let blocks = repeat_with(|| front_end.convert_block(|_| LEVEL_VOLTS));
        let first = filtered(blocks, Some(Rpm(rpm))).next().expect("a reading");
        let off = first - LEVEL_VOLTS * NM_PER_VOLT;
        println!("first reading at {rpm:>5} r/min: off by {off:+.1} nm");
        assert!(off.abs() < 100.0, "{off}");
    }
}
