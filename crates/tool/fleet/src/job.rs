//! A job: the files of one diagnosis and its options, under an identifier that follows from its content.

use std::{fmt, fs, io, path::Path};

use serde::{Deserialize, Serialize};

use crate::store::{CRC, FleetStore, compute_checksum};

/// A file of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobFile {
    /// Its path as the user gave it.
    pub path: String,
    /// Its name in the folder of the job.
    pub stored: String,
    /// The CRC-64 of its content.
    pub crc64: String,
}

/// Request to the diagnosis, as the options of `trueup diagnose`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosisRequest {
    /// Quantity to compare, where the runs measure several.
    pub quantity: Option<String>,
    /// The size of an error that matters, in µm RMS.
    pub matters_um: Option<f64>,
    /// The uncertainty of the measuring instrument, in µm (95 %).
    pub instrument_um: Option<f64>,
    /// True if the CNC is known to apply the offset once.
    pub applied_once: bool,
    /// Keys and columns whose impossible values the user accepts.
    pub accept: Vec<String>,
}

/// A diagnosis to be made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// The version of this form.
    pub schema: u32,
    /// The machine: its serial number, or what the user calls it.
    pub machine: String,
    /// The day of the record, as 2026-11-22.
    pub date: Option<String>,
    /// The machine file.
    pub machine_file: JobFile,
    /// The runs.
    pub runs: Vec<JobFile>,
    /// Runs with the bridge disengaged.
    pub off: Vec<JobFile>,
    /// Runs not used for the fit.
    pub holdout: Vec<JobFile>,
    /// The request.
    pub request: DiagnosisRequest,
}

/// A file that is submitted: its path as the user gave it, and its content.
#[derive(Clone, Debug)]
pub struct SubmittedFile {
    /// The path.
    pub path: String,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// A job that is submitted.
#[derive(Clone, Debug)]
pub struct JobSubmission {
    /// The machine: its serial number, or what the user calls it.
    pub machine: String,
    /// The day of the record.
    pub date: Option<String>,
    /// The machine file.
    pub machine_file: SubmittedFile,
    /// The runs.
    pub runs: Vec<SubmittedFile>,
    /// Runs with the bridge disengaged.
    pub off: Vec<SubmittedFile>,
    /// Runs not used for the fit.
    pub holdout: Vec<SubmittedFile>,
    /// The request.
    pub request: DiagnosisRequest,
}

/// A job in the folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SubmittedJob {
    /// Its identifier.
    pub id: String,
    /// False if the same job was there already.
    pub is_new: bool,
    /// The day that the job was submitted with, `none` if without, where another one was given now.
    pub other_date: Option<String>,
}

/// Why a stored job cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StoredJobError {
    /// A file is missing or cannot be read.
    #[error("{0} cannot be read: {1}")]
    Unreadable(String, String),
    /// `job.json` is not of this form.
    #[error("job.json is damaged: {0}; submit the job again")]
    Form(String),
    /// A file differs from what was submitted.
    #[error(
        "{0} differs from what was submitted (its checksum is wrong): remove the folder of the job, and submit it again"
    )]
    Checksum(String),
}

impl JobSubmission {
    /// Returns the files in their order: the name that each has in the folder, and its content.
    fn files(&self) -> Vec<(String, &SubmittedFile)> {
        let numbered = |kind: &'static str, all: &'_ [SubmittedFile]| -> Vec<String> {
            (1..=all.len()).map(|number| format!("{kind}-{number}.csv")).collect()
        };
        let mut files = vec![("machine.toml".to_string(), &self.machine_file)];
        for (kind, all) in [("run", &self.runs), ("off", &self.off), ("holdout", &self.holdout)] {
            files.extend(numbered(kind, all).into_iter().zip(all));
        }
        files
    }

    /// Returns the identifier: the CRC-64 of the machine's name, the request, and each file with its name and length. The
    /// same content has the same identifier, wherever its files lie.
    #[must_use]
    pub fn id(&self) -> String {
        let mut digest = CRC.digest();
        let mut add = |bytes: &[u8]| {
            digest.update(&(bytes.len() as u64).to_le_bytes());
            digest.update(bytes);
        };
        add(self.machine.as_bytes());
        add(serde_json::to_string(&self.request).unwrap_or_default().as_bytes());
        for (name, content) in self.files() {
            add(name.as_bytes());
            add(&content.bytes);
        }
        format!("{:016x}", digest.finalize())
    }

    fn to_job(&self) -> Job {
        let stored = |stored: String, content: &SubmittedFile| JobFile {
            path: content.path.clone(),
            stored,
            crc64: compute_checksum(&content.bytes),
        };
        let mut files = self.files().into_iter().map(|(name, content)| stored(name, content));
        let mut take = |count: usize| -> Vec<JobFile> { files.by_ref().take(count).collect() };
        let machine_file = take(1).remove(0);
        Job {
            schema: 1,
            machine: self.machine.clone(),
            date: self.date.clone(),
            machine_file,
            runs: take(self.runs.len()),
            off: take(self.off.len()),
            holdout: take(self.holdout.len()),
            request: self.request.clone(),
        }
    }

    /// Puts the job into the folder. A job that failed before is tried again.
    ///
    /// # Errors
    /// The folder cannot be written, or has another job under this identifier.
    pub fn submit(&self, store: &FleetStore) -> io::Result<SubmittedJob> {
        let id = self.id();
        let target = store.job_folder(&id);
        if !target.exists() {
            let staged = store.create_staging_folder(&format!("job-{id}-"))?;
            let text = serde_json::to_string_pretty(&self.to_job())?;
            fs::write(staged.path().join("job.json"), text + "\n")?;
            for (name, content) in self.files() {
                fs::write(staged.path().join(name), &content.bytes)?;
            }
            if store.publish_folder(staged, &target)? {
                return Ok(SubmittedJob { id, is_new: true, other_date: None });
            }
        }
        let there = Job::read(store, &id).map_err(io::Error::other)?;
        let other_date = self.to_job().conflicting_date(there, target.display())?;
        fs::remove_file(store.failure_path(&id)).or_else(crate::store::ignore_not_found)?;
        Ok(SubmittedJob { id, is_new: false, other_date })
    }
}

impl Job {
    /// Reads a job of the folder.
    ///
    /// # Errors
    /// It is missing or damaged.
    pub fn read(store: &FleetStore, id: &str) -> Result<Self, StoredJobError> {
        let text = fs::read_to_string(store.job_folder(id).join("job.json"))
            .map_err(|error| StoredJobError::Unreadable("job.json".into(), error.to_string()))?;
        serde_json::from_str(&text).map_err(|error| StoredJobError::Form(error.to_string()))
    }

    /// Returns its files.
    pub(crate) fn files(&self) -> impl Iterator<Item = &JobFile> {
        let files =
            [std::slice::from_ref(&self.machine_file), &self.runs, &self.off, &self.holdout];
        files.into_iter().flatten()
    }

    /// Returns what the identifier is made of.
    fn identifying_content(&self) -> (&str, &DiagnosisRequest, Vec<(&str, &str)>) {
        let files = self.files().map(|file| (file.stored.as_str(), file.crc64.as_str()));
        (&self.machine, &self.request, files.collect())
    }

    /// Compares a job with the one that is at its place. Returns the day that stays, `none` if without, where another one
    /// is given now.
    ///
    /// # Errors
    /// It is another job.
    pub(crate) fn conflicting_date(
        &self,
        there: Self,
        place: impl fmt::Display,
    ) -> io::Result<Option<String>> {
        if there.identifying_content() != self.identifying_content() {
            let why = format!("{place}: holds another job");
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, why));
        }
        let is_other = self.date.is_some() && self.date != there.date;
        Ok(is_other.then(|| there.date.unwrap_or_else(|| "none".into())))
    }

    /// Reads a file of the job, and compares it with what was submitted.
    ///
    /// # Errors
    /// It is missing or damaged.
    pub fn read_file(&self, folder: &Path, file: &JobFile) -> Result<Vec<u8>, StoredJobError> {
        let bytes = fs::read(folder.join(&file.stored))
            .map_err(|error| StoredJobError::Unreadable(file.stored.clone(), error.to_string()))?;
        if compute_checksum(&bytes) != file.crc64 {
            return Err(StoredJobError::Checksum(file.stored.clone()));
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn submission(machine: &str, run: &[u8]) -> JobSubmission {
        let content =
            |path: &str, bytes: &[u8]| SubmittedFile { path: path.into(), bytes: bytes.into() };
        JobSubmission {
            machine: machine.into(),
            date: None,
            machine_file: content("m.toml", b"[machine]"),
            runs: vec![content("r.csv", run)],
            off: Vec::new(),
            holdout: Vec::new(),
            request: DiagnosisRequest::default(),
        }
    }

    #[test]
    fn the_same_content_is_one_job_and_another_is_another() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = FleetStore::create(folder.path()).expect("it is made");
        let first = submission("a", b"1").submit(&store).expect("it is written");
        let mut again = submission("a", b"1");
        again.runs[0].path = "elsewhere/r.csv".into();
        let again = again.submit(&store).expect("it is there");
        assert!(first.is_new && !again.is_new);
        assert_eq!(first.id, again.id);
        for other in [submission("b", b"1"), submission("a", b"2")] {
            assert_ne!(other.submit(&store).expect("it is written").id, first.id);
        }
        assert_eq!(store.list_job_ids().expect("it is read").len(), 3);
    }

    #[test]
    fn a_run_is_not_taken_for_a_hold_out() {
        let mut moved = submission("a", b"1");
        moved.holdout = moved.runs.clone();
        let mut twice = submission("a", b"1");
        twice.runs.push(twice.runs[0].clone());
        assert_ne!(moved.id(), twice.id());
    }

    #[test]
    fn a_flipped_bit_in_a_stored_run_is_found() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = FleetStore::create(folder.path()).expect("it is made");
        let id = submission("a", b"1").submit(&store).expect("it is written").id;
        let job = Job::read(&store, &id).expect("a job");
        assert_eq!(job.read_file(&store.job_folder(&id), &job.runs[0]).expect("it is read"), b"1");
        fs::write(store.job_folder(&id).join("run-1.csv"), b"3").expect("it is written");
        let found = job.read_file(&store.job_folder(&id), &job.runs[0]);
        assert_eq!(found, Err(StoredJobError::Checksum("run-1.csv".into())));
    }
}
