//! One whole image, boot program and slot A, as it is flashed into an empty board; and the update behind it.

use trueup_boot::{flash_layout::Slot, image_header::FirmwareVersion};
use trueup_emulator::{chip, flash_image, setup, slot_images};

use crate::board::boot;

/// Bytes that a board's flash has in front of slot A.
const SLOT_A: usize = 0x1_0000;

#[test]
#[ignore = "long: the application on the model of the chip"]
fn one_whole_image_starts_on_an_empty_board_and_has_its_update_in_slot_a() {
    let Some(_) = boot() else { return };
    let machine = setup::project_root().join("data/paper_spindle.toml");
    let version = FirmwareVersion::new(0, 9, 1, 0);
    let whole =
        slot_images::build_flashable_files_for_machine(&machine, version).expect("it builds");
    let flash = flash_image::read_flash_image(&whole.image).expect("an image");
    let update = std::fs::read(&whole.update).expect("it was written");
    let length = flash.len().next_multiple_of(4) - SLOT_A;
    println!("{} bytes, {} in slot A, update of {}", flash.len(), length, update.len());
    assert_eq!(
        flash[SLOT_A..],
        update[..flash.len() - SLOT_A],
        "slot A is the first file of the update"
    );
    let second = &update[length..];
    assert_eq!(&second[64..72], b"TRUEUPFW", "the second file follows");
    assert_eq!(second[76], Slot::B.number(), "for slot B");

    let model = chip::build_model().expect("the model builds").expect("it was there");
    let folder = tempfile::tempdir().expect("a folder");
    let script = folder.path().join("script");
    std::fs::write(&script, "500 flags 3\n").expect("a folder of the test");
    let script = script.to_str().expect("plain");
    let own = ["--bor", "--ms", "1500", "--script", script];
    let report = chip::run(&model, &whole.image, &own).expect("the model runs");
    assert!(report.clean, "a violation:\n{}", report.stdout);
    let offsets = report.events.iter().filter(|event| event.contains(" can 281 "));
    let first = offsets.clone().next().and_then(|event| event.split(' ').next());
    println!("the first offset {} ms after power-on", first.unwrap_or_default());
    let offsets = offsets.count();
    assert!(offsets > 1_000 && report.stdout.contains("quality 1"), "{offsets}: {}", report.stdout);
    // The log is read with the whole image.
    let is_reported = report.log.iter().any(|line| line.contains("slot A"));
    assert!(is_reported, "{:?}", report.log);
}
