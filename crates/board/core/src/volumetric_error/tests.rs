//! Tests of the parts cached from message to message, of the extremes, and of the inputs that have to be known.

use super::*;
use crate::{
    axis_errors::CachedErrors,
    calibration::Calibration,
    curve::CurveSegment,
    testing::{minimal_calibration, next_random},
    thermal_state::MachineThermalState,
    units::MicroDegrees,
};

/// Returns a volume of drawn numbers, with a curve of the angle about Y along X.
fn drawn<'a>(seed: &mut u64, curve: Curve<'a>, most: i32) -> VolumetricErrorModel<'a> {
    let mut number =
        |most: i32| (i64::from(next_random(seed)) % (2 * i64::from(most)) - i64::from(most)) as i32;
    let mut vector = |most: i32| [number(most), number(most), number(most)];
    let arm = most.min(MAX_LEVER_ARM);
    let order = [LinearAxis::Z, LinearAxis::X, LinearAxis::Y];
    let line = |axis, moves_workpiece, [point, shift, tilt]: [Vector; 3]| RotaryAxisLocation {
        axis,
        moves_workpiece,
        point: point.map(Position),
        shift: shift.map(FineNanometres),
        tilt: tilt.map(FineNanometres),
    };
    let mut guides = [AngularErrors::default(); 3];
    for guide in &mut guides {
        guide.point = vector(most).map(Position);
        for (angle, slope) in guide.about.iter_mut().zip(vector(most)) {
            angle.slope = Gradient(slope);
        }
    }
    guides[0].about[1] = AngularErrorCurve { slope: Gradient::ZERO, curve };
    VolumetricErrorModel {
        chain: KinematicChain::new(order, (vector(4)[0].unsigned_abs() % 4) as u8)
            .expect("each once"),
        guides,
        tool: vector(arm).map(Position),
        rotary: [
            Some(line(RotaryAxis::B, false, [vector(arm), vector(most), vector(most)])),
            Some(line(RotaryAxis::C, true, [vector(arm), vector(most), vector(most)])),
        ],
    }
}

#[test]
fn what_is_kept_is_what_is_computed_anew_wherever_the_axes_go() {
    let segments = [CurveSegment::new(Position(900), 16, [256, 7, 0, 0]).to_bytes()];
    let curve = Curve::new(Position(-900), &segments, &[[0, 0]], 16);
    let mut seed = 1;
    for _ in 0..50 {
        let volume = drawn(&mut seed, curve, 1 << 20);
        let calibration = Calibration { volume: Some(volume), ..minimal_calibration() };
        let (heat, mut place) = (MachineThermalState::default(), MachinePosition::default());
        let mut cached = CachedErrors::from_position(&calibration, &heat, &place);
        for _ in 0..40 {
            let number = (next_random(&mut seed) % 2_000) as i32 - 1_000;
            match next_random(&mut seed) % 4 {
                3 => {
                    place.angles = [MicroDegrees(number * 90_000), MicroDegrees(number)];
                    cached.update_rotary_angles(&calibration, &place);
                }
                axis => {
                    let axis = LinearAxis::ALL[axis as usize];
                    place.position[axis as usize] = Position(number);
                    cached.update_axis_position(&calibration, &heat, &place, axis);
                }
            }
            // Now and then after several have moved.
            if next_random(&mut seed).is_multiple_of(3) {
                continue;
            }
            cached.sum_guideway_errors(&calibration, &place);
            assert_eq!(*cached.errors(), calibration.compute_axis_errors(&heat, &place));
            let outside = place.position[0].0.abs() > 900;
            assert_eq!(cached.errors().outside, outside, "{place:?}");
        }
    }
}

#[test]
fn the_extremes_saturate_and_never_wrap() {
    let most = FineNanometres(i32::MAX);
    // The largest product of each sign, twice.
    for (angles, lever, along_x) in [
        ([FineNanometres(0), most, FineNanometres(i32::MIN)], [0, i32::MAX, i32::MAX], i32::MAX),
        ([FineNanometres(0), FineNanometres(i32::MIN), most], [0, i32::MAX, i32::MAX], i32::MIN),
        ([FineNanometres(0), FineNanometres(i32::MIN), most], [0, i32::MIN, i32::MIN], i32::MAX),
        ([FineNanometres(0), FineNanometres(i32::MIN), most], [0, i32::MAX, i32::MIN], 8),
    ] {
        let [x, ..] = cross(angles, lever);
        let exact = i128::from(angles[1].0) * i128::from(lever[2])
            - i128::from(angles[2].0) * i128::from(lever[1]);
        let exact = (exact + (1 << 26)) >> 27;
        assert_eq!(i128::from(x), exact.clamp(i32::MIN.into(), i32::MAX.into()), "{angles:?}");
        assert!(along_x == x || along_x == 8);
    }
    let mut seed = 7;
    let wild = [i32::MIN, -1, 0, i32::MAX];
    for at in 0..1_024_usize {
        let volume = drawn(&mut seed, Curve::default(), i32::MAX);
        let calibration = Calibration { volume: Some(volume), ..minimal_calibration() };
        let pick = |digit: u32| wild[at >> (2 * digit) & 3];
        let place = MachinePosition {
            position: [pick(0), pick(1), pick(2)].map(Position),
            angles: [pick(3), pick(4)].map(MicroDegrees),
            ..MachinePosition::default()
        };
        let _ = calibration.compute_axis_errors(&MachineThermalState::default(), &place);
    }
}

#[test]
fn a_chain_has_each_axis_once_and_comes_back_in_its_order() {
    use LinearAxis::{X, Y, Z};
    for order in [[X, Y, Z], [Y, X, Z], [Z, Y, X], [Y, Z, X]] {
        for on_workpiece in 0..=3 {
            let chain = KinematicChain::new(order, on_workpiece).expect("each once");
            assert_eq!((chain.order(), chain.workpiece_axis_count()), (order, on_workpiece));
            for (place, axis) in (0..).zip(order) {
                let moves_workpiece = place < on_workpiece;
                assert_eq!(chain.moves_workpiece(axis), moves_workpiece);
                for (other_place, other) in (0..).zip(order) {
                    let is_farther = other_place > place || other == axis && moves_workpiece;
                    assert_eq!(chain.is_in_lever(axis, other), is_farther, "{axis:?} {other:?}");
                }
            }
        }
    }
    assert_eq!(KinematicChain::new([X, X, Z], 0), None);
    assert_eq!(KinematicChain::new([X, Y, Z], 4), None);
    assert_eq!(KinematicChain::default().order(), [X, Y, Z]);
}

#[test]
fn only_what_changes_an_error_has_to_be_known() {
    let mut volume = VolumetricErrorModel {
        chain: KinematicChain::default(),
        guides: Default::default(),
        tool: [Position(1); 3],
        rotary: [None; 2],
    };
    let needed = |volume: &VolumetricErrorModel<'_>| {
        (
            LinearAxis::ALL.map(|axis| volume.depends_on_position(axis)),
            volume.depends_on_rotary_angles(),
        )
    };
    assert_eq!(needed(&volume), ([false; 3], false));
    // EAY: Y itself, and Z as its lever; EBZ: Z alone.
    volume.guides[1].about[0].slope = Gradient(1);
    assert_eq!(needed(&volume), ([false, true, true], false));
    volume.guides = Default::default();
    volume.guides[2].about[1].slope = Gradient(1);
    assert_eq!(needed(&volume), ([false, false, true], false));
    let line = RotaryAxisLocation {
        axis: RotaryAxis::A,
        moves_workpiece: false,
        point: [Position(0); 3],
        shift: [FineNanometres(0); 3],
        tilt: [FineNanometres(0); 3],
    };
    // A head turns the tool, the lever; of a table only the second axis is turned, by the first.
    volume.rotary[0] = Some(line);
    assert_eq!(needed(&volume), ([false, false, true], true));
    volume.guides = Default::default();
    assert_eq!(needed(&volume), ([false; 3], false));
    let table = RotaryAxisLocation { moves_workpiece: true, shift: [FineNanometres(1); 3], ..line };
    volume.rotary = [Some(table), None];
    assert_eq!(needed(&volume), ([false; 3], false));
    volume.rotary = [Some(table), Some(table)];
    assert_eq!(needed(&volume), ([false; 3], true));
    volume.rotary[0] = Some(RotaryAxisLocation {
        tilt: [FineNanometres(1), FineNanometres(0), FineNanometres(0)],
        ..table
    });
    volume.rotary[1] = None;
    assert_eq!(needed(&volume), ([true; 3], false));
}
