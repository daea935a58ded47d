//! A configuration as the simulators of LinuxCNC have it, and a HAL file of the user.

use super::{MAX_ACCELERATION, MAX_VELOCITY, SWITCH};

/// The INI file but for its axes and joints.
pub(crate) const INI: &str = "\
[EMC]
VERSION = 1.1
MACHINE = stock
[DISPLAY]
DISPLAY = FOLDER/SCREEN
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = sim.var
FEATURES = 8
SUBROUTINE_PATH = FOLDER
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 30.0
BASE_PERIOD = 0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
TOOL_TABLE = sim.tbl
[HAL]
HALFILE = core_sim.hal
HALFILE = own.hal
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 53
[KINS]
KINEMATICS = trivkins
JOINTS = 3
";
/// A switch, a probe, and a recorder whose pins are connected later.
pub(crate) const OWN: &str = "\
loadrt comp names=switch,probe
loadrt sampler depth=16000 cfg=fffffffffffffbfffs
addf switch servo-thread
addf probe servo-thread
addf sampler.0 servo-thread
setp switch.in0 -2
setp probe.in1 -5
setp probe.hyst 0
setp switch.hyst 0
net Xpos => switch.in1
net Zpos => probe.in0
net at-switch switch.out => joint.0.home-sw-in
net touched probe.out => motion.probe-input
";

/// Returns the INI file of three joints, whose X has a home switch.
pub(crate) fn ini() -> String {
    let mut text = INI.to_string();
    for (joint, (axis, home)) in ["X", "Y", "Z"].iter().zip([true, false, false]).enumerate() {
        let motion = format!(
            "MIN_LIMIT = -50\nMAX_LIMIT = 50\nMAX_VELOCITY = {MAX_VELOCITY}\nMAX_ACCELERATION = {MAX_ACCELERATION}\n"
        );
        // The switch closes above -2 mm: found at 10 mm/s, then left at 0.1 mm/s.
        let home = if home {
            format!(
                "HOME_SEARCH_VEL = 10\nHOME_LATCH_VEL = -0.1\nHOME_OFFSET = {SWITCH}\nHOME = 0\nHOME_SEQUENCE = 0\n"
            )
        } else {
            "HOME_SEARCH_VEL = 0\nHOME_LATCH_VEL = 0\nHOME = 0\nHOME_SEQUENCE = 1\n".into()
        };
        text += &format!(
            "[AXIS_{axis}]\n{motion}[JOINT_{joint}]\nTYPE = LINEAR\nBACKLASH = 0.000\nFERROR = 1\nMIN_FERROR = 0.25\n{motion}{home}"
        );
    }
    text
}
