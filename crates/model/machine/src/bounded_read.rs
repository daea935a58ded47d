//! Files of the user's, opened and read within bounds.
//!
//! A file that was named by mistake may be of any size, or a device without an end. It is refused
//! by its length before it is read, and by what came of it where a length is not to be had.

use std::{fs::File, io::Read as _, path::Path};

use crate::location::{InputFileError, Location};

/// Opens the file at `path`, which may have `most_bytes`.
///
/// A pipe has no length and is opened: who reads it counts.
///
/// # Errors
/// The file cannot be opened, or is longer; at its start.
pub fn open(path: &Path, most_bytes: u64) -> Result<File, InputFileError> {
    let bad = |rule| InputFileError::new(Location::start_of_file(path), rule);
    let unreadable = |error| bad(format!("cannot be read: {error}"));
    let file = File::open(path).map_err(unreadable)?;
    let bytes = file.metadata().map_err(unreadable)?.len();
    if bytes > most_bytes {
        return Err(bad(format!("has {bytes} bytes, {}", describe_size_limit(most_bytes))));
    }
    Ok(file)
}

/// Reads the file at `path` whole, which may have `most_bytes`.
///
/// # Errors
/// The file cannot be read, or is longer; at its start.
pub fn read(path: &Path, most_bytes: u64) -> Result<Vec<u8>, InputFileError> {
    let bad = |rule| InputFileError::new(Location::start_of_file(path), rule);
    let mut bytes = Vec::new();
    open(path, most_bytes)?
        .take(most_bytes.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(|error| bad(format!("cannot be read: {error}")))?;
    if bytes.len() as u64 > most_bytes {
        return Err(bad(format!("has no end so far, {}", describe_size_limit(most_bytes))));
    }
    Ok(bytes)
}

/// Reads the text file at `path` whole, which may have `most_bytes`.
///
/// # Errors
/// The file cannot be read or is longer, at its start; or is not UTF-8, where it begins not to be.
pub fn read_text(path: &Path, most_bytes: u64) -> Result<String, InputFileError> {
    String::from_utf8(read(path, most_bytes)?).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let text = String::from_utf8_lossy(&error.as_bytes()[..valid]);
        InputFileError::new(
            Location::from_byte_offset(path, &text, text.len()),
            "is not UTF-8 text",
        )
    })
}

/// Returns the end of a sentence that states a bound.
pub(crate) fn describe_size_limit(bytes: u64) -> String {
    const MEBIBYTE: u64 = 1 << 20;
    format!("more than the {} MiB that are read", bytes / MEBIBYTE)
}
