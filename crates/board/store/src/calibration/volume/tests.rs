//! The record of the volume: where it lies, that it comes back, and what is refused.

use trueup_core::{
    calibration::Calibration,
    cnc::LinearAxis,
    design_parameters::MAX_TERMS,
    gradient::Gradient,
    term::{Effect, Target, Term},
};

use super::*;
use crate::calibration::{
    decode,
    tests::{blob, mended, with_sample, with_smallest},
};

/// Calls `check` with a volume that has something of everything.
fn with_volume<T>(mut calibration: Calibration<'_>, check: impl FnOnce(Calibration<'_>) -> T) -> T {
    let curve = calibration.straightness[0];
    let slope = Gradient(-31);
    let mut guides = [AngularErrors::default(); 3];
    guides[0].point = [1, -2, i32::MAX].map(Position);
    guides[0].about[1] = AngularErrorCurve { slope, curve: Curve::default() };
    guides[2].about[2] = AngularErrorCurve { slope: Gradient::ZERO, curve };
    let order = [LinearAxis::Y, LinearAxis::X, LinearAxis::Z];
    let line = RotaryAxisLocation {
        axis: RotaryAxis::C,
        moves_workpiece: true,
        point: [5, -6, MAX_LEVER_ARM].map(Position),
        shift: [7, -8, 9].map(FineNanometres),
        tilt: [-1, 2, i32::MIN].map(FineNanometres),
    };
    calibration.volume = Some(VolumetricErrorModel {
        chain: KinematicChain::new(order, 1).expect("each once"),
        guides,
        tool: [1, 2, -MAX_LEVER_ARM].map(Position),
        rotary: [Some(line), None],
    });
    check(calibration)
}

/// Returns where the record of the volume begins, by the last of the terms.
fn record(blob: &[u8]) -> usize {
    let word = |at: usize| usize::from(u16::from_le_bytes([blob[at], blob[at + 1]]));
    let last = word(572) + 24 * (word(574) - 1);
    assert_eq!(blob[last], VOLUMETRIC_TERM_KIND);
    word(last + 8)
}

#[test]
fn a_volume_comes_back_alone_and_after_all_terms_there_can_be() {
    let full = |mut calibration: Calibration<'_>| {
        let term = Term {
            target: Target::Elongation,
            constant: FineNanometres(1),
            effect: Effect::Offset,
        };
        calibration.terms = [Some(term); MAX_TERMS];
        with_volume(calibration, |calibration| {
            assert_eq!(decode(&blob(&calibration)), Ok(calibration))
        });
    };
    with_smallest(|volume| {
        with_volume(volume, |calibration| assert_eq!(decode(&blob(&calibration)), Ok(calibration)))
    });
    with_sample(|volume| {
        with_volume(volume, |calibration| assert_eq!(decode(&blob(&calibration)), Ok(calibration)))
    });
    with_sample(full);
}

#[test]
fn a_volume_adds_its_records_and_changes_nothing_before_them() {
    with_smallest(|calibration| {
        let without = blob(&calibration);
        with_volume(calibration, |with| {
            let with = blob(&with);
            assert_eq!(with.len(), without.len() + 24 + VolumetricErrorModel::SIZE);
            // Length, reference to the terms, CRC.
            let same = |at: usize| !(6..8).contains(&at) && !(572..576).contains(&at);
            let fixed = (0..without.len() - 4).filter(|at| same(*at));
            for at in fixed {
                assert_eq!(with[at], without[at], "byte {at}");
            }
        });
    });
}

#[test]
fn what_has_no_meaning_in_a_volume_is_refused() {
    let good = with_smallest(|volume| with_volume(volume, |calibration| blob(&calibration)));
    let start = record(&good);
    let of_rotary = start + 4 + 216 + 12;
    for (at, byte) in [
        // The same axis twice, none, four on the workpiece.
        (start, 0),
        (start, 3),
        (start + 3, 4),
        // The bucket shift of a curve, a tool and a point beyond what turns, axis and side.
        (start + 4 + 12 + 4 + 13, 1),
        (start + 4 + 216 + 3, 0x7F),
        (of_rotary + 4 + 3, 0x7F),
        (of_rotary, 4),
        (of_rotary + 1, 2),
        (of_rotary + 2, 1),
    ] {
        let mut bad = good.clone();
        bad[at] = byte;
        assert!(decode(&mended(bad)).is_err(), "{byte:#x} at {at}");
    }
    // Two records, and a volume that is not the last of the terms.
    let terms = usize::from(u16::from_le_bytes([good[572], good[573]]));
    let mut bad = good.clone();
    bad[terms + 10] = 2;
    assert!(decode(&mended(bad)).is_err());
    let mut bad = good;
    bad[574] = 2;
    assert!(decode(&mended(bad)).is_err());
}
