//! A job that is put on the server.

use std::io;

use super::{QUEUE_SUBJECT, RemoteFleet};
use crate::{
    job::{Job, JobSubmission, SubmittedJob},
    store::FleetStore,
};

impl RemoteFleet {
    /// Puts a job on the server. A job that failed before, or whose result is damaged on the server, is tried again. Once
    /// this has returned, the job is on the server's disk.
    ///
    /// # Errors
    /// The server does not answer, or has another job under this identifier.
    pub fn submit(&self, submission: &JobSubmission) -> io::Result<SubmittedJob> {
        let folder = tempfile::tempdir()?;
        let store = FleetStore::create(folder.path())?;
        let id = submission.submit(&store)?.id;
        let job = Job::read(&store, &id).map_err(io::Error::other)?;
        let there = self.read_text(&self.jobs, &id)?;
        let is_new = there.is_none() && {
            self.send_job_files(&store, &id, &job)?;
            let text = serde_json::to_string_pretty(&job)? + "\n";
            self.put_if_absent(&self.jobs, &id, text)?
        };
        let mut other_date = None;
        if let Some(there) = there {
            let there: Job = serde_json::from_str(&there)?;
            other_date = job.conflicting_date(there, format_args!("{}: {id}", self.url))?;
        }
        if self.read_text(&self.failed, &id)?.is_some() {
            // A file that was damaged on the server is whole again.
            self.send_job_files(&store, &id, &job)?;
            self.wait_for_response(&id, self.failed.purge(&id))?;
        }
        match self.fetch_result(&store, &id) {
            Ok(true) => return Ok(SubmittedJob { id, is_new, other_date }),
            Ok(false) => {}
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                self.send_job_files(&store, &id, &job)?;
                self.wait_for_response(&id, self.results.purge(&id))?;
            }
            Err(error) => return Err(error),
        }
        self.enqueue(&id)?;
        Ok(SubmittedJob { id, is_new, other_date })
    }

    /// Puts a job into the queue, unless it is there.
    pub(super) fn enqueue(&self, id: &str) -> io::Result<()> {
        let subject = format!("{QUEUE_SUBJECT}.{id}");
        let sent = self.runtime.block_on(async {
            let sent = self.context.publish(subject.clone(), "".into()).await;
            match sent {
                Ok(stored) => stored.await.map(|_| ()),
                Err(error) => Err(error),
            }
        });
        let Err(error) = sent else { return Ok(()) };
        // The queue takes each job once.
        let is_there = self.runtime.block_on(self.queue.get_last_raw_message_by_subject(&subject));
        is_there.map(|_| ()).map_err(|_| io::Error::other(format!("{}: {error}", self.url)))
    }

    /// Returns how many jobs have not ended.
    pub(super) fn count_unfinished_jobs(&self) -> io::Result<u64> {
        let info = self.wait_for_response("the queue", self.queue.get_info())?;
        Ok(info.state.messages)
    }
}
