//! The file held against the table of keys: everything that is unknown, missing, of the wrong type or
//! outside its range, all of it at once.

use std::{collections::BTreeSet, path::Path};

use super::term;
use crate::{
    effect::Cause,
    keys::{
        key::{Key, Requirement, ValueType},
        reader::{Section, TomlDocument, is_temperature_column},
        term::{TERM, TERM_KEYS},
    },
    location::InputFileError,
    sections::inputs::is_condition,
};

/// Returns what is wrong with the keys of `section`, in no order.
pub(super) fn find_key_errors(section: &Section<'_>, keys: &[Key]) -> Vec<InputFileError> {
    let mut faults = find_value_errors(section, keys);
    // A misspelt key would be reported as a missing one too.
    if section.keys().iter().any(|name| !keys.iter().any(|key| matches_key(section, key, name))) {
        return faults;
    }
    let there: BTreeSet<&str> = section.keys().into_iter().collect();
    for key in keys.iter().filter(|key| key.need == Requirement::Required) {
        if !there.contains(key.name) {
            faults.extend(
                section.required::<()>(key.name, None).err().map(|fault| add_key_help(fault, key)),
            );
        }
    }
    faults
}

/// Returns what is wrong with what stands in `section`, whatever is missing.
fn find_value_errors(section: &Section<'_>, keys: &[Key]) -> Vec<InputFileError> {
    let mut faults = Vec::new();
    let names: Vec<&str> = keys.iter().map(|key| key.name).collect();
    for name in section.keys() {
        match keys.iter().find(|key| matches_key(section, key, name)) {
            Some(key) => push_value_errors(section, name, key, &mut faults),
            None => faults.push(unknown_key_error(section, name, &names)),
        }
    }
    faults
}

/// Returns what is wrong with a `[[term]]`, in no order. Which keys its cause needs is known by its page alone, which
/// stops at the first that is missing: it reads the term again with the example of that key, and so on.
pub(super) fn find_term_errors(section: &Section<'_>) -> Vec<InputFileError> {
    let all = [TERM, TERM_KEYS].concat();
    let cause = section.text("cause").ok().flatten().and_then(Cause::from_name);
    let Some(cause) = cause else {
        let mut faults = find_key_errors(section, &all);
        // One that is there and is text, but is none.
        if faults.iter().all(|fault| fault.place != section.location("cause")) {
            faults.extend(term::read(section).err());
        }
        return faults;
    };
    let names = cause.keys(section);
    let is_one =
        |key: &&Key| names.contains(&key.name) || TERM.iter().any(|common| common.name == key.name);
    let keys: Vec<Key> = all.iter().filter(is_one).copied().collect();
    let mut faults = find_key_errors(section, &keys);
    // A misspelt key would be reported as a missing one too; a wrong value hides the rules that go by it.
    if !find_value_errors(section, &keys).is_empty() {
        return faults;
    }
    let examples = keys.iter().map(|key| format!("{} = {}\n", key.name, key.example));
    let examples = examples.collect::<String>();
    let Ok(examples) = TomlDocument::parse(&examples, Path::new("")) else { return faults };
    let mut added: Vec<&str> = Vec::new();
    loop {
        let read = section
            .read_with_keys_from(&examples.root(), &added, |section| cause.read(section).map(drop));
        let Err(error) = read else { return faults };
        let is_missing = |key: &&Key| {
            !added.contains(&key.name)
                && section.required::<()>(key.name, None).is_err_and(|missing| missing == error)
        };
        let Some(key) = keys.iter().find(is_missing) else {
            // A rule of the page next to an example says nothing of what is there.
            faults.extend(Some(error).filter(|_| added.is_empty()));
            return faults;
        };
        faults.push(add_key_help(error, key));
        added.push(key.name);
    }
}

/// With what `key` is, and an example of it.
fn add_key_help(error: InputFileError, key: &Key) -> InputFileError {
    error.with_help(append_example(format!("{}: {}", key.name, key.meaning), key))
}

fn unknown_key_error(section: &Section<'_>, name: &str, names: &[&str]) -> InputFileError {
    let mut error = section.unknown_key_error(name, names.iter().copied());
    if names.contains(&"temp_<name>_c") {
        error.rule.push_str(
            "; the inputs are sensor, temp_<name>_c, and any name with kind = \"condition\"",
        );
    }
    error.with_help(format!("the keys here are {}", names.join(", ")))
}

/// Returns whether `name` in `section` is this key. A condition may have any name, and is known by its kind; so may a
/// tool.
fn matches_key(section: &Section<'_>, key: &Key, name: &str) -> bool {
    match key.name {
        "<condition>" => {
            section.section(name).ok().flatten().is_some_and(|section| is_condition(&section))
        }
        "<tool>" => name != "default",
        pattern if pattern.contains('<') => is_temperature_column(name),
        exact => exact == name,
    }
}

fn append_example(help: String, key: &Key) -> String {
    match key.example {
        "" => help,
        example => format!("{help}, as in {} = {example}", key.name),
    }
}

fn push_value_errors(
    section: &Section<'_>,
    name: &str,
    key: &Key,
    faults: &mut Vec<InputFileError>,
) {
    let result = match key.form {
        ValueType::Text => section.text(name).map(drop),
        ValueType::Boolean => section.boolean(name).map(drop),
        ValueType::Column => section.temperature_column(name).map(drop),
        ValueType::Choice(choices) => {
            let choices: Vec<(&str, ())> = choices.iter().map(|choice| (*choice, ())).collect();
            section.choice(name, &choices).map(drop)
        }
        ValueType::Choices(_) => section.strings(name).map(drop),
        ValueType::Number => section.number(name).map(drop),
        ValueType::Positive => section.positive_number(name).map(drop),
        ValueType::NotNegative => section.non_negative_number(name).map(drop),
        // The order of a spline has a rule of its own, with the reason.
        ValueType::Whole(..) if name == "order" => section.integer(name, 0, u32::MAX).map(drop),
        ValueType::Whole(least, most) => section.integer(name, least, most).map(drop),
        ValueType::Numbers => section.numbers(name).map(drop),
        ValueType::NumberOrNumbers => section.number_or_numbers(name).map(drop),
        ValueType::Vector => section.vector(name).map(drop),
        ValueType::Rows => section.rows(name).map(drop),
        ValueType::Terms => section.sections(name).map(drop),
        ValueType::Table(keys) => section.section(name).map(|inner| {
            faults.extend(inner.iter().flat_map(|inner| self::find_key_errors(inner, keys)));
        }),
    };
    let unit = if key.unit.is_empty() { String::new() } else { format!(" ({})", key.unit) };
    let help = append_example(format!("{}{unit}: {}", key.name, key.meaning), key);
    faults.extend(result.err().map(|error| error.with_help(help)));
}
