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
    qemu::{self, QEMU_PROGRAM as QEMU},
    stale_shared_memory,
};

/// The processor of the STM32F405.
pub const TARGET_TRIPLE: &str = "thumbv7em-none-eabihf";
/// Set to "distribution" it forces the second way to the target.
pub const TOOLCHAIN_ENV_VAR: &str = "TRUEUP_TOOLCHAIN";

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
pub fn project_root() -> PathBuf {
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
pub(crate) fn ensure_toolchain() -> Result<Toolchain> {
    let _alone = lock_setup()?;
    let forced = std::env::var(TOOLCHAIN_ENV_VAR).unwrap_or_default();
    match forced.as_str() {
        "" | "rustup" => {}
        "distribution" => return ensure_distribution_toolchain().map(|()| Toolchain::Distribution),
        other => {
            bail!("{TOOLCHAIN_ENV_VAR} is \"{other}\": it takes \"rustup\" or \"distribution\"")
        }
    }
    match ensure_target_installed() {
        Ok(()) => Ok(Toolchain::Rustup),
        Err(first) if forced.is_empty() => {
            trueup_output::write_diagnostic(format_args!(
                "{first:#}; trying the distribution's compiler"
            ));
            ensure_distribution_toolchain().map_err(|second| {
                second.context(format!(
                    "the target {TARGET_TRIPLE} cannot be installed; the first way failed: {first:#}"
                ))
            })?;
            Ok(Toolchain::Distribution)
        }
        Err(error) => Err(error),
    }
}

/// Waits until no other command or test of the project is installing anything; as long as the file
/// that it gives is open, none begins.
fn lock_setup() -> Result<File> {
    let folder = project_root().join("target");
    fs::create_dir_all(&folder)?;
    let lock = File::create(folder.join("setup.lock"))?;
    flock(&lock, FlockOperation::LockExclusive)?;
    Ok(lock)
}

fn ensure_target_installed() -> Result<()> {
    if is_target_installed() {
        return Ok(());
    }
    let mut add = Command::new("rustup");
    add.args(["target", "add", TARGET_TRIPLE]);
    trueup_output::write_diagnostic(format_args!(
        "the compiler lacks {TARGET_TRIPLE}; running `{}`",
        process::format_command_line(&add)
    ));
    process::run(&mut add)?;
    if !is_target_installed() {
        bail!("rustup added {TARGET_TRIPLE}, but not to the compiler in use");
    }
    Ok(())
}

fn is_target_installed() -> bool {
    let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
    process::capture_stdout(Command::new(rustc).args([
        "--print",
        "target-libdir",
        "--target",
        TARGET_TRIPLE,
    ]))
    .is_ok_and(|folder| {
        fs::read_dir(folder.trim()).is_ok_and(|mut files| {
            files.any(|file| {
                file.is_ok_and(|file| file.file_name().to_string_lossy().starts_with("libcore-"))
            })
        })
    })
}

fn ensure_distribution_toolchain() -> Result<()> {
    // Debian's compiler comes without the linker that the target asks for.
    let packages = ["rustc-web", "cargo-web", "rust-web-src", "lld"];
    if !packages.iter().all(|package| is_package_installed(package)) {
        install_packages(&packages, "the distribution's compiler and library source")?;
    }
    Ok(())
}

/// Makes sure that QEMU is there and new enough; gives its path.
///
/// # Errors
/// It is missing and cannot be installed, or it is too old.
pub fn ensure_qemu() -> Result<PathBuf> {
    let _alone = lock_setup()?;
    if process::find_on_path(QEMU).is_none() {
        install_packages(&[QEMU], "QEMU, the emulator")?;
    }
    qemu::find_qemu()
}

/// Makes sure that the Python clients of the tests are there, in an environment of the project's
/// own; gives its interpreter.
///
/// # Errors
/// No Python, or the packages cannot be had.
pub fn ensure_python() -> Result<PathBuf> {
    let _alone = lock_setup()?;
    let requirements = project_root().join("host-tests/python/requirements.txt");
    let requested = fs::read_to_string(&requirements).context("the list of Python packages")?;
    let folder = project_root().join("target/python");
    let python = folder.join("bin/python");
    let stamp = folder.join("installed.txt");
    if fs::read_to_string(&stamp).is_ok_and(|installed| installed == requested) {
        return Ok(python);
    }
    if process::find_on_path("python3").is_none() {
        install_packages(&["python3", "python3-venv"], "Python, for the CAN clients of the tests")?;
    }
    trueup_output::write_diagnostic("installing the Python CAN clients into target/python");
    let make = |python: &str| {
        process::run(Command::new(python).args(["-m", "venv", "--clear"]).arg(&folder))
    };
    if make("python3").is_err() {
        install_packages(&["python3-venv"], "Python's virtual environments")?;
        // Another Python may stand before the distribution's on PATH.
        make("python3").or_else(|_| make("/usr/bin/python3"))?;
    }
    // By their hashes: no other package can be put under a requested name.
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
    fs::write(stamp, requested)?;
    Ok(python)
}

/// LinuxCNC, locked against other users until this is dropped: all instances on a computer share one key of
/// shared memory, so only one can run.
#[derive(Debug)]
pub struct LockedLinuxCnc {
    program: PathBuf,
    _alone: File,
}

impl LockedLinuxCnc {
    /// Returns the path of its start script.
    #[must_use]
    pub fn program(&self) -> &Path {
        &self.program
    }
}

/// Makes sure that LinuxCNC is there, waits until no other test runs it and removes what a killed one left; `None` where
/// the distribution has no package of it.
///
/// # Errors
/// There is a package, but it cannot be installed.
pub fn install_and_lock_linuxcnc() -> Result<Option<LockedLinuxCnc>> {
    const LINUXCNC_PROGRAM: &str = "linuxcnc";
    const LINUXCNC_PACKAGE: &str = "linuxcnc-uspace";
    let installing = lock_setup()?;
    if process::find_on_path(LINUXCNC_PROGRAM).is_none() {
        if process::find_on_path("apt-get").is_none() {
            return Ok(None);
        }
        if let Err(error) =
            install_packages(&[LINUXCNC_PACKAGE], "LinuxCNC, to load what is exported to it")
        {
            // Only now are the lists of packages up to date: is there one at all?
            let mut show = Command::new("apt-cache");
            if process::capture_stdout(show.args(["show", LINUXCNC_PACKAGE])).is_err() {
                return Ok(None);
            }
            return Err(error);
        }
    }
    drop(installing);
    let program =
        process::find_on_path(LINUXCNC_PROGRAM).context("linuxcnc is installed but not on PATH")?;
    let alone = File::create(project_root().join("target/linuxcnc.lock"))?;
    flock(&alone, FlockOperation::LockExclusive)?;
    stale_shared_memory::remove_hal_segments()?;
    Ok(Some(LockedLinuxCnc { program, _alone: alone }))
}

/// Makes sure that a component of LinuxCNC can be compiled here.
///
/// # Errors
/// Something is missing and cannot be installed.
pub fn ensure_linuxcnc_dev() -> Result<()> {
    const LINUXCNC_PACKAGE: &str = "linuxcnc-uspace-dev";
    let _alone = lock_setup()?;
    if process::find_on_path("halcompile").is_none() || process::find_on_path("make").is_none() {
        install_packages(
            &[LINUXCNC_PACKAGE, "make", "gcc"],
            "the makefile and headers of LinuxCNC",
        )?;
    }
    Ok(())
}

/// Makes sure that valgrind is there, which counts instructions.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn ensure_valgrind() -> Result<()> {
    ensure_program("valgrind", "valgrind", "valgrind, to count instructions").map(drop)
}

/// Returns the path of `ensure_log2asc`, one of the can-utils, for the tests of recordings.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn ensure_log2asc() -> Result<PathBuf> {
    ensure_program("log2asc", "can-utils", "can-utils, to read what the tool has recorded")
}

/// Returns the path of `ensure_mbpoll`, a Modbus master, for the tests of the gateway.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn ensure_mbpoll() -> Result<PathBuf> {
    ensure_program("mbpoll", "mbpoll", "mbpoll, a Modbus master")
}

/// Returns the path of `ensure_mosquitto`, an MQTT broker, for the tests of what is published.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn ensure_mosquitto() -> Result<PathBuf> {
    ensure_program("mosquitto", "mosquitto", "mosquitto, an MQTT broker")
}

/// Makes sure of what the quick tests need: all but LinuxCNC, which is large.
///
/// # Errors
/// Something is missing and cannot be had here.
pub fn install_quick_test_dependencies() -> Result<()> {
    ensure_toolchain()?;
    ensure_qemu()?;
    ensure_python()?;
    ensure_log2asc()?;
    ensure_mbpoll()?;
    ensure_mosquitto()?;
    Ok(())
}

/// Everything at once, for `cargo xtask setup` and the long tests.
///
/// # Errors
/// Something is missing and cannot be had here.
pub fn install_all_dependencies() -> Result<()> {
    install_quick_test_dependencies()?;
    install_and_lock_linuxcnc()?;
    Ok(())
}

/// Returns where a program is, which its package brings if it is not there.
fn ensure_program(name: &str, package: &str, what: &str) -> Result<PathBuf> {
    let place = || {
        // Debian has services where only the administrator's PATH leads.
        let of_service = Path::new("/usr/sbin").join(name);
        process::find_on_path(name).or_else(|| of_service.is_file().then_some(of_service))
    };
    let _alone = lock_setup()?;
    if place().is_none() {
        install_packages(&[package], what)?;
    }
    place().with_context(|| format!("{package} is installed but {name} is not on PATH"))
}

fn is_package_installed(package: &str) -> bool {
    process::capture_stdout(Command::new("dpkg-query").args(["-W", "-f", "${Status}", package]))
        .is_ok_and(|status| status == "install ok installed")
}

/// Installs packages of the distribution, or says how.
fn install_packages(packages: &[&str], what: &str) -> Result<()> {
    let by_hand = format!("sudo apt-get update && sudo apt-get install -y {}", packages.join(" "));
    if process::find_on_path("apt-get").is_none() {
        bail!(
            "{what} is missing, and this is not Debian or Ubuntu; install: {}",
            packages.join(" ")
        );
    }
    let root =
        process::capture_stdout(Command::new("id").arg("-u")).is_ok_and(|id| id.trim() == "0");
    let sudo = || process::capture_stdout(Command::new("sudo").args(["-n", "true"])).is_ok();
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
    trueup_output::write_diagnostic(format_args!(
        "{what} is missing; installing: {}",
        packages.join(" ")
    ));
    apt(&["update"])
        .and_then(|()| apt(&[&["install", "-y", "--no-install-recommends"], packages].concat()))
        .with_context(|| format!("{what} could not be installed; by hand:\n    {by_hand}"))
}
