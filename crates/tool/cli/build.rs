//! A release build of the tool carries the firmware images, so that an installed `trueup` needs no source
//! tree. Where they are missing, or older than what they are built from, `cargo xtask images` builds
//! them; where that cannot be, the tool comes without them, and says so when they are requested.
//!
//! `TRUEUP_FIRMWARE=0` leaves them out. A build for tests carries nothing, unless `TRUEUP_FIRMWARE=1` says
//! that it takes what `cargo xtask images` has built before.
#![allow(clippy::print_stdout, reason = "cargo reads this")]

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
    time::SystemTime,
};

#[path = "../../../commit.rs"]
mod commit;

/// Names of the carried images; a constant of what this writes names one, too.
const IMAGE_NAMES: [&str; 4] = [
    "trueup-virtual.elf",
    "trueup-stm32f405.elf",
    "trueup-stm32f405.bin",
    "trueup-stm32f405.update",
];
/// Sources of the images.
const IMAGE_SOURCES: [&str; 17] = [
    "Cargo.lock",
    "build.rs",
    "commit.rs",
    "src",
    "data/keys",
    "data/paper_spindle.toml",
    "crates/board/boot/src",
    "crates/board/canopen/src",
    "crates/board/core/src",
    "crates/board/link/src",
    "crates/model/machine/src",
    "crates/board/max31865/src",
    "crates/board/modbus/src",
    "crates/board/node/src",
    "crates/board/pipe/src",
    "crates/board/signature/src",
    "crates/board/store/src",
];
const FIRMWARE_ENV_VAR: &str = "TRUEUP_FIRMWARE";

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed={FIRMWARE_ENV_VAR}");
    let package = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let root = package.join("../../..");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    // An image says its commit, so that one of another commit is another image.
    let with_commit = commit::emit_commit_env(&root);
    let is_release = env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let carried = match env::var(FIRMWARE_ENV_VAR).as_deref() {
        Ok("0") => false,
        Ok("1") => true,
        _ => is_release,
    };
    let folder = root.join("target/carried");
    if carried {
        for source in IMAGE_SOURCES {
            println!("cargo:rerun-if-changed={}", root.join(source).display());
        }
        // A build for tests stands in the folder that the project's own command is built in, and would
        // wait for itself.
        if is_release && !is_up_to_date(&root, &folder, &with_commit) {
            build_images(&root);
        }
    }
    let mut list = String::from("&[");
    for name in IMAGE_NAMES {
        let image = folder.join(name);
        if carried && image.is_file() {
            let image = image.canonicalize().expect("it is a file");
            list += &format!("({name:?}, include_bytes!({image:?}).as_slice()), ");
        } else if carried {
            // Tried again at the next build.
            println!("cargo:rerun-if-changed={}", image.display());
            println!("cargo:warning={name} is missing: trueup will come without it");
        }
    }
    fs::write(out.join("carried.rs"), list + "]").expect("OUT_DIR can be written");
}

/// Returns whether all images are there and none is older than what it is built from.
fn is_up_to_date(root: &Path, folder: &Path, with_commit: &[PathBuf]) -> bool {
    let changed = |path: &Path| fs::metadata(path).and_then(|metadata| metadata.modified()).ok();
    let images = IMAGE_NAMES.map(|name| changed(&folder.join(name)));
    let sources = IMAGE_SOURCES.iter().map(|source| root.join(source));
    let newest = sources
        .chain(with_commit.iter().cloned())
        .filter_map(|source| find_latest_modification_time(&source))
        .max();
    images.into_iter().min().flatten() > newest
}

/// When something in a folder, or a file, was last changed.
fn find_latest_modification_time(path: &Path) -> Option<SystemTime> {
    let Ok(entries) = fs::read_dir(path) else {
        return fs::metadata(path).and_then(|metadata| metadata.modified()).ok();
    };
    entries.flatten().filter_map(|entry| find_latest_modification_time(&entry.path())).max()
}

/// Builds the images as `cargo xtask images` does, in another profile's folder than this build.
fn build_images(root: &Path) {
    println!("cargo:warning=building the firmware images that trueup carries: some minutes");
    let mut command = Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
    command.args(["run", "--quiet", "--locked", "-p", "trueup-emulator", "--bin", "images"]);
    command.current_dir(root);
    // What is set for this build script is not meant for that build.
    for (name, _) in env::vars_os() {
        let name = name.to_string_lossy().into_owned();
        let is_ours = ["CARGO_CFG_", "CARGO_FEATURE_", "CARGO_PKG_", "DEP_", "CARGO_MANIFEST_"];
        if is_ours.iter().any(|prefix| name.starts_with(prefix))
            || ["CARGO_ENCODED_RUSTFLAGS", "OUT_DIR", "TARGET", "HOST", "PROFILE"]
                .contains(&name.as_str())
        {
            command.env_remove(name);
        }
    }
    let stderr = match command.output() {
        Ok(output) if output.status.success() => return,
        Ok(output) => String::from_utf8_lossy(&output.stderr).trim().replace('\n', " | "),
        Err(error) => error.to_string(),
    };
    println!("cargo:warning=the firmware images are not built: {stderr}");
}
