//! Every number of a machine by its key, from the writers of its sections.

use crate::{
    file::Machine,
    keys::section::{NewSection, Value},
};

/// A number of a machine file, or several of one key.
pub(super) struct NumericEntry {
    /// Its key as `Locations` has it: `term[0].um_per_c`.
    pub(super) key: String,
    /// Its key in the table of ranges: `term.slow-mode.um_per_c`.
    pub(super) row: String,
    pub(super) values: Vec<f64>,
}

/// Returns the numbers of `machine`, those that came by default included.
pub(super) fn numeric_entries(machine: &Machine) -> Vec<NumericEntry> {
    let mut entries = Vec::new();
    for section in machine.sections() {
        let name = section.name().to_string();
        collect_section_entries(&section, &name, &name, &mut entries);
    }
    for (index, term) in machine.terms.iter().enumerate() {
        let row = format!("term.{}", term.effect.name());
        collect_section_entries(&term.to_section(), &format!("term[{index}]"), &row, &mut entries);
    }
    entries
}

fn collect_section_entries(
    section: &NewSection,
    name: &str,
    row: &str,
    entries: &mut Vec<NumericEntry>,
) {
    for (key, value) in section.key_values() {
        collect_value_entries(&format!("{name}.{key}"), format!("{row}.{key}"), value, entries);
    }
}

fn collect_value_entries(key: &str, row: String, value: &Value, entries: &mut Vec<NumericEntry>) {
    let values: Vec<f64> = match value {
        Value::Number(number) => vec![*number],
        Value::Whole(number) => vec![f64::from(*number)],
        Value::Numbers(numbers) => numbers.clone(),
        Value::Wholes(numbers) => numbers.iter().copied().map(f64::from).collect(),
        Value::Rows(rows) => rows.iter().flatten().copied().collect(),
        Value::Inline(inner) => {
            for (name, value) in inner {
                collect_value_entries(
                    &format!("{key}.{name}"),
                    format!("{row}.{name}"),
                    value,
                    entries,
                );
            }
            return;
        }
        Value::Boolean(_) | Value::Text(_) | Value::Texts(_) => return,
    };
    entries.push(NumericEntry { key: key.to_string(), row, values });
}
