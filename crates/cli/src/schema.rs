//! `trueup schema`: every key of the machine file and every column of a run, for editors and the reference.

use anyhow::Result;
use clap::{Args, ValueEnum};
use trueup_machine::schema;

use crate::{Outcome, output};

/// Prints what a machine file may hold, as a JSON schema for your editor, or the columns of a run.
#[derive(Args)]
#[command(after_help = "Examples:
  trueup schema > trueup.schema.json      then, as the first line of a machine file:
      #:schema ./trueup.schema.json       (Even Better TOML, taplo)
  trueup schema run
  trueup schema --markdown                the tables of docs/reference.md")]
pub struct Schema {
    /// Of which file.
    #[arg(value_enum, default_value_t = Of::Machine)]
    of: Of,
    /// As a table of Markdown.
    #[arg(long)]
    markdown: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Of {
    /// The machine file.
    Machine,
    /// The columns of a run.
    Run,
}

/// Prints it.
pub fn run(args: &Schema) -> Result<Outcome> {
    match (args.of, args.markdown) {
        (Of::Machine, false) => {
            output::print(serde_json::to_string_pretty(&schema::machine_file())?)?
        }
        (Of::Machine, true) => output::print(schema::machine_table().trim_end())?,
        (Of::Run, false) => output::print(serde_json::to_string_pretty(&schema::run_columns())?)?,
        (Of::Run, true) => output::print(schema::run_table().trim_end())?,
    }
    Ok(Outcome::Done)
}
