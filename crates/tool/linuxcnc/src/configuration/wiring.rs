//! The HAL files that bring offsets into a configuration.
//!
//! At the joint, `moveoff` limits value, speed and acceleration of the offset, and `offset` adds it to the command and
//! takes it off the feedback:
//!
//! ```text
//!  joint.N.motor-pos-cmd ─► offset.in ──► offset.out ─► (the user's signal) ─► drive
//!                    component ─► moveoff ─► offset.offset
//!  joint.N.motor-pos-fb ◄─ offset.fb-out ◄─ offset.fb-in ◄─ (the user's signal) ◄─ drive
//! ```
//!
//! `moveoff` could do all of it, but its feedback is a servo cycle late: the following error would grow by the way of a
//! cycle, and a home switch or an index would be off by it. `offset` has a function for the feedback of its own, which
//! runs between the drive's reading and the motion controller.
//!
//! | caution of `moveoff` | what is done |
//! |---|---|
//! | soft limits are not honoured | the component keeps command + offset within the joint's limits |
//! | offsets vanish in a step when `power-on` falls | `power-on` is always true; the component holds the offset |
//! | waypoints fill up, and then offsets freeze | sampled every 10⁹ s: there are none |
//! | return to zero is not coordinated | the enabling pins stay true; the component takes offsets back by the limits |
//! | one set of variables for all instances | a second `moveoff` is refused |
//! | it goes away from its goal when nothing changes that | `guard` holds it while the component is gone |

use std::fmt::Write as _;

mod watchdog;

use self::watchdog::ALIVE_ONESHOT;
use super::{
    OffsetEntryPoint,
    boardless_config::{CALIBRATION_FILE, THERMAL_STATE_FILE},
    finding::{ConfigurationFinding, OffsetRequirements},
    hal_files::{HalFiles, MOTION_CONTROLLER_FUNCTION, ThreadOrderError},
    ini_file::IniFile,
    input_signals,
    joints::Joint,
    servo_hal_lines::{self, REALTIME_COMPONENT_NAME, REALTIME_INSTANCE_NAME, round_to_billionth},
};
use crate::ini_settings::IniSettings;

/// The HAL file that is loaded once.
pub(crate) const REALTIME_HAL_FILE: &str = "trueup_realtime.hal";
/// The HAL file that may be loaded again when the component has ended.
pub(crate) const COMPONENT_HAL_FILE: &str = "trueup.hal";
/// First line of both.
pub(crate) const GENERATED_FILE_HEADER: &str =
    "# Written by trueup linuxcnc setup; --remove takes it out. Changes are lost.";
const MICROMETRES_PER_MILLIMETRE: f64 = 1e3;
const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];
/// The instance of `moveoff`; its channels are the joints of X, Y and Z in the order of their numbers.
pub(crate) const LIMITER_INSTANCE: &str = "trueup-mv";

/// Returns the pin that keeps a joint's reference while the component is gone: an input that is never selected.
pub(crate) fn reference_hold_pin(joint: usize) -> String {
    format!("trueup-j{joint}-go.in7")
}

/// The text of the two HAL files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct GeneratedHalFiles {
    /// Text of `REALTIME_HAL_FILE`.
    pub realtime: String,
    /// Text of `COMPONENT_HAL_FILE`.
    pub component: String,
}

/// Writes the HAL files.
///
/// # Errors
/// Something is in the way, each with its place.
pub(crate) fn generate_hal_files(
    ini: &IniFile,
    hal: &HalFiles,
    joints: &[Joint],
    demand: &OffsetRequirements,
) -> Result<GeneratedHalFiles, Vec<ConfigurationFinding>> {
    let mut writer = HalWriter { ini, hal, findings: Vec::new() };
    let realtime = writer.generate_realtime_file(joints, demand);
    let component = writer.generate_component_file(joints, demand);
    if writer.findings.is_empty() {
        Ok(GeneratedHalFiles { realtime, component })
    } else {
        Err(writer.findings)
    }
}

/// Returns the lines for a configuration that setup cannot change; `SIGNAL-OF-…` stands for a signal that only the
/// user knows.
#[must_use]
pub(crate) fn generate_manual_hal_lines(
    ini: &IniFile,
    hal: &HalFiles,
    joints: &[Joint],
    demand: &OffsetRequirements,
) -> String {
    // What would be refused is in the user's hands.
    let mut writer = HalWriter { ini, hal, findings: Vec::new() };
    let realtime = writer.generate_realtime_file(joints, demand);
    let component = writer.generate_component_file(joints, demand);
    let machine = match demand.corrects_screw {
        Some(_) => "MACHINE = machine.toml\n",
        None => "",
    };
    let bridge = match demand.no_board {
        Some(_) => {
            format!(
                "CALIBRATION = /FOLDER/{CALIBRATION_FILE}\nHEAT = /FOLDER/{THERMAL_STATE_FILE}\n"
            )
        }
        None => "PORT = /dev/ttyUSB0\nPOSITION_PERIOD_MS = 2\n".into(),
    };
    format!(
        "# In the INI file, after your own HALFILE lines:\n[HAL]\nHALFILE = {REALTIME_HAL_FILE}\nHALFILE = {COMPONENT_HAL_FILE}\n\
         [TRUEUP]\n{machine}{bridge}\n\
         # {REALTIME_HAL_FILE}; compare the positions of addf with `halcmd show thread`:\n{}\n# {COMPONENT_HAL_FILE}:\n{}",
        realtime.trim_start_matches(GENERATED_FILE_HEADER),
        component.trim_start_matches(GENERATED_FILE_HEADER)
    )
}

struct HalWriter<'a> {
    ini: &'a IniFile,
    hal: &'a HalFiles,
    findings: Vec<ConfigurationFinding>,
}

impl HalWriter<'_> {
    fn generate_realtime_file(&mut self, joints: &[Joint], demand: &OffsetRequirements) -> String {
        let mut text =
            format!("{GENERATED_FILE_HEADER}\n# Loaded once, after the machine's own files.\n");
        let (thread, functions) = self.hal.find_motion_thread().unwrap_or_else(|ThreadOrderError(place)| {
            let place = place.unwrap_or_else(|| self.ini.section_location("HAL"));
            self.findings.push(ConfigurationFinding::error(
                place,
                "the servo thread cannot be followed: no `addf motion-controller THREAD`, or a position beyond its functions",
                "connect the offsets by hand (docs/book/src/linuxcnc.md)",
            ));
            ("servo-thread".into(), vec!["motion-command-handler".into(), MOTION_CONTROLLER_FUNCTION.into()])
        });
        if let Some(no_board) = &demand.no_board {
            text += &servo_hal_lines::format_load_and_setp_lines(
                no_board,
                self.ini,
                joints,
                demand,
                input_signals::has_all_angle_signals(demand, self.hal),
            );
        }
        match demand.entry {
            OffsetEntryPoint::Joint => {
                self.write_joint_offset_lines(&mut text, joints, demand, &thread, &functions)
            }
            // The counts are read by the motion controller of the next period.
            OffsetEntryPoint::Eoffset if demand.no_board.is_some() => {
                let _ = writeln!(text, "addf {REALTIME_INSTANCE_NAME} {thread}");
            }
            OffsetEntryPoint::Eoffset => {}
        }
        self.write_watchdog(&mut text, &thread);
        self.write_operator_messages(&mut text, &thread, demand);
        text
    }

    /// The limiter, and what adds the offset and takes it off.
    fn write_joint_offset_lines(
        &mut self,
        text: &mut String,
        joints: &[Joint],
        demand: &OffsetRequirements,
        thread: &str,
        functions: &[String],
    ) {
        if let Some(loaded) = self.hal.find_loadrt("moveoff") {
            self.findings.push(ConfigurationFinding::error(
                loaded.place.clone(),
                "moveoff is loaded here, and two of it share their variables",
                "take it out, or enter offsets by eoffset (--by eoffset)",
            ));
        }
        let names: Vec<String> =
            joints.iter().map(|joint| format!("trueup-j{}", joint.number)).collect();
        let _ = writeln!(
            text,
            "\nloadrt moveoff names={LIMITER_INSTANCE} personality={}",
            joints.len()
        );
        self.write_loadrt(text, "offset", &names);
        let stops = self.write_speed_ramp_loads(text, &names);
        // The feedback just before the motion controller, the command just after it.
        let controller = functions
            .iter()
            .position(|function| function == MOTION_CONTROLLER_FUNCTION)
            .unwrap_or_default()
            + 1;
        let mut position = controller;
        let mut add = |function: String| {
            let _ = writeln!(text, "addf {function} {thread} {position}");
            position += 1;
        };
        names.iter().for_each(|name| add(format!("{name}.update-feedback")));
        // Over the motion controller.
        position += 1;
        let mut add = |function: String| {
            let _ = writeln!(text, "addf {function} {thread} {position}");
            position += 1;
        };
        if demand.no_board.is_some() {
            add(REALTIME_INSTANCE_NAME.into());
        }
        stops.into_iter().for_each(&mut add);
        for function in ["read-inputs", "write-outputs"] {
            add(format!("{LIMITER_INSTANCE}.{function}"));
        }
        names.iter().for_each(|name| add(format!("{name}.update-output")));
        text.push_str("\n# Always enabled: an offset is held when the machine goes off, and taken back by the component.\n");
        for (pin, value) in [
            ("power-on", "1"),
            ("move-enable", "1"),
            ("apply-offsets", "1"),
            ("backtrack-enable", "0"),
            ("waypoint-sample-secs", "1e9"),
            ("waypoint-threshold", "1e9"),
            ("epsilon", "0.0001"),
        ] {
            let _ = writeln!(text, "setp {LIMITER_INSTANCE}.{pin} {value}");
        }
        let mm_per_unit = IniSettings::parse(&self.ini.to_text()).unwrap_or_default().mm_per_unit;
        for (channel, (joint, name)) in joints.iter().zip(&names).enumerate() {
            let number = joint.number;
            let [command, feedback] =
                ["cmd", "fb"].map(|end| self.resolve_joint_signal(joint, end));
            let _ = write!(
                text,
                "\n# Joint {number}: {command} and {feedback} are the drive's from here on.\n\
                 unlinkp joint.{number}.motor-pos-cmd\n\
                 unlinkp joint.{number}.motor-pos-fb\n\
                 net {name}-cmd joint.{number}.motor-pos-cmd => {name}.in\n\
                 net {name}-fb {name}.fb-out => joint.{number}.motor-pos-fb\n\
                 net {name}-now {LIMITER_INSTANCE}.offset-current-{channel} => {name}.offset\n\
                 net {command} {name}.out\n\
                 net {feedback} => {name}.fb-in\n"
            );
            Self::write_speed_ramp_nets(text, name, channel);
            if demand.no_board.is_some() {
                let slew_mm_per_s = demand.slew_um_per_s / MICROMETRES_PER_MILLIMETRE;
                let speed =
                    joint.max_offset_rate_mm_per_s(slew_mm_per_s, mm_per_unit) / mm_per_unit;
                let _ = write!(
                    text,
                    "setp {name}-go.in1 {speed}\n\
                     setp {name}-speed.maxv {acceleration}\n\
                     setp {LIMITER_INSTANCE}.offset-accel-{channel} {acceleration}\n",
                    speed = round_to_billionth(speed),
                    acceleration = round_to_billionth(joint.acceleration.available_headroom())
                );
            }
        }
    }

    /// Returns the signal on the command or the feedback of a joint.
    fn resolve_joint_signal(&mut self, joint: &Joint, end: &str) -> String {
        let pin = format!("joint.{}.motor-pos-{end}", joint.number);
        if let Some(place) = self.hal.find_late_reference(&pin) {
            self.findings.push(ConfigurationFinding::error(
                place,
                format!(
                    "{pin} is connected after the HAL files, and belongs to the offset by then"
                ),
                "connect it in a HALFILE",
            ));
        }
        let link = self.hal.find_link(&pin);
        if link.is_none() {
            self.findings.push(ConfigurationFinding::error(
                self.ini.section_location(&joint.section_name()),
                format!("{pin} is on no signal of the HAL files"),
                format!("connect it: net SIGNAL {pin}"),
            ));
        }
        link.map_or_else(|| format!("SIGNAL-OF-{pin}"), |link| link.signal)
    }

    /// Loads a module with these instances, unless the user's own line names them already.
    fn write_loadrt(&mut self, text: &mut String, module: &str, names: &[String]) {
        let Some(loaded) = self.hal.find_loadrt(module) else {
            let _ = writeln!(text, "loadrt {module} names={}", names.join(","));
            return;
        };
        let there: Vec<&str> = loaded
            .words
            .iter()
            .find_map(|word| word.strip_prefix("names="))
            .unwrap_or_default()
            .split(',')
            .collect();
        if !names.iter().all(|name| there.contains(&name.as_str())) {
            self.findings.push(ConfigurationFinding::error(
                loaded.place.clone(),
                format!("{module} is loaded here, and LinuxCNC loads a module once"),
                format!(
                    "add {} to this line, with names= for the others too (count=N makes {module}.0, {module}.1, …)",
                    names.join(",")
                ),
            ));
        }
    }

    /// Returns the component and its wires.
    fn generate_component_file(&mut self, joints: &[Joint], demand: &OffsetRequirements) -> String {
        let entry = demand.entry;
        let machine = match demand.corrects_screw {
            // A probed point contains an external offset, and none at the joint: nothing can be learned from it there.
            Some(_) if entry == OffsetEntryPoint::Eoffset => {
                " --machine [TRUEUP](MACHINE) --record trueup_record.csv"
            }
            Some(_) => " --machine [TRUEUP](MACHINE)",
            None => "",
        };
        let angles =
            if input_signals::has_all_angle_signals(demand, self.hal) { " --rotary" } else { "" };
        let mut text = if demand.no_board.is_some() {
            format!(
                "{GENERATED_FILE_HEADER}\n# What keeps the heat over a restart, and the wires of {REALTIME_COMPONENT_NAME}.\n\n\
                 loadusr trueup linuxcnc keep --file [TRUEUP](HEAT)\n\n"
            )
        } else {
            format!(
                "{GENERATED_FILE_HEADER}\n# If the component alone has ended: halcmd -i YOUR.ini -f {COMPONENT_HAL_FILE}\n\n\
             loadusr -W trueup linuxcnc --by {} --port [TRUEUP](PORT) --position-period-ms [TRUEUP](POSITION_PERIOD_MS){angles}{machine} --log trueup.log\n\n",
                entry.name()
            )
        };
        text += &input_signals::format_input_nets(demand, self.hal);
        self.write_pin_net(&mut text, "motion.motion-enabled", "trueup-on", &["machine-on".into()]);
        self.write_pin_net(&mut text, "motion.is-all-homed", "trueup-homed", &["homed".into()]);
        self.write_pin_net(&mut text, "spindle.0.speed-out", "trueup-rpm", &["spindle-rpm".into()]);
        let axes: Vec<&str> = (0..AXIS_NAMES.len())
            .filter(|axis| joints.iter().any(|joint| joint.axis == *axis))
            .map(|axis| AXIS_NAMES[axis])
            .collect();
        for axis in &axes {
            let signal = format!("trueup-{axis}-cmd");
            self.write_pin_net(
                &mut text,
                &format!("axis.{axis}.pos-cmd"),
                &signal,
                &[format!("{axis}-cmd")],
            );
        }
        match entry {
            OffsetEntryPoint::Joint => joints.iter().enumerate().for_each(|(channel, joint)| {
                self.write_joint_nets(&mut text, channel, joint, demand)
            }),
            OffsetEntryPoint::Eoffset => self.write_eoffset_nets(&mut text, &axes),
        }
        let _ = write!(
            text,
            "\nnet trueup-heartbeat trueup.0.heartbeat => {ALIVE_ONESHOT}.in\nsetp trueup.0.enable 1\n\n"
        );
        for (signal, pin) in [
            ("applied", "applied"),
            ("connected", "connected"),
            ("fault", "fault"),
            ("limited", "limited"),
            ("other", "other-calibration"),
            ("quality", "quality"),
        ] {
            let _ = writeln!(text, "net trueup-{signal} trueup.0.{pin}");
        }
        text
    }

    fn write_joint_nets(
        &mut self,
        text: &mut String,
        channel: usize,
        joint: &Joint,
        demand: &OffsetRequirements,
    ) {
        let n = joint.number;
        let limiter = |pin: &str| format!("{LIMITER_INSTANCE}.offset-{pin}-{channel}");
        let mut pins =
            vec![("offset", limiter("in")), ("min", limiter("min")), ("max", limiter("max"))];
        // Speed and acceleration are set once without a board.
        if demand.no_board.is_none() {
            pins.push(("vel", format!("trueup-j{n}-go.in1")));
            pins.push(("accel", format!("{} trueup-j{n}-speed.maxv", limiter("accel"))));
            pins.push(("kept", reference_hold_pin(n)));
        }
        for (pin, to) in pins {
            let _ = writeln!(text, "net trueup-j{n}-{pin} trueup.0.joint-{n}-{pin} => {to}");
        }
        let _ = writeln!(text, "net trueup-j{n}-now => trueup.0.joint-{n}-now");
        for (pin, ours) in [("motor-offset", "reference"), ("homing", "homing"), ("pos-cmd", "cmd")]
        {
            let signal = format!("trueup-j{n}-{ours}-in");
            self.write_pin_net(
                text,
                &format!("joint.{n}.{pin}"),
                &signal,
                &[format!("joint-{n}-{ours}")],
            );
        }
    }

    fn write_eoffset_nets(&mut self, text: &mut String, axes: &[&str]) {
        for axis in axes {
            for pin in ["scale", "enable", "counts"] {
                let pin = format!("axis.{axis}.eoffset-{pin}");
                if let Some(link) = self.hal.find_final_link(&pin) {
                    self.findings.push(ConfigurationFinding::error(
                        link.place,
                        format!("{pin} is on the signal {} already", link.signal),
                        "take your own external offset out, or enter offsets at the joint (--by joint)",
                    ));
                }
            }
            self.write_pin_net(
                text,
                &format!("axis.{axis}.eoffset-request"),
                &format!("trueup-{axis}-req"),
                &[format!("{axis}-request")],
            );
            self.write_pin_net(
                text,
                &format!("axis.{axis}.eoffset"),
                &format!("trueup-{axis}-eoff"),
                &[format!("{axis}-eoffset")],
            );
        }
        let all = |pin: &str| {
            axes.iter().map(|axis| format!(" axis.{axis}.eoffset-{pin}")).collect::<String>()
        };
        // The scale first: a count without one would be a step of its own.
        let _ = writeln!(text, "net trueup-scale trueup.0.scale =>{}", all("scale"));
        let _ = writeln!(text, "net trueup-eoff-on trueup.0.enable-out =>{}", all("enable"));
        for axis in axes {
            let _ = writeln!(
                text,
                "net trueup-{axis} trueup.0.{axis}-counts => axis.{axis}.eoffset-counts"
            );
        }
    }

    /// Connects a pin of LinuxCNC to pins of the component, by the user's signal where there is one.
    fn write_pin_net(&self, text: &mut String, pin: &str, signal: &str, to: &[String]) {
        let link = self.hal.find_final_link(pin);
        let signal = link.as_ref().map_or(signal, |link| link.signal.as_str());
        let to: Vec<String> = to.iter().map(|pin| format!("trueup.0.{pin}")).collect();
        let _ = writeln!(text, "net {signal} {pin} => {}", to.join(" "));
    }
}
