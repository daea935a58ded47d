//! Terms that take each other back are refused before a board runs them, and right files are not.

use std::path::Path;

use trueup_machine::{
    Machine, MachineFile, check, compile,
    envelope::{InputRanges, find_cancelling_terms, find_limit_violation, predict_states},
};

/// Returns a spindle that grows by 1.8 µm for each kelvin of its front bearing; Z held to `max_z_um`.
fn machine(max_z_um: f64, terms: &str) -> Machine {
    let text = format!(
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\ntemp_front_c = {{ channel = 0, kind = \"pt100\" }}\n\
         [spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \"temp_front_c\"\n\
         reference_c = 21.0\nk_um_per_c = 1.8\nlag_s = 420.0\n[axis.x]\ntravel_mm = [0.0, 600.0]\n\
         [limits]\nmax_um = {{ x = 200.0, y = 200.0, z = {max_z_um} }}\n{terms}"
    );
    MachineFile::parse(&text, Path::new("m.toml")).expect("the test's own file")
}

/// Returns a zero and a first rise from `start_s` of the record's own clock on.
fn pair(offset_um: f64, amplitude_um: f64) -> String {
    format!(
        "[[term]]\ncause = \"sensor-offset\"\nquantity = \"elongation\"\noffset_um = {offset_um}\n\
         [[term]]\ncause = \"slow-mode\"\nquantity = \"elongation\"\namplitude_um = {amplitude_um}\n\
         time_constant_s = 510.0\nstart_s = 9000000.0\n"
    )
}

#[test]
fn a_zero_that_a_first_rise_takes_back_is_refused_with_what_it_does_after_a_start() {
    for (offset_um, amplitude_um) in [(-643.0, 636.0), (388.0, -391.0), (-1450.0, 1444.0)] {
        let machine = machine(300.0, &pair(offset_um, amplitude_um));
        let refused = compile(&machine).expect_err("Z would stand at its limit");
        assert!(refused.rule.contains("right after a start"), "{refused}");
        assert!(refused.rule.contains("limits.max_um.z is 300"), "{refused}");
        assert!(refused.rule.contains("sensor-offset"), "{refused}");
    }
    // Within the limit it can be run; `check` says it.
    let small = machine(300.0, &pair(-143.0, 139.0));
    compile(&small).expect("the board can run it");
    let warnings = check::machine_warnings(&small);
    assert!(
        warnings.iter().any(|warning| warning.what.contains("take each other back")),
        "{warnings:?}"
    );
    // With a limit as large as the two, neither is believed.
    let wide = machine(3000.0, &pair(-1450.0, 1444.0));
    assert!(compile(&wide).is_err_and(|error| error.rule.contains("take each other back")));
}

#[test]
fn two_paths_of_one_thermometer_that_part_on_the_way_are_refused() {
    let paths = "[[term]]\ncause = \"extra-heat-path\"\nquantity = \"elongation\"\ncolumn = \"temp_front_c\"\n\
                 um_per_c = 90.0\ntime_constant_s = 0.0\nreference_c = 20.0\n\
                 [[term]]\ncause = \"slow-mode\"\nquantity = \"elongation\"\ncolumn = \"temp_front_c\"\n\
                 um_per_c = -89.0\ntime_constant_s = 3600.0\nreference_c = 20.0\n";
    let excess = find_limit_violation(&machine(300.0, paths))
        .expect("the first hour after a start is beyond the limit");
    assert!(excess.um.abs() > 300.0 && excess.rule.contains("min after a start"), "{excess:?}");
}

#[test]
fn what_a_machine_may_need_is_not_refused() {
    let right = [
        // A zero, a first rise of a large spindle, a slow path, and a jump that the board does not run.
        "[[term]]\ncause = \"sensor-offset\"\nquantity = \"elongation\"\noffset_um = -37.0\n",
        "[[term]]\ncause = \"slow-mode\"\nquantity = \"elongation\"\namplitude_um = 64.0\ntime_constant_s = 4000.0\n",
        "[[term]]\ncause = \"extra-heat-path\"\nquantity = \"dx\"\ncolumn = \"temp_front_c\"\num_per_c = -7.5\n\
         time_constant_s = 900.0\nreference_c = 22.0\n",
        "[[term]]\ncause = \"step\"\nquantity = \"elongation\"\nat_s = 60.0\nsize_um = 900.0\n",
        "[[term]]\ncause = \"pitch-scale\"\nquantity = \"dx\"\num_per_m = -140.0\nconstant_um = 51.0\n",
    ];
    for terms in right {
        let machine = machine(300.0, terms);
        compile(&machine).unwrap_or_else(|refused| panic!("{refused}\n{terms}"));
        assert_eq!(find_cancelling_terms(&machine), None, "{terms}");
    }
}

/// By hand: at 30 °C and 600 mm nothing but growth, 1.8·9 µm down; right after a start the rise is not there yet.
#[test]
fn a_state_is_what_the_model_says_there() {
    let machine = machine(300.0, &pair(-10.0, 25.0));
    let all = predict_states(&machine, &InputRanges::normal(&machine));
    let of = |moment: fn(&&trueup_machine::envelope::PredictedState) -> bool| {
        let um = all.iter().filter(moment).map(|state| state.um[0]);
        um.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], um| [low.min(um), high.max(um)])
    };
    let near = |[a, b]: [f64; 2], [c, d]: [f64; 2]| (a - c).abs() < 0.01 && (b - d).abs() < 0.01;
    let first = of(|state| state.since_start_s == 0.0);
    assert!(near(first, [-1.8 * 11.0 - 10.0, 1.8 * 9.0 - 10.0]), "{first:?}");
    let settled = of(|state| state.is_settled);
    assert!(near(settled, [-1.8 * 11.0 + 15.0, 1.8 * 9.0 + 15.0]), "{settled:?}");
}

/// Returns a machine without a spindle's thermometer, with paths of heat along Z: column, µm/°C, and the temperature at which
/// each does nothing.
fn machine_with_heat_paths(paths: &[(&str, f64, f64)]) -> Machine {
    let mut text = String::from(
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[limits]\nmax_um = { x = 40.0, y = 40.0, z = 40.0 }\n",
    );
    for (column, um_per_c, reference_c) in paths {
        text += &format!(
            "[[term]]\nquantity = \"dz\"\ncause = \"extra-heat-path\"\ncolumn = \"{column}\"\num_per_c = {um_per_c}\n\
             reference_c = {reference_c}\n"
        );
    }
    MachineFile::parse(&text, Path::new("m.toml")).expect("the test's own file")
}

/// A machine without a term has fewer thermometers, and fewer states of its own: each term is compared in those of the whole.
#[test]
fn a_thermometer_that_one_term_reads_is_there_without_the_term() {
    // By hand: 0 µm at 10 °C and 100 µm at 30 °C, which is clamped and no fault of two terms.
    let one = machine_with_heat_paths(&[("temp_bed_c", 5.0, 10.0)]);
    assert_eq!(find_limit_violation(&one), None);
    assert_eq!(find_cancelling_terms(&one), None);
    // 200 to 600 µm and as much less: nothing is left, and neither is believed.
    let two = machine_with_heat_paths(&[("temp_bed_c", 20.0, 0.0), ("temp_room_c", -20.0, 0.0)]);
    let violation = find_limit_violation(&two).expect("two terms take each other back");
    assert!(violation.rule.contains("take each other back"), "{violation:?}");
    assert_eq!(violation.um.abs(), 600.0);
    let pair = find_cancelling_terms(&two).expect("the same two");
    assert_eq!((pair.terms, pair.um.map(f64::abs)), ([0, 1], [600.0; 2]));
}
