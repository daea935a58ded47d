//! LinuxCNC's configuration of the machine in the loop, and what it cuts.
//!
//! The bridge's own wires are those of `integrations/linuxcnc/trueup.hal`, as a user loads them.
//!
//! `OFFSET_AV_RATIO` gives external offsets their share a of the axis' acceleration, and at a steady
//! speed v they are v/(2a) late. 0.0025 of 2000 mm/s² are 5 mm/s²: 7 ms at the diagonal's 70 µm/s. Its
//! share of the speed, 2.5 mm/s, is then above the slew limit, which the component keeps by itself.
//!
//! Where a second of the board takes `slower` seconds of the wall, LinuxCNC's time is as much slower: its
//! feeds are divided by it, its accelerations by its square, its dwells and the period of the positions are
//! as much longer. What it expects of the bridge, it expects in its own time: no limit is loosened.

use std::fmt::Write as _;

use super::{OffsetEntryPoint, plant::SAMPLER_PINS};

/// The travel of X, Y and Z in mm, from 0.
pub(crate) const AXIS_TRAVEL_MM: [f64; 3] = [14_300.0, 3_000.0, 2_500.0];
/// The share of an axis' speed and acceleration that external offsets get.
pub(crate) const OFFSET_AV_RATIO: f64 = 0.0025;
/// The feed along the diagonal in mm/min.
pub(crate) const DIAGONAL_FEED_MM_PER_MIN: f64 = 58_000.0;
/// The centre, the radius and the feed of the arc.
pub(crate) const ARC_CENTRE_RADIUS_FEED: ([f64; 2], f64, f64) =
    ([13_000.0, 1_500.0], 700.0, 20_000.0);
/// The heights of the staircase in mm; off the multiples of the screw's pitch.
pub(crate) const STAIRCASE_HEIGHTS_MM: [f64; 6] = [101.3, 509.9, 901.2, 1_309.1, 1_717.5, 2_126.8];
/// The feed between them in mm/min.
pub(crate) const STAIRCASE_FEED_MM_PER_MIN: f64 = 30_000.0;
/// The feed of the move with five axes in mm/min.
const FIVE_AXES_FEED_MM_PER_MIN: f64 = 4_000.0;
/// How long a program waits until an offset has settled.
const OFFSET_SETTLING_DWELL_S: f64 = 0.3;
/// How long it stands at each height of the staircase. LinuxCNC's interpreter ends a dwell by the wall's clock,
/// so where the computer keeps the servo thread waiting, that many cycles are missing from the dwell.
pub(crate) const STAIRCASE_DWELL_S: f64 = 1.0;
/// The spindle's speed in r/min.
pub(crate) const SPINDLE_RPM: f64 = 24_000.0;

/// Steps of a program, as it says them on `motion.analog-out-01`.
pub mod phase {
    /// The diagonal.
    pub(crate) const DIAGONAL: u32 = 1;
    /// The arc.
    pub(crate) const ARC: u32 = 2;
    /// The staircase.
    pub(crate) const STAIRCASE: u32 = 3;
    /// The warm-up.
    pub(crate) const WARM_UP: u32 = 4;
    /// Rotary axes in motion.
    pub(crate) const FIVE_AXES: u32 = 5;
}

/// How often the position of a moving axis is sent, in ms of the board.
const POSITION_PERIOD_MS: u32 = 2;

/// Returns the .ini. `port` is where the bridge is, `None`: setup adds what is ours; `here` is the session's folder. A busy computer answers late, so
/// LinuxCNC's parts wait for each other.
#[must_use]
pub(crate) fn ini_file(port: Option<&str>, here: &str, slower: u32) -> String {
    let slow = f64::from(slower);
    let period_ms = POSITION_PERIOD_MS * slower;
    let section = port.map_or(String::new(), |port| {
        format!(
            "[TRUEUP]\nPORT = {port}\nMACHINE = {here}/machine.toml\nPOSITION_PERIOD_MS = {period_ms}\n"
        )
    });
    let files: &[&str] = match port {
        Some(_) => &["machine.hal", "trueup_watchdog.hal", "trueup.hal", "loop.hal"],
        None => &["machine.hal"],
    };
    let files: String = files.iter().map(|name| format!("HALFILE = {here}/{name}\n")).collect();
    let mut text = format!(
        "\
[EMC]
VERSION = 1.1
MACHINE = trueup-loop
DEBUG = 0
{section}[DISPLAY]
DISPLAY = {here}/screen.sh
[RS274NGC]
PARAMETER_FILE = {here}/loop.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 30.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[HAL]
{files}[TRAJ]
COORDINATES = XYZAC
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = {}
MAX_LINEAR_VELOCITY = {}
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = {here}/loop.tbl
[KINS]
KINEMATICS = trivkins coordinates=XYZAC
JOINTS = 5
[SPINDLE_0]
MAX_FORWARD_VELOCITY = 24000
",
        500.0 / slow,
        1_100.0 / slow,
    );
    let motion = |velocity: f64, acceleration: f64| {
        let (velocity, acceleration) = (velocity / slow, acceleration / (slow * slow));
        format!("MAX_VELOCITY = {velocity}\nMAX_ACCELERATION = {acceleration}\n")
    };
    let speeds = [1_000.0, 1_000.0, 600.0];
    for (joint, (axis, travel_mm)) in ["X", "Y", "Z"].iter().zip(AXIS_TRAVEL_MM).enumerate() {
        let motion = motion(speeds[joint], 2_000.0);
        let ratio = match port {
            Some(_) => format!("OFFSET_AV_RATIO = {OFFSET_AV_RATIO}\n"),
            None => String::new(),
        };
        // An offset moves the joint beyond what was commanded: its limits leave room for it.
        let _ = write!(
            text,
            "[AXIS_{axis}]\nMIN_LIMIT = -5\nMAX_LIMIT = {}\n{motion}{ratio}[JOINT_{joint}]\nTYPE = LINEAR\nMIN_LIMIT = -10\nMAX_LIMIT = {}\n\
             {motion}{JOINT_INI_LINES}",
            travel_mm + 5.0,
            travel_mm + 10.0,
        );
    }
    for (joint, axis) in [(3, "A"), (4, "C")] {
        let motion = format!("MIN_LIMIT = -200\nMAX_LIMIT = 200\n{}", motion(40.0, 300.0));
        let _ = write!(
            text,
            "[AXIS_{axis}]\n{motion}[JOINT_{joint}]\nTYPE = ANGULAR\n{motion}{JOINT_INI_LINES}"
        );
    }
    text
}

/// A joint that is where it is commanded to be.
pub(super) const JOINT_INI_LINES: &str = "\
FERROR = 10
MIN_FERROR = 10
HOME = 0
HOME_OFFSET = 0
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
";

/// Returns the machine: joints that are where they are commanded to be.
#[must_use]
pub(crate) fn machine_hal() -> String {
    let mut text = String::from(
        "\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
setp spindle.0.at-speed 1
",
    );
    for joint in 0..5 {
        let _ = writeln!(
            text,
            "net joint-{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb"
        );
    }
    text
}

/// Returns the bridge's wires, with the angles of the head; a slow bridge's slew limit is as slow.
#[must_use]
pub(crate) fn trueup_hal(shipped: &str, slew_um_per_s: f64, slower: u32) -> String {
    let period = "--position-period-ms";
    let slew = match slower {
        1 => String::new(),
        _ => format!("--slew-um-per-s {} ", slew_um_per_s / f64::from(slower)),
    };
    // The bridge of the warm-up has other time constants than the machine file.
    shipped.replacen(period, &format!("--any-calibration --rotary {slew}{period}"), 1)
}

/// The angles and the load, by the names that setup looks for.
pub(crate) const ANGLE_AND_LOAD_NETS: [&str; 3] = [
    "trueup-angle-1 axis.c.pos-cmd",
    "trueup-angle-2 axis.a.pos-cmd",
    "trueup-load motion.analog-out-00",
];

/// Returns the angles and the load for the bridge.
#[must_use]
pub(crate) fn angle_and_load_hal() -> String {
    let to = ["angle-1", "angle-2", "load-n"];
    ANGLE_AND_LOAD_NETS
        .iter()
        .zip(to)
        .map(|(net, pin)| format!("net {net} => trueup.0.{pin}\n"))
        .collect()
}

/// Returns the writer of the servo cycles.
#[must_use]
pub(crate) fn sampler_hal(by: OffsetEntryPoint) -> String {
    let offsets = match by {
        OffsetEntryPoint::Eoffset => ["trueup-x-eoff", "trueup-y-eoff", "trueup-z-eoff"],
        OffsetEntryPoint::Joint => ["trueup-j0-now", "trueup-j1-now", "trueup-j2-now"],
    };
    let mut text = format!(
        "\
loadrt sampler depth=16000 cfg={}
addf sampler.0 servo-thread
",
        "f".repeat(SAMPLER_PINS.len())
    );
    // A pin that is wired already has a signal of another name.
    let signals = [
        "joint-0",
        "joint-1",
        "joint-2",
        "joint-4",
        "joint-3",
        offsets[0],
        offsets[1],
        offsets[2],
        "trueup-rpm",
        "trueup-load",
    ];
    for (number, pin) in SAMPLER_PINS.iter().enumerate() {
        let _ = match signals.get(number) {
            Some(signal) => writeln!(text, "net {signal} => sampler.0.pin.{number}"),
            None => writeln!(text, "net sample-{number} {pin} => sampler.0.pin.{number}"),
        };
    }
    text
}

/// Returns the diagonal, the arc and the staircase.
#[must_use]
pub(crate) fn path_program(pass: u32, slower: u32) -> String {
    let slow = f64::from(slower);
    let [x_mm, y_mm, _] = AXIS_TRAVEL_MM;
    let ([cx, cy], radius, arc_feed) = ARC_CENTRE_RADIUS_FEED;
    let mut text = format!(
        "\
G21 G90 G94 G17 G64 P0.001
M68 E0 Q0
M68 E1 Q0
M68 E2 Q{pass}
G53 G0 Z1210
G53 G0 X0 Y0
G4 P{long_s}
M68 E1 Q{diagonal}
G1 X{x_mm} Y{y_mm} F{diagonal_feed}
G4 P{dwell_s}
M68 E1 Q0
G0 X{start} Y{cy}
G4 P{dwell_s}
M68 E1 Q{arc}
G3 X{end} Y{cy} I-{radius} J0 F{arc_feed}
G4 P{dwell_s}
M68 E1 Q0
G0 Z60
M68 E1 Q{stairs}
",
        diagonal = phase::DIAGONAL,
        arc = phase::ARC,
        stairs = phase::STAIRCASE,
        start = cx + radius,
        end = cx - radius,
        diagonal_feed = DIAGONAL_FEED_MM_PER_MIN / slow,
        arc_feed = arc_feed / slow,
        dwell_s = OFFSET_SETTLING_DWELL_S * slow,
        long_s = 2.0 * OFFSET_SETTLING_DWELL_S * slow,
    );
    let down = STAIRCASE_HEIGHTS_MM.iter().rev();
    let turn = [STAIRCASE_HEIGHTS_MM[STAIRCASE_HEIGHTS_MM.len() - 1] + 40.0];
    for z_mm in STAIRCASE_HEIGHTS_MM.iter().chain(&turn).chain(down) {
        let _ = write!(
            text,
            "G1 Z{z_mm} F{}\nG4 P{}\n",
            STAIRCASE_FEED_MM_PER_MIN / slow,
            STAIRCASE_DWELL_S * slow
        );
    }
    text + "M68 E1 Q0\nM2\n"
}

/// Returns the warm-up, which lasts until the machine's clock says that it is over, and the rotary axes with
/// the warm spindle.
#[must_use]
pub(crate) fn warm_up_program(pass: u32, slower: u32) -> String {
    let slow = f64::from(slower);
    format!(
        "\
G21 G90 G94 G17 G64 P0.001
M68 E1 Q0
M68 E2 Q{pass}
G53 G0 X7000 Y1400 Z20
G4 P{long_s}
M68 E1 Q{warm_up}
G4 P{short_s}
M3 S{SPINDLE_RPM}
M66 P0 L3 Q{longest_s}
M68 E1 Q{five_axes}
G4 P{dwell_s}
G0 A40
G0 C120
G1 X7300 Y1600 A-35 C-60 F{five_axes_feed}
G0 A25 C30
G0 A0 C0
G4 P{dwell_s}
M68 E1 Q0
M5
M2
",
        warm_up = phase::WARM_UP,
        five_axes = phase::FIVE_AXES,
        longest_s = 1_800 * slower,
        five_axes_feed = FIVE_AXES_FEED_MM_PER_MIN / slow,
        long_s = 2.0 * OFFSET_SETTLING_DWELL_S * slow,
        dwell_s = OFFSET_SETTLING_DWELL_S * slow,
        short_s = OFFSET_SETTLING_DWELL_S * slow / 3.0,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pin_is_wired_once() {
        let text = sampler_hal(OffsetEntryPoint::Eoffset);
        for number in 0..SAMPLER_PINS.len() {
            let pin = format!("sampler.0.pin.{number}\n");
            assert_eq!(text.matches(&pin).count(), 1, "{pin}");
        }
    }

    #[test]
    fn the_angles_are_asked_for() {
        let shipped = "loadusr -W trueup linuxcnc --position-period-ms 2\n";
        let real = trueup_hal(shipped, 500.0, 1);
        assert!(real.contains("linuxcnc --any-calibration --rotary --position-period-ms 2"));
        let slow = trueup_hal(shipped, 500.0, 4);
        assert!(slow.contains("--rotary --slew-um-per-s 125 --position-period-ms 2"));
    }
}
