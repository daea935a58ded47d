//! The component without its HAL: pins and frames in, pins and frames out.

use core::time::Duration;

use trueup_core::{
    cnc::{Control, MachineConditions, OffsetFlags, OffsetQuality},
    learned_changes::LEARNED_PART_COUNT,
};
use trueup_link::{
    layout::STATUS_ID, receiver::FrameCounters, slcan::AdapterMessage, status::StateBits,
};

use crate::{
    NANOMETRES_PER_MICROMETRE, NANOMETRES_PER_MILLIMETRE,
    bridge_status::BridgeStatus,
    engage::EngageSequence,
    joint_offsets::{
        AppliedOffsets, JointGoal, JointOffsets, JointReading, JointSettings, MAX_JOINTS,
        StepInputs,
    },
    offset_follower::{AxisReading, OffsetFollower, RateLimits},
    offset_target::{OffsetLimits, OffsetTarget, ReceivedOffsets},
    sender::{CncTransmitter, CommandValues, DueFrames},
};

/// LinuxCNC has applied an offset when it is within this of it, in nanometres: the planner stops a
/// thousandth of its step before its goal, and a wire bit is 10 nm.
const APPLIED_TOLERANCE_NM: f64 = 20.0;
pub use crate::bridge_status::TEMPERATURE_CHANNEL_COUNT;
/// Each item of `Status` comes every 1.1 s; three missed, and it counts as unknown.
const STATUS_TIMEOUT: Duration = Duration::from_millis(3_400);
/// How often the heartbeat turns round.
const HEARTBEAT_HALF_PERIOD: Duration = Duration::from_millis(50);

/// How the component is set.
#[derive(Clone, Copy, Debug)]
pub struct ComponentOptions {
    /// How long silence is tolerated, and how large an offset may be.
    pub limits: OffsetLimits,
    /// How fast the offset of each axis may change.
    pub pace: [RateLimits; 3],
    /// How often the position of a moving axis is sent.
    pub position_period: Duration,
    /// Whether angles are sent.
    pub sends_rotary: bool,
    /// The most by which the offset of X, Y and Z goes against a reversal, in µm, where that is known:
    /// then an offset can turn an axis as well.
    pub against_um: [Option<f64>; 3],
    /// The joints at which offsets enter; none: as external offsets of the axes.
    pub joints: [Option<JointSettings>; MAX_JOINTS],
}

/// Values of the input pins.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ComponentInputs {
    /// The operator wants offsets.
    pub enable: bool,
    /// LinuxCNC's motion is enabled.
    pub machine_on: bool,
    /// All joints are homed.
    pub homed: bool,
    /// The operator takes the present error as the reference.
    pub zero: bool,
    /// The operator allows that a master writes to the bridge while nothing is engaged.
    pub service: bool,
    /// The operator confirms what the bridge requires.
    pub confirm: bool,
    /// Commanded positions of X, Y and Z in mm, without the external offset.
    pub position_mm: [f64; 3],
    /// LinuxCNC's external offsets of X, Y and Z, as requested and as applied.
    pub readings: [AxisReading; 3],
    /// The joints at which offsets enter.
    pub joints: [JointReading; MAX_JOINTS],
    /// Commanded angles of the head axes in degrees.
    pub angles_deg: [f64; 2],
    /// Spindle speed in r/min.
    pub spindle_rpm: f64,
    /// Axial cutting force in N.
    pub load_n: f64,
    /// Tool and conditions; `None`: the pin `tool` says nothing.
    pub conditions: Option<MachineConditions>,
}

/// Values for the output pins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ComponentOutputs {
    /// To be added to the counts of X, Y and Z, with wrapping.
    pub counts: [i32; 3],
    /// Goals and limits of the joints' offsets for `moveoff`.
    pub joints: [JointGoal; MAX_JOINTS],
    /// The bridge's offsets, in µm; the last that were received, where it is silent.
    pub offset_um: [f64; 3],
    /// The offsets that LinuxCNC has applied, in µm.
    pub applied_um: [f64; 3],
    /// The offsets of the bridge are applied on every axis.
    pub applied: bool,
    /// Valid offsets arrive.
    pub connected: bool,
    /// No offset can be trusted: none for longer than the hold, "not available", or LinuxCNC takes none.
    pub fault: bool,
    /// An axis could not follow for half a second: soft limit, joint mode, no `OFFSET_AV_RATIO`.
    pub limited: bool,
    /// LinuxCNC does not take the offset of an axis.
    pub not_taken: bool,
    /// As on the wire; 4 while the component holds, 5 while it takes back, 6 after that.
    pub quality: OffsetQuality,
    /// As on the wire.
    pub flags: OffsetFlags,
    /// Milliseconds since the sample on which the offset rests.
    pub age_ms: u32,
    /// Counters of received frames.
    pub counters: FrameCounters,
    /// The bridge's temperatures in °C; `None` where it does not say.
    pub temperatures_c: [Option<f64>; TEMPERATURE_CHANNEL_COUNT],
    /// The elongation of the spindle by its sensor, in µm; `None` where the bridge does not say.
    pub elongation_um: Option<f64>,
    /// State bits that the bridge reports next to its offsets.
    pub state: StateBits,
    /// CRC of the calibration that the bridge runs on, once it has reported it; 0: none.
    pub calibration: Option<u32>,
    /// Nothing is engaged, because the bridge runs on another calibration than the pinned one, or it is not known
    /// which one that is.
    pub other_calibration: bool,
    /// Turns round ten times a second as long as the component lives.
    pub heartbeat: bool,
}

/// The component: from the pins and the bridge's frames to the new pins, once a turn of the loop.
#[derive(Debug)]
pub struct Component {
    options: ComponentOptions,
    offsets: ReceivedOffsets,
    followers: [OffsetFollower; 3],
    /// At the joints, if any gets an offset.
    joints: JointOffsets,
    sender: CncTransmitter,
    engage: EngageSequence,
    status: BridgeStatus,
    was_away: bool,
    offset_nm: [i32; 3],
}

impl Component {
    /// Returns a component that begins now.
    #[must_use]
    pub fn new(now: Duration, options: ComponentOptions) -> Self {
        Self {
            options,
            offsets: ReceivedOffsets::new(now),
            followers: Default::default(),
            joints: JointOffsets::default(),
            sender: CncTransmitter::new(
                options.position_period,
                options.sends_rotary,
                options.against_um,
            ),
            engage: EngageSequence::default(),
            status: BridgeStatus::default(),
            was_away: false,
            offset_nm: [0; 3],
        }
    }

    /// Lets the offset of a joint go on from what a component before this one has left.
    pub fn resume(&mut self, joint: usize, left: JointGoal) {
        self.joints.resume(joint, left);
    }

    /// Says from now on what was learned, in the bridge's units, to a bridge that runs on the calibration with this
    /// CRC; `None`: nothing.
    pub fn set_learned_values(&mut self, learned: Option<([i16; LEARNED_PART_COUNT], u32)>) {
        let running = self.status.calibration;
        self.sender
            .set_learned_values(learned.filter(|(_, calibration)| running == Some(*calibration)));
    }

    /// Says from now on that nothing was learned, to whatever calibration the bridge runs on: values that it got before
    /// this component began stay in force until they are taken back.
    pub fn clear_learned_values(&mut self) {
        self.sender.set_learned_values(
            self.status.calibration.map(|running| ([0; LEARNED_PART_COUNT], running)),
        );
    }

    /// Takes what came over the line.
    pub fn receive(&mut self, now: Duration, event: &AdapterMessage) {
        match event {
            AdapterMessage::Frame(frame) if frame.id() == STATUS_ID => {
                self.status.receive(now, frame)
            }
            AdapterMessage::Frame(frame) => self.offsets.receive(now, frame),
            AdapterMessage::Malformed(_) => self.offsets.count_malformed_line(),
            AdapterMessage::Accepted | AdapterMessage::Rejected | AdapterMessage::Other(_) => {}
        }
    }

    /// Returns one turn of the loop: what the pins are to say, and the frames to send.
    pub fn step(
        &mut self,
        now: Duration,
        inputs: &ComponentInputs,
    ) -> (ComponentOutputs, DueFrames) {
        let ready = inputs.machine_on && inputs.homed;
        let limits = &self.options.limits;
        let target = self.offsets.update_target(now, limits);
        if let OffsetTarget::Follow(offset) = target {
            self.offset_nm = offset;
        }
        let goal = match target {
            OffsetTarget::Follow(offset) => Some(offset),
            OffsetTarget::Hold => None,
            OffsetTarget::RampOut => Some([0; 3]),
        };
        let mut outputs = ComponentOutputs::default();
        let applied = self.apply_offsets(now, inputs, ready, goal, &mut outputs);
        let AppliedOffsets { nm: applied_nm, at_zero, arrived, .. } = applied;
        outputs.offset_um = self.offset_nm.map(|nm| f64::from(nm) / NANOMETRES_PER_MICROMETRE);
        outputs.applied_um = applied_nm.map(|nm| nm / NANOMETRES_PER_MICROMETRE);
        let limits = &self.options.limits;
        let fresh = self.offsets.fresh_output(now, limits);
        // A bridge that was away may be another one, or have another calibration: until it says which.
        let is_here = fresh.is_some_and(|output| output.quality != OffsetQuality::Fault);
        let is_away = target == OffsetTarget::RampOut && !is_here;
        if is_away && !self.was_away {
            self.status.calibration = None;
        }
        self.was_away = is_away;
        outputs.connected = fresh.is_some();
        outputs.flags = fresh.map_or(OffsetFlags::NONE, |output| output.flags);
        outputs.flags = outputs.flags.with_if(self.offsets.is_clamped(), OffsetFlags::CLAMPED);
        outputs.quality = match (target, fresh) {
            (OffsetTarget::Follow(_), Some(output)) => output.quality,
            (OffsetTarget::Follow(_) | OffsetTarget::Hold, _) => OffsetQuality::Hold,
            (OffsetTarget::RampOut, _) if at_zero => OffsetQuality::Fault,
            (OffsetTarget::RampOut, _) => OffsetQuality::RampingOut,
        };
        outputs.fault = outputs.not_taken || target == OffsetTarget::RampOut;
        outputs.applied = ready && matches!(target, OffsetTarget::Follow(_)) && arrived;
        outputs.age_ms = self.offsets.age_ms(now).unwrap_or(u32::MAX);
        outputs.counters = self.offsets.counters();
        let known = |reported: Option<(Duration, f64)>| {
            reported
                .filter(|(at, _)| now.saturating_sub(*at) <= STATUS_TIMEOUT)
                .map(|(_, value)| value)
        };
        outputs.temperatures_c = self.status.temperatures_c.map(known);
        outputs.elongation_um = known(self.status.elongation_um);
        (outputs.state, outputs.calibration) = (self.status.state, self.status.calibration);
        outputs.heartbeat = (now.as_millis() / HEARTBEAT_HALF_PERIOD.as_millis()) % 2 == 1;

        let control = Control {
            engage: self.engage.step(
                now,
                inputs.enable && inputs.machine_on,
                fresh.is_none_or(|output| output.quality != OffsetQuality::Fault),
                at_zero,
            ),
            referenced: inputs.homed,
            zero: inputs.zero,
            service: inputs.service,
            confirm: inputs.confirm,
            ..Control::default()
        };
        let command = CommandValues {
            control,
            position_mm: inputs.position_mm,
            offset_mm: applied_nm.map(|nm| nm / NANOMETRES_PER_MILLIMETRE),
            angles_deg: inputs.angles_deg,
            spindle_rpm: inputs.spindle_rpm,
            load_n: inputs.load_n,
            conditions: inputs.conditions,
        };
        (outputs, self.sender.take_due_frames(now, &command))
    }

    /// Brings the offsets towards their goal, at the joints or as external offsets.
    fn apply_offsets(
        &mut self,
        now: Duration,
        inputs: &ComponentInputs,
        ready: bool,
        goal_nm: Option<[i32; 3]>,
        outputs: &mut ComponentOutputs,
    ) -> AppliedOffsets {
        if self.options.joints.iter().any(Option::is_some) {
            let step = StepInputs { now, ready, goal_nm, max_nm: self.options.limits.max_nm };
            let (goals, applied) = self.joints.step(&step, &self.options.joints, &inputs.joints);
            (outputs.limited, outputs.not_taken) = (applied.limited, applied.not_taken);
            outputs.joints = goals;
            return applied;
        }
        let mut applied = AppliedOffsets::ZERO;
        for (axis, follower) in self.followers.iter_mut().enumerate() {
            let reading = inputs.readings[axis];
            let goal = goal_nm.map(|goal| goal[axis]);
            let step = follower.step(now, ready, goal, reading, &self.options.pace[axis]);
            outputs.counts[axis] = step.counts;
            outputs.limited |= step.stuck;
            outputs.not_taken |= step.not_taken;
            let offset = f64::from(self.offset_nm[axis]);
            applied.nm[axis] = reading.eoffset_nm;
            applied.at_zero &= reading.eoffset_nm.abs() <= APPLIED_TOLERANCE_NM;
            applied.arrived &= (reading.eoffset_nm - offset).abs() <= APPLIED_TOLERANCE_NM
                && (reading.request_nm - offset).abs() <= APPLIED_TOLERANCE_NM;
        }
        applied
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::vec::Vec;
    use trueup_core::{
        cnc::{CncMessage as Received, Output},
        units::Nanometres,
    };
    use trueup_link::{
        frames::{encode_offset_xy, encode_offset_z},
        receiver::CncReceiver,
        status::{self, StatusItem},
    };

    const SLEW: f64 = 500e3;

    pub(crate) fn component() -> Component {
        let pace = RateLimits {
            slew_nm_per_s: SLEW,
            cycle_s: 1e-3,
            acceleration_nm_per_s2: f64::INFINITY,
            planner_keeps_slew: true,
        };
        let limits = OffsetLimits {
            max_nm: [200_000; 3],
            stale: Duration::from_millis(100),
            hold: Duration::from_millis(2_000),
        };
        let position_period = Duration::from_millis(2);
        let options = ComponentOptions {
            limits,
            pace: [pace; 3],
            position_period,
            sends_rotary: false,
            against_um: [Some(0.0); 3],
            joints: [None; MAX_JOINTS],
        };
        Component::new(Duration::ZERO, options)
    }

    /// A machine that executes each request at once, and a bridge that says this every
    /// millisecond, while it is there.
    struct World {
        component: Component,
        inputs: ComponentInputs,
        offset: Option<[i32; 3]>,
        outputs: ComponentOutputs,
        controls: Vec<Control>,
        receiver: CncReceiver,
        ms: u64,
    }

    impl World {
        fn new() -> Self {
            Self {
                component: component(),
                inputs: ComponentInputs {
                    enable: true,
                    machine_on: true,
                    homed: true,
                    ..ComponentInputs::default()
                },
                offset: Some([0; 3]),
                outputs: ComponentOutputs::default(),
                controls: Vec::new(),
                receiver: CncReceiver::new(),
                ms: 0,
            }
        }

        fn live(&mut self, ms: u64) {
            for _ in 0..ms {
                self.ms += 1;
                let now = Duration::from_millis(self.ms);
                if let Some(offset) = self.offset {
                    let offset = Some(offset.map(Nanometres));
                    let output =
                        Output { offset, quality: OffsetQuality::Live, ..Output::default() };
                    let counter = (self.ms % 256) as u8;
                    for frame in
                        [encode_offset_xy(&output, counter), encode_offset_z(&output, counter)]
                    {
                        self.component.receive(now, &AdapterMessage::Frame(frame));
                    }
                }
                let (outputs, frames) = self.component.step(now, &self.inputs);
                for (reading, counts) in self.inputs.readings.iter_mut().zip(outputs.counts) {
                    if self.inputs.machine_on && self.inputs.homed {
                        reading.request_nm += f64::from(counts);
                    }
                    reading.eoffset_nm = reading.request_nm;
                }
                for frame in &frames {
                    let received = self.receiver.accept(frame).expect("in order");
                    if let Some(Received::Control(control)) = received {
                        self.controls.push(control);
                    }
                }
                self.outputs = outputs;
            }
        }

        fn z_um(&self) -> f64 {
            self.outputs.applied_um[2]
        }
    }

    #[test]
    fn an_offset_is_applied_at_the_slew_limit_and_reported() {
        let mut world = World::new();
        world.offset = Some([1_000, -2_000, 40_000]);
        world.live(100);
        assert!(world.outputs.connected && !world.outputs.applied, "40 um take 80 ms after 50");
        assert_eq!(world.outputs.offset_um, [1.0, -2.0, 40.0]);
        world.live(40);
        assert_eq!(world.outputs.applied_um, [1.0, -2.0, 40.0]);
        assert!(world.outputs.applied && !world.outputs.fault && !world.outputs.limited);
        assert_eq!(world.outputs.quality, OffsetQuality::Live);
    }

    #[test]
    fn a_silent_bridge_is_held_then_taken_back_then_a_fault_without_offset() {
        let mut world = World::new();
        world.offset = Some([0, 0, 40_000]);
        world.live(200);
        world.offset = None;
        world.live(150);
        assert_eq!((world.outputs.quality, world.outputs.connected), (OffsetQuality::Hold, false));
        world.live(1_900);
        assert_eq!((world.z_um(), world.outputs.fault), (40.0, false));
        world.live(90);
        assert_eq!((world.outputs.quality, world.outputs.fault), (OffsetQuality::RampingOut, true));
        world.live(100);
        assert_eq!((world.outputs.quality, world.z_um()), (OffsetQuality::Fault, 0.0));
        world.offset = Some([0, 0, 40_000]);
        world.live(150);
        assert_eq!((world.z_um(), world.outputs.fault), (40.0, false));
    }

    #[test]
    fn the_bridge_is_engaged_only_while_the_machine_is_on_and_referenced_only_while_homed() {
        let mut world = World::new();
        for (enable, machine_on, homed) in
            [(true, true, true), (true, false, true), (false, true, true), (true, true, false)]
        {
            world.inputs = ComponentInputs { enable, machine_on, homed, ..world.inputs };
            world.live(200);
            let control = world.controls.last().expect("at once");
            assert_eq!((control.engage, control.referenced), (enable && machine_on, homed));
        }
    }

    #[test]
    fn temperatures_are_reported_until_they_are_too_old() {
        let mut world = World::new();
        world.live(1);
        let item = StatusItem::Temperatures { pair: 1, centi_c: [Some(2_345), None] };
        let reported = status::Status { last_refused: status::FrameRejectReason::None, item };
        let frame = AdapterMessage::Frame(status::encode(&reported, 0));
        world.component.receive(Duration::from_millis(world.ms), &frame);
        world.live(3_400);
        assert_eq!(world.outputs.temperatures_c[..5], [None, None, Some(23.45), None, None]);
        world.live(2);
        assert_eq!(world.outputs.temperatures_c, [None; TEMPERATURE_CHANNEL_COUNT]);
    }

    #[test]
    fn a_machine_that_was_off_begins_again_from_zero() {
        let mut world = World::new();
        world.offset = Some([0, 0, 40_000]);
        world.live(200);
        world.inputs.machine_on = false;
        world.live(20);
        // As LinuxCNC does it at machine on.
        world.inputs.readings = [AxisReading::default(); 3];
        world.inputs.machine_on = true;
        world.live(60);
        assert!(world.z_um() > 0.0 && world.z_um() < 10.0, "{}", world.z_um());
        world.live(100);
        assert_eq!(world.z_um(), 40.0);
    }
}
