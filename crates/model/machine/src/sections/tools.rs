//! `[spindle.tools]`: how each tool grows with speed, and which number of the CNC is which tool.
//!
//! A key is the number that the CNC sends, or a label of the run file's column `tool` with its `number`. The growth
//! that is added is `um_per_krpm2`·(n/1000)²; a tool that is not in the list has that of `default`.

use crate::{
    keys::{
        key::{Key, ValueType, key, section},
        plausible_range::SPEED_GROWTH_RANGE,
        reader::Section,
        section::NewSection,
        table::{Table, build_inline_table, entries, table, to_inline_table},
    },
    location::{InputFileError, truncate_text},
    tool_column::label_code,
};

/// The key of every tool that is not in the list.
const DEFAULT_TOOL_KEY: &str = "default";

table! {
    /// The growth of every tool that is not in the list.
    struct DefaultToolKeys {
        um_per_krpm2: f64 = GROWTH_KEY;
    }
}

table! {
    /// A tool as it is written.
    struct ToolKeys {
        um_per_krpm2: f64 = GROWTH_KEY;
        number: Option<u16> = key(Whole(0, 65_535), "", "of a key that is a label: the number that the CNC sends; `compile` refuses a label without one").with_example_value("7").with_range(range([0.0, 65535.0], [0.0, 65535.0], [1.0, 100.0], USER_SETTING_SOURCE));
        label: Option<String> = key(Text, "", "of a key that is a number: what the column `tool` of a run file calls it").with_example_value("\"drill\"");
    }
}

const GROWTH_KEY: Key =
    key("um_per_krpm2", ValueType::Number, "µm", "growth with speed, for (1000 r/min)²")
        .required()
        .with_example_value("0.021")
        .with_range(SPEED_GROWTH_RANGE);

pub(crate) const TOOL_LIST_KEYS: &[Key] = &[
    section(
        DEFAULT_TOOL_KEY,
        DefaultToolKeys::KEYS,
        "every tool that is not in the list, and while no tool is known",
    )
    .required(),
    section(
        "<tool>",
        ToolKeys::KEYS,
        "a tool, by the number that the CNC sends or by a label; at most 32",
    ),
];

/// The tools of a spindle.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolGrowthList {
    /// The growth of a tool that is not in the list, in µm for (1000 r/min)².
    pub default_um_per_krpm2: f64,
    /// In the order of their numbers, those without one last; at most 32.
    pub tools: Vec<ToolGrowth>,
}

/// One of them; it has a number, a label, or both.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolGrowth {
    /// The number that the CNC sends.
    pub number: Option<u16>,
    /// Its label in the column `tool` of a run.
    pub label: Option<String>,
    /// In µm for (1000 r/min)².
    pub um_per_krpm2: f64,
}

impl ToolGrowth {
    /// Returns its key in the file.
    #[must_use]
    pub fn key(&self) -> String {
        self.number
            .map_or_else(|| self.label.clone().unwrap_or_default(), |number| number.to_string())
    }
}

impl ToolGrowthList {
    /// Returns what each label that has a number is in a run, with that number.
    pub(crate) fn numbered_label_codes(&self) -> impl Iterator<Item = (f64, u16)> {
        let code = |tool: &ToolGrowth| Some((label_code(tool.label.as_deref()?), tool.number?));
        self.tools.iter().filter_map(code)
    }

    /// Returns the first label that has no number.
    #[must_use]
    pub(crate) fn first_unnumbered_label(&self) -> Option<&str> {
        self.tools.iter().find(|tool| tool.number.is_none())?.label.as_deref()
    }
}

pub(crate) fn read(section: &Section<'_>) -> Result<ToolGrowthList, InputFileError> {
    let default = section.required(DEFAULT_TOOL_KEY, section.section(DEFAULT_TOOL_KEY)?)?;
    let mut tools: Vec<ToolGrowth> = Vec::new();
    for key in section.keys().into_iter().filter(|key| *key != DEFAULT_TOOL_KEY) {
        let Some(of) = section.section(key)? else { continue };
        let ToolKeys { um_per_krpm2, number: stated, label } = ToolKeys::read(&of)?;
        let (number, label) = match key.parse::<f64>() {
            Err(_) if label.is_some() => {
                return Err(of.key_error(
                    "label",
                    "belongs to a key that is a number: this key is the label",
                ));
            }
            Err(_) => (stated, Some(key.to_string())),
            Ok(_) if stated.is_some() => {
                return Err(of.key_error(
                    "number",
                    "belongs to a key that is a label: this key is the number",
                ));
            }
            Ok(_) => {
                let number = key.parse().map_err(|_| {
                    let rule = "is no number of a tool: it must be a whole number from 0 to 65535, or a label";
                    section.key_error(key, rule)
                })?;
                (Some(number), label)
            }
        };
        let label = label.map(|label| label.trim().to_string());
        if label.as_deref().is_some_and(|label| label.is_empty() || label.parse::<f64>().is_ok()) {
            return Err(of.key_error("label", "must be a word, not empty and no number"));
        }
        let is_same = |tool: &&ToolGrowth| {
            number.is_some() && tool.number == number || label.is_some() && tool.label == label
        };
        if let Some(other) = tools.iter().find(is_same) {
            let rule = format!("is the tool of {} as well", truncate_text(&other.key()));
            return Err(section.key_error(key, rule));
        }
        tools.push(ToolGrowth { number, label, um_per_krpm2 });
    }
    let most = trueup_core::design_parameters::MAX_TOOLS;
    if tools.len() > most {
        let last = tools[most].key();
        let rule = format!(
            "is too much: a board knows {most} tools; leave those to `default` that grow like it"
        );
        return Err(section.key_error(&last, rule));
    }
    tools.sort_by_key(|tool| tool.number.map_or(u32::MAX, u32::from));
    let DefaultToolKeys { um_per_krpm2 } = DefaultToolKeys::read(&default)?;
    Ok(ToolGrowthList { default_um_per_krpm2: um_per_krpm2, tools })
}

/// Returns `section` with the tools and the default.
pub(crate) fn write(section: NewSection, tools: &ToolGrowthList) -> NewSection {
    let section = tools.tools.iter().fold(section, |section, tool| {
        // The key is the number, or else the label.
        let label = tool.label.clone().filter(|_| tool.number.is_some());
        let keys = ToolKeys { um_per_krpm2: tool.um_per_krpm2, number: None, label };
        let mut entries = entries(&keys);
        entries.rotate_left(1);
        section.with_value(tool.key(), build_inline_table(entries))
    });
    let default = DefaultToolKeys { um_per_krpm2: tools.default_um_per_krpm2 };
    section.with_value(DEFAULT_TOOL_KEY, to_inline_table(&default))
}
