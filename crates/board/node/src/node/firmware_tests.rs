//! A new firmware through the object dictionary, to a board that the test plays.

use std::vec::Vec;

use trueup_canopen::{
    dictionary::{EntryContent as O, FIRMWARE_HEADER_BYTES},
    sdo::{AbortCode, ObjectAccess as _, ObjectValue},
};
use trueup_core::cnc::Control;
use trueup_link::frames;

use super::{
    Interface, Node, NodeConfiguration,
    firmware_update::{FirmwareChunk, SlotStates, UpdateStep},
    sensor_only_calibration,
};

/// Returns a node at rest in slot B, whose CNC says `Service`.
fn node_in_service(buffer: &mut [u8]) -> Node<'_> {
    let mut node =
        Node::new(NodeConfiguration { buffer: Some(buffer), ..sensor_only_calibration().into() });
    let service = Control { service: true, ..Control::REFERENCED };
    for counter in 0..4 {
        node.receive(Interface::Can, &frames::encode_control(service, counter)).expect("in order");
    }
    let status = [[5, 0], [3, 2]];
    let versions = [0x0102_0300, 0x0102_0400];
    node.set_slot_states(SlotStates {
        running: 1,
        versions,
        status,
        floor: 7,
        choice: 0x0005_0202,
    });
    node
}

/// Returns the next step, and its bytes.
fn take_update_step(node: &mut Node<'_>) -> Option<(UpdateStep, Vec<u8>)> {
    let mut piece = FirmwareChunk::new();
    node.take_firmware_step(&mut piece).map(|step| (step, piece.to_vec()))
}

fn number(node: &Node<'_>, what: O) -> u32 {
    match node.read(what) {
        Ok(ObjectValue::Number(number)) => number,
        other => panic!("{what:?}: {other:?}"),
    }
}

fn firmware_header() -> [u8; FIRMWARE_HEADER_BYTES] {
    core::array::from_fn(|at| u8::try_from(at % 251).expect("below 251"))
}

/// Writes the header as a master does; the board takes it.
fn begin(node: &mut Node<'_>) {
    node.open(O::FirmwareHeader, Some(512)).expect("allowed");
    for segment in firmware_header().chunks(7) {
        node.append(O::FirmwareHeader, segment).expect("room");
        assert_eq!(take_update_step(node), None, "not before all of it has come");
    }
    node.close(O::FirmwareHeader).expect("whole");
    assert_eq!(take_update_step(node), Some((UpdateStep::Begin, firmware_header().to_vec())));
    assert_eq!(take_update_step(node), None, "one at a time");
    node.finish_firmware_step(UpdateStep::Begin, Ok(()));
}

/// Has the board take what waits.
fn write_pending_to_flash(node: &mut Node<'_>, flash: &mut Vec<u8>) {
    let (step, bytes) = take_update_step(node).expect("bytes wait");
    assert_eq!(step, UpdateStep::Write);
    flash.extend(bytes);
    node.finish_firmware_step(step, Ok(()));
}

#[test]
fn a_firmware_comes_in_two_transfers_and_each_byte_reaches_the_board_once() {
    let mut buffer = [0; 1_024];
    let mut node = node_in_service(&mut buffer);
    assert_eq!([O::FirmwareReceived, O::FirmwareTag].map(|object| number(&node, object)), [0; 2]);
    begin(&mut node);
    let tag = firmware_header().last_chunk().map(|bytes| u32::from_le_bytes(*bytes));
    assert_eq!(
        (number(&node, O::FirmwareReceived), Some(number(&node, O::FirmwareTag))),
        (512, tag)
    );

    let image: Vec<u8> = (0_u8..241).cycle().take(2_000).collect();
    let mut flash = Vec::new();
    let (first, rest) = image.split_at(1_001);
    node.open(O::FirmwareImage, None).expect("allowed");
    for (turn, segment) in first.chunks(7).enumerate() {
        node.append(O::FirmwareImage, segment).expect("room");
        if turn % 5 == 0 {
            write_pending_to_flash(&mut node, &mut flash);
        }
    }
    assert_eq!(node.open(O::New, None), Err(AbortCode::DeviceState), "the buffer is in use");
    // The line breaks. What had come is kept, and the next transfer goes on behind it.
    assert_eq!(number(&node, O::FirmwareReceived), 512 + 1_001);
    assert_eq!(node.open(O::FirmwareImage, Some(999)), Err(AbortCode::DeviceState), "bytes wait");
    write_pending_to_flash(&mut node, &mut flash);
    node.open(O::FirmwareImage, Some(999)).expect("allowed");
    for segment in rest.chunks(7) {
        node.append(O::FirmwareImage, segment).expect("room");
        write_pending_to_flash(&mut node, &mut flash);
    }
    node.close(O::FirmwareImage).expect("whole");
    assert_eq!(take_update_step(&mut node), Some((UpdateStep::Finish, Vec::new())));
    node.finish_firmware_step(UpdateStep::Finish, Ok(()));
    assert_eq!(flash, image);
    assert_eq!((number(&node, O::FirmwareReceived), number(&node, O::FirmwareRefused)), (2_512, 0));
}

#[test]
fn a_refusal_of_the_board_has_its_number_and_ends_the_firmware() {
    let mut buffer = [0; 1_024];
    let mut node = node_in_service(&mut buffer);
    node.open(O::FirmwareHeader, None).expect("allowed");
    node.append(O::FirmwareHeader, &[0; 512]).expect("room");
    node.close(O::FirmwareHeader).expect("whole");
    let (step, _) = take_update_step(&mut node).expect("a step");
    node.finish_firmware_step(step, Err(9));
    assert_eq!(number(&node, O::FirmwareRefused), 9);
    assert_eq!(node.open(O::FirmwareImage, None), Err(AbortCode::DeviceState), "none is under way");
    // The flash refuses in the middle: the next segment is refused, and it must begin anew.
    begin(&mut node);
    assert_eq!(number(&node, O::FirmwareRefused), 0);
    node.open(O::FirmwareImage, None).expect("allowed");
    node.append(O::FirmwareImage, &[1; 7]).expect("room");
    let (step, _) = take_update_step(&mut node).expect("a step");
    node.finish_firmware_step(step, Err(11));
    assert_eq!(node.append(O::FirmwareImage, &[1; 7]), Err(AbortCode::Value));
    assert_eq!(
        [O::FirmwareReceived, O::FirmwareRefused].map(|object| number(&node, object)),
        [0, 11]
    );
}

#[test]
fn a_header_of_another_length_and_too_many_bytes_at_once_are_refused() {
    let mut buffer = [0; 1_024];
    let mut node = node_in_service(&mut buffer);
    assert_eq!(node.open(O::FirmwareHeader, Some(511)), Err(AbortCode::Length));
    node.open(O::FirmwareHeader, None).expect("allowed");
    node.append(O::FirmwareHeader, &[0; 511]).expect("room");
    assert_eq!(node.append(O::FirmwareHeader, &[0; 2]), Err(AbortCode::TooLong));
    assert_eq!(node.close(O::FirmwareHeader), Err(AbortCode::TooShort));
    assert_eq!(take_update_step(&mut node), None);
    begin(&mut node);
    node.open(O::FirmwareImage, None).expect("allowed");
    node.append(O::FirmwareImage, &[0; 512]).expect("room");
    // A board that does not take them: the master is to come back, and nothing is lost.
    assert_eq!(node.append(O::FirmwareImage, &[0; 7]), Err(AbortCode::CannotStore));
    assert_eq!(number(&node, O::FirmwareReceived), 1_024);
}

#[test]
fn nothing_is_taken_without_service_or_while_an_offset_is_followed_and_a_board_without_slots_reports_it()
 {
    let mut node = Node::new(sensor_only_calibration().into());
    assert_eq!(node.open(O::FirmwareHeader, None), Err(AbortCode::DeviceState));
    assert_eq!(node.read(O::RunningSlot), Err(AbortCode::NoData));
    let mut buffer = [0; 1_024];
    let mut node = node_in_service(&mut buffer);
    begin(&mut node);
    node.open(O::FirmwareImage, None).expect("allowed");
    node.append(O::FirmwareImage, &[1; 7]).expect("room");
    // The CNC ends its service: the next segment is refused.
    for counter in 4..8 {
        node.receive(Interface::Can, &frames::encode_control(Control::REFERENCED, counter))
            .expect("in order");
    }
    assert_eq!(node.append(O::FirmwareImage, &[1; 7]), Err(AbortCode::DeviceState));
    node.firmware = super::firmware_update::FirmwareUpdate::default();
    for counter in 8..12 {
        let service = Control { service: true, ..Control::REFERENCED };
        node.receive(Interface::Can, &frames::encode_control(service, counter)).expect("in order");
    }
    assert_eq!(node.open(O::FirmwareHeader, None), Err(AbortCode::CannotStore), "it has no slots");
}

#[test]
fn the_slots_are_read_as_the_table_of_objects_has_them() {
    let mut buffer = [0; 1_024];
    let node = node_in_service(&mut buffer);
    let read = |what| number(&node, what);
    assert_eq!(read(O::RunningSlot), 1);
    assert_eq!([0, 1].map(|slot| read(O::SlotVersion(slot))), [0x0102_0300, 0x0102_0400]);
    assert_eq!([0, 1].map(|slot| read(O::SlotStatus(slot))), [5, 0x0203]);
    assert_eq!(read(O::FirmwareFloor), 7);
    assert_eq!(read(O::SlotChoice), 0x0005_0202);
    assert_eq!(node.read(O::FirmwareImage), Err(AbortCode::WriteOnly));
}
