//! The errors of the volume against homogeneous transforms in Python, which share nothing with the model.
//!
//! Machines of every chain and kind are drawn, with all nine angles, errors of both rotary axes, points and
//! tools. The transforms are not linear, the model is: errors are small enough that their products do not show.

use std::{
    fmt::Write as _,
    io::Write as _,
    path::Path,
    process::{Command, Stdio},
};

use anyhow::{Context as _, Result, ensure};
use rand::Rng as _;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng as _};
use serde_json::{Map, Value, json};
use trueup_emulator::setup;
use trueup_machine::{Machine, MachineFile, file::Angle, model::volume_um};
use trueup_twin::{
    bodies::{Body, Drive, error_um},
    cubic_spline::CubicSpline,
};

/// Kind, and the rotary axes of the workpiece, from it to the bed, and of the tool, from the frame.
const KINDS: [(&str, &[&str], &[&str]); 9] = [
    ("3-axis", &[], &[]),
    ("table-table", &["C", "A"], &[]),
    ("table-table", &["C", "B"], &[]),
    ("table-table", &["B"], &[]),
    ("head-table", &["C"], &["B"]),
    ("head-table", &["A"], &["C"]),
    ("head-head", &[], &["C", "A"]),
    ("head-head", &[], &["A", "B"]),
    ("head-head", &[], &["C", "B"]),
];

const POSES: usize = 20;

/// Returns the errors by `host-tests/python/volume.py`.
fn transforms(asked: &[Value]) -> Result<Vec<Vec<[f64; 3]>>> {
    let mut python = Command::new(setup::python()?)
        .arg(setup::root().join("host-tests/python/volume.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    // It reads all before it writes.
    python.stdin.take().context("piped")?.write_all(json!(asked).to_string().as_bytes())?;
    let output = python.wait_with_output()?;
    ensure!(output.status.success(), "volume.py failed");
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn vector(random: &mut ChaCha8Rng, most: f64) -> [f64; 3] {
    std::array::from_fn(|_| random.random_range(-most..most))
}

/// Returns a machine as its file, and as the transforms want it.
fn drawn(random: &mut ChaCha8Rng, number: usize) -> (Machine, Value) {
    let (kind, table, head) = KINDS[number % KINDS.len()];
    let mut linear = ["X", "Y", "Z"];
    linear.rotate_left(random.random_range(0..3));
    if random.random() {
        linear.swap(0, 1);
    }
    let on_workpiece = number / KINDS.len() % 4;
    let mut chain = String::from("w");
    for axis in table.iter().chain(&linear[..on_workpiece]) {
        write!(chain, " {axis}'").expect("a string");
    }
    chain.push_str(" b");
    for axis in linear[on_workpiece..].iter().chain(head) {
        write!(chain, " {axis}").expect("a string");
    }
    chain.push_str(" t");
    let names = |axes: &[&str]| json!(axes).to_string().to_lowercase();
    let mut text = format!(
        "machine = {{ name = \"m\", kind = \"{kind}\", head_axes = {}, chain = \"{chain}\" }}\n",
        names(head)
    );
    let (mut angles, mut points, mut rotary) = (Map::new(), Map::new(), Map::new());
    for axis in ["x", "y", "z"] {
        let point = vector(random, 300.0);
        writeln!(text, "angular.point_{axis}_mm = {point:?}").expect("a string");
        points.insert(axis.into(), json!(point));
        for about in ["a", "b", "c"] {
            let name = format!("e{about}{axis}");
            let angle = if random.random() {
                let urad_per_m = random.random_range(-20.0..20.0);
                writeln!(text, "angular.{name}.urad_per_m = {urad_per_m:?}").expect("a string");
                json!(urad_per_m)
            } else {
                let control: [f64; 5] = std::array::from_fn(|_| random.random_range(-15.0..15.0));
                let knots = [-500.0, -500.0, -500.0, -500.0, 50.0, 500.0, 500.0, 500.0, 500.0];
                let spline = format!("order = 4, knots_mm = {knots:?}, control_urad = {control:?}");
                writeln!(text, "angular.{name} = {{ {spline} }}").expect("a string");
                json!([4, knots, control])
            };
            angles.insert(name, angle);
        }
    }
    for axis in table.iter().chain(head) {
        let own = ["A", "B", "C"].iter().position(|it| it == axis).expect("one of them");
        let axis = axis.to_lowercase();
        let (point, mut shift, tilt) =
            (vector(random, 250.0), vector(random, 20.0), vector(random, 15.0));
        shift[own] = 0.0;
        writeln!(text, "rotary.{axis}.point_mm = {point:?}").expect("a string");
        for n in (0..3).filter(|n| *n != own) {
            let along = ["x", "y", "z"][n];
            writeln!(text, "rotary.{axis}.e{along}o{axis}_um = {:?}", shift[n]).expect("a string");
        }
        for (about, urad) in ["a", "b", "c"].iter().zip(tilt) {
            writeln!(text, "rotary.{axis}.e{about}o{axis}_urad = {urad:?}").expect("a string");
        }
        rotary.insert(axis, json!({"point": point, "shift": shift, "tilt": tilt}));
    }
    let (length_mm, offset_mm) = (random.random_range(0.0..250.0), vector(random, 50.0));
    writeln!(text, "tool = {{ length_mm = {length_mm:?}, offset_mm = {offset_mm:?} }}")
        .expect("a string");
    let [x, y, z] = offset_mm;
    let poses: Vec<[f64; 6]> = (0..POSES)
        .map(|_| {
            let ([x, y, z], [a, b, c]) = (vector(random, 500.0), vector(random, 180.0));
            [x, y, z, a, b, c]
        })
        .collect();
    let machine = MachineFile::parse(&text, Path::new("m.toml"));
    let machine = machine.unwrap_or_else(|error| panic!("{error}\n{text}"));
    let asked = json!({
        "chain": chain, "angles": angles, "points": points, "rotary": rotary,
        "tool": [x, y, z - length_mm], "poses": poses,
    });
    (machine, asked)
}

#[test]
fn the_volume_errs_as_homogeneous_transforms_say() -> Result<()> {
    let mut random = ChaCha8Rng::seed_from_u64(46);
    let (machines, asked): (Vec<Machine>, Vec<Value>) =
        (0..KINDS.len() * 4 * 3).map(|number| drawn(&mut random, number)).unzip();
    let theirs = transforms(&asked)?;
    let (mut worst, mut largest): (f64, f64) = (0.0, 0.0);
    for ((machine, asked), theirs) in machines.iter().zip(&asked).zip(theirs) {
        let poses: Vec<[f64; 6]> = serde_json::from_value(asked["poses"].clone())?;
        for ([x, y, z, a, b, c], theirs) in poses.into_iter().zip(theirs) {
            let ours = volume_um(machine, [x, y, z], [a, b, c]);
            for (ours, theirs) in ours.into_iter().zip(theirs) {
                largest = largest.max(theirs.abs());
                worst = worst.max((ours - theirs).abs());
                assert!((ours - theirs).abs() <= 0.01, "{ours} against {theirs} of {asked}");
            }
        }
    }
    println!("errors up to {largest:.1} µm, worst difference {worst:.5} µm");
    assert!(largest > 20.0);
    Ok(())
}

/// Returns a machine whose angles are slopes as the virtual one has it: its curves are others than B-splines.
fn bodies(machine: &Machine) -> Vec<Body> {
    const DRIVES: [Drive; 6] = [Drive::X, Drive::Y, Drive::Z, Drive::A, Drive::B, Drive::C];
    let volume = &machine.volume;
    let chain = volume.chain.as_ref().expect("drawn with one");
    let plain = |axis, workpiece, at_mm| Body {
        axis,
        workpiece,
        at_mm,
        turn_x: CubicSpline::default(),
        turn_y: CubicSpline::default(),
        turn_z: CubicSpline::default(),
        shift_um: [0.0; 3],
        tilt_urad: [0.0; 3],
    };
    let linear = chain.linear.iter().map(|axis| {
        let turn = |about: usize| {
            let of = |it: &&trueup_machine::file::Angular| {
                it.along == *axis && it.about.index() == about
            };
            let angle = &volume.angular.iter().find(of).expect("all nine are drawn").angle;
            let Angle::Line(urad_per_m) = angle else { panic!("a curve") };
            let points = [-600.0, 600.0].map(|mm| [mm, urad_per_m * mm / 1000.0]);
            CubicSpline::through(points.to_vec()).expect("they rise")
        };
        let at_mm = volume.point_mm[axis.index()];
        Body {
            turn_x: turn(0),
            turn_y: turn(1),
            turn_z: turn(2),
            ..plain(DRIVES[axis.index()], chain.moves_workpiece(*axis), at_mm)
        }
    });
    let rotary = |axis: &trueup_machine::file::RotaryAxis, workpiece: bool| {
        let known = volume.rotary.iter().find(|it| it.axis == *axis).expect("all are drawn");
        Body {
            shift_um: known.shift_um,
            tilt_urad: known.tilt_urad,
            ..plain(DRIVES[3 + axis.index()], workpiece, known.point_mm)
        }
    };
    let table = chain.table.iter().rev().map(|axis| rotary(axis, true));
    table.chain(linear).chain(chain.head.iter().map(|axis| rotary(axis, false))).collect()
}

#[test]
fn the_virtual_machine_errs_as_the_model_of_it_says() {
    let mut random = ChaCha8Rng::seed_from_u64(47);
    let mut largest: f64 = 0.0;
    for number in 0..KINDS.len() * 4 {
        let (mut machine, asked) = drawn(&mut random, number);
        for angular in &mut machine.volume.angular {
            if matches!(angular.angle, Angle::Curve(_)) {
                angular.angle = Angle::Line(random.random_range(-20.0..20.0));
            }
        }
        let bodies = bodies(&machine);
        let tip_mm = machine.volume.tool.tip_mm(machine.tool_direction);
        let poses: Vec<[f64; 6]> = serde_json::from_value(asked["poses"].clone()).expect("drawn");
        for [x, y, z, a, b, c] in poses {
            let model = volume_um(&machine, [x, y, z], [a, b, c]);
            let truth = error_um(&bodies, tip_mm, [x, y, z], [a, b, c]);
            for (model, truth) in model.into_iter().zip(truth) {
                largest = largest.max(truth.abs());
                assert!((model - truth).abs() <= 0.01, "{model} against {truth} of {asked}");
            }
        }
    }
    assert!(largest > 20.0);
}
