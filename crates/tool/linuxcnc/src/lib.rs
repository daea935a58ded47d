//! The bridge in LinuxCNC: `loadusr -W trueup linuxcnc …`.
//!
//! ```text
//!  LinuxCNC's pins ─► sender ───► frames ─► line ─► bridge
//!                    offsets ◄─── frames ◄─ line ◄─┘
//!                        │ target
//!  eoffset-request ─► follower ─► x-counts ─► axis.x.eoffset-counts
//! ```
//!
//! The decisions ([`offset_target`], [`offset_follower`], [`sender`], put together in [`component`]) are `trueup-linuxcnc-core`: it takes time
//! and inputs as arguments and knows no HAL, so that a test can drive it through years. [`hal`] is
//! the only file with `unsafe`, `component_pins` names every pin, [`trueup_client::connection`] keeps the
//! connection to the bridge alive, [`status`] puts the pins into words, [`record`] writes down what `trueup learn` needs of the past,
//! [`run()`] is the loop.
//!
//! How LinuxCNC treats external offsets (`src/emc/motion/axis.c` and `control.c` of 2.9) and what
//! that means here:
//!
//! | LinuxCNC | here |
//! |---|---|
//! | each servo cycle adds (counts − counts before)·scale to `eoffset-request`; 32 bits, may wrap | the counts pin itself is read, stepped with wrapping, written: a restarted component goes on where the signal stands |
//! | the change is lost unless machine on, all homed, enabled | written only then; every step is checked against `eoffset-request`, and a lost one is made again |
//! | machine on sets request and offset to 0, not the counts | the present request is where a ramp begins, never what was written |
//! | `eoffset-enable` = 0 stops the offset where it is, and `eoffset-request` no longer says where | `enable-out` is true as long as the component lives; offsets are taken back by a ramp |
//! | joint mode, and an axis at its soft limit, do not move the offset; afterwards it hurries after the request | the request never runs ahead of `eoffset` by more than the planner needs |
//! | the planner moves with `OFFSET_AV_RATIO` of the axis' speed and acceleration, by default 0 | read from the .ini, and warned of in words |
//! | `axis.L.pos-cmd` is without the external offset | sent to the bridge unchanged |

mod component_pins;
pub mod configuration;
pub mod hal;
pub mod ini_settings;
pub mod record;
pub mod run;
pub mod status;

pub use trueup_linuxcnc_core::{
    Component, ComponentInputs, ComponentOptions, ComponentOutputs, component, engage,
    joint_offsets, offset_follower, offset_target, sender,
};

pub use record::RecordFile;
pub use run::run;

use trueup_linuxcnc_core::{NANOMETRES_PER_MICROMETRE, NANOMETRES_PER_MILLIMETRE};
