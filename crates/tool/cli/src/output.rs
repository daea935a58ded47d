//! The output of the tool: files that are whole or untouched, and results on standard output.
//! Diagnostics go through `trueup_output::write_diagnostic` or `report`.

use std::{
    fs::{self, OpenOptions},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Context as _, Result};
use tempfile::{NamedTempFile, TempPath};

use crate::UserError;

/// Whether standard output is a file's content.
static IS_STDOUT_RESERVED: AtomicBool = AtomicBool::new(false);

/// Writes `path` by `write`. Until that has succeeded nothing at `path` is changed: what is written
/// stands in a file next to it, which then takes its name.
///
/// `inputs` are never written over. The path `-` is standard output; what a command says of its own goes to
/// standard error from then on.
pub fn write_atomically<T>(
    path: &Path,
    inputs: &[&Path],
    write: impl FnOnce(&mut dyn Write) -> io::Result<T>,
) -> Result<T> {
    let mut set = FileTransaction::new(inputs);
    let result = set.add(path, write)?;
    set.commit()?;
    Ok(result)
}

/// Files that take their places together: none of them is changed until all are written, and if one cannot take its
/// place, those before it are put back.
pub struct FileTransaction<'i> {
    inputs: &'i [&'i Path],
    staged: Vec<StagedFile>,
}

/// A file that is written, and waits for its place.
struct StagedFile {
    /// `None`: what stands there goes.
    new: Option<NamedTempFile>,
    target: PathBuf,
    /// As the user names it.
    path: PathBuf,
}

impl<'i> FileTransaction<'i> {
    /// Returns an empty set; `inputs` are never written over.
    pub fn new(inputs: &'i [&'i Path]) -> Self {
        Self { inputs, staged: Vec::new() }
    }

    /// Writes a file by `write`, in the folder of its place. A device or a pipe gets it at once.
    pub fn add<T>(
        &mut self,
        path: &Path,
        write: impl FnOnce(&mut dyn Write) -> io::Result<T>,
    ) -> Result<T> {
        if is_standard_output(path) {
            IS_STDOUT_RESERVED.store(true, Ordering::Relaxed);
            let mut out = BufWriter::new(trueup_output::StdoutWriter);
            let written = write(&mut out).and_then(|result| out.flush().map(|()| result));
            return written.context("standard output cannot be written");
        }
        let during = || format!("while writing {}", path.display());
        let target = self.resolve_target(path)?;
        match fs::metadata(&target) {
            // A device or a pipe has no content to keep, and its name must stay its own.
            Ok(there) if !there.is_file() => {
                let out = OpenOptions::new().write(true).open(&target);
                let mut out = BufWriter::new(out.map_err(|error| write_error(path, &error))?);
                return write(&mut out)
                    .and_then(|result| out.flush().map(|()| result))
                    .with_context(during);
            }
            _ => {}
        }
        let new = create_sibling_temp_file(&target).map_err(|error| write_error(path, &error))?;
        let mut out = BufWriter::new(new);
        let result = write(&mut out).with_context(during)?;
        let new = out.into_inner().map_err(io::IntoInnerError::into_error).with_context(during)?;
        new.as_file().sync_all().with_context(during)?;
        self.staged.push(StagedFile { new: Some(new), target, path: path.into() });
        Ok(result)
    }

    /// Adds a file by its text.
    pub fn add_text(&mut self, path: &Path, text: &str) -> Result<()> {
        self.add(path, |out| out.write_all(text.as_bytes()))
    }

    /// Adds files of a folder by their names and texts.
    pub fn add_texts<N: AsRef<Path>>(
        &mut self,
        folder: &Path,
        files: impl IntoIterator<Item = (N, String)>,
    ) -> Result<()> {
        files.into_iter().try_for_each(|(name, text)| self.add_text(&folder.join(name), &text))
    }

    /// Lets a file of an earlier set go, which this one has none of.
    pub fn remove(&mut self, path: &Path) -> Result<()> {
        let target = self.resolve_target(path)?;
        if target.is_file() {
            self.staged.push(StagedFile { new: None, target, path: path.into() });
        }
        Ok(())
    }

    /// Gives every file its place.
    pub fn commit(self) -> Result<()> {
        // What stood there, for the case that a later one fails; a set of one needs none.
        let mut done: Vec<(PathBuf, Option<TempPath>)> = Vec::new();
        let is_set = self.staged.len() > 1;
        for StagedFile { new, target, path } in self.staged {
            let placed = create_backup(&target, is_set).and_then(|old| {
                match new {
                    Some(new) => drop(new.persist(&target).map_err(|error| error.error)?),
                    None => fs::remove_file(&target)?,
                }
                Ok(old)
            });
            match placed {
                Ok(old) => done.push((target, old)),
                Err(error) => {
                    for (target, old) in done.into_iter().rev() {
                        // The first failure is what is reported.
                        _ = match old {
                            Some(old) => old.persist(&target).map_err(|error| error.error),
                            None => fs::remove_file(&target),
                        };
                    }
                    return Err(write_error(&path, &error).into());
                }
            }
        }
        Ok(())
    }

    /// Returns the file that a path leads to, which is no input.
    fn resolve_target(&self, path: &Path) -> Result<PathBuf> {
        check_output_path(path, self.inputs)?;
        // A link is followed, so that the file it leads to is written and not the link.
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        Ok(target)
    }
}

/// Refuses what [`write_atomically`] would, before anything is written: for commands that write several files of which one
/// alone would be wrong.
///
/// # Errors
/// `path` is an input, or a folder, or lies in a folder that is not there.
pub fn check_output_path(path: &Path, inputs: &[&Path]) -> Result<(), UserError> {
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

/// Makes a folder for results, if there is none.
pub fn create_folder(folder: &Path) -> Result<(), UserError> {
    fs::create_dir_all(folder)
        .map_err(|error| UserError(format!("{}: cannot be made: {error}", folder.display())))
}

fn write_error(path: &Path, error: &io::Error) -> UserError {
    UserError(format!("{}: cannot be written: {error}", path.display()))
}

/// Returns the file at `target` under a second name, if there is one and it is required.
fn create_backup(target: &Path, is_requested: bool) -> io::Result<Option<TempPath>> {
    if !is_requested || !target.exists() {
        return Ok(None);
    }
    let name = create_sibling_temp_file(target)?.into_temp_path();
    fs::remove_file(&name)?;
    // A file system without hard links has a copy.
    fs::hard_link(target, &name).or_else(|_| fs::copy(target, &name).map(drop))?;
    Ok(Some(name))
}

/// Refuses to write over a run file that is there with anything else in it than `text`: it may have been filled in, and
/// that is hours of work.
pub fn check_run_overwrite(path: &Path, text: &str) -> Result<(), UserError> {
    let is_run = path.extension().is_some_and(|kind| kind == "csv");
    if is_run && fs::read_to_string(path).is_ok_and(|there| there != text) {
        let rule = "is there already, and not empty: move it away first";
        return Err(UserError(format!("{}: {rule}", path.display())));
    }
    Ok(())
}

/// Returns whether a path stands for standard output.
pub fn is_standard_output(path: &Path) -> bool {
    path == Path::new("-")
}

/// Returns an empty file in the folder of `target`, removed unless it is given a name.
fn create_sibling_temp_file(target: &Path) -> io::Result<NamedTempFile> {
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
    if IS_STDOUT_RESERVED.load(Ordering::Relaxed) {
        trueup_output::write_diagnostic(result);
        return Ok(());
    }
    trueup_output::write_result(result).context("standard output cannot be written")
}

/// Prints which files were written into a folder.
pub fn print_written_files(folder: &Path, names: &[String], as_json: bool) -> Result<()> {
    if as_json {
        return print(serde_json::json!({ "folder": folder, "files": names }));
    }
    names.iter().try_for_each(|name| print(folder.join(name).display()))
}
