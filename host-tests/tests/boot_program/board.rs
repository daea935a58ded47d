//! A board of these tests: the content of its flash, and what it says.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::OnceLock,
};

use tempfile::TempDir;
use trueup_boot::{
    flash_layout::{SLOT_SIZE, Slot},
    image_header::FirmwareVersion,
};
use trueup_emulator::{
    chip::{self, ModelRunReport},
    slot_images,
};
use trueup_signature::PrivateKey;

/// Behaviours of the small image (`src/bin/slot_test`).
pub const GOOD: u8 = 0;
pub const HANGS: u8 = 1;
pub const RESETS: u8 = 2;
pub const SPEAKS_AND_HANGS: u8 = 3;
pub const CONFIRMS: u8 = 4;
pub const LOADS: u8 = 5;

/// A board answers within this many ms after anything.
pub const ANSWER_MS: f64 = 2_000.0;

/// Offset of slot A in the flash, and of the file that the small image loads.
const SLOT_A: usize = 0x1_0000;
const FILE: usize = 0x8_0000;
const FLASH: usize = 0x10_0000;

/// What is built once.
struct Parts {
    model: PathBuf,
    boot: PathBuf,
    images: [PathBuf; 2],
}

fn parts() -> Option<&'static Parts> {
    static PARTS: OnceLock<Option<Parts>> = OnceLock::new();
    PARTS
        .get_or_init(|| {
            let model = chip::build_model().expect("the model builds")?;
            let boot = slot_images::build_boot_program().expect("the boot program builds");
            let images =
                Slot::ALL.map(|slot| slot_images::build_slot_test_image(slot).expect("it builds"));
            Some(Parts { model, boot, images })
        })
        .as_ref()
}

/// Returns the boot program's image; `None`: this compiler is too old for the model.
pub fn boot() -> Option<&'static PathBuf> {
    parts().map(|parts| &parts.boot)
}

/// Returns a version of this minor number.
pub fn version(minor: u8) -> FirmwareVersion {
    FirmwareVersion::new(0, minor, 0, 0)
}

/// Returns the bytes of a small image for a slot.
pub fn body(slot: Slot, behaviour: u8) -> Vec<u8> {
    body_of(&parts().expect("it was asked for").images[usize::from(slot.number())], slot, behaviour)
}

/// Returns the same of an image that was built apart.
pub fn body_of(image: &Path, slot: Slot, behaviour: u8) -> Vec<u8> {
    let name = slot.name().as_bytes()[0];
    slot_images::build_slot_test_body(image, slot, behaviour, name).expect("a body")
}

/// Returns a file for a slot, signed with the developers' key.
pub fn file(slot: Slot, minor: u8, floor: u8, behaviour: u8) -> Vec<u8> {
    let key = slot_images::load_development_key().expect("the developers' key");
    slot_images::build_signed_update(
        &body(slot, behaviour),
        slot,
        version(minor),
        version(floor),
        &key,
    )
}

/// Returns the same of that many bytes, the largest image among them.
pub fn file_of(length: usize, slot: Slot, minor: u8) -> Vec<u8> {
    let mut body = body(slot, GOOD);
    let mut random = 1_u32;
    body.resize_with(length - trueup_boot::image_header::HEADER_SIZE, || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 24) as u8
    });
    let key = slot_images::load_development_key().expect("the developers' key");
    slot_images::build_signed_update(&body, slot, version(minor), version(0), &key)
}

/// Returns a file that a stranger has signed.
pub fn foreign(slot: Slot, minor: u8) -> Vec<u8> {
    let key = PrivateKey::generate().expect("a system with random numbers");
    slot_images::build_signed_update(&body(slot, GOOD), slot, version(minor), version(0), &key)
}

/// A board with what is in its flash.
pub struct Board {
    folder: TempDir,
    boot: PathBuf,
}

/// A line of the board: when, in ms since power-on, and what.
pub type PrintedLine = (f64, String);

impl Board {
    /// Its slots hold these bytes; `None`: this compiler is too old for the model.
    pub fn with(a: &[u8], b: &[u8]) -> Option<Self> {
        let boot = parts()?.boot.clone();
        let board = Self { folder: tempfile::tempdir().expect("a folder"), boot };
        let mut flash = vec![0xFF; FLASH];
        flash[SLOT_A..SLOT_A + a.len()].copy_from_slice(a);
        let start_of_b = SLOT_A + SLOT_SIZE as usize;
        flash[start_of_b..start_of_b + b.len()].copy_from_slice(b);
        board.write(&flash);
        Some(board)
    }

    /// And this boot program.
    pub fn with_boot(mut self, boot: &Path) -> Self {
        boot.clone_into(&mut self.boot);
        self
    }

    /// And a file is there to be loaded.
    pub fn offering(self, file: &[u8]) -> Self {
        self.change(|flash| flash[FILE..FILE + file.len()].copy_from_slice(file));
        self
    }

    /// Changes bytes of its flash while it is off.
    pub fn change(&self, work: impl FnOnce(&mut [u8])) {
        let mut flash = self.flash();
        work(&mut flash);
        self.write(&flash);
    }

    /// The bytes of a slot, from its start.
    pub fn slot(&self, slot: Slot) -> Vec<u8> {
        let start = SLOT_A + usize::from(slot.number()) * SLOT_SIZE as usize;
        self.flash()[start..start + SLOT_SIZE as usize].to_vec()
    }

    fn flash(&self) -> Vec<u8> {
        fs::read(self.path()).expect("it was written")
    }

    fn write(&self, flash: &[u8]) {
        fs::write(self.path(), flash).expect("a folder of the test");
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("flash")
    }

    /// Runs for this time from power-on; returns the model's report.
    pub fn report(&self, ms: u32, script: &str, options: &[&str]) -> ModelRunReport {
        let model = &parts().expect("it is there").model;
        let script_file = self.folder.path().join("script");
        fs::write(&script_file, script).expect("a folder of the test");
        let (ms, flash) = (ms.to_string(), self.path());
        let (flash, script_file) =
            (flash.to_str().expect("plain"), script_file.to_str().expect("plain"));
        let own = ["--bor", "--ms", &ms, "--flash", flash, "--script", script_file];
        let all = [&own[..], options].concat();
        chip::run_without_log(model, &self.boot, &all).expect("the model runs")
    }

    /// Runs for this time; returns its messages and its resets. Nothing of it may be against the manual.
    pub fn live(&self, ms: u32, script: &str, options: &[&str]) -> Vec<PrintedLine> {
        let report = self.report(ms, script, options);
        // The image of the tests sends from 16 MHz, 2.1 % fast; nothing else is allowed.
        let violations = report.stdout.lines().skip_while(|line| !line.starts_with("== Violation"));
        let others: Vec<&str> = violations
            .skip(1)
            .take_while(|line| line.starts_with("   "))
            .filter(|line| !line.contains("where 921600 is meant"))
            .collect();
        assert!(others.is_empty(), "against the manual: {others:#?}\n{}", report.stdout);
        let line = |event: &String| {
            let (at, what) = event.split_once(' ')?;
            let is_reported = what.starts_with("serial ") || what.starts_with("reset ");
            is_reported.then(|| (at.parse().expect("a time"), what.replace("serial ", "")))
        };
        report.events.iter().filter_map(line).collect()
    }
}

/// Returns the time of the first message.
pub fn first(lines: &[PrintedLine], what: &str) -> f64 {
    let found = lines.iter().find(|(_, event)| event == what);
    found.unwrap_or_else(|| panic!("never {what:?}: {lines:?}")).0
}

/// Returns whether there was a message.
pub fn has(lines: &[PrintedLine], what: &str) -> bool {
    lines.iter().any(|(_, event)| event == what)
}

/// Returns the longest silence after power-on or a reset, in ms.
pub fn longest_silence(lines: &[PrintedLine]) -> f64 {
    let (mut since, mut longest) = (Some(0.0), 0.0_f64);
    for (at, event) in lines {
        longest = since.map_or(longest, |from| longest.max(at - from));
        since = event.starts_with("reset").then_some(*at);
    }
    longest
}
