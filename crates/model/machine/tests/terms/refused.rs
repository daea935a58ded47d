//! Terms that are refused, each with its place.

use std::path::Path;

use trueup_machine::MachineFile;

use super::{AXIS, HEAD, INPUTS, SENSOR, dependence, machine, term};

#[test]
fn what_fits_no_machine_is_refused_with_its_place() {
    for (sections, text, rule) in [
        (
            SENSOR,
            "cause = \"thermal-lag\"\nquantity = \"elongation\"\ntime_constant_s = 3.0",
            "term[0].cause \"thermal-lag\" needs a temperature on which elongation depends",
        ),
        (
            AXIS,
            "cause = \"axis-expansion\"\nquantity = \"dx\"\ncolumn = \"temp_b_c\"\n\
             um_per_m_per_c = 1.0\nreference_c = 20.0",
            "\"axis-expansion\" belongs to an axis without [axis.*.thermal]",
        ),
        (
            AXIS,
            "cause = \"expansion-constant\"\nquantity = \"dx\"\num_per_c = 1.0",
            "\"expansion-constant\" corrects a constant that the mode \"position\" does not use",
        ),
        (
            SENSOR,
            "cause = \"termal-lag\"\nquantity = \"elongation\"",
            "term[0].cause \"termal-lag\" is not known; did you mean thermal-lag?",
        ),
        (
            SENSOR,
            "cause = \"sensor-gain\"\nquantity = \"elongation\"\ngian = 1.0",
            "unknown key term[0].gian; did you mean gain?",
        ),
        (SENSOR, "cause = \"sensor-gain\"\nquantity = \"elongation\"", "term[0].gain is missing"),
        (
            SENSOR,
            "cause = \"backlash\"\nquantity = \"elongation\"\nwidth_um = 1.0",
            "belongs to dx, dy or dz",
        ),
        (
            SENSOR,
            "cause = \"cross-axis\"\nquantity = \"dx\"\naxis = \"x\"\num_per_m = 1.0",
            "another axis than the one that moves",
        ),
        (
            SENSOR,
            "cause = \"growth-rate\"\nquantity = \"elongation\"\ntime_constant_s = 1.0",
            "needs [spindle] source = \"warmup\"",
        ),
        (
            SENSOR,
            "cause = \"angular-error\"\nquantity = \"dx\"\nlever = \"x\"\nurad_per_m = 1.0",
            "\"angular-error\" has its lever along another axis than the one in error",
        ),
        (
            SENSOR,
            "cause = \"angular-error\"\nquantity = \"dx\"\nlever = \"y\"\nalong = \"y\"\n\
             urad_per_m = 1.0",
            "has its lever along another axis than the one that tilts",
        ),
        (
            SENSOR,
            "cause = \"angular-error\"\nquantity = \"dx\"\nlever = \"y\"\norder = 2\n\
             knots_mm = [0.0, 0.0, 9.0, 9.0]\ncontrol_urad = [1.0]",
            "term[0].control_urad has 1 elements, but a spline of order 2 needs at least 2",
        ),
        (
            AXIS,
            "cause = \"pitch-periodic\"\nquantity = \"dx\"\nperiod_mm = 1.0\n\
             amplitude_um = [1.0, 2.0]\nphase_deg = [1.0]",
            "term[0].phase_deg has 1 elements, but amplitude_um has 2",
        ),
    ] {
        let text = format!("{HEAD}{sections}[[term]]\n{text}\n");
        let error = MachineFile::parse(&text, Path::new("m.toml")).expect_err(rule).to_string();
        assert!(error.contains(rule), "{error}");
        let first = text.lines().position(|line| line == "[[term]]").expect("it is there") + 1;
        let line: usize =
            error.split(':').nth(1).and_then(|part| part.parse().ok()).expect("a line");
        assert!(line >= first, "{error}");
    }
    let text = format!("{HEAD}term = 3\n");
    let error = MachineFile::parse(&text, Path::new("m.toml")).expect_err("no tables");
    assert!(error.to_string().contains("unknown key machine.term"), "{error}");
}

#[test]
fn more_terms_than_the_board_runs_are_refused_with_the_one_that_is_too_much() {
    let gain = term("elongation", "cause = \"sensor-gain\"\ngain = 1.1");
    let full = machine(&format!("{INPUTS}{SENSOR}"), &gain.repeat(16));
    trueup_machine::compile(&full).expect("sixteen fit");
    let more = machine(&format!("{INPUTS}{SENSOR}"), &gain.repeat(17));
    let error = trueup_machine::compile(&more).expect_err("seventeen do not").to_string();
    assert!(error.contains("term[16] is too much: the board runs 16 terms"), "{error}");
    let far = term("elongation", "cause = \"sensor-offset\"\noffset_um = 1e5");
    let far = machine(&format!("{INPUTS}{SENSOR}"), &far);
    let error = trueup_machine::compile(&far).expect_err("too far").to_string();
    assert!(error.contains("term[0] 100000 µm is beyond the board's ±8388 µm"), "{error}");
}

#[test]
fn a_slope_by_heat_beyond_the_boards_range_is_refused() {
    let keys = dependence::RISE_BY_POSITION.replace("100.0", "120.0");
    let text = term("dx", &format!("cause = \"dependence\"\n{keys}"));
    let refused = trueup_machine::compile(&machine(&format!("{INPUTS}{AXIS}"), &text));
    let message = refused.expect_err("too steep").to_string();
    assert!(message.contains("120 µm/(m·K) is beyond the board's ±104"), "{message}");
}
