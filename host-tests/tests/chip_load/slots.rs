//! The two slots of calibrations in the chip's flash, damaged: the first, the second, both.

use std::{fs, ops::Range};

use anyhow::{Context as _, Result, ensure};
use trueup_store::{
    calibration::{MAX_BLOB_SIZE, calibration_crc},
    calibration_store::CalibrationStore,
};

use super::{Received, all, chip, compiled, master, sectors::Sectors};

/// Of the chip's megabyte of flash, the sectors 8 and 9 (RM0090, table 5).
const SECTORS: Range<usize> = 0x8_0000..0xC_0000;

/// Damaged part of a slot.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    Nothing,
    /// A bit in the middle of the calibration.
    Blob,
    /// A bit of the CRC before it.
    Head,
}

/// Returns a megabyte with two loaded calibrations, half and a quarter of the growth, each damaged as it says.
fn flash(damaged: [Part; 2]) -> Vec<u8> {
    let mut flash = vec![0xFF; 1 << 20];
    let base = calibration_crc(compiled(1.0).blob());
    let loaded = [0.5, 0.25].map(compiled);
    let buffer = &mut [0; MAX_BLOB_SIZE];
    let (mut slots, _) = CalibrationStore::open(Sectors(&mut flash[SECTORS]), Some(base), buffer);
    for calibration in &loaded {
        slots.store(calibration.blob(), || ()).expect("there is room");
    }
    for (calibration, part) in loaded.iter().zip(damaged) {
        let blob = calibration.blob();
        let at = flash.windows(blob.len()).position(|window| window == blob).expect("it is there");
        match part {
            Part::Nothing => {}
            Part::Blob => flash[at + blob.len() / 2] ^= 0x10,
            Part::Head => flash[at - 1] ^= 0x10,
        }
    }
    flash
}

/// A start with such a flash: the growth that it runs on, and whether it asks for `Confirm`, and what becomes of that.
fn start(damaged: [Part; 2], gain: f64, requires_confirmation: bool) -> Result<()> {
    let Some(chip) = chip() else { return Ok(()) };
    let file = tempfile::NamedTempFile::new_in(&chip.folder)?;
    fs::write(&file, flash(damaged))?;
    let path = file.path().to_str().context("a plain name")?;
    // Engaged, then confirmed, then another start.
    let script = format!(
        "0 flags 2\n250 flags 3\n{}400 flags 2\n440 flags 18\n520 flags 2\n600 flags 3\n{}\
         700 reset power\n700 flags 2\n950 flags 3\n{}",
        master::questions(370.0),
        master::questions(670.0),
        master::questions(1_060.0)
    );
    let report = chip.live(1_090, &script, &["--flash", path])?;
    ensure!(report.clean, "a violation:\n{}", report.stdout);
    let received = Received::of(&report.events);
    let running = received.object((0x2100, 3), 0.0).context("it does not say what it runs on")?;
    ensure!(running == calibration_crc(compiled(gain).blob()), "it runs on {running:08x}");
    let is_requested =
        received.emergencies.iter().any(|(time, code)| *time < 250.0 && *code == 0x6301);
    ensure!(
        is_requested == requires_confirmation,
        "asks: {is_requested}, {:x?}",
        received.emergencies
    );
    let quality = |from: f64| {
        let at = received.offsets.iter().position(|time| *time > from);
        at.and_then(|at| received.qualities.get(at)).copied()
    };
    // Not available until the older one is confirmed; then live; and not asked again.
    let (before, after) = (quality(390.0), quality(690.0));
    ensure!(
        before == Some(if requires_confirmation { 6 } else { 1 }),
        "quality {before:?} before the answer"
    );
    ensure!(after == Some(1), "quality {after:?} after the answer");
    ensure!(quality(1_080.0) == Some(1), "quality {:?} after the next start", quality(1_080.0));
    let again = received.emergencies.iter().any(|(time, code)| *time > 700.0 && *code == 0x6301);
    ensure!(!again, "it asks again after the next start");
    Ok(())
}

#[test]
fn of_damaged_slots_the_other_counts_and_of_both_the_images_own_and_the_operator_is_asked() {
    use Part::{Blob, Head, Nothing};
    let cases = [
        ("none is damaged", [Nothing, Nothing], 0.25, false),
        ("the older one is", [Blob, Nothing], 0.25, false),
        ("the newer one is", [Nothing, Blob], 0.5, true),
        ("the newer one's head is", [Nothing, Head], 0.5, true),
        ("both are", [Blob, Blob], 1.0, true),
        ("the heads of both are", [Head, Head], 1.0, true),
    ];
    all(&cases.map(|(what, ..)| what.to_owned()), |what| {
        let (_, damaged, gain, requires_confirmation) =
            cases.iter().find(|case| case.0 == what).expect("one of them");
        start(*damaged, *gain, *requires_confirmation)
    });
}
