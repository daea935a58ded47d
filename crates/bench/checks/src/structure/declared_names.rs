//! Names of the project drawn at random, for a reader who judges whether each is the field's term.

use anyhow::{Result, ensure};
use rand::{SeedableRng as _, seq::IndexedRandom as _};
use rand_chacha::ChaCha8Rng;

use super::source_file::{SourceFile, is_identifier_byte};

/// The words that declare an item.
const ITEM_KEYWORDS: [&str; 9] =
    ["fn", "struct", "enum", "union", "trait", "type", "const", "static", "mod"];

/// A name with the place where it is declared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeclaredName {
    /// The word that declares it.
    pub kind: &'static str,
    /// The name.
    pub name: String,
    /// `file:line`.
    pub place: String,
    /// True if it is declared inside another item.
    pub is_indented: bool,
}

/// Returns the names of all items that are not there for tests, in the order of their places.
fn collect_declared_names(sources: &[SourceFile]) -> Vec<DeclaredName> {
    sources
        .iter()
        .filter(|source| !source.is_test_or_example())
        .flat_map(find_declared_names_in_file)
        .collect()
}

pub(super) fn find_declared_names_in_file(source: &SourceFile) -> Vec<DeclaredName> {
    let mut found = Vec::new();
    let mut is_of_a_test = false;
    for (line, text) in source.code.lines().enumerate() {
        match text.trim() {
            "#[test]" => is_of_a_test = true,
            it if it.is_empty() || it.starts_with("#[") => continue,
            _ if std::mem::take(&mut is_of_a_test) => continue,
            _ => {}
        }
        let words: Vec<&str> = text
            .split(|character: char| !is_identifier_char(character))
            .filter(|identifier| !identifier.is_empty() && *identifier != "mut")
            .collect();
        let declared = words.windows(2).find_map(|pair| {
            let kind = ITEM_KEYWORDS.into_iter().find(|kind| *kind == pair[0])?;
            // `const fn`, and `_`.
            (!ITEM_KEYWORDS.contains(&pair[1]) && pair[1].chars().any(char::is_alphabetic))
                .then(|| (kind, pair[1].to_owned()))
        });
        let is_item = declared.as_ref().is_some_and(|(kind, name)| {
            let found = text.find(&format!("{kind} {name}"));
            found.or_else(|| text.find(&format!("{kind} mut {name}"))).is_some_and(|at| {
                let before = &text[..at];
                before.split_whitespace().all(is_modifier)
            })
        });
        if let Some((kind, name)) = declared.filter(|_| is_item) {
            found.push(DeclaredName {
                kind,
                name,
                place: format!("{}:{}", source.path, line + 1),
                is_indented: text.starts_with(' '),
            });
        }
    }
    found
}

fn is_identifier_char(letter: char) -> bool {
    u8::try_from(letter).is_ok_and(is_identifier_byte)
}

/// Returns whether a word may stand before the one that declares an item.
fn is_modifier(word: &str) -> bool {
    word.starts_with("pub")
        || word.ends_with(')')
        || ["const", "unsafe", "async", "extern", "in"].contains(&word)
        || word.starts_with('"')
}

/// Draws `count` different names of a folder's source with this seed. Returns them and how many there are.
///
/// # Errors
/// A file cannot be read, or there are fewer names.
pub fn draw_names(
    root: &std::path::Path,
    count: usize,
    seed: u64,
) -> Result<(Vec<DeclaredName>, usize)> {
    let mut names = collect_declared_names(&super::source_file::read_sources(root)?);
    names.sort_by(|a, b| a.name.cmp(&b.name));
    names.dedup_by(|a, b| a.name == b.name);
    ensure!(count <= names.len(), "there are {} names", names.len());
    let of = names.len();
    let drawn = names.choose_multiple(&mut ChaCha8Rng::seed_from_u64(seed), count);
    Ok((drawn.cloned().collect(), of))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_are_names_and_uses_are_not() {
        let text = "pub(crate) const fn lag() {}\nstruct Heat;\nlet x: *const u8 = f;\n\
                    use std::fn_name;\n// fn comment() {}\n#[cfg(test)]\nmod tests { fn of_test() {} }\n\
                    const _: () = ();\n#[test]\nfn it_is() {}\n    pub fn step(&self) {}\nstatic TABLE: [u8; 2] = [0; 2];\n\
                    static mut COUNT: u8 = 0;\n";
        let found: Vec<_> = find_declared_names_in_file(&SourceFile::new("x.rs", text))
            .into_iter()
            .map(|name| (name.kind, name.name, name.place))
            .collect();
        let expected = [
            ("fn", "lag", "x.rs:1"),
            ("struct", "Heat", "x.rs:2"),
            ("fn", "step", "x.rs:11"),
            ("static", "TABLE", "x.rs:12"),
            ("static", "COUNT", "x.rs:13"),
        ];
        let expected: Vec<_> =
            expected.map(|(kind, name, place)| (kind, name.to_owned(), place.to_owned())).into();
        assert_eq!(found, expected);
    }

    #[test]
    fn a_seed_draws_the_same_names_again() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
        let (first, of) = draw_names(root, 60, 7).expect("there are 60 names");
        assert_eq!(draw_names(root, 60, 7).expect("the same").0, first);
        assert_ne!(draw_names(root, 60, 8).expect("others").0, first);
        let mut names: Vec<_> = first.iter().map(|name| &name.name).collect();
        names.sort();
        names.dedup();
        assert!(names.len() == 60 && of > 60);
    }
}
