//! On which calibration a bridge may be engaged: the one that a machine file makes, or the one of the first contact,
//! which a state file keeps. A calibration that was loaded while the control was away is not engaged.

use std::{
    ffi::OsString,
    fs::{self, File},
    io::{ErrorKind, Write as _},
    path::{Path, PathBuf},
};

/// First word of a state file, which distinguishes it from any other file.
const STATE_FILE_MAGIC: &str = "trueup-calibration";

/// The calibrations on which a bridge may be engaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CalibrationPolicy {
    /// A bridge on any calibration.
    Any,
    /// A bridge that runs on what this machine file makes.
    Machine {
        /// CRC of what the file compiles to.
        crc: u32,
        /// The file.
        path: PathBuf,
    },
    /// A bridge that runs on what it ran on when it was met for the first time.
    FirstContact(PathBuf),
}

/// The rule, what is known of the bridge, and what follows from both.
#[derive(Clone, Debug)]
pub struct PinnedCalibration {
    rule: CalibrationPolicy,
    expected: Result<Option<u32>, String>,
    running: Option<u32>,
}

impl PinnedCalibration {
    /// Returns the rule with what its state file holds. A state file that is damaged or cannot be read is
    /// no first contact: nothing is engaged then.
    #[must_use]
    pub fn new(rule: CalibrationPolicy) -> Self {
        let expected = match &rule {
            CalibrationPolicy::Any => Ok(None),
            CalibrationPolicy::Machine { crc, .. } => Ok(Some(*crc)),
            CalibrationPolicy::FirstContact(path) => read_state_file(path),
        };
        Self { rule, expected, running: None }
    }

    /// Takes the CRC that the bridge says it runs on (0: on none), and returns the sentence for the user, if this
    /// is news. A first contact is written down, before anything is engaged.
    pub fn update_running_crc(&mut self, running: Option<u32>) -> Option<String> {
        if running == self.running {
            return None;
        }
        self.running = running;
        let running = running.filter(|crc| *crc != 0)?;
        if let (CalibrationPolicy::FirstContact(path), Ok(None)) = (&self.rule, &self.expected) {
            self.expected = write_state_file(path, running).map(|()| Some(running));
            if self.expected.is_ok() {
                return Some(format!(
                    "first contact: the bridge runs on the calibration {running:08x}, which is noted in {}; no other is \
                     engaged from now on",
                    path.display()
                ));
            }
        }
        self.refusal()
    }

    /// Returns whether the bridge may be engaged.
    #[must_use]
    pub fn is_engage_allowed(&self) -> bool {
        self.rule == CalibrationPolicy::Any
            || matches!(self.expected, Ok(Some(crc)) if self.running == Some(crc))
    }

    /// Returns whether it is known that the bridge may not be engaged: it runs on another calibration, or what it
    /// should run on cannot be known.
    #[must_use]
    pub fn is_engage_refused(&self) -> bool {
        self.refusal().is_some()
    }

    /// Returns the CRC that the bridge has to run on, as far as one is known.
    #[must_use]
    pub fn expected_crc(&self) -> Option<u32> {
        self.expected.clone().ok().flatten()
    }

    /// Returns why nothing is engaged and what to do, if that does not depend on what the bridge has yet to say.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        let expected = match &self.expected {
            Err(why) => return Some(format!("nothing is engaged: {why}")),
            Ok(expected) => (*expected)?,
        };
        let running = self.running.filter(|crc| *crc != expected)?;
        let runs = match running {
            0 => "the bridge runs on no calibration".into(),
            crc => format!("the bridge runs on the calibration {crc:08x}"),
        };
        Some(match &self.rule {
            CalibrationPolicy::Any => return None,
            CalibrationPolicy::Machine { path, .. } => format!(
                "nothing is engaged: {runs}, {} makes {expected:08x}: load it (trueup bridge load), or name the \
                 right file, or give --any-calibration",
                path.display()
            ),
            CalibrationPolicy::FirstContact(path) => format!(
                "nothing is engaged: {runs}, at the first contact it was {expected:08x} ({}). If the change is yours, \
                 delete that file and start again; if not, load the right one (trueup bridge load)",
                path.display()
            ),
        })
    }
}

/// Returns where a gateway keeps the calibration of the bridge on this port, unless stated otherwise: in the
/// folder that systemd, the desktop or the user's home has for states, else in the present one.
#[must_use]
pub fn default_state_path(port: &str, variable: impl Fn(&str) -> Option<OsString>) -> PathBuf {
    let folder = state_folder(variable).unwrap_or_default();
    let plain = |letter: char| if letter.is_ascii_alphanumeric() { letter } else { '-' };
    folder.join(format!("gateway-{}.calibration", port.chars().map(plain).collect::<String>()))
}

/// Returns the folder that systemd, the desktop or the user's home has for states; `None`: none of them has one.
pub(crate) fn state_folder(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let of = |name: &str, below: &str| {
        variable(name)
            .filter(|value| !value.is_empty())
            .map(|value| PathBuf::from(value).join(below))
    };
    of("STATE_DIRECTORY", "")
        .or_else(|| of("XDG_STATE_HOME", "trueup"))
        .or_else(|| of("HOME", ".local/state/trueup"))
        .or_else(|| of("LOCALAPPDATA", "trueup"))
}

/// Returns the CRC in a state file; `None` where there is no file.
fn read_state_file(path: &Path) -> Result<Option<u32>, String> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => {
            return Err(format!("the state file {} cannot be read: {error}", path.display()));
        }
    };
    let words: Vec<&str> = text.split_whitespace().collect();
    match words[..] {
        [STATE_FILE_MAGIC, crc] if crc.len() == 8 => u32::from_str_radix(crc, 16).ok(),
        _ => None,
    }
    .filter(|crc| *crc != 0)
    .map(Some)
    .ok_or_else(|| {
        format!(
            "the state file {} is damaged. Find out on which calibration the bridge runs (trueup bridge info); if it \
             is yours, delete the file and start again",
            path.display()
        )
    })
}

/// Writes a state file so that it is whole or not there, whenever the power goes.
fn write_state_file(path: &Path, crc: u32) -> Result<(), String> {
    let adjacent = path.with_extension("new");
    let write = || {
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder)?;
        }
        let mut file = File::create(&adjacent)?;
        writeln!(file, "{STATE_FILE_MAGIC} {crc:08x}")?;
        file.sync_all()?;
        fs::rename(&adjacent, path)
    };
    write().map_err(|error| {
        format!(
            "the state file {} cannot be written: {error}. Name one that can by --state",
            path.display()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const OURS: u32 = 0x1234_ABCD;
    const OTHER: u32 = 0x0000_4321;

    #[test]
    fn the_first_contact_is_pinned_and_the_next_start_remembers_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("deeper/calibration.state");
        let start = || PinnedCalibration::new(CalibrationPolicy::FirstContact(path.clone()));
        let mut first = start();
        assert!(!first.is_engage_allowed() && !first.is_engage_refused(), "nothing is known yet");
        assert_eq!(first.update_running_crc(None), None);
        assert_eq!(first.update_running_crc(Some(0)), None, "no calibration is none to be pinned");
        assert!(!first.is_engage_allowed() && !path.exists());
        let notices = first.update_running_crc(Some(OURS)).expect("news");
        assert!(notices.contains("first contact") && notices.contains("1234abcd"), "{notices}");
        assert!(first.is_engage_allowed() && first.update_running_crc(Some(OURS)).is_none());
        // The bridge is away for a while, and back with another.
        assert_eq!(first.update_running_crc(None), None);
        assert!(!first.is_engage_allowed() && !first.is_engage_refused());
        for mut pinned in [first, start()] {
            let notices = pinned.update_running_crc(Some(OTHER)).expect("news");
            assert!(notices.contains("1234abcd") && notices.contains("00004321"), "{notices}");
            assert!(notices.contains("delete that file"), "{notices}");
            assert!(!pinned.is_engage_allowed() && pinned.is_engage_refused());
            assert_eq!(pinned.update_running_crc(Some(OURS)), None);
            assert!(pinned.is_engage_allowed() && !pinned.is_engage_refused());
        }
    }

    #[test]
    fn a_state_file_that_is_damaged_or_cannot_be_kept_engages_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("state");
        for text in [
            "",
            "trueup-calibration",
            "trueup-calibration 1234",
            "1234abcd",
            "trueup-calibration 00000000",
        ] {
            fs::write(&path, text).expect("a file");
            let mut pinned = PinnedCalibration::new(CalibrationPolicy::FirstContact(path.clone()));
            let notices = pinned.update_running_crc(Some(OURS)).expect("news");
            assert!(
                notices.contains("damaged") && notices.contains("bridge info"),
                "{text:?}: {notices}"
            );
            assert!(!pinned.is_engage_allowed(), "{text:?}");
            assert_eq!(fs::read_to_string(&path).expect("it stays"), text);
        }
        // A folder in its place: neither readable nor writable.
        let mut pinned =
            PinnedCalibration::new(CalibrationPolicy::FirstContact(folder.path().into()));
        let notices = pinned.update_running_crc(Some(OURS)).expect("news");
        assert!(notices.contains("cannot be read") && !pinned.is_engage_allowed(), "{notices}");
        fs::write(&path, "x").expect("a file");
        let mut pinned =
            PinnedCalibration::new(CalibrationPolicy::FirstContact(path.join("below-a-file")));
        let notices = pinned.update_running_crc(Some(OURS)).expect("news");
        assert!(notices.contains("cannot be") && !pinned.is_engage_allowed(), "{notices}");
    }

    #[test]
    fn each_port_has_a_state_file_of_its_own_where_states_belong() {
        let of = |known: &'static str| {
            default_state_path("tcp:127.0.0.1:3333", move |name| {
                (name == known).then(|| "/s".into())
            })
        };
        let name = "gateway-tcp-127-0-0-1-3333.calibration";
        assert_eq!(of("STATE_DIRECTORY"), Path::new("/s").join(name));
        assert_eq!(of("XDG_STATE_HOME"), Path::new("/s/trueup").join(name));
        assert_eq!(of("HOME"), Path::new("/s/.local/state/trueup").join(name));
        assert_eq!(of("none"), Path::new(name));
    }

    #[test]
    fn a_machine_file_pins_what_it_makes_and_any_calibration_pins_none() {
        let mut pinned =
            PinnedCalibration::new(CalibrationPolicy::Machine { crc: OURS, path: "m.toml".into() });
        assert!(!pinned.is_engage_allowed());
        let notices = pinned.update_running_crc(Some(OTHER)).expect("news");
        assert!(
            notices.contains("m.toml makes 1234abcd") && notices.contains("00004321"),
            "{notices}"
        );
        assert!(notices.contains("bridge load"), "{notices}");
        assert!(!pinned.is_engage_allowed());
        assert_eq!(pinned.update_running_crc(Some(OURS)), None);
        assert!(pinned.is_engage_allowed());
        let mut any = PinnedCalibration::new(CalibrationPolicy::Any);
        assert!(any.is_engage_allowed());
        assert_eq!(any.update_running_crc(Some(OTHER)), None);
        assert!(any.is_engage_allowed() && !any.is_engage_refused());
    }
}
