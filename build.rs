//! Hands the linker its scripts, and compiles the machine file that is linked into the image.
//!
//! | features | place in the flash |
//! |---|---|
//! | a board, `measure` | `src/memory.x` |
//! | `boot` | that of the boot program (`trueup_boot::flash_layout`) |
//! | `slots`, `slot-test` | that of slot A or B, as `TRUEUP_SLOT` says; with its header, and the boot program of `TRUEUP_BOOT`, if any |
//!
//! The link arguments stand here and not in `.cargo/config.toml`, because `RUSTFLAGS` in the
//! environment would replace those in silence and the image would come out empty.
#![allow(clippy::print_stdout, reason = "cargo reads this")]

use std::{env, fs, path::Path, path::PathBuf, process::exit};

use trueup_boot::{
    flash_layout::{
        FLASH_START, HANDOVER_SIZE, HANDOVER_START, MAX_BOOT_PROGRAM_SIZE, SLOT_SIZE, Slot,
    },
    image_header::HEADER_SIZE,
};
use trueup_machine::{compile::compile, machine_file::MachineFile};
use trueup_signature::PublicKey;

#[path = "commit.rs"]
mod commit;

/// The machine file of an image that was built without one.
const DEFAULT_MACHINE_FILE: &str = "data/paper_spindle.toml";

/// Where the linker may place what. Not at the workspace's root: a linker that runs there takes a file of that name
/// before any that is made here.
const MEMORY_LINKER_SCRIPT: &str = "src/memory.x";
/// Where the stack of the board that is flashed ends, and what lies below it.
const STACK_GUARD_LINKER_SCRIPT: &str = "src/board/stm32f405/guard.x";
/// The key of developers, whose private half is public.
const DEVELOPMENT_PUBLIC_KEY_FILE: &str = "data/keys/development.pub.pem";

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let place = select_memory_layout();
    fs::write(out.join("memory.x"), place.render_linker_script()).expect("OUT_DIR can be written");
    // The image checks itself from there on (`src/board/stm32f405/image_check.rs`).
    fs::write(out.join("start.in"), place.start.to_string()).expect("OUT_DIR can be written");
    println!("cargo:rerun-if-changed={MEMORY_LINKER_SCRIPT}");
    println!("cargo:rerun-if-changed={STACK_GUARD_LINKER_SCRIPT}");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    commit::emit_commit_env(Path::new("."));
    if has_feature("BOOT") {
        embed_public_key(&out);
    }
    if has_feature("SLOTS") {
        embed_boot_program(&out);
    }
    if has_feature("SLOTS") || !has_feature("BOOT") {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
        embed_calibration(&out);
    }
}

fn has_feature(name: &str) -> bool {
    env::var_os(format!("CARGO_FEATURE_{name}")).is_some()
}

/// A part of the flash, and the part of the RAM that belongs to it: start and bytes.
struct MemoryLayout {
    start: u32,
    length: u32,
    ram: (u32, u32),
}

impl MemoryLayout {
    /// Returns the script of the linker; for the board that is flashed with the guard below its stack.
    fn render_linker_script(&self) -> String {
        let Self { start, length, ram: (ram, ram_length) } = self;
        let mut memory = format!(
            "MEMORY {{ FLASH : ORIGIN = {start:#x}, LENGTH = {length} \
             RAM : ORIGIN = {ram:#x}, LENGTH = {ram_length} }}\n"
        );
        if *start == FLASH_START && !has_feature("BOOT") {
            memory = fs::read_to_string(MEMORY_LINKER_SCRIPT).expect("it is part of the package");
        }
        if has_feature("SLOTS") {
            let header = start - u32::try_from(HEADER_SIZE).expect("512");
            memory += &format!(
                "MEMORY {{ BOOT : ORIGIN = {FLASH_START:#x}, LENGTH = {MAX_BOOT_PROGRAM_SIZE} \
                 HEADER : ORIGIN = {header:#x}, LENGTH = {HEADER_SIZE} }}\n\
                 SECTIONS {{ .boot : {{ KEEP(*(.boot)) }} > BOOT \
                 .slot_header : {{ KEEP(*(.slot_header)) }} > HEADER }} INSERT BEFORE .vector_table;\n"
            );
        }
        if has_feature("STM32F405") {
            // Without it up to 7 bytes before the constants are in no segment: erased flash on a board, zeros in an
            // emulator, and so another image.
            memory += "SECTIONS { .fill : { LONG(0xFFFFFFFF) . = ALIGN(8); } > FLASH =0xFFFFFFFF } INSERT AFTER .text;\n";
            memory +=
                &fs::read_to_string(STACK_GUARD_LINKER_SCRIPT).expect("it is next to the board");
        }
        memory
    }
}

/// Returns the place of this image.
fn select_memory_layout() -> MemoryLayout {
    println!("cargo:rerun-if-env-changed=TRUEUP_SLOT");
    let ram = (0x2000_0000, 128 * 1024);
    let header = u32::try_from(HEADER_SIZE).expect("512");
    let is_in_slot = has_feature("SLOTS") || has_feature("SLOT_TEST");
    if is_in_slot {
        let is_b = env::var("TRUEUP_SLOT").is_ok_and(|slot| slot == Slot::B.name());
        let start = if is_b { Slot::B.start() } else { Slot::A.start() };
        MemoryLayout {
            start: start + header,
            length: SLOT_SIZE - header,
            ram: ram_below_handover(ram.0),
        }
    } else if has_feature("BOOT") {
        // The upper part of the RAM: where the application has its stack.
        MemoryLayout {
            start: FLASH_START,
            length: MAX_BOOT_PROGRAM_SIZE,
            ram: ram_below_handover(0x2001_8000),
        }
    } else {
        MemoryLayout { start: FLASH_START, length: 512 * 1024, ram }
    }
}

/// Returns the RAM from an address on, up to the words that the boot program hands over: neither program has its stack
/// there.
fn ram_below_handover(ram: u32) -> (u32, u32) {
    const _: () = assert!(HANDOVER_START + HANDOVER_SIZE == 0x2000_0000 + 128 * 1024);
    (ram, HANDOVER_START - ram)
}

/// Writes the public key of updates: the one that the user names, or that of developers.
fn embed_public_key(out: &Path) {
    println!("cargo:rerun-if-env-changed=TRUEUP_KEY");
    let given = env::var("TRUEUP_KEY").unwrap_or_else(|_| DEVELOPMENT_PUBLIC_KEY_FILE.into());
    println!("cargo:rerun-if-changed={given}");
    let key = fs::read_to_string(&given).map_err(|error| error.to_string());
    match key.and_then(|pem| PublicKey::from_pem(&pem).map_err(|fault| fault.to_string())) {
        Ok(key) => fs::write(out.join("key.bin"), key.to_bytes()).expect("OUT_DIR can be written"),
        Err(error) => {
            println!("cargo:warning={given}: {error}");
            exit(1);
        }
    }
}

/// Puts the bytes of the boot program where the image takes them from; none, if no boot program is named.
fn embed_boot_program(out: &Path) {
    println!("cargo:rerun-if-env-changed=TRUEUP_BOOT");
    let bytes = match env::var("TRUEUP_BOOT") {
        Ok(path) => {
            println!("cargo:rerun-if-changed={path}");
            fs::read(&path).unwrap_or_else(|error| {
                println!("cargo:warning={path}: {error}");
                exit(1);
            })
        }
        Err(_) => Vec::new(),
    };
    fs::write(out.join("boot.bin"), bytes).expect("OUT_DIR can be written");
}

/// Compiles the machine file.
fn embed_calibration(out: &Path) {
    println!("cargo:rerun-if-env-changed=TRUEUP_MACHINE");
    let given = env::var("TRUEUP_MACHINE");
    println!("cargo:rustc-env=TRUEUP_EXAMPLE={}", u8::from(given.is_err()));
    let machine = given.unwrap_or_else(|_| {
        // A board must not take another machine's spindle for its own without a warning.
        if env::var_os("CARGO_FEATURE_STM32F405").is_some() {
            println!(
                "cargo:warning=TRUEUP_MACHINE is not set: {DEFAULT_MACHINE_FILE} is linked in, and gives no offset"
            );
        }
        DEFAULT_MACHINE_FILE.into()
    });
    println!("cargo:rerun-if-changed={machine}");
    match MachineFile::read(Path::new(&machine)).and_then(|machine| compile(&machine)) {
        Ok(compiled) => {
            fs::write(out.join("calibration.bin"), compiled.blob())
                .expect("OUT_DIR can be written");
        }
        Err(error) => {
            println!("cargo:warning={error}");
            exit(1);
        }
    }
}
