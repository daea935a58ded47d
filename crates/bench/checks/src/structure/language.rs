//! The language of documents and doc comments, counted: words that a reader from outside stumbles over, and doc comments
//! of functions that do not say what the function does.
//!
//! Read are the pages (`.md`) but for the list of changes, and the doc comments of all Rust files; not text in backticks
//! and not blocks of code.

use std::{fs, path::Path};

use anyhow::{Context as _, Result};

use super::source_file::SourceFile;

/// Counted words of one kind that 10,000 words may have.
pub(super) const MAX_OCCURRENCES_PER_10_000_WORDS: f64 = 2.0;
/// Doc comments of functions that begin with a verb, of a hundred.
pub(super) const MIN_VERB_FIRST_DOC_PERCENT: f64 = 60.0;

/// Words whose frequency is printed: the heading, and the forms in lower case.
const COUNTED_WORDS: &[(&str, &[&str])] = &[
    ("told, tell", &["told", "tell", "tells", "telling"]),
    ("so much, so many", &["so much", "so many"]),
    ("beside", &["beside"]),
    ("nobody, somebody, whoever", &["nobody", "somebody", "whoever"]),
    ("hear", &["hear", "hears", "heard", "hearing"]),
];

/// Phrases that have a term of the trade: none may be in a page or a comment.
const REPLACED_PHRASES: &[(&str, &str)] = &[
    ("set aside", "excluded as outliers"),
    ("foresee", "predict"),
    ("foresees", "predicts"),
    ("foreseen", "predicted"),
    ("the machine file as it is", "the current machine file"),
    ("nothing was fitted to", "not used for the fit"),
    ("does not hold nothing", "excludes zero"),
    ("nobody here has made", "recorded by others"),
    ("told apart", "separated"),
    ("tells apart", "separates"),
    ("left-out", "held-out"),
    ("so many as", "a number, or until"),
];

/// Words and phrases that have a term of the trade: none may be in a text in quotes, which is a message.
const REPLACED_MESSAGE_PHRASES: &[(&str, &str)] = &[
    ("told", "reported, sent, separated"),
    ("tell", "show, separate, report"),
    ("tells", "shows, separates, reports"),
    ("hear", "receive"),
    ("hears", "receives"),
    ("heard", "received, sending"),
    ("wanted", "requested, target"),
    ("left out", "held out, skipped, omitted"),
    ("left-out", "held-out"),
    ("set aside", "excluded, excluded as outliers"),
    ("beside", "next to, together with, in addition to"),
    ("nobody", "no …, not"),
    ("somebody", "a user, another"),
    ("whoever", "anyone who"),
    ("so many as", "a number, or until"),
    ("goes with", "depends on, is correlated with"),
    ("comes and goes", "is periodic"),
    ("foresee", "predict"),
    ("foresees", "predicts"),
    ("foreseen", "predicted"),
    ("not said yes", "did not confirm"),
];

/// References that lead nowhere, and names of the workplace: none of them may be in the project.
const FORBIDDEN_REFERENCES: &[&str] =
    &["the issue's", "interfaces.md", "language.md", "design.md", "seed 00", "shared/seeds"];

/// Verbs that a doc comment of a function may begin with are these endings' third person; words with the ending that
/// are none:
const NON_VERBS: &[&str] = &[
    "This",
    "Its",
    "As",
    "Is",
    "Has",
    "Whether",
    "Always",
    "Others",
    "Micrometres",
    "Metres",
    "Nanometres",
    "Units",
    "Rows",
    "Values",
    "Columns",
    "Bytes",
    "Lines",
    "Words",
    "Names",
    "Keys",
    "Files",
    "Errors",
    "Less",
    "Means",
    "Seconds",
    "Milliseconds",
    "Degrees",
    "Counts",
    "Readings",
    "Terms",
    "Parts",
    "Ticks",
    "Frames",
    "Steps",
    "Numbers",
    "Two's",
    "Causes",
    "Runs",
    "Perhaps",
];

/// What was counted.
#[derive(Default)]
pub(crate) struct LanguageReport {
    /// All words.
    pub words: usize,
    /// The headings of [`COUNTED_WORDS`] and "What …", each with its number.
    pub counts: Vec<(&'static str, usize)>,
    /// Doc comments of functions, and those that begin with a verb.
    pub functions: [usize; 2],
    /// `file:line: phrase` of [`FORBIDDEN_REFERENCES`].
    pub nowhere: Vec<String>,
    /// `file:line: phrase -> term` of [`REPLACED_PHRASES`] and [`REPLACED_MESSAGE_PHRASES`].
    pub phrases: Vec<String>,
    /// `file:line: path` of source files that are named and are not there.
    pub missing_files: Vec<String>,
    /// `file:line` of tables whose rows begin without a head.
    pub cut_tables: Vec<String>,
    /// The files with the most counted words, and their number.
    pub files: Vec<(String, usize)>,
}

impl LanguageReport {
    /// Returns a count per 10,000 words.
    pub(crate) fn per_10_000_words(&self, count: usize) -> f64 {
        1e4 * count as f64 / self.words.max(1) as f64
    }
}

/// Reads pages and doc comments.
///
/// # Errors
/// A page cannot be read.
pub(crate) fn analyse_language(root: &Path, sources: &[SourceFile]) -> Result<LanguageReport> {
    let mut found = LanguageReport {
        counts: COUNTED_WORDS.iter().map(|(head, _)| (*head, 0)).chain([("What …", 0)]).collect(),
        ..LanguageReport::default()
    };
    let mut pages = Vec::new();
    collect_pages(root, &mut pages)?;
    for path in pages {
        let name = path.strip_prefix(root).unwrap_or(&path).to_string_lossy().replace('\\', "/");
        let text = fs::read_to_string(&path).with_context(|| name.clone())?;
        found
            .cut_tables
            .extend(find_headerless_table_rows(&text).iter().map(|line| format!("{name}:{line}")));
        found.nowhere.extend(find_forbidden_references(&name, &text));
        found.phrases.extend(find_replaced_phrases(&name, &strip_code(&text)));
        found.missing_files.extend(find_missing_file_references(&name, &text, sources));
        found.count_words(&name, &strip_code(&text));
    }
    for source in sources {
        // The lists above.
        if source.path.ends_with("structure/language.rs") {
            continue;
        }
        found.nowhere.extend(find_forbidden_references(&source.path, &source.text));
        let comments = extract_comments(&source.text);
        found.phrases.extend(find_replaced_phrases(&source.path, &strip_code(&comments)));
        found.phrases.extend(find_replaced_message_phrases(source));
        found.missing_files.extend(find_missing_file_references(&source.path, &comments, sources));
        found.count_words(&source.path, &strip_code(&extract_doc_comments(&source.text)));
        if !source.is_test_or_example() {
            for first in first_doc_words_of_functions(&source.text) {
                found.functions[0] += 1;
                found.functions[1] += usize::from(is_verb(&first));
            }
        }
    }
    found.files.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    Ok(found)
}

impl LanguageReport {
    fn count_words(&mut self, name: &str, text: &str) {
        self.words += text.split_whitespace().count();
        let lower = text.to_lowercase();
        let mut all = 0;
        for (index, (_, forms)) in COUNTED_WORDS.iter().enumerate() {
            let count: usize = forms.iter().map(|form| count_whole_words(&lower, form)).sum();
            self.counts[index].1 += count;
            all += count;
        }
        let what = count_sentences_opening_with_what(text);
        self.counts[COUNTED_WORDS.len()].1 += what;
        all += what;
        if all > 0 {
            self.files.push((name.to_owned(), all));
        }
    }
}

fn collect_pages(folder: &Path, pages: &mut Vec<std::path::PathBuf>) -> Result<()> {
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name == "target" || name.starts_with('.') || name == "CHANGELOG.md" {
            continue;
        }
        if path.is_dir() {
            collect_pages(&path, pages)?;
        } else if name.ends_with(".md") {
            pages.push(path);
        }
    }
    Ok(())
}

/// Returns the doc comments of a file, a paragraph for each item.
fn extract_doc_comments(text: &str) -> String {
    let mut all = String::new();
    for line in text.lines().map(str::trim_start) {
        match line.strip_prefix("///").or_else(|| line.strip_prefix("//!")) {
            Some(comment) => all += comment,
            None if !all.ends_with("\n\n") => all += "\n",
            None => {}
        }
        all += "\n";
    }
    all
}

/// Returns the comments of a file, each on its line; the other lines are empty.
fn extract_comments(text: &str) -> String {
    let comment = |line: &str| {
        let line = line.trim_start();
        line.starts_with("//").then(|| line.trim_start_matches(['/', '!']).to_owned())
    };
    text.lines().flat_map(|line| [comment(line).unwrap_or_default(), "\n".to_owned()]).collect()
}

/// Returns the text without blocks of code and without what is in backticks.
fn strip_code(text: &str) -> String {
    let mut is_code = false;
    let mut all = String::with_capacity(text.len());
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
        } else if !is_code {
            for (index, part) in line.split('`').enumerate() {
                all += if index % 2 == 0 { part } else { "x" };
            }
        }
        all.push('\n');
    }
    all
}

fn count_whole_words(text: &str, form: &str) -> usize {
    find_whole_words(text, form).count()
}

/// Returns where `form` stands between other characters than letters and digits.
fn find_whole_words<'t>(text: &'t str, form: &'t str) -> impl Iterator<Item = usize> + 't {
    let is_letter = |letter: Option<char>| letter.is_some_and(char::is_alphanumeric);
    text.match_indices(form).map(|(at, _)| at).filter(move |at| {
        !is_letter(text[..*at].chars().next_back())
            && !is_letter(text[at + form.len()..].chars().next())
    })
}

/// Returns how many sentences begin with "What" and are no question.
fn count_sentences_opening_with_what(text: &str) -> usize {
    let is_start = |before: &str| {
        let on_line = before.rsplit('\n').next().unwrap_or_default();
        let trimmed = before.trim_end();
        let opens = [' ', '\t', '*', '-', '|', '#', '>'];
        let ends = trimmed.ends_with(['.', '!', '?', ':', '|']) || trimmed.is_empty();
        ends || on_line.trim_matches(opens).is_empty()
            && before.trim_end_matches(' ').ends_with("\n\n")
    };
    let starts = text.match_indices("What ").filter(|(at, _)| is_start(&text[..*at]));
    starts.filter(|(at, _)| !is_question(&text[*at..])).count()
}

fn is_question(text: &str) -> bool {
    let end = text.find(['.', '?', '|']);
    end.is_some_and(|at| text.as_bytes()[at] == b'?')
}

/// Returns the first word of the doc comment of each documented function.
fn first_doc_words_of_functions(text: &str) -> Vec<String> {
    let mut first: Option<String> = None;
    let mut found = Vec::new();
    for line in text.lines().map(str::trim) {
        if let Some(comment) = line.strip_prefix("///") {
            let word = comment.split_whitespace().next().unwrap_or_default();
            first.get_or_insert_with(|| word.to_owned());
        } else if line.starts_with("#[") || line.starts_with("//") {
            // Attributes stand between a comment and its item.
        } else {
            let before = line.split('(').next().unwrap_or_default();
            if let Some(word) =
                first.take().filter(|_| before.starts_with("fn ") || before.contains(" fn "))
            {
                found.push(word);
            }
        }
    }
    found
}

/// Returns true for a word that looks like a verb in the third person: Returns, Computes, Carries.
fn is_verb(word: &str) -> bool {
    word.starts_with(char::is_uppercase)
        && word.ends_with('s')
        && !word.ends_with("ss")
        && !NON_VERBS.contains(&word)
        && word.chars().skip(1).all(char::is_lowercase)
}

fn find_forbidden_references(name: &str, text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let lower = line.to_lowercase();
        let phrases = FORBIDDEN_REFERENCES.iter().filter(|phrase| lower.contains(**phrase));
        found.extend(phrases.map(|phrase| format!("{name}:{}: {phrase}", index + 1)));
    }
    found
}

/// Returns where a phrase stands that has a term of the trade.
fn find_replaced_phrases(name: &str, text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let lower = line.to_lowercase();
        for (phrase, term) in REPLACED_PHRASES {
            if count_whole_words(&lower, phrase) > 0 {
                found.push(format!("{name}:{}: {phrase} -> {term}", index + 1));
            }
        }
    }
    found
}

/// Returns where a text in quotes has a phrase with a term of the trade. What is compiled for tests does not count, nor
/// do names in quotes (`"told"`, `"/plc/heard"`), which others read, and names in braces.
fn find_replaced_message_phrases(source: &SourceFile) -> Vec<String> {
    if source.is_test_or_example() {
        return Vec::new();
    }
    let mut found = Vec::new();
    let lines = source.words.lines().zip(source.code.lines()).enumerate();
    for (index, (words, code)) in lines {
        // A text in quotes is there in the words, and blank in the code.
        let quoted = words.bytes().zip(code.bytes());
        let quoted = quoted.map(|(word, code)| if code == b' ' { word } else { b'"' });
        let lower = String::from_utf8_lossy(&quoted.collect::<Vec<_>>()).to_lowercase();
        for (phrase, term) in REPLACED_MESSAGE_PHRASES {
            let is_message = |at: usize| {
                let [before, after] = [&lower[..at], &lower[at + phrase.len()..]];
                let is_name =
                    before.ends_with(['"', '/', '.', '_']) && after.starts_with(['"', '_']);
                !is_name && !before.ends_with(['{', '_']) && !after.starts_with('_')
            };
            if find_whole_words(&lower, phrase).any(is_message) {
                found.push(format!("{}:{}: {phrase} -> {term}", source.path, index + 1));
            }
        }
    }
    found
}

/// Returns where a source file is named in backticks that no path of the project ends with.
fn find_missing_file_references(name: &str, text: &str, sources: &[SourceFile]) -> Vec<String> {
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate() {
        for quoted in line.split('`').skip(1).step_by(2).filter(|part| part.ends_with(".rs")) {
            let is_path =
                quoted.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-/".contains(&byte));
            let is_there = |source: &SourceFile| {
                source
                    .path
                    .strip_suffix(quoted)
                    .is_some_and(|rest| rest.is_empty() || rest.ends_with('/'))
            };
            if is_path && !sources.iter().any(is_there) {
                found.push(format!("{name}:{}: {quoted}", index + 1));
            }
        }
    }
    found
}

/// Returns the lines at which rows of a table begin without a head: an empty line has cut the table.
fn find_headerless_table_rows(text: &str) -> Vec<usize> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let mut is_code = false;
    let mut found = Vec::new();
    for (index, line) in lines.iter().enumerate() {
        is_code ^= line.starts_with("```");
        let is_first = !index.checked_sub(1).is_some_and(|before| lines[before].starts_with('|'));
        let next = lines.get(index + 1).copied().unwrap_or_default();
        let has_head =
            next.starts_with('|') && next.chars().all(|character| "|-: ".contains(character));
        if line.starts_with('|') && is_first && !has_head && !is_code {
            found.push(index + 1);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phrases_with_a_term_and_files_that_are_gone_are_found_by_line() {
        let text = "Rows are set aside.\n`set aside`, setaside\n";
        let phrases = find_replaced_phrases("a.md", &strip_code(text));
        assert_eq!(phrases, ["a.md:1: set aside -> excluded as outliers"]);
        let comments =
            extract_comments("fn x() {} // no\n    /// See `b.rs`, `src/a.rs` and `a.rs`.\n");
        let sources = [SourceFile::new("crates/x/src/a.rs", "")];
        assert_eq!(find_missing_file_references("y.rs", &comments, &sources), ["y.rs:2: b.rs"]);
    }

    #[test]
    fn a_message_with_a_replaced_phrase_is_found_and_names_and_tests_are_not() {
        let text = "fn a() {\n    // It was told.\n    say(\"The bridge was told.\");\n    \
                    say(\"told\", told, \"/plc/heard\", \"{told}\");\n    say(\"a µm left out, {x}\");\n}\n\
                    #[cfg(test)]\nmod tests {\n    const A: &str = \"it was told\";\n}\n";
        assert_eq!(
            find_replaced_message_phrases(&SourceFile::new("src/a.rs", text)),
            [
                "src/a.rs:3: told -> reported, sent, separated",
                "src/a.rs:5: left out -> held out, skipped, omitted"
            ]
        );
        assert!(find_replaced_message_phrases(&SourceFile::new("tests/a.rs", text)).is_empty());
    }

    #[test]
    fn words_are_counted_where_they_are_whole_and_no_code() {
        let text =
            strip_code("He was told. `told`\n```\ntold\n```\nRetold, Told; besides beside.\n");
        assert_eq!(count_whole_words(&text.to_lowercase(), "told"), 2);
        assert_eq!(count_whole_words(&text.to_lowercase(), "beside"), 1);
    }

    #[test]
    fn a_question_is_no_noun_clause() {
        let text =
            "What a curve leaves.\n\nWhat is it?\nIt is. What else is there.\nSee What it is.";
        assert_eq!(count_sentences_opening_with_what(text), 2);
    }

    #[test]
    fn a_function_doc_begins_with_a_verb_or_not() {
        let text = "/// Returns it.\n#[must_use]\npub const fn a() {}\n/// The value.\nfn b();\n\
                    /// A type.\nstruct C;\n/// This is it.\nasync fn d() {}";
        let words = first_doc_words_of_functions(text);
        assert_eq!(words, ["Returns", "The", "This"]);
        assert_eq!(words.iter().filter(|word| is_verb(word)).count(), 1);
    }

    #[test]
    fn an_empty_line_cuts_a_table() {
        let text = "| a | b |\n|---|---|\n| 1 | 2 |\n\n| 3 | 4 |\n\n```\n| no table\n```\n";
        assert_eq!(find_headerless_table_rows(text), [5]);
    }

    #[test]
    fn references_that_lead_nowhere_are_found() {
        let found = find_forbidden_references("a.md", "fine\nas The Issue's figure says\n");
        assert_eq!(found, ["a.md:2: the issue's"]);
    }
}
