//! `[instrument]`: what the machine is measured with.

use crate::keys::table::table;

table! {
    /// The properties of the measuring instrument.
    pub(crate) struct Instrument {
        uncertainty_um: f64 = key(Positive, "µm", "what the measuring instrument is worth, 95 %; for `trueup diagnose`").required().with_example_value("0.5");
    }
}
