//! Where the measured data are that tests read and the project may not carry (`docs/measured-data.md`
//! lists them).
//!
//! The folder is what `TRUEUP_DATA` names, else `../shared/data` next to the project. Without
//! either, the tests on them are skipped, with a line for each: nothing is skipped in silence.
#![allow(clippy::print_stdout, clippy::disallowed_methods, reason = "only tests use it")]
#![forbid(unsafe_code)]

use std::{
    env,
    io::{Write as _, stderr},
    path::{Path, PathBuf},
};

/// The environment variable that names the folder.
pub(crate) const DATA_DIR_ENV_VAR: &str = "TRUEUP_DATA";

/// Returns the path of a measured file, `None` where it is not there; a line says so then.
///
/// `name` is its path below the folder, `ess_iso230/x.csv` say.
#[must_use]
pub fn find_measured_file(name: &str) -> Option<PathBuf> {
    let adjacent = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
    let folder = env::var_os(DATA_DIR_ENV_VAR).map_or(adjacent, PathBuf::from);
    let found = find_in_folder(&folder, name);
    if found.is_none() {
        // `cargo verify` counts this line …
        println!("skipped: {name} is not there (docs/measured-data.md)");
        // … and a bare `cargo test`, which keeps to itself what a passed test prints, cannot keep this
        // one. Should it get lost all the same, the test is no worse for it.
        _ = writeln!(
            stderr(),
            "\nskipped: no {name}; {DATA_DIR_ENV_VAR} names the folder of measured data"
        );
    }
    found
}

fn find_in_folder(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(name);
    path.is_file().then_some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_file_is_found() {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        assert_eq!(find_in_folder(here, "src/lib.rs"), Some(here.join("src/lib.rs")));
        assert_eq!(find_in_folder(here, "src"), None);
        assert_eq!(find_in_folder(here, "no/such.csv"), None);
    }
}
