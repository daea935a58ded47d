//! Installs what a fresh machine lacks: the compiler's target, QEMU, the Python clients.
//!
//! Nothing is installed in silence: a line says what is about to be, and where this may not be
//! done, the error has the exact line to type.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, bail};
use rustix::fs::{FlockOperation, flock};

use crate::{
    process,
    qemu::{self, PROGRAM as QEMU},
};

/// The processor of the STM32F405.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// Set to `distribution` it forces the second way to the target.
pub const TOOLCHAIN_VARIABLE: &str = "TRUEUP_TOOLCHAIN";

/// The compiler of the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Toolchain {
    /// The compiler that runs this, with the target added by rustup.
    Rustup,
    /// The distribution's compiler, which builds `core` from the distribution's source.
    Distribution,
}

/// Returns the root of the project, wherever the command was called. Cargo says at run time which package
/// it runs; what was compiled in may be out of date, because a folder can be moved.
#[must_use]
pub fn root() -> PathBuf {
    // What is handed out knows no folder of the computer that built it, or it would be another file on each.
    let here = if cfg!(debug_assertions) { env!("CARGO_MANIFEST_DIR") } else { "" };
    let compiled_in = Path::new(here);
    let running = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    let above = |package: &Path| {
        package.ancestors().find(|folder| folder.join("src/memory.x").is_file()).map(Path::to_owned)
    };
    running
        .and_then(|package| above(&package))
        .or_else(|| above(compiled_in))
        .unwrap_or_else(|| compiled_in.to_owned())
}

/// Makes sure that the firmware can be compiled.
///
/// # Errors
/// Neither way works here; the error has both reasons.
pub(crate) fn toolchain() -> Result<Toolchain> {
    let _alone = alone()?;
    let forced = std::env::var(TOOLCHAIN_VARIABLE).unwrap_or_default();
    match forced.as_str() {
        "" | "rustup" => {}
        "distribution" => return distribution().map(|()| Toolchain::Distribution),
        other => {
            bail!("{TOOLCHAIN_VARIABLE} is \"{other}\": it takes \"rustup\" or \"distribution\"")
        }
    }
    match rustup() {
        Ok(()) => Ok(Toolchain::Rustup),
        Err(first) if forced.is_empty() => {
            trueup_output::diagnostic(format_args!(
                "{first:#}; trying the distribution's compiler"
            ));
            distribution().map_err(|second| {
                second.context(format!(
                    "the target {TARGET} cannot be installed; the first way failed: {first:#}"
                ))
            })?;
            Ok(Toolchain::Distribution)
        }
        Err(error) => Err(error),
    }
}

/// Waits until no other command or test of the project is installing anything; as long as the file
/// that it gives is open, none begins.
fn alone() -> Result<File> {
    let folder = root().join("target");
    fs::create_dir_all(&folder)?;
    let lock = File::create(folder.join("setup.lock"))?;
    flock(&lock, FlockOperation::LockExclusive)?;
    Ok(lock)
}

fn rustup() -> Result<()> {
    if target_is_there() {
        return Ok(());
    }
    let mut add = Command::new("rustup");
    add.args(["target", "add", TARGET]);
    trueup_output::diagnostic(format_args!(
        "the compiler lacks {TARGET}; running `{}`",
        process::line(&add)
    ));
    process::run(&mut add)?;
    if !target_is_there() {
        bail!("rustup added {TARGET}, but not to the compiler in use");
    }
    Ok(())
}

fn target_is_there() -> bool {
    let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
    process::output(Command::new(rustc).args(["--print", "target-libdir", "--target", TARGET]))
        .is_ok_and(|folder| {
            fs::read_dir(folder.trim()).is_ok_and(|mut files| {
                files.any(|file| {
                    file.is_ok_and(|file| {
                        file.file_name().to_string_lossy().starts_with("libcore-")
                    })
                })
            })
        })
}

fn distribution() -> Result<()> {
    // Debian's compiler comes without the linker that the target asks for.
    let packages = ["rustc-web", "cargo-web", "rust-web-src", "lld"];
    if !packages.iter().all(|package| is_installed(package)) {
        install(&packages, "the distribution's compiler and library source")?;
    }
    Ok(())
}

/// Makes sure that QEMU is there and new enough; gives its path.
///
/// # Errors
/// It is missing and cannot be installed, or it is too old.
pub fn qemu() -> Result<PathBuf> {
    let _alone = alone()?;
    if process::find(QEMU).is_none() {
        install(&[QEMU], "QEMU, the emulator")?;
    }
    qemu::program()
}

/// Makes sure that the Python clients of the tests are there, in an environment of the project's
/// own; gives its interpreter.
///
/// # Errors
/// No Python, or the packages cannot be had.
pub fn python() -> Result<PathBuf> {
    let _alone = alone()?;
    let requirements = root().join("host-tests/python/requirements.txt");
    let wanted = fs::read_to_string(&requirements).context("the list of Python packages")?;
    let folder = root().join("target/python");
    let python = folder.join("bin/python");
    let stamp = folder.join("installed.txt");
    if fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(python);
    }
    if process::find("python3").is_none() {
        install(&["python3", "python3-venv"], "Python, for the CAN clients of the tests")?;
    }
    trueup_output::diagnostic("installing the Python CAN clients into target/python");
    let make = |python: &str| {
        process::run(Command::new(python).args(["-m", "venv", "--clear"]).arg(&folder))
    };
    if make("python3").is_err() {
        install(&["python3-venv"], "Python's virtual environments")?;
        // Another Python may stand before the distribution's on PATH.
        make("python3").or_else(|_| make("/usr/bin/python3"))?;
    }
    // By their hashes: nobody can put another package under a name that is asked for.
    let pip = [
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--require-hashes",
        "-r",
    ];
    process::run(Command::new(&python).args(pip).arg(&requirements))?;
    fs::write(stamp, wanted)?;
    Ok(python)
}

/// LinuxCNC, locked against other users until this is dropped: all instances on a computer share one key of
/// shared memory, so only one can run.
#[derive(Debug)]
pub struct LinuxCnc {
    program: PathBuf,
    _alone: File,
}

impl LinuxCnc {
    /// Returns the path of its start script.
    #[must_use]
    pub fn program(&self) -> &Path {
        &self.program
    }
}

/// Makes sure that LinuxCNC is there, and waits until no other test runs it; `None` where the
/// distribution has no package of it.
///
/// # Errors
/// There is a package, but it cannot be installed.
pub fn linuxcnc() -> Result<Option<LinuxCnc>> {
    const PROGRAM: &str = "linuxcnc";
    const PACKAGE: &str = "linuxcnc-uspace";
    let installing = alone()?;
    if process::find(PROGRAM).is_none() {
        if process::find("apt-get").is_none() {
            return Ok(None);
        }
        if let Err(error) = install(&[PACKAGE], "LinuxCNC, to load what is exported to it") {
            // Only now are the lists of packages up to date: is there one at all?
            let mut show = Command::new("apt-cache");
            if process::output(show.args(["show", PACKAGE])).is_err() {
                return Ok(None);
            }
            return Err(error);
        }
    }
    drop(installing);
    let program = process::find(PROGRAM).context("linuxcnc is installed but not on PATH")?;
    let alone = File::create(root().join("target/linuxcnc.lock"))?;
    flock(&alone, FlockOperation::LockExclusive)?;
    Ok(Some(LinuxCnc { program, _alone: alone }))
}

/// Makes sure that a component of LinuxCNC can be compiled here.
///
/// # Errors
/// Something is missing and cannot be installed.
pub fn linuxcnc_dev() -> Result<()> {
    const PACKAGE: &str = "linuxcnc-uspace-dev";
    let _alone = alone()?;
    if process::find("halcompile").is_none() || process::find("make").is_none() {
        install(&[PACKAGE, "make", "gcc"], "the makefile and headers of LinuxCNC")?;
    }
    Ok(())
}

/// Makes sure that valgrind is there, which counts instructions.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn valgrind() -> Result<()> {
    let _alone = alone()?;
    if process::find("valgrind").is_none() {
        install(&["valgrind"], "valgrind, to count instructions")?;
    }
    Ok(())
}

/// Returns the path of `log2asc`, one of the can-utils, for the tests of recordings.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn log2asc() -> Result<PathBuf> {
    const PROGRAM: &str = "log2asc";
    let _alone = alone()?;
    if process::find(PROGRAM).is_none() {
        install(&["can-utils"], "can-utils, to read what the tool has recorded")?;
    }
    process::find(PROGRAM).context("can-utils is installed but log2asc is not on PATH")
}

/// Returns the path of `mbpoll`, a Modbus master, for the tests of the gateway.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn mbpoll() -> Result<PathBuf> {
    const PROGRAM: &str = "mbpoll";
    let _alone = alone()?;
    if process::find(PROGRAM).is_none() {
        install(&[PROGRAM], "mbpoll, a Modbus master")?;
    }
    process::find(PROGRAM).context("mbpoll is installed but not on PATH")
}

/// Returns the path of `mosquitto`, an MQTT broker, for the tests of what is published.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn mosquitto() -> Result<PathBuf> {
    const PROGRAM: &str = "mosquitto";
    // Debian has it where only the administrator's PATH leads.
    let place = || {
        let other = PathBuf::from("/usr/sbin").join(PROGRAM);
        process::find(PROGRAM).or_else(|| other.is_file().then_some(other))
    };
    let _alone = alone()?;
    if place().is_none() {
        install(&[PROGRAM], "mosquitto, an MQTT broker")?;
    }
    place().context("mosquitto is installed but not on PATH")
}

/// Makes sure of what the quick tests need: all but LinuxCNC, which is large.
///
/// # Errors
/// Something is missing and cannot be had here.
pub fn quick() -> Result<()> {
    toolchain()?;
    qemu()?;
    python()?;
    log2asc()?;
    mbpoll()?;
    mosquitto()?;
    Ok(())
}

/// Everything at once, for `cargo xtask setup` and the long tests.
///
/// # Errors
/// Something is missing and cannot be had here.
pub fn everything() -> Result<()> {
    quick()?;
    linuxcnc()?;
    Ok(())
}

fn is_installed(package: &str) -> bool {
    process::output(Command::new("dpkg-query").args(["-W", "-f", "${Status}", package]))
        .is_ok_and(|status| status == "install ok installed")
}

/// Installs packages of the distribution, or says how.
fn install(packages: &[&str], what: &str) -> Result<()> {
    let by_hand = format!("sudo apt-get update && sudo apt-get install -y {}", packages.join(" "));
    if process::find("apt-get").is_none() {
        bail!(
            "{what} is missing, and this is not Debian or Ubuntu; install: {}",
            packages.join(" ")
        );
    }
    let root = process::output(Command::new("id").arg("-u")).is_ok_and(|id| id.trim() == "0");
    let sudo = || process::output(Command::new("sudo").args(["-n", "true"])).is_ok();
    if !root && !sudo() {
        bail!("{what} is missing and this user may not install it; run:\n    {by_hand}");
    }
    let apt = |arguments: &[&str]| {
        let mut command = if root { Command::new("apt-get") } else { Command::new("sudo") };
        if !root {
            command.args(["-n", "apt-get"]);
        }
        command.args(["-qq", "-o", "DPkg::Lock::Timeout=300"]).args(arguments);
        process::run(command.env("DEBIAN_FRONTEND", "noninteractive"))
    };
    trueup_output::diagnostic(format_args!(
        "{what} is missing; installing: {}",
        packages.join(" ")
    ));
    apt(&["update"])
        .and_then(|()| apt(&[&["install", "-y", "--no-install-recommends"], packages].concat()))
        .with_context(|| format!("{what} could not be installed; by hand:\n    {by_hand}"))
}
