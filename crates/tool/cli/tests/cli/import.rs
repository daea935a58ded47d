//! `trueup import`: flags, the terminal's questions, the map of headers; and other commands that are given a table.

use crate::desk::Desk;
#[cfg(target_os = "linux")]
use crate::terminal::Terminal;

const TABLE: &str = "Zeit;Position;Richtung;Messuhr;Bemerkung\ns;mm;;µm;\n0;0;hin;0,5;\n10;100;hin;1,5;kalt\n\
                     20;100;rück;2,5;\n";
const RUN: &str = "time_s,x_mm,dir_x,measured_dx_um\n0,0,1,0.5\n10,100,1,1.5\n20,100,-1,2.5\n";
const FLAGS: &str = "--column Position=x_mm --column Messuhr=measured_dx_um";
const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";

#[test]
fn without_a_terminal_each_open_question_is_a_line_with_its_flag() {
    let desk = Desk::new(&[("t.csv", TABLE)]);
    let (out, err) = desk.run_expecting("import t.csv -o r.csv", 2);
    let lines: Vec<&str> = err.lines().collect();
    assert!(out.is_empty() && lines.len() == 2, "{out}{err}");
    assert!(
        lines[0].contains(
            "t.csv:1:6: Position is a position of which axis? Add --column Position=x_mm (or"
        ),
        "{err}"
    );
    assert!(
        lines[1].contains("t.csv:1:24: Messuhr") && lines[1].contains("measured_elongation_um"),
        "{err}"
    );
    assert_eq!(desk.files("."), ["t.csv"]);
    // The rest of many is one line.
    desk.write("u.csv", "Zeit;X;Y;Z;Bett Temperatur\n0;1;2;3;4\n1;2;3;4;5\n");
    let (_, err) = desk.run_expecting("import u.csv -o r.csv", 2);
    assert!(err.lines().count() == 3 && err.contains("and --unit Z=mm (or"), "{err}");
    let (_, err) = desk.run_expecting("import u.csv -o r.csv --json", 2);
    assert!(err.lines().next().is_some_and(|line| line.contains("\"column\":6")), "{err}");
}

#[test]
fn what_was_understood_is_printed_and_the_run_is_written() {
    let desk = Desk::new(&[("t.csv", TABLE)]);
    let (out, err) = desk.run_expecting(&format!("import t.csv -o r.csv {FLAGS}"), 0);
    assert_eq!((desk.text("r.csv").as_str(), err.as_str()), (RUN, ""));
    for phrase in [
        "t.csv: UTF-8, \";\" between columns, decimal comma, 3 rows",
        "Messuhr      measured_dx_um   µm      0,5 → 0.5; 1,5 → 1.5; 2,5 → 2.5",
        "skipped: Bemerkung (it is no quantity of a run)",
        "r.csv: written. Next: trueup check r.csv",
    ] {
        assert!(out.contains(phrase), "{phrase}: {out}");
    }
    // The command that it names.
    desk.run_expecting("check r.csv", 0);
    let (out, err) = desk.run_expecting(&format!("import t.csv -o - {FLAGS}"), 0);
    assert!(out == RUN && err.contains("decimal comma"), "{out}{err}");
    let (out, _) = desk.run_expecting(&format!("import t.csv -o s.csv --json {FLAGS}"), 0);
    let json: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!((&json["columns"][1]["name"], &json["rows"]), (&"x_mm".into(), &3.into()));
}

#[test]
fn a_file_that_is_there_is_replaced_only_by_the_same_or_on_request() {
    let desk = Desk::new(&[("t.csv", TABLE), ("r.csv", "mine\n")]);
    let line = format!("import t.csv -o r.csv {FLAGS}");
    let (_, err) = desk.run_expecting(&line, 2);
    assert!(err.contains("--overwrite") && desk.text("r.csv") == "mine\n", "{err}");
    desk.run_expecting(&format!("{line} --overwrite"), 0);
    desk.run_expecting(&line, 0);
    let (_, err) = desk.run_expecting(&format!("import t.csv -o t.csv --overwrite {FLAGS}"), 2);
    assert!(err.contains("is an input") && desk.text("t.csv") == TABLE, "{err}");
}

#[test]
fn a_map_is_written_once_and_answers_from_then_on() {
    let desk = Desk::new(&[("t.csv", TABLE)]);
    desk.run_expecting(&format!("import t.csv -o r.csv --map m.toml {FLAGS}"), 0);
    let map = desk.text("m.toml");
    assert!(map.contains("[columns.Messuhr]\nname = \"measured_dx_um\""), "{map}");
    desk.write("u.csv", TABLE.replace("2,5", "9,5"));
    desk.run_expecting("import u.csv -o s.csv --map m.toml", 0);
    assert_eq!(desk.text("s.csv"), RUN.replace("2.5", "9.5"));
    assert_eq!(desk.text("m.toml"), map);
    // A file of the kind that lacks a column of the map.
    desk.write("w.csv", "Zeit [s];Position [mm];Temperatur Bett [°C]\n0;1;20,5\n1;2;20,6\n");
    desk.run_expecting("import w.csv -o w.run.csv --map m.toml", 0);
    assert!(desk.text("w.run.csv").starts_with("time_s,x_mm,temp_bett_c\n"));
    desk.write("m.toml", format!("{map}colour = \"red\"\n"));
    let (_, err) = desk.run_expecting("import u.csv -o v.csv --map m.toml", 2);
    assert!(err.contains("m.toml:") && err.contains("colour is no key"), "{err}");
}

#[test]
fn a_wrong_flag_and_a_wrong_cell_are_one_line_each() {
    let desk = Desk::new(&[
        ("t.csv", TABLE),
        ("b.csv", "Zeit [s];X [mm]\n0;1\n1;zwei\n2;3\n"),
        ("m.toml", MACHINE),
    ]);
    for (line, phrase) in [
        ("import t.csv -o r.csv --unit Zeit", "must be a column, = and its unit"),
        ("import t.csv -o r.csv --unit Zeit=parsec", "must be a unit"),
        ("import t.csv -o r.csv --unit Weg=mm", "t.csv:1:1: there is no column Weg"),
        ("import b.csv -o r.csv", "b.csv:3:3: \"zwei\" is no number in X [mm]. correct it"),
        ("import none.csv -o r.csv", "none.csv:1:1: cannot be read"),
        ("import m.toml -o r.csv", "m.toml:1:1: has no row of numbers"),
        ("import t.csv -o none/r.csv", "there is no folder none"),
    ] {
        let (out, err) = desk.run_expecting(line, 2);
        assert!(err.to_lowercase().contains(&phrase.to_lowercase()), "{line}: {err}");
        assert!(out.is_empty() && err.lines().count() == 1, "{line}: {err}");
    }
    assert_eq!(desk.files("."), ["b.csv", "m.toml", "t.csv"]);
}

#[test]
fn volts_become_counts_by_the_machine_files_scale() {
    let inputs = "[inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 27648, divider = 0.328 }\n";
    let desk = Desk::new(&[
        ("t.csv", "Zeit [s];Sensor [V]\n0;1,5\n1;2\n"),
        ("m.toml", &format!("{MACHINE}{inputs}")),
    ]);
    let (_, err) = desk.run_expecting("import t.csv -o r.csv", 2);
    assert!(err.contains("--counts-per-v N, or --machine M.toml"), "{err}");
    let (_, err) = desk.run_expecting("import t.csv -o r.csv --machine m.toml", 0);
    assert_eq!(desk.text("r.csv"), "time_s,sensor_counts\n0,4147.2\n1,5529.6\n");
    assert!(err.contains("no column is a measured error"), "{err}");
}

#[test]
fn a_command_that_is_given_a_table_names_the_line_that_imports_it() {
    let desk = Desk::new(&[("Messung Mai.csv", TABLE), ("t.csv", TABLE), ("m.toml", MACHINE)]);
    for command in
        ["diagnose -m m.toml -r t.csv --out d", "fit backlash -r t.csv -o f.toml", "check t.csv"]
    {
        let output = desk.trueup(command);
        let err = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(2), "{command}: {err}");
        assert!(err.contains("help: trueup import t.csv -o t.run.csv"), "{command}: {err}");
    }
    // The columns are read, and none of them is known.
    desk.write("c.csv", "Zeit [s],X [mm],Abweichung X [mm]\n0,1,0.001\n1,2,0.002\n");
    let (_, err) = desk.run_expecting("check c.csv", 2);
    assert!(err.contains("is no run file, but a table that can be imported"), "{err}");
    desk.run_expecting("import c.csv -o c.run.csv", 0);
    assert_eq!(desk.text("c.run.csv"), "time_s,x_mm,measured_dx_um\n0,1,1\n1,2,2\n");
    // The message for a run file with a fault names the fault.
    desk.write("f.csv", "time_s;x_mm\n0;1,5\n");
    let (_, err) = desk.run_expecting("check f.csv", 2);
    assert!(err.contains("f.csv:2:3: x_mm 1,5 has a decimal comma"), "{err}");
}

#[cfg(target_os = "linux")]
#[test]
fn on_a_terminal_what_is_open_is_asked_and_the_map_keeps_it() {
    let desk = Desk::new(&[("t.csv", &TABLE.replace("µm", "").replace(",5", ".500"))]);
    let mut terminal =
        Terminal::start(&desk, "import t.csv -o r.csv --map m.toml", (120, 30), true);
    let down = "\u{1b}[B";
    // What stands on the screen, and what is typed then.
    for (requested, answer) in [
        ("Position is a position of which axis?", "\r"),
        ("Messuhr is the error in which direction", down),
        ("> measured_dy_um", "\r"),
        ("Messuhr states no unit", down),
        ("> µm", "\r"),
    ] {
        terminal.shows(&[requested]);
        terminal.press(answer);
    }
    let text = terminal.shows(&["r.csv: written"]);
    assert!(terminal.ended().success(), "{text}");
    assert_eq!(desk.text("r.csv"), RUN.replace("dx_um", "dy_um"));
    let map = desk.text("m.toml");
    for phrase in ["name = \"x_mm\"", "name = \"measured_dy_um\"", "unit = \"µm\""] {
        assert!(map.contains(phrase), "{phrase}: {map}");
    }
    desk.run_expecting("import t.csv -o s.csv --map m.toml", 0);
}
