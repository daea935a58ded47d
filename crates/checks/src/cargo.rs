//! The cargo that runs this, at the root of the project and with the versions of its lock file.

use std::process::Command;

use trueup_emulator::setup;

/// `cargo <verb> --locked`, to be gone on with.
pub fn locked(verb: &str) -> Command {
    let mut command = plain(verb);
    command.arg("--locked");
    command
}

/// `cargo <verb>`, for what knows no lock file.
pub fn plain(verb: &str) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    command.arg(verb).current_dir(setup::root());
    command
}
