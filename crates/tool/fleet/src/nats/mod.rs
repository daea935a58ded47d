//! The fleet on a NATS server with JetStream, for workers on any computer.
//!
//! | on the server | holds |
//! |---|---|
//! | key-value bucket `trueup-jobs` | ID → `job.json` |
//! | object store `trueup-files` | `jobs/ID/FILE`, `results/ID/ATTEMPT/FILE` |
//! | stream `trueup-queue`, subject `trueup.queue.ID` | jobs that have not ended, each once; removed when a worker acknowledges |
//! | key-value bucket `trueup-results` | ID → `result.json` and which attempt it is of; the first one stays |
//! | key-value bucket `trueup-failed` | ID → why the job cannot be done |
//! | key-value bucket `trueup-leases` | ID → the worker that has it; ends by itself |
//!
//! A worker fetches a job into a folder of its own and does it there as [`crate::worker`] does: the result is the same,
//! to the byte. A message that is not acknowledged within the length of a lease goes to another worker, so a worker
//! that is killed loses nothing. An acknowledged message is on the server's disk if the server synchronises always, as
//! that of [`server`] does.

mod files;
pub mod records;
pub mod server;
mod status;
mod submit;
mod worker;

use std::{
    fmt, io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    time::Duration,
};

use async_nats::{
    ConnectOptions,
    jetstream::{
        self, Context,
        kv::{self, CreateErrorKind},
        object_store::{self, ObjectStore},
        stream::{self, DiscardPolicy, RetentionPolicy, Stream},
    },
};
use tokio::runtime::{Builder, Runtime};

const QUEUE_STREAM: &str = "trueup-queue";
const QUEUE_SUBJECT: &str = "trueup.queue";
const FILE_BUCKET: &str = "trueup-files";
/// How long a worker that says nothing is shown as the one that has a job.
const LEASE_TTL: Duration = Duration::from_secs(60);
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// The longest wait for an answer of several parts: a list of keys, a file.
const MULTIPART_RESPONSE_TIMEOUT: Duration = Duration::from_secs(120);

/// How a server is reached.
#[derive(Clone, Default)]
pub struct ConnectionSettings {
    /// Its address, `nats://127.0.0.1:4222`, or `tls://…`.
    pub url: String,
    /// Name and password.
    pub login: Option<(String, String)>,
    /// The certificate of the authority that the server's certificate is of, in PEM; none: those of the system.
    pub authority: Option<PathBuf>,
}

/// A fleet on a server.
pub struct RemoteFleet {
    runtime: Runtime,
    url: String,
    context: Context,
    queue: Stream,
    files: ObjectStore,
    jobs: kv::Store,
    results: kv::Store,
    failed: kv::Store,
    leases: kv::Store,
}

impl RemoteFleet {
    /// Connects, and makes what the fleet needs on the server.
    ///
    /// # Errors
    /// The server cannot be reached, refuses the login, or has no JetStream.
    pub fn create(access: &ConnectionSettings) -> io::Result<Self> {
        Self::connect(access, true)
    }

    /// Connects to a server on which a job was submitted.
    ///
    /// # Errors
    /// The server cannot be reached or refuses the login, or there is no fleet on it.
    pub fn open(access: &ConnectionSettings) -> io::Result<Self> {
        Self::connect(access, false)
    }

    fn connect(access: &ConnectionSettings, creates: bool) -> io::Result<Self> {
        let runtime = create_runtime()?;
        let url = &access.url;
        let made = runtime.block_on(async {
            let context = connect_jetstream(access).await?;
            let lacks = |what: &str, error: &dyn fmt::Display| {
                let why = format!("{url}: {what}: {error}; trueup fleet submit makes it on a server with JetStream");
                io::Error::new(io::ErrorKind::NotFound, why)
            };
            let queue = match creates {
                true => context.get_or_create_stream(queue_config()).await.map_err(|error| lacks("no queue", &error))?,
                false => context.get_stream(QUEUE_STREAM).await.map_err(|error| lacks("no queue", &error))?,
            };
            let files = match context.get_object_store(FILE_BUCKET).await {
                Err(_) if creates => {
                    let config = object_store::Config { bucket: FILE_BUCKET.into(), ..Default::default() };
                    context.create_object_store(config).await.map_err(|error| lacks("no store of files", &error))?
                }
                got => got.map_err(|error| lacks("no store of files", &error))?,
            };
            let mut buckets = Vec::new();
            for (name, max_age) in [("jobs", None), ("results", None), ("failed", None), ("leases", Some(LEASE_TTL))] {
                let bucket = format!("trueup-{name}");
                let max_age = max_age.unwrap_or_default();
                let store = match context.get_key_value(&bucket).await {
                    Err(_) if creates => {
                        let config = kv::Config { bucket, max_age, ..Default::default() };
                        context.create_key_value(config).await.map_err(|error| lacks(name, &error))?
                    }
                    got => got.map_err(|error| lacks(name, &error))?,
                };
                buckets.push(store);
            }
            let buckets = <[kv::Store; 4]>::try_from(buckets).map_err(|_| io::Error::other("four buckets"))?;
            Ok::<_, io::Error>((context, queue, files, buckets))
        });
        let (context, queue, files, [jobs, results, failed, leases]) = made?;
        Ok(Self { runtime, url: url.clone(), context, queue, files, jobs, results, failed, leases })
    }

    /// Waits for an answer of the server, and no longer than [`MULTIPART_RESPONSE_TIMEOUT`].
    ///
    /// The client's reader of files and keys waits without end for a server that went away in the middle, and panics if it
    /// went away before the first part. Both are errors here, after which the worker tries again.
    fn wait_for_response<T, E: fmt::Display>(
        &self,
        what: &str,
        answer: impl Future<Output = Result<T, E>>,
    ) -> io::Result<T> {
        let answer = async { tokio::time::timeout(MULTIPART_RESPONSE_TIMEOUT, answer).await };
        let why = match catch_unwind(AssertUnwindSafe(|| self.runtime.block_on(answer))) {
            Ok(Ok(Ok(value))) => return Ok(value),
            Ok(Ok(Err(error))) => error.to_string(),
            Ok(Err(_)) => format!("no answer within {} s", MULTIPART_RESPONSE_TIMEOUT.as_secs()),
            Err(_) => "the server went away in the middle of an answer".into(),
        };
        Err(io::Error::other(format!("{}: {what}: {why}", self.url)))
    }

    fn read_text(&self, bucket: &kv::Store, id: &str) -> io::Result<Option<String>> {
        let value = self.wait_for_response(id, bucket.get(id))?;
        let text = value.map(|value| String::from_utf8(value.to_vec()));
        text.transpose().map_err(|_| io::Error::other(format!("{}: {id}: is no text", self.url)))
    }

    /// Writes a key that is not there yet. Returns whether the key has this text now.
    fn put_if_absent(&self, bucket: &kv::Store, id: &str, text: String) -> io::Result<bool> {
        match self.runtime.block_on(bucket.create(id, text.clone().into())) {
            Ok(_) => Ok(true),
            // If the server is killed between writing and answering, the client finds the text of this very call there.
            Err(error) if error.kind() == CreateErrorKind::AlreadyExists => {
                Ok(self.read_text(bucket, id)?.as_deref() == Some(text.as_str()))
            }
            Err(error) => Err(io::Error::other(format!("{}: {id}: {error}", self.url))),
        }
    }

    /// Returns the keys of a bucket, sorted.
    fn keys(&self, bucket: &kv::Store) -> io::Result<Vec<String>> {
        use futures_util::TryStreamExt as _;
        let mut keys: Vec<String> = self.wait_for_response("keys", async {
            let keys = bucket.keys().await.map_err(|error| error.to_string())?;
            keys.try_collect().await.map_err(|error| error.to_string())
        })?;
        // Only what is an identifier becomes a name of a file.
        keys.retain(|key| is_job_id(key));
        keys.sort();
        Ok(keys)
    }
}

/// Returns whether it is an identifier of a job, which may be a name of a folder.
fn is_job_id(key: &str) -> bool {
    key.len() == 16 && key.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Returns a runtime whose one thread answers the server while the others compute.
fn create_runtime() -> io::Result<Runtime> {
    Builder::new_multi_thread().worker_threads(1).enable_all().build()
}

async fn connect_jetstream(access: &ConnectionSettings) -> io::Result<Context> {
    let mut options =
        ConnectOptions::new().name("trueup fleet").connection_timeout(REQUEST_TIMEOUT);
    if let Some((user, password)) = &access.login {
        options = options.user_and_password(user.clone(), password.clone());
    }
    if let Some(file) = &access.authority {
        options = options.add_root_certificates(file.clone());
    }
    let client = options.connect(&access.url).await.map_err(|error| {
        let why = format!(
            "{}: no server answers: {error}; trueup fleet server --dir DIR starts one",
            access.url
        );
        io::Error::new(io::ErrorKind::ConnectionRefused, why)
    })?;
    Ok(jetstream::ContextBuilder::new().timeout(REQUEST_TIMEOUT).build(client))
}

/// Each job at most once, until a worker has acknowledged it.
fn queue_config() -> stream::Config {
    stream::Config {
        name: QUEUE_STREAM.into(),
        subjects: vec![format!("{QUEUE_SUBJECT}.*")],
        retention: RetentionPolicy::WorkQueue,
        max_messages_per_subject: 1,
        discard: DiscardPolicy::New,
        discard_new_per_subject: true,
        ..Default::default()
    }
}
