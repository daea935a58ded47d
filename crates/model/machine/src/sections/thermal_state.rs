//! `[thermal_state]`: what the board takes for a machine that has no heat of its own.

use crate::keys::table::table;

table! {
    /// The state of a cold machine.
    #[derive(PartialEq)]
    pub(crate) struct ThermalStateSection {
        cold_within_c: f64 = key(NotNegative, "K", "after a power cut the machine counts as cold if at least two thermometers agree within this; a board takes at most 5").required().with_example_value("0.5").with_range(range([0.0, 100.0], [0.0, 5.0], [0.2, 1.0], USER_SETTING_SOURCE));
    }
}

impl Default for ThermalStateSection {
    /// Class B of IEC 60751 is ±0.4 K at 20 °C.
    fn default() -> Self {
        Self { cold_within_c: 0.5 }
    }
}
