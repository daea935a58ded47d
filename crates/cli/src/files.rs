//! Machine files and runs as every command reads them: what is unlikely to be meant in them is said.

use std::path::Path;

use trueup_machine::{
    BadInput, Machine, MachineFile, RunFile,
    check::{self, Summary},
};

use crate::{report, runs, summary};

/// Reads the machine file at `path`, and says in short what is unlikely in it.
pub fn machine(path: &Path) -> Result<Machine, BadInput> {
    parsed(&MachineFile::read_text(path)?, path)
}

/// The same of a text that is there already.
pub fn parsed(source: &str, path: &Path) -> Result<Machine, BadInput> {
    let machine = MachineFile::parse(source, path)?;
    report::in_short(path, &check::machine(&machine));
    report::in_detail(|| summary::in_words(&machine, &Summary::of(&machine)));
    Ok(machine)
}

/// Reads the run at `path`, and says in short what is unlikely in it, by itself and beside `machine`.
pub fn run(path: &Path, machine: Option<&Machine>) -> Result<RunFile, BadInput> {
    let run = runs::read(path)?;
    report::in_short(path, &check::run(&run, machine));
    Ok(run)
}

/// The same for a command that looks after the names of the columns itself.
pub fn run_of_known_names(path: &Path, machine: &Machine) -> Result<RunFile, BadInput> {
    let run = runs::read(path)?;
    report::in_short(path, &check::values(&run, Some(machine)));
    Ok(run)
}
