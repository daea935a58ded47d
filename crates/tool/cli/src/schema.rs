//! `trueup schema`: every key of the machine file and of a scenario, every column of a run, for editors and
//! the reference.

use anyhow::Result;
use clap::{Args, ValueEnum};
use trueup_machine::schema;

use crate::{CommandOutcome, output};

/// Prints what a machine file or a scenario may hold, as a JSON schema for your editor, or the columns of a
/// run.
#[derive(Args)]
#[command(after_help = "Examples:
  trueup schema > trueup.schema.json      then, as the first line of a machine file:
      #:schema ./trueup.schema.json       (Even Better TOML, taplo)
  trueup schema run
  trueup schema scenario
  trueup schema --markdown                the tables of docs/reference.md")]
pub struct SchemaArgs {
    /// Of which file.
    #[arg(value_enum, default_value_t = SchemaKind::Machine)]
    of: SchemaKind,
    /// As a table of Markdown.
    #[arg(long)]
    markdown: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum SchemaKind {
    /// The machine file.
    Machine,
    /// The columns of a run.
    Run,
    /// The scenario of `simulate`.
    Scenario,
}

/// Prints it.
pub fn run(args: &SchemaArgs) -> Result<CommandOutcome> {
    let table = || match args.of {
        SchemaKind::Machine => schema::machine_file_markdown(),
        SchemaKind::Run => schema::run_columns_markdown(),
        SchemaKind::Scenario => trueup_twin::schema::scenario_markdown_table(),
    };
    let schema = || match args.of {
        SchemaKind::Machine => schema::machine_file_schema(),
        SchemaKind::Run => schema::run_columns_json(),
        SchemaKind::Scenario => trueup_twin::schema::scenario_schema(),
    };
    if args.markdown {
        output::print(table().trim_end())?;
    } else {
        output::print(serde_json::to_string_pretty(&schema())?)?;
    }
    Ok(CommandOutcome::Done)
}
