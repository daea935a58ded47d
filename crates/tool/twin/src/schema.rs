//! Every key of the scenario from the types that read it, for editors (JSON schema) and for the reference (a
//! table of Markdown): what stands next to a field there is what users read here.

use schemars::{Schema, generate::SchemaSettings};
use serde::{
    Deserialize, Deserializer,
    de::{Error as _, Visitor, value::Error},
};
use serde_json::Value;

use crate::{
    Scenario,
    ambient::AmbientConfig,
    axes::{Abbe, AxisConfig, StraightnessConfig},
    instrument::InstrumentConfig,
    path::Segment,
    rigid_bodies::Body,
    scenario::{CoolantConfig, MAX_SCENARIO_ROWS},
    sensors::{DisplacementConfig, ThermometerConfig},
    spindle::SpindleConfig,
    tool::ToolConfig,
};

/// Returns the scenario as a JSON schema (draft 2020-12).
#[must_use]
pub fn scenario_schema() -> Value {
    let settings =
        SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
    let mut schema: Schema = settings.into_generator().into_root_schema_for::<Scenario>();
    schema.insert("title".into(), "Scenario of trueup".into());
    schema.insert(
        "description".into(),
        format!(
            "A virtual machine tool and what it does, for `trueup simulate`: at most {MAX_SCENARIO_ROWS:.0} rows."
        )
        .into(),
    );
    schema.to_value()
}

/// Returns the scenario's keys as a table of Markdown.
#[must_use]
pub fn scenario_markdown_table() -> String {
    let mut rows = "| key | what stands there | default | what |\n|---|---|---|---|\n".to_string();
    append_table_rows(&scenario_schema(), "", &mut rows);
    rows
}

/// The keys of a table, then the tables in it, in the order of the code.
fn append_table_rows(schema: &Value, name: &str, rows: &mut String) {
    let is_needed = |key: &str| {
        schema["required"].as_array().is_some_and(|needed| needed.iter().any(|other| other == key))
    };
    let all = table_keys(name).iter().map(|key| (*key, &schema["properties"][*key]));
    for (key, value) in all.clone().filter(|(_, value)| table_schema(value).is_none()) {
        let default = match &value["default"] {
            _ if is_needed(key) => "needed".into(),
            Value::Null => String::new(),
            default => format!("`{default}`"),
        };
        let (form, what) = (describe_value_type(value), describe_key(value));
        rows.push_str(&format!("| `{key}` | {form} | {default} | {what} |\n"));
    }
    for (key, value) in all {
        let Some((inner, how)) = table_schema(value) else { continue };
        let title = match how {
            TableMultiplicity::One => format!("[{key}]"),
            TableMultiplicity::Named => format!("[{key}.<name>]"),
            TableMultiplicity::Many => format!("[[{key}]]"),
        };
        let need = if is_needed(key) { "needed" } else { "" };
        rows.push_str(&format!("| **`{title}`** | | {need} | {} |\n", describe_key(value)));
        append_table_rows(inner, key, rows);
    }
}

/// Returns the keys of the table of this name, of the file itself where it has none.
fn table_keys(table: &str) -> &'static [&'static str] {
    match table {
        "" => field_names::<Scenario>(),
        "ambient" => field_names::<AmbientConfig>(),
        "coolant" => field_names::<CoolantConfig>(),
        "spindle" => field_names::<SpindleConfig>(),
        "tool" => field_names::<ToolConfig>(),
        "sensor" => field_names::<DisplacementConfig>(),
        "thermometer" => field_names::<ThermometerConfig>(),
        "axis" => field_names::<AxisConfig>(),
        "straightness" => field_names::<StraightnessConfig>(),
        "abbe" => field_names::<Abbe>(),
        "body" => field_names::<Body>(),
        "instrument" => field_names::<InstrumentConfig>(),
        "segment" => field_names::<Segment>(),
        _ => &[],
    }
}

/// Returns the fields of a type in the order of the code, which a schema forgets: its reader is asked for them.
fn field_names<'de, T: Deserialize<'de>>() -> &'static [&'static str] {
    let mut fields: &'static [&'static str] = &[];
    // It reads nothing, and so cannot but fail.
    _ = T::deserialize(FieldNameCollector(&mut fields));
    fields
}

/// The deserializer that records the fields that a type's reader wants.
struct FieldNameCollector<'f>(&'f mut &'static [&'static str]);

impl<'de> Deserializer<'de> for FieldNameCollector<'_> {
    type Error = Error;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        fields: &'static [&'static str],
        _visitor: V,
    ) -> Result<V::Value, Error> {
        *self.0 = fields;
        Err(Error::custom("nothing is read"))
    }

    fn deserialize_any<V: Visitor<'de>>(self, _visitor: V) -> Result<V::Value, Error> {
        Err(Error::custom("not a table"))
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit
        unit_struct newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

/// How often a table may stand in the file.
enum TableMultiplicity {
    One,
    /// One for each name.
    Named,
    /// One after the other.
    Many,
}

/// Returns the schema of a table that `value` is, or holds.
fn table_schema(value: &Value) -> Option<(&Value, TableMultiplicity)> {
    let whole = value["anyOf"].as_array().and_then(|any| any.first()).unwrap_or(value);
    let is_table = |schema: &Value| schema["properties"].is_object();
    let named = || {
        let patterns = whole["patternProperties"].as_object().and_then(|all| all.values().next());
        [Some(&whole["additionalProperties"]), patterns]
            .into_iter()
            .flatten()
            .find(|schema| is_table(schema))
    };
    if is_table(whole) {
        return Some((whole, TableMultiplicity::One));
    }
    if is_table(&whole["items"]) {
        return Some((&whole["items"], TableMultiplicity::Many));
    }
    named().map(|named| (named, TableMultiplicity::Named))
}

/// Returns what may stand at a key, in words.
fn describe_value_type(value: &Value) -> String {
    if let Some(any) = value["anyOf"].as_array() {
        return any.first().map(describe_value_type).unwrap_or_default();
    }
    let choices = value["enum"].as_array().or(value["oneOf"].as_array());
    if let Some(choices) = choices {
        let name = |schema: &Value| {
            schema["const"].as_str().or(schema.as_str()).map(|text| format!("`\"{text}\"`"))
        };
        return choices.iter().filter_map(name).collect::<Vec<_>>().join(", ");
    }
    let name = match &value["type"] {
        Value::Array(all) => all.first().and_then(Value::as_str),
        one => one.as_str(),
    };
    match name {
        Some("array") if value["items"]["type"] == "array" => "rows of two numbers".into(),
        Some("array") => match value["maxItems"].as_u64() {
            Some(2) => "two numbers".into(),
            Some(3) => "three numbers".into(),
            _ => format!("a list of {}", describe_value_type(&value["items"])),
        },
        Some("string") => "text".into(),
        Some("integer") => "whole number".into(),
        Some("boolean") => "`true` or `false`".into(),
        name => name.unwrap_or_default().into(),
    }
}

/// Returns what a key is, on one line, without its full stop.
fn describe_key(value: &Value) -> String {
    let text = value["description"].as_str().unwrap_or_default();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    text.trim_end_matches('.').replace('|', "\\|")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn each_table(schema: &Value, name: &str, with: &mut impl FnMut(&str, Vec<&str>)) {
        let properties = schema["properties"].as_object().expect("a table has keys");
        with(name, properties.keys().map(String::as_str).collect());
        for (key, value) in properties {
            if let Some((inner, _)) = table_schema(value) {
                each_table(inner, key, with);
            }
        }
    }

    #[test]
    fn the_table_has_every_key_of_the_schema() {
        let mut tables = 0;
        each_table(&scenario_schema(), "", &mut |name, keys| {
            let mut fields = table_keys(name).to_vec();
            fields.sort_unstable();
            assert_eq!(fields, keys, "{name}");
            tables += 1;
        });
        assert_eq!(tables, 13);
    }

    #[test]
    fn every_key_says_what_stands_there_and_what_it_is() {
        let table = scenario_markdown_table();
        assert!(table.lines().count() > 100, "{table}");
        for row in table.lines().skip(2) {
            let cells: Vec<&str> = row.split(" | ").map(str::trim).collect();
            assert!(row.starts_with("| **") || !cells[1].is_empty(), "{row}");
            assert!(cells.last().is_some_and(|what| what.len() > 8), "{row}");
            assert!(!row.contains("[`"), "a link of the code: {row}");
        }
    }
}
