//! Who writes to a board, and whose machine it is.

use super::*;
use std::{vec, vec::Vec};
use trueup_canopen::{
    dictionary::{CLEAR_REFERENCE_SIGNATURE, RESTORE_REFERENCE_SIGNATURE},
    sdo::{AbortCode, ObjectAccess as _, ObjectValue},
};
use trueup_core::{
    bridge::ReferenceErrors,
    calibration::MachineIdentity,
    units::{FineNanometres, Nanometres},
};
use trueup_link::status::StateBits;
use trueup_store::{
    calibration::{MAX_BLOB_SIZE, calibration_crc, encode},
    reference::ReferenceStatus,
    write_log::{self, RECORD_SIZE, WriteOrigin, WriteRecord},
};

const CHIP_ID: [u32; 3] = [7, 8, 9];

fn named(machine: &'static str, board: [u32; 3]) -> Node<'static> {
    let mut calibration = sensor_only_calibration();
    calibration.names = MachineIdentity { machine: machine.as_bytes(), serial: b"", board };
    Node::new(calibration.into())
}

fn identity_crc(machine: &'static str, board: [u32; 3]) -> u32 {
    write_log::machine_identity_crc(&MachineIdentity {
        machine: machine.as_bytes(),
        serial: b"",
        board,
    })
}

/// `Control` so often, 20 ms apart.
fn send_controls(node: &mut Node<'_>, control: Control, count: usize, counter: &mut u8) {
    for _ in 0..count {
        node.receive(Interface::Serial, &frames::encode_control(control, *counter))
            .expect("in order");
        *counter = counter.wrapping_add(1);
        for _ in 0..20 {
            node.tick(1, TickInput::default());
            node.next_service_frame();
        }
    }
}

fn has_foreign_machine_bit(node: &Node<'_>) -> bool {
    node.faults(node.last_output()).state_bits().contains(StateBits::FOREIGN_MACHINE)
}

#[test]
fn a_board_takes_the_first_machine_and_asks_before_it_runs_another_or_another_boards() {
    const UNKNOWN_CHIP: [u32; 3] = [0; 3];
    let gantry = Some(identity_crc("gantry", UNKNOWN_CHIP));
    for (machine, board, before, is_requested, is_named) in [
        ("gantry", UNKNOWN_CHIP, None, false, true),
        ("gantry", UNKNOWN_CHIP, gantry, false, false),
        ("mill", UNKNOWN_CHIP, gantry, true, false),
        ("gantry", CHIP_ID, None, false, true),
        ("gantry", CHIP_ID, gantry, true, false),
        ("gantry", [7, 8, 1], None, true, false),
        ("gantry", [7, 8, 1], Some(identity_crc("gantry", [7, 8, 1])), false, false),
        // A calibration that names nothing belongs nowhere.
        ("", UNKNOWN_CHIP, None, false, false),
        ("", UNKNOWN_CHIP, gantry, false, false),
    ] {
        let mut node = named(machine, board);
        node.check_identity(before, CHIP_ID);
        node.tick(1, TickInput::default());
        assert_eq!(has_foreign_machine_bit(&node), is_requested, "{machine} {board:?} {before:?}");
        let write = node.take_pending_write();
        let expected =
            is_named.then(|| (WriteKind::Named, identity_crc(machine, board), WriteOrigin::Board));
        assert_eq!(write.map(|write| (write.what, write.about, write.origin)), expected);
    }
}

#[test]
fn another_machine_gives_no_offset_until_confirm_and_is_the_boards_own_from_then_on() {
    let mut node = named("mill", [0; 3]);
    node.check_identity(Some(identity_crc("gantry", [0; 3])), CHIP_ID);
    let mut counter = 0;
    send_controls(&mut node, Control::REFERENCED, 5, &mut counter);
    send_controls(&mut node, Control::ENGAGED, 30, &mut counter);
    assert_eq!(
        (node.last_output().quality, has_foreign_machine_bit(&node)),
        (OffsetQuality::Fault, true)
    );
    send_controls(&mut node, Control { confirm: true, ..Control::REFERENCED }, 5, &mut counter);
    assert!(!has_foreign_machine_bit(&node));
    let written = [(); 3].map(|()| {
        node.take_pending_write().map(|record| (record.what, record.about, record.origin))
    });
    let question = u32::from(Fault::ForeignMachine as u8);
    assert_eq!(
        written,
        [
            Some((WriteKind::Confirmed, question, WriteOrigin::Serial)),
            Some((WriteKind::Named, identity_crc("mill", [0; 3]), WriteOrigin::Serial)),
            None
        ]
    );
}

/// Stores the writes that wait, as the board does, numbered from `first`. Returns them.
fn store(node: &mut Node<'_>, first: u32) -> Vec<WriteRecord> {
    let mut stored = Vec::new();
    while let Some(write) = node.take_pending_write() {
        let sequence = first + u32::try_from(stored.len()).expect("a few entries");
        let retained = WriteRecord { sequence, ..write };
        node.finish_write(&write, Some(retained));
        stored.push(retained);
    }
    stored
}

fn read_writes(node: &Node<'_>) -> Vec<WriteRecord> {
    let Ok(ObjectValue::Bytes(bytes)) =
        node.read(trueup_canopen::dictionary::EntryContent::WriteLog)
    else {
        return Vec::new();
    };
    bytes.as_chunks::<RECORD_SIZE>().0.iter().filter_map(WriteRecord::from_bytes).collect()
}

#[test]
fn every_write_is_reported_with_what_when_and_over_which_line_and_a_second_load_hides_no_first() {
    use trueup_canopen::dictionary::EntryContent as O;
    let mut room = [0; MAX_BLOB_SIZE];
    let blob = encode(&sensor_only_calibration(), &mut room).expect("small").to_vec();
    let mut buffer = vec![0; MAX_BLOB_SIZE];
    let buffer = Some(&mut buffer[..]);
    let mut node =
        Node::new(NodeConfiguration { blob: &blob, buffer, ..sensor_only_calibration().into() });
    let mut counter = 0;
    let service = Control { service: true, ..Control::REFERENCED };
    send_controls(&mut node, service, 5, &mut counter);
    assert_eq!(node.read(O::Utc), Ok(ObjectValue::Number(0)));
    node.write(O::Utc, 1_790_000_000).expect("allowed");
    send_controls(&mut node, service, 100, &mut counter);
    node.log.set_request_interface(Interface::Can);
    node.open(O::New, None).and_then(|()| node.append(O::New, &blob)).expect("allowed");
    node.close(O::New).expect("allowed");
    let load = node.take_received_calibration().expect("whole");
    node.finish_load(load, LoadOutcome::Stored);
    node.restore_reference_status(
        ReferenceStatus::in_force(ReferenceErrors {
            elongation: Nanometres(9),
            ..ReferenceErrors::default()
        }),
        None,
    );
    node.log.set_request_interface(Interface::Serial);
    // Again and again it is nothing new, and fills no flash.
    for _ in 0..100 {
        node.write(O::Forget, CLEAR_REFERENCE_SIGNATURE).expect("allowed");
    }
    let stored = store(&mut node, 5);
    assert_eq!(read_writes(&node), stored);
    let crc = calibration_crc(&blob);
    let seen: Vec<_> = stored
        .iter()
        .map(|record| (record.sequence, record.what, record.about, record.origin))
        .collect();
    assert_eq!(
        seen,
        [
            (5, WriteKind::Loaded, crc, WriteOrigin::Can),
            (6, WriteKind::Forgotten, 0, WriteOrigin::Serial)
        ]
    );
    for write in &stored {
        assert_eq!((write.calibration, write.utc_s), (crc, 1_790_000_002));
        assert_eq!(write.at_ms, node.now().0);
    }
    // A second load that is given up leaves the first for the next start, and says so.
    node.open(O::New, None).and_then(|()| node.append(O::New, &[1, 2, 3])).expect("allowed");
    assert_eq!(node.read(O::NewCrc), Ok(ObjectValue::Number(crc)));
}

#[test]
fn nothing_is_written_while_an_offset_is_followed_or_without_service() {
    use trueup_canopen::dictionary::EntryContent as O;
    let mut node = Node::new(sensor_only_calibration().into());
    node.restore_reference_status(
        ReferenceStatus::in_force(ReferenceErrors {
            elongation: Nanometres(9),
            ..ReferenceErrors::default()
        }),
        None,
    );
    let mut counter = 0;
    let service = Control { service: true, ..Control::REFERENCED };
    for (control, quality, may) in [
        (Control::REFERENCED, OffsetQuality::Off, false),
        (service, OffsetQuality::Live, false),
        (Control { engage: true, ..service }, OffsetQuality::Off, false),
        (service, OffsetQuality::Off, true),
    ] {
        send_controls(&mut node, control, 5, &mut counter);
        node.last.quality = quality;
        for (what, number) in [
            (O::ErrorCount, 0),
            (O::Inhibit, 100),
            (O::ConsumerHeartbeat, 0x0002_0064),
            (O::ProducerHeartbeat, 0),
            (O::Utc, 1),
            (O::ReferenceElongation, 9),
            (O::Reference(0), 9),
            (O::Reference(1), 9),
            (O::Reference(2), 9),
            (O::Forget, RESTORE_REFERENCE_SIGNATURE),
            (O::Forget, CLEAR_REFERENCE_SIGNATURE),
        ] {
            let expected = if may { Ok(()) } else { Err(AbortCode::DeviceState) };
            assert_eq!(node.write(what, number), expected, "{what:?} {control:?} {quality:?}");
        }
    }
}

#[test]
fn the_reference_of_the_board_before_is_taken_when_all_of_it_is_there_and_is_stored() {
    use trueup_canopen::dictionary::EntryContent as O;
    let mut node = named("gantry", [0; 3]);
    let mut counter = 0;
    send_controls(&mut node, Control { service: true, ..Control::REFERENCED }, 5, &mut counter);
    node.log.set_request_interface(Interface::Serial);
    let offered = [
        (O::ReferenceElongation, -1_000_i32),
        (O::Reference(0), 2_000),
        (O::Reference(1), 500_000),
        (O::Reference(2), -3),
    ];
    // Whichever part is missing: nothing is taken, and what was offered still waits.
    for missing in 0..4 {
        node.offer = OfferedReference::default();
        for (what, nm) in
            offered.into_iter().skip(missing + 1).chain(offered.into_iter().take(missing))
        {
            node.write(what, nm.cast_unsigned()).expect("allowed");
        }
        assert_eq!(
            node.write(O::Forget, RESTORE_REFERENCE_SIGNATURE),
            Err(AbortCode::DeviceState),
            "without {missing}"
        );
        assert_eq!(
            (node.reference(), node.take_zero_outcome()),
            (ReferenceErrors::default(), None)
        );
        let (what, nm) = offered[missing];
        node.write(what, nm.cast_unsigned()).expect("allowed");
        assert_eq!(
            (node.reference(), node.take_zero_outcome()),
            (ReferenceErrors::default(), None),
            "it waits"
        );
    }
    node.restore_reference_status(
        ReferenceStatus::in_force(ReferenceErrors {
            elongation: Nanometres(7),
            ..ReferenceErrors::default()
        }),
        None,
    );
    node.write(O::Forget, RESTORE_REFERENCE_SIGNATURE).expect("allowed");
    // It is offered, and until it is confirmed none is in force.
    let axes = [2_000, 500_000, -3].map(|nm| FineNanometres(nm * FineNanometres::PER_NANOMETRE));
    let back = ReferenceErrors { elongation: Nanometres(-1_000), axes };
    assert_eq!((node.reference(), node.take_zero_outcome()), (ReferenceErrors::default(), None));
    let offered = ReferenceStatus { is_offered: true, ..ReferenceStatus::in_force(back) };
    assert_eq!((node.take_reference_status(), node.take_reference_status()), (Some(offered), None));
    assert!(node.questions.contains(Fault::ReferenceOffered));
    assert_eq!(node.read(O::Offered(1)), Ok(ObjectValue::Number(500_000)));
    let write = node.take_pending_write().map(|record| (record.what, record.about, record.origin));
    assert_eq!(
        write,
        Some((WriteKind::Offered, (-1_000_i32).cast_unsigned(), WriteOrigin::Serial))
    );
    assert_eq!(node.write(O::Forget, RESTORE_REFERENCE_SIGNATURE + 1), Err(AbortCode::Value));
    assert_eq!(
        node.write(O::Forget, RESTORE_REFERENCE_SIGNATURE),
        Err(AbortCode::DeviceState),
        "once"
    );
    assert_eq!(node.write(O::Reference(3), 1), Err(AbortCode::NoSubindex));
}

#[test]
fn a_write_that_is_not_stored_is_reported_and_so_is_the_store() {
    let mut node = named("gantry", [0; 3]);
    node.check_identity(None, CHIP_ID);
    let write = node.take_pending_write().expect("named");
    node.finish_write(&write, None);
    assert_eq!(read_writes(&node), [write]);
    assert!(node.faults(node.last_output()).contains(Fault::Store));
    // A board that takes none of them loses none either.
    for about in 0..10 {
        node.log_write(WriteKind::Zeroed, about, Some(Interface::Can));
    }
    let waiting = core::iter::from_fn(|| node.take_pending_write()).count();
    assert_eq!(waiting + read_writes(&node).len(), 11);
}

#[test]
fn writes_from_before_the_start_are_reported_before_those_since() {
    let mut node = named("gantry", [0; 3]);
    let write = |sequence| WriteRecord {
        sequence,
        calibration: 7,
        about: 9,
        at_ms: 5,
        utc_s: 0,
        what: WriteKind::Confirmed,
        origin: WriteOrigin::Can,
        is_unattended: false,
    };
    let mut stored = write_log::WriteLog::default();
    [1, 2].map(write).iter().for_each(|write| stored.push(write));
    node.log = WriteJournal::from_stored(stored);
    node.finish_write(&write(0), Some(write(3)));
    assert_eq!(read_writes(&node), [1, 2, 3].map(write));
}
