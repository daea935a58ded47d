//! The book's tutorial is true: each command in it is run, in its order, and prints what stands there.
//!
//! In a block ```` ```console ```` a line `$ trueup …` is a command and what follows its output: standard
//! output, then standard error, then the exit code if it is not 0. A line `…` stands for any lines. A
//! block ```` ```csv NAME ```` is a file. `TRUEUP_WRITE_TUTORIAL=1` writes the page anew where it differs.

use std::{fs, path::Path};

use crate::desk::Desk;

/// What a command prints, as a reader of the page sees it.
fn printed(desk: &Desk, command: &str) -> String {
    let words = command.strip_prefix("trueup ").expect("only this tool is called");
    let output = desk.trueup(words);
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("it prints UTF-8");
    let mut said = text(&output.stdout) + &text(&output.stderr);
    if !output.status.success() {
        said += &format!("(exit code {})\n", output.status.code().expect("not killed"));
    }
    said
}

/// Whether lines are as the page says, where `…` stands for any number of them.
fn fits(page: &[&str], said: &[&str]) -> bool {
    match page.split_first() {
        None => said.is_empty(),
        Some((&"…", rest)) => (0..=said.len()).any(|from| fits(rest, &said[from..])),
        Some((first, rest)) => {
            said.split_first().is_some_and(|(it, said)| it == first && fits(rest, said))
        }
    }
}

#[test]
fn every_command_of_the_tutorial_prints_what_stands_there() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/book/src/tutorial.md");
    let page = fs::read_to_string(&path).expect("the page is there");
    let desk = Desk::new(&[]);
    let (mut anew, mut wrong, mut commands) = (String::new(), Vec::new(), 0);
    let mut lines = page.lines().peekable();
    while let Some(line) = lines.next() {
        anew += &format!("{line}\n");
        let Some(kind) = line.strip_prefix("```").filter(|kind| !kind.is_empty()) else { continue };
        let mut body = Vec::new();
        while let Some(line) = lines.next_if(|line| *line != "```") {
            body.push(line);
        }
        if let Some(name) = kind.strip_prefix("csv ") {
            desk.write(name, body.join("\n") + "\n");
        }
        if kind != "console" {
            anew.extend(body.iter().map(|line| format!("{line}\n")));
            continue;
        }
        let command = body[0].strip_prefix("$ ").expect("a block begins with its command");
        let said = printed(&desk, command);
        commands += 1;
        anew += &format!("{}\n", body[0]);
        if fits(&body[1..], &said.lines().collect::<Vec<_>>()) {
            anew.extend(body[1..].iter().map(|line| format!("{line}\n")));
        } else {
            wrong.push(format!("$ {command}\n{said}"));
            anew += &said;
        }
    }
    if std::env::var_os("TRUEUP_WRITE_TUTORIAL").is_some() {
        fs::write(&path, anew).expect("the page can be written");
        return;
    }
    assert!(commands >= 8, "{commands} commands");
    assert!(
        wrong.is_empty(),
        "the page says something else (TRUEUP_WRITE_TUTORIAL=1 mends it):\n{}",
        wrong.join("\n")
    );
}
