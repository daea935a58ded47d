//! The result of a job as it stands in the folder, compared with its checksums.

use std::{collections::BTreeMap, fs, io};

use serde::{Deserialize, Serialize};

use crate::store::{FleetStore, compute_checksum};

/// A file of a result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResultFile {
    /// Its name in `out`.
    pub name: String,
    /// The CRC-64 of its content.
    pub crc64: String,
}

/// `result.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobResult {
    /// The version of this form.
    pub schema: u32,
    /// The job.
    pub id: String,
    /// The machine.
    pub machine: String,
    /// The day of the record.
    pub date: Option<String>,
    /// The files of the diagnosis.
    pub files: Vec<ResultFile>,
}

/// A result with its files.
#[derive(Clone, Debug)]
pub struct StoredResult {
    /// The quantity.
    pub done: JobResult,
    /// The content of each file, by its name.
    pub files: BTreeMap<String, Vec<u8>>,
}

/// The results of a folder.
#[derive(Clone, Debug, Default)]
pub struct StoredResults {
    /// Those that are whole.
    pub whole: Vec<StoredResult>,
    /// Those that are damaged, each in a sentence.
    pub damaged: Vec<String>,
}

/// Reads every result.
///
/// # Errors
/// The folder cannot be read.
pub fn read_all_results(store: &FleetStore) -> io::Result<StoredResults> {
    let mut results = StoredResults::default();
    for id in store.list_subfolder("results")? {
        match read_result(store, &id) {
            Ok(stored) => results.whole.push(stored),
            Err(why) => results.damaged.push(format!(
                "results/{id}: {why}; remove this folder, and a worker does the job again"
            )),
        }
    }
    Ok(results)
}

fn read_result(store: &FleetStore, id: &str) -> Result<StoredResult, String> {
    let folder = store.result_folder(id);
    let unreadable = |name: &str, error: io::Error| format!("{name} cannot be read: {error}");
    let text = fs::read_to_string(folder.join("result.json"))
        .map_err(|error| unreadable("result.json", error))?;
    let done: JobResult =
        serde_json::from_str(&text).map_err(|error| format!("result.json is damaged: {error}"))?;
    if done.id != id {
        return Err(format!("result.json is damaged: it is of job {:?}", done.id));
    }
    let mut files = BTreeMap::new();
    for ResultFile { name, crc64 } in &done.files {
        // A name of the form that workers write, and no way out of the folder.
        if name.contains(['/', '\\']) {
            return Err(format!("result.json is damaged: {name:?} is no name of a file"));
        }
        let bytes =
            fs::read(folder.join("out").join(name)).map_err(|error| unreadable(name, error))?;
        if compute_checksum(&bytes) != *crc64 {
            return Err(format!("{name} is damaged (its checksum is wrong)"));
        }
        files.insert(name.clone(), bytes);
    }
    Ok(StoredResult { done, files })
}
