//! The table of keys is what the reader takes, what the schema says, and what `docs/reference.md` prints.

use std::{fs, path::Path};

use serde_json::{Map, Value, json};
use toml_edit::{DocumentMut, Item, TableLike};
use trueup_machine::{
    Machine, MachineFile,
    effect::Cause,
    machine_file::machine_file_keys::{
        Key, MACHINE_FILE_KEYS, Requirement, TERM, TERM_KEYS, ValueType,
    },
    schema,
};

const SHIPPED: [&str; 6] = [
    "data/gantry.toml",
    "data/paper_spindle.toml",
    "integrations/linuxcnc/trueup_gantry.toml",
    "integrations/linuxcnc/trueup_lathe.toml",
    "crates/bench/emulator/src/linuxcnc/base.toml",
    "host-tests/corpus/toml/all.toml",
];

fn project(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..").join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn the_reference_prints_the_tables_of_the_code() {
    let page = project("docs/reference.md");
    for (command, table) in [
        ("trueup schema --markdown", schema::machine_file_markdown()),
        ("trueup schema run --markdown", schema::run_columns_markdown()),
    ] {
        assert!(
            page.contains(table.trim_end()),
            "put what `{command}` prints into docs/reference.md"
        );
    }
}

/// Returns true if the value has a type of the schema's language.
fn is_of_type(value: &Value, name: &str) -> bool {
    match name {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "integer" => value.is_i64(),
        "number" => value.is_number(),
        "boolean" => value.is_boolean(),
        other => panic!("{other}"),
    }
}

/// Checks `value` by the part of the schema's language that this project's schema uses, and nothing else.
fn check(schema: &Value, value: &Value, at: &str) -> Result<(), String> {
    let fails = |why: &str| Err(format!("{at}: {value} {why}"));
    let all = |schemas: &Value| -> Vec<Result<(), String>> {
        let schemas = schemas.as_array().expect("an array of schemas");
        schemas.iter().map(|schema| check(schema, value, at)).collect()
    };
    let number = value.as_f64();
    let empty = Map::new();
    let fields = value.as_object().unwrap_or(&empty);
    let pattern = |pattern: &str, name: &str| {
        let (before, after) =
            pattern.trim_matches(['^', '$']).split_once(".+").expect("known form");
        name.strip_prefix(before)
            .and_then(|rest| rest.strip_suffix(after))
            .is_some_and(|middle| !middle.is_empty())
    };
    for (keyword, rule) in schema.as_object().expect("a schema") {
        match keyword.as_str() {
            "$schema" | "title" | "description" | "default" | "examples" | "then" => {}
            "type" => {
                if !is_of_type(value, rule.as_str().expect("a name")) {
                    return fails(&format!("is no {rule}"));
                }
            }
            "enum" if !rule.as_array().expect("choices").contains(value) => {
                return fails("is no choice");
            }
            "const" if value != rule => return fails("is another"),
            "minimum" if number < rule.as_f64() => return fails("is too small"),
            "maximum" if number > rule.as_f64() => return fails("is too large"),
            "exclusiveMinimum" if number <= rule.as_f64() => return fails("is too small"),
            "minItems" if value.as_array().map(Vec::len) < rule.as_u64().map(|n| n as usize) => {
                return fails("is too short");
            }
            "maxItems" if value.as_array().map(Vec::len) > rule.as_u64().map(|n| n as usize) => {
                return fails("is too long");
            }
            "enum" | "const" | "minimum" | "maximum" | "exclusiveMinimum" | "minItems"
            | "maxItems" => {}
            "pattern" if !pattern(rule.as_str().expect("text"), value.as_str().unwrap_or("")) => {
                return fails("has another form");
            }
            "pattern" => {}
            "items" => {
                for item in value.as_array().into_iter().flatten() {
                    check(rule, item, at)?;
                }
            }
            "anyOf" => {
                if all(rule).iter().all(Result::is_err) {
                    return fails("is none of them");
                }
            }
            "allOf" => all(rule).into_iter().collect::<Result<Vec<()>, _>>().map(drop)?,
            "if" => {
                if check(rule, value, at).is_ok() {
                    check(&schema["then"], value, at)?;
                }
            }
            "propertyNames" => {
                for name in fields.keys() {
                    check(rule, &json!(name), at)?;
                }
            }
            "required" => {
                for name in rule.as_array().expect("names") {
                    if !fields.contains_key(name.as_str().expect("a name")) {
                        return fails(&format!("lacks {name}"));
                    }
                }
            }
            "properties" | "patternProperties" | "additionalProperties" => {}
            other => panic!("{other} is not known here"),
        }
    }
    for (name, field) in fields {
        let at = format!("{at}.{name}");
        let own = schema["properties"].get(name);
        let patterns = schema["patternProperties"].as_object();
        let by_pattern = patterns
            .into_iter()
            .flatten()
            .find(|(candidate, _)| pattern(candidate, name))
            .map(|pattern| pattern.1);
        match own.or(by_pattern) {
            Some(rule) => check(rule, field, &at)?,
            None if schema["additionalProperties"] == false => {
                return Err(format!("{at} is unknown"));
            }
            None if schema["additionalProperties"].is_object() => {
                check(&schema["additionalProperties"], field, &at)?;
            }
            None => {}
        }
    }
    Ok(())
}

fn json_of(item: &Item) -> Value {
    fn of_table(table: &dyn TableLike) -> Value {
        table
            .iter()
            .map(|(key, item)| (key.to_string(), json_of(item)))
            .collect::<Map<_, _>>()
            .into()
    }
    fn of_value(value: &toml_edit::Value) -> Value {
        match value {
            toml_edit::Value::String(text) => json!(text.value()),
            toml_edit::Value::Integer(number) => json!(number.value()),
            toml_edit::Value::Float(number) => json!(number.value()),
            toml_edit::Value::Boolean(is) => json!(is.value()),
            toml_edit::Value::Datetime(time) => json!(time.value().to_string()),
            toml_edit::Value::Array(values) => values.iter().map(of_value).collect(),
            toml_edit::Value::InlineTable(table) => of_table(table),
        }
    }
    match item {
        Item::None => Value::Null,
        Item::Value(value) => of_value(value),
        Item::Table(table) => of_table(table),
        Item::ArrayOfTables(tables) => tables.iter().map(|table| of_table(table)).collect(),
    }
}

/// Whether the schema takes a machine file.
fn validates(text: &str) -> Result<(), String> {
    let document: DocumentMut = text.parse().expect("TOML");
    check(&schema::machine_file_schema(), &json_of(document.as_item()), "")
}

fn parse(text: &str) -> Result<Machine, trueup_machine::InputFileError> {
    MachineFile::parse(text, Path::new("m.toml"))
}

#[test]
fn every_shipped_file_is_in_the_schema_and_what_is_wrong_is_not() {
    for file in SHIPPED {
        let text = project(file);
        assert_eq!(validates(&text), Ok(()), "{file}");
        parse(&text).unwrap_or_else(|error| panic!("{file}: {error}"));
        for (right, wrong) in [
            ("kind = \"", "kind = \"x"),
            ("name = \"", "nam = \""),
            ("[limits]", "[limits]\nhold = 3"),
        ] {
            let wrong = text.replacen(right, wrong, 1);
            assert_ne!(wrong, text, "{file}");
            assert!(validates(&wrong).is_err() && parse(&wrong).is_err(), "{file}: {wrong}");
        }
    }
}

/// The lines of a section: the keys that must be there, and `more`.
fn lines(name: &str, keys: &[Key], more: &[(&str, &str)], text: &mut String) {
    text.push_str(&format!("[{name}]\n"));
    let is_more = |key: &Key| more.iter().any(|(name, _)| *name == key.name);
    for key in keys.iter().filter(|key| key.need == Requirement::Required && !is_more(key)) {
        if !matches!(key.form, ValueType::Table(_)) {
            text.push_str(&format!("{} = {}\n", key.name, key.example));
        }
    }
    for (key, value) in more {
        text.push_str(&format!("{key} = {value}\n"));
    }
    for key in keys.iter().filter(|key| key.need == Requirement::Required) {
        if let ValueType::Table(inner) = key.form {
            lines(&format!("{name}.{}", key.name), inner, &[], text);
        }
    }
}

/// Returns a file with this section, what it cannot be without, and `more` in it.
fn file_with(name: &str, keys: &[Key], more: &[(&str, &str)]) -> String {
    let mut text = String::new();
    let machine = MACHINE_FILE_KEYS.iter().find(|key| key.name == "machine").expect("the first");
    if let (ValueType::Table(machine), true) = (machine.form, name != "machine") {
        // What the errors of the volume cannot be without.
        let chain = match name {
            "rotary.b" => [("kind", "\"table-table\""), ("chain", "\"w C' B' b X Y Z t\"")],
            _ => [("kind", "\"table-table\""), ("chain", "\"w C' A' b X Y Z t\"")],
        };
        let of_volume = name.starts_with("angular") || name.starts_with("rotary");
        lines("machine", machine, if of_volume { &chain } else { &[] }, &mut text);
        if name != "inputs.sensor" {
            text.push_str(
                "[inputs.sensor]\nvolts_full_scale = 10\ncounts_full_scale = 4096\ndivider = 0.3\n",
            );
        }
        if name.ends_with(".dual") {
            let pitch = "[axis.x.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = [0]\n";
            text.push_str(pitch);
        }
    }
    let has = |name: &str| more.iter().any(|(key, _)| *key == name);
    let mut more = more.to_vec();
    let mut adjacent = |section: &str, key: &'static str, value: &'static str, without: &[&str]| {
        // Of the kind that was asked for there are none of them.
        if name == section && !has(key) && !without.iter().any(|key| has(key)) {
            more.push((key, value));
        }
    };
    adjacent("spindle.sensor", "zero_counts", "1", &["zero_v"]);
    adjacent("spindle.sensor", "um_per_count", "1", &["um_per_v"]);
    if name.starts_with("angular.") {
        adjacent(name, "urad_per_m", "1", &[]);
    }
    adjacent("axis.x.thermal", "reference_c", "20.0", &["table"]);
    adjacent("inputs.temp_<name>_c", "kind", "\"linear\"", &[]);
    // The line in volts where a key of it is asked for, else in counts.
    let in_volts = ["zero_v", "c_per_v"];
    adjacent("inputs.temp_<name>_c", "zero_counts", "1", &["kind", "zero_v", "c_per_v"]);
    adjacent("inputs.temp_<name>_c", "counts_per_c", "1", &["kind", "zero_v", "c_per_v"]);
    adjacent("inputs.temp_<name>_c", "counts_full_scale", "1", &["kind", "zero_v", "c_per_v"]);
    for key in in_volts.into_iter().filter(|_| in_volts.iter().any(|key| has(key))) {
        adjacent("inputs.temp_<name>_c", key, "1", &["kind"]);
    }
    if name == "spindle" {
        text.push_str("[spindle.sensor]\nk0_um = 0\nzero_counts = 1\num_per_count = 1\n");
    }
    if name == "axis.x.pitch" {
        more.iter_mut()
            .filter(|(key, _)| *key == "reverse_um")
            .for_each(|entry| entry.1 = "[0.5, 2.0, 2.5]");
    }
    if name == "machine" && has("head_axes") {
        more.push(("kind", "\"3-axis\""));
    }
    if name == "spindle.tools.<tool>" {
        text.push_str("[spindle.tools.default]\num_per_krpm2 = 0\n");
    }
    let tool = if has("number") { "a" } else { "7" };
    let name = name.replace("<name>", "a").replace("<condition>", "a").replace("<tool>", tool);
    lines(&name, keys, &more, &mut text);
    text
}

/// Calls `with` for each section of the file, with its name; one of several that are alike.
fn sections(keys: &'static [Key], name: &str, with: &mut dyn FnMut(&str, &'static [Key])) {
    for key in keys {
        if let ValueType::Table(inner) = key.form {
            let name =
                if name.is_empty() { key.name.into() } else { format!("{name}.{}", key.name) };
            let is_group = inner.iter().all(|key| matches!(key.form, ValueType::Table(_)));
            if !is_group {
                with(&name, inner);
            }
            if name != "axis.y" && name != "axis.z" {
                sections(inner, &name, with);
            }
        }
    }
}

#[test]
fn every_key_with_its_example_is_taken_by_the_reader_and_the_schema_and_an_unknown_one_is_not() {
    let mut tried = 0;
    sections(MACHINE_FILE_KEYS, "", &mut |name, keys| {
        for key in keys.iter().filter(|key| !matches!(key.form, ValueType::Table(_))) {
            // What a key alone contradicts is of a rule between keys, and of other tests.
            if (name == "axis.x.dual" && key.name == "across") || key.name == "order" {
                continue;
            }
            // The second drive's table has the keys of the first one's.
            if name.starts_with("straightness") || name == "axis.x.dual.pitch" {
                continue;
            }
            // An angle is a slope or a curve.
            if name.starts_with("angular.") && key.name != "urad_per_m" {
                continue;
            }
            let text = file_with(name, keys, &[(key.name, key.example)]);
            parse(&text).unwrap_or_else(|error| panic!("{name}.{}: {error}\n{text}", key.name));
            assert_eq!(validates(&text), Ok(()), "{text}");
            tried += 1;
        }
        if name == "axis.x.dual.pitch" {
            return;
        }
        let text = file_with(name, keys, &[("unheard_of", "1")]);
        let error = parse(&text).expect_err("an unknown key");
        assert!(error.rule.starts_with("unknown key "), "{error}");
        assert!(error.help.as_ref().is_some_and(|help| help.contains(keys[0].name)), "{error:?}");
        assert!(validates(&text).is_err(), "{text}");
    });
    assert!(tried > 60, "{tried}");
}

#[test]
fn a_default_is_what_the_reader_takes_without_the_key() {
    let mut tried = 0;
    sections(MACHINE_FILE_KEYS, "", &mut |name, keys| {
        for key in keys {
            let Requirement::Default(default) = key.need else { continue };
            let section = file_with(name, keys, &[]);
            let without = parse(&section).unwrap_or_else(|error| panic!("{error}\n{section}"));
            let with = parse(&file_with(name, keys, &[(key.name, default)]))
                .expect("the default is taken");
            let places = without.places.clone();
            assert_eq!(Machine { places, ..with }, without, "{name}.{} = {default}", key.name);
            tried += 1;
        }
    });
    assert!(tried >= 18, "{tried}");
}

#[test]
fn every_key_of_every_cause_is_described_and_no_other_is() {
    let mut used: Vec<&str> =
        Cause::ALL.iter().flat_map(|cause| schema::cause_keys(*cause)).collect();
    used.sort_unstable();
    used.dedup();
    let described: Vec<&str> = TERM_KEYS.iter().map(|key| key.name).collect();
    assert_eq!(
        used, described,
        "TERM_KEYS in crates/model/machine/src/keys/term.rs, by the alphabet"
    );
    assert_eq!(TERM.len(), 6);
}

#[test]
fn all_that_is_wrong_in_a_file_is_reported_at_once_in_the_order_of_its_lines() {
    let text = "[machine]\nname = \"m\"\nkind = \"4-axis\"\n\n[limits]\nslew_um_per_s = -1.0\nhold_ms = 2.5\n\
                slow = 3\n\n[axis.x.backlash]\nramp_mm = 0.1\n\n[[term]]\ncause = \"backlsh\"\nquantity = \"dx\"\n";
    let error = parse(text).expect_err("six things are wrong");
    let messages: Vec<String> = error.into_single_errors().map(|fault| fault.to_string()).collect();
    let expected = [
        "m.toml:3:8: machine.kind must be",
        "m.toml:6:17: limits.slew_um_per_s must be above 0, not -1",
        "m.toml:7:11: limits.hold_ms must be a whole number, not a float",
        "m.toml:8:1: unknown key limits.slow",
        "m.toml:10:9: axis.x.backlash.width_um is missing",
        "m.toml:14:9: term[0].cause \"backlsh\" is not known; did you mean backlash?",
    ];
    assert_eq!(messages.len(), expected.len(), "{messages:#?}");
    for (messages, expected) in messages.iter().zip(expected) {
        assert!(messages.starts_with(expected), "{messages} is not {expected}");
    }
    // Rules between keys, of two sections at once.
    let text = "[machine]\nname = \" \"\nkind = \"3-axis\"\n[spindle]\nsource = \"sensor\"\n";
    let error = parse(text).expect_err("two things are wrong");
    assert_eq!(error.others.len(), 1, "{error:?}");
}

#[test]
fn a_sensor_may_be_given_in_volts_as_its_data_sheet_does() {
    let sensor = |law: &str, inputs: &str| {
        parse(&format!(
            "[machine]\nname = \"m\"\nkind = \"3-axis\"\n{inputs}[spindle.sensor]\nk0_um = 0.0\n{law}\n"
        ))
    };
    let inputs = "[inputs]\nsensor = { volts_full_scale = 10, counts_full_scale = 27648, divider = 0.328 }\n";
    let model = sensor("zero_v = 1.5\num_per_v = 50.0", inputs).expect("right").spindle.sensor;
    let model = model.expect("a sensor");
    assert!((model.zero_counts - 1.5 * 2764.8).abs() < 1e-9);
    assert!((model.um_per_count * 27648.0 - 500.0).abs() < 1e-9);
    let mixed = sensor("zero_counts = 4000\num_per_v = 50.0", inputs).expect("each as it likes");
    assert_eq!(mixed.spindle.sensor.expect("a sensor").zero_counts, 4000.0);
    let both =
        sensor("zero_v = 1.5\nzero_counts = 4000\num_per_v = 50.0", inputs).expect_err("twice");
    assert!(both.to_string().contains("zero_v cannot be combined with zero_counts"), "{both}");
    let unknown = sensor("zero_v = 1.5\num_per_v = 50.0", "").expect_err("what is a count?");
    assert!(unknown.to_string().contains("needs [inputs] sensor"), "{unknown}");
}
