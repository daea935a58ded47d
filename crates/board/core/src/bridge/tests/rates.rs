//! A temperature that changes faster than its mass can: the next source, or what was last believed, and never a step.

use super::{sources::chain, *};
use crate::{
    fixed_point::ScaledCoefficient,
    term::{Effect, Target, Term},
};

/// 16 counts a kelvin, as paper 2 has it.
const FINE: Thermometer = Thermometer::Linear { zero: 0, slope: 1_000, shift: 0 };
const PER_K: f64 = 16.0 * 256.0;

/// Returns a spindle by its temperature alone, 10 µm/K above 20 °C, on channel 3; channel 5 is another thermometer.
fn by_temperature() -> Calibration<'static> {
    let mut machine = chain();
    machine.spindle.chain = [Some(ElongationSource::Temperature), None, None];
    machine.spindle.warmup = None;
    (machine.thermometers[3], machine.thermometers[5]) = (Some(FINE), Some(FINE));
    machine.guards = Default::default();
    machine
}

/// Engaged for so long, at these temperatures of channels 3 and 5. Returns the largest |offset of Z|.
fn hold(rig: &mut Rig, ms: u32, celsius: [f64; 2]) -> i32 {
    let mut largest = 0;
    for _ in 0..ms {
        rig.control(ENGAGED);
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        for (channel, celsius) in [3, 5].into_iter().zip(celsius) {
            raw[channel] = RawTemperatureReading((celsius * PER_K) as i32);
        }
        rig.now = rig.now.wrapping_add_ms(1);
        let input = TickInput { temperatures: Some(&raw), ..TickInput::default() };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        largest = largest.max(rig.last.offset.map_or(0, |offset| offset[2].0.abs()));
    }
    largest
}

fn engaged(machine: Calibration<'static>) -> Rig {
    let mut rig = Rig::new(machine);
    hold(&mut rig, 2_000, [30.0, 30.0]);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 100_000));
    rig
}

#[test]
fn a_step_of_the_only_source_is_held_for_as_long_as_it_is_not_believed() {
    let mut rig = engaged(by_temperature());
    for lasts_ms in [4_000, 59_000] {
        let largest = hold(&mut rig, lasts_ms, [85.0, 30.0]);
        assert_eq!(largest, 100_000, "held");
        assert_eq!(rig.last.quality, OffsetQuality::Hold);
        let lost = rig.bridge.lost_inputs(&rig.state);
        assert!(
            lost.too_fast.contains(3)
                && !lost.too_fast.contains(5)
                && !lost.thermometers.contains(3)
        );
        assert_eq!(rig.state.temperature(3), None, "and not shown as a temperature");
        hold(&mut rig, 500, [30.0, 30.0]);
        assert_eq!(
            (rig.last.quality, rig.z_nm()),
            (OffsetQuality::Live, 100_000),
            "back where it was"
        );
    }
    hold(&mut rig, 60_500, [50.0, 30.0]);
    hold(&mut rig, 1_000, [50.0, 30.0]);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 300_000), "steady for 60 s");
}

#[test]
fn a_ramp_of_12_kelvin_a_minute_is_found_and_one_of_9_is_followed() {
    for (per_min, is_followed) in [(9.0, true), (12.0, false)] {
        let mut rig = engaged(by_temperature());
        for n in 0..600 {
            let now = 30.0 + per_min * f64::from(n) / 600.0;
            hold(&mut rig, 100, [now, 30.0]);
            if n > 250 {
                assert_eq!(
                    rig.last.quality == OffsetQuality::Live,
                    is_followed,
                    "{per_min} K/min: {n}"
                );
            }
        }
    }
}

#[test]
fn a_step_goes_to_the_next_source_where_there_is_one_and_the_offset_goes_on() {
    let mut machine = by_temperature();
    machine.spindle.warmup = chain().spindle.warmup;
    machine.spindle.chain[1] = Some(ElongationSource::Warmup);
    let mut rig = engaged(machine);
    assert_eq!(hold(&mut rig, 4_000, [85.0, 30.0]), 100_000);
    assert_eq!(rig.last.quality, OffsetQuality::WarmUpModel);
    hold(&mut rig, 3_000, [30.0, 30.0]);
    assert_eq!(rig.last.quality, OffsetQuality::Live);
}

#[test]
fn a_second_thermometer_of_the_same_law_that_agrees_lets_a_step_be_believed() {
    let mut machine = by_temperature();
    let heat = Effect::Heat {
        channel: 5,
        smoothing: SmoothingFactor::NO_LAG,
        reference: Temperature(0),
        per_temperature: ScaledCoefficient { mantissa: 0, shift: 0 },
    };
    let term = Term { target: Target::Elongation, constant: Default::default(), effect: heat };
    machine.terms[0] = Some(term);
    let mut rig = engaged(machine);
    hold(&mut rig, 4_000, [50.0, 30.0]);
    assert_eq!(rig.last.quality, OffsetQuality::Hold);
    hold(&mut rig, 1_000, [50.0, 47.5]);
    assert_eq!(rig.last.quality, OffsetQuality::Live);
    // One of another law says nothing of it.
    let mut rig = engaged(by_temperature());
    hold(&mut rig, 4_000, [50.0, 50.0]);
    assert_eq!(rig.last.quality, OffsetQuality::Hold);
}

#[test]
fn a_step_of_an_axis_holds_its_temperature_and_lets_it_be_followed_otherwise() {
    let mut machine = calibration();
    machine.spindle.chain = [None; 3];
    machine.thermometers[3] = Some(FINE);
    machine.axes[0].thermal = Some(AxisThermalModel {
        channel: 3,
        smoothing: SmoothingFactor::NO_LAG,
        smoothing_falling: SmoothingFactor::NO_LAG,
        origin: Position(0),
        law: ThermalExpansionLaw { pieces: &super::sources::TEN_UM_PER_K },
    });
    let mut rig = Rig::new(machine);
    hold(&mut rig, 2_000, [30.0, 30.0]);
    let x = |rig: &Rig| rig.last.offset.map(|offset| offset[0].0);
    let before = x(&rig);
    assert_eq!(rig.last.quality, OffsetQuality::Live);
    hold(&mut rig, 10_000, [33.0, 30.0]);
    assert_eq!((rig.last.quality, x(&rig)), (OffsetQuality::Hold, before));
    // No reference is taken on a temperature that is held.
    rig.control(Control { zero: true, ..ENGAGED });
    assert_eq!(rig.state.reference(), ReferenceErrors::default());
}

#[test]
fn the_first_reading_is_believed_and_a_broken_wire_at_the_rail_never_is() {
    let mut rig = Rig::new(by_temperature());
    hold(&mut rig, 3_000, [70.0, 30.0]);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 500_000));
    // 0 V and full scale for ten minutes: lost within half a second, and never believed.
    for counts in [0.0, 4_095.0] {
        let mut rig = engaged(by_temperature());
        hold(&mut rig, 210, [counts / 16.0, 30.0]);
        assert!(rig.bridge.lost_inputs(&rig.state).thermometers.contains(3), "{counts}");
        assert!(rig.last.flags.contains(OffsetFlags::SENSOR_FAULT));
        hold(&mut rig, 100_000, [counts / 16.0, 30.0]);
        assert_eq!((rig.last.quality, rig.last.offset), (OffsetQuality::Fault, None));
    }
}
