//! The terms against `f64`, and their extremes.

use super::*;
use crate::{
    cnc::LinearAxis,
    dimensions::{CHANNELS, MAX_TERMS},
    fixed::Scaled,
    gradient::Gradient,
    lag::SmoothingFactor,
    place::Place,
    travel::Travel,
    units::{Fine, Position, Rpm, Temperature},
};
extern crate std;
use std::vec::Vec;

/// The nearest coefficient to `value`, as the host makes it.
fn scaled(value: f64) -> Scaled {
    let mut shift = 62_u8;
    while (value * 2_f64.powi(shift.into())).abs() >= 1_073_741_823.0 {
        shift -= 1;
    }
    let mantissa = (value * 2_f64.powi(shift.into())).round() as i32;
    Scaled { mantissa, shift }
}

fn with(terms: &[(Target, i32, Effect<'static>)]) -> Terms<'static> {
    let mut all = [None; MAX_TERMS];
    for (place, &(target, constant, effect)) in all.iter_mut().zip(terms) {
        *place = Some(Term { target, constant: Fine(constant), effect });
    }
    all
}

fn um(fine: Fine) -> f64 {
    f64::from(fine.0) / 256_000.0
}

#[test]
fn terms_of_the_elongation_apply_in_their_order() {
    let gain = (Target::Elongation, 0, Effect::Gain(scaled(1.0)));
    let offset = (Target::Elongation, 256_000, Effect::Offset);
    let p = Fine(10 * 256_000);
    let (states, operating) = (TermStates::default(), OperatingPoint::default());
    assert_eq!(um(elongation(&with(&[gain, offset]), p, &states, operating)), 21.0);
    assert_eq!(um(elongation(&with(&[offset, gain]), p, &states, operating)), 22.0);
}

#[test]
fn what_a_sensor_a_spindle_and_a_cut_do() {
    let states = TermStates::default();
    let operating = OperatingPoint { speed: Some(Rpm(12_000)), load: 500 * 256 };
    // c·p² with c in 1/µm: p² in fine units is 256 000 times µm², halved 24 times.
    let curvature = scaled(0.01 / 256_000.0 * 2_f64.powi(24));
    for (effect, wanted) in [
        (Effect::Curvature(curvature), 75.0),
        (Effect::Saturation(Fine(40 * 256_000)), 40.0),
        (Effect::Speed(scaled(0.05 * 256_000.0 / 1e6)), 57.2),
        (Effect::Load(scaled(-0.01 * 1_000.0)), 45.0),
    ] {
        let terms = with(&[(Target::Elongation, 0, effect)]);
        let got = um(elongation(&terms, Fine(50 * 256_000), &states, operating));
        assert!((got - wanted).abs() < 1e-5, "{effect:?}: {got}");
    }
}

#[test]
fn heat_follows_its_lag_and_time_its_own() {
    let kelvin = f64::from(Temperature::PER_KELVIN);
    // −3 µm/K from 25 °C, with a smoothing factor of a quarter a step.
    let heat = Effect::Heat {
        channel: 2,
        smoothing: SmoothingFactor(1 << 30),
        reference: Temperature(25 * Temperature::PER_KELVIN),
        per_temperature: scaled(-3.0 * 256_000.0 / kelvin),
    };
    let amplitude = scaled(8.0 * 256_000.0 / f64::from(UNIT_STEP));
    let time = Effect::Time { smoothing: SmoothingFactor(1 << 30), amplitude };
    let x = Target::Axis(LinearAxis::X);
    let terms = with(&[(x, 0, heat), (Target::Elongation, 0, time)]);
    let mut states = TermStates::default();
    let heated = heat_terms(&terms);
    assert!(!states.knows(heated));
    let mut temperatures = [None; CHANNELS];
    let mut heat_up = |temperatures: &_| {
        states.step(&terms, 0, temperatures);
        states.step(&terms, 1, temperatures);
        let (errors, _) = axis_errors(&terms, &states, &Place::default());
        let grown = elongation(&terms, Fine::ZERO, &states, OperatingPoint::default());
        (um(errors[0]), um(grown))
    };
    let near = |got: (f64, f64), wanted: (f64, f64)| {
        assert!((got.0 - wanted.0).abs() < 1e-5 && (got.1 - wanted.1).abs() < 1e-5, "{got:?}");
    };
    near(heat_up(&temperatures), (0.0, 2.0));
    temperatures[2] = Some(Temperature(27 * Temperature::PER_KELVIN));
    near(heat_up(&temperatures), (-6.0, 3.5));
    temperatures[2] = Some(Temperature(31 * Temperature::PER_KELVIN));
    near(heat_up(&temperatures), (-9.0, 4.625));
    temperatures[2] = None;
    near(heat_up(&temperatures), (-9.0, 8.0 * (1.0 - 0.75_f64.powi(4))));
    assert!(states.knows(heated));
}

#[test]
fn what_an_axis_adds_depends_on_its_place_and_direction() {
    let x = Target::Axis(LinearAxis::X);
    let metre = 1_000 * Position::PER_MILLIMETRE;
    // 8 µm/m, as in `gradient`.
    let gradient = Gradient((8.0 * 1e-5 * 2_f64.powi(36)) as i32);
    let mut place = Place { position: [Position(metre / 4); 3], ..Place::default() };
    place.position[1] = Position(metre / 2);
    let at = |effect, place: &Place| {
        um(axis_errors(&with(&[(x, 0, effect)]), &TermStates::default(), place).0[0])
    };
    let scale = Effect::Position { axis: LinearAxis::X, gradient };
    let cross = Effect::Position { axis: LinearAxis::Y, gradient };
    let reversed = Effect::Reversed { width: Fine(-25 * 256_000), gradient };
    assert!((at(scale, &place) - 2.0).abs() < 1e-5);
    assert!((at(cross, &place) - 4.0).abs() < 1e-5);
    assert_eq!(at(reversed, &place), 0.0);
    place.travel[0] = Travel::new();
    place.travel[0].update(&crate::travel::Config::default(), Position(0), -1);
    assert!((at(reversed, &place) + 23.0).abs() < 1e-5);
}

#[test]
fn a_wave_repeats_over_the_whole_travel() {
    let mut worst: f64 = 0.0;
    for period_mm in [0.25, 1.0, 5.0, 37.3, 2_500.0] {
        let turns = (2_f64.powi(64) / (period_mm * 1e5)) as u64;
        // The period as it is stored: right to 2⁻⁵³ of itself.
        for (degrees, phase) in [(0.0, 0), (90.0, 1 << 30), (-90.0, 3 << 30)] {
            for n in -4000..4000 {
                let position = Position(n * 386_117);
                let effect = Effect::Wave { turns, phase, amplitude: Fine(100 * 256_000) };
                let place = Place { position: [position; 3], ..Place::default() };
                let got = um(effect.at(LinearAxis::Z, Fine::ZERO, &place).0);
                let turn = f64::from(position.0) / 1e5 / period_mm + degrees / 360.0;
                let exact = 100.0 * (std::f64::consts::TAU * turn).sin();
                worst = worst.max((got - exact).abs());
            }
        }
    }
    std::println!("a wave of 100 µm: {:.4} nm at most", worst * 1e3);
    assert!(worst < 5e-6, "{worst} µm");
}

#[test]
fn nothing_extreme_panics() {
    let extremes = [i32::MIN, -1, 0, 1, i32::MAX];
    let mut effects = Vec::new();
    for m in extremes {
        let scaled = Scaled { mantissa: m, shift: m.unsigned_abs() as u8 };
        effects.extend([
            Effect::Gain(scaled),
            Effect::Curvature(scaled),
            Effect::Saturation(Fine(m)),
            Effect::Speed(scaled),
            Effect::Load(scaled),
            Effect::Position { axis: LinearAxis::Z, gradient: Gradient(m) },
            Effect::Reversed { width: Fine(m), gradient: Gradient(m) },
            Effect::Wave { turns: u64::MAX, phase: u32::MAX, amplitude: Fine(m) },
            Effect::Heat {
                channel: 255,
                smoothing: SmoothingFactor(u32::MAX),
                reference: Temperature(m),
                per_temperature: scaled,
            },
            Effect::Heat {
                channel: 0,
                smoothing: SmoothingFactor(7),
                reference: Temperature(m),
                per_temperature: scaled,
            },
            Effect::Time { smoothing: SmoothingFactor(m.unsigned_abs()), amplitude: scaled },
        ]);
    }
    for effect in effects {
        for target in [Target::Elongation, Target::Axis(LinearAxis::Y)] {
            let terms = with(&[(target, i32::MAX, effect); MAX_TERMS]);
            for x in extremes {
                let mut states = TermStates::default();
                for index in 0..=MAX_TERMS {
                    states.step(&terms, index, &[Some(Temperature(x)); CHANNELS]);
                }
                let place = Place { position: [Position(x); 3], ..Place::default() };
                let _ = axis_errors(&terms, &states, &place);
                let operating = OperatingPoint { speed: Some(Rpm(u16::MAX)), load: i32::MIN };
                let _ = elongation(&terms, Fine(x), &states, operating);
            }
        }
    }
}
