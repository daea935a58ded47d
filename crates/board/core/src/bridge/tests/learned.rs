//! Learned changes in the offset: their sign, their way, and the sources that they do not apply to.

use super::*;
use crate::{
    learned_changes::{LearnedChangeRequest, LearnedLimits},
    retained_lags::RetainedLags,
};

const LEARNED_LIMITS: LearnedLimits = LearnedLimits { growth: 250, axes: 250, zero: 200 };

fn apply_change(rig: &mut Rig, part: u8, amount: i16) {
    assert!(rig.bridge.apply_learned_change(
        &mut rig.state,
        LearnedChangeRequest { part, amount, calibration: 0 }
    ));
}

/// Engaged for so long; the largest step of an offset in a tick, in nm.
fn largest_step(rig: &mut Rig, ms: u32, code: u16) -> i32 {
    let mut largest = 0;
    for n in 0..ms {
        let before = rig.z_nm();
        if n % 20 == 0 {
            rig.control(ENGAGED);
        }
        rig.run(1, code);
        largest = largest.max((rig.z_nm() - before).abs());
    }
    largest
}

#[test]
fn two_percent_more_of_the_growth_lift_it_by_two_percent_and_no_tick_steps() {
    let mut calibration = calibration();
    calibration.limits.learned = LEARNED_LIMITS;
    let mut rig = Rig::new(calibration);
    rig.run_engaged(300, 1050);
    assert_eq!(rig.z_nm(), 51_200);
    apply_change(&mut rig, 1, 2_000);
    apply_change(&mut rig, 5, -500);
    // Half of the way after 1000 steps of 100 ms; the zero has had all of its 500 by then.
    assert!(largest_step(&mut rig, 100_000, 1050) <= 2, "0.5 nm and 1 nm, each at its millisecond");
    assert!((rig.z_nm() - (51_200 + 512 - 500)).abs() <= 1, "{}", rig.z_nm());
    largest_step(&mut rig, 110_000, 1050);
    assert_eq!(rig.z_nm(), 51_200 + 1_024 - 500);
    // Twice the growth, twice what was learned of it.
    rig.run_engaged(300, 1100);
    assert_eq!(rig.z_nm(), 2 * (51_200 + 1_024) - 500);
    apply_change(&mut rig, 1, 0);
    apply_change(&mut rig, 5, 0);
    assert!(largest_step(&mut rig, 210_000, 1100) <= 2);
    assert_eq!(rig.z_nm(), 102_400);
}

#[test]
fn the_slew_limit_holds_however_slow_it_is() {
    let mut calibration = calibration();
    calibration.limits.learned = LEARNED_LIMITS;
    let mut rig = Rig::new(calibration);
    rig.run_engaged(300, 1050);
    // 1 nm/s: slower than what was learned would have it.
    calibration.limits.slew_nm_per_s = 1;
    rig.bridge = Bridge::new(calibration);
    apply_change(&mut rig, 5, 20_000);
    let z = rig.z_nm();
    largest_step(&mut rig, 20_000, 1050);
    assert!((rig.z_nm() - z - 20).abs() <= 1, "{} nm in 20 s", rig.z_nm() - z);
}

#[test]
fn an_axis_expands_by_its_share_more_wherever_it_stands() {
    let mut calibration = expanding();
    calibration.limits.learned = LEARNED_LIMITS;
    let mut rig = Rig::new(calibration);
    // 1 K and 1 m are 100 µm, against the axis; 1 % more of it is 1 µm.
    warm(&mut rig, 300, Some(21), 1_000);
    apply_change(&mut rig, 2, 1_000);
    apply_change(&mut rig, 3, 1_000);
    let output = warm(&mut rig, 50_000, Some(21), 1_000);
    let x = output.offset.expect("available")[0].0;
    assert!((x + 100_500).abs() <= 1, "half of the way: {x}");
    let output = warm(&mut rig, 51_000, Some(21), 1_000);
    assert_eq!(output.offset, Some([-101_000, 0, 0].map(Nanometres)), "Y has no law: nothing");
    let output = warm(&mut rig, 300, Some(21), -1_000);
    assert_eq!(output.offset, Some([101_000, 0, 0].map(Nanometres)));
}

#[test]
fn a_fall_back_is_as_its_own_model_says() {
    let mut calibration = sources::chain();
    calibration.limits.learned = LEARNED_LIMITS;
    let mut rig = Rig::new(calibration);
    sources::hold(&mut rig, 300, 1_010, Some(20));
    apply_change(&mut rig, 1, 1_000);
    apply_change(&mut rig, 5, 1_000);
    sources::hold(&mut rig, 101_000, 1_010, Some(20));
    let z = rig.z_nm();
    assert_eq!(z, 10_752 + 108 + 1_000, "10.5 codes, 1 % more, and 1 µm");
    // The sensor is lost: a kelvin of the fall-back is 10 µm, neither more nor from elsewhere.
    sources::hold(&mut rig, 400, 0, Some(20));
    assert_eq!(rig.last.quality, OffsetQuality::TemperatureModel);
    assert!((rig.z_nm() - z).abs() <= 2, "{} after {z}", rig.z_nm());
    sources::hold(&mut rig, 400, 0, Some(21));
    assert!((rig.z_nm() - z - 10_000).abs() <= 2, "{} after {z}", rig.z_nm());
}

#[test]
fn a_machine_that_is_called_cold_keeps_what_was_learned() {
    let mut calibration = heat::lagging();
    calibration.limits.learned = LEARNED_LIMITS;
    let mut rig = Rig::new(calibration);
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    apply_change(&mut rig, 2, 5);
    warm(&mut rig, 1_000, Some(21), 1_000);
    assert!(
        rig.state.is_thermal_state_unknown()
            && rig.state.learned_changes().current_amounts()[1] == 5
    );
    rig.bridge.confirm_cold(&mut rig.state);
    assert!(!rig.state.is_thermal_state_unknown());
    assert_eq!(rig.state.learned_changes().current_amounts(), [0, 5, 0, 0, 0]);
}
