//! Runs other programs; an error names the command line, with the program's error output if it was not shown.

use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};

pub use trueup_virtual_bridge::program::{capture_stdout, find_on_path, format_command_line};

/// Returns the cargo that started this program, without what it has set for this program alone. A build script that
/// reads such a variable (that of `ring`) runs again when it changes, and all that needs its crate is compiled again.
#[must_use]
pub fn new_cargo_command() -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_")
            || text.starts_with("CARGO_MANIFEST_")
            || text == "OUT_DIR"
        {
            command.env_remove(&name);
        }
    }
    command
}

/// Runs a command to its end, its output on this one's standard error.
///
/// # Errors
/// It could not be started, or it failed.
pub fn run(command: &mut Command) -> Result<()> {
    let line = format_command_line(command);
    let status = command
        .stdin(Stdio::null())
        .stdout(trueup_output::stderr_stdio())
        .status()
        .with_context(|| format!("cannot start `{line}`"))?;
    if !status.success() {
        bail!("`{line}` failed: {status}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_is_started_without_what_is_set_for_this_package() {
        // Set by cargo, and by the tiers, for each test program.
        assert!(std::env::var_os("CARGO_MANIFEST_DIR").is_some());
        let command = new_cargo_command();
        let removed: Vec<_> = command.get_envs().filter(|(_, value)| value.is_none()).collect();
        assert!(removed.iter().any(|(name, _)| *name == "CARGO_MANIFEST_DIR"), "{removed:?}");
    }
}
