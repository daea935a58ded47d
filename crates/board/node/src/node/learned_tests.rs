//! Learned changes as they come over the line: who may send them, when, and how far they go.

use super::*;
use std::{vec, vec::Vec};
use trueup_canopen::{
    dictionary::{CLEAR_REFERENCE_SIGNATURE, EntryContent, find_object},
    sdo::{ObjectAccess as _, ObjectValue},
};
use trueup_core::{
    cnc::Control,
    design_parameters::CODES_PER_TICK,
    learned_changes::{LEARNED_PART_COUNT, LearnedChangeRequest, LearnedLimits, calibration_id},
    units::AdcCode,
};
use trueup_store::calibration::{MAX_BLOB_SIZE, encode};

/// 700.5 codes of 1024 nm.
const BASE_ELONGATION_NM: i32 = 717_312;
const LEARNED_LIMITS: LearnedLimits = LearnedLimits { growth: 20, axes: 0, zero: 50 };

/// A bridge that permits a little, with the blob that says so, and its CNC on CAN.
struct LearnedChangeRig {
    node: Node<'static>,
    calibration: u16,
    counter: u8,
}

impl LearnedChangeRig {
    fn new() -> Self {
        Self::with_limits(LEARNED_LIMITS)
    }

    fn with_limits(caps: LearnedLimits) -> Self {
        let mut calibration = sensor_only_calibration();
        calibration.limits.learned = caps;
        calibration.limits.slew_nm_per_s = 1_000_000;
        calibration.limits.max = [trueup_core::units::Nanometres(2_000_000); 3];
        let mut room = vec![0; MAX_BLOB_SIZE];
        let blob = encode(&calibration, &mut room).expect("small").to_vec().leak();
        let node = Node::new(NodeConfiguration { blob, ..calibration.into() });
        Self { node, calibration: calibration_id(calibration_crc(blob)), counter: 0 }
    }

    /// Engaged, and grown.
    fn new_engaged() -> Self {
        let mut rig = Self::new();
        rig.send_control_frames(Control::REFERENCED, 3);
        rig.send_control_frames(Control::ENGAGED, 100);
        assert_eq!(rig.node.last_output().quality, OffsetQuality::Live);
        assert_eq!(rig.z_offset_nm(), BASE_ELONGATION_NM);
        rig
    }

    fn change_request(&self, part: u8, amount: i16) -> LearnedChangeRequest {
        LearnedChangeRequest { part, amount, calibration: self.calibration }
    }

    /// `Control` so often, 20 ms apart, over CAN; gives the offset of Z in every tick.
    fn send_control_frames(&mut self, control: Control, count: usize) -> Vec<i32> {
        let mut all = Vec::new();
        for _ in 0..count {
            self.node
                .receive(Interface::Can, &frames::encode_control(control, self.counter))
                .expect("in order");
            self.counter = self.counter.wrapping_add(1);
            all.extend(self.run_for_ms(20));
        }
        all
    }

    fn run_for_ms(&mut self, ms: u32) -> Vec<i32> {
        let codes: [AdcCode; CODES_PER_TICK] =
            core::array::from_fn(|n| AdcCode(700 + u16::from(n % 2 == 1)));
        let mut all = Vec::new();
        for _ in 0..ms {
            self.node.tick(1, TickInput { codes: Some(&codes), ..TickInput::default() });
            self.node.next_service_frame();
            all.push(self.z_offset_nm());
        }
        all
    }

    fn send_change_request(&mut self, change: LearnedChangeRequest, count: usize) -> Vec<i32> {
        self.send_control_frames(Control { learned: change, ..Control::ENGAGED }, count)
    }

    fn z_offset_nm(&self) -> i32 {
        self.node.last_output().offset.map_or(i32::MIN, |[_, _, z]| z.0)
    }

    fn now(&self) -> [i16; LEARNED_PART_COUNT] {
        self.node.state.learned_changes().current_amounts()
    }

    fn is_refused(&self) -> bool {
        self.node.faults(self.node.last_output()).contains(Fault::LearnedRefused)
    }
}

#[test]
fn its_own_master_says_it_while_engaged_and_the_offset_gets_there_without_a_step() {
    let mut rig = LearnedChangeRig::new_engaged();
    // 0.1 % of 717.312 µm are 717 nm; and 500 nm of zero. A hundred units are 10 s.
    let mut all = Vec::new();
    for part in [rig.change_request(1, 100), rig.change_request(5, 500)] {
        all.extend(rig.send_change_request(part, 1));
    }
    all.extend(rig.send_control_frames(Control::ENGAGED, 600));
    assert_eq!((rig.now(), rig.is_refused()), ([100, 0, 0, 0, 120], false));
    assert_eq!(rig.z_offset_nm(), BASE_ELONGATION_NM + 717 + 120, "what grows is lifted");
    let largest = all.windows(2).map(|pair| (pair[1] - pair[0]).abs()).max();
    assert!(largest <= Some(8), "a unit of 717 µm is 7.2 nm: {largest:?}");
    // Taken back in the same way.
    rig.send_change_request(rig.change_request(1, 0), 1);
    rig.send_change_request(rig.change_request(5, 0), 1);
    rig.send_control_frames(Control::ENGAGED, 700);
    assert_eq!((rig.now(), rig.z_offset_nm()), ([0; LEARNED_PART_COUNT], BASE_ELONGATION_NM));
}

#[test]
fn beyond_its_cap_of_no_part_or_of_another_calibration_it_is_refused_and_reported() {
    let good = LearnedChangeRig::new().change_request(1, 100);
    for bad in [
        LearnedChangeRequest { amount: 2_001, ..good },
        LearnedChangeRequest { amount: -2_001, ..good },
        LearnedChangeRequest { part: 2, amount: 1, ..good },
        LearnedChangeRequest { part: 5, amount: 5_001, ..good },
        LearnedChangeRequest { part: 6, ..good },
        LearnedChangeRequest { part: 7, ..good },
        LearnedChangeRequest { calibration: good.calibration ^ 1, ..good },
        LearnedChangeRequest { calibration: good.calibration ^ 0x8000, ..good },
    ] {
        let mut rig = LearnedChangeRig::new_engaged();
        rig.send_change_request(bad, 50);
        assert_eq!(
            (rig.now(), rig.z_offset_nm()),
            ([0; LEARNED_PART_COUNT], BASE_ELONGATION_NM),
            "{bad:?}"
        );
        assert!(rig.is_refused(), "{bad:?}");
        assert_eq!(
            rig.node.last_output().quality,
            OffsetQuality::Live,
            "it is a sign of life all the same"
        );
        // Told until nothing of the kind is asked for, and good ones count meanwhile.
        rig.send_change_request(good, 10);
        assert!(rig.is_refused() && rig.now()[0] > 0);
        rig.send_control_frames(Control::ENGAGED, 1);
        assert!(!rig.is_refused());
    }
}

#[test]
fn that_nothing_was_learned_is_never_refused_and_of_another_calibration_takes_nothing_back() {
    let mut rig = LearnedChangeRig::new_engaged();
    rig.send_change_request(rig.change_request(1, 100), 1);
    let ours = rig.calibration;
    for (part, calibration) in (1..=5).map(|part| (part, ours ^ 1)) {
        rig.send_change_request(LearnedChangeRequest { part, amount: 0, calibration }, 100);
    }
    assert_eq!((rig.now(), rig.is_refused()), ([100, 0, 0, 0, 0], false));
    for part in 1..=5 {
        rig.send_change_request(rig.change_request(part, 0), 100);
    }
    assert_eq!(
        (rig.now(), rig.is_refused()),
        ([0; LEARNED_PART_COUNT], false),
        "no cap is below 0"
    );

    // Nor by a board without a calibration.
    let mut bare = Node::new(NodeConfiguration::default());
    let learned = LearnedChangeRequest { part: 1, amount: 0, calibration: calibration_id(0) };
    for counter in 0..10 {
        let control = Control { learned, ..Control::REFERENCED };
        bare.receive(Interface::Can, &frames::encode_control(control, counter)).expect("in order");
        bare.tick(1, TickInput::default());
    }
    assert!(!bare.faults(bare.last_output()).contains(Fault::LearnedRefused));
}

#[test]
fn a_calibration_that_states_no_cap_lets_nothing_be_changed() {
    let mut node = Node::new(sensor_only_calibration().into());
    // Without a blob its CRC is 0.
    let learned = LearnedChangeRequest {
        part: 1,
        amount: 1,
        calibration: calibration_id(calibration_crc(&[])),
    };
    for counter in 0..10 {
        let control = Control { learned, ..Control::REFERENCED };
        node.receive(Interface::Can, &frames::encode_control(control, counter)).expect("in order");
        node.tick(1, TickInput::default());
    }
    assert!(node.faults(node.last_output()).contains(Fault::LearnedRefused));
    assert_eq!(node.state.learned_changes().current_amounts(), [0; LEARNED_PART_COUNT]);
}

#[test]
fn what_is_damaged_repeated_or_from_another_line_moves_nothing() {
    let mut rig = LearnedChangeRig::new_engaged();
    let control = Control { learned: rig.change_request(1, 100), ..Control::ENGAGED };
    let mut damaged = *frames::encode_control(control, rig.counter).data();
    damaged[4] ^= 1;
    let damaged = Frame::new(CONTROL_ID, &damaged).expect("8 bytes");
    assert!(rig.node.receive(Interface::Can, &damaged).is_err());
    let repeated = frames::encode_control(control, rig.counter.wrapping_sub(1));
    assert!(rig.node.receive(Interface::Can, &repeated).is_err());
    let late = frames::encode_control(control, rig.counter.wrapping_add(100));
    assert!(rig.node.receive(Interface::Can, &late).is_err());
    let strange = frames::encode_control(control, 0);
    assert_eq!(rig.node.receive(Interface::Serial, &strange), Ok(None));
    rig.run_for_ms(400);
    assert_eq!((rig.now(), rig.z_offset_nm()), ([0; LEARNED_PART_COUNT], BASE_ELONGATION_NM));
    assert!(rig.node.master.has_second_sender(), "a sender on another interface is reported");
}

#[test]
fn of_two_masters_on_one_line_neither_is_believed() {
    let mut rig = LearnedChangeRig::new_engaged();
    let learned = rig.change_request(1, 100);
    for _ in 0..3 {
        let late = frames::encode_control(Control::ENGAGED, rig.counter.wrapping_add(100));
        assert!(rig.node.receive(Interface::Can, &late).is_err());
        rig.counter = rig.counter.wrapping_add(101);
    }
    rig.send_control_frames(Control { learned, ..Control::ENGAGED }, 5);
    assert!(rig.node.master.has_second_sender());
    assert_eq!(rig.now(), [0; LEARNED_PART_COUNT]);
}

#[test]
fn one_frame_of_a_stranger_moves_a_unit_and_the_masters_next_takes_it_back() {
    let mut rig = LearnedChangeRig::new_engaged();
    rig.send_change_request(rig.change_request(1, 1_000), 1);
    rig.send_change_request(rig.change_request(1, 0), 1);
    rig.send_control_frames(Control::ENGAGED, 50);
    assert_eq!((rig.now(), rig.z_offset_nm()), ([0; LEARNED_PART_COUNT], BASE_ELONGATION_NM));
}

#[test]
fn a_master_reads_each_part_at_its_place_in_the_dictionary() {
    let mut rig = LearnedChangeRig::with_limits(LearnedLimits { axes: 20, ..LEARNED_LIMITS });
    rig.send_control_frames(Control::REFERENCED, 3);
    for (part, amount) in [(1, -1), (2, 2), (3, -3), (4, 4), (5, -5)] {
        rig.send_control_frames(
            Control { learned: rig.change_request(part, amount), ..Control::REFERENCED },
            30,
        );
    }
    let places = find_object(0x2011).expect("it is there");
    let reported = [1, 2, 3, 4, 5]
        .map(|place| rig.node.read(places.entry(place).expect("a part").what).expect("readable"));
    assert_eq!(
        reported,
        [-1, 2, -3, 4, -5].map(|value: i32| ObjectValue::Number(value.cast_unsigned()))
    );
}

#[test]
fn it_may_be_said_at_rest_and_forget_and_a_restart_forget_it() {
    let mut rig = LearnedChangeRig::new();
    rig.send_control_frames(Control::REFERENCED, 3);
    let at_rest = Control { learned: rig.change_request(5, 30), ..Control::REFERENCED };
    rig.send_control_frames(at_rest, 200);
    assert_eq!(rig.now(), [0, 0, 0, 0, 30]);
    let reported = rig.node.read(EntryContent::Learned(4));
    assert_eq!(reported, Ok(ObjectValue::Number(30)));
    rig.send_control_frames(Control { service: true, ..Control::REFERENCED }, 1);
    rig.node.write(EntryContent::Forget, CLEAR_REFERENCE_SIGNATURE).expect("at rest, and allowed");
    assert_eq!(rig.now(), [0; LEARNED_PART_COUNT]);

    rig.send_control_frames(at_rest, 200);
    let retained = rig.node.retained_state();
    let mut again = LearnedChangeRig::new();
    again.node.resume(Some(&retained), 0);
    again.send_control_frames(Control::REFERENCED, 3);
    again.send_control_frames(Control::ENGAGED, 100);
    assert_eq!((again.now(), again.z_offset_nm()), ([0; LEARNED_PART_COUNT], BASE_ELONGATION_NM));
}
