//! Run files read with a progress bar, where one is long and somebody watches.

use std::{io::BufReader, path::Path};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trueup_machine::{BadInput, RunFile};

/// A run above this is worth a progress bar: about a second of work.
pub const LONG_RUN_BYTES: u64 = 16 << 20;

/// Reads the run file at `path`.
pub fn read(path: &Path) -> Result<RunFile, BadInput> {
    let file = RunFile::open(path)?;
    let bytes = bytes(path);
    let bar = progress("reading", bytes, bytes);
    let run = RunFile::from_reader(BufReader::with_capacity(1 << 16, bar.wrap_read(file)), path);
    bar.finish_and_clear();
    run
}

/// The size of the run; 0 where it is not a plain file.
pub fn bytes(path: &Path) -> u64 {
    path.metadata().map_or(0, |metadata| metadata.len())
}

/// A bar of `steps` on standard error; none for a short run, or where nobody watches.
pub fn progress(what: &'static str, steps: u64, run_bytes: u64) -> ProgressBar {
    if run_bytes < LONG_RUN_BYTES {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}");
    ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what)
}
