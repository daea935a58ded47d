//! Runs in another unit, with fault values of thermometers, or without their directions of approach: reported or
//! mended by every command that reads them.

use crate::desk::Desk;

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
                       [spindle.temperature]\nsensor = \"temp_nose_c\"\nreference_c = 21.0\nk_um_per_c = 2.0\n\
                       lag_s = 500.0\n";
const LASH: &str =
    "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x.backlash]\nwidth_um = 14.0\n";

/// Returns a spindle of 3.1 µm/K and 450 s; `shown` makes of each temperature what the file says.
fn spindle(shown: impl Fn(usize, f64) -> f64) -> String {
    let mut text = String::from("time_s,temp_nose_c,spindle_rpm,measured_elongation_um\n");
    let (mut nose, mut growth) = (0.0, 0.0);
    for row in 0..600 {
        let rpm = if row % 240 < 150 { 7000.0 } else { 0.0 };
        nose += (rpm / 500.0 - nose) * (1.0 - (-25.0_f64 / 1_300.0).exp());
        growth += (nose - growth) * (1.0 - (-25.0_f64 / 450.0).exp());
        let noise = ((row * 7919 % 101) as f64 - 50.0) / 100.0;
        let (celsius, um) = (shown(row, 21.0 + nose), 3.1 * growth + 0.2 * noise);
        text += &format!("{},{celsius:.3},{rpm},{um:.3}\n", 25 * row);
    }
    text
}

fn number_after(text: &str, key: &str) -> f64 {
    let rest =
        text.split_once(&format!("{key} = ")).unwrap_or_else(|| panic!("no {key}: {text}")).1;
    rest.lines()
        .next()
        .and_then(|line| line.parse().ok())
        .unwrap_or_else(|| panic!("{key}: {text}"))
}

#[test]
fn fault_values_of_a_thermometer_are_excluded_by_every_command_and_reported() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    desk.write("sound.csv", spindle(|_, celsius| celsius));
    let fit = |run: &str| {
        let (_, err) = desk
            .run_expecting(&format!("fit elongation --run {run} --machine m.toml -o f.toml"), 0);
        let text = desk.text("f.toml");
        (["k_um_per_c", "reference_c", "lag_s"].map(|key| number_after(&text, key)), err)
    };
    let (right, err) = fit("sound.csv");
    assert!(!err.contains("shows"), "{err}");
    for (value, rows) in [
        (85.0, vec![77, 78, 300]),
        (-127.0, vec![150]),
        (-242.02, vec![9, 200, 410, 411, 500]),
        (988.79, vec![444]),
    ] {
        desk.write(
            "f.csv",
            spindle(|row, celsius| if rows.contains(&row) { value } else { celsius }),
        );
        let message = format!("temp_nose_c shows {value} in {} row", rows.len());
        let line = format!("(first in line {})", rows[0] + 2);
        let (found, err) = fit("f.csv");
        assert!(err.contains(&message) && err.contains(&line), "{err}");
        for (found, right, within) in
            [(found[0], right[0], 0.01), (found[1], right[1], 0.05), (found[2], right[2], 10.0)]
        {
            assert!((found - right).abs() < within, "{value}: {found} for {right}");
        }
        for (command, code) in [
            ("check -m m.toml f.csv", 3),
            ("predict -m m.toml -r f.csv -o p.csv", 0),
            ("learn -m m.toml -r f.csv -o l.toml", 3),
            ("trust -m m.toml --calibrated sound.csv -r f.csv", 0),
            ("compare sound.csv f.csv", 0),
            ("accept --off sound.csv --on f.csv --out a", 3),
            ("diagnose -m m.toml -r f.csv --out d", 0),
        ] {
            let output = desk.trueup(command);
            let err = String::from_utf8(output.stderr).expect("UTF-8");
            assert!(
                output.status.code() == Some(code) || !command.starts_with("check"),
                "{command}: {err}"
            );
            assert!(err.contains(&message) && err.contains(&line), "{command}: {err}");
        }
        // No row is predicted by what was no temperature.
        let predicted = desk.text("p.csv");
        let row = predicted.lines().nth(rows[0] + 1).expect("as many rows");
        assert!(row.contains(",,"), "{row}");
    }
}

#[test]
fn a_run_in_another_unit_is_reported_and_the_impossible_is_refused_until_it_is_accepted() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    desk.write("f.csv", spindle(|_, celsius| 32.0 + 1.8 * celsius));
    desk.write("t.csv", spindle(|_, celsius| (10.0 * celsius).round()));
    for command in [
        "check -m m.toml",
        "predict -m m.toml -o p.csv -r",
        "fit elongation -m m.toml -o f.toml -r",
        "diagnose -m m.toml --out d -r",
    ] {
        let text = |run: &str, more: &str| {
            let output = desk.trueup(&format!("{command} {run}{more}"));
            (output.status.code(), String::from_utf8(output.stderr).expect("UTF-8"))
        };
        let (code, err) = text("f.csv", "");
        // A constant that is found from it would be wrong.
        let finds = command.starts_with("fit") || command.starts_with("diagnose");
        assert!(err.contains("looks like °F, not °C"), "{command}: {err}");
        assert_eq!(code == Some(2), finds, "{command}: {err}");
        assert_eq!(err.contains("--accept temp_nose_c"), finds, "{command}: {err}");
        assert!(!desk.path("d").exists() && !desk.path("f.toml").exists(), "{command}");
        let (code, err) = text("f.csv", " --accept temp_nose_c");
        assert_ne!(code, Some(2), "{command}: {err}");
        let tidy = || {
            _ = std::fs::remove_file(desk.path("f.toml"));
            _ = std::fs::remove_dir_all(desk.path("d"));
        };
        tidy();
        let (code, err) = text("t.csv", "");
        assert!(
            err.contains("looks like tenths") && err.contains("--accept temp_nose_c"),
            "{command}: {err}"
        );
        assert_eq!(code, Some(2), "{command}");
        assert!(
            !desk.path("d/diagnosis.json").exists() || command.starts_with("check"),
            "{command}"
        );
        let (code, err) = text("t.csv", " --accept temp_nose_c");
        assert_ne!(code, Some(2), "{command}: {err}");
        tidy();
    }
}

/// Targets 0 to 200 mm there and back, with a backlash of 14 µm, with or without its directions.
fn sweeps(has_directions: bool) -> String {
    let mut text =
        format!("time_s,run,x_mm,{}measured_dx_um\n", if has_directions { "dir_x," } else { "" });
    let mut time_s = 0;
    for run in 0..6 {
        for (direction, lash) in [(1, 0.0), (-1, 14.0)] {
            for step in 0..9 {
                let place = if direction == 1 { step } else { 8 - step };
                let noise = f64::from(time_s * 13 % 17 - 8) * 0.05;
                let own = if has_directions { format!("{direction},") } else { String::new() };
                text += &format!("{time_s},{run},{},{own}{:.2}\n", 25 * place, lash + noise);
                time_s += 4;
            }
        }
    }
    text
}

#[test]
fn directions_that_are_missing_are_derived_and_reported() {
    let desk = Desk::new(&[("m.toml", LASH)]);
    desk.write("with.csv", sweeps(true));
    desk.write("without.csv", sweeps(false));
    let message = "dir_x is missing: x_mm falls as often as it rises";
    for (command, code) in [
        ("check -m m.toml RUN", 3),
        ("predict -m m.toml -r RUN -o p.csv", 0),
        ("diagnose -m m.toml -r RUN --out d", 0),
        ("fit backlash -m m.toml -r RUN -o f.toml", 0),
        ("fit pitch -m m.toml -r RUN -o f.toml", 0),
    ] {
        let both = ["with.csv", "without.csv"].map(|run| {
            let line = command.replace("RUN", run);
            let output = desk.trueup(&line);
            let err = String::from_utf8(output.stderr).expect("UTF-8");
            let is_without = run == "without.csv";
            assert_eq!(err.contains(message), is_without, "{line}: {err}");
            let expected = if command.starts_with("check") && !is_without { 0 } else { code };
            assert_eq!(output.status.code(), Some(expected), "{line}: {err}");
            let out = String::from_utf8(output.stdout).expect("UTF-8").replace(run, "RUN");
            // Places in the file differ by the column.
            out.lines().filter(|line| !line.contains("RUN:")).map(String::from).collect::<Vec<_>>()
        });
        if !command.starts_with("check") {
            assert_eq!(both[0], both[1], "{command}");
        }
    }
    let (message, _) = desk.run_expecting("diagnose -m m.toml -r without.csv --out d", 0);
    assert!(!message.contains("does not repeat"), "{message}");
}

#[test]
fn a_misspelt_column_is_reported_with_the_name_that_was_meant_and_a_free_one_is_not() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let text = spindle(|_, celsius| celsius);
    desk.write("slip.csv", text.replace("spindle_rpm", "spindel_rpm"));
    desk.write("free.csv", text.replace("spindle_rpm", "pump_rpm"));
    assert!(
        desk.run_expecting("check -m m.toml slip.csv", 3).1.contains("did you mean spindle_rpm?")
    );
    assert_eq!(desk.run_expecting("check -m m.toml free.csv", 0).1, "");
}

#[test]
fn a_clock_of_unix_seconds_and_the_first_line_of_a_spreadsheet_are_understood() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let rows: String = (0..40)
        .map(|row| format!("{};{};{}\n", 1_790_000_000 + 60 * row, 21 + row % 9, row % 9))
        .collect();
    desk.write("r.csv", format!("sep=;\ntimestamp;temp_nose_c;measured_elongation_um\n{rows}"));
    let (out, _) = desk.run_expecting("predict -m m.toml -r r.csv -o p.csv", 0);
    assert!(out.contains("40 rows") && desk.text("p.csv").starts_with("time_s,"), "{out}");
}
