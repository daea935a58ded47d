//! `extra-heat-path` by the spindle's speed: what it predicts, and what it refuses.

use super::*;

pub(super) const LINEAR: &str = "column = \"spindle_rpm\"\ninput = \"speed\"\num_per_krpm = 0.7\n\
                        time_constant_s = 1630.0";
pub(super) const SQUARE: &str = "column = \"spindle_rpm\"\ninput = \"speed2\"\num_per_krpm2 = -0.04\n\
                         time_constant_s = 900.0";

/// From cold, at 4000 r/min the other way round, at rest, and started anew where time runs back. A row without a
/// speed is passed over.
#[test]
fn the_speed_heats_an_axis_from_cold_by_itself_or_its_square() {
    let csv =
        "run,time_s,spindle_rpm\n1,50,-4000\n1,150,-4000\n1,200,\n1,250,0\n2,0,8000\n2,100,8000\n";
    let e = (-1.0_f64).exp();
    for (input, key, heating) in
        [("speed", "um_per_krpm", [4.0, 8.0]), ("speed2", "um_per_krpm2", [16.0, 64.0])]
    {
        let [slow, fast] = heating.map(|heating| -3.0 * heating * (1.0 - e));
        let expected = [0.0, slow, slow * e, 0.0, fast];
        let near = |mut got: Vec<f64>| {
            assert!(got.remove(2).is_nan());
            assert_near(&got, &expected);
        };
        for input in [format!("input = \"{input}\"\n"), String::new()] {
            let keys = format!(
                "cause = \"extra-heat-path\"\ncolumn = \"spindle_rpm\"\n{input}{key} = -3.0\n\
                 time_constant_s = 100.0"
            );
            for quantity in [Quantity::Dx, Quantity::Dy, Quantity::Dz] {
                near(predicted("", &term(quantity.name(), &keys), quantity, csv));
            }
            let grown = term("elongation", &keys);
            let csv = csv.replace('\n', ",0\n").replacen(",0", ",sensor_counts", 1);
            near(predicted(SENSOR, &grown, Quantity::Elongation, &csv));
        }
    }
}

#[test]
fn a_term_by_the_speed_says_what_it_lacks() {
    let refused = |keys: &str| {
        let text = term("dx", &format!("cause = \"extra-heat-path\"\n{keys}"));
        let text = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{text}");
        MachineFile::parse(&text, Path::new("m.toml")).expect_err(keys).to_string()
    };
    for (keys, phrase) in [
        ("column = \"spindle_rpm\"\num_per_krpm2 = 1.0\n", "time_constant_s"),
        ("column = \"spindle_rpm\"\ninput = \"speed\"\ntime_constant_s = 9.0\n", "um_per_krpm"),
        ("column = \"temp_a_c\"\num_per_krpm = 1.0\ntime_constant_s = 9.0\n", "spindle_rpm"),
        ("column = \"spindle_rpm\"\num_per_c = 1.0\nreference_c = 9.0\n", "um_per_c"),
        (
            "column = \"spindle_rpm\"\ninput = \"speed\"\num_per_krpm2 = 1.0\ntime_constant_s = 9.0\n",
            "um_per_krpm2",
        ),
    ] {
        let message = refused(keys);
        assert!(message.contains(phrase), "{message}");
    }
}
