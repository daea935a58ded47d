//! Which error the runs are compared in.

use trueup_machine::{InputFileError, RunFile, machine_file::Quantity};

/// Returns the quantity that is requested, or the only one that the runs measure.
pub(crate) fn resolve_quantity(
    runs: &[RunFile],
    asked: Option<Quantity>,
) -> Result<Quantity, InputFileError> {
    let measured = |quantity: Quantity| format!("measured_{}_um", quantity.name());
    if let Some(quantity) = asked {
        for run in runs {
            run.require_column(&measured(quantity))?;
        }
        return Ok(quantity);
    }
    let first = &runs[0];
    let there: Vec<Quantity> = Quantity::ALL
        .into_iter()
        .filter(|&quantity| runs.iter().all(|run| run.column(&measured(quantity)).is_some()))
        .collect();
    match there[..] {
        [only] => Ok(only),
        [] => {
            if let Some(slip) = runs
                .iter()
                .find_map(|run| run.find_column_typo(|name| name.starts_with("measured_")))
            {
                return Err(slip);
            }
            let places = first.value_location(0, "");
            let header = trueup_machine::Location { line: 1, column: 1, ..places };
            let rule = "a column measured_elongation_um, measured_dx_um, measured_dy_um or \
                        measured_dz_um is missing: there is nothing to compare the model with";
            Err(InputFileError::new(header, rule))
        }
        _ => {
            let names: Vec<&str> = there.iter().map(|quantity| quantity.name()).collect();
            let header =
                trueup_machine::Location { line: 1, column: 1, ..first.value_location(0, "") };
            let rule = format!(
                "several quantities are measured: choose one by --quantity {}",
                names.join(" or --quantity ")
            );
            Err(InputFileError::new(header, rule))
        }
    }
}
