//! The thresholds of the finder: named numbers of its code that decide, and have a source in docs/thresholds.md.
//!
//! A number of the code that the table does not name is no threshold: a cap of work, a number of mathematics, the size of
//! a picture. A row of the table that names a number of the finder which its file does not have is stale.

use std::collections::BTreeSet;

use super::source_file::SourceFile;

/// The finder's code.
const DIAGNOSE_SOURCE_FOLDER: &str = "crates/analysis/diagnose/src/";
/// The column of the table that says where a number is: its name, then its file.
const LOCATION_COLUMN: usize = 3;

/// The named numbers of the finder.
pub(crate) struct ThresholdReport {
    /// `file:name` of those that decide.
    pub decide: BTreeSet<String>,
    /// How many others there are.
    pub others: usize,
    /// Rows of the table that lead nowhere, as line and name.
    pub stale: Vec<String>,
}

/// Counts the named numbers of `sources` that the `table` names, and the others.
pub(crate) fn count_thresholds(sources: &[SourceFile], table: &str) -> ThresholdReport {
    let is_finder = |file: &&SourceFile| {
        file.path.starts_with(DIAGNOSE_SOURCE_FOLDER) && !file.is_test_or_example()
    };
    let finder: Vec<&SourceFile> = sources.iter().filter(is_finder).collect();
    let mut found = ThresholdReport { decide: BTreeSet::new(), others: 0, stale: Vec::new() };
    let mut file = String::new();
    for (number, row) in table.lines().enumerate() {
        let Some(cell) = row.split('|').nth(LOCATION_COLUMN) else { continue };
        for (name, path) in parse_named_constants(cell, &mut file) {
            let end = format!("/{path}");
            let own = finder.iter().filter(|file| file.path.ends_with(&end));
            let (with, without): (Vec<&&SourceFile>, Vec<&&SourceFile>) =
                own.partition(|file| declared_constants(file).any(|constant| constant == name));
            found.decide.extend(with.iter().map(|file| format!("{}:{name}", file.path)));
            // A file of this name may be in another crate as well.
            let elsewhere = sources.iter().any(|source| {
                source.path.ends_with(&end)
                    && declared_constants(source).any(|constant| constant == name)
            });
            if with.is_empty() && !without.is_empty() && !elsewhere {
                found.stale.push(format!("docs/thresholds.md:{} {name}", number + 1));
            }
        }
    }
    let all: usize = finder.iter().map(|file| declared_constants(file).count()).sum();
    found.others = all.saturating_sub(found.decide.len());
    found
}

/// Returns the numbers that a cell names, each with its file; `file` is that of the cell before, which "the same file"
/// means.
fn parse_named_constants(cell: &str, file: &mut String) -> Vec<(String, String)> {
    let mut names = Vec::new();
    let mut all = Vec::new();
    for (n, word) in cell.split('`').enumerate() {
        let is_quoted = n % 2 == 1;
        if is_quoted && word.ends_with(".rs") {
            *file = word.to_owned();
        } else if is_quoted {
            names.extend(is_constant_name(word).then(|| word.to_owned()));
            continue;
        } else if !word.contains("same") {
            continue;
        }
        all.extend(names.drain(..).map(|name| (name, file.clone())));
    }
    all
}

fn is_constant_name(word: &str) -> bool {
    let of_name = |character: char| {
        character.is_ascii_uppercase() || character.is_ascii_digit() || character == '_'
    };
    word.starts_with(|character: char| character.is_ascii_uppercase()) && word.chars().all(of_name)
}

/// Returns the names of the numbers and lists of numbers that a file declares.
fn declared_constants(source: &SourceFile) -> impl Iterator<Item = &str> {
    source.code.lines().filter_map(|line| {
        let (before, rest) = line.split_once("const ")?;
        let (name, rest) = rest.split_once(": ")?;
        let (kind, _) = rest.split_once(" =")?;
        let kind = kind.trim_start_matches(['[', '(']).split([';', ',']).next().unwrap_or_default();
        let is_number = matches!(kind, "f64" | "usize" | "u8" | "u32" | "u64" | "i32");
        (before.trim_start().is_empty() || before.trim_start().starts_with("pub"))
            .then_some(name)
            .filter(|name| is_number && is_constant_name(name))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_of_the_table_is_a_threshold_and_one_that_is_gone_is_stale() {
        let code = "const A: f64 = 1.0;\npub(super) const B_2: [usize; 2] = [1, 2];\n    const CAP: usize = 9;\n\
                    const TEXT: &str = \"const C: f64 = 1\";\n// const D: f64 = 2.0;\n#[cfg(test)]\nconst E: f64 = 1.0;";
        let table = "| a | 1 | `A`, `diagnose/src/a.rs` | s | x |\n| b | 1 | `B_2`, the same file | s | x |\n\
                     | gone | 1 | `D`, `E`, the same file | s | x |\n| other | 1 | `F`, `fit/src/a.rs` | s | x |";
        let sources = [
            SourceFile::new("crates/analysis/diagnose/src/a.rs", code),
            SourceFile::new("crates/analysis/fit/src/a.rs", "const F: f64 = 1.0;"),
        ];
        let found = count_thresholds(&sources, table);
        let of = "crates/analysis/diagnose/src/a.rs";
        assert_eq!(
            found.decide.into_iter().collect::<Vec<_>>(),
            [format!("{of}:A"), format!("{of}:B_2")]
        );
        assert_eq!(found.others, 1);
        assert_eq!(found.stale, ["docs/thresholds.md:3 D", "docs/thresholds.md:3 E"]);
    }
}
