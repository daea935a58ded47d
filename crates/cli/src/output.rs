//! What the tool leaves behind: files that are whole or untouched, and results on standard output.
//! Diagnostics go through `trueup_output::diagnostic` or `report`.

use std::{
    fs::{self, OpenOptions},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Context as _, Result};

use crate::UserError;

/// Whether standard output is a file's content.
static IS_TAKEN: AtomicBool = AtomicBool::new(false);

/// Writes `path` by `write`. Until that has succeeded nothing at `path` is changed: what is written
/// stands in a file beside it, which then takes its name.
///
/// `inputs` are never written over. The path `-` is standard output; what a command says of its own goes to
/// standard error from then on.
pub fn write_whole<T>(
    path: &Path,
    inputs: &[&Path],
    write: impl FnOnce(&mut dyn Write) -> io::Result<T>,
) -> Result<T> {
    if is_standard_output(path) {
        IS_TAKEN.store(true, Ordering::Relaxed);
        let mut out = BufWriter::new(trueup_output::Output);
        let written = write(&mut out).and_then(|result| out.flush().map(|()| result));
        return written.context("standard output cannot be written");
    }
    check_target(path, inputs)?;
    // A link is followed, so that the file it leads to is written and not the link.
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    let cannot =
        |error: io::Error| UserError(format!("{}: cannot be written: {error}", path.display()));
    let during = || format!("while writing {}", path.display());

    match fs::metadata(&target) {
        // A device or a pipe has no content to keep, and its name must stay its own.
        Ok(there) if !there.is_file() => {
            let out = OpenOptions::new().write(true).open(&target).map_err(cannot)?;
            let mut out = BufWriter::new(out);
            return write(&mut out)
                .and_then(|result| out.flush().map(|()| result))
                .with_context(during);
        }
        _ => {}
    }
    let beside = beside(&target).map_err(cannot)?;
    let mut out = BufWriter::new(beside);
    let result = write(&mut out).with_context(during)?;
    let beside = out.into_inner().map_err(io::IntoInnerError::into_error).with_context(during)?;
    beside.as_file().sync_all().with_context(during)?;
    beside.persist(&target).map_err(|error| cannot(error.error))?;
    Ok(result)
}

/// Refuses what [`write_whole`] would, before anything is written: for commands that write several files of which one
/// alone would be wrong.
///
/// # Errors
/// `path` is an input, or a folder, or lies in a folder that is not there.
pub fn check_target(path: &Path, inputs: &[&Path]) -> Result<(), UserError> {
    if is_standard_output(path) {
        return Ok(());
    }
    let refused = |rule: &str| Err(UserError(format!("{}: {rule}", path.display())));
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    if inputs.iter().any(|input| fs::canonicalize(input).is_ok_and(|input| input == target)) {
        return refused("is an input, and must not be overwritten");
    }
    if target.is_dir() {
        return refused("is a folder");
    }
    match path.parent().filter(|folder| *folder != Path::new("") && !folder.is_dir()) {
        Some(folder) => {
            refused(&format!("cannot be written: there is no folder {}", folder.display()))
        }
        None => Ok(()),
    }
}

/// Writes a program, or the run file that is filled in beside it. A run file that is there with anything else
/// in it stays: somebody has filled it in, and that is hours of work.
pub fn write_measurement(path: &Path, inputs: &[&Path], text: &str) -> Result<()> {
    let is_run = path.extension().is_some_and(|kind| kind == "csv");
    if is_run && fs::read_to_string(path).is_ok_and(|there| there != text) {
        let rule = "is there already, and not empty: move it away first";
        return Err(UserError(format!("{}: {rule}", path.display())).into());
    }
    write_whole(path, inputs, |out| out.write_all(text.as_bytes()))
}

/// Whether a path stands for standard output.
pub fn is_standard_output(path: &Path) -> bool {
    path == Path::new("-")
}

/// An empty file in the folder of `target`, removed unless it is given a name.
fn beside(target: &Path) -> io::Result<tempfile::NamedTempFile> {
    let folder = match target.parent() {
        Some(folder) if folder != Path::new("") => folder.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".trueup-");
    #[cfg(unix)]
    {
        // As any new file, less the umask: temporary files are the owner's alone by default.
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

/// Prints a result on a line of its own. A reader that has seen enough (`| head`) gets no more, and the command
/// goes on: its exit status stands.
pub fn print(result: impl std::fmt::Display) -> Result<()> {
    if IS_TAKEN.load(Ordering::Relaxed) {
        trueup_output::diagnostic(result);
        return Ok(());
    }
    trueup_output::result(result).context("standard output cannot be written")
}

/// Prints which files were written into a folder.
pub fn list(folder: &Path, names: &[String], as_json: bool) -> Result<()> {
    if as_json {
        return print(serde_json::json!({ "folder": folder, "files": names }));
    }
    names.iter().try_for_each(|name| print(folder.join(name).display()))
}
