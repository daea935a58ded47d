//! Programs that a virtual machine runs: `program` writes it, the machine measures, and `fit circle` or `fit volume` finds what
//! was put into that machine. The fit does not know where the artefact lies, how it is turned, or the centre of a circle.

use serde_json::Value;
use trueup_twin::{
    axes::{AxesConfig, AxisConfig, AxisName, SimulatedAxes, StraightnessConfig},
    cubic_spline::CubicSpline,
    rigid_bodies::{Body, MovingAxis},
};

use crate::{
    desk::Desk,
    virtual_probe::{Truth, run},
};

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\nchain = \"w b X Y Z t\"\n\
    [tool]\nlength_mm = 100.0\n[axis.x]\ntravel_mm = [0.0, 600.0]\n[axis.y]\ntravel_mm = [0.0, 400.0]\n\
    [axis.z]\ntravel_mm = [-300.0, 0.0]\n";

/// Returns axes without heat: X leans with Y, Y is too short, X has play.
fn axes(x_of_y_um_per_m: f64, y_um_per_m: f64, play_um: f64) -> AxesConfig {
    let plain = AxisConfig { screw_heating_c: 0.0, ..AxisConfig::default() };
    let x = AxisConfig { backlash_um: play_um, ..plain.clone() };
    let y = AxisConfig { pitch_um_per_m: y_um_per_m, ..plain };
    AxesConfig {
        axes: [(AxisName::X, x), (AxisName::Y, y)].into(),
        straightness: vec![StraightnessConfig {
            error: AxisName::X,
            along: AxisName::Y,
            points: CubicSpline::default(),
            um_per_m: x_of_y_um_per_m,
        }],
        ..AxesConfig::default()
    }
}

/// Noise of 0.1 µm.
fn noise_um(of: f64) -> f64 {
    0.15 * ((of * 12.9898).sin() * 43758.5453).fract()
}

/// Returns the cells of a run file by their columns, and its header.
fn rows(text: &str) -> (Vec<&str>, Vec<Vec<&str>>) {
    let mut lines = text.lines().skip_while(|line| line.starts_with('#'));
    let names = lines.next().expect("a header").split(',').collect();
    (names, lines.map(|line| line.split(',').collect()).collect())
}

/// Fills in a circle: the tip goes along the rows, and the instrument reads its distance from a centre that is a little off.
fn circle(
    template: &str,
    axes_of_plane: [&str; 2],
    centre: [f64; 2],
    truth: &AxesConfig,
) -> String {
    let (names, rows) = rows(template);
    let column = |name: &str| names.iter().position(|candidate| *candidate == name);
    let number = |row: &[&str], at: usize| row[at].parse::<f64>().expect("a number");
    let place = |row: &[&str]| {
        let mut mm = [0.0; 3];
        for (n, name) in ["x_mm", "y_mm", "z_mm"].into_iter().enumerate() {
            mm[n] = column(name).map_or(0.0, |at| number(row, at));
        }
        mm
    };
    let [first, second] = axes_of_plane.map(|name| "xyz".find(name).expect("an axis"));
    let mut axes = SimulatedAxes::new(truth, place(&rows[0]), 20.0);
    let mut text = names.join(",") + "\n";
    for (n, row) in rows.iter().enumerate() {
        let mm = place(row);
        if n == 0 || column("dir").is_some_and(|dir| row[dir] != rows[n - 1][dir]) {
            let next = place(&rows[n + 1]);
            axes.step(0.1, [0, 1, 2].map(|axis| 2.0 * mm[axis] - next[axis]), 20.0);
        }
        axes.step(0.1, mm, 20.0);
        let error = axes.error_um();
        let off = [first, second].map(|axis| mm[axis] + error[axis] / 1000.0);
        let radius = (mm[first] - centre[0]).hypot(mm[second] - centre[1]);
        // The pivot is 7 µm and 4 µm off, the bar 11 µm too long.
        let um = ((off[0] - centre[0] - 0.007).hypot(off[1] - centre[1] + 0.004) - radius) * 1000.0;
        text += &format!("{}{:.4}\n", row.join(","), um - 11.0 + noise_um(n as f64));
    }
    text
}

fn json(desk: &Desk, line: &str, code: i32) -> Value {
    serde_json::from_str(&desk.run_expecting(line, code).0).expect("JSON")
}

#[test]
fn a_circle_names_what_the_machine_has() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let (out, _) = desk.run_expecting(
        "program circle --machine m.toml --for siemens --axis x,y --at x=300,y=200,z=-120 -o c",
        0,
    );
    assert!(out.contains("x 150 to 450 mm, y 50 to 350 mm"), "{out}");
    assert!(out.contains("trueup fit circle --run c/circle-xy.csv"), "{out}");
    let truth = axes(60.0, -40.0, 6.0);
    desk.write(
        "c/circle-xy.csv",
        circle(&desk.text("c/circle-xy.csv"), ["x", "y"], [300.0, 200.0], &truth),
    );
    let line = "--json fit circle --run c/circle-xy.csv --machine m.toml -o f.toml";
    let found = json(&desk, line, 0);
    assert_eq!(found["verdict"], "explained", "{found}");
    let of = |cause: &str, name: &str| {
        let findings = found["findings"].as_array().expect("findings");
        let own =
            findings.iter().find(|finding| finding["cause"] == cause && finding["claimed"] == true);
        let own = own.unwrap_or_else(|| panic!("no {cause}: {found}"));
        own["parameters"][name]["value"].as_f64().expect("a number")
    };
    assert_eq!(found["findings"].as_array().expect("findings").len(), 3, "{found}");
    for (cause, name, truth) in [
        ("backlash", "width_um", 6.0),
        ("squareness", "um_per_m", 60.0),
        ("scale-mismatch", "um_per_m", 40.0),
    ] {
        let value = of(cause, name);
        assert!((value - truth).abs() < 0.05 * truth, "{cause}: {value}, and it is {truth}");
    }
    // With where Z stands it is a measurement of the volume as well.
    let line =
        "--json fit volume --run c/circle-xy.csv --machine m.toml -o v.toml --instrument-um 0.1";
    let size = size(&json(&desk, line, 0), "EC0Y");
    assert!((size - 60.0).abs() < 10.0, "{size}");
}

#[test]
fn a_circle_along_the_tool_is_an_arc_over_its_retracted_half() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let line = "program circle --machine m.toml --for linuxcnc --axis x,z --range z=-290:-10 --at x=300,z=-199 --radius 150 -o c";
    let (out, _) = desk.run_expecting(line, 0);
    assert!(out.contains("x 150 to 450 mm"), "{out}");
    let truth = axes(0.0, 0.0, 6.0);
    desk.write(
        "c/circle-zx.csv",
        circle(&desk.text("c/circle-zx.csv"), ["z", "x"], [-199.0, 300.0], &truth),
    );
    let found =
        json(&desk, "--json fit circle --run c/circle-zx.csv --machine m.toml -o f.toml", 0);
    let plane = &found["planes"][0];
    assert_eq!(
        (&plane["plane"], &plane["causes"]),
        (&"zx".into(), &serde_json::json!(["backlash of x"]))
    );
    // More than the circle fits nowhere, and a control without words for it is refused.
    let (_, err) = desk.run_expecting(&line.replace("150 -o", "250 -o"), 2);
    assert!(
        err.contains("a circle of 250 mm would send") && err.contains("smaller --radius"),
        "{err}"
    );
    let (_, err) = desk.run_expecting(&line.replace("linuxcnc", "heidenhain"), 2);
    assert!(err.contains("M91 does not hold"), "{err}");
}

/// Returns the size of an error of `fit volume`.
fn size(found: &Value, name: &str) -> f64 {
    let errors = found["errors"].as_array().expect("errors");
    let own = errors.iter().find(|error| error["error"] == name);
    own.and_then(|finding| finding["size"].as_f64()).unwrap_or_else(|| panic!("no {name}: {found}"))
}

fn is_known(found: &Value, name: &str) -> bool {
    let errors = found["errors"].as_array().expect("errors");
    errors.iter().any(|error| error["error"] == name && error["known"] == true)
}

/// Returns a point turned about Z around a place, by an angle in µrad.
fn turned([x, y, z]: [f64; 3], about: [f64; 3], urad: f64) -> [f64; 3] {
    [x - urad * 1e-6 * (y - about[1]), y + urad * 1e-6 * (x - about[0]), z]
}

#[test]
fn a_square_shows_how_x_leans_with_y_however_it_lies() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let line = "program square --machine m.toml --for linuxcnc --range z=-290:-10 --at x=100,y=80,z=-200 --size 250 --stylus 6 -o s";
    desk.run_expecting(line, 0);
    let program = desk.text("s/square_xyz.ngc");
    let corner = [100.0, 80.0, -300.0];
    for urad in [0.0, 700.0] {
        let truth = Truth { axes: axes(80.0, 0.0, 0.0), bodies: Vec::new() };
        // 0.3 mm from where it was stated to be, and turned.
        let text = run(&program, &truth, 100.0, |tip, _| {
            let [x, y, _] = turned(tip, corner, -urad);
            x + 3.0 > corner[0] + 0.3 && y + 3.0 > corner[1] - 0.2
        });
        desk.write("s/square-xyz.csv", &text);
        let line = "--json fit volume --run s/square-xyz.csv --machine m.toml -o f.toml --instrument-um 0.1";
        let found = json(&desk, line, 0);
        let size = size(&found, "EC0Y");
        assert!((size - 80.0).abs() < 8.0, "{urad} µrad: {size} µm/m; {found}");
        assert!(is_known(&found, "EC0Y"), "{found}");
    }
    // Two faces that are no square say nothing of it.
    let apart = desk.text("s/square-xyz.csv").replace(",square,", ",batch,");
    desk.write("s/apart.csv", apart);
    let found = json(
        &desk,
        "--json fit volume --run s/apart.csv --machine m.toml -o f.toml --instrument-um 0.1",
        3,
    );
    assert!(!is_known(&found, "EC0Y"), "{found}");
    let (_, err) = desk.run_expecting(&line.replace("linuxcnc", "siemens"), 2);
    assert!(err.contains("by the control's own measuring cycles"), "{err}");
    let (_, err) = desk.run_expecting(&line.replace(" --stylus 6", ""), 2);
    assert!(err.contains("give --stylus"), "{err}");
}

/// The readings are how far a ball is off, and neither its radius nor that of the stylus is in them.
fn are_small(text: &str) {
    let (names, rows) = rows(text);
    let measured: Vec<usize> =
        (0..names.len()).filter(|n| names[*n].starts_with("measured_d")).collect();
    for um in rows.iter().flat_map(|row| measured.iter().map(|n| row[*n].parse::<f64>())) {
        assert!(um.expect("a number").abs() < 500.0, "{text}");
    }
}

/// Returns whether the tip is at a ball; both spheres are as wide as stylus and ball together.
fn is_at(tip: [f64; 3], ball: [f64; 3], apart_mm: f64) -> bool {
    (0..3).map(|n| (tip[n] - ball[n]).powi(2)).sum::<f64>() <= apart_mm * apart_mm
}

/// A body of the machine that is right.
fn body(axis: MovingAxis, workpiece: bool) -> Body {
    Body {
        axis,
        workpiece,
        at_mm: [300.0, 200.0, -150.0],
        turn_x: CubicSpline::default(),
        turn_y: CubicSpline::default(),
        turn_z: CubicSpline::default(),
        shift_um: [0.0; 3],
        tilt_urad: [0.0; 3],
    }
}

#[test]
fn a_sphere_at_many_angles_finds_the_line_of_the_table() {
    let file = MACHINE.replace("3-axis", "table-table").replace("w b", "w C' b")
        + "[rotary.c]\npoint_mm = [300.0, 200.0, -400.0]\n";
    let desk = Desk::new(&[("m.toml", &file)]);
    let line = "program sphere --machine m.toml --for linuxcnc --range z=-290:-10 --at x=360,y=240,z=-200 --ball 20 --stylus 6 \
                --angle c=-120,-60,0,60,120,180 --tool-length 100,200 -o s";
    desk.run_expecting(line, 0);
    let mut table = body(MovingAxis::C, true);
    (table.at_mm, table.tilt_urad) = ([300.0, 200.0, -400.0], [40.0, -25.0, 0.0]);
    let mut bodies = vec![table];
    bodies.extend([MovingAxis::X, MovingAxis::Y, MovingAxis::Z].map(|axis| body(axis, false)));
    let truth = Truth { axes: axes(0.0, 0.0, 0.0), bodies };
    let arm = [60.0, 40.0];
    let text = run(&desk.text("s/sphere_xyz.ngc"), &truth, 100.0, |tip, deg| {
        // The table goes the other way than its angle.
        let (sin, cos) = (-deg[2]).to_radians().sin_cos();
        let [u, v] = arm.map(|mm| mm + 0.15);
        let ball = [300.0 + u * cos - v * sin, 200.0 + u * sin + v * cos, -299.9];
        is_at(tip, ball, 13.0)
    });
    are_small(&text);
    desk.write("s/sphere-xyz.csv", &text);
    let line =
        "--json fit volume --run s/sphere-xyz.csv --machine m.toml -o f.toml --instrument-um 0.1";
    let found = json(&desk, line, 0);
    for (name, truth) in [("EAOC", 40.0), ("EBOC", -25.0)] {
        let size = size(&found, name);
        assert!((size - truth).abs() < 4.0, "{name}: {size}");
    }
    assert!(is_known(&found, "EAOC"), "{found}");
    // Where the line passes is not distinguished from where the tip of the stylus is.
    assert!(!is_known(&found, "EXOC") && !is_known(&found, "EYOC"));
}

#[test]
fn a_ball_plate_in_two_heights_with_two_styli_finds_a_roll() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let mut x = body(MovingAxis::X, false);
    // Straight where the plate was in the middle: else its slope there would be a squareness.
    x.at_mm[2] = -300.0;
    // X rolls by 60 µrad over 600 mm, as an S.
    let roll = (0..=12).map(|n| {
        let s = f64::from(n) / 6.0 - 1.0;
        [50.0 * f64::from(n), 30.0 * s + 20.0 * (s * s * s - s)]
    });
    x.turn_x = CubicSpline::from_points(roll.collect()).expect("they rise");
    let bodies = vec![x, body(MovingAxis::Y, false), body(MovingAxis::Z, false)];
    let truth = Truth { axes: axes(50.0, -60.0, 0.0), bodies };
    let mut runs = String::new();
    for (name, z) in [("low", -250.0), ("high", -150.0)] {
        let line = format!(
            "program plate --machine m.toml --for linuxcnc --range z=-290:-2 --at x=60,y=60,z={z} --ball 20 --stylus 6 --step-mm 95 \
             --balls 5x4 --tool-length 100,200 --repeats 1 --search 2 -o {name}"
        );
        desk.run_expecting(&line, 0);
        let first = [60.0, 60.0, z - 100.0];
        let program = desk.text(&format!("{name}/plate_xyz.ngc"));
        let text = run(&program, &truth, 100.0, |tip, _| {
            let tip = turned(tip, first, -300.0);
            // The plate ends with its last ball.
            let near = [0, 1].map(|n| {
                let last = [4.0, 3.0][n];
                first[n] + 95.0 * ((tip[n] - first[n]) / 95.0).round().clamp(0.0, last)
            });
            is_at(tip, [near[0] + 0.2, near[1] - 0.1, first[2] + 0.3], 13.0)
        });
        are_small(&text);
        desk.write(&format!("{name}/plate-xyz.csv"), &text);
        runs += &format!(" --run {name}/plate-xyz.csv");
    }
    let line = format!(
        "--json fit volume{runs} --machine m.toml -o f.toml --instrument-um 0.1 --scale-um-per-m 1"
    );
    let found = json(&desk, &line, 0);
    let of_held_out = |name: &str| found["held_out"][name].as_f64().expect("a number");
    assert!(of_held_out("after_um") < 0.1 * of_held_out("before_um"), "{}", found["held_out"]);
    assert!(is_known(&found, "EC0Y") && is_known(&found, "EAX"), "{found}");
    let size = size(&found, "EC0Y");
    assert!((size - 50.0).abs() < 5.0, "{size}: {found}");
}
