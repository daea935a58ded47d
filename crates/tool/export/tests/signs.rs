//! One small machine, every number of every file worked out by hand: the signs, the units and the
//! forms.
//!
//! X goes +2 µm too far at 100 mm and −3 µm (short) at 200 mm, and is left +5 µm behind after an
//! approach in the negative direction. Y has a table for each direction. Z sags by 4 µm over the
//! first 100 mm of X. X grows by 10 µm/m/K from 20 °C, and the tool 60 µm downwards.

use std::path::Path;

use trueup_export::{
    ApproachDirection, ExportError, ExportFormat, ExportOptions, ExportResult, LengthUnit, export,
};
use trueup_machine::{Machine, MachineFile};

const MACHINE: &str = r#"
[machine]
name = "by hand"
kind = "3-axis"
[axis.x.pitch]
start_mm = 0.0
step_mm = 100.0
forward_um = [0.0, 2.0, -3.0]
[axis.x.backlash]
width_um = 5.0
[axis.x.thermal]
mode = "both"
sensor = "temp_x_c"
reference_c = 20.0
constant_um_per_c = 0.5
slope_um_per_m_per_c = 10.0
origin_mm = 50.0
[axis.y.pitch]
start_mm = -100.0
step_mm = 100.0
forward_um = [1.0, 3.0, 4.0]
reverse_um = [6.0, 7.0, 9.0]
[straightness.z_of_x]
order = 2
knots_mm = [0.0, 0.0, 100.0, 200.0, 200.0]
control_um = [0.0, -4.0, -4.0]
[spindle]
source = "temperature"
[spindle.temperature]
sensor = "temp_head_c"
reference_c = 20.0
k_um_per_c = 2.0
"#;

fn machine() -> Machine {
    MachineFile::parse(MACHINE, Path::new("hand.toml")).expect("it is correct")
}

fn exported(format: ExportFormat, options: &ExportOptions) -> ExportResult {
    export(&machine(), format, options).expect("it can be held")
}

fn file<'e>(export: &'e ExportResult, name: &str) -> &'e str {
    let file = export.files.iter().find(|file| file.name == name);
    &file.unwrap_or_else(|| panic!("no {name} in {:?}", export.files)).text
}

fn assert_lines(text: &str, lines: &[&str]) {
    for line in lines {
        assert!(text.lines().any(|there| there == *line), "{line} is not in\n{text}");
    }
}

#[test]
fn linuxcnc_trims_are_the_opposite_of_the_error_with_the_backlash_in_the_reverse_column() {
    let export = exported(ExportFormat::LinuxCnc, &ExportOptions::default());
    assert_eq!(file(&export, "x.comp"), "0 0 -0.005\n100 -0.002 -0.007\n200 0.003 -0.002\n");
    assert_eq!(file(&export, "y.comp"), "-100 -0.001 -0.006\n0 -0.003 -0.007\n100 -0.004 -0.009\n");
    let left: Vec<&str> = export.report.omitted.iter().map(|left| left.section.as_str()).collect();
    assert_eq!(left, ["straightness.z_of_x", "axis.x.thermal", "spindle.temperature"]);
    assert!(export.report.max_difference_um() < 1e-9, "{}", export.report);
}

#[test]
fn linuxcnc_in_inches_has_the_same_positions_and_trims() {
    let options = ExportOptions { units: LengthUnit::Inches, ..ExportOptions::default() };
    let export = exported(ExportFormat::LinuxCnc, &options);
    assert_lines(file(&export, "x.comp"), &["3.93700787 -0.00007874 -0.00027559"]);
    assert!(export.report.max_difference_um() < 0.001, "{}", export.report);
}

#[test]
fn siemens_values_are_the_error_because_a_positive_one_moves_the_axis_negative() {
    let mut options = ExportOptions { elongation_um: 60.0, ..ExportOptions::default() };
    options.temperatures_c.insert("temp_x_c".into(), 30.0);
    let export = exported(ExportFormat::Siemens840d, &options);
    assert_eq!(
        file(&export, "AX_EEC.INI"),
        "%_N_AX_EEC_INI\nCHANDATA(1)\n\
         $AA_ENC_COMP[0,0,AX1]=0\n$AA_ENC_COMP[0,1,AX1]=0.002\n$AA_ENC_COMP[0,2,AX1]=-0.003\n\
         $AA_ENC_COMP_STEP[0,AX1]=100\n$AA_ENC_COMP_MIN[0,AX1]=0\n$AA_ENC_COMP_MAX[0,AX1]=200\n\
         $AA_ENC_COMP_IS_MODULO[0,AX1]=0\nM17\n"
    );
    // Y: 3 µm at its reference are taken out, forward in table 0, reverse in table 1.
    assert_lines(
        file(&export, "NC_CEC.INI"),
        &[
            "$AN_CEC[0,0]=-0.002",
            "$AN_CEC[0,1]=0",
            "$AN_CEC[0,2]=0.001",
            "$AN_CEC_DIRECTION[0]=1",
            "$AN_CEC[1,0]=0.003",
            "$AN_CEC[1,1]=0.004",
            "$AN_CEC[1,2]=0.006",
            "$AN_CEC_DIRECTION[1]=-1",
            "$AN_CEC_INPUT_AXIS[1]=(AX2)",
            "$AN_CEC_OUTPUT_AXIS[1]=(AX2)",
            // Z is too low, so its value is negative, and Z rises.
            "$AN_CEC[2,0]=0",
            "$AN_CEC[2,1]=-0.004",
            "$AN_CEC_INPUT_AXIS[2]=(AX1)",
            "$AN_CEC_OUTPUT_AXIS[2]=(AX3)",
            "$AN_CEC_DIRECTION[2]=0",
        ],
    );
    // 10 K: K₀ = 5 µm, tanβ = 100 µm/m; the tool has grown 60 µm downwards, and Z rises.
    assert_lines(
        file(&export, "TEMP_COMP.INI"),
        &[
            "$SA_TEMP_COMP_ABS_VALUE[AX1]=0.005",
            "$SA_TEMP_COMP_SLOPE[AX1]=0.0001",
            "$SA_TEMP_COMP_REF_POSITION[AX1]=50",
            "$SC_TOOL_TEMP_COMP[0]=0",
            "$SC_TOOL_TEMP_COMP[1]=0",
            "$SC_TOOL_TEMP_COMP[2]=-0.06",
            "$MA_TEMP_COMP_TYPE[AX1]=7",
            "$MA_TEMP_COMP_TYPE[AX2]=4",
        ],
    );
    assert_lines(file(&export, "temperature.csv"), &["AX1,70,0.025,0.0005,50"]);
    assert_lines(file(&export, "tool_direction.csv"), &["1000,0,0,-1"]);
    assert_lines(
        file(&export, "ENABLE.INI"),
        &["$MA_BACKLASH[0,AX1]=0.005", "$MA_CEC_MAX_SUM[AX2]=0.006", "$MA_CEC_MAX_SUM[AX3]=0.004"],
    );
    let constants: Vec<f64> = export
        .report
        .tables
        .iter()
        .map(|table| table.constant_um)
        .filter(|um| *um != 0.0)
        .collect();
    assert_eq!(constants, [3.0]);
    assert!(export.report.max_difference_um() < 1e-6, "{}", export.report);
}

#[test]
fn siemens_in_inches_is_25_4_times_smaller() {
    let options = ExportOptions { units: LengthUnit::Inches, ..ExportOptions::default() };
    let export = exported(ExportFormat::Siemens840d, &options);
    assert_lines(
        file(&export, "AX_EEC.INI"),
        &["$AA_ENC_COMP[0,1,AX1]=0.0000787", "$AA_ENC_COMP_STEP[0,AX1]=3.937007874"],
    );
    assert_lines(file(&export, "ENABLE.INI"), &["$MA_CEC_SCALING_SYSTEM_METRIC[AX2]=0"]);
    assert!(export.report.max_difference_um() < 0.01, "{}", export.report);
}

#[test]
fn fanuc_values_are_the_steps_of_the_correction_and_positive_moves_positive() {
    let export = exported(ExportFormat::Fanuc, &ExportOptions::default());
    // X in sections of 50 mm, because its straightness needs four points: the correction is 0, −1,
    // −2, +0.5 (rounded to 1), +3. Y from 128, the reference in its middle, 3 µm taken out: +2, 0,
    // −1, and −3, −4, −6 in the negative direction.
    assert_eq!(
        file(&export, "PITCH.TXT"),
        "%\nN10001P-1\nN10002P-1\nN10003P3\nN10004P2\nN10129P-2\nN10130P-1\nN10131P-1\nN10132P-2\n%\n"
    );
    assert_lines(
        file(&export, "CNC-PARA.TXT"),
        &[
            "N01851A1P5A2P0",
            "N03620A1P0A2P129",
            "N03621A1P1A2P129",
            "N03622A1P4A2P130",
            "N03623A1P1A2P1",
            "N03624A1P50000A2P100000",
            "N03626A2P131",
            "N03627A2P-4",
            "N05711P1",
            "N05721P3",
        ],
    );
    // Z is too low along X: it is lifted by 4 units.
    assert_lines(file(&export, "CNC-PARA.TXT"), &["N05761P0", "N05764P4"]);
}

#[test]
fn heidenhain_values_are_the_error_and_the_cma_names_the_moving_axis() {
    let export = exported(ExportFormat::Heidenhain, &ExportOptions::default());
    assert_eq!(
        file(&export, "X.com"),
        "BEGIN X.com MM\nNR AXISPOS BACKLASH X Z\n0 +0 +0.005 +0 +0\n\
         1 +100 +0.007 +0.002 -0.004\n2 +200 +0.002 -0.003 -0.004\n[END]\n"
    );
    assert_eq!(
        file(&export, "config.cma"),
        "BEGIN config.cma MM\nNR ACTIVE X Y\n0 * X.com Y.com\n[END]\n"
    );
    let read = trueup_export::heidenhain::parse(file(&export, "X.com")).expect("it is correct");
    assert!((read.correction_um("X", 100.0) + 2.0).abs() < 1e-9);
    assert!(export.report.max_difference_um() < 1e-6, "{}", export.report);
}

#[test]
fn a_wrong_sign_anywhere_would_show() {
    // The readers give the correction; with the model's error it must vanish, not double.
    let export = exported(ExportFormat::LinuxCnc, &ExportOptions::default());
    let read = trueup_export::linuxcnc::parse(file(&export, "x.comp")).expect("it is correct");
    assert_eq!(read.trim_at(200.0, ApproachDirection::Positive), 0.003);
    assert_eq!(read.trim_at(200.0, ApproachDirection::Negative), -0.002);
}

#[test]
fn a_machine_that_cannot_be_held_is_refused_with_every_reason() {
    let source = "[machine]\nname = \"hot\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
                  [spindle.temperature]\nsensor = \"temp_head_c\"\nreference_c = 20.0\n\
                  k_um_per_c = 2.0\n[squareness]\nx_of_y_um_per_m = 10.0\n";
    let machine = MachineFile::parse(source, Path::new("hot.toml")).expect("it is correct");
    for format in [ExportFormat::LinuxCnc, ExportFormat::Fanuc, ExportFormat::Heidenhain] {
        let refused =
            export(&machine, format, &ExportOptions::default()).expect_err("nothing fits");
        let ExportError::NothingFits { omitted, .. } = &refused else { panic!("{refused}") };
        assert_eq!(omitted.len(), 2, "{refused}");
        let name = format.name();
        let text = refused.to_string();
        assert!(
            text.starts_with(&format!("nothing of the model can be held by {name}; ")),
            "{text}"
        );
        assert!(text.contains("; spindle.temperature: "), "{text}");
    }
    // With the travel, the angle can be held where there are cross tables.
    let mut options = ExportOptions::default();
    options.travel_mm[1] = Some((0.0, 1000.0));
    let export = export(&machine, ExportFormat::Siemens840d, &options).expect("the angle fits");
    assert_lines(file(&export, "NC_CEC.INI"), &["$AN_CEC[0,0]=0", "$AN_CEC[0,1]=0.01"]);
}

#[test]
fn a_machine_without_errors_has_nothing_to_export() {
    let source = "[machine]\nname = \"new\"\nkind = \"3-axis\"\n";
    let machine = MachineFile::parse(source, Path::new("new.toml")).expect("it is correct");
    let refused =
        export(&machine, ExportFormat::LinuxCnc, &ExportOptions::default()).expect_err("no errors");
    assert_eq!(refused, ExportError::NoErrors(ExportFormat::LinuxCnc));
    let text = "the model has no errors, so there is nothing to export to linuxcnc";
    assert_eq!(refused.to_string(), text);
}

#[test]
fn what_a_diagnosis_has_added_along_and_across_an_axis_is_exported_with_it() {
    // +10 µm/m on X over 1 m, 2 µm more after a negative approach, and Z sags by 4 µm/m of X.
    let source = "[machine]\nname = \"extended\"\nkind = \"3-axis\"\n\
                  [[term]]\ncause = \"pitch-scale\"\nquantity = \"dx\"\num_per_m = 10.0\n\
                  [[term]]\ncause = \"backlash\"\nquantity = \"dx\"\nwidth_um = 2.0\n\
                  [[term]]\ncause = \"cross-axis\"\nquantity = \"dz\"\naxis = \"x\"\num_per_m = -4.0\n\
                  [[term]]\ncause = \"extra-heat-path\"\nquantity = \"dy\"\ncolumn = \"temp_room_c\"\n\
                  um_per_c = 1.0\ntime_constant_s = 60.0\nreference_c = 20.0\n\
                  [[term]]\ncause = \"axis-expansion\"\nquantity = \"dy\"\ncolumn = \"temp_screw_c\"\n\
                  um_per_m_per_c = 11.0\nreference_c = 20.0\n\
                  [[term]]\ncause = \"extra-heat-path\"\nquantity = \"dx\"\ncolumn = \"spindle_rpm\"\n\
                  um_per_krpm2 = 0.1\ntime_constant_s = 60.0\n";
    let machine = MachineFile::parse(source, Path::new("extended.toml")).expect("it is correct");
    let mut options = ExportOptions::default();
    options.travel_mm[0] = Some((0.0, 1000.0));
    let of = |format| export(&machine, format, &options).expect("it fits");
    let linuxcnc = of(ExportFormat::LinuxCnc);
    assert_eq!(file(&linuxcnc, "x.comp"), "0 0 -0.002\n1000 -0.01 -0.012\n");
    let siemens = of(ExportFormat::Siemens840d);
    assert_lines(file(&siemens, "AX_EEC.INI"), &["$AA_ENC_COMP[0,1,AX1]=0.01"]);
    assert_lines(file(&siemens, "NC_CEC.INI"), &["$AN_CEC[0,1]=-0.004"]);
    assert_lines(file(&siemens, "ENABLE.INI"), &["$MA_BACKLASH[0,AX1]=0.002"]);
    let heidenhain = of(ExportFormat::Heidenhain);
    assert_lines(file(&heidenhain, "X.com"), &["1 +1000 +0.012 +0.01 -0.004"]);
    for export in [linuxcnc, siemens, heidenhain, of(ExportFormat::Fanuc)] {
        let left: Vec<&str> =
            export.report.omitted.iter().map(|left| left.section.as_str()).collect();
        assert!(left.contains(&"term[3] (extra-heat-path)"), "{}", export.report);
        assert!(left.contains(&"term[4] (axis-expansion)"), "{}", export.report);
        assert!(left.contains(&"term[5] (extra-heat-path)"), "{}", export.report);
        assert!(export.report.max_difference_um() < 1.0, "{}", export.report);
    }
    // Without the travel a scale cannot be a table, and that is reported.
    let export = export(&machine, ExportFormat::LinuxCnc, &ExportOptions::default())
        .expect("the backlash fits");
    assert_eq!(file(&export, "x.comp"), "0 0 -0.002\n");
    assert!(export.report.to_string().contains("term[0] (pitch-scale): it needs the travel"));
}

#[test]
fn a_periodic_error_gets_points_where_it_bends() {
    let source = "[machine]\nname = \"periodic\"\nkind = \"3-axis\"\n\
                  [[term]]\ncause = \"pitch-periodic\"\nquantity = \"dy\"\nperiod_mm = 10.0\n\
                  amplitude_um = 3.0\nphase_deg = 40.0\n";
    let machine = MachineFile::parse(source, Path::new("periodic.toml")).expect("it is correct");
    let mut options = ExportOptions::default();
    options.travel_mm[1] = Some((-50.0, 50.0));
    for format in [ExportFormat::LinuxCnc, ExportFormat::Heidenhain, ExportFormat::Siemens840d] {
        let export = export(&machine, format, &options).expect("it fits");
        println!("{}: {:?}", format.name(), export.report.tables);
        assert!(export.report.is_complete(), "{}", export.report);
        assert!(export.report.max_difference_um() < 0.15, "{}", export.report);
    }
}

#[test]
fn what_depends_on_the_tool_or_a_condition_is_omitted_by_name_with_the_reason() {
    let source = format!(
        "{MACHINE}[spindle.tools]\n7 = {{ um_per_krpm2 = 0.02 }}\ndefault = {{ um_per_krpm2 = 0.01 }}\n\
         [inputs]\ndoor_open = {{ kind = \"condition\", bit = 0 }}\n\
         [[term]]\ncause = \"dependence\"\nquantity = \"dx\"\ncolumn = \"door_open\"\nform = \"level\"\n\
         levels = [0.0, 1.0]\nlevel_um = [0.0, 5.0]\n"
    );
    let with = MachineFile::parse(&source, Path::new("hand.toml")).expect("it is correct");
    for format in [
        ExportFormat::LinuxCnc,
        ExportFormat::Siemens840d,
        ExportFormat::Heidenhain,
        ExportFormat::Fanuc,
    ] {
        let of =
            |machine| export(machine, format, &ExportOptions::default()).expect("it can be held");
        let (with, without) = (of(&with), of(&machine()));
        for (section, column) in [("spindle.tools", "tool"), ("term[0] (dependence)", "door_open")]
        {
            let line =
                format!("{section}: it depends on {column}, which no table of a control knows");
            assert!(with.report.to_string().contains(&line), "{line}\n{}", with.report);
        }
        // The tables are those of the machine without them.
        assert_eq!(with.files.len(), without.files.len());
        for (with, without) in with.files.iter().zip(&without.files) {
            assert_eq!(with.text, without.text, "{}", with.name);
        }
    }
}
