//! `trueup check`, and how errors and warnings are printed. The shipped files and every measured set must be
//! silent: a warning that is wrong is worse than none.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::desk::Desk;
use serde_json::Value;

const PAPER: &str = include_str!("../../../../../data/paper_spindle.toml");
const RUN: &str = "sensor_counts,measured_elongation_um\n5376,3\n5638,8\n5900,12\n";

fn desk() -> Desk {
    Desk::new(&[("m.toml", PAPER), ("run.csv", RUN)])
}

/// Standard error as it is.
fn stderr_of(desk: &Desk, line: &str, code: i32) -> String {
    let output = desk.trueup(line);
    let stderr = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!(output.status.code(), Some(code), "{line}: {stderr}");
    stderr
}

#[test]
fn a_right_file_and_a_right_run_are_described_and_nothing_is_wrong() {
    let desk = desk();
    let (out, err) = desk.run_expecting("check m.toml run.csv", 0);
    assert_eq!(err, "");
    for phrase in [
        "m.toml: \"paper\", 3-axis\n  X: not corrected\n",
        "Z: up to 423.0 µm, held to 500 µm: spindle.sensor 423.0",
        "changes by at most 20 µm/s: 1 % of the rapid traverse of axes from 120 mm/min on",
        "a position of X, Y, Z that jumps is accepted: no rapid_mm_per_min states how fast the axis can move",
        "sensor: 500.0 µm from 0 to 10 V (32768 counts)",
        "on the board: 613 of 16384 bytes (4 %)",
        "run.csv: 3 rows of sensor_counts, measured_elongation_um",
        "nothing looks wrong",
    ] {
        assert!(out.contains(phrase), "no {phrase}: {out}");
    }
}

#[test]
fn a_warning_has_its_line_a_caret_and_help_and_ends_with_3() {
    let desk = desk();
    desk.write("up.toml", PAPER.replace("5048.0", "40000.0"));
    let text = stderr_of(&desk, "check up.toml", 3);
    let expected = "\
warning: spindle.sensor.zero_counts 40000 is beyond full scale: the input gives 0 to 32768 counts
  --> up.toml:15:15
   |
15 | zero_counts = 40000.0
   |               ^^^^^^^
   |
   = help: write what the sensor reads when the machine is cold, in the counts of [inputs] sensor
";
    assert_eq!(text, expected);
    let (out, _) = desk.run_expecting("check up.toml --json", 3);
    let json: Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(json[0]["warnings"][0]["line"], 15, "{json}");
    assert_eq!(json[0]["does"]["board_bytes"], 613, "{json}");
}

#[test]
fn every_command_that_reads_a_file_prints_its_warnings_on_a_line_and_q_does_not() {
    let desk = desk();
    desk.write(
        "up.toml",
        PAPER.replace("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0, 0, 1]"),
    );
    let line = "warning: up.toml:6:18: machine.tool_direction points up";
    for command in [
        "compile up.toml -o c.bin",
        "predict --machine up.toml --run run.csv -o p.csv",
        "fit elongation --machine up.toml --run run.csv -o f.toml",
        "export up.toml --format linuxcnc -o d",
    ] {
        let stderr = String::from_utf8(desk.trueup(command).stderr).expect("UTF-8");
        assert_eq!(stderr.matches(line).count(), 1, "{command}: {stderr}");
        assert!(stderr.contains("`trueup check up.toml` says what to do"), "{command}: {stderr}");
        let quiet = String::from_utf8(desk.trueup(&format!("{command} -q")).stderr).expect("UTF-8");
        assert!(!quiet.contains("warning"), "{command}: {quiet}");
    }
}

#[test]
fn what_no_board_can_run_is_reported_where_a_board_is_meant() {
    let desk = desk();
    let steep = "[straightness.z_of_x]\norder = 2\nknots_mm = [0.0, 0.0, 1.0, 1.0]\ncontrol_um = [0.0, 90.0]\n";
    desk.write("steep.toml", format!("{PAPER}\n{steep}"));
    let text = stderr_of(&desk, "check steep.toml", 3);
    assert!(text.contains("no board can run this") && text.contains("steep.toml:"), "{text}");
    // To predict with it may be so.
    let (head, rest) = PAPER.split_once("[inputs]").expect("it has inputs");
    let (_, law) = rest.split_once("[spindle]").expect("and a spindle");
    desk.write("model.toml", format!("{head}[spindle]{law}\n{steep}"));
    assert_eq!(stderr_of(&desk, "check model.toml", 0), "");
}

#[test]
fn a_file_that_corrects_nothing_is_a_warning_of_compile_and_a_line_of_check() {
    let desk = desk();
    desk.write("nothing.toml", "[machine]\nname = \"m\"\nkind = \"3-axis\"\n");
    let (_, err) = desk.run_expecting("compile nothing.toml -o c.bin", 0);
    assert!(err.contains("warning: nothing.toml:1:2: machine corrects nothing"), "{err}");
    let (out, _) = desk.run_expecting("check nothing.toml", 0);
    assert!(out.contains("corrects nothing: a board with it leaves every offset at 0"), "{out}");
    desk.write(
        "unused.toml",
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\ntemp_bed_c = { channel = 0, kind = \"pt100\" }\n",
    );
    let (out, _) = desk.run_expecting("check unused.toml", 0);
    assert!(out.contains("inputs that no law uses: temp_bed_c"), "{out}");
}

#[test]
fn an_error_is_printed_as_by_cargo_and_as_an_object_with_json() {
    let desk = desk();
    desk.write("bad.toml", PAPER.replace("slew_um_per_s = 20.0", "slew_um_per_s = -3.0"));
    let expected = "\
error: limits.slew_um_per_s must be above 0, not -3
  --> bad.toml:20:17
   |
20 | slew_um_per_s = -3.0
   |                 ^^^^";
    let text = stderr_of(&desk, "check bad.toml", 2);
    assert!(text.starts_with(expected), "{text}");
    let text = stderr_of(&desk, "compile bad.toml -o c.bin --json", 2);
    let object: Value = serde_json::from_str(&text).expect("one object");
    assert_eq!(object["level"], "error");
    assert_eq!(
        (&object["file"], &object["line"], &object["column"]),
        (&"bad.toml".into(), &20.into(), &17.into())
    );
    desk.write("comma.csv", "time_s;sensor_counts\n0;1\n1;2,5\n");
    let text = stderr_of(&desk, "check comma.csv", 2);
    assert!(
        text.contains(" --> comma.csv:3:3\n") && text.contains("3 | 1;2,5\n  |   ^^^"),
        "{text}"
    );
}

/// Every machine file of the project: what is a TOML with a section [machine], but those that an old version read.
fn shipped(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("the project's folder") {
        let path = entry.expect("readable").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && !name.starts_with('.') && name != "target" && name != "corpus" {
            shipped(&path, found);
        } else if name.ends_with(".toml") {
            let text = fs::read_to_string(&path).expect("UTF-8");
            if text.contains("\n[machine]\n") || text.starts_with("[machine]\n") {
                found.push(path);
            }
        }
    }
}

#[test]
fn nothing_is_doubted_in_the_files_that_the_project_ships() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let mut files = Vec::new();
    shipped(&root, &mut files);
    assert!(files.len() >= 6, "{files:?}");
    let desk = desk();
    for file in files {
        let (_, err) = desk.run_expecting(&format!("check {}", file.display()), 0);
        assert_eq!(err, "", "{}", file.display());
    }
    let table = root.join("data/spindle_paper_table1.csv");
    let machine = root.join("data/paper_spindle.toml");
    desk.run_expecting(&format!("check {} --machine {}", table.display(), machine.display()), 0);
}

#[test]
fn nothing_is_doubted_in_any_measured_set() {
    let desk = Desk::new(&[("plain.toml", "[machine]\nname = \"m\"\nkind = \"3-axis\"\n")]);
    for (machine, runs) in [
        ("strangers/b02_x/machine.toml", &["continuous", "test", "train"][..]),
        ("strangers/mcu1025/machine.toml", &["test", "train"]),
        ("strangers/muts_z/machine.toml", &["test", "train"]),
        ("strangers/rods/aluminium.toml", &["aluminium_1s"]),
        ("strangers/rods/brass.toml", &["brass_1s"]),
        ("strangers/rods/copper.toml", &["copper_1s"]),
        (
            "strangers/slits/m0.toml",
            &["11358_axis1_both", "11358_axis1_bwd", "11358_axis1_fwd", "11359_axis1_both"],
        ),
        ("strangers/voron_run2/m0.toml", &["run2_cool", "run2_heat"]),
        ("strangers/voron_run2/m1.toml", &["run2_cool", "run2_heat"]),
        ("strangers/voron_run2/m2.toml", &["run2_cool", "run2_heat"]),
        ("ess_iso230/", &["x", "z", "muts_x"]),
        ("ess_slits/", &["accuracy_axis1", "repeatability_axis1", "resolver"]),
        ("spindle_paper_table1/", &["run"]),
        ("spindle_sjtu/", &["run"]),
        ("voron_frame_expansion/", &["run1", "run3", "run4"]),
    ] {
        let folder = machine.rsplit_once('/').map_or("", |(folder, _)| folder);
        let believed = match machine.ends_with('/') {
            true => Some(desk.path("plain.toml")),
            false => trueup_measured_data::find_measured_file(machine),
        };
        let Some(believed) = believed else { continue };
        for run in runs {
            let Some(run) =
                trueup_measured_data::find_measured_file(&format!("{folder}/{run}.csv"))
            else {
                continue;
            };
            let line = format!("check {} {}", believed.display(), run.display());
            let (_, err) = desk.run_expecting(&line, 0);
            assert_eq!(err, "", "{line}");
        }
    }
}
