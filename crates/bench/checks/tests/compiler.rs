//! The oldest compiler is stated in one place, the manifest; pages that name it say the same.

use std::{fs, path::Path};

/// Returns the text of a file of the project.
fn project_file(path: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    fs::read_to_string(root.join(path)).expect("a file of the project")
}

/// Returns the `rust-version` of a manifest.
fn rust_version(manifest: &str) -> String {
    let text = project_file(manifest);
    let value = text.lines().find_map(|line| line.strip_prefix("rust-version = \""));
    value.expect("stated once").trim_end_matches('"').to_owned()
}

/// Returns the versions that stand behind "Rust " in a page.
fn named_versions(page: &str) -> Vec<String> {
    let text = project_file(page);
    let versions = text.split("Rust ").skip(1).map(|rest| {
        let end = rest
            .find(|character: char| !character.is_ascii_digit() && character != '.')
            .unwrap_or(rest.len());
        rest[..end].trim_end_matches('.').to_owned()
    });
    versions.filter(|version| version.starts_with("1.")).collect()
}

#[test]
fn pages_name_the_oldest_compiler_of_the_manifests() {
    let (project, chip) =
        (rust_version("Cargo.toml"), rust_version("crates/bench/chip/Cargo.toml"));
    assert_ne!(project, chip);
    for page in ["README.md", "docs/book/src/install.md"] {
        assert_eq!(named_versions(page), [project.as_str()], "{page}");
    }
    assert_eq!(named_versions("ARCHITECTURE.md"), [chip.as_str()]);
    assert_eq!(named_versions("crates/bench/chip/Cargo.toml"), [chip.as_str()]);
    let model = format!("MIN_COMPILER_VERSION: (u32, u32) = ({});", chip.replace('.', ", "));
    assert!(project_file("crates/bench/emulator/src/chip.rs").contains(&model));
}
