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

use super::{RemoteFleet, files::parse_job_id};
use crate::{
    store::FleetStore,
    worker::{self, DiagnoseFn, JobCounts, RENEWALS_PER_LEASE, WorkerOptions},
};

const WORKER_CONSUMER_NAME: &str = "workers";
/// How long one question for a job waits.
const FETCH_TIMEOUT: Duration = Duration::from_secs(1);
/// How long a server may be away before workers that are to end give up.
const SERVER_LOSS_TIMEOUT: Duration = Duration::from_secs(60);

/// Reports something to people.
pub type ReportFn<'r> = dyn Fn(&str) + Sync + 'r;

impl RemoteFleet {
    /// Works until every job has ended, or for ever. A server that goes away is reported and waited for.
    ///
    /// # Errors
    /// The diagnosis says that this worker cannot go on; or the server is away for a minute and the workers are to end.
    pub fn run_workers(
        &self,
        options: WorkerOptions,
        diagnose: &DiagnoseFn<'_>,
        report: &ReportFn<'_>,
    ) -> io::Result<JobCounts> {
        let consumer = self.open_consumer(options.lease, report)?;
        let is_away = AtomicBool::new(false);
        let tally = Mutex::default();
        let team = WorkerPool { remote: self, consumer, options, diagnose, report, is_away, tally };
        worker::run_threads(options.threads, |_| team.run())?;
        Ok(team.tally.into_inner().unwrap_or_else(PoisonError::into_inner))
    }

    /// Returns the consumer of the queue. Its lease is one for all workers: it is set while none of them has a job, else
    /// the one that is there stays.
    fn open_consumer(&self, lease: Duration, report: &ReportFn<'_>) -> io::Result<PullConsumer> {
        let config = pull::Config {
            durable_name: Some(WORKER_CONSUMER_NAME.into()),
            ack_policy: AckPolicy::Explicit,
            ack_wait: lease,
            ..Default::default()
        };
        let there = self.queue.get_or_create_consumer(WORKER_CONSUMER_NAME, config.clone());
        let there = self.wait_for_response("the queue", there)?;
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
        self.wait_for_response("the queue", self.queue.create_consumer(config))
    }
}

/// The threads of one process.
struct WorkerPool<'t> {
    remote: &'t RemoteFleet,
    consumer: PullConsumer,
    options: WorkerOptions,
    diagnose: &'t DiagnoseFn<'t>,
    report: &'t ReportFn<'t>,
    /// It was reported that the server does not answer.
    is_away: AtomicBool,
    tally: Mutex<JobCounts>,
}

/// Why a job was not ended.
enum AttemptError {
    /// The server did not answer: it is tried again.
    Server(io::Error),
    /// This worker cannot go on.
    Worker(io::Error),
}

impl WorkerPool<'_> {
    fn run(&self) -> io::Result<()> {
        let mut answered = Instant::now();
        loop {
            let broken = match self.fetch_next_job() {
                Ok(Some(message)) => self.handle_message(&message),
                Ok(None) => match self.remote.count_unfinished_jobs() {
                    Ok(0) if self.options.until_empty => return Ok(()),
                    other => other.map(|_| ()).map_err(AttemptError::Server),
                },
                Err(error) => Err(AttemptError::Server(error)),
            };
            match broken {
                Ok(()) => {
                    answered = Instant::now();
                    if self.is_away.swap(false, Ordering::Relaxed) {
                        (self.report)("the server answers again");
                    }
                }
                Err(AttemptError::Worker(error)) => return Err(error),
                Err(AttemptError::Server(error))
                    if self.options.until_empty && answered.elapsed() > SERVER_LOSS_TIMEOUT =>
                {
                    return Err(error);
                }
                Err(AttemptError::Server(error)) => {
                    if !self.is_away.swap(true, Ordering::Relaxed) {
                        (self.report)(&format!("{error}; it is tried again until it answers"));
                    }
                    thread::sleep(FETCH_TIMEOUT);
                }
            }
        }
    }

    /// Takes the next job that waits.
    fn fetch_next_job(&self) -> io::Result<Option<Message>> {
        let requested = self.consumer.fetch().max_messages(1).expires(FETCH_TIMEOUT);
        // All of it within the runtime: its drop notifies the server.
        self.remote.wait_for_response("the queue", async {
            let mut messages = requested.messages().await.map_err(|error| error.to_string())?;
            messages.next().await.transpose().map_err(|error| error.to_string())
        })
    }

    fn handle_message(&self, message: &Message) -> Result<(), AttemptError> {
        let Some(id) = parse_job_id(&message.subject) else {
            // No subject of a job: it was put there by another program.
            return self.acknowledge(message);
        };
        let remote = self.remote;
        let has = |bucket| {
            remote.read_text(bucket, id).map(|text| text.is_some()).map_err(AttemptError::Server)
        };
        if has(&remote.results)? {
            return self.acknowledge(message);
        }
        if has(&remote.failed)? {
            return self.acknowledge_failed_job(message, id);
        }
        // Another worker may have set it since. If it does so at this very moment, a job may be done twice, with one result.
        let info = remote
            .wait_for_response("the queue", self.consumer.get_info())
            .map_err(AttemptError::Server)?;
        let renewed = info.config.ack_wait / RENEWALS_PER_LEASE;
        let (ended, end) = channel::<()>();
        thread::scope(|scope| {
            scope.spawn(move || {
                self.report_progress(message, id);
                while end.recv_timeout(renewed) == Err(RecvTimeoutError::Timeout) {
                    self.report_progress(message, id);
                }
            });
            let done = self.run_job(message, id);
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

    fn run_job(&self, message: &Message, id: &str) -> Result<(), AttemptError> {
        let remote = self.remote;
        let folder = tempfile::tempdir().map_err(AttemptError::Worker)?;
        let store = FleetStore::create(folder.path()).map_err(AttemptError::Worker)?;
        let failed = |reason: String| json!({"schema": 1, "id": id, "reason": reason}).to_string();
        let failure = match remote.fetch_job_files(&store, id) {
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                Some(failed(error.to_string()))
            }
            Err(error) => return Err(AttemptError::Server(error)),
            Ok(()) => {
                let alone = WorkerOptions { threads: 1, until_empty: true, ..self.options };
                let done = worker::run_workers(&store, alone, self.diagnose);
                done.map_err(|error| {
                    let _ = remote.runtime.block_on(message.ack_with(AckKind::Nak(None)));
                    AttemptError::Worker(error)
                })?;
                fs::read_to_string(store.failure_path(id)).ok()
            }
        };
        let is_failed = failure.is_some();
        let is_first = match failure {
            Some(text) => remote.put_if_absent(&remote.failed, id, text),
            None => remote.send_result(&store, id, &attempt_id(message)),
        };
        if is_first.map_err(AttemptError::Server)? {
            let mut tally = self.tally.lock().unwrap_or_else(PoisonError::into_inner);
            if is_failed { tally.failed += 1 } else { tally.done += 1 }
        }
        if is_failed {
            self.acknowledge_failed_job(message, id)?;
        } else {
            self.acknowledge(message)?;
        }
        let _ = remote.runtime.block_on(remote.leases.purge(id));
        Ok(())
    }

    /// Removes a job from the queue, and waits until the server says so.
    fn acknowledge(&self, message: &Message) -> Result<(), AttemptError> {
        self.remote
            .wait_for_response("the queue", message.double_ack())
            .map_err(AttemptError::Server)
    }

    /// Removes a job that has failed from the queue. If it was submitted again a moment before, the queue did not take it
    /// a second time: it is put back.
    fn acknowledge_failed_job(&self, message: &Message, id: &str) -> Result<(), AttemptError> {
        self.acknowledge(message)?;
        let remote = self.remote;
        match remote.read_text(&remote.failed, id).map_err(AttemptError::Server)? {
            Some(_) => Ok(()),
            None => remote.enqueue(id).map_err(AttemptError::Server),
        }
    }
}

/// Returns a name that no other attempt at any job has. A server that was killed counts deliveries anew: by their number
/// alone two workers had one name, and the second removed the files of the first as its own.
fn attempt_id(message: &Message) -> String {
    let unique = message.context.client().new_inbox();
    let unique = unique.rsplit('.').next().unwrap_or(&unique);
    match message.info() {
        Ok(info) => format!("{}-{}-{unique}", info.stream_sequence, info.delivered),
        Err(_) => unique.into(),
    }
}
