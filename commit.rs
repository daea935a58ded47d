//! Which commit of the source a build is of, for the build scripts that take this file in: the image's and
//! the tool's, which compare the two when they meet.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// Gives the code `TRUEUP_COMMIT`: the first 8 hexadecimal digits of the hash of the commit that is checked
/// out in `root`; where there is no repository, or no git, `unknown`. Gives the files that change with it.
pub fn emit_commit_env(root: &Path) -> Vec<PathBuf> {
    let git = |args: &[&str]| {
        let output = Command::new("git").arg("-C").arg(root).args(args).output().ok()?;
        let stdout = String::from_utf8(output.stdout).ok().filter(|_| output.status.success())?;
        Some(stdout.trim().to_string())
    };
    let commit = git(&["rev-parse", "HEAD"]).and_then(|hash| hash.get(..8).map(str::to_string));
    println!("cargo:rustc-env=TRUEUP_COMMIT={}", commit.as_deref().unwrap_or("unknown"));
    // Both change with a checkout, the second with each commit. Of a file that is not there cargo would think
    // that it changes all the time.
    let places = ["HEAD", "logs/HEAD"].map(|name| git(&["rev-parse", "--git-path", name]));
    let places = places.into_iter().flatten().map(|path| root.join(path));
    let changing: Vec<PathBuf> = places.filter(|place| place.is_file()).collect();
    for place in changing.iter().chain([&root.join("commit.rs")]) {
        println!("cargo:rerun-if-changed={}", place.display());
    }
    changing
}
