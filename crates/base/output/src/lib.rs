//! The one way to standard output and standard error. [`write_result`] prints the result of a command,
//! [`write_diagnostic`] everything else; both show control and bidirectional characters escaped. `print!`,
//! `eprintln!`, `stdout()` and `stderr()` are denied by clippy everywhere else.
//!
//! | stream cannot be written | `write_diagnostic` | `write_result` |
//! |---|---|---|
//! | reader gone (`EPIPE`) | dropped | dropped; the command goes on, its exit status stands |
//! | full disk, I/O error | dropped | an error; after [`enable_background_output`] or [`enable_best_effort_output`] a diagnostic |
//! | busy (`EAGAIN`) | waits one second, then dropped | waits |
//! | reader stopped, pipe full | waits; after [`enable_background_output`] dropped and counted | waits; after [`enable_background_output`] dropped and counted |
//!
//! A control path (the LinuxCNC component, a gateway, a virtual bridge) calls [`enable_background_output`] before it starts: from then
//! on a thread of its own writes each stream from a bounded queue ([`line_queue`]), and no call here waits.

pub mod escape;
pub mod line_queue;

use std::{
    fmt::Display,
    io::{self, ErrorKind, IsTerminal as _, Write},
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use escape::escape_except_line_breaks;
use line_queue::LineQueue;

/// Longest wait for a standard error that is busy (`EAGAIN`).
const STDERR_WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// From one try to the next on a stream that is busy.
const WRITE_RETRY_INTERVAL: Duration = Duration::from_millis(2);
/// Longest wait at the end for queued lines.
const QUEUE_DRAIN_TIMEOUT: Duration = Duration::from_millis(500);

/// The reader of standard output is gone.
static IS_STDOUT_CLOSED: AtomicBool = AtomicBool::new(false);
/// A result that cannot be written is reported as a diagnostic.
static IS_BEST_EFFORT: AtomicBool = AtomicBool::new(false);
/// That has been reported.
static IS_OUTPUT_FAILURE_REPORTED: AtomicBool = AtomicBool::new(false);
static OUTPUT_QUEUES: OnceLock<OutputQueues> = OnceLock::new();

/// The queues of a control path.
struct OutputQueues {
    output: LineQueue,
    error: LineQueue,
}

/// Writes both streams from threads of their own from now on: no call waits, lines that a stream does not take are
/// dropped and counted, and no failure to write is an error.
pub fn enable_background_output() {
    enable_best_effort_output();
    OUTPUT_QUEUES.get_or_init(|| OutputQueues {
        output: LineQueue::new("standard output", io::stdout()),
        error: LineQueue::new("standard error", io::stderr()),
    });
}

/// Reports a result that cannot be written as a diagnostic from now on: for a command whose product is not what it
/// prints, such as one that changes a bridge.
pub fn enable_best_effort_output() {
    IS_BEST_EFFORT.store(true, Ordering::Relaxed);
}

/// Waits a short time until queued lines are written; at the end of a program.
pub fn flush_queues() {
    if let Some(OutputQueues { output, error }) = OUTPUT_QUEUES.get() {
        let deadline = Instant::now() + QUEUE_DRAIN_TIMEOUT;
        output.flush_until(deadline);
        error.flush_until(deadline);
    }
}

/// Writes a line of diagnostics to standard error, escaped except for its line breaks. Never fails.
pub fn write_diagnostic(text: impl Display) {
    write_to_stderr(format!("{}\n", escape_except_line_breaks(&text.to_string())));
}

/// Writes text to standard error unchanged, colours and cursor movements included: what a user's file has brought
/// into it is escaped already. Never fails.
pub fn write_styled_diagnostic(text: impl Display) {
    write_to_stderr(format!("{text}\n"));
}

/// Writes a question to standard error, without a line break at its end. Never fails.
pub fn write_prompt(question: impl Display) {
    write_to_stderr(escape_except_line_breaks(&question.to_string()));
}

/// Writes a result on a line of its own to standard output, escaped except for its line breaks.
///
/// # Errors
/// Standard output cannot be written, and its reader has not just left. Never after [`enable_background_output`] or [`enable_best_effort_output`].
pub fn write_result(text: impl Display) -> io::Result<()> {
    let text = format!("{}\n", escape_except_line_breaks(&text.to_string()));
    if let Some(OutputQueues { output, .. }) = OUTPUT_QUEUES.get() {
        output.push(text);
        return Ok(());
    }
    report_best_effort_error(
        StdoutWriter.write_all(text.as_bytes()).and_then(|()| StdoutWriter.flush()),
    )
}

/// Writes a line to standard output as [`write_result`] does; a failure is a diagnostic. For tools of the workshop, and for
/// what a control path reports.
pub fn write_line_best_effort(text: impl Display) {
    enable_best_effort_output();
    // A best effort has reported its failure.
    _ = write_result(text);
}

/// Reports the failure of a best effort once, as a diagnostic.
fn report_best_effort_error(written: io::Result<()>) -> io::Result<()> {
    match written {
        Err(error) if IS_BEST_EFFORT.load(Ordering::Relaxed) => {
            if !IS_OUTPUT_FAILURE_REPORTED.swap(true, Ordering::Relaxed) {
                write_diagnostic(format_args!(
                    "warning: standard output cannot be written: {error}"
                ));
            }
            Ok(())
        }
        other => other,
    }
}

/// Standard output as a writer of bytes, for a file's content: unescaped. A reader that has left is no error.
#[derive(Clone, Copy, Debug, Default)]
pub struct StdoutWriter;

impl Write for StdoutWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match has_stdout_reader() {
            false => Ok(bytes.len()),
            true => ignore_broken_pipe(
                retry_until_deadline(None, || io::stdout().lock().write(bytes)),
                bytes.len(),
            ),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match has_stdout_reader() {
            false => Ok(()),
            true => {
                ignore_broken_pipe(retry_until_deadline(None, || io::stdout().lock().flush()), ())
            }
        }
    }
}

/// Returns `done` where the reader has left, and remembers it.
fn ignore_broken_pipe<T>(written: io::Result<T>, done: T) -> io::Result<T> {
    match written {
        Err(error) if is_broken_pipe(&error) => {
            IS_STDOUT_CLOSED.store(true, Ordering::Relaxed);
            Ok(done)
        }
        other => other,
    }
}

/// Returns false once the reader of standard output has left (`| head`): a command that prints without end ends then.
#[must_use]
pub fn has_stdout_reader() -> bool {
    !IS_STDOUT_CLOSED.load(Ordering::Relaxed)
}

/// Returns true if standard output is a terminal.
#[must_use]
pub fn is_stdout_terminal() -> bool {
    io::stdout().is_terminal()
}

/// Returns true if standard error is a terminal.
#[must_use]
pub fn is_stderr_terminal() -> bool {
    io::stderr().is_terminal()
}

/// Returns standard error for a program that is started, as its standard output.
#[must_use]
pub fn stderr_stdio() -> std::process::Stdio {
    io::stderr().into()
}

fn write_to_stderr(text: String) {
    if let Some(OutputQueues { error, .. }) = OUTPUT_QUEUES.get() {
        error.push(text);
        return;
    }
    let deadline = Instant::now() + STDERR_WRITE_TIMEOUT;
    let mut left = text.as_bytes();
    while !left.is_empty() {
        // Nothing is left to report this failure to.
        match retry_until_deadline(Some(deadline), || io::stderr().lock().write(left)) {
            Ok(written @ 1..) => left = left.get(written..).unwrap_or_default(),
            _ => return,
        }
    }
}

/// Tries again, until the deadline, while a stream is busy or a signal interrupts.
fn retry_until_deadline<T>(
    deadline: Option<Instant>,
    mut write: impl FnMut() -> io::Result<T>,
) -> io::Result<T> {
    loop {
        match write() {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error)
                if error.kind() == ErrorKind::WouldBlock
                    && deadline.is_none_or(|deadline| Instant::now() < deadline) =>
            {
                thread::sleep(WRITE_RETRY_INTERVAL);
            }
            other => return other,
        }
    }
}

fn is_broken_pipe(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::BrokenPipe | ErrorKind::ConnectionReset)
}
