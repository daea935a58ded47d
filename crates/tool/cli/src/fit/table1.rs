//! `trueup fit table1`: ways to a straightness curve side by side.

use std::path::{Path, PathBuf};

use anyhow::Result;
use serde_json::{Value, json};
use trueup_fit::straightness::method_table::{
    MethodResult, MethodTable, MethodTableEntry, MethodTableOptions, ResidualDeviation,
    build_method_table,
};

use super::{FitInput, args};
use crate::{CommandOutcome, output, provenance};

/// Makes the table, prints it, and writes the page.
pub fn run(args: &args::Table1Args, as_json: bool) -> Result<CommandOutcome> {
    let args::FitInputArgs { run, machine } = &args.measured;
    let input = FitInput::read(&args.measured)?;
    let quantity = args.curve.error.quantity();
    let options = MethodTableOptions {
        quantity: quantity.as_deref(),
        options: args.curve.to_options(),
        feed_mm_per_min: args.feed,
        cycle_ms: args.cycle_ms,
    };
    let table = build_method_table(&input.runs, &options)?;
    let inputs: Vec<&Path> = run.iter().chain(machine).map(PathBuf::as_path).collect();
    let html = table.to_html(&provenance::provenance_from_files(&inputs)?);
    output::write_atomically(&args.output, &inputs, |out| out.write_all(html.as_bytes()))?;
    if as_json {
        output::print(table1_json(&table, &args.output))?;
    } else {
        for entry in &table.entries {
            print(entry)?;
        }
        output::print(format_args!(
            "jumps and accelerations at {} mm/min, a new target each {} ms\n{}",
            table.feed_mm_per_min,
            table.cycle_ms,
            args.output.display()
        ))?;
    }
    Ok(CommandOutcome::Done)
}

fn print(entry: &MethodTableEntry) -> Result<()> {
    output::print(format_args!("{}, {} positions", entry.name, entry.positions))?;
    output::print(format_args!("  without: {}", format_residuals(&entry.without)))?;
    for row in &entry.rows {
        let MethodResult { way, jump_mm_per_s, acceleration_mm_per_s2, .. } = row;
        output::print(format_args!(
            "  {way}: {}; jumps of {jump_mm_per_s:.6} mm/s, requires {acceleration_mm_per_s2:.4} mm/s2",
            format_residuals(&row.left)
        ))?;
    }
    Ok(())
}

fn format_residuals(
    ResidualDeviation { residual, over_a_metre_um, step_um }: &ResidualDeviation,
) -> String {
    // + 0.0 turns -0 into 0.
    let mean_um = (residual.mean_um * 100.0).round() / 100.0 + 0.0;
    format!(
        "range {:.2} µm, mean {mean_um:.2} µm, mean square {:.2} µm², {over_a_metre_um:.2} µm in any metre, \
         {step_um:.2} µm from one position to the next",
        residual.range_um, residual.mean_square_um2
    )
}

fn table1_json(table: &MethodTable, page: &Path) -> Value {
    let left = |ResidualDeviation { residual, over_a_metre_um, step_um }: &ResidualDeviation| {
        json!({
            "range_um": residual.range_um, "mean_um": residual.mean_um,
            "mean_square_um2": residual.mean_square_um2, "largest_um": residual.largest_um,
            "over_a_metre_um": over_a_metre_um, "step_um": step_um,
        })
    };
    let row = |row: &MethodResult| {
        json!({
            "way": row.way.to_string(), "coefficients": row.coefficients, "left": left(&row.left),
            "jump_mm_per_s": row.jump_mm_per_s,
            "acceleration_mm_per_s2": row.acceleration_mm_per_s2,
        })
    };
    let entry = |entry: &MethodTableEntry| {
        json!({
            "name": entry.name, "positions": entry.positions, "without": left(&entry.without),
            "ways": entry.rows.iter().map(row).collect::<Vec<_>>(),
            "papers_control_points": entry.steps,
        })
    };
    json!({
        "entries": table.entries.iter().map(entry).collect::<Vec<_>>(),
        "feed_mm_per_min": table.feed_mm_per_min, "cycle_ms": table.cycle_ms,
        "output": page.to_string_lossy(),
    })
}
