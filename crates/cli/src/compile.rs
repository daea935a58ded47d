//! `trueup compile`: a machine file into the blob that the bridge stores.

use std::path::Path;

use anyhow::{Result, ensure};
use serde_json::json;
use trueup_link::calibration::{SIZE, decode, encode};
use trueup_machine::{MachineFile, compile};

use crate::{Outcome, output};

/// Compiles `machine` to `to`.
pub fn run(machine: &Path, to: &Path, as_json: bool) -> Result<Outcome> {
    let read = MachineFile::read(machine)?;
    let compiled = compile(&read)?;
    let blob = encode(&compiled.calibration);
    ensure!(
        decode(&blob) == Ok(compiled.calibration),
        "the bridge would refuse this calibration; nothing is written"
    );
    output::write_whole(to, &[machine], |out| out.write_all(&blob))?;

    let nm = compiled.largest_difference_nm;
    if as_json {
        output::print(json!({
            "output": to.to_string_lossy(),
            "machine": read.name,
            "bytes": SIZE,
            "largest_difference_nm": nm,
        }))?;
    } else {
        output::print(format_args!(
            "{}: calibration of \"{}\", {SIZE} bytes\n\
             largest difference from the model: {nm:.3} nm",
            to.display(),
            read.name.escape_debug(),
        ))?;
    }
    Ok(Outcome::Done)
}
