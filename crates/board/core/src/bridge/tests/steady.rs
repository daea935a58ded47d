//! A thermometer at the edge of a step of its converter: the axis stands.

use super::heat::by_term;
use super::*;
extern crate std;
use crate::{fixed_point::ScaledCoefficient, pt100, term::Effect, testing::next_random};
use std::vec::Vec;

/// Returns the machine with a PT100 at a MAX31865.
fn with_steps(mut machine: Calibration<'static>) -> Calibration<'static> {
    machine.thermometers[3] = Some(Thermometer::Pt100);
    machine
}

/// Returns the offset of X at 2 m in each 100 ms of a minute in which the reading is now one step, now the next.
fn offsets_nm(machine: Calibration<'static>) -> Vec<i32> {
    let mut rig = Rig::new(machine);
    let mut seed = 1;
    let mut step = || {
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        let steps = 20 * 32 + 5 + (next_random(&mut seed) & 1).cast_signed();
        raw[3] = RawTemperatureReading(
            pt100::resistance_from_temperature(Temperature(steps * (Temperature::PER_KELVIN / 32)))
                .0,
        );
        for _ in 0..THERMAL_STEP_MS {
            rig.control(ENGAGED);
            rig.bridge.receive(
                &mut rig.state,
                CncMessage::Position(AxisPosition {
                    axis: LinearAxis::X,
                    position: Position(2_000 * Position::PER_MILLIMETRE),
                    direction: TravelDirection::Positive,
                }),
            );
            rig.now = rig.now.wrapping_add_ms(1);
            let input = TickInput { temperatures: Some(&raw), speed: Some(Rpm(0)), codes: None };
            rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        }
        rig.last.offset.expect("available")[0].0
    };
    (0..300).for_each(|_| {
        step();
    });
    (0..600).map(|_| step()).collect()
}

#[test]
fn an_axis_does_not_go_to_and_fro_with_the_step_of_a_converter() {
    // By the law 100 µm/(m·K) over 2 m and 1/32 K: 6.25 µm a step. By a term 10 µm/K: 0.31 µm a step.
    let mut term = by_term(expanding(), SmoothingFactor::NO_LAG);
    let by_kelvin = 10_000.0 * 256.0 / f64::from(Temperature::PER_KELVIN);
    if let Some(it) = &mut term.terms[0]
        && let Effect::Heat { per_temperature, .. } = &mut it.effect
    {
        *per_temperature =
            ScaledCoefficient { mantissa: (by_kelvin * 2_f64.powi(24)) as i32, shift: 24 };
    }
    for (machine, step_nm) in [(with_steps(expanding()), 6_250), (with_steps(term), 312)] {
        let all = offsets_nm(machine);
        let (least, most) = (all.iter().min().unwrap(), all.iter().max().unwrap());
        assert!((most - least) * 3 < step_nm, "{least} to {most} of {step_nm} nm");
        let turns = all.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!(turns < 12, "the axis moves {turns} times in a minute");
        assert!(*most < -4 * step_nm, "nothing is followed: {most}");
    }
}
