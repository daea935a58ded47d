//! Events at a LinuxCNC with offsets at its joints, one after the other.

use std::{
    collections::BTreeMap,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use serde_json::json;
use trueup_emulator::linuxcnc::headless_linuxcnc::HeadlessLinuxCnc;
use trueup_linuxcnc::{
    hal::is_process_alive,
    status::{describe_status, parse},
};

use super::{CYCLE_S, Cycle, MAX_ACCELERATION, NOISE, Rig, SURFACE};

/// A reversal of 6 µm is over within 13 ms of the first cycle in which the component asks for it.
pub(crate) fn reversals(rig: &mut Rig) -> Result<()> {
    for x in [16.0, 10.0, 16.0, 10.0] {
        rig.offsets([x, -20.0, 40.0])?;
        let cycles: Vec<Cycle> = rig.cycles().into_iter().flatten().collect();
        let requested = cycles.windows(2).position(|two| (two[1].goal - two[0].goal).abs() > 0.005);
        let requested = requested.context("the offset was asked for")?;
        let there =
            cycles[requested..].iter().position(|cycle| (cycle.offset[0] * 1e3 - x).abs() < 0.05);
        let took = there.context("the offset is there")?;
        println!("reversal of 6 um: {took} ms");
        assert!(took <= 13, "{took} ms");
    }
    Ok(())
}

/// A program has all of its acceleration.
pub(crate) fn programs(rig: &mut Rig) -> Result<()> {
    // Exact stops: where moves are blended, LinuxCNC gives each half of the acceleration.
    rig.mdi("G61")?;
    rig.mdi("G53 G0 X20 Y20 Z-1")?;
    let seen = rig.check("rapid moves")?;
    assert!(seen.planner_acceleration >= 0.99 * MAX_ACCELERATION, "{seen:?}");
    Ok(())
}

/// An abort stops the program and not the offsets.
pub(crate) fn aborts(rig: &mut Rig) -> Result<()> {
    for um in [[60.0, 0.0, -40.0], [10.0, -20.0, 40.0]] {
        rig.cnc.send_request_with_argument("begin_mdi", "text", "G53 G1 F1500 X-20 Y-20")?;
        rig.bridge.set_offset(um);
        thread::sleep(Duration::from_millis(400));
        rig.cnc.send_request(&json!({"do": "abort"}))?;
        rig.applied(um)?;
        rig.check("abort")?;
        rig.mdi("G53 G0 X20 Y20")?;
    }
    Ok(())
}

/// The offset is held while the machine is off, and goes on from there.
pub(crate) fn power(rig: &mut Rig) -> Result<()> {
    for state in ["estop", "off"] {
        rig.cnc.send_request_with_argument("begin_mdi", "text", "G53 G1 F1500 X-20 Y-20")?;
        thread::sleep(Duration::from_millis(300));
        rig.cnc.send_request_with_argument("state", "name", state)?;
        let held =
            rig.cnc.read_pins(&["trueup-mv.offset-current-0", "trueup-mv.offset-current-2"])?;
        rig.bridge.set_offset([-30.0, 0.0, 0.0]);
        thread::sleep(Duration::from_millis(300));
        assert_eq!(
            held,
            rig.cnc.read_pins(&["trueup-mv.offset-current-0", "trueup-mv.offset-current-2"])?
        );
        assert!((held[0] - 0.01).abs() < 1e-6 && (held[1] - 0.04).abs() < 1e-6, "{held:?}");
        rig.cnc.power_on_and_home()?;
        rig.applied([-30.0, 0.0, 0.0])?;
        rig.offsets([10.0, -20.0, 40.0])?;
        rig.check(state)?;
        rig.mdi("G53 G0 X20 Y20")?;
    }
    Ok(())
}

/// A joint that is homed again with an offset finds the same place.
pub(crate) fn homing(rig: &mut Rig) -> Result<()> {
    rig.mdi("G53 G0 X-10 Y0")?;
    rig.cycles();
    let drive = rig.cnc.read_pin("trueup-j0.out")?;
    // The goal is sent so shortly before that the offset is still on its way: held is what acts.
    rig.bridge.set_offset([190.0, -20.0, 40.0]);
    rig.cnc.send_request_with_argument("home", "joint", 0)?;
    rig.bridge.set_offset([10.0, -20.0, 40.0]);
    rig.cnc.send_request_with_argument("teleop", "on", true)?;
    rig.applied([10.0, -20.0, 40.0])?;
    rig.mdi("G53 G0 X-10 Y0")?;
    let again = rig.cnc.read_pin("trueup-j0.out")?;
    println!("homed again: the drive is {:.3} um off", (again - drive) * 1e3);
    // The switch is left at 0.1 mm/s, and seen in a servo cycle.
    assert!((again - drive).abs() < 0.3e-3, "{again} {drive}");
    rig.check("homing")?;
    Ok(())
}

/// A component that has ended is loaded again while an offset with a base acts: nothing moves, whatever it received
/// last. While it is gone, killed or ended, the offset is held.
pub(crate) fn ended(rig: &mut Rig) -> Result<()> {
    let names = ["trueup-mv.offset-current-0", "trueup-mv.offset-current-2", "trueup-j0.out"];
    let base = rig.cnc.read_pin(names[0])? - 0.01;
    assert!(base.abs() > 5e-3, "homed with an offset: {base}");
    for signal in ["TERM", "KILL"] {
        let before = rig.cnc.read_pins(&names)?;
        end_component(&mut rig.cnc, signal)?;
        if signal == "KILL" {
            let (description, is_live) = describe_status(&shown(rig)?);
            ensure!(!is_live && description.contains("killed"), "{description}");
        }
        let near =
            |seen: &[f64]| seen.iter().zip(&before).all(|(one, two)| (one - two).abs() < 1e-6);
        let gone = rig.cnc.read_pins(&names)?;
        assert!(near(&gone), "{signal}, gone: {before:?} {gone:?}");
        if signal == "TERM" {
            stands_whatever_the_goal(rig, &names)?;
        }
        load_component(&mut rig.cnc, signal)?;
        rig.applied([10.0, -20.0, 40.0])?;
        let again = rig.cnc.read_pins(&names)?;
        println!("{signal}, loaded again: {before:?} {again:?}");
        assert!(near(&again), "{signal}, loaded again: {before:?} {again:?}");
        let (description, is_live) = describe_status(&shown(rig)?);
        ensure!(is_live, "{description}");
        let seen = rig.check(signal)?;
        assert!(seen.offset_speed <= NOISE / CYCLE_S, "{signal}: the offset moved: {seen:?}");
    }
    Ok(())
}

/// While the component is gone the offset stands, whatever goal `moveoff` has: from rest with a goal above it `moveoff` would go
/// down, with one below down as well. The signal of a component that has ended has no writer, so the test writes it.
fn stands_whatever_the_goal(rig: &mut Rig, names: &[&str]) -> Result<()> {
    const GOAL: &str = "trueup-j0-offset";
    // Its speed is taken to 0 by a ramp of 6 ms, which begins when the feed is held.
    let speeds = ["trueup-mv.offset-vel-0", "trueup-mv.offset-vel-1", "trueup-mv.offset-vel-2"];
    rig.cnc.wait_for_pins("the offsets are held", 5, &speeds, |seen| seen == [0.0; 3])?;
    let goal = rig.cnc.read_pin("trueup-mv.offset-in-0")?;
    let before = rig.cnc.read_pins(names)?;
    for mm in [goal + 0.15, goal - 0.15] {
        rig.cnc.run_halcmd(&format!("sets {GOAL} {mm}"))?;
        thread::sleep(Duration::from_millis(500));
        let seen = rig.cnc.read_pins(names)?;
        assert_eq!(seen, before, "a goal of {mm} mm, was {goal}");
    }
    rig.cnc.run_halcmd(&format!("sets {GOAL} {goal}"))?;
    Ok(())
}

/// A joint that is homed while the component is gone, with an offset acting, finds the same places when it is back.
pub(crate) fn homed_meanwhile(rig: &mut Rig) -> Result<()> {
    for signal in ["TERM", "KILL"] {
        rig.mdi("G53 G0 X-10 Y0")?;
        rig.applied([10.0, -20.0, 40.0])?;
        rig.cycles();
        let drive = rig.cnc.read_pin("trueup-j0.out")?;
        end_component(&mut rig.cnc, signal)?;
        let reference = rig.cnc.read_pin("joint.0.motor-offset")?;
        rig.cnc.send_request_with_argument("home", "joint", 0)?;
        let new = rig.cnc.read_pin("joint.0.motor-offset")?;
        load_component(&mut rig.cnc, signal)?;
        rig.cnc.send_request_with_argument("teleop", "on", true)?;
        rig.applied([10.0, -20.0, 40.0])?;
        rig.mdi("G53 G0 X-10 Y0")?;
        let again = rig.cnc.read_pin("trueup-j0.out")?;
        println!(
            "{signal}, homed meanwhile: the reference {:.3} um and the drive {:.3} um off",
            (new - reference) * 1e3,
            (again - drive) * 1e3
        );
        // The offset was there, so the reference differs by how the switch was found alone; the base has to contain it.
        assert!((again - drive).abs() < 0.3e-3, "{signal}: {again} {drive}");
        rig.check("homed while the component was gone")?;
    }
    Ok(())
}

/// Ends the component by this signal, and waits until LinuxCNC holds the feed.
pub(crate) fn end_component(cnc: &mut HeadlessLinuxCnc, signal: &str) -> Result<()> {
    let pid = cnc.read_pin("trueup.0.pid")? as u32;
    let done = Command::new("kill").args(["-s", signal, &pid.to_string()]).status()?;
    ensure!(done.success(), "kill -s {signal} {pid}");
    let end = Instant::now() + Duration::from_secs(10);
    while is_process_alive(pid) {
        ensure!(Instant::now() < end, "it does not end by {signal}");
        thread::sleep(Duration::from_millis(10));
    }
    cnc.wait_for_pins("the feed is held", 5, &["motion.feed-inhibit"], |seen| seen[0] == 1.0)
}

/// Loads the component that was ended by this signal again, and waits until it lives.
pub(crate) fn load_component(cnc: &mut HeadlessLinuxCnc, signal: &str) -> Result<()> {
    let [ini, hal] = ["stock.ini", "trueup.hal"].map(|name| cnc.folder().join(name));
    cnc.run_halcmd(&format!("-i {} -f {}", ini.display(), hal.display())).or_else(|error| {
        // The wires of one that was killed are still there.
        if signal == "KILL" { Ok(String::new()) } else { Err(error) }
    })?;
    cnc.wait_for_pins("it beats", 10, &["motion.feed-inhibit"], |seen| seen[0] == 0.0)
}

/// Returns the pins as `trueup linuxcnc status` reads them.
fn shown(rig: &mut Rig) -> Result<BTreeMap<String, String>> {
    Ok(parse(&rig.cnc.run_halcmd("-s show pin trueup.0.")?))
}

/// At the soft limit the drive does not stay beyond.
pub(crate) fn soft_limit(rig: &mut Rig) -> Result<()> {
    rig.offsets([50.0, -20.0, 40.0])?;
    rig.cnc.send_request(&json!({"do": "jog", "axis": 0, "speed": 20.0}))?;
    rig.cnc.wait_for_pins(
        "the offset stands back",
        5,
        &["trueup.0.limited", "joint.0.pos-cmd", "trueup-mv.offset-current-0"],
        |seen| seen[0] == 1.0 && (seen[1] - 50.0).abs() < 1e-6,
    )?;
    thread::sleep(Duration::from_millis(200));
    let seen = rig.cnc.read_pins(&["trueup-j0.out", "joint.0.motor-offset", "joint.0.pos-cmd"])?;
    println!("at the soft limit: {seen:?}");
    assert!(seen[0] <= 50.0 + 1e-6, "{seen:?}");
    rig.check("soft limit")?;
    rig.mdi("G53 G0 X0")?;
    rig.applied([50.0, -20.0, 40.0])?;
    Ok(())
}

/// A probed point is that of the planner: 30 µm more of offset, 30 µm less of position.
pub(crate) fn probing(rig: &mut Rig) -> Result<()> {
    let mut probed = Vec::new();
    for z in [40.0, 70.0] {
        rig.offsets([50.0, -20.0, z])?;
        rig.mdi(&format!("G53 G0 Z{}", SURFACE + 0.2))?;
        rig.mdi("G38.2 Z-6 F6")?;
        let stat = rig.cnc.send_request(&json!({"do": "stat"}))?;
        probed.push(stat["probed"][2].as_f64().context("a position")?);
        rig.mdi("G53 G0 Z0")?;
    }
    println!("probed: {probed:?}");
    // 0.1 mm/s and a servo cycle.
    assert!((probed[0] - probed[1] - 0.03).abs() <= 0.11e-3, "{probed:?}");
    assert!((probed[0] + 0.04 - SURFACE).abs() <= 0.21e-3, "{probed:?}");
    rig.check("probing")?;
    macros(&mut rig.cnc, 1.0)
}

/// Modes that a job may have left: units, work offset, tool length, `G92`, rotation.
const JOBS: [&str; 6] = [
    "G21",
    "G10 L2 P2 Z-3\nG55",
    "G43.1 Z1.2",
    "G20\nG92 Z0.2",
    "G10 L2 P9 Z0.7 R30\nG59.3\nG20 G91",
    "G10 L2 P1 Z-2\nG20\nG43.1 Z0.05\nG92 Z1\nG91",
];

/// A probed point lacks the offset, 70 µm on Z: nothing is learned from it, and a touch-off takes nothing off it. `mm` are in
/// a unit of the machine.
pub(crate) fn macros(cnc: &mut HeadlessLinuxCnc, mm: f64) -> Result<()> {
    let mdi = |cnc: &mut HeadlessLinuxCnc, text: &str| {
        cnc.send_request_with_argument("mdi", "text", text).map(drop)
    };
    let before = cnc.read_pin("axis.z.pos-cmd")?;
    cnc.send_request(&json!({"do": "stat"}))?;
    mdi(cnc, &format!("o<trueup_probe> call [{SURFACE}] [1] [60]"))?;
    let message = cnc.send_request(&json!({"do": "stat"}))?["said"].to_string();
    ensure!(message.contains("the offset enters at the joint"), "{message}");
    let after = cnc.read_pin("axis.z.pos-cmd")?;
    assert!((before - after).abs() < 1e-6, "it does not move: {before} {after}");
    for job in JOBS {
        for line in job.lines() {
            mdi(cnc, line)?;
        }
        cnc.send_request(&json!({"do": "stat"}))?;
        mdi(cnc, "o<trueup_touch_off> call [6] [300] [1]")?;
        let message = cnc.send_request(&json!({"do": "stat"}))?["said"].to_string();
        mdi(cnc, "G21 G90")?;
        mdi(cnc, "G1 Z3 F1200")?;
        let z = cnc.read_pin("axis.z.pos-cmd")? * mm;
        println!("{job:?}: touched off, Z3 is at {z:.5}");
        // The planner meets the surface with 70 um of offset; 5 mm/s and a servo cycle.
        assert!((z + 0.07 - SURFACE - 2.0).abs() <= 6e-3, "{job:?}: {z}: {message}");
        mdi(cnc, "G21 G90 G17 G49 G92.1 G54")?;
        for system in [1, 2, 9] {
            mdi(cnc, &format!("G10 L2 P{system} X0 Y0 Z0 R0"))?;
        }
        mdi(cnc, "G53 G0 Z0")?;
    }
    Ok(())
}

/// A bridge that falls silent is held, then taken back by the limits.
pub(crate) fn silence(rig: &mut Rig) -> Result<()> {
    rig.bridge.silence(true);
    rig.cnc.wait_for_pins(
        "taken back",
        20,
        &["trueup.0.fault", "trueup-mv.offset-current-2"],
        |seen| seen[0] == 1.0 && seen[1].abs() < 1e-6,
    )?;
    rig.bridge.silence(false);
    rig.applied([50.0, -20.0, 70.0])?;
    rig.check("silence")?;
    Ok(())
}
