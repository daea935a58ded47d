//! Public items that nothing outside their crate names: they promise what is not needed, and the compiler cannot say whether
//! they are dead.
//!
//! An item is used if its name stands in a crate that depends on its own, in a test, example or program of its own crate,
//! in an example of its documentation, in a macro that other crates call or in the arguments of one that declares public
//! items; so is a type in the signature of a used item.
//! Two items of one name count as used together, so the count is a lower bound. Crates with a README are meant for users of
//! their own and are excluded, as are functions with a C interface.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    ops::Range,
    path::Path,
};

use anyhow::{Context as _, Result};

use super::source_file::{SourceFile, find_item_end, is_identifier_byte};

/// The kinds of items, and whether it is a type.
const ITEM_KINDS: &[(&str, bool)] = &[
    ("fn", false),
    ("const", false),
    ("static", false),
    ("mod", false),
    ("struct", true),
    ("enum", true),
    ("union", true),
    ("trait", true),
    ("type", true),
];

/// A crate of the project.
pub(crate) struct Package {
    /// Its name.
    name: String,
    /// Its folder from the project's root; empty for the root package.
    folder: String,
    /// The crates that it depends on, tests included.
    needs: BTreeSet<String>,
    /// Whether it has a README.
    is_for_others: bool,
}

/// The public items of crates.
pub(crate) struct PublicItemReport {
    /// How many there are.
    pub all: usize,
    /// Those that nothing outside their crate names, as `file:line name`.
    pub unused: Vec<String>,
}

/// Reads the manifests of all crates.
pub(crate) fn read_packages(root: &Path) -> Result<Vec<Package>> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.is_dir() && name != "target" && !name.starts_with('.') {
                folders.push(path);
            } else if name == "Cargo.toml" {
                let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
                let below = folder.strip_prefix(root).unwrap_or(&folder);
                let is_for_others =
                    !below.as_os_str().is_empty() && folder.join("README.md").is_file();
                found.extend(parse_package(&below.to_string_lossy(), &text, is_for_others));
            }
        }
    }
    Ok(found)
}

fn parse_package(folder: &str, manifest: &str, is_for_others: bool) -> Option<Package> {
    let mut section = "";
    let mut name = None;
    let mut needs = BTreeSet::new();
    for line in manifest.lines() {
        if line.starts_with('[') {
            section = line;
        } else if let Some((key, value)) = line.split_once('=') {
            let key = key.split('.').next().unwrap_or_default().trim();
            if section == "[package]" && key == "name" {
                name = Some(value.trim().trim_matches('"').to_owned());
            } else if section.ends_with("dependencies]") && !section.starts_with("[workspace") {
                needs.insert(key.to_owned());
            }
        }
    }
    Some(Package { name: name?, folder: folder.replace('\\', "/"), needs, is_for_others })
}

/// Finds the public items of libraries that nothing outside their crate names.
pub(crate) fn find_unused_items(sources: &[SourceFile], packages: &[Package]) -> PublicItemReport {
    let mut own: BTreeMap<&str, Vec<&SourceFile>> = BTreeMap::new();
    for source in sources {
        let holds = |package: &&Package| {
            package.folder.is_empty() || is_inside_folder(&source.path, &package.folder)
        };
        if let Some(package) =
            packages.iter().filter(holds).max_by_key(|package| package.folder.len())
        {
            own.entry(&package.name).or_default().push(source);
        }
    }
    let words: BTreeMap<&str, BTreeSet<String>> = own
        .iter()
        .map(|(name, files)| {
            let words = files
                .iter()
                .flat_map(|file| extract_identifiers(&file.code_with_tests()))
                .collect();
            (*name, words)
        })
        .collect();
    let mut found = PublicItemReport { all: 0, unused: Vec::new() };
    for package in packages {
        let library = format!("{}/src/lib.rs", package.folder);
        let files = own.get(package.name.as_str()).map_or(&[][..], |files| files.as_slice());
        if package.is_for_others || !files.iter().any(|file| file.path == library) {
            continue;
        }
        let mut used: BTreeSet<String> = BTreeSet::new();
        for user in transitive_dependants(&package.name, packages) {
            used.extend(words.get(user).into_iter().flatten().cloned());
        }
        let (library, others): (Vec<&SourceFile>, Vec<&SourceFile>) =
            files.iter().copied().partition(|file| is_library_source(&file.path, &package.folder));
        used.extend(others.iter().flat_map(|file| extract_identifiers(&file.code_with_tests())));
        used.extend(library.iter().flat_map(|file| collect_externally_used_names(file)));
        used.extend(library.iter().flat_map(|file| collect_macro_declared_names(file)));
        let items = library
            .iter()
            .filter(|file| !file.is_test_or_example())
            .flat_map(|file| public_items(file))
            .collect();
        add_unused_items(items, used, &mut found);
    }
    found.unused.sort();
    found
}

fn is_inside_folder(path: &str, folder: &str) -> bool {
    path.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/'))
}

fn is_library_source(path: &str, folder: &str) -> bool {
    let inside = path.get(folder.len() + 1..).unwrap_or_default();
    inside.starts_with("src/") && !inside.starts_with("src/bin/") && inside != "src/main.rs"
}

/// Returns the crates that need this one, also through others.
fn transitive_dependants<'a>(name: &'a str, packages: &'a [Package]) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::from([name]);
    loop {
        let before = found.len();
        for package in packages {
            if package.needs.iter().any(|need| found.contains(need.as_str())) {
                found.insert(&package.name);
            }
        }
        if found.len() == before {
            found.remove(name);
            return found;
        }
    }
}

fn extract_identifiers(code: &str) -> Vec<String> {
    let is_part = |character: char| character.is_alphanumeric() || character == '_';
    let words = code
        .split(move |character| !is_part(character))
        .filter(|identifier| !identifier.is_empty());
    words.map(str::to_owned).collect()
}

/// Returns the names in examples of the documentation, in macros that other crates call, and in the types that an
/// implementation of a trait names.
fn collect_externally_used_names(source: &SourceFile) -> Vec<String> {
    let mut found = Vec::new();
    let mut is_example = false;
    for line in source.text.lines() {
        let line = line.trim_start();
        if let Some(text) = line.strip_prefix("///").or_else(|| line.strip_prefix("//!")) {
            if text.trim_start().starts_with("```") {
                is_example = !is_example;
            } else if is_example {
                found.extend(extract_identifiers(text));
            }
            continue;
        }
        is_example = false;
        if line.contains("$crate") || line.starts_with("type ") {
            found.extend(extract_identifiers(line));
        }
    }
    found
}

/// Returns the names in the arguments of macros that declare public items, and next to `pub` in these macros.
fn collect_macro_declared_names(source: &SourceFile) -> Vec<String> {
    const MACRO_RULES: &str = "macro_rules! ";
    let code = &source.code;
    let mut found = Vec::new();
    for (at, _) in code.match_indices(MACRO_RULES) {
        let body = &code[at..find_item_end(code.as_bytes(), at)];
        let public: Vec<&str> = body.lines().filter(|line| line.contains("pub ")).collect();
        if public.is_empty() {
            continue;
        }
        found.extend(public.into_iter().flat_map(extract_identifiers));
        let call = format!(
            "{}!",
            extract_identifiers(&body[MACRO_RULES.len()..]).into_iter().next().unwrap_or_default()
        );
        let calls = code.match_indices(&call).map(|(at, _)| at);
        found.extend(
            calls.flat_map(|at| extract_identifiers(&code[at..find_item_end(code.as_bytes(), at)])),
        );
    }
    found
}

/// A public item.
struct PublicItem {
    name: String,
    place: String,
    is_type: bool,
    /// The names of what its users see of it.
    signature: BTreeSet<String>,
}

fn public_items(source: &SourceFile) -> Vec<PublicItem> {
    let code = &source.code;
    let private = find_private_module_ranges(code);
    let mut found = Vec::new();
    for (at, _) in code.match_indices("pub ") {
        let is_end_of_name =
            at.checked_sub(1).is_some_and(|before| is_identifier_byte(code.as_bytes()[before]));
        if is_end_of_name || private.iter().any(|range| range.contains(&at)) {
            continue;
        }
        // `pub const unsafe fn` is a function, `pub const A` a constant.
        let mut rest = code[at + 4..].trim_start();
        let mut kind = None;
        loop {
            let end = rest.bytes().take_while(|&byte| is_identifier_byte(byte)).count();
            let known = ITEM_KINDS.iter().find(|(kind, _)| *kind == &rest[..end]);
            if known.is_none() && !matches!(&rest[..end], "async" | "unsafe" | "mut") {
                break;
            }
            kind = known.or(kind);
            rest = rest[end..].trim_start();
        }
        let name: String =
            rest.bytes().take_while(|&byte| is_identifier_byte(byte)).map(char::from).collect();
        if let Some(&(kind, is_type)) = kind
            && !name.is_empty()
        {
            let line = code[..at].matches('\n').count() + 1;
            let signature = extract_identifiers(&extract_signature(kind, &rest[name.len()..]))
                .into_iter()
                .collect();
            found.push(PublicItem {
                name,
                place: format!("{}:{line}", source.path),
                is_type,
                signature,
            });
        }
    }
    found
}

/// Returns where the modules are that a file has in itself and for itself.
fn find_private_module_ranges(code: &str) -> Vec<Range<usize>> {
    let is_private =
        |at: usize| code[..at].rsplit('\n').next().is_some_and(|part| part.trim().is_empty());
    let starts = code.match_indices("mod ").map(|(at, _)| at).filter(|at| is_private(*at));
    starts.map(|at| at..find_item_end(code.as_bytes(), at)).collect()
}

/// Returns what the users of an item see of it, from behind its name.
fn extract_signature(kind: &str, rest: &str) -> String {
    let is_open = matches!(kind, "struct" | "enum" | "union" | "trait");
    let mut nested = 0usize;
    let end = rest.find(|character| {
        match character {
            '(' | '[' => nested += 1,
            ')' | ']' => nested = nested.saturating_sub(1),
            '{' if is_open => nested += 1,
            '}' if is_open => {
                nested = nested.saturating_sub(1);
                return nested == 0;
            }
            ';' | '{' if nested == 0 => return true,
            '=' if nested == 0 && matches!(kind, "const" | "static") => return true,
            _ => {}
        }
        false
    });
    let all = &rest[..end.unwrap_or(rest.len())];
    match kind {
        "mod" => String::new(),
        // Private fields are not seen.
        "struct" => all
            .split("pub ")
            .skip(1)
            .flat_map(|part| part.lines().next())
            .collect::<Vec<_>>()
            .join(" "),
        _ => all.to_owned(),
    }
}

fn add_unused_items(
    items: Vec<PublicItem>,
    mut used: BTreeSet<String>,
    found: &mut PublicItemReport,
) {
    let types: BTreeSet<&String> =
        items.iter().filter(|item| item.is_type).map(|item| &item.name).collect();
    loop {
        let before = used.len();
        for item in &items {
            if used.contains(&item.name) {
                used.extend(
                    item.signature.iter().filter(|type_name| types.contains(type_name)).cloned(),
                );
            }
        }
        if used.len() == before {
            break;
        }
    }
    found.all += items.len();
    let unused = items.iter().filter(|item| !used.contains(&item.name));
    found.unused.extend(unused.map(|item| format!("{} {}", item.place, item.name)));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unused(sources: &[(&str, &str)]) -> Vec<String> {
        let packages = [
            parse_package("crates/a", "[package]\nname = \"a\"\n[features]\nb = []", false),
            parse_package(
                "crates/b",
                "[package]\nname = \"b\"\n[dependencies]\na.workspace = true",
                false,
            ),
            parse_package(
                "crates/c",
                "[package]\nname = \"c\"\n[dev-dependencies]\nb = { path = \"b\" }",
                false,
            ),
            parse_package("crates/d", "[package]\nname = \"d\"", true),
        ];
        let packages: Vec<Package> = packages.into_iter().flatten().collect();
        let sources: Vec<SourceFile> =
            sources.iter().map(|(path, text)| SourceFile::new(*path, text)).collect();
        let found = find_unused_items(&sources, &packages).unused;
        let name = |text: &String| text.split(' ').next_back().unwrap_or_default().to_owned();
        let mut names: Vec<String> = found.iter().map(name).collect();
        names.sort();
        names
    }

    #[test]
    fn an_item_is_used_by_dependants_tests_and_examples_alone() {
        let library = "/// ```\n/// shown();\n/// ```\n/// not_shown();\npub fn shown() {}\npub fn not_shown() {}\n\
                       pub const fn by_b() {}\npub const BY_C: u8 = 1;\npub unsafe fn by_test() {}\npub mod by_none {}\n\
                       pub(crate) fn private() {}\nmod own { pub fn inside() {} }\npub fn by_d() {}\n#[cfg(test)]\nmod tests { pub fn test() { by_none(); } }";
        let found = unused(&[
            ("crates/a/src/lib.rs", library),
            ("crates/a/tests/it.rs", "fn t() { by_test(); }"),
            ("crates/b/src/lib.rs", "fn t() { by_b(); /* by_none() */ }"),
            ("crates/c/src/main.rs", "fn t() { a::BY_C; }"),
            ("crates/d/src/lib.rs", "pub fn d() { by_d(); }"),
        ]);
        assert_eq!(found, ["by_d", "by_none", "not_shown"]);
    }

    #[test]
    fn what_a_macro_declares_for_others_is_used() {
        let library = "macro_rules! declared {\n ($name:ident) => { pub use a::$name;\n pub const ALL: &[B] = &[]; }\n}\n\
                       declared! { A }\npub struct A;\npub struct B;\nmacro_rules! own { ($name:ident) => { $name } }\n\
                       own! { C }\npub struct C;";
        assert_eq!(unused(&[("crates/a/src/lib.rs", library)]), ["C"]);
    }

    #[test]
    fn a_type_is_used_in_the_signature_of_a_used_item() {
        let library = "pub fn used(a: [A; 2]) -> B { Hidden }\npub struct A { pub c: C,\n d: Private }\npub enum B { D(D) }\n\
                       pub struct C;\npub struct D(pub E);\npub type E = F;\npub trait F {}\npub struct Private;\n\
                       pub struct Hidden;\npub fn unused() -> Last {}\npub struct Last;";
        let found = unused(&[
            ("crates/a/src/lib.rs", library),
            ("crates/b/src/lib.rs", "fn t() { used(); }"),
        ]);
        assert_eq!(found, ["Hidden", "Last", "Private", "unused"]);
    }
}
