//! A user's LinuxCNC configuration: what is in it, what stands in the way of offsets, and how they are added.
//!
//! ```text
//!  INI + #INCLUDE ─► ini_file ─┬─► joints ──┐
//!  HALFILE, source ─► hal_files ┴────────────┴─► check ─► wiring ─► install
//! ```
//!
//! [`ini_file`] and [`hal_files`] read, [`joints`] says which joint moves which axis and how fast, [`check`] judges,
//! [`wiring`] writes HAL files, [`inputs`] knows what the user's HAL files have to bring, [`boardless_config`] what a bridge without a board needs,
//! [`installed_setup`] finds what is there already, [`setup`] puts them into the configuration and takes them out.

pub mod boardless_config;
pub mod check;
pub mod finding;
pub mod hal_files;
pub mod ini_file;
mod input_signals;
pub mod inputs;
pub mod installed_setup;
pub mod joints;
mod servo_hal_lines;
pub mod setup;
pub mod wiring;

/// Where offsets enter LinuxCNC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OffsetEntryPoint {
    /// As an external offset of the axis: LinuxCNC's planner knows it and pays for it.
    #[default]
    Eoffset,
    /// Between the joint's motor command and the drive: the planner does not see it.
    Joint,
}

impl OffsetEntryPoint {
    /// Returns the word of command lines and INI files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Eoffset => "eoffset",
            Self::Joint => "joint",
        }
    }

    /// Returns the entry with this name.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        [Self::Eoffset, Self::Joint].into_iter().find(|entry| entry.name() == name)
    }
}
