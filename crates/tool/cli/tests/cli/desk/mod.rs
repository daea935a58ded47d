//! A temporary folder with files in which `trueup` is run as a user runs it: by the words of a line,
//! with what it prints, leaves there and ends with. Files are named as the user names them, so that no
//! test depends on where the folder lies, and a run that ends with another code than the test says
//! fails with all that it has printed.

use std::{
    fs,
    path::PathBuf,
    process::{Command, Output},
};

use tempfile::TempDir;

/// The folder; it goes with the test.
pub struct Desk(TempDir);

impl Desk {
    /// Returns a folder with these files: name and content.
    pub fn new(files: &[(&str, &str)]) -> Self {
        let desk = Self(tempfile::tempdir().expect("a writable folder for temporary files"));
        for (name, content) in files {
            desk.write(name, content);
        }
        desk
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).unwrap_or_else(|error| panic!("{name}: {error}"));
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Returns the same of a file that must be UTF-8.
    pub fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Returns the names in a folder of this one (`.`: itself), sorted.
    pub fn files(&self, folder: &str) -> Vec<String> {
        let entries = fs::read_dir(self.path(folder)).expect("a readable folder");
        let name = |entry: fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        let mut names: Vec<_> = entries.map(|entry| name(entry.expect("readable"))).collect();
        names.sort();
        names
    }

    /// Runs the tool in this folder with the words of `line`, each parted by one space.
    pub fn trueup(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_trueup"))
            .args(line.split(' '))
            .current_dir(self.0.path())
            // What a load replaces is kept there.
            .env("XDG_STATE_HOME", self.path(".state"))
            // A LinuxCNC that has started the tests would give its own.
            .env_remove("INI_FILE_NAME")
            .output()
            .expect("the tool was built for this test")
    }

    /// Standard output and standard error of a run that must end with `code`; where that is 2, each error in
    /// one line, as [`in_one_line`] has it.
    pub fn run_expecting(&self, line: &str, code: i32) -> (String, String) {
        let output = self.trueup(line);
        let text = |bytes| String::from_utf8(bytes).expect("the tool prints UTF-8");
        let (out, err) = (text(output.stdout), text(output.stderr));
        assert_eq!(output.status.code(), Some(code), "{line}: {out}{err}");
        (out, if code == 2 { in_one_line(&err) } else { err })
    }
}

/// Returns the messages, with `file:line:column: rule` for the error, its place and its line with a caret; the
/// form itself is tested in `check.rs`.
pub fn in_one_line(text: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    for line in text.lines() {
        let before = lines.last().and_then(|line| line.strip_prefix("error: "));
        if let (Some(rule), Some(place)) = (before, line.trim_start().strip_prefix("--> ")) {
            let message = format!("{place}: {rule}");
            lines.pop();
            lines.push(message);
        } else {
            lines.push(line.to_string());
        }
    }
    let is_drawn = |line: &str| {
        let line = line.trim_start_matches([' ', '0', '1', '2', '3', '4', '5', '6', '7', '8', '9']);
        line.starts_with('|') || line.starts_with("= help:")
    };
    // An error without a line of a file has none but its sentence.
    let rest = lines.iter().filter(|line| !is_drawn(line));
    rest.map(|line| line.strip_prefix("error: ").unwrap_or(line).to_string() + "\n").collect()
}
