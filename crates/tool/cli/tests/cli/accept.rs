//! `trueup accept`: exit codes, files, and what it says of runs that cannot be compared.

use std::{fmt::Write as _, fs, path::Path, process::Command};

/// Returns a warm-up of `left` of 60 µm, a row a minute, with a gauge of 0.1 µm.
fn run(left: f64) -> String {
    let mut csv = String::from("time_s,spindle_rpm,measured_elongation_um\n");
    for minute in 0..120 {
        let time_s = 60.0 * f64::from(minute);
        let um = 60.0 * left * (1.0 - (-time_s / 1800.0).exp()) + 0.1 * f64::from(minute % 3 - 1);
        writeln!(csv, "{time_s},12000,{um:.2}").expect("a string grows");
    }
    csv
}

fn accept(folder: &Path, more: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_trueup"))
        .current_dir(folder)
        .args(["accept", "--off", "off.csv", "--on", "on.csv", "--out", "acceptance"])
        .args(more)
        .output()
        .expect("it starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

#[test]
fn what_is_met_ends_with_0_and_what_is_not_with_3_and_a_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("written");
    put("off.csv", &run(1.0));
    put("on.csv", &run(0.05));
    let (code, stdout, _) = accept(folder.path(), &[]);
    assert_eq!(code, Some(0), "{stdout}");
    assert!(stdout.starts_with("passed"), "{stdout}");
    let (code, stdout, _) = accept(folder.path(), &["--limit-um", "1.5"]);
    assert_eq!(code, Some(3), "{stdout}");
    assert!(stdout.contains("1.5 µm are allowed"), "{stdout}");

    put("on.csv", &run(0.4));
    put(
        "m.toml",
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"warmup\"\n[spindle.warmup]\n\
         lag_s = 0.0\nwarm_s = 7200.0\nmax_um = 36.0\nexponent = 4.0\n",
    );
    let (code, stdout, _) = accept(folder.path(), &["--machine", "m.toml"]);
    assert_eq!(code, Some(3), "{stdout}");
    assert!(stdout.contains("60 % of what the machine does"), "{stdout}");
    assert!(stdout.contains("Change spindle.warmup.max_um from 36 to 5"), "{stdout}");
    let json = fs::read_to_string(folder.path().join("acceptance/acceptance.json")).expect("left");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    for key in ["passed", "before", "after", "reduction", "advice"] {
        assert!(!json[key].is_null(), "{key}");
    }
    assert_eq!(json["passed"], false);
    assert!(folder.path().join("acceptance/adjusted.toml").exists());
    assert!(folder.path().join("acceptance/report.html").exists());
}

#[test]
fn runs_that_cannot_be_compared_are_refused_with_their_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("written");
    put("off.csv", &run(1.0));
    put("on.csv", &run(0.05).replace("elongation", "dx"));
    let (code, _, stderr) = accept(folder.path(), &[]);
    assert_eq!(code, Some(2), "{stderr}");
    assert!(stderr.contains("--> on.csv:1:1\n") && stderr.contains("measures nothing"), "{stderr}");
    // A spindle that did not turn alike is reported.
    put("on.csv", &run(0.05).replace(",12000,", ",6000,"));
    let (_, _, stderr) = accept(folder.path(), &[]);
    assert!(stderr.contains("did not turn alike"), "{stderr}");
    // And so are another tool, and a condition of the machine file.
    let with = |factor: f64, cells: &str| {
        let text = run(factor);
        let (head, rows) = text.split_once('\n').expect("a header");
        let rows: String = rows.lines().map(|row| format!("{row},{cells}\n")).collect();
        format!("{head},tool,door_open\n{rows}")
    };
    put("off.csv", &with(1.0, "7,0"));
    put(
        "m.toml",
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\ndoor_open = { kind = \"condition\", bit = 0 }\n",
    );
    for (cells, message_of) in
        [("7,0", None), ("9,0", Some("The tools were not")), ("7,1", Some("door_open was not"))]
    {
        put("on.csv", &with(0.05, cells));
        let (_, _, stderr) = accept(folder.path(), &["--machine", "m.toml"]);
        assert_eq!(stderr.contains("not alike"), message_of.is_some(), "{cells}: {stderr}");
        assert!(message_of.is_none_or(|phrase| stderr.contains(phrase)), "{cells}: {stderr}");
    }
}

/// A term names tools by their numbers, the record by their labels: the machine file translates.
#[test]
fn labels_of_tools_are_the_numbers_of_the_machine_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("written");
    put(
        "m.toml",
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle.tools]\nprobe = { number = 7, um_per_krpm2 = 0.0 }\n\
         default = { um_per_krpm2 = 0.0 }\n[[term]]\ncause = \"dependence\"\nquantity = \"elongation\"\n\
         column = \"tool\"\nform = \"level\"\nlevels = [1.0, 7.0]\nlevel_um = [0.0, 10.0]\nlevel_default = 0.0\n",
    );
    // The tool is 10 µm longer than without the term, and the bridge has taken off four fifths of it.
    let run = |um: f64, tool: &str| {
        let rows = (0..12).map(|n| format!("{},{um:.1},{tool}\n", 60 * n));
        format!("time_s,measured_elongation_um,tool\n{}", rows.collect::<String>())
    };
    let mut answers = Vec::new();
    for tool in ["probe", "7"] {
        put("off.csv", &run(10.0, tool));
        put("on.csv", &run(2.0, tool));
        let (_, _, stderr) = accept(folder.path(), &["--machine", "m.toml"]);
        let text =
            fs::read_to_string(folder.path().join("acceptance/acceptance.json")).expect("written");
        answers.push((stderr, text));
    }
    assert_eq!(answers[0], answers[1]);
}

/// The picture of the README is the one that the command beneath it makes.
#[test]
fn the_picture_of_both_runs_is_the_one_of_the_readme() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let readme = fs::read_to_string(root.join("README.md")).expect("the project's own");
    let command =
        readme.split("`trueup ").find(|part| part.contains("--picture docs/acceptance.svg"));
    let command = command.and_then(|command| command.split('`').next()).expect("it stands there");
    let folder = tempfile::tempdir().expect("a folder");
    let picture = folder.path().join("p.svg").display().to_string();
    let line = command.replace("docs/acceptance.svg", &picture).replace('\n', " ");
    let out = folder.path().join("acceptance").display().to_string();
    let words =
        line.split_whitespace().map(|word| if word == "acceptance" { out.as_str() } else { word });
    let output = Command::new(env!("CARGO_BIN_EXE_trueup"))
        .current_dir(&root)
        .args(words)
        .output()
        .expect("it starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let drawn = fs::read_to_string(&picture).expect("written");
    let shown = fs::read_to_string(root.join("docs/acceptance.svg")).expect("the project's own");
    assert!(
        drawn == shown && drawn.contains("with compensation"),
        "draw it anew: trueup {command}"
    );
}
