//! Circles of modules: the folders directly below a crate's `src`, each with the file of its name.
//!
//! Without a circle of files there may still be one of modules: a file of `a` needs one of `b`, and another file of `b` one
//! of `a`. Then neither module can be read, moved or replaced without the other, and the crate has no layers.
//! What counts is how many modules are in circles, not how many circles there are, as two circles that grow together are one.

use std::collections::{BTreeMap, BTreeSet};

use super::{
    dependency_cycles::{CrateModules, group_modules_by_crate},
    source_file::SourceFile,
};

/// The crates that may have modules in circles, and how many. No other may have any.
const MAX_MODULES_IN_CYCLES_BY_CRATE: &[(&str, usize)] =
    &[("crates/analysis/diagnose", 2), ("crates/board/core", 2), ("crates/board/link", 3)];

/// The modules of one crate that need each other.
pub(super) struct ModuleCycles {
    /// The folder of the crate.
    package: String,
    /// Those in circles, in the order of their names.
    modules: BTreeSet<String>,
    /// Who needs whom inside of a circle: `file:line -> file`.
    uses: Vec<String>,
}

impl ModuleCycles {
    /// Returns whether more modules are in circles than the crate may have.
    pub(super) fn is_above_limit(&self) -> bool {
        self.modules.len() > self.max_modules_in_cycles()
    }

    fn max_modules_in_cycles(&self) -> usize {
        let allowed =
            MAX_MODULES_IN_CYCLES_BY_CRATE.iter().find(|(package, _)| *package == self.package);
        allowed.map_or(0, |(_, limit)| *limit)
    }

    /// Returns `crate: modules`, and below it each use if the crate is above its limit.
    pub(super) fn format_lines(&self) -> Vec<String> {
        let modules: Vec<&str> = self.modules.iter().map(String::as_str).collect();
        let (count, limit) = (modules.len(), self.max_modules_in_cycles());
        let mut lines =
            vec![format!("{}: {count} (at most {limit}): {}", self.package, modules.join(", "))];
        if self.is_above_limit() {
            lines.extend(self.uses.iter().map(|line| format!("    {line}")));
        }
        lines
    }
}

/// Returns the crates that have modules in circles.
pub(super) fn find_module_cycles(sources: &[SourceFile]) -> Vec<ModuleCycles> {
    let crates = group_modules_by_crate(sources).into_iter();
    crates.filter_map(|(package, modules)| find_cycles_in_crate(package, &modules)).collect()
}

fn find_cycles_in_crate(package: &str, files: &CrateModules<'_>) -> Option<ModuleCycles> {
    let file_needs = files.module_dependencies();
    let mut needs: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (from, targets) in &file_needs {
        for to in targets.keys() {
            if let (Some(from), Some(to)) = (from.first(), to.first())
                && from != to
            {
                needs.entry(from).or_default().insert(to);
            }
        }
    }
    let reached: BTreeMap<&str, BTreeSet<&str>> =
        needs.keys().map(|&module| (module, transitive_dependencies(module, &needs))).collect();
    let need_each_other = |from: &str, to: &str| {
        reached.get(from).is_some_and(|reached| reached.contains(to))
            && reached.get(to).is_some_and(|reached| reached.contains(from))
    };
    let modules: BTreeSet<String> = needs
        .keys()
        .filter(|&&module| need_each_other(module, module))
        .map(|&module| module.to_owned())
        .collect();
    if modules.is_empty() {
        return None;
    }
    let mut uses = Vec::new();
    for (from, targets) in &file_needs {
        for (to, line) in targets {
            if let (Some(first), Some(second)) = (from.first(), to.first())
                && first != second
                && need_each_other(first, second)
            {
                uses.push(format!("{}:{line} -> {}", files.file_path(from), files.file_path(to)));
            }
        }
    }
    Some(ModuleCycles { package: package.to_owned(), modules, uses })
}

/// Returns all modules that one needs, directly or through others.
fn transitive_dependencies<'m>(
    from: &'m str,
    needs: &BTreeMap<&'m str, BTreeSet<&'m str>>,
) -> BTreeSet<&'m str> {
    let mut reached = BTreeSet::new();
    let mut open = vec![from];
    while let Some(module) = open.pop() {
        for &next in needs.get(module).into_iter().flatten() {
            if reached.insert(next) {
                open.push(next);
            }
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycles(files: &[(&str, &str)]) -> Vec<ModuleCycles> {
        let sources: Vec<_> =
            files.iter().map(|(path, text)| SourceFile::new(*path, text)).collect();
        find_module_cycles(&sources)
    }

    const ROOT: (&str, &str) = ("crates/x/src/lib.rs", "mod a; mod b; mod c; pub use b::B;");

    #[test]
    fn modules_need_each_other_where_no_two_files_do() {
        let found = cycles(&[
            ROOT,
            ("crates/x/src/a.rs", "mod low; mod high;"),
            ("crates/x/src/a/low.rs", ""),
            ("crates/x/src/a/high.rs", "use crate::B;"),
            ("crates/x/src/b.rs", "use crate::a::low::Low;"),
            ("crates/x/src/c.rs", "use crate::{a::high::High, b::B};"),
        ]);
        assert_eq!(found.len(), 1);
        assert!(found[0].is_above_limit());
        let lines = [
            "crates/x: 2 (at most 0): a, b",
            "    crates/x/src/a/high.rs:1 -> crates/x/src/b.rs",
            "    crates/x/src/b.rs:1 -> crates/x/src/a/low.rs",
        ];
        assert_eq!(found[0].format_lines(), lines);
    }

    #[test]
    fn one_direction_and_files_of_one_module_are_no_circle() {
        let found = cycles(&[
            ROOT,
            ("crates/x/src/a.rs", "mod low; mod high; use crate::b::B;"),
            ("crates/x/src/a/low.rs", "use super::high::High;"),
            ("crates/x/src/a/high.rs", "use super::low::Low;"),
            ("crates/x/src/b.rs", "use crate::c::C; #[cfg(test)] mod tests { use crate::a::A; }"),
            ("crates/x/src/c.rs", "fn f() {}"),
        ]);
        assert!(found.is_empty());
    }

    #[test]
    fn a_crate_may_have_as_many_as_are_listed_and_no_more() {
        let (package, limit) = MAX_MODULES_IN_CYCLES_BY_CRATE[0];
        let with = |count: usize| {
            let names = ["a", "b", "c", "d"];
            let names = &names[..count];
            let next = names.iter().cycle().skip(1);
            let files: Vec<(String, String)> = names
                .iter()
                .zip(next)
                .map(|(name, next)| {
                    (format!("{package}/src/{name}.rs"), format!("use crate::{next}::{next}_item;"))
                })
                .collect();
            let files: Vec<_> = files.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
            cycles(&files).remove(0)
        };
        assert!(!with(limit).is_above_limit());
        assert_eq!(with(limit).format_lines().len(), 1);
        assert!(with(limit + 1).is_above_limit());
    }
}
