//! `docs/papers.md` holds every statement of the five papers against the tests that show it: a row that
//! names a test that is not there is red, and so is one that names none and gives no reason.

use std::{collections::BTreeSet, fs, path::Path};

/// The names of all functions in Rust files below `folder`.
fn functions(folder: &Path, found: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).expect("a folder of the project") {
        let path = entry.expect("it is readable").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" {
            functions(&path, found);
        } else if name.ends_with(".rs") {
            let text = fs::read_to_string(&path).expect("source is text");
            let mut is_test = false;
            for line in text.lines().map(str::trim) {
                is_test |= line == "#[test]";
                if let Some(rest) = line.strip_prefix("fn ") {
                    let name = rest.split('(').next().unwrap_or_default();
                    if is_test {
                        found.insert(name.to_string());
                    }
                    is_test = false;
                }
            }
        }
    }
}

/// Returns what stands between backquotes.
fn quoted(cell: &str) -> impl Iterator<Item = &str> {
    cell.split('`').skip(1).step_by(2)
}

/// Number, statement, where, shown by: the rows of the page.
fn rows(page: &str) -> Vec<[&str; 4]> {
    page.lines()
        .filter_map(|line| {
            let inner = line.strip_prefix("| ")?.strip_suffix('|')?;
            let cells: Vec<&str> = inner.split(" | ").map(str::trim).collect();
            let is_row = cells[0].split_once('.').is_some_and(|(seed, number)| {
                seed.parse::<u32>().is_ok() && number.parse::<u32>().is_ok()
            });
            is_row.then(|| {
                <[&str; 4]>::try_from(cells).unwrap_or_else(|_| panic!("four cells: {line}"))
            })
        })
        .collect()
}

#[test]
fn every_test_that_the_papers_page_names_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let page = fs::read_to_string(root.join("docs/papers.md")).expect("the page is there");
    let mut tests = BTreeSet::new();
    for folder in ["crates", "host-tests", "xtask"] {
        functions(&root.join(folder), &mut tests);
    }
    let rows = rows(&page);
    for seed in 0..5 {
        let of = rows.iter().filter(|[number, ..]| number.starts_with(&format!("{seed}.")));
        assert!(of.count() >= 9, "seed {seed} has statements");
    }
    let mut named = 0;
    for [number, _, place, shown_by] in rows {
        let mut any = false;
        for test in quoted(shown_by) {
            assert!(tests.contains(test), "{number}: there is no test {test}");
            any = true;
            named += 1;
        }
        // What no test shows says why.
        let reason = place.contains("not there") || shown_by.starts_with("not there");
        assert!(any || reason, "{number}: neither a test nor a reason");
    }
    println!("{named} tests are named");
}
