//! Damage of frames by a serial line: bits that flip, bytes and frames that are lost, doubled, inserted
//! or swapped. Nothing may be believed that was not sent, and one frame later all is well again.
//!
//! SLCAN has no check of its own, so the frames' protection is all there is; these are the frames of a CNC
//! and of a board as lines.

// A test may count as it likes: what overflows panics.
#![allow(clippy::arithmetic_side_effects, clippy::cast_possible_truncation, clippy::cast_sign_loss)]

use std::thread;

use trueup_core::{
    cnc::{
        AxisPosition, CncMessage, Control, LinearAxis, OffsetQuality, Output, RotaryAxisAngles,
        SpindleState, TravelDirection,
    },
    units::{MicroDegrees, Nanometres, Position, Rpm},
};
use trueup_link::{
    frame::Frame,
    frames,
    layout::{OFFSET_XY_ID, OFFSET_Z_ID, STATUS_ID},
    receiver::{CncReceiver, OffsetReceiver, StatusReceiver},
    slcan::{LineSplitter, decode_line, encode_line},
    status::{self, FrameRejectReason, Status, StatusItem},
};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
    test_vectors::XorShift32,
};

/// Lines that are damaged in every way.
const LINES: usize = 40;
/// Each has 21 characters and its end.
const LENGTH: usize = 22;

/// Returns what a CNC sends, frame by frame, each identifier with its own counter.
fn commands(count: usize) -> Vec<Frame> {
    let mut random = XorShift32::new(7);
    let mut counters = [250_u8; 6];
    (0..count)
        .map(|n| {
            let kind = n % 6;
            let counter = counters[kind];
            counters[kind] = counter.wrapping_add(1);
            let any = random.next_u32() as i32;
            match kind {
                axis @ 0..=2 => {
                    let position = Position(any / 2);
                    let (axis, direction) = (LinearAxis::ALL[axis], TravelDirection::Positive);
                    frames::encode_position(AxisPosition { axis, position, direction }, counter)
                }
                3 => frames::encode_rotary(
                    RotaryAxisAngles { angles: [any / 16, -any / 16].map(MicroDegrees) },
                    counter,
                ),
                4 => frames::encode_spindle(
                    SpindleState { speed: Rpm(any as u16), load_n: 120 },
                    counter,
                ),
                _ => frames::encode_control(Control::ENGAGED, counter),
            }
        })
        .collect()
}

/// Thirty lines of a CNC and ten of a board.
fn lines_of_both() -> Vec<Frame> {
    let mut all = commands(LINES - 10);
    for counter in 0..5 {
        let nm = 20_000 + 777 * i32::from(counter);
        let offset = Some([nm, -nm / 3, nm * 5].map(Nanometres));
        let output = Output { offset, quality: OffsetQuality::Live, ..Output::default() };
        if counter < 4 {
            all.push(frames::encode_offset_xy(&output, counter));
            all.push(frames::encode_offset_z(&output, counter));
        } else {
            for (counter, nm) in [(0, nm), (1, -nm)] {
                let item = StatusItem::Elongation(Some(Nanometres(nm)));
                let reported = Status { last_refused: FrameRejectReason::None, item };
                all.push(status::encode(&reported, counter));
            }
        }
    }
    all
}

fn line(frame: &Frame) -> [u8; LENGTH] {
    encode_line(frame).as_bytes().try_into().expect("8 bytes of data")
}

/// The frames in these bytes.
fn frames_in(bytes: &[u8], mut each: impl FnMut(Frame)) {
    let mut lines = LineSplitter::new();
    for byte in bytes {
        if let Some(Ok(line)) = lines.push(*byte)
            && let Ok(frame) = decode_line(line)
        {
            each(frame);
        }
    }
}

/// The ears on both ends of a line.
#[derive(Clone)]
struct Ears {
    board: CncReceiver,
    offsets: OffsetReceiver,
    status: StatusReceiver,
}

impl Ears {
    /// They have received these.
    fn after(sent: &[Frame]) -> Self {
        let mut ears = Self {
            board: CncReceiver::new(),
            offsets: OffsetReceiver::new(),
            status: StatusReceiver::new(),
        };
        assert!(sent.iter().all(|frame| ears.accept(frame)), "they were sent so");
        ears
    }

    fn know(id: u16) -> bool {
        CncReceiver::is_cnc_frame_id(id) || [OFFSET_XY_ID, OFFSET_Z_ID, STATUS_ID].contains(&id)
    }

    /// Returns whether this is believed.
    fn accept(&mut self, frame: &Frame) -> bool {
        match frame.id() {
            OFFSET_XY_ID | OFFSET_Z_ID => self.offsets.accept(frame).is_ok(),
            STATUS_ID => self.status.accept(frame).is_ok(),
            _ => matches!(self.board.accept(frame), Ok(Some(_))),
        }
    }
}

/// Results of the damaged forms of a line.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    forms: u64,
    /// Hexadecimal digits that became lower case: the same frame.
    same: u64,
    /// Frames of another service than the CNC's cyclic ones, which have no protection.
    elsewhere: u64,
}

struct Damage<'a> {
    original: Frame,
    ears: Ears,
    node: &'a mut Node<'static>,
    outcome: Outcome,
}

impl Damage<'_> {
    /// The board receives these bytes in place of the line.
    fn receive(&mut self, bytes: &[u8]) {
        self.outcome.forms += 1;
        frames_in(bytes, |frame| {
            let is_received = self.ears.clone().accept(&frame);
            if is_received && frame == self.original {
                self.outcome.same += 1;
            } else if is_received {
                panic!("{:?} is taken for {frame:?}: {}", self.original, bytes.escape_ascii());
            } else if !Ears::know(frame.id()) {
                // SDO, network management, heartbeats: the node must not change by it.
                self.outcome.elsewhere += 1;
                let _ = self.node.receive(Interface::Serial, &frame);
            }
        });
    }
}

/// All flips of one, two and three bits of a line.
fn flip_all(frame: &Frame, mut receive: impl FnMut(&[u8; LENGTH])) {
    let mut bytes = line(frame);
    let bits = LENGTH * 8;
    let flip = |bytes: &mut [u8; LENGTH], bit: usize| bytes[bit / 8] ^= 1 << (bit % 8);
    for a in 0..bits {
        flip(&mut bytes, a);
        receive(&bytes);
        for b in a + 1..bits {
            flip(&mut bytes, b);
            receive(&bytes);
            for c in b + 1..bits {
                flip(&mut bytes, c);
                receive(&bytes);
                flip(&mut bytes, c);
            }
            flip(&mut bytes, b);
        }
        flip(&mut bytes, a);
    }
}

/// Returns the state of a node that a frame without protection could change.
fn settings(node: &Node<'_>) -> String {
    format!("{:?} {:?}", node.reference(), node.last_output())
}

fn flipped(numbers: impl Iterator<Item = usize>) -> Outcome {
    let all = lines_of_both();
    let mut total = Outcome::default();
    for number in numbers {
        let mut node = Node::new(NodeConfiguration::default());
        let before = settings(&node);
        let original = all[number];
        let ears = Ears::after(&all[..number]);
        let mut damage = Damage { original, ears, node: &mut node, outcome: Outcome::default() };
        flip_all(&original, |bytes| damage.receive(bytes));
        let outcome = damage.outcome;
        assert_eq!(settings(&node), before, "line {number}");
        total.forms += outcome.forms;
        total.same += outcome.same;
        total.elsewhere += outcome.elsewhere;
    }
    total
}

#[test]
fn no_one_to_three_flipped_bits_of_a_line_make_another_command() {
    println!("{:?}", flipped([5].into_iter()));
}

#[test]
#[ignore = "long: 36 million damaged lines"]
fn no_one_to_three_flipped_bits_of_forty_lines_make_another_command() {
    let halves: Vec<Outcome> = thread::scope(|scope| {
        let halves = [0, 1].map(|half| scope.spawn(move || flipped((half..LINES).step_by(2))));
        halves.into_iter().map(|half| half.join().expect("it says what is wrong")).collect()
    });
    let sum = |of: fn(&Outcome) -> u64| halves.iter().map(of).sum::<u64>();
    println!(
        "{} damaged forms of {LINES} lines: none is taken for another command; {} are the same frame in \
         another case, {} have an identifier without protection",
        sum(|outcome| outcome.forms),
        sum(|outcome| outcome.same),
        sum(|outcome| outcome.elsewhere),
    );
    assert_eq!(sum(|outcome| outcome.forms), 40 * (176 + 176 * 175 / 2 + 176 * 175 * 174 / 6));
}

/// The line is followed by others: which of the frames are received.
fn receive_all(receiver: &mut CncReceiver, bytes: &[u8]) -> Vec<(Frame, CncMessage)> {
    let mut received = Vec::new();
    frames_in(bytes, |frame| {
        if let Ok(Some(command)) = receiver.accept(&frame) {
            received.push((frame, command));
        }
    });
    received
}

#[test]
fn a_byte_lost_doubled_inserted_or_swapped_costs_at_most_two_frames_and_makes_none() {
    // Three lines of each identifier before, one that is damaged, and those after it.
    let all = commands(36);
    let mut forms = 0;
    for number in 18..24 {
        let before = Ears::after(&all[..number]).board;
        let whole: Vec<u8> = all[number..].iter().flat_map(line).collect();
        let mut judge = |bytes: &[u8], at: usize| {
            forms += 1;
            let got = receive_all(&mut before.clone(), bytes);
            for (frame, _) in &got {
                assert!(all[number..].contains(frame), "{frame:?} was never sent");
            }
            // Where the end of the line is hit the next one goes with it; from then on all are received.
            let lost = if at + 1 >= LENGTH { 2 } else { 1 };
            let rest = &all[number + lost..];
            let tail: Vec<Frame> =
                got.iter().rev().take(rest.len()).rev().map(|received| received.0).collect();
            assert_eq!(tail, rest, "byte {at} of {}", bytes[..2 * LENGTH].escape_ascii());
        };
        for at in 0..LENGTH {
            let mut lost = whole.clone();
            lost.remove(at);
            judge(&lost, at);
            let mut swapped = whole.clone();
            swapped.swap(at, at + 1);
            judge(&swapped, at + 1);
            // The same byte once more is among these.
            for byte in 0..=u8::MAX {
                let mut inserted = whole.clone();
                inserted.insert(at, byte);
                judge(&inserted, at);
                inserted.remove(at);
                inserted[at] = byte;
                judge(&inserted, at);
            }
        }
    }
    println!("{forms} damaged streams");
}

#[test]
fn frames_lost_doubled_inserted_or_swapped_are_received_once_in_their_order() {
    let all = commands(600);
    let foreign = frames::encode_control(Control::ENGAGED, 99);
    for seed in 1..200 {
        let mut random = XorShift32::new(seed);
        let mut stream: Vec<Frame> = Vec::new();
        for pair in all.chunks(2) {
            match random.next_below(20) {
                0 => stream.push(pair[0]),
                1 => stream.extend([pair[0], pair[0], pair[1], pair[1]]),
                2 => stream.extend([pair[0], foreign, pair[1]]),
                3 => stream.extend([pair[1], pair[0]]),
                _ => stream.extend(pair),
            }
        }
        let bytes: Vec<u8> = stream.iter().flat_map(line).collect();
        let got = receive_all(&mut CncReceiver::new(), &bytes);
        let own: Vec<&Frame> = got
            .iter()
            .map(|received| &received.0)
            .filter(|received| **received != foreign)
            .collect();
        assert!(own.len() > 400, "seed {seed}: {} heard", own.len());
        for id in [0x201, 0x301, 0x401, 0x501, 0x202, 0x302] {
            let places: Vec<usize> = own
                .iter()
                .filter(|frame| frame.id() == id)
                .map(|frame| {
                    all.iter().position(|candidate| candidate == *frame).expect("it was sent")
                })
                .collect();
            assert!(places.is_sorted_by(|a, b| a < b), "seed {seed}, {id:#x}: {places:?}");
        }
    }
}
