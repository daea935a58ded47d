//! Circles of files: each needs the next, and the last the first.
//!
//! A file needs another if a path in its code (`crate::…`, `super::…`, `self::…`, or one that begins
//! with a module that it declares) leads there; through a name that a file only passes on
//! (`pub use a::Name`) to where the name is. A module's file and the files of its folder are one place
//! to the reader, so a path from one of these up to the module that holds it is not a need of its own.
//! The root of a crate declares everything and is in no circle.

use std::collections::{BTreeMap, BTreeSet};

use super::source_file::{SourceFile, is_identifier_byte};

/// Files that need each other.
pub(crate) struct DependencyCycle {
    /// Their paths from the project's root.
    pub files: Vec<String>,
    /// Who needs whom: from, to, and the line.
    pub uses: Vec<(String, String, usize)>,
}

/// A path of names in code, and the byte where it stands.
struct ItemPath {
    names: Vec<String>,
    at: usize,
    /// Whether it belongs to a `use`.
    declared: bool,
}

/// The modules of one crate.
pub(super) struct CrateModules<'s> {
    /// By module path, the root's being empty.
    modules: BTreeMap<Vec<String>, &'s SourceFile>,
    /// The names that a module passes on under its own path: name to path.
    passed_on: BTreeMap<Vec<String>, BTreeMap<String, Vec<String>>>,
}

/// Returns all circles of all crates, in the order of their first files.
pub(crate) fn find_cycles(sources: &[SourceFile]) -> Vec<DependencyCycle> {
    group_modules_by_crate(sources).values().flat_map(CrateModules::find_cycles).collect()
}

/// Returns the modules of each crate by its folder; files of tests are excluded.
pub(super) fn group_modules_by_crate(sources: &[SourceFile]) -> BTreeMap<&str, CrateModules<'_>> {
    let mut crates: BTreeMap<&str, BTreeMap<Vec<String>, &SourceFile>> = BTreeMap::new();
    for source in sources.iter().filter(|source| !source.is_test_or_example()) {
        if let Some((package, module)) = crate_and_module_path(&source.path) {
            crates.entry(package).or_default().insert(module, source);
        }
    }
    crates.into_iter().map(|(package, modules)| (package, CrateModules::new(modules))).collect()
}

/// Returns the folder of a file's crate, and its module path there.
fn crate_and_module_path(path: &str) -> Option<(&str, Vec<String>)> {
    let (package, file) = match path.strip_prefix("src/") {
        Some(file) => ("", file),
        None => path.split_once("/src/")?,
    };
    // Each of these is a program of its own.
    if file.starts_with("bin/") {
        return None;
    }
    let mut names: Vec<String> = file.strip_suffix(".rs")?.split('/').map(Into::into).collect();
    if names.last().is_some_and(|name| name == "mod") || matches!(file, "lib.rs" | "main.rs") {
        names.pop();
    }
    Some((package, names))
}

impl<'s> CrateModules<'s> {
    fn new(modules: BTreeMap<Vec<String>, &'s SourceFile>) -> Self {
        let mut house = Self { modules, passed_on: BTreeMap::new() };
        let modules: Vec<_> =
            house.modules.iter().map(|(name, source)| (name.clone(), *source)).collect();
        for (module, source) in modules {
            let mut names = BTreeMap::new();
            for path in parse_paths(&source.code).into_iter().filter(|path| path.declared) {
                if let (Some(name), Some(full)) =
                    (path.names.last(), house.resolve_path(&module, &path.names))
                {
                    names.insert(name.clone(), full);
                }
            }
            house.passed_on.insert(module, names);
        }
        house
    }

    /// Returns a path from the root of the crate, if it leads into the crate.
    fn resolve_path(&self, module: &[String], names: &[String]) -> Option<Vec<String>> {
        let mut here = module.to_vec();
        let mut rest = names;
        match names.first()?.as_str() {
            "crate" => {
                here.clear();
                rest = &rest[1..];
            }
            "self" => rest = &rest[1..],
            "super" => {
                while rest.first().is_some_and(|name| name == "super") {
                    here.pop()?;
                    rest = &rest[1..];
                }
            }
            child => {
                here.push(child.into());
                if !self.modules.contains_key(&here) {
                    return None;
                }
                here.pop();
            }
        }
        here.extend_from_slice(rest);
        Some(here)
    }

    /// Returns the module in which a path ends; names that are only passed on are followed.
    fn resolve_reexports(&self, full: &[String]) -> Vec<String> {
        let mut full = full.to_vec();
        // A module that passes on its own name would lead nowhere.
        for _ in 0..8 {
            let module = (0..=full.len())
                .rev()
                .map(|length| &full[..length])
                .find(|module| self.modules.contains_key(*module))
                .unwrap_or_default()
                .to_vec();
            let next =
                full.get(module.len()).and_then(|name| self.passed_on.get(&module)?.get(name));
            match next {
                Some(next) if *next != full => {
                    let rest = full[module.len() + 1..].to_vec();
                    full = [next.clone(), rest].concat();
                }
                _ => return module,
            }
        }
        full
    }

    /// Returns what each module needs, and on which line it first says so.
    pub(super) fn module_dependencies(
        &self,
    ) -> BTreeMap<Vec<String>, BTreeMap<Vec<String>, usize>> {
        let mut needs: BTreeMap<_, BTreeMap<_, _>> = BTreeMap::new();
        for (module, source) in &self.modules {
            for path in parse_paths(&source.code) {
                let Some(full) = self.resolve_path(module, &path.names) else { continue };
                let target = self.resolve_reexports(&full);
                let known = self.modules.contains_key(&target);
                if known && !target.is_empty() && target != *module && !module.starts_with(&target)
                {
                    let line = source.code[..path.at].lines().count();
                    needs.entry(module.clone()).or_default().entry(target).or_insert(line);
                }
            }
        }
        needs
    }

    /// Returns the path of a module's file from the project's root.
    pub(super) fn file_path(&self, module: &[String]) -> &str {
        self.modules.get(module).map_or("", |source| &source.path)
    }

    fn find_cycles(&self) -> Vec<DependencyCycle> {
        let needs = self.module_dependencies();
        let reachable: BTreeMap<_, _> = self
            .modules
            .keys()
            .map(|module| (module, transitive_dependencies(module, &needs)))
            .collect();
        let mut reported = BTreeSet::new();
        let mut circles = Vec::new();
        for module in self.modules.keys() {
            let members: Vec<_> = reachable[module]
                .iter()
                .filter(|other| reachable[other].contains(module))
                .collect();
            if members.is_empty() || !reported.insert(members.clone()) {
                continue;
            }
            let path = |module: &Vec<String>| self.modules[module].path.clone();
            let uses = members.iter().flat_map(|from| {
                let to = needs.get(*from).into_iter().flatten();
                to.filter(|(to, _)| members.contains(to))
                    .map(|(to, line)| (path(from), path(to), *line))
            });
            circles.push(DependencyCycle {
                uses: uses.collect(),
                files: members.iter().map(|member| path(member)).collect(),
            });
        }
        circles
    }
}

/// Returns all modules that one needs, directly or through others.
fn transitive_dependencies(
    from: &[String],
    needs: &BTreeMap<Vec<String>, BTreeMap<Vec<String>, usize>>,
) -> BTreeSet<Vec<String>> {
    let mut reached = BTreeSet::new();
    let mut open = vec![from.to_vec()];
    while let Some(module) = open.pop() {
        for next in needs.get(&module).into_iter().flat_map(BTreeMap::keys) {
            if reached.insert(next.clone()) {
                open.push(next.clone());
            }
        }
    }
    reached
}

/// Returns all paths of two or more names in a file's code; a group in braces is a path for each member.
fn parse_paths(code: &str) -> Vec<ItemPath> {
    let bytes = code.as_bytes();
    let mut paths = Vec::new();
    let mut at = 0;
    let mut in_use = false;
    while at < bytes.len() {
        if !is_identifier_byte(bytes[at]) {
            in_use &= bytes[at] != b';';
            at += 1;
            continue;
        }
        let follows_a_path = code[..at].trim_end().ends_with("::");
        let name = &code[at..at + identifier_length(&bytes[at..])];
        if name == "use" {
            in_use = true;
        } else if !follows_a_path {
            let start = paths.len();
            let end = parse_path_group(code, at, &[], at, &mut paths);
            if in_use {
                paths[start..].iter_mut().for_each(|path: &mut ItemPath| path.declared = true);
            }
            at = end.max(at + 1);
            continue;
        }
        at += name.len();
    }
    paths.retain(|path| path.names.len() > 1);
    paths
}

fn identifier_length(bytes: &[u8]) -> usize {
    bytes.iter().take_while(|&&byte| is_identifier_byte(byte)).count()
}

fn skip_whitespace(bytes: &[u8], mut at: usize) -> usize {
    while bytes.get(at).is_some_and(u8::is_ascii_whitespace) {
        at += 1;
    }
    at
}

/// Reads the path that begins at a byte, behind others, and gives where it ends.
fn parse_path_group(
    code: &str,
    from: usize,
    before: &[String],
    first: usize,
    paths: &mut Vec<ItemPath>,
) -> usize {
    let bytes = code.as_bytes();
    let mut names = before.to_vec();
    let mut at = from;
    loop {
        let length = identifier_length(&bytes[at..]);
        if length > 0 {
            names.push(code[at..at + length].to_owned());
            at += length;
        } else if bytes.get(at) == Some(&b'{') && !names.is_empty() {
            at = skip_whitespace(bytes, at + 1);
            while at < bytes.len() && bytes[at] != b'}' {
                let end = parse_path_group(code, at, &names, at, paths);
                at = skip_whitespace(bytes, end.max(at + 1));
                if bytes.get(at) == Some(&b',') {
                    at = skip_whitespace(bytes, at + 1);
                }
            }
            return at + 1;
        }
        let next = skip_whitespace(bytes, at);
        if bytes[next.min(bytes.len())..].starts_with(b"::") {
            at = skip_whitespace(bytes, next + 2);
            // Generic arguments and a star end what can be followed.
            if bytes.get(at).is_some_and(|&byte| is_identifier_byte(byte) || byte == b'{') {
                continue;
            }
        }
        break;
    }
    // `self` at the end of a group is the module before it.
    if names.len() > 1 && names.last().is_some_and(|name| name == "self") {
        names.pop();
    }
    paths.push(ItemPath { names, at: first, declared: false });
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circles(files: &[(&str, &str)]) -> Vec<Vec<String>> {
        let sources: Vec<_> =
            files.iter().map(|(path, text)| SourceFile::new(*path, text)).collect();
        find_cycles(&sources).into_iter().map(|circle| circle.files).collect()
    }

    #[test]
    fn a_path_is_followed_through_groups_and_names_that_are_passed_on() {
        let found = circles(&[
            ("crates/x/src/lib.rs", "mod a; mod b; mod c; pub use b::B;"),
            ("crates/x/src/a.rs", "use crate::{c::{self, C}, B};"),
            ("crates/x/src/b.rs", "fn f() { crate::c::g() }"),
            ("crates/x/src/c.rs", "use super::a::A;"),
            ("crates/y/src/lib.rs", "mod a; mod b;"),
            ("crates/y/src/a.rs", "use crate::b::B; // crate::c"),
            ("crates/y/src/b.rs", "#[cfg(test)] mod tests { use crate::a::A; }"),
        ]);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0], ["crates/x/src/a.rs", "crates/x/src/b.rs", "crates/x/src/c.rs"]);
    }

    #[test]
    fn a_module_and_its_own_files_are_one_place_but_two_of_its_files_are_two() {
        let parent = ("crates/x/src/m/mod.rs", "mod p; mod q; use p::P;");
        let below = [parent, ("crates/x/src/m/p.rs", "use super::M;")];
        assert!(circles(&below).is_empty());
        let adjacent = [
            parent,
            ("crates/x/src/m/p.rs", "use super::q::Q;"),
            ("crates/x/src/m/q.rs", "use super::p::P;"),
        ];
        assert_eq!(circles(&adjacent), [["crates/x/src/m/p.rs", "crates/x/src/m/q.rs"]]);
    }
}
