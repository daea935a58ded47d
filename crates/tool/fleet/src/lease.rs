//! Leases: which worker has a job, and when another one may take it.
//!
//! The file `leases/ID.N` says that the job was taken for the N-th time; its owner rewrites it with a counter while it
//! works. A worker takes a job by creating the next file, which the file system lets only one succeed in. A lease has
//! ended when its counter has not moved for the length of a lease *as this worker has watched it*: no clock of another
//! computer takes part, and none that is set back. A file is never taken over, so that a worker that stood still and
//! goes on disturbs nothing: it works on an older number, and the first result stays.

use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, OpenOptions},
    io::{self, Write as _},
    path::PathBuf,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use crate::store::{FleetStore, ignore_not_found};

/// Content of a lease whose owner has given it back.
const RELEASED_MARKER: &str = "released";

/// The newest lease of each job.
pub(crate) type NewestLeases = BTreeMap<String, u64>;

/// Leases of others, as a worker has seen them.
#[derive(Debug)]
pub(crate) struct LeaseMonitor {
    length: Duration,
    seen: Mutex<HashMap<PathBuf, (String, Instant)>>,
}

/// A lease that this worker holds.
#[derive(Debug)]
pub(crate) struct JobLease {
    path: PathBuf,
    worker: String,
    beats: u64,
}

impl LeaseMonitor {
    pub(crate) fn new(length: Duration) -> Self {
        Self { length, seen: Mutex::default() }
    }

    /// Returns whether a lease has ended at `now`.
    pub(crate) fn has_expired(&self, path: PathBuf, now: Instant) -> bool {
        let Ok(content) = fs::read_to_string(&path) else { return false };
        if content == RELEASED_MARKER {
            return true;
        }
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = seen.entry(path).or_insert_with(|| (content.clone(), now));
        if entry.0 != content {
            *entry = (content, now);
        }
        now.saturating_duration_since(entry.1) >= self.length
    }
}

/// Returns whether a lease was given back.
pub(crate) fn is_released(store: &FleetStore, id: &str, number: u64) -> bool {
    fs::read_to_string(lease_path(store, id, number))
        .is_ok_and(|content| content == RELEASED_MARKER)
}

/// Returns the newest lease of each job.
pub(crate) fn find_newest_leases(store: &FleetStore) -> io::Result<NewestLeases> {
    let mut newest = NewestLeases::new();
    for name in store.list_subfolder("leases")? {
        if let Some((id, number)) = parse_lease_file_name(&name) {
            let known = newest.entry(id.to_string()).or_default();
            *known = number.max(*known);
        }
    }
    Ok(newest)
}

fn parse_lease_file_name(name: &str) -> Option<(&str, u64)> {
    let (id, number) = name.rsplit_once('.')?;
    Some((id, number.parse().ok()?))
}

/// Returns the file of a lease.
pub(crate) fn lease_path(store: &FleetStore, id: &str, number: u64) -> PathBuf {
    store.lease_path(&format!("{id}.{number}"))
}

/// Removes the leases of a job that has ended.
pub(crate) fn remove_leases(store: &FleetStore, id: &str) -> io::Result<()> {
    for name in store.list_subfolder("leases")? {
        if parse_lease_file_name(&name).is_some_and(|(of, _)| of == id) {
            fs::remove_file(store.lease_path(&name)).or_else(ignore_not_found)?;
        }
    }
    Ok(())
}

impl JobLease {
    /// Takes a job for the `number`-th time; none where another worker was faster.
    pub(crate) fn acquire(
        store: &FleetStore,
        id: &str,
        number: u64,
        worker: &str,
    ) -> io::Result<Option<Self>> {
        let path = lease_path(store, id, number);
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(mut file) => {
                file.write_all(format!("{worker} 0").as_bytes())?;
                Ok(Some(Self { path, worker: worker.into(), beats: 0 }))
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Shows that the worker is alive. A lease that cannot be written ends, and another worker does the job too: the
    /// first result stays.
    pub(crate) fn renew(&mut self) {
        self.beats += 1;
        let content = format!("{} {}", self.worker, self.beats);
        // Not `create`: what was cleared stays so.
        let file = OpenOptions::new().write(true).truncate(true).open(&self.path);
        let _ = file.and_then(|mut file| file.write_all(content.as_bytes()));
    }

    /// Gives the job back, so that another worker need not wait for the end of the lease.
    pub(crate) fn release(&self) {
        // Else it ends by itself.
        let _ = fs::write(&self.path, RELEASED_MARKER);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_of_two_workers_gets_a_job_and_a_still_counter_ends_its_lease() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = FleetStore::create(folder.path()).expect("it is made");
        let take = |number| JobLease::acquire(&store, "a", number, "w").expect("it is written");
        let mut first = take(1).expect("nobody has it");
        assert!(take(1).is_none());
        let watch = LeaseMonitor::new(Duration::from_secs(10));
        let start = Instant::now();
        let ended =
            |s| watch.has_expired(lease_path(&store, "a", 1), start + Duration::from_secs(s));
        assert!(!ended(0) && !ended(9));
        first.renew();
        assert!(!ended(15) && !ended(24) && ended(25));
        assert!(take(2).is_some());
        assert_eq!(find_newest_leases(&store).expect("it is read").get("a"), Some(&2));
        first.release();
        assert!(ended(25), "what was given back is free at once");
    }
}
