//! Files that are far too large: refused with their place, at once and in little memory.
//!
//! The command runs under the limits that it promises, set by the shell, so that it could not even
//! try: one second of processor time, and 200 MB of memory by address, which is more than what it
//! touches.
#![cfg(unix)]

use std::{
    fs::File,
    io::Write as _,
    process::{Command, Output},
};

use crate::desk::Desk;

const PAPER: &str = include_str!("../../../../../data/paper_spindle.toml");
const GIGABYTE: u64 = 1_000_000_000;

fn limited(desk: &Desk, line: &str) -> Output {
    const SHELL: &str = "ulimit -v 200000 && ulimit -t 1 && exec \"$0\" \"$@\"";
    Command::new("sh")
        .args(["-c", SHELL, env!("CARGO_BIN_EXE_trueup")])
        .args(line.split(' '))
        .current_dir(desk.path("."))
        .output()
        .expect("every Unix has a shell")
}

/// Returns what the command says of a file that it must refuse.
fn refused(desk: &Desk, line: &str) -> String {
    let output = limited(desk, line);
    let stderr = crate::desk::in_one_line(&String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(2), "{line}: {stderr}");
    stderr
}

/// A file that begins with `start` and then holds nothing but zero bytes, without a place on disk.
fn sparse(desk: &Desk, name: &str, start: &str, bytes: u64) {
    let mut file = File::create(desk.path(name)).expect("a writable folder");
    file.write_all(start.as_bytes()).expect("a little room");
    file.set_len(bytes).expect("a file system with sparse files");
}

#[test]
fn a_run_of_ten_gigabytes_or_a_line_of_one_is_refused_with_its_place() {
    let desk = Desk::new(&[("m.toml", PAPER)]);
    sparse(&desk, "long.csv", "sensor_counts\n5048\n", 10 * GIGABYTE);
    sparse(&desk, "line.csv", "sensor_counts\n5048\n", GIGABYTE);
    sparse(&desk, "header.csv", "sensor_counts", GIGABYTE);
    let long = "long.csv:1:1: has 10000000000 bytes, more than the 1024 MiB that are read";
    for (name, phrase) in [
        ("long.csv", long),
        ("line.csv", "line.csv:3:1: the line is longer than 1048576 bytes"),
        ("header.csv", "header.csv:1:1: the line is longer"),
    ] {
        for command in [
            format!("predict --machine m.toml --run {name} -o out.csv"),
            format!("fit elongation --run {name} -o out.toml"),
            format!("diagnose --machine m.toml --run {name} --out out"),
        ] {
            let message = refused(&desk, &command);
            assert!(message.contains(phrase), "{command}: {message}");
        }
    }
}

#[test]
fn a_machine_file_of_ten_gigabytes_or_a_line_of_one_is_refused_with_its_place() {
    let desk = Desk::new(&[("run.csv", "sensor_counts\n5048\n")]);
    sparse(&desk, "long.toml", PAPER, 10 * GIGABYTE);
    sparse(&desk, "line.toml", "name = ", GIGABYTE);
    for name in ["long.toml", "line.toml"] {
        for command in [
            format!("predict --machine {name} --run run.csv -o out.csv"),
            format!("compile {name} -o out.bin"),
            format!("fit elongation --run run.csv --machine {name} -o out.toml"),
            format!("diagnose --machine {name} --run run.csv --out out"),
        ] {
            let message = refused(&desk, &command);
            let phrase = format!("{name}:1:1: has ");
            assert!(message.contains(&phrase), "{command}: {message}");
            assert!(message.contains("more than the 4 MiB that are read"), "{command}: {message}");
        }
    }
}
