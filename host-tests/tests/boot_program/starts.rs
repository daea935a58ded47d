//! Which slot starts, after how long, with good and bad images in them.

use std::{fs, thread};

use object::{Object as _, ObjectSymbol as _};
use trueup_boot::flash_layout::{SLOT_SIZE, Slot};
use trueup_emulator::flash_image;

use crate::board::{
    ANSWER_MS, Board, GOOD, HANGS, RESETS, SPEAKS_AND_HANGS, boot, file, file_of, first, foreign,
    has,
};

/// Limits of the watchdog's oscillator (data sheet, LSI oscillator characteristics), in Hz.
const LSI: [&str; 3] = ["17000", "32000", "47000"];

#[test]
fn a_start_is_at_most_150_ms_longer_with_the_largest_image() {
    let sizes = [32 * 1024, 112 * 1024, SLOT_SIZE as usize];
    thread::scope(|scope| {
        for size in sizes {
            scope.spawn(move || {
                let Some(_) = boot() else { return };
                let board = Board::with(&file_of(size, Slot::A, 1), &[]).expect("it is there");
                let at = first(&board.live(250, "", &[]), "A");
                println!("an image of {} KB speaks {at:.1} ms after power-on", size / 1024);
                assert!(at <= 150.0, "{at} ms");
            });
        }
    });
}

#[test]
fn the_boot_program_fits_its_sectors_and_no_panic_can_be_reached() {
    let Some(boot) = boot() else { return };
    let bytes = flash_image::read_flash_image(boot).expect("an image").len();
    println!("the boot program has {bytes} bytes");
    assert!(bytes <= 32 * 1024);
    // The linker leaves out what nothing refers to, so no call through a register hides one.
    let image = fs::read(boot).expect("it was just built");
    let file = object::File::parse(&*image).expect("an image");
    let names: Vec<&str> = file.symbols().filter_map(|symbol| symbol.name().ok()).collect();
    assert!(names.iter().any(|name| name.contains("compress")), "its symbols are there");
    let panics: Vec<_> = names.iter().filter(|name| name.contains("panic")).collect();
    assert!(panics.is_empty(), "{panics:?}");
}

#[test]
fn of_two_good_images_the_newer_one_speaks() {
    let Some(_) = boot() else { return };
    for (a, b, name) in [(1, 2, "B"), (2, 1, "A")] {
        let [a, b] = [file(Slot::A, a, 0, GOOD), file(Slot::B, b, 0, GOOD)];
        let lines = Board::with(&a, &b).expect("it is there").live(300, "", &[]);
        assert!(lines.iter().all(|(_, stdout)| stdout == name), "{name}: {lines:?}");
        assert!(has(&lines, name));
    }
}

#[test]
#[ignore = "long: nine boards of more than two seconds on the model of the chip"]
fn a_new_image_that_hangs_or_resets_gives_way_within_two_seconds_on_any_watchdog() {
    let Some(_) = boot() else { return };
    thread::scope(|scope| {
        for behaviour in [HANGS, RESETS, SPEAKS_AND_HANGS] {
            for lsi in LSI {
                scope.spawn(move || {
                    let [a, b] = [file(Slot::A, 1, 0, GOOD), file(Slot::B, 2, 0, behaviour)];
                    let board = Board::with(&a, &b).expect("it is there");
                    let lines = board.live(2_300, "", &["--lsi", lsi]);
                    let at = first(&lines, "A");
                    println!("behaviour {behaviour}, LSI {lsi} Hz: A speaks at {at:.0} ms");
                    assert!(at <= ANSWER_MS, "{at} ms, {lines:?}");
                    assert_eq!(
                        lines.iter().filter(|(_, line)| line.starts_with("reset")).count(),
                        1
                    );
                    // It stays with it after a power cycle.
                    let lines = board.live(300, "", &["--lsi", lsi]);
                    assert!(has(&lines, "A") && !has(&lines, "B"), "{lines:?}");
                });
            }
        }
    });
}

#[test]
#[ignore = "long: six boards on the model of the chip"]
fn foreign_swapped_cut_and_damaged_files_are_passed_over() {
    let Some(_) = boot() else { return };
    let good = file(Slot::B, 2, 0, GOOD);
    let mut damaged = good.clone();
    *damaged.last_mut().expect("bytes") ^= 1;
    let mut header = good.clone();
    header[91] ^= 1;
    let files = [
        ("foreign", foreign(Slot::B, 2)),
        ("swapped", file(Slot::A, 2, 0, GOOD)),
        ("cut", good[..good.len() / 2].to_vec()),
        ("cut in its header", good[..300].to_vec()),
        ("damaged", damaged),
        ("damaged in its header", header),
    ];
    thread::scope(|scope| {
        for (name, file_b) in files {
            scope.spawn(move || {
                let a = file(Slot::A, 1, 0, GOOD);
                let board = Board::with(&a, &file_b).expect("it is there");
                let lines = board.live(400, "", &[]);
                let at = first(&lines, "A");
                println!("{name}: A speaks at {at:.0} ms");
                assert!(!has(&lines, "B"), "{name}: {lines:?}");
            });
        }
    });
}

#[test]
#[ignore = "long: four seconds on the model of the chip"]
fn with_a_dead_pll_an_image_of_a_probe_is_verified_slowly_and_starts() {
    let Some(_) = boot() else { return };
    let board = Board::with(&file_of(112 * 1024, Slot::A, 1), &[]).expect("it is there");
    let at = first(&board.live(2_200, "", &["--pll-dead"]), "A");
    println!("an image of 112 KB, verified on 16 MHz, speaks at {at:.0} ms");
    assert!(at <= ANSWER_MS);
    let board = Board::with(&foreign(Slot::A, 1), &[]).expect("it is there");
    assert!(!has(&board.live(2_200, "", &["--pll-dead"]), "A"), "not even then a foreign one");
}

#[test]
#[ignore = "long: three seconds on the model of the chip"]
fn without_an_image_it_looks_again_and_again() {
    let Some(_) = boot() else { return };
    let lines = Board::with(&[], &[]).expect("it is there").live(3_000, "", &[]);
    assert!(
        lines.len() >= 2 && lines.iter().all(|(_, line)| line.starts_with("reset")),
        "{lines:?}"
    );
}
