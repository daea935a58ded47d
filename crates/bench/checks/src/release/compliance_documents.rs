//! Papers for the seller of a product, next to the program: parts lists, licences, known vulnerabilities, templates of
//! declarations. Each by the tool that is kept for it; what cannot be had here is named.

use std::{fs, path::Path, process::Command};

use anyhow::{Context as _, Result};
use trueup_emulator::{process, setup};

use super::reproducible_build;
use crate::{cargo, supply_chain};

/// The versions that options and templates are written for.
const CARGO_CYCLONEDX_VERSION: &str = "0.5.9";
const CARGO_ABOUT_VERSION: &str = "0.9.3";

/// A product that is built of other people's crates: its name, the folder of its package, and what it is built for.
struct Product {
    name: &'static str,
    package: &'static str,
    target: &'static str,
    features: &'static [&'static str],
}

const PRODUCTS: [Product; 2] = [
    Product {
        name: "trueup-host",
        package: "crates/tool/cli",
        target: "x86_64-unknown-linux-gnu",
        features: &[],
    },
    Product {
        name: "trueup-firmware",
        package: ".",
        target: setup::TARGET_TRIPLE,
        features: &["--no-default-features", "--features", "stm32f405"],
    },
];

/// Papers that stand in the project, copied for users who get only the release.
const COPIED_DOCUMENTS: [&str; 4] = [
    "SECURITY.md",
    "CHANGELOG.md",
    "docs/declarations/eu-declaration-of-conformity-cra.md",
    "docs/declarations/eu-declaration-of-incorporation.md",
];

/// Writes all papers of the clone `source`, in which tools may leave what they like, and returns a sentence for each
/// that is missing.
///
/// # Errors
/// A tool cannot be built or fails.
pub(super) fn write_documents(source: &Path, folder: &Path) -> Result<Vec<String>> {
    let mut fetch = cargo::locked_cargo_command("fetch");
    process::run(fetch.arg("--quiet").current_dir(source))?;
    for product in &PRODUCTS {
        write_sbom(product, source, folder)?;
        write_licences(product, source, folder)?;
    }
    for text in COPIED_DOCUMENTS {
        let name = Path::new(text).file_name().context("a paper has a name")?;
        fs::copy(source.join(text), folder.join(name)).with_context(|| text.to_owned())?;
    }
    let (advisories, missing) = supply_chain::build_vulnerability_report()?;
    fs::write(folder.join("vulnerabilities.txt"), advisories)?;
    Ok(missing.into_iter().collect())
}

/// Writes the parts list (SBOM) in CycloneDX's JSON.
fn write_sbom(product: &Product, source: &Path, folder: &Path) -> Result<()> {
    let Product { name, package, target, features } = product;
    let mut command =
        Command::new(cargo::install_tool("cargo-cyclonedx", CARGO_CYCLONEDX_VERSION)?);
    command.args(["cyclonedx", "--quiet", "--format", "json", "--spec-version", "1.5"]);
    command.args(["--target", target, "--override-filename", name]).args(*features);
    command.arg("--manifest-path").arg(source.join(package).join("Cargo.toml"));
    command.env("SOURCE_DATE_EPOCH", reproducible_build::commit_unix_seconds()?.to_string());
    process::run(command.current_dir(source.join(package)))?;
    let made = source.join(package).join(name).with_extension("json");
    let text = fs::read_to_string(&made).with_context(|| made.display().to_string())?;
    // As the paths in the programs.
    let text = text.replace(&source.display().to_string(), "/trueup");
    Ok(fs::write(folder.join(format!("{name}.cdx.json")), text)?)
}

/// Writes the licences of the parts, with their texts.
fn write_licences(product: &Product, source: &Path, folder: &Path) -> Result<()> {
    let Product { name, package, target, features } = product;
    let mut command = Command::new(cargo::install_release_tool(
        "cargo-about",
        CARGO_ABOUT_VERSION,
        &["--features", "cli"],
    )?);
    // Nothing is asked for over the network: the texts are those of the crates.
    command.args(["generate", "--frozen", "--fail", "--target", target]).args(*features);
    command.arg("--manifest-path").arg(source.join(package).join("Cargo.toml"));
    command.arg("--config").arg(source.join("about.toml"));
    command.arg("--output-file").arg(folder.join(format!("{name}-licences.txt")));
    command.arg(source.join("crates/bench/checks/src/release/licences.hbs"));
    process::run(command.current_dir(source))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the quoted words of a list in a TOML file.
    fn list(text: &str, key: &str) -> Vec<String> {
        let (_, rest) = text.split_once(&format!("\n{key} = [")).expect("the list is there");
        let (list, _) = rest.split_once(']').expect("it ends");
        list.split('"').skip(1).step_by(2).map(str::to_owned).collect()
    }

    #[test]
    fn the_licences_that_are_listed_are_those_that_are_allowed() {
        let read = |name: &str| {
            std::fs::read_to_string(setup::project_root().join(name))
                .expect("a file of the project")
        };
        assert_eq!(list(&read("about.toml"), "accepted"), list(&read("deny.toml"), "allow"));
    }
}
