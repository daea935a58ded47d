//! Values that a master reads of a board: the sensor, the thermometers, the noise, the names, the time.

mod sensor_bridge;

use sensor_bridge::calibration;
use trueup_canopen::{
    dictionary::{ELONGATION_SUBINDEX, EntryContent, NOT_AVAILABLE, ReceiverCounter},
    sdo::{AbortCode, ObjectAccess, ObjectValue},
};
use trueup_core::{
    bridge::{ReferenceErrors, TickInput},
    cnc::Control,
    design_parameters::CODES_PER_TICK,
    supply_monitor::InternalReferenceLevel,
    thermometer::RawTemperatureReading,
    units::{AdcCode, Nanometres},
};
use trueup_link::{
    frame::Frame,
    frames,
    layout::CONTROL_ID,
    status::{self, StatusItem},
};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_store::{calibration::calibration_crc, reference::ReferenceStatus};

fn node() -> Node<'static> {
    Node::new(calibration().into())
}

/// Milliseconds in which the sensor reads 700.5 codes, one up and one down, and the PT100 20 °C.
fn run(node: &mut Node<'_>, ms: u32) {
    run_at(node, ms, RawTemperatureReading(107_793_500));
}

fn run_at(node: &mut Node<'_>, ms: u32, thermometer: RawTemperatureReading) {
    let codes: [AdcCode; CODES_PER_TICK] =
        core::array::from_fn(|n| AdcCode(if n % 2 == 0 { 700 } else { 701 }));
    let mut temperatures = [RawTemperatureReading::NONE; 8];
    temperatures[2] = thermometer;
    for _ in 0..ms {
        let temperatures = Some(&temperatures);
        node.tick(1, TickInput { codes: Some(&codes), speed: None, temperatures });
    }
}

fn number(node: &Node<'_>, what: EntryContent) -> u32 {
    match node.read(what) {
        Ok(ObjectValue::Number(number)) => number,
        other => panic!("{what:?}: {other:?}"),
    }
}

#[test]
fn each_input_is_read_at_its_place_and_what_is_not_there_is_reported_to_be_missing() {
    let elongation = ELONGATION_SUBINDEX - 1;
    let mut node = node();
    for is_running in [false, true] {
        for input in 0..ELONGATION_SUBINDEX {
            let value = number(&node, EntryContent::Input(input)).cast_signed();
            let is_missing = number(&node, EntryContent::InputStatus(input)) != 0;
            // In thousandths: of a degree, of a micrometre.
            let expected = match input {
                2 => Some(20_000),
                _ if input == elongation => Some(717_312),
                _ => None,
            };
            let expected = expected.filter(|_| is_running);
            assert_eq!(value, expected.unwrap_or(NOT_AVAILABLE), "input {input}");
            assert_eq!(is_missing, expected.is_none(), "input {input}");
        }
        run(&mut node, 1_000);
    }
}

#[test]
fn the_noise_is_reported_in_thousandths_of_a_code_once_the_board_has_taken_it() {
    let mut node = node();
    run(&mut node, 100);
    assert_eq!(number(&node, EntryContent::Noise), 0);
    // Second differences of 2 codes: √(4/6), in the log and in the object.
    assert_eq!(node.take_display_values().noise_codes, 0.816);
    assert_eq!(number(&node, EntryContent::Noise), 816);
}

#[test]
fn the_names_of_the_machine_are_read_and_without_a_calibration_there_are_none() {
    let (named, none) = (node(), Node::new(NodeConfiguration::default()));
    let texts = [(EntryContent::MachineName, "gantry"), (EntryContent::MachineSerial, "17/4")];
    for (what, text) in texts {
        assert_eq!(named.read(what), Ok(ObjectValue::Bytes(text.as_bytes())));
        assert_eq!(none.read(what), Err(AbortCode::NoData));
    }
}

#[test]
fn blocks_are_counted_and_a_tick_without_one_is_not() {
    let mut node = node();
    assert_eq!(node.sample_block_count(), 0);
    run(&mut node, 5);
    node.tick(1, TickInput::default());
    assert_eq!(node.sample_block_count(), 5);
}

#[test]
fn the_level_that_readings_count_from_is_the_stored_one_or_that_of_the_first_seconds() {
    let mut node = node();
    assert_eq!(node.supply_baseline_level(), InternalReferenceLevel(0), "not known yet");
    (0..200).for_each(|_| node.receive_supply_code(AdcCode(1_500)));
    assert_eq!(node.supply_baseline_level(), InternalReferenceLevel(1_500 * 16));
    node.set_supply_baseline_level(InternalReferenceLevel(24_321));
    (0..200).for_each(|_| node.receive_supply_code(AdcCode(1_500)));
    assert_eq!(node.supply_baseline_level(), InternalReferenceLevel(24_321));
}

#[test]
fn a_time_that_was_set_goes_on_and_one_of_0_is_none() {
    let mut node = node();
    let control = Control { service: true, ..Control::REFERENCED };
    for counter in 0..5 {
        node.receive(Interface::Can, &frames::encode_control(control, counter)).expect("in order");
        run(&mut node, 20);
        node.next_service_frame();
    }
    for (reported, after_3_s) in [(1_790_000_000, 1_790_000_003), (0, 0)] {
        node.write(EntryContent::Utc, reported).expect("allowed");
        run(&mut node, 3_000);
        assert_eq!(number(&node, EntryContent::Utc), after_3_s);
    }
}

#[test]
fn a_board_that_runs_and_was_written_nothing_has_no_calibration_and_no_writes_to_read() {
    let node = node();
    for what in [EntryContent::Running, EntryContent::WriteLog] {
        assert_eq!(node.read(what), Err(AbortCode::NoData), "{what:?}");
    }
    assert_eq!(number(&node, EntryContent::RunningCrc), 0);
    let blob = [7; 100];
    let node = Node::new(NodeConfiguration { blob: &blob, ..NodeConfiguration::default() });
    assert_eq!(node.read(EntryContent::Running), Ok(ObjectValue::Bytes(&blob)));
    assert_eq!(number(&node, EntryContent::RunningCrc), calibration_crc(&blob));
}

#[test]
fn a_board_reports_its_number_the_commit_of_its_image_and_whether_a_reference_is_in_force() {
    let mut node = Node::new(NodeConfiguration {
        serial_number: 0xFEDC_BA98,
        commit: 0x1234_ABCD,
        ..NodeConfiguration::default()
    });
    assert_eq!(number(&node, EntryContent::SerialNumber), 0xFEDC_BA98);
    assert_eq!(number(&node, EntryContent::Commit), 0x1234_ABCD);
    assert_eq!(number(&node, EntryContent::HasReference), 0);
    node.restore_reference_status(
        ReferenceStatus::in_force(ReferenceErrors {
            elongation: Nanometres(-5),
            ..ReferenceErrors::default()
        }),
        None,
    );
    assert_eq!(number(&node, EntryContent::HasReference), 1);
    assert_eq!(number(&node, EntryContent::ReferenceElongation).cast_signed(), -5);
}

#[test]
fn every_kind_of_frame_that_was_received_has_a_count_of_its_own() {
    let mut node = node();
    let frame = |counter| frames::encode_control(Control::REFERENCED, counter);
    let mut damaged = *frame(0).data();
    damaged[5] ^= 1;
    let damaged = Frame::from_data(CONTROL_ID, damaged);
    let short = Frame::new(CONTROL_ID, &[0; 7]).expect("7 bytes");
    // Two lost before the second; three damaged, two repeated, four too short.
    let sent = [frame(0), frame(3), damaged, damaged, damaged, frame(3), frame(3), short, short];
    for frame in sent.into_iter().chain([short, short]) {
        node.receive(Interface::Can, &frame).ok();
    }
    let counted = [
        (ReceiverCounter::Accepted, 2),
        (ReceiverCounter::Malformed, 4),
        (ReceiverCounter::Crc, 3),
        (ReceiverCounter::Sequence, 2),
        (ReceiverCounter::Lost, 2),
    ];
    for (counter, count) in counted {
        assert_eq!(number(&node, EntryContent::ReceiverCounter(counter)), count, "{counter:?}");
    }
}

#[test]
fn the_status_has_temperatures_to_the_nearest_hundredth_of_a_degree() {
    // 6 mK above 20 °C: 0.39 mΩ each.
    const THERE: RawTemperatureReading = RawTemperatureReading(107_795_838);
    let mut node = node();
    run_at(&mut node, 1_000, THERE);
    let mut reported = [None; 8];
    for _ in 0..2_000 {
        run_at(&mut node, 1, THERE);
        let status = node.next_service_frame().and_then(|frame| status::decode(&frame).ok());
        if let Some(StatusItem::Temperatures { pair, centi_c }) = status.map(|status| status.item) {
            let first = 2 * usize::from(pair);
            reported[first..first + 2].copy_from_slice(&centi_c);
        }
    }
    let mut expected = [None; 8];
    expected[2] = Some(2_001);
    assert_eq!(reported, expected);
}
