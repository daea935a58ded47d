//! The virtual board: the real firmware in QEMU, fed with blocks of one millisecond.
//!
//! The host puts blocks into a pipe, rings, and gets back the CAN frames that they caused, so both
//! stay in step however fast or slow either is. The serial line is QEMU's own, a byte stream that
//! lives next to it.

use std::{
    collections::VecDeque,
    fs::{File, OpenOptions, remove_file},
    io::{self, BufReader, Read, Write},
    os::unix::net::UnixStream,
    path::Path,
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::Duration,
};

use anyhow::{Context as _, Result};
use rustix::{
    fs::{CWD, FileType, Mode, mknodat},
    net::sockopt::set_socket_send_buffer_size,
};
use trueup_core::units::TimestampMs;
use trueup_link::frame::Frame;
use trueup_pipe::{Block, BoardRecord, RECORD_SIZE};

use crate::{
    log::LogDecoder,
    qemu::{self, BOOT_TIMEOUT, QemuProcess, SharedTempDir},
};

/// Blocks that can be announced with one ring: a byte.
pub const MAX_BATCH_BLOCKS: u32 = u8::MAX as u32;
/// Bytes that may wait for the board's serial line. On a computer that is busy the emulator takes in
/// less than a CNC says, and what waits for seconds is no longer the position. The kernel gives about
/// twice as much, and takes its own book-keeping from it.
pub(crate) const SERIAL_BUFFER_BYTES: usize = 4_096;

/// A running virtual board.
pub struct VirtualBoard {
    // Fields are dropped in this order: the pipes close before QEMU is ended.
    samples: File,
    frames: BufReader<File>,
    doorbell: UnixStream,
    serial: UnixStream,
    log: Arc<Mutex<Vec<String>>>,
    qemu: QemuProcess,
}

impl VirtualBoard {
    /// Boots an image with these bytes as its calibration, valid or not, and waits until it is up.
    ///
    /// # Errors
    /// QEMU is missing or ends, or the board does not come up in time.
    pub fn boot(image: &Path, calibration: &[u8]) -> Result<Self> {
        Self::boot_in_folder(qemu::create_temp_folder()?, image, calibration)
    }

    /// Ends this board as a power cut would, and boots it again: what it has stored, it finds.
    ///
    /// # Errors
    /// As [`VirtualBoard::boot`].
    pub fn restart(self, image: &Path, calibration: &[u8]) -> Result<Self> {
        let folder = self.qemu.folder();
        drop(self);
        Self::boot_in_folder(folder, image, calibration)
    }

    fn boot_in_folder(folder: SharedTempDir, image: &Path, calibration: &[u8]) -> Result<Self> {
        let decoder = LogDecoder::from_image(image)?;
        let mut qemu = QemuProcess::start_in_folder(
            folder,
            image,
            // QEMU waits for the host at the doorbell, so that the first word of the board is not
            // lost. The board's log goes to QEMU's standard output.
            &[
                "-chardev",
                "socket,id=doorbell,path=doorbell.sock,server=on,wait=on",
                "-semihosting-config",
                "enable=on,target=native",
                "-serial",
                "unix:serial.sock,server=on,wait=off",
                "-serial",
                "chardev:doorbell",
            ],
            |folder| {
                std::fs::write(folder.join("calibration.bin"), calibration)?;
                for pipe in ["samples", "frames"] {
                    // One of an earlier life would hold what that one has left unread.
                    remove_file(folder.join(pipe)).or_else(ignore_not_found)?;
                    mknodat(CWD, folder.join(pipe), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
                        .context("cannot make a pipe")?;
                }
                Ok(())
            },
        )?;
        // Held open both ways until the board has opened its ends, so that no side waits in `open`.
        let both = |name| OpenOptions::new().read(true).write(true).open(qemu.path(name));
        let held = [both("samples")?, both("frames")?];

        let log = Arc::new(Mutex::new(Vec::new()));
        let lines = log.clone();
        let source = qemu.take_stdout()?;
        thread::spawn(move || {
            let keep = |line| lines.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            if let Err(error) = decoder.decode_stream(source, keep) {
                trueup_output::write_diagnostic(format_args!("the board's log ends: {error:#}"));
            }
        });

        let doorbell = qemu.connect("doorbell.sock")?;
        let serial = qemu.connect("serial.sock")?;
        set_socket_send_buffer_size(&serial, SERIAL_BUFFER_BYTES)?;
        doorbell.set_read_timeout(Some(BOOT_TIMEOUT))?;
        let samples = OpenOptions::new().write(true).open(qemu.path("samples"))?;
        let frames = BufReader::new(File::open(qemu.path("frames"))?);
        let mut board = Self { samples, frames, doorbell, serial, log, qemu };
        board.wait_for_boot()?;
        drop(held);
        Ok(board)
    }

    /// Lets the board live through these blocks, at most [`MAX_BATCH_BLOCKS`], and gives what it sent
    /// on its CAN meanwhile.
    ///
    /// # Errors
    /// QEMU has ended.
    pub fn step(&mut self, blocks: &[Block]) -> Result<Vec<(TimestampMs, Frame)>> {
        let count = u8::try_from(blocks.len()).context("too many blocks for one batch")?;
        if count == 0 {
            return Ok(Vec::new());
        }
        let bytes = blocks.iter().map(Block::encode).collect::<Result<Vec<_>, _>>()?.concat();
        let rung = self.samples.write_all(&bytes).and_then(|()| self.doorbell.write_all(&[count]));
        if rung.is_err() {
            return Err(self.qemu.diagnose_channel_error("the board no longer takes samples"));
        }
        let mut sent = Vec::with_capacity(blocks.len() * 3);
        loop {
            let mut bytes = [0; RECORD_SIZE];
            if self.frames.read_exact(&mut bytes).is_err() {
                return Err(self.qemu.diagnose_channel_error("the board no longer sends frames"));
            }
            match BoardRecord::decode(&bytes).context("the board sent a broken record")? {
                BoardRecord::Frame { time, frame } => sent.push((time, frame)),
                BoardRecord::EndOfBatch { .. } => return Ok(sent),
                BoardRecord::Restart { .. } => {
                    self.wait_for_boot()?;
                    return Ok(sent);
                }
            }
        }
    }

    /// A board that starts or restarts says when it is up: rung before, it would not receive.
    fn wait_for_boot(&mut self) -> Result<()> {
        let mut ready = [0];
        if self.doorbell.read_exact(&mut ready).is_err() || ready != *b"R" {
            return Err(self.qemu.diagnose_channel_error("the board does not come up"));
        }
        Ok(())
    }

    /// Returns the CNC's end of the serial line, as QEMU has it: the caller must read on, because
    /// QEMU stops when a few hundred bytes wait there.
    ///
    /// # Errors
    /// The socket cannot be shared.
    pub fn try_clone_serial(&self) -> Result<UnixStream> {
        Ok(self.serial.try_clone()?)
    }

    /// Returns the CNC's end of the serial line, for one who reads when it suits him.
    ///
    /// # Errors
    /// The socket cannot be shared.
    pub fn open_buffered_serial(&self) -> Result<BufferedSerial> {
        let (sender, received) = mpsc::channel();
        let mut source = self.try_clone_serial()?;
        thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(length @ 1..) = source.read(&mut bytes) {
                if sender.send(bytes[..length].to_vec()).is_err() {
                    break;
                }
            }
        });
        Ok(BufferedSerial { writer: self.try_clone_serial()?, received, rest: VecDeque::new() })
    }

    /// Returns the board's log so far.
    #[must_use]
    pub fn log(&self) -> Vec<String> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the board's log since it was last taken.
    #[must_use]
    pub fn take_log(&self) -> Vec<String> {
        std::mem::take(&mut self.log.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Returns what the board keeps when its power goes: [`VirtualBoard::restart`] finds it there.
    #[must_use]
    pub fn flash_path(&self) -> std::path::PathBuf {
        self.qemu.path("flash.bin")
    }

    /// Returns the emulator it runs in.
    pub(crate) fn qemu_mut(&mut self) -> &mut QemuProcess {
        &mut self.qemu
    }
}

fn ignore_not_found(error: io::Error) -> io::Result<()> {
    if error.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(error) }
}

/// The CNC's end of the serial line: it takes in whatever comes, and a read waits 20 s at most.
pub struct BufferedSerial {
    writer: UnixStream,
    received: mpsc::Receiver<Vec<u8>>,
    rest: VecDeque<u8>,
}

impl BufferedSerial {
    /// How long a board may take to say something.
    const READ_TIMEOUT: Duration = Duration::from_secs(20);
}

impl Read for BufferedSerial {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.rest.is_empty() {
            match self.received.recv_timeout(Self::READ_TIMEOUT) {
                Ok(bytes) => self.rest.extend(bytes),
                Err(RecvTimeoutError::Disconnected) => return Ok(0),
                Err(RecvTimeoutError::Timeout) => {
                    let seconds = Self::READ_TIMEOUT.as_secs();
                    let message = format!("the board has sent nothing for {seconds} s");
                    return Err(io::Error::new(io::ErrorKind::TimedOut, message));
                }
            }
        }
        self.rest.read(buffer)
    }
}

impl Write for BufferedSerial {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
