//! LinuxCNC's own interpreter reads the programs: every dwell comes where the run file says that it
//! does, from the side and at the feed that it says.

mod support;

use std::{fs, path::Path, process::Command};

use support::{machine, with_z};
use trueup_machine::MachineFile;
use trueup_program::{
    Control, Gauge, Kind, Options, Plan, Stretch, control, plan::Reading, plans, speeds,
};

/// Where the interpreter says that the machine stands, by axis.
#[derive(Clone, Copy, Default)]
struct Stand {
    mm: [f64; 3],
    direction: [i8; 3],
    feed: f64,
    is_to_be_read: bool,
}

/// Returns what `rs274` makes of a program: where it stands at each dwell with a reading.
fn stands(program: &str) -> Option<Vec<Stand>> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("program.ngc");
    fs::write(&path, program).expect("it is written");
    let done = Command::new("rs274").arg("-g").arg(&path).current_dir(&folder).output();
    let done = match done {
        Ok(done) => done,
        Err(_) => return None,
    };
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{program}\n{said}{}", String::from_utf8_lossy(&done.stderr));
    let (mut now, mut found) = (Stand::default(), Vec::new());
    for line in said.lines() {
        let Some((_, call)) = line.split_once("..... ") else { continue };
        let numbers = || {
            let inside =
                call.split_once('(').and_then(|it| it.1.split_once(')')).unwrap_or_default();
            inside.0.split(", ").map(|number| number.parse::<f64>().expect("a number"))
        };
        if call.starts_with("STRAIGHT_") {
            for (axis, to) in numbers().take(3).enumerate() {
                if to != now.mm[axis] {
                    now.direction[axis] = if to > now.mm[axis] { 1 } else { -1 };
                }
                now.mm[axis] = to;
            }
        } else if call.starts_with("SET_FEED_RATE") {
            now.feed = numbers().next().expect("a feed");
        } else if call.starts_with("COMMENT(\"read\")") {
            now.is_to_be_read = true;
        } else if call.starts_with("DWELL") && now.is_to_be_read {
            found.push(now);
            now.is_to_be_read = false;
        }
    }
    Some(found)
}

fn check(plan: &Plan) -> bool {
    let Some(stands) = stands(&control::program(plan, Control::LinuxCnc).1) else { return false };
    let readings = plan.readings();
    assert_eq!(stands.len(), readings.len(), "{}", plan.name);
    for (n, (stand, reading)) in stands.iter().zip(&readings).enumerate() {
        let Reading { position_mm, direction, feed_mm_per_min, .. } = *reading;
        for axis in 0..3 {
            let Some(mm) = position_mm[axis] else { continue };
            assert!((stand.mm[axis] - mm).abs() < 1e-4, "{} {n}: {reading:?}", plan.name);
            assert_eq!(stand.direction[axis], direction[axis], "{} {n}: {reading:?}", plan.name);
        }
        if let Some(feed) = feed_mm_per_min {
            assert_eq!(stand.feed, feed, "{} {n}", plan.name);
        }
    }
    true
}

#[test]
fn linuxcncs_interpreter_stands_where_the_run_file_says() {
    let kinds = [
        Kind::Backlash,
        Kind::Pitch,
        Kind::Straightness,
        Kind::Warmup,
        Kind::AxisHeat,
        Kind::Diagonal,
    ];
    let stretch = |rpm, load_n| Stretch { rpm, minutes: 4.0, load_n };
    let stretches = [stretch(6000.0, 0.0), stretch(6000.0, 300.0), stretch(0.0, 0.0)];
    let planned = speeds(&stretches, 20.0, &["temp_front_c".into()], "to tell a from b");
    assert_eq!(planned.readings().len(), 37);
    check(&planned);
    // X words are diameters, the interpreter's positions are radii.
    let text = "[machine]\nname = \"l\"\nkind = \"lathe\"\n[axis.x]\ntravel_mm = [0.0, 140.0]\n[axis.z]\n\
                travel_mm = [-500.0, 0.0]\n";
    let lathe = MachineFile::parse(text, Path::new("l.toml")).expect("the test's own file");
    let ranges = Options {
        range_mm: [Some([60.0, 120.0]), None, Some([-300.0, -50.0])],
        ..Options::default()
    };
    for kind in [Kind::Backlash, Kind::Pitch] {
        plans(kind, &lathe, &ranges).expect("it fits").0.iter().for_each(|plan| _ = check(plan));
    }
    for kind in kinds {
        for gauge in [None, Some(Gauge::Dial), Some(Gauge::Laser)] {
            let options = Options { gauge, feeds_mm_per_min: vec![1000.0, 200.0], ..with_z() };
            for plan in plans(kind, &machine(), &options).expect("it fits").0 {
                if !check(&plan) {
                    println!("skipped: LinuxCNC's interpreter (rs274) is not here");
                    return;
                }
            }
        }
    }
}
