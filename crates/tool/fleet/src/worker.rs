//! Workers: threads that take jobs, do them, and publish one result each.
//!
//! ```text
//! waiting ─► lease ─► diagnosis in tmp/ ─► results/ID or failed/ID.json ─► lease removed
//! ```
//!
//! A worker that is killed anywhere leaves a lease that ends, and files below `tmp`. A job that is done twice has one
//! result: the folder of the second cannot take the name.

use std::{
    fs, io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    process,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
        mpsc::{RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use serde::Serialize;
use serde_json::json;
use trueup_numerics::parallel::run_single_threaded;

use crate::{
    job::{Job, JobFile, StoredJobError},
    job_result::{JobResult, ResultFile},
    lease::{self, JobLease, LeaseMonitor},
    store::{FleetStore, compute_checksum},
};

/// The longest pause before a worker looks for jobs again.
const MAX_POLL_INTERVAL: Duration = Duration::from_millis(500);
/// How often a lease is renewed in its length.
pub(crate) const RENEWALS_PER_LEASE: u32 = 4;

/// A job with the content of its files, as the worker has read it.
#[derive(Debug)]
pub struct LoadedJob {
    /// The job.
    pub job: Job,
    /// The machine file.
    pub machine_file: Vec<u8>,
    /// The runs.
    pub runs: Vec<Vec<u8>>,
    /// Runs with the bridge disengaged.
    pub off: Vec<Vec<u8>>,
    /// Runs not used for the fit.
    pub holdout: Vec<Vec<u8>>,
}

/// Why a diagnosis was not made.
#[derive(Debug)]
pub enum DiagnosisError {
    /// The job cannot be done, by any worker: the reason.
    Job(String),
    /// This worker cannot: the job waits for another one.
    Worker(String),
}

/// Files that a diagnosis hands to the worker, which writes them: names and content.
pub type DiagnosisFiles = Vec<(&'static str, Vec<u8>)>;

/// Makes the diagnosis of a job whose result will stand in the folder.
pub type DiagnoseFn<'d> =
    dyn Fn(&LoadedJob, &Path) -> Result<DiagnosisFiles, DiagnosisError> + Sync + 'd;

/// How workers work.
#[derive(Clone, Copy, Debug)]
pub struct WorkerOptions {
    /// Threads, each with a job of its own.
    pub threads: usize,
    /// The length of a lease.
    pub lease: Duration,
    /// True if the workers end once every job has ended.
    pub until_empty: bool,
}

/// Work done by this process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct JobCounts {
    /// Jobs with a result of theirs.
    pub done: usize,
    /// Jobs that failed.
    pub failed: usize,
}

/// Works until every job has ended, or for ever.
///
/// # Errors
/// The folder cannot be read or written, or the diagnosis says that this worker cannot go on.
pub fn run_workers(
    store: &FleetStore,
    options: WorkerOptions,
    diagnose: &DiagnoseFn<'_>,
) -> io::Result<JobCounts> {
    let team = WorkerThreads {
        store,
        options,
        diagnose,
        watch: LeaseMonitor::new(options.lease),
        queue: Mutex::default(),
        done: AtomicUsize::new(0),
        failed: AtomicUsize::new(0),
    };
    run_threads(options.threads, |number| team.run(number))?;
    let count = |counter: &AtomicUsize| counter.load(Ordering::Relaxed);
    Ok(JobCounts { done: count(&team.done), failed: count(&team.failed) })
}

/// Runs this many threads, each with its number, until all have ended.
///
/// # Errors
/// The first error of a thread, or that one has panicked.
pub(crate) fn run_threads(
    count: usize,
    run: impl Fn(usize) -> io::Result<()> + Sync,
) -> io::Result<()> {
    let run = &run;
    let ended: Vec<thread::Result<io::Result<()>>> = thread::scope(|scope| {
        let start = |number| scope.spawn(move || run(number));
        let threads: Vec<_> = (0..count.max(1)).map(start).collect();
        threads.into_iter().map(|thread| thread.join()).collect()
    });
    ended.into_iter().try_for_each(|result| {
        result.unwrap_or_else(|_| Err(io::Error::other("a thread of the worker has panicked")))
    })
}

/// The threads of one process.
struct WorkerThreads<'t> {
    store: &'t FleetStore,
    options: WorkerOptions,
    diagnose: &'t DiagnoseFn<'t>,
    watch: LeaseMonitor,
    /// Jobs that waited when they were last looked for, with the number of their next lease.
    queue: Mutex<Vec<(String, u64)>>,
    done: AtomicUsize,
    failed: AtomicUsize,
}

/// Work to do.
enum NextJob {
    Job(String, JobLease),
    /// Other workers have what is left.
    Wait,
    /// Every job has ended.
    Nothing,
}

impl WorkerThreads<'_> {
    fn run(&self, number: usize) -> io::Result<()> {
        let worker = format!("{}-{number}", process::id());
        loop {
            match self.acquire_next_job(&worker)? {
                NextJob::Job(id, lease) => self.process_job(&id, lease)?,
                NextJob::Nothing if self.options.until_empty => return Ok(()),
                NextJob::Wait | NextJob::Nothing => {
                    thread::sleep(MAX_POLL_INTERVAL.min(self.options.lease / RENEWALS_PER_LEASE));
                }
            }
        }
    }

    /// Takes the next job that waits.
    fn acquire_next_job(&self, worker: &str) -> io::Result<NextJob> {
        let mut queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        let mut is_fresh = false;
        loop {
            while let Some((id, number)) = queue.pop() {
                if self.store.is_job_ended(&id) {
                    continue;
                }
                let Some(lease) = JobLease::acquire(self.store, &id, number, worker)? else {
                    continue;
                };
                // It may have ended between the two.
                if self.store.is_job_ended(&id) {
                    lease::remove_leases(self.store, &id)?;
                    continue;
                }
                return Ok(NextJob::Job(id, lease));
            }
            if is_fresh {
                return Ok(NextJob::Wait);
            }
            let open;
            (*queue, open) = self.scan_waiting_jobs()?;
            is_fresh = true;
            if open == 0 {
                return Ok(NextJob::Nothing);
            }
        }
    }

    /// Returns the jobs that wait, in an order of this process, and how many have not ended.
    fn scan_waiting_jobs(&self) -> io::Result<(Vec<(String, u64)>, usize)> {
        let leases = lease::find_newest_leases(self.store)?;
        let now = Instant::now();
        let open = self.store.list_job_ids()?.into_iter().filter(|id| !self.store.is_job_ended(id));
        let open: Vec<String> = open.collect();
        // What a worker has left that was killed after its result.
        for id in leases.keys().filter(|id| self.store.is_job_ended(id)) {
            self.store.clear_staging(&format!("result-{id}-"))?;
            lease::remove_leases(self.store, id)?;
        }
        let waits = |id: &String| match leases.get(id) {
            None => Some((id.clone(), 1)),
            Some(number) => self
                .watch
                .has_expired(lease::lease_path(self.store, id, *number), now)
                .then(|| (id.clone(), number + 1)),
        };
        let mut waiting: Vec<(String, u64)> = open.iter().filter_map(waits).collect();
        // Workers that begin at different places seldom reach for the same job.
        if !waiting.is_empty() {
            let start = process::id() as usize % waiting.len();
            waiting.rotate_left(start);
        }
        Ok((waiting, open.len()))
    }

    /// Does a job while its lease is renewed.
    fn process_job(&self, id: &str, mut lease: JobLease) -> io::Result<()> {
        let (ended, end) = channel::<()>();
        let renewed = self.options.lease / RENEWALS_PER_LEASE;
        let done = thread::scope(|scope| {
            let lease = &mut lease;
            scope.spawn(move || {
                while end.recv_timeout(renewed) == Err(RecvTimeoutError::Timeout) {
                    lease.renew();
                }
            });
            let done = self.attempt_job(id);
            drop(ended);
            done
        });
        match done {
            Ok(()) => {
                self.store.clear_staging(&format!("result-{id}-"))?;
                lease::remove_leases(self.store, id)
            }
            Err(error) => {
                lease.release();
                Err(error)
            }
        }
    }

    fn attempt_job(&self, id: &str) -> io::Result<()> {
        let damage = |damage: StoredJobError| DiagnosisError::Job(format!("jobs/{id}: {damage}"));
        let made = load_job(self.store, id).map_err(damage).and_then(|loaded| {
            let out = self.store.result_folder(id).join("out");
            let diagnose = || run_single_threaded(|| (self.diagnose)(&loaded, &out));
            // A job that breaks the program must not take the others with it.
            let made = catch_unwind(AssertUnwindSafe(diagnose)).unwrap_or_else(|_| {
                let why =
                    "the program has failed on these files: report it with the folder of the job";
                Err(DiagnosisError::Job(why.into()))
            });
            made.map(|files| (loaded.job, files))
        });
        match made {
            Ok((job, files)) => {
                if publish_result(self.store, id, &job, &files)? {
                    self.done.fetch_add(1, Ordering::Relaxed);
                }
                Ok(())
            }
            Err(DiagnosisError::Job(reason)) => {
                let machine = Job::read(self.store, id).map(|job| job.machine).ok();
                let text = json!({"schema": 1, "id": id, "machine": machine, "reason": reason});
                let text = serde_json::to_string_pretty(&text)? + "\n";
                self.store.publish_file(&self.store.failure_path(id), &text)?;
                self.failed.fetch_add(1, Ordering::Relaxed);
                Ok(())
            }
            Err(DiagnosisError::Worker(reason)) => Err(io::Error::other(reason)),
        }
    }
}

/// Reads a job with its files.
///
/// # Errors
/// A file is missing or damaged.
pub fn load_job(store: &FleetStore, id: &str) -> Result<LoadedJob, StoredJobError> {
    let folder = store.job_folder(id);
    let job = Job::read(store, id)?;
    let bytes = |file: &JobFile| job.read_file(&folder, file);
    let all = |files: &[JobFile]| files.iter().map(bytes).collect::<Result<Vec<_>, _>>();
    Ok(LoadedJob {
        machine_file: bytes(&job.machine_file)?,
        runs: all(&job.runs)?,
        off: all(&job.off)?,
        holdout: all(&job.holdout)?,
        job,
    })
}

/// Publishes the result of a job, unless it has one. Returns whether it was the first.
fn publish_result(
    store: &FleetStore,
    id: &str,
    job: &Job,
    files: &DiagnosisFiles,
) -> io::Result<bool> {
    let staged = store.create_staging_folder(&format!("result-{id}-"))?;
    let out = staged.path().join("out");
    fs::create_dir(&out)?;
    for (name, content) in files {
        fs::write(out.join(name), content)?;
    }
    let named = |(name, content): &(&'static str, Vec<u8>)| ResultFile {
        name: (*name).into(),
        crc64: compute_checksum(content),
    };
    let done = JobResult {
        schema: 1,
        id: id.into(),
        machine: job.machine.clone(),
        date: job.date.clone(),
        files: files.iter().map(named).collect(),
    };
    fs::write(staged.path().join("result.json"), serde_json::to_string_pretty(&done)? + "\n")?;
    store.publish_folder(staged, &store.result_folder(id))
}

/// Where the jobs of a folder stand.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FleetStatus {
    /// Jobs that no worker has.
    pub waiting: Vec<JobStatus>,
    /// Jobs that a worker has, or had when it ended.
    pub running: Vec<JobStatus>,
    /// Jobs with a result.
    pub done: Vec<JobStatus>,
    /// Jobs that cannot be done.
    pub failed: Vec<JobStatus>,
}

/// A job and how it stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct JobStatus {
    /// Its identifier.
    pub id: String,
    /// Its machine; empty where the job cannot be read.
    pub machine: String,
    /// How often a worker has taken it; above 1 some worker has ended before the job did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taken: Option<u64>,
    /// Why it has failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Returns where the jobs of a folder stand.
///
/// # Errors
/// The folder cannot be read.
pub fn read_status(store: &FleetStore) -> io::Result<FleetStatus> {
    let leases = lease::find_newest_leases(store)?;
    let failed = store.list_subfolder("failed")?;
    let mut status = FleetStatus::default();
    for id in store.list_job_ids()? {
        let machine = Job::read(store, &id).map(|job| job.machine).unwrap_or_default();
        let mut entry = JobStatus { id: id.clone(), machine, taken: None, reason: None };
        if store.result_folder(&id).exists() {
            status.done.push(entry);
        } else if failed.contains(&format!("{id}.json")) {
            let text = fs::read_to_string(store.failure_path(&id)).unwrap_or_default();
            let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
            entry.reason = value["reason"].as_str().map(String::from);
            status.failed.push(entry);
        } else if let Some(taken) = leases.get(&id) {
            entry.taken = Some(*taken);
            let is_free = lease::is_released(store, &id, *taken);
            if is_free { &mut status.waiting } else { &mut status.running }.push(entry);
        } else {
            status.waiting.push(entry);
        }
    }
    Ok(status)
}
