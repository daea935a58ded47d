//! `[instrument]`: what the machine is measured with.

use crate::keys::table::table;

table! {
    /// The properties of the measuring instrument.
    pub(crate) struct Instrument {
        uncertainty_um: f64 = key(Positive, "µm", "what the measuring instrument is worth, 95 %; for `trueup diagnose`").required().with_example_value("0.5").with_range(range([0.0, 1e5], [0.001, 100.0], [0.1, 5.0], "data sheets of gauges, interferometers and probes").with_hint_below("probably in mm instead of µm").with_hint_above(NANOMETRES_HINT));
    }
}
