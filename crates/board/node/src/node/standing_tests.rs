//! The reference, in force or offered, and a calibration that changes while no CNC is there.

use super::*;
use std::{boxed::Box, vec, vec::Vec};
use trueup_canopen::{
    dictionary::{
        CLEAR_REFERENCE_SIGNATURE, DROP_CALIBRATION_SIGNATURE, EntryContent as O,
        RESTORE_REFERENCE_SIGNATURE,
    },
    sdo::{AbortCode, ObjectAccess as _, ObjectValue},
};
use trueup_core::{
    bridge::ReferenceErrors,
    design_parameters::CODES_PER_TICK,
    units::{AdcCode, FineNanometres, Nanometres},
};
use trueup_link::status::StateBits;
use trueup_store::{
    calibration::{MAX_BLOB_SIZE, encode},
    reference::ReferenceStatus,
    write_log::{WriteOrigin, WriteRecord},
};

/// A CNC, or who says that it is one, on the serial line.
struct TestCnc {
    counter: u8,
}

impl TestCnc {
    fn send_control(&mut self, node: &mut Node<'_>, control: Control, times: u32) {
        let codes: [AdcCode; CODES_PER_TICK] =
            core::array::from_fn(|n| AdcCode(400 + u16::from(n % 2 == 1)));
        for _ in 0..times {
            node.receive(Interface::Serial, &frames::encode_control(control, self.counter))
                .expect("in order");
            self.counter = self.counter.wrapping_add(1);
            for _ in 0..20 {
                node.tick(1, TickInput { codes: Some(&codes), ..TickInput::default() });
                node.next_service_frame();
            }
        }
    }

    /// Three times without, three times with.
    fn confirm(&mut self, node: &mut Node<'_>) {
        self.send_control(node, Control::REFERENCED, 4);
        self.send_control(node, Control { confirm: true, ..Control::REFERENCED }, 4);
        self.send_control(node, Control::REFERENCED, 4);
    }
}

const SERVICE_CONTROL: Control = Control { service: true, ..Control::REFERENCED };

fn run_without_control_for(node: &mut Node<'_>, ms: u32) {
    for _ in 0..ms {
        node.tick(1, TickInput::default());
        node.next_service_frame();
    }
}

fn reference(elongation_nm: i32) -> ReferenceErrors {
    ReferenceErrors {
        elongation: Nanometres(elongation_nm),
        axes: [FineNanometres(256), FineNanometres(0), FineNanometres(-512)],
    }
}

fn state(node: &Node<'_>) -> StateBits {
    node.faults(&node.last).state_bits()
}

/// Returns a board that runs on a calibration with these limits, in µm.
fn board(max_um: [i32; 3]) -> Node<'static> {
    let mut calibration = sensor_only_calibration();
    calibration.limits.max = max_um.map(|um| Nanometres(um * 1_000));
    let mut blob = vec![0; MAX_BLOB_SIZE];
    let length = encode(&calibration, &mut blob).expect("small").len();
    blob.truncate(length);
    Node::new(NodeConfiguration {
        blob: Box::leak(blob.into()),
        buffer: Some(Box::leak(vec![0; MAX_BLOB_SIZE].into())),
        ..calibration.into()
    })
}

fn engage(node: &mut Node<'_>, cnc: &mut TestCnc) -> OffsetQuality {
    cnc.send_control(node, Control::REFERENCED, 4);
    cnc.send_control(node, Control::ENGAGED, 40);
    node.last_output().quality
}

#[test]
fn an_offered_reference_bars_every_offset_until_confirm_takes_it() {
    let mut node = board([500; 3]);
    let offered =
        ReferenceStatus { is_offered: true, ..ReferenceStatus::in_force(reference(32_840)) };
    assert!(node.restore_reference_status(offered, None));
    let mut cnc = TestCnc { counter: 0 };
    assert_eq!(engage(&mut node, &mut cnc), OffsetQuality::Fault);
    assert_eq!(state(&node).0 & !1, StateBits::REFERENCE_OFFERED.0);
    assert_eq!(node.reference(), ReferenceErrors::default());
    cnc.confirm(&mut node);
    assert_eq!(node.reference(), reference(32_840));
    assert_eq!(node.take_reference_status(), Some(ReferenceStatus::in_force(reference(32_840))));
    assert_eq!(engage(&mut node, &mut cnc), OffsetQuality::Live);
    assert_eq!(state(&node).0, 0);
}

#[test]
fn zero_replaces_an_offered_reference_and_forgetting_declines_it() {
    let offered =
        ReferenceStatus { is_offered: true, ..ReferenceStatus::in_force(reference(32_840)) };
    for declines in [false, true] {
        let mut node = board([500; 3]);
        node.restore_reference_status(offered, None);
        let mut cnc = TestCnc { counter: 0 };
        cnc.send_control(&mut node, SERVICE_CONTROL, 30);
        if declines {
            node.write(O::Forget, CLEAR_REFERENCE_SIGNATURE).expect("allowed");
            assert_eq!(node.reference(), ReferenceErrors::default());
        } else {
            cnc.send_control(&mut node, Control { zero: true, ..Control::REFERENCED }, 5);
            assert_ne!(node.reference(), ReferenceErrors::default());
        }
        let now = node.reference();
        assert_eq!(
            node.take_reference_status(),
            Some(ReferenceStatus::in_force(now)),
            "{declines}"
        );
        assert_eq!(node.read(O::OfferedElongation), Ok(ObjectValue::Number(1 << 31)));
        assert_eq!(engage(&mut node, &mut cnc), OffsetQuality::Live, "{declines}");
    }
}

#[test]
fn one_edge_of_confirm_answers_one_question_in_the_fixed_order() {
    let mut node = board([500; 3]);
    let standing = ReferenceStatus {
        is_offered: true,
        is_changed: true,
        ..ReferenceStatus::in_force(reference(9))
    };
    node.restore_reference_status(standing, None);
    for question in [Fault::HeatUnknown, Fault::OlderCalibration, Fault::ForeignMachine] {
        node.require_confirmation(question);
    }
    let mut cnc = TestCnc { counter: 0 };
    for question in [
        Fault::ForeignMachine,
        Fault::CalibrationChanged,
        Fault::OlderCalibration,
        Fault::ReferenceOffered,
    ] {
        assert_eq!(engage(&mut node, &mut cnc), OffsetQuality::Fault, "{question:?}");
        cnc.confirm(&mut node);
        assert_eq!(node.take_confirmed_fault(), Some(question));
    }
    assert_eq!(engage(&mut node, &mut cnc), OffsetQuality::Live);
}

#[test]
fn a_reference_beyond_its_limit_is_taken_by_nobody() {
    // X, Y, Z, and the elongation by the largest.
    let limits_um = [20, 100, 50];
    for (part, nm, may) in [
        (O::ReferenceElongation, 100_000, true),
        (O::ReferenceElongation, -100_001, false),
        (O::Reference(0), -20_000, true),
        (O::Reference(0), 20_001, false),
        (O::Reference(1), 100_000, true),
        (O::Reference(2), -50_001, false),
        (O::Reference(2), i32::MAX, false),
        (O::ReferenceElongation, i32::MIN, false),
    ] {
        let mut node = board(limits_um);
        TestCnc { counter: 0 }.send_control(&mut node, SERVICE_CONTROL, 5);
        let taken = node.write(part, nm.cast_unsigned());
        assert_eq!(taken, if may { Ok(()) } else { Err(AbortCode::Value) }, "{part:?} {nm}");
    }
    for (elongation_nm, may) in [(100_000, true), (100_001, false), (-100_001, false)] {
        for is_offered in [false, true] {
            let mut node = board(limits_um);
            let standing = ReferenceStatus {
                is_offered,
                ..ReferenceStatus::in_force(reference(elongation_nm))
            };
            assert_eq!(node.restore_reference_status(standing, None), may);
            assert_eq!(state(&node).contains(StateBits::STORE_FAILING), !may, "it is reported");
            assert_eq!(node.offer.has_offered_reference(), may && is_offered);
            assert_eq!(node.reference() != ReferenceErrors::default(), may && !is_offered);
        }
    }
    // The spindle of these codes has grown by 410 µm.
    let mut node = board(limits_um);
    let mut cnc = TestCnc { counter: 0 };
    cnc.send_control(&mut node, Control::REFERENCED, 30);
    cnc.send_control(&mut node, Control { zero: true, ..Control::REFERENCED }, 5);
    assert_eq!(
        (node.take_zero_outcome(), node.reference()),
        (Some(ZeroOutcome::Unchanged), ReferenceErrors::default())
    );
}

/// Loads another calibration over the serial line, and returns the write that is logged.
fn load_other_calibration(node: &mut Node<'_>) -> WriteRecord {
    let mut calibration = sensor_only_calibration();
    calibration.limits.hold_ms = 77;
    let mut place = [0; MAX_BLOB_SIZE];
    let blob = encode(&calibration, &mut place).expect("small").to_vec();
    node.log.set_request_interface(Interface::Serial);
    node.open(O::New, None).expect("allowed");
    node.append(O::New, &blob).and_then(|()| node.close(O::New)).expect("allowed");
    let mut load = node.take_received_calibration().expect("whole");
    load.validate_blob().expect("a calibration");
    node.finish_load(load, LoadOutcome::Stored);
    let writes: Vec<_> = core::iter::from_fn(|| node.take_pending_write()).collect();
    writes.into_iter().find(|write| write.what == WriteKind::Loaded).expect("it is logged")
}

#[test]
fn a_load_is_unattended_unless_the_master_is_a_cnc_that_sends() {
    // A tool that speaks for want of a CNC has no axes.
    let tool = Control { service: true, ..Control::default() };
    let mut node = board([500; 3]);
    TestCnc { counter: 0 }.send_control(&mut node, tool, 10);
    assert!(load_other_calibration(&mut node).is_unattended);
    // A CNC that is there since the start, whether or not it has engaged.
    let mut node = board([500; 3]);
    let mut cnc = TestCnc { counter: 0 };
    cnc.send_control(&mut node, SERVICE_CONTROL, 10);
    assert!(!load_other_calibration(&mut node).is_unattended);
    // A CNC after a silence, until it has engaged.
    run_without_control_for(&mut node, 600);
    cnc.send_control(&mut node, SERVICE_CONTROL, 100);
    assert!(load_other_calibration(&mut node).is_unattended);
    cnc.send_control(&mut node, Control::ENGAGED, 10);
    cnc.send_control(&mut node, SERVICE_CONTROL, 300);
    assert!(!load_other_calibration(&mut node).is_unattended);
    // Another CNC goes on in its place.
    let stranger = frames::encode_control(SERVICE_CONTROL, cnc.counter.wrapping_add(100));
    node.receive(Interface::Serial, &stranger).expect_err("out of sequence");
    cnc.counter = cnc.counter.wrapping_add(101);
    cnc.send_control(&mut node, SERVICE_CONTROL, 10);
    assert!(load_other_calibration(&mut node).is_unattended);
}

#[test]
fn a_first_calibration_needs_no_confirmation() {
    let mut node = board([500; 3]);
    node.set_fault(Fault::ExampleConstants);
    node.update_inhibition();
    let tool = Control { service: true, ..Control::default() };
    TestCnc { counter: 0 }.send_control(&mut node, tool, 10);
    assert!(!load_other_calibration(&mut node).is_unattended);
    let buffer = Some(Box::leak(vec![0; MAX_BLOB_SIZE].into()));
    let mut node = Node::new(NodeConfiguration { buffer, ..NodeConfiguration::default() });
    TestCnc { counter: 0 }.send_control(&mut node, tool, 10);
    assert!(!load_other_calibration(&mut node).is_unattended);
}

#[test]
fn a_load_that_waits_for_the_next_start_is_dropped_once() {
    let mut node = board([500; 3]);
    let mut cnc = TestCnc { counter: 0 };
    cnc.send_control(&mut node, SERVICE_CONTROL, 10);
    assert_eq!(
        node.write(O::DropNew, DROP_CALIBRATION_SIGNATURE),
        Err(AbortCode::DeviceState),
        "nothing waits"
    );
    let crc = load_other_calibration(&mut node).about;
    assert_eq!(node.read(O::NewCrc), Ok(ObjectValue::Number(crc)));
    assert_eq!(node.write(O::DropNew, DROP_CALIBRATION_SIGNATURE + 1), Err(AbortCode::Value));
    node.write(O::DropNew, DROP_CALIBRATION_SIGNATURE).expect("allowed");
    assert!(
        node.take_calibration_to_restore().is_some()
            && node.take_calibration_to_restore().is_none()
    );
    node.finish_calibration_drop(true);
    assert_eq!(node.read(O::NewCrc), Ok(ObjectValue::Number(0)));
    let write = node.take_pending_write().map(|write| (write.what, write.about, write.origin));
    assert_eq!(write, Some((WriteKind::Cancelled, crc, WriteOrigin::Serial)));
    // A store that takes nothing leaves it, and is reported.
    load_other_calibration(&mut node);
    node.write(O::DropNew, DROP_CALIBRATION_SIGNATURE).expect("allowed");
    node.finish_calibration_drop(false);
    assert_eq!(node.read(O::NewCrc), Ok(ObjectValue::Number(crc)));
    assert!(state(&node).contains(StateBits::STORE_FAILING));
}

#[test]
fn the_age_of_a_reference_is_known_in_the_start_that_has_taken_it_or_by_two_times_of_day() {
    let mut node = board([500; 3]);
    let mut cnc = TestCnc { counter: 0 };
    assert_eq!(node.read(O::ReferenceAge), Ok(ObjectValue::Number(u32::MAX)));
    cnc.send_control(&mut node, SERVICE_CONTROL, 30);
    cnc.send_control(&mut node, Control { zero: true, ..SERVICE_CONTROL }, 5);
    cnc.send_control(&mut node, SERVICE_CONTROL, 500);
    assert_eq!(node.read(O::ReferenceAge), Ok(ObjectValue::Number(10)));
    let by = u32::from(u16::from_le_bytes([WriteKind::Zeroed as u8, WriteOrigin::Serial as u8]));
    assert_eq!(node.read(O::ReferenceOrigin), Ok(ObjectValue::Number(by)));
    // After a start: by the log alone, if the times are there.
    let taken = core::iter::from_fn(|| node.take_pending_write())
        .find(|write| write.what == WriteKind::Zeroed);
    let taken = WriteRecord { utc_s: 1_790_000_000, ..taken.expect("it is logged") };
    let mut again = board([500; 3]);
    again.restore_reference_status(ReferenceStatus::in_force(node.reference()), Some(taken));
    assert_eq!(again.read(O::ReferenceAge), Ok(ObjectValue::Number(u32::MAX)));
    assert_eq!(again.read(O::ReferenceUtc), Ok(ObjectValue::Number(1_790_000_000)));
    again.set_utc_s(1_790_000_100);
    assert_eq!(again.read(O::ReferenceAge), Ok(ObjectValue::Number(100)));
    // The write of another reference says nothing of this one.
    let mut other = board([500; 3]);
    other.restore_reference_status(ReferenceStatus::in_force(reference(5)), Some(taken));
    assert_eq!(other.read(O::ReferenceUtc), Ok(ObjectValue::Number(0)));
    // Without the rest of it nothing is offered.
    assert_eq!(again.write(O::Forget, RESTORE_REFERENCE_SIGNATURE), Err(AbortCode::DeviceState));
}
