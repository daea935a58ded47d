//! The structure of the source, counted: circles of files, files and functions that are too long, dependencies on a
//! higher layer, places that name one cause of error outside its page, public items that nothing needs; and the language
//! of documents.
//!
//! A file that needs a file that needs the first cannot be read, tried or changed alone; a file of a
//! thousand lines is not read at all; and a cause that is written in thirty places is added in
//! twenty-nine. Each is counted here and red above its limit.

mod causes;
mod circles;
mod functions;
mod ignored;
mod language;
mod layers;
mod modules;
pub mod names;
mod public;
mod source;
mod thresholds;

use std::{fmt::Write as _, fs, path::Path};

use anyhow::{Result, ensure};

use source::SourceFile;

/// Lines that a source file may have, its tests included.
const LONGEST: usize = 500;

/// Files that are tables of data and may be longer.
const TABLES: &[&str] = &[];

/// The limit of each count.
struct Limits {
    /// Circles of files.
    circles: usize,
    /// Files above [`LONGEST`] lines.
    long_files: usize,
    /// Functions above [`functions::LONGEST`] lines.
    long_functions: usize,
    /// Dependencies on a higher layer.
    arrows: usize,
    /// Crates of no layer.
    strangers: usize,
    /// References that lead nowhere.
    nowhere: usize,
    /// Tables that an empty line cuts.
    cut_tables: usize,
    /// Files that `rustfmt` does not see.
    unseen: usize,
    /// Ignored tests that are of no tier.
    without_tier: usize,
    /// Public items that nothing outside their crate names.
    public: usize,
    /// Places that name the one cause that is named in most.
    places: usize,
    /// Numbers that decide in the finder.
    thresholds: usize,
    /// Rows of docs/thresholds.md that name one which is not there.
    stale: usize,
}

const LIMITS: Limits = Limits {
    circles: 0,
    long_files: 0,
    long_functions: 0,
    arrows: 0,
    strangers: 0,
    nowhere: 0,
    cut_tables: 0,
    unseen: 0,
    without_tier: 0,
    public: 0,
    places: 2,
    thresholds: 64,
    stale: 0,
};

/// Lines of code that the project aims at.
const CODE: usize = 110_000;

/// How many files with the most counted words are named.
const NAMED_FILES: usize = 8;

/// Counts, and gives what was found as text, one count a heading and what it counts below.
///
/// # Errors
/// A count is above its limit (the error has the whole report), or a file cannot be read.
pub fn check(root: &Path) -> Result<String> {
    let sources = source::all(root)?;
    let circles = circles::find(&sources);
    let long: Vec<&SourceFile> = sources
        .iter()
        .filter(|source| source.lines() > LONGEST && !TABLES.contains(&source.path.as_str()))
        .collect();
    let (cause, places) = causes::most_often_named(&sources);

    let mut text = String::new();
    let mut over = Vec::new();
    let mut head = |text: &mut String, what: &str, count: usize, limit: usize| {
        writeln!(text, "{what}: {count} (at most {limit})")?;
        if count > limit {
            over.push(what.to_owned());
        }
        anyhow::Ok(())
    };
    head(&mut text, "circles of files", circles.len(), LIMITS.circles)?;
    for circle in &circles {
        writeln!(text, "    {}", circle.files.join(", "))?;
        for (from, to, line) in &circle.uses {
            writeln!(text, "        {from}:{line} -> {to}")?;
        }
    }
    head(&mut text, &format!("files above {LONGEST} lines"), long.len(), LIMITS.long_files)?;
    for source in &long {
        writeln!(text, "    {:5}  {}", source.lines(), source.path)?;
    }
    let long = functions::long(&sources);
    let what = format!("functions above {} lines", functions::LONGEST);
    head(&mut text, &what, long.len(), LIMITS.long_functions)?;
    for it in &long {
        writeln!(text, "    {:5}  {} {}", it.lines, it.place, it.name)?;
    }
    let public = public::find(&sources, &public::packages(root)?);
    let what = format!("public items that nothing outside their crate names, of {}", public.all);
    for (what, found, limit) in [
        ("arrows up", layers::arrows_up(root)?, LIMITS.arrows),
        ("crates without a layer", layers::without_layer(root)?, LIMITS.strangers),
        (
            "files that the format check does not see",
            modules::unseen(&sources).into_iter().map(str::to_owned).collect(),
            LIMITS.unseen,
        ),
        (
            "ignored tests whose reason and name are of no tier",
            ignored::without_tier(&sources),
            LIMITS.without_tier,
        ),
        (what.as_str(), public.unused, LIMITS.public),
    ] {
        head(&mut text, what, found.len(), limit)?;
        for place in &found {
            writeln!(text, "    {place}")?;
        }
    }
    let what = format!("places that name {cause} outside its page, the list, the twin and tests");
    head(&mut text, &what, places.len(), LIMITS.places)?;
    for place in &places {
        writeln!(text, "    {place}")?;
    }
    let thresholds =
        thresholds::count(&sources, &fs::read_to_string(root.join("docs/thresholds.md"))?);
    let what =
        format!("thresholds of the finder (target: 40; and {} other numbers)", thresholds.others);
    head(&mut text, &what, thresholds.decide.len(), LIMITS.thresholds)?;
    let language = language::count(root, &sources)?;
    for (what, found, limit) in [
        ("references that lead nowhere", &language.nowhere, LIMITS.nowhere),
        ("tables without a head", &language.cut_tables, LIMITS.cut_tables),
        ("thresholds of the finder that are elsewhere", &thresholds.stale, LIMITS.stale),
    ] {
        head(&mut text, what, found.len(), limit)?;
        for place in found {
            writeln!(text, "    {place}")?;
        }
    }
    let lines: usize = sources.iter().map(SourceFile::lines_of_code).sum();
    writeln!(
        text,
        "lines of code without tests, comments and blank lines: {lines} (target: {CODE})"
    )?;
    writeln!(text, "words per 10,000 of {} (target: 2 at most each)", language.words)?;
    for (what, count) in &language.counts {
        writeln!(text, "    {:5.1}  {what}", language.frequency(*count))?;
    }
    let [all, with_verb] = language.functions;
    let share = 100.0 * with_verb as f64 / all.max(1) as f64;
    writeln!(
        text,
        "doc comments of functions that begin with a verb: {share:.0} % of {all} (target: 60 %)"
    )?;
    writeln!(text, "most of these words:")?;
    for (file, count) in language.files.iter().take(NAMED_FILES) {
        writeln!(text, "    {count:5}  {file}")?;
    }
    ensure!(over.is_empty(), "{text}above the limit: {}", over.join(", "));
    Ok(text)
}
