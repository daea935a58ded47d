//! `trueup new` and `trueup schema`, and a result on standard output.

use crate::desk::Desk;
#[cfg(target_os = "linux")]
use crate::terminal::Terminal;

#[test]
fn a_new_file_compiles_and_nothing_in_it_is_doubted() {
    let desk = Desk::new(&[]);
    let line = "new -o m.toml --yes --name mill --travel x=0:600 --travel z=-300:0 --rapid 15000 \
                --sensor-um-per-v 50 --sensor-zero-v 1.54 --thermometer screw --control siemens";
    let (out, err) = desk.run_expecting(line, 0);
    assert!(out.starts_with("m.toml: written") && err.is_empty(), "{out}{err}");
    let text = desk.text("m.toml");
    for phrase in [
        "zero_v = 1.54 #",
        "counts_full_scale = 27648, divider = 0.328",
        "travel_mm = [-300.0, 0.0]",
    ] {
        assert!(text.contains(phrase), "{phrase}: {text}");
    }
    assert_eq!(desk.run_expecting("check m.toml", 0).1, "");
    assert_eq!(desk.run_expecting("compile m.toml -o m.bin", 0).1, "");
    // It is the user's from now on.
    let (_, err) = desk.run_expecting(line, 2);
    assert!(err.contains("m.toml: is there already"), "{err}");
    assert_eq!(desk.text("m.toml"), text);
}

#[test]
fn without_a_terminal_nothing_is_asked_and_a_dash_is_standard_output() {
    let desk = Desk::new(&[]);
    let (text, err) =
        desk.run_expecting("new -o - --kind head-head --head-axes c,a --travel x=0:600", 0);
    assert!(text.starts_with("# What is known of this machine."), "{text}");
    assert!(err.contains("machine.toml: written"), "{err}");
    desk.write("m.toml", &text);
    let (toml, err) = desk.run_expecting("compile m.toml -o c.bin", 0);
    assert!(
        toml.contains("calibration of \"machine\"") && err.contains("corrects nothing"),
        "{toml}{err}"
    );
    let blob = desk.trueup("compile m.toml -o -");
    assert_eq!(blob.stdout, desk.read("c.bin"), "the calibration and nothing else");
    assert!(desk.files(".").iter().all(|name| name != "-"));
}

#[test]
fn what_the_flags_contradict_is_refused() {
    let desk = Desk::new(&[]);
    for (flags, phrase) in [
        ("--kind head-head --head-axes c", "must name exactly two"),
        ("--travel x=0:6 --travel x=0:7", "--travel x is given twice"),
        ("--travel x=6:0", "the lower end stands first"),
        ("--travel w=0:6", "the axis must be x, y or z"),
        ("--sensor-um-per-v 0", "must not be 0"),
        ("--thermometer a --thermometer a", "--thermometer a is given twice"),
        ("--thermometer a-b", "must be a word"),
    ] {
        let (_, err) = desk.run_expecting(&format!("new -o m.toml --yes {flags}"), 2);
        assert!(err.contains(phrase), "{flags}: {err}");
    }
    assert!(desk.files(".").is_empty());
}

#[test]
fn the_schema_and_the_columns_are_json_and_markdown() {
    let desk = Desk::new(&[]);
    let json = |line: &str| -> serde_json::Value {
        serde_json::from_str(&desk.run_expecting(line, 0).0).expect("JSON")
    };
    let schema = json("schema");
    assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    assert_eq!(schema["properties"]["limits"]["properties"]["hold_ms"]["default"], 2000);
    assert!(json("schema run").as_array().is_some_and(|columns| columns.len() > 20));
    let scenario = json("schema scenario");
    assert_eq!(scenario["properties"]["interval_s"]["default"], 10.0);
    assert!(desk.run_expecting("schema --markdown", 0).0.starts_with("| key | unit | range |"));
    assert!(
        desk.run_expecting("schema run --markdown", 0).0.starts_with("| column | unit | what |")
    );
    let table = desk.run_expecting("schema scenario --markdown", 0).0;
    let page = include_str!("../../../../../docs/reference.md");
    assert!(
        page.contains(table.trim_end()),
        "put what `trueup schema scenario --markdown` prints into docs/reference.md"
    );
}

/// An answer that cannot be is asked for again at once: who has answered ten questions is not to lose them to
/// the eleventh.
#[cfg(target_os = "linux")]
#[test]
fn on_a_terminal_it_asks_and_what_cannot_be_is_asked_for_again() {
    let desk = Desk::new(&[]);
    let mut terminal = Terminal::start(&desk, "new -o m.toml", (80, 24), true);
    let down = "\u{1b}[B";
    // What stands on the screen, and what is typed then.
    for (requested, answer) in [
        ("Name of the machine [machine]", "mill\r"),
        ("Kind of machine", down),
        ("> two rotary axes carry the spindle", "\r"),
        ("from the frame to the tool [c,a]", "c\r"),
        ("must be two of a, b and c", "b,c\r"),
        ("Travel of X", "600\r"),
        ("must be the two ends", "600:0\r"),
        ("the lower end stands first", "0:600\r"),
        ("Travel of Y", "\r"),
        ("Travel of Z", "-300:0\r"),
        ("Where are positions measured?", "\r"),
        ("Rapid traverse in mm/min (empty: not known)", "0\r"),
        ("must be above 0", "<\r"),
        ("Where are positions measured?", "\r"),
        ("Rapid traverse in mm/min (empty: not known)", "15000\r"),
        ("displacement sensor at the spindle? y or n [y]", "<\r"),
        ("Rapid traverse in mm/min (empty: not known)", "15000\r"),
        ("displacement sensor at the spindle? y or n [y]", "maybe\r"),
        ("must be y or n", "\r"),
        ("the end of its range, in V [10]", "<\r"),
        ("displacement sensor at the spindle? y or n [y]", "y\r"),
        ("the end of its range, in V [10]", "-10\r"),
        ("must be above 0", "5\r"),
        ("for one volt", "0\r"),
        ("must not be 0", "ten\r"),
        ("must be a number", "10\r"),
        ("when the machine is cold, in V [2.5]", "<\r"),
        ("for one volt (data sheet: range in µm / volts) [10]", "100\r"),
        ("when the machine is cold, in V [2.5]", "7\r"),
        ("must be from 0 to 5 V", "\r"),
        ("A PT100", "on the screw\r"),
        ("must be a word", "screw\r"),
        ("screw (empty: no more): screw", "screw\r"),
        ("there is a screw already", "\r"),
        ("> LinuxCNC", down),
        ("> Siemens", "\r"),
    ] {
        terminal.shows(&[requested]);
        terminal.press(answer);
    }
    assert_eq!(terminal.ended().code(), Some(0), "{}", terminal.text());
    let text = desk.text("m.toml");
    for phrase in [
        "name = \"mill\"",
        "kind = \"head-head\"",
        "head_axes = [\"b\", \"c\"]",
        "travel_mm = [-300.0, 0.0]",
        "rapid_mm_per_min = 15000.0",
        "volts_full_scale = 5.0, counts_full_scale = 27648",
        "um_per_v = 100.0",
        "zero_v = 2.5",
        "temp_screw_c = { channel = 0",
    ] {
        assert!(text.contains(phrase), "{phrase}: {text}");
    }
    assert!(!text.contains("[axis.y]"), "{text}");
    assert_eq!(desk.run_expecting("check m.toml", 0).1, "");

    // Refused before the first question.
    for (line, rule) in [
        ("new -o m.toml", "m.toml: is there already"),
        ("new -o nowhere/m.toml", "its folder is not there"),
    ] {
        let mut terminal = Terminal::start(&desk, line, (80, 24), true);
        assert_eq!(terminal.ended().code(), Some(2));
        assert!(terminal.text().contains(rule), "{}", terminal.text());
    }
}
