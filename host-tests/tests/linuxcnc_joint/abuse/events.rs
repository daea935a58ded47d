//! Kinds of events, drawn by their shares, each with everything that it draws itself.

use std::{fs, thread, time::Duration};

use anyhow::{Context as _, Result, ensure};
use rand::Rng as _;
use serde_json::json;

use super::{
    super::{
        MAX_VELOCITY, SURFACE,
        events::{end_component, load_component},
    },
    rig::{Abused, Way},
};

/// Above the surface a probing move begins so high, in mm; it has 0.05 µm in a servo cycle.
const CLEARANCE: f64 = 0.02;
const PROBING_MM_PER_MIN: f64 = 3.0;
/// The joints' limits, in mm.
const SOFT_LIMIT: f64 = 50.0;
/// A jog to a limit ends this near to it at most, in mm: by the offset that leads away, and a servo cycle.
const LIMIT_REACHED: f64 = 0.3;
/// A program of the folder.
const PROGRAM: &str = "job.ngc";

/// A kind of event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Kind {
    Offsets,
    Program,
    Abort,
    EStop,
    Off,
    DriveFault,
    Homing,
    HomingBroken,
    SoftLimit,
    Probing,
    ProbingBroken,
    Overrides,
    Pause,
    Jog,
    Silence,
    LongSilence,
    BridgeKilled,
    ComponentEnded,
    Calibration,
    SensorFails,
}

use Kind::*;

/// All kinds, with what they are called and their shares of all events.
const KINDS: [(Kind, &str, u32); 20] = [
    (Offsets, "offsets jump", 12),
    (Program, "rapid move", 14),
    (Abort, "abort", 12),
    (EStop, "emergency stop", 8),
    (Off, "machine off and on", 8),
    (DriveFault, "fault of a drive or the spindle", 5),
    (Homing, "homing of X", 5),
    (HomingBroken, "homing of X broken off", 4),
    (SoftLimit, "jog to the soft limit", 3),
    (Probing, "probing (G38.2)", 8),
    (ProbingBroken, "probing broken off", 3),
    (Overrides, "feed and rapid override", 7),
    (Pause, "pause and resume", 6),
    (Jog, "jog", 6),
    (Silence, "bridge silent, held", 3),
    (LongSilence, "bridge silent, taken back", 1),
    (BridgeKilled, "bridge killed and restarted", 3),
    (ComponentEnded, "component ended or killed, loaded again", 2),
    (Calibration, "another calibration, and the right one again", 1),
    (SensorFails, "sensor at its rail, and back", 5),
];

/// Measurements of an event.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Measured {
    /// Error of a probed position, in µm.
    pub probed_um: Option<f64>,
    /// Way of the drive beyond the soft limit, in µm.
    pub beyond_limit_um: Option<f64>,
}

impl Measured {
    /// Takes the larger of both each; of a probed position the larger error.
    pub(crate) fn take(&mut self, other: &Self) {
        let larger = |one: Option<f64>, other: Option<f64>| match (one, other) {
            (Some(one), Some(other)) => Some(one.max(other)),
            (one, other) => one.or(other),
        };
        self.probed_um = larger(self.probed_um, other.probed_um.map(f64::abs));
        self.beyond_limit_um = larger(self.beyond_limit_um, other.beyond_limit_um);
    }
}

impl Kind {
    /// Returns what it is called.
    pub(crate) fn name(self) -> &'static str {
        KINDS.iter().find(|(kind, ..)| *kind == self).map_or("", |(_, name, _)| name)
    }

    /// Returns true if there has to be a bridge that can fail.
    fn needs_a_bridge(self) -> bool {
        matches!(self, Silence | LongSilence | BridgeKilled | ComponentEnded | Calibration)
    }

    /// Draws one by the shares.
    pub(crate) fn draw(rig: &mut Abused) -> Self {
        let kinds: Vec<(Self, u32)> = KINDS
            .iter()
            .filter(|(kind, ..)| match rig.bridge {
                Some(_) => *kind != SensorFails,
                None => !kind.needs_a_bridge(),
            })
            .map(|(kind, _, share)| (*kind, *share))
            .collect();
        let all: u32 = kinds.iter().map(|(_, share)| share).sum();
        let mut left = rig.random.random_range(0..all);
        for (kind, share) in kinds {
            if left < share {
                return kind;
            }
            left -= share;
        }
        Offsets
    }

    /// Lets it happen. LinuxCNC is on, homed and at rest before; afterwards it may be off.
    pub(crate) fn happen(self, rig: &mut Abused) -> Result<Measured> {
        let mut measured = Measured::default();
        match self {
            Offsets => rig.say_any()?,
            Program => rapid_move(rig)?,
            Abort => {
                moving(rig)?;
                rig.cnc.send_request(&json!({ "do": "abort" }))?;
                rig.idle()?;
            }
            EStop => switched(rig, "estop")?,
            Off => switched(rig, "off")?,
            DriveFault => drive_fault(rig)?,
            Homing => homing(rig)?,
            HomingBroken => homing_broken(rig)?,
            SoftLimit => measured.beyond_limit_um = Some(soft_limit(rig)?),
            Probing => measured.probed_um = Some(probing(rig)?),
            ProbingBroken => probing_broken(rig)?,
            Overrides => overrides(rig)?,
            Pause => pause(rig)?,
            Jog => jog(rig)?,
            Silence => {
                moving(rig)?;
                silence(rig, true)?;
                rig.say_any()?;
                rig.rest(20, 1_500);
                silence(rig, false)?;
                rig.idle()?;
            }
            LongSilence => {
                silence(rig, true)?;
                rig.cnc.wait_for_pins("a fault", 10, &["trueup.0.fault"], |seen| seen[0] == 1.0)?;
                rig.rest(0, 500);
                silence(rig, false)?;
            }
            BridgeKilled => {
                moving(rig)?;
                kill(rig, true)?;
                rig.say_any()?;
                rig.rest(20, 3_000);
                kill(rig, false)?;
                rig.idle()?;
            }
            ComponentEnded => component_ended(rig)?,
            Calibration => calibration(rig)?,
            SensorFails => sensor_fails(rig)?,
        }
        Ok(measured)
    }
}

/// Begins a move, with offsets that may change before or in the middle of it; it is on its way afterwards.
fn moving(rig: &mut Abused) -> Result<()> {
    let [x, y, z] = rig.place()?;
    let is_rapid = rig.random.random_bool(0.3);
    let code = if is_rapid { "G0".into() } else { format!("G1 F{:.0}", rig.draw(300.0, 1_800.0)) };
    if rig.random.random_bool(0.5) {
        rig.say_any()?;
    }
    rig.cnc.send_request_with_argument(
        "begin_mdi",
        "text",
        format!("G53 {code} X{x:.3} Y{y:.3} Z{z:.3}"),
    )?;
    rig.rest(20, 350);
    if rig.random.random_bool(0.5) {
        rig.say_any()?;
    }
    Ok(())
}

/// Moves rapidly between exact stops: where moves are blended, LinuxCNC gives each half of the acceleration.
fn rapid_move(rig: &mut Abused) -> Result<()> {
    let [x, y, z] = rig.place()?;
    rig.say_any()?;
    rig.mdi(&format!("G61 G53 G0 X{x:.3} Y{y:.3} Z{z:.3}"))
}

fn switched(rig: &mut Abused, state: &str) -> Result<()> {
    moving(rig)?;
    switch(rig, state)
}

fn switch(rig: &mut Abused, state: &str) -> Result<()> {
    rig.cnc.send_request_with_argument("state", "name", state)?;
    if rig.random.random_bool(0.5) {
        rig.say_any()?;
    }
    rig.rest(0, 300);
    Ok(())
}

fn drive_fault(rig: &mut Abused) -> Result<()> {
    moving(rig)?;
    let pin = if rig.random.random_bool(0.5) { "joint.1" } else { "spindle.0" };
    let pin = format!("{pin}.amp-fault-in");
    rig.cnc.set_pin(&pin, 1)?;
    rig.cnc.wait_for_pins("the machine is off", 5, &["motion.motion-enabled"], |seen| {
        seen[0] == 0.0
    })?;
    rig.cnc.set_pin(&pin, 0)?;
    // Until the task has seen it.
    rig.rest(100, 300);
    Ok(())
}

/// Homes X again, with offsets that may be on their way.
fn homing(rig: &mut Abused) -> Result<()> {
    rig.mdi("G53 G0 X-3")?;
    rig.say_any()?;
    rig.rest(0, 100);
    rig.cnc.send_request_with_argument("home", "joint", 0).map(drop)
}

/// Begins to home X, and breaks it off in any of its phases: search, way back, latch at 0.1 mm/s.
fn homing_broken(rig: &mut Abused) -> Result<()> {
    rig.mdi("G53 G0 X-3")?;
    rig.say_any()?;
    rig.rest(0, 100);
    rig.cnc.send_request_with_argument("begin_home", "joint", 0)?;
    rig.rest(10, 900);
    break_off(rig)?;
    rig.on()
}

/// Aborts, stops or switches off.
fn break_off(rig: &mut Abused) -> Result<()> {
    match rig.random.random_range(0..3) {
        0 => rig.cnc.send_request(&json!({ "do": "abort" })).map(drop),
        1 => switch(rig, "estop"),
        _ => switch(rig, "off"),
    }
}

/// Jogs X to a limit while an offset leads beyond it; returns how far the drive is beyond it then, in µm.
fn soft_limit(rig: &mut Abused) -> Result<f64> {
    let side = if rig.random.random_bool(0.5) { 1.0 } else { -1.0 };
    let mm = rig.draw(0.01, 0.05);
    rig.set_offset([side * mm * 1e3, 0.0, 0.0])?;
    rig.applied()?;
    rig.cnc.send_request(&json!({ "do": "jog", "axis": 0, "speed": side * MAX_VELOCITY }))?;
    // Until the offset stands back.
    thread::sleep(Duration::from_millis(600));
    // The place of the joint differs by the scatter of the home switch.
    let drive = rig.drives()?[0] - rig.off_um[0] * 1e-3;
    rig.mdi("G53 G0 X-5")?;
    let beyond = side * drive - SOFT_LIMIT;
    ensure!(beyond > -LIMIT_REACHED, "the limit was not reached: {drive} mm");
    Ok(beyond * 1e3)
}

/// Probes the surface with the offsets on; returns by how much the probed position is wrong, in µm.
fn probing(rig: &mut Abused) -> Result<f64> {
    rig.say_any()?;
    rig.applied()?;
    let acts = rig.acting()?[2];
    rig.mdi(&format!("G53 G0 Z{:.4}", SURFACE - acts + CLEARANCE))?;
    rig.applied()?;
    rig.mdi(&format!("G38.2 Z{:.4} F{PROBING_MM_PER_MIN}", SURFACE - 1.0))?;
    let acts = rig.acting()?[2];
    let stat = rig.stat()?;
    rig.mdi("G53 G0 Z-1")?;
    let probed = stat["probed"][2].as_f64().context("a probed position")?;
    // At the joint it is the planner's, and the surface is the drive's.
    let drive = if rig.way == Way::Eoffset { probed } else { probed + acts };
    Ok((drive - SURFACE) * 1e3)
}

/// Probes, and breaks it off on the way; nothing is touched.
fn probing_broken(rig: &mut Abused) -> Result<()> {
    rig.say_any()?;
    rig.mdi(&format!("G53 G0 Z{:.4}", SURFACE + 2.0))?;
    let feed = rig.draw(10.0, 60.0);
    rig.cnc.send_request_with_argument(
        "begin_mdi",
        "text",
        format!("G38.2 Z{:.4} F{feed:.1}", SURFACE - 1.0),
    )?;
    rig.rest(20, 500);
    break_off(rig)?;
    rig.on()?;
    rig.mdi("G53 G0 Z-1")
}

fn overrides(rig: &mut Abused) -> Result<()> {
    moving(rig)?;
    for _ in 0..3 {
        let (feed, rapid) = (rig.draw(0.0, 1.5), rig.draw(0.05, 1.0));
        rig.cnc.send_request(&json!({ "do": "overrides", "feed": feed, "rapid": rapid }))?;
        rig.rest(20, 150);
    }
    rig.cnc.send_request(&json!({ "do": "overrides", "feed": 1.0, "rapid": 1.0 }))?;
    rig.idle()
}

fn pause(rig: &mut Abused) -> Result<()> {
    let mut program = String::from("G21 G90 G64\n");
    for _ in 0..3 {
        let [x, y, z] = [rig.draw(-8.0, 8.0), rig.draw(-8.0, 8.0), rig.draw(-2.5, -0.5)];
        program += &format!("G53 G1 F1500 X{x:.3} Y{y:.3} Z{z:.3}\n");
    }
    fs::write(rig.cnc.folder().join(PROGRAM), program + "M2\n")?;
    rig.cnc.start_program(PROGRAM)?;
    rig.rest(50, 400);
    rig.cnc.send_request(&json!({ "do": "pause" }))?;
    rig.say_any()?;
    rig.rest(50, 300);
    rig.cnc.resume_program()?;
    rig.idle()
}

fn jog(rig: &mut Abused) -> Result<()> {
    let axis = rig.random.random_range(0..2);
    let side = if rig.random.random_bool(0.5) { 1.0 } else { -1.0 };
    let (speed, seconds) = (side * rig.draw(3.0, MAX_VELOCITY), rig.draw(0.05, 0.5));
    rig.say_any()?;
    rig.cnc
        .send_request(&json!({ "do": "jog", "axis": axis, "speed": speed, "seconds": seconds }))?;
    rig.mdi("G53 G0 X5 Y0")
}

/// Without a board: the sensor's wire breaks, so that it reads its rail; what acts is held, taken back, and taken up again.
fn sensor_fails(rig: &mut Abused) -> Result<()> {
    if rig.random.random_bool(0.5) {
        moving(rig)?;
    }
    let rail = if rig.random.random_bool(0.5) { 0.0 } else { 10.0 };
    rig.sensor(rail)?;
    rig.rest(50, 4_000);
    rig.say_any()?;
    rig.idle()
}

fn silence(rig: &Abused, is_silent: bool) -> Result<()> {
    rig.bridge.as_ref().context("a bridge")?.silence(is_silent);
    Ok(())
}

fn kill(rig: &Abused, is_dead: bool) -> Result<()> {
    rig.bridge.as_ref().context("a bridge")?.kill(is_dead);
    Ok(())
}

/// Ends the component and loads it again; while it is gone the offset stands, whatever the bridge says.
fn component_ended(rig: &mut Abused) -> Result<()> {
    let signal = if rig.random.random_bool(0.5) { "TERM" } else { "KILL" };
    if rig.random.random_bool(0.5) {
        moving(rig)?;
    }
    end_component(&mut rig.cnc, signal)?;
    // What it was given last is reached.
    thread::sleep(Duration::from_millis(400));
    let before = rig.acting()?;
    rig.say_any()?;
    rig.rest(50, 500);
    let after = rig.acting()?;
    let stands = before.iter().zip(after).all(|(before, after)| (before - after).abs() < 1e-6);
    ensure!(stands, "the offset moved without a component: {before:?}, {after:?}");
    load_component(&mut rig.cnc, signal)?;
    rig.idle()
}

/// Starts the bridge again with another calibration, which is refused, and then with the right one.
fn calibration(rig: &mut Abused) -> Result<()> {
    for (crc, is_other) in [(rig.calibration ^ 1, 1.0), (rig.calibration, 0.0)] {
        kill(rig, true)?;
        rig.rest(20, 500);
        rig.bridge.as_ref().context("a bridge")?.run_on(crc);
        kill(rig, false)?;
        let names = ["trueup.0.connected", "trueup.0.other-calibration"];
        rig.cnc.wait_for_pins("its calibration is known", 10, &names, |seen| {
            seen == [1.0, is_other]
        })?;
    }
    Ok(())
}
