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

use super::shdr::Lines;
use crate::{
    clock,
    shared::Shared,
    snapshot::{Event, Snapshot},
};

/// Agents at a time; one more is closed at once.
const MAX_AGENTS: usize = 16;
/// Changes that may wait for an agent: of about three seconds.
const MAX_WAITING: usize = 64;
/// An agent asks at least this often whether the adapter lives, in ms.
const HEARTBEAT_MS: u32 = 10_000;
/// How long an agent may take to take a line.
const DEAF: Duration = Duration::from_secs(5);
/// The longest line of an agent, in bytes.
const MAX_LINE: u64 = 1_024;
/// From one look for a new agent to the next.
const LOOK: Duration = Duration::from_millis(50);

/// All agents.
#[derive(Clone, Default)]
pub struct Adapter(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    lines: Lines,
    agents: Vec<Agent>,
}

/// An agent that is connected.
struct Agent {
    queue: SyncSender<Arc<str>>,
    stream: Arc<TcpStream>,
}

impl Adapter {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends what has changed to every agent.
    pub fn update(&self, bridges: &[Snapshot], events: &[(usize, Event)], time_ms: u64) {
        let mut state = self.state();
        let changes = state.lines.update(bridges, events, time_ms);
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
    fn join(&self, stream: Arc<TcpStream>) -> (SyncSender<Arc<str>>, Receiver<Arc<str>>) {
        let (sender, receiver) = mpsc::sync_channel(MAX_WAITING);
        let mut state = self.state();
        // Under one lock with the changes, so that none is missed between them.
        sender.try_send(state.lines.all(clock::now_ms()).into()).ok();
        state.agents.push(Agent { queue: sender.clone(), stream });
        (sender, receiver)
    }

    /// Forgets an agent that has left.
    fn leave(&self, stream: &Arc<TcpStream>) {
        self.state().agents.retain(|agent| !Arc::ptr_eq(&agent.stream, stream));
    }

    /// Serves agents in threads of its own, until the end.
    ///
    /// # Errors
    /// The listener cannot be used.
    pub fn serve(&self, shared: Shared, listener: TcpListener) -> io::Result<SocketAddr> {
        listener.set_nonblocking(true)?;
        let (adapter, count) = (self.clone(), Arc::new(AtomicUsize::new(0)));
        let address = listener.local_addr()?;
        thread::spawn(move || {
            while !shared.has_ended() {
                let Ok((stream, _)) = listener.accept() else {
                    thread::sleep(LOOK);
                    continue;
                };
                if count.fetch_add(1, Ordering::Relaxed) >= MAX_AGENTS {
                    count.fetch_sub(1, Ordering::Relaxed);
                    continue;
                }
                let (adapter, count) = (adapter.clone(), count.clone());
                thread::spawn(move || {
                    // An agent that leaves comes again.
                    talk(&adapter, stream).ok();
                    count.fetch_sub(1, Ordering::Relaxed);
                });
            }
        });
        Ok(address)
    }
}

/// Talks with an agent until either leaves.
fn talk(adapter: &Adapter, stream: TcpStream) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(DEAF))?;
    let stream = Arc::new(stream);
    let (answers, lines) = adapter.join(stream.clone());
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
    let answers = Answers(answers);
    answers.until_the_end(&stream);
    stream.shutdown(Shutdown::Both).ok();
    // The writer may wait for a change: without a sender it ends.
    adapter.leave(&stream);
    drop(answers);
    writes.join().ok();
    Ok(())
}

/// The queue of an agent, for the answers to its questions.
struct Answers(SyncSender<Arc<str>>);

impl Answers {
    /// Answers each `* PING`.
    fn until_the_end(&self, stream: &TcpStream) {
        let mut reader = BufReader::new(stream);
        let mut line = Vec::new();
        loop {
            line.clear();
            let read = reader.by_ref().take(MAX_LINE).read_until(b'\n', &mut line);
            if !read.is_ok_and(|length| length > 0) || line.last() != Some(&b'\n') {
                return;
            }
            let is_ping = line.trim_ascii() == b"* PING";
            let pong = format!("* PONG {HEARTBEAT_MS}\n");
            if is_ping && self.0.try_send(pong.into()).is_err() {
                return;
            }
        }
    }
}
