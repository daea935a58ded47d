//! Shared by the threads of a publisher: the bridge, the spool, the counts, and the sign to stop.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use trueup_client::{connection::BridgeConnection, duplex_stream::DuplexStream};

use crate::{bridge::BridgeMonitor, snapshot::BridgeSnapshot, spool::Spool};

/// From one look at the line to the next. Events between them are taken together.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// One for all threads.
#[derive(Clone)]
pub struct SharedState(Arc<Inner>);

struct Inner {
    /// A lock each: the thread of a line waits for no other bridge.
    bridges: Vec<Mutex<BridgeMonitor>>,
    spool: Mutex<Spool>,
    counts: PublisherCounters,
    stop: Arc<AtomicBool>,
}

/// Counts since the publisher began.
#[derive(Default)]
pub struct PublisherCounters {
    /// Rows and events on the disk.
    pub recorded: AtomicU64,
    /// Those that found no place on the disk.
    pub not_recorded: AtomicU64,
    /// Those that the broker has acknowledged.
    pub acknowledged: AtomicU64,
    /// Those that were damaged or gave way.
    pub lost: AtomicU64,
    /// Messages that are no payload, or too large.
    pub hostile: AtomicU64,
    /// The broker has the births; else it is not connected.
    pub is_online: AtomicBool,
}

impl SharedState {
    /// Returns what is shared. Everything ends when `stop` is set.
    #[must_use]
    pub fn new(bridges: Vec<BridgeMonitor>, spool: Spool, stop: Arc<AtomicBool>) -> Self {
        let (counts, bridges) =
            (PublisherCounters::default(), bridges.into_iter().map(Mutex::new).collect());
        Self(Arc::new(Inner { bridges, spool: Mutex::new(spool), counts, stop }))
    }

    /// Returns the bridge of this place, for a moment. A thread that has panicked with it leaves it as it was.
    #[must_use]
    pub fn lock_bridge(&self, place: usize) -> Option<MutexGuard<'_, BridgeMonitor>> {
        let bridge = self.0.bridges.get(place)?;
        Some(bridge.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Returns what is known of the bridges now.
    #[must_use]
    pub fn snapshots(&self) -> Vec<BridgeSnapshot> {
        let now = Instant::now();
        (0..)
            .map_while(|place| self.lock_bridge(place))
            .map(|monitor| monitor.snapshot(now))
            .collect()
    }

    /// Returns the spool, for a moment.
    pub fn lock_spool(&self) -> MutexGuard<'_, Spool> {
        self.0.spool.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the counts.
    #[must_use]
    pub fn counts(&self) -> &PublisherCounters {
        &self.0.counts
    }

    /// Returns whether it is time to end.
    #[must_use]
    pub fn is_stop_requested(&self) -> bool {
        self.0.stop.load(Ordering::Relaxed)
    }
}

/// Keeps a line to the bridge of this place, in a thread of its own that waits neither for a disk nor for a network,
/// until the end.
pub fn spawn_bridge_thread(
    shared: SharedState,
    place: usize,
    open: impl FnMut() -> std::io::Result<DuplexStream> + Send + 'static,
) -> JoinHandle<()> {
    thread::spawn(move || {
        let line = BridgeConnection::spawn(open);
        while !shared.is_stop_requested() {
            let now = Instant::now();
            let mut to_send = Vec::new();
            if let Some(mut bridge) = shared.lock_bridge(place) {
                to_send.extend(line.take_events().filter_map(|event| bridge.receive(event, now)));
                to_send.extend(bridge.take_due_request(now));
            }
            to_send.into_iter().for_each(|frame| line.try_send(frame));
            thread::sleep(POLL_INTERVAL);
        }
    })
}
