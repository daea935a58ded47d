//! How long an input may be silent: the figures of the manual, written out here, because a test that
//! asks a constant for its own value lets any value pass.

use super::*;

#[test]
fn the_figures_are_those_of_the_manual() {
    assert_eq!((SAMPLES_TIMEOUT_MS, STARVED_MS, TEMPERATURE_TIMEOUT_MS), (20, 100, 1_000));
    assert_eq!(RETURN_MS, 1_000);
}

#[test]
fn twenty_milliseconds_without_samples_are_put_up_with_and_one_more_is_not() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1050);
    for ms in 1..=30 {
        rig.control(ENGAGED);
        let output = rig.tick(None);
        let is_told = output.flags.contains(Flags::SAMPLES_MISSING);
        let expected = if ms <= 20 { (Quality::Live, false) } else { (Quality::Hold, true) };
        assert_eq!((output.quality, is_told), expected, "after {ms} ms");
        // And it says how old it is.
        assert_eq!(output.age_ms, ms, "after {ms} ms");
    }
}

/// An axis with a law over temperature, which arrives every 100 ms for a second and then no more:
/// after how many milliseconds it is not followed any longer.
fn followed_without_a_temperature_ms() -> u32 {
    let mut machine = plain();
    machine.thermometers[2] = Some(Thermometer::Linear { zero: 0, slope: 16_000, shift: 0 });
    machine.axes[0].thermal = Some(AxisThermal {
        channel: 2,
        smoothing: SmoothingFactor(u32::MAX),
        smoothing_falling: SmoothingFactor(u32::MAX),
        origin: Position(0),
        law: Law { pieces: &[] },
    });
    let mut rig = Rig::new(machine);
    let mut raw = [Raw::NONE; CHANNELS];
    raw[2] = Raw(21 * 256);
    for ms in 0..3_000_u32 {
        rig.control(ENGAGED);
        rig.now = rig.now.after(1);
        let is_there = ms <= 1_000 && ms % 100 == 0;
        let temperatures = is_there.then_some(&raw);
        let input = Input { codes: None, speed: Some(Rpm(0)), temperatures };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        if ms >= 1_000 && rig.last.quality != Quality::Live {
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
