//! What a calibration cannot be followed without: each input that it needs is missed, and no other.

use super::*;
use crate::{
    calibration::AXIS_PAIRS,
    curve::{Curve, SEGMENT_SIZE, Segment},
    gradient::Gradient,
};
extern crate std;

/// Where these axes are, and engaged, for a millisecond.
fn at(rig: &mut Rig, axes: impl Iterator<Item = LinearAxis>) -> Output {
    rig.control(ENGAGED);
    for axis in axes {
        let heard = AxisPosition { axis, position: Position(0), direction: Heading::Positive };
        rig.bridge.hear(&mut rig.state, Command::Position(heard));
    }
    rig.tick(None)
}

#[test]
fn a_guide_needs_the_position_of_the_axis_that_it_guides_whether_it_is_bent_or_not_square() {
    let segments: &'static [[u8; SEGMENT_SIZE]] =
        std::vec![Segment::new(Position(100_000), 16, [256, 0, 0, 0]).to_bytes()].leak();
    for (pair, (_, over)) in AXIS_PAIRS.into_iter().enumerate() {
        let [mut bent, mut not_square] = [plain(); 2];
        bent.straightness[pair] = Curve::new(Position(0), segments, &[[0, 0]], 17);
        not_square.squareness[pair] = Gradient(6_871_948);
        for machine in [bent, not_square] {
            let mut rig = Rig::new(machine);
            let others = || LinearAxis::ALL.into_iter().filter(|axis| *axis != over);
            let output = at(&mut rig, others());
            assert_eq!(output.quality, Quality::Off, "without {over:?}");
            assert!(output.flags.contains(Flags::CNC_LOST));
            let output = at(&mut rig, [over].into_iter());
            assert_eq!(output.quality, Quality::Live, "with {over:?} alone");
            assert!(!output.flags.contains(Flags::CNC_LOST));
        }
    }
}

#[test]
fn a_term_of_a_temperature_is_held_and_given_up_with_its_thermometer() {
    let mut rig = Rig::new(heat::by_term(expanding(), SmoothingFactor::NO_LAG));
    let output = warm(&mut rig, 300, Some(21), 0);
    assert_eq!((output.quality, output.flags), (Quality::Live, Flags::NONE));
    let output = warm(&mut rig, 500, None, 0);
    assert_eq!(output.quality, Quality::Hold);
    assert!(output.flags.contains(Flags::SENSOR_FAULT));
    let output = warm(&mut rig, 2_500, None, 0);
    assert_eq!((output.quality, output.offset), (Quality::Fault, None));
}
