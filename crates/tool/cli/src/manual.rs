//! `trueup completions` and `trueup man`: what a shell and `man` know of this tool, out of its own
//! description of its commands.

use std::{fs, io::Write as _, path::PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, Command};
use clap_complete::Shell;

use crate::{
    CommandOutcome,
    output::{self, FileTransaction},
};

/// Prints what a shell completes this tool's commands and options with.
///
/// bash: trueup completions bash > ~/.local/share/bash-completion/completions/trueup
#[derive(Args)]
pub struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

/// Writes the manual's pages, one for each command: man ./trueup-fit.1.
#[derive(Args)]
pub struct ManArgs {
    /// The folder; it is made if there is none.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Prints the completions.
pub fn print_completions(args: &CompletionsArgs, mut tool: Command) -> Result<CommandOutcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut tool, "trueup", &mut script);
    let mut out = trueup_output::StdoutWriter;
    out.write_all(&script)
        .and_then(|()| out.flush())
        .context("standard output cannot be written")?;
    Ok(CommandOutcome::Done)
}

/// Writes the pages.
pub fn write_man_pages(args: &ManArgs, tool: Command, as_json: bool) -> Result<CommandOutcome> {
    fs::create_dir_all(&args.folder).with_context(|| args.folder.display().to_string())?;
    let made = tempfile::Builder::new().prefix("trueup-man-").tempdir()?;
    clap_mangen::generate_to(tool.disable_help_subcommand(true), made.path())?;
    let names =
        fs::read_dir(&made)?.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
    let mut pages: Vec<String> = names.collect::<Result<_>>()?;
    pages.sort();
    let mut set = FileTransaction::new(&[]);
    for page in &pages {
        let bytes = fs::read(made.path().join(page))?;
        set.add(&args.folder.join(page), |out| out.write_all(&bytes))?;
    }
    set.commit()?;
    output::print_written_files(&args.folder, &pages, as_json)?;
    Ok(CommandOutcome::Done)
}
