//! The PC's end of the bridge's line: where a bridge is, how it is spoken to, and what it says.
//!
//! ```text
//!  port ─► (reader, writer) ─► session ─► object, words, status, record     trueup bridge …
//!                          └─► trueup-linuxcnc                              trueup linuxcnc
//! ```
//!
//! | module | does |
//! |---|---|
//! | [`port`] | TCP, a serial device or a CAN interface, opened to lines of SLCAN both ways |
//! | [`found`] | the ports of this computer |
//! | [`mod@holder`] | which other program holds the line |
//! | [`ends`] | both directions of an open line |
//! | [`line`](mod@line) | a line that is opened again whenever it breaks, for who stays on it |
//! | [`session`] | one client's time on the line: open, receive, ask, close |
//! | [`object`] | the objects of the bridge, by SDO |
//! | `patience` | how long an answer is waited for |
//! | [`load`] | a calibration, sent, read back and put to use |
//! | [`firmware`] | a new firmware, sent to the other slot of a board, and put to use |
//! | [`firmware_file`] | the file of an update, read and checked |
//! | [`firmware_slots`] | the slots of a board: versions, status, why the one that runs was chosen |
//! | [`previous`] | the calibration that a load has replaced |
//! | [`disengage`] | the offsets of a bridge that no CNC commands, taken back |
//! | [`mod@reference`] | what the errors count from: value, age, by whom, in force or offered |
//! | [`questions`] | what a bridge asks its operator |
//! | [`saved`] | all that a board holds, in one file |
//! | [`words`] | offsets, flags, faults and states for people and as JSON |
//! | [`status`] | what the bridge says of itself, put together |
//! | [`writes`] | who has written to the bridge |
//! | [`remedy`] | what to do about each of the words |
//! | [`poll`] | an object asked for again and again while frames flow by |
//! | [`cnc`] | what the CNC says, where it can be received |
//! | [`record`] | a log of every frame, and a run file for `diagnose` |
//! | `socket_can` | the CAN interface, with the feature `socketcan` on Linux |
//!
//! A failure outside the user's reach is an [`anyhow::Error`], a sentence with its causes; one that
//! the user has to mend is in there as [`Unusable`], or as [`trueup_machine::BadInput`].

#![forbid(unsafe_code)]

pub mod build;
pub mod cnc;
mod dating;
pub mod disengage;
pub mod ends;
pub mod firmware;
pub mod firmware_file;
pub mod firmware_slots;
pub mod found;
pub mod holder;
pub mod line;
pub mod load;
pub mod object;
pub mod pinned;
pub mod poll;
pub mod port;
pub mod previous;
pub mod questions;
pub mod record;
pub mod reference;
pub mod remedy;
pub mod saved;
pub mod session;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod socket_can;
pub mod status;
mod timeout_policy;
pub mod words;
pub mod writes;

use std::{fmt, io, path::PathBuf};

/// An input that the user has to change: a port, or the place of a recording.
#[derive(Debug)]
pub enum Unusable {
    /// `--port` has none of the forms of a port.
    NoPort {
        /// The text that the user wrote.
        text: String,
    },
    /// After `tcp:` comes no host and no number of a port.
    NoAddress {
        /// The text that the user wrote.
        text: String,
    },
    /// A CAN interface, which this build cannot open.
    NoSocketCan {
        /// The interface's name, such as `can0`.
        interface: String,
    },
    /// The bridge runs on another calibration than the machine file makes, or does not say on which.
    OtherCalibration,
    /// The folder of a recording cannot be made.
    Folder {
        /// The folder that cannot be made.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// A file of a recording cannot be begun: it is there already, or may not be written.
    File {
        /// The file that cannot be begun.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
}

impl fmt::Display for Unusable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const FORMS: &str = "a port is tcp:HOST:PORT, a serial device, such as /dev/ttyACM0, or a \
                             CAN interface, can0";
        match self {
            Self::NoPort { text } => write!(f, "--port \"{text}\": {FORMS}"),
            Self::NoAddress { text } => {
                write!(f, "--port \"{text}\": after tcp: comes HOST:PORT; {FORMS}")
            }
            Self::NoSocketCan { interface } => write!(
                f,
                "--port {interface}: this tool was built without SocketCAN; on Linux it has it: cargo install \
                 --path crates/tool/cli, without --no-default-features"
            ),
            Self::OtherCalibration => f.write_str(
                "not recorded: the bridge does not run the calibration of the machine file; load it, \
                 or leave --strict out",
            ),
            Self::Folder { path, error } => {
                write!(f, "{}: cannot be made: {error}", path.display())
            }
            Self::File { path, error } if error.kind() == io::ErrorKind::AlreadyExists => write!(
                f,
                "{}: the recording cannot be created: another one is there, and stays; give --record another name",
                path.display()
            ),
            Self::File { path, error } => {
                write!(f, "{}: the recording cannot be created: {error}", path.display())
            }
        }
    }
}

impl std::error::Error for Unusable {}
