//! What a master reads of a board: the sensor, the thermometers, the noise, the names, the time.

mod sensor_bridge;

use sensor_bridge::calibration;
use trueup_canopen::{
    dictionary::{ELONGATION_INPUT, NOT_AVAILABLE, ObjectKind},
    sdo::{Abort, ObjectValue, Objects},
};
use trueup_core::{
    bridge::Input, cnc::Control, dimensions::CODES_PER_TICK, supply::Level, thermometer::Raw,
    units::Code,
};
use trueup_link::frames;
use trueup_node::node::{Line, Node};

fn node() -> Node<'static> {
    Node::new(Some(calibration()), false)
}

/// Milliseconds in which the sensor reads 700.5 codes, one up and one down, and the PT100 20 °C.
fn run(node: &mut Node<'_>, ms: u32) {
    let codes: [Code; CODES_PER_TICK] =
        core::array::from_fn(|n| Code(if n % 2 == 0 { 700 } else { 701 }));
    let mut temperatures = [Raw::NONE; 8];
    temperatures[2] = Raw(107_793_500);
    for _ in 0..ms {
        let temperatures = Some(&temperatures);
        node.tick(1, Input { codes: Some(&codes), speed: None, temperatures });
    }
}

fn number(node: &Node<'_>, what: ObjectKind) -> u32 {
    match node.read(what) {
        Ok(ObjectValue::Number(number)) => number,
        other => panic!("{what:?}: {other:?}"),
    }
}

#[test]
fn each_input_is_read_at_its_place_and_what_is_not_there_is_said_to_be_missing() {
    let elongation = ELONGATION_INPUT - 1;
    let mut node = node();
    for is_running in [false, true] {
        for input in 0..ELONGATION_INPUT {
            let value = number(&node, ObjectKind::Input(input)).cast_signed();
            let is_missing = number(&node, ObjectKind::InputStatus(input)) != 0;
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
fn the_noise_is_told_in_thousandths_of_a_code_once_the_board_has_taken_it() {
    let mut node = node();
    run(&mut node, 100);
    assert_eq!(number(&node, ObjectKind::Noise), 0);
    let noise = node.take_noise();
    assert_eq!(noise.squares, 4 * noise.count, "second differences of 2 codes");
    // √(4/6)
    assert_eq!(number(&node, ObjectKind::Noise), 816);
}

#[test]
fn the_names_of_the_machine_are_read_and_without_a_calibration_there_are_none() {
    let (named, none) = (node(), Node::new(None, false));
    let texts = [(ObjectKind::MachineName, "gantry"), (ObjectKind::MachineSerial, "17/4")];
    for (what, text) in texts {
        assert_eq!(named.read(what), Ok(ObjectValue::Bytes(text.as_bytes())));
        assert_eq!(none.read(what), Err(Abort::NoData));
    }
}

#[test]
fn blocks_are_counted_and_a_tick_without_one_is_not() {
    let mut node = node();
    assert_eq!(node.blocks(), 0);
    run(&mut node, 5);
    node.tick(1, Input::default());
    assert_eq!(node.blocks(), 5);
}

#[test]
fn the_level_that_readings_count_from_is_the_stored_one_or_that_of_the_first_seconds() {
    let mut node = node();
    assert_eq!(node.supply_basis(), Level(0), "not known yet");
    (0..200).for_each(|_| node.hear_supply(Code(1_500)));
    assert_eq!(node.supply_basis(), Level(1_500 * 16));
    node.set_supply_basis(Level(24_321));
    (0..200).for_each(|_| node.hear_supply(Code(1_500)));
    assert_eq!(node.supply_basis(), Level(24_321));
}

#[test]
fn a_time_that_was_told_goes_on_and_one_of_0_is_none() {
    let mut node = node();
    let control = Control { service: true, ..Control::REFERENCED };
    for counter in 0..5 {
        node.hear(Line::Can, &frames::control(control, counter)).expect("in order");
        run(&mut node, 20);
        node.service();
    }
    for (told, after_3_s) in [(1_790_000_000, 1_790_000_003), (0, 0)] {
        node.write(ObjectKind::Utc, told).expect("allowed");
        run(&mut node, 3_000);
        assert_eq!(number(&node, ObjectKind::Utc), after_3_s);
    }
}
