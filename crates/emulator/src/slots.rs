//! Images for the two slots of the flash, the boot program that chooses between them, and the files of updates.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, ensure};
use rustix::fs::{FlockOperation, flock};
use trueup_boot::{
    header::{HEADER_SIZE, Header, Version},
    layout::{BOOT_SIZE, SLOT_SIZE, Slot},
};
use trueup_signature::PrivateKey;

use crate::{
    binary, firmware, process, seal,
    setup::{self, TARGET},
};

/// Where the test has behaviour and name of the small image (`src/bin/slot_test`).
const SETTINGS: &str = "SLOT_TEST";

/// Builds the boot program, for the public key that `TRUEUP_KEY` names or that of developers.
///
/// # Errors
/// It does not compile, does not fit its sectors, or there is no way to the target.
pub fn build_boot() -> Result<PathBuf> {
    let image = build("boot", "trueup-boot-program", "boot", None)?;
    let size = binary::of(&image)?.len();
    ensure!(size <= BOOT_SIZE as usize, "the boot program has {size} bytes, above {BOOT_SIZE}");
    Ok(image)
}

/// Builds the small image of the tests, linked for a slot.
///
/// # Errors
/// As [`build_boot`].
pub fn build_slot_test(slot: Slot) -> Result<PathBuf> {
    let name = format!("slot-test-{}", slot.name());
    build("slot-test", "trueup-slot-test", &name, Some(slot))
}

/// Returns cargo commands for the boot program with the image of its tests, and for the application in a slot:
/// `cargo <verb>`.
///
/// # Errors
/// As [`firmware::cargo`].
pub fn cargo(verb: &str) -> Result<[Command; 2]> {
    let (mut boot, _) = firmware::cargo_for(verb, "slot-test")?;
    boot.args(["--bin", "trueup-boot-program", "--bin", "trueup-slot-test"]);
    let (mut application, _) = firmware::cargo_for(verb, "slots")?;
    application.args(["--bin", "trueup-firmware"]);
    Ok([boot, application])
}

/// Builds the application of the board that is flashed for a machine, linked for a slot and with its CRC.
///
/// # Errors
/// As [`build_boot`]; the machine file cannot be used.
pub fn build_application(slot: Slot, machine: &Path) -> Result<PathBuf> {
    let name = format!("stm32f405-{}-for-{}", slot.name(), firmware::mark(machine)?);
    let (mut command, folder) = cargo_for("slots", "trueup-firmware", Some(slot))?;
    command.env(firmware::MACHINE_VARIABLE, machine);
    let image = build_with(command, &folder, "trueup-firmware", &name)?;
    seal::seal(&image)?;
    Ok(image)
}

fn build(feature: &str, program: &str, name: &str, slot: Option<Slot>) -> Result<PathBuf> {
    let (command, folder) = cargo_for(feature, program, slot)?;
    build_with(command, &folder, program, name)
}

fn cargo_for(feature: &str, program: &str, slot: Option<Slot>) -> Result<(Command, PathBuf)> {
    let (mut command, folder) = firmware::cargo_for("build", feature)?;
    command.args(["--bin", program]);
    match slot {
        Some(slot) => command.env("TRUEUP_SLOT", slot.name()),
        None => command.env_remove("TRUEUP_SLOT"),
    };
    Ok((command, folder))
}

fn build_with(mut command: Command, folder: &Path, program: &str, name: &str) -> Result<PathBuf> {
    let images = folder.join("images");
    fs::create_dir_all(&images)?;
    // Both slots' images have the same file name, so nobody else may build until the copy is made.
    let lock = File::create(images.join("lock"))?;
    flock(&lock, FlockOperation::LockExclusive)?;
    process::run(&mut command)?;
    let image = images.join(format!("trueup-{name}.elf"));
    let copy = tempfile::NamedTempFile::new_in(&images)?;
    let built = folder.join(TARGET).join("firmware").join(program);
    fs::copy(&built, &copy).with_context(|| built.display().to_string())?;
    copy.persist(&image)?;
    Ok(image)
}

/// Returns the bytes of an image behind its header, filled up to whole words as erased flash is.
///
/// # Errors
/// The image cannot be read, or has bytes outside of its slot.
pub fn body(image: &Path, slot: Slot) -> Result<Vec<u8>> {
    let mut flash = binary::of(image)?;
    let start = usize::try_from(slot.start() - binary::FLASH_START)?;
    let (first, end) = (start + HEADER_SIZE, start + SLOT_SIZE as usize);
    let name = image.display();
    ensure!(flash.len() > first, "{name} is not linked for slot {}", slot.name());
    ensure!(flash.len() <= end, "{name} is larger than a slot");
    ensure!(flash[..first].iter().all(|byte| *byte == 0xFF), "{name} has bytes below its slot");
    flash.resize(flash.len().next_multiple_of(4), 0xFF);
    Ok(flash.split_off(first))
}

/// Returns the body of the small image of the tests with its behaviour and the name that it says.
///
/// # Errors
/// As [`body`].
pub fn slot_test_body(image: &Path, slot: Slot, behaviour: u8, name: u8) -> Result<Vec<u8>> {
    let mut body = body(image, slot)?;
    let address = seal::symbol(image, SETTINGS)?.context("the image has no settings")?;
    let at = usize::try_from(address - slot.start())? - HEADER_SIZE;
    let place = body.get_mut(at..at + 2).context("its settings are not in the image")?;
    place.copy_from_slice(&[behaviour, name]);
    Ok(body)
}

/// Returns the file of an update: header, signature and image.
#[must_use]
pub fn sign(
    body: &[u8],
    slot: Slot,
    version: Version,
    floor: Version,
    key: &PrivateKey,
) -> Vec<u8> {
    let mut header = Header::unsigned(body, slot, version, floor);
    header.signature = key.sign(Header::signed(&header.encode()));
    let mut file = header.encode().to_vec();
    file.extend(body);
    file
}

/// Returns the private key of developers. Its owner is everybody.
///
/// # Errors
/// It cannot be read.
pub fn development_key() -> Result<PrivateKey> {
    let path = setup::root().join("data/keys/development.pem");
    let pem = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    PrivateKey::from_pem(&pem).with_context(|| path.display().to_string())
}
