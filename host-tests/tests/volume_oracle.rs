//! The errors of the volume against homogeneous transforms in Python, which share nothing with the model.
//!
//! Machines of every chain and kind are drawn, with all 21 errors of three axes (pitch tables, straightness, squareness, nine
//! angles), errors of both rotary axes, points and tools. The transforms are not linear, the model is: errors are small enough that their products do not show.

use std::{
    fmt::Write as _,
    io::{BufRead as _, BufReader, Write as _},
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
};

use anyhow::{Context as _, Result, ensure};
use rand::Rng as _;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng as _};
use serde_json::{Map, Value, json};
use trueup_core::{
    calibration::Calibration,
    machine_position::MachinePosition,
    thermal_state::MachineThermalState,
    tip_error::UNLIMITED,
    units::{MicroDegrees, Position},
};
use trueup_emulator::setup;
use trueup_machine::{
    Machine, MachineFile,
    compile::compile,
    machine_file::AngleProfile,
    model::{ReferenceModel, RowInputs, volumetric_error_um},
};
use trueup_twin::{
    cubic_spline::CubicSpline,
    rigid_bodies::{Body, MovingAxis, error_um},
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

/// Each kind with none to three linear axes under the workpiece, three times.
const MACHINES: usize = KINDS.len() * 4 * 3;
const POSES: usize = 20;
/// The target: the board against the transforms, in nm.
const MAX_OF_BOARD_NM: f64 = 20.0;
/// What offsets may leave on the workpiece, in µm: they are computed where the axes would stand without them.
const MAX_LEFT_UM: f64 = 0.02;

/// `host-tests/python/volume.py`: a machine and its poses in, the errors at them out.
struct Transforms {
    python: Child,
    answers: BufReader<ChildStdout>,
}

impl Transforms {
    fn new() -> Result<Self> {
        let mut python = Command::new(setup::ensure_python()?)
            .arg(setup::project_root().join("host-tests/python/volume.py"))
            // Its matrices are small: threads for one of them only wait for each other.
            .env("OPENBLAS_NUM_THREADS", "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let answers = BufReader::new(python.stdout.take().context("piped")?);
        Ok(Self { python, answers })
    }

    /// Returns the errors of a machine at its poses, in µm.
    fn errors_um(&mut self, request: &Value) -> Result<Vec<[f64; 3]>> {
        // It reads the whole line before it answers.
        writeln!(self.python.stdin.as_mut().context("piped")?, "{request}")?;
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        ensure!(!line.is_empty(), "volume.py failed");
        Ok(serde_json::from_str(&line)?)
    }
}

impl Drop for Transforms {
    fn drop(&mut self) {
        // The end of its input ends it.
        drop(self.python.stdin.take());
        self.python.wait().ok();
    }
}

fn vector(random: &mut ChaCha8Rng, most: f64) -> [f64; 3] {
    std::array::from_fn(|_| random.random_range(-most..most))
}

/// The clamped knots of a drawn curve, in mm; it has as many control points as [`curve`] draws.
const KNOTS_MM: [f64; 9] = [-500.0, -500.0, -500.0, -500.0, 50.0, 500.0, 500.0, 500.0, 500.0];

fn curve(random: &mut ChaCha8Rng, most: f64) -> [f64; 5] {
    std::array::from_fn(|_| random.random_range(-most..most))
}

/// Draws pitch, straightness and squareness of all axes: into the file's `text`, and as the transforms want them.
fn shifts(random: &mut ChaCha8Rng, text: &mut String) -> Map<String, Value> {
    const AXES: [&str; 3] = ["x", "y", "z"];
    let mut shifts = Map::new();
    for axis in AXES {
        let (start_mm, step_mm, table) = (-400.0, 160.0, curve(random, 15.0).as_slice().to_vec());
        writeln!(
            text,
            "axis.{axis}.pitch = {{ start_mm = {start_mm:?}, step_mm = {step_mm:?}, forward_um = {table:?} }}"
        )
        .expect("a string");
        let law = json!([{"start": start_mm, "step": step_mm, "values": table}]);
        shifts.insert(format!("e{axis}{axis}"), law);
        for across in AXES.into_iter().filter(|other| *other != axis) {
            let (control, um_per_m) = (curve(random, 15.0), random.random_range(-20.0..20.0));
            let spline = format!("order = 4, knots_mm = {KNOTS_MM:?}, control_um = {control:?}");
            writeln!(text, "straightness.{across}_of_{axis} = {{ {spline} }}").expect("a string");
            writeln!(text, "squareness.{across}_of_{axis}_um_per_m = {um_per_m:?}")
                .expect("a string");
            shifts.insert(format!("e{across}{axis}"), json!([[4, KNOTS_MM, control], um_per_m]));
        }
    }
    shifts
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
                let control = curve(random, 15.0);
                let spline =
                    format!("order = 4, knots_mm = {KNOTS_MM:?}, control_urad = {control:?}");
                writeln!(text, "angular.{name} = {{ {spline} }}").expect("a string");
                json!([4, KNOTS_MM, control])
            };
            angles.insert(name, angle);
        }
    }
    let shifts = shifts(random, &mut text);
    for axis in table.iter().chain(head) {
        let own =
            ["A", "B", "C"].iter().position(|candidate| candidate == axis).expect("one of them");
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
    let request = json!({
        "chain": chain, "angles": angles, "shifts": shifts, "points": points, "rotary": rotary,
        "tool": [x, y, z - length_mm], "poses": poses,
    });
    (machine, request)
}

/// Returns the errors by the model at a pose in mm and degrees, in µm.
fn of_model_um(machine: &Machine, [x, y, z, a, b, c]: [f64; 6]) -> [f64; 3] {
    let situation = RowInputs {
        position_mm: [x, y, z],
        angle_deg: [a, b, c],
        direction: [1.0; 3],
        ..RowInputs::UNKNOWN
    };
    ReferenceModel::new(machine).step(&situation).error_um()
}

#[test]
fn the_volume_errs_as_homogeneous_transforms_say() -> Result<()> {
    let mut random = ChaCha8Rng::seed_from_u64(46);
    let mut transforms = Transforms::new()?;
    let (mut worst, mut largest): (f64, f64) = (0.0, 0.0);
    for number in 0..MACHINES {
        let (machine, request) = drawn(&mut random, number);
        let poses: Vec<[f64; 6]> = serde_json::from_value(request["poses"].clone())?;
        let theirs = transforms.errors_um(&request)?;
        ensure!(theirs.len() == poses.len(), "{} answers", theirs.len());
        for (pose, theirs) in poses.into_iter().zip(theirs) {
            let ours = of_model_um(&machine, pose);
            for (ours, theirs) in ours.into_iter().zip(theirs) {
                largest = largest.max(theirs.abs());
                worst = worst.max((ours - theirs).abs());
                assert!((ours - theirs).abs() <= 0.01, "{ours} against {theirs} of {request}");
            }
        }
    }
    println!("errors up to {largest:.1} µm, worst difference {worst:.5} µm");
    assert!(largest > 20.0);
    Ok(())
}

/// Returns the errors of a board with this calibration at a pose in its own units, in nm.
fn of_board_nm(calibration: &Calibration<'_>, place: &MachinePosition) -> [f64; 3] {
    let sums = calibration
        .compute_axis_errors(&MachineThermalState::default(), place)
        .clamped_sums(UNLIMITED)
        .sums;
    sums.map(|sum| f64::from(sum.0) / 256.0)
}

/// Draws poses that a board can be sent, in its own units, and the same in mm and degrees.
fn board_poses(
    random: &mut ChaCha8Rng,
    machine: &Machine,
    count: usize,
) -> (Vec<MachinePosition>, Vec<[f64; 6]>) {
    let turning = machine.angle_axes();
    let drawn = (0..count).map(|_| {
        let mut place = MachinePosition::default();
        let mut pose = [0.0; 6];
        for (units, mm) in place.position.iter_mut().zip(&mut pose) {
            let per_mm = f64::from(Position::PER_MILLIMETRE);
            *units = Position((random.random_range(-500.0..500.0) * per_mm) as i32);
            *mm = f64::from(units.0) / per_mm;
        }
        for (angle, axis) in place.angles.iter_mut().zip(&turning) {
            *angle = MicroDegrees(random.random_range(-180_000_000..180_000_000));
            pose[3 + axis.index()] = f64::from(angle.0) / 1e6;
        }
        (place, pose)
    });
    drawn.unzip()
}

/// Returns the offsets of a board with the calibration of `machine` at these places, in µm.
fn offsets_um(machine: &Machine, places: &[MachinePosition]) -> Result<Vec<[f64; 3]>> {
    let compiled = compile(machine)?;
    let calibration = compiled.calibration();
    let offset = |place| of_board_nm(&calibration, place).map(|nm| -nm / 1_000.0);
    Ok(places.iter().map(offset).collect())
}

/// Returns the longest of the errors, in µm.
fn longest_um(errors_um: &[[f64; 3]]) -> f64 {
    let lengths = errors_um.iter().map(|error| error.iter().map(|um| um * um).sum::<f64>().sqrt());
    lengths.fold(0.0, f64::max)
}

/// The tip is where it should be on the workpiece: with a head that turns the tool, and with a table that turns the
/// workpiece, whatever its place there. A correction for another tool leaves what the angles make of the difference.
#[test]
fn with_the_offsets_of_the_board_the_tip_is_right_on_the_workpiece() -> Result<()> {
    let mut random = ChaCha8Rng::seed_from_u64(49);
    let mut transforms = Transforms::new()?;
    let (mut without, mut left, mut shorter_tool, mut elsewhere) = (0.0, 0.0, 0.0, 0.0);
    for number in 0..MACHINES {
        let (mut machine, mut request) = drawn(&mut random, number);
        let (places, poses) = board_poses(&mut random, &machine, POSES);
        request["poses"] = json!(poses);
        let mut left_um = |request: &Value, offsets: &[[f64; 3]]| -> Result<f64> {
            let mut request = request.clone();
            request["offsets"] = json!(offsets);
            Ok(longest_um(&transforms.errors_um(&request)?))
        };
        without = left_um(&request, &[[0.0; 3]; POSES])?.max(without);
        left = left_um(&request, &offsets_um(&machine, &places)?)?.max(left);

        let mut other = machine.clone();
        other.volume.tool.length_mm += 100.0;
        shorter_tool = left_um(&request, &offsets_um(&other, &places)?)?.max(shorter_tool);

        let chain = machine.volume.chain.as_ref().expect("drawn with one");
        if !chain.table.is_empty() {
            // Lines of rotary axes alone, those of the table: their errors depend on the place on it.
            let of_table = chain.table.clone();
            machine.volume.angular.clear();
            for line in machine
                .volume
                .rotary
                .iter_mut()
                .filter(|location| !of_table.contains(&location.axis))
            {
                (line.shift_um, line.tilt_urad) = ([0.0; 3], [0.0; 3]);
            }
            (machine.straightness, machine.squareness) = (Vec::new(), Vec::new());
            machine.axes.iter_mut().for_each(|axis| axis.pitch = None);
            (request["angles"], request["shifts"]) = (json!({}), json!({}));
            let lines = request["rotary"].as_object_mut().expect("a map");
            for (axis, it) in lines {
                if !of_table.iter().any(|table| table.name() == axis) {
                    *it = json!({"point": it["point"]});
                }
            }
            left = left_um(&request, &offsets_um(&machine, &places)?)?.max(left);
            let mut moved = places.clone();
            for place in &mut moved {
                place.position[0].0 += 100 * Position::PER_MILLIMETRE;
            }
            elsewhere = left_um(&request, &offsets_um(&machine, &moved)?)?.max(elsewhere);
        }
    }
    println!(
        "µm on the workpiece: {without:.1} without offsets, {left:.4} with; {shorter_tool:.1} with those for a tool that is \
         100 mm longer, {elsewhere:.1} with those for a place that is 100 mm farther on the table"
    );
    assert!(without > 20.0 && shorter_tool > 1.0 && elsewhere > 1.0);
    assert!(left <= MAX_LEFT_UM, "{left} µm");
    Ok(())
}

#[test]
#[ignore = "campaign: cargo xtask volume-board"]
fn campaign_the_board_is_within_20_nm_of_homogeneous_transforms() -> Result<()> {
    let expected = std::env::var("TRUEUP_POSES").ok().and_then(|text| text.parse().ok());
    let each = expected.unwrap_or(1_000_000_usize).div_ceil(MACHINES);
    let mut random = ChaCha8Rng::seed_from_u64(48);
    let mut transforms = Transforms::new()?;
    let (mut worst_nm, mut of_model_nm, mut largest_nm): (f64, f64, f64) = (0.0, 0.0, 0.0);
    let mut squares = 0.0;
    for number in 0..MACHINES {
        let (machine, mut request) = drawn(&mut random, number);
        let compiled = compile(&machine)?;
        let calibration = compiled.calibration();
        let (places, poses) = board_poses(&mut random, &machine, each);
        request["poses"] = json!(poses);
        let theirs = transforms.errors_um(&request)?;
        ensure!(theirs.len() == each, "{} answers", theirs.len());
        for ((place, pose), theirs) in places.iter().zip(poses).zip(theirs) {
            let board = of_board_nm(&calibration, place);
            let model = of_model_um(&machine, pose);
            for ((board, model), theirs) in board.into_iter().zip(model).zip(theirs) {
                let theirs = theirs * 1_000.0;
                largest_nm = largest_nm.max(theirs.abs());
                of_model_nm = of_model_nm.max((model * 1_000.0 - theirs).abs());
                worst_nm = worst_nm.max((board - theirs).abs());
                squares += (board - theirs).powi(2);
            }
        }
    }
    let count = each * MACHINES;
    println!(
        "{count} poses of {MACHINES} machines, errors up to {:.1} µm; board against transforms: worst {worst_nm:.2} nm, RMS \
         {:.3} nm; model against transforms: worst {of_model_nm:.2} nm",
        largest_nm / 1_000.0,
        (squares / (3 * count) as f64).sqrt()
    );
    assert!(largest_nm > 20_000.0);
    assert!(worst_nm <= MAX_OF_BOARD_NM, "{worst_nm} nm");
    Ok(())
}

/// Returns a machine whose angles are slopes as the virtual one has it: its curves are others than B-splines.
fn bodies(machine: &Machine) -> Vec<Body> {
    const DRIVES: [MovingAxis; 6] =
        [MovingAxis::X, MovingAxis::Y, MovingAxis::Z, MovingAxis::A, MovingAxis::B, MovingAxis::C];
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
            let of = |motion: &&trueup_machine::machine_file::AngularErrorMotion| {
                motion.along == *axis && motion.about.index() == about
            };
            let angle = &volume.angular.iter().find(of).expect("all nine are drawn").angle;
            let AngleProfile::Line(urad_per_m) = angle else { panic!("a curve") };
            let points = [-600.0, 600.0].map(|mm| [mm, urad_per_m * mm / 1000.0]);
            CubicSpline::from_points(points.to_vec()).expect("they rise")
        };
        let at_mm = volume.point_mm[axis.index()];
        Body {
            turn_x: turn(0),
            turn_y: turn(1),
            turn_z: turn(2),
            ..plain(DRIVES[axis.index()], chain.moves_workpiece(*axis), at_mm)
        }
    });
    let rotary = |axis: &trueup_machine::machine_file::RotaryAxis, workpiece: bool| {
        let known =
            volume.rotary.iter().find(|location| location.axis == *axis).expect("all are drawn");
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
        let (mut machine, request) = drawn(&mut random, number);
        for angular in &mut machine.volume.angular {
            if matches!(angular.angle, AngleProfile::Curve(_)) {
                angular.angle = AngleProfile::Line(random.random_range(-20.0..20.0));
            }
        }
        let bodies = bodies(&machine);
        let tip_mm = machine.volume.tool.tip_offset_mm(machine.tool_direction);
        let poses: Vec<[f64; 6]> = serde_json::from_value(request["poses"].clone()).expect("drawn");
        for [x, y, z, a, b, c] in poses {
            let model = volumetric_error_um(&machine, machine.volume.tool, [x, y, z], [a, b, c]);
            let truth = error_um(&bodies, tip_mm, [x, y, z], [a, b, c]);
            for (model, truth) in model.into_iter().zip(truth) {
                largest = largest.max(truth.abs());
                assert!((model - truth).abs() <= 0.01, "{model} against {truth} of {request}");
            }
        }
    }
    assert!(largest > 20.0);
}
