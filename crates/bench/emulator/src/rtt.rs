//! The log of the flashable image, which goes to a probe through a buffer in RAM (RTT). In QEMU
//! there is no probe: the monitor saves the RAM, and the log is read from that.

use std::{
    fs,
    io::{BufRead as _, BufReader, Write as _},
    os::unix::net::UnixStream,
    path::Path,
    time::Duration,
};

use anyhow::{Context as _, Result, bail, ensure};
use object::{Object as _, ObjectSymbol as _};
use serde_json::{Value, json};

use crate::{log::LogDecoder, qemu::QemuProcess};

/// QEMU's arguments for a monitor that [`QemuMonitor::connect`] finds.
pub const QEMU_MONITOR_ARGUMENTS: [&str; 2] = ["-qmp", "unix:qmp.sock,server=on,wait=off"];

const RAM_START: u64 = 0x2000_0000;
const RAM_SIZE: u64 = 128 * 1024;

/// QEMU's monitor.
pub struct QemuMonitor {
    lines: BufReader<UnixStream>,
}

impl QemuMonitor {
    /// Connects to the monitor of an emulator that was started with [`QEMU_MONITOR_ARGUMENTS`].
    ///
    /// # Errors
    /// QEMU has ended, or is not QEMU.
    pub fn connect(qemu: &mut QemuProcess) -> Result<Self> {
        let stream = qemu.connect("qmp.sock")?;
        stream.set_read_timeout(Some(Duration::from_secs(10)))?;
        let mut monitor = Self { lines: BufReader::new(stream) };
        monitor.read_message()?;
        monitor.execute(&json!({"execute": "qmp_capabilities"}))?;
        Ok(monitor)
    }

    fn execute(&mut self, command: &Value) -> Result<()> {
        self.lines.get_mut().write_all(format!("{command}\n").as_bytes())?;
        loop {
            let answer = self.read_message()?;
            if let Some(error) = answer.get("error") {
                bail!("QEMU's monitor refuses {command}: {error}");
            }
            if answer.get("return").is_some() {
                return Ok(());
            }
        }
    }

    fn read_message(&mut self) -> Result<Value> {
        let mut line = String::new();
        self.lines.read_line(&mut line).context("QEMU's monitor is silent")?;
        serde_json::from_str(&line).context("QEMU's monitor")
    }

    /// Returns the log that stands in the board's RAM now.
    ///
    /// # Errors
    /// The image has no RTT, or more was logged than its buffer holds.
    pub fn read_log(&mut self, qemu: &QemuProcess, image: &Path) -> Result<Vec<String>> {
        let path = qemu.path("ram.bin");
        let arguments = json!({"val": RAM_START, "size": RAM_SIZE, "filename": path});
        self.execute(&json!({"execute": "pmemsave", "arguments": arguments}))?;
        let ram = fs::read(path)?;
        let bytes = up_channel_bytes(&ram, find_control_block_address(image)?)?;
        let mut lines = Vec::new();
        LogDecoder::from_image(image)?.decode_stream(bytes, |line| lines.push(line))?;
        Ok(lines)
    }
}

/// Where the image keeps the control block.
fn find_control_block_address(image: &Path) -> Result<u64> {
    let bytes = fs::read(image)?;
    let elf = object::File::parse(&*bytes)?;
    let symbol = elf.symbols().find(|symbol| symbol.name() == Ok("_SEGGER_RTT"));
    Ok(symbol.context("the image has no RTT")?.address())
}

/// Returns what the first up-channel holds: after 16 bytes of identifier and two counts come the name, the
/// buffer, its size and the place of the next write.
fn up_channel_bytes(ram: &[u8], block: u64) -> Result<&[u8]> {
    let word = |address: u64| -> Result<u64> {
        let start = usize::try_from(address.wrapping_sub(RAM_START))?;
        let bytes = ram.get(start..).and_then(|rest| rest.first_chunk());
        Ok(u32::from_le_bytes(*bytes.context("an address outside the RAM")?).into())
    };
    let (buffer, size, written) = (word(block + 28)?, word(block + 32)?, word(block + 36)?);
    ensure!(written <= size, "the log's buffer is not initialised");
    let start = usize::try_from(buffer.wrapping_sub(RAM_START))?;
    ram.get(start..start + usize::try_from(written)?).context("a buffer outside the RAM")
}
