//! `[instrument]`: what the machine is measured with.

use super::table::table;

table! {
    /// The properties of the measuring instrument.
    pub(super) struct Instrument {
        uncertainty_um: f64 = key(Positive, "µm", "what the measuring instrument is worth, 95 %; for `trueup diagnose`").required().with_example_value("0.5");
    }
}
