//! From the integers of the board back to a machine file.
//!
//! The board's calibration knows readings, not the PLC's counts, and neither the machine's name nor
//! its inputs. The machine file that is shown therefore takes ADC codes for counts, by inputs whose
//! scale is exactly one code a count, and is otherwise what a user would write.
//!
//! What is shown compiles back to the very same calibration. This is checked for every calibration
//! that is shown, and held against random ones in `tests/show_round_trip.rs`. A calibration that no
//! machine file compiles to (one that was not written by [`compile`](mod@crate::compile)) is shown
//! as well, with the reason.

use std::{fmt::Write, path::Path};

use trueup_core::{
    calibration::Calibration,
    limits::Limits,
    sensor::{SensorLaw, Slope},
    tool::Direction,
    units::{Code, NANOMETRES_PER_MICROMETRE, READINGS_PER_CODE},
};

use crate::{
    compile::{Compiled, compile},
    inputs::{REFERENCE_VOLTS, SensorInput},
    machine_file::MachineFile,
};

/// The inputs of a machine that is shown: one count is one ADC code, exactly.
pub const SHOWN_INPUT: SensorInput =
    SensorInput { volts_full_scale: 10.0, counts_full_scale: 4096.0, divider: 0.33 };

/// A slope that the board's integers hold as 0; a machine file must not state 0 itself.
const UM_PER_COUNT_OF_NO_SLOPE: f64 = 1e-12;

const NM_PER_UM: f64 = NANOMETRES_PER_MICROMETRE as f64;

/// A calibration as a machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// The machine file.
    pub toml: String,
    /// The largest difference in nm between the machine file's model and the calibration's law over
    /// the input range; or, of a calibration that no machine file compiles to, the reason.
    pub largest_difference_nm: Result<f64, String>,
}

/// Turns `calibration` back into a machine file.
#[must_use]
pub fn show(calibration: &Calibration) -> Shown {
    let mut toml = String::new();
    write_machine(&mut toml, calibration).expect("a String can always be written");
    let largest_difference_nm = compiled_back(&toml, calibration);
    let verdict = match &largest_difference_nm {
        Ok(nm) => format!(
            "Compiles back to the same calibration. Largest difference from the board's law: {nm:.3} nm"
        ),
        Err(reason) => format!("Does not compile back to this calibration: {reason}"),
    };
    Shown { toml: format!("# {verdict}\n\n{toml}"), largest_difference_nm }
}

/// The largest difference in nm, if `toml` compiles to `calibration`.
fn compiled_back(toml: &str, calibration: &Calibration) -> Result<f64, String> {
    let compiled: Compiled = MachineFile::parse(toml, Path::new("shown"))
        .and_then(|machine| compile(&machine))
        .map_err(|bad| bad.rule)?;
    if compiled.calibration == *calibration {
        Ok(compiled.largest_difference_nm)
    } else {
        Err("it holds values that no machine file is compiled to".into())
    }
}

fn write_machine(toml: &mut String, calibration: &Calibration) -> std::fmt::Result {
    let Calibration { sensor, tool_direction, limits } = calibration;
    writeln!(toml, "[machine]")?;
    writeln!(toml, "name = \"shown\" # a calibration holds no name")?;
    writeln!(toml, "kind = \"3-axis\"")?;
    writeln!(toml, "tool_direction = {:?}", written_direction(*tool_direction))?;
    if *sensor != SensorLaw::default() {
        write_sensor(toml, sensor)?;
    }
    write_limits(toml, limits)
}

fn write_sensor(toml: &mut String, law: &SensorLaw) -> std::fmt::Result {
    let SensorInput { volts_full_scale, counts_full_scale, divider } = SHOWN_INPUT;
    let readings_per_count = f64::from(READINGS_PER_CODE);
    let slope_nm = f64::from(law.slope.0) / (1_u64 << Slope::FRACTION_BITS) as f64;
    let um_per_count = slope_nm * readings_per_count / NM_PER_UM;
    let codes = Code::FULL_SCALE;
    writeln!(toml, "\n[inputs]")?;
    writeln!(
        toml,
        "# Assumed: counts are ADC codes, {codes} for {REFERENCE_VOLTS} V at the ADC. A"
    )?;
    writeln!(
        toml,
        "# calibration does not hold the counts of the machine file that it came from."
    )?;
    writeln!(
        toml,
        "sensor = {{ volts_full_scale = {volts_full_scale:?}, counts_full_scale = \
         {counts_full_scale:?}, divider = {divider:?} }}"
    )?;
    writeln!(toml, "\n[spindle]\nsource = \"sensor\"\n\n[spindle.sensor]")?;
    writeln!(toml, "k0_um = {:?}", f64::from(law.k0.0) / NM_PER_UM)?;
    writeln!(toml, "zero_counts = {:?}", f64::from(law.zero.0) / readings_per_count)?;
    if law.slope.0 == 0 {
        writeln!(toml, "um_per_count = {UM_PER_COUNT_OF_NO_SLOPE:?} # on the board: 0")
    } else {
        writeln!(toml, "um_per_count = {um_per_count:?}")
    }
}

fn write_limits(toml: &mut String, limits: &Limits) -> std::fmt::Result {
    let [x, y, z] = limits.max.map(|max| f64::from(max.0) / NM_PER_UM);
    writeln!(toml, "\n[limits]")?;
    writeln!(toml, "max_um = {{ x = {x:?}, y = {y:?}, z = {z:?} }}")?;
    writeln!(toml, "slew_um_per_s = {:?}", f64::from(limits.slew_nm_per_s) / NM_PER_UM)?;
    writeln!(toml, "link_timeout_ms = {}", limits.link_timeout_ms)?;
    writeln!(toml, "hold_ms = {}", limits.hold_ms)
}

/// The direction with the fewest decimals that is stored as `stored` again.
fn written_direction(stored: Direction) -> [f64; 3] {
    const MOST_DECIMALS: i32 = 12;
    let unit = unit_vector_near(stored);
    (0..=MOST_DECIMALS)
        .map(|decimals| {
            let scale = 10_f64.powi(decimals);
            // + 0.0 turns −0 into 0.
            unit.map(|component| (component * scale).round() / scale + 0.0)
        })
        .find(|&written| is_stored_as(written, stored))
        .unwrap_or(unit)
}

/// Whether the machine file's reader and the compiler make `stored` of `written`.
fn is_stored_as(written: [f64; 3], stored: Direction) -> bool {
    let length = written.iter().map(|component| component * component).sum::<f64>().sqrt();
    let one = f64::from(Direction::ONE);
    // Without a length this is NaN, which is equal to nothing.
    written.map(|component| (component / length * one).round()) == stored.0.map(f64::from)
}

/// A vector of length 1 whose every component rounds to that of `stored`.
///
/// The stored vector is not of length 1, and to scale it can move a component by up to 0.68 of its
/// last place, into the next one. What rounding has added to the length is therefore taken back in
/// equal steps from all three components, which moves each by half a place at most if there is such
/// a vector at all.
fn unit_vector_near(stored: Direction) -> [f64; 3] {
    let one = f64::from(Direction::ONE);
    let components = stored.0.map(f64::from);
    let length = components.iter().map(|component| component * component).sum::<f64>().sqrt();
    let sum = components.iter().map(|component| component.abs()).sum::<f64>();
    let step = if sum == 0.0 { 0.0 } else { (length - one) * length / sum };
    components.map(|component| {
        let sign = if component == 0.0 { 0.0 } else { component.signum() };
        (component - sign * step) / one
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::compile;
    use trueup_core::units::{Nanometres, Reading};

    const PAPER: &str = include_str!("../../../data/paper_spindle.toml");

    fn paper_but(from: &str, to: &str) -> Calibration {
        let machine = MachineFile::parse(&PAPER.replace(from, to), Path::new("m.toml"));
        compile(&machine.expect("a right machine file")).expect("fits").calibration
    }

    #[test]
    fn one_count_of_the_shown_input_is_one_code_exactly() {
        assert_eq!(SHOWN_INPUT.codes_from_counts(1.0), 1.0);
        assert_eq!(SHOWN_INPUT.exact_reading_from_counts(1.0), 1024.0);
    }

    #[test]
    fn the_papers_calibration_is_shown_in_codes() {
        let shown = show(&paper_but("", ""));
        assert_eq!(shown.largest_difference_nm, Ok(0.0));
        for line in [
            "# Compiles back to the same calibration. Largest difference from the board's law: 0.000 nm",
            "tool_direction = [0.0, 0.0, -1.0]",
            "sensor = { volts_full_scale = 10.0, counts_full_scale = 4096.0, divider = 0.33 }",
            "source = \"sensor\"",
            "k0_um = 0.0",
            // 5048 counts of 1/8 code, 500 µm over 4096 codes.
            "zero_counts = 631.0",
            "um_per_count = 0.1220703125",
            "max_um = { x = 200.0, y = 200.0, z = 500.0 }",
            "slew_um_per_s = 20.0",
            "link_timeout_ms = 500",
            "hold_ms = 2000",
        ] {
            assert!(shown.toml.lines().any(|shown| shown == line), "{line}\n{}", shown.toml);
        }
    }

    #[test]
    fn a_direction_is_shown_as_the_user_wrote_it() {
        let calibration =
            paper_but("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0, 0.6, -0.8]");
        let shown = show(&calibration).toml;
        assert!(shown.contains("\ntool_direction = [0.0, 0.6, -0.8]\n"), "{shown}");
    }

    #[test]
    fn without_a_source_no_input_is_shown() {
        let shown = show(&Calibration { sensor: SensorLaw::default(), ..paper_but("", "") });
        assert_eq!(shown.largest_difference_nm, Ok(0.0));
        assert!(!shown.toml.contains("spindle") && !shown.toml.contains("inputs"));
    }

    #[test]
    fn a_law_without_a_slope_is_shown_too() {
        let sensor = SensorLaw { k0: Nanometres(1234), zero: Reading(i32::MIN), slope: Slope(0) };
        let shown = show(&Calibration { sensor, ..paper_but("", "") });
        assert!(shown.largest_difference_nm.is_ok_and(|nm| nm < 0.01), "{}", shown.toml);
    }

    #[test]
    fn what_no_machine_file_compiles_to_is_shown_with_the_reason() {
        let good = paper_but("", "");
        let mut no_slew = good;
        no_slew.limits.slew_nm_per_s = 0;
        let mut no_timeout = good;
        no_timeout.limits.link_timeout_ms = 0;
        let mut too_long = good;
        too_long.tool_direction.0[2] -= 500;
        let mut too_far = good;
        too_far.sensor.k0 = Nanometres(i32::MAX);
        for (calibration, reason) in [
            (no_slew, "limits.slew_um_per_s must be above 0"),
            (no_timeout, "limits.link_timeout_ms must be from 1"),
            (too_long, "no machine file"),
            (too_far, "beyond the board's"),
        ] {
            let shown = show(&calibration);
            let error = shown.largest_difference_nm.expect_err(reason);
            assert!(error.contains(reason), "{error}");
            assert!(shown.toml.starts_with("# Does not compile back to this calibration: "));
            assert!(shown.toml.contains("[limits]"));
        }
    }
}
