//! A change of the key on the chip, with a dead PLL: boot program and slot A are flashed with a new key burnt in, then an
//! update comes that is signed with the new key, or still with the old one; the power is cut in between.

use std::{fs, path::PathBuf, sync::OnceLock, thread};

use trueup_boot::flash_layout::Slot;
use trueup_emulator::slot_images;
use trueup_signature::PrivateKey;

use crate::board::{
    ANSWER_MS, Board, CONFIRMS, GOOD, LOADS, body_of, boot, file, first, has, longest_silence,
    version,
};

/// The new key: of this test alone, so never for a machine.
const NEW_KEY: &str = "\
-----BEGIN PRIVATE KEY-----
MC4CAQAwBQYDK2VwBCIEIK0XeMgtPVNhBbFGTn16YWKmPIkB35XxnYmIIzKiUsV3
-----END PRIVATE KEY-----
";

const DEAD: [&str; 1] = ["--pll-dead"];

/// The new key, and what is built with it.
struct New {
    key: PrivateKey,
    boot: PathBuf,
    images: [PathBuf; 2],
}

impl New {
    /// Builds it once.
    fn get() -> &'static Self {
        static NEW: OnceLock<New> = OnceLock::new();
        NEW.get_or_init(|| {
            let key = PrivateKey::from_pem(NEW_KEY).expect("a key");
            let folder = tempfile::tempdir().expect("a folder");
            let path = folder.path().join("maker.pub.pem");
            fs::write(&path, key.public_key().to_pem().expect("a key"))
                .expect("a folder of the test");
            let boot =
                slot_images::build_boot_program_with_key(&path).expect("the boot program builds");
            let images = Slot::ALL.map(|slot| {
                slot_images::build_slot_test_image_with_key(slot, &path).expect("it builds")
            });
            Self { key, boot, images }
        })
    }

    /// Returns the file of a small image that takes updates of the new key, signed with this one.
    fn file(&self, slot: Slot, minor: u8, behaviour: u8, signed_with: &PrivateKey) -> Vec<u8> {
        let body = body_of(&self.images[usize::from(slot.number())], slot, behaviour);
        slot_images::build_signed_update(&body, slot, version(minor), version(0), signed_with)
    }

    /// Returns a board with the new boot program and an image of the new key, which loads what is offered, in slot A.
    fn board(&self, b: &[u8]) -> Board {
        let a = self.file(Slot::A, 1, LOADS, &self.key);
        Board::with(&a, b).expect("it is there").with_boot(&self.boot)
    }
}

#[test]
#[ignore = "long: three boards on the model of the chip"]
fn after_a_key_change_with_a_dead_pll_only_images_of_the_new_key_start() {
    let Some(_) = boot() else { return };
    let new = New::get();
    let old_key = &slot_images::load_development_key().expect("the developers' key");
    let b = |signed_with| new.file(Slot::B, 2, CONFIRMS, signed_with);
    thread::scope(|scope| {
        scope.spawn(move || {
            let board = new.board(&[]).offering(&b(&new.key));
            let lines = board.live(5_500, "", &DEAD);
            let silence = longest_silence(&lines);
            println!("an update of the new key: {silence:.0} ms");
            let events: Vec<&str> = lines.iter().map(|(_, line)| line.as_str()).collect();
            let [a, c, u, reset, b, d, ..] = events[..] else { panic!("{lines:?}") };
            assert_eq!([a, c, u, b, d], ["A", "c", "u", "B", "c"], "{lines:?}");
            assert!(reset.starts_with("reset") && silence <= ANSWER_MS, "{lines:?}");
            // The signature was recorded at the download: the CRC is enough.
            let at = first(&board.live(500, "", &DEAD), "B");
            assert!(at < 300.0, "B speaks at {at} ms");
        });
        scope.spawn(move || {
            let board = new.board(&[]).offering(&b(old_key));
            let lines = board.live(4_700, "1500 reset power\n", &DEAD);
            let silence = longest_silence(&lines);
            println!("an update of the old key, and a power cut: {silence:.0} ms");
            assert!(!has(&lines, "u") && !has(&lines, "B"), "{lines:?}");
            assert!(
                lines.last().is_some_and(|(at, line)| line == "A" && *at > 4_650.0),
                "{lines:?}"
            );
            assert!(silence <= ANSWER_MS, "{lines:?}");
        });
        // An image that was built for the old key, in either slot.
        scope.spawn(move || {
            let lines = new.board(&file(Slot::B, 3, 0, GOOD)).live(2_200, "", &DEAD);
            assert!(has(&lines, "A") && !has(&lines, "B"), "{lines:?}");
        });
    });
}

#[test]
#[ignore = "long: six boards on the model of the chip"]
fn a_power_cut_in_an_update_after_a_key_change_with_a_dead_pll_leaves_a_signed_image_that_answers()
{
    let Some(_) = boot() else { return };
    let new = New::get();
    let old_key = &slot_images::load_development_key().expect("the developers' key");
    thread::scope(|scope| {
        for signed_with in [&new.key, old_key] {
            for cut in ["0 cut 40\n", "0 cut 3000\n", "900 reset power\n"] {
                scope.spawn(move || {
                    let b = new.file(Slot::B, 2, CONFIRMS, signed_with);
                    let lines = new.board(&[]).offering(&b).live(9_000, cut, &DEAD);
                    let silence = longest_silence(&lines);
                    let is_new = std::ptr::eq(signed_with, &new.key);
                    println!("{}, new key {is_new}: {silence:.0} ms", cut.trim());
                    assert!(
                        lines.iter().any(|(_, line)| line.starts_with("reset power")),
                        "{lines:?}"
                    );
                    assert!(silence <= ANSWER_MS, "{lines:?}");
                    assert_eq!(has(&lines, "B"), is_new, "{lines:?}");
                    let last = if is_new { "B" } else { "A" };
                    assert_eq!(
                        lines.last().map(|(_, line)| line.as_str()),
                        Some(last),
                        "{lines:?}"
                    );
                });
            }
        }
    });
}
