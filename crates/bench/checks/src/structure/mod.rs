//! The structure of the source, counted: circles of files and of modules, files and functions that are too long, dependencies on a
//! higher layer, places that name one cause of error outside its page, public items that nothing needs; and the language
//! of documents and names.
//!
//! A file that needs a file that needs the first cannot be read, tried or changed alone; a file of a
//! thousand lines is not read at all; and a cause that is written in thirty places is added in
//! twenty-nine. Each is counted here and red above its limit.

mod ambiguous_type_names;
mod cause_mentions;
mod closure_arguments;
mod crate_layers;
pub mod declared_names;
mod dependency_cycles;
mod forbidden_uses;
mod ignored_tests;
mod language;
mod long_functions;
mod module_cycles;
mod public_items;
mod source_file;
mod thresholds;
mod undeclared_modules;

use std::{collections::BTreeMap, fmt::Write as _, fs, path::Path};

use anyhow::{Result, ensure};

use language::{LanguageReport, MAX_OCCURRENCES_PER_10_000_WORDS, MIN_VERB_FIRST_DOC_PERCENT};
use source_file::SourceFile;

/// Lines that a source file may have, its tests included.
const MAX_FILE_LINES: usize = 500;

/// Files that are tables of data and may be longer.
const TABLE_FILES: &[&str] = &[];

/// The limit of each count.
struct CountLimits {
    /// Circles of files.
    circles: usize,
    /// Files above [`MAX_FILE_LINES`] lines.
    long_files: usize,
    /// Functions above [`long_functions::MAX_FUNCTION_LINES`] lines.
    long_functions: usize,
    /// Dependencies on a higher layer.
    arrows: usize,
    /// Uses of a name behind a wall.
    breaches: usize,
    /// Crates of no layer.
    strangers: usize,
    /// References that lead nowhere.
    nowhere: usize,
    /// Phrases that have a term of the trade.
    phrases: usize,
    /// Source files that are named and are not there.
    missing_files: usize,
    /// Tables that an empty line cuts.
    cut_tables: usize,
    /// Files that `rustfmt` does not see.
    unseen: usize,
    /// Ignored tests that are of no tier.
    without_tier: usize,
    /// Names of types with several meanings.
    ambiguous: usize,
    /// Closure arguments that do not say what they are.
    placeholders: usize,
    /// Public items that nothing outside their crate names.
    public: usize,
    /// Places that name the one cause that is named in most.
    places: usize,
    /// Numbers that decide in the finder.
    thresholds: usize,
    /// Rows of docs/thresholds.md that name one which is not there.
    stale: usize,
}

const COUNT_LIMITS: CountLimits = CountLimits {
    circles: 0,
    long_files: 0,
    long_functions: 0,
    arrows: 0,
    breaches: 0,
    strangers: 0,
    nowhere: 0,
    phrases: 0,
    missing_files: 0,
    cut_tables: 0,
    unseen: 0,
    without_tier: 0,
    ambiguous: 9,
    placeholders: 0,
    public: 0,
    places: 2,
    thresholds: 40,
    stale: 0,
};

/// Lines of code that the project aims at.
const TARGET_CODE_LINES: usize = 110_000;

/// How many files with the most counted words, and names with the most meanings, are listed.
const MAX_LISTED_ENTRIES: usize = 8;

/// What was found, as text, and the counts above their limit.
#[derive(Default)]
struct CountReport {
    text: String,
    over: Vec<String>,
}

impl CountReport {
    /// Writes the heading of a count.
    fn add_count(&mut self, what: &str, count: usize, limit: usize) -> Result<()> {
        writeln!(self.text, "{what}: {count} (at most {limit})")?;
        if count > limit {
            self.over.push(what.to_owned());
        }
        Ok(())
    }

    /// Writes a count with the places that it counts.
    fn add_count_with_places(&mut self, what: &str, places: &[String], limit: usize) -> Result<()> {
        self.add_count(what, places.len(), limit)?;
        for place in places {
            writeln!(self.text, "    {place}")?;
        }
        Ok(())
    }
}

/// Counts, and gives what was found as text, one count a heading and what it counts below.
///
/// # Errors
/// A count is above its limit (the error has the whole report), or a file cannot be read.
pub fn check_structure(root: &Path) -> Result<String> {
    let sources = source_file::read_sources(root)?;
    let circles = dependency_cycles::find_cycles(&sources);
    let long: Vec<&SourceFile> = sources
        .iter()
        .filter(|source| {
            source.line_count() > MAX_FILE_LINES && !TABLE_FILES.contains(&source.path.as_str())
        })
        .collect();
    let (cause, places) = cause_mentions::find_most_mentioned_cause(&sources);

    let mut report = CountReport::default();
    report.add_count("circles of files", circles.len(), COUNT_LIMITS.circles)?;
    for circle in &circles {
        writeln!(report.text, "    {}", circle.files.join(", "))?;
        for (from, to, line) in &circle.uses {
            writeln!(report.text, "        {from}:{line} -> {to}")?;
        }
    }
    write_module_cycles(&mut report, &sources)?;
    report.add_count(
        &format!("files above {MAX_FILE_LINES} lines"),
        long.len(),
        COUNT_LIMITS.long_files,
    )?;
    for source in &long {
        writeln!(report.text, "    {:5}  {}", source.line_count(), source.path)?;
    }
    let long = long_functions::find_long_functions(&sources);
    let what = format!("functions above {} lines", long_functions::MAX_FUNCTION_LINES);
    report.add_count(&what, long.len(), COUNT_LIMITS.long_functions)?;
    for it in &long {
        writeln!(report.text, "    {:5}  {} {}", it.lines, it.place, it.name)?;
    }
    let public = public_items::find_unused_items(&sources, &public_items::read_packages(root)?);
    let unseen = undeclared_modules::find_undeclared_files(&sources);
    let unseen = unseen.into_iter().map(str::to_owned).collect();
    let what = format!("public items that nothing outside their crate names, of {}", public.all);
    for (what, found, limit) in [
        ("arrows up", crate_layers::find_upward_dependencies(root)?, COUNT_LIMITS.arrows),
        (
            "names used behind a wall",
            forbidden_uses::find_forbidden_uses(&sources),
            COUNT_LIMITS.breaches,
        ),
        (
            "crates without a layer",
            crate_layers::find_crates_without_layer(root)?,
            COUNT_LIMITS.strangers,
        ),
        ("files that the format check does not see", unseen, COUNT_LIMITS.unseen),
        (
            "ignored tests whose reason and name are of no tier",
            ignored_tests::find_untiered_tests(&sources),
            COUNT_LIMITS.without_tier,
        ),
        (
            "closure arguments named `it`",
            closure_arguments::find_placeholder_arguments(&sources),
            COUNT_LIMITS.placeholders,
        ),
        (what.as_str(), public.unused, COUNT_LIMITS.public),
    ] {
        report.add_count_with_places(what, &found, limit)?;
    }
    let ambiguous = ambiguous_type_names::find_ambiguous_names(&sources);
    let what = "names of types with more than two definitions outside tests";
    report.add_count(what, ambiguous.len(), COUNT_LIMITS.ambiguous)?;
    for name in ambiguous.iter().take(MAX_LISTED_ENTRIES) {
        writeln!(report.text, "    {name}")?;
    }
    let what = format!("places that name {cause} outside its page, the list, the twin and tests");
    report.add_count_with_places(&what, &places, COUNT_LIMITS.places)?;
    let thresholds = thresholds::count_thresholds(
        &sources,
        &fs::read_to_string(root.join("docs/thresholds.md"))?,
    );
    let what =
        format!("thresholds of the finder (target: 40; and {} other numbers)", thresholds.others);
    report.add_count(&what, thresholds.decide.len(), COUNT_LIMITS.thresholds)?;
    let language = language::analyse_language(root, &sources)?;
    for (what, found, limit) in [
        ("references that lead nowhere", &language.nowhere, COUNT_LIMITS.nowhere),
        ("phrases that have a term of the trade", &language.phrases, COUNT_LIMITS.phrases),
        ("files that are named and not there", &language.missing_files, COUNT_LIMITS.missing_files),
        ("tables without a head", &language.cut_tables, COUNT_LIMITS.cut_tables),
        ("thresholds of the finder that are elsewhere", &thresholds.stale, COUNT_LIMITS.stale),
    ] {
        report.add_count_with_places(what, found, limit)?;
    }
    let CountReport { mut text, mut over } = report;
    write_line_counts_by_crate(&mut text, &sources)?;
    over.extend(write_language_report(&mut text, &language)?);
    ensure!(over.is_empty(), "{text}above the limit: {}", over.join(", "));
    Ok(text)
}

/// Writes how many lines are code, in all, by room (a folder of `crates`) and by crate.
fn write_line_counts_by_crate(text: &mut String, sources: &[SourceFile]) -> Result<()> {
    let tests = undeclared_modules::find_test_only_files(sources);
    let mut crates = BTreeMap::<(&str, &str), usize>::new();
    for source in sources.iter().filter(|source| !tests.contains(&source.path)) {
        let parts: Vec<&str> = source.path.splitn(4, '/').collect();
        let place = match parts[..] {
            ["crates", room, name, _] => (room, name),
            _ => ("root", parts[0]),
        };
        *crates.entry(place).or_default() += source.code_line_count();
    }
    let all: usize = crates.values().sum();
    writeln!(
        text,
        "lines of code without tests, comments and blank lines: {all} (target: {TARGET_CODE_LINES})"
    )?;
    writeln!(text, "lines of code by crate:")?;
    let crates: Vec<_> = crates.into_iter().filter(|&(_, lines)| lines > 0).collect();
    for room in crates.chunk_by(|(a, _), (b, _)| a.0 == b.0) {
        let in_room: usize = room.iter().map(|(_, lines)| lines).sum();
        writeln!(text, "    {in_room:6}  {}", room[0].0.0)?;
        for ((_, name), lines) in room {
            writeln!(text, "    {lines:6}      {name}")?;
        }
    }
    Ok(())
}

/// Writes which crates have modules in circles, and how many of them have more than they may.
fn write_module_cycles(report: &mut CountReport, sources: &[SourceFile]) -> Result<()> {
    let crates = module_cycles::find_module_cycles(sources);
    let above = crates.iter().filter(|found| found.is_above_limit()).count();
    report.add_count("crates with more modules in circles than they may have", above, 0)?;
    for line in crates.iter().flat_map(module_cycles::ModuleCycles::format_lines) {
        writeln!(report.text, "    {line}")?;
    }
    Ok(())
}

/// Writes how frequent the counted words are, and where most of them stand. Returns which of them are beyond their limit.
fn write_language_report(text: &mut String, language: &LanguageReport) -> Result<Vec<String>> {
    let mut over = Vec::new();
    writeln!(
        text,
        "words per 10,000 of {} (at most {MAX_OCCURRENCES_PER_10_000_WORDS} each)",
        language.words
    )?;
    for (what, count) in &language.counts {
        let frequency = language.per_10_000_words(*count);
        writeln!(text, "    {frequency:5.1}  {what}")?;
        if frequency > MAX_OCCURRENCES_PER_10_000_WORDS {
            over.push((*what).to_owned());
        }
    }
    let [all, with_verb] = language.functions;
    let share = 100.0 * with_verb as f64 / all.max(1) as f64;
    writeln!(
        text,
        "doc comments of functions that begin with a verb: {share:.0} % of {all} (at least {MIN_VERB_FIRST_DOC_PERCENT} %)"
    )?;
    if share < MIN_VERB_FIRST_DOC_PERCENT {
        over.push("doc comments of functions that begin with a verb, below their limit".to_owned());
    }
    writeln!(text, "most of these words:")?;
    for (file, count) in language.files.iter().take(MAX_LISTED_ENTRIES) {
        writeln!(text, "    {count:5}  {file}")?;
    }
    Ok(over)
}

#[cfg(test)]
mod tests {
    use anyhow::Context as _;

    use super::*;

    #[test]
    fn lines_are_counted_by_room_and_crate() -> Result<()> {
        let sources = [
            SourceFile::new(
                "crates/base/output/src/lib.rs",
                "fn a() {}\n\nfn b() {}\n#[cfg(test)]\nmod e;",
            ),
            SourceFile::new("crates/base/output/src/e.rs", "fn e() {}\n"),
            SourceFile::new("crates/base/output/tests/a.rs", "fn c() {}\n"),
            SourceFile::new("crates/base/numerics/src/lib.rs", "// d\nfn d() {}\n"),
            SourceFile::new("src/main.rs", "fn main() {}\n"),
        ];
        let mut text = String::new();
        write_line_counts_by_crate(&mut text, &sources)?;
        let (_, table) = text.split_once("by crate:\n").context("no table")?;
        let words: Vec<&str> = table.split_whitespace().collect();
        assert_eq!(words, ["3", "base", "1", "numerics", "2", "output", "1", "root", "1", "src"]);
        Ok(())
    }
}
