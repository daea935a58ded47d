//! The adapter between the CNC's line and the board's bus: SLCAN on a TCP port on one side, CAN
//! frames on the other, as a CANable does it.
//!
//! The board's own serial line would do as well at real time, but not faster: an emulated USART
//! costs tens of microseconds a byte, and 2,000 lines a second are 44,000 of them. The bus goes
//! through the pipes that carry the samples, so it is as fast as they are. The lines are read and
//! written by the board's own [`Port`], here on the host.
//!
//! When board time is compressed, the CNC cannot take a thousand times the factor of pairs a
//! second. Every 257th cycle is then passed on: the counter of such pairs still rises by one
//! (257 = 256 + 1), so that the CNC's checks stay as they are and every frame is, to the bit, what
//! the board has sent.

use std::{
    collections::VecDeque,
    io::{ErrorKind, Read as _, Write as _},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use anyhow::Result;
use trueup_core::units::TimestampMs;
use trueup_link::{
    frame::Frame,
    layout::{OFFSET_XY_ID, OFFSET_Z_ID},
    slcan::Port,
};
use trueup_pipe::FRAMES_PER_BLOCK;

/// Cycles from one pair to the next while time is compressed.
pub(crate) const COMPRESSED_PAIR_INTERVAL_CYCLES: u32 = 257;
/// A client that takes nothing in for this time counts as gone.
const CLIENT_WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// What `N` answers.
const ADAPTER_SERIAL_NUMBER: u16 = 2;

/// State of both sides.
struct AdapterState {
    port: Port,
    from_cnc: VecDeque<Frame>,
    client: Option<TcpStream>,
    received_count: u64,
    /// When the last of them came.
    last_received: Option<Instant>,
}

/// An adapter that listens.
pub(crate) struct SlcanAdapter {
    shared: Arc<Mutex<AdapterState>>,
    address: SocketAddr,
    stride: u32,
    /// The cycle of the last pair that was passed on.
    last: Option<TimestampMs>,
    passed: u64,
}

impl SlcanAdapter {
    /// Listens on a free port of the loopback.
    ///
    /// # Errors
    /// There is none.
    pub fn listen() -> Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Mutex::new(AdapterState {
            port: Port::new(ADAPTER_SERIAL_NUMBER),
            from_cnc: VecDeque::new(),
            client: None,
            received_count: 0,
            last_received: None,
        }));
        let theirs = shared.clone();
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                serve_client(stream, &theirs);
                lock_state(&theirs).client = None;
            }
        });
        Ok(Self { shared, address, stride: 1, last: None, passed: 0 })
    }

    /// Where it listens, as the component takes it.
    #[must_use]
    pub fn address(&self) -> String {
        format!("tcp:{}", self.address)
    }

    /// Every this many cycles a pair is passed on.
    pub(crate) fn set_frame_pair_interval_cycles(&mut self, stride: u32) {
        self.stride = stride;
    }

    /// Pairs passed on to the CNC, and frames received from it.
    #[must_use]
    pub(crate) fn frame_counts(&self) -> (u64, u64) {
        (self.passed, lock_state(&self.shared).received_count)
    }

    /// Returns whether the CNC has sent something within `time`.
    #[must_use]
    pub(crate) fn has_received_from_cnc_within(&self, time: Duration) -> bool {
        lock_state(&self.shared).last_received.is_some_and(|received| received.elapsed() < time)
    }

    /// Returns what the CNC has sent, as much of it as fits a block.
    #[must_use]
    pub(crate) fn take_frames(&self) -> [Option<Frame>; FRAMES_PER_BLOCK] {
        let mut shared = lock_state(&self.shared);
        std::array::from_fn(|_| shared.from_cnc.pop_front())
    }

    /// Passes on what the board has sent on its bus.
    pub(crate) fn forward_frames(&mut self, sent: &[(TimestampMs, Frame)]) {
        let mut shared = lock_state(&self.shared);
        let mut bytes = Vec::new();
        for cycle in sent.chunk_by(|(one, _), (other, _)| one == other) {
            let Some((time, _)) = cycle.first() else { continue };
            // A board that was restarted begins at 0 again.
            let due = self
                .last
                .is_none_or(|last| time.0 < last.0 || time.duration_ms_since(last) >= self.stride);
            if !due {
                continue;
            }
            let frames: Vec<Frame> = cycle.iter().map(|(_, frame)| *frame).collect();
            let is_pair = [OFFSET_XY_ID, OFFSET_Z_ID]
                .iter()
                .all(|id| frames.iter().any(|frame| frame.id() == *id));
            if is_pair {
                self.last = Some(*time);
                self.passed += u64::from(shared.port.send_all(&frames));
                bytes.extend(std::iter::from_fn(|| shared.port.pop()));
            }
        }
        shared.write(&bytes);
    }
}

impl AdapterState {
    fn write(&mut self, bytes: &[u8]) {
        let Some(client) = &mut self.client else { return };
        // A line that was cut off would garble the next: such a client is let go.
        if client.write_all(bytes).is_err() {
            client.shutdown(std::net::Shutdown::Both).ok();
            self.client = None;
        }
    }
}

fn lock_state(shared: &Mutex<AdapterState>) -> MutexGuard<'_, AdapterState> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One client, until it goes.
fn serve_client(mut stream: TcpStream, shared: &Mutex<AdapterState>) {
    let set_up = || -> std::io::Result<TcpStream> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(CLIENT_WRITE_TIMEOUT))?;
        stream.try_clone()
    };
    let Ok(writer) = set_up() else { return };
    {
        let mut shared = lock_state(shared);
        shared.port = Port::new(ADAPTER_SERIAL_NUMBER);
        shared.from_cnc.clear();
        shared.client = Some(writer);
    }
    let mut bytes = [0; 4096];
    loop {
        let length = match stream.read(&mut bytes) {
            Ok(0) => return,
            Ok(length) => length,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(_) => return,
        };
        let mut shared = lock_state(shared);
        let mut answers = Vec::new();
        for &byte in &bytes[..length] {
            if let Some(frame) = shared.port.receive(byte) {
                shared.received_count += 1;
                shared.last_received = Some(Instant::now());
                shared.from_cnc.push_back(frame);
            }
            answers.extend(std::iter::from_fn(|| shared.port.pop()));
        }
        shared.write(&answers);
    }
}
