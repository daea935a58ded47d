//! Modules that the format check does not see.
//!
//! `rustfmt` follows the `mod` lines that it can read; a module that a macro declares is compiled, and its
//! file is neither formatted nor checked.

use std::collections::BTreeSet;

use super::source_file::{SourceFile, is_identifier_byte};

/// Returns the paths of the source files that no plain `mod` line declares.
pub(crate) fn find_undeclared_files(sources: &[SourceFile]) -> Vec<&str> {
    let paths: BTreeSet<&str> = sources.iter().map(|source| source.path.as_str()).collect();
    let declared = |source: &SourceFile| candidate_module_paths(&source.path, &source.text);
    let seen: BTreeSet<String> = sources.iter().flat_map(declared).collect();
    paths.into_iter().filter(|path| !is_crate_root(path) && !seen.contains(*path)).collect()
}

/// Returns the paths of the files that are compiled for tests alone: `#[cfg(test)] mod name;` declares them.
pub(crate) fn find_test_only_files(sources: &[SourceFile]) -> BTreeSet<String> {
    let of_tests = |source: &SourceFile| {
        &candidate_module_paths(&source.path, &source.text)
            - &candidate_module_paths(&source.path, &source.words)
    };
    sources.iter().flat_map(of_tests).collect()
}

/// Returns the paths at which the modules may be that the `text` of a file declares.
fn candidate_module_paths(path: &str, text: &str) -> BTreeSet<String> {
    let mut files = BTreeSet::new();
    for (name, attribute) in parse_module_declarations(text) {
        let below = match attribute {
            Some(attribute) => vec![format!("{}/{attribute}", parent_folder(path))],
            None => {
                let children = submodule_folder(path);
                vec![format!("{children}/{name}.rs"), format!("{children}/{name}/mod.rs")]
            }
        };
        files.extend(below.iter().map(|path| normalise_path(path)));
    }
    files
}

/// Returns true if cargo compiles the file without a `mod` line.
fn is_crate_root(path: &str) -> bool {
    let (folder, name) = path.rsplit_once('/').unwrap_or(("", path));
    let parent = folder.rsplit('/').next().unwrap_or_default();
    matches!(name, "main.rs" | "lib.rs" | "build.rs")
        || folder.is_empty()
        || matches!(parent, "bin" | "tests" | "examples" | "benches" | "fuzz_targets")
}

/// Returns the folder of the modules that a file declares.
fn submodule_folder(path: &str) -> String {
    let stem = path.strip_suffix(".rs").unwrap_or(path);
    let is_own = matches!(path.rsplit('/').next(), Some("mod.rs")) || is_crate_root(path);
    if is_own { parent_folder(path).to_owned() } else { stem.to_owned() }
}

fn parent_folder(path: &str) -> &str {
    path.rsplit_once('/').map_or(".", |(folder, _)| folder)
}

/// Resolves `..` and `.`.
fn normalise_path(path: &str) -> String {
    let mut parts = Vec::new();
    for part in path.split('/') {
        match part {
            "." => {}
            ".." => drop(parts.pop()),
            part => parts.push(part),
        }
    }
    parts.join("/")
}

/// Returns the names in lines `mod name;`, each with the path that an attribute above gives it.
fn parse_module_declarations(text: &str) -> Vec<(String, Option<String>)> {
    let mut found = Vec::new();
    let mut path = None;
    for line in text.lines().map(str::trim) {
        if let Some(rest) = line.strip_prefix("#[path = \"") {
            path = rest.split_once('"').map(|(path, _)| path.to_owned());
            continue;
        }
        let item = match line.strip_prefix("pub") {
            Some(rest) if rest.starts_with('(') => {
                rest.split_once(')').map_or("", |(_, rest)| rest).trim_start()
            }
            Some(rest) => rest.trim_start(),
            None => line,
        };
        if let Some(name) = item.strip_prefix("mod ").and_then(|rest| rest.strip_suffix(';'))
            && let name = name.trim_start_matches("r#")
            && name.bytes().all(is_identifier_byte)
        {
            found.push((name.to_owned(), path.take()));
        } else if !line.starts_with("#[") && !line.starts_with("//") {
            path = None;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_module_that_a_macro_declares_is_unseen() {
        let sources: Vec<_> = [
            (
                "crates/x/src/lib.rs",
                "pub mod a;\npub(crate) mod m;\n#[path = \"../o/p.rs\"]\nmod q;",
            ),
            ("crates/x/src/a.rs", "mod below;"),
            ("crates/x/src/a/below.rs", ""),
            ("crates/x/src/m/mod.rs", "causes! { hidden::Hidden \"h\", }\n$(mod $module;)*"),
            ("crates/x/src/m/hidden.rs", ""),
            ("crates/x/o/p.rs", ""),
            ("crates/x/tests/t.rs", "mod u;"),
            ("crates/x/tests/u/mod.rs", ""),
        ]
        .into_iter()
        .map(|(path, text)| SourceFile::new(path, text))
        .collect();
        assert_eq!(find_undeclared_files(&sources), ["crates/x/src/m/hidden.rs"]);
    }

    #[test]
    fn a_module_that_is_declared_for_tests_is_a_test_file() {
        let text = "mod code;\n#[cfg(test)]\nmod cuts;\n#[cfg(test)]\nmod tests { fn f() {} }";
        let sources = [SourceFile::new("crates/x/src/lib.rs", text)];
        let found = find_test_only_files(&sources);
        assert!(found.contains("crates/x/src/cuts.rs"), "{found:?}");
        assert!(!found.contains("crates/x/src/code.rs"), "{found:?}");
    }
}
