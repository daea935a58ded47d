//! The kinds of measurement, a page each.

pub(crate) mod axis_heat;
pub(crate) mod backlash;
pub(crate) mod diagonal;
pub(crate) mod pitch;
pub(crate) mod straightness;
pub(crate) mod warmup;

use trueup_machine::{Machine, file::LinearAxis};

use crate::plan::{Plan, Step};
use crate::travel::Travel;

/// What a kind gives: its plans, and notes of what has none.
type Plans = (Vec<Plan>, Vec<String>);

/// A move of one axis at a feed.
fn go(travel: &Travel, mm: f64, feed_mm_per_min: f64) -> Step {
    Step::Move { to_mm: travel.at(mm), feed_mm_per_min }
}

/// `x` of the axis as the operator calls it: `X`.
fn capital(axis: LinearAxis) -> String {
    axis.name().to_uppercase()
}

/// The column of the measured error of an axis.
fn measured(axis: LinearAxis) -> String {
    format!("measured_d{}_um", axis.name())
}

/// The columns of the temperatures that the machine's laws go by, each once.
fn temperatures(machine: &Machine, axis: LinearAxis) -> Vec<String> {
    let own = machine.axes[axis.index()].thermal.as_ref().map(|thermal| thermal.sensor.clone());
    vec![own.unwrap_or_else(|| format!("temp_screw_{}_c", axis.name()))]
}

/// That all corrections of the control must be off.
const WITHOUT_CORRECTION: &str =
    "Switch the control's own compensation off first: what is measured is the bare machine.";
