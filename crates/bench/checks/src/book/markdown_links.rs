//! Links of Markdown documents: found, followed, and given other targets.

use std::{
    fs,
    path::{Component, Path, PathBuf},
};

use anyhow::Result;

/// A link in a text.
pub(crate) struct MarkdownLink {
    /// The line, from 1 on.
    pub line: usize,
    /// Its target, the text between `](` and `)`.
    pub target: String,
}

/// Returns the links of a text, but for what is code.
pub(crate) fn find_links(text: &str) -> Vec<MarkdownLink> {
    let mut found = Vec::new();
    let mut line = 0;
    rewrite_link_targets_with_line(text, &mut |number, target| {
        line = number;
        found.push(MarkdownLink { line, target: target.into() });
        None
    });
    found
}

/// Returns the same text with the targets that `new` gives; `None` leaves one unchanged.
pub(crate) fn rewrite_link_targets(
    text: &str,
    new: &mut dyn FnMut(&str) -> Option<String>,
) -> String {
    rewrite_link_targets_with_line(text, &mut |_, target| new(target))
}

fn rewrite_link_targets_with_line(
    text: &str,
    new: &mut dyn FnMut(usize, &str) -> Option<String>,
) -> String {
    let mut result = String::with_capacity(text.len());
    let mut in_code = false;
    for (line, number) in text.split_inclusive('\n').zip(1..) {
        in_code ^= line.trim_start().starts_with("```");
        if in_code {
            result += line;
            continue;
        }
        let mut rest = line;
        // Behind `](` in what is not between backquotes.
        while let Some(at) = rest.find("](") {
            let (before, target) = rest.split_at(at + 2);
            let end = target.find(')');
            let Some(end) = end.filter(|_| !is_in_code_span(line, line.len() - target.len()))
            else {
                result += before;
                rest = target;
                continue;
            };
            result += before;
            let target = &target[..end];
            result += &new(number, target).unwrap_or_else(|| target.into());
            rest = &rest[at + 2 + end..];
        }
        result += rest;
    }
    result
}

/// Returns whether a place in a line is between backquotes.
fn is_in_code_span(line: &str, place: usize) -> bool {
    line[..place].matches('`').count() % 2 == 1
}

/// Path and anchor of a target, the anchor with its `#`.
pub(crate) fn split_anchor(target: &str) -> (&str, &str) {
    target.split_at(target.find('#').unwrap_or(target.len()))
}

/// Returns the file that a page, or a line of it, includes as a whole.
pub(crate) fn included_file(page: &Path, text: &str) -> Option<PathBuf> {
    let path = text.trim().strip_prefix("{{#include ")?.strip_suffix("}}")?;
    Some(normalise_path(&page.parent()?.join(path)))
}

/// Returns a path without `..`.
pub(crate) fn normalise_path(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut normal, part| {
        match part {
            Component::ParentDir => drop(normal.pop()),
            Component::CurDir => {}
            part => normal.push(part),
        }
        normal
    })
}

/// Returns the documents whose links are looked after.
pub(crate) fn list_documents_to_check(root: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for folder in ["", "data", "docs", "docs/book/src", "integrations", "crates"] {
        collect_markdown_files(
            &root.join(folder),
            match folder {
                "crates" => 2,
                "integrations" => 1,
                _ => 0,
            },
            &mut found,
        )?;
    }
    found.sort();
    Ok(found)
}

fn collect_markdown_files(folder: &Path, deeper: usize, found: &mut Vec<PathBuf>) -> Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() && deeper > 0 {
            collect_markdown_files(&path, deeper - 1, found)?;
        } else if path.extension().is_some_and(|extension| extension == "md") {
            found.push(path);
        }
    }
    Ok(())
}

/// Returns the links of a document that lead nowhere, a line each.
pub(crate) fn find_broken_links(root: &Path, document: &Path) -> Result<Vec<String>> {
    let text = fs::read_to_string(document)?;
    let shown = document.strip_prefix(root).unwrap_or(document).display().to_string();
    let mut broken = Vec::new();
    for link in find_links(&text) {
        let (path, anchor) = split_anchor(&link.target);
        if link.target.contains("://") || link.target.starts_with("mailto:") {
            continue;
        }
        let file = match path {
            "" => document.to_owned(),
            path => normalise_path(&document.parent().unwrap_or(root).join(path)),
        };
        let has_anchor = || -> Result<bool> {
            let mut text = fs::read_to_string(&file)?;
            if let Some(origin) = included_file(&file, &text) {
                text = fs::read_to_string(origin)?;
            }
            Ok(heading_anchors(&text).iter().any(|known| *known == anchor[1..]))
        };
        if !file.exists() {
            broken.push(format!("{shown}:{}: there is no {}", link.line, link.target));
        } else if !anchor.is_empty()
            && file.extension().is_some_and(|extension| extension == "md")
            && !has_anchor()?
        {
            broken.push(format!("{shown}:{}: there is no heading for {}", link.line, link.target));
        }
    }
    Ok(broken)
}

/// Returns what the headings of a text are called in a link.
fn heading_anchors(text: &str) -> Vec<String> {
    let mut in_code = false;
    let mut anchors = Vec::new();
    for line in text.lines() {
        in_code ^= line.trim_start().starts_with("```");
        let heading = line.trim_start_matches('#');
        if in_code || heading.len() == line.len() || !heading.starts_with(' ') {
            continue;
        }
        let retained = heading.trim().to_lowercase();
        let retained = retained
            .chars()
            .filter(|character| character.is_alphanumeric() || [' ', '-', '_'].contains(character));
        anchors.push(
            retained.map(|character| if character == ' ' { '-' } else { character }).collect(),
        );
    }
    anchors
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_found_outside_code_and_given_other_targets() {
        let text = "[a](b.md#c) `[no](x.md)` and [d](e)\n```\n[no](y.md)\n```\n[`f`](g.md)\n";
        let found: Vec<_> =
            find_links(text).into_iter().map(|link| (link.line, link.target)).collect();
        assert_eq!(found, [(1, "b.md#c".into()), (1, "e".into()), (5, "g.md".into())]);
        let new = rewrite_link_targets(text, &mut |target| (target == "e").then(|| "new".into()));
        assert_eq!(new, text.replace("[d](e)", "[d](new)"));
    }

    #[test]
    fn a_broken_link_and_a_missing_heading_are_reported_with_their_line() {
        let folder = std::env::temp_dir().join(format!("trueup-links-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let page = folder.join("page.md");
        let text = "# It is, so: a head\n[a](#it-is-so-a-head)\n[b](#other) [c](none.md)\n";
        fs::write(&page, text).expect("written");
        let broken = find_broken_links(&folder, &page).expect("it can be read");
        fs::remove_dir_all(&folder).expect("removed");
        let requested =
            ["page.md:3: there is no heading for #other", "page.md:3: there is no none.md"];
        assert_eq!(broken, requested);
    }
}
