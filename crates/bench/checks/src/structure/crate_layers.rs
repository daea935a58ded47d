//! The layers of crates: a crate depends on its own layer and on those below.

use std::{fs, path::Path};

use anyhow::{Context as _, Result};

/// From the lowest layer up: the name of its folder in `crates`, and those of its crates. `output` and `numerics` know nothing
/// of machines, so all may use them.
const CRATE_LAYERS: &[(&str, &[&str])] = &[
    ("base", &["numerics", "output"]),
    (
        "board",
        &[
            "core",
            "link",
            "canopen",
            "store",
            "boot",
            "node",
            "modbus",
            "max31865",
            "signature",
            "pipe",
        ],
    ),
    ("model", &["machine"]),
    ("analysis", &["fit", "diagnose", "learn", "compare", "accept", "page"]),
    (
        "tool",
        &[
            "cli",
            "client",
            "screen",
            "program",
            "export",
            "import",
            "linuxcnc",
            "linuxcnc-core",
            "servo",
            "gateway",
            "fleet",
            "serve",
            "twin",
            "virtual-bridge",
        ],
    ),
    ("bench", &["campaigns", "emulator", "chip", "demo", "bounds", "checks", "measured-data"]),
];

/// Returns the dependencies that lead to a higher layer, as `crate -> crate (layer)`. Those of tests alone do not count.
pub(crate) fn find_upward_dependencies(root: &Path) -> Result<Vec<String>> {
    let mut manifests = Vec::new();
    for (layer, names) in CRATE_LAYERS {
        for name in *names {
            let path = root.join("crates").join(layer).join(name).join("Cargo.toml");
            if path.is_file() {
                let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
                manifests.push((*name, text));
            }
        }
    }
    Ok(manifests
        .iter()
        .flat_map(|(name, text)| find_upward_dependencies_in_manifest(name, text))
        .collect())
}

/// Returns the folders of crates in `crates`, or in a folder of a layer there, that [`CRATE_LAYERS`] does not name: their
/// arrows are seen by nothing.
pub(crate) fn find_crates_without_layer(root: &Path) -> Result<Vec<String>> {
    let crates = root.join("crates");
    let mut found = Vec::new();
    for folder in
        [crates.clone()].into_iter().chain(CRATE_LAYERS.iter().map(|(layer, _)| crates.join(layer)))
    {
        if !folder.is_dir() {
            continue;
        }
        for entry in fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.join("Cargo.toml").is_file() && layer_index(&name).is_none() {
                found.push(path.strip_prefix(root).unwrap_or(&path).display().to_string());
            }
        }
    }
    found.sort();
    Ok(found)
}

/// Returns the index of a crate's layer.
fn layer_index(name: &str) -> Option<usize> {
    CRATE_LAYERS.iter().position(|(_, names)| names.contains(&name))
}

fn find_upward_dependencies_in_manifest(name: &str, manifest: &str) -> Vec<String> {
    let mut is_counted = false;
    let mut found = Vec::new();
    for line in manifest.lines().map(str::trim) {
        if line.starts_with('[') {
            is_counted = line.ends_with("dependencies]") && !line.contains("dev-");
        }
        let Some(rest) = line.strip_prefix("trueup-").filter(|_| is_counted) else { continue };
        let end = rest.find(['.', ' ', '=']).unwrap_or(rest.len());
        let other = &rest[..end];
        if let (Some(own), Some(higher)) = (layer_index(name), layer_index(other))
            && higher > own
        {
            found.push(format!("{name} -> {other} ({})", CRATE_LAYERS[higher].0));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dependency_on_a_higher_layer_is_an_arrow_up() {
        let manifest = "[dependencies]\ntrueup-core.workspace = true\n\
                        [target.'cfg(unix)'.dependencies]\ntrueup-emulator = { workspace = true }\n\
                        [dev-dependencies]\ntrueup-twin.workspace = true\n";
        assert_eq!(
            find_upward_dependencies_in_manifest("cli", manifest),
            ["cli -> emulator (bench)"]
        );
        assert!(find_upward_dependencies_in_manifest("emulator", manifest).is_empty());
    }

    #[test]
    fn a_crate_without_a_layer_is_found() -> Result<()> {
        let root = std::env::temp_dir().join(format!("trueup-layers-{}", std::process::id()));
        for name in ["core", "stranger", "board/link", "board/another"] {
            let folder = root.join("crates").join(name);
            fs::create_dir_all(&folder)?;
            fs::write(folder.join("Cargo.toml"), "")?;
        }
        let found = find_crates_without_layer(&root)?;
        fs::remove_dir_all(&root)?;
        assert_eq!(found, ["crates/board/another", "crates/stranger"]);
        Ok(())
    }
}
