//! The old FANUC Series 0 by the numbers of paper 4, checked by hand; and straightness that four points
//! cannot hold.

use std::path::Path;

use trueup_export::{
    ExportError, ExportFormat, ExportOptions, ExportResult, export,
    fanuc::{FanucSeries, parse_series_0_sheet},
};
use trueup_machine::{MachineFile, machine_file::LinearAxis};

fn exported(text: &str, fanuc: FanucSeries) -> Result<ExportResult, ExportError> {
    let source = format!("[machine]\nname = \"lathe\"\nkind = \"3-axis\"\n{text}");
    let machine = MachineFile::parse(&source, Path::new("m.toml")).expect("it is correct");
    export(&machine, ExportFormat::Fanuc, &ExportOptions { fanuc, ..ExportOptions::default() })
}

/// Errors of 0, −2 and +3 µm; and of Z 0, −20, −40, which needs 4 times as much a step.
const BOTH: &str = "[axis.x.pitch]\nstart_mm = -100.0\nstep_mm = 100.0\nforward_um = [4.0, 0.0, -2.0, 3.0]\n\
                    [axis.z.pitch]\nstart_mm = 0.0\nstep_mm = 50.0\nforward_um = [0.0, -20.0, -40.0]\n";

#[test]
fn the_sheet_has_the_papers_numbers() {
    let x = &BOTH[..BOTH.find("[axis.z").expect("it is there")];
    let export = exported(x, FanucSeries::Zero).expect("it can be held");
    // The reference at point 1, sections of 100 mm: the correction is -4, 0, +2, -3, so the points after
    // the first are +4, +2, -5.
    let sheet = &export.files[0].text;
    assert_eq!(export.files[0].name, "SERIES-0.TXT");
    for line in [
        "MDI MODE, PWE = 1; ALARM 1000 COMES: PRESS CAN AND RESET TOGETHER",
        "0011 PML2=0 PML1=0 (X1, BOTH AXES)",
        "1000 1 (X: POINT AT THE REFERENCE; POINTS 1 TO 3)",
        "0756 100000 (X: SPACING, 0.001 MM)",
        "1002 4 (X: POINT 1)",
        "1003 2 (X: POINT 2)",
        "1004 -5 (X: POINT 3)",
    ] {
        assert!(sheet.lines().any(|other| other == line), "{line}: {sheet}");
    }
    assert_eq!(parse_series_0_sheet(sheet, LinearAxis::X), Ok((1, 100.0, vec![4, 2, -5])));
}

#[test]
fn both_axes_have_one_magnification() {
    let export = exported(BOTH, FanucSeries::Zero).expect("it can be held");
    let sheet = &export.files[0].text;
    assert!(sheet.contains("0011 PML2=1 PML1=0 (X4, BOTH AXES)"), "{sheet}");
    assert!(sheet.contains("2000 0 (Z: ") && sheet.contains("0757 50000 (Z: "), "{sheet}");
    // +20 in each section of Z: 5 times 4.
    assert!(sheet.contains("2002 5 (Z: POINT 1)\n2003 5 (Z: POINT 2)"), "{sheet}");
    // X in whole steps of 4: 4, 0 (or 4), -4.
    let (_, _, values) = parse_series_0_sheet(sheet, LinearAxis::X).expect("it reads back");
    let sums: Vec<i64> = values
        .iter()
        .scan(-4, |sum, value| {
            *sum += value;
            Some(*sum)
        })
        .collect();
    assert!(sums.iter().zip([0, 2, -3]).all(|(sum, right)| (sum - right).abs() <= 2), "{sums:?}");
    // What is off by micrometres is no whole export.
    assert!(
        !export.report.is_complete() && export.report.max_difference_um() > 1.0,
        "{}",
        export.report
    );
}

#[test]
fn what_series_0_does_not_have_is_omitted_with_the_reason() {
    let text = format!(
        "{BOTH}[axis.y.pitch]\nstart_mm = 0.0\nstep_mm = 50.0\nforward_um = [0.0, 1.0]\n\
         [straightness.z_of_x]\norder = 2\nknots_mm = [0.0, 0.0, 100.0, 100.0]\ncontrol_um = [0.0, 3.0]\n"
    );
    let export = exported(&text, FanucSeries::Zero).expect("the rest can be held");
    let left = export.report.to_string();
    assert!(left.contains("axis.y.pitch: Series 0 has numbers for X and Z"), "{left}");
    assert!(left.contains("straightness.z_of_x: Series 0 has no straightness"), "{left}");
    let two_way = "[axis.x.pitch]\nstart_mm = 0.0\nstep_mm = 50.0\nforward_um = [0.0, 1.0]\n\
                   reverse_um = [4.0, 6.0]\n";
    let refused = exported(two_way, FanucSeries::Zero).expect_err("nothing is left");
    assert!(refused.to_string().contains("--ways one"), "{refused}");
}

#[test]
fn straightness_that_four_points_cannot_hold_is_not_written_and_its_loss_is_reported() {
    let gantry = include_str!("../../../../data/gantry.toml");
    let machine = MachineFile::parse(gantry, Path::new("gantry.toml")).expect("it is correct");
    let export = export(&machine, ExportFormat::Fanuc, &ExportOptions::default())
        .expect("its pitch is held");
    let report = export.report.to_string();
    println!("{report}");
    assert!(!export.report.is_complete());
    // Only curves of which a tenth at most stays are written, each with its loss.
    let written =
        export.report.tables.iter().filter(|table| table.section.contains("straightness"));
    assert!(
        written.clone().all(|table| table.largest.um < 5.0 && table.loss.is_some()),
        "{report}"
    );
    let curve =
        export.report.omitted.iter().find(|left| left.section.contains("straightness.z_of_x"));
    let reason = &curve.expect("it is left out").reason;
    let off_um: f64 = reason
        .split(' ')
        .zip(reason.split(' ').skip(1))
        .find_map(|(number, unit)| (unit == "µm").then(|| number.parse().ok())?)
        .expect("a loss in µm");
    assert!((30.0..40.0).contains(&off_um), "{reason}");
}
