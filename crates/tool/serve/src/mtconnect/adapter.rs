//! The adapter: agents connect, get all that is known, and then each change. An agent that is too slow, or says
//! what is no line, is closed; the others do not notice.

use std::{
    io::{self, BufRead as _, BufReader, Read as _, Write as _},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
        mpsc::{self, Receiver, SyncSender},
    },
    thread,
    time::Duration,
};

use super::shdr::ShdrEncoder;
use crate::{
    clock,
    shared_state::SharedState,
    snapshot::{BridgeEvent, BridgeSnapshot},
};

/// Agents at a time; one more is closed at once.
const MAX_AGENTS: usize = 16;
/// Changes that may wait for an agent: of about three seconds.
const MAX_QUEUED_CHANGES: usize = 64;
/// An agent checks at least this often whether the adapter lives, in ms.
const HEARTBEAT_PERIOD_MS: u32 = 10_000;
/// How long an agent may take to take a line.
const AGENT_WRITE_TIMEOUT: Duration = Duration::from_secs(5);
/// The longest line of an agent, in bytes.
const MAX_LINE_BYTES: u64 = 1_024;
/// From one look for a new agent to the next.
const ACCEPT_POLL_INTERVAL: Duration = Duration::from_millis(50);

/// All agents.
#[derive(Clone, Default)]
pub struct MtconnectAdapter(Arc<Mutex<AdapterState>>);

#[derive(Default)]
struct AdapterState {
    lines: ShdrEncoder,
    agents: Vec<MtconnectAgent>,
}

/// An agent that is connected.
struct MtconnectAgent {
    queue: SyncSender<Arc<str>>,
    stream: Arc<TcpStream>,
}

impl MtconnectAdapter {
    fn lock_state(&self) -> MutexGuard<'_, AdapterState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends what has changed to every agent.
    pub fn update(
        &self,
        bridges: &[BridgeSnapshot],
        events: &[(usize, BridgeEvent)],
        time_ms: u64,
    ) {
        let mut state = self.lock_state();
        let changes = state.lines.encode_changes(bridges, events, time_ms);
        if !changes.is_empty() {
            let changes: Arc<str> = changes.into();
            state.agents.retain(|agent| {
                let is_taken = agent.queue.try_send(changes.clone()).is_ok();
                if !is_taken {
                    // It has missed a change: it connects again, and gets all that is known.
                    agent.stream.shutdown(Shutdown::Both).ok();
                }
                is_taken
            });
        }
    }

    /// Lets an agent have all that is known, and from then on each change.
    fn register_agent(&self, stream: Arc<TcpStream>) -> (SyncSender<Arc<str>>, Receiver<Arc<str>>) {
        let (sender, receiver) = mpsc::sync_channel(MAX_QUEUED_CHANGES);
        let mut state = self.lock_state();
        // Under one lock with the changes, so that none is missed between them.
        sender.try_send(state.lines.encode_all(clock::now_ms()).into()).ok();
        state.agents.push(MtconnectAgent { queue: sender.clone(), stream });
        (sender, receiver)
    }

    /// Forgets an agent that has left.
    fn remove_agent(&self, stream: &Arc<TcpStream>) {
        self.lock_state().agents.retain(|agent| !Arc::ptr_eq(&agent.stream, stream));
    }

    /// Serves agents in threads of its own, until the end.
    ///
    /// # Errors
    /// The listener cannot be used.
    pub fn serve(&self, shared: SharedState, listener: TcpListener) -> io::Result<SocketAddr> {
        listener.set_nonblocking(true)?;
        let (adapter, count) = (self.clone(), Arc::new(AtomicUsize::new(0)));
        let address = listener.local_addr()?;
        thread::spawn(move || {
            while !shared.is_stop_requested() {
                let Ok((stream, _)) = listener.accept() else {
                    thread::sleep(ACCEPT_POLL_INTERVAL);
                    continue;
                };
                if count.fetch_add(1, Ordering::Relaxed) >= MAX_AGENTS {
                    count.fetch_sub(1, Ordering::Relaxed);
                    continue;
                }
                let (adapter, count) = (adapter.clone(), count.clone());
                thread::spawn(move || {
                    // An agent that leaves comes again.
                    serve_agent(&adapter, stream).ok();
                    count.fetch_sub(1, Ordering::Relaxed);
                });
            }
        });
        Ok(address)
    }
}

/// Talks with an agent until either leaves.
fn serve_agent(adapter: &MtconnectAdapter, stream: TcpStream) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(AGENT_WRITE_TIMEOUT))?;
    let stream = Arc::new(stream);
    let (answers, lines) = adapter.register_agent(stream.clone());
    let written = stream.clone();
    let writes = thread::spawn(move || {
        let mut writer = &*written;
        for line in lines {
            if writer.write_all(line.as_bytes()).is_err() {
                break;
            }
        }
        // Whether it was too slow or has gone: the reader ends too.
        written.shutdown(Shutdown::Both).ok();
    });
    let answers = PingResponder(answers);
    answers.answer_pings(&stream);
    stream.shutdown(Shutdown::Both).ok();
    // The writer may wait for a change: without a sender it ends.
    adapter.remove_agent(&stream);
    drop(answers);
    writes.join().ok();
    Ok(())
}

/// The queue of an agent, for the answers to its questions.
struct PingResponder(SyncSender<Arc<str>>);

impl PingResponder {
    /// Answers each `* PING`.
    fn answer_pings(&self, stream: &TcpStream) {
        let mut reader = BufReader::new(stream);
        let mut line = Vec::new();
        loop {
            line.clear();
            let read = reader.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut line);
            if !read.is_ok_and(|length| length > 0) || line.last() != Some(&b'\n') {
                return;
            }
            let is_ping = line.trim_ascii() == b"* PING";
            let pong = format!("* PONG {HEARTBEAT_PERIOD_MS}\n");
            if is_ping && self.0.try_send(pong.into()).is_err() {
                return;
            }
        }
    }
}
