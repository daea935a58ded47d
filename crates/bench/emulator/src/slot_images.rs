//! Images for the two slots of the flash, the boot program that chooses between them, and the files of updates.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, ensure};
use trueup_boot::{
    flash_layout::{MAX_BOOT_PROGRAM_SIZE, SLOT_SIZE, Slot},
    image_header::{FirmwareVersion, HEADER_SIZE, ImageHeader},
};
use trueup_signature::{PrivateKey, PublicKey};

use crate::{
    firmware_build::{
        self, FIRMWARE_PROGRAM, LinkedMachineFile, build_and_copy, hash_machine_file,
    },
    flash_image, image_check, setup,
};

/// Names the bytes of the boot program that an image is to have in front.
const BOOT_IMAGE_ENV_VAR: &str = "TRUEUP_BOOT";
/// Where an image has its header.
const SLOT_HEADER_SYMBOL: &str = "TRUEUP_SLOT_HEADER";
/// Where the test has behaviour and name of the small image (`src/bin/slot_test`).
const SLOT_TEST_SYMBOL: &str = "SLOT_TEST";

/// Builds the boot program, for the public key that `TRUEUP_KEY` names or that of developers.
///
/// # Errors
/// It does not compile, does not fit its sectors, or there is no way to the target.
pub fn build_boot_program() -> Result<PathBuf> {
    build_boot_program_with_optional_key(None)
}

/// Builds the boot program for another public key (PEM), under another name.
///
/// # Errors
/// As [`build_boot_program`].
pub fn build_boot_program_with_key(key: &Path) -> Result<PathBuf> {
    build_boot_program_with_optional_key(Some(key))
}

fn build_boot_program_with_optional_key(key: Option<&Path>) -> Result<PathBuf> {
    let name = if key.is_some() { "boot-with-key" } else { "boot" };
    let image = build_program("boot", "trueup-boot-program", name, None, key)?;
    let size = flash_image::read_flash_image(&image)?.len();
    ensure!(
        size <= MAX_BOOT_PROGRAM_SIZE as usize,
        "the boot program has {size} bytes, above {MAX_BOOT_PROGRAM_SIZE}"
    );
    Ok(image)
}

/// Builds the small image of the tests, linked for a slot.
///
/// # Errors
/// As [`build_boot_program`].
pub fn build_slot_test_image(slot: Slot) -> Result<PathBuf> {
    let name = format!("slot-test-{}", slot.name());
    build_program("slot-test", "trueup-slot-test", &name, Some(slot), None)
}

/// Builds the same for another public key (PEM), under another name.
///
/// # Errors
/// As [`build_boot_program`].
pub fn build_slot_test_image_with_key(slot: Slot, key: &Path) -> Result<PathBuf> {
    let name = format!("slot-test-with-key-{}", slot.name());
    build_program("slot-test", "trueup-slot-test", &name, Some(slot), Some(key))
}

/// Returns cargo commands for the boot program with the image of its tests, and for the application in a slot:
/// `cargo <verb>`.
///
/// # Errors
/// There is no way to the target; see `setup::toolchain`.
pub fn cargo_commands(verb: &str) -> Result<[Command; 2]> {
    let (mut boot, _) = firmware_build::cargo_command(verb, "slot-test")?;
    boot.args(["--bin", "trueup-boot-program", "--bin", "trueup-slot-test"]);
    let (mut application, _) = firmware_build::cargo_command(verb, "slots")?;
    application.args(["--bin", "trueup-firmware"]);
    Ok([boot, application])
}

/// Builds the application of the board that is flashed for a machine, linked for a slot and with its CRC.
///
/// # Errors
/// As [`build_boot_program`]; the machine file cannot be used.
pub fn build_application(slot: Slot, machine: &Path) -> Result<PathBuf> {
    let name = format!("stm32f405-{}-for-{}", slot.name(), hash_machine_file(machine)?);
    build_application_for_slot(slot, LinkedMachineFile::File(machine), None, &name, |_| Ok(()))
}

fn build_application_for_slot(
    slot: Slot,
    machine: LinkedMachineFile<'_>,
    boot: Option<&Path>,
    name: &str,
    finish: impl FnOnce(&Path) -> Result<()>,
) -> Result<PathBuf> {
    let (mut command, folder) = cargo_command("slots", FIRMWARE_PROGRAM, Some(slot))?;
    machine.apply_to(&mut command);
    match boot {
        Some(boot) => command.env(BOOT_IMAGE_ENV_VAR, boot),
        None => command.env_remove(BOOT_IMAGE_ENV_VAR),
    };
    build_and_copy(command, &folder, FIRMWARE_PROGRAM, name, |image| {
        image_check::embed_image_check(image)?;
        finish(image)
    })
}

/// Files for a board.
#[derive(Debug)]
pub struct FlashableFiles {
    /// Boot program and slot A, one whole image; its plain bytes stand next to it (`.bin`).
    pub image: PathBuf,
    /// The files of an update, for slot A and for slot B, one behind the other.
    pub update: PathBuf,
}

/// Builds them for a machine, with this version.
///
/// # Errors
/// As [`build_boot_program`]; the machine file cannot be used, or the key of the boot program is not that of the signature.
pub fn build_flashable_files_for_machine(
    machine: &Path,
    version: FirmwareVersion,
) -> Result<FlashableFiles> {
    let name = format!("stm32f405-{version}-for-{}", hash_machine_file(machine)?);
    build_flashable_files(LinkedMachineFile::File(machine), &name, version)
}

/// Builds the whole image alone.
pub(crate) fn build_combined_image(
    machine: LinkedMachineFile<'_>,
    name: &str,
    version: FirmwareVersion,
) -> Result<PathBuf> {
    let boot = build_boot_program()?;
    let boot_bytes = boot.with_extension("bin");
    let bytes = flash_image::read_flash_image(&boot)?;
    // What is the same keeps its time, and nothing is built again.
    if fs::read(&boot_bytes).ok().as_ref() != Some(&bytes) {
        fs::write(&boot_bytes, bytes)?;
    }
    let image = build_signed_image(Slot::A, machine, Some(&boot_bytes), name, version)?;
    fs::write(image.with_extension("bin"), flash_image::read_flash_image(&image)?)?;
    Ok(image)
}

pub(crate) fn build_flashable_files(
    machine: LinkedMachineFile<'_>,
    name: &str,
    version: FirmwareVersion,
) -> Result<FlashableFiles> {
    let image = build_combined_image(machine, name, version)?;
    let second = build_signed_image(Slot::B, machine, None, &format!("{name}-B"), version)?;
    let update =
        [read_image_with_header(&image, Slot::A)?, read_image_with_header(&second, Slot::B)?]
            .concat();
    let path = image.with_extension("update");
    fs::write(&path, update)?;
    Ok(FlashableFiles { image, update: path })
}

/// Builds the application for a slot, with its header and signature.
fn build_signed_image(
    slot: Slot,
    machine: LinkedMachineFile<'_>,
    boot: Option<&Path>,
    name: &str,
    version: FirmwareVersion,
) -> Result<PathBuf> {
    let key = load_signing_key()?;
    build_application_for_slot(slot, machine, boot, name, |image| {
        let file = build_signed_update(
            &read_image_body(image, slot)?,
            slot,
            version,
            FirmwareVersion::default(),
            &key,
        );
        image_check::write_at_symbol(image, SLOT_HEADER_SYMBOL, &file[..HEADER_SIZE])
    })
}

/// Returns the version of this project's firmware.
///
/// # Errors
/// `TRUEUP_FIRMWARE_VERSION` is none.
pub fn firmware_version() -> Result<FirmwareVersion> {
    let text = env::var("TRUEUP_FIRMWARE_VERSION");
    let text = text.as_deref().unwrap_or(env!("CARGO_PKG_VERSION"));
    FirmwareVersion::parse(text)
        .with_context(|| format!("TRUEUP_FIRMWARE_VERSION: {text} is no version"))
}

/// Returns the key that images are signed with: the one that `TRUEUP_SIGNING_KEY` names, or that of developers. The boot
/// program has its public half.
fn load_signing_key() -> Result<PrivateKey> {
    let Ok(path) = env::var("TRUEUP_SIGNING_KEY") else {
        ensure!(
            env::var_os("TRUEUP_KEY").is_none(),
            "TRUEUP_KEY names the key of the boot program; TRUEUP_SIGNING_KEY has to name its private half"
        );
        return load_development_key();
    };
    let key = PrivateKey::from_pem(&fs::read_to_string(&path).with_context(|| path.clone())?)
        .with_context(|| path.clone())?;
    let public =
        env::var("TRUEUP_KEY").context("TRUEUP_SIGNING_KEY is set, but TRUEUP_KEY is not")?;
    let burnt = PublicKey::from_pem(&fs::read_to_string(&public).with_context(|| public.clone())?)
        .with_context(|| public.clone())?;
    ensure!(
        burnt.to_bytes() == key.public_key().to_bytes(),
        "{public} is not the public half of {path}: no board would start what is signed with it"
    );
    Ok(key)
}

/// Builds a program; with `key`, for that public key in the place of what the environment names.
fn build_program(
    feature: &str,
    program: &str,
    name: &str,
    slot: Option<Slot>,
    key: Option<&Path>,
) -> Result<PathBuf> {
    let (mut command, folder) = cargo_command(feature, program, slot)?;
    if let Some(key) = key {
        command.env("TRUEUP_KEY", key);
    }
    build_and_copy(command, &folder, program, name, |_| Ok(()))
}

fn cargo_command(feature: &str, program: &str, slot: Option<Slot>) -> Result<(Command, PathBuf)> {
    let (mut command, folder) = firmware_build::cargo_command("build", feature)?;
    command.args(["--bin", program]);
    match slot {
        Some(slot) => command.env("TRUEUP_SLOT", slot.name()),
        None => command.env_remove("TRUEUP_SLOT"),
    };
    Ok((command, folder))
}

/// Returns the bytes of an image behind its header, filled up to whole words as erased flash is.
///
/// # Errors
/// The image cannot be read, or has bytes outside of its slot.
pub fn read_image_body(image: &Path, slot: Slot) -> Result<Vec<u8>> {
    Ok(read_image_with_header(image, slot)?.split_off(HEADER_SIZE))
}

/// Returns the same with the header that the image has.
fn read_image_with_header(image: &Path, slot: Slot) -> Result<Vec<u8>> {
    let mut flash = flash_image::read_flash_image(image)?;
    let start = usize::try_from(slot.start() - flash_image::FLASH_START)?;
    let (first, end) = (start + HEADER_SIZE, start + SLOT_SIZE as usize);
    let name = image.display();
    ensure!(flash.len() > first, "{name} is not linked for slot {}", slot.name());
    ensure!(flash.len() <= end, "{name} is larger than a slot");
    // A whole image has the boot program below slot A.
    let below = if slot == Slot::A { MAX_BOOT_PROGRAM_SIZE as usize..start } else { 0..start };
    ensure!(flash[below].iter().all(|byte| *byte == 0xFF), "{name} has bytes below its slot");
    flash.resize(flash.len().next_multiple_of(4), 0xFF);
    Ok(flash.split_off(start))
}

/// Returns the body of the small image of the tests with its behaviour and the name that it says.
///
/// # Errors
/// As [`read_image_body`].
pub fn build_slot_test_body(image: &Path, slot: Slot, behaviour: u8, name: u8) -> Result<Vec<u8>> {
    let mut body = read_image_body(image, slot)?;
    let address = image_check::find_symbol_address(image, SLOT_TEST_SYMBOL)?
        .context("the image has no settings")?;
    let at = usize::try_from(address - slot.start())? - HEADER_SIZE;
    let place = body.get_mut(at..at + 2).context("its settings are not in the image")?;
    place.copy_from_slice(&[behaviour, name]);
    Ok(body)
}

/// Returns the file of an update: header, signature and image.
#[must_use]
pub fn build_signed_update(
    body: &[u8],
    slot: Slot,
    version: FirmwareVersion,
    floor: FirmwareVersion,
    key: &PrivateKey,
) -> Vec<u8> {
    let mut header = ImageHeader::new_unsigned(body, slot, version, floor);
    header.signature = key.sign(ImageHeader::signed_bytes(&header.encode()));
    let mut file = header.encode().to_vec();
    file.extend(body);
    file
}

/// Returns the private key of developers. Its owner is everybody.
///
/// # Errors
/// It cannot be read.
pub fn load_development_key() -> Result<PrivateKey> {
    let path = setup::project_root().join("data/keys/development.pem");
    let pem = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    PrivateKey::from_pem(&pem).with_context(|| path.display().to_string())
}
