//! A file of a recording, written from its beginning to its end, in which a cell can be blanked again.

use std::{
    fs::{File, OpenOptions},
    io::{self, BufWriter, Seek as _, SeekFrom, Write as _},
    path::PathBuf,
};

use anyhow::{Context as _, Result};

use crate::UnusableInputError;

/// A file that is being written.
pub(crate) struct RecordingFile {
    /// Where it stands.
    pub path: PathBuf,
    file: BufWriter<File>,
    length: u64,
}

impl RecordingFile {
    /// Begins a file that must not be there yet.
    pub fn create(path: PathBuf) -> Result<Self> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)
            .map_err(|error| UnusableInputError::File { path: path.clone(), error })?;
        Ok(Self { path, file: BufWriter::new(file), length: 0 })
    }

    /// Returns how many bytes were written.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Writes a line.
    pub(crate) fn write_line(&mut self, line: &str) -> Result<()> {
        let written = writeln!(self.file, "{line}");
        self.length += line.len() as u64 + 1;
        self.with_write_context(written)
    }

    /// Writes spaces over the bytes at this place.
    pub(crate) fn overwrite_with_spaces(&mut self, at: u64, length: usize) -> Result<()> {
        let mut blank = || {
            self.file.seek(SeekFrom::Start(at))?;
            self.file.write_all(&vec![b' '; length])?;
            self.file.seek(SeekFrom::End(0)).map(|_| ())
        };
        let written = blank();
        self.with_write_context(written)
    }

    /// All that was written stands in the file.
    pub fn flush(&mut self) -> Result<()> {
        let written = self.file.flush();
        self.with_write_context(written)
    }

    fn with_write_context(&self, written: io::Result<()>) -> Result<()> {
        written.with_context(|| format!("while writing {}", self.path.display()))
    }
}
