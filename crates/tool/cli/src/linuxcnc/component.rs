//! `trueup linuxcnc component`: the realtime component of a bridge without a board, built for the LinuxCNC of this computer.
//!
//! The part in C is linked to LinuxCNC's headers, so it is compiled here, by the makefile of `linuxcnc-uspace-dev`. The
//! bridge itself comes as a static library with each release.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;
use trueup_servo::component::{COMPONENT_C_HEADER, COMPONENT_C_SOURCE, LIBRARY_FILE_NAME};

use crate::{CommandOutcome, UserError, output};

const REALTIME_COMPONENT_NAME: &str = "trueup_node";
/// Sections that nothing calls are omitted: the library has more than a bridge needs.
const COMPONENT_MAKEFILE: &str = "obj-m += trueup_node.o\n\
    trueup_node-objs := trueup_node.o libtrueup_servo.a\n\
    include $(shell halcompile --print-modinc)\n";

/// Where it is built.
#[derive(Args)]
pub struct ComponentArgs {
    /// Copies it to LinuxCNC's modules, by the makefile's own install; asks for the rights it needs (sudo).
    #[arg(long)]
    install: bool,
    /// The folder in which it is built.
    #[arg(long, value_name = "DIR", default_value = "trueup_node")]
    out: PathBuf,
    /// The library trueup_servo. Without this the one that came with trueup.
    #[arg(long, value_name = "FILE")]
    library: Option<PathBuf>,
}

/// Builds it, and installs it if requested.
pub fn run(args: &ComponentArgs, as_json: bool) -> Result<CommandOutcome> {
    let library = find_servo_library(args.library.as_deref())?;
    if Command::new("halcompile").arg("--print-modinc").output().is_err() {
        let rule = "halcompile is not installed: sudo apt-get install linuxcnc-uspace-dev";
        return Err(UserError(rule.into()).into());
    }
    let out = &args.out;
    fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let texts = [
        ("trueup_node.c", COMPONENT_C_SOURCE),
        ("trueup_servo.h", COMPONENT_C_HEADER),
        ("Makefile", COMPONENT_MAKEFILE),
    ];
    for (name, text) in texts {
        output::write_atomically(&out.join(name), &[], |to| to.write_all(text.as_bytes()))?;
    }
    let copy = out.join(LIBRARY_FILE_NAME);
    fs::copy(&library, &copy).with_context(|| format!("{} cannot be written", copy.display()))?;
    run_make(out, &["modules"], false)?;
    let module = out.join(format!("{REALTIME_COMPONENT_NAME}.so"));
    if args.install {
        run_make(out, &["install"], !is_root()?)?;
    }
    if as_json {
        output::print(json!({"module": module, "installed": args.install}))?;
    } else if args.install {
        output::print(format!(
            "installed: {REALTIME_COMPONENT_NAME}; then: trueup linuxcnc setup INI --machine M.toml --no-board"
        ))?;
    } else {
        output::print(format!("built: {}; install it with --install", module.display()))?;
    }
    Ok(CommandOutcome::Done)
}

/// Runs make in a folder.
fn run_make(folder: &Path, targets: &[&str], as_root: bool) -> Result<()> {
    let mut command = Command::new(if as_root { "sudo" } else { "make" });
    if as_root {
        command.arg("make");
    }
    command.arg("-C").arg(folder).arg("LDFLAGS=-Wl,--gc-sections").args(targets);
    let done =
        command.output().context("make cannot be started: sudo apt-get install build-essential")?;
    if done.status.success() {
        return Ok(());
    }
    let stderr = String::from_utf8_lossy(&done.stderr);
    Err(UserError(format!("make {} failed in {}:\n{stderr}", targets.join(" "), folder.display()))
        .into())
}

/// Returns the library: as given, else where a release has it, next to the program or in its `lib`.
fn find_servo_library(given: Option<&Path>) -> Result<PathBuf> {
    if let Some(path) = given {
        let missing = || UserError(format!("{}: there is no such file", path.display())).into();
        return if path.is_file() { Ok(path.to_path_buf()) } else { Err(missing()) };
    }
    let program = env::current_exe().and_then(fs::canonicalize).unwrap_or_default();
    let folder = program.parent().unwrap_or(Path::new(""));
    let places =
        [folder.join(LIBRARY_FILE_NAME), folder.join("../lib/trueup").join(LIBRARY_FILE_NAME)];
    places.iter().find(|path| path.is_file()).cloned().ok_or_else(|| {
        UserError(format!(
            "{LIBRARY_FILE_NAME} is not next to {}, where a release has it. Give it with \
             --library FILE, or build it from the source: cargo rustc -p trueup-servo --lib \
             --profile servo --crate-type staticlib -- --cfg trueup_library",
            program.display()
        ))
        .into()
    })
}

fn is_root() -> Result<bool> {
    Ok(Command::new("id").arg("-u").output().context("id cannot be started")?.stdout == b"0\n")
}
