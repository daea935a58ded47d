//! A whole update on the chip: loaded, verified, tried, confirmed, and started with a dead PLL.

use trueup_boot::flash_layout::Slot;

use crate::board::{Board, CONFIRMS, GOOD, LOADS, boot, file, first, has};

#[test]
fn an_update_is_loaded_verified_tried_and_confirmed() {
    let Some(_) = boot() else { return };
    let new = file(Slot::B, 2, 2, CONFIRMS);
    let board = Board::with(&file(Slot::A, 1, 0, LOADS), &[]).expect("it is there").offering(&new);
    let lines = board.live(3_000, "", &[]);
    let events: Vec<&str> = lines.iter().map(|(_, line)| line.as_str()).collect();
    let [a, ca, u, reset, b, cb, ..] = events[..] else { panic!("{lines:?}") };
    assert_eq!([a, ca, u, b, cb], ["A", "c", "u", "B", "c"], "{lines:?}");
    assert!(reset.starts_with("reset"), "{lines:?}");
    assert_eq!(board.slot(Slot::B)[..new.len()], new);
    // A dead PLL: the signature was recorded, so the CRC is enough.
    let lines = board.live(600, "", &["--pll-dead"]);
    let at = first(&lines, "B");
    println!("with a dead PLL and a recorded signature B speaks at {at:.0} ms");
    assert!(at < 300.0 && !has(&lines, "A"), "{lines:?}");
    // A reset of a confirmed image is no reason to go back.
    let lines = board.live(900, "400 reset watchdog\n", &[]);
    assert!(!has(&lines, "A"), "{lines:?}");
}

#[test]
#[ignore = "long: four boards on the model of the chip"]
fn below_the_floor_of_a_confirmed_image_nothing_starts() {
    let Some(_) = boot() else { return };
    for (floor, starts) in [(2, true), (3, false)] {
        let [a, b] = [file(Slot::A, 3, floor, CONFIRMS), file(Slot::B, 2, 0, GOOD)];
        let board = Board::with(&a, &b).expect("it is there");
        let lines = board.live(300, "", &[]);
        assert!(has(&lines, "c"), "{lines:?}");
        // The newer one is lost.
        board.change(|flash| flash[0x1_0100..0x1_0200].fill(0));
        let lines = board.live(1_000, "", &[]);
        assert_eq!(has(&lines, "B"), starts, "floor {floor}: {lines:?}");
    }
}

#[test]
#[ignore = "long: seven starts on the model of the chip"]
fn a_trial_has_five_power_cycles() {
    let Some(_) = boot() else { return };
    let [a, b] = [file(Slot::A, 1, 0, CONFIRMS), file(Slot::B, 2, 0, GOOD)];
    let board = Board::with(&a, &b).expect("it is there");
    for number in 1..=7 {
        let lines = board.live(250, "", &[]);
        let expected = if number <= 5 { "B" } else { "A" };
        assert!(has(&lines, expected), "start {number}: {lines:?}");
    }
}
