//! Columns that would have one name.

use trueup_machine::InputFileError;
use trueup_output::escape::shell_quote;

use super::{ColumnMapping, ColumnRole, target_column};
use crate::layout::SourceTable;

/// Gives thermometers of one name numbers; other columns of one name are an error.
pub(super) fn disambiguate_column_names(
    plans: &mut [ColumnMapping],
    layout: &SourceTable,
) -> Result<(), InputFileError> {
    for at in 0..plans.len() {
        let Some(name) = target_column(&plans[at].role).map(|target| target.name.clone()) else {
            continue;
        };
        let is_taken = |plans: &[ColumnMapping], name: &str| {
            plans[..at]
                .iter()
                .any(|plan| target_column(&plan.role).is_some_and(|target| target.name == name))
        };
        if !is_taken(plans, &name) {
            continue;
        }
        let stem = name.strip_prefix("temp_").and_then(|rest| rest.strip_suffix("_c"));
        let Some(stem) = stem else {
            let first = plans[..at]
                .iter()
                .find(|plan| target_column(&plan.role).is_some_and(|column| column.name == name));
            let first = first.map_or("", |plan| plan.header.as_str());
            let rule = format!("{first} and {} would both be {name}", plans[at].header);
            let flag = shell_quote(&format!("{}=-", plans[at].header));
            return Err(InputFileError::new(layout.columns[at].place.clone(), rule)
                .with_help(format!("leave one out, or name it: --column {flag}")));
        };
        let stem =
            stem.trim_end_matches("_1").trim_end_matches('1').trim_end_matches('_').to_string();
        let free = (2..).map(|number| match stem.as_str() {
            "" => format!("temp_{number}_c"),
            stem => format!("temp_{stem}_{number}_c"),
        });
        let name = free.into_iter().find(|name| !is_taken(plans, name)).unwrap_or(name);
        if let ColumnRole::Number { target, .. } = &mut plans[at].role {
            target.name = name;
        }
    }
    Ok(())
}
