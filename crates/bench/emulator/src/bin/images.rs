//! Builds the firmware images that an installed `trueup` carries, and prints their folder.
//!
//! `cargo xtask images` does the same; a release build of the tool calls this, which needs a third of what
//! the project's own commands are built from.

use std::process::ExitCode;

fn main() -> ExitCode {
    match trueup_emulator::release_images::build_bundled_images() {
        Ok(folder) => {
            trueup_output::write_line_best_effort(folder.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            trueup_output::write_diagnostic(format_args!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
