//! Names of types that have several meanings.

use std::collections::BTreeMap;

use super::{declared_names::find_declared_names_in_file, source_file::SourceFile};

/// Types of one name that a reader may have to tell apart.
const MAX_DEFINITIONS_PER_NAME: usize = 2;
/// The words that declare a type.
const TYPE_KEYWORDS: [&str; 5] = ["struct", "enum", "union", "trait", "type"];

/// Returns `name: number of definitions, their places` of each name with more than [`MAX_DEFINITIONS_PER_NAME`] outside tests,
/// those with the most first.
pub(super) fn find_ambiguous_names(sources: &[SourceFile]) -> Vec<String> {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for source in sources.iter().filter(|source| !source.is_test_or_example()) {
        for declared in find_declared_names_in_file(source) {
            // The associated types of a trait have the trait's meaning.
            let is_associated = declared.kind == "type" && declared.is_indented;
            if TYPE_KEYWORDS.contains(&declared.kind) && !is_associated {
                places.entry(declared.name).or_default().push(declared.place);
            }
        }
    }
    let mut found: Vec<_> =
        places.into_iter().filter(|(_, places)| places.len() > MAX_DEFINITIONS_PER_NAME).collect();
    found.sort_by_key(|(_, places)| std::cmp::Reverse(places.len()));
    let describe = |(name, places): (String, Vec<String>)| {
        format!("{name}: {}, {}", places.len(), places.join(", "))
    };
    found.into_iter().map(describe).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_types_of_one_name_are_ambiguous() {
        let file = |path: &str, text: &str| SourceFile::new(path, text);
        let sources = [
            file(
                "a.rs",
                "pub struct Record;\nenum Line {}\nimpl A for B {\n    type Error = u8;\n}\n",
            ),
            file(
                "b.rs",
                "pub(crate) enum Record {}\ntype Line = u8;\nimpl C {\n    type Error = u8;\n}\n",
            ),
            file("c.rs", "trait Record {}\ntype Error = u8;\nfn f(line: Line) {}\n"),
            file("tests/d.rs", "struct Line;\n"),
            file("e.rs", "#[cfg(test)]\nmod tests {\n    struct Line;\n}\ntype Record = u8;\n"),
        ];
        let found = find_ambiguous_names(&sources);
        assert_eq!(found, ["Record: 4, a.rs:1, b.rs:1, c.rs:1, e.rs:5"]);
    }
}
