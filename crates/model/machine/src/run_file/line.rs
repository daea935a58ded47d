//! The lines of a run file, read one at a time and within bounds.

use std::{
    io::{BufRead, Read as _},
    path::Path,
};

use crate::{
    bounded_read::describe_size_limit,
    location::{InputFileError, Location},
};

/// The longest line that is read, in bytes, its end included: the bytes of ten times as many
/// columns as a file may have.
const MAX_LINE_BYTES: usize = 1 << 20;

/// The lines that a fault keeps from being read.
pub(super) enum LineReadError {
    /// This line; the next one can be.
    Line(InputFileError),
    /// This line and all after it.
    Rest(InputFileError),
}

impl LineReadError {
    pub(super) fn into_error(self) -> InputFileError {
        let (Self::Line(error) | Self::Rest(error)) = self;
        error
    }
}

/// A line of a file.
pub(super) struct RunLine {
    /// Without byte order mark and line end.
    pub(super) text: String,
    /// Its number in the file, the first is 1.
    pub(super) number: usize,
}

impl RunLine {
    /// Returns whether there is anything to be read in it: it is neither empty nor a comment.
    pub(super) fn has_content(&self) -> bool {
        let text = self.text.trim_start();
        !text.is_empty() && !text.starts_with('#')
    }

    pub(super) fn location(&self, path: &Path, column: usize) -> Location {
        Location { file: path.to_path_buf(), line: self.number, column }
    }
}

/// The lines of a file that is being read.
pub(super) struct RunFileLines<'p, S> {
    source: S,
    path: &'p Path,
    bytes: Vec<u8>,
    /// How many have been read.
    number: usize,
    /// How much of the file has been read.
    file_bytes: u64,
    /// How much of it may be.
    most_bytes: u64,
}

impl<'p, S: BufRead> RunFileLines<'p, S> {
    /// Of a file that may have `most_bytes`.
    pub(super) fn new(source: S, path: &'p Path, most_bytes: u64) -> Self {
        Self { source, path, bytes: Vec::new(), number: 0, file_bytes: 0, most_bytes }
    }

    /// Returns the next line; none at the end.
    pub(super) fn read_line(&mut self) -> Result<Option<RunLine>, LineReadError> {
        self.bytes.clear();
        self.number += 1;
        let most = MAX_LINE_BYTES as u64 + 1;
        let read = self.source.by_ref().take(most).read_until(b'\n', &mut self.bytes).map_err(
            |error| {
                LineReadError::Rest(InputFileError::new(
                    self.location(1),
                    format!("cannot be read: {error}"),
                ))
            },
        )?;
        if read > MAX_LINE_BYTES {
            let rule = format!(
                "the line is longer than {MAX_LINE_BYTES} bytes: a run file has one \
                 observation a line"
            );
            return Err(LineReadError::Rest(InputFileError::new(self.location(1), rule)));
        }
        self.file_bytes += read as u64;
        if self.file_bytes > self.most_bytes {
            let rule = format!("the file goes on here, {}", describe_size_limit(self.most_bytes));
            return Err(LineReadError::Rest(InputFileError::new(self.location(1), rule)));
        }
        let mut bytes = self.bytes.strip_suffix(b"\n").unwrap_or(&self.bytes);
        bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
        if self.number == 1 {
            bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        }
        let text = str::from_utf8(bytes).map_err(|error| {
            let column = String::from_utf8_lossy(&bytes[..error.valid_up_to()]).chars().count() + 1;
            LineReadError::Line(
                InputFileError::new(self.location(column), "is not UTF-8 text")
                    .with_help("save the file as UTF-8; µ and ° of another encoding are not read"),
            )
        })?;
        if let Some(at) = text.find('\r') {
            let column = text[..at].chars().count() + 1;
            let rule = "a carriage return alone does not end a line: use LF or CRLF";
            return Err(LineReadError::Line(InputFileError::new(self.location(column), rule)));
        }
        Ok((read > 0).then(|| RunLine { text: text.into(), number: self.number }))
    }

    fn location(&self, column: usize) -> Location {
        Location { file: self.path.to_path_buf(), line: self.number, column }
    }
}
