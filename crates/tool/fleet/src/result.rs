//! The result of a job as it stands in the folder, compared with its checksums.

use std::{collections::BTreeMap, fs, io};

use serde::{Deserialize, Serialize};

use crate::store::{Store, checksum};

/// A file of a result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Named {
    /// Its name in `out`.
    pub name: String,
    /// The CRC-64 of its content.
    pub crc64: String,
}

/// `result.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Done {
    /// The version of this form.
    pub schema: u32,
    /// The job.
    pub id: String,
    /// The machine.
    pub machine: String,
    /// The day of the record.
    pub date: Option<String>,
    /// The files of the diagnosis.
    pub files: Vec<Named>,
}

/// A result with its files.
#[derive(Clone, Debug)]
pub struct Stored {
    /// The quantity.
    pub done: Done,
    /// The content of each file, by its name.
    pub files: BTreeMap<String, Vec<u8>>,
}

/// The results of a folder.
#[derive(Clone, Debug, Default)]
pub struct Results {
    /// Those that are whole.
    pub whole: Vec<Stored>,
    /// Those that are damaged, each in a sentence.
    pub damaged: Vec<String>,
}

/// Reads every result.
///
/// # Errors
/// The folder cannot be read.
pub fn read(store: &Store) -> io::Result<Results> {
    let mut results = Results::default();
    for id in store.list("results")? {
        match stored(store, &id) {
            Ok(stored) => results.whole.push(stored),
            Err(why) => results.damaged.push(format!(
                "results/{id}: {why}; remove this folder, and a worker does the job again"
            )),
        }
    }
    Ok(results)
}

fn stored(store: &Store, id: &str) -> Result<Stored, String> {
    let folder = store.result(id);
    let unreadable = |name: &str, error: io::Error| format!("{name} cannot be read: {error}");
    let text = fs::read_to_string(folder.join("result.json"))
        .map_err(|error| unreadable("result.json", error))?;
    let done: Done =
        serde_json::from_str(&text).map_err(|error| format!("result.json is damaged: {error}"))?;
    if done.id != id {
        return Err(format!("result.json is damaged: it is of job {:?}", done.id));
    }
    let mut files = BTreeMap::new();
    for Named { name, crc64 } in &done.files {
        // A name of the form that workers write, and no way out of the folder.
        if name.contains(['/', '\\']) {
            return Err(format!("result.json is damaged: {name:?} is no name of a file"));
        }
        let bytes =
            fs::read(folder.join("out").join(name)).map_err(|error| unreadable(name, error))?;
        if checksum(&bytes) != *crc64 {
            return Err(format!("{name} is damaged (its checksum is wrong)"));
        }
        files.insert(name.clone(), bytes);
    }
    Ok(Stored { done, files })
}
