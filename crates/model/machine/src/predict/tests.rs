use super::*;
use crate::MachineFile;
use std::path::Path;

const PAPER: &str = include_str!("../../../../../data/paper_spindle.toml");
const INPUT: &str =
    "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.328 }";

fn machine(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("the test's own machine file")
}

fn run(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run")
}

/// Returns what is written, and the account of it.
fn written(machine_text: &str, run_text: &str) -> (String, PredictionSummary) {
    let (machine, run) = (machine(machine_text), run(run_text));
    let predictor = RunPredictor::new(&machine, &run).expect("can be predicted");
    let (mut out, mut rows) = (Vec::new(), 0);
    let account = predictor.write_csv(&mut out, || rows += 1).expect("a Vec can be written");
    assert_eq!(rows, account.rows);
    (String::from_utf8(out).expect("CSV is text"), account)
}

#[test]
fn both_sides_stand_next_to_what_was_read() {
    let (csv, account) = written(PAPER, "sensor_counts,mystery\n9164,-1e-3\n5048,\n");
    let header = format!("sensor_counts,mystery,{}\n", PREDICTION_COLUMNS.join(","));
    // 62.80517578125 µm: the board rounds it to a nanometre, and the error once more.
    let grown = "9164,-0.001,62.805176,62.805000,0.000000,0.000000,0.000000,0.000000,\
                 -62.805176,-62.805000\n";
    let cold = format!("5048,{}\n", ",0.000000".repeat(8));
    assert_eq!(csv, [header.as_str(), grown, &cold].concat());
    assert_eq!((account.rows, account.rows_without_counts), (2, 0));
    let difference_nm = account.largest_difference_nm.expect("there is a bridge");
    assert!((difference_nm - 0.175_781_25).abs() < 1e-9);
}

#[test]
fn a_row_without_counts_has_empty_cells() {
    let (csv, account) = written(PAPER, "x_mm;sensor_counts\n1;\n2;5048\n3;nan\n");
    // X and Y do not depend on a tool that points down.
    let rest = format!(",,,,{},,\n", ["0.000000"; 4].join(","));
    assert!(csv.contains(&format!("\n1{rest}")) && csv.contains(&format!("\n3{rest}")), "{csv}");
    assert_eq!((account.rows, account.rows_without_counts), (3, 2));
}

#[test]
fn without_inputs_the_model_predicts_alone() {
    let (csv, account) = written(&PAPER.replace(INPUT, ""), "sensor_counts\n9164\n");
    assert!(csv.ends_with("\n9164,62.805176,,0.000000,,0.000000,,-62.805176,\n"), "{csv}");
    assert_eq!(account.largest_difference_nm, None);
}

#[test]
fn without_a_source_both_sides_are_zero_and_no_counts_are_needed() {
    let text = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";
    let (csv, account) = written(text, "x_mm\n1\n");
    assert!(csv.ends_with(&format!("\n1{}\n", ",0.000000".repeat(8))), "{csv}");
    assert_eq!(account.largest_difference_nm, Some(0.0));
}

#[test]
fn an_inclined_tool_shares_its_growth_between_the_axes() {
    let text =
        PAPER.replace("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0.0, 0.6, -0.8]");
    let (csv, account) = written(&text, "sensor_counts\n9164\n");
    let cells = "62.805176,62.805000,0.000000,0.000000,37.683105,37.683000,\
                 -50.244141,-50.244000\n";
    assert!(csv.ends_with(cells), "{csv}");
    assert!(account.largest_difference_nm.expect("there is a bridge") < 1.0);
}

#[test]
fn the_bridge_is_within_2_nm_of_the_model_at_every_count() {
    let text =
        PAPER.replace("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0.1, -0.7, -0.8]");
    let counts: String = (0..=32_768).map(|count| format!("{count}\n")).collect();
    let (_, account) = written(&text, &format!("sensor_counts\n{counts}"));
    let difference_nm = account.largest_difference_nm.expect("there is a bridge");
    assert!((0.5..1.1).contains(&difference_nm), "{difference_nm} nm");
}

#[test]
fn what_was_written_is_a_run_file_with_the_same_values() {
    let text = "\"load; \"\"z\"\", n\",sensor_counts,time_s\n1e-7,5048.5,\n-2e300,0.1,3\n";
    let (csv, _) = written(PAPER, text);
    let (before, after) = (run(text), run(&csv));
    assert_eq!(after.columns().len(), 3 + PREDICTION_COLUMNS.len());
    for (before, after) in before.columns().iter().zip(after.columns()) {
        assert_eq!(before.name, after.name);
        for (before, after) in before.values.iter().zip(after.values.iter()) {
            assert!(before == after || before.is_nan() && after.is_nan());
        }
    }
}

#[test]
fn counts_that_the_sensor_cannot_give_are_reported() {
    let (_, account) = written(PAPER, "sensor_counts\n0\n32768\n40000\n-1\n\n");
    assert_eq!(account.rows_out_of_range, 2);
    assert_eq!(account.first_out_of_range.expect("two").line, 4);
}

#[test]
fn what_the_board_could_not_run_is_predicted_all_the_same() {
    let steep = machine(&PAPER.replace("0.0152587890625", "2.0"));
    let run = run("sensor_counts\n5049\n");
    let predictor = RunPredictor::new(&steep, &run).expect("the model needs no board");
    let why = predictor.bridge_error().expect("the board cannot");
    assert!(why.starts_with("m.toml:16:16: spindle.sensor.um_per_count 2 is"), "{why}");
    assert_eq!(predictor.predictions().next().map(|row| row.model.elongation_um), Some(2.0));
}

#[test]
fn what_cannot_be_predicted_is_refused_with_its_place() {
    for (run_text, complaint) in [
        ("x_mm\n1\n", "r.csv:1:1: column sensor_counts is missing"),
        ("sensor_counts,bridge_dx_um\n1,2\n", "r.csv:1:1: column bridge_dx_um is already there"),
    ] {
        let (machine, run) = (machine(PAPER), run(run_text));
        let error = RunPredictor::new(&machine, &run).expect_err(complaint).to_string();
        assert!(error.starts_with(complaint), "{error}");
    }
}

#[test]
fn a_row_that_the_boards_numbers_cannot_hold_breaks_the_promise_and_one_between_its_steps_does_not()
{
    let axis = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x.thermal]\nmode = \"position\"\n\
                sensor = \"temp_a_c\"\nreference_c = 20\nslope_um_per_m_per_c = 11.5\nlag_s = 30\n";
    let machine = MachineFile::parse(axis, Path::new("m.toml")).expect("a machine");
    let written = |rows: &str| {
        let text = format!("time_s,x_mm,temp_a_c\n{rows}");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let predictor = RunPredictor::new(&machine, &run).expect("it can be predicted");
        predictor.write_csv(Vec::new(), || {}).expect("a Vec can be written")
    };
    // 8.4 m beyond what a sum of errors may be: 303 mm of growth.
    let (row, nm) = written("0,0,20\n600,30000,900\n").broken_promise.expect("it is broken");
    assert!(row == 1 && nm > 1e8, "{nm}");
    assert_eq!(written("0,0,20\n600,9000,30\n1200,9000,25\n").broken_promise, None);
    // 50 ms after a step of the board, while the temperature runs away.
    let between = written("0,9000,20\n10,9000,20\n10.25,9000,40\n");
    assert!(between.largest_difference_nm.expect("a bridge") > OFFSET_RESOLUTION_NM, "{between:?}");
    assert_eq!(between.broken_promise, None);
}

#[test]
fn a_tool_of_another_length_errs_by_its_own_lever_and_the_board_knows_that_of_the_file() {
    let text = "machine = { name = 'm', kind = '3-axis', chain = 'w b X Y Z t' }
                angular.eax.urad_per_m = 10.0
                tool.length_mm = 100.0";
    // At X = 1 m rolled by 10 µrad: Δy = −10 µrad · (Z − length), Δz = 10 µrad · Y.
    let rows = "x_mm,y_mm,z_mm,tool_length_mm\n1000,500,200,100\n1000,500,200,300\n1000,500,200,\n";
    let (machine, rows) = (machine(text), run(rows));
    let predictor = RunPredictor::new(&machine, &rows).expect("can be predicted");
    let all: Vec<RowPrediction> = predictor.predictions().collect();
    assert_eq!(all[0].model.error_um, [0.0, -1.0, 5.0]);
    assert_eq!(all[1].model.error_um, [0.0, 1.0, 5.0]);
    assert!(all[2].model.error_um[1].is_nan(), "{:?}", all[2]);
    assert_eq!(all[2].model.error_um[2].to_bits(), 5.0_f64.to_bits());
    assert!(
        all.iter().take(2).all(|prediction| prediction.compensated.error_um == [0.0, -1.0, 5.0])
    );
    assert!(all[1].arithmetic_error_nm().expect("a board") < 1.0);
    assert_eq!(predictor.unsupported_features(), ["tool_length_mm"]);
    let (_, account) = written(text, "x_mm,y_mm,z_mm,tool_length_mm\n1000,500,200,300\n");
    assert_eq!(account.broken_promise, None);
}
