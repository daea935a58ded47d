//! The documentation of all crates for programmers, with a front page: rustdoc writes a page for each crate, and none that
//! leads to them.
//!
//! The front page shows the crates by their room. What a room holds is the table of ARCHITECTURE.md, what a crate is for is the
//! description in its manifest: neither is written here again.

use std::{fmt::Write as _, fs, path::PathBuf};

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;
use trueup_emulator::{process, setup};
use trueup_page::{HtmlPage, escape_html};

use crate::cargo;

/// A crate that has documentation.
#[derive(Clone, Debug, PartialEq, Eq)]
struct DocumentedCrate {
    /// The folder of its manifest, below the project's root.
    folder: String,
    package: String,
    /// Its folder in the documentation.
    target: String,
    description: String,
}

/// Documents all crates that a host compiles, every warning an error, and gives the front page. `is_private`: private items too,
/// whose links lead nowhere unseen otherwise.
///
/// # Errors
/// cargo cannot be started, a crate has no page, or rustdoc finds something wrong.
pub fn build_api_docs(is_private: bool) -> Result<PathBuf> {
    let mut doc = cargo::locked_cargo_command("doc");
    doc.args(["--workspace", "--exclude", "trueup-firmware", "--no-deps", "--all-features"]);
    doc.args(is_private.then_some("--document-private-items"));
    process::run(doc.env("RUSTDOCFLAGS", "-D warnings"))?;

    let mut metadata = cargo::locked_cargo_command("metadata");
    metadata.args(["--no-deps", "--format-version", "1"]);
    let metadata: Value = serde_json::from_str(&process::capture_stdout(&mut metadata)?)?;
    let crates = parse_documented_crates(&metadata)?;
    let folder = PathBuf::from(string_field(&metadata, "target_directory")?).join("doc");
    for one in &crates {
        let page = folder.join(&one.target).join("index.html");
        ensure!(
            page.is_file(),
            "{} has no documentation: {} is missing",
            one.package,
            page.display()
        );
    }
    let root = setup::project_root();
    let rooms = parse_layer_table(&fs::read_to_string(root.join("ARCHITECTURE.md"))?);
    let front_page = folder.join("index.html");
    fs::write(&front_page, render_front_page_html(&rooms, &crates)?)?;
    Ok(front_page)
}

/// Returns the crates in the folder `crates`, and the commands, in the order of their folders.
fn parse_documented_crates(metadata: &Value) -> Result<Vec<DocumentedCrate>> {
    let root = string_field(metadata, "workspace_root")?;
    let mut crates = Vec::new();
    for package in metadata["packages"].as_array().context("no packages")? {
        let manifest = string_field(package, "manifest_path")?;
        let Some(folder) = manifest
            .strip_prefix(root)
            .and_then(|path| path.strip_suffix("/Cargo.toml"))
            .map(|path| path.trim_start_matches('/'))
            .filter(|path| path.starts_with("crates/"))
        else {
            continue;
        };
        let package_name = string_field(package, "name")?;
        let targets = package["targets"].as_array().context("no targets")?;
        let of_kind = |kind: &str| {
            targets.iter().find(|target| {
                target["kind"].as_array().is_some_and(|all| all.contains(&kind.into()))
            })
        };
        let target = of_kind("lib").or_else(|| of_kind("bin")).context("nothing to document")?;
        crates.push(DocumentedCrate {
            folder: folder.into(),
            package: package_name.into(),
            target: string_field(target, "name")?.replace('-', "_"),
            description: string_field(package, "description")
                .context(package_name.to_owned())?
                .into(),
        });
    }
    crates.sort_by(|a, b| a.folder.cmp(&b.folder));
    Ok(crates)
}

fn string_field<'a>(value: &'a Value, key: &str) -> Result<&'a str> {
    value[key].as_str().with_context(|| format!("no {key}"))
}

/// Returns the folders of the rooms with what they hold, from the table in ARCHITECTURE.md whose first column is `room`.
fn parse_layer_table(architecture: &str) -> Vec<(String, String)> {
    let table = architecture.lines().skip_while(|line| !line.starts_with("| room |")).skip(2);
    let rows = table.take_while(|line| line.starts_with('|'));
    rows.filter_map(|row| {
        let mut cells = row.trim_matches('|').split('|').map(|cell| cell.trim().replace('`', ""));
        Some((cells.next()?, cells.next()?))
    })
    .collect()
}

/// Returns the front page: a heading for each room, and below it its crates.
///
/// # Errors
/// A crate lies in no room: ARCHITECTURE.md is older than the crate.
fn render_front_page_html(
    rooms: &[(String, String)],
    crates: &[DocumentedCrate],
) -> Result<String> {
    let mut page = HtmlPage::new("trueup: documentation for programmers");
    page.add_paragraph(
        "The crates by their room, from the bottom up. A crate depends on its own room and on those above it on this page. \
         ARCHITECTURE.md shows how data flow through them.",
    );
    let mut shown = 0;
    for (folder, holds) in rooms {
        page.add_heading(folder);
        page.add_paragraph(holds);
        let mut list = String::from("<ul>\n");
        let inside = format!("{folder}/");
        for one in crates.iter().filter(|one| one.folder.starts_with(&inside)) {
            shown += 1;
            let [target, package, description] =
                [&one.target, &one.package, &one.description].map(|text| escape_html(text));
            let _ = writeln!(
                list,
                "<li><a href=\"{target}/index.html\">{package}</a>: {description}</li>"
            );
        }
        page.add_raw_html(&(list + "</ul>\n"));
    }
    ensure!(shown == crates.len(), "a crate lies in no room of ARCHITECTURE.md");
    page.add_note(
        "The firmware itself is built for its own processor: src/main.rs shows its tasks. The model of the chip, crates/bench/chip, \
         is a workspace of its own.",
    );
    Ok(page.to_html())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn a_crate(folder: &str) -> DocumentedCrate {
        DocumentedCrate {
            folder: folder.into(),
            package: "trueup-core".into(),
            target: "trueup_core".into(),
            description: "what a < b does".into(),
        }
    }

    #[test]
    fn the_rooms_are_those_of_the_architecture() {
        let text = fs::read_to_string(setup::project_root().join("ARCHITECTURE.md")).unwrap();
        let folders: Vec<String> =
            parse_layer_table(&text).into_iter().map(|(folder, _)| folder).collect();
        let expected = ["base", "board", "model", "analysis", "tool", "bench"];
        assert_eq!(folders, expected.map(|room| format!("crates/{room}")));
    }

    #[test]
    fn a_crate_stands_below_its_room_with_its_description() {
        let rooms = [("crates/board".to_owned(), "what the board runs".to_owned())];
        let html = render_front_page_html(&rooms, &[a_crate("crates/board/core")]).unwrap();
        let line = "<li><a href=\"trueup_core/index.html\"><span class=\"w\">trueup-core</span></a>: what a &lt; b does</li>";
        assert!(html.find(line) > html.find("<p>what the board runs</p>"), "{html}");
        let error = render_front_page_html(&rooms, &[a_crate("crates/attic/core")]).unwrap_err();
        assert!(error.to_string().contains("no room"), "{error}");
    }

    #[test]
    fn only_crates_are_shown_and_a_program_by_its_own_name() {
        let package = |folder: &str, name: &str, target: &str, kind: &str| {
            serde_json::json!({"name": name, "manifest_path": format!("/p/{folder}/Cargo.toml"), "description": "d",
                "targets": [{"name": "images", "kind": ["example"]}, {"name": target, "kind": [kind]}]})
        };
        let packages = [
            package("xtask", "xtask", "xtask", "bin"),
            package("crates/tool/cli", "trueup-cli", "trueup", "bin"),
            package("crates/board/link", "trueup-link", "trueup-link", "lib"),
        ];
        let crates = parse_documented_crates(
            &serde_json::json!({"workspace_root": "/p", "packages": packages}),
        )
        .unwrap();
        let targets: Vec<&str> = crates.iter().map(|one| one.target.as_str()).collect();
        assert_eq!(targets, ["trueup_link", "trueup"]);
    }
}
