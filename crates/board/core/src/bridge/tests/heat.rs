//! Heat over a restart: resumed, cold, or not known.

use super::sources::{TEN_UM_PER_K, chain, hold};
use super::*;
use crate::{
    retained_lags::RetainedLags,
    term::{Effect, Target, Term},
};

/// As `expanding`, with a lag of 40 s, and a second thermometer.
pub(super) fn lagging() -> Calibration<'static> {
    let mut machine = expanding();
    machine.thermometers[5] = machine.thermometers[3];
    // 1 − e^(−0.1/40) in Q32.
    let smoothing = SmoothingFactor(10_724_000);
    let thermal = machine.axes[0].thermal.as_mut().expect("it has one");
    (thermal.smoothing, thermal.smoothing_falling) = (smoothing, smoothing);
    machine
}

/// Returns the same with a term of its screw's temperature in the place of the law: 1 µm, whatever the temperature is.
pub(super) fn by_term(
    mut machine: Calibration<'static>,
    smoothing: SmoothingFactor,
) -> Calibration<'static> {
    machine.axes[0].thermal = None;
    machine.terms[0] = Some(Term {
        target: Target::Axis(LinearAxis::X),
        constant: FineNanometres(256_000),
        effect: Effect::Heat {
            channel: 3,
            smoothing,
            reference: Temperature(20 * Temperature::PER_KELVIN),
            per_temperature: Default::default(),
        },
    });
    machine
}

/// Engaged at 1 m for so long, at these temperatures.
fn live(rig: &mut Rig, ms: u32, screw: i32, other: i32) -> Output {
    for _ in 0..ms {
        rig.control(ENGAGED);
        rig.bridge.receive(
            &mut rig.state,
            CncMessage::Position(AxisPosition {
                axis: LinearAxis::X,
                position: Position(1_000 * Position::PER_MILLIMETRE),
                direction: TravelDirection::Positive,
            }),
        );
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        (raw[3], raw[5]) = (RawTemperatureReading(screw * 256), RawTemperatureReading(other * 256));
        rig.now = rig.now.wrapping_add_ms(1);
        let input = TickInput { temperatures: Some(&raw), speed: Some(Rpm(0)), codes: None };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
    }
    rig.last
}

fn x_nm(output: &Output) -> i32 {
    output.offset.expect("available")[0].0
}

/// Warmed from 20 °C for 20 s, when a lag of 40 s is on its way.
fn warming() -> Rig {
    let mut rig = Rig::new(lagging());
    live(&mut rig, 1_000, 20, 20);
    live(&mut rig, 20_000, 21, 20);
    rig
}

#[test]
fn a_reset_keeps_the_heat_and_the_offset_is_as_without_it() {
    let mut without = warming();
    let memory = without.bridge.retained_lags(&without.state);
    let mut with = Rig::new(lagging());
    with.bridge.restore_lags(&mut with.state, &memory, 0);
    assert!(!with.state.is_thermal_state_unknown());
    for seconds in [1, 10, 30] {
        let (a, b) = (
            x_nm(&live(&mut without, seconds * 1_000, 21, 20)),
            x_nm(&live(&mut with, seconds * 1_000, 21, 20)),
        );
        assert!((a - b).abs() <= 300, "{a} without, {b} with a reset");
        assert!(a < -35_000, "{a}");
    }
}

#[test]
fn over_a_power_cut_the_heat_goes_on_as_at_the_temperature_that_is_seen_again() {
    for off_s in [1, 20, 90, 3_600] {
        let mut without = warming();
        let memory = without.bridge.retained_lags(&without.state);
        // The screw stays at 21 °C, and the machine is seen again at once.
        let mut with = Rig::new(lagging());
        with.bridge.restore_lags(&mut with.state, &memory, off_s * 10);
        assert!(!with.state.is_thermal_state_unknown());
        // A cut before any thermometer is received: what was missed stays missed.
        let memory = with.bridge.retained_lags(&with.state);
        let mut again = Rig::new(lagging());
        again.bridge.restore_lags(&mut again.state, &memory, 0);
        live(&mut without, off_s.min(300) * 1_000, 21, 20);
        let expected = x_nm(&live(&mut without, 1_000, 21, 20));
        for rig in [&mut with, &mut again] {
            let got = x_nm(&live(rig, 1_000, 21, 20));
            // Up to 0.3 s until both thermometers are known, of a lag of 40 s.
            assert!((got - expected).abs() <= 400, "{off_s} s: {got} for {expected}");
        }
    }
}

#[test]
fn after_a_power_cut_a_machine_that_has_cooled_is_as_a_lag_of_what_is_seen_makes_it() {
    let rig = warming();
    let memory = rig.bridge.retained_lags(&rig.state);
    let mut rig = Rig::new(lagging());
    rig.bridge.restore_lags(&mut rig.state, &memory, 400);
    let output = live(&mut rig, 1_000, 20, 20);
    // 100 µm/K · (1 − e^(−20/40)) · e^(−41/40): a second is seen.
    let expected = -100_000.0 * -(-20.0_f64 / 40.0).exp_m1() * (-41.0_f64 / 40.0).exp();
    assert!((f64::from(x_nm(&output)) - expected).abs() < 400.0, "{output:?} for {expected}");
}

#[test]
fn without_its_heat_a_machine_whose_thermometers_differ_gives_nothing_until_it_no_longer_matters() {
    let mut rig = Rig::new(lagging());
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    let output = live(&mut rig, 1_000, 21, 20);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
    assert!(rig.state.is_thermal_state_unknown());
    // 400 µm are 1 µm after nine half-lives of 27.7 s: 250 s.
    live(&mut rig, 247_000, 21, 20);
    assert!(rig.state.is_thermal_state_unknown());
    let output = live(&mut rig, 4_000, 21, 20);
    assert_eq!((output.quality, x_nm(&output)), (OffsetQuality::Live, -100_000));
}

#[test]
fn a_machine_whose_thermometers_agree_is_cold_and_so_is_one_that_the_operator_calls_so() {
    let mut rig = Rig::new(lagging());
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    let output = live(&mut rig, 1_000, 21, 21);
    assert_eq!(output.quality, OffsetQuality::Live);

    let mut rig = Rig::new(lagging());
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    live(&mut rig, 1_000, 21, 20);
    assert!(rig.state.is_thermal_state_unknown());
    rig.bridge.confirm_cold(&mut rig.state);
    assert_eq!(live(&mut rig, 1_000, 21, 20).quality, OffsetQuality::Live);
}

#[test]
fn a_lone_thermometer_never_agrees_with_itself_and_one_that_is_broken_with_none() {
    let mut machine = lagging();
    machine.thermometers[5] = None;
    let mut rig = Rig::new(machine);
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    live(&mut rig, 2_000, 21, 21);
    assert!(rig.state.is_thermal_state_unknown());

    let mut rig = Rig::new(lagging());
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    warm(&mut rig, 2_000, Some(21), 1_000);
    assert!(rig.state.is_thermal_state_unknown(), "channel 5 says nothing");
}

#[test]
fn a_machine_without_a_law_that_remembers_needs_no_heat() {
    for machine in [expanding(), calibration()] {
        let mut rig = Rig::new(machine);
        rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
        assert!(!rig.state.is_thermal_state_unknown());
    }
}

#[test]
fn heat_is_known_again_by_channel_and_time_constant_alone() {
    let rig = warming();
    let memory = rig.bridge.retained_lags(&rig.state);
    for (change, is_known) in [(0, true), (1, false), (2, false)] {
        let mut other = lagging();
        other.limits.hold_ms = 77;
        let thermal = other.axes[0].thermal.as_mut().expect("it has one");
        match change {
            0 => thermal.origin = Position(9),
            1 => thermal.channel = 5,
            _ => thermal.smoothing.0 += 1,
        }
        let mut rig = Rig::new(other);
        rig.bridge.restore_lags(&mut rig.state, &memory, 0);
        assert_eq!(!rig.state.is_thermal_state_unknown(), is_known, "{change}");
    }
}

/// Growth by a temperature on channel 3 that lags by 40 s, 100 nm a kelvin; nothing else.
fn lagging_spindle() -> Calibration<'static> {
    let mut machine = lagging();
    let thermal = machine.axes[0].thermal.take().expect("it has one");
    machine.spindle.chain[0] = Some(ElongationSource::Temperature);
    machine.spindle.temperature = Some(crate::calibration::SpindleTemperatureModel {
        channel: 3,
        smoothing: thermal.smoothing,
        smoothing_falling: thermal.smoothing_falling,
        law: ThermalExpansionLaw { pieces: &TEN_UM_PER_K },
    });
    machine
}

#[test]
fn a_spindle_follows_its_thermometer_once_in_a_step() {
    let mut rig = Rig::new(lagging_spindle());
    live(&mut rig, 1_000, 20, 20);
    let before = rig.last.offset.expect("available")[2].0;
    live(&mut rig, 40_000, 21, 20);
    let grown = rig.last.offset.expect("available")[2].0 - before;
    // 10 µm·(1 − 1/e), to a step of the heat.
    assert!((grown - 6_321).abs() <= 30, "{grown}");
}

#[test]
fn a_term_of_a_temperature_is_known_where_the_heat_is() {
    let machine = by_term(lagging(), SmoothingFactor(10_724_000));
    let mut rig = Rig::new(machine);
    let output = live(&mut rig, 1_000, 21, 20);
    assert_eq!((output.quality, x_nm(&output)), (OffsetQuality::Live, -1_000));
    let mut rig = Rig::new(machine);
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    let output = live(&mut rig, 1_000, 21, 20);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
}

#[test]
fn the_growth_of_a_spindle_that_lags_is_not_known_where_its_heat_is_not() {
    let mut rig = Rig::new(lagging_spindle());
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    let output = live(&mut rig, 1_000, 21, 20);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
    // One that does not lag grows with its thermometer, whatever was before.
    let mut machine = lagging_spindle();
    let growth = machine.spindle.temperature.as_mut().expect("it has one");
    (growth.smoothing, growth.smoothing_falling) =
        (SmoothingFactor::NO_LAG, SmoothingFactor::NO_LAG);
    let mut rig = Rig::new(machine);
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    assert_eq!(live(&mut rig, 1_000, 21, 20).quality, OffsetQuality::Live);
}

#[test]
fn a_fall_back_that_remembers_is_dead_as_long_as_its_heat_is_not_known() {
    let slow = SmoothingFactor(10_724_000);
    let mut by_temperature = chain();
    (by_temperature.spindle.chain[2], by_temperature.spindle.warmup) = (None, None);
    let growth = by_temperature.spindle.temperature.as_mut().expect("it has one");
    (growth.smoothing, growth.smoothing_falling) = (slow, slow);
    let mut by_time = chain();
    (by_time.spindle.chain[1], by_time.spindle.temperature) = (None, None);
    let law = &mut by_time.spindle.warmup.as_mut().expect("it has one").law;
    (law.smoothing_heating, law.smoothing_cooling) = (slow, slow);
    for machine in [by_temperature, by_time] {
        let mut rig = Rig::new(machine);
        hold(&mut rig, 1_300, 1_050, Some(22));
        assert!(!rig.bridge.has_fallback_failed(&rig.state), "known from the start");
        let mut rig = Rig::new(machine);
        rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
        hold(&mut rig, 1_300, 1_050, Some(22));
        assert!(rig.state.is_thermal_state_unknown() && rig.bridge.has_fallback_failed(&rig.state));
        rig.bridge.confirm_cold(&mut rig.state);
        hold(&mut rig, 500, 1_050, Some(22));
        assert!(!rig.bridge.has_fallback_failed(&rig.state), "called cold");
    }
}

#[test]
fn a_term_over_time_that_has_run_ahead_is_where_waiting_would_have_brought_it() {
    use crate::fixed_point::ScaledCoefficient;
    let mut machine = lagging();
    machine.axes[0].thermal = None;
    machine.terms[0] = Some(Term {
        target: Target::Axis(LinearAxis::X),
        constant: FineNanometres::ZERO,
        // 10 µm with 40 s.
        effect: Effect::Time {
            smoothing: SmoothingFactor(10_724_000),
            amplitude: ScaledCoefficient { mantissa: 2_560_000, shift: 30 },
        },
    });
    let [mut waits, mut ahead] = [machine; 2].map(Rig::new);
    live(&mut waits, 30_000, 21, 20);
    ahead.state.heat.advance_time_terms(&machine, 0, 300);
    let [waits, ahead] = [&mut waits, &mut ahead].map(|rig| x_nm(&live(rig, 10_000, 21, 20)));
    // 10 µm·(1 − 1/e), to a step of the heat.
    assert!((waits + 6_321).abs() <= 10, "{waits}");
    assert_eq!(ahead, waits);
}

#[test]
fn a_term_without_a_lag_has_nothing_to_keep_and_needs_nothing_that_was_kept() {
    for (smoothing, is_retained) in
        [(SmoothingFactor::NO_LAG, false), (SmoothingFactor(1 << 22), true)]
    {
        let mut machine = by_term(expanding(), smoothing);
        machine.thermometers[5] = machine.thermometers[3];
        let mut rig = Rig::new(machine);
        live(&mut rig, 1_000, 21, 21);
        let memory = rig.bridge.retained_lags(&rig.state);
        assert_eq!(memory.lags.iter().any(Option::is_some), is_retained);
        let mut rig = Rig::new(machine);
        rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
        assert_eq!(rig.state.is_thermal_state_unknown(), is_retained);
    }
}

#[test]
fn a_term_over_time_is_kept_over_a_reset() {
    use crate::fixed_point::ScaledCoefficient;
    let amplitude = ScaledCoefficient { mantissa: 2_560_000, shift: 30 };
    let mut machine = by_term(expanding(), SmoothingFactor::NO_LAG);
    let term = machine.terms[0].as_mut().expect("it has one");
    term.effect = Effect::Time { smoothing: SmoothingFactor(10_724_000), amplitude };
    let mut rig = Rig::new(machine);
    let before = x_nm(&live(&mut rig, 20_000, 21, 21));
    let memory = rig.bridge.retained_lags(&rig.state);
    let mut rig = Rig::new(machine);
    rig.bridge.restore_lags(&mut rig.state, &memory, 0);
    let after = x_nm(&live(&mut rig, 200, 21, 21));
    assert!((after - before).abs() <= 50 && before < -4_000, "{before}, then {after}");
}

/// Heat by the speed alone, 40 s: known from the start, kept over a reset, cooled over a power cut, and not known
/// without what was kept.
#[test]
fn heat_by_the_speed_is_kept_over_a_reset_and_cools_while_the_power_is_gone() {
    use crate::{cnc::SpindleState, fixed_point::ScaledCoefficient, term::SpeedExponent};
    let mut machine = by_term(expanding(), SmoothingFactor::NO_LAG);
    machine.axes[0].thermal = None;
    machine.thermometers[5] = machine.thermometers[3];
    let term = machine.terms[0].as_mut().expect("it has one");
    // 10 µm at 10 000 r/min.
    let per_unit = ScaledCoefficient { mantissa: 3_435_974, shift: 26 };
    let (power, smoothing) = (SpeedExponent::Second, SmoothingFactor(10_724_000));
    term.constant = FineNanometres::ZERO;
    term.effect = Effect::SpeedHeat { power, smoothing, per_unit };
    let run = |rig: &mut Rig, rpm: u16, ms: u32| {
        let mut last = None;
        for _ in 0..ms {
            let spindle = SpindleState { speed: Rpm(rpm), load_n: 0 };
            rig.bridge.receive(&mut rig.state, CncMessage::Spindle(spindle));
            last = Some(live(rig, 1, 21, 21));
        }
        last.expect("it ran")
    };
    let largest_nm = 1e4;
    let near = |output: &Output, share: f64| {
        let got = f64::from(x_nm(output));
        assert_eq!(output.quality, OffsetQuality::Live);
        assert!((got + share * largest_nm).abs() < 0.005 * largest_nm, "{got} nm, {share}");
    };
    let mut rig = Rig::new(machine);
    run(&mut rig, 10_000, 20_000);
    let warm = 1.0 - (-0.5_f64).exp();
    near(&run(&mut rig, 10_000, 200), warm + 0.003);
    let memory = rig.bridge.retained_lags(&rig.state);
    // A reset; 40 s without power.
    for (steps, share) in [(0, warm), (400, warm * (-1.0_f64).exp())] {
        let mut rig = Rig::new(machine);
        rig.bridge.restore_lags(&mut rig.state, &memory, steps);
        assert!(!rig.state.is_thermal_state_unknown());
        near(&run(&mut rig, 0, 200), share);
    }
    // Nor is it followed once nobody says how fast the spindle turns.
    assert_ne!(live(&mut rig, 2_000, 21, 21).quality, OffsetQuality::Live);
    let mut rig = Rig::new(machine);
    rig.bridge.restore_lags(&mut rig.state, &RetainedLags::default(), 0);
    assert!(rig.state.is_thermal_state_unknown());
    // Another power is another heat.
    let term = machine.terms[0].as_mut().expect("it has one");
    term.effect = Effect::SpeedHeat { power: SpeedExponent::First, smoothing, per_unit };
    let mut rig = Rig::new(machine);
    rig.bridge.restore_lags(&mut rig.state, &memory, 0);
    assert!(rig.state.is_thermal_state_unknown());
}
