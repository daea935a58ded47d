//! A machine file as the first word of a line, as `compile` and `export` are called, or behind `--machine` as
//! in every other command: one of the two.

use std::path::{Path, PathBuf};

use clap::Args;

#[derive(Args)]
#[group(required = true, multiple = false)]
pub struct MachineArg {
    /// The machine file.
    #[arg(value_name = "M.toml")]
    file: Option<PathBuf>,
    /// The same, as other commands take it.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
}

impl MachineArg {
    /// Where it is.
    pub fn path(&self) -> &Path {
        let given = self.file.as_deref().or(self.machine.as_deref());
        given.expect("the group of the two is required")
    }
}
