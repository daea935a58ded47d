//! A thermometer that is late.

use trueup_machine::machine_file::Quantity;

use super::{AXIS, TEMPERATURE, assert_near, predicted, term};

/// It warms by 1 K in 10 s. A thermometer 20 s behind by a lag shows 10 s/(e^(10/20) − 1) of that too
/// little, by a delay 2 K: at 2 µm/K of the spindle and 10 µm/(m·K) of the axis.
#[test]
fn the_part_is_warmer_than_a_thermometer_that_is_late_while_it_warms() {
    let csv = "time_s,x_mm,temp_a_c\n0,500,20\n10,500,21\n20,500,22\n30,0,23\n40,500,24\n";
    let late = |quantity, form| {
        let keys =
            format!("cause = \"thermometer-lag\"\ntime_constant_s = 20.0\nform = \"{form}\"");
        term(quantity, &keys)
    };
    let of = |sections, quantity: Quantity, terms: &str| predicted(sections, terms, quantity, csv);
    let behind_c = 1.0 / 0.5_f64.exp_m1();
    let grown = of(TEMPERATURE, Quantity::Elongation, &late("elongation", "lag"));
    assert_near(&grown[2..4], &[2.0 * (2.0 + behind_c), 2.0 * (3.0 + behind_c)]);
    let grown = of(TEMPERATURE, Quantity::Elongation, &late("elongation", "delay"));
    assert_near(&grown, &[4.0, 6.0, 8.0, 8.0, 8.0]);
    assert_near(&of(AXIS, Quantity::Dx, &late("dx", "lag"))[2..4], &[5.0 * (2.0 + behind_c), 0.0]);
}

/// Without a column of times nothing is late, and the run says what it lacks.
#[test]
fn a_late_thermometer_needs_the_time() {
    let late = term("elongation", "cause = \"thermometer-lag\"\ntime_constant_s = 20.0");
    let machine = super::machine(TEMPERATURE, &late);
    let needed = trueup_machine::model::required_columns(&machine);
    assert_eq!(needed, ["temp_a_c", "time_s"]);
}
