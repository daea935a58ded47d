//! Faults in `[axis]`, `[straightness]` and `[squareness]` that are refused.

use crate::{MACHINE, assert_refused};

#[test]
fn an_axiss_thermal_growth_is_checked() {
    let right = "mode = \"both\"\nsensor = \"temp_a_c\"\n";
    let key = "axis.x.thermal";
    assert_refused(
        &format!("{MACHINE}[axis.x.thermal]\n"),
        &[
            ("", "4:9", &format!("{key}.mode is missing")),
            ("mode = \"screw\"\n", "5:8", "must be \"constant\" or \"position\" or \"both\""),
            ("mode = \"both\"\n", "4:9", &format!("{key}.sensor is missing")),
            ("mode = \"both\"\nsensor = \"a\"\n", "6:10", "must name a column temp_<name>_c"),
            (right, "4:9", &format!("{key}.reference_c is missing")),
            (
                &format!("{right}reference_c = 20\nslope_um_per_m = 1\n"),
                "8:1",
                "did you mean slope_um_per_m_per_c?",
            ),
            (&format!("{right}reference_c = 20\nlag_s = -1\n"), "8:9", "must not be negative"),
            (&format!("{right}table = []\n"), "7:9", "table must have 1 to 4096 elements, not 0"),
            (&format!("{right}table = [1, 2, 3]\n"), "7:10", "table[0] must be an array of three"),
            (&format!("{right}table = [[1, 2]]\n"), "7:10", "table[0] must have 3 elements, not 2"),
            (&format!("{right}table = [[1, 2, \"\"]]\n"), "7:17", "table[0][2] must be a number"),
            (
                &format!("{right}table = [[1, 2, 3], [5, 0, 0], [5, 1, 1]]\n"),
                "7:33",
                &format!("{key}.table[2][0] 5 is not above 5: T must rise"),
            ),
        ],
    );
}

#[test]
fn an_axiss_tables_are_checked() {
    let table = "start_mm = 0\nstep_mm = 1\n";
    let long = format!("{table}forward_um = [{}]\n", "1, ".repeat(4097));
    let key = "axis.x.pitch";
    assert_refused(
        &format!("{MACHINE}[axis.x.pitch]\n"),
        &[
            ("step_mm = 1\n", "4:9", &format!("{key}.start_mm is missing")),
            (
                "start_mm = 0\nstep_mm = 0\n",
                "6:11",
                &format!("{key}.step_mm must be above 0, not 0"),
            ),
            (table, "4:9", &format!("{key}.forward_um is missing")),
            (&format!("{table}forward_um = []\n"), "7:14", "must have 1 to 4096 elements, not 0"),
            (&long, "7:14", "must have 1 to 4096 elements, not 4097"),
            (&format!("{table}forward_um = 1\n"), "7:14", "must be an array of numbers"),
            (
                &format!("{table}forward_um = [1,\n 2, nan]\n"),
                "8:5",
                &format!("{key}.forward_um[2] must be a finite number"),
            ),
            (
                &format!("{table}forward_um = [1, 2, 3]\nreverse_um = [1, 2]\n"),
                "8:14",
                &format!("{key}.reverse_um has 2 elements, but forward_um has 3"),
            ),
            ("forwards_um = [1]\n", "5:1", "did you mean forward_um?"),
        ],
    );
}

#[test]
fn an_axis_is_checked() {
    let pitch = "[axis.y.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = [1]\n";
    let dual = "across = \"x\"\nfirst_mm = 0\nsecond_mm = 9\n";
    let second = "pitch = { start_mm = 0, step_mm = 1, forward_um = [1]";
    assert_refused(
        MACHINE,
        &[
            ("[axis.u]\n", "4:7", "unknown key axis.u"),
            ("[axis]\nx = 1\n", "5:5", "axis.x must be a table, not an integer"),
            ("[axis.x]\nfeedback = \"encoder\"\n", "5:12", "must be \"screw\" or \"scale\""),
            ("[axis.x.thermals]\n", "4:9", "did you mean thermal?"),
            ("[axis.y.backlash]\n", "4:9", "axis.y.backlash.width_um is missing"),
            ("[axis.y.backlash]\nwidth_um = 1\nramp_mm = -1\n", "6:11", "must not be negative"),
            (
                "[axis.y]\nfeedback = \"scale\"\n[axis.y.backlash]\nwidth_um = 1\n",
                "6:9",
                "axis.y.backlash belongs to feedback = \"screw\": a scale on the axis sees",
            ),
            (
                &format!("{pitch}reverse_um = [2]\n[axis.y.backlash]\nwidth_um = 1\n"),
                "9:9",
                "axis.y.backlash cannot be combined with a reverse_um table on the same axis",
            ),
            (
                &format!(
                    "{pitch}[axis.y.backlash]\nwidth_um = 1\n[axis.y.dual]\n{dual}{second}, \
                     reverse_um = [1] }}\n"
                ),
                "8:9",
                "axis.y.backlash cannot be combined with a reverse_um table on the same axis",
            ),
            (
                &format!("[axis.y.dual]\n{dual}{second} }}\n"),
                "4:9",
                "axis.y.dual needs [axis.y.pitch], the first drive's table",
            ),
            (
                &format!("{pitch}[axis.y.dual]\n{}{second} }}\n", dual.replace('x', "y")),
                "9:10",
                "axis.y.dual.across must be another axis than \"y\"",
            ),
            (
                &format!("{pitch}[axis.y.dual]\n{}{second} }}\n", dual.replace('9', "0")),
                "11:13",
                "axis.y.dual.second_mm must not be first_mm = 0",
            ),
            (&format!("{pitch}[axis.y.dual]\n{dual}"), "8:9", "axis.y.dual.pitch is missing"),
            (
                &format!("{pitch}[axis.y.dual]\n{dual}pitch = {{ start_mm = 0 }}\n"),
                "12:1",
                "axis.y.dual.pitch.step_mm is missing",
            ),
        ],
    );
}

#[test]
fn a_straightness_curve_is_checked() {
    let curve = |order: u32, knots: &str, control: &str| {
        format!("order = {order}\nknots_mm = [{knots}]\ncontrol_um = [{control}]\n")
    };
    assert_refused(
        &format!("{MACHINE}[straightness.z_of_x]\n"),
        &[
            ("", "4:15", "straightness.z_of_x.order is missing"),
            ("order = 4\n", "4:15", "straightness.z_of_x.knots_mm is missing"),
            ("order = 4.0\n", "5:9", "must be a whole number, not a float"),
            (&curve(5, "0", "0"), "5:9", "order must be 2, 3 or 4, not 5: the board runs cubics"),
            (
                &curve(4, "0", "0, 1, 2"),
                "7:14",
                "control_um has 3 elements, but a spline of order 4",
            ),
            (
                &curve(4, "0, 0, 0, 0, 1, 1, 1", "0, 1, 2, 3"),
                "6:12",
                "knots_mm must have 8 elements, 4 of control_um and 4 of the order, not 7",
            ),
            (
                &curve(2, "0, 0, 2, 1, 3, 3", "0, 1, 2, 3"),
                "6:22",
                "knots_mm[3] 1 is below 2 before it",
            ),
            (&curve(2, "1, 1, 1, 1", "0, 1"), "6:12", "must not all be 1"),
            (
                &curve(2, "0, 1, 3, 3", "0, 1"),
                "6:16",
                "knots_mm[1] must be 0 as well: the first knot",
            ),
            (
                &curve(2, "0, 0, 1, 3", "0, 1"),
                "6:19",
                "knots_mm[2] must be 3 as well: the last knot",
            ),
            (&curve(2, "0, 0, 0, 3, 3", "0, 1, 2"), "6:19", "0 repeats the end more than 2 times"),
            (&curve(2, "0, 0, 3, 3, 3", "0, 1, 2"), "6:19", "3 repeats the end more than 2 times"),
            (
                &curve(3, "0, 0, 0, 1, 2, 2, 2, 3, 3, 3", "0, 1, 2, 3, 4, 5, 6"),
                "6:31",
                "knots_mm[6] 2 stands there more than 2 times: the curve would jump",
            ),
            ("oder = 4\n", "5:1", "unknown key straightness.z_of_x.oder; did you mean order?"),
        ],
    );
    assert_refused(
        MACHINE,
        &[
            ("[straightness.x_of_x]\n", "4:15", "unknown key straightness.x_of_x"),
            ("[straightness]\nz_of_x = 1\n", "5:10", "straightness.z_of_x must be a table"),
        ],
    );
}

#[test]
fn the_squareness_is_checked() {
    assert_refused(
        &format!("{MACHINE}[squareness]\n"),
        &[
            ("x_of_y = 1\n", "5:1", "unknown key squareness.x_of_y; did you mean x_of_y_um_per_m?"),
            ("z_of_z_um_per_m = 1\n", "5:1", "unknown key squareness.z_of_z_um_per_m"),
            ("x_of_y_um_per_m = [1]\n", "5:19", "must be a number, not an array"),
        ],
    );
}
