//! The folder of a fleet: what stands where, and how a file or a folder becomes visible whole.
//!
//! ```text
//! jobs/ID/job.json, machine.toml, run-1.csv …   what was submitted; never changed
//! leases/ID.N                                   the N-th worker that took the job
//! results/ID/result.json, out/…                 out: what `trueup diagnose --out` writes
//! failed/ID.json                                why the job cannot be done
//! copy-of                                       of which fleet on a server the folder is a copy
//! tmp/…                                         not yet whole
//! ```
//!
//! Everything is written below `tmp`, synchronised to the disk, and renamed. A rename is atomic, so a reader sees
//! either nothing or all of it, whenever a process or the computer stops.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use crc::{CRC_64_XZ, Crc};
use tempfile::{NamedTempFile, TempDir};

/// The folders of a fleet.
const FLEET_SUBFOLDERS: [&str; 5] = ["jobs", "leases", "results", "failed", "tmp"];

/// A fleet's folder.
#[derive(Clone, Debug)]
pub struct FleetStore {
    root: PathBuf,
}

impl FleetStore {
    /// Opens the folder, and makes what is missing of it.
    ///
    /// # Errors
    /// A folder cannot be made.
    pub fn create(root: &Path) -> io::Result<Self> {
        FLEET_SUBFOLDERS.iter().try_for_each(|name| fs::create_dir_all(root.join(name)))?;
        Ok(Self { root: root.into() })
    }

    /// Opens a folder that `submit` has made; none where it is something else.
    #[must_use]
    pub fn open(root: &Path) -> Option<Self> {
        let is_there = FLEET_SUBFOLDERS.iter().all(|name| root.join(name).is_dir());
        is_there.then(|| Self { root: root.into() })
    }

    /// Returns the folder of a job.
    #[must_use]
    pub fn job_folder(&self, id: &str) -> PathBuf {
        self.root.join("jobs").join(id)
    }

    /// Returns the folder of a result.
    #[must_use]
    pub fn result_folder(&self, id: &str) -> PathBuf {
        self.root.join("results").join(id)
    }

    /// Returns the file that says why a job has failed.
    #[must_use]
    pub(crate) fn failure_path(&self, id: &str) -> PathBuf {
        self.root.join("failed").join(format!("{id}.json"))
    }

    /// Returns the file that says of which fleet on a server this folder is a copy.
    pub(crate) fn copy_source_path(&self) -> PathBuf {
        self.root.join("copy-of")
    }

    /// Returns the names in one of the folders, sorted.
    pub(crate) fn list_subfolder(&self, folder: &str) -> io::Result<Vec<String>> {
        list_file_names(&self.root.join(folder))
    }

    /// Returns the file of a lease.
    pub(crate) fn lease_path(&self, name: &str) -> PathBuf {
        self.root.join("leases").join(name)
    }

    /// Returns whether a job has ended, with a result or a reason.
    pub(crate) fn is_job_ended(&self, id: &str) -> bool {
        self.result_folder(id).exists() || self.failure_path(id).exists()
    }

    /// Returns the jobs that were submitted, in the order of their identifiers.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn list_job_ids(&self) -> io::Result<Vec<String>> {
        self.list_subfolder("jobs")
    }

    /// Returns a new folder that is not visible yet.
    pub(crate) fn create_staging_folder(&self, prefix: &str) -> io::Result<TempDir> {
        tempfile::Builder::new().prefix(prefix).tempdir_in(self.root.join("tmp"))
    }

    /// Makes a staged folder visible as `target`, unless there is one of that name: the first one stays. Returns whether
    /// it was the first.
    pub(crate) fn publish_folder(&self, staged: TempDir, target: &Path) -> io::Result<bool> {
        sync_tree(staged.path())?;
        let from = staged.keep();
        let renamed = fs::rename(&from, target);
        if renamed.is_ok() {
            if let Some(parent) = target.parent() {
                sync_folder(parent)?;
            }
            return Ok(true);
        }
        // Another one was first.
        if target.is_dir() {
            let removed = fs::remove_dir_all(&from);
            return removed.or_else(ignore_not_found).map(|()| false);
        }
        renamed.map(|()| true)
    }

    /// Makes a file visible whole, in the place of what is there.
    pub(crate) fn publish_file(&self, target: &Path, text: &str) -> io::Result<()> {
        let mut file = NamedTempFile::new_in(self.root.join("tmp"))?;
        file.write_all(text.as_bytes())?;
        file.as_file().sync_all()?;
        file.persist(target).map_err(|error| error.error)?;
        target.parent().map_or(Ok(()), sync_folder)
    }

    /// Removes what workers that were killed have left of a job that has ended.
    pub(crate) fn clear_staging(&self, prefix: &str) -> io::Result<()> {
        for name in self.list_subfolder("tmp")?.iter().filter(|name| name.starts_with(prefix)) {
            fs::remove_dir_all(self.root.join("tmp").join(name)).or_else(ignore_not_found)?;
        }
        Ok(())
    }
}

/// Returns the names in a folder, sorted.
fn list_file_names(folder: &Path) -> io::Result<Vec<String>> {
    let entries = fs::read_dir(folder)?;
    let mut names: Vec<String> = entries
        .map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()))
        .collect::<io::Result<_>>()?;
    names.sort();
    Ok(names)
}

/// Returns success for what another process has removed already.
pub(crate) fn ignore_not_found(error: io::Error) -> io::Result<()> {
    if error.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(error) }
}

/// Synchronises each file of a folder, then the folder.
fn sync_tree(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            sync_tree(&path)?;
        } else {
            File::open(&path)?.sync_all()?;
        }
    }
    sync_folder(folder)
}

/// Synchronises the names in a folder, where the system can.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Returns the CRC-64 (that of xz) of bytes, as 16 hexadecimal digits.
#[must_use]
pub fn compute_checksum(bytes: &[u8]) -> String {
    format!("{:016x}", CRC.checksum(bytes))
}

/// The polynomial of checksums and identifiers.
pub(crate) const CRC: Crc<u64, crc::Table<16>> = Crc::<u64, crc::Table<16>>::new(&CRC_64_XZ);
