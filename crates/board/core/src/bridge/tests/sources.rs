//! One source of the elongation takes over from another, and what the CNC gets meanwhile.

use super::*;
use crate::calibration::{SpindleTemperatureModel, SpindleWarmupModel};

/// K₀ grows by 10 µm a kelvin above 20 °C.
pub(super) const TEN_UM_PER_K: [[u8; 20]; 1] = [{
    // 10 000 nm in 1/256, by 1.024 K, Q4.
    let words: [i32; 5] = [20 * 4_096_000, 0, 41_943_040, 0, 0];
    let mut bytes = [0; 20];
    let mut n = 0;
    while n < 20 {
        bytes[n] = words[n / 4].to_le_bytes()[n % 4];
        n += 1;
    }
    bytes
}];

/// Returns the sensor of `calibration`, then a temperature on channel 3, then a warm-up of 30 µm at once.
pub(super) fn chain() -> Calibration<'static> {
    let mut machine = calibration();
    machine.spindle.chain =
        [ElongationSource::Sensor, ElongationSource::Temperature, ElongationSource::Warmup]
            .map(Some);
    machine.thermometers[3] = Some(Thermometer::Linear { zero: 0, slope: 16_000, shift: 0 });
    // A kelvin a reading and more: these tests are of the sources.
    machine.guards.max_rates[3] = crate::temperature_rate::MAX_RATE_DECIKELVIN_PER_MIN;
    machine.spindle.temperature = Some(SpindleTemperatureModel {
        channel: 3,
        smoothing: SmoothingFactor::NO_LAG,
        smoothing_falling: SmoothingFactor::NO_LAG,
        law: ThermalExpansionLaw { pieces: &TEN_UM_PER_K },
    });
    machine.spindle.warmup = Some(SpindleWarmupModel {
        law: crate::warmup::WarmupModel {
            lag_ms: 0,
            max: Nanometres(30_000).to_fine(),
            smoothing_heating: SmoothingFactor::NO_LAG,
            smoothing_cooling: SmoothingFactor::NO_LAG,
            full: 1 << crate::warmup::WarmupModel::FULL_FRACTION_BITS,
        },
        power: Default::default(),
    });
    machine
}

/// Engaged for so long; `code`: what the sensor reads; `kelvin`: above 0 °C, `None` for broken.
pub(super) fn hold(rig: &mut Rig, ms: u32, code: u16, kelvin: Option<i32>) -> Output {
    for n in 0..ms {
        rig.control(ENGAGED);
        let codes = core::array::from_fn(|n| AdcCode((code + (n % 4) as u16).saturating_sub(1)));
        let codes = if code == 0 { [AdcCode(0); CODES_PER_TICK] } else { codes };
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        raw[3] = kelvin
            .map_or(RawTemperatureReading::NONE, |kelvin| RawTemperatureReading(kelvin * 256));
        rig.now = rig.now.wrapping_add_ms(1);
        let input =
            TickInput { temperatures: Some(&raw), speed: Some(Rpm(24_000)), codes: Some(&codes) };
        let before = rig.last.offset;
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        if let (Some(before), Some(after)) = (before, rig.last.offset) {
            assert!((after[2].0 - before[2].0).abs() <= 1_000, "{n}");
        }
    }
    rig.last
}

#[test]
fn a_source_that_takes_over_goes_on_where_the_one_before_was() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 1_300, 1_050, Some(22));
    let grown = rig.z_nm();
    assert!((grown - 51_700).abs() < 600, "the sensor: {grown}");
    // The models say 20 and 30 µm; they tell how it grows from here.
    hold(&mut rig, 1_000, 0, Some(22));
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::TemperatureModel, grown));
    hold(&mut rig, 1_000, 0, Some(23));
    assert_eq!(rig.z_nm(), grown + 10_000);
    hold(&mut rig, 1_000, 0, None);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::WarmUpModel, grown + 10_000));
    assert!(rig.last.flags.contains(OffsetFlags::SENSOR_FAULT));
    // The sensor returns: debounced, without a step, and its difference is taken back at 10 nm/s.
    hold(&mut rig, 900, 1_050, Some(23));
    assert_ne!(rig.last.quality, OffsetQuality::Live, "not before it was fresh for a second");
    hold(&mut rig, 1_400, 1_050, Some(23));
    assert_eq!(rig.last.quality, OffsetQuality::Live);
    assert!(rig.last.flags.contains(OffsetFlags::SLEWING), "reported");
    let before = rig.z_nm();
    assert!((before - grown - 10_000).abs() <= 20, "{before}");
    hold(&mut rig, 10_000, 1_050, Some(23));
    assert!((before - rig.z_nm() - 100).abs() <= 2, "10 nm in a second: {}", rig.z_nm());
}

#[test]
fn ten_thousand_changes_of_source_leave_10_nm_in_the_first_second() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 1_300, 1_050, Some(22));
    let mut random = 7_u32;
    let mut before = rig.z_nm();
    // Every change is one of the chosen source: where nothing grows nothing may move.
    for _ in 0..10_000 {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let (code, kelvin) =
            [(1_050, Some(22)), (0, Some(22)), (0, None)][(random >> 16) as usize % 3];
        hold(&mut rig, 1_000, code, kelvin);
        assert!((rig.z_nm() - before).abs() <= 10, "{} after {before}", rig.z_nm());
        before = rig.z_nm();
    }
}

#[test]
fn a_fall_back_whose_zero_is_not_known_is_not_used() {
    let reference =
        ReferenceErrors { elongation: Nanometres(60_000), ..ReferenceErrors::default() };
    let mut rig = Rig::new(chain());
    rig.state.set_reference(reference);
    hold(&mut rig, 2_000, 0, Some(22));
    assert_eq!((rig.last.quality, rig.last.offset), (OffsetQuality::Fault, None));
    // It has outlasted the reset: it goes on.
    let retained =
        RetainedTransfer { source: ElongationSource::Temperature, shift: Nanometres(41_000) };
    let mut rig = Rig::new(chain());
    rig.state.set_reference(reference);
    rig.state.restore_transfer(retained);
    hold(&mut rig, 2_000, 0, Some(22));
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::TemperatureModel, 1_000));
    assert_eq!(rig.state.retained_transfer(), Some(retained));
}

#[test]
fn a_fall_back_that_is_dead_is_reported_while_it_is_not_needed() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 1_300, 1_050, Some(22));
    assert!(!rig.bridge.has_fallback_failed(&rig.state));
    let output = hold(&mut rig, 1_000, 1_050, None);
    assert_eq!(output.quality, OffsetQuality::Live);
    assert!(output.flags.contains(OffsetFlags::SENSOR_FAULT));
    assert!(rig.bridge.has_fallback_failed(&rig.state));
    let output = hold(&mut rig, 500, 1_050, Some(22));
    assert_eq!(output.flags, OffsetFlags::NONE);
    assert!(!rig.bridge.has_fallback_failed(&rig.state));
}

#[test]
fn what_the_sensor_last_said_is_not_reported_once_it_is_lost() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 300, 1_050, Some(22));
    assert!(rig.state.elongation().is_some());
    hold(&mut rig, 10, 0, Some(22));
    assert_eq!(rig.state.elongation(), None);
}

#[test]
fn the_age_is_that_of_the_oldest_position_of_an_axis_that_moves() {
    let mut rig = Rig::new(expanding());
    warm(&mut rig, 300, Some(21), 1_000);
    for n in 1..=20 {
        warm(&mut rig, 1, Some(21), 1_000 + n);
    }
    assert!(rig.last.age_ms <= 1);
    let temperatures = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
    for n in 1..=200_u8 {
        rig.control(ENGAGED);
        rig.now = rig.now.wrapping_add_ms(1);
        let input = TickInput { temperatures: Some(&temperatures), speed: None, codes: None };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        assert_eq!(rig.last.age_ms, n + 1, "it was on its way when it was last heard");
    }
    // One that stands says so, and rests.
    warm(&mut rig, 2, Some(21), 1_020);
    rig.tick(None);
    rig.tick(None);
    assert_eq!(rig.last.age_ms, 0);
}

#[test]
fn sources_that_grow_apart_for_a_minute_no_longer_fit_and_those_that_differ_by_less_do() {
    // 1.024 µm a code, 10 µm a kelvin.
    for (codes, kelvin, is_unfit) in [
        (0, 20, false),
        (50, 20, true),
        (50, 24, false),
        (50, 22, true),
        (14, 20, false),
        (0, 23, true),
    ] {
        let mut machine = chain();
        (machine.spindle.chain[2], machine.spindle.warmup) = (None, None);
        let mut rig = Rig::new(machine);
        hold(&mut rig, 1_300, 1_000, Some(20));
        hold(&mut rig, 59_000, 1_000 + codes, Some(kelvin));
        assert!(!rig.bridge.has_source_disagreement(&rig.state), "not before a minute");
        hold(&mut rig, 2_000, 1_000 + codes, Some(kelvin));
        assert_eq!(
            rig.bridge.has_source_disagreement(&rig.state),
            is_unfit,
            "{codes} codes, {kelvin} °C"
        );
        // Where they agree again it fits again.
        hold(&mut rig, 1_000, 1_000, Some(20));
        assert!(!rig.bridge.has_source_disagreement(&rig.state));
    }
}

#[test]
fn a_source_that_takes_over_from_a_lost_one_keeps_the_growth_since() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 1_300, 1_050, Some(22));
    let grown = rig.z_nm();
    // The temperature has risen while the sensor's last words are 150 ms old: a frozen one is found after 200.
    hold(&mut rig, 150, 1_050, Some(23));
    hold(&mut rig, 500, 0, Some(23));
    assert_eq!(rig.last.quality, OffsetQuality::TemperatureModel);
    assert_eq!(rig.z_nm(), grown + 10_000, "since then by its own word");
}

#[test]
fn a_thermometer_that_returns_as_the_sensor_is_lost_reports_nothing_of_before() {
    // In every millisecond of a step of the heat.
    for lead_ms in 0..100 {
        let mut machine = chain();
        (machine.spindle.chain[2], machine.spindle.warmup) = (None, None);
        let mut rig = Rig::new(machine);
        hold(&mut rig, 1_300, 1_050, Some(22));
        hold(&mut rig, 1_000 + lead_ms, 1_050, None);
        let grown = rig.z_nm();
        // The spindle's housing is 5 K warmer than when it was last learnt of.
        hold(&mut rig, 600, 0, Some(27));
        assert_eq!(
            (rig.last.quality, rig.z_nm()),
            (OffsetQuality::TemperatureModel, grown),
            "{lead_ms}"
        );
    }
}

#[test]
fn a_source_that_returns_reports_what_grew_while_the_thermometer_in_use_said_nothing() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 1_300, 1_050, Some(22));
    hold(&mut rig, 1_000, 0, Some(22));
    let grown = rig.z_nm();
    // The sensor is about to be used again. The thermometer falls silent, too short to be given up, and the
    // spindle grows by 10 codes.
    hold(&mut rig, 850, 1_050, Some(22));
    hold(&mut rig, 300, 1_060, None);
    assert_eq!(rig.last.quality, OffsetQuality::Live);
    assert!((rig.z_nm() - grown - 10_240).abs() <= 10, "{} after {grown}", rig.z_nm());
}

/// Returns whether a quiet sensor that has stopped changing is believed after half a second, with the spindle at this
/// speed.
fn is_believed_frozen_at(speed: Option<Rpm>) -> bool {
    let mut rig = Rig::new(calibration());
    for ms in 0..1_200 {
        let mut codes = [AdcCode(1050); CODES_PER_TICK];
        // Too few changes to tell it lively.
        if ms < 700 {
            codes[0] = AdcCode(1049);
        }
        rig.now = rig.now.wrapping_add_ms(1);
        let input = TickInput { codes: Some(&codes), speed, temperatures: None };
        rig.bridge.tick(&mut rig.state, rig.now, input);
        assert!(rig.state.believable || ms >= 700, "{speed:?} at {ms} ms");
    }
    rig.state.believable
}

#[test]
fn a_quiet_sensor_that_stands_still_is_a_fault_where_run_out_must_show_and_only_there() {
    assert!(!is_believed_frozen_at(Some(Rpm(24_000))));
    assert!(!is_believed_frozen_at(Some(Rpm(301))));
    assert!(is_believed_frozen_at(Some(Rpm(300))));
    assert!(is_believed_frozen_at(None));
}

#[test]
fn the_first_source_counts_from_its_own_zero_where_another_one_was_used_before_the_reset() {
    let mut rig = Rig::new(chain());
    let retained =
        RetainedTransfer { source: ElongationSource::Temperature, shift: Nanometres(41_000) };
    rig.state.restore_transfer(retained);
    hold(&mut rig, 1_000, 1_050, Some(22));
    assert_eq!(rig.last.quality, OffsetQuality::Live);
    assert!((rig.z_nm() - 51_700).abs() < 600, "{}", rig.z_nm());
}

#[test]
fn a_first_source_that_is_a_thermometer_is_gone_back_to_from_the_sensor() {
    let mut machine = chain();
    machine.spindle.chain.swap(0, 1);
    let mut rig = Rig::new(machine);
    hold(&mut rig, 1_000, 1_050, Some(22));
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 20_000));
    hold(&mut rig, 1_000, 1_050, None);
    hold(&mut rig, 1_000, 1_060, None);
    assert!((rig.z_nm() - 20_000 - 10_240).abs() < 600, "by the sensor's growth: {}", rig.z_nm());
    // Back for a second, and then taken back by 10 nm in each.
    hold(&mut rig, 5_000, 1_060, Some(22));
    assert!(rig.last.flags.contains(OffsetFlags::SLEWING), "on its way back");
}

#[test]
fn of_two_sources_that_are_lost_one_after_the_other_the_third_goes_on_from_the_second() {
    let mut rig = Rig::new(chain());
    // Lost in the middle of a step, behind what is noted in it.
    hold(&mut rig, 1_350, 1_050, Some(22));
    let grown = rig.z_nm();
    // 10 µm by the thermometer, which is lost then.
    hold(&mut rig, 150, 0, Some(23));
    hold(&mut rig, 1_000, 0, None);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::WarmUpModel, grown + 10_000));
}

#[test]
fn what_was_never_followed_leaves_nothing_for_after_a_reset_unless_the_first_source_was_there() {
    use ElongationSource::{Sensor, Temperature};
    // What the sensor reads in each second; 0: its wire is broken.
    for (seconds, retained) in
        [([0, 0], None), ([1_050, 1_050], Some(Sensor)), ([1_050, 0], Some(Temperature))]
    {
        let mut rig = Rig::new(chain());
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        raw[3] = RawTemperatureReading(22 * 256);
        for ms in 0..2_000 {
            let code = seconds[ms / 1_000];
            let codes =
                core::array::from_fn(|n| AdcCode(if code == 0 { 0 } else { code + n as u16 % 3 }));
            rig.now = rig.now.wrapping_add_ms(1);
            let (speed, temperatures) = (Some(Rpm(24_000)), Some(&raw));
            let input = TickInput { temperatures, speed, codes: Some(&codes) };
            rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        }
        assert_eq!(rig.state.retained_transfer().map(|retained| retained.source), retained);
    }
}

#[test]
fn what_is_taken_back_is_as_the_rate_says_to_the_nanometre() {
    let mut machine = chain();
    machine.limits.rejoin_nm_per_s = 15;
    let mut rig = Rig::new(machine);
    hold(&mut rig, 1_300, 1_050, Some(22));
    hold(&mut rig, 1_000, 0, Some(22));
    // 1.5 nm in each step: the thermometer has reported 10 µm that the sensor has not seen.
    hold(&mut rig, 1_000, 0, Some(23));
    hold(&mut rig, 3_000, 1_050, Some(23));
    let before = rig.z_nm();
    hold(&mut rig, 10_000, 1_050, Some(23));
    assert_eq!(before - rig.z_nm(), 150);
}

#[test]
fn a_term_of_the_elongation_is_there_without_a_source_as_well() {
    use crate::term::{Effect, Target, Term};
    let mut machine = minimal_calibration();
    let (target, effect) = (Target::Elongation, Effect::Offset);
    machine.terms[0] = Some(Term { target, constant: Nanometres(7_000).to_fine(), effect });
    let mut rig = Rig::new(machine);
    for _ in 0..100 {
        rig.control(ENGAGED);
        rig.tick(None);
    }
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 7_000));
}

#[test]
fn zero_on_a_source_that_is_on_its_way_back_leaves_nothing_to_take_back() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 1_300, 1_050, Some(22));
    hold(&mut rig, 1_000, 0, Some(22));
    hold(&mut rig, 1_000, 0, Some(23));
    hold(&mut rig, 3_000, 1_050, Some(23));
    assert!(rig.last.flags.contains(OffsetFlags::SLEWING), "on its way back");
    rig.control(Control { zero: true, ..ENGAGED });
    hold(&mut rig, 5_000, 1_050, Some(23));
    assert_eq!((rig.z_nm(), rig.last.flags), (0, OffsetFlags::NONE));
}

#[test]
fn in_the_first_second_of_a_source_nothing_but_growth_moves_the_offset_and_then_it_is_taken_back() {
    let mut rig = Rig::new(chain());
    hold(&mut rig, 1_300, 1_050, Some(22));
    hold(&mut rig, 1_000, 0, Some(22));
    hold(&mut rig, 1_000, 0, Some(23));
    while rig.last.quality != OffsetQuality::Live {
        hold(&mut rig, 1, 1_050, Some(23));
    }
    let before = rig.z_nm();
    hold(&mut rig, 1_000, 1_050, Some(23));
    assert_eq!(rig.z_nm(), before);
    hold(&mut rig, 100, 1_050, Some(23));
    assert_eq!(rig.z_nm(), before - 1);
}

#[test]
fn the_age_is_that_of_the_angles_while_the_head_turns() {
    let mut machine = calibration();
    machine.kinematics.axes = [Some(kinematics::RotaryAxis::A), None];
    let mut rig = Rig::new(machine);
    for (degrees, is_turning) in [(10, false), (20, true), (30, true), (30, false)] {
        let angles = [MicroDegrees(degrees * 1_000_000), MicroDegrees(0)];
        rig.bridge.receive(&mut rig.state, CncMessage::Rotary(RotaryAxisAngles { angles }));
        for ms in 1..=100_u8 {
            let age_ms = rig.run_engaged(1, 1_100).age_ms;
            if rig.now.0 > 100 {
                assert_eq!(age_ms, if is_turning { ms } else { 0 }, "{degrees}, {ms} ms");
            }
        }
    }
}

#[test]
fn a_source_whose_zero_is_not_known_is_not_used_in_the_place_of_the_one_before_the_reset() {
    let reference =
        ReferenceErrors { elongation: Nanometres(60_000), ..ReferenceErrors::default() };
    let mut machine = chain();
    // The one that was used before the reset is no longer there.
    (machine.spindle.chain[2], machine.spindle.warmup) = (None, None);
    let mut rig = Rig::new(machine);
    rig.state.set_reference(reference);
    let retained = RetainedTransfer { source: ElongationSource::Warmup, shift: Nanometres(41_000) };
    rig.state.restore_transfer(retained);
    hold(&mut rig, 2_000, 0, Some(22));
    assert_eq!((rig.last.quality, rig.last.offset), (OffsetQuality::Fault, None));
}
