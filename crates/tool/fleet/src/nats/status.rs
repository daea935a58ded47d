//! Where the jobs on a server stand.

use std::io;

use super::RemoteFleet;
use crate::{
    job::Job,
    worker::{FleetStatus, JobStatus},
};

impl RemoteFleet {
    /// Returns where the jobs stand. A job counts as running while its worker says so, and a minute longer.
    ///
    /// # Errors
    /// The server does not answer.
    pub fn status(&self) -> io::Result<FleetStatus> {
        let [results, failed, leases] =
            [&self.results, &self.failed, &self.leases].map(|bucket| self.keys(bucket));
        let (results, failed, leases) = (results?, failed?, leases?);
        let mut status = FleetStatus::default();
        for id in self.keys(&self.jobs)? {
            let text = self.read_text(&self.jobs, &id)?.unwrap_or_default();
            let job: Option<Job> = serde_json::from_str(&text).ok();
            let machine = job.map(|job| job.machine).unwrap_or_default();
            let mut entry = JobStatus { id: id.clone(), machine, taken: None, reason: None };
            let is_in = |ids: &[String]| ids.binary_search(&id).is_ok();
            if is_in(&results) {
                status.done.push(entry);
            } else if is_in(&failed) {
                let text = self.read_text(&self.failed, &id)?.unwrap_or_default();
                let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
                entry.reason = value["reason"].as_str().map(String::from);
                status.failed.push(entry);
            } else if is_in(&leases) {
                entry.taken =
                    self.read_text(&self.leases, &id)?.and_then(|taken| taken.parse().ok());
                status.running.push(entry);
            } else {
                status.waiting.push(entry);
            }
        }
        Ok(status)
    }
}
