//! `trueup export`: the files, the report beside them, and the exit codes.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

const PITCH: &str = "\
[machine]
name = \"small\"
kind = \"3-axis\"
[axis.x.pitch]
start_mm = 0.0
step_mm = 100.0
forward_um = [0.0, 2.0, -3.0]
[axis.x.backlash]
width_um = 5.0
";
const HOT: &str = "
[spindle]
source = \"temperature\"
[spindle.temperature]
sensor = \"temp_head_c\"
reference_c = 20.0
k_um_per_c = 2.0
";

fn trueup(folder: &Path, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trueup"))
        .args(line.split(' '))
        .current_dir(folder)
        .output()
        .expect("the tool was built for this test")
}

/// Standard output and standard error of a run that must end with `code`.
fn said(folder: &Path, line: &str, code: i32) -> (String, String) {
    let output = trueup(folder, line);
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{line}: {out}{err}");
    (out, err)
}

fn folder_with(machine: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    fs::write(folder.path().join("m.toml"), machine).expect("it can be written");
    folder
}

#[test]
fn a_whole_export_ends_with_0_and_leaves_its_files_and_both_reports() {
    let folder = folder_with(PITCH);
    for (format, files) in [
        ("linuxcnc", &["x.comp"][..]),
        ("heidenhain", &["X.com", "config.cma"]),
        ("siemens-840d", &["MEMORY.INI", "AX_EEC.INI", "ENABLE.INI"]),
        ("fanuc", &["CNC-PARA.TXT", "PITCH.TXT"]),
    ] {
        let line = format!("export m.toml --format {format} -o out/{format}");
        let (out, err) = said(folder.path(), &line, 0);
        assert!(err.is_empty() && out.contains("largest difference of all: "), "{out}{err}");
        let there = folder.path().join("out").join(format);
        let mut wanted: Vec<&str> = [files, &["report.txt", "report.json"]].concat();
        let mut names: Vec<String> = fs::read_dir(&there)
            .expect("it was made")
            .map(|entry| entry.expect("readable").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort_unstable();
        wanted.sort_unstable();
        assert_eq!(names, wanted);
        let report = fs::read_to_string(there.join("report.txt")).expect("it was written");
        assert!(out.starts_with(&report), "what is printed is what is beside the files");
    }
    let comp = fs::read_to_string(folder.path().join("out/linuxcnc/x.comp")).expect("it is there");
    assert_eq!(comp, "0 0 -0.005\n100 -0.002 -0.007\n200 0.003 -0.002\n");
}

#[test]
fn what_is_left_out_ends_with_3_and_stands_in_the_json() {
    let folder = folder_with(&format!("{PITCH}{HOT}"));
    let (out, _) = said(folder.path(), "export m.toml --format linuxcnc -o out --json", 3);
    let json: serde_json::Value = serde_json::from_str(&out).expect("it is JSON");
    assert_eq!(json["left_out"][0]["section"], "spindle.temperature");
    assert_eq!(json["files"][0], "x.comp");
    assert_eq!(json["whole"], false);
    assert_eq!(json["tables"][0]["points"], 3);
    let beside = fs::read_to_string(folder.path().join("out/report.json")).expect("it is there");
    assert_eq!(serde_json::from_str::<serde_json::Value>(&beside).expect("JSON as well"), json);
}

#[test]
fn what_cannot_be_held_at_all_ends_with_2_and_writes_nothing() {
    let hot = format!("[machine]\nname = \"hot\"\nkind = \"3-axis\"\n{HOT}");
    let folder = folder_with(&hot);
    let (out, err) = said(folder.path(), "export m.toml --format linuxcnc -o out", 2);
    assert!(out.is_empty() && err.starts_with("m.toml: nothing of the model"), "{out}{err}");
    assert!(!folder.path().join("out").exists());
}

#[test]
fn options_reach_the_files_and_wrong_ones_are_refused() {
    let folder = folder_with(PITCH);
    let line = "export m.toml --format siemens-840d -o out --reference x=100 --units inch";
    said(folder.path(), line, 0);
    let eec = fs::read_to_string(folder.path().join("out/AX_EEC.INI")).expect("it is there");
    assert!(eec.contains("$AA_ENC_COMP[0,1,AX1]=0\n"), "0 at the reference point: {eec}");
    assert!(eec.contains("$AA_ENC_COMP[0,0,AX1]=-0.0000787\n"), "-2 um in inches: {eec}");
    for (wrong, rule) in [
        ("--travel x=5:1", "the smaller first"),
        ("--travel a=0:1", "must begin with x=, y= or z="),
        ("--reference x=far", "far is no number"),
        ("--tolerance-um 0", "must be above 0"),
        ("--max-points 1", "must be at least 2"),
        ("--temperature 30", "must be like temp_x_c=30"),
    ] {
        let (_, err) =
            said(folder.path(), &format!("export m.toml --format siemens-840d -o out {wrong}"), 2);
        assert!(err.contains(rule), "{wrong}: {err}");
    }
    let (_, err) = said(folder.path(), "export m.toml --format g-code -o out", 2);
    assert!(err.contains("siemens-840d"), "{err}");
}

#[test]
fn a_folder_that_is_a_file_is_refused() {
    let folder = folder_with(PITCH);
    let (_, err) = said(folder.path(), "export m.toml --format linuxcnc -o m.toml", 2);
    assert!(err.starts_with("m.toml: cannot be made a folder"), "{err}");
    let kept = fs::read_to_string(folder.path().join("m.toml")).expect("it is there");
    assert_eq!(kept, PITCH);
}
