//! Puts offsets into a configuration, and takes them out again.
//!
//! Setup adds whole lines between `SETUP_BLOCK_BEGIN` and `SETUP_BLOCK_END` and two HAL files; everything else stays identical to the byte,
//! also a last line without an end, and line ends of DOS. So taking them out needs no copy, and edits that were made
//! meanwhile survive. A copy of each file as it was before the first setup is kept all the same.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use trueup_machine::{
    InputFileError, Location, bounded_read, machine_file::MAX_MACHINE_FILE_BYTES,
};
use trueup_store::calibration::validate_blob;

use super::{
    OffsetEntryPoint,
    boardless_config::{CALIBRATION_FILE, THERMAL_STATE_FILE},
    check::{CheckReport, check},
    finding::{ConfigurationFinding, OffsetRequirements},
    hal_files::HalFiles,
    ini_file::{IniFile, SETUP_BLOCK_BEGIN, SETUP_BLOCK_END, is_file},
    installed_setup::{BridgeSettings, TRUEUP_INI_SECTION, find_manual_setup},
    joints::{compute_offset_av_ratio, read_joints},
    wiring::{self, COMPONENT_HAL_FILE, GENERATED_FILE_HEADER, REALTIME_HAL_FILE},
};
use crate::ini_settings::IniSettings;

/// Added to the name of a file for its copy.
const BACKUP_SUFFIX: &str = ".trueup-backup";

/// A file that changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileChange {
    /// Its path.
    pub path: PathBuf,
    /// Its new content; `None`: it is removed.
    pub content: Option<Vec<u8>>,
}

/// Returns the report of the check, and the files that setup changes; none if they are as they should be, or if the
/// report has an error.
///
/// # Errors
/// A file cannot be read.
pub fn prepare_setup(
    ini: &IniFile,
    hal: &HalFiles,
    demand: &OffsetRequirements,
    bridge: &BridgeSettings,
) -> Result<(CheckReport, Vec<FileChange>), InputFileError> {
    let mut report = check(ini, hal, demand);
    if let Some((place, _)) = find_manual_setup(ini, hal) {
        report.findings.push(ConfigurationFinding::error(
            place,
            "the component is connected by hand already",
            "take [TRUEUP] and its HALFILE lines out first, or go on by hand",
        ));
    }
    let has_file = demand.no_board.is_some();
    let calibration =
        has_file.then(|| absolute_path_in_ini_folder(ini, CALIBRATION_FILE).display().to_string());
    for (what, text) in [
        ("port", bridge.port.as_ref()),
        ("path", bridge.machine.as_ref()),
        ("path", calibration.as_ref()),
    ] {
        if let Some(text) = text.filter(|text| text.contains(char::is_whitespace)) {
            report.findings.push(ConfigurationFinding::error(
                Location::start_of_file(ini.path()),
                format!("the {what} \"{text}\" has a blank, at which a HAL file would cut it"),
                "use one without blanks: rename it, or make a link to it",
            ));
        }
    }
    for name in [REALTIME_HAL_FILE, COMPONENT_HAL_FILE] {
        let path = ini.folder().join(name);
        if is_file(&path) && !is_written_by_setup(&path)? {
            report.findings.push(ConfigurationFinding::error(
                Location::start_of_file(&path),
                "this file was not written by setup, which needs its name",
                "move or rename it",
            ));
        }
    }
    if !report.is_usable() {
        return Ok((report, Vec::new()));
    }
    // Usable: both are there.
    let joints = read_joints(ini)?;
    let wiring = wiring::generate_hal_files(ini, hal, &joints, demand)
        .map_err(|findings| error_from_first_finding(ini, &findings))?;
    let mut blocks = InsertedBlocks::default();
    if let Some(line) = &hal.last_line {
        let lines = [REALTIME_HAL_FILE, COMPONENT_HAL_FILE].map(|name| format!("HALFILE = {name}"));
        blocks.insert_after(line, lines.to_vec());
    }
    if demand.entry == OffsetEntryPoint::Eoffset {
        add_missing_offset_av_ratios(ini, demand, &mut blocks)?;
    }
    let mut section =
        vec![format!("[{TRUEUP_INI_SECTION}]"), format!("BY = {}", demand.entry.name())];
    section.extend(bridge.port.iter().map(|port| format!("PORT = {port}")));
    section.extend(bridge.machine.iter().map(|machine| format!("MACHINE = {machine}")));
    match demand.no_board {
        // LinuxCNC may be started from anywhere.
        Some(_) => section.extend([
            format!(
                "CALIBRATION = {}",
                absolute_path_in_ini_folder(ini, CALIBRATION_FILE).display()
            ),
            format!("HEAT = {}", absolute_path_in_ini_folder(ini, THERMAL_STATE_FILE).display()),
        ]),
        None => section.push(format!("POSITION_PERIOD_MS = {}", bridge.position_period_ms)),
    }
    blocks.at_end.insert(ini.path().to_path_buf(), section);
    let mut changes = blocks.compute_changes(ini)?;
    for (name, text) in
        [(REALTIME_HAL_FILE, wiring.realtime), (COMPONENT_HAL_FILE, wiring.component)]
    {
        let path = ini.folder().join(name);
        if !is_file(&path) || bounded_read::read_text(&path, MAX_MACHINE_FILE_BYTES)? != text {
            changes.push(FileChange { path, content: Some(text.into_bytes()) });
        }
    }
    changes.extend(compute_calibration_change(
        ini,
        demand.no_board.as_ref().map(|boardless| &boardless.blob),
    )?);
    Ok((report, changes))
}

/// Returns the files that change when setup's lines are taken out.
///
/// # Errors
/// A file cannot be read.
pub fn prepare_removal(ini: &IniFile) -> Result<Vec<FileChange>, InputFileError> {
    let mut changes = InsertedBlocks::default().compute_changes(ini)?;
    for name in [REALTIME_HAL_FILE, COMPONENT_HAL_FILE] {
        let path = ini.folder().join(name);
        if is_file(&path) && is_written_by_setup(&path)? {
            changes.push(FileChange { path, content: None });
        }
    }
    changes.extend(compute_calibration_change(ini, None)?);
    let heat = absolute_path_in_ini_folder(ini, THERMAL_STATE_FILE);
    if is_file(&heat) {
        changes.push(FileChange { path: heat, content: None });
    }
    Ok(changes)
}

/// Returns the whole path of a file next to the INI file.
fn absolute_path_in_ini_folder(ini: &IniFile, name: &str) -> PathBuf {
    let folder = ini.folder();
    std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_path_buf()).join(name)
}

/// Returns the change of the calibration's file, if it has to change. A file that is no calibration is not ours.
fn compute_calibration_change(
    ini: &IniFile,
    blob: Option<&Vec<u8>>,
) -> Result<Option<FileChange>, InputFileError> {
    let path = absolute_path_in_ini_folder(ini, CALIBRATION_FILE);
    let before = if is_file(&path) {
        Some(bounded_read::read(&path, MAX_MACHINE_FILE_BYTES)?)
    } else {
        None
    };
    if before.as_ref() == blob
        || before.as_ref().is_some_and(|before| validate_blob(before).is_err())
    {
        return Ok(None);
    }
    Ok(Some(FileChange { path, content: blob.cloned() }))
}

fn error_from_first_finding(ini: &IniFile, findings: &[ConfigurationFinding]) -> InputFileError {
    let first = findings.first().cloned();
    let first = first
        .map(|finding| InputFileError::new(finding.place, finding.what).with_help(finding.help));
    first.unwrap_or_else(|| {
        InputFileError::new(Location::start_of_file(ini.path()), "it cannot be set up")
    })
}

fn is_written_by_setup(path: &Path) -> Result<bool, InputFileError> {
    Ok(bounded_read::read_text(path, MAX_MACHINE_FILE_BYTES)?.lines().next()
        == Some(GENERATED_FILE_HEADER))
}

/// `OFFSET_AV_RATIO` of each axis that states none.
fn add_missing_offset_av_ratios(
    ini: &IniFile,
    demand: &OffsetRequirements,
    blocks: &mut InsertedBlocks,
) -> Result<(), InputFileError> {
    let base = IniSettings::parse(&ini.to_text()).map_err(|error| {
        InputFileError::new(ini.line_location(error.place.0, error.place.1), error.rule)
    })?;
    let joints = read_joints(ini)?;
    for (axis, motion) in base.axes.iter().enumerate() {
        let section = format!("AXIS_{}", ["X", "Y", "Z"][axis]);
        let stated = ini.value(&section, "OFFSET_AV_RATIO").is_some_and(|value| !value.is_ours);
        let header = ini.find_section_header(&section);
        let is_there = joints.iter().any(|joint| joint.axis == axis);
        if let (true, false, Some(header)) = (is_there, stated, header)
            && let Some(ratio) =
                compute_offset_av_ratio(motion.velocity_mm_per_s, demand.slew_um_per_s)
        {
            blocks.insert_after(&header, vec![format!("OFFSET_AV_RATIO = {ratio:.6}")]);
        }
    }
    Ok(())
}

/// Lines to be added to files.
#[derive(Debug, Default)]
struct InsertedBlocks {
    after: BTreeMap<PathBuf, BTreeMap<usize, Vec<String>>>,
    at_end: BTreeMap<PathBuf, Vec<String>>,
}

impl InsertedBlocks {
    fn insert_after(&mut self, place: &Location, lines: Vec<String>) {
        self.after.entry(place.file.clone()).or_default().insert(place.line, lines);
    }

    /// Returns the files that change: what setup had added goes, and these blocks come.
    fn compute_changes(&self, ini: &IniFile) -> Result<Vec<FileChange>, InputFileError> {
        let mut changes = Vec::new();
        for path in ini.files() {
            let before = bounded_read::read_text(&path, MAX_MACHINE_FILE_BYTES)?;
            let none = BTreeMap::new();
            let after = self.after.get(&path).unwrap_or(&none);
            let text = replace_blocks(&before, after, self.at_end.get(&path));
            if text == before {
                continue;
            }
            let mut copy = path.clone().into_os_string();
            copy.push(BACKUP_SUFFIX);
            if !before.contains(SETUP_BLOCK_BEGIN) {
                changes.push(FileChange { path: copy.into(), content: Some(before.into_bytes()) });
            }
            changes.push(FileChange { path, content: Some(text.into_bytes()) });
        }
        Ok(changes)
    }
}

/// Returns the text without what setup had added and with these blocks after the lines with these numbers.
fn replace_blocks(
    text: &str,
    after: &BTreeMap<usize, Vec<String>>,
    at_end: Option<&Vec<String>>,
) -> String {
    let end_of_line = if text.contains("\r\n") { "\r\n" } else { "\n" };
    let mut new = String::with_capacity(text.len());
    let block = |new: &mut String, lines: &[String]| {
        let all = std::iter::once(SETUP_BLOCK_BEGIN)
            .chain(lines.iter().map(String::as_str))
            .chain([SETUP_BLOCK_END]);
        all.for_each(|line| new.extend([line, end_of_line]));
    };
    let mut is_ours = false;
    for (index, line) in text.split_inclusive('\n').enumerate() {
        is_ours |= line.trim_end() == SETUP_BLOCK_BEGIN;
        if !is_ours {
            new.push_str(line);
            if !line.ends_with('\n') {
                new.push_str(end_of_line);
            }
            if let Some(lines) = after.get(&(index + 1)) {
                block(&mut new, lines);
            }
        }
        is_ours &= line.trim_end() != SETUP_BLOCK_END;
    }
    if let Some(lines) = at_end {
        block(&mut new, lines);
    }
    if !text.ends_with('\n') && new.ends_with(end_of_line) {
        new.truncate(new.len() - end_of_line.len());
    }
    new
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(lines: &[&str]) -> Vec<String> {
        lines.iter().map(|line| (*line).to_owned()).collect()
    }

    #[test]
    fn a_text_is_the_same_to_the_byte_when_its_blocks_are_gone() {
        for text in [
            "[A]\nX = 1\n[B]\n",
            "[A]\nX = 1",
            "[A]\r\nX = 1\r\n\r\n[B]",
            "[A]\n\n\n",
            "a\n  [HAL] \nX=\t1\n\n",
        ] {
            let after: BTreeMap<usize, Vec<String>> =
                [(1, block(&["one", "two"])), (2, block(&["three"]))].into();
            let end = block(&["[END]"]);
            let with = replace_blocks(text, &after, Some(&end));
            assert!(with.contains("two") && with.contains("[END]"), "{with}");
            assert_eq!(replace_blocks(&with, &BTreeMap::new(), None), text);
            assert_eq!(with.ends_with('\n'), text.ends_with('\n'));
        }
    }

    #[test]
    fn edits_next_to_the_blocks_survive() {
        let with = replace_blocks("[A]\nX = 1\n", &[(2, block(&["ours"]))].into(), None);
        let edited = format!("# new\n{with}Y = 2\n");
        assert_eq!(replace_blocks(&edited, &BTreeMap::new(), None), "# new\n[A]\nX = 1\nY = 2\n");
    }
}
