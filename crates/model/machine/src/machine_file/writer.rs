//! Writes machine files: whole, or what changes in the user's.
//!
//! In the user's file the keys of the section that is written are replaced, added or taken away, and
//! nothing else changes: order, blanks, comments (those next to the keys that are replaced as well),
//! byte order mark and line ends are the user's. It makes no difference whether the user wrote the
//! section under a header, with dotted keys, or as an inline table.
//!
//! A number is written in the fewest digits that read back to the same `f64`. Where digits beyond
//! the precision of the measurement would only be in the way, as in long tables, a fit rounds first
//! ([`round_to_decimals`]) and judges the rounded numbers.
//!
//! A user's file that was written into is read by [`MachineFile::parse`] before it is handed out.

mod toml_layout;

use std::path::Path;

use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, TableLike};

use super::MachineFile;
use crate::location::{InputFileError, Location};

pub use crate::keys::section::{NewSection, Value, round_to_decimals};

/// The changes in a machine file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MachineFileEdit {
    /// Sections to replace or to add.
    pub sections: Vec<NewSection>,
    /// Sections or keys to take away, by their dotted names, because they contradict the new ones:
    /// `axis.x.backlash` next to a new reverse table. A name that is not there is no error.
    pub removed: Vec<String>,
    /// Keys to write only where the user has not: section, key, value.
    pub defaults: Vec<(String, &'static str, Value)>,
    /// Tables to write in the place of those of an array of tables, by its name (`term`) and their
    /// numbers in it, from 0. A number that is not there is no error.
    pub replaced: Vec<(usize, NewSection)>,
    /// Tables to add at the end of an array of tables, by its name: `term`.
    pub appended: Vec<NewSection>,
}

impl MachineFileEdit {
    /// Returns an edit of one section.
    #[must_use]
    pub fn from_section(section: NewSection) -> Self {
        Self { sections: vec![section], ..Self::default() }
    }

    /// Returns whether there is nothing to write.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.sections.is_empty() && self.replaced.is_empty() && self.appended.is_empty()
    }

    /// Returns what is written, alone, as TOML; what a machine file may need next to it is stated in comments.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut document = DocumentMut::new();
        self.write_sections(document.as_table_mut());
        // The blank line before the first section.
        let mut text = document.to_string().trim_start().to_string();
        for (section, key, value) in &self.defaults {
            text.push_str(&format!("\n# A machine file that uses it has in [{section}]:\n"));
            text.push_str(&format!("# {key} = {}\n", toml_layout::to_toml_value(value)));
        }
        for name in &self.removed {
            text.push_str(&format!("\n# A machine file must not have [{name}] as well.\n"));
        }
        text
    }

    /// `source`, the content of the machine file at `path`, with this edit.
    ///
    /// # Errors
    /// `source` is no machine file, or would not be one with the edit: the rule names the place in
    /// what would have been written.
    pub fn apply(&self, source: &str, path: &Path) -> Result<String, InputFileError> {
        // Also refuses what toml_edit could only call invalid, with a place and a better rule.
        MachineFile::parse(source, path)?;
        let (mark, unmarked) = match source.strip_prefix('\u{feff}') {
            Some(rest) => ("\u{feff}", rest),
            None => ("", source),
        };
        let windows = unmarked.contains("\r\n");
        let mut document: DocumentMut =
            unmarked.replace("\r\n", "\n").parse().map_err(|error| {
                InputFileError::new(
                    Location::start_of_file(path),
                    format!("cannot be edited: {error}"),
                )
            })?;
        for name in &self.removed {
            remove_table(document.as_table_mut(), name);
        }
        self.write_sections(document.as_table_mut());
        for (section, key, value) in &self.defaults {
            let names: Vec<&str> = section.split('.').collect();
            if let Some(table) =
                toml_layout::find_or_insert_table(document.as_table_mut(), &names, &[])
                && !table.contains_key(key)
            {
                toml_layout::set_key(table, key, value, None);
            }
        }
        let mut text = document.to_string();
        if windows {
            text = text.replace('\n', "\r\n");
        }
        let text = format!("{mark}{text}");
        MachineFile::parse(&text, path).map_err(|mut error| {
            error.rule = format!("with what is to be written: {}", error.rule);
            error
        })?;
        Ok(text)
    }

    fn write_sections(&self, root: &mut Table) {
        for section in &self.sections {
            write_section(root, section);
        }
        for (index, section) in &self.replaced {
            replace_table(root, *index, section);
        }
        for section in &self.appended {
            append_table(root, section);
        }
    }
}

fn write_section(root: &mut Table, section: &NewSection) {
    let names: Vec<&str> = section.name().split('.').collect();
    if let Some(table) = toml_layout::find_or_insert_table(root, &names, section.header_comments())
    {
        replace_keys(table, section);
    }
}

/// Writes the table of this number in the array of tables of the section's name anew.
fn replace_table(root: &mut Table, index: usize, section: &NewSection) {
    let table: Option<&mut dyn TableLike> = match root.get_mut(section.name()) {
        Some(Item::ArrayOfTables(tables)) => tables.get_mut(index).map(|table| table as _),
        // The user has written the array inline.
        Some(Item::Value(toml_edit::Value::Array(array))) => {
            let table = array.get_mut(index).and_then(toml_edit::Value::as_inline_table_mut);
            table.map(|table| table as _)
        }
        _ => None,
    };
    if let Some(table) = table {
        replace_keys(table, section);
    }
}

/// The keys of `section` in the place of those of `table`.
fn replace_keys(table: &mut dyn TableLike, section: &NewSection) {
    let stale: Vec<String> = table
        .iter()
        .map(|(key, _)| key.to_string())
        .filter(|key| !section.is_preserved(key))
        .filter(|key| section.value(key).is_none())
        .collect();
    for key in stale {
        table.remove(&key);
    }
    fill_table(table, section);
}

/// Adds the table at the end of the array of tables of its name.
fn append_table(root: &mut Table, section: &NewSection) {
    let item =
        root.entry(section.name()).or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new()));
    match item {
        Item::ArrayOfTables(tables) => {
            let mut table = toml_layout::new_table(section.header_comments());
            if tables.is_empty() {
                // Where the user's tables are not in the order of their sections, the end is still
                // behind all of them.
                table.set_position(Some(isize::MAX));
            }
            fill_table(&mut table, section);
            tables.push(table);
        }
        // The user has written the array inline.
        Item::Value(toml_edit::Value::Array(array)) => {
            let mut table = toml_edit::InlineTable::new();
            fill_table(&mut table, section);
            array.push(table);
        }
        // No machine file has anything else there.
        _ => {}
    }
}

fn fill_table(table: &mut dyn TableLike, section: &NewSection) {
    for entry in section.entries() {
        toml_layout::set_key(table, &entry.key, &entry.value, entry.note.as_deref());
    }
}

fn remove_table(root: &mut Table, name: &str) {
    let names: Vec<&str> = name.split('.').collect();
    let Some((last, parents)) = names.split_last() else { return };
    let mut table: &mut dyn TableLike = root;
    for name in parents {
        match table.get_mut(name).and_then(Item::as_table_like_mut) {
            Some(inner) => table = inner,
            None => return,
        }
    }
    table.remove(last);
}

#[cfg(test)]
mod tests;
