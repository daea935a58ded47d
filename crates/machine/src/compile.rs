//! From what the user writes (µm, counts, seconds) to the integers that the board runs.
//!
//! The sensor's law in reading units, with Z, S and K what is stored:
//!
//! ```text
//! Z = round(reading of V₀)
//! S = round(2²⁸ · nm per reading unit)
//! K = round(K₀ + (Z − V₀)·S/2²⁸)       V₀ exact: K takes up what rounding Z has moved
//! elongation in nm = K + (reading − Z)·S/2²⁸
//! ```
//!
//! The stored law is linear, as the model is, so the largest difference between the two over the
//! input range is at one of its ends. It is measured at both for every calibration and refused
//! above [`LARGEST_DIFFERENCE_NM`]. Measured: 0 nm for the paper's sensor, whose constants are
//! exact here, and at most 0.506 nm over 200 000 random sensors with the zero reading in range, of
//! which 0.5 nm is K's rounding (`the_stored_law_is_within_0_51_nm_…` below). What the board adds
//! when it runs the law is the rounding of the reading (half a unit, 0.06 nm for the paper's
//! sensor) and of the result (half a nanometre).

use trueup_core::{
    calibration::Calibration,
    limits::Limits,
    sensor::{SensorLaw, Slope},
    tool::Direction,
    units::{NANOMETRES_PER_MICROMETRE, Nanometres, Reading},
};

use crate::{
    inputs::SensorInput,
    machine_file::{Machine, SensorModel, Source},
    model,
    place::BadInput,
};

/// The largest offset that the wire can carry, either way, in µm: a 20-bit signed number of 10 nm.
pub const WIRE_LIMIT_UM: f64 = 5242.87;

/// A calibration further than this from the model, in nm anywhere in the input range, is refused.
pub const LARGEST_DIFFERENCE_NM: f64 = 2.0;

const NM_PER_UM: f64 = NANOMETRES_PER_MICROMETRE as f64;
const SLOPE_ONE: f64 = (1_u64 << Slope::FRACTION_BITS) as f64;

/// A machine in the integers of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compiled {
    /// What the board runs.
    pub calibration: Calibration,
    /// The largest difference between the stored law and the model over the input range, in nm.
    pub largest_difference_nm: f64,
}

/// Turns `machine` into what the board runs. A machine without a spindle source compiles to a law
/// that is 0 everywhere, and needs no inputs.
///
/// # Errors
/// The sensor is the source but `[inputs]` does not describe it, or a value does not fit the
/// board's integer for it; with the key and, for a machine that was read from a file, its place.
pub fn compile(machine: &Machine) -> Result<Compiled, BadInput> {
    let (sensor, largest_difference_nm) = match (machine.spindle.source, &machine.spindle.sensor) {
        (Some(Source::Sensor), Some(model)) => compile_sensor(machine, model)?,
        _ => (SensorLaw::default(), 0.0),
    };
    let calibration = Calibration {
        sensor,
        tool_direction: compile_direction(machine.tool_direction),
        limits: compile_limits(machine)?,
    };
    Ok(Compiled { calibration, largest_difference_nm })
}

/// The elongation in nm that `law` gives at full resolution: before the board rounds the reading
/// and the result.
#[must_use]
pub fn stored_law_nm(law: &SensorLaw, reading: f64) -> f64 {
    let slope_nm = f64::from(law.slope.0) / SLOPE_ONE;
    f64::from(law.k0.0) + (reading - f64::from(law.zero.0)) * slope_nm
}

fn compile_sensor(machine: &Machine, model: &SensorModel) -> Result<(SensorLaw, f64), BadInput> {
    let Some(input) = machine.inputs.as_ref().and_then(|inputs| inputs.sensor) else {
        let rule = "is missing: the board must know how the sensor's counts reach it";
        return Err(machine.places.bad("inputs.sensor", rule));
    };
    let readings_per_count = input.exact_reading_from_counts(1.0);
    let slope_nm = model.um_per_count * NM_PER_UM / readings_per_count;
    let zero_reading = input.exact_reading_from_counts(model.zero_counts);

    let slope = rounded(slope_nm * SLOPE_ONE).ok_or_else(|| {
        let rule = format!(
            "{} is {slope_nm:.3} nm for one of the board's reading units, which must be below 8: \
             at most {} µm a count with this input",
            model.um_per_count,
            8.0 * readings_per_count / NM_PER_UM
        );
        machine.places.bad("spindle.sensor.um_per_count", rule)
    })?;
    let zero = rounded(zero_reading).ok_or_else(|| {
        let rule = format!("{} is outside what the board can store", model.zero_counts);
        machine.places.bad("spindle.sensor.zero_counts", rule)
    })?;
    let moved_by_zero = (f64::from(zero) - zero_reading) * (f64::from(slope) / SLOPE_ONE);
    let k0 = rounded(model.k0_um * NM_PER_UM + moved_by_zero).ok_or_else(|| {
        let rule = format!("{} is beyond the board's ±2147483 µm", model.k0_um);
        machine.places.bad("spindle.sensor.k0_um", rule)
    })?;
    let law = SensorLaw { k0: Nanometres(k0), zero: Reading(zero), slope: Slope(slope) };

    let largest_difference_nm = largest_difference_nm(&law, model, &input);
    if largest_difference_nm > LARGEST_DIFFERENCE_NM {
        let rule = format!(
            "{} is so far outside the input range that the board's law would be \
             {largest_difference_nm:.1} nm off, more than {LARGEST_DIFFERENCE_NM} nm",
            model.zero_counts
        );
        return Err(machine.places.bad("spindle.sensor.zero_counts", rule));
    }
    for counts in [0.0, input.counts_full_scale] {
        let elongation_um = model::elongation_um(model, counts);
        if rounded(elongation_um * NM_PER_UM).is_none() {
            let rule = format!(
                "gives {elongation_um} µm at {counts} counts, beyond the board's ±2147483 µm"
            );
            return Err(machine.places.bad("spindle.sensor", rule));
        }
    }
    Ok((law, largest_difference_nm))
}

/// At the ends of the input range, where a linear function is largest.
fn largest_difference_nm(law: &SensorLaw, model: &SensorModel, input: &SensorInput) -> f64 {
    let difference = |counts: f64| {
        let stored = stored_law_nm(law, input.exact_reading_from_counts(counts));
        (stored - model::elongation_um(model, counts) * NM_PER_UM).abs()
    };
    difference(0.0).max(difference(input.counts_full_scale))
}

fn compile_direction(tool_direction: [f64; 3]) -> Direction {
    // A component is at most 1 in magnitude, give or take the last bit of an f64: it always fits.
    Direction(
        tool_direction.map(|component| (component * f64::from(Direction::ONE)).round() as i32),
    )
}

fn compile_limits(machine: &Machine) -> Result<Limits, BadInput> {
    let limits = &machine.limits;
    let mut max = [Nanometres::ZERO; 3];
    for ((stored, axis), max_um) in max.iter_mut().zip(["x", "y", "z"]).zip(limits.max_um) {
        let bad = |rule: String| machine.places.bad(&format!("limits.max_um.{axis}"), rule);
        if !(0.0..=WIRE_LIMIT_UM).contains(&max_um) {
            return Err(bad(format!(
                "{max_um} is not within 0 to {WIRE_LIMIT_UM} µm, what the wire can carry"
            )));
        }
        *stored = Nanometres(rounded(max_um * NM_PER_UM).expect("held to ±5.3 mm above"));
    }
    let slew_nm_per_s = (limits.slew_um_per_s * NM_PER_UM).round();
    if !(1.0..=f64::from(u32::MAX)).contains(&slew_nm_per_s) {
        let rule = format!(
            "{} is not within 0.001 to 4294967 µm/s, what the board can store",
            limits.slew_um_per_s
        );
        return Err(machine.places.bad("limits.slew_um_per_s", rule));
    }
    if limits.link_timeout_ms == 0 {
        let rule = "must be at least 1: at 0 the CNC would always count as lost";
        return Err(machine.places.bad("limits.link_timeout_ms", rule));
    }
    Ok(Limits {
        max,
        // Held to the range of u32 above.
        slew_nm_per_s: slew_nm_per_s as u32,
        link_timeout_ms: limits.link_timeout_ms,
        hold_ms: limits.hold_ms,
    })
}

/// The nearest integer, or `None` where `i32` does not reach.
fn rounded(value: f64) -> Option<i32> {
    let nearest = value.round();
    (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&nearest).then_some(nearest as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MachineFile;
    use std::path::Path;

    /// The paper's machine file with `from` replaced by `to`.
    fn paper_but(from: &str, to: &str) -> Machine {
        let text = include_str!("../../../data/paper_spindle.toml");
        assert!(text.contains(from), "{from} is not in the paper's machine file");
        MachineFile::parse(&text.replace(from, to), Path::new("paper.toml"))
            .expect("the changed file is right by itself")
    }

    fn paper() -> Machine {
        paper_but("", "")
    }

    #[test]
    fn the_papers_constants_are_exact_in_the_boards_integers() {
        let compiled = compile(&paper()).expect("the paper's sensor fits");
        // 500 000 nm over 2²² reading units, times 2²⁸.
        assert_eq!(compiled.calibration.sensor.slope, Slope(32_000_000));
        assert_eq!(compiled.calibration.sensor.zero, Reading(5048 * 128));
        assert_eq!(compiled.calibration.sensor.k0, Nanometres(0));
        assert_eq!(compiled.calibration.tool_direction, Direction::DOWN);
        assert!(compiled.largest_difference_nm < 1e-9);
    }

    #[test]
    fn the_board_is_within_half_a_nanometre_of_the_papers_model_at_every_count() {
        let machine = paper();
        let law = compile(&machine).expect("the paper's sensor fits").calibration.sensor;
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor).expect("the paper's");
        for counts in (0..=32_768).map(f64::from) {
            let board = f64::from(law.elongation(input.reading_from_counts(counts)).0);
            let difference = board - machine.elongation_um(counts) * NM_PER_UM;
            assert!(difference.abs() <= 0.5, "{counts} counts: {difference} nm");
        }
    }

    #[test]
    fn the_limits_arrive_in_nanometres_and_milliseconds() {
        let limits = compile(&paper()).expect("the paper's sensor fits").calibration.limits;
        assert_eq!(limits.max, [200_000, 200_000, 500_000].map(Nanometres));
        assert_eq!(limits.slew_nm_per_s, 20_000);
        assert_eq!((limits.link_timeout_ms, limits.hold_ms), (500, 2000));
    }

    #[test]
    fn a_direction_has_length_one_within_two_of_its_units() {
        let machine =
            paper_but("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [1, -2, 3]");
        let Direction(v) =
            compile(&machine).expect("a direction always fits").calibration.tool_direction;
        let length = v.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
        assert!((length - f64::from(Direction::ONE)).abs() < 2.0);
        assert!(v[0] > 0 && v[1] < 0 && v[2] > 0);
    }

    #[test]
    fn without_a_source_the_law_is_zero_and_no_input_is_needed() {
        let machine = MachineFile::parse(
            "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n",
            Path::new("m.toml"),
        )
        .expect("the shortest machine file");
        let compiled = compile(&machine).expect("nothing to fit");
        assert_eq!(compiled.calibration.sensor, SensorLaw::default());
    }

    #[test]
    fn a_sensor_whose_growth_lowers_the_reading_has_a_negative_slope() {
        let machine =
            paper_but("um_per_count = 0.0152587890625", "um_per_count = -0.0152587890625");
        let law = compile(&machine).expect("fits").calibration.sensor;
        assert_eq!(law.slope, Slope(-32_000_000));
        let reading = 128.0 * (5048.0 - 1000.0);
        assert!((stored_law_nm(&law, reading) - 15_258.789_062_5).abs() < 1e-9);
    }

    /// Any calibration that the zero reading in range and a slope within the format allow.
    #[test]
    fn the_stored_law_is_within_0_51_nm_of_the_model_for_any_sensor_with_its_zero_in_range() {
        let mut machine = paper();
        let mut seed = 0x2545_f491_4f6c_dd1d_u64;
        let mut uniform = |from: f64, to: f64| {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            from + (to - from) * (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut worst: f64 = 0.0;
        for _ in 0..200_000 {
            let counts_full_scale = uniform(1000.0, 70_000.0).round();
            let volts_full_scale = uniform(1.0, 20.0);
            let divider = uniform(0.3, 1.0) * 3.3 / volts_full_scale;
            let input = SensorInput { volts_full_scale, counts_full_scale, divider };
            let steepest = 7.99 * input.exact_reading_from_counts(1.0) / NM_PER_UM;
            machine.inputs.as_mut().expect("the paper's has inputs").sensor = Some(input);
            machine.spindle.sensor = Some(SensorModel {
                k0_um: uniform(-500.0, 500.0),
                zero_counts: uniform(0.0, counts_full_scale),
                um_per_count: uniform(-steepest, steepest),
                temperature: None,
            });
            let compiled = compile(&machine).expect("within every range");
            worst = worst.max(compiled.largest_difference_nm);
        }
        assert!((0.49..0.51).contains(&worst), "worst {worst} nm");
    }

    #[test]
    fn the_difference_at_the_ends_is_the_largest_in_between() {
        let machine = paper_but("um_per_count = 0.0152587890625", "um_per_count = 0.0198");
        let compiled = compile(&machine).expect("fits");
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor).expect("the paper's");
        let law = &compiled.calibration.sensor;
        for counts in 0..=32_768 {
            let counts = f64::from(counts);
            let stored = stored_law_nm(law, input.exact_reading_from_counts(counts));
            let difference = (stored - machine.elongation_um(counts) * NM_PER_UM).abs();
            assert!(difference <= compiled.largest_difference_nm + 1e-9);
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_key_and_place() {
        let cases = [
            (
                "um_per_count = 0.0152587890625",
                "um_per_count = 1.1",
                "16:16: spindle.sensor.um_per_count 1.1 is 8.594 nm",
            ),
            (
                "zero_counts = 5048.0",
                "zero_counts = 2e7",
                "15:15: spindle.sensor.zero_counts 20000000 is outside what",
            ),
            (
                // The slope is 0.45 of its unit off; the distance makes that 3.4 nm.
                "zero_counts = 5048.0\num_per_count = 0.0152587890625",
                "zero_counts = 1.6e7\num_per_count = 0.0100000002146",
                "15:15: spindle.sensor.zero_counts 16000000 is so far outside",
            ),
            ("k0_um = 0.0", "k0_um = 3e6", "14:9: spindle.sensor.k0_um 3000000 is beyond"),
            (
                "k0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0152587890625",
                "k0_um = 2147400\nzero_counts = 0.0\num_per_count = 0.0152587890625",
                "13:10: spindle.sensor gives 2147900 µm at 32768 counts",
            ),
            ("x = 200.0", "x = 5242.88", "limits.max_um.x 5242.88 is not within 0 to 5242.87"),
            (
                "slew_um_per_s = 20.0",
                "slew_um_per_s = 0.0004",
                "limits.slew_um_per_s 0.0004 is not",
            ),
            ("slew_um_per_s = 20.0", "slew_um_per_s = 5e6", "limits.slew_um_per_s 5000000 is not"),
            (
                "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }",
                "",
                "inputs.sensor is missing",
            ),
        ];
        for (from, to, phrase) in cases {
            let error = compile(&paper_but(from, to)).expect_err(to).to_string();
            assert!(error.contains(phrase), "{to}: {error}");
        }
    }

    #[test]
    fn the_widest_limits_of_the_wire_fit() {
        let limits =
            compile(&paper_but("x = 200.0", "x = 5242.87")).expect("fits").calibration.limits;
        assert_eq!(limits.max[0], Nanometres(5_242_870));
    }
}
