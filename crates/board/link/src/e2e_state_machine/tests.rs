//! The state machine against the standard's own words, and what it is for.

use super::*;
use crate::e2e;
use proptest::prelude::*;
use std::{collections::VecDeque, vec::Vec};

const ID: u16 = 0x201;

fn frame(counter: u8) -> Frame {
    let mut data = [0, 0, 0, 1, 2, 3, 4, 5];
    e2e::protect(ID, counter, &mut data);
    Frame::new(ID, &data).unwrap()
}

fn damaged(counter: u8) -> Frame {
    let mut data = *frame(counter).data();
    data[5] ^= 0x80;
    Frame::new(ID, &data).unwrap()
}

/// The verdicts of the standard that make a difference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ByteVerdict {
    Ok,
    Error,
    /// Repeated, or wrong sequence.
    Order,
}

/// E2E_SMCheck as PRS E2E Protocol words it: a list of verdicts, counted anew each time.
struct Standard {
    state: E2eState,
    window: VecDeque<ByteVerdict>,
}

impl Standard {
    fn check(&mut self, verdict: ByteVerdict) -> E2eState {
        self.window.push_front(verdict);
        let size = if self.state == E2eState::Invalid { 3 } else { 8 };
        self.window.truncate(8);
        let count =
            |what| self.window.iter().take(size).filter(|verdict| **verdict == what).count();
        let (ok, error) = (count(ByteVerdict::Ok), count(ByteVerdict::Error));
        let next = match self.state {
            E2eState::Initial if error > 4 => E2eState::Invalid,
            E2eState::Initial if ok >= 1 => E2eState::Valid,
            E2eState::Valid if error <= 4 && ok >= 1 => E2eState::Valid,
            // A window that is not full yet has no verdict on what is missing in it.
            E2eState::Valid if error <= 4 && self.window.len() < size => E2eState::Valid,
            E2eState::Valid => E2eState::Invalid,
            E2eState::Invalid if ok >= 3 && error == 0 => E2eState::Valid,
            same => same,
        };
        if next == E2eState::Invalid && self.state != next {
            self.window.clear();
        }
        self.state = next;
        next
    }
}

proptest! {
    #[test]
    fn it_goes_through_the_states_of_the_standard(fates in prop::collection::vec(0_u8..9, 1..400)) {
        let mut stream = E2eStateMachine::new(ID);
        let mut standard = Standard { state: E2eState::Initial, window: VecDeque::new() };
        let (mut counter, mut received, mut mode) = (0_u8, false, 0);
        for fate in fates {
            // Fates come in stretches, or no stretch of damage would ever be long enough.
            mode = match fate { 6 => 1, 7 => 2, 8 => 0, _ => mode };
            let fate = if mode == 0 || fate < 2 { fate.min(2) } else { mode - 1 };
            let (sent, verdict) = match fate {
                0 => (damaged(counter.wrapping_add(1)), ByteVerdict::Error),
                1 if received => (frame(counter), ByteVerdict::Order),
                _ => {
                    counter = counter.wrapping_add(1);
                    received = true;
                    (frame(counter), ByteVerdict::Ok)
                }
            };
            let got = stream.accept(&sent);
            let state = standard.check(verdict);
            prop_assert_eq!(stream.state(), state);
            prop_assert_eq!(got.is_ok(), verdict == ByteVerdict::Ok && state == E2eState::Valid);
        }
    }
}

#[test]
fn four_damaged_of_eight_cost_nothing_else_and_a_fifth_ends_it() {
    let mut stream = E2eStateMachine::new(ID);
    assert_eq!((stream.state(), stream.accept(&frame(0))), (E2eState::Initial, Ok(0)));
    for n in 1..=4 {
        assert!(stream.accept(&damaged(n)).is_err());
        assert_eq!(stream.state(), E2eState::Valid, "after {n}");
    }
    assert_eq!(stream.accept(&frame(5)), Ok(4), "within one frame");
    assert!(stream.accept(&damaged(6)).is_err());
    assert_eq!(stream.state(), E2eState::Invalid);
    // Three in a row, the third is used.
    for counter in [7, 8] {
        assert!(matches!(
            stream.accept(&frame(counter)),
            Err(E2eStateMachineError::Untrusted(E2eError::Crc { .. }))
        ));
    }
    assert_eq!(stream.accept(&frame(9)), Ok(0));
    assert_eq!(stream.state(), E2eState::Valid);
}

#[test]
fn noise_from_the_start_makes_the_first_whole_frame_no_good() {
    let mut stream = E2eStateMachine::new(ID);
    for n in 0..5 {
        assert_eq!(stream.state(), E2eState::Initial);
        assert!(stream.accept(&damaged(n)).is_err());
    }
    assert_eq!(stream.state(), E2eState::Invalid);
    assert!(stream.accept(&frame(0)).is_err());
}

#[test]
fn frames_too_short_to_be_checked_count_as_damaged() {
    let mut stream = E2eStateMachine::new(ID);
    assert_eq!(stream.accept(&frame(0)), Ok(0));
    (0..5).for_each(|_| stream.record_damaged_frame(E2eError::TooShort { len: 2 }));
    assert_eq!(stream.state(), E2eState::Invalid);
    let refused = stream.accept(&frame(1));
    assert_eq!(refused, Err(E2eStateMachineError::Untrusted(E2eError::TooShort { len: 2 })));
}

#[test]
fn a_sender_that_stands_still_is_not_trusted_after_a_window() {
    let mut stream = E2eStateMachine::new(ID);
    assert_eq!(stream.accept(&frame(9)), Ok(0));
    let states: Vec<_> = (0..8)
        .map(|_| {
            assert!(stream.accept(&frame(9)).is_err());
            stream.state()
        })
        .collect();
    assert_eq!(states[..7], [E2eState::Valid; 7]);
    assert_eq!(states[7], E2eState::Invalid);
}

#[test]
fn of_pure_noise_less_is_used_than_passes_the_crc() {
    // Frames of noise: a CRC of 16 bits passes about 15 of a million, the states none of them.
    let (mut stream, mut alone) = (E2eStateMachine::new(ID), E2eChecker::new(ID));
    let (mut random, mut used, mut passed) = (7_u64, 0, 0);
    for _ in 0..1_000_000 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let bytes = (random ^ random >> 29).wrapping_mul(0x9E37_79B9_7F4A_7C15).to_be_bytes();
        let noise = Frame::new(ID, &bytes).unwrap();
        used += u32::from(stream.accept(&noise).is_ok());
        let is_whole = !matches!(alone.check(&noise), Err(E2eError::Crc { .. }));
        passed += u32::from(is_whole);
    }
    assert!((5..30).contains(&passed), "{passed} of a million pass the CRC");
    assert_eq!(used, 0);
}
