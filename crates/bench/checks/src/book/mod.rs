//! The book, `docs/book`: its pages, and `cargo xtask book`, which makes web pages of it.
//!
//! Some pages are documents of their own that the book includes (`docs/reference.md`), and some include a file that a
//! test needs as well (`tutorial.md`). Every link is
//! written as a reader of the source tree follows it; for the web a link to a page of the book stays
//! one, and a link to another file of the project goes to the project's repository.

mod markdown_links;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, bail};
use trueup_emulator::{process, setup};

use self::markdown_links::{included_file, normalise_path};
use crate::cargo;

/// The version that the pages are written for.
const MDBOOK_VERSION: &str = "0.5.4";
/// Where the book's own text is, below the project's root.
const BOOK_SOURCE_FOLDER: &str = "docs/book/src";

/// A page of the book.
struct BookPage {
    /// Its file in the book.
    name: String,
    /// The file that its text stands in: its own, or the one that it includes.
    origin: PathBuf,
    text: String,
}

/// Returns the pages that stand in the book's folder, but for its contents.
fn read_book_pages(root: &Path) -> Result<Vec<BookPage>> {
    let mut pages = Vec::new();
    for entry in fs::read_dir(root.join(BOOK_SOURCE_FOLDER))? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name == "SUMMARY.md" || !name.ends_with(".md") {
            continue;
        }
        let own = read_text(&path)?;
        let origin = included_file(&path, &own).unwrap_or(path);
        let text = read_text(&origin)
            .and_then(|text| expand_includes(&origin, &text))
            .context(name.clone())?;
        pages.push(BookPage { name, origin, text });
    }
    pages.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(pages)
}

/// Returns the text of a page, with the files that it includes between its own lines.
fn expand_includes(page: &Path, text: &str) -> Result<String> {
    let mut whole = String::new();
    for line in text.split_inclusive('\n') {
        whole +=
            &included_file(page, line).map_or_else(|| Ok(line.into()), |file| read_text(&file))?;
    }
    Ok(whole)
}

fn read_text(file: &Path) -> Result<String> {
    fs::read_to_string(file).with_context(|| format!("{} is missing", file.display()))
}

/// Returns what is wrong with the book and the links of all documents, a line each; empty: nothing.
///
/// # Errors
/// A document cannot be read.
pub(crate) fn find_book_problems(root: &Path) -> Result<Vec<String>> {
    let summary = fs::read_to_string(root.join(BOOK_SOURCE_FOLDER).join("SUMMARY.md"))?;
    let listed: Vec<String> =
        markdown_links::find_links(&summary).into_iter().map(|link| link.target).collect();
    let mut faults = Vec::new();
    for page in read_book_pages(root)? {
        match listed.iter().filter(|name| **name == page.name).count() {
            1 => {}
            count => faults.push(format!("{}: {count} times in SUMMARY.md", page.name)),
        }
    }
    for document in markdown_links::list_documents_to_check(root)? {
        faults.extend(markdown_links::find_broken_links(root, &document)?);
    }
    Ok(faults)
}

/// Renders the book into `target/book` and gives its first page.
///
/// # Errors
/// A link is broken, or mdBook cannot be built or fails.
pub fn render_book() -> Result<PathBuf> {
    let root = setup::project_root();
    let faults = find_book_problems(&root)?;
    if !faults.is_empty() {
        bail!("broken links:\n{}", faults.join("\n"));
    }
    let manifest = fs::read_to_string(root.join("Cargo.toml"))?;
    let repository = manifest.lines().find_map(|line| line.strip_prefix("repository = "));
    let repository = repository.context("Cargo.toml names no repository")?.trim_matches('"');

    let folder = root.join("target/book");
    let source = folder.join("src");
    if source.is_dir() {
        fs::remove_dir_all(&source)?;
    }
    fs::create_dir_all(&source)?;
    fs::copy(root.join("docs/book/book.toml"), folder.join("book.toml"))?;
    fs::copy(root.join(BOOK_SOURCE_FOLDER).join("SUMMARY.md"), source.join("SUMMARY.md"))?;
    for entry in fs::read_dir(root.join(BOOK_SOURCE_FOLDER))? {
        let path = entry?.path();
        if let (Some("svg"), Some(name)) =
            (path.extension().and_then(|extension| extension.to_str()), path.file_name())
        {
            fs::copy(&path, source.join(name))?;
        }
    }
    let pages = read_book_pages(&root)?;
    let place = |path: &Path| {
        let page = pages.iter().find(|page| page.origin == path);
        page.map(|page| page.name.clone()).or_else(|| {
            let own = path.parent() == Some(&root.join(BOOK_SOURCE_FOLDER));
            own.then(|| path.file_name().unwrap_or_default().to_string_lossy().into_owned())
        })
    };
    for page in &pages {
        let text = markdown_links::rewrite_link_targets(&page.text, &mut |target| {
            let (path, anchor) = markdown_links::split_anchor(target);
            if path.is_empty() || target.contains("://") {
                return None;
            }
            let path = normalise_path(&page.origin.parent()?.join(path));
            let web = place(&path).unwrap_or_else(|| {
                let below = path.strip_prefix(&root).unwrap_or(&path);
                format!("{repository}/blob/main/{}", below.display())
            });
            Some(format!("{web}{anchor}"))
        });
        fs::write(source.join(&page.name), text)?;
    }
    let mdbook = cargo::install_tool("mdbook", MDBOOK_VERSION)?;
    process::run(
        Command::new(mdbook).args(["build", "--dest-dir"]).arg(folder.join("html")).arg(&folder),
    )?;
    Ok(folder.join("html/index.html"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn project_root() -> PathBuf {
        normalise_path(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.."))
    }

    /// Returns what is between backquotes and is a path of this project: it has a slash, and no blank, option,
    /// placeholder or address in it.
    fn paths(text: &str) -> Vec<&str> {
        let mut in_code = false;
        let lines = text.lines().filter(|line| {
            let fence = line.trim_start().starts_with("```");
            in_code ^= fence;
            !in_code && !fence
        });
        lines
            .flat_map(|line| line.split('`').skip(1).step_by(2))
            .filter(|word| word.contains('/') && !word.starts_with("target/"))
            .filter(|word| !word.contains([' ', '<', '*', ':', '{', '…']))
            .collect()
    }

    #[test]
    fn every_page_is_in_the_contents_once_and_every_link_of_every_document_resolves() {
        let faults = find_book_problems(&project_root()).expect("the documents can be read");
        assert!(faults.is_empty(), "{}", faults.join("\n"));
        // Not because nothing was looked at.
        assert!(read_book_pages(&project_root()).expect("as above").len() > 20);
        assert!(
            markdown_links::list_documents_to_check(&project_root()).expect("as above").len() > 40
        );
    }

    #[test]
    fn a_page_has_what_it_includes_between_its_own_lines() {
        for page in read_book_pages(&project_root()).expect("the pages can be read") {
            assert!(!page.text.contains("{{#include"), "{}", page.name);
        }
        let page = project_root().join(BOOK_SOURCE_FOLDER).join("tutorial.md");
        let text = expand_includes(&page, "before\n{{#include tutorial.in/on.csv}}\nbehind\n");
        let text = text.expect("the file is there");
        assert!(text.starts_with("before\ntime_s,") && text.ends_with("\nbehind\n"), "{text}");
        let missing =
            expand_includes(&page, "{{#include tutorial.in/off.txt}}\n").expect_err("no such file");
        assert!(missing.to_string().ends_with("tutorial.in/off.txt is missing"), "{missing}");
    }

    #[test]
    fn every_path_that_the_two_pages_for_programmers_name_is_there() {
        let mut named = 0;
        for page in ["ARCHITECTURE.md", "CONTRIBUTING.md"] {
            let text = fs::read_to_string(project_root().join(page)).expect("it is there");
            for path in paths(&text) {
                assert!(project_root().join(path).exists(), "{page}: there is no {path}");
                named += 1;
            }
        }
        assert!(named > 20, "{named} paths were looked at");
    }

    #[test]
    fn the_readme_is_short() {
        let lines = fs::read_to_string(project_root().join("README.md")).expect("it is there");
        assert!(lines.lines().count() <= 150, "what it loses belongs to the book");
    }

    #[test]
    fn paths_are_what_is_quoted_and_has_a_slash() {
        let text =
            "`src/main.rs`, `cargo x a/b`, `crates/*/x`, `name`, [x](y/z)\n```\n`a/b`\n```\n";
        assert_eq!(paths(text), ["src/main.rs"]);
    }
}
