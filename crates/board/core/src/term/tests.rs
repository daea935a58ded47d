//! The terms against `f64`, and their extremes.

use super::*;
use crate::{
    cnc::LinearAxis,
    design_parameters::{MAX_TERMS, TEMPERATURE_CHANNEL_COUNT},
    fixed_point::ScaledCoefficient,
    gradient::Gradient,
    lag::SmoothingFactor,
    machine_position::MachinePosition,
    reversal::ReversalTracker,
    units::{FineNanometres, Position, Rpm, Temperature},
};
extern crate std;
use std::vec::Vec;

/// Returns the nearest coefficient to `value`, as the host makes it.
fn scaled(value: f64) -> ScaledCoefficient {
    let mut shift = 62_u8;
    while (value * 2_f64.powi(shift.into())).abs() >= 1_073_741_823.0 {
        shift -= 1;
    }
    let mantissa = (value * 2_f64.powi(shift.into())).round() as i32;
    ScaledCoefficient { mantissa, shift }
}

fn with(terms: &[(Target, i32, Effect<'static>)]) -> Terms<'static> {
    let mut all = [None; MAX_TERMS];
    for (place, &(target, constant, effect)) in all.iter_mut().zip(terms) {
        *place = Some(Term { target, constant: FineNanometres(constant), effect });
    }
    all
}

fn um(fine: FineNanometres) -> f64 {
    f64::from(fine.0) / 256_000.0
}

#[test]
fn terms_of_the_elongation_apply_in_their_order() {
    let gain = (Target::Elongation, 0, Effect::Gain(scaled(1.0)));
    let offset = (Target::Elongation, 256_000, Effect::Offset);
    let p = FineNanometres(10 * 256_000);
    let (states, operating) = (TermStates::default(), OperatingPoint::default());
    assert_eq!(um(apply_elongation_terms(&with(&[gain, offset]), p, &states, operating)), 21.0);
    assert_eq!(um(apply_elongation_terms(&with(&[offset, gain]), p, &states, operating)), 22.0);
}

#[test]
fn what_a_sensor_a_spindle_and_a_cut_do() {
    let states = TermStates::default();
    let operating = OperatingPoint { speed: Some(Rpm(12_000)), load: 500 * 256 };
    // c·p² with c in 1/µm: p² in fine units is 256 000 times µm², halved 24 times.
    let curvature = scaled(0.01 / 256_000.0 * 2_f64.powi(24));
    for (effect, expected) in [
        (Effect::Curvature(curvature), 75.0),
        (Effect::Saturation(FineNanometres(40 * 256_000)), 40.0),
        (Effect::Speed(scaled(0.05 * 256_000.0 / 1e6)), 57.2),
        (Effect::Load(scaled(-0.01 * 1_000.0)), 45.0),
    ] {
        let terms = with(&[(Target::Elongation, 0, effect)]);
        let got =
            um(apply_elongation_terms(&terms, FineNanometres(50 * 256_000), &states, operating));
        assert!((got - expected).abs() < 1e-5, "{effect:?}: {got}");
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
    let heated = thermal_term_indices(&terms);
    assert!(!states.is_initialised(heated));
    let mut temperatures = [None; TEMPERATURE_CHANNEL_COUNT];
    let mut step_thermal = |temperatures: &_| {
        states.step(&terms, 0, temperatures, None, true);
        states.step(&terms, 1, temperatures, None, true);
        let (errors, _) = compute_axis_errors(&terms, &states, &MachinePosition::default());
        let grown = apply_elongation_terms(
            &terms,
            FineNanometres::ZERO,
            &states,
            OperatingPoint::default(),
        );
        (um(errors[0]), um(grown))
    };
    let near = |got: (f64, f64), expected: (f64, f64)| {
        assert!((got.0 - expected.0).abs() < 1e-5 && (got.1 - expected.1).abs() < 1e-5, "{got:?}");
    };
    near(step_thermal(&temperatures), (0.0, 2.0));
    temperatures[2] = Some(Temperature(27 * Temperature::PER_KELVIN));
    near(step_thermal(&temperatures), (-6.0, 3.5));
    temperatures[2] = Some(Temperature(31 * Temperature::PER_KELVIN));
    near(step_thermal(&temperatures), (-9.0, 4.625));
    temperatures[2] = None;
    near(step_thermal(&temperatures), (-9.0, 8.0 * (1.0 - 0.75_f64.powi(4))));
    assert!(states.is_initialised(heated));
}

/// 3 µm/K at 1.34 m, 4 K above the reference: 12 µm there, −6 µm at −0.67 m, 0 at 0.
#[test]
fn a_slope_by_heat_goes_with_the_position() {
    let heat = Effect::HeatSlope {
        channel: 1,
        smoothing: SmoothingFactor::NO_LAG,
        reference: Temperature(20 * Temperature::PER_KELVIN),
        per_temperature: scaled(3.0 * 256_000.0 / f64::from(Temperature::PER_KELVIN)),
    };
    let terms = with(&[(Target::Axis(LinearAxis::Y), 0, heat)]);
    let mut states = TermStates::default();
    let mut temperatures = [None; TEMPERATURE_CHANNEL_COUNT];
    temperatures[1] = Some(Temperature(24 * Temperature::PER_KELVIN));
    states.step(&terms, 0, &temperatures, None, true);
    for (y, expected) in [(1 << HEAT_SLOPE_BITS, 12.0), (-(1 << 26), -6.0), (0, 0.0)] {
        let position = [Position(77), Position(y), Position(-5)];
        let (errors, _) = compute_axis_errors(
            &terms,
            &states,
            &MachinePosition { position, ..MachinePosition::default() },
        );
        let got = errors.map(um);
        assert!((got[1] - expected).abs() < 1e-5 && [got[0], got[2]] == [0.0; 2], "{got:?}");
    }
    assert!(states.is_initialised(thermal_term_indices(&terms)));
}

/// Ten hours of speeds from 0 to the largest, against the lag and its product in `f64`.
#[test]
fn heat_by_the_speed_starts_cold_and_is_right_over_all_speeds() {
    let mut worst_nm: f64 = 0.0;
    for (power, exponent) in [(SpeedExponent::First, 1), (SpeedExponent::Second, 2)] {
        for tau_s in [1.0, 163.0, 2_400.0, 1e5] {
            let exact = -(-0.1_f64 / tau_s).exp_m1();
            let smoothing = SmoothingFactor((exact * 4_294_967_296.0).round() as u32);
            let given = f64::from(smoothing.0) / 4_294_967_296.0;
            // 100 µm at the largest speed.
            let um_per_unit = -100.0 / f64::from(u16::MAX).powi(exponent);
            let per_unit = scaled(um_per_unit * 256_000.0 / power.input_units_per_speed_power());
            let heat = Effect::SpeedHeat { power, smoothing, per_unit };
            let terms = with(&[(Target::Axis(LinearAxis::Y), 0, heat)]);
            let (mut states, mut lagged, mut seed) = (TermStates::default(), 0.0, 1);
            let mut rpm = 0;
            for step in 0..360_000 {
                if step % 9_000 == 0 {
                    rpm =
                        [u16::MAX, crate::testing::next_random(&mut seed) as u16][step / 9_000 % 2];
                }
                // For a minute nobody knows it.
                let speed = Some(Rpm(rpm)).filter(|_| !(50_000..50_600).contains(&step));
                states.step(&terms, 0, &[None; TEMPERATURE_CHANNEL_COUNT], speed, true);
                let heating = speed.map_or(0.0, |rpm| f64::from(rpm.0).powi(exponent));
                lagged += (heating - lagged) * given;
                let got =
                    um(compute_axis_errors(&terms, &states, &MachinePosition::default()).0[1]);
                worst_nm = worst_nm.max((got - um_per_unit * lagged).abs() * 1e3);
                if step == 0 {
                    assert!((got + 100.0 * exact).abs() < 1e-4, "cold at the start: {got}");
                }
            }
            assert!(states.is_initialised(thermal_term_indices(&terms)));
        }
    }
    std::println!("heat by the speed, 100 µm: {worst_nm:.4} nm at most");
    assert!(worst_nm < 0.01, "{worst_nm} nm");
}

#[test]
fn what_an_axis_adds_depends_on_its_place_and_direction() {
    let x = Target::Axis(LinearAxis::X);
    let metre = 1_000 * Position::PER_MILLIMETRE;
    // 8 µm/m, as in `gradient`.
    let gradient = Gradient((8.0 * 1e-5 * 2_f64.powi(36)) as i32);
    let mut place =
        MachinePosition { position: [Position(metre / 4); 3], ..MachinePosition::default() };
    place.position[1] = Position(metre / 2);
    let at = |effect, place: &MachinePosition| {
        um(compute_axis_errors(&with(&[(x, 0, effect)]), &TermStates::default(), place).0[0])
    };
    let scale = Effect::Position { axis: LinearAxis::X, gradient };
    let cross = Effect::Position { axis: LinearAxis::Y, gradient };
    let reversed = Effect::Reversed { width: FineNanometres(-25 * 256_000), gradient };
    assert!((at(scale, &place) - 2.0).abs() < 1e-5);
    assert!((at(cross, &place) - 4.0).abs() < 1e-5);
    assert_eq!(at(reversed, &place), 0.0);
    place.travel[0] = ReversalTracker::new();
    place.travel[0].update(&crate::reversal::ReversalConfig::default(), Position(0), -1);
    assert!((at(reversed, &place) + 23.0).abs() < 1e-5);
}

/// By hand: 10 µrad at a lever of 100 mm are 1 µm, and −1 µm on the other side of its zero.
#[test]
fn an_angle_acts_by_its_lever() {
    let mm = |mm: i32| Position(mm * Position::PER_MILLIMETRE);
    let at = |x_mm: i32, y_mm: i32, origin_mm: i32| {
        // 20 µrad/m: 20 µm/m² at a lever of 1342.177 28 mm.
        let angle = Gradient((20.0 * 1.342_177_28 * 1e-5 * 2_f64.powi(36)).round() as i32);
        let (along, lever) = (LinearAxis::X, LinearAxis::Y);
        let tilt = Effect::TiltLine(Tilt { along, lever, origin: mm(origin_mm), angle });
        let place =
            MachinePosition { position: [mm(x_mm), mm(y_mm), mm(7)], ..MachinePosition::default() };
        let terms = with(&[(Target::Axis(LinearAxis::X), 0, tilt)]);
        um(compute_axis_errors(&terms, &TermStates::default(), &place).0[0])
    };
    for ((x_mm, y_mm, origin_mm), expected) in [
        ((500, 100, 0), 1.0),
        ((500, 300, 200), 1.0),
        ((500, 100, 200), -1.0),
        ((-500, 100, 0), -1.0),
        ((0, 100, 0), 0.0),
        ((500, 200, 200), 0.0),
        // 300 µrad at a lever of 30 m.
        ((15_000, 15_000, -15_000), 9_000.0_f64.min(f64::from(i32::MAX) / 256_000.0)),
    ] {
        let got = at(x_mm, y_mm, origin_mm);
        assert!(
            (got - expected).abs() < 5e-4,
            "{x_mm} {y_mm} {origin_mm}: {got} is not {expected}"
        );
    }
}

#[test]
fn a_tilt_is_right_over_the_whole_travel() {
    let mut worst: f64 = 0.0;
    let places = || (-20..=20).map(|n| Position(n * 107_374_182));
    for gradient in [-27_000_000, -1_234_567, 1, 98_765] {
        let (along, lever) = (LinearAxis::Z, LinearAxis::Y);
        for (p, l) in places().flat_map(|p| places().map(move |l| (p, l))) {
            let origin = Position(-l.0 / 3);
            let tilt = Effect::TiltLine(Tilt { along, lever, origin, angle: Gradient(gradient) });
            let place =
                MachinePosition { position: [Position(5), l, p], ..MachinePosition::default() };
            let got = tilt.error_at(LinearAxis::X, FineNanometres::ZERO, &place).0;
            let arm = (f64::from(l.0) - f64::from(origin.0)) / f64::from(REFERENCE_LEVER.0);
            let exact = f64::from(gradient) * 2_f64.powi(-28) * f64::from(p.0) * arm;
            let held = exact.clamp(f64::from(i32::MIN), f64::from(i32::MAX));
            worst = worst.max((f64::from(got.0) - held).abs() / 256.0);
        }
    }
    std::println!("a tilt at levers up to 28 m: {worst:.3} nm at most");
    assert!(worst < 0.05, "{worst} nm");
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
                let effect =
                    Effect::Wave { turns, phase, amplitude: FineNanometres(100 * 256_000) };
                let place =
                    MachinePosition { position: [position; 3], ..MachinePosition::default() };
                let got = um(effect.error_at(LinearAxis::Z, FineNanometres::ZERO, &place).0);
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
        let scaled = ScaledCoefficient { mantissa: m, shift: m.unsigned_abs() as u8 };
        effects.extend([
            Effect::Gain(scaled),
            Effect::Curvature(scaled),
            Effect::Saturation(FineNanometres(m)),
            Effect::Speed(scaled),
            Effect::Load(scaled),
            Effect::Position { axis: LinearAxis::Z, gradient: Gradient(m) },
            Effect::Reversed { width: FineNanometres(m), gradient: Gradient(m) },
            Effect::Wave { turns: u64::MAX, phase: u32::MAX, amplitude: FineNanometres(m) },
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
            Effect::HeatSlope {
                channel: 0,
                smoothing: SmoothingFactor(u32::MAX),
                reference: Temperature(m),
                per_temperature: scaled,
            },
            Effect::Time { smoothing: SmoothingFactor(m.unsigned_abs()), amplitude: scaled },
            Effect::SpeedHeat {
                power: if m < 0 { SpeedExponent::First } else { SpeedExponent::Second },
                smoothing: SmoothingFactor(m.unsigned_abs()),
                per_unit: scaled,
            },
            Effect::TiltLine(Tilt {
                along: LinearAxis::X,
                lever: LinearAxis::Z,
                origin: Position(if m < 0 { i32::MAX } else { i32::MIN }),
                angle: Gradient(m),
            }),
        ]);
    }
    for effect in effects {
        for target in [Target::Elongation, Target::Axis(LinearAxis::Y)] {
            let terms = with(&[(target, i32::MAX, effect); MAX_TERMS]);
            for x in extremes {
                let mut states = TermStates::default();
                for index in 0..=MAX_TERMS {
                    let temperatures = [Some(Temperature(x)); TEMPERATURE_CHANNEL_COUNT];
                    states.step(&terms, index, &temperatures, Some(Rpm(u16::MAX)), true);
                }
                let place =
                    MachinePosition { position: [Position(x); 3], ..MachinePosition::default() };
                let _ = compute_axis_errors(&terms, &states, &place);
                let operating = OperatingPoint { speed: Some(Rpm(u16::MAX)), load: i32::MIN };
                let _ = apply_elongation_terms(&terms, FineNanometres(x), &states, operating);
            }
        }
    }
}

#[test]
fn curvature_bends_a_shrinking_spindle_as_it_does_a_growing_one_and_is_held_at_a_millimetre() {
    // As above: 0.001·p² µm.
    let curvature = Effect::Curvature(scaled(0.001 / 256_000.0 * 2_f64.powi(24)));
    let terms = with(&[(Target::Elongation, 0, curvature)]);
    let (states, operating) = (TermStates::default(), OperatingPoint::default());
    let added = |p: i32| {
        um(apply_elongation_terms(&terms, FineNanometres(p), &states, operating))
            - um(FineNanometres(p))
    };
    let held = 2_f64.powi(28) / 256_000.0;
    for sign in [1, -1] {
        assert!((added(sign * 50 * 256_000) - 2.5).abs() < 1e-5);
        // 1.05 mm, and what is beyond adds as much.
        let at_end = added(sign * (1 << 28));
        assert!((at_end - 0.001 * held * held).abs() < 1e-3, "{at_end}");
        assert_eq!(added(sign * (1 << 29)), at_end);
    }
}

#[test]
fn a_tilt_that_bends_is_its_curve_at_the_lever() {
    use crate::curve::{Curve, CurveSegment};
    // 4 µm at a lever of 2²⁷ positions, whatever the position; outside beyond 1 mm.
    let segments =
        std::vec![CurveSegment::new(Position(100_000), 15, [4 * 256_000, 0, 0, 0]).to_bytes()];
    let curve = Curve::new(Position(0), segments.leak(), &[[0, 0]], 17);
    let origin = Position(1_000);
    let tilt = Tilt { along: LinearAxis::X, lever: LinearAxis::Z, origin, angle: curve };
    let terms = with(&[(Target::Axis(LinearAxis::Y), 256_000, Effect::TiltCurve(tilt))]);
    for (x, lever, y_um, outside) in [
        (50_000, REFERENCE_LEVER.0, 5.0, false),
        (50_000, -REFERENCE_LEVER.0 / 2, -1.0, false),
        (100_001, 0, 1.0, true),
    ] {
        let position = [Position(x), Position(0), Position(origin.0 + lever)];
        let place = MachinePosition { position, ..MachinePosition::default() };
        let (errors, is_outside) = compute_axis_errors(&terms, &TermStates::default(), &place);
        assert!((um(errors[1]) - y_um).abs() < 1e-4, "{x}, {lever}: {errors:?}");
        assert_eq!(
            (errors[0], errors[2], is_outside),
            (FineNanometres(0), FineNanometres(0), outside)
        );
    }
}

#[test]
fn a_table_of_a_term_is_that_of_its_own_axis_by_direction() {
    use crate::{pitch_table::PitchErrorTable, reversal::Interval};
    let table =
        |um: [i32; 2]| std::vec![(um[0] * 256_000).to_le_bytes(), (um[1] * 256_000).to_le_bytes()];
    let pitch = PitchErrorTable {
        start: Position(0),
        step: Interval::new(1_000),
        forward: table([1, 3]).leak(),
        reverse: Some(table([5, 9]).leak()),
    };
    let terms = with(&[(Target::Axis(LinearAxis::Z), 0, Effect::Table(pitch))]);
    let config = crate::reversal::ReversalConfig::default();
    for (direction, z, expected_um, outside) in [
        (1, 1_000, 3.0, false),
        (-1, 0, 5.0, false),
        (-1, 1_000, 9.0, false),
        (1, 1_001, 3.0, true),
    ] {
        let mut place =
            MachinePosition { position: [0, 77, z].map(Position), ..MachinePosition::default() };
        place.travel[2].update(&config, Position(z), direction);
        let (errors, is_outside) = compute_axis_errors(&terms, &TermStates::default(), &place);
        assert!((um(errors[2]) - expected_um).abs() < 1e-5, "{direction} at {z}: {errors:?}");
        assert_eq!(
            (errors[0], errors[1], is_outside),
            (FineNanometres(0), FineNanometres(0), outside)
        );
    }
}
