//! Workers on a server: each takes a job, does it in a folder of its own, and acknowledges it once its result is there.

use std::{
    fs, io,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use async_nats::jetstream::{
    AckKind, Message,
    consumer::{AckPolicy, PullConsumer, pull},
};
use futures_util::StreamExt as _;
use serde_json::json;

use super::{Remote, files::id_of};
use crate::{
    store::Store,
    worker::{self, BEATS, Diagnose, Options, Tally},
};

const CONSUMER: &str = "workers";
/// How long one question for a job waits.
const ASKED: Duration = Duration::from_secs(1);
/// How long a server may be away before workers that are to end give up.
const AWAY: Duration = Duration::from_secs(60);

/// Reports something to people.
pub type Report<'r> = dyn Fn(&str) + Sync + 'r;

impl Remote {
    /// Works until every job has ended, or for ever. A server that goes away is reported and waited for.
    ///
    /// # Errors
    /// The diagnosis says that this worker cannot go on; or the server is away for a minute and the workers are to end.
    pub fn work(
        &self,
        options: Options,
        diagnose: &Diagnose<'_>,
        report: &Report<'_>,
    ) -> io::Result<Tally> {
        let consumer = self.consumer(options.lease, report)?;
        let is_away = AtomicBool::new(false);
        let tally = Mutex::default();
        let team = Team { remote: self, consumer, options, diagnose, report, is_away, tally };
        worker::run_threads(options.threads, |_| team.run())?;
        Ok(team.tally.into_inner().unwrap_or_else(PoisonError::into_inner))
    }

    /// Returns the consumer of the queue. Its lease is one for all workers: it is set while none of them has a job, else
    /// the one that is there stays.
    fn consumer(&self, lease: Duration, report: &Report<'_>) -> io::Result<PullConsumer> {
        let config = pull::Config {
            durable_name: Some(CONSUMER.into()),
            ack_policy: AckPolicy::Explicit,
            ack_wait: lease,
            ..Default::default()
        };
        let there = self.queue.get_or_create_consumer(CONSUMER, config.clone());
        let there = self.wait("the queue", there)?;
        let info = there.cached_info();
        let (set, is_used) = (info.config.ack_wait, info.num_ack_pending > 0);
        if set == lease {
            return Ok(there);
        }
        if is_used {
            report(&format!(
                "the lease stays {} s, by which other workers have jobs; another --lease-s is taken \
                 while no job is being done",
                set.as_secs_f64()
            ));
            return Ok(there);
        }
        self.wait("the queue", self.queue.create_consumer(config))
    }
}

/// The threads of one process.
struct Team<'t> {
    remote: &'t Remote,
    consumer: PullConsumer,
    options: Options,
    diagnose: &'t Diagnose<'t>,
    report: &'t Report<'t>,
    /// It was reported that the server does not answer.
    is_away: AtomicBool,
    tally: Mutex<Tally>,
}

/// Why a job was not ended.
enum Broken {
    /// The server did not answer: it is tried again.
    Server(io::Error),
    /// This worker cannot go on.
    Worker(io::Error),
}

impl Team<'_> {
    fn run(&self) -> io::Result<()> {
        let mut answered = Instant::now();
        loop {
            let broken = match self.next() {
                Ok(Some(message)) => self.process(&message),
                Ok(None) => match self.remote.open_jobs() {
                    Ok(0) if self.options.until_empty => return Ok(()),
                    other => other.map(|_| ()).map_err(Broken::Server),
                },
                Err(error) => Err(Broken::Server(error)),
            };
            match broken {
                Ok(()) => {
                    answered = Instant::now();
                    if self.is_away.swap(false, Ordering::Relaxed) {
                        (self.report)("the server answers again");
                    }
                }
                Err(Broken::Worker(error)) => return Err(error),
                Err(Broken::Server(error))
                    if self.options.until_empty && answered.elapsed() > AWAY =>
                {
                    return Err(error);
                }
                Err(Broken::Server(error)) => {
                    if !self.is_away.swap(true, Ordering::Relaxed) {
                        (self.report)(&format!("{error}; it is tried again until it answers"));
                    }
                    thread::sleep(ASKED);
                }
            }
        }
    }

    /// Takes the next job that waits.
    fn next(&self) -> io::Result<Option<Message>> {
        let asked = self.consumer.fetch().max_messages(1).expires(ASKED);
        // All of it within the runtime: its end tells the server so.
        self.remote.wait("the queue", async {
            let mut messages = asked.messages().await.map_err(|error| error.to_string())?;
            messages.next().await.transpose().map_err(|error| error.to_string())
        })
    }

    fn process(&self, message: &Message) -> Result<(), Broken> {
        let Some(id) = id_of(&message.subject) else {
            // No subject of a job: it was put there by another program.
            return self.acknowledge(message);
        };
        let remote = self.remote;
        let has = |bucket| remote.text(bucket, id).map(|it| it.is_some()).map_err(Broken::Server);
        if has(&remote.results)? {
            return self.acknowledge(message);
        }
        if has(&remote.failed)? {
            return self.acknowledge_failed(message, id);
        }
        // Another worker may have set it since. If it does so at this very moment, a job may be done twice, with one result.
        let info = remote.wait("the queue", self.consumer.get_info()).map_err(Broken::Server)?;
        let renewed = info.config.ack_wait / BEATS;
        let (ended, end) = channel::<()>();
        thread::scope(|scope| {
            scope.spawn(move || {
                self.report_progress(message, id);
                while end.recv_timeout(renewed) == Err(RecvTimeoutError::Timeout) {
                    self.report_progress(message, id);
                }
            });
            let done = self.attempt(message, id);
            drop(ended);
            done
        })
    }

    /// Reports that this worker still has the job. If the report is lost, the job is done twice, with one result.
    fn report_progress(&self, message: &Message, id: &str) {
        let taken = message.info().map_or(1, |info| info.delivered);
        let runtime = &self.remote.runtime;
        let _ = runtime.block_on(message.ack_with(AckKind::Progress));
        let _ = runtime.block_on(self.remote.leases.put(id, taken.to_string().into()));
    }

    fn attempt(&self, message: &Message, id: &str) -> Result<(), Broken> {
        let remote = self.remote;
        let folder = tempfile::tempdir().map_err(Broken::Worker)?;
        let store = Store::create(folder.path()).map_err(Broken::Worker)?;
        let failed = |reason: String| json!({"schema": 1, "id": id, "reason": reason}).to_string();
        let failure = match remote.fetch_job(&store, id) {
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                Some(failed(error.to_string()))
            }
            Err(error) => return Err(Broken::Server(error)),
            Ok(()) => {
                let alone = Options { threads: 1, until_empty: true, ..self.options };
                let done = worker::work(&store, alone, self.diagnose);
                done.map_err(|error| {
                    let _ = remote.runtime.block_on(message.ack_with(AckKind::Nak(None)));
                    Broken::Worker(error)
                })?;
                fs::read_to_string(store.failed(id)).ok()
            }
        };
        let is_failed = failure.is_some();
        let is_first = match failure {
            Some(text) => remote.is_first(&remote.failed, id, text),
            None => remote.send_result(&store, id, &attempt_of(message)),
        };
        if is_first.map_err(Broken::Server)? {
            let mut tally = self.tally.lock().unwrap_or_else(PoisonError::into_inner);
            if is_failed { tally.failed += 1 } else { tally.done += 1 }
        }
        if is_failed {
            self.acknowledge_failed(message, id)?;
        } else {
            self.acknowledge(message)?;
        }
        let _ = remote.runtime.block_on(remote.leases.purge(id));
        Ok(())
    }

    /// Removes a job from the queue, and waits until the server says so.
    fn acknowledge(&self, message: &Message) -> Result<(), Broken> {
        self.remote.wait("the queue", message.double_ack()).map_err(Broken::Server)
    }

    /// Removes a job that has failed from the queue. If it was submitted again a moment before, the queue did not take it
    /// a second time: it is put back.
    fn acknowledge_failed(&self, message: &Message, id: &str) -> Result<(), Broken> {
        self.acknowledge(message)?;
        let remote = self.remote;
        match remote.text(&remote.failed, id).map_err(Broken::Server)? {
            Some(_) => Ok(()),
            None => remote.queue(id).map_err(Broken::Server),
        }
    }
}

/// Returns a name that no other attempt at any job has. A server that was killed counts deliveries anew: by their number
/// alone two workers had one name, and the second removed the files of the first as its own.
fn attempt_of(message: &Message) -> String {
    let unique = message.context.client().new_inbox();
    let unique = unique.rsplit('.').next().unwrap_or(&unique);
    match message.info() {
        Ok(info) => format!("{}-{}-{unique}", info.stream_sequence, info.delivered),
        Err(_) => unique.into(),
    }
}
