//! Every key of the machine file and every column of a run, from the tables that the readers use: as a JSON
//! schema (draft 2020-12) for editors, and as the tables of `docs/reference.md`.

use std::path::Path;

use serde_json::{Map, Value, json};

use crate::{
    effect::Cause,
    keys::{
        key::{Key, Requirement, ValueType},
        reader::{MAX_ARRAY_LENGTH, TomlDocument},
        term::{TERM, TERM_KEYS},
    },
    known_columns::KNOWN_COLUMNS,
    machine_file::machine_file_keys::MACHINE_FILE_KEYS,
};

/// Returns the machine file as a JSON schema.
#[must_use]
pub fn machine_file_schema() -> Value {
    let mut schema = table_schema(MACHINE_FILE_KEYS);
    let head = [
        ("$schema", "https://json-schema.org/draft/2020-12/schema"),
        ("title", "Machine file of trueup"),
        (
            "description",
            "What is believed about a machine tool. What is missing is not part of it.",
        ),
    ];
    if let Some(map) = schema.as_object_mut() {
        map.extend(head.map(|(key, text)| (key.to_string(), text.into())));
    }
    schema
}

/// Returns the columns of a run that are known, each with its unit and meaning.
#[must_use]
pub fn run_columns_json() -> Value {
    let column = |column: &crate::known_columns::KnownColumn| json!({"name": column.name, "unit": column.unit, "description": strip_markdown(column.meaning)});
    KNOWN_COLUMNS.iter().map(column).collect()
}

/// Returns a meaning without the marks of Markdown.
fn strip_markdown(meaning: &str) -> String {
    meaning.replace('`', "")
}

fn table_schema(keys: &[Key]) -> Value {
    let (mut properties, mut patterns) = (Map::new(), Map::new());
    let mut others = Value::from(false);
    for key in keys {
        match key.name.split_once("<name>") {
            // Of any name.
            None if key.name.starts_with('<') => {
                others = value_schema(key);
                None
            }
            None => properties.insert(key.name.into(), value_schema(key)),
            Some((before, after)) => {
                patterns.insert(format!("^{before}.+{after}$"), value_schema(key))
            }
        };
    }
    let required = keys.iter().filter(|key| key.need == Requirement::Required).map(|key| key.name);
    let required: Vec<&str> = required.collect();
    let mut table = json!({
        "type": "object", "properties": properties, "additionalProperties": others,
    });
    if !patterns.is_empty() {
        table["patternProperties"] = patterns.into();
    }
    if !required.is_empty() {
        table["required"] = required.into();
    }
    table
}

fn value_schema(key: &Key) -> Value {
    let numbers = json!({
        "type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": MAX_ARRAY_LENGTH,
    });
    let three = json!({"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3});
    let mut schema = match key.form {
        ValueType::Text => json!({"type": "string"}),
        ValueType::Boolean => json!({"type": "boolean"}),
        ValueType::Choice(choices) => json!({"enum": choices}),
        ValueType::Choices(choices) => {
            json!({"type": "array", "items": {"enum": choices}, "maxItems": 2})
        }
        ValueType::Column => json!({"type": "string", "pattern": "^temp_.+_c$"}),
        ValueType::Number => json!({"type": "number"}),
        ValueType::Positive => json!({"type": "number", "exclusiveMinimum": 0}),
        ValueType::NotNegative => json!({"type": "number", "minimum": 0}),
        ValueType::Whole(least, most) => {
            json!({"type": "integer", "minimum": least, "maximum": most})
        }
        ValueType::Numbers => numbers,
        ValueType::NumberOrNumbers => json!({"anyOf": [{"type": "number"}, numbers]}),
        ValueType::Vector => three,
        ValueType::Rows => json!({
            "type": "array", "items": three, "minItems": 1, "maxItems": MAX_ARRAY_LENGTH,
        }),
        ValueType::Table(keys) => table_schema(keys),
        ValueType::Terms => json!({"type": "array", "items": term_schema()}),
    };
    let unit = if key.unit.is_empty() { String::new() } else { format!(" ({})", key.unit) };
    schema["description"] = format!("{}{unit}", strip_markdown(key.meaning)).into();
    // TOML's strings, numbers and arrays of them are JSON as well.
    let json_of = |toml: &str| serde_json::from_str::<Value>(toml).ok();
    if let Requirement::Default(default) = key.need
        && let Some(default) = json_of(default)
    {
        schema["default"] = default;
    }
    if let Some(example) = json_of(key.example) {
        schema["examples"] = json!([example]);
    }
    schema
}

/// Returns a term: the keys that all have, and those of its cause.
fn term_schema() -> Value {
    let causes: Vec<Value> = Cause::ALL
        .iter()
        .map(|cause| {
            let common = TERM.iter().map(|key| key.name);
            let names: Vec<&str> = common.chain(cause_keys(*cause)).collect();
            json!({
                "if": {"properties": {"cause": {"const": cause.name()}}},
                "then": {"propertyNames": {"enum": names}},
            })
        })
        .collect();
    let mut schema = table_schema(&[TERM, TERM_KEYS].concat());
    let names: Vec<&str> = Cause::ALL.iter().map(|cause| cause.name()).collect();
    schema["properties"]["cause"] = json!({"enum": names, "description": "the cause's name"});
    schema["allOf"] = causes.into();
    schema
}

/// Returns the keys of a cause besides those that all have: which of them go together depends on what stands
/// there, so that the page is asked next to each of them.
#[must_use]
pub fn cause_keys(cause: Cause) -> Vec<&'static str> {
    let mut names: Vec<&'static str> = Vec::new();
    for adjacent in [""].into_iter().chain(TERM_KEYS.iter().map(|key| key.name)) {
        let text =
            if adjacent.is_empty() { "[t]\n".into() } else { format!("[t]\n{adjacent} = 1\n") };
        let Ok(document) = TomlDocument::parse(&text, Path::new("")) else { continue };
        let Ok(Some(section)) = document.root().section("t") else { continue };
        for name in cause.keys(&section) {
            if !names.contains(name) {
                names.push(name);
            }
        }
    }
    names
}

/// Returns the machine file's keys as a table of Markdown.
#[must_use]
pub fn machine_file_markdown() -> String {
    let mut rows =
        "| key | unit | range | default | what | for example |\n|---|---|---|---|---|---|\n"
            .to_string();
    append_key_rows(MACHINE_FILE_KEYS, "", &mut rows);
    rows
}

/// The rows of a section and of those in it. Sections that are alike are there once.
fn append_key_rows(keys: &[Key], section: &str, rows: &mut String) {
    let is_table = |key: &&Key| matches!(key.form, ValueType::Table(_));
    for key in keys.iter().filter(|key| !is_table(key)) {
        if matches!(key.form, ValueType::Terms) {
            rows.push_str(&format!(
                "| `[[{}]]` | | | | {}, see below | |\n",
                key.name, key.meaning
            ));
            continue;
        }
        let default = match key.need {
            Requirement::Required => "needed".into(),
            Requirement::Optional => String::new(),
            Requirement::Default(default) => format!("`{default}`"),
        };
        rows.push_str(&format!(
            "| `{}` | {} | {} | {default} | {} | {} |\n",
            key.name,
            key.unit,
            format_range(key),
            key.meaning,
            if matches!(key.need, Requirement::Default(_)) {
                String::new()
            } else {
                format!("`{}`", key.example)
            },
        ));
    }
    let mut seen: Vec<(*const Key, String)> = Vec::new();
    for key in keys.iter().filter(is_table) {
        let ValueType::Table(inner) = key.form else { continue };
        let name = if section.is_empty() {
            key.name.to_string()
        } else {
            format!("{section}.{}", key.name)
        };
        let alike = seen.iter().find(|(first, _)| *first == inner.as_ptr());
        let as_there = alike.map(|(_, first)| format!("; keys as in `[{first}]`"));
        // The second drive's table is that of the first.
        let of_drive = (key.name == "pitch" && section.ends_with("dual"))
            .then(|| "; keys as in `[axis.x.pitch]`".to_string());
        let elsewhere = as_there.or(of_drive);
        rows.push_str(&format!(
            "| **`[{name}]`** | | | | {}{} | |\n",
            key.meaning,
            elsewhere.as_deref().unwrap_or_default()
        ));
        if elsewhere.is_none() {
            append_key_rows(inner, &name, rows);
        }
        seen.push((inner.as_ptr(), name));
    }
}

fn format_range(key: &Key) -> String {
    let listed = |choices: &[&str]| {
        choices.iter().map(|choice| format!("`\"{choice}\"`")).collect::<Vec<_>>().join(", ")
    };
    match key.form {
        ValueType::Choice(choices) | ValueType::Choices(choices) => listed(choices),
        ValueType::Positive => "above 0".into(),
        ValueType::NotNegative => "from 0".into(),
        ValueType::Whole(least, u32::MAX) => format!("whole, from {least}"),
        ValueType::Whole(least, most) => format!("whole, {least} to {most}"),
        ValueType::Numbers => format!("1 to {MAX_ARRAY_LENGTH} numbers"),
        ValueType::Rows => format!("1 to {MAX_ARRAY_LENGTH} rows"),
        ValueType::Vector => "three numbers".into(),
        ValueType::Column => "`temp_<name>_c`".into(),
        ValueType::Text => "text".into(),
        ValueType::Boolean => "`true`, `false`".into(),
        _ => String::new(),
    }
}

/// Returns the known columns of a run as a table of Markdown.
#[must_use]
pub fn run_columns_markdown() -> String {
    let mut rows = "| column | unit | what |\n|---|---|---|\n".to_string();
    for column in KNOWN_COLUMNS {
        rows.push_str(&format!("| `{}` | {} | {} |\n", column.name, column.unit, column.meaning));
    }
    rows
}
