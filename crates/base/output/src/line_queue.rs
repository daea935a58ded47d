//! A bounded queue of lines in front of a writer that may stall or fail: a thread writes, the caller never waits.
//! Lines that find the queue full are dropped, and counted where the writer takes lines again.

use std::{
    io::{self, Write},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{self, Receiver, SyncSender, TrySendError},
    },
    thread,
    time::{Duration, Instant},
};

/// Lines that may wait: an hour of a component that reports something every few seconds.
const MAX_QUEUED_LINES: usize = 1_024;
/// Bytes of a line; longer ones are cut, so that the queue is bounded in memory as well.
const MAX_LINE_BYTES: usize = 4_096;
/// From one try to the next on a writer that is busy (`EAGAIN`).
const WRITE_RETRY_INTERVAL: Duration = Duration::from_millis(5);

enum QueueItem {
    Text(String),
    /// All before it is written.
    Mark(mpsc::Sender<()>),
}

/// The queue. A clone is another end of the same one.
#[derive(Clone, Debug)]
pub struct LineQueue {
    sender: SyncSender<QueueItem>,
    dropped: Arc<AtomicU64>,
}

impl LineQueue {
    /// Starts the thread that writes to `writer`, which messages call `name`.
    pub fn new(name: &str, writer: impl Write + Send + 'static) -> Self {
        let (sender, receiver) = mpsc::sync_channel(MAX_QUEUED_LINES);
        let queue = Self { sender, dropped: Arc::default() };
        let (name, dropped) = (name.to_owned(), queue.dropped.clone());
        let thread = thread::Builder::new().name("output".into());
        // Without a thread (no memory for its stack) every line is dropped and counted.
        _ = thread.spawn(move || run_writer(&name, writer, &receiver, &dropped));
        queue
    }

    /// Appends text, line break included, or drops it if the queue is full.
    pub fn push(&self, mut text: String) {
        if text.len() > MAX_LINE_BYTES {
            let cut = text.floor_char_boundary_at(MAX_LINE_BYTES);
            text.truncate(cut);
            text.push_str("…\n");
        }
        if self.sender.try_send(QueueItem::Text(text)).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Waits until all before is written, no longer than the deadline.
    pub fn flush_until(&self, deadline: Instant) {
        let (done, is_done) = mpsc::channel();
        let mut mark = QueueItem::Mark(done);
        loop {
            match self.sender.try_send(mark) {
                Ok(()) => break,
                Err(TrySendError::Full(back)) if Instant::now() < deadline => mark = back,
                Err(_) => return,
            }
            thread::sleep(WRITE_RETRY_INTERVAL);
        }
        // Either it is written or the time is up.
        _ = is_done.recv_timeout(deadline.saturating_duration_since(Instant::now()));
    }
}

/// The end of the text that fits.
trait CharBoundary {
    fn floor_char_boundary_at(&self, at: usize) -> usize;
}

impl CharBoundary for str {
    fn floor_char_boundary_at(&self, at: usize) -> usize {
        (0..=at).rev().find(|at| self.is_char_boundary(*at)).unwrap_or_default()
    }
}

fn run_writer(
    name: &str,
    mut writer: impl Write,
    lines: &Receiver<QueueItem>,
    dropped: &AtomicU64,
) {
    for item in lines {
        match item {
            // A full disk or a reader that has left loses the line, and no later one that can be written.
            QueueItem::Text(text) => _ = write_all(&mut writer, text.as_bytes()),
            QueueItem::Mark(done) => _ = done.send(()),
        }
        let count = dropped.swap(0, Ordering::Relaxed);
        if count > 0 {
            let text = format!("warning: {count} lines were dropped: {name} took none\n");
            _ = write_all(&mut writer, text.as_bytes());
        }
    }
}

fn write_all(writer: &mut impl Write, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match writer.write(bytes) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(written) => bytes = bytes.get(written..).unwrap_or_default(),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                thread::sleep(WRITE_RETRY_INTERVAL)
            }
            Err(error) => return Err(error),
        }
    }
    writer.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    /// Takes nothing while it is held.
    #[derive(Clone, Default)]
    struct Gate(Arc<Mutex<Vec<u8>>>);

    impl Write for Gate {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("whole").write(bytes)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_writer_that_stalls_delays_no_caller_and_the_lost_lines_are_counted() {
        let gate = Gate::default();
        let queue = LineQueue::new("the log", gate.clone());
        let held = gate.0.lock().expect("whole");
        let start = Instant::now();
        for line in 0..5_000 {
            queue.push(format!("{line}\n"));
        }
        queue.flush_until(Instant::now() + Duration::from_millis(20));
        assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
        drop(held);
        queue.flush_until(Instant::now() + Duration::from_secs(5));
        let text = String::from_utf8(gate.0.lock().expect("whole").clone()).expect("text");
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines[0], "0");
        let notice = lines.iter().find(|line| line.contains("dropped")).expect("a count");
        let count: usize = notice.split(' ').nth(1).expect("a count").parse().expect("a count");
        assert_eq!(count + lines.len() - 1, 5_000, "{notice}");
    }

    #[test]
    fn a_writer_that_fails_loses_its_lines_and_a_long_line_is_cut() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let queue = LineQueue::new("full", Full);
        queue.push("lost\n".into());
        queue.flush_until(Instant::now() + Duration::from_secs(5));

        let gate = Gate::default();
        let queue = LineQueue::new("the log", gate.clone());
        queue.push("µ".repeat(1 << 20));
        queue.flush_until(Instant::now() + Duration::from_secs(5));
        assert_eq!(gate.0.lock().expect("whole").len(), MAX_LINE_BYTES + "…\n".len());
    }
}
