//! `trueup compile`: a machine file into the blob that the bridge stores.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::json;
use trueup_machine::{check::no_correction_warning, compile};

use crate::{CommandOutcome, input_files, machine_arg::MachineArg, output, report};

#[derive(Args)]
pub struct CompileArgs {
    #[command(flatten)]
    machine: MachineArg,
    /// Where to write the calibration.
    #[arg(long, value_name = "CAL.bin")]
    output: PathBuf,
}

/// Compiles the machine file.
pub fn run(args: &CompileArgs, as_json: bool) -> Result<CommandOutcome> {
    let (machine, to) = (args.machine.path(), &args.output);
    let read = input_files::read_machine(machine)?;
    let compiled = compile(&read)?;
    if let Some(nothing) = no_correction_warning(&read) {
        report::print_brief_warnings(machine, &[nothing]);
    }
    let blob = compiled.blob();
    output::write_atomically(to, &[machine], |out| out.write_all(blob))?;

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
    Ok(CommandOutcome::Done)
}
