//! An error that depends on a recorded column is named by that column, and a column that is no input is not.

use std::{fmt::Write as _, path::Path};

use trueup_campaigns::hidden_effects::{HiddenCause, draw_test_case};
use trueup_diagnose::{Diagnosis, Verdict, diagnose, report::Finding};
use trueup_machine::{MachineFile, RunFile, machine_file::Quantity, predict::RunPredictor};
use trueup_twin::noise::RandomStream;

const MACHINE: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[spindle]\nsource = \"sensor\"\n\
                       [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5000.0\num_per_count = 0.02\n";

fn read(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
}

fn answer(machine: &str, runs: &[&str], holdout: &[&str]) -> Diagnosis {
    let machine = MachineFile::parse(machine, Path::new("m.toml")).expect("a machine file");
    let numbered = |text: &&str| read(text).with_tool_numbers(&machine).expect("all are listed");
    let read = |texts: &[&str]| texts.iter().map(numbered).collect::<Vec<_>>();
    diagnose(&machine, &read(runs), &read(holdout), None, &mut |_, _| {}).expect("comparable")
}

fn claimed(diagnosis: &Diagnosis) -> Vec<&Finding> {
    diagnosis.report.findings.iter().filter(|finding| finding.claimed).collect()
}

/// Returns a day at a mill whose error is right but for `hidden` of the tool's number, the speed and the door.
fn day(seed: u64, hidden: impl Fn(f64, f64, f64) -> f64) -> String {
    let mut stream = RandomStream::new(seed, "mill");
    let mut csv =
        "time_s,sensor_counts,spindle_rpm,tool,door_open,part,twin_um,measured_elongation_um\n"
            .to_string();
    let (mut grown_um, mut rpm, mut tool, mut door) = (0.0, 0.0, 1.0, 0.0);
    for row in 0..240 {
        if stream.bernoulli(0.06) {
            rpm = 6000.0 * f64::from(stream.uniform_integer(0, 4) as u32);
        }
        if stream.bernoulli(0.06) {
            tool = f64::from(stream.uniform_integer(1, 3) as u32);
        }
        if stream.bernoulli(0.05) {
            door = 1.0 - door;
        }
        grown_um += (rpm / 400.0 - grown_um) / 30.0;
        let counts = (5000.0 + grown_um / 0.02).round();
        let measured_um =
            (counts - 5000.0) * 0.02 + hidden(tool, rpm, door) + 0.4 * stream.standard_normal();
        let cells = [f64::from(row) * 60.0, counts, rpm, tool, door, f64::from(row / 3)];
        cells.iter().for_each(|cell| write!(csv, "{cell},").expect("text"));
        writeln!(csv, "{:.3},{measured_um:.3}", measured_um + 0.001).expect("text");
    }
    csv
}

#[test]
fn a_switch_is_named_with_its_size_and_what_is_no_input_is_not() {
    let by_door = |_: f64, _: f64, door: f64| 5.0 * door;
    let diagnosis = answer(MACHINE, &[&day(1, by_door)], &[&day(2, by_door)]);
    assert_eq!(diagnosis.report.verdict, Verdict::Explained);
    let [found] = claimed(&diagnosis)[..] else { panic!("{:?}", diagnosis.report.findings) };
    assert_eq!((found.cause.as_str(), found.column.as_deref()), ("dependence", Some("door_open")));
    assert_eq!(
        (found.form, found.times.as_deref(), found.compensated),
        (Some("level"), None, true)
    );
    let ci95 = &found.parameters["level_um"]["ci95"][0];
    let [low, high] = [0, 1].map(|end| ci95[end].as_f64().expect("a number"));
    assert!(low <= 5.0 && 5.0 <= high && high - low < 1.0, "{low} to {high}");
    // The column of the gauge's other channel, and the number of the part, explain nothing.
    let notes = diagnosis.report.notes.join(" ");
    assert!(notes.contains("twin_um reproduces the measured value"), "{notes}");
    assert!(notes.contains("part only grows with the rows"), "{notes}");
    let after = &diagnosis.report.after;
    assert!(after.holdout_rms_um < 0.5, "{after:?}");
}

#[test]
fn each_tool_has_its_own_centrifugal_growth() {
    let by_tool = |tool: f64, rpm: f64, _: f64| 0.015 * (tool - 1.0) * (rpm / 1000.0).powi(2);
    let diagnosis = answer(MACHINE, &[&day(3, by_tool)], &[&day(4, by_tool)]);
    let named: Vec<_> = claimed(&diagnosis)
        .iter()
        .map(|finding| (finding.column.clone(), finding.times.clone()))
        .collect();
    assert_eq!(
        named,
        [(Some("tool".to_string()), Some("speed2".to_string()))],
        "{:?}",
        diagnosis.report.findings
    );
    assert!(diagnosis.report.after.holdout_rms_um < 0.6, "{:?}", diagnosis.report.after);
}

#[test]
fn a_tool_without_a_number_is_called_by_its_label() {
    let by_tool = |tool: f64, rpm: f64, _: f64| 0.015 * (tool - 1.0) * (rpm / 1000.0).powi(2);
    let labelled = |seed: u64| {
        let text = day(seed, by_tool);
        let mut rows = text.lines().map(|row| row.split(',').collect::<Vec<_>>());
        let mut csv = rows.next().expect("a header").join(",") + "\n";
        for mut cells in rows {
            cells[3] = ["drill", "mill", "probe"][cells[3].parse::<usize>().expect("a tool") - 1];
            writeln!(csv, "{}", cells.join(",")).expect("text");
        }
        csv
    };
    let tools = "[spindle.tools]\ndrill = { um_per_krpm2 = 0.0 }\nmill = { number = 2, um_per_krpm2 = 0.0 }\n\
                 probe = { um_per_krpm2 = 0.0 }\ndefault = { um_per_krpm2 = 0.0 }\n";
    let diagnosis = answer(&format!("{MACHINE}{tools}"), &[&labelled(3)], &[&labelled(4)]);
    let [found] = claimed(&diagnosis)[..] else { panic!("{:?}", diagnosis.report.findings) };
    for tool in ["tool = drill", "tool = 2", "tool = probe"] {
        assert!(found.sentence.contains(tool), "{}", found.sentence);
    }
}

/// Only with tools 2 and 3 does the force bend something: 0.1 and −0.2 µm for each unit.
#[test]
fn what_acts_only_with_some_tools_is_named_with_both_columns() {
    let force = |row: usize| 40.0 + 35.0 * (row as f64 / 7.0).sin();
    let with_force = |text: &str| {
        let mut rows = text.lines();
        let mut csv = format!("spray,{}\n", rows.next().expect("a header"));
        for (row, line) in rows.enumerate() {
            let mut cells: Vec<String> = line.split(',').map(String::from).collect();
            let tool = cells[3].parse::<f64>().expect("a tool") as usize;
            let last = cells.len() - 1;
            let um: f64 = cells[last].parse().expect("measured");
            cells[last] = format!("{:.3}", um + [0.0, 0.1, -0.2][tool - 1] * force(row));
            writeln!(csv, "{:.3},{}", force(row), cells.join(",")).expect("text");
        }
        csv
    };
    let [first, second] = [5, 6].map(|seed| with_force(&day(seed, |_, _, _| 0.0)));
    let diagnosis = answer(MACHINE, &[&first], &[&second]);
    let both = claimed(&diagnosis).iter().any(|finding| {
        finding.columns == Some(["tool".to_string(), "spray".to_string()])
            && finding.form == Some("level")
    });
    assert!(both, "{:?}", diagnosis.report.findings);
    assert!(diagnosis.report.after.holdout_rms_um < 0.6, "{:?}", diagnosis.report.after);
}

#[test]
fn where_nothing_depends_on_a_column_none_is_named() {
    for seed in 10..16 {
        let diagnosis = answer(MACHINE, &[&day(seed, |_, _, _| 0.0)], &[]);
        assert!(claimed(&diagnosis).is_empty(), "{seed}: {:?}", diagnosis.report.findings);
    }
}

#[test]
fn the_extended_file_predicts_what_the_diagnosis_says() {
    let challenge = draw_test_case(HiddenCause::Dependence, 10.0, 1);
    let runs: Vec<&str> = challenge.runs.iter().map(String::as_str).collect();
    let diagnosis = answer(&challenge.machine, &runs, &[&challenge.holdout]);
    let text = diagnosis
        .render_extended_toml(&challenge.machine, Path::new("m.toml"))
        .expect("a machine file");
    assert!(text.contains("cause = \"dependence\""), "{text}");
    let extended = MachineFile::parse(&text, Path::new("extended.toml")).expect("a machine file");
    let run = read(&challenge.holdout);
    let index = Quantity::ALL
        .iter()
        .position(|quantity| quantity.name() == challenge.quantity)
        .expect("one");
    let measured = run.column(&format!("measured_{}_um", challenge.quantity)).expect("measured");
    let left: Vec<f64> = RunPredictor::new(&extended, &run)
        .expect("a prediction")
        .model_values()
        .zip(measured)
        .map(|(model, measured)| measured - model.to_array()[index])
        .filter(|left| !left.is_nan())
        .collect();
    let rms_um = (left.iter().map(|um| um * um).sum::<f64>() / left.len() as f64).sqrt();
    // What only explains is fitted to what the board's terms leave, `after` is of the joint fit.
    let said_um = diagnosis.report.after.holdout_rms_um;
    assert!((rms_um - said_um).abs() < 0.05 * said_um, "{rms_um} and {said_um}");
}
