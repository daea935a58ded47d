//! The port before a program that speaks SLCAN.

use super::*;
use crate::slcan::{MAX_FRAME_LINE_LEN, encode_line};
use proptest::prelude::*;
use std::{vec, vec::Vec};

fn drain(port: &mut Port) -> Vec<u8> {
    core::iter::from_fn(|| port.pop()).collect()
}

/// Sends text to the port; the frames for the board, and everything that the client reads.
fn talk(port: &mut Port, text: &[u8]) -> (Vec<Frame>, Vec<u8>) {
    let frames = text.iter().filter_map(|byte| port.receive(*byte)).collect();
    (frames, drain(port))
}

fn opened() -> Port {
    let mut port = Port::new(0xA001);
    assert_eq!(talk(&mut port, b"O\r").1, b"\r");
    port
}

fn frame(len: usize) -> Frame {
    Frame::new(0x181, &[0xAB; 8][..len]).unwrap()
}

#[test]
fn python_can_opens_sends_and_leaves() {
    let mut port = Port::new(1);
    // It sets the bit rate between a close and an open, sends an empty line for the data bit
    // rate that it has not, and opens once more.
    let (frames, answers) = talk(&mut port, b"C\rS8\r\rO\rO\r");
    assert_eq!((frames.len(), &answers[..]), (0, &b"\r\r\r\r\r"[..]));
    assert!(port.is_open());
    let (frames, answers) = talk(&mut port, b"t3028B4E6090300000000\rV\rN\r");
    assert_eq!(frames[0].id(), 0x302);
    assert_eq!(frames[0].payload(), [0xB4, 0xE6, 9, 3, 0, 0, 0, 0]);
    assert_eq!(answers, b"\rV1013\rN0001\r");
    talk(&mut port, b"C\r");
    assert!(!port.is_open());
    assert_eq!(port.counters(), PortCounters::default());
}

#[test]
fn slcand_opens_after_a_line_left_over_by_another_client() {
    let mut port = Port::new(1);
    let (frames, answers) = talk(&mut port, b"t30C\rS6\rF\rO\r");
    assert_eq!((frames.len(), &answers[..]), (0, &b"\x07\rF00\r\r"[..]));
    assert!(port.is_open());
}

#[test]
fn commands_without_effect_are_answered_and_change_nothing() {
    for line in [
        "",
        "S0",
        "S1",
        "S2",
        "S3",
        "S4",
        "S5",
        "S6",
        "S7",
        "S8",
        "Z0",
        "M00000000",
        "mFFFFFFFF",
        "s031C",
        "s0",
        "s00AB12",
        "O",
        "T000001818AABBCCDDEEFF0011",
        "T1FFFFFFF0",
        "r1810",
        "r7FF8",
        "R1FFFFFFF8",
    ] {
        let mut port = opened();
        let text = [line.as_bytes(), b"\r"].concat();
        assert_eq!(talk(&mut port, &text), (Vec::new(), b"\r".to_vec()), "{line}");
        assert!(port.is_open());
        assert_eq!(port.counters(), PortCounters::default());
    }
}

#[test]
fn every_malformed_line_is_answered_by_one_bell_and_counted() {
    for line in [
        "t",
        "t1",
        "t181",
        "t1811",
        "t1811A",
        "t1811AABB",
        "t18119G",
        "t1819",
        "t8000",
        "tFFF0",
        "t18190011223344556677",
        "t 810",
        "O1",
        "C0",
        "L ",
        "V1",
        "N1",
        "F0",
        "S",
        "S9",
        "SA",
        "S88",
        "Z",
        "Z1",
        "Z00",
        "M",
        "M0000000",
        "M000000000",
        "m0000000G",
        "s",
        "sG",
        "s0G",
        "T1810",
        "T200000000",
        "T000001811",
        "r1819",
        "r18",
        "r18100",
        "r8000",
        "R1810",
        "R200000000",
        "x",
        "o",
        "0",
        "\u{7}",
        "X1",
        "oooooooooooooooooooooooooooooooooooooooo",
    ] {
        let mut port = opened();
        let text = [line.as_bytes(), b"\r"].concat();
        assert_eq!(talk(&mut port, &text), (Vec::new(), [BELL].to_vec()), "{line}");
        assert_eq!(port.counters().malformed, 1, "{line}");
        assert!(port.last_error().is_some() && port.is_open());
        assert_eq!(talk(&mut port, b"t7010\r").0.len(), 1, "the line after {line}");
    }
}

#[test]
fn a_closed_channel_takes_and_gives_no_frame() {
    let mut port = Port::new(1);
    for line in [&b"t3020\r"[..], b"T000003020\r", b"r3020\r", b"R000003020\r"] {
        assert_eq!(talk(&mut port, line), (Vec::new(), [BELL].to_vec()));
        assert_eq!(port.last_error(), Some(SlcanError::NotOpen(line[0])));
    }
    assert!(!port.send(&frame(8)));
    assert_eq!(port.pop(), None);
    assert_eq!(port.counters().dropped, 0);
}

#[test]
fn a_client_that_only_listens_receives_frames_but_sends_none() {
    let mut port = Port::new(1);
    talk(&mut port, b"L\r");
    assert!(port.is_open() && port.send(&frame(0)));
    assert_eq!(drain(&mut port), b"t1810\r");
    assert_eq!(talk(&mut port, b"t3020\r"), (Vec::new(), [BELL].to_vec()));
}

#[test]
fn line_feeds_are_passed_over() {
    let mut port = Port::new(1);
    let (frames, answers) = talk(&mut port, b"O\r\n\nt30\n20\r\n");
    assert_eq!((frames.len(), &answers[..]), (1, &b"\r\r"[..]));
}

#[test]
fn frames_that_find_no_room_are_dropped_whole_and_answers_still_fit() {
    let mut port = opened();
    let pair = [frame(8), frame(8)];
    let mut queued = 0;
    while port.send_all(&pair) {
        queued += 1;
    }
    assert_eq!(queued, 5, "milliseconds of traffic");
    assert_eq!(port.counters().dropped, 2);
    for byte in b"V\r" {
        port.receive(*byte);
    }
    let expected = [&b"t1818ABABABABABABABAB\r".repeat(10)[..], b"V1013\r"].concat();
    assert_eq!(drain(&mut port), expected);
    assert!(port.send(&frame(8)), "there is room again");
}

#[test]
fn answers_that_find_no_room_are_dropped_whole_and_counted() {
    let mut port = opened();
    for _ in 0..100 {
        port.receive(b'V');
        port.receive(CR);
    }
    let fitting = TX_CAPACITY_BYTES / VERSION_REPLY.len();
    assert_eq!(drain(&mut port), VERSION_REPLY.repeat(fitting));
    assert_eq!(port.counters().dropped, 100 - u32::try_from(fitting).unwrap());
}

#[test]
fn the_longest_line_of_a_standard_frame_is_as_stated() {
    assert_eq!(encode_line(&frame(8)).len(), MAX_FRAME_LINE_LEN);
}

proptest! {
    #[test]
    fn no_bytes_panic_and_every_line_gets_exactly_one_answer(
        bytes in prop::collection::vec(
            prop_oneof![any::<u8>(), prop::sample::select(&b"\r\rtTrRSOCZMs0123478AF"[..])],
            0..400,
        ),
    ) {
        let mut port = Port::new(1);
        let mut refused = 0;
        for byte in bytes {
            let frame = port.receive(byte);
            let answer = drain(&mut port);
            let ends = answer.iter().filter(|byte| [CR, BELL].contains(byte)).count();
            prop_assert_eq!(ends, usize::from(byte == CR));
            refused += u32::from(answer == [BELL]);
            prop_assert_eq!(port.counters().malformed, refused);
            prop_assert!(frame.is_none() || answer == [CR]);
        }
        prop_assert_eq!(port.counters().dropped, 0);
    }

    #[test]
    fn a_frame_goes_through_the_port_both_ways(
        id in 0_u16..0x800, payload in prop::collection::vec(any::<u8>(), 0..=8),
    ) {
        let sent = Frame::new(id, &payload).unwrap();
        let mut port = opened();
        prop_assert!(port.send(&sent));
        let line = drain(&mut port);
        prop_assert_eq!(talk(&mut port, &line).0, [sent]);
    }
}

#[test]
fn pieces_of_any_size_are_the_same_bytes_in_their_order() {
    let frames: Vec<Frame> = (0..8).map(frame).collect();
    let lines: Vec<u8> = frames.iter().flat_map(|frame| encode_line(frame).into_bytes()).collect();
    for size in 1..=lines.len() + 1 {
        let mut port = opened();
        assert!(port.send_all(&frames));
        let (mut received, mut piece) = (Vec::new(), vec![0; size]);
        loop {
            let count = port.drain_into(&mut piece);
            received.extend_from_slice(&piece[..count]);
            if count < size {
                break;
            }
        }
        assert_eq!(received, lines, "pieces of {size}");
    }
}

#[test]
fn frames_may_take_all_but_the_room_for_answers_to_the_last_byte() {
    let all_but_answers = TX_CAPACITY_BYTES - REPLY_RESERVE_BYTES;
    let mut frames = vec![frame(8); 9];
    frames.extend([frame(7), frame(0)]);
    let bytes: usize = frames.iter().map(frame_line_length).sum();
    assert_eq!(bytes, all_but_answers);
    let mut port = opened();
    assert!(port.send_all(&frames));
    assert!(!port.send(&frame(0)));
    assert_eq!((port.counters().dropped, drain(&mut port).len()), (1, all_but_answers));
}

#[test]
fn a_closed_port_takes_no_frame_more_and_what_waits_still_goes_out() {
    let mut port = opened();
    assert!(port.send(&frame(1)));
    port.close();
    assert!(!port.is_open() && !port.send(&frame(1)));
    assert_eq!(drain(&mut port), b"t1811AB\r");
}

#[test]
fn the_serial_number_is_reported_in_four_digits_the_highest_first() {
    let mut port = Port::new(0x1A2F);
    assert_eq!(talk(&mut port, b"N\r").1, b"N1A2F\r");
}

#[test]
fn an_answer_may_take_the_last_byte_of_the_room() {
    let mut port = opened();
    for byte in b"\r".repeat(TX_CAPACITY_BYTES + 1) {
        port.receive(byte);
    }
    assert_eq!((port.counters().dropped, drain(&mut port).len()), (1, TX_CAPACITY_BYTES));
}
