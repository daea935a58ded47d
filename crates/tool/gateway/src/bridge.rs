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
    ends::Ends,
    line::{Line, LineEvent},
    pinned::Pinned,
};

use crate::hub::Hub;

/// From one look at the line to the next: two cycles of the bridge. Events between them are taken
/// together, which is what keeps the gateway cheap.
const TURN: Duration = Duration::from_millis(2);

/// How the line to the bridge is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LineState {
    /// It is open.
    pub is_up: bool,
    /// Why it last was not.
    pub why: Option<String>,
}

/// The hub, its clock, and the sign to stop: one for all threads.
#[derive(Clone)]
pub struct Shared {
    hub: Arc<Mutex<Hub>>,
    line: Arc<Mutex<LineState>>,
    stop: Arc<AtomicBool>,
    start: Instant,
}

impl Shared {
    /// Returns a hub whose clock starts now. Everything ends when `stop` is set.
    #[must_use]
    pub fn new(stop: Arc<AtomicBool>, pinned: Pinned) -> Self {
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
    pub fn hub(&self) -> MutexGuard<'_, Hub> {
        self.hub.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns how the line to the bridge is.
    #[must_use]
    pub fn line(&self) -> LineState {
        self.line.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns whether it is time to end.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn line_is(&self, state: LineState) {
        *self.line.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }
}

/// Reads at most once a turn: a thread that woke for each frame would cost more than all the rest.
struct OnceATurn(Box<dyn Read + Send>);

impl Read for OnceATurn {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        thread::sleep(TURN);
        self.0.read(bytes)
    }
}

/// Keeps a line to the bridge, in a thread of its own, until the end.
pub fn keep(
    shared: Shared,
    mut open: impl FnMut() -> io::Result<Ends> + Send + 'static,
) -> JoinHandle<()> {
    thread::spawn(move || {
        let line = Line::keep(move || {
            let (reader, writer) = open()?;
            Ok((Box::new(OnceATurn(reader)), writer))
        });
        while !shared.has_ended() {
            let frames = {
                let mut hub = shared.hub();
                for heard in line.received() {
                    match heard {
                        LineEvent::Up => shared.line_is(LineState { is_up: true, why: None }),
                        LineEvent::Down(why) => {
                            shared.line_is(LineState { is_up: false, why: Some(why) });
                        }
                        LineEvent::Received(event) => hub.receive(shared.now(), &event),
                        LineEvent::Late => hub.stalled(),
                    }
                }
                hub.refresh(shared.now());
                hub.frames()
            };
            for frame in frames {
                line.send(frame);
            }
            thread::sleep(TURN);
        }
    })
}
