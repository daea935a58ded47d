//! A LinuxCNC of three simulated joints, which are where they are commanded to be: for tests that need a control and
//! no bridge.

use std::{
    fs::{self, Permissions},
    os::unix::fs::PermissionsExt as _,
};

use anyhow::{Context as _, Result};

use super::{
    config::JOINT_INI_LINES,
    headless_linuxcnc::{DISPLAY_PROGRAM, HeadlessLinuxCnc},
};
use crate::setup::LockedLinuxCnc;

/// A busy computer answers late.
const INI_TEMPLATE: &str = "\
[EMC]
VERSION = 1.1
MACHINE = trueup
DEBUG = 0
[DISPLAY]
DISPLAY = FOLDER/SCREEN
[RS274NGC]
PARAMETER_FILE = FOLDER/sim.var
MORE_RS274NGC[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 30.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[HAL]
HALFILE = FOLDER/sim.hal
[TRAJ]
COORDINATES = XYZ
LINEAR_UNITS = UNITS
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 5000
MAX_LINEAR_VELOCITY = 5000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = FOLDER/sim.tbl
[KINS]
KINEMATICS = trivkins
JOINTS = 3
";
const HAL_WIRING: &str = "\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net x joint.0.motor-pos-cmd => joint.0.motor-pos-fb
net y joint.1.motor-pos-cmd => joint.1.motor-pos-fb
net z joint.2.motor-pos-cmd => joint.2.motor-pos-fb
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
";

/// Lines of an axis in the INI file.
#[derive(Clone, Debug)]
pub struct AxisIniLines {
    /// Limits and speeds, of the axis and its joint.
    pub limits: String,
    /// What its joint has next to them; `FOLDER` is where the files are.
    pub joint: String,
}

/// Settings of the whole control.
#[derive(Clone, Copy, Debug)]
pub struct ControlSettings<'a> {
    /// Unit of the machine: `mm` or `inch`.
    pub units: &'a str,
    /// More lines of `[RS274NGC]`; `FOLDER` is where the files are.
    pub rs274ngc: &'a str,
}

impl Default for ControlSettings<'_> {
    fn default() -> Self {
        Self { units: "mm", rs274ngc: "" }
    }
}

/// Starts it with X, Y and Z, more HAL lines, and more files of its folder, and switches it on. The signals `x`,
/// `y` and `z` are the joints' positions in mm.
///
/// # Errors
/// It does not start; with its output.
pub fn start(
    control: LockedLinuxCnc,
    axes: &[AxisIniLines; 3],
    hal: &str,
    files: &[(String, String)],
) -> Result<HeadlessLinuxCnc> {
    start_with_settings(control, ControlSettings::default(), axes, hal, files)
}

/// [`start`] with settings. A file that begins with `#!` is executable.
///
/// # Errors
/// As [`start`].
pub fn start_with_settings(
    control: LockedLinuxCnc,
    settings: ControlSettings<'_>,
    axes: &[AxisIniLines; 3],
    hal: &str,
    files: &[(String, String)],
) -> Result<HeadlessLinuxCnc> {
    let folder = HeadlessLinuxCnc::create_config_folder()?;
    let here = folder.path().to_str().context("a temporary folder has a plain name")?;
    let mut text = INI_TEMPLATE.to_string();
    for (number, (name, AxisIniLines { limits, joint })) in
        ["X", "Y", "Z"].iter().zip(axes).enumerate()
    {
        text += &format!(
            "[AXIS_{name}]\n{limits}[JOINT_{number}]\nTYPE = LINEAR\n{JOINT_INI_LINES}{joint}{limits}"
        );
    }
    let text = text
        .replace("MORE_RS274NGC", settings.rs274ngc)
        .replace("UNITS = UNITS", &format!("UNITS = {}", settings.units))
        .replace("FOLDER", here)
        .replace("SCREEN", DISPLAY_PROGRAM);
    let wires = [HAL_WIRING, hal].concat();
    let own = [("sim.ini", text.as_str()), ("sim.hal", &wires), ("sim.tbl", "")];
    let files = files.iter().map(|(name, text)| (name.as_str(), text.as_str()));
    for (name, text) in own.into_iter().chain(files) {
        fs::write(folder.path().join(name), text)?;
        if text.starts_with("#!") {
            fs::set_permissions(folder.path().join(name), Permissions::from_mode(0o755))?;
        }
    }
    let mut cnc = HeadlessLinuxCnc::start(folder, "sim.ini", control)?;
    cnc.power_on_and_home()?;
    Ok(cnc)
}
