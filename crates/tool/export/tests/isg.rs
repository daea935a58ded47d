//! The ISG format, read back and evaluated as its control would: component errors times levers.

use std::path::Path;

use trueup_export::{
    ExportError, ExportFormat, ExportOptions, ExportResult, export,
    isg::{CompensationFile, parse},
};
use trueup_machine::{
    Machine, MachineFile,
    model::{ReferenceModel, RowInputs},
};

fn machine(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn exported(text: &str) -> Result<ExportResult, ExportError> {
    export(&machine(text), ExportFormat::Isg, &ExportOptions::default())
}

fn file<'e>(export: &'e ExportResult, name: &str) -> &'e str {
    &export.files.iter().find(|file| file.name == name).expect("it is there").text
}

const VOLUME: &str = "
machine = { name = 'portal', kind = '3-axis', chain = 'w b X Y Z t' }
axis.x.travel_mm = [0, 1000]
axis.y.travel_mm = [-400, 400]
axis.z.travel_mm = [0, 500]
axis.x.pitch = { start_mm = 0, step_mm = 125, forward_um = [0, 3, -4, 9, 2, 7, 1, 0, -6] }
straightness.z_of_x = { order = 4, knots_mm = [0, 0, 0, 0, 400, 1000, 1000, 1000, 1000], control_um = [0, 9, -7, 12, 3] }
straightness.x_of_y = { order = 3, knots_mm = [-400, -400, -400, 400, 400, 400], control_um = [5, -9, 2] }
squareness = { x_of_y_um_per_m = 14.0, y_of_z_um_per_m = -9.0 }
tool = { length_mm = 130, offset_mm = [10, -20, 0] }
[angular]
point_x_mm = [0, 150, 250]
point_y_mm = [500, 0, -30]
eax.urad_per_m = 12.0
ebx = { order = 4, knots_mm = [0, 0, 0, 0, 300, 1000, 1000, 1000, 1000], control_urad = [0, 20, -15, 30, 4] }
ecx.urad_per_m = -18.0
eay = { order = 4, knots_mm = [-400, -400, -400, -400, 400, 400, 400, 400], control_urad = [3, 20, -15, 10] }
eby.urad_per_m = 11.0
ecy.urad_per_m = 8.0
eaz.urad_per_m = -16.0
ebz = { order = 2, knots_mm = [0, 0, 120, 500, 500], control_urad = [3, 9, -15] }
ecz.urad_per_m = 21.0
";

/// Returns the error in µm as the kernel adds it up, of a chain X, Y, Z that moves the tool.
fn as_the_control(file: &CompensationFile, position_mm: [f64; 3]) -> [f64; 3] {
    let value = |name: String, mm: f64| file.value(&name, mm).unwrap_or(0.0);
    let tip = ["X", "Y", "Z"].map(|axis| value(format!("P0{axis}"), 0.0));
    let mut sum = [0.0; 3];
    for (n, axis) in ["X", "Y", "Z"].iter().enumerate() {
        let own = position_mm[n];
        let offset = ["X", "Y", "Z"].map(|along| value(format!("E{along}{axis}"), own));
        let [a, b, c] = ["A", "B", "C"].map(|about| value(format!("E{about}{axis}"), own));
        // What is between the axis and the tool.
        let [x, y, z] = [0, 1, 2].map(|m| tip[m] + if m > n { position_mm[m] } else { 0.0 });
        let turned = [b * z - c * y, c * x - a * z, a * y - b * x];
        for m in 0..3 {
            sum[m] += (offset[m] + turned[m]) * 1e3;
        }
    }
    sum
}

#[test]
fn the_volume_is_read_back_within_50_nm_wherever_the_tool_is() {
    let export = exported(VOLUME).expect("it has component errors");
    let back = parse(file(&export, "volcomp.csv")).expect("its own file");
    let machine = machine(VOLUME);
    let (mut worst, mut largest, mut seed) = (0.0_f64, 0.0_f64, 1_u64);
    for _ in 0..1_000 {
        let position_mm = [[0.0, 1000.0], [-400.0, 400.0], [0.0, 500.0]].map(|[low, high]| {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * (seed >> 11) as f64 / (1_u64 << 53) as f64
        });
        let situation = RowInputs { position_mm, direction: [1.0; 3], ..RowInputs::UNKNOWN };
        let model = ReferenceModel::new(&machine).step(&situation).error_um();
        for (model, control) in model.into_iter().zip(as_the_control(&back, position_mm)) {
            worst = worst.max((model - control).abs());
            largest = largest.max(model.abs());
        }
    }
    assert!(worst <= 0.05 && largest > 15.0, "{worst} of {largest} µm");
    assert!(export.report.tables.iter().all(|table| table.largest.um <= 0.05), "{}", export.report);
    assert_eq!(export.report.omitted, []);
}

#[test]
fn a_row_is_what_the_hand_writes() {
    let text = "machine = { name = 'm', kind = '3-axis', chain = 'w b X Y Z t' }
                axis.x.pitch = { start_mm = 0, step_mm = 100, forward_um = [0, 2] }
                angular.ebx.urad_per_m = 100.0";
    let export = exported(text).expect("a pitch and an angle");
    let csv = file(&export, "volcomp.csv");
    let (comments, rows): (Vec<&str>, Vec<&str>) =
        csv.lines().partition(|line| line.starts_with("//"));
    // The sign is an assumption: file and report say so, and how to try it.
    for message in [comments.join(" "), export.report.to_string()] {
        assert!(message.contains("A wrong sign doubles the errors"), "{message}");
        assert!(message.contains("if it doubles, set negate"), "{message}");
    }
    assert_eq!(
        rows,
        [
            "#",
            "X EXX EYX EZX EAX EBX ECX",
            "0 0 0 0 0 0 0",
            "100 0.002 0 0 0 0.00001 0",
            "#",
            "P0X P0Y P0Z",
            "0 0 0"
        ]
    );
    let list = file(&export, "volcomp.lis");
    for line in
        ["chain XYZ", "workpiece_axes 0", "X 1", "file[0] volcomp.csv", "file_format[0] ISG_CSV"]
    {
        assert!(list.lines().any(|other| other == line), "{line} in {list}");
    }
}

#[test]
fn what_turns_the_tool_is_written_and_what_moves_the_workpiece_is_omitted_with_the_reason() {
    let text = "machine = { name = 'm', kind = 'head-table', head_axes = ['b'], chain = \"w C' X' b Y Z B t\" }
                angular.eax.urad_per_m = 10.0
                rotary.b = { point_mm = [0, 1, 250], exob_um = 5.0, ecob_urad = -20.0 }
                rotary.c.exoc_um = 3.0";
    let export = exported(text).expect("the head's line");
    let csv = file(&export, "volcomp.csv");
    let back = parse(csv).expect("its own file");
    for (name, value) in [("PZB", 250.0), ("X0B", 0.005), ("C0B", -0.000_02), ("PYB", 1.0)] {
        assert_eq!(back.value(name, 0.0), Some(value), "{csv}");
    }
    let list = file(&export, "volcomp.lis");
    assert!(
        list.starts_with("chain CXYZB\\nworkpiece_axes 2\\n".replace("\\n", "\n").as_str()),
        "{list}"
    );
    let omitted: Vec<&str> =
        export.report.omitted.iter().map(|omission| omission.section.as_str()).collect();
    assert_eq!(omitted, ["angular.eax", "rotary.c"]);
}

#[test]
fn without_a_chain_nothing_is_written_and_other_controls_refuse_angles_with_the_reason() {
    let pitch = "axis.x.pitch = { start_mm = 0, step_mm = 100, forward_um = [0, 2] }";
    let refused = exported(&format!("machine = {{ name = 'm', kind = '3-axis' }}\n{pitch}"));
    let rule = refused.expect_err("no chain").to_string();
    assert!(rule.contains("TwinCAT needs the chain of the axes"), "{rule}");
    let text = "machine = { name = 'm', kind = '3-axis', chain = 'w b X Y Z t' }
                angular.eax.urad_per_m = 10.0";
    for format in ExportFormat::ALL.into_iter().filter(|format| *format != ExportFormat::Isg) {
        let refused =
            export(&machine(text), format, &ExportOptions::default()).expect_err("an angle");
        let rule = refused.to_string();
        assert!(
            rule.contains("angular.eax: an angle acts by its lever along other axes"),
            "{rule}"
        );
        // The 840D could, and the user wants to know why not.
        assert_eq!(rule.contains("(VCS)"), format == ExportFormat::Siemens840d, "{rule}");
    }
}

#[test]
fn a_file_that_is_no_table_is_refused() {
    for (text, rule) in [
        ("X EXX\n0 1\n0 2\n", "line 3: 0 does not rise"),
        ("X EXX\n0\n", "line 2 has not a number for each name"),
        ("X EXX\n0 a\n", "line 2 is not of numbers"),
    ] {
        assert_eq!(parse(text), Err(rule.into()));
    }
    assert_eq!(parse("// nothing\n\n#\n"), Ok(CompensationFile::default()));
}
