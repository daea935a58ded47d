//! Angular errors and lines of rotary axes: the board against the model, on drawn machines and in the bridge.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::fmt::Write;

use trueup_core::{
    machine_position::MachinePosition,
    thermal_state::MachineThermalState,
    tip_error::UNLIMITED,
    units::{MicroDegrees, Position},
};
use trueup_machine::{
    decompile::{calibration_changes, decompile_to_toml},
    model::volumetric_error_um,
};

use crate::{gantry::*, rig::*};

/// A chain of each kind, with its other keys of `[machine]`.
const CHAINS: [(&str, &str); 8] = [
    ("w b X Y Z t", "kind = \"3-axis\""),
    ("w X' Y' b Z t", "kind = \"3-axis\""),
    ("w Z' X' Y' b t", "kind = \"3-axis\""),
    ("w C' A' X' b Y Z t", "kind = \"table-table\""),
    ("w C' B' b Z Y X t", "kind = \"table-table\""),
    ("w C' Y' b X Z B t", "kind = \"head-table\"\nhead_axes = [\"b\"]"),
    ("w b X Y Z C A t", "kind = \"head-head\"\nhead_axes = [\"c\", \"a\"]"),
    ("w X' b Z Y A B t", "kind = \"head-head\"\nhead_axes = [\"a\", \"b\"]"),
];

/// Returns a machine with every error of the volume, over ±2 m: curves, slopes, shifts and tilts.
fn drawn((chain, kind): (&str, &str), random: &mut Random) -> String {
    let mut text = format!("[machine]\nname = \"m\"\n{kind}\nchain = \"{chain}\"\n");
    let mut number = |most: f64| random.uniform(-most, most);
    text.push_str("[tool]\n");
    writeln!(text, "length_mm = {:?}", number(150.0) + 150.0).expect("a string");
    writeln!(text, "offset_mm = {:?}", [number(99.0), number(99.0), number(99.0)])
        .expect("a string");
    text.push_str("[angular]\n");
    for axis in ["x", "y", "z"] {
        let point = [number(900.0), number(900.0), number(900.0)];
        writeln!(text, "point_{axis}_mm = {point:?}").expect("a string");
    }
    for axis in ["x", "y", "z"] {
        for about in ["a", "b", "c"] {
            writeln!(text, "[angular.e{about}{axis}]").expect("a string");
            if number(1.0) > 0.0 {
                writeln!(text, "urad_per_m = {:?}", number(60.0)).expect("a string");
            } else {
                let control: Vec<f64> = (0..7).map(|_| number(100.0)).collect();
                let knots = "-2000.0, -2000.0, -2000.0, -2000.0, -700.0, 1.0, 900.0, 2000.0, 2000.0, 2000.0, 2000.0";
                writeln!(text, "order = 4\nknots_mm = [{knots}]\ncontrol_urad = {control:?}")
                    .expect("a string");
            }
        }
    }
    for (axis, along) in [("a", ["y", "z"]), ("b", ["x", "z"]), ("c", ["x", "y"])] {
        if chain.contains(&axis.to_uppercase()) {
            let point = [number(400.0), number(400.0), number(400.0)];
            writeln!(text, "[rotary.{axis}]\npoint_mm = {point:?}").expect("a string");
            for shift in along {
                writeln!(text, "e{shift}o{axis}_um = {:?}", number(80.0)).expect("a string");
            }
            for about in ["a", "b", "c"] {
                writeln!(text, "e{about}o{axis}_urad = {:?}", number(80.0)).expect("a string");
            }
        }
    }
    text + "[limits]\nmax_um = { x = 4000, y = 4000, z = 4000 }\nslew_um_per_s = 10000\n"
}

#[test]
fn the_board_is_within_1_nm_of_every_drawn_volume() {
    const POSES: usize = 4_000;
    let mut worst: f64 = 0.0;
    for (seed, chain) in (0..).zip(CHAINS) {
        let random = &mut Random(seed);
        let (machine, compiled) = compiled(&drawn(chain, random));
        let calibration = compiled.calibration();
        let turning = machine.angle_axes();
        for _ in 0..POSES {
            let mut place = MachinePosition::default();
            let mut position_mm = [0.0; 3];
            for (units, mm) in place.position.iter_mut().zip(&mut position_mm) {
                *units = Position((random.uniform(-2_100.0, 2_100.0) * UNITS_PER_MM) as i32);
                *mm = f64::from(units.0) / UNITS_PER_MM;
            }
            let mut angle_deg = [f64::NAN; 3];
            for (angle, axis) in place.angles.iter_mut().zip(&turning) {
                *angle = MicroDegrees((random.uniform(-180.0, 180.0) * 1e6) as i32);
                angle_deg[axis.index()] = f64::from(angle.0) / 1e6;
            }
            let sums = calibration
                .compute_axis_errors(&MachineThermalState::default(), &place)
                .clamped_sums(UNLIMITED)
                .sums;
            let model = volumetric_error_um(&machine, machine.volume.tool, position_mm, angle_deg);
            for (board, model) in sums.into_iter().zip(model) {
                worst = worst.max((f64::from(board.0) / 256.0 - model * 1_000.0).abs());
            }
        }
    }
    println!("volume: {worst:.4} nm over {} poses", POSES * CHAINS.len());
    assert!(worst <= 1.0, "{worst}");
}

#[test]
fn a_drawn_volume_is_shown_as_a_file_that_compiles_to_it_again() {
    for (seed, chain) in (20..).zip(CHAINS) {
        let (machine, compiled) = compiled(&drawn(chain, &mut Random(seed)));
        let shown = decompile_to_toml(&compiled.calibration());
        let nm =
            shown.largest_difference_nm.unwrap_or_else(|error| panic!("{error}\n{}", shown.toml));
        assert!(nm < 2.0, "{nm} nm");
        let (again, compiled_again) = self::compiled(&shown.toml);
        assert_eq!(again.volume.chain, machine.volume.chain, "{}", shown.toml);
        // Length and offset are one tip on the board, to its 10 nm.
        let tips = [&again, &machine]
            .map(|machine| machine.volume.tool.tip_offset_mm(machine.tool_direction));
        let off_mm = tips[0].iter().zip(tips[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off_mm < 1e-5, "{tips:?}");
        assert_eq!(again.kind, machine.kind);
        let reported = calibration_changes::describe_changes(
            &compiled.calibration(),
            &compiled_again.calibration(),
        );
        let of_volume = reported
            .iter()
            .all(|warning| warning.starts_with("angular") && warning.contains("0.00 µm"));
        assert!(of_volume, "{reported:?}");
    }
}

#[test]
fn the_bridge_takes_an_angle_times_its_lever_back() {
    let sections = "[tool]\nlength_mm = 100\n[angular.ebx]\nurad_per_m = 10\n";
    let text = machine_of("\"3-axis\"\nchain = \"w b X Y Z t\"", sections);
    let (machine, compiled) = compiled(&text);
    let mut rig = Rig::new(&compiled);
    // 10 µrad about Y; the tip is 0.3 m above the guide's point: +3 µm of X.
    rig.position_mm = [1000.0, 0.0, 400.0];
    let situation = at(rig.position_mm);
    assert_signs(&machine, &mut rig, 700, &situation, [3_000.0, 0.0, 0.0]);
    // Only Z moves: the lever does.
    rig.position_mm = [1000.0, 0.0, 600.0];
    let situation = at(rig.position_mm);
    assert_signs(&machine, &mut rig, 700, &situation, [5_000.0, 0.0, 0.0]);
}

#[test]
fn the_bridge_turns_the_errors_with_the_angles_that_the_cnc_sends() {
    let sections = "[tool]\nlength_mm = 100\n[rotary.b]\npoint_mm = [0, 0, 200]\necob_urad = 10\n";
    let text =
        machine_of("\"head-table\"\nhead_axes = [\"b\"]\nchain = \"w C' b X Y Z B t\"", sections);
    let (machine, compiled) = compiled(&text);
    let mut rig = Rig::new(&compiled);
    assert_signs(&machine, &mut rig, 700, &at([0.0; 3]), [0.0; 3]);
    rig.angles_deg = [90.0, 0.0];
    let mut turned = at([0.0; 3]);
    turned.angle_deg = [0.0, 90.0, 0.0];
    assert_signs(&machine, &mut rig, 700, &turned, [0.0, -3_000.0, 0.0]);
    // Of a table in a table the CNC sends both, the one next to the bed first.
    let sections = "[rotary.c]\neyoc_um = 5\n";
    let text = machine_of("\"table-table\"\nchain = \"w C' A' b X Y Z t\"", sections);
    let (machine, compiled) = self::compiled(&text);
    let mut rig = Rig::new(&compiled);
    rig.angles_deg = [90.0, 33.0];
    let mut turned = at([0.0; 3]);
    turned.angle_deg = [90.0, 0.0, 33.0];
    assert_signs(&machine, &mut rig, 700, &turned, [0.0, 0.0, 5_000.0]);
}
