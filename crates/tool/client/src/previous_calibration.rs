//! The calibration that a load has replaced, kept on this computer, so that it can be loaded again.
//!
//! A file for each board and each calibration that took another one's place: its name says which, its content is the
//! one before, as `compile` writes it. A board that was loaded elsewhere meanwhile runs on a calibration of which there is
//! no such file, so what is kept is never loaded in the place of a calibration that this computer has not seen.

use std::{
    env,
    ffi::OsString,
    fs,
    io::{self, ErrorKind},
    path::{Path, PathBuf},
};

use trueup_store::calibration::calibration_crc;

use crate::pinned_calibration::state_folder;

/// The place of what is kept for one board.
#[derive(Clone, Debug)]
pub struct PreviousCalibrationStore {
    folder: PathBuf,
    /// The hash of the chip's number.
    board: u32,
}

impl PreviousCalibrationStore {
    /// Returns the place in the folder for states of this user; `None`: there is none.
    #[must_use]
    pub fn for_board(board: u32) -> Option<Self> {
        Self::from_environment(board, |name| env::var_os(name))
    }

    fn from_environment(board: u32, variable: impl Fn(&str) -> Option<OsString>) -> Option<Self> {
        Some(Self { folder: state_folder(variable)?.join("replaced"), board })
    }

    /// Returns the file of what the calibration with the CRC `by` has replaced.
    #[must_use]
    pub fn path(&self, by: u32) -> PathBuf {
        self.folder.join(format!("board-{:08x}-before-{by:08x}.bin", self.board))
    }

    /// Keeps `blob`, which the calibration with the CRC `by` replaces. The same one once more replaces nothing.
    ///
    /// # Errors
    /// The folder or the file cannot be written.
    pub fn save(&self, blob: &[u8], by: u32) -> io::Result<()> {
        if calibration_crc(blob) == by {
            return Ok(());
        }
        fs::create_dir_all(&self.folder)?;
        let path = self.path(by);
        let adjacent = path.with_extension("new");
        fs::write(&adjacent, blob)?;
        fs::rename(&adjacent, &path)
    }

    /// Returns the file of the calibration that a board ran on before the one with the CRC `running`; `None`: none
    /// was replaced by it from here.
    #[must_use]
    pub fn find(&self, running: u32) -> Option<PathBuf> {
        let path = self.path(running);
        match fs::metadata(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            _ => Some(path),
        }
    }

    /// Returns the folder of all of them.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_replaced_is_found_by_board_and_by_what_replaced_it() {
        let home = tempfile::tempdir().expect("a folder");
        let of = |board| {
            PreviousCalibrationStore::from_environment(board, |name| {
                (name == "HOME").then(|| home.path().into())
            })
            .expect("it has a home")
        };
        let (first, second) = (*b"calibration 1111", *b"calibration 2222");
        assert_eq!(of(1).find(calibration_crc(&second)), None);
        of(1).save(&first, calibration_crc(&second)).expect("a folder that can be written");
        let retained = of(1).find(calibration_crc(&second)).expect("it was kept");
        assert_eq!(fs::read(retained).expect("it is there"), first);
        // Of another board, or for a calibration that was loaded elsewhere, there is none.
        assert_eq!(of(2).find(calibration_crc(&second)), None);
        assert_eq!(of(1).find(7), None);
        // The same one once more does not make itself its own predecessor.
        of(1).save(&second, calibration_crc(&second)).expect("nothing to do");
        let retained = of(1).find(calibration_crc(&second)).expect("as before");
        assert_eq!(fs::read(retained).expect("it is there"), first);
        assert!(PreviousCalibrationStore::from_environment(1, |_| None).is_none());
    }
}
