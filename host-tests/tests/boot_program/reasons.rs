//! The reason of a start, as the boot program hands it to the application and object 0x2121:07 has it: each once.

use std::thread;

use trueup_boot::{
    boot_state::{BootState, ImageStatus},
    flash_layout::{FLASH_START, HANDOVER_START, JOURNAL_SECTOR_SIZE, JOURNAL_START, Slot},
    handover::StartInfo,
    journal::Journal,
    start::StartReason,
};
use trueup_store::simulated_nor_flash::SimulatedNorFlash;

use crate::{
    application::application,
    board::{Board, GOOD, RESETS, boot, file, foreign},
    loads::answer,
    sdo_script::questions,
};

const CHOICE: (u16, u8) = (0x2121, 7);
/// The application answers by then, also behind an image that has reset.
const REQUEST_MS: u32 = 600;

/// The boot program has ended after this, and the application has read the words within 60 ms of it.
const FLIPS_MS: u32 = 60;

/// Returns the records that hold a status of the image of this file.
fn records(slot: Slot, file: &[u8], status: ImageStatus) -> Vec<u8> {
    let tag = u32::from_le_bytes(file[508..512].try_into().expect("a header"));
    let flash = SimulatedNorFlash::<{ JOURNAL_SECTOR_SIZE as usize }>::erased();
    let mut journal = Journal::open(flash);
    journal.commit(BootState::default().with_status(slot, tag, status)).expect("room");
    journal.into_flash().bytes
}

/// Returns a board with these slots and the application in slot A of this status.
fn board(a: &[u8], b: &[u8], status: ImageStatus) -> Board {
    let board = Board::with(a, b).expect("it is there");
    let start = (JOURNAL_START - FLASH_START) as usize;
    let records = records(Slot::A, a, status);
    board.change(|flash| flash[start..start + records.len()].copy_from_slice(&records));
    board
}

/// Returns what the application says of its start at that time in a script.
fn choice(board: &Board, script: &str, request_ms: u32) -> Option<StartInfo> {
    let script = script.to_owned() + &questions(&[CHOICE], request_ms.into());
    let report = board.report(request_ms + 60, &script, &[]);
    let word = answer(&report.events, CHOICE);
    StartInfo::decode(word.unwrap_or_else(|| panic!("no answer:\n{}", report.stdout)))
}

#[test]
#[ignore = "long: seven starts of the application on the model of the chip"]
fn each_reason_of_the_boot_program_is_reported_by_the_application() {
    let Some(_) = boot() else { return };
    use ImageStatus::{Confirmed, New, Rejected};
    let app = application(Slot::A, 2);
    let cases = [
        (vec![], New, "", StartReason::OnlyImage, None),
        (vec![], Confirmed, "", StartReason::Newest, None),
        (vec![], Rejected, "", StartReason::LastResort, None),
        (file(Slot::B, 1, 0, GOOD), New, "", StartReason::Trial(1), Some(New)),
        (file(Slot::B, 1, 0, GOOD), New, "pin", StartReason::Trial(2), Some(New)),
        (foreign(Slot::B, 3), Confirmed, "", StartReason::RolledBack, Some(New)),
        (file(Slot::B, 3, 0, RESETS), Confirmed, "", StartReason::RolledBack, Some(Rejected)),
    ];
    thread::scope(|scope| {
        for (b, status, reset, reason, other) in cases {
            let app = &app;
            scope.spawn(move || {
                let (script, request_ms) = match reset {
                    "" => (String::new(), REQUEST_MS),
                    reset => (format!("{REQUEST_MS} reset {reset}\n"), 2 * REQUEST_MS),
                };
                let found = choice(&board(app, &b, status), &script, request_ms);
                println!("{reason:?} {other:?}: {found:?}");
                assert_eq!(found, Some(StartInfo { reason, other }), "{status:?} {reset}");
            });
        }
    });
}

#[test]
#[ignore = "long: the application on the model of the chip"]
fn a_word_that_was_damaged_on_its_way_is_no_reason() {
    let Some(_) = boot() else { return };
    let app = application(Slot::A, 2);
    let board = board(&app, &[], ImageStatus::Confirmed);
    // Another bit of the word flips every 2 ms while the boot program ends and the application tests its RAM.
    let place = HANDOVER_START + 4;
    let flips =
        (0..32).map(|bit| format!("{} poke {place:x} {:x}\n", FLIPS_MS + 2 * bit, 1_u32 << bit));
    assert_eq!(choice(&board, &flips.collect::<String>(), REQUEST_MS), None);
}
