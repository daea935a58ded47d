//! Every key of the machine file: its form, unit, default, meaning and an example, from the sections that declare it.
//!
//! The reader holds every file against this table (`validation.rs`), so that a key that does
//! not stand here is refused wherever it is used; the JSON schema and the tables of `docs/reference.md` are
//! made of it ([`crate::schema`]).

use super::machine;
use crate::{
    keys::{
        key::{key, section},
        plausible_range::{UNBOUNDED_LIMIT, USER_SETTING_SOURCE, range},
        table::Table,
    },
    sections::{
        Limits, ToolGeometry, axis, inputs, instrument::Instrument, spindle, straightness,
        thermal_state::ThermalStateSection, volume,
    },
};

pub use crate::keys::{
    key::{Key, Requirement, ValueType},
    term::{TERM, TERM_KEYS},
};

/// The file itself.
pub const MACHINE_FILE_KEYS: &[Key] = &[
    section(
        "machine",
        machine::MachineKeys::KEYS,
        "which machine it is, and where its tool points",
    )
    .required(),
    section(
        "inputs",
        inputs::INPUT_KEYS,
        "what is connected to the board; needed to run on one, not to predict",
    )
    .with_range(range(
        [-UNBOUNDED_LIMIT, UNBOUNDED_LIMIT],
        [-1e10, 1e10],
        [-1e5, 1e5],
        USER_SETTING_SOURCE,
    )),
    section("spindle", spindle::SPINDLE_KEYS, "how the spindle grows"),
    section("axis", axis::AXIS_KEYS, "what is known of each linear axis"),
    section(
        "straightness",
        straightness::STRAIGHTNESS_KEYS,
        "errors of one axis while another one moves",
    ),
    section("squareness", straightness::SQUARENESS_KEYS, "angles between the axes"),
    section(
        "angular",
        volume::ANGULAR_KEYS,
        "angular errors of the linear axes, in the letters of ISO 230-1; needs `machine.chain`",
    ),
    section(
        "rotary",
        volume::ROTARY_KEYS,
        "location errors of the rotary axes, in the letters of ISO 230-7; needs `machine.chain`",
    ),
    section(
        "tool",
        ToolGeometry::KEYS,
        "where the tool tip is, which angular errors move by their lever",
    ),
    section(
        "limits",
        Limits::KEYS,
        "how far and how fast an offset may go, and how long silence is tolerated",
    )
    .with_range(range(
        [0.0, UNBOUNDED_LIMIT],
        [0.0, UNBOUNDED_LIMIT],
        [0.0, UNBOUNDED_LIMIT],
        USER_SETTING_SOURCE,
    )),
    section(
        "thermal_state",
        ThermalStateSection::KEYS,
        "what the board takes for a machine without heat of its own; without it 0.5 K",
    ),
    section("instrument", Instrument::KEYS, "what the machine is measured with"),
    key("term", ValueType::Terms, "", "a cause that `trueup diagnose` has added"),
];
