//! The line to the bridge, which may go and come: opened again and again, read in one thread and
//! written in another, so that the loop never waits for either.
//!
//! Frames to be sent wait in a short queue. While it is full, frames are dropped: the receiver
//! sees a gap in the counter, and the next frame says something newer anyway. A frame that has waited for
//! too long, or would wait in a line that stalls, is dropped likewise; and what comes is passed on
//! only while it cannot be old (`dating`).

use std::{
    io::{self, Read, Write},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender},
    },
    thread,
    time::{Duration, Instant},
};

use trueup_link::{
    frame::Frame,
    slcan::{AdapterMessage, SlcanClient, client, encode_line},
};

use crate::{
    duplex_stream::{DuplexStream, is_timeout},
    latency::{LatencyMonitor, MAX_FRAME_AGE},
};

/// Frames that may wait: of a few milliseconds.
const MAX_QUEUED_FRAMES: usize = 32;
/// Before a line is opened again.
const RECONNECT_DELAY: Duration = Duration::from_millis(250);
/// After this silence a bridge is requested to open its channel again: it may have
/// restarted.
const CHANNEL_REOPEN_TIMEOUT: Duration = Duration::from_secs(1);
/// How often the writer looks whether there is a request to send.
const WRITER_POLL_PERIOD: Duration = Duration::from_millis(10);
/// After this time without a frame a line is closed and opened again.
const FRAME_TIMEOUT: Duration = Duration::from_secs(3);

/// An event on the line.
#[derive(Debug)]
pub enum ConnectionEvent {
    /// It is open.
    Up,
    /// It cannot be opened, or is broken; why.
    Down(String),
    /// A frame, a refusal or a malformed line came from the bridge.
    Received(AdapterMessage),
    /// The line has stalled, and delivers frames that are too old: they are dropped.
    Late,
}

/// An event and its time.
type TimedEvent = (Instant, ConnectionEvent);
/// Where frames wait to be sent, and since when; `None`: the line is down.
type SendQueue = Mutex<Option<SyncSender<(Instant, Frame)>>>;

/// A connection to the bridge that is opened again whenever it breaks.
#[derive(Debug)]
pub struct BridgeConnection {
    events: Receiver<TimedEvent>,
    to_send: Arc<SendQueue>,
    stop: Arc<AtomicBool>,
}

impl BridgeConnection {
    /// Keeps a line open until this is dropped.
    pub fn spawn(open: impl FnMut() -> io::Result<DuplexStream> + Send + 'static) -> Self {
        let (sender, received) = mpsc::channel();
        let to_send = Arc::new(Mutex::new(None));
        let stop = Arc::new(AtomicBool::new(false));
        let (slot, flag) = (to_send.clone(), stop.clone());
        thread::spawn(move || run_connection(open, &sender, &slot, &flag));
        Self { events: received, to_send, stop }
    }

    /// Returns what has happened since the last call; frames that have waited here for too long are dropped.
    pub fn take_events(&self) -> impl Iterator<Item = ConnectionEvent> + '_ {
        let is_old = |at: Instant, event: &ConnectionEvent| {
            matches!(event, ConnectionEvent::Received(AdapterMessage::Frame(_)))
                && at.elapsed() > MAX_FRAME_AGE
        };
        self.events
            .try_iter()
            .filter(move |(at, event)| !is_old(*at, event))
            .map(|(_, event)| event)
    }

    /// Sends a frame, unless the line is down or busy.
    pub fn try_send(&self, frame: Frame) {
        if let Some(queue) = lock(&self.to_send).as_ref() {
            queue.try_send((Instant::now(), frame)).ok();
        }
    }
}

impl Drop for BridgeConnection {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        lock(&self.to_send).take();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run_connection(
    mut open: impl FnMut() -> io::Result<DuplexStream>,
    received: &Sender<TimedEvent>,
    slot: &SendQueue,
    stop: &AtomicBool,
) {
    let report = |event| received.send((Instant::now(), event));
    while !stop.load(Ordering::Relaxed) {
        let why = match open() {
            Err(error) => error.to_string(),
            Ok((reader, writer)) => {
                if report(ConnectionEvent::Up).is_err() {
                    return;
                }
                let (queue, frames) = mpsc::sync_channel(MAX_QUEUED_FRAMES);
                let reopen = Arc::new(AtomicBool::new(true));
                let dating = Arc::new(Mutex::new(LatencyMonitor::default()));
                let (requested, dates) = (reopen.clone(), dating.clone());
                let writer =
                    thread::spawn(move || write_frames(writer, &frames, &requested, &dates));
                *lock(slot) = Some(queue);
                let why = read_events(reader, received, &reopen, &dating, &writer, stop);
                // Without its queue the writer ends; if it is stuck in a dead line, it ends when
                // that is given up.
                lock(slot).take();
                why
            }
        };
        if report(ConnectionEvent::Down(why)).is_err() {
            return;
        }
        thread::sleep(RECONNECT_DELAY);
    }
}

/// Reads until the line breaks; why it does.
fn read_events(
    mut reader: Box<dyn Read + Send>,
    received: &Sender<TimedEvent>,
    reopen: &AtomicBool,
    dating: &Mutex<LatencyMonitor>,
    writer: &thread::JoinHandle<()>,
    stop: &AtomicBool,
) -> String {
    let mut bytes = [0; 4096];
    let mut client = SlcanClient::new();
    let (mut last, mut requested_at) = (Instant::now(), Instant::now());
    let mut was_in_time = false;
    while !stop.load(Ordering::Relaxed) {
        if writer.is_finished() {
            return "the bridge accepts no frames".into();
        }
        match reader.read(&mut bytes) {
            Ok(0) => return "the bridge has closed the line".into(),
            Ok(length) => {
                let now = Instant::now();
                let mut dating = lock(dating);
                dating.record_reception(now);
                for event in bytes[..length].iter().filter_map(|&byte| client.receive(byte)) {
                    // A bridge whose channel is closed answers every frame, with a refusal.
                    let is_frame = matches!(event, AdapterMessage::Frame(_));
                    if is_frame {
                        last = now;
                    }
                    let is_used = dating.accept(now, &event);
                    let is_news = is_frame && was_in_time && !is_used;
                    if is_frame {
                        was_in_time = is_used;
                    }
                    let event = if is_used {
                        ConnectionEvent::Received(event)
                    } else {
                        ConnectionEvent::Late
                    };
                    if (is_used || is_news) && received.send((now, event)).is_err() {
                        return String::new();
                    }
                }
            }
            Err(error) if is_timeout(&error) => {}
            Err(error) => return error.to_string(),
        }
        if last.elapsed() > FRAME_TIMEOUT {
            return format!("no frame has come for {} s", FRAME_TIMEOUT.as_secs());
        }
        if last.elapsed() > CHANNEL_REOPEN_TIMEOUT
            && requested_at.elapsed() > CHANNEL_REOPEN_TIMEOUT
        {
            requested_at = Instant::now();
            reopen.store(true, Ordering::Relaxed);
        }
    }
    String::new()
}

fn write_frames(
    mut writer: Box<dyn Write + Send>,
    frames: &Receiver<(Instant, Frame)>,
    reopen: &AtomicBool,
    dating: &Mutex<LatencyMonitor>,
) {
    // An end of the queue, or of the line: either way there is nothing more to write.
    loop {
        if reopen.swap(false, Ordering::Relaxed) && writer.write_all(client::OPEN_SEQUENCE).is_err()
        {
            return;
        }
        // The time of a question is that before it is written, however long that takes.
        let question = lock(dating).next_query(Instant::now()).unwrap_or_default();
        let first = match frames.recv_timeout(if question.is_empty() {
            WRITER_POLL_PERIOD
        } else {
            Duration::ZERO
        }) {
            Ok(first) => Some(first),
            // One who only listens has nothing to send.
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        let mut bytes = question.to_vec();
        let may_send = lock(dating).can_send(Instant::now());
        // What has come together goes out together.
        for (at, frame) in first.into_iter().chain(frames.try_iter()) {
            if may_send && at.elapsed() <= MAX_FRAME_AGE {
                bytes.extend_from_slice(encode_line(&frame).as_bytes());
            }
        }
        if !bytes.is_empty() && writer.write_all(&bytes).and_then(|()| writer.flush()).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{
        net::{TcpListener, TcpStream},
        sync::atomic::AtomicU32,
    };
    use trueup_link::{frames, slcan::Port};

    fn open(port: u16) -> io::Result<DuplexStream> {
        let stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_read_timeout(Some(Duration::from_millis(20)))?;
        Ok((Box::new(stream.try_clone()?), Box::new(stream)))
    }

    /// A bridge that restarts behind a line that stays: with its channel closed it
    /// refuses every frame, until it gets the command to open.
    #[test]
    fn a_bridge_that_forgets_its_channel_is_asked_to_open_it_again() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let number = listener.local_addr().unwrap().port();
        let restarts = Arc::new(AtomicU32::new(0));
        let count = restarts.clone();
        thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
            let mut port = Port::new(1);
            let (mut bytes, mut open_for) = ([0; 256], 0);
            loop {
                let length = stream.read(&mut bytes).unwrap_or(0);
                for byte in &bytes[..length] {
                    port.receive(*byte);
                }
                if port.is_open() {
                    port.send(&frames::encode_heartbeat(frames::NmtState::Operational));
                    open_for += 1;
                }
                if open_for == 10 {
                    (port, open_for) = (Port::new(1), 0);
                    count.fetch_add(1, Ordering::Relaxed);
                }
                let answer: Vec<u8> = std::iter::from_fn(|| port.pop()).collect();
                if stream.write_all(&answer).is_err() {
                    return;
                }
            }
        });
        let line = BridgeConnection::spawn(move || open(number));
        let start = Instant::now();
        let mut refusals = 0;
        while restarts.load(Ordering::Relaxed) < 2 {
            assert!(start.elapsed() < Duration::from_secs(10), "it is left alone");
            line.try_send(frames::encode_heartbeat(frames::NmtState::Operational));
            for event in line.take_events() {
                assert!(
                    !matches!(event, ConnectionEvent::Down(_)),
                    "the line itself stays: {event:?}"
                );
                refusals +=
                    u32::from(matches!(event, ConnectionEvent::Received(AdapterMessage::Rejected)));
            }
            thread::sleep(Duration::from_millis(5));
        }
        assert!(refusals > 10, "it does answer: {refusals}");
    }

    #[test]
    fn one_who_only_listens_keeps_his_line() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let number = listener.local_addr().unwrap().port();
        thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let frame = encode_line(&frames::encode_heartbeat(frames::NmtState::Operational));
            while stream.write_all(frame.as_bytes()).is_ok() {
                thread::sleep(Duration::from_millis(20));
            }
        });
        let line = BridgeConnection::spawn(move || open(number));
        let start = Instant::now();
        while start.elapsed() < 2 * CHANNEL_REOPEN_TIMEOUT {
            for event in line.take_events() {
                assert!(!matches!(event, ConnectionEvent::Down(_)), "nothing was wrong: {event:?}");
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn a_line_that_cannot_be_opened_is_tried_again_until_it_can() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let number = listener.local_addr().unwrap().port();
        drop(listener);
        let line = BridgeConnection::spawn(move || open(number));
        let wait = |requested: fn(&ConnectionEvent) -> bool| {
            let start = Instant::now();
            while !line.take_events().any(|event| requested(&event)) {
                assert!(start.elapsed() < Duration::from_secs(10));
                thread::sleep(Duration::from_millis(5));
            }
        };
        wait(|event| matches!(event, ConnectionEvent::Down(_)));
        let listener = TcpListener::bind(("127.0.0.1", number)).unwrap();
        wait(|event| matches!(event, ConnectionEvent::Up));
        drop(listener.accept().unwrap());
        wait(|event| matches!(event, ConnectionEvent::Down(_)));
    }
}
