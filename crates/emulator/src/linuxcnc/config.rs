//! LinuxCNC's configuration of the machine in the loop, and what it cuts.
//!
//! The bridge's own wires are those of `integrations/linuxcnc/trueup.hal`, as a user loads them.
//!
//! `OFFSET_AV_RATIO` gives external offsets their share a of the axis' acceleration, and at a steady
//! speed v they are v/(2a) late. 0.0025 of 2000 mm/s² are 5 mm/s²: 7 ms at the diagonal's 70 µm/s. Its
//! share of the speed, 2.5 mm/s, is then above the slew limit, which the component keeps by itself.

use std::fmt::Write as _;

use super::plant::PINS;

/// The travel of X, Y and Z in mm, from 0.
pub const TRAVEL_MM: [f64; 3] = [14_300.0, 3_000.0, 2_500.0];
/// The share of an axis' speed and acceleration that external offsets get.
pub const OFFSET_AV_RATIO: f64 = 0.0025;
/// The feed along the diagonal in mm/min.
pub const DIAGONAL_FEED: f64 = 58_000.0;
/// The centre, the radius and the feed of the arc.
pub const ARC: ([f64; 2], f64, f64) = ([13_000.0, 1_500.0], 700.0, 20_000.0);
/// The heights of the staircase in mm; off the multiples of the screw's pitch.
pub const STAIRS_MM: [f64; 6] = [101.3, 509.9, 901.2, 1_309.1, 1_717.5, 2_126.8];
/// The spindle's speed in r/min.
pub const SPINDLE_RPM: f64 = 24_000.0;

/// What a program does, as it says on `motion.analog-out-01`.
pub mod phase {
    /// The diagonal.
    pub const DIAGONAL: u32 = 1;
    /// The arc.
    pub const ARC: u32 = 2;
    /// The staircase.
    pub const STAIRS: u32 = 3;
    /// The warm-up.
    pub const WARM_UP: u32 = 4;
    /// Rotary axes in motion.
    pub const FIVE_AXES: u32 = 5;
}

/// The .ini. `port` is where the bridge is; `here` is the session's folder.
#[must_use]
pub fn ini(port: &str, here: &str) -> String {
    let mut text = format!(
        "\
[EMC]
VERSION = 1.1
MACHINE = trueup-loop
DEBUG = 0
[TRUEUP]
PORT = {port}
MACHINE = {here}/machine.toml
POSITION_PERIOD_MS = 2
[DISPLAY]
DISPLAY = {here}/screen.sh
[RS274NGC]
PARAMETER_FILE = {here}/loop.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[HAL]
HALFILE = {here}/machine.hal
HALFILE = {here}/trueup_watchdog.hal
HALFILE = {here}/trueup.hal
HALFILE = {here}/loop.hal
[TRAJ]
COORDINATES = XYZAC
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 500
MAX_LINEAR_VELOCITY = 1100
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = {here}/loop.tbl
[KINS]
KINEMATICS = trivkins coordinates=XYZAC
JOINTS = 5
[SPINDLE_0]
MAX_FORWARD_VELOCITY = 24000
"
    );
    let speeds = [1_000.0, 1_000.0, 600.0];
    for (joint, (axis, travel_mm)) in ["X", "Y", "Z"].iter().zip(TRAVEL_MM).enumerate() {
        let motion = format!("MAX_VELOCITY = {}\nMAX_ACCELERATION = 2000\n", speeds[joint]);
        // An offset moves the joint beyond what was commanded: its limits leave room for it.
        let _ = write!(
            text,
            "[AXIS_{axis}]\nMIN_LIMIT = -5\nMAX_LIMIT = {}\n{motion}OFFSET_AV_RATIO = \
             {OFFSET_AV_RATIO}\n[JOINT_{joint}]\nTYPE = LINEAR\nMIN_LIMIT = -10\nMAX_LIMIT = {}\n\
             {motion}{JOINT}",
            travel_mm + 5.0,
            travel_mm + 10.0,
        );
    }
    for (joint, axis) in [(3, "A"), (4, "C")] {
        let motion =
            "MIN_LIMIT = -200\nMAX_LIMIT = 200\nMAX_VELOCITY = 40\nMAX_ACCELERATION = 300\n";
        let _ =
            write!(text, "[AXIS_{axis}]\n{motion}[JOINT_{joint}]\nTYPE = ANGULAR\n{motion}{JOINT}");
    }
    text
}

/// A joint that is where it is told to be.
pub(super) const JOINT: &str = "\
FERROR = 10
MIN_FERROR = 10
HOME = 0
HOME_OFFSET = 0
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
";

/// The machine: joints that are where they are told to be.
#[must_use]
pub fn machine_hal() -> String {
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

/// The bridge's wires, with the angles of the head.
#[must_use]
pub fn trueup_hal(shipped: &str) -> String {
    let period = "--position-period-ms";
    shipped.replacen(period, &format!("--rotary {period}"), 1)
}

/// The angles and the load for the bridge, and the writer of the servo cycles.
#[must_use]
pub fn loop_hal() -> String {
    let mut text = format!(
        "\
net head-1 axis.c.pos-cmd => trueup.0.angle-1
net head-2 axis.a.pos-cmd => trueup.0.angle-2
net load motion.analog-out-00 => trueup.0.load-n
loadrt sampler depth=16000 cfg={}
addf sampler.0 servo-thread
",
        "f".repeat(PINS.len())
    );
    // A pin that is wired already has a signal of another name.
    let signals = [
        "joint-0",
        "joint-1",
        "joint-2",
        "joint-4",
        "joint-3",
        "trueup-x-eoff",
        "trueup-y-eoff",
        "trueup-z-eoff",
        "trueup-rpm",
        "load",
    ];
    for (number, pin) in PINS.iter().enumerate() {
        let _ = match signals.get(number) {
            Some(signal) => writeln!(text, "net {signal} => sampler.0.pin.{number}"),
            None => writeln!(text, "net sample-{number} {pin} => sampler.0.pin.{number}"),
        };
    }
    text
}

/// The diagonal, the arc and the staircase.
#[must_use]
pub fn path(pass: u32) -> String {
    let [x_mm, y_mm, _] = TRAVEL_MM;
    let ([cx, cy], radius, arc_feed) = ARC;
    let mut text = format!(
        "\
G21 G90 G94 G17 G64 P0.001
M68 E0 Q0
M68 E1 Q0
M68 E2 Q{pass}
G53 G0 Z1210
G53 G0 X0 Y0
G4 P0.6
M68 E1 Q{diagonal}
G1 X{x_mm} Y{y_mm} F{DIAGONAL_FEED}
G4 P0.3
M68 E1 Q0
G0 X{start} Y{cy}
G4 P0.3
M68 E1 Q{arc}
G3 X{end} Y{cy} I-{radius} J0 F{arc_feed}
G4 P0.3
M68 E1 Q0
G0 Z60
M68 E1 Q{stairs}
",
        diagonal = phase::DIAGONAL,
        arc = phase::ARC,
        stairs = phase::STAIRS,
        start = cx + radius,
        end = cx - radius,
    );
    let down = STAIRS_MM.iter().rev();
    let turn = [STAIRS_MM[STAIRS_MM.len() - 1] + 40.0];
    for z_mm in STAIRS_MM.iter().chain(&turn).chain(down) {
        let _ = write!(text, "G1 Z{z_mm} F30000\nG4 P0.3\n");
    }
    text + "M68 E1 Q0\nM2\n"
}

/// The warm-up, which lasts until the machine's clock says that it is over, and the rotary axes with
/// the warm spindle.
#[must_use]
pub fn warm(pass: u32) -> String {
    format!(
        "\
G21 G90 G94 G17 G64 P0.001
M68 E1 Q0
M68 E2 Q{pass}
G53 G0 X7000 Y1400 Z20
G4 P0.6
M68 E1 Q{warm_up}
G4 P0.1
M3 S{SPINDLE_RPM}
M66 P0 L3 Q1800
M68 E1 Q{five_axes}
G4 P0.3
G0 A40
G0 C120
G1 X7300 Y1600 A-35 C-60 F4000
G0 A25 C30
G0 A0 C0
G4 P0.3
M68 E1 Q0
M5
M2
",
        warm_up = phase::WARM_UP,
        five_axes = phase::FIVE_AXES,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pin_is_wired_once() {
        let text = loop_hal();
        for number in 0..PINS.len() {
            let pin = format!("sampler.0.pin.{number}\n");
            assert_eq!(text.matches(&pin).count(), 1, "{pin}");
        }
    }

    #[test]
    fn the_angles_are_asked_for() {
        let shipped = "loadusr -W trueup linuxcnc --position-period-ms 2\n";
        assert!(trueup_hal(shipped).contains("linuxcnc --rotary --position-period-ms 2"));
    }
}
