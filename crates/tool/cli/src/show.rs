//! `trueup show`: a blob back into a machine file.

use std::path::Path;

use anyhow::Result;
use serde_json::json;
use trueup_machine::{check::list_implausible_values, compile::decompile, decompile};
use trueup_store::calibration::{decode, validate_blob};

use crate::{CommandOutcome, UserError, input_files, output, report};

/// Above any calibration, and what may follow it in its file.
pub const MAX_CALIBRATION_FILE_BYTES: u64 = 1 << 20;

/// Prints the calibration in the file `from`.
pub fn run(from: &Path, as_json: bool) -> Result<CommandOutcome> {
    let bad = |rule: String| UserError(format!("{}: {rule}", from.display()));
    let bytes = input_files::read_bytes(from, MAX_CALIBRATION_FILE_BYTES)?;
    let calibration = decode(&bytes).map_err(|error| bad(error.to_string()))?;
    let more = bytes.len() - validate_blob(&bytes).map_or(bytes.len(), <[u8]>::len);
    if more > 0 {
        report::print_warning(format_args!(
            "{}: {more} bytes after the calibration are ignored",
            from.display()
        ));
    }
    // What is shown is not used: the impossible is reported as well, and `compile` refuses it.
    for finding in list_implausible_values(&decompile(&calibration)) {
        report::print_warning(format_args!("{}: {}", from.display(), finding.warning.what));
    }
    let shown = decompile::decompile_to_toml(&calibration);
    let not_met = shown.largest_difference_nm.as_ref().err();
    if let Some(reason) = not_met {
        report::print_warning(format_args!("{}: does not compile back: {reason}", from.display()));
    }
    if as_json {
        output::print(json!({
            "toml": shown.toml,
            "largest_difference_nm": shown.largest_difference_nm.as_ref().ok(),
            "does_not_compile_back": not_met,
        }))?;
    } else {
        output::print(shown.toml.trim_end())?;
    }
    Ok(if not_met.is_none() { CommandOutcome::Done } else { CommandOutcome::NotMet })
}
