//! What was learned, in a file beside the machine file: every change, and the way back.

use serde::{Deserialize, Serialize};

use crate::{bank::Bank, constants::Constant, step::Recent};

/// Records that are remembered so that none is learned from twice.
const RECORDS: usize = 1000;

/// Readings that are remembered for the same: two years at thirty a day.
const READINGS: usize = 20_000;

/// The form that is written.
pub(crate) const SCHEMA: u32 = 2;

/// What a learner knows. It is written as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Memory {
    /// Of this form; 2.
    pub schema: u32,
    /// The user's own machine file that it is counted from, hashed.
    pub(crate) base: u64,
    /// What is learned: `elongation`, `dx`, `dy` or `dz`.
    pub quantity: String,
    /// The constants, with what the user's own file says.
    pub constants: Vec<Constant>,
    pub(crate) bank: Bank,
    /// The zero in µm, then the share of each constant, as they are applied.
    pub applied: Vec<f64>,
    /// The clock of the last reading, in s.
    pub(crate) last_s: Option<f64>,
    /// Hashes of the records that were learned from.
    pub(crate) records: Vec<u64>,
    /// Hashes of the readings that were learned from: a record may grow.
    #[serde(default)]
    pub(crate) readings: Vec<u64>,
    /// The readings of late, with what the file as it is misses them by.
    #[serde(default)]
    pub(crate) recent: Vec<Recent>,
    /// Whether a record has shown that the CNC applies the offsets of the bridge once.
    #[serde(default)]
    pub(crate) is_applied_once: bool,
    /// Every change, the latest last.
    pub changes: Vec<Change>,
}

/// A change of the constants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// The record that it comes from, or `undo`.
    pub record: String,
    /// The constants before and after, each with its key.
    pub constants: Vec<(String, f64, f64)>,
    /// Why.
    pub reason: String,
    /// What was known and applied before; none once it was undone, or another was undone after it.
    pub(crate) before: Option<Box<Before>>,
}

/// What was known before a change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Before {
    pub bank: Bank,
    pub applied: Vec<f64>,
}

impl Memory {
    /// From JSON.
    ///
    /// # Errors
    /// It is not what a learner wrote; with the place.
    pub fn read(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Form {
            schema: u32,
        }
        let Form { schema } = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if schema != SCHEMA {
            return Err(format!(
                "schema is {schema}, and this version reads {SCHEMA}: move it away, and learning begins anew"
            ));
        }
        let memory: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        let values = memory.constants.len() + 1;
        let is_whole =
            |bank: &Bank, applied: &[f64]| applied.len() == values && bank.is_whole(values);
        let before = memory.changes.iter().filter_map(|change| change.before.as_ref());
        if !is_whole(&memory.bank, &memory.applied)
            || !before.into_iter().all(|before| is_whole(&before.bank, &before.applied))
        {
            return Err("its parts do not fit together, so it is damaged: move it away, and learning begins anew".into());
        }
        Ok(memory)
    }

    /// As JSON.
    ///
    /// # Errors
    /// None that is known: all of it can be written.
    pub fn write(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string(self)
    }

    /// Takes the last change back that is not taken back yet: what is applied, and what was known, are as before
    /// it. The record that it came from is not learned from again. Returns the change, or `None` where there
    /// is none.
    pub fn undo(&mut self) -> Option<Change> {
        let index = self.changes.iter().rposition(|change| change.before.is_some())?;
        let before = self.changes[index].before.take()?;
        let undone = self.changes[index].clone();
        self.bank = before.bank;
        self.applied = before.applied;
        let back = undone.constants.iter().map(|(key, from, to)| (key.clone(), *to, *from));
        self.changes.push(Change {
            record: "undo".into(),
            constants: back.collect(),
            reason: format!("what came from {} is taken back", undone.record),
            before: None,
        });
        Some(undone)
    }

    pub(crate) fn knows(&self, record: u64) -> bool {
        self.records.contains(&record)
    }

    pub(crate) fn knows_reading(&self, reading: u64) -> bool {
        self.readings.contains(&reading)
    }

    pub(crate) fn remember_reading(&mut self, reading: u64) {
        self.readings.push(reading);
        if self.readings.len() > READINGS {
            self.readings.remove(0);
        }
    }

    pub(crate) fn remember(&mut self, record: u64) {
        self.records.push(record);
        if self.records.len() > RECORDS {
            self.records.remove(0);
        }
    }
}

/// FNV-1a over 64 bits: the same on every machine.
pub(crate) fn hash(bytes: impl Iterator<Item = u8>) -> u64 {
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
