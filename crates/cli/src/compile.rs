//! `trueup compile`: a machine file into the blob that the bridge stores.

use std::path::Path;

use anyhow::Result;
use serde_json::json;
use trueup_machine::{MachineFile, compile};

use crate::{Outcome, output};

/// Compiles `machine` to `to`.
pub fn run(machine: &Path, to: &Path, as_json: bool) -> Result<Outcome> {
    let read = MachineFile::read(machine)?;
    let compiled = compile(&read)?;
    let blob = compiled.blob();
    output::write_whole(to, &[machine], |out| out.write_all(blob))?;

    let nm = compiled.largest_difference_nm;
    if as_json {
        output::print(json!({
            "output": to.to_string_lossy(),
            "machine": read.name,
            "bytes": blob.len(),
            "largest_difference_nm": nm,
        }))?;
    } else {
        output::print(format_args!(
            "{}: calibration of \"{}\", {} bytes\n\
             largest difference from the model: {nm:.3} nm",
            to.display(),
            read.name.escape_debug(),
            blob.len(),
        ))?;
    }
    Ok(Outcome::Done)
}
