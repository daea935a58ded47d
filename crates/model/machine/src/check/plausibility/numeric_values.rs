//! Every number of a machine by its key, from the writers of its sections, with the range that the key declares.

use crate::{
    effect::Cause,
    keys::{
        key::{Key, ValueType},
        plausible_range::{PlausibleRange, default_range_for_unit},
        section::{NewSection, Value},
        term::{TERM, TERM_KEYS},
    },
    machine_file::{Machine, machine_file_keys::MACHINE_FILE_KEYS},
};

/// A number of a machine file, or several of one key.
pub(super) struct NumericEntry {
    /// Its key as `Locations` has it: `term[0].um_per_c`.
    pub(super) key: String,
    /// Its unit; empty for a bare number, and for rows.
    pub(super) unit: &'static str,
    pub(super) range: Option<PlausibleRange>,
    pub(super) values: Vec<f64>,
}

/// The keys among which a name stands.
#[derive(Clone, Copy)]
pub(super) enum KeyScope {
    /// Those of a section, with the range of those that have none of their own.
    Section(&'static [Key], Option<PlausibleRange>),
    /// Those of a term of this cause.
    Term(Cause),
}

impl KeyScope {
    /// The machine file itself.
    pub(super) const FILE: Self = Self::Section(MACHINE_FILE_KEYS, None);

    /// Returns the key of this name.
    fn key(self, name: &str) -> Option<&'static Key> {
        match self {
            Self::Section(keys, _) => {
                let of_any_name = || keys.iter().find(|key| matches_name_pattern(key.name, name));
                keys.iter().find(|key| key.name == name).or_else(of_any_name)
            }
            Self::Term(_) => TERM.iter().chain(TERM_KEYS).find(|key| key.name == name),
        }
    }

    /// Returns the range of the numbers of a key: its own, else that of its section, else that of its unit.
    pub(super) fn key_range(self, key: &Key) -> Option<PlausibleRange> {
        let nearest = match self {
            Self::Section(_, of_section) => key.range.or(of_section),
            Self::Term(cause) => cause.range_override(key.name).or(key.range),
        };
        nearest.or_else(|| default_range_for_unit(key.unit))
    }

    /// Returns the keys of the section of this name.
    pub(super) fn section(self, name: &str) -> Option<Self> {
        let key = self.key(name)?;
        let ValueType::Table(keys) = key.form else { return None };
        let of_section = match self {
            Self::Section(_, of_section) => of_section,
            Self::Term(_) => None,
        };
        Some(Self::Section(keys, key.range.or(of_section)))
    }

    /// Returns a key by its names from here on, and its range.
    pub(super) fn find(self, dotted: &str) -> Option<(&'static Key, Option<PlausibleRange>)> {
        match dotted.split_once('.') {
            Some((section, rest)) => self.section(section)?.find(rest),
            None => self.key(dotted).map(|key| (key, self.key_range(key))),
        }
    }
}

/// Returns whether a key stands for any name, and this is one of them: `temp_<name>_c`, `<tool>`.
fn matches_name_pattern(pattern: &str, name: &str) -> bool {
    let (Some((before, _)), Some((_, after))) = (pattern.split_once('<'), pattern.split_once('>'))
    else {
        return false;
    };
    name.strip_prefix(before).is_some_and(|rest| rest.ends_with(after))
}

/// Returns the numbers of `machine`, those that came by default included.
pub(super) fn collect_numeric_entries(machine: &Machine) -> Vec<NumericEntry> {
    let mut entries = Vec::new();
    for section in machine.sections() {
        let name = section.name().to_string();
        let scope = name
            .split('.')
            .try_fold(KeyScope::FILE, |scope, name| scope.section(name))
            .expect("what is written is a section of the table of keys");
        collect_section_entries(&section, &name, scope, &mut entries);
    }
    for (index, term) in machine.terms.iter().enumerate() {
        let scope = KeyScope::Term(term.effect.cause());
        collect_section_entries(&term.to_section(), &format!("term[{index}]"), scope, &mut entries);
    }
    entries
}

fn collect_section_entries(
    section: &NewSection,
    name: &str,
    scope: KeyScope,
    entries: &mut Vec<NumericEntry>,
) {
    for (key, value) in section.key_values() {
        collect_value_entries(name, key, scope, value, entries);
    }
}

fn collect_value_entries(
    section: &str,
    name: &str,
    scope: KeyScope,
    value: &Value,
    entries: &mut Vec<NumericEntry>,
) {
    let path = format!("{section}.{name}");
    let values: Vec<f64> = match value {
        Value::Number(number) => vec![*number],
        Value::Whole(number) => vec![f64::from(*number)],
        Value::Numbers(numbers) => numbers.clone(),
        Value::Wholes(numbers) => numbers.iter().copied().map(f64::from).collect(),
        Value::Rows(rows) => rows.iter().flatten().copied().collect(),
        Value::Inline(inner) => {
            if let Some(scope) = scope.section(name) {
                for (name, value) in inner {
                    collect_value_entries(&path, name, scope, value, entries);
                }
            }
            return;
        }
        Value::Boolean(_) | Value::Text(_) | Value::Texts(_) => return,
    };
    if let Some(key) = scope.key(name) {
        let range = scope.key_range(key);
        // The numbers of a row have different units.
        let unit = if matches!(key.form, ValueType::Rows) { "" } else { key.unit };
        entries.push(NumericEntry { key: path, unit, range, values });
    }
}
