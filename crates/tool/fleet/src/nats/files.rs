//! Files between the server and a folder, both ways; each is compared with its checksum.

use std::{
    fmt::Display,
    fs, io,
    path::{Component, Path},
};

use async_nats::jetstream::object_store::GetErrorKind;
use serde::{Deserialize, Serialize};
use tokio::io::AsyncReadExt as _;

use super::{RemoteFleet, is_job_id};
use crate::{job::Job, job_result::JobResult, store::FleetStore};

/// A result on the server.
#[derive(Serialize, Deserialize)]
struct AttemptResult {
    /// Where its files are: `results/ID/ATTEMPT`.
    attempt: String,
    result: JobResult,
}

impl RemoteFleet {
    fn send(&self, name: &str, path: &Path) -> io::Result<()> {
        let bytes = fs::read(path)?;
        self.wait_for_response(name, self.files.put(name, &mut bytes.as_slice())).map(|_| ())
    }

    fn fetch_file(&self, name: &str, path: &Path) -> io::Result<()> {
        // A file that is missing or damaged stays so: unlike a server that does not answer it is not requested again.
        let lost = |error: &dyn Display| invalid_data_error(&format!("{name}: {error}"));
        let bytes = self.wait_for_response(name, async {
            let mut object = match self.files.get(name).await {
                Err(error) if error.kind() == GetErrorKind::NotFound => {
                    return Ok::<_, String>(Err(lost(&error)));
                }
                got => got.map_err(|error| error.to_string())?,
            };
            let mut bytes = Vec::new();
            let read = object.read_to_end(&mut bytes).await;
            match read {
                Err(error) if error.kind() == io::ErrorKind::InvalidData => Ok(Err(lost(&error))),
                other => other.map(|_| Ok(bytes)).map_err(|error| error.to_string()),
            }
        })?;
        fs::write(path, bytes?)
    }

    /// Sends the files of a job.
    pub(super) fn send_job_files(&self, store: &FleetStore, id: &str, job: &Job) -> io::Result<()> {
        let folder = store.job_folder(id);
        job.files().try_for_each(|file| {
            self.send(&format!("jobs/{id}/{}", file.stored), &folder.join(&file.stored))
        })
    }

    /// Fetches a job into a folder.
    pub(super) fn fetch_job_files(&self, store: &FleetStore, id: &str) -> io::Result<()> {
        let text = self.read_text(&self.jobs, id)?;
        let text = text.ok_or_else(|| invalid_data_error("the job is not on the server"))?;
        let job: Job =
            serde_json::from_str(&text).map_err(|error| invalid_data_error(&error.to_string()))?;
        let staged = store.create_staging_folder(&format!("job-{id}-"))?;
        for file in job.files() {
            let name = validate_file_name(&file.stored)?;
            self.fetch_file(&format!("jobs/{id}/{name}"), &staged.path().join(name))?;
        }
        // Last: no file of the job takes its place.
        fs::write(staged.path().join("job.json"), &text)?;
        store.publish_folder(staged, &store.job_folder(id)).map(|_| ())
    }

    /// Sends the result of a job, unless it has one. Returns whether it was the first.
    pub(super) fn send_result(
        &self,
        store: &FleetStore,
        id: &str,
        attempt: &str,
    ) -> io::Result<bool> {
        let folder = store.result_folder(id);
        let result: JobResult =
            serde_json::from_str(&fs::read_to_string(folder.join("result.json"))?)?;
        let object = |name: &str| format!("results/{id}/{attempt}/{name}");
        for file in &result.files {
            self.send(&object(&file.name), &folder.join("out").join(&file.name))?;
        }
        let names: Vec<String> = result.files.iter().map(|file| object(&file.name)).collect();
        let text = serde_json::to_string(&AttemptResult { attempt: attempt.into(), result })?;
        let is_first = self.put_if_absent(&self.results, id, text)?;
        if !is_first {
            names
                .iter()
                .try_for_each(|name| self.wait_for_response(name, self.files.delete(name)))?;
        }
        Ok(is_first)
    }

    /// Fetches the result of a job into a folder. Returns whether there is one.
    pub(super) fn fetch_result(&self, store: &FleetStore, id: &str) -> io::Result<bool> {
        let Some(text) = self.read_text(&self.results, id)? else { return Ok(false) };
        let of: AttemptResult =
            serde_json::from_str(&text).map_err(|error| invalid_data_error(&error.to_string()))?;
        let staged = store.create_staging_folder(&format!("result-{id}-"))?;
        let out = staged.path().join("out");
        fs::create_dir(&out)?;
        for file in &of.result.files {
            let name = validate_file_name(&file.name)?;
            self.fetch_file(&format!("results/{id}/{}/{name}", of.attempt), &out.join(name))?;
        }
        let text = serde_json::to_string_pretty(&of.result)? + "\n";
        fs::write(staged.path().join("result.json"), text)?;
        store.publish_folder(staged, &store.result_folder(id)).map(|_| true)
    }

    /// Marks a folder as the copy of this fleet, by the moment at which its queue was made.
    fn mark_as_copy(&self, store: &FleetStore) -> io::Result<()> {
        let created = self.queue.cached_info().created.unix_timestamp_nanos();
        let own = format!("the fleet whose queue was made at {created} ns since 1970\n");
        let file = store.copy_source_path();
        match fs::read_to_string(&file) {
            Ok(text) if text == own => Ok(()),
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            Err(_) if store.list_job_ids()?.is_empty() => store.publish_file(&file, &own),
            _ => {
                let rule = "holds the jobs of another fleet: give another --out, or remove it";
                let folder = file.parent().unwrap_or(&file).display();
                Err(io::Error::new(io::ErrorKind::AlreadyExists, format!("{folder}: {rule}")))
            }
        }
    }

    /// Fetches every job that has a result, with it, into a folder: `fleet diagnose` reads it there. Returns a sentence
    /// for each that cannot be had.
    ///
    /// # Errors
    /// The server does not answer, the folder cannot be written, or it holds the jobs of another fleet.
    pub fn fetch_results(&self, store: &FleetStore) -> io::Result<Vec<String>> {
        self.mark_as_copy(store)?;
        let mut damaged = Vec::new();
        for id in self.keys(&self.results)? {
            // Neither a job nor its result ever changes.
            if store.result_folder(&id).exists() {
                continue;
            }
            let fetched =
                self.fetch_job_files(store, &id).and_then(|()| self.fetch_result(store, &id));
            match fetched {
                Err(error) if error.kind() == io::ErrorKind::InvalidData => damaged.push(format!(
                    "results/{id}: {error}; submit the job again, and a worker does it again"
                )),
                other => drop(other?),
            }
        }
        Ok(damaged)
    }
}

fn invalid_data_error(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

/// Returns a name that leads nowhere but into the folder.
fn validate_file_name(name: &str) -> io::Result<&str> {
    let mut parts = Path::new(name).components();
    let is_plain = matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None));
    let is_plain = is_plain && !name.contains(['/', '\\']);
    is_plain
        .then_some(name)
        .ok_or_else(|| invalid_data_error(&format!("{name:?} is no name of a file")))
}

/// Returns the identifier in a subject of the queue.
pub(super) fn parse_job_id(subject: &str) -> Option<&str> {
    subject.rsplit('.').next().filter(|id| is_job_id(id))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_leads_out_of_the_folder() {
        for name in ["", ".", "..", "../x", "/x", "a/b", "a\\b"] {
            assert!(validate_file_name(name).is_err(), "{name}");
        }
        assert_eq!(validate_file_name("run-1.csv").expect("a name"), "run-1.csv");
        assert_eq!(parse_job_id("trueup.queue.0123456789abcdef"), Some("0123456789abcdef"));
        assert_eq!(parse_job_id("trueup.queue.*"), None);
    }
}
