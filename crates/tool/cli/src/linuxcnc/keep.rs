//! `trueup linuxcnc keep`: the heat of a machine without a board, from the memory of the servo thread to a file.
//!
//! The component `trueup_node` writes two copies in turn, each with its number and CRC, into a file in memory: a servo
//! thread must not wait for a disk. Here they are copied to the disk, as a whole, while they are whole. The component reads
//! them when LinuxCNC starts again.

use std::{
    fs,
    io::ErrorKind,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use clap::Args;
use trueup_store::retained_state::{self, RETAINED_COPY_SIZE, RetainedCopies};

use crate::{CommandOutcome, output};

/// Time between two looks at the memory.
const POLL_INTERVAL: Duration = Duration::from_secs(1);
/// Time between two writes of the file: the most heat that a crash of the computer loses.
const FILE_WRITE_PERIOD: Duration = Duration::from_secs(10);
/// After this time without a new copy the servo thread counts as gone.
const COPY_TIMEOUT: Duration = Duration::from_secs(60);

/// From where to where.
#[derive(Args)]
pub struct KeepArgs {
    /// The file on the disk.
    #[arg(long, value_name = "FILE")]
    file: PathBuf,
    /// The memory of the component.
    #[arg(long, value_name = "FILE", default_value = "/dev/shm/trueup_heat")]
    memory: PathBuf,
}

/// Copies until the component is gone, or it is ended.
pub fn run(args: &KeepArgs) -> Result<CommandOutcome> {
    let memory = &args.memory;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("signal handler")?;
    let (mut last, mut on_disk) = (None, None);
    let (mut changed, mut written) = (Instant::now(), Instant::now());
    loop {
        let now = read_valid_copies(memory)?;
        let is_gone = now.is_none() && last.is_some() && !memory.exists();
        if now.is_some() && now != last {
            (last, changed) = (now, Instant::now());
        }
        let ends = is_gone || stop.load(Ordering::Relaxed) || changed.elapsed() > COPY_TIMEOUT;
        let is_due = on_disk.is_none() || written.elapsed() >= FILE_WRITE_PERIOD || ends;
        if let Some(copies) = last.filter(|_| is_due && last != on_disk) {
            let done = output::write_atomically(&args.file, &[], |out| {
                out.write_all(copies.as_flattened())
            });
            written = Instant::now();
            match done {
                Ok(()) => on_disk = last,
                // A disk that is full for a while costs the heat of that while.
                Err(error) if on_disk.is_some() && !ends => {
                    trueup_output::write_diagnostic(format_args!(
                        "the heat is written later: {error:#}"
                    ));
                }
                Err(error) => return Err(error),
            }
        }
        if ends {
            return Ok(CommandOutcome::Done);
        }
        thread::sleep(POLL_INTERVAL);
    }
}

/// Returns the copies if one of them is whole; a component that has just started has none.
fn read_valid_copies(memory: &Path) -> Result<Option<RetainedCopies>> {
    let bytes = match fs::read(memory) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        bytes => bytes.with_context(|| format!("{} cannot be read", memory.display()))?,
    };
    let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
    if bytes.len() != 2 * RETAINED_COPY_SIZE {
        return Ok(None);
    }
    copies.as_flattened_mut().copy_from_slice(&bytes);
    Ok(retained_state::load(&copies).map(|_| copies))
}
