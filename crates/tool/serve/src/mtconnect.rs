//! MTConnect: an adapter that agents read lines of SHDR from, and the description of the devices for them.
//!
//! | data item | is |
//! |---|---|
//! | `b1_avail` | AVAILABLE while valid offsets come |
//! | `b1_offset_x` … `z`, `b1_elongation` | `Displacement` in mm |
//! | `b1_position_x` … `z` | `Position` in mm, commanded, where the CNC is on the bridge's line |
//! | `b1_temperature_0` … `7` | `Temperature` in °C |
//! | `b1_faults`, `b1_state`, `b1_line` | `Condition`, the words of the bridge as native codes |
//! | `b1_message` | `Message`: each event, its code as the native code |
//!
//! `b1` is the first bridge. A value that is not known is UNAVAILABLE.

pub mod adapter;
pub mod devices;
pub(crate) mod shdr;
