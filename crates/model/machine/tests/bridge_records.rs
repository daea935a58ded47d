//! Records of a bridge: what it applied is taken out of what was measured, by the rule that stands in
//! `docs/reference.md`, and rows in which that is not known are excluded.

use std::{borrow::Cow, path::Path};

use trueup_machine::{
    Machine, MachineFile, RunFile, applied_offsets::UncompensatedRun, compile,
    machine_file::Quantity,
};

const THREE_AXIS: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"head-head\"\nhead_axes = [\"c\", \"a\"]\n";

fn machine(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("right")
}

fn run(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
}

/// Returns what is left of a column, `None` where it is missing, and what is reported.
fn taken_out(machine_text: &str, text: &str, column: &str) -> (Vec<Option<f64>>, Vec<String>) {
    let run = run(text);
    let (run, notes) =
        UncompensatedRun::from_run(Cow::Borrowed(&run), Some(&machine(machine_text)), None)
            .expect("right");
    let values = run.column(column).expect("it is kept");
    (values.iter().map(|um| (!um.is_nan()).then_some(*um)).collect(), notes)
}

fn error(machine_text: &str, text: &str, quantity: Option<Quantity>) -> String {
    let run = run(text);
    let taken_out =
        UncompensatedRun::from_run(Cow::Borrowed(&run), Some(&machine(machine_text)), quantity);
    taken_out.map(|_| ()).expect_err("refused").to_string()
}

#[test]
fn a_run_without_a_bridge_comes_back_as_it_is() {
    let run = run("time_s,measured_dz_um,flow\n0,1.5,2\n");
    let (same, notes) = UncompensatedRun::from_run(Cow::Borrowed(&run), None, None).expect("right");
    assert!(std::ptr::eq(&raw const *same, &raw const run) && notes.is_empty());
}

#[test]
fn an_axis_has_the_error_that_was_measured_less_the_offset() {
    let text = "measured_dx_um,offset_x_um,quality\n3,-4,1\n-1,0,0\n";
    let (dx, _) = taken_out(THREE_AXIS, text, "measured_dx_um");
    assert_eq!(dx, [Some(7.0), Some(-1.0)]);
}

#[test]
fn a_spindle_that_points_down_has_grown_by_what_was_measured_and_by_the_lift() {
    let text = "measured_elongation_um,offset_z_um,quality\n3,40,1\n41,0,0\n";
    let (grown, _) = taken_out(THREE_AXIS, text, "measured_elongation_um");
    assert_eq!(grown, [Some(43.0), Some(41.0)]);
}

#[test]
fn a_swung_tool_has_grown_by_what_was_applied_along_it() {
    // A = 30° swings the tool to (0, sin 30°, −cos 30°): 40 µm along it are lifted by their opposite.
    let (y, z) = (-40.0 * 0.5, 40.0 * 0.75_f64.sqrt());
    let head = "measured_elongation_um,offset_x_um,offset_y_um,offset_z_um,quality";
    for (names, angles) in [("a_deg,c_deg", "30,0"), ("angle1_deg,angle2_deg", "0,30")] {
        let text =
            format!("{head},{names}\n3,0,{y},{z},1,{angles}\n3,0,{y},{z},1,,\n5,0,0,0,0,,\n");
        let (grown, notes) = taken_out(HEAD, &text, "measured_elongation_um");
        assert!((grown[0].expect("known") - 43.0).abs() < 1e-12, "{names}: {grown:?}");
        // Without the angles nobody knows; an offset of 0 is 0 at any.
        assert_eq!(grown[1..], [None, Some(5.0)], "{names}");
        assert!(notes.iter().any(|note| note.contains("1 of 3 rows")), "{notes:?}");
    }
}

#[test]
fn rows_with_an_unknown_offset_are_excluded_and_counted() {
    let text = "time_s,measured_dz_um,offset_z_um,quality,flags,age_ms,calibration_crc,temp_a_c\n\
                0,1,0,0,0,0,7,20\n1,2,-9,3,0,0,7,21\n2,3,-9,4,0,0,7,22\n3,4,-9,5,0,0,7,23\n\
                4,5,,6,0,0,7,24\n5,6,-9,,0,0,7,25\n6,7,,1,0,0,7,26\n7,,-9,4,0,0,7,27\n";
    let run = run(text);
    let (run, notes) =
        UncompensatedRun::from_run(Cow::Borrowed(&run), None, Some(Quantity::Dz)).expect("right");
    let names: Vec<_> = run.columns().iter().map(|column| column.name.as_str()).collect();
    assert_eq!(names, ["time_s", "measured_dz_um", "temp_a_c"]);
    let dz = run.column("measured_dz_um").expect("kept");
    assert_eq!(dz[..2], [1.0, 11.0]);
    assert!(dz[2..].iter().all(|um| um.is_nan()), "{dz:?}");
    // What has a memory goes on.
    assert_eq!(run.column("temp_a_c").expect("kept")[7], 27.0);
    assert_eq!(notes.len(), 2);
    assert!(notes[0].contains("measured_dz_um: 3 of 7 rows") && notes[0].contains("quality 4"));
    assert!(notes[1].contains("measured_dz_um: 2 of 7 rows") && notes[1].contains("missing"));
}

/// A bridge says 6 until a CNC has engaged it, and again when it fails. By the limits of the machine file a CNC
/// is at 0 after 2 s of hold, 500 µm at 20 µm/s, and 1 s: 28 s.
#[test]
fn a_bridge_without_an_offset_for_longer_than_a_cnc_takes_to_go_to_0_was_without_one() {
    let mut text = "time_s,measured_dz_um,offset_z_um,quality\n".to_string();
    let quality = |s: u32| match s {
        60..90 => 1,
        _ => 6,
    };
    for s in 0..140 {
        let offset = if quality(s) == 1 { "-9" } else { "" };
        text += &format!("{s},5,{offset},{}\n", quality(s));
    }
    let (dz, notes) = taken_out(THREE_AXIS, &text, "measured_dz_um");
    for (s, dz) in (0..).zip(&dz) {
        let expected = match s {
            0..=28 | 90..=118 => None,
            60..90 => Some(14.0),
            _ => Some(5.0),
        };
        assert_eq!(*dz, expected, "at {s} s");
    }
    assert!(notes.iter().any(|note| note.contains("58 of 140 rows")), "{notes:?}");
    // A CNC that may be slower is waited for longer, and without a clock for ever.
    let slow = format!("{THREE_AXIS}[limits]\nhold_ms = 60000\n");
    assert_eq!(taken_out(&slow, &text, "measured_dz_um").0[..60], [None; 60]);
    let timeless = text.replace("time_s", "flow");
    assert_eq!(taken_out(THREE_AXIS, &timeless, "measured_dz_um").0[120..], [None; 20]);
    // Where nothing was ever applied, no column of an offset is needed.
    let never: String = (0..40).map(|s| format!("{s},5,6\n")).collect();
    let never = format!("time_s,measured_dz_um,quality\n{never}");
    let run = run(&never);
    let refused = UncompensatedRun::from_run(Cow::Borrowed(&run), Some(&machine(THREE_AXIS)), None);
    assert!(refused.is_err(), "its first rows are not known");
}

#[test]
fn what_cannot_be_subtracted_is_refused_where_it_is_requested() {
    let offsets = "measured_dz_um,offset_z_um\n1,2\n";
    let refused = error(THREE_AXIS, offsets, None);
    assert!(refused.starts_with("r.csv:1:1: column quality is missing"), "{refused}");
    let bad = error(THREE_AXIS, "measured_dz_um,offset_z_um,quality\n1,2,1\n1,2,7\n", None);
    assert_eq!(bad, "r.csv:3:5: quality must be 0 to 6, not 7");
    let both = "measured_dx_um,measured_dz_um,offset_z_um,quality\n5,1,2,1\n";
    let refused = error(THREE_AXIS, both, Some(Quantity::Dx));
    assert!(refused.starts_with("r.csv:1:1: column offset_x_um is missing"), "{refused}");
    let (dz, notes) = taken_out(THREE_AXIS, both, "measured_dz_um");
    assert_eq!(dz, [Some(-1.0)]);
    assert!(notes.iter().any(|note| note.contains("measured_dx_um is ignored")), "{notes:?}");
    // A bridge that was off all the time applied nothing.
    let off = "measured_dx_um,quality\n5,0\n6,0\n";
    assert_eq!(taken_out(THREE_AXIS, off, "measured_dx_um").0, [Some(5.0), Some(6.0)]);
    let lacks =
        "measured_elongation_um,offset_x_um,offset_y_um,offset_z_um,quality,a_deg\n1,0,0,2,1,0\n";
    let refused = error(HEAD, lacks, Some(Quantity::Elongation));
    assert!(refused.contains("column c_deg is missing"), "{refused}");
}

#[test]
fn the_calibration_of_another_machine_file_is_refused() {
    let text = format!("{THREE_AXIS}[squareness]\nx_of_y_um_per_m = 3.0\n");
    let own = compile(&machine(&text)).expect("it fits").crc();
    let other = compile(&machine(THREE_AXIS)).expect("it fits").crc();
    let record = |crc: &str| {
        format!("measured_dx_um,offset_x_um,quality,calibration_crc\n1,0,0,{crc}\n3,-4,1,{crc}\n")
    };
    let notes_with = |crc: &str| taken_out(&text, &record(crc), "measured_dx_um").1;
    assert_eq!(notes_with(&own.to_string()), [""; 0]);
    let unknown = notes_with("");
    assert!(unknown[0].contains("there is no calibration_crc"), "{unknown:?}");
    let refused = error(&text, &record(&other.to_string()), None);
    assert!(refused.starts_with("r.csv:2:7: calibration_crc "), "{refused}");
    assert!(refused.contains("is another calibration"), "{refused}");
    let without = "measured_dx_um,offset_x_um,quality\n1,0,0\n";
    assert!(
        taken_out(&text, without, "measured_dx_um").1[0].contains("there is no calibration_crc")
    );
}
