//! The words that the tiers of the score card share.

use std::{fs, ops::Range, path::PathBuf, process::ExitCode};

use crate::compare::DrawScores;

/// Options of a tier.
pub struct TierOptions {
    pub each: bool,
    seeds: u64,
    first: u64,
    tsv: Option<PathBuf>,
    names: Vec<String>,
}

impl TierOptions {
    /// Of `words`, with this many seeds where they say nothing.
    ///
    /// # Errors
    /// A word that is none; it has been reported.
    pub fn parse(words: &[String], seeds: u64) -> Result<Self, ExitCode> {
        let mut it = Self { each: false, seeds, first: 0, tsv: None, names: Vec::new() };
        let mut words = words.iter();
        while let Some(word) = words.next() {
            let number = |next: Option<&String>| next.and_then(|word| word.parse::<u64>().ok());
            let is_read = match word.as_str() {
                "--each" => {
                    it.each = true;
                    true
                }
                "--seeds" => number(words.next()).map(|number| it.seeds = number).is_some(),
                "--first" => number(words.next()).map(|number| it.first = number).is_some(),
                "--tsv" => words.next().map(|path| it.tsv = Some(path.into())).is_some(),
                name if !name.starts_with('-') => {
                    it.names.push(word.clone());
                    true
                }
                _ => false,
            };
            if !is_read {
                eprintln!(
                    "error: {word}: there are --seeds N, --first N, --each, --tsv FILE, names"
                );
                return Err(ExitCode::from(2));
            }
        }
        Ok(it)
    }

    /// Returns the seeds, one after the other.
    pub fn seeds(&self) -> Range<u64> {
        self.first..self.first + self.seeds
    }

    /// Returns whether what has this name is requested.
    pub fn is_selected(&self, name: &str) -> bool {
        self.names.is_empty() || self.names.iter().any(|other| other == name)
    }

    /// Writes `draws` to where `--tsv` says.
    pub fn write_tsv(&self, draws: &DrawScores) {
        if let Some(path) = &self.tsv
            && let Err(error) = fs::write(path, draws.to_tsv())
        {
            eprintln!("error: {}: {error}", path.display());
        }
    }
}
