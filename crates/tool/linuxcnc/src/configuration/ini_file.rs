//! The lines of an INI file with their places, as LinuxCNC reads them.
//!
//! Measured with `inivar` and the script `linuxcnc` of 2.9: only the first section of a name counts; within it the first
//! line of a key wins, except for keys that may repeat (`HALFILE`); `#INCLUDE file` at the beginning of a line of the
//! INI file itself is replaced by that file, whose own `#INCLUDE` lines are comments.
//!
//! Lines between `SETUP_BLOCK_BEGIN` and `SETUP_BLOCK_END` are those of `trueup linuxcnc setup`.

use std::{
    fs,
    path::{Path, PathBuf},
};

use trueup_machine::{
    InputFileError, Location, bounded_read, machine_file::MAX_MACHINE_FILE_BYTES,
};

/// The first line of what setup has added.
pub(crate) const SETUP_BLOCK_BEGIN: &str =
    "# >>> trueup linuxcnc setup; --remove takes these lines out";
/// The last line of what setup has added.
pub(crate) const SETUP_BLOCK_END: &str = "# <<< trueup linuxcnc setup";
const INCLUDE_DIRECTIVE: &str = "#INCLUDE";

/// A line of an INI file.
#[derive(Clone, Debug, PartialEq, Eq)]
struct IniLine {
    place: Location,
    text: String,
    is_ours: bool,
}

/// A value with its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IniValue {
    /// Text without surrounding blanks.
    pub text: String,
    /// Place of the value.
    pub place: Location,
    /// True if `trueup linuxcnc setup` has written the line.
    pub is_ours: bool,
}

impl IniValue {
    /// Returns the words before a comment.
    #[must_use]
    pub(crate) fn without_comment(&self) -> &str {
        self.text.split(['#', ';']).next().unwrap_or_default().trim()
    }
}

/// An INI file with the files that it includes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IniFile {
    path: PathBuf,
    lines: Vec<IniLine>,
}

impl IniFile {
    /// Reads the file and what it includes.
    ///
    /// # Errors
    /// A file cannot be read, or a line of setup's block is missing.
    pub fn read(path: &Path) -> Result<Self, InputFileError> {
        let mut lines = Vec::new();
        for line in read_lines(path)? {
            let Some(rest) = line.text.strip_prefix(INCLUDE_DIRECTIVE) else {
                lines.push(line);
                continue;
            };
            let name = rest.trim();
            if name.is_empty() {
                return Err(InputFileError::new(line.place, "#INCLUDE names no file"));
            }
            let included = parent_folder(path).join(expand_home(name));
            let read = read_lines(&included).map_err(|error| {
                InputFileError::new(line.place.clone(), format!("#INCLUDE {name}: {}", error.rule))
                    .with_help("give the path of the file, or take the line out")
            })?;
            lines.extend(read);
        }
        Ok(Self { path: path.to_path_buf(), lines })
    }

    /// Returns the path of the INI file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the folder of the INI file, where LinuxCNC runs.
    #[must_use]
    pub fn folder(&self) -> &Path {
        parent_folder(&self.path)
    }

    /// Returns the whole text, with included files in their places.
    #[must_use]
    pub fn to_text(&self) -> String {
        self.lines.iter().flat_map(|line| [line.text.as_str(), "\n"]).collect()
    }

    /// Returns the place of a line of [`IniFile::to_text`], counted from 1, with this column.
    #[must_use]
    pub fn line_location(&self, line: usize, column: usize) -> Location {
        let place = line.checked_sub(1).and_then(|index| self.lines.get(index));
        let start = || Location::start_of_file(&self.path);
        place.map_or_else(start, |line| Location { column, ..line.place.clone() })
    }

    /// Returns the lines of the first section of this name, without its header.
    fn section_lines(&self, section: &str) -> impl Iterator<Item = &IniLine> {
        let is_header = |line: &&IniLine| parse_section_header(&line.text).is_some();
        let is_this = move |line: &&IniLine| parse_section_header(&line.text) == Some(section);
        let start = self.lines.iter().position(|line| is_this(&line)).map(|index| index + 1);
        let start = start.unwrap_or(self.lines.len());
        self.lines[start..].iter().take_while(move |line| !is_header(line))
    }

    /// Returns every value of a key that may repeat.
    pub fn values(&self, section: &str, key: &str) -> Vec<IniValue> {
        self.section_lines(section).filter_map(|line| parse_value(line, key)).collect()
    }

    /// Returns the value of a key.
    #[must_use]
    pub fn value(&self, section: &str, key: &str) -> Option<IniValue> {
        self.section_lines(section).find_map(|line| parse_value(line, key))
    }

    /// Returns the number of a key.
    ///
    /// # Errors
    /// It is not a number.
    pub fn number(
        &self,
        section: &str,
        key: &str,
    ) -> Result<Option<(f64, Location)>, InputFileError> {
        let Some(value) = self.value(section, key) else { return Ok(None) };
        let text = value.without_comment();
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        let Some(number) = number else {
            let rule = format!("[{section}]{key} = {text} is not a number");
            return Err(InputFileError::new(value.place, rule));
        };
        Ok(Some((number, value.place)))
    }

    /// Returns the place of a section's header; the start of the file if there is none.
    #[must_use]
    pub(crate) fn section_location(&self, section: &str) -> Location {
        self.find_section_header(section).unwrap_or_else(|| Location::start_of_file(&self.path))
    }

    /// Returns the place of a section's header.
    #[must_use]
    pub(crate) fn find_section_header(&self, section: &str) -> Option<Location> {
        let line = self.lines.iter().find(|line| parse_section_header(&line.text) == Some(section));
        line.map(|line| line.place.clone())
    }

    /// Returns a second section of a name whose first one counts alone.
    #[must_use]
    pub(crate) fn find_duplicate_section(&self, section: &str) -> Option<Location> {
        let same =
            self.lines.iter().filter(|line| parse_section_header(&line.text) == Some(section));
        same.skip(1).map(|line| line.place.clone()).next()
    }

    /// Returns the files that the lines come from, each once, the INI file first.
    #[must_use]
    pub fn files(&self) -> Vec<PathBuf> {
        let mut files = vec![self.path.clone()];
        for line in &self.lines {
            if !files.contains(&line.place.file) {
                files.push(line.place.file.clone());
            }
        }
        files
    }
}

/// Returns the folder of a file, `.` for a bare name.
#[must_use]
pub(crate) fn parent_folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// Replaces a leading `~/` by the user's home, as LinuxCNC does.
#[must_use]
pub fn expand_home(name: &str) -> PathBuf {
    let home = std::env::var_os("HOME").map(PathBuf::from);
    match (name.strip_prefix("~/"), home) {
        (Some(rest), Some(home)) => home.join(rest),
        _ => PathBuf::from(name),
    }
}

/// Returns true if a file is there.
#[must_use]
pub fn is_file(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| metadata.is_file())
}

fn read_lines(path: &Path) -> Result<Vec<IniLine>, InputFileError> {
    let text = bounded_read::read_text(path, MAX_MACHINE_FILE_BYTES)?;
    let mut lines = Vec::new();
    let mut begun: Option<Location> = None;
    for (index, text) in text.lines().enumerate() {
        let place = Location { file: path.to_path_buf(), line: index + 1, column: 1 };
        if text.trim_end() == SETUP_BLOCK_BEGIN {
            begun = Some(place.clone());
        }
        lines.push(IniLine { place, text: text.to_owned(), is_ours: begun.is_some() });
        if text.trim_end() == SETUP_BLOCK_END {
            begun = None;
        }
    }
    match begun {
        Some(place) => Err(InputFileError::new(place, format!("the line \"{SETUP_BLOCK_END}\" is missing after this one"))
            .with_help("put it after the lines that setup has added, or restore the file from its backup, FILE.trueup-backup")),
        None => Ok(lines),
    }
}

/// Returns the name of a section, if the line is its header.
fn parse_section_header(line: &str) -> Option<&str> {
    line.trim_start().strip_prefix('[')?.split(']').next().map(str::trim)
}

fn parse_value(line: &IniLine, key: &str) -> Option<IniValue> {
    if line.text.trim_start().starts_with(['#', ';']) {
        return None;
    }
    let (name, value) = line.text.split_once('=')?;
    if name.trim() != key {
        return None;
    }
    let blanks = value.chars().take_while(|character| character.is_whitespace()).count();
    let column = name.chars().count() + 2 + blanks;
    let place = Location { column, ..line.place.clone() };
    Some(IniValue { text: value.trim().to_owned(), place, is_ours: line.is_ours })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(files: &[(&str, &str)]) -> Result<(tempfile::TempDir, IniFile), InputFileError> {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, text) in files {
            fs::write(folder.path().join(name), text).expect("writes");
        }
        IniFile::read(&folder.path().join(files[0].0)).map(|lines| (folder, lines))
    }

    #[test]
    fn the_first_section_counts_and_an_included_file_keeps_its_own_places() {
        let main = "[A]\nX = 7 # seven\n#INCLUDE b.inc\n[A]\nY = 1\n";
        let (_folder, ini) =
            read(&[("m.ini", main), ("b.inc", "Z = 3\n[B]\n  K=  v w\n")]).expect("reads");
        assert_eq!(ini.number("A", "X").expect("a number").map(|number| number.0), Some(7.0));
        assert_eq!(ini.value("A", "Y"), None, "LinuxCNC reads the first [A] alone");
        let z = ini.value("A", "Z").expect("included");
        assert_eq!((z.place.line, z.place.file.ends_with("b.inc")), (1, true));
        let k = ini.value("B", "K").expect("included");
        assert_eq!((k.text.as_str(), k.place.line, k.place.column), ("v w", 3, 7));
        assert!(
            ini.find_duplicate_section("A").is_some() && ini.find_duplicate_section("B").is_none()
        );
    }

    #[test]
    fn a_missing_include_and_an_unfinished_block_are_refused_with_their_place() {
        let error = read(&[("m.ini", "[A]\n#INCLUDE none.inc\n")]).expect_err("not there");
        assert!((error.place.line, error.rule.contains("none.inc")) == (2, true), "{error}");
        let error =
            read(&[("m.ini", &format!("[A]\n{SETUP_BLOCK_BEGIN}\nX = 1\n"))]).expect_err("no end");
        assert_eq!(error.place.line, 2);
        let error = read(&[("m.ini", "[A]\nX = much\n")]).expect("reads").1.number("A", "X");
        assert_eq!(error.expect_err("no number").place.column, 5);
    }
}
