//! One QEMU with one image in it, ended with its owner.

use std::{
    fs,
    io::Read,
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, Stdio},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};

use crate::program::{capture_stdout, find_on_path};

/// The emulator's program, and the package that has it.
pub const QEMU_PROGRAM: &str = "qemu-system-arm";
/// The oldest version that has what the board needs.
const MIN_QEMU_VERSION: (u32, u32) = (7, 2);

/// How long QEMU may take to open its sockets, and the board to say that it is up.
pub(crate) const BOOT_TIMEOUT: Duration = Duration::from_secs(30);

/// The longest path that the kernel takes for a socket, in bytes.
const MAX_SOCKET_PATH_BYTES: usize = 107;

/// Returns the path of QEMU.
///
/// # Errors
/// It is not on the search path, or it is too old.
pub fn find_qemu() -> Result<PathBuf> {
    let path = find_on_path(QEMU_PROGRAM).context("qemu-system-arm is not on PATH")?;
    let stdout = capture_stdout(Command::new(&path).arg("--version"))?;
    let version = stdout.split("version ").nth(1).unwrap_or_default();
    let mut numbers = version.split('.').map(|number| number.parse::<u32>().unwrap_or(0));
    let version = (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0));
    if version < MIN_QEMU_VERSION {
        bail!(
            "{} is version {}.{}; {}.{} or newer is needed",
            path.display(),
            version.0,
            version.1,
            MIN_QEMU_VERSION.0,
            MIN_QEMU_VERSION.1
        );
    }
    Ok(path)
}

/// A folder that is removed with the last emulator in it.
pub type SharedTempDir = Arc<tempfile::TempDir>;

/// Returns a new, empty one.
///
/// # Errors
/// There is no place for temporary files.
pub(crate) fn create_temp_folder() -> Result<SharedTempDir> {
    Ok(Arc::new(tempfile::Builder::new().prefix("trueup-").tempdir()?))
}

/// A running emulator. Dropping it ends the process.
pub struct QemuProcess {
    child: Child,
    folder: SharedTempDir,
}

impl QemuProcess {
    /// Starts the image in a folder of its own, which `prepare` fills first. `arguments` are QEMU's
    /// beyond machine and image; its working directory is the folder.
    ///
    /// # Errors
    /// QEMU is missing or too old, or does not start.
    pub fn start(
        image: &Path,
        arguments: &[&str],
        prepare: impl FnOnce(&Path) -> Result<()>,
    ) -> Result<Self> {
        Self::start_in_folder(create_temp_folder()?, image, arguments, prepare)
    }

    /// The same in a folder that there is already: what an earlier image has left, this one finds.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub(crate) fn start_in_folder(
        folder: SharedTempDir,
        image: &Path,
        arguments: &[&str],
        prepare: impl FnOnce(&Path) -> Result<()>,
    ) -> Result<Self> {
        let qemu = find_qemu()?;
        let image = fs::canonicalize(image)
            .with_context(|| format!("there is no firmware image {}", image.display()))?;
        let longest = folder.path().as_os_str().len() + "/doorbell.sock".len();
        if longest > MAX_SOCKET_PATH_BYTES {
            bail!(
                "the folder for temporary files, {}, is too long a name for a socket in it; set \
                   TMPDIR to a shorter one",
                folder.path().display()
            );
        }
        prepare(folder.path())?;
        // With setpriv the kernel ends QEMU when this process dies, however it dies.
        let mut command = match find_on_path("setpriv") {
            Some(setpriv) => {
                let mut command = Command::new(setpriv);
                command.args(["--pdeathsig", "KILL"]).arg(qemu);
                command
            }
            None => Command::new(qemu),
        };
        command
            .args(["-machine", "netduinoplus2", "-display", "none", "-monitor", "none"])
            .arg("-kernel")
            .arg(image)
            .args(arguments)
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(fs::File::create(folder.path().join("qemu.err"))?);
        let child = command.spawn().context("cannot start QEMU")?;
        Ok(Self { child, folder })
    }

    /// Returns a path in the emulator's folder.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns the emulator's folder.
    #[must_use]
    pub fn folder(&self) -> SharedTempDir {
        self.folder.clone()
    }

    /// Returns the process id, for those who want to end it from outside.
    #[must_use]
    pub(crate) fn process_id(&self) -> u32 {
        self.child.id()
    }

    /// Returns what the image writes by semihosting; it can be taken once.
    ///
    /// # Errors
    /// It was taken before.
    pub(crate) fn take_stdout(&mut self) -> Result<ChildStdout> {
        self.child.stdout.take().context("QEMU's standard output is taken")
    }

    /// Connects to a socket that QEMU opens.
    ///
    /// # Errors
    /// QEMU has ended, or does not open it in time.
    pub fn connect(&mut self, name: &str) -> Result<UnixStream> {
        let end = Instant::now() + BOOT_TIMEOUT;
        loop {
            if let Ok(stream) = UnixStream::connect(self.path(name)) {
                return Ok(stream);
            }
            self.check_running()?;
            if Instant::now() > end {
                bail!("QEMU does not open its socket {name}");
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Fails if QEMU has ended, with its output.
    ///
    /// # Errors
    /// It has.
    pub fn check_running(&mut self) -> Result<()> {
        if let Some(status) = self.child.try_wait()? {
            bail!("QEMU has ended ({status}){}", self.read_stderr());
        }
        Ok(())
    }

    /// Returns the error for a channel to the board that has broken off.
    #[must_use]
    pub(crate) fn diagnose_channel_error(&mut self, what: &str) -> anyhow::Error {
        // The pipes close a moment before the process can be seen to have ended.
        for _ in 0..100 {
            if let Err(error) = self.check_running() {
                return error.context(what.to_owned());
            }
            thread::sleep(Duration::from_millis(10));
        }
        anyhow::anyhow!("{what}, though QEMU is still running{}", self.read_stderr())
    }

    fn read_stderr(&self) -> String {
        let mut text = String::new();
        let read =
            fs::File::open(self.path("qemu.err")).and_then(|mut f| f.read_to_string(&mut text));
        match (read, text.trim()) {
            (Ok(_), "") | (Err(_), _) => String::new(),
            (Ok(_), text) => format!(": {text}"),
        }
    }
}

impl Drop for QemuProcess {
    fn drop(&mut self) {
        // It may have ended already; there is nothing else to do about a failure here.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
