//! Every pin, by its name.
//!
//! `trueup.0.` stands before each. Lengths on pins that LinuxCNC writes are in machine units.
//!
//! | pin | type | |
//! |---|---|---|
//! | `enable` | bit in | the operator wants offsets |
//! | `machine-on`, `homed` | bit in | `motion.motion-enabled`, `motion.is-all-homed` |
//! | `zero` | bit in | a rising edge takes the present error as the reference |
//! | `service` | bit in | the operator allows that `bridge load` and CANopen masters write, while nothing is engaged |
//! | `confirm` | bit in | a rising edge confirms what the bridge requires |
//! | `L-cmd` | float in | `axis.L.pos-cmd`, L = x, y, z; nan, or not connected: nothing is sent to the bridge |
//! | `L-request`, `L-eoffset` | float in | `axis.L.eoffset-request`, `axis.L.eoffset` |
//! | `angle-1`, `angle-2` | float in | commanded angles of the head axes, degrees |
//! | `spindle-rpm`, `load-n` | float in | speed in r/min, axial cutting force in N |
//! | `tool` | s32 in | `iocontrol.0.tool-number`, 0: none; below 0, as long as it is not connected: neither tool nor conditions are sent |
//! | `condition-NN` | bit in | the condition with `bit = NN` in the machine file, 00 to 15 |
//! | `L-counts` | s32 out | to `axis.L.eoffset-counts` |
//! | `scale` | float out | to `axis.L.eoffset-scale`: machine units a count |
//! | `enable-out` | bit out | to `axis.L.eoffset-enable` |
//! | `L-offset-um`, `L-applied-um` | float out | what the bridge says; what LinuxCNC has applied |
//! | `applied` | bit out | the two are the same on every axis, within 20 nm |
//! | `connected`, `fault`, `limited`, `other-calibration` | bit out | see [`ComponentOutputs`] |
//! | `quality` | s32 out | 0 off … 6 fault, as on the wire |
//! | `flags`, `age-ms` | u32 out | as on the wire |
//! | `crc-errors`, `seq-errors`, `malformed`, `lost` | u32 out | frames since the start |
//! | `temp-NN` | float out | a temperature of the bridge in °C, by its channel; nan while it is not known |
//! | `elongation-um` | float out | what the spindle's sensor reads, before reference and limits; nan while it is not known |
//! | `joint-N-offset`, `-min`, `-max`, `-vel`, `-accel` | float out | to `moveoff`, where offsets enter at joint N |
//! | `joint-N-kept` | float out | `joint.N.motor-offset` that the offset is counted from; its signal keeps it while the component is gone |
//! | `joint-N-now` | float in | `offset-current` of `moveoff` |
//! | `joint-N-cmd`, `joint-N-reference`, `joint-N-homing` | in | `joint.N.pos-cmd`, `joint.N.motor-offset`, `joint.N.homing` |
//! | `heartbeat` | bit out | 10 Hz as long as the component lives and its wires are whole |
//! | `pid` | u32 out | its process |

use std::cell::Cell;

use trueup_core::{cnc::MachineConditions, design_parameters::CONDITION_COUNT};

use crate::{
    component::{ComponentInputs, ComponentOutputs},
    configuration::wiring::{LIMITER_INSTANCE, reference_hold_pin},
    hal::{HalComponent, HalError, Pin},
    joint_offsets::{JointGoal, JointReading, JointSettings, MAX_JOINTS},
    offset_follower::AxisReading,
};

/// At the pin `tool`: it is not known which it is.
const UNKNOWN_TOOL: i32 = -1;
/// A count is a nanometre.
const MM_PER_COUNT: f64 = 1e-6;
const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];
/// No offset is as large, in machine units.
const UNDRIVEN_LIMIT_THRESHOLD: f64 = 1e6;
/// Without the wire of one of these, of an axis' four and of a joint's ten, an offset no longer does what it says.
const REQUIRED_PINS: [&str; 5] = ["machine-on", "homed", "scale", "enable-out", "heartbeat"];
const REQUIRED_AXIS_PINS: [&str; 4] = ["cmd", "request", "eoffset", "counts"];
const JOINT_OUTPUT_PINS: [&str; 6] = ["offset", "min", "max", "vel", "accel", "kept"];
/// The state of a joint is not known before all of these are connected.
const JOINT_INPUT_PINS: [&str; 4] = ["now", "cmd", "reference", "homing"];

/// The pins of an axis.
struct AxisPins<'hal> {
    command: Pin<'hal, f64>,
    request: Pin<'hal, f64>,
    eoffset: Pin<'hal, f64>,
    counts: Pin<'hal, i32>,
    offset_um: Pin<'hal, f64>,
    applied_um: Pin<'hal, f64>,
}

/// The pins of a joint at which an offset enters.
struct JointPins<'hal> {
    offset: Pin<'hal, f64>,
    min: Pin<'hal, f64>,
    max: Pin<'hal, f64>,
    retained: Pin<'hal, f64>,
    now: Pin<'hal, f64>,
    command: Pin<'hal, f64>,
    reference: Pin<'hal, f64>,
    homing: Pin<'hal, bool>,
    wires: Vec<RequiredPin>,
    /// Values that an earlier component has left.
    left: Option<JointGoal>,
}

/// A pin that nothing works without, once it is connected.
struct RequiredPin {
    name: String,
    was_connected: Cell<bool>,
}

impl RequiredPin {
    fn new(name: String) -> Self {
        Self { name, was_connected: Cell::new(false) }
    }
}

/// All pins of the component. Lengths at the pins are in the units of the .ini, temperatures in °C.
pub(crate) struct ComponentPins<'hal> {
    mm_per_unit: f64,
    enable: Pin<'hal, bool>,
    machine_on: Pin<'hal, bool>,
    homed: Pin<'hal, bool>,
    zero: Pin<'hal, bool>,
    service: Pin<'hal, bool>,
    confirm: Pin<'hal, bool>,
    angles: [Pin<'hal, f64>; 2],
    spindle_rpm: Pin<'hal, f64>,
    load_n: Pin<'hal, f64>,
    tool: Pin<'hal, i32>,
    conditions: Vec<Pin<'hal, bool>>,
    axes: [AxisPins<'hal>; 3],
    joints: [Option<JointPins<'hal>>; MAX_JOINTS],
    applied: Pin<'hal, bool>,
    connected: Pin<'hal, bool>,
    fault: Pin<'hal, bool>,
    limited: Pin<'hal, bool>,
    other_calibration: Pin<'hal, bool>,
    quality: Pin<'hal, i32>,
    flags: Pin<'hal, u32>,
    age_ms: Pin<'hal, u32>,
    crc_errors: Pin<'hal, u32>,
    seq_errors: Pin<'hal, u32>,
    malformed: Pin<'hal, u32>,
    lost: Pin<'hal, u32>,
    temperatures: Vec<Pin<'hal, f64>>,
    elongation_um: Pin<'hal, f64>,
    heartbeat: Pin<'hal, bool>,
    hal: &'hal HalComponent,
    wires: Vec<RequiredPin>,
}

/// Returns the pin that holds the process number of the component called `name`.
#[must_use]
pub(crate) fn pid_pin_name(name: &str) -> String {
    format!("{name}.0.pid")
}

impl<'hal> ComponentPins<'hal> {
    /// Makes all pins of the component called `name`.
    ///
    /// # Errors
    /// The HAL refuses one.
    pub fn new(
        hal: &'hal HalComponent,
        name: &str,
        mm_per_unit: f64,
        temperatures: u8,
        joints: &[Option<JointSettings>; MAX_JOINTS],
    ) -> Result<Self, HalError> {
        let full = |pin: &str| format!("{name}.0.{pin}");
        let axis = |letter: &str| -> Result<AxisPins<'hal>, HalError> {
            // When a pin that is written is connected, the HAL gives its value to the signal: any
            // other than the present one would be a change, and move the axis.
            let counts = hal.create_output_pin(&full(&format!("{letter}-counts")))?;
            counts.set(hal.read_foreign_pin(&format!("axis.{letter}.eoffset-counts")).unwrap_or(0));
            // Until it is connected it says that it is not: 0 would be a position.
            let command = hal.create_input_pin(&full(&format!("{letter}-cmd")))?;
            if !hal.has_adopted_pins() {
                command.set(f64::NAN);
            }
            Ok(AxisPins {
                command,
                request: hal.create_input_pin(&full(&format!("{letter}-request")))?,
                eoffset: hal.create_input_pin(&full(&format!("{letter}-eoffset")))?,
                counts,
                offset_um: hal.create_output_pin(&full(&format!("{letter}-offset-um")))?,
                applied_um: hal.create_output_pin(&full(&format!("{letter}-applied-um")))?,
            })
        };
        hal.create_output_pin::<f64>(&full("scale"))?.set(MM_PER_COUNT / mm_per_unit);
        hal.create_output_pin::<bool>(&full("enable-out"))?.set(true);
        hal.create_output_pin::<u32>(&pid_pin_name(name))?.set(std::process::id());
        let tool = hal.create_input_pin(&full("tool"))?;
        // Until it is connected it says that it is not: 0 would be no tool.
        if !hal.has_adopted_pins() {
            tool.set(UNKNOWN_TOOL);
        }
        let condition = |bit: u8| hal.create_input_pin(&full(&format!("condition-{bit:02}")));
        let [x, y, z] = AXIS_NAMES.map(axis);
        let temperature = |number: u8| hal.create_output_pin(&full(&format!("temp-{number:02}")));
        let of_axes = AXIS_NAMES
            .iter()
            .flat_map(|axis| REQUIRED_AXIS_PINS.map(|pin| format!("{axis}-{pin}")));
        let of_joints = joints
            .iter()
            .flatten()
            .flat_map(|joint| JOINT_OUTPUT_PINS.map(|pin| format!("joint-{}-{pin}", joint.number)));
        let wires = REQUIRED_PINS.map(String::from).into_iter().chain(of_axes).chain(of_joints);
        Ok(Self {
            hal,
            wires: wires.map(|pin| RequiredPin::new(full(&pin))).collect(),
            mm_per_unit,
            enable: hal.create_input_pin(&full("enable"))?,
            machine_on: hal.create_input_pin(&full("machine-on"))?,
            homed: hal.create_input_pin(&full("homed"))?,
            zero: hal.create_input_pin(&full("zero"))?,
            service: hal.create_input_pin(&full("service"))?,
            confirm: hal.create_input_pin(&full("confirm"))?,
            angles: [
                hal.create_input_pin(&full("angle-1"))?,
                hal.create_input_pin(&full("angle-2"))?,
            ],
            spindle_rpm: hal.create_input_pin(&full("spindle-rpm"))?,
            load_n: hal.create_input_pin(&full("load-n"))?,
            tool,
            conditions: (0..CONDITION_COUNT).map(condition).collect::<Result<_, HalError>>()?,
            axes: [x?, y?, z?],
            joints: create_joint_pins(hal, name, mm_per_unit, joints)?,
            applied: hal.create_output_pin(&full("applied"))?,
            connected: hal.create_output_pin(&full("connected"))?,
            fault: hal.create_output_pin(&full("fault"))?,
            limited: hal.create_output_pin(&full("limited"))?,
            other_calibration: hal.create_output_pin(&full("other-calibration"))?,
            quality: hal.create_output_pin(&full("quality"))?,
            flags: hal.create_output_pin(&full("flags"))?,
            age_ms: hal.create_output_pin(&full("age-ms"))?,
            crc_errors: hal.create_output_pin(&full("crc-errors"))?,
            seq_errors: hal.create_output_pin(&full("seq-errors"))?,
            malformed: hal.create_output_pin(&full("malformed"))?,
            lost: hal.create_output_pin(&full("lost"))?,
            temperatures: (0..temperatures).map(temperature).collect::<Result<_, HalError>>()?,
            elongation_um: hal.create_output_pin(&full("elongation-um"))?,
            heartbeat: hal.create_output_pin(&full("heartbeat"))?,
        })
    }

    /// Lets the offsets at the joints go on from what a component before this one has left.
    pub(crate) fn resume(&self, component: &mut crate::Component) {
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(left) = joint.as_ref().and_then(|joint| joint.left) {
                component.resume(index, left);
            }
        }
    }

    /// Returns a pin that was connected and is no longer. One that never was belongs to an axis that the machine does
    /// not have.
    #[must_use]
    pub(crate) fn find_disconnected_pin(&self) -> Option<&str> {
        let is_cut = |wire: &&RequiredPin| {
            let is_connected = self.hal.is_pin_connected(&wire.name) == Some(true);
            wire.was_connected.set(wire.was_connected.get() || is_connected);
            wire.was_connected.get() && !is_connected
        };
        // Each is looked at, so that each is known once it has been there.
        let of_joints = self.joints.iter().flatten().flat_map(|joint| &joint.wires);
        let cut: Vec<&RequiredPin> = self.wires.iter().chain(of_joints).filter(is_cut).collect();
        cut.first().map(|wire| wire.name.as_str())
    }

    /// Returns what the pins say.
    #[must_use]
    pub fn read(&self) -> ComponentInputs {
        let nm = |units: f64| units * self.mm_per_unit / MM_PER_COUNT;
        ComponentInputs {
            enable: self.enable.get(),
            machine_on: self.machine_on.get(),
            homed: self.homed.get(),
            zero: self.zero.get(),
            service: self.service.get(),
            confirm: self.confirm.get(),
            position_mm: self.axes.each_ref().map(|axis| axis.command.get() * self.mm_per_unit),
            readings: self.axes.each_ref().map(|axis| AxisReading {
                request_nm: nm(axis.request.get()),
                eoffset_nm: nm(axis.eoffset.get()),
            }),
            joints: self.joints.each_ref().map(|joint| {
                let Some(joint) = joint else { return JointReading::default() };
                if !joint.wires.iter().all(|wire| wire.was_connected.get()) {
                    return JointReading::unconnected();
                }
                JointReading {
                    now_nm: nm(joint.now.get()),
                    command_nm: nm(joint.command.get()),
                    reference_nm: nm(joint.reference.get()),
                    homing: joint.homing.get(),
                }
            }),
            angles_deg: self.angles.each_ref().map(Pin::get),
            spindle_rpm: self.spindle_rpm.get(),
            load_n: self.load_n.get(),
            conditions: self.conditions(),
        }
    }

    /// Returns tool and conditions; `None` for a number that no tool can have: sent, it would be another tool's.
    fn conditions(&self) -> Option<MachineConditions> {
        let tool = u16::try_from(self.tool.get()).ok()?;
        let held = self.conditions.iter().rev();
        let bits = held.fold(0, |bits, pin| bits << 1 | u16::from(pin.get()));
        Some(MachineConditions { tool, bits })
    }

    /// Lets the pins say this. Counts are stepped from where they stand: a signal keeps its value
    /// when a component goes, and the next one goes on from there.
    pub fn write(&self, outputs: &ComponentOutputs) {
        for (axis, pins) in self.axes.iter().enumerate() {
            if outputs.counts[axis] != 0 {
                pins.counts.set(pins.counts.get().wrapping_add(outputs.counts[axis]));
            }
            pins.offset_um.set(outputs.offset_um[axis]);
            pins.applied_um.set(outputs.applied_um[axis]);
        }
        let units = |nm: f64| nm * MM_PER_COUNT / self.mm_per_unit;
        for (joint, goal) in self.joints.iter().zip(&outputs.joints) {
            let Some(joint) = joint else { continue };
            joint.min.set(units(goal.min_nm));
            joint.max.set(units(goal.max_nm));
            joint.offset.set(units(goal.offset_nm));
            joint.retained.set(units(goal.reference_nm));
        }
        self.applied.set(outputs.applied);
        self.connected.set(outputs.connected);
        self.fault.set(outputs.fault);
        self.limited.set(outputs.limited);
        self.other_calibration.set(outputs.other_calibration);
        self.quality.set((outputs.quality as u8).into());
        self.flags.set(outputs.flags.0.into());
        self.age_ms.set(outputs.age_ms);
        self.crc_errors.set(outputs.counters.crc_errors);
        self.seq_errors.set(outputs.counters.sequence_errors);
        self.malformed.set(outputs.counters.malformed);
        self.lost.set(outputs.counters.lost);
        for (pin, temperature) in self.temperatures.iter().zip(outputs.temperatures_c) {
            pin.set(temperature.unwrap_or(f64::NAN));
        }
        self.elongation_um.set(outputs.elongation_um.unwrap_or(f64::NAN));
        self.heartbeat.set(outputs.heartbeat);
    }
}

/// Makes the pins of the joints. Until the first step they say what `moveoff` does already: a signal takes its value
/// from the pin that is connected to it.
fn create_joint_pins<'hal>(
    hal: &'hal HalComponent,
    name: &str,
    mm_per_unit: f64,
    joints: &[Option<JointSettings>; MAX_JOINTS],
) -> Result<[Option<JointPins<'hal>>; MAX_JOINTS], HalError> {
    let mut all = [const { None }; MAX_JOINTS];
    for (channel, settings) in joints.iter().enumerate() {
        let Some(settings) = *settings else { continue };
        let full = |pin: &str| format!("{name}.0.joint-{}-{pin}", settings.number);
        let there = |pin: &str| {
            hal.read_foreign_pin::<f64>(&format!("{LIMITER_INSTANCE}.offset-{pin}-{channel}"))
        };
        let [offset, min, max] = [
            hal.create_output_pin(&full("offset"))?,
            hal.create_output_pin(&full("min"))?,
            hal.create_output_pin(&full("max"))?,
        ];
        // Read before it is set: the pin of a component that was killed is still on its signal.
        let of_base =
            hal.read_foreign_pin(&reference_hold_pin(settings.number)).unwrap_or(f64::NAN);
        let retained = hal.create_output_pin(&full("kept"))?;
        retained.set(f64::NAN);
        let nm = |units: f64| units * mm_per_unit / MM_PER_COUNT;
        // The limits of a moveoff that no component has driven yet are 10²⁰.
        let driven = there("min").zip(there("max")).filter(|(min, max)| {
            min.abs() < UNDRIVEN_LIMIT_THRESHOLD && max.abs() < UNDRIVEN_LIMIT_THRESHOLD
        });
        let left = driven.zip(there("in")).map(|((low, high), goal)| {
            min.set(low);
            max.set(high);
            offset.set(goal);
            retained.set(of_base);
            JointGoal {
                offset_nm: nm(goal),
                min_nm: nm(low),
                max_nm: nm(high),
                reference_nm: nm(of_base),
            }
        });
        hal.create_output_pin::<f64>(&full("vel"))?.set(settings.mm_per_s / mm_per_unit);
        hal.create_output_pin::<f64>(&full("accel"))?.set(settings.mm_per_s2 / mm_per_unit);
        all[channel] = Some(JointPins {
            offset,
            min,
            max,
            retained,
            now: hal.create_input_pin(&full("now"))?,
            command: hal.create_input_pin(&full("cmd"))?,
            reference: hal.create_input_pin(&full("reference"))?,
            homing: hal.create_input_pin(&full("homing"))?,
            wires: JOINT_INPUT_PINS.map(|pin| RequiredPin::new(full(pin))).into(),
            left,
        });
    }
    Ok(all)
}
