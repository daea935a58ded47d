//! `trueup export`: the files, the report next to them, and the exit codes.

use crate::desk::Desk;

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

/// The steps of the table above are no more than that: its FANUC values are whole to a unit.
const UNIT_UM: f64 = 5.0;

fn desk_with(machine: &str) -> Desk {
    Desk::new(&[("m.toml", machine)])
}

#[test]
fn a_whole_export_ends_with_0_and_leaves_its_files_and_both_reports() {
    let desk = desk_with(PITCH);
    for (format, files) in [
        ("linuxcnc", &["x.comp"][..]),
        ("heidenhain", &["X.com", "config.cma"]),
        ("siemens-840d", &["MEMORY.INI", "AX_EEC.INI", "ENABLE.INI"]),
        ("fanuc", &["CNC-PARA.TXT", "PITCH.TXT"]),
    ] {
        let line = format!("export m.toml --format {format} -o out/{format} --unit-um {UNIT_UM}");
        let (out, err) = desk.run_expecting(&line, 0);
        assert!(err.is_empty() && out.contains("largest difference of all: "), "{out}{err}");
        let mut expected: Vec<&str> = [files, &["report.txt", "report.json"]].concat();
        expected.sort_unstable();
        assert_eq!(desk.files(&format!("out/{format}")), expected);
        let report = desk.text(&format!("out/{format}/report.txt"));
        assert!(out.starts_with(&report), "what is printed is what is beside the files");
    }
    let comp = desk.text("out/linuxcnc/x.comp");
    assert_eq!(comp, "0 0 -0.005\n100 -0.002 -0.007\n200 0.003 -0.002\n");
}

#[test]
fn what_is_omitted_ends_with_3_and_stands_in_the_json() {
    let desk = desk_with(&format!("{PITCH}{HOT}"));
    let (out, _) = desk.run_expecting("export m.toml --format linuxcnc -o out --json", 3);
    let json: serde_json::Value = serde_json::from_str(&out).expect("it is JSON");
    assert_eq!(json["left_out"][0]["section"], "spindle.temperature");
    assert_eq!(json["files"][0], "x.comp");
    assert_eq!(json["whole"], false);
    assert_eq!(json["tables"][0]["points"], 3);
    let adjacent = desk.text("out/report.json");
    assert_eq!(serde_json::from_str::<serde_json::Value>(&adjacent).expect("JSON as well"), json);
}

#[test]
fn a_fanuc_export_that_is_off_by_micrometres_ends_with_3() {
    let desk = desk_with(PITCH);
    let (out, _) = desk.run_expecting("export m.toml --format fanuc -o out", 3);
    assert!(out.contains("each value is given out at once") && out.contains("2.5 µm off"), "{out}");
    assert!(desk.path("out/PITCH.TXT").exists());
}

#[test]
fn what_cannot_be_held_at_all_ends_with_2_and_writes_nothing() {
    let hot = format!("[machine]\nname = \"hot\"\nkind = \"3-axis\"\n{HOT}");
    let desk = desk_with(&hot);
    let (out, err) = desk.run_expecting("export m.toml --format linuxcnc -o out", 2);
    assert!(out.is_empty() && err.starts_with("m.toml: nothing of the model"), "{out}{err}");
    assert!(!desk.path("out").exists());
}

#[test]
fn options_reach_the_files_and_wrong_ones_are_refused() {
    let desk = desk_with(PITCH);
    let line = "export m.toml --format siemens-840d -o out --reference x=100 --units inch";
    desk.run_expecting(line, 0);
    let eec = desk.text("out/AX_EEC.INI");
    assert!(eec.contains("$AA_ENC_COMP[0,1,AX1]=0\n"), "0 at the reference point: {eec}");
    assert!(eec.contains("$AA_ENC_COMP[0,0,AX1]=-0.0000787\n"), "-2 µm in inches: {eec}");
    for (wrong, rule) in [
        ("--travel x=5:1", "the smaller first"),
        ("--travel a=0:1", "must begin with x=, y= or z="),
        ("--reference x=far", "far is not a number"),
        ("--tolerance-um 0", "must be above 0"),
        ("--max-points 1", "must be at least 2"),
        ("--temperature 30", "must be like temp_x_c=30"),
    ] {
        let (_, err) =
            desk.run_expecting(&format!("export m.toml --format siemens-840d -o out {wrong}"), 2);
        assert!(err.contains(rule), "{wrong}: {err}");
    }
    let (_, err) = desk.run_expecting("export m.toml --format g-code -o out", 2);
    assert!(err.contains("siemens-840d"), "{err}");
}

#[test]
fn a_folder_that_is_a_file_is_refused() {
    let desk = desk_with(PITCH);
    let (_, err) = desk.run_expecting("export m.toml --format linuxcnc -o m.toml", 2);
    assert!(err.starts_with("m.toml: the folder cannot be created"), "{err}");
    assert_eq!(desk.text("m.toml"), PITCH);
}
