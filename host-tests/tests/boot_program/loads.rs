//! The application is given a new image frame by frame over CAN, and refuses it; `chip_clients update` has the one that it takes.

use trueup_boot::{header::HEADER_SIZE, layout::Slot, refusal::Refusal};

use crate::{
    application::application,
    board::{Board, boot, foreign},
    sdo_script::{download, questions},
};

const HEADER: (u16, u8) = (0x2120, 1);
const IMAGE: (u16, u8) = (0x2120, 2);
const RECEIVED: (u16, u8) = (0x2120, 3);
const REFUSED: (u16, u8) = (0x2120, 5);
/// The board is up, and has heard `Service`.
const BEGIN_MS: f64 = 500.0;
/// An erase of two sectors of 128 KB: the model takes the data sheet's longest times.
const ERASE_MS: f64 = 4_300.0;

/// Returns the frames of an update, and when the last one is sent.
fn update(file: &[u8]) -> (String, f64) {
    let (header, image) = file.split_at(HEADER_SIZE);
    let (header, sent) = download(HEADER, header, BEGIN_MS);
    let (image, end) = download(IMAGE, image, sent + ERASE_MS);
    (format!("0 flags 10\n{header}{image}"), end)
}

/// Returns the last answer about an object.
fn answer(events: &[String], (index, subindex): (u16, u8)) -> Option<u32> {
    let [low, high] = index.to_le_bytes();
    events.iter().rev().find_map(|event| {
        let hex = event.split_once(" can 581 ")?.1;
        let byte = |at: usize| u8::from_str_radix(hex.get(2 * at..2 * at + 2)?, 16).ok();
        let is_it =
            [byte(1)?, byte(2)?, byte(3)?] == [low, high, subindex] && byte(0)? & 0xE0 == 0x40;
        let number = [byte(4)?, byte(5)?, byte(6)?, byte(7)?];
        is_it.then(|| u32::from_le_bytes(number))
    })
}

#[test]
#[ignore = "long: the application on the model of the chip"]
fn the_application_refuses_an_image_of_a_stranger_and_goes_on() {
    let Some(_) = boot() else { return };
    let board = Board::with(&application(Slot::A, 1), &[]).expect("it is there");
    let (frames, end) = update(&foreign(Slot::B, 2));
    let ask = end + 400.0;
    let script =
        format!("{frames}{}{} reset pin\n", questions(&[REFUSED, RECEIVED], ask), ask + 50.0);
    let report = board.report((ask + 800.0) as u32, &script, &[]);
    let told = [REFUSED, RECEIVED].map(|at| answer(&report.events, at));
    let refusal = Refusal::Signature.number().into();
    assert_eq!(told, [Some(refusal), Some(0)], "{}", report.said);
    let offsets = report.events.iter().filter(|event| event.contains(" can 281 ")).count();
    assert!(offsets > 1_000, "it sends on, after the reset as well: {offsets}");
}
