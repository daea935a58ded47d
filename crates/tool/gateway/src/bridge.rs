//! The thread that keeps the line to the bridge, and what it shares with those who serve PLCs.

use std::{
    io::{self, Read},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use trueup_client::{
    connection::{BridgeConnection, ConnectionEvent},
    duplex_stream::DuplexStream,
    pinned_calibration::PinnedCalibration,
};

use crate::hub::Hub;

/// From one look at the line to the next: two cycles of the bridge. Events between them are taken
/// together, which is what keeps the gateway cheap.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// How the line to the bridge is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct LinkState {
    /// It is open.
    pub is_up: bool,
    /// Why it last was not.
    pub why: Option<String>,
}

/// The hub, its clock, and the sign to stop: one for all threads.
#[derive(Clone)]
pub struct SharedHub {
    hub: Arc<Mutex<Hub>>,
    line: Arc<Mutex<LinkState>>,
    stop: Arc<AtomicBool>,
    start: Instant,
}

impl SharedHub {
    /// Returns a hub whose clock starts now. Everything ends when `stop` is set.
    #[must_use]
    pub fn new(stop: Arc<AtomicBool>, pinned: PinnedCalibration) -> Self {
        Self {
            hub: Arc::new(Mutex::new(Hub::new(pinned))),
            line: Arc::default(),
            stop,
            start: Instant::now(),
        }
    }

    /// Returns the time of the hub's clock.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// Returns the hub, for a moment. A thread that has panicked with it leaves it as it was.
    pub fn lock_hub(&self) -> MutexGuard<'_, Hub> {
        self.hub.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns how the line to the bridge is.
    #[must_use]
    pub(crate) fn link_state(&self) -> LinkState {
        self.line.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns whether it is time to end.
    #[must_use]
    pub fn is_stop_requested(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn set_link_state(&self, state: LinkState) {
        *self.line.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }
}

/// Reads at most once a turn: a thread that woke for each frame would cost more than all the rest.
struct ThrottledReader(Box<dyn Read + Send>);

impl Read for ThrottledReader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        thread::sleep(POLL_INTERVAL);
        self.0.read(bytes)
    }
}

/// Keeps a line to the bridge, in a thread of its own, until the end.
pub fn spawn_bridge_thread(
    shared: SharedHub,
    mut open: impl FnMut() -> io::Result<DuplexStream> + Send + 'static,
) -> JoinHandle<()> {
    thread::spawn(move || {
        let line = BridgeConnection::spawn(move || {
            let (reader, writer) = open()?;
            Ok((Box::new(ThrottledReader(reader)), writer))
        });
        while !shared.is_stop_requested() {
            let frames = {
                let mut hub = shared.lock_hub();
                for received in line.take_events() {
                    match received {
                        ConnectionEvent::Up => {
                            shared.set_link_state(LinkState { is_up: true, why: None })
                        }
                        ConnectionEvent::Down(why) => {
                            shared.set_link_state(LinkState { is_up: false, why: Some(why) });
                        }
                        ConnectionEvent::Received(event) => hub.receive(shared.now(), &event),
                        ConnectionEvent::Late => hub.count_stall(),
                    }
                }
                hub.refresh_input_block(shared.now());
                hub.take_due_frames()
            };
            for frame in frames {
                line.try_send(frame);
            }
            thread::sleep(POLL_INTERVAL);
        }
    })
}
