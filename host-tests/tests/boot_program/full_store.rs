//! The longest starts of the application: its stores are full, of the largest calibrations, or one is written anew; a sector
//! is erased; the core has 16 MHz, the flash its longest times, and the watchdog its shortest limit.

use std::{fs, ops::Range, thread};

use trueup_boot::flash_layout::Slot;
use trueup_emulator::setup;
use trueup_machine::{MachineFile, compile};
use trueup_store::{
    calibration::{MAX_BLOB_SIZE, calibration_crc},
    calibration_store::CalibrationStore,
    reference::ReferenceStore,
};

use crate::{
    application::application,
    board::{Board, boot},
    sectors::Sectors,
};

/// Sectors 8 and 9, and 10 and 11 of the references.
const CALIBRATIONS: Range<usize> = 0x8_0000..0xC_0000;
const REFERENCES: Range<usize> = 0xC_0000..0x10_0000;
/// Points of a table in each direction, of four bytes each.
const POINTS: usize = 1_960;

/// Returns the calibration of the machine of these tests, with a table of this error at each of its points.
fn calibration(um: Option<u32>) -> Vec<u8> {
    let machine = setup::project_root().join("data/paper_spindle.toml");
    let mut text = fs::read_to_string(machine).expect("it is ours");
    if let Some(um) = um {
        let points = vec![um.to_string(); POINTS].join(", ");
        text += &format!(
            "\n[axis.x.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = [{points}]\nreverse_um = [{points}]\n"
        );
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("machine.toml");
    fs::write(&path, text).expect("it is written");
    let machine = MachineFile::read(&path).expect("a machine file");
    compile(&machine).expect("it compiles").blob().to_vec()
}

/// Lives with so many calibrations, of which seven fill a sector, and full references.
fn starts_with(application: &[u8], calibrations: u32) {
    let board = Board::with(application, &[]).expect("it is there");
    board.change(|flash| {
        let (base, buffer) = (calibration_crc(&calibration(None)), &mut [0; MAX_BLOB_SIZE]);
        let (mut slots, _) =
            CalibrationStore::open(Sectors(&mut flash[CALIBRATIONS]), Some(base), buffer);
        let mut last = 0;
        for number in 1..=calibrations {
            let blob = calibration(Some(number));
            assert!(blob.len() > MAX_BLOB_SIZE - 400, "{} of {MAX_BLOB_SIZE} bytes", blob.len());
            slots.store(&blob, || ()).expect("there is room");
            last = calibration_crc(&blob);
        }
        let (mut references, _) = ReferenceStore::open(Sectors(&mut flash[REFERENCES]), last);
        while references.append(Default::default()).is_ok() {}
    });
    let options = ["--pll-dead", "--slow-flash", "--lsi", "47000"];
    let report = board.report(9_000, "", &options);
    let is_reset = |event: &&String| event.contains(" reset ");
    let resets: Vec<_> = report.events.iter().filter(is_reset).collect();
    let erased = report.stdout.lines().filter(|line| line.contains(" erased, ")).count();
    println!("{calibrations} calibrations: {} resets, {erased} sectors erased", resets.len());
    assert!(resets.is_empty(), "{calibrations} calibrations: {resets:?}\n{}", report.stdout);
    assert_eq!(erased, 2, "{calibrations} calibrations: {}", report.stdout);
    // The tasks run: their limit is the short one.
    assert!(report.stdout.contains("IWDG: resets after 71 ms"), "{}", report.stdout);
}

#[test]
#[ignore = "long: nine seconds of two applications at 16 MHz on the model of the chip"]
fn the_longest_start_is_not_reset_by_the_fastest_watchdog() {
    let Some(_) = boot() else { return };
    let application = application(Slot::A, 1);
    thread::scope(|scope| {
        // With 8 the newest is alone in its sector, and written anew before the other one is erased.
        for calibrations in [8, 14] {
            let application = &application;
            scope.spawn(move || starts_with(application, calibrations));
        }
    });
}
