//! The same commit, built in two folders: both builds give the same bytes, or the release is refused.
//!
//! The second folder is a fresh clone of another name and depth. Differences between two computers that have no place
//! in a file are taken out of both: paths by `--remap-path-prefix`, times by the commit's (`SOURCE_DATE_EPOCH`).

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{process, setup};
use trueup_signature::PrivateKey;

/// Builds here and in a clone, and returns the clone's folder. Images of two firmware slots are signed with the key, given by
/// its file and as it was read, and boot with its public half; without one it is the developers'.
///
/// # Errors
/// There are changes that are in no commit, something does not build, or the files differ; with their names.
pub(super) fn build_release_twice(key: Option<(&Path, &PrivateKey)>) -> Result<PathBuf> {
    let root = setup::project_root();
    let keys = match key {
        Some((private, key)) => {
            let public = root.join("target/release.pub.pem");
            fs::write(&public, key.public_key().to_pem()?)?;
            vec![("TRUEUP_SIGNING_KEY", private.canonicalize()?), ("TRUEUP_KEY", public)]
        }
        None => Vec::new(),
    };
    let changed = process::capture_stdout(git_command(&root).args([
        "status",
        "--porcelain",
        "--untracked-files=no",
    ]))?;
    ensure!(changed.is_empty(), "a release is of a commit; these are in none:\n{changed}");
    let time = commit_unix_seconds()?;
    build_release_in_folder(&root, time, &keys)?;
    let again = root.join("target/release-again/in-another-folder");
    if again.is_dir() {
        fs::remove_dir_all(&again)?;
    }
    fs::create_dir_all(again.parent().context("it is in a folder")?)?;
    process::run(git_command(&root).args(["clone", "--quiet", "--no-hardlinks", "."]).arg(&again))?;
    build_release_in_folder(&again, time, &keys)?;
    let files = |root: &Path| root.join("target/release-files");
    let differ = find_differing_files(&files(&root), &files(&again))?;
    ensure!(
        differ.is_empty(),
        "the release is not reproducible: {} are others in {}",
        differ.join(", "),
        again.display()
    );
    Ok(again)
}

/// Returns the time of the commit, in seconds of Unix.
pub(super) fn commit_unix_seconds() -> Result<u64> {
    let stdout = process::capture_stdout(git_command(&setup::project_root()).args([
        "log",
        "-1",
        "--format=%ct",
    ]))?;
    stdout.trim().parse().context("git says when the commit was made")
}

fn git_command(root: &Path) -> Command {
    let mut git = Command::new("git");
    git.current_dir(root);
    git
}

/// Builds all files of a folder. This program does it for both: it is of the same commit.
fn build_release_in_folder(root: &Path, commit_time: u64, keys: &[(&str, PathBuf)]) -> Result<()> {
    trueup_output::write_diagnostic(format_args!("building in {}", root.display()));
    let mut command = Command::new(env::current_exe()?);
    command.current_dir(root).args(["release", "--once"]);
    let home = match env::var_os("CARGO_HOME") {
        Some(home) => PathBuf::from(home),
        None => PathBuf::from(env::var_os("HOME").context("HOME is not set")?).join(".cargo"),
    };
    let flag = |from: &Path, to: &str| format!("--remap-path-prefix={}={to}", from.display());
    let flags = [flag(root, "/trueup"), flag(&home, "/cargo")];
    command.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f"));
    command.env("SOURCE_DATE_EPOCH", commit_time.to_string());
    for variable in ["TRUEUP_SIGNING_KEY", "TRUEUP_KEY", "TRUEUP_FIRMWARE_VERSION"] {
        command.env_remove(variable);
    }
    command.envs(keys.iter().cloned());
    // What this process was started with belongs to its folder alone.
    for variable in ["CARGO_MANIFEST_PATH", "CARGO_TARGET_DIR", "RUSTFLAGS"] {
        command.env_remove(variable);
    }
    // The folder that the program works in.
    command.env("CARGO_MANIFEST_DIR", root.join("xtask"));
    process::run(&mut command)
}

/// Returns the names of files that only one folder has, or that differ.
fn find_differing_files(one: &Path, other: &Path) -> Result<Vec<String>> {
    let mut names = super::list_file_names(one)?;
    names.extend(super::list_file_names(other)?);
    names.sort();
    names.dedup();
    let read = |folder: &Path, name: &str| fs::read(folder.join(name)).ok();
    names.retain(|name| read(one, name) != read(other, name));
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_differs_or_is_missing_is_named() {
        let [one, other] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        let write = |folder: &Path, name: &str, text: &str| {
            fs::write(folder.join(name), text).expect("a file");
        };
        for folder in [one.path(), other.path()] {
            write(folder, "same", "1");
        }
        write(one.path(), "differs", "1");
        write(other.path(), "differs", "2");
        write(other.path(), "more", "");
        assert_eq!(
            find_differing_files(one.path(), other.path()).expect("read"),
            ["differs", "more"]
        );
    }
}
