//! The journal: the step that comes next in `commission.json`, and every command in `log.txt`.

use std::{
    fs::{self, OpenOptions},
    io::Write as _,
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use trueup_client::write_log::format_utc;

use crate::{UserError, output};

/// The steps, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    Sign,
    Program,
    Off,
    Fit,
    Load,
    On,
    Accept,
    Done,
}

impl Step {
    const ALL: [Self; 8] = [
        Self::Sign,
        Self::Program,
        Self::Off,
        Self::Fit,
        Self::Load,
        Self::On,
        Self::Accept,
        Self::Done,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Sign => "sign",
            Self::Program => "program",
            Self::Off => "off",
            Self::Fit => "fit",
            Self::Load => "load",
            Self::On => "on",
            Self::Accept => "accept",
            Self::Done => "done",
        }
    }

    /// Returns what is done in it, for the user.
    pub fn title(self) -> &'static str {
        match self {
            Self::Sign => "sign test at 10 µm",
            Self::Program => "write the motion programs",
            Self::Off => "measure without compensation",
            Self::Fit => "fit the constants",
            Self::Load => "load the calibration",
            Self::On => "measure with compensation",
            Self::Accept => "accept or not",
            Self::Done => "done",
        }
    }
}

/// The journal of a commissioning, in a folder.
pub struct Journal {
    folder: PathBuf,
    /// The kind of commissioning, with its axis, in words.
    subject: String,
    /// The step to be done.
    pub next: Step,
    /// Where stands what the board held before a sign test that has not put it back.
    pub before: Option<String>,
    /// 1 at first; one more each time that it was not accepted.
    pub round: u32,
}

impl Journal {
    /// Goes on with the one in `folder`, which is of the same subject, or begins it.
    pub fn open(folder: &Path, subject: &str) -> Result<Self> {
        let path = folder.join("commission.json");
        let subject = subject.to_owned();
        let (next, before) = (Step::Sign, None);
        let mut journal = Self { folder: folder.into(), subject, next, before, round: 1 };
        let Ok(text) = fs::read_to_string(&path) else {
            journal.save()?;
            return Ok(journal);
        };
        let damaged = || UserError(format!("{}: is not what commission writes", path.display()));
        let all: Value = serde_json::from_str(&text).map_err(|_| damaged())?;
        // One from before there were axes is of the spindle.
        let begun = all["of"].as_str().unwrap_or("warmup");
        if begun != journal.subject {
            let rule = format!("{}: was begun for {begun}; give another folder", folder.display());
            return Err(UserError(rule).into());
        }
        let round = all["round"].as_u64().and_then(|value| u32::try_from(value).ok());
        journal.round = round.filter(|round| *round > 0).ok_or_else(damaged)?;
        journal.before = all["before"].as_str().map(str::to_owned);
        let step = Step::ALL.into_iter().find(|step| all["next"] == step.name());
        journal.next = step.ok_or_else(damaged)?;
        Ok(journal)
    }

    /// The step is done; this one comes next.
    pub fn advance_to(&mut self, next: Step) -> Result<()> {
        self.next = next;
        self.save()
    }

    /// It was not accepted: what is fitted now is measured anew.
    pub fn start_next_round(&mut self) -> Result<()> {
        self.round += 1;
        self.log("not accepted; the next round measures and fits again")?;
        self.advance_to(Step::Off)
    }

    fn save(&self) -> Result<()> {
        let all = json!({
            "of": self.subject,
            "next": self.next.name(),
            "round": self.round,
            "before": self.before,
        });
        let text = serde_json::to_string_pretty(&all)? + "\n";
        let path = self.folder.join("commission.json");
        output::write_atomically(&path, &[], |out| out.write_all(text.as_bytes()))
    }

    /// Writes a line down, with the time, and shows it.
    pub fn log(&self, line: &str) -> Result<()> {
        self.append(line)?;
        trueup_output::write_diagnostic(line);
        Ok(())
    }

    /// Writes a line down, with the time.
    pub fn append(&self, line: &str) -> Result<()> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = format_utc(u32::try_from(since.as_secs()).unwrap_or(u32::MAX));
        let path = self.folder.join("log.txt");
        let during = || format!("while writing {}", path.display());
        let mut log =
            OpenOptions::new().create(true).append(true).open(&path).with_context(during)?;
        writeln!(log, "{now} {line}").with_context(during)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_on_where_it_stopped_and_a_damaged_one_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut journal = Journal::open(folder.path(), "warmup").expect("a new one");
        assert_eq!((journal.next, journal.round), (Step::Sign, 1));
        for step in Step::ALL {
            journal.advance_to(step).expect("it is written");
            assert_eq!(Journal::open(folder.path(), "warmup").expect("right").next, step);
        }
        journal.start_next_round().expect("it is written");
        let again = Journal::open(folder.path(), "warmup").expect("right");
        assert_eq!((again.next, again.round), (Step::Off, 2));
        assert!(Journal::open(folder.path(), "pitch x").is_err(), "another subject");
        for damaged in ["", "{}", r#"{"next": "on", "round": 0}"#, r#"{"next": "x", "round": 1}"#] {
            fs::write(folder.path().join("commission.json"), damaged).expect("writable");
            assert!(Journal::open(folder.path(), "warmup").is_err(), "{damaged}");
        }
    }
}
