//! Programs of a lathe: X and Z alone, each only in a range; X is a diameter in the text and a radius elsewhere.

use std::path::Path;

use trueup_machine::{Machine, MachineFile, machine_file::LinearAxis};
use trueup_program::{
    Control, MeasurementKind, MeasurementOptions, MeasurementPlan, control, create_plans, template,
};

fn lathe() -> Machine {
    let text = "[machine]\nname = \"l\"\nkind = \"lathe\"\n[axis.x]\ntravel_mm = [0.0, 140.0]\n\
                [axis.y]\ntravel_mm = [-40.0, 40.0]\n[axis.z]\ntravel_mm = [-500.0, 0.0]\n";
    MachineFile::parse(text, Path::new("l.toml")).expect("the test's own file")
}

fn ranges() -> MeasurementOptions {
    MeasurementOptions {
        range_mm: [Some([60.0, 120.0]), None, Some([-300.0, -50.0])],
        spindle_rpm: Some(1500.0),
        ..MeasurementOptions::default()
    }
}

fn of(kind: MeasurementKind) -> Vec<MeasurementPlan> {
    create_plans(kind, &lathe(), &ranges()).expect("it fits").0
}

/// Returns the lines of a program that are no comments and no messages.
fn blocks(text: &str) -> Vec<&str> {
    let is_block = |line: &&str| {
        !line.is_empty() && !line.starts_with(['(', ';', '%']) && !line.starts_with("MSG")
    };
    text.lines().map(str::trim).filter(is_block).collect()
}

#[test]
fn no_program_moves_y_and_x_is_written_as_a_diameter() {
    for kind in [
        MeasurementKind::Backlash,
        MeasurementKind::Pitch,
        MeasurementKind::Straightness,
        MeasurementKind::AxisHeat,
        MeasurementKind::Warmup,
    ] {
        for plan in of(kind) {
            assert!(plan.extent_mm()[1].is_none(), "{kind:?}");
            for (which, mode) in [(Control::LinuxCnc, "G7"), (Control::Siemens, "DIAMON")] {
                let (name, text) = control::generate_program(&plan, which).expect("it is written");
                assert!(text.contains(mode), "{name}: {text}");
                let blocks = blocks(&text);
                assert!(blocks.iter().all(|block| !block.contains('Y')), "{name}: {text}");
                let x: Vec<f64> = blocks
                    .iter()
                    .filter_map(|block| {
                        block.split_whitespace().find_map(|word| word.strip_prefix('X'))
                    })
                    .map(|number| number.parse().expect("a number"))
                    .collect();
                // Radii are 60 to 120 mm.
                assert!(x.iter().all(|mm| (120.0..=240.0).contains(mm)), "{name}: {x:?}");
                assert!(!name.ends_with("_x.ngc") || !x.is_empty(), "{name}");
            }
            let rows = template::run_file_templates(&plan)[0].1.clone();
            if let Some([low, high]) = plan.extent_mm()[0] {
                assert!(low >= 60.0 && high <= 120.0 && rows.contains("x_mm"), "{rows}");
                let stop = plan.first_stop_instructions().join(" ");
                assert!(stop.contains("(diameter") && !stop.contains('Y'), "{stop}");
            }
        }
    }
}

#[test]
fn both_axes_lead_to_the_work_and_move_only_in_a_range_from_its_retracted_end() {
    let why = create_plans(MeasurementKind::Backlash, &lathe(), &MeasurementOptions::default())
        .expect_err("no range")
        .0;
    assert!(why.contains("x leads to the work") && why.contains("z leads to the work"), "{why}");
    for plan in of(MeasurementKind::Pitch) {
        let first = plan.first_stop_instructions().join(" ");
        assert!(
            first.contains("X goes to 120 mm") || first.contains("Z goes to -50 mm"),
            "{first}"
        );
    }
    let y = MeasurementOptions { axes: vec![LinearAxis::Y], ..ranges() };
    assert!(
        create_plans(MeasurementKind::Pitch, &lathe(), &y)
            .expect_err("no Y")
            .0
            .contains("X and Z only")
    );
    assert!(create_plans(MeasurementKind::Diagonal, &lathe(), &ranges()).is_err());
}

#[test]
fn the_gauge_is_between_turret_and_chuck() {
    let notes = of(MeasurementKind::Warmup)[0].notes.join(" ");
    assert!(notes.contains("between turret and chuck") && !notes.contains("test bar"), "{notes}");
    assert!(notes.contains("out of the chuck is positive"), "{notes}");
    let text = control::generate_program(&of(MeasurementKind::Backlash)[0], Control::LinuxCnc)
        .expect("it is written")
        .1;
    assert!(text.contains("Set a dial between turret and chuck"), "{text}");
}

#[test]
fn a_control_whose_words_differ_on_a_lathe_is_refused_with_the_reason() {
    for control in [Control::LinuxCnc, Control::Siemens] {
        assert_eq!(control.check_machine(&lathe()), Ok(()));
    }
    assert!(Control::Fanuc.check_machine(&lathe()).expect_err("G90").0.contains("turning cycle"));
    assert!(Control::Heidenhain.check_machine(&lathe()).is_err());
}
