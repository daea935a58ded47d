//! Hands the linker its scripts, and compiles the machine file that is linked into the image.
//!
//! The link arguments stand here and not in `.cargo/config.toml`, because `RUSTFLAGS` in the
//! environment would replace those in silence and the image would come out empty.
#![allow(clippy::print_stdout, reason = "cargo reads this")]

use std::{env, fs, path::Path, path::PathBuf, process::exit};

use trueup_machine::{compile::compile, file::MachineFile};

#[path = "commit.rs"]
mod commit;

/// The machine file of an image that was built without one.
const EXAMPLE: &str = "data/paper_spindle.toml";

/// Where the stack of the board that is flashed ends, and what lies below it.
const GUARD: &str = "src/board/stm32f405/guard.x";

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let mut memory = fs::read_to_string("memory.x").expect("it stands beside this file");
    if env::var_os("CARGO_FEATURE_STM32F405").is_some() {
        memory += &fs::read_to_string(GUARD).expect("it stands beside the board");
    }
    fs::write(out.join("memory.x"), memory).expect("OUT_DIR can be written");
    println!("cargo:rerun-if-changed={GUARD}");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    println!("cargo:rerun-if-changed=memory.x");
    commit::tell(Path::new("."));

    println!("cargo:rerun-if-env-changed=TRUEUP_MACHINE");
    let given = env::var("TRUEUP_MACHINE");
    println!("cargo:rustc-env=TRUEUP_EXAMPLE={}", u8::from(given.is_err()));
    let machine = given.unwrap_or_else(|_| {
        // A board must not take somebody else's spindle for its own without a word.
        if env::var_os("CARGO_FEATURE_STM32F405").is_some() {
            println!(
                "cargo:warning=TRUEUP_MACHINE is not set: {EXAMPLE} is linked in, and gives no offset"
            );
        }
        EXAMPLE.into()
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
