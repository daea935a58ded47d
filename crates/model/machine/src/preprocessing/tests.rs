use std::path::Path;

use super::*;
use crate::MachineFile;

fn run(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run")
}

fn machine(text: &str) -> Machine {
    let text = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{text}");
    MachineFile::parse(&text, Path::new("m.toml")).expect("the test's own file")
}

#[test]
fn fault_values_become_missing_ones_and_are_reported_with_count_value_and_line() {
    let mut text = String::from("time_s,temp_a_c,temp_b_c\n");
    for row in 0..200 {
        let sound = 20.0 + 0.05 * f64::from(row) + 0.01 * f64::from(row * 7 % 5);
        let a = match row {
            40 | 90 | 141 => 988.79,
            60 => 85.0,
            _ => sound,
        };
        text += &format!("{},{a:.2},{sound:.2}\n", 15 * row);
    }
    let (cleaned, warnings) = without_fault_values(run(&text));
    let warning_text: Vec<String> =
        warnings.iter().map(|warning| format!("{}: {}", warning.place, warning.what)).collect();
    assert_eq!(warning_text.len(), 2, "{warning_text:?}");
    assert!(
        warning_text[0]
            .starts_with("r.csv:42:5: temp_a_c shows 988.79 in 3 rows (first in line 42)"),
        "{warning_text:?}"
    );
    assert!(
        warning_text[1].starts_with("r.csv:62:5: temp_a_c shows 85 in 1 row (first in line 62)"),
        "{warning_text:?}"
    );
    let values = cleaned.column("temp_a_c").expect("there");
    let missing: Vec<usize> = (0..200).filter(|&row| values[row].is_nan()).collect();
    assert_eq!(missing, [40, 60, 90, 141]);
    assert!(cleaned.column("temp_b_c").expect("there").iter().all(|value| !value.is_nan()));
    // A column that is nothing else is left for the rule of units.
    let (retained, warnings) = without_fault_values(run("temp_a_c\n988.79\n988.79\n988.79\n"));
    assert_eq!((retained.column("temp_a_c").expect("there")[0], warnings), (988.79, Vec::new()));
}

/// Positions 0, 10, 20, 30 there and back in each of three runs; `turn` says whether the last target is read
/// from both sides.
fn sweeps(turn: bool) -> (String, Vec<f64>) {
    let (mut text, mut directions) = (String::from("run,y_mm,measured_dy_um\n"), Vec::new());
    for number in 0..3 {
        for (direction, all) in [(1.0, [0, 10, 20, 30]), (-1.0, [30, 20, 10, 0])] {
            for place in all {
                if direction < 0.0 && place == 30 && !turn {
                    continue;
                }
                text += &format!("{number},{place},0.5\n");
                directions.push(direction);
            }
        }
    }
    (text, directions)
}

#[test]
fn directions_that_are_missing_are_those_in_which_the_positions_go() {
    for turn in [true, false] {
        let (text, directions) = sweeps(turn);
        let (with, warnings) = with_approach_directions(run(&text), None);
        assert_eq!(with.column("dir_y").expect("derived"), directions, "{turn}");
        let [warning] = &warnings[..] else { panic!("{warnings:?}") };
        assert!(
            warning
                .what
                .starts_with("dir_y is missing: y_mm falls as often as it rises. It is derived")
        );
        assert!(warning.help.contains("(+1, −1)"), "{}", warning.help);
    }
}

#[test]
fn nothing_is_derived_where_positions_do_not_say_it() {
    let derives = |text: &str, machine: Option<&Machine>| {
        let (with, warnings) = with_approach_directions(run(text), machine);
        (with.column("dir_x").is_some(), warnings.len())
    };
    // One way only, back at the start of each run; no error of the axis; the directions are there.
    let one_way: String = (0..20).map(|row| format!("{},0.1\n", 10 * (row % 5))).collect();
    assert_eq!(derives(&format!("x_mm,measured_dx_um\n{one_way}"), None), (false, 0));
    let there_and_back = "0,1\n5,1\n9,1\n9,1\n5,1\n0,1\n0,1\n5,1\n9,1\n9,1\n5,1\n0,1\n";
    assert_eq!(derives(&format!("x_mm,measured_dz_um\n{there_and_back}"), None), (false, 0));
    // Positions in no order are reported where the model goes by the direction.
    let drawn: String = (0..40).map(|row| format!("{},0.1\n", row * 17 % 41)).collect();
    let text = format!("x_mm,measured_dx_um\n{drawn}");
    assert_eq!(derives(&text, None), (false, 0));
    assert_eq!(derives(&text, Some(&machine("[axis.x]\n"))), (false, 0));
    let lash = machine("[axis.x.backlash]\nwidth_um = 8.0\n");
    assert_eq!(derives(&text, Some(&lash)), (false, 1));
}
