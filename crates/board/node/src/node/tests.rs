//! Tests of a node as a CANopen master sees it: its heartbeat, emergencies, objects, and a calibration.

use super::*;
use crate::node::firmware_update::SlotStates;
use crate::reset_info::{CrashInfo, ResetInfo};
use std::{boxed::Box, vec, vec::Vec};
use trueup_canopen::dictionary::{AccessType, CLEAR_REFERENCE_SIGNATURE, DataType, OBJECTS};
use trueup_canopen::sdo::AbortCode;
use trueup_core::{bridge::ReferenceErrors, cnc::Control, units::Nanometres};
use trueup_link::{layout::*, status::ResetReason};
use trueup_store::calibration::{MAX_BLOB_SIZE, calibration_crc, encode};
use trueup_store::reference::ReferenceStatus;

fn blob() -> Vec<u8> {
    encode(&super::sensor_only_calibration(), &mut [0; MAX_BLOB_SIZE]).expect("small").to_vec()
}

std::thread_local! {
    /// The counter of the `Control` with which the operator allows to write; `None`: writing is not allowed.
    static SERVICE: core::cell::Cell<Option<u8>> = const { core::cell::Cell::new(None) };
}

/// Lets this many milliseconds pass without samples; returns the other messages than the offsets.
fn pass(node: &mut Node<'_>, ms: u32) -> Vec<Frame> {
    let text = (0..ms).flat_map(|_| {
        node.tick(1, TickInput::default());
        if node.now().0.is_multiple_of(100) && SERVICE.get().is_some() {
            service(node);
        }
        node.next_service_frame()
    });
    text.collect()
}

/// The operator allows to write, and goes on to.
fn service(node: &mut Node<'_>) {
    let counter = SERVICE.get().map_or(0, |counter| counter.wrapping_add(1));
    SERVICE.set(Some(counter));
    let control = Control { service: true, ..Control::REFERENCED };
    node.receive(Interface::Can, &frames::encode_control(control, counter)).expect("in order");
}

fn receive(node: &mut Node<'_>, data: [u8; 8]) {
    let request = Frame::new(SDO_REQUEST_ID, &data).expect("a full frame");
    assert_eq!(node.receive(Interface::Can, &request), Ok(None));
}

/// Returns what is answered to a request within 200 ms.
fn transact(node: &mut Node<'_>, data: [u8; 8]) -> [u8; 8] {
    receive(node, data);
    for _ in 0..200 {
        if let Some(answer) = pass(node, 1).iter().find(|frame| frame.id() == SDO_RESPONSE_ID) {
            return *answer.data();
        }
    }
    panic!("no answer to {data:02X?}");
}

fn request(command: u8, index: u16, subindex: u8, number: u32) -> [u8; 8] {
    let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), number.to_le_bytes());
    [command, low, high, subindex, a, b, c, d]
}

fn read(node: &mut Node<'_>, index: u16, subindex: u8) -> Result<u32, u32> {
    let answer = transact(node, request(0x40, index, subindex, 0));
    let number = u32::from_le_bytes(*answer.last_chunk().expect("8 bytes"));
    if answer[0] == 0x80 { Err(number) } else { Ok(number) }
}

fn write(node: &mut Node<'_>, index: u16, subindex: u8, number: u32) -> Result<(), u32> {
    service(node);
    let answer = transact(node, request(0x22, index, subindex, number));
    let abort = u32::from_le_bytes(*answer.last_chunk().expect("8 bytes"));
    if answer[0] == 0x80 { Err(abort) } else { Ok(()) }
}

/// Sends a whole domain; the answer to the last segment is still to come.
fn send_calibration(node: &mut Node<'_>, bytes: &[u8]) {
    let size = u32::try_from(bytes.len()).expect("a blob");
    service(node);
    assert_eq!(transact(node, request(0x21, 0x2100, 2, size))[0], 0x60);
    let last = bytes.chunks(7).count() - 1;
    for (number, part) in bytes.chunks(7).enumerate() {
        let mut data = [0; 8];
        data[0] = u8::from(number % 2 == 1) << 4
            | (7 - u8::try_from(part.len()).expect("7 at most")) << 1;
        data[1..=part.len()].copy_from_slice(part);
        if number == last {
            data[0] |= 1;
            return receive(node, data);
        }
        assert_eq!(transact(node, data)[0] & 0xEF, 0x20);
    }
}

/// Reads a whole domain.
fn read_domain(node: &mut Node<'_>, index: u16, subindex: u8) -> Vec<u8> {
    assert_eq!(transact(node, request(0x40, index, subindex, 0))[0], 0x41);
    let mut bytes = Vec::new();
    for toggle in [0, 0x10].into_iter().cycle() {
        let answer = transact(node, [0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]);
        bytes.extend(&answer[1..8 - usize::from(answer[0] >> 1 & 7)]);
        if answer[0] & 1 != 0 {
            break;
        }
    }
    bytes
}

/// Returns a node with all that a board gives it.
fn whole<'a>(blob: &'a [u8], buffer: &'a mut [u8]) -> Node<'a> {
    let calibrated: NodeConfiguration = sensor_only_calibration().into();
    let mut node = Node::new(NodeConfiguration { blob, buffer: Some(buffer), ..calibrated });
    node.set_slot_states(SlotStates::default());
    node
}

#[test]
fn every_object_that_can_be_read_is_answered_with_its_type() {
    let (blob, mut buffer) = (blob(), vec![0; MAX_BLOB_SIZE]);
    let mut node = whole(&blob, &mut buffer);
    for object in OBJECTS {
        for entry in object.entries {
            let answer = transact(&mut node, request(0x40, object.index, entry.subindex, 0));
            let at = (object.index, entry.subindex);
            let (kind, size) = (answer[0] >> 5, 4 - usize::from(answer[0] >> 2 & 3));
            let abort = u32::from_le_bytes(*answer.last_chunk().expect("8 bytes"));
            match (entry.kind, entry.access) {
                (_, AccessType::Write) => assert_eq!(abort, AbortCode::WriteOnly.code()),
                // No error was there yet, or fewer; nothing was loaded.
                _ if kind == 4 => {
                    assert_eq!(abort, AbortCode::NoData.code(), "{at:04X?}");
                    let may_be_empty = [(0x2100, 2), (0x2101, 1), (0x2101, 2), (0x2110, 1)];
                    assert!(object.index == 0x1003 || may_be_empty.contains(&at), "{at:04X?}");
                }
                (DataType::Text | DataType::Domain, _) => assert_eq!(answer[0], 0x41, "{at:04X?}"),
                (number, _) => assert_eq!((kind, Some(size)), (2, number.size()), "{at:04X?}"),
            }
        }
    }
}

#[test]
fn how_the_last_start_ended_is_read_by_a_master() {
    let (blob, mut buffer) = (blob(), vec![0; MAX_BLOB_SIZE]);
    let mut node = whole(&blob, &mut buffer);
    let mut start = ResetInfo { reason: ResetReason::Panic, ..ResetInfo::default() };
    start.stop =
        CrashInfo { pc: 0x0800_1234, lr: 5, status: 0x200, address: 6, task: 3, ..start.stop };
    start.stop.line = 77;
    start.stop.file[20..].copy_from_slice(b"a.rs");
    start.counts[ResetReason::Panic as usize] = 2;
    node.board.start = start;
    let numbers = [1, 2, 3, 4, 5, 7].map(|sub| read(&mut node, 0x2002, sub));
    assert_eq!(numbers, [0x0800_1234, 5, 0x200, 6, 77, 3].map(Ok));
    assert_eq!(read_domain(&mut node, 0x2002, 6), b"a.rs");
    assert_eq!(read(&mut node, 0x2001, 7), Ok(6));
    assert_eq!([6, 7, 8].map(|sub| read(&mut node, 0x2003, sub)), [0, 2, 0].map(Ok));
}

#[test]
fn a_loaded_calibration_is_checked_stored_and_read_back() {
    let (running, mut buffer) = (blob(), vec![0; MAX_BLOB_SIZE]);
    let mut node = whole(&running, &mut buffer);
    assert_eq!(read_domain(&mut node, 0x2100, 1), running);
    assert_eq!(read(&mut node, 0x2100, 3), Ok(calibration_crc(&running)));
    let mut other = sensor_only_calibration();
    other.limits.hold_ms += 1;
    let other = encode(&other, &mut [0; MAX_BLOB_SIZE]).expect("small").to_vec();

    send_calibration(&mut node, &other);
    assert_eq!(read(&mut node, 0x2100, 4), Ok(0), "asked before the board has looked at it");
    for (bytes, fate, answer) in [
        (other.clone(), LoadOutcome::Stored, [0x20, 0x30].to_vec()),
        (other.clone(), LoadOutcome::NotStored, [0x80].to_vec()),
        (vec![7; 700], LoadOutcome::Rejected, [0x80].to_vec()),
    ] {
        if let Some(load) = node.take_received_calibration() {
            node.finish_load(load, LoadOutcome::Rejected);
        }
        let started = node.now();
        send_calibration(&mut node, &bytes);
        assert!(pass(&mut node, 20).iter().all(|frame| frame.id() != SDO_RESPONSE_ID));
        let mut load = node.take_received_calibration().expect("it has come whole");
        assert_eq!(load.validate_blob().is_ok(), fate != LoadOutcome::Rejected);
        assert!(node.take_received_calibration().is_none());
        node.finish_load(load, fate);
        let frames = pass(&mut node, 5);
        let end = frames.iter().find(|frame| frame.id() == SDO_RESPONSE_ID).expect("an answer");
        assert!(answer.contains(&end.data()[0]), "{fate:?}: {end:?}");
        let stored = fate == LoadOutcome::Stored;
        // What is stored for the next start is reported, whatever became of a load after it.
        assert_eq!(read(&mut node, 0x2100, 4), Ok(calibration_crc(&other)), "{fate:?}");
        if stored {
            assert_eq!(read_domain(&mut node, 0x2100, 2), other);
            let segments = bytes.len().div_ceil(7);
            let took = node.now().duration_ms_since(started);
            std::println!("{} bytes, {segments} segments, both ways: {took} ms", bytes.len());
        } else {
            assert_eq!(read(&mut node, 0x2100, 2), Err(AbortCode::NoData.code()));
        }
    }
    assert_eq!(read_domain(&mut node, 0x2100, 1), running, "it runs on until the next start");
}

#[test]
fn nothing_is_loaded_or_forgotten_while_an_offset_is_followed_or_without_a_store() {
    let mut node = Node::new(sensor_only_calibration().into());
    let load = |node: &mut Node<'_>| {
        let answer = transact(node, request(0x21, 0x2100, 2, 700));
        u32::from_le_bytes(*answer.last_chunk().expect("8 bytes"))
    };
    assert_eq!(load(&mut node), AbortCode::DeviceState.code(), "nobody has allowed it");
    service(&mut node);
    assert_eq!(load(&mut node), AbortCode::CannotStore.code());
    node.slot = LoadSlot::new(Box::leak(vec![0; 800].into()));
    assert_eq!(load(&mut node), 0);
    let too_long = transact(&mut node, request(0x21, 0x2100, 2, 801));
    assert_eq!(u32::from_le_bytes(*too_long.last_chunk().unwrap()), AbortCode::TooLong.code());
    assert_eq!(write(&mut node, 0x2010, 6, CLEAR_REFERENCE_SIGNATURE), Ok(()));
    assert_eq!(node.take_zero_outcome(), None, "there is none to forget");
    node.restore_reference_status(
        ReferenceStatus::in_force(ReferenceErrors {
            elongation: Nanometres(1),
            ..Default::default()
        }),
        None,
    );
    assert_eq!(write(&mut node, 0x2010, 6, CLEAR_REFERENCE_SIGNATURE), Ok(()));
    assert!(matches!(node.take_zero_outcome(), Some(ZeroOutcome::Taken(_))));
    let wrong_signature = write(&mut node, 0x2010, 6, CLEAR_REFERENCE_SIGNATURE + 1);
    assert_eq!(wrong_signature, Err(AbortCode::Value.code()));
    node.last.quality = OffsetQuality::Live;
    receive(&mut node, request(0x21, 0x2100, 2, 700));
    let refused = node.answer.expect("at once");
    let abort = u32::from_le_bytes(*refused.data().last_chunk().unwrap());
    assert_eq!(abort, AbortCode::DeviceState.code());
    receive(&mut node, request(0x22, 0x2010, 6, CLEAR_REFERENCE_SIGNATURE));
    let refusal = Frame::from_data(SDO_RESPONSE_ID, request(0x80, 0x2010, 6, abort));
    assert_eq!(node.answer, Some(refusal));
}

#[test]
fn settings_are_taken_within_their_range_and_act() {
    let mut node = Node::new(sensor_only_calibration().into());
    let beats = |node: &mut Node<'_>, ms| {
        pass(node, ms).iter().filter(|frame| frame.id() == HEARTBEAT_ID).count()
    };
    assert_eq!(write(&mut node, 0x1017, 0, 20), Ok(()));
    assert_eq!(beats(&mut node, 1_000), 50);
    assert_eq!(write(&mut node, 0x1017, 0, 0), Ok(()));
    assert_eq!(beats(&mut node, 1_000), 0);
    assert_eq!(write(&mut node, 0x1003, 0, 1), Err(AbortCode::Value.code()));
    for wrong in [0x0101_0064, 0x0080_0064, 0x0001_0064] {
        assert_eq!(write(&mut node, 0x1016, 1, wrong), Err(AbortCode::Value.code()), "{wrong:X}");
    }
    assert_eq!(write(&mut node, 0x1015, 0, 500), Ok(()));
    assert_eq!(read(&mut node, 0x1015, 0), Ok(500));
}

fn codes_of(frames: &[Frame]) -> Vec<u16> {
    let emergencies = frames.iter().filter(|frame| frame.id() == EMERGENCY_ID);
    emergencies.map(|frame| u16::from_le_bytes([frame.data()[0], frame.data()[1]])).collect()
}

#[test]
fn the_heartbeat_of_a_node_that_was_received_is_missed() {
    let mut node = Node::new(sensor_only_calibration().into());
    pass(&mut node, 1_000);
    assert_eq!(write(&mut node, 0x1016, 1, 0x0002_0032), Ok(()));
    assert_eq!(codes_of(&pass(&mut node, 200)), [], "it was never heard");
    let beat = |node: &mut Node<'_>| {
        node.receive(Interface::Can, &Frame::new(0x702, &[5]).unwrap()).map(drop)
    };
    for _ in 0..5 {
        assert_eq!(beat(&mut node), Ok(()));
        assert_eq!(codes_of(&pass(&mut node, 50)), []);
    }
    assert_eq!(codes_of(&pass(&mut node, 50)), [0x8130]);
    assert_eq!(read(&mut node, 0x1001, 0).map(|register| register & 0x11), Ok(0x11));
    assert_eq!(beat(&mut node), Ok(()));
    assert_eq!(codes_of(&pass(&mut node, 20)), [0]);
}

#[test]
fn the_faults_of_the_bridge_and_the_board_are_reported_and_remembered() {
    let mut node = Node::new(NodeConfiguration { is_degraded: true, ..Default::default() });
    node.set_fault(Fault::Crystal);
    node.set_fault(Fault::WatchdogReset);
    assert_eq!(codes_of(&pass(&mut node, 100)), [0x6300, 0x5001, 0x6101, 0x6102]);
    assert_eq!(read(&mut node, 0x1003, 0), Ok(4));
    assert_eq!(read(&mut node, 0x1003, 1), Ok(0x000E_6102));
    assert_eq!(read(&mut node, 0x1001, 0), Ok(0x81));
    assert_eq!(write(&mut node, 0x1003, 0, 0), Ok(()));
    assert_eq!(read(&mut node, 0x1003, 0), Ok(0));

    // The converter stops, the CNC comes and goes.
    SERVICE.set(None);
    let mut node =
        Node::new(NodeConfiguration { is_degraded: true, ..sensor_only_calibration().into() });
    assert_eq!(codes_of(&pass(&mut node, 100)), [0x7002, 0x9001, 0x5000, 0x6102]);
    let control = Control::REFERENCED;
    node.receive(Interface::Can, &frames::encode_control(control, 0)).expect("the first");
    assert_eq!(codes_of(&pass(&mut node, 1_000)), [0x8100]);
    node.receive(Interface::Can, &frames::encode_control(control, 1)).expect("in order");
    assert_eq!(codes_of(&pass(&mut node, 100)), [0]);
}

#[test]
fn two_frames_next_to_the_offsets_never_come_in_the_same_or_the_next_tick() {
    let (blob, mut buffer) = (blob(), vec![0; MAX_BLOB_SIZE]);
    let mut node = whole(&blob, &mut buffer);
    let mut before = 0;
    let mut answers = 0;
    for ms in 0..5_000_u32 {
        receive(&mut node, request(0x40, 0x1000, 0, 0));
        let frames = pass(&mut node, 1);
        let services = frames.len();
        answers += frames.iter().filter(|frame| frame.id() == SDO_RESPONSE_ID).count();
        assert!(before == 0 || services == 0, "at {ms} ms");
        before = services;
    }
    assert!((2_350..=2_400).contains(&answers), "{answers} in 5 s");
}

fn command(node: &mut Node<'_>, data: &[u8]) {
    assert_eq!(node.receive(Interface::Can, &Frame::new(NMT_ID, data).expect("short")), Ok(None));
}

#[test]
fn a_node_restarts_only_when_it_is_asked_itself_and_no_offset_is_followed() {
    let mut node = Node::new(sensor_only_calibration().into());
    pass(&mut node, 10);
    // To another node, too long, too short; start, stop, pre-operational.
    let others: [&[u8]; 7] =
        [&[0x81, 2], &[0x81, 1, 0], &[0x81], &[], &[0x01, 1], &[0x02, 0], &[0x80, 1]];
    for data in others {
        command(&mut node, data);
        assert!(!node.take_restart_request(), "{data:02X?}");
    }
    for data in [[0x81, 1], [0x81, 0]] {
        let mut alone = Node::new(sensor_only_calibration().into());
        command(&mut alone, &data);
        assert!(!alone.take_restart_request(), "nobody has allowed it");
        service(&mut node);
        command(&mut node, &data);
        assert_eq!((node.take_restart_request(), node.take_restart_request()), (true, false));
        for quality in [OffsetQuality::Live, OffsetQuality::Hold, OffsetQuality::RampingOut] {
            node.last.quality = quality;
            command(&mut node, &data);
            // Nor does it restart once the offset is gone: that was asked at another time.
            assert!(!node.take_restart_request(), "{quality:?}");
            node.last.quality = OffsetQuality::Off;
            assert!(!node.take_restart_request(), "{quality:?}");
        }
        // Asked in time, but the CNC was quicker.
        command(&mut node, &data);
        node.last.quality = OffsetQuality::Live;
        assert!(!node.take_restart_request());
        node.last.quality = OffsetQuality::Off;
    }
}

#[test]
fn stop_and_start_change_no_frame() {
    let life = |commands: &[[u8; 2]]| -> Vec<Frame> {
        let mut node = Node::new(sensor_only_calibration().into());
        let sent = (0..400_usize).flat_map(|ms| {
            if let Some(data) = commands.get(ms / 100).filter(|_| ms % 100 == 50) {
                command(&mut node, data);
            }
            let mut frames: Vec<_> = node.tick(1, TickInput::default()).into_iter().collect();
            frames.extend(node.next_service_frame());
            frames
        });
        sent.collect()
    };
    let left_alone = life(&[]);
    assert_eq!(life(&[[0x02, 0], [0x80, 1], [0x01, 0]]), left_alone);
    assert_ne!(life(&[[0x82, 1]]), left_alone, "the comparison sees a boot-up");
}

#[test]
fn reset_communication_sets_back_what_cia_301_says_and_the_offsets_go_on() {
    let mut node = Node::new(sensor_only_calibration().into());
    pass(&mut node, 10);
    service(&mut node);
    for (index, subindex, value) in [(0x1015, 0, 500), (0x1017, 0, 20), (0x1016, 1, 0x0002_0032)] {
        let command = if index == 0x1016 { 0x23 } else { 0x2B };
        assert_eq!(transact(&mut node, request(command, index, subindex, value))[0], 0x60);
    }
    assert_eq!(transact(&mut node, request(0x40, 0x1008, 0, 0))[0], 0x41);
    let counter = node.counter;
    command(&mut node, &[0x82, 0]);
    let reported = pass(&mut node, 150);
    let beats: Vec<_> = reported.iter().flat_map(frames::decode_heartbeat).collect();
    assert_eq!(beats, [NmtState::BootUp, NmtState::Stopped], "without samples");
    assert_eq!(node.counter, counter.wrapping_add(150), "a pair a millisecond");
    assert_eq!(read(&mut node, 0x1015, 0), Ok(100));
    assert_eq!(read(&mut node, 0x1017, 0), Ok(100));
    assert_eq!(read(&mut node, 0x1016, 1), Ok(0));
    let segment = transact(&mut node, [0x60, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(segment[0], 0x80, "the upload that was open has ended");
}

#[test]
fn reset_communication_is_passed_over_while_an_offset_is_followed() {
    use OffsetQuality::{Hold, Live, Off};
    for (quality, period_ms) in [(Live, 20), (Hold, 20), (Off, 100)] {
        let mut node = Node::new(sensor_only_calibration().into());
        node.heartbeat.period_ms = 20;
        node.last.quality = quality;
        command(&mut node, &[0x82, 0]);
        assert_eq!(node.heartbeat.period_ms, period_ms, "{quality:?}");
    }
}

#[test]
fn the_status_reports_each_item_in_turn_and_why_a_frame_was_refused() {
    use trueup_link::layout::STATUS_ID;
    use trueup_link::status::{FrameRejectReason, StatusItem, decode};
    let start = ResetInfo { reason: ResetReason::Watchdog, ..ResetInfo::default() };
    let mut node = Node::new(NodeConfiguration { start, ..sensor_only_calibration().into() });
    node.set_free_stack_bytes(4_000);
    let statuses = |node: &mut Node<'_>, ms| -> Vec<_> {
        let reported = pass(node, ms);
        let frames = reported.iter().filter(|frame| frame.id() == STATUS_ID);
        frames.map(|frame| (frames::e2e_counter(frame), decode(frame).expect("ours"))).collect()
    };
    let first = statuses(&mut node, 2_200);
    assert_eq!(first.len(), 22, "ten a second");
    for (number, (counter, status)) in (0..).zip(&first) {
        assert_eq!((*counter, status.last_refused), (number, FrameRejectReason::None));
        let item = match status.item {
            StatusItem::Temperatures { pair, centi_c: [None, None] } => pair,
            StatusItem::Elongation(None) => 4,
            StatusItem::Refused { damaged: 0, out_of_sequence: 0 } => 5,
            StatusItem::Received { malformed: 0, lost: 0 } => 6,
            StatusItem::Board { noise_thousandths: 0, faults } => {
                assert_eq!(faults, node.faults(&node.last).low_half_word());
                7
            }
            StatusItem::State(bits) => {
                assert_eq!(bits, node.faults(&node.last).state_bits());
                8
            }
            StatusItem::Reset { reason: ResetReason::Watchdog, free_stack: 4_000 } => 9,
            StatusItem::Calibration(0) => 10,
            other => panic!("{other:?}"),
        };
        assert_eq!(item, number % 11);
    }
    let control = Control::REFERENCED;
    let frame = |counter| frames::encode_control(control, counter);
    let mut damaged = *frame(0).data();
    damaged[4] ^= 1;
    for (sent, reason, counts) in [
        (Frame::new(CONTROL_ID, &damaged).unwrap(), FrameRejectReason::Damaged, [1, 0, 0, 0]),
        (frame(0), FrameRejectReason::Damaged, [1, 0, 0, 0]),
        (frame(0), FrameRejectReason::Repeated, [1, 1, 0, 0]),
        (frame(100), FrameRejectReason::WrongSequence, [1, 2, 0, 0]),
        (Frame::new(CONTROL_ID, &[0; 7]).unwrap(), FrameRejectReason::Malformed, [1, 2, 1, 0]),
        (frame(103), FrameRejectReason::Malformed, [1, 2, 1, 2]),
    ] {
        node.receive(Interface::Can, &sent).ok();
        let mut found = [None; 4];
        for (_, status) in statuses(&mut node, 1_100) {
            assert_eq!(status.last_refused, reason);
            match status.item {
                StatusItem::Refused { damaged, out_of_sequence } => {
                    (found[0], found[1]) = (Some(damaged), Some(out_of_sequence));
                }
                StatusItem::Received { malformed, lost } => {
                    (found[2], found[3]) = (Some(malformed), Some(lost));
                }
                _ => {}
            }
        }
        assert_eq!(found, counts.map(Some), "{reason:?}");
    }
}

#[test]
fn a_fault_of_a_single_tick_is_reported_whenever_it_comes() {
    use trueup_core::{design_parameters::CODES_PER_TICK, units::AdcCode, units::Rpm};
    let alive: [AdcCode; CODES_PER_TICK] =
        core::array::from_fn(|n| AdcCode(700 + u16::from(n == 1)));
    for phase in 0..4 {
        let mut node = Node::new(sensor_only_calibration().into());
        let mut messages = Vec::new();
        for ms in 0..200 {
            let speed = (ms != 100 + phase).then_some(Rpm(12_000));
            node.tick(1, TickInput { codes: Some(&alive), speed, temperatures: None });
            let flags = node.last_output().flags;
            assert_eq!(flags.contains(OffsetFlags::SPEED_UNKNOWN), speed.is_none());
            messages.extend(node.next_service_frame());
        }
        assert_eq!(codes_of(&messages), [0x6102, 0x9001, 0], "at {phase}");
    }
}
