//! How far an axis may be sent.

use trueup_machine::{Machine, file::LinearAxis};

use crate::{options::Options, refused::Refused};

/// An axis and its travel in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Travel {
    pub axis: LinearAxis,
    pub low_mm: f64,
    pub high_mm: f64,
}

/// The over-travel of the paper's own program (N10 … X50), in mm: so far an axis goes before it comes
/// back, so that all play is taken up.
const OVER_TRAVEL_MM: f64 = 50.0;
/// A short axis has less: this share of it.
const OVER_TRAVEL_SHARE: f64 = 0.05;

impl Travel {
    pub fn length_mm(&self) -> f64 {
        self.high_mm - self.low_mm
    }

    /// How far the axis goes beyond a target before it approaches it, in mm.
    pub fn over_travel_mm(&self) -> f64 {
        micrometres(OVER_TRAVEL_MM.min(OVER_TRAVEL_SHARE * self.length_mm()))
    }

    /// The ends between which targets may be, in mm.
    pub fn inside_mm(&self) -> [f64; 2] {
        let over_mm = self.over_travel_mm();
        [micrometres(self.low_mm + over_mm), micrometres(self.high_mm - over_mm)]
    }

    /// Targets about `step_mm` apart over the inside, both ends included.
    pub fn even_targets_mm(&self, step_mm: f64) -> Result<Vec<f64>, Refused> {
        let [low, high] = self.inside_mm();
        even(low, high, step_mm).ok_or_else(|| {
            Refused(format!(
                "--step-mm {step_mm} does not fit: {} may be sent from {low} to {high} mm, which gives \
                 2 to {MOST_TARGETS} targets",
                self.axis.name()
            ))
        })
    }

    /// A place of this axis alone.
    pub fn at(&self, mm: f64) -> [Option<f64>; 3] {
        let mut to = [None; 3];
        to[self.axis.index()] = Some(micrometres(mm));
        to
    }
}

/// The most targets of a run: what `fit pitch` takes for single targets.
const MOST_TARGETS: usize = 2048;

/// From `low` to `high` in steps of at most `step`; `None` where there are too many or no two.
pub(crate) fn even(low: f64, high: f64, step: f64) -> Option<Vec<f64>> {
    // A step that fits but for rounding is no longer one.
    let steps = ((high - low) / step - 1e-9).ceil().max(1.0);
    if !(high > low && steps < MOST_TARGETS as f64) {
        return None;
    }
    let count = steps as usize;
    let at = |n: usize| micrometres(low + (high - low) * n as f64 / count as f64);
    Some((0..=count).map(at).collect())
}

/// As a control takes it: whole micrometres.
pub(crate) fn micrometres(mm: f64) -> f64 {
    (mm * 1000.0).round() / 1000.0
}

/// The wanted axes that have a travel, and a note for each that has none.
pub(crate) fn travels(
    machine: &Machine,
    options: &Options,
) -> Result<(Vec<Travel>, Vec<String>), Refused> {
    let (mut travels, mut notes) = (Vec::new(), Vec::new());
    for axis in LinearAxis::ALL {
        let is_named = options.axes.contains(&axis);
        if !options.axes.is_empty() && !is_named {
            continue;
        }
        let name = axis.name();
        let known = machine.axes[axis.index()].travel_mm;
        match options.travel_mm[axis.index()].or(known) {
            Some([low_mm, high_mm]) => {
                if let Some([low, high]) = known
                    && (low_mm < low || high_mm > high)
                {
                    return Err(Refused(format!(
                        "--travel {name}={low_mm}:{high_mm} is more than the machine file's \
                         travel_mm of {low} to {high} mm"
                    )));
                }
                travels.push(Travel { axis, low_mm, high_mm });
            }
            None if is_named => return Err(Refused(no_travel(name))),
            None => notes.push(format!("no program for {name}: {}", no_travel(name))),
        }
    }
    if travels.is_empty() {
        return Err(Refused(no_travel("x")));
    }
    Ok((travels, notes))
}

fn no_travel(axis: &str) -> String {
    format!(
        "the travel of {axis} is not known: write travel_mm = [0.0, 1000.0] under [axis.{axis}] of the \
         machine file, or give --travel {axis}=0:1000"
    )
}
