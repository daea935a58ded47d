//! Whether a file corrects anything: `compile` and `load` say so, since a board with it would stay at 0.

use super::{
    error_bounds::{axis_error_bounds, elongation_bounds},
    warning::Warning,
};
use crate::{machine_file::Machine, sections::LinearAxis};

/// Returns a warning for a file with which every offset stays at 0; `None` where something is corrected.
#[must_use]
pub fn no_correction_warning(machine: &Machine) -> Option<Warning> {
    let is_there = |um: Option<f64>| um != Some(0.0);
    let grows = elongation_bounds(machine).iter().any(|part| is_there(part.largest_um))
        || machine.has_elongation() && machine.spindle.source.is_none();
    let parts = LinearAxis::ALL.into_iter().flat_map(|axis| axis_error_bounds(machine, axis));
    let errs = parts.into_iter().any(|part| is_there(part.largest_um));
    (!grows && !errs).then(|| {
        let what = if machine.spindle.source.is_none() && machine.spindle.sensor.is_some() {
            "corrects nothing: [spindle] has a sensor and no source = \"sensor\""
        } else {
            "corrects nothing: a board with it leaves every offset at 0"
        };
        Warning::for_key(
            machine,
            "machine",
            what,
            "write a [spindle] source, or an [axis.…] or [straightness.…] section; `trueup fit` makes them from \
             measured runs",
        )
    })
}
