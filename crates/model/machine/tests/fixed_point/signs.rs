//! Signs, held to what the hand finds from `docs/physics.md`.

use std::fmt::Write;

use trueup_core::{
    cnc::TravelDirection,
    units::{MicroDegrees, Nanometres, SensorReading},
};
use trueup_machine::model::{ReferenceModel, RowInputs};

use crate::{gantry::*, rig::*};

#[test]
fn growth_seen_by_the_sensor_is_an_error_downwards_and_an_offset_upwards() {
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", PAPERS_SENSOR));
    let mut rig = Rig::new(&compiled);
    // 4096 counts above zero: 62.5 µm of growth.
    rig.counts = 9_144;
    let situation = RowInputs { sensor_counts: 9_144.0, ..at([0.0; 3]) };
    assert_signs(&machine, &mut rig, 500, &situation, [0.0, 0.0, -62_500.0]);
    let law = compiled.calibration().spindle.sensor;
    assert_eq!(law.elongation(SensorReading(9_144 * 128)), Nanometres(62_500));
}

#[test]
fn a_spindle_warmer_than_its_reference_is_lifted() {
    let sections = "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\n\
                    sensor = \"temp_x_c\"\nreference_c = 20\nk_um_per_c = 2\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    rig.heat_to(2, 25.5);
    let situation = RowInputs { temperatures_c: &[("temp_x_c", 25.5)], ..at([0.0; 3]) };
    assert_signs(&machine, &mut rig, 500, &situation, [0.0, 0.0, -11_000.0]);
}

#[test]
fn a_spindle_that_has_run_warm_is_lifted() {
    let sections = "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 1\nwarm_s = 5\n\
                    max_um = 80\nexponent = 4\n";
    // No [inputs]: neither a sensor nor a thermometer is needed.
    let alone = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[limits]\nmax_um = { z = 4000 }\n";
    let (machine, compiled) = compiled(&format!("{alone}{sections}"));
    let mut rig = Rig::new(&compiled);
    let mut reference = ReferenceModel::new(&machine);
    let row = |time_s| RowInputs { time_s: Some(time_s), ..at([0.0; 3]) };
    assert_eq!(reference.step(&row(0.0)).error_um(), [0.0; 3]);
    assert_eq!(reference.step(&row(6.0)).error_um(), [0.0, 0.0, -80.0]);
    assert_eq!(rig.offset_nm(800), [0; 3]);
    assert_eq!(rig.offset_nm(5_400), [0, 0, 80_000]);
}

#[test]
fn the_papers_axis_has_gone_270_um_too_far_and_is_taken_back() {
    let sections = "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_x_c\"\n\
                    reference_c = 23\nslope_um_per_m_per_c = 14.21\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    for (celsius, metres, nm) in
        [(42.0, 1.0, 269_990.0), (23.0, 1.0, 0.0), (22.0, 1.0, -14_210.0), (42.0, -0.5, -134_995.0)]
    {
        // A start each: an axis that warms by 19 K at once is not believed.
        let mut rig = Rig::new(&compiled);
        rig.heat_to(2, celsius);
        rig.position_mm[0] = metres * 1_000.0;
        let temperatures = [("temp_x_c", celsius)];
        let situation =
            RowInputs { temperatures_c: &temperatures, ..at([metres * 1_000.0, 0.0, 0.0]) };
        assert_signs(&machine, &mut rig, 800, &situation, [nm, 0.0, 0.0]);
    }
}

#[test]
fn an_axis_that_falls_short_is_sent_further() {
    // The example of 10 mm commanded and 9 moved, a hundredth of it: 10 µm short.
    let sections = "[axis.y.pitch]\nstart_mm = 0\nstep_mm = 10\nforward_um = [0, -10]\n\
                    reverse_um = [3, -7]\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    for (mm, direction, nm) in [
        (10.0, 1.0, -10_000.0),
        (2.5, 1.0, -2_500.0),
        (10.0, -1.0, -7_000.0),
        (-4.0, -1.0, 3_000.0),
    ] {
        rig.position_mm[1] = mm;
        rig.heading[1] =
            if direction < 0.0 { TravelDirection::Negative } else { TravelDirection::Positive };
        let situation = RowInputs { direction: [1.0, direction, 1.0], ..at([0.0, mm, 0.0]) };
        assert_signs(&machine, &mut rig, 10, &situation, [0.0, nm, 0.0]);
    }
}

#[test]
fn backlash_is_an_error_of_the_negative_approach_alone() {
    for width_um in [4.0, -2.5] {
        let sections = format!("[axis.x.backlash]\nwidth_um = {width_um:?}\n");
        let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
        let mut rig = Rig::new(&compiled);
        for (mm, direction) in [(0.0, 1.0), (-1.0, -1.0), (5.0, 1.0), (4.0, -1.0)] {
            rig.position_mm[0] = mm;
            rig.heading[0] =
                if direction < 0.0 { TravelDirection::Negative } else { TravelDirection::Positive };
            let error = if direction < 0.0 { width_um * 1_000.0 } else { 0.0 };
            let situation = RowInputs { direction: [direction, 1.0, 1.0], ..at([mm, 0.0, 0.0]) };
            assert_signs(&machine, &mut rig, 10, &situation, [error, 0.0, 0.0]);
        }
    }
}

#[test]
fn on_a_reversal_the_axis_moves_by_the_backlash_further_and_the_table_arrives() {
    // A nut with 50 µm of play: the motor takes up the play before the table follows.
    const PLAY_UM: f64 = 50.0;
    let sections = format!("[axis.x.backlash]\nwidth_um = {PLAY_UM:?}\n");
    let (_, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
    let mut rig = Rig::new(&compiled);
    let (mut motor_um, mut table_um, mut uncorrected_um) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut before = (0.0, 1.0);
    for (mm, direction) in [(10.0, 1.0), (4.0, -1.0), (1.0, -1.0), (3.0, 1.0), (-2.0, -1.0)] {
        rig.position_mm[0] = mm;
        rig.heading[0] =
            if direction < 0.0 { TravelDirection::Negative } else { TravelDirection::Positive };
        let command_um = 1_000.0 * mm;
        let sent_um = command_um + f64::from(rig.offset_nm(10)[0]) / 1_000.0;
        let further_um = if direction == before.1 { 0.0 } else { PLAY_UM };
        let moved_um = (sent_um - motor_um).abs() - (command_um - before.0).abs();
        assert!((moved_um - further_um).abs() < 1e-3, "{mm} mm: {moved_um} µm further");
        let follow = |table_um: f64, motor_um: f64| table_um.clamp(motor_um, motor_um + PLAY_UM);
        (motor_um, before) = (sent_um, (command_um, direction));
        table_um = follow(table_um, sent_um);
        uncorrected_um = follow(uncorrected_um, command_um);
        let behind_um = if direction < 0.0 { PLAY_UM } else { 0.0 };
        assert_eq!(uncorrected_um - command_um, behind_um, "without the correction");
        assert!((table_um - command_um).abs() < 1e-3, "{mm} mm: the table is at {table_um} µm");
    }
}

#[test]
fn straightness_adds_up_across_the_axes() {
    // Each a straight line from 0 at 0 to this many µm at 100 mm.
    let curves = [
        ("x_of_y", 1),
        ("x_of_z", 2),
        ("y_of_x", 4),
        ("y_of_z", 8),
        ("z_of_x", 16),
        ("z_of_y", 32),
    ];
    let mut sections = String::new();
    for (name, um) in curves {
        writeln!(
            sections,
            "[straightness.{name}]\norder = 2\nknots_mm = [0, 0, 100, 100]\ncontrol_um = [0, {um}]"
        )
        .unwrap();
    }
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
    let mut rig = Rig::new(&compiled);
    for (position, error_nm) in [
        ([100.0, 0.0, 0.0], [0.0, 4_000.0, 16_000.0]),
        ([0.0, 100.0, 0.0], [1_000.0, 0.0, 32_000.0]),
        ([0.0, 0.0, 100.0], [2_000.0, 8_000.0, 0.0]),
        // Outside, the ends are held.
        ([50.0, 150.0, 25.0], [1_500.0, 4_000.0, 40_000.0]),
        ([-9.0, -9.0, -9.0], [0.0; 3]),
    ] {
        rig.position_mm = position;
        assert_signs(&machine, &mut rig, 10, &at(position), error_nm);
    }
}

#[test]
fn squareness_is_the_error_of_the_first_axis_over_a_metre_of_the_second() {
    let sections = "[squareness]\nx_of_y_um_per_m = 12\nz_of_x_um_per_m = -30\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    let position = [2_000.0, -500.0, 700.0];
    rig.position_mm = position;
    assert_signs(&machine, &mut rig, 10, &at(position), [-6_000.0, 0.0, -60_000.0]);
}

#[test]
fn a_tilted_head_takes_half_a_millimetre_to_y_and_z() {
    // 0.5 mm at once: k0 stands for the growth.
    let sections = PAPERS_SENSOR.replace("k0_um = 0.0", "k0_um = 500.0");
    let kind = "\"head-head\"\nhead_axes = [\"c\", \"a\"]";
    let (machine, compiled) = compiled(&machine_of(kind, &sections));
    let mut rig = Rig::new(&compiled);
    let calibration = compiled.calibration();
    for (c, a, error_nm) in [
        (0.0, 30.0, [0.0, 250_000.0, -433_012.7]),
        (90.0, 30.0, [-250_000.0, 0.0, -433_012.7]),
        (0.0, -30.0, [0.0, -250_000.0, -433_012.7]),
        (180.0, 90.0, [0.0, -500_000.0, 0.0]),
    ] {
        rig.angles_deg = [c, a];
        let situation =
            RowInputs { sensor_counts: 5_048.0, angle_deg: [a, f64::NAN, c], ..at([0.0; 3]) };
        assert_signs(&machine, &mut rig, 800, &situation, error_nm);
        let angles = [c, a].map(|degrees| MicroDegrees((degrees * 1e6) as i32));
        let error =
            calibration.kinematics.tool_direction(angles).project_elongation(Nanometres(500_000));
        assert_eq!(error.map(|nm| f64::from(nm.0)), error_nm.map(f64::round));
    }
}

#[test]
fn two_drives_share_their_errors_across_the_beam() {
    for (first, second, y) in [(0.0, 3_000.0, 750.0), (3_000.0, 0.0, 2_250.0)] {
        let sections = format!(
            "[axis.x.pitch]\nstart_mm = 0\nstep_mm = 100\nforward_um = [4, 4]\n[axis.x.dual]\n\
             across = \"y\"\nfirst_mm = {first:?}\nsecond_mm = {second:?}\n\
             pitch = {{ start_mm = 0, step_mm = 100, forward_um = [8, 8] }}\n"
        );
        let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
        let mut rig = Rig::new(&compiled);
        // A quarter of the way: 3/4 · 4 + 1/4 · 8; held beyond both drives.
        for (y, nm) in [(y, 5_000.0), (first, 4_000.0), (second, 8_000.0)] {
            rig.position_mm = [50.0, y, 0.0];
            assert_signs(&machine, &mut rig, 10, &at([50.0, y, 0.0]), [nm, 0.0, 0.0]);
        }
        let (beyond_mm, nm) = if second > first { (3_500.0, 8_000.0) } else { (3_500.0, 4_000.0) };
        rig.position_mm = [50.0, beyond_mm, 0.0];
        assert_signs(&machine, &mut rig, 10, &at([50.0, beyond_mm, 0.0]), [nm, 0.0, 0.0]);
    }
}

// Where the paper contradicts itself.
