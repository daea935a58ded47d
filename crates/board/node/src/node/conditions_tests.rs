//! Tool and conditions over the line: taken once whole and in order, and reported where they are lost.

use super::*;
use trueup_core::{
    cnc::{LinearAxis, MachineConditions},
    design_parameters::CODES_PER_TICK,
    lag::SmoothingFactor,
    term::{CategoryFactor, ConditionLevels, Effect, Target, Term},
    units::{AdcCode, FineNanometres, Nanometres},
};
use trueup_link::status::StateBits;

/// X moves by 5 µm while bit 9 is on.
const CONDITION_SHIFT_NM: i32 = 5_000;

struct ConditionRig {
    node: Node<'static>,
    counter: u8,
    emergencies: std::vec::Vec<Fault>,
}

impl ConditionRig {
    fn new() -> Self {
        let mut calibration = sensor_only_calibration();
        calibration.limits.slew_nm_per_s = 1_000_000;
        let condition = ConditionLevels {
            bit: 9,
            default: false,
            off: 0,
            on: CONDITION_SHIFT_NM * 256,
            shift: 0,
            smoothing: SmoothingFactor::NO_LAG,
            times: CategoryFactor::One,
        };
        let target = Target::Axis(LinearAxis::X);
        let effect = Effect::Condition(condition);
        calibration.terms[0] = Some(Term { target, constant: FineNanometres::ZERO, effect });
        let node = Node::new(calibration.into());
        let mut rig = Self { node, counter: 0, emergencies: std::vec::Vec::new() };
        (0..3).for_each(|_| rig.send_control(Control::REFERENCED, None));
        rig
    }

    /// `Control`, and `Conditions` if they are sent, then 20 ms.
    fn send_control(&mut self, control: Control, conditions: Option<Frame>) {
        self.node
            .receive(Interface::Can, &frames::encode_control(control, self.counter))
            .expect("in order");
        self.counter = self.counter.wrapping_add(1);
        if let Some(frame) = conditions {
            let _ = self.node.receive(Interface::Can, &frame);
        }
        let codes: [AdcCode; CODES_PER_TICK] =
            core::array::from_fn(|n| AdcCode(700 + u16::from(n % 2 == 1)));
        for _ in 0..20 {
            self.node.tick(1, TickInput { codes: Some(&codes), ..TickInput::default() });
            let emergency_frame = self
                .node
                .next_service_frame()
                .and_then(|frame| trueup_canopen::emergency::decode(&frame).ok());
            self.emergencies.extend(
                emergency_frame
                    .filter(|emergency| emergency.code != 0)
                    .map(|emergency| emergency.fault),
            );
        }
    }

    fn x_offset(&self) -> Option<Nanometres> {
        self.node.last_output().offset.map(|[x, ..]| x)
    }

    fn state(&self) -> StateBits {
        self.node.faults(self.node.last_output()).state_bits()
    }
}

fn active_condition_frame(counter: u8) -> Option<Frame> {
    Some(frames::encode_conditions(MachineConditions { tool: 3, bits: 1 << 9 }, counter))
}

#[test]
fn a_condition_that_is_sent_moves_its_axis_and_a_damaged_frame_does_not() {
    let mut rig = ConditionRig::new();
    (0..50).for_each(|n| rig.send_control(Control::ENGAGED, active_condition_frame(n)));
    assert_eq!(rig.x_offset(), Some(Nanometres(-CONDITION_SHIFT_NM)));
    assert!(!rig.emergencies.contains(&Fault::ConditionsLost));
    // Off, but damaged.
    let frame = frames::encode_conditions(MachineConditions::default(), 50);
    let mut data = *frame.data();
    data[4] ^= 1;
    rig.send_control(Control::ENGAGED, Frame::new(frame.id(), &data).ok());
    assert_eq!(rig.x_offset(), Some(Nanometres(-CONDITION_SHIFT_NM)));
}

#[test]
fn lost_conditions_are_an_emergency_and_a_state_bit_within_100_ms_of_their_timeout() {
    let mut rig = ConditionRig::new();
    (0..50).for_each(|n| rig.send_control(Control::ENGAGED, active_condition_frame(n)));
    // Four times the link timeout of 500 ms.
    (0..99).for_each(|_| rig.send_control(Control::ENGAGED, None));
    assert!(!rig.emergencies.contains(&Fault::ConditionsLost));
    assert!(!rig.state().contains(StateBits::CONDITIONS_LOST));
    (0..5).for_each(|_| rig.send_control(Control::ENGAGED, None));
    assert!(rig.emergencies.contains(&Fault::ConditionsLost), "{:?}", rig.emergencies);
    assert!(rig.state().contains(StateBits::CONDITIONS_LOST));
    assert_eq!(
        (rig.node.last_output().quality, rig.x_offset()),
        (OffsetQuality::Hold, Some(Nanometres(-CONDITION_SHIFT_NM)))
    );
    (0..200).for_each(|_| rig.send_control(Control::ENGAGED, None));
    assert_eq!(rig.node.last_output().quality, OffsetQuality::TemperatureModel);
    assert_eq!(rig.x_offset(), Some(Nanometres(0)), "off is the default");
    (0..50).for_each(|n| rig.send_control(Control::ENGAGED, active_condition_frame(n)));
    assert!(!rig.state().contains(StateBits::CONDITIONS_LOST));
    assert_eq!(rig.node.last_output().quality, OffsetQuality::Live);
}
