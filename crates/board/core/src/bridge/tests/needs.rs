//! The inputs without which a calibration cannot be followed: each is missed, and no other.

use super::*;
use crate::{
    calibration::{DualDrive, STRAIGHTNESS_AXIS_PAIRS},
    curve::{CURVE_SEGMENT_SIZE, Curve, CurveSegment},
    fixed_point::ScaledCoefficient,
    gradient::Gradient,
    pitch_table::{GantryBeam, PitchErrorTable},
    reversal::Interval,
    term::{Effect, Target, Term, Tilt},
};
extern crate std;

/// Where these axes are, and engaged, for a millisecond.
fn at(rig: &mut Rig, axes: impl Iterator<Item = LinearAxis>) -> Output {
    rig.control(ENGAGED);
    for axis in axes {
        let received =
            AxisPosition { axis, position: Position(0), direction: TravelDirection::Positive };
        rig.bridge.receive(&mut rig.state, CncMessage::Position(received));
    }
    rig.tick(None)
}

#[test]
fn a_guide_needs_the_position_of_the_axis_that_it_guides_whether_it_is_bent_or_not_square() {
    let segments: &'static [[u8; CURVE_SEGMENT_SIZE]] =
        std::vec![CurveSegment::new(Position(100_000), 16, [256, 0, 0, 0]).to_bytes()].leak();
    for (pair, (_, over)) in STRAIGHTNESS_AXIS_PAIRS.into_iter().enumerate() {
        let [mut bent, mut not_square] = [minimal_calibration(); 2];
        bent.straightness[pair] = Curve::new(Position(0), segments, &[[0, 0]], 17);
        not_square.squareness[pair] = Gradient(6_871_948);
        for machine in [bent, not_square] {
            let mut rig = Rig::new(machine);
            let others = || LinearAxis::ALL.into_iter().filter(|axis| *axis != over);
            let output = at(&mut rig, others());
            assert_eq!(output.quality, OffsetQuality::Off, "without {over:?}");
            assert!(output.flags.contains(OffsetFlags::CNC_LOST));
            let output = at(&mut rig, [over].into_iter());
            assert_eq!(output.quality, OffsetQuality::Live, "with {over:?} alone");
            assert!(!output.flags.contains(OffsetFlags::CNC_LOST));
        }
    }
}

#[test]
fn a_term_of_a_temperature_is_held_and_given_up_with_its_thermometer() {
    let mut rig = Rig::new(heat::by_term(expanding(), SmoothingFactor::NO_LAG));
    let output = warm(&mut rig, 300, Some(21), 0);
    assert_eq!((output.quality, output.flags), (OffsetQuality::Live, OffsetFlags::NONE));
    let output = warm(&mut rig, 500, None, 0);
    assert_eq!(output.quality, OffsetQuality::Hold);
    assert!(output.flags.contains(OffsetFlags::SENSOR_FAULT));
    let output = warm(&mut rig, 2_500, None, 0);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
}

/// A sensor that reads 50 codes of growth, a thermometer at 21 °C, X at 1 m; each if it is there.
fn lives(rig: &mut Rig, ms: u32, zero: bool, [sensor, thermometer, position]: [bool; 3]) {
    for _ in 0..ms {
        rig.control(Control { zero, ..ENGAGED });
        if position {
            let position = Position(1_000 * Position::PER_MILLIMETRE);
            let axis = LinearAxis::X;
            let received = AxisPosition { axis, position, direction: TravelDirection::Positive };
            rig.bridge.receive(&mut rig.state, CncMessage::Position(received));
        }
        let codes =
            core::array::from_fn(|n| AdcCode(if sensor { 1_049 + n as u16 % 3 } else { 0 }));
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        raw[3] =
            if thermometer { RawTemperatureReading(21 * 256) } else { RawTemperatureReading::NONE };
        rig.now = rig.now.wrapping_add_ms(1);
        let speed = Some(Rpm(24_000));
        let input = TickInput { temperatures: Some(&raw), speed, codes: Some(&codes) };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
    }
}

fn sensor_and_expansion() -> Calibration<'static> {
    Calibration { spindle: calibration().spindle, ..expanding() }
}

#[test]
fn zero_is_taken_only_while_the_sensor_the_thermometer_and_the_position_are_all_there() {
    for missing in [None, Some(0), Some(1), Some(2)] {
        let mut rig = Rig::new(sensor_and_expansion());
        lives(&mut rig, 1_000, false, [true; 3]);
        let there = core::array::from_fn(|input| Some(input) != missing);
        // Long enough for each to be missed, too short for the offset to be given up.
        lives(&mut rig, 800, false, there);
        let before = rig.last.quality;
        lives(&mut rig, 100, true, there);
        let is_taken = rig.state.reference() != ReferenceErrors::default();
        assert_eq!(is_taken, missing.is_none(), "without {missing:?}");
        assert_eq!(before, if is_taken { OffsetQuality::Live } else { OffsetQuality::Hold });
    }
}

#[test]
fn growth_and_an_axis_that_are_both_held_at_their_limits_are_reported_as_one_is() {
    for (max, is_reported) in [([200_000, 500_000], false), ([50_000, 50_000], true)] {
        let mut machine = sensor_and_expansion();
        // 100 µm of X, 51.2 µm of growth.
        (machine.limits.max[0], machine.limits.max[2]) = (Nanometres(max[0]), Nanometres(max[1]));
        let mut rig = Rig::new(machine);
        lives(&mut rig, 1_000, false, [true; 3]);
        assert_eq!(rig.last.flags.contains(OffsetFlags::CLAMPED), is_reported, "{max:?}");
    }
}

#[test]
fn an_input_that_has_only_not_come_yet_is_off_and_no_fault() {
    let mut rig = Rig::new(expanding());
    // Channel 3 is read in the fourth millisecond.
    for _ in 0..3 {
        rig.tick(None);
        assert_eq!(
            (rig.last.quality, rig.last.offset),
            (OffsetQuality::Off, Some([Nanometres(0); 3]))
        );
    }
}

#[test]
fn heat_that_only_a_fall_back_needs_is_no_fault_while_the_sensor_is_there() {
    let mut machine = sources::chain();
    let warmup = machine.spindle.warmup.as_mut().expect("it has one");
    warmup.law.smoothing_cooling = SmoothingFactor(10_724_000);
    let mut rig = Rig::new(machine);
    let memory = crate::retained_lags::RetainedLags::default();
    rig.bridge.restore_lags(&mut rig.state, &memory, 0);
    let output = rig.run(1_000, 1_050);
    assert!(rig.state.is_thermal_state_unknown());
    assert_eq!((output.quality, output.offset), (OffsetQuality::Off, Some([Nanometres(0); 3])));
}

#[test]
fn the_offset_follows_the_head_from_angle_to_angle() {
    let mut machine = calibration();
    machine.kinematics.axes = [Some(kinematics::RotaryAxis::A), None];
    let mut rig = Rig::new(machine);
    // 102.4 µm of growth along (0, sin A, −cos A).
    for (degrees, y_nm, z_nm) in
        [(0, 0, 102_400), (30, -51_200, 88_681), (30, -51_200, 88_681), (-30, 51_200, 88_681)]
    {
        // Said once, which is enough.
        let angles = [MicroDegrees(degrees * 1_000_000), MicroDegrees(0)];
        rig.bridge.receive(&mut rig.state, CncMessage::Rotary(RotaryAxisAngles { angles }));
        rig.run_engaged(300, 1_100);
        assert_eq!(rig.last.offset, Some([0, y_nm, z_nm].map(Nanometres)), "{degrees} degrees");
    }
}

/// X with a term of this effect.
fn with_term(target: Target, effect: Effect<'static>) -> Calibration<'static> {
    let mut machine = minimal_calibration();
    machine.terms[0] = Some(Term { target, constant: FineNanometres(0), effect });
    machine
}

#[test]
fn each_table_and_term_needs_the_positions_that_it_is_over_and_no_other() {
    use LinearAxis::{X, Y, Z};
    let points: &'static [[u8; 4]] = &[[0; 4]; 2];
    let pitch = PitchErrorTable {
        start: Position(0),
        step: Interval::new(100),
        forward: points,
        reverse: None,
    };
    let gradient = Gradient(6_871_948);
    let curve = Curve::default();
    let (of, origin) = (Target::Axis(X), Position(0));
    let tilted = Tilt { along: X, lever: Z, origin, angle: gradient };
    let bent = Tilt { along: Y, lever: Z, origin, angle: curve };
    let [mut screw, mut gantry, mut backlash] = [minimal_calibration(); 3];
    screw.axes[1].pitch = Some(pitch);
    gantry.axes[0].dual = Some(DualDrive { across: Y, beam: GantryBeam::default(), pitch });
    backlash.axes[2].backlash = FineNanometres(256);
    let wave = Effect::Wave { turns: 1, phase: 0, amplitude: FineNanometres(256) };
    let machines: [(Calibration<'static>, &[LinearAxis]); 13] = [
        (minimal_calibration(), &[]),
        (screw, &[Y]),
        (gantry, &[X, Y]),
        (backlash, &[Z]),
        (with_term(of, Effect::Offset), &[]),
        (with_term(of, Effect::Position { axis: Y, gradient }), &[Y]),
        (with_term(of, Effect::Curve { axis: Z, curve }), &[Z]),
        (with_term(of, Effect::Reversed { width: FineNanometres(256), gradient }), &[X]),
        (with_term(Target::Axis(Y), Effect::Table(pitch)), &[Y]),
        (with_term(Target::Axis(Z), wave), &[Z]),
        (with_term(of, Effect::TiltLine(tilted)), &[X, Z]),
        (with_term(of, Effect::TiltCurve(bent)), &[Y, Z]),
        (with_term(Target::Elongation, Effect::Position { axis: Y, gradient }), &[Y]),
    ];
    for (number, (machine, needed)) in machines.into_iter().enumerate() {
        for bits in 0..8_u8 {
            let needed_axes =
                || LinearAxis::ALL.into_iter().filter(|axis| bits & 1 << *axis as u8 != 0);
            let is_enough =
                needed.iter().all(|axis| needed_axes().any(|reported| reported == *axis));
            let output = at(&mut Rig::new(machine), needed_axes());
            assert_eq!(
                output.quality == OffsetQuality::Live,
                is_enough,
                "machine {number}, {bits:03b}"
            );
            assert_eq!(
                output.flags.contains(OffsetFlags::CNC_LOST),
                !is_enough,
                "machine {number}"
            );
        }
    }
}

#[test]
fn speed_and_load_are_needed_where_a_term_is_over_them_and_the_angles_where_a_head_turns_growth() {
    let scaled = ScaledCoefficient { mantissa: 1, shift: 0 };
    let spindle = CncMessage::Spindle(SpindleState { speed: Rpm(1_000), load_n: 0 });
    let angles = CncMessage::Rotary(RotaryAxisAngles { angles: [MicroDegrees(0); 2] });
    let elongation = Target::Elongation;
    let [mut head, mut growing] = [minimal_calibration(), with_term(elongation, Effect::Offset)];
    head.kinematics.axes[1] = Some(kinematics::RotaryAxis::C);
    growing.kinematics = head.kinematics;
    for (machine, needed) in [
        (minimal_calibration(), None),
        (with_term(elongation, Effect::Offset), None),
        (with_term(elongation, Effect::Speed(scaled)), Some(spindle)),
        (with_term(elongation, Effect::Load(scaled)), Some(spindle)),
        (head, None),
        (growing, Some(angles)),
    ] {
        let is_live = |received: Option<CncMessage>| {
            let mut rig = Rig::new(machine);
            received.into_iter().for_each(|command| rig.bridge.receive(&mut rig.state, command));
            at(&mut rig, [].into_iter()).quality == OffsetQuality::Live
        };
        assert_eq!(is_live(None), needed.is_none(), "{:?}", machine.terms[0]);
        assert!(is_live(needed), "{:?}", machine.terms[0]);
    }
}

#[test]
fn a_single_message_of_a_position_moves_the_offset() {
    let mut rig = Rig::new(expanding());
    warm(&mut rig, 300, Some(21), 1_000);
    let position = Position(1_500 * Position::PER_MILLIMETRE);
    let received =
        AxisPosition { axis: LinearAxis::X, position, direction: TravelDirection::Positive };
    rig.bridge.receive(&mut rig.state, CncMessage::Position(received));
    let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
    raw[3] = RawTemperatureReading(21 * 256);
    for _ in 0..60 {
        rig.control(ENGAGED);
        rig.now = rig.now.wrapping_add_ms(1);
        let input = TickInput { temperatures: Some(&raw), speed: Some(Rpm(0)), codes: None };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
    }
    assert_eq!(rig.last.offset, Some([-150_000, 0, 0].map(Nanometres)));
}
