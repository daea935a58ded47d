//! The book's tutorial is true: each command in it is run, in its order and in one folder, and prints what stands there.
//!
//! How a page writes commands, what they print, another exit code than 0 and lines left out is
//! [trycmd](https://docs.rs/trycmd)'s. Next to the page are the files that it begins with (`tutorial.in`), and a folder
//! that lets the commands write, in a copy of them (`tutorial.out`). Where the page says something else,
//! `TRYCMD=overwrite cargo test -p trueup-cli tutorial` mends it.

use std::{fs, path::Path};

use trycmd::TestCases;

#[test]
fn every_command_of_the_tutorial_prints_what_stands_there() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/book/src/tutorial.md");
    // trycmd passes over a program that it does not know, and a page without commands.
    let text = fs::read_to_string(&page).expect("the page is there");
    let commands: Vec<&str> = text.lines().filter(|line| line.starts_with("$ ")).collect();
    assert!(commands.len() >= 8, "{commands:#?}");
    assert!(commands.iter().all(|line| line.starts_with("$ trueup ")), "{commands:#?}");
    TestCases::new()
        .register_bin("trueup", Path::new(env!("CARGO_BIN_EXE_trueup")))
        .env("NO_COLOR", "1")
        .case(&page);
}
