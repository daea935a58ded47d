//! Every item there and back, and what has no meaning.

use super::*;
use crate::{e2e::E2eChecker, layout::E2E_COUNTER};
use proptest::prelude::*;
use std::{format, string::String, vec::Vec};

#[test]
fn the_ends_and_what_is_missing_keep_apart() {
    for (item, tail) in [
        (
            StatusItem::Temperatures { pair: 0, centi_c: [Some(i16::MAX), Some(-i16::MAX)] },
            [0x10, 0xFF, 0x7F, 0x01, 0x80],
        ),
        (StatusItem::Temperatures { pair: 3, centi_c: [None; 2] }, [0x13, 0, 0x80, 0, 0x80]),
        (StatusItem::Elongation(Some(Nanometres(-1))), [0x14, 0xFF, 0xFF, 0xFF, 0xFF]),
        (StatusItem::Elongation(None), [0x14, 0, 0, 0, 0x80]),
        (StatusItem::Refused { damaged: 1, out_of_sequence: 0xFFFF }, [0x15, 1, 0, 0xFF, 0xFF]),
        (StatusItem::Received { malformed: 0x1234, lost: 2 }, [0x16, 0x34, 0x12, 2, 0]),
        (StatusItem::Board { noise_thousandths: 1_041, faults: 1 << 13 }, [0x17, 0x11, 4, 0, 0x20]),
        (StatusItem::State(StateBits(0x8000_2001)), [0x18, 1, 0x20, 0, 0x80]),
        (
            StatusItem::Reset { reason: ResetReason::HardFault, free_stack: 0x1234 },
            [0x19, 7, 0, 0x34, 0x12],
        ),
        (StatusItem::Calibration(0xF4AC_FB13), [0x1A, 0x13, 0xFB, 0xAC, 0xF4]),
        // -12.0 µm and -27.0 µm/m: -120 = 0xFF88, -270 = 0xFEF2.
        (
            StatusItem::Slope { axis: 0, constant: Some(-120), slope: -270 },
            [0x1B, 0x88, 0xFF, 0xF2, 0xFE],
        ),
        (
            StatusItem::Slope { axis: 2, constant: None, slope: i16::MAX },
            [0x1D, 0, 0x80, 0xFF, 0x7F],
        ),
    ] {
        let status = Status { last_refused: FrameRejectReason::Malformed, item };
        let frame = encode(&status, 9);
        assert_eq!(frame.data()[3..], tail, "{item:?}");
        assert_eq!(decode(&frame), Ok(status));
    }
}

#[test]
fn an_item_or_a_reason_without_meaning_is_refused_by_name() {
    for (signal, at, from) in [("Item", STATUS_ITEM, 14), ("LastRefused", LAST_REFUSED, 5)] {
        for raw in from..16 {
            let status = Status {
                last_refused: FrameRejectReason::None,
                item: StatusItem::Elongation(None),
            };
            let mut data = *encode(&status, 0).data();
            at.insert(&mut data, raw);
            let frame = Frame::new(STATUS_ID, &data).expect("8 bytes");
            assert_eq!(decode(&frame), Err(DecodeError::Value { signal, raw }));
        }
    }
}

proptest! {
    #[test]
    fn whatever_is_read_is_written_again_and_protected(data in any::<[u8; 8]>(), counter: u8) {
        let frame = Frame::new(STATUS_ID, &data).expect("8 bytes");
        if let Ok(status) = decode(&frame) {
            let again = encode(&status, counter);
            prop_assert_eq!(&again.data()[3..], &data[3..]);
            prop_assert_eq!(E2E_COUNTER.extract(again.data()), counter.into());
            prop_assert!(E2eChecker::new(STATUS_ID).check(&again).is_ok());
        }
    }
}

#[test]
fn every_condition_of_the_state_has_a_bit_of_its_own_in_their_order() {
    assert!(StateBits::NAMES.is_sorted_by(|(a, _), (b, _)| a.0 < b.0));
    for (bit, word) in StateBits::NAMES {
        assert_eq!(bit.0.count_ones(), 1, "{word}");
        assert!(!StateBits::default().contains(bit), "{word}");
    }
}

#[test]
fn a_condition_that_holds_is_added_to_the_others_and_adding_it_again_changes_nothing() {
    let (first, second) = (StateBits::SECOND_MASTER, StateBits::SELF_TEST_FAILED);
    let both = StateBits::default().with_if(true, first).with_if(true, second);
    assert_eq!(both.with_if(true, first).with_if(false, StateBits::CAN_BUS_OFF), both);
    assert!(both.contains(first) && both.contains(second) && both.contains(both));
    assert!(!first.contains(both), "of several each has to be set");
}

#[test]
fn every_reason_of_a_start_has_its_own_number_and_word() {
    let reasons: Vec<_> = (0..).map_while(ResetReason::from_wire).collect();
    assert_eq!(reasons.len(), ResetReason::COUNT);
    for (number, reason) in reasons.iter().enumerate() {
        assert_eq!(*reason as usize, number);
        // As the variants are called: HardFault is hard-fault.
        let name = format!("{reason:?}");
        let apart = |(n, c): (usize, char)| [(n > 0 && c.is_uppercase()).then_some('-'), Some(c)];
        let words: String = name.chars().enumerate().flat_map(apart).flatten().collect();
        assert_eq!(reason.as_str(), words.to_lowercase());
    }
}
