//! Every key of the machine file: its form, unit, default, meaning and an example, from the sections that declare it.
//!
//! The reader holds every file against this table (`structure.rs`), so that a key that does
//! not stand here is refused wherever it is used; the JSON schema and the tables of `docs/reference.md` are
//! made of it ([`crate::schema`]).

pub(crate) mod term;

use super::{
    axis, inputs,
    instrument::Instrument,
    key::{key, section},
    limits::Limits,
    machine, spindle, straightness,
    table::Table,
    thermal_state::ThermalState,
    volume::{self, ToolTip},
};

pub use super::key::{Form, Key, Need};
pub use term::{TERM, TERM_KEYS};

/// The file itself.
pub const FILE: &[Key] = &[
    section("machine", machine::Keys::KEYS, "which machine it is, and where its tool points")
        .required(),
    section(
        "inputs",
        inputs::INPUTS,
        "what is connected to the board; needed to run on one, not to predict",
    ),
    section("spindle", spindle::SPINDLE, "how the spindle grows"),
    section("axis", axis::SECTIONS, "what is known of each linear axis"),
    section(
        "straightness",
        straightness::STRAIGHTNESS,
        "errors of one axis while another one moves",
    ),
    section("squareness", straightness::SQUARENESS, "angles between the axes"),
    section(
        "angular",
        volume::ANGULAR,
        "angular errors of the linear axes, in the letters of ISO 230-1; needs `machine.chain`",
    ),
    section(
        "rotary",
        volume::ROTARY,
        "location errors of the rotary axes, in the letters of ISO 230-7; needs `machine.chain`",
    ),
    section(
        "tool",
        ToolTip::KEYS,
        "where the tool tip is, which angular errors move by their lever",
    ),
    section(
        "limits",
        Limits::KEYS,
        "how far and how fast an offset may go, and how long silence is tolerated",
    ),
    section(
        "thermal_state",
        ThermalState::KEYS,
        "what the board takes for a machine without heat of its own; without it 0.5 K",
    ),
    section("instrument", Instrument::KEYS, "what the machine is measured with"),
    key("term", Form::Terms, "", "a cause that `trueup diagnose` has added"),
];
