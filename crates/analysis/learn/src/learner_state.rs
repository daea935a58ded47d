//! The state of a learner, in a file next to the learned machine file: everything that is known, every change, and the
//! way back. It belongs to one machine (by its serial number, else its name) and one quantity.
//!
//! ```text
//! checkpoint ──► window of readings ──► what is believed now
//!   filters        the last 300, as they were read
//! ```
//!
//! The present belief is never stored: it is the checkpoint, advanced by the readings of the window and the events
//! among them. So an event that is found late acts from the reading at which it happened, and a state that was read back
//! is the same to the bit. A reading that leaves the window advances the checkpoint.

use std::collections::HashSet;

use serde::{Deserialize, Serialize};

use trueup_machine::Machine;

use crate::{
    event::DetectedEvent, filter_bank::FilterBank, learnable_constants::LearnableConstant,
    wear_regression::RegressionSums,
};

/// Readings that are known by their hash: a year at thirty a day, 8 bytes each.
const MAX_SEEN_READINGS: usize = 12_000;
/// Digits of a hash.
const HASH_DIGIT_COUNT: usize = 8;
/// Changes that are listed: one a day at most, a year and a half of days.
const MAX_STORED_CHANGES: usize = 400;

/// The form that is written.
const SCHEMA_VERSION: u32 = 3;
/// The form before it, which is read too.
const PREVIOUS_SCHEMA_VERSION: u32 = 2;

/// The machine that a state belongs to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MachineIdentity {
    /// Its name.
    pub name: String,
    /// Its serial number, where its file has one.
    pub serial: Option<String>,
}

impl MachineIdentity {
    /// Returns the machine that a machine file is of.
    #[must_use]
    pub fn from_machine(machine: &Machine) -> Self {
        Self { name: machine.name.clone(), serial: machine.serial.clone() }
    }

    /// Returns true if both are one machine: by the serial numbers where both have one, else by the names.
    #[must_use]
    pub fn is_same_as(&self, other: &Self) -> bool {
        match (&self.serial, &other.serial) {
            (Some(one), Some(two)) => one == two,
            _ => self.name == other.name,
        }
    }

    /// Returns the machine in words.
    #[must_use]
    pub fn description(&self) -> String {
        let serial =
            self.serial.as_ref().map_or(String::new(), |serial| format!(" (serial {serial})"));
        format!("machine {}{serial}", self.name)
    }
}

/// A stored reading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StoredReading {
    /// The clock in s.
    pub t: Option<f64>,
    /// The reading less the prediction of the user's file, in µm.
    pub y: f64,
    /// Sensitivities: of the zero, of each constant.
    pub g: Vec<f64>,
    /// Effect of each thermometer per unit share, in µm.
    pub h: Vec<f64>,
    /// Its evidence on the growth of each backlash, in µm; empty where it was refused.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub worn: Vec<f64>,
}

/// The state of a learner. It is written as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearnerState {
    /// The form; 3.
    pub schema: u32,
    /// The machine.
    pub machine: MachineIdentity,
    /// The learned quantity: `elongation`, `dx`, `dy` or `dz`.
    pub quantity: String,
    /// The constants, with what the user's own file says.
    pub constants: Vec<LearnableConstant>,
    /// The value in the user's file where the zero of the growth is written.
    pub(crate) zero: Option<f64>,
    /// The zero in µm, then the share of each constant, as they are applied.
    pub applied: Vec<f64>,
    /// The clock of the first and of the last reading, in s.
    pub(crate) first_s: Option<f64>,
    pub(crate) last_s: Option<f64>,
    /// Whether a record has shown that the CNC applies the offsets of the bridge once.
    pub(crate) is_applied_once: bool,
    /// The values applied before the readings of an engaged bridge whose factor is not known moved them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) proven: Option<Vec<f64>>,
    /// The column of the air, where a record has had one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) air: Option<String>,
    /// The events, the latest last.
    pub events: Vec<DetectedEvent>,
    /// Every change, the latest last.
    pub changes: Vec<DailyChange>,
    /// Checks of the probe: the clock in s, and the reading of a certified reference less its value at 20 °C, in µm.
    pub(crate) checks: Vec<[f64; 2]>,
    /// Of each backlash what the readings before the window say of its growth.
    #[serde(default)]
    pub(crate) worn: Vec<RegressionSums>,
    /// The temperature columns of `h`.
    pub(crate) thermometers: Vec<String>,
    /// The filters before the window.
    pub(crate) checkpoint: FilterBank,
    /// The clock of the last reading before the window, in s.
    pub(crate) checkpoint_s: Option<f64>,
    /// The number of the window's first reading.
    pub(crate) first: u64,
    /// The last readings.
    pub(crate) window: Vec<StoredReading>,
    /// Hashes of the readings that were learned from, in hexadecimal digits.
    pub(crate) seen: String,
    /// The same by the rule of the form before this one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(crate) seen_before: String,
}

/// A change of the constants on one day.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DailyChange {
    /// The clock of the day's last change, in s.
    pub at: Option<f64>,
    /// The constants before and after, each with its place in the list of keys.
    pub values: Vec<(usize, f64, f64)>,
    /// Whether it takes another one back.
    #[serde(default, skip_serializing_if = "is_false")]
    pub is_undo: bool,
    /// The number of the day's first reading, and what was applied before it; none once it is taken back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) before: Option<(u64, Vec<f64>)>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks by reference")]
fn is_false(it: &bool) -> bool {
    !it
}

impl LearnerState {
    /// Returns the state before the first reading.
    pub(crate) fn new(
        machine: MachineIdentity,
        quantity: String,
        constants: Vec<LearnableConstant>,
        checkpoint: FilterBank,
    ) -> Self {
        Self {
            schema: SCHEMA_VERSION,
            machine,
            quantity,
            zero: None,
            applied: vec![0.0; constants.len() + 1],
            constants,
            first_s: None,
            last_s: None,
            is_applied_once: false,
            proven: None,
            air: None,
            events: Vec::new(),
            changes: Vec::new(),
            checks: Vec::new(),
            worn: Vec::new(),
            thermometers: Vec::new(),
            checkpoint,
            checkpoint_s: None,
            first: 0,
            window: Vec::new(),
            seen: String::new(),
            seen_before: String::new(),
        }
    }

    /// Reads the state from JSON.
    ///
    /// # Errors
    /// It is not what a learner wrote; with the place.
    pub fn from_json(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct SchemaHeader {
            schema: u32,
        }
        let SchemaHeader { schema } =
            serde_json::from_str(text).map_err(|error| error.to_string())?;
        let memory: Self = match schema {
            SCHEMA_VERSION => serde_json::from_str(text).map_err(|error| error.to_string())?,
            PREVIOUS_SCHEMA_VERSION => parse_legacy_state(text)?,
            other => {
                return Err(format!(
                    "schema is {other}, and this version reads {SCHEMA_VERSION}: --reset begins anew and keeps a backup"
                ));
            }
        };
        let values = memory.constants.len() + 1;
        let is_whole = memory.applied.len() == values
            && memory.proven.as_ref().is_none_or(|proven| proven.len() == values)
            && memory.checkpoint.is_consistent(values)
            && memory.seen.is_ascii()
            && memory.seen_before.is_ascii()
            && memory.window.iter().all(|stored| stored.g.len() == values)
            && memory.changes.iter().all(|change| {
                change.before.as_ref().is_none_or(|(_, applied)| applied.len() == values)
                    && change.values.iter().all(|(place, ..)| *place < values)
            })
            && memory.events.iter().all(|event| match &event.action {
                crate::event::EventAction::Shift(all) => all.iter().all(|entry| entry.0 < values),
                _ => true,
            });
        if is_whole {
            Ok(memory)
        } else {
            Err("its parts do not fit together, so it is damaged: --reset begins anew and keeps a backup".into())
        }
    }

    /// Returns true if `text` is of the form before this one.
    #[must_use]
    pub fn is_previous_schema(text: &str) -> bool {
        #[derive(Deserialize)]
        struct SchemaHeader {
            schema: u32,
        }
        serde_json::from_str(text)
            .is_ok_and(|SchemaHeader { schema }| schema == PREVIOUS_SCHEMA_VERSION)
    }

    /// Writes the state as JSON.
    ///
    /// # Errors
    /// None that is known: all of it can be written.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string(self)
    }

    /// Returns the keys of a change's values by their place: of the zero, of each constant.
    #[must_use]
    pub fn value_key(&self, place: usize) -> &str {
        match place.checked_sub(1) {
            None => "zero",
            Some(index) => self.constants.get(index).map_or("", |constant| constant.key.as_str()),
        }
    }

    /// Takes the last change back that is not taken back yet: what is applied, and what was known, are as before it. Its
    /// readings are not learned from again. Returns the change.
    ///
    /// # Errors
    /// There is none, or its readings are no longer kept; the rule.
    pub fn undo_last_change(&mut self) -> Result<DailyChange, String> {
        let index = self.changes.iter().rposition(|change| change.before.is_some());
        let index = index.ok_or("has no change that is not taken back already")?;
        let (sequence, applied) = self.changes[index].before.clone().unwrap_or_default();
        let Some(retained) = sequence.checked_sub(self.first) else {
            return Err(format!(
                "keeps the last {} readings, and the change is older: --reset begins anew and keeps a backup",
                self.window.len()
            ));
        };
        self.changes[index].before = None;
        self.window.truncate(retained as usize);
        self.events.retain(|event| event.sequence < sequence);
        self.applied = applied;
        self.proven = None;
        let undone = self.changes[index].clone();
        let back = undone.values.iter().map(|(key, from, to)| (*key, *to, *from)).collect();
        self.record_change(DailyChange {
            at: self.last_s,
            values: back,
            is_undo: true,
            before: None,
        });
        Ok(undone)
    }

    /// Adds a change to the list.
    pub(crate) fn record_change(&mut self, change: DailyChange) {
        self.changes.push(change);
        if self.changes.len() > MAX_STORED_CHANGES {
            self.changes.remove(0);
        }
    }

    /// Returns the number of the next reading.
    pub(crate) fn next_sequence_number(&self) -> u64 {
        self.first + self.window.len() as u64
    }

    /// Returns the hashes of the readings that were learned from.
    pub(crate) fn seen_hashes(&self) -> HashSet<&str> {
        split_hashes(&self.seen)
    }

    /// Returns the same by the rule of the form before this one.
    pub(crate) fn legacy_seen_hashes(&self) -> HashSet<&str> {
        split_hashes(&self.seen_before)
    }

    /// Remembers that a reading was learned from.
    pub(crate) fn mark_seen(&mut self, identity: u64) {
        self.seen += &format_truncated_hash(identity);
        if self.seen.len() > MAX_SEEN_READINGS * HASH_DIGIT_COUNT {
            self.seen.drain(..HASH_DIGIT_COUNT);
        }
    }
}

/// The form before this one.
#[derive(Deserialize)]
struct LegacyLearnerState {
    quantity: String,
    constants: Vec<LearnableConstant>,
    bank: FilterBank,
    applied: Vec<f64>,
    last_s: Option<f64>,
    #[serde(default)]
    readings: Vec<u64>,
    #[serde(default)]
    is_applied_once: bool,
}

/// Reads the form before this one; nothing of it is lost but the way back, which stays in the backup. Its owner has no name yet: the old form did not say whose it was.
fn parse_legacy_state(text: &str) -> Result<LearnerState, String> {
    let old: LegacyLearnerState = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let machine = MachineIdentity { name: String::new(), serial: None };
    Ok(LearnerState {
        applied: old.applied,
        last_s: old.last_s,
        is_applied_once: old.is_applied_once,
        checkpoint_s: old.last_s,
        first: old.readings.len() as u64,
        seen_before: old.readings.iter().map(|hash| format_truncated_hash(*hash)).collect(),
        ..LearnerState::new(machine, old.quantity, old.constants, old.bank)
    })
}

fn split_hashes(all: &str) -> HashSet<&str> {
    (0..all.len() / HASH_DIGIT_COUNT)
        .map(|n| &all[n * HASH_DIGIT_COUNT..(n + 1) * HASH_DIGIT_COUNT])
        .collect()
}

/// Returns the lower half of a hash, in hexadecimal digits.
pub(crate) fn format_truncated_hash(hash: u64) -> String {
    format!("{:08x}", hash & 0xffff_ffff)
}

/// FNV-1a over 64 bits: the same on every machine.
pub(crate) fn fnv1a_64(bytes: impl Iterator<Item = u8>) -> u64 {
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
