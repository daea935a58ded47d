//! A servo period of the bridge without a board: pins in, pins out.
//!
//! ```text
//!  pins ─► component ─ frames ─► node ─ tick, service ─ frames ─► component ─► pins, a period later
//! ```
//!
//! A tick of the node is a millisecond. A servo period has these ticks:
//!
//! | servo period | ticks |
//! |---|---|
//! | 0.5 ms | one every second period, with a sample of each |
//! | 1 ms | one |
//! | 2, 4 ms | two, four, with the same sample |
//!
//! Other periods are refused: no tick runs, and the reason is reported ([`ServoError`]).
//!
//! A joint of LinuxCNC follows the command of its axis two periods later, and an offset takes one from the position to
//! the joint. So where offsets enter at the joints, a position waits for a period, and its offset acts together with
//! it.

use core::time::Duration;

use trueup_core::{
    bridge::TickInput, cnc::MachineConditions, design_parameters::TEMPERATURE_CHANNEL_COUNT,
    temperature_channels::RawTemperatures, thermometer::RawTemperatureReading,
};
use trueup_link::slcan::AdapterMessage;
use trueup_linuxcnc_core::{
    NANOMETRES_PER_MILLIMETRE,
    component::{self, Component, ComponentOptions},
    joint_offsets::{JointReading, JointSettings, MAX_JOINTS},
    offset_follower::{AxisReading, RateLimits},
    offset_target,
};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_store::{
    calibration::{self, BlobError, calibration_crc},
    retained_state::{self, RetainedCopies},
};

use crate::{
    sensor::{SensorScale, TickSamples},
    temperature::ChannelConversion,
};

pub use trueup_linuxcnc_core::component::ComponentOutputs;

/// The bridge runs in the same thread: a silence of this length is a fault of this program.
const OFFSETS_STALE_TIMEOUT: Duration = Duration::from_millis(100);
/// Time between two copies of the heat, which changes no faster.
const RETAIN_PERIOD_US: u64 = 1_000_000;
const US_PER_S: u64 = 1_000_000;
const NS_PER_US: u64 = 1_000;
const US_PER_TICK: u64 = 1_000;
/// LinuxCNC rounds a period to its timer.
const SERVO_PERIOD_TOLERANCE_NS: u64 = 1_000;
/// Supported servo periods.
const SUPPORTED_SERVO_PERIODS_US: [u64; 4] = [500, 1_000, 2_000, 4_000];

/// How the component is set: what setup has written into the HAL file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoSettings {
    /// Millimetres in a machine unit.
    pub mm_per_unit: f64,
    /// The input of the sensor.
    pub sensor: SensorScale,
    /// True if angles are given.
    pub sends_rotary: bool,
    /// The most by which the offset of X, Y and Z goes against a reversal, in µm; not a number where that is not known.
    pub against_um: [f64; 3],
    /// Acceleration of LinuxCNC's planner for the external offsets of X, Y and Z, in machine units per second².
    pub acceleration: [f64; 3],
    /// LinuxCNC itself lets these offsets change no faster than the slew limit (`OFFSET_AV_RATIO`).
    pub planner_keeps_slew: [bool; 3],
    /// The joints at which offsets enter; none: as external offsets of the axes.
    pub joints: [Option<Joint>; MAX_JOINTS],
    /// Temperatures that are given by a program count as missing when its heartbeat has stood for this time; 0: never.
    pub temperature_timeout_ms: u32,
}

/// A joint at which an offset enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Index of its axis: X, Y, Z.
    pub axis: usize,
    /// Least and largest position of the drive, in machine units.
    pub limits: [f64; 2],
}

/// Values of the pins. Lengths are in machine units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ServoInputs {
    /// The operator wants offsets.
    pub enable: bool,
    /// LinuxCNC's motion is enabled.
    pub machine_on: bool,
    /// All joints are homed.
    pub homed: bool,
    /// The operator takes the present error as the reference.
    pub zero: bool,
    /// The operator confirms what the bridge requires.
    pub confirm: bool,
    /// Commanded positions of X, Y and Z, without the external offset.
    pub position: [f64; 3],
    /// `axis.L.eoffset-request` of X, Y and Z.
    pub request: [f64; 3],
    /// `axis.L.eoffset` of X, Y and Z.
    pub eoffset: [f64; 3],
    /// Commanded angles of the head axes in degrees.
    pub angles_deg: [f64; 2],
    /// Spindle speed in r/min.
    pub spindle_rpm: f64,
    /// Axial cutting force in N.
    pub load_n: f64,
    /// The tool; below 0: not known.
    pub tool: i32,
    /// A bit for each condition.
    pub conditions: u16,
    /// Offset that acts at each joint.
    pub joint_now: [f64; MAX_JOINTS],
    /// Commanded position of each joint.
    pub joint_command: [f64; MAX_JOINTS],
    /// LinuxCNC's reference of each joint.
    pub joint_reference: [f64; MAX_JOINTS],
    /// A bit for each joint that is homed now.
    pub joint_homing: u16,
    /// The sensor, in volts; not a number: none.
    pub sensor_v: f64,
    /// Temperatures of the channels in °C; not a number: none.
    pub temperature_c: [f64; TEMPERATURE_CHANNEL_COUNT],
    /// Changes with each set of temperatures, where a program gives them.
    pub temperature_heartbeat: bool,
}

/// Why nothing runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServoError {
    /// The calibration is not one.
    Calibration(BlobError),
    /// The servo period, in ns, is none of 0.5, 1, 2 and 4 ms.
    Period(u64),
}

/// The node and the component, between two servo periods.
#[derive(Debug)]
pub struct ServoBridge {
    node: Node<'static>,
    component: Component,
    settings: ServoSettings,
    channels: [ChannelConversion; TEMPERATURE_CHANNEL_COUNT],
    /// CRC of the calibration.
    calibration: u32,
    /// Where X, Y and Z were commanded a period ago.
    position_before: Option<[f64; 3]>,
    samples: TickSamples,
    temperatures: RawTemperatures,
    /// Which channel is converted next.
    turn: usize,
    heartbeat: bool,
    since_heartbeat_us: u64,
    now_us: u64,
    /// Time of a tick that has passed already.
    pending_us: u64,
    /// The wall's clock at the start, in seconds.
    started_s: Option<u32>,
    retain_at_us: u64,
    /// Of the next copy.
    copy: u32,
}

/// Returns the ticks' time of a servo period.
///
/// # Errors
/// [`ServoError::Period`].
pub(crate) fn find_supported_period_us(period_ns: u64) -> Result<u64, ServoError> {
    let near =
        |us: &&u64| period_ns.abs_diff(us.saturating_mul(NS_PER_US)) <= SERVO_PERIOD_TOLERANCE_NS;
    SUPPORTED_SERVO_PERIODS_US.iter().find(near).copied().ok_or(ServoError::Period(period_ns))
}

impl ServoBridge {
    /// Returns a bridge that has just been switched on.
    ///
    /// # Errors
    /// The calibration or the servo period is refused.
    pub fn new(
        blob: &'static [u8],
        settings: &ServoSettings,
        period_ns: u64,
    ) -> Result<Self, ServoError> {
        let period_us = find_supported_period_us(period_ns)?;
        let blob = calibration::validate_blob(blob).map_err(ServoError::Calibration)?;
        let law = calibration::decode(blob).map_err(ServoError::Calibration)?;
        let mut channels = [ChannelConversion::Unused; TEMPERATURE_CHANNEL_COUNT];
        for (channel, thermometer) in channels.iter_mut().zip(&law.thermometers) {
            *channel = ChannelConversion::from_thermometer(thermometer.as_ref());
        }
        let limits = law.limits;
        let nm = |units: f64| units * settings.mm_per_unit * NANOMETRES_PER_MILLIMETRE;
        let cycle = Duration::from_micros(period_us);
        let slew = RateLimits {
            slew_nm_per_s: limits.slew_nm_per_s.into(),
            cycle_s: period_us as f64 * 1e-6,
            acceleration_nm_per_s2: f64::INFINITY,
            planner_keeps_slew: false,
        };
        let mut pace = [slew; 3];
        let of_axes = settings.acceleration.iter().zip(settings.planner_keeps_slew);
        for (pace, (acceleration, planner_keeps_slew)) in pace.iter_mut().zip(of_axes) {
            pace.planner_keeps_slew = planner_keeps_slew;
            if *acceleration > 0.0 {
                pace.acceleration_nm_per_s2 = nm(*acceleration);
            }
        }
        let mut joints = [None; MAX_JOINTS];
        for (number, (place, joint)) in joints.iter_mut().zip(&settings.joints).enumerate() {
            *place = joint.map(|joint| JointSettings {
                number,
                axis: joint.axis,
                limits_nm: joint.limits.map(nm),
                // The limits of `moveoff` are set by the HAL file.
                mm_per_s: 0.0,
                mm_per_s2: 0.0,
            });
        }
        let options = ComponentOptions {
            limits: offset_target::OffsetLimits {
                max_nm: limits.max.map(|max| max.0),
                stale: OFFSETS_STALE_TIMEOUT,
                hold: Duration::from_millis(limits.hold_ms.into()),
            },
            pace,
            position_period: cycle,
            sends_rotary: settings.sends_rotary,
            against_um: settings.against_um.map(|um| um.is_finite().then_some(um)),
            joints,
        };
        let node = Node::new(NodeConfiguration { blob, ..law.into() });
        Ok(Self {
            node,
            component: Component::new(Duration::ZERO, options),
            settings: *settings,
            channels,
            calibration: calibration_crc(blob),
            position_before: None,
            samples: TickSamples::default(),
            temperatures: [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT],
            turn: 0,
            heartbeat: false,
            since_heartbeat_us: 0,
            now_us: 0,
            pending_us: 0,
            started_s: None,
            retain_at_us: RETAIN_PERIOD_US,
            copy: 1,
        })
    }

    /// Returns the node.
    #[must_use]
    pub fn node(&self) -> &Node<'static> {
        &self.node
    }

    /// Goes on with the heat from before a restart, `copies` as they were saved last. `now_s`: the wall's clock. Where
    /// it does not say for how long nothing ran, or no copy is whole, the heat is not known, as on the board after a
    /// power cut.
    pub fn resume(&mut self, copies: &RetainedCopies, now_s: Option<u32>) {
        self.started_s = now_s;
        let off_s = retained_state::off_time_s(copies, now_s);
        let stored = retained_state::load(copies).filter(|_| off_s.is_some());
        self.node.resume(stored.as_ref(), off_s.unwrap_or(0));
    }

    /// Saves the heat into the older of the copies once a second. Returns true if it did.
    pub fn save_retained_state(&mut self, copies: &mut RetainedCopies) -> bool {
        if self.now_us < self.retain_at_us {
            return false;
        }
        self.retain_at_us = self.now_us.saturating_add(RETAIN_PERIOD_US);
        let passed_s = u32::try_from(self.now_us / US_PER_S).unwrap_or(u32::MAX);
        let now_s = self.started_s.map(|started| started.saturating_add(passed_s));
        self.copy =
            retained_state::write_copy(copies, self.copy, &self.node.retained_state(), now_s);
        true
    }

    /// Returns the nanometres in a machine unit.
    #[must_use]
    pub(crate) fn nm_per_unit(&self) -> f64 {
        self.settings.mm_per_unit * NANOMETRES_PER_MILLIMETRE
    }

    /// Returns the CRC of the calibration.
    #[must_use]
    pub fn calibration_crc(&self) -> u32 {
        self.calibration
    }

    /// Runs a servo period.
    ///
    /// # Errors
    /// [`ServoError::Period`]: nothing has run.
    pub fn step(
        &mut self,
        inputs: &ServoInputs,
        period_ns: u64,
    ) -> Result<ComponentOutputs, ServoError> {
        let period_us = find_supported_period_us(period_ns)?;
        self.sample_inputs(inputs, period_us);
        let now = Duration::from_micros(self.now_us);
        let position =
            self.position_before.replace(inputs.position).filter(|_| self.has_joint_offsets());
        let position = position.unwrap_or(inputs.position);
        let (mut outputs, frames) =
            self.component.step(now, &self.component_inputs(inputs, position));
        outputs.calibration = Some(self.calibration);
        for frame in &frames {
            // The node counts a refused frame, and its status has the count.
            self.node.receive(Interface::Can, frame).ok();
        }
        self.now_us = self.now_us.saturating_add(period_us);
        self.pending_us = self.pending_us.saturating_add(period_us);
        while self.pending_us >= US_PER_TICK {
            self.pending_us = self.pending_us.saturating_sub(US_PER_TICK);
            self.tick(inputs);
        }
        Ok(outputs)
    }

    fn has_joint_offsets(&self) -> bool {
        self.settings.joints.iter().any(Option::is_some)
    }

    /// Takes the samples of this period.
    fn sample_inputs(&mut self, inputs: &ServoInputs, period_us: u64) {
        let parts = if period_us < US_PER_TICK { 2 } else { 1 };
        let part = usize::from(self.pending_us > 0);
        self.samples.add_sample(inputs.sensor_v, &self.settings.sensor, part, parts);
        self.since_heartbeat_us = self.since_heartbeat_us.saturating_add(period_us);
        if inputs.temperature_heartbeat != self.heartbeat {
            self.heartbeat = inputs.temperature_heartbeat;
            self.since_heartbeat_us = 0;
        }
    }

    /// Runs a tick of the node, and lets the component receive what it sends.
    fn tick(&mut self, inputs: &ServoInputs) {
        let timeout_us =
            u64::from(self.settings.temperature_timeout_ms).saturating_mul(US_PER_TICK);
        let is_late = timeout_us > 0 && self.since_heartbeat_us > timeout_us;
        // One channel a tick: a temperature is slow.
        self.turn = if self.turn.saturating_add(1) < TEMPERATURE_CHANNEL_COUNT {
            self.turn.saturating_add(1)
        } else {
            0
        };
        if let Some(((place, channel), celsius)) = self
            .temperatures
            .iter_mut()
            .zip(&self.channels)
            .zip(&inputs.temperature_c)
            .nth(self.turn)
        {
            *place = if is_late {
                RawTemperatureReading::NONE
            } else {
                channel.raw_reading_from_celsius(*celsius)
            };
        }
        let input = TickInput {
            codes: self.samples.codes(),
            speed: None,
            temperatures: Some(&self.temperatures),
        };
        let now = Duration::from_micros(self.now_us);
        for frame in self.node.tick(1, input) {
            self.component.receive(now, &AdapterMessage::Frame(frame));
        }
        if let Some(frame) = self.node.next_service_frame() {
            self.component.receive(now, &AdapterMessage::Frame(frame));
        }
    }

    fn component_inputs(
        &self,
        inputs: &ServoInputs,
        position: [f64; 3],
    ) -> component::ComponentInputs {
        let mm_per_unit = self.settings.mm_per_unit;
        let nm = |units: f64| units * mm_per_unit * NANOMETRES_PER_MILLIMETRE;
        let mut readings = [AxisReading::default(); 3];
        for (reading, (request, eoffset)) in
            readings.iter_mut().zip(inputs.request.iter().zip(&inputs.eoffset))
        {
            *reading = AxisReading { request_nm: nm(*request), eoffset_nm: nm(*eoffset) };
        }
        let mut joints = [JointReading::default(); MAX_JOINTS];
        let pins = inputs.joint_now.iter().zip(&inputs.joint_command).zip(&inputs.joint_reference);
        for (number, (joint, ((now, command), reference))) in
            joints.iter_mut().zip(pins).enumerate()
        {
            *joint = JointReading {
                now_nm: nm(*now),
                command_nm: nm(*command),
                reference_nm: nm(*reference),
                homing: inputs.joint_homing >> number & 1 == 1,
            };
        }
        component::ComponentInputs {
            enable: inputs.enable,
            machine_on: inputs.machine_on,
            homed: inputs.homed,
            zero: inputs.zero,
            // Nothing is written to a node without a board.
            service: false,
            confirm: inputs.confirm,
            position_mm: position.map(|units| units * mm_per_unit),
            readings,
            joints,
            angles_deg: inputs.angles_deg,
            spindle_rpm: inputs.spindle_rpm,
            load_n: inputs.load_n,
            conditions: u16::try_from(inputs.tool)
                .ok()
                .map(|tool| MachineConditions { tool, bits: inputs.conditions }),
        }
    }
}
