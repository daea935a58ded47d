//! The application is given a new image frame by frame over CAN: a stranger's, which it refuses, and its maker's.
//! `chip_clients update` has the serial line.

use trueup_boot::{
    flash_layout::Slot, image_header::HEADER_SIZE, reject_reason::FirmwareRejectReason,
};
use trueup_canopen::sdo::{
    SEGMENTS_PER_BLOCK,
    client::{BlockDownload, TransferProgress},
};
use trueup_link::frame::Frame;

use crate::{
    application::application,
    board::{Board, boot, foreign},
    sdo_script::{download, questions},
};

const HEADER: (u16, u8) = (0x2120, 1);
const IMAGE: (u16, u8) = (0x2120, 2);
const RECEIVED: (u16, u8) = (0x2120, 3);
const REFUSED: (u16, u8) = (0x2120, 5);
const RUNNING: (u16, u8) = (0x2121, 1);
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

/// From one segment of a block to the next: a frame of 8 bytes takes up to 0.135 ms, and the bus has other ones.
const SEGMENT_MS: f64 = 0.25;
/// A block that was sent is answered by then: its bytes are in the flash.
const BLOCK_MS: f64 = 6.0;

/// Returns the frames of a block download of the image, and when the last one is sent.
fn download_in_blocks(image: &[u8], from_ms: f64) -> (String, f64) {
    let (mut script, mut at) = (String::new(), from_ms);
    let mut send = |frame: &Frame, at: f64| {
        let hex: String = frame.data().iter().map(|byte| format!("{byte:02x}")).collect();
        script += &format!("{at:.2} frame 601 {hex}\n");
    };
    let (mut transfer, start) = BlockDownload::start(IMAGE, image);
    send(&start, at);
    let [low, high] = IMAGE.0.to_le_bytes();
    // Each as the board gives it if it has taken all.
    let mut answer = [0xA4, low, high, IMAGE.1, SEGMENTS_PER_BLOCK, 0, 0, 0];
    loop {
        at += BLOCK_MS;
        let received =
            transfer.receive(&Frame::from_data(0x581, answer)).expect("an answer of this transfer");
        let TransferProgress::Request(first) = received else { return (script, at) };
        let (mut count, mut next) = (0, Some(first));
        while let Some(frame) = next {
            send(&frame, at);
            (at, count, next) = (at + SEGMENT_MS, count + 1, transfer.next_segment());
        }
        let is_end = first.data()[0] >= 0xC0;
        answer = if is_end {
            [0xA1, 0, 0, 0, 0, 0, 0, 0]
        } else {
            [0xA2, count, SEGMENTS_PER_BLOCK, 0, 0, 0, 0, 0]
        };
    }
}

/// Returns the last answer about an object.
pub fn answer(events: &[String], (index, subindex): (u16, u8)) -> Option<u32> {
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
    let answers = [REFUSED, RECEIVED].map(|at| answer(&report.events, at));
    let refusal = FirmwareRejectReason::Signature.number().into();
    assert_eq!(answers, [Some(refusal), Some(0)], "{}", report.stdout);
    let offsets = report.events.iter().filter(|event| event.contains(" can 281 ")).count();
    assert!(offsets > 1_000, "it sends on, after the reset as well: {offsets}");
}

#[test]
#[ignore = "long: the application on the model of the chip"]
fn the_application_takes_an_image_over_can_in_time() {
    let Some(_) = boot() else { return };
    let board = Board::with(&application(Slot::A, 1), &[]).expect("it is there");
    let file = application(Slot::B, 2);
    let (header, image) = file.split_at(HEADER_SIZE);
    let (header, sent) = download(HEADER, header, BEGIN_MS);
    let (image, end) = download_in_blocks(image, sent + ERASE_MS);
    // The signature is verified before the last answer; then NMT: restart.
    let restart = end + 1_000.0;
    let requested =
        questions(&[RECEIVED], restart - 20.0) + &questions(&[RUNNING], restart + 800.0);
    let script = format!("0 flags 10\n{header}{image}{requested}{restart} frame 000 8101\n");
    let report = board.report((restart + 900.0) as u32, &script, &["--slow-flash"]);
    let aborted = report.events.iter().find(|event| event.contains(" can 581 80"));
    assert_eq!(aborted, None, "{}", report.stdout);
    let received = answer(&report.events, RECEIVED);
    assert_eq!(received, Some(file.len() as u32), "{}", report.stdout);
    assert_eq!(answer(&report.events, RUNNING), Some(Slot::B.number().into()), "{}", report.stdout);
    let last = report.events.iter().rev().find(|event| event.contains(" can 581 a1"));
    let last = last.and_then(|event| event.split(' ').next()?.parse::<f64>().ok());
    let took = (last.expect("the end is answered") - BEGIN_MS) / 1e3;
    println!("{} bytes over CAN, flash at its slowest: verified after {took:.1} s", file.len());
    assert!(took <= 20.0, "{took}");
}
