//! `predict`, `compile` and `show` as a user runs them: what they print, write and leave alone,
//! and how they end.

#[cfg(unix)]
use std::{fs, path::Path};

use crate::desk::Desk;
use trueup_core::units::Nanometres;
use trueup_machine::RunFile;
use trueup_store::calibration::{MAX_BLOB_SIZE, decode, encode};

const PAPER: &str = include_str!("../../../../../data/paper_spindle.toml");
const TABLE: &str = include_str!("../../../../../data/spindle_paper_table1.csv");
/// The fixed part of the calibration and its CRC: the paper has no tables.
const PAPER_BYTES: usize = 613;

/// Returns a folder with the paper's files.
fn desk() -> Desk {
    Desk::new(&[("m.toml", PAPER), ("run.csv", TABLE)])
}

impl Desk {
    /// Standard output of a run that must end with `code`.
    fn printed(&self, line: &str, code: i32) -> String {
        self.run_expecting(line, code).0
    }

    /// Returns the one line on standard error of a run that must refuse its input and print no result.
    fn refused(&self, line: &str) -> String {
        let (out, err) = self.run_expecting(line, 2);
        assert_eq!(out, "", "{line}: {err}");
        assert_eq!(err.lines().count(), 1, "{line}: {err}");
        err
    }
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

#[test]
fn predict_writes_the_run_with_both_predictions() {
    let desk = desk();
    let printed = desk.printed("predict --machine m.toml --run run.csv -o out.csv", 0);
    assert!(printed.starts_with("out.csv: 15 rows\n"), "{printed}");

    let before = RunFile::read(&desk.path("run.csv")).expect("the project's own file");
    let after = RunFile::read(&desk.path("out.csv")).expect("what is written is a run file");
    let names: Vec<&str> = after.columns().iter().map(|column| column.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "sensor_counts",
            "spindle_rpm",
            "measured_elongation_um",
            "predicted_elongation_um",
            "bridge_elongation_um",
            "predicted_dx_um",
            "bridge_dx_um",
            "predicted_dy_um",
            "bridge_dy_um",
            "predicted_dz_um",
            "bridge_dz_um",
        ]
    );
    let column = |name| after.column(name).expect("listed above");
    for column in before.columns() {
        assert_eq!(after.column(&column.name), Some(&column.values[..]));
    }
    let rows = column("sensor_counts").iter().enumerate();
    for (row, counts) in rows {
        let um = (counts - 5048.0) * 500.0 / 32768.0;
        assert!((column("predicted_elongation_um")[row] - um).abs() < 1e-6);
        // Half a nanometre of the result, and of the reading half a unit of 1/1024 code, 0.06 nm.
        assert!((column("bridge_elongation_um")[row] - um).abs() < 0.000_57);
        assert_eq!(column("predicted_dz_um")[row], -column("predicted_elongation_um")[row]);
        assert_eq!(column("bridge_dz_um")[row], -column("bridge_elongation_um")[row]);
        assert_eq!((column("predicted_dx_um")[row], column("bridge_dy_um")[row]), (0.0, 0.0));
    }
    let text = desk.text("out.csv");
    let first = text.lines().nth(1).expect("15 rows");
    assert!(first.starts_with("5376,24000,3,5.004883,5.005000,"), "{first}");
    assert_eq!(desk.files("."), ["m.toml", "out.csv", "run.csv"], "nothing else is left");
}

#[test]
fn predict_prints_json_if_asked() {
    let desk = desk();
    desk.write("run.csv", "sensor_counts\n9164\nnan\n40000\n");
    let (out, err) =
        desk.run_expecting("predict --json --machine m.toml --run run.csv -o out.csv", 0);
    let document = json(&out);
    assert_eq!(document["output"], "out.csv");
    assert_eq!((&document["rows"], &document["rows_without_counts"]), (&3.into(), &1.into()));
    assert_eq!(document["rows_out_of_range"], 1);
    assert!(document["largest_difference_nm"].as_f64().expect("a number") < 1.0);
    let warning = json(&err);
    assert_eq!(
        warning["message"],
        "run.csv:4:1: sensor_counts is outside the input's range in 1 rows"
    );
    assert_eq!(warning["level"], "warning");
}

#[test]
fn predict_needs_no_inputs_but_says_what_is_missing() {
    let desk = desk();
    let inputs = PAPER.find("[inputs]").expect("the paper's has inputs");
    let spindle = PAPER.find("[spindle]").expect("the paper's has a spindle");
    desk.write("m.toml", [&PAPER[..inputs], &PAPER[spindle..]].concat());
    let (out, err) = desk.run_expecting("predict --machine m.toml --run run.csv -o out.csv", 0);
    assert_eq!(out, "out.csv: 15 rows\n");
    let warning = "warning: m.toml: the bridge's columns stay empty: without [inputs] sensor";
    assert!(err.starts_with(warning), "{err}");
    let after = RunFile::read(&desk.path("out.csv")).expect("a run file");
    let bridge = after.column("bridge_elongation_um").expect("the column is there, but empty");
    assert!(bridge.iter().all(|value| value.is_nan()));
}

#[test]
fn predict_goes_on_where_the_board_could_not_and_says_why() {
    let desk = desk();
    desk.write("steep.toml", PAPER.replace("0.0152587890625", "9.0"));
    let (_, err) = desk.run_expecting("predict --machine steep.toml --run run.csv -o out.csv", 0);
    let warning = "warning: steep.toml: the bridge's columns stay empty: steep.toml:16:16: \
                   spindle.sensor.um_per_count 9 is";
    assert!(err.contains(warning), "{err}");
    let after = RunFile::read(&desk.path("out.csv")).expect("a run file");
    let model = after.column("predicted_elongation_um").expect("it is there");
    assert!(model.iter().all(|value| !value.is_nan()));
}

#[test]
fn predict_ends_with_3_where_the_board_is_further_off_than_compile_promised() {
    let desk = desk();
    desk.write(
        "hot.toml",
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x.thermal]\nmode = \"position\"\n\
         sensor = \"temp_a_c\"\nreference_c = 20\nslope_um_per_m_per_c = 11.5\nlag_s = 30\n",
    );
    // 283 mm of growth are beyond what a sum of errors may be; 1.1 mm are none.
    for (celsius, mm, code) in [(840, 30_000, 3), (30, 9_000, 0)] {
        desk.write("hot.csv", format!("time_s,x_mm,temp_a_c\n0,0,20\n600,{mm},{celsius}\n"));
        let (out, err) =
            desk.run_expecting("predict --machine hot.toml --run hot.csv -o out.csv", code);
        assert!(out.starts_with("out.csv: 2 rows\n"), "it is written: {out}");
        let message = "hot.csv:3:1: the bridge is ";
        assert_eq!(
            err.contains(message) && err.contains("compile has promised"),
            code == 3,
            "{err}"
        );
    }
}

#[test]
fn compile_and_export_take_the_machine_file_as_a_word_or_behind_m_and_not_both() {
    let backlash = "[axis.x]\ntravel_mm = [0.0, 100.0]\n[axis.x.backlash]\nwidth_um = 3.0\n";
    let machine = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{backlash}");
    let desk = Desk::new(&[("m.toml", &machine)]);
    for command in ["compile M -o cal.bin", "export M --format linuxcnc -o tables"] {
        let line = |machine: &str| command.replace(" M ", machine);
        let outputs: Vec<_> = [" m.toml ", " -m m.toml ", " --machine m.toml "]
            .map(|machine| desk.trueup(&line(machine)))
            .into();
        assert!(outputs.iter().all(|output| output.status == outputs[0].status), "{outputs:?}");
        assert!(outputs.iter().all(|output| output.stdout == outputs[0].stdout), "{outputs:?}");
        assert!(!outputs[0].stdout.is_empty(), "{outputs:?}");
        for machine in [" ", " m.toml -m m.toml "] {
            let (out, err) = desk.run_expecting(&line(machine), 2);
            assert!(out.is_empty() && err.contains("--machine <M.toml>"), "{err}");
        }
    }
}

#[test]
fn bad_input_ends_with_2_its_place_and_an_untouched_output() {
    let desk = desk();
    desk.write("typo.toml", PAPER.replace("zero_counts", "zero_count"));
    desk.write(
        "steep.toml",
        PAPER.replace("zero_counts = 5048.0", "zero_counts = 32000\nk0_um = 3e6").replacen(
            "k0_um = 0.0\n",
            "",
            1,
        ),
    );
    desk.write("comma.csv", "time_s;sensor_counts\n0;1\n1;2,5\n");
    desk.write("none.csv", "time_s\n0\n");
    desk.write("out.csv", "keep me");
    desk.write("cal.bin", "keep me too");
    let files = desk.files(".");
    for (line, complaint) in [
        (
            "predict --machine typo.toml --run run.csv -o out.csv",
            "typo.toml:15:1: unknown key spindle.sensor.zero_count; did you mean zero_counts?",
        ),
        (
            "predict --machine m.toml --run comma.csv -o out.csv",
            "comma.csv:3:3: sensor_counts 2,5 has a decimal comma",
        ),
        (
            "predict --machine m.toml --run none.csv -o out.csv",
            "none.csv:1:1: column sensor_counts is missing",
        ),
        ("predict --machine no.toml --run run.csv -o out.csv", "no.toml:1:1: cannot be read: "),
        ("predict --machine m.toml --run no.csv -o out.csv", "no.csv:1:1: cannot be read: "),
        ("predict --machine m.toml --run run.csv -o no/out.csv", "no/out.csv: cannot be written: "),
        ("predict --machine m.toml --run run.csv -o run.csv", "run.csv: is an input, and must not"),
        ("predict --machine m.toml --run run.csv -o .", ".: is a folder"),
        ("compile typo.toml -o cal.bin", "typo.toml:15:1: unknown key"),
        (
            "compile steep.toml -o cal.bin",
            "steep.toml:15:9: spindle.sensor.k0_um 3000000 µm is impossible",
        ),
        ("compile m.toml -o ./m.toml", "./m.toml: is an input, and must not be overwritten"),
        ("show m.toml", "m.toml: bytes "),
        ("show no.bin", "no.bin: cannot be read: "),
    ] {
        let message = desk.refused(line);
        assert!(message.starts_with(complaint), "{line}: {message}");
    }
    assert_eq!(desk.read("out.csv"), b"keep me");
    assert_eq!(desk.read("cal.bin"), b"keep me too");
    assert_eq!(desk.read("m.toml"), PAPER.as_bytes());
    assert_eq!(desk.files("."), files, "no remains of what was not finished");
}

#[test]
fn a_wrong_command_line_ends_with_2() {
    let desk = desk();
    for line in ["", "pridect", "compile m.toml", "predict --machine m.toml -o out.csv", "bridge"] {
        desk.run_expecting(line, 2);
    }
    for line in ["--help", "--version", "bridge monitor --help"] {
        desk.run_expecting(line, 0);
    }
}

#[test]
fn an_output_that_is_there_is_replaced_whole() {
    let desk = desk();
    desk.write("cal.bin", [0_u8; 1000]);
    desk.printed("compile m.toml -o cal.bin", 0);
    assert_eq!(desk.read("cal.bin").len(), PAPER_BYTES);
}

#[test]
fn what_is_compiled_is_shown_and_compiles_to_the_same_bytes() {
    let desk = desk();
    let printed = desk.printed("compile m.toml -o cal.bin", 0);
    assert_eq!(
        printed,
        "cal.bin: calibration of \"paper\", 613 bytes\n\
         largest difference from the model: 0.003 nm\n"
    );
    let blob = desk.read("cal.bin");
    assert_eq!(decode(&blob).expect("a calibration").limits.max[2], Nanometres(500_000));

    let shown = desk.printed("show cal.bin", 0);
    // 642 228 units of 1/1024 of a code.
    assert!(shown.contains("\nzero_counts = 627.17578125\n"), "{shown}");
    desk.write("shown.toml", &shown);
    let document = json(&desk.printed("compile shown.toml -o again.bin --json", 0));
    assert_eq!(document["bytes"], PAPER_BYTES);
    assert_eq!(document["largest_difference_nm"], 0.0);
    assert_eq!(desk.read("again.bin"), blob);

    let document = json(&desk.printed("--json show cal.bin", 0));
    assert_eq!(document["toml"].as_str().expect("a text").trim_end(), shown.trim_end());
    assert_eq!(document["does_not_compile_back"], serde_json::Value::Null);
}

#[test]
fn a_damaged_calibration_is_refused_with_the_place_of_the_damage() {
    let desk = desk();
    desk.printed("compile m.toml -o cal.bin", 0);
    let blob = desk.read("cal.bin");
    let mut flipped = blob.clone();
    flipped[20] ^= 1;
    desk.write("flipped.bin", flipped);
    desk.write("cut.bin", &blob[..PAPER_BYTES - 1]);
    for (line, complaint) in [
        ("show flipped.bin", "flipped.bin: the CRC at the end is "),
        ("show cut.bin", "cut.bin: 612 bytes are too short"),
    ] {
        let message = desk.refused(line);
        assert!(message.starts_with(complaint), "{message}");
    }
}

#[test]
fn a_calibration_that_no_machine_file_gives_is_shown_and_ends_with_3() {
    let desk = desk();
    desk.printed("compile m.toml -o cal.bin", 0);
    let blob = desk.read("cal.bin");
    let mut calibration = decode(&blob).expect("just compiled");
    calibration.limits.slew_nm_per_s = 0;
    desk.write("stuck.bin", encode(&calibration, &mut [0; MAX_BLOB_SIZE]).expect("it fits"));
    let shown = desk.printed("show stuck.bin", 3);
    assert!(shown.contains("\nslew_um_per_s = 0.0\n"), "{shown}");
    let document = json(&desk.printed("show stuck.bin --json", 3));
    let reason = document["does_not_compile_back"].as_str().expect("a reason");
    assert!(reason.contains("slew_um_per_s"), "{reason}");
}

#[cfg(unix)]
#[test]
fn a_new_file_has_the_usual_rights_and_a_device_stays_a_device() {
    use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _};
    let desk = desk();
    desk.printed("compile m.toml -o cal.bin", 0);
    let rights =
        |name: &str| fs::metadata(desk.path(name)).expect("written").permissions().mode() & 0o777;
    assert_eq!(rights("cal.bin"), rights("run.csv"));
    desk.printed("predict --machine m.toml --run run.csv -o /dev/null", 0);
    let null = fs::metadata(Path::new("/dev/null")).expect("every unix has it");
    assert!(null.file_type().is_char_device());
}

#[cfg(unix)]
#[test]
fn a_link_is_followed_and_stays_a_link() {
    let desk = desk();
    desk.write("real.bin", "old");
    std::os::unix::fs::symlink("real.bin", desk.path("cal.bin")).expect("links are allowed");
    desk.printed("compile m.toml -o cal.bin", 0);
    assert!(fs::symlink_metadata(desk.path("cal.bin")).expect("there").is_symlink());
    assert_eq!(desk.read("real.bin").len(), PAPER_BYTES);
}

#[test]
fn a_machine_file_and_a_run_file_that_are_exchanged_are_named_in_one_line() {
    let desk = desk();
    for line in [
        "diagnose --machine m.toml --run m.toml --out d",
        "predict --machine m.toml --run m.toml -o out.csv",
        "compare m.toml run.csv --out d",
        "fit elongation --run m.toml -o out.toml",
        "learn --machine m.toml --run m.toml -o out.toml",
        "trust --machine m.toml --calibrated m.toml --run run.csv",
        "accept --off m.toml --on run.csv --out d",
    ] {
        assert!(desk.refused(line).contains("m.toml:1:1: is a machine file"), "{line}");
    }
    for line in [
        "compile run.csv -o m.bin",
        "predict --machine run.csv --run run.csv -o out.csv",
        "diagnose --machine run.csv --run run.csv --out d",
    ] {
        assert!(desk.refused(line).contains("run.csv:1:1: is a table of values"), "{line}");
    }
}

#[test]
fn the_machine_file_needs_no_option() {
    let desk = desk();
    let line = "predict --run run.csv -o out.csv";
    let with_option = desk.printed(&format!("{line} --machine m.toml"), 0);
    for free in [format!("{line} m.toml"), "predict m.toml --run run.csv -o out.csv".into()] {
        assert_eq!(desk.printed(&free, 0), with_option, "{free}");
    }
    let checked = desk.printed("check m.toml", 0);
    assert_eq!(desk.printed("check --machine m.toml", 0), checked);
}

#[test]
fn the_help_of_a_fit_speaks_of_no_other() {
    let desk = desk();
    let kinds = ["straightness", "pitch", "backlash", "elongation", "warmup", "thermal", "table1"];
    for kind in kinds {
        let help = desk.printed(&format!("fit {kind} --help"), 0);
        for other in
            ["elongation", "warmup", "thermal", "table1"].into_iter().filter(|other| *other != kind)
        {
            let is_word = |word: &str| {
                word.trim_matches(|character: char| !character.is_alphanumeric()) == other
            };
            assert!(!help.split_whitespace().any(is_word), "{kind} speaks of {other}: {help}");
        }
    }
}
