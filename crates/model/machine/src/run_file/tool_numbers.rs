//! The tools of a run with the numbers of a machine file.

use super::RunFile;
use crate::{
    location::InputFileError, machine_file::Machine, sections::ToolGrowthList,
    tool_column::TOOL_COLUMN,
};

impl RunFile {
    /// Returns the label that a value of the column `tool` stands for, if it is one.
    #[must_use]
    pub(crate) fn tool_label(&self, value: f64) -> Option<&str> {
        self.labels.iter().find(|(code, _)| *code == value).map(|(_, label)| label.as_str())
    }

    /// Puts the numbers of `[spindle.tools]` in the place of labels. A label that is listed without a number stays one.
    ///
    /// # Errors
    /// A label that the machine file does not list: at its first row.
    pub fn with_tool_numbers(self, machine: &Machine) -> Result<Self, InputFileError> {
        let tools = machine.spindle.tools.as_ref();
        let codes: Vec<(f64, u16)> =
            tools.into_iter().flat_map(ToolGrowthList::numbered_label_codes).collect();
        let is_listed = |label: &str| {
            tools.is_some_and(|table| {
                table.tools.iter().any(|tool| tool.label.as_deref() == Some(label))
            })
        };
        if let Some((code, label)) = self.labels.iter().find(|(_, label)| !is_listed(label)) {
            let values = self.column(TOOL_COLUMN).unwrap_or_default();
            let row = values.iter().position(|value| value == code).unwrap_or(0);
            let rule = format!("is \"{label}\", a label that has no number in [spindle.tools]");
            let list = if tools.is_some() {
                ""
            } else {
                "[spindle.tools]\ndefault = { um_per_krpm2 = 0.0 }\n"
            };
            let help = format!(
                "write the number that the CNC sends, or add to the machine file:\n{list}{label:?} = {{ number = 1, um_per_krpm2 = 0.0 }}"
            );
            return Err(self.value_error(row, TOOL_COLUMN, rule).with_help(help));
        }
        if codes.is_empty() || self.labels.is_empty() {
            return Ok(self);
        }
        let number = |value: f64| codes.iter().find(|(code, _)| *code == value);
        Ok(self.with_altered_values(self.row_count(), |name, values| {
            if name == TOOL_COLUMN {
                for value in values {
                    *value = number(*value).map_or(*value, |(_, number)| f64::from(*number));
                }
            }
        }))
    }
}
