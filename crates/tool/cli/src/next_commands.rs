//! The lines that a command prints for its user to type next: whole, with the files that it has written, so that they
//! run as they are printed.

use std::path::Path;

use anyhow::Result;
use trueup_output::escape::shell_quote;

use crate::output;

/// Placeholder of a port that only the user knows.
const PORT_PLACEHOLDER: &str = "--port PORT";

fn quote_path(path: &Path) -> String {
    shell_quote(&path.to_string_lossy()).to_string()
}

/// Returns the lines that bring a machine file to a board; the calibration stands in `folder`.
pub fn deployment_commands(machine: &Path, folder: &Path) -> Vec<String> {
    let calibration =
        quote_path(&folder.join(machine.with_extension("bin").file_name().unwrap_or_default()));
    vec![
        format!("trueup compile {} -o {calibration}", quote_path(machine)),
        format!("trueup bridge load {calibration} {PORT_PLACEHOLDER}"),
    ]
}

/// Returns the line that keeps what a board holds.
pub fn bridge_save_command(folder: &Path) -> String {
    format!("trueup bridge save {} {PORT_PLACEHOLDER}", quote_path(&folder.join("board.json")))
}

/// Prints them after the results of a command.
pub fn print_next_commands(lines: &[String]) -> Result<()> {
    lines.iter().try_for_each(|line| output::print(format_args!("then: {line}")))
}
