//! Who writes to a board, and whose machine it is.

use super::*;
use std::{vec, vec::Vec};
use trueup_canopen::{
    dictionary::{BACK, FORGET},
    sdo::{Abort, ObjectValue, Objects as _},
};
use trueup_core::{
    bridge::Reference,
    calibration::Names,
    units::{Fine, Nanometres},
};
use trueup_link::status::StateBits;
use trueup_store::{
    calibration::{MAX_SIZE, encode, identity},
    reference::Standing,
    writes::{self, Origin, SIZE, Write},
};

const CHIP: [u32; 3] = [7, 8, 9];

fn named(machine: &'static str, board: [u32; 3]) -> Node<'static> {
    let mut calibration = tests_calibration();
    calibration.names = Names { machine: machine.as_bytes(), serial: b"", board };
    Node::new(Some(calibration), false)
}

fn of(machine: &'static str, board: [u32; 3]) -> u32 {
    writes::identity(&Names { machine: machine.as_bytes(), serial: b"", board })
}

/// `Control` so often, 20 ms apart.
fn controls(node: &mut Node<'_>, control: Control, count: usize, counter: &mut u8) {
    for _ in 0..count {
        node.receive(Interface::Serial, &frames::control(control, *counter)).expect("in order");
        *counter = counter.wrapping_add(1);
        for _ in 0..20 {
            node.tick(1, Input::default());
            node.service();
        }
    }
}

fn asks(node: &Node<'_>) -> bool {
    node.faults(node.last()).state().contains(StateBits::FOREIGN_MACHINE)
}

#[test]
fn a_board_takes_the_first_machine_and_asks_before_it_runs_another_or_another_boards() {
    const NO: [u32; 3] = [0; 3];
    let gantry = Some(of("gantry", NO));
    for (machine, board, before, is_asked, is_named) in [
        ("gantry", NO, None, false, true),
        ("gantry", NO, gantry, false, false),
        ("mill", NO, gantry, true, false),
        ("gantry", CHIP, None, false, true),
        ("gantry", CHIP, gantry, true, false),
        ("gantry", [7, 8, 1], None, true, false),
        ("gantry", [7, 8, 1], Some(of("gantry", [7, 8, 1])), false, false),
        // A calibration that names nothing belongs nowhere.
        ("", NO, None, false, false),
        ("", NO, gantry, false, false),
    ] {
        let mut node = named(machine, board);
        node.check_identity(before, CHIP);
        node.tick(1, Input::default());
        assert_eq!(asks(&node), is_asked, "{machine} {board:?} {before:?}");
        let write = node.take_write();
        let expected = is_named.then(|| (WriteKind::Named, of(machine, board), Origin::Board));
        assert_eq!(write.map(|it| (it.what, it.about, it.origin)), expected);
    }
}

#[test]
fn another_machine_gives_no_offset_until_confirm_and_is_the_boards_own_from_then_on() {
    let mut node = named("mill", [0; 3]);
    node.check_identity(Some(of("gantry", [0; 3])), CHIP);
    let mut counter = 0;
    controls(&mut node, Control::REFERENCED, 5, &mut counter);
    controls(&mut node, Control::ENGAGED, 30, &mut counter);
    assert_eq!((node.last().quality, asks(&node)), (Quality::Fault, true));
    controls(&mut node, Control { confirm: true, ..Control::REFERENCED }, 5, &mut counter);
    assert!(!asks(&node));
    let written = [(); 3].map(|()| node.take_write().map(|it| (it.what, it.about, it.origin)));
    let question = u32::from(Fault::ForeignMachine as u8);
    assert_eq!(
        written,
        [
            Some((WriteKind::Confirmed, question, Origin::Serial)),
            Some((WriteKind::Named, of("mill", [0; 3]), Origin::Serial)),
            None
        ]
    );
}

/// Stores the writes that wait, as the board does, numbered from `first`. Returns them.
fn store(node: &mut Node<'_>, first: u32) -> Vec<Write> {
    let mut stored = Vec::new();
    while let Some(write) = node.take_write() {
        let sequence = first + u32::try_from(stored.len()).expect("a few entries");
        let kept = Write { sequence, ..write };
        node.end_write(&write, Some(kept));
        stored.push(kept);
    }
    stored
}

fn told(node: &Node<'_>) -> Vec<Write> {
    let Ok(ObjectValue::Bytes(bytes)) = node.read(trueup_canopen::dictionary::ObjectKind::WriteLog)
    else {
        return Vec::new();
    };
    bytes.as_chunks::<SIZE>().0.iter().filter_map(Write::from_bytes).collect()
}

#[test]
fn every_write_is_told_with_what_when_and_over_which_line_and_a_second_load_hides_no_first() {
    use trueup_canopen::dictionary::ObjectKind as O;
    let mut room = [0; MAX_SIZE];
    let blob = encode(&tests_calibration(), &mut room).expect("small").to_vec();
    let mut buffer = vec![0; MAX_SIZE];
    let mut node = Node::new(Some(tests_calibration()), false);
    node.set_blob(&blob);
    node.set_buffer(&mut buffer);
    let mut counter = 0;
    let service = Control { service: true, ..Control::REFERENCED };
    controls(&mut node, service, 5, &mut counter);
    assert_eq!(node.read(O::Utc), Ok(ObjectValue::Number(0)));
    node.write(O::Utc, 1_790_000_000).expect("allowed");
    controls(&mut node, service, 100, &mut counter);
    node.log.speaks(Interface::Can);
    node.open(O::New, None).and_then(|()| node.append(O::New, &blob)).expect("allowed");
    node.close(O::New).expect("allowed");
    let load = node.take_load().expect("whole");
    node.end_load(load, Outcome::Stored);
    node.set_standing(
        Standing::in_force(Reference { elongation: Nanometres(9), ..Reference::default() }),
        None,
    );
    node.log.speaks(Interface::Serial);
    // Again and again it is nothing new, and fills no flash.
    for _ in 0..100 {
        node.write(O::Forget, FORGET).expect("allowed");
    }
    let stored = store(&mut node, 5);
    assert_eq!(told(&node), stored);
    let crc = identity(&blob);
    let seen: Vec<_> =
        stored.iter().map(|it| (it.sequence, it.what, it.about, it.origin)).collect();
    assert_eq!(
        seen,
        [(5, WriteKind::Loaded, crc, Origin::Can), (6, WriteKind::Forgotten, 0, Origin::Serial)]
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
    use trueup_canopen::dictionary::ObjectKind as O;
    let mut node = Node::new(Some(tests_calibration()), false);
    node.set_standing(
        Standing::in_force(Reference { elongation: Nanometres(9), ..Reference::default() }),
        None,
    );
    let mut counter = 0;
    let service = Control { service: true, ..Control::REFERENCED };
    for (control, quality, may) in [
        (Control::REFERENCED, Quality::Off, false),
        (service, Quality::Live, false),
        (Control { engage: true, ..service }, Quality::Off, false),
        (service, Quality::Off, true),
    ] {
        controls(&mut node, control, 5, &mut counter);
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
            (O::Forget, BACK),
            (O::Forget, FORGET),
        ] {
            let expected = if may { Ok(()) } else { Err(Abort::DeviceState) };
            assert_eq!(node.write(what, number), expected, "{what:?} {control:?} {quality:?}");
        }
    }
}

#[test]
fn the_reference_of_the_board_before_is_taken_when_all_of_it_is_there_and_is_stored() {
    use trueup_canopen::dictionary::ObjectKind as O;
    let mut node = named("gantry", [0; 3]);
    let mut counter = 0;
    controls(&mut node, Control { service: true, ..Control::REFERENCED }, 5, &mut counter);
    node.log.speaks(Interface::Serial);
    let offered = [
        (O::ReferenceElongation, -1_000_i32),
        (O::Reference(0), 2_000),
        (O::Reference(1), 500_000),
        (O::Reference(2), -3),
    ];
    // Whichever part is missing: nothing is taken, and what was offered still waits.
    for missing in 0..4 {
        node.offer = Offer::default();
        for (what, nm) in
            offered.into_iter().skip(missing + 1).chain(offered.into_iter().take(missing))
        {
            node.write(what, nm.cast_unsigned()).expect("allowed");
        }
        assert_eq!(node.write(O::Forget, BACK), Err(Abort::DeviceState), "without {missing}");
        assert_eq!((node.reference(), node.take_zero()), (Reference::default(), None));
        let (what, nm) = offered[missing];
        node.write(what, nm.cast_unsigned()).expect("allowed");
        assert_eq!((node.reference(), node.take_zero()), (Reference::default(), None), "it waits");
    }
    node.set_standing(
        Standing::in_force(Reference { elongation: Nanometres(7), ..Reference::default() }),
        None,
    );
    node.write(O::Forget, BACK).expect("allowed");
    // It is offered, and until it is confirmed none is in force.
    let axes = [2_000, 500_000, -3].map(|nm| Fine(nm * Fine::PER_NANOMETRE));
    let back = Reference { elongation: Nanometres(-1_000), axes };
    assert_eq!((node.reference(), node.take_zero()), (Reference::default(), None));
    let offered = Standing { is_offered: true, ..Standing::in_force(back) };
    assert_eq!((node.take_standing(), node.take_standing()), (Some(offered), None));
    assert!(node.questions.has(Fault::ReferenceOffered));
    assert_eq!(node.read(O::Offered(1)), Ok(ObjectValue::Number(500_000)));
    let write = node.take_write().map(|it| (it.what, it.about, it.origin));
    assert_eq!(write, Some((WriteKind::Offered, (-1_000_i32).cast_unsigned(), Origin::Serial)));
    assert_eq!(node.write(O::Forget, BACK + 1), Err(Abort::Value));
    assert_eq!(node.write(O::Forget, BACK), Err(Abort::DeviceState), "once");
    assert_eq!(node.write(O::Reference(3), 1), Err(Abort::NoSubindex));
}

#[test]
fn a_write_that_is_not_stored_is_told_and_so_is_the_store() {
    let mut node = named("gantry", [0; 3]);
    node.check_identity(None, CHIP);
    let write = node.take_write().expect("named");
    node.end_write(&write, None);
    assert_eq!(told(&node), [write]);
    assert!(node.faults(node.last()).has(Fault::Store));
    // A board that takes none of them loses none either.
    for about in 0..10 {
        node.log(WriteKind::Zeroed, about, Some(Interface::Can));
    }
    let waiting = core::iter::from_fn(|| node.take_write()).count();
    assert_eq!(waiting + told(&node).len(), 11);
}

#[test]
fn writes_from_before_the_start_are_told_before_those_since() {
    let mut node = named("gantry", [0; 3]);
    let write = |sequence| Write {
        sequence,
        calibration: 7,
        about: 9,
        at_ms: 5,
        utc_s: 0,
        what: WriteKind::Confirmed,
        origin: Origin::Can,
        is_unattended: false,
    };
    let mut stored = writes::Writes::default();
    [1, 2].map(write).iter().for_each(|it| stored.push(it));
    node.set_writes(stored);
    node.end_write(&write(0), Some(write(3)));
    assert_eq!(told(&node), [1, 2, 3].map(write));
}
