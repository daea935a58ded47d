//! The rules of claims: one set-up, one tool, an unknown scale, a gross reading, a sound machine.

use std::path::Path;

use trueup_fit::volume::{self, VolumeFitOptions, VolumeReport, identifiability::ErrorAssessment};
use trueup_machine::{InputFileError, Machine, MachineFile, RunFile};

use crate::{
    drawn::{At, Drawn},
    measured::Balls,
};

const STATED: VolumeFitOptions =
    VolumeFitOptions { instrument_um: Some(1.0), scale_um_per_m: Some(1.0), artefact_um: None };

fn run(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("run.csv")).expect("a run")
}

pub fn file(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

pub fn fit(text: &str, machine: &Machine, options: &VolumeFitOptions) -> VolumeReport {
    volume::fit(&[run(text)], machine, options).expect("a fit")
}

pub fn of<'r>(report: &'r VolumeReport, name: &str) -> &'r ErrorAssessment {
    let found = report.known.iter().find(|assessment| assessment.error.to_string() == name);
    found.unwrap_or_else(|| panic!("no {name}"))
}

/// A plate at three heights and upright in both planes, with one tool or two.
fn plates(machine: &mut Drawn, tools: usize) -> String {
    let mut balls = Balls::new(machine);
    for tool_mm in machine.tools_mm.into_iter().take(tools) {
        for height in [0.0, 0.5, 1.0] {
            balls.plate(machine, [0, 1], [0.0, 0.0, height], tool_mm);
        }
    }
    balls.csv()
}

#[test]
fn an_angle_of_z_needs_a_second_tool_and_the_report_says_so() {
    // Seed 0: w b X Z Y t or the like, three axes that all move the tool.
    let mut machine = Drawn::of_size(0, 1.0);
    machine.file = machine
        .file
        .lines()
        .map(|line| {
            if line.starts_with("chain") {
                "chain = \"w b X Y Z t\"\n".into()
            } else {
                format!("{line}\n")
            }
        })
        .collect();
    let believed = file(&machine.file);
    let one = fit(&plates(&mut Drawn::of_size(0, 1.0), 1), &believed, &STATED);
    let open = of(&one, "EBZ");
    assert!(open.acts && !open.is_known, "{open:?}");
    assert!(open.next_test.contains("100 mm longer"), "{open:?}");
    assert!(of(&one, "EYX").is_known && of(&one, "EC0Y").is_known);
    // Nothing turns about the tool: no tip moves.
    assert!(!of(&one, "ECZ").acts);
    let two = fit(&plates(&mut Drawn::of_size(0, 1.0), 2), &believed, &STATED);
    assert!(of(&two, "EBZ").open < 0.5 * open.open, "{:?}", of(&two, "EBZ"));
}

#[test]
fn a_sound_machine_stays_as_it_is_or_gets_less_than_the_noise() {
    let mut machine = Drawn::of_size(0, 0.0);
    let text = plates(&mut machine, 2);
    let report = fit(&text, &file(&machine.file), &STATED);
    assert!(
        report.has_significant_improvement() != report.edit.is_empty(),
        "{:?}",
        report.held_out
    );
    for it in report.known.iter().filter(|assessment| assessment.is_known) {
        assert!(it.size.abs() < 3.0 * it.half_width.max(0.5), "{it:?}");
    }
}

#[test]
fn the_mean_scale_is_open_where_the_scale_of_the_artefact_is_not_stated() {
    let mut machine = Drawn::of_size(0, 1.0);
    let text = plates(&mut machine, 2);
    let believed = file(&machine.file);
    let report = fit(&text, &believed, &VolumeFitOptions { scale_um_per_m: None, ..STATED });
    assert!(!of(&report, "EXX").is_known);
    assert!(report.warnings.iter().any(|warning| warning.contains("--scale-um-per-m")));
    assert!(of(&fit(&text, &believed, &STATED), "EXX").is_known);
}

#[test]
fn a_gross_reading_is_excluded_and_changes_nothing() {
    let mut machine = Drawn::of_size(0, 1.0);
    let text = plates(&mut machine, 2);
    let mut lines: Vec<String> = text.lines().map(str::to_string).collect();
    let (before, value) = lines[40].rsplit_once(',').expect("columns");
    let spoilt = format!("{before},{}", value.parse::<f64>().expect("a number") + 60.0);
    lines[40] = spoilt;
    let believed = file(&machine.file);
    let [with, without] = [lines.join("\n"), text].map(|text| fit(&text, &believed, &STATED));
    assert_eq!(with.excluded.len(), 1, "{:?}", with.excluded);
    assert_eq!((with.excluded[0].place.line, without.excluded.len()), (41, 0));
    assert!((of(&with, "EAX").size - of(&without, "EAX").size).abs() < 0.5);
}

#[test]
fn a_second_fit_of_the_same_readings_finds_nothing_more() {
    let mut machine = Drawn::of_size(1, 1.0);
    let mut balls = Balls::new(&mut machine);
    for tool_mm in machine.tools_mm {
        for height in [0.0, 0.5, 1.0] {
            balls.plate(&mut machine, [0, 1], [0.0, 0.0, height], tool_mm);
        }
    }
    let text = balls.csv();
    let first = fit(&text, &file(&machine.file), &STATED);
    let corrected = first.edit.apply(&machine.file, Path::new("m.toml")).expect("sections");
    let second = fit(&text, &file(&corrected), &STATED);
    let [before, after] = [&first, &second].map(|report| report.held_out.before_um);
    assert!(after < 0.15 * before, "{before} µm, then {after} µm");
    // What is found a second time is added to what is there: still the same machine.
    assert!(of(&second, "EYX").size.abs() < 0.2 * of(&first, "EYX").size.abs());
}

/// A straight edge along X, read in Z at two places of Y; its own form is a bow of 6 µm.
pub fn edge(bow_um: f64, roll_urad: f64, has_points: bool) -> String {
    let mut text = String::from(if has_points {
        "x_mm,y_mm,z_mm,setup,point,measured_dz_um\n"
    } else {
        "x_mm,y_mm,z_mm,setup,measured_dz_um\n"
    });
    for (setup, y) in [(1, 0.0), (2, 400.0)] {
        for n in 0..41_u8 {
            let x = 10.0 * f64::from(n);
            let share = x / 200.0 - 1.0;
            let bow = bow_um * (1.0 - share * share);
            // A roll that grows as an S: a lever in Y makes it an error in Z.
            let roll = roll_urad * (share.powi(3) - share) * y / 1000.0;
            let point = if has_points { format!("{n},") } else { String::new() };
            let noise = 0.1 * ((f64::from(n) * 12.9898 + y).sin() * 43758.5453).fract();
            text += &format!("{x},{y},0,{setup},{point}{:.4}\n", bow + roll + noise);
        }
    }
    text
}

#[test]
fn straightness_of_an_unknown_edge_is_not_claimed_and_its_angle_is() {
    let believed = file("[machine]\nname = \"m\"\nkind = \"3-axis\"\nchain = \"w b X Y Z t\"\n");
    let options = VolumeFitOptions { instrument_um: Some(0.1), ..VolumeFitOptions::default() };
    let text = edge(6.0, 40.0, true);
    let report = fit(&text, &believed, &options);
    let straightness = of(&report, "EZX");
    assert!(!straightness.is_known, "{straightness:?}");
    assert!(straightness.confused_with.iter().any(|name| name.contains("form of the artefact")));
    // The same points at two levers: their difference has no form of the edge. Its slope is how the edge was put down.
    let angle = of(&report, "EAX");
    assert!(angle.open < 0.5 && angle.is_there, "{angle:?}");
    let certified = VolumeFitOptions { artefact_um: Some(0.2), ..options };
    assert!(of(&fit(&text, &believed, &certified), "EZX").is_known);
    // Without the numbers of the points it may be another edge each time.
    let apart = fit(&edge(6.0, 40.0, false), &believed, &options);
    assert!(!of(&apart, "EZX").is_known && of(&apart, "EAX").open > 0.6, "{:?}", of(&apart, "EAX"));
}

#[test]
fn an_angle_that_was_a_line_goes_on_beyond_what_was_measured() {
    let text = |travel: &str| {
        format!(
            "[machine]\nname = \"m\"\nkind = \"3-axis\"\nchain = \"w b X Y Z t\"\n{travel}\
             [angular.eax]\nurad_per_m = 90.0\n"
        )
    };
    let with_travel = text("[axis.x]\ntravel_mm = [0.0, 600.0]\n");
    // From 150 to 450 mm it rolls as the line says and, over it, as an S.
    let mut run = String::from("x_mm,y_mm,z_mm,measured_dy_um,measured_dz_um\n");
    for (n, x) in (0..=10_u8).map(|n| (n, 150.0 + 30.0 * f64::from(n))) {
        let s = f64::from(n) / 5.0 - 1.0;
        let urad = 90.0 * x / 1000.0 + 40.0 * (s.powi(3) - s);
        for (y, z) in [(0.0, 0.0), (300.0, 0.0), (0.0, 200.0), (300.0, 200.0)] {
            let noise = 0.1 * ((x * 12.9898 + y + z).sin() * 43758.5453).fract();
            let (dy, dz) = (-urad * z / 1000.0 + noise, urad * y / 1000.0 - noise);
            run += &format!("{x},{y},{z},{dy:.4},{dz:.4}\n");
        }
    }
    let options = VolumeFitOptions { instrument_um: Some(0.1), ..STATED };
    let roll_um = |text: &str, x: f64| {
        let report = fit(&run, &file(text), &options);
        let path = Path::new("m.toml");
        let fitted = file(&report.edit.apply(text, path).expect("sections"));
        let tool = fitted.volume.tool;
        let dz =
            |y| trueup_machine::model::volumetric_error_um(&fitted, tool, [x, y, 0.0], [0.0; 3])[2];
        (dz(300.0) - dz(0.0), report.warnings)
    };
    // 150 mm beyond, the line alone goes on: 13.5 µrad at 300 mm.
    let (at_end, _) = roll_um(&with_travel, 450.0);
    let (beyond, warnings) = roll_um(&with_travel, 600.0);
    assert!((beyond - at_end - 4.05).abs() < 0.02, "{at_end} µm, {beyond} µm beyond");
    assert!(!warnings.iter().any(|warning| warning.contains("was a line")), "{warnings:?}");
    let (_, warnings) = roll_um(&text(""), 600.0);
    let message = "angular.eax was a line and is a curve now: below x 150 mm and above 450 mm";
    assert!(warnings.iter().any(|warning| warning.contains(message)), "{warnings:?}");
}

#[test]
fn two_gauges_on_one_edge_claim_no_straightness_of_its_form() {
    let believed = file("[machine]\nname = \"m\"\nkind = \"3-axis\"\nchain = \"w b X Y Z t\"\n");
    let options = VolumeFitOptions { instrument_um: Some(0.1), ..VolumeFitOptions::default() };
    let text: String = edge(6.0, 0.0, false)
        .lines()
        .map(|line| match line.rsplit_once(',') {
            Some((row, "measured_dz_um")) => format!("{row},measured_dy_um,measured_dz_um\n"),
            Some((row, um)) => format!("{row},{um},{um}\n"),
            None => String::new(),
        })
        .collect();
    let report = fit(&text, &believed, &options);
    for name in ["EYX", "EZX"] {
        assert!(!of(&report, name).is_known, "{:?}", of(&report, name));
    }
}

#[test]
fn what_cannot_be_fitted_is_refused_with_what_to_do() {
    let mut machine = Drawn::of_size(0, 1.0);
    let at = At { mm: [10.0; 3], deg: [0.0; 3], tool_mm: machine.tools_mm[0] };
    let mut balls = Balls::new(&mut machine);
    balls.probe(&mut machine, &at);
    let refused = |text: &str, machine: &Machine| -> InputFileError {
        volume::fit(&[run(text)], machine, &STATED).expect_err("refused")
    };
    let few = refused(&balls.csv(), &file(&machine.file)).to_string();
    assert!(few.contains("3 readings") && few.contains("24 are needed"), "{few}");
    let bare = file("[machine]\nname = \"m\"\nkind = \"3-axis\"\n");
    assert!(
        refused("x_mm,y_mm,z_mm,measured_dx_um\n1,2,3,4\n", &bare)
            .to_string()
            .contains("machine.chain is missing")
    );
    let same = "x_mm,y_mm,z_mm,measured_diagonal_um\n1,2,3,4\n5,6,7,8\n1,2,3,4\n";
    let same = refused(same, &file(&machine.file)).to_string();
    assert!(same.contains("number in the column setup"), "{same}");
}
