//! `[limits]`: how far and how fast an offset may go, and how long silence is tolerated.

use crate::keys::{
    key::{Key, ValueType, key},
    table::{default_table, table},
};

table! {
    /// How far and how fast an offset may go, and how long silence is tolerated.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Limits {
        /// Of X, Y and Z, either way; at least 0.
        max_um: [f64; 3] = key(Table(OFFSET_LIMIT_KEYS), "", "the largest offset; a board takes at most 4000 µm from any calibration (14.3 m of steel grow by it at 20 K)");
        slew_um_per_s: f64 = key(Positive, "µm/s", "the fastest change of an offset; a board takes at most 10000. A table, curve or wave must not be steeper than what this follows at 30 mm/min (40 µm/mm)").with_default("20.0");
        link_timeout_ms: u32 = key(Whole(1, u32::MAX), "ms", "without the CNC's `Control` for so long it is lost; a board takes at most 60000").with_default("500");
        hold_ms: u32 = key(Whole(0, u32::MAX), "ms", "the last offset is held for so long, then taken back; a board takes at most 600000").with_default("2000");
        rejoin_um_per_s: f64 = key(Positive, "µm/s", "how fast the difference between two sources of the growth is taken back when the better one has returned; a board takes 0.001 to 1").with_default("0.01");
        learned: LearnedChangeLimits = key(Table(LearnedChangeLimits::KEYS), "", "how far what `trueup learn` has learned may change the correction while the bridge runs, either way; without it nothing may").inline().omit_default();
    }
}

const OFFSET_LIMIT_KEYS: &[Key] = &[
    offset_limit_key("x", "200.0"),
    offset_limit_key("y", "200.0"),
    offset_limit_key("z", "500.0"),
];

const fn offset_limit_key(axis: &'static str, default: &'static str) -> Key {
    key(axis, ValueType::NotNegative, "µm", "on this axis, either way").with_default(default)
}

table! {
    /// How far what was learned may change the parts of the correction while the bridge runs, either way.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct LearnedChangeLimits {
        growth_percent: f64 = key(NotNegative, "%", "of the growth of the spindle; a board takes at most 25, in steps of 0.1").with_default("0.0").with_example_value("5.0");
        axes_percent: f64 = key(NotNegative, "%", "of the expansion of each axis; a board takes at most 25, in steps of 0.1").with_default("0.0").with_example_value("5.0");
        zero_um: f64 = key(NotNegative, "µm", "the zero of the growth; a board takes at most 20, in steps of 0.1").with_default("0.0").with_example_value("10.0");
    }
}

impl Default for Limits {
    fn default() -> Self {
        default_table().expect("each of its keys has a default")
    }
}
