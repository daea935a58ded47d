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
//! | [`port_discovery`] | the ports of this computer |
//! | [`mod@port_holder`] | which other program holds the line |
//! | [`duplex_stream`] | both directions of an open line |
//! | [`line`](mod@connection) | a line that is opened again whenever it breaks, for who stays on it |
//! | [`session`] | one client's time on the line: open, receive, request, close |
//! | [`sdo_object`] | the objects of the bridge, by SDO |
//! | `patience` | how long an answer is waited for |
//! | [`calibration_load`] | a calibration, sent, read back and put to use |
//! | [`firmware_transfer`] | a new firmware, sent to the other slot of a board, and put to use |
//! | [`firmware_file`] | the file of an update, read and checked |
//! | [`firmware_slots`] | the slots of a board: versions, status, why the one that runs was chosen |
//! | [`previous_calibration`] | the calibration that a load has replaced |
//! | [`disengage`] | the offsets of a bridge that no CNC commands, taken back |
//! | [`mod@reference`] | what the errors count from: value, age, by whom, in force or offered |
//! | [`operator_questions`] | what a bridge requires its operator to confirm |
//! | [`saved_board`] | all that a board holds, in one file |
//! | [`state_text`] | offsets, flags, faults and states for people and as JSON |
//! | [`status`] | what the bridge says of itself, put together |
//! | [`write_log`] | who has written to the bridge |
//! | [`remedy`] | what to do about each of the words |
//! | [`poll`] | an object requested again and again while frames flow by |
//! | [`cnc`] | what the CNC says, where it can be received |
//! | [`record`] | a log of every frame, and a run file for `diagnose` |
//! | `socket_can` | the CAN interface, with the feature `socketcan` on Linux |
//!
//! A failure outside the user's reach is an [`anyhow::Error`], a sentence with its causes; one that
//! the user has to mend is in there as [`UnusableInputError`], or as [`trueup_machine::InputFileError`].

#![forbid(unsafe_code)]

pub mod build;
pub mod calibration_load;
pub mod cnc;
pub mod connection;
pub mod disengage;
pub mod duplex_stream;
pub mod firmware_file;
pub mod firmware_slots;
pub mod firmware_transfer;
mod latency;
pub mod operator_questions;
pub mod pinned_calibration;
pub mod poll;
pub mod port;
pub mod port_discovery;
pub mod port_holder;
pub mod previous_calibration;
pub mod record;
pub mod reference;
pub mod remedy;
pub mod saved_board;
pub mod sdo_object;
pub mod session;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod socket_can;
pub mod state_text;
pub mod status;
mod timeout_policy;
pub mod write_log;

use std::{io, path::PathBuf};

const PORT_FORMATS: &str =
    "a port is tcp:HOST:PORT, a serial device, such as /dev/ttyACM0, or a CAN interface, can0";

/// An input that the user has to change: a port, or the place of a recording.
#[derive(Debug, thiserror::Error)]
pub enum UnusableInputError {
    /// `--port` has none of the forms of a port.
    #[error("--port \"{text}\": {PORT_FORMATS}")]
    NoPort {
        /// The text that the user wrote.
        text: String,
    },
    /// After `tcp:` comes no host and no number of a port.
    #[error("--port \"{text}\": after tcp: comes HOST:PORT; {PORT_FORMATS}")]
    NoAddress {
        /// The text that the user wrote.
        text: String,
    },
    /// A CAN interface, which this build cannot open.
    #[error(
        "--port {interface}: this tool was built without SocketCAN; on Linux it has it: cargo install --path \
             crates/tool/cli, without --no-default-features"
    )]
    NoSocketCan {
        /// The interface's name, such as `can0`.
        interface: String,
    },
    /// The bridge runs on another calibration than the machine file makes, or does not say on which.
    #[error(
        "not recorded: the bridge does not run the calibration of the machine file; load it, or omit --strict"
    )]
    OtherCalibration,
    /// The folder of a recording cannot be made.
    #[error("{}: cannot be made: {error}", .path.display())]
    Folder {
        /// The folder that cannot be made.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// A file of a recording cannot be begun: it is there already, or may not be written.
    #[error("{}: the recording cannot be created: {}", .path.display(), io_error_reason(.error))]
    File {
        /// The file that cannot be begun.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
}

fn io_error_reason(error: &io::Error) -> String {
    if error.kind() == io::ErrorKind::AlreadyExists {
        "another one is there, and stays; give --record another name".into()
    } else {
        error.to_string()
    }
}
