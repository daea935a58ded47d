//! How long an input may be silent: the figures of the manual, written out here, because a test that
//! asks a constant for its own value lets any value pass.

use super::*;

#[test]
fn the_figures_are_those_of_the_manual() {
    assert_eq!(
        (SAMPLES_TIMEOUT_MS, STALE_DURATION_AFTER_LOSS_MS, TEMPERATURE_TIMEOUT_MS),
        (20, 100, 1_000)
    );
    assert_eq!(SOURCE_RETURN_DELAY_MS, 1_000);
}

#[test]
fn twenty_milliseconds_without_samples_are_put_up_with_and_one_more_is_not() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1050);
    for ms in 1..=30 {
        rig.control(ENGAGED);
        let output = rig.tick(None);
        let is_reported = output.flags.contains(OffsetFlags::SAMPLES_MISSING);
        let expected =
            if ms <= 20 { (OffsetQuality::Live, false) } else { (OffsetQuality::Hold, true) };
        assert_eq!((output.quality, is_reported), expected, "after {ms} ms");
        // And it says how old it is.
        assert_eq!(output.age_ms, ms, "after {ms} ms");
    }
}

/// Returns an axis with a law over temperature, which arrives every 100 ms for a second and then no more:
/// after how many milliseconds it is not followed any longer.
fn followed_without_a_temperature_ms() -> u32 {
    let mut machine = minimal_calibration();
    machine.thermometers[2] = Some(Thermometer::Linear { zero: 0, slope: 16_000, shift: 0 });
    machine.axes[0].thermal = Some(AxisThermalModel {
        channel: 2,
        smoothing: SmoothingFactor(u32::MAX),
        smoothing_falling: SmoothingFactor(u32::MAX),
        origin: Position(0),
        law: ThermalExpansionLaw { pieces: &[] },
    });
    let mut rig = Rig::new(machine);
    let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
    raw[2] = RawTemperatureReading(21 * 256);
    for ms in 0..3_000_u32 {
        rig.control(ENGAGED);
        rig.now = rig.now.wrapping_add_ms(1);
        let is_there = ms <= 1_000 && ms % 100 == 0;
        let temperatures = is_there.then_some(&raw);
        let input = TickInput { codes: None, speed: Some(Rpm(0)), temperatures };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        if ms >= 1_000 && rig.last.quality != OffsetQuality::Live {
            return ms - 1_000;
        }
    }
    panic!("followed for ever");
}

#[test]
fn a_second_without_a_temperature_is_put_up_with_and_little_more() {
    let ms = followed_without_a_temperature_ms();
    // A second, then each channel is asked once in 100 ms, and its debounce takes some of these.
    assert!((1_001..=1_000 + 400).contains(&ms), "followed for {ms} ms");
}

#[test]
fn what_is_inhibited_goes_to_0_and_is_not_available_from_then_on() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1_050);
    rig.state.set_inhibited(true);
    assert_eq!(rig.run_engaged(1, 1_050).quality, OffsetQuality::RampingOut);
    let output = rig.run_engaged(60, 1_050);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
    rig.state.set_inhibited(false);
    rig.run_engaged(60, 1_050);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 51_200));
}

#[test]
fn after_missing_blocks_the_sensor_is_believed_again_in_a_tenth_of_a_second() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1_050);
    rig.state.mark_samples_lost();
    for ms in 1..=STALE_DURATION_AFTER_LOSS_MS {
        let output = rig.run_engaged(1, 1_050);
        assert_eq!(output.quality, OffsetQuality::Hold, "after {ms} ms");
        assert!(output.flags.contains(OffsetFlags::SAMPLES_MISSING), "after {ms} ms");
    }
    let output = rig.run_engaged(1, 1_050);
    assert_eq!((output.quality, output.flags), (OffsetQuality::Live, OffsetFlags::NONE));
}

#[test]
fn what_is_measured_by_a_supply_that_is_not_believed_is_not_and_one_that_has_moved_is_corrected() {
    use crate::supply_monitor::{InternalReferenceLevel, SupplyMonitor};
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1_050);
    rig.state.set_supply_scale(None);
    let output = rig.run_engaged(30, 1_050);
    assert!(output.flags.contains(OffsetFlags::SENSOR_FAULT));
    assert_eq!(rig.state.elongation(), None);
    // All codes are 2 % too high by it: 1 071 are 1 050.
    let mut supply = SupplyMonitor::default();
    supply.set_baseline_level(InternalReferenceLevel(1_500 * 16));
    (0..2_000).for_each(|_| supply.receive(AdcCode(1_530)));
    rig.state.set_supply_scale(Some(supply.scale()));
    rig.run_engaged(200, 1_071);
    assert_eq!(rig.last.quality, OffsetQuality::Live);
    assert!((rig.z_nm() - 51_200).abs() <= 100, "{}", rig.z_nm());
}
