//! `extended.toml`: the user's machine file as it is, comments and all, with the terms after it.

use trueup_machine::{BadInput, MachineFile, machine_file::Term};

/// `source` with `terms` at its end. It is read back, so that what is handed out can be loaded.
///
/// # Errors
/// `source` is no machine file.
pub(crate) fn extended(
    source: &str,
    path: &std::path::Path,
    terms: &[Term],
) -> Result<String, BadInput> {
    let mut text = source.trim_end().to_string();
    text.push('\n');
    for term in terms {
        text.push('\n');
        text.push_str(&term.to_toml());
    }
    MachineFile::parse(&text, path)?;
    Ok(text)
}
