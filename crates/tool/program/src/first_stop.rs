//! The first stop of a program: what moves, where to, how far, and what must be clear.
//!
//! It is taken from the plan's own steps and written by [`crate::control`] in front of them, so that no kind of
//! measurement can leave it out or say something else than what is done.

use crate::plan::{MeasurementPlan, Step};

const AXIS_NAMES: [&str; 3] = ["X", "Y", "Z"];

impl MeasurementPlan {
    /// Returns the sentences of the stop that comes before anything moves or turns.
    #[must_use]
    pub fn first_stop_instructions(&self) -> Vec<String> {
        let mut sentences = Vec::new();
        let approaches = self.first_approaches();
        let extents: Vec<(&str, [f64; 2])> = AXIS_NAMES
            .into_iter()
            .zip(self.extent_mm())
            .filter_map(|(axis, extent)| extent.map(|extent| (axis, extent)))
            .collect();
        if !extents.is_empty() {
            // A lathe's screen shows diameters.
            let diameter = |axis: &str, mm: &[f64]| match (self.is_lathe && axis == "X", mm) {
                (true, [mm]) => format!(" (diameter {})", round_to_micrometres(2.0 * mm)),
                (true, [low, high]) => {
                    format!(
                        " (diameters {} to {})",
                        round_to_micrometres(2.0 * low),
                        round_to_micrometres(2.0 * high)
                    )
                }
                _ => String::new(),
            };
            let to = approaches.iter().map(|(axis, mm)| {
                format!(
                    "{} goes to {mm} mm{}",
                    AXIS_NAMES[*axis],
                    diameter(AXIS_NAMES[*axis], &[*mm])
                )
            });
            let to: Vec<String> = to.collect();
            let feed = self.approach_mm_per_min;
            sentences.push(format!("{}, at {feed} mm/min.", to.join(", then ")));
            let between = |(axis, [low, high]): &(&str, [f64; 2])| {
                format!(
                    "{axis} moves {} mm, from {low} to {high} mm{}",
                    round_to_micrometres(high - low),
                    diameter(axis, &[*low, *high])
                )
            };
            let moves: Vec<String> = extents.iter().map(between).collect();
            let highest = self.max_feed_mm_per_min();
            sentences.push(format!("Then {}, at up to {highest} mm/min.", moves.join(", ")));
            let axes: Vec<&str> = extents.iter().map(|(axis, _)| *axis).collect();
            let others: Vec<&str> = AXIS_NAMES
                .into_iter()
                .filter(|axis| !axes.contains(axis) && (!self.is_lathe || *axis != "Y"))
                .collect();
            sentences.push(format!(
                "The whole way of {} must be clear of part, vice, tool, cables.",
                axes.join(" and ")
            ));
            sentences.push(if others.is_empty() {
                "Home all axes first.".into()
            } else {
                format!("Home all axes; jog {} clear: they stand.", others.join(" and "))
            });
        }
        if self.max_rpm() > 0.0 {
            sentences.push(format!("The spindle turns at up to {} r/min.", self.max_rpm()));
            if extents.is_empty() {
                sentences
                    .push("No axis moves. All that turns must be clear, the door closed.".into());
            }
        }
        sentences.extend(self.precautions.iter().cloned());
        sentences
    }

    /// Returns the approaches before the first measuring move, reading or further stop.
    fn first_approaches(&self) -> Vec<(usize, f64)> {
        let is_before = |step: &&Step| {
            matches!(
                step,
                Step::Approach { .. }
                    | Step::Guarded { .. }
                    | Step::Note(_)
                    | Step::Spindle(_)
                    | Step::Dwell(_)
            )
        };
        let approach = |step: &Step| match step {
            Step::Approach { axis, to_mm } | Step::Guarded { axis, to_mm } => Some((*axis, *to_mm)),
            _ => None,
        };
        self.steps.iter().take_while(is_before).filter_map(approach).collect()
    }
}

/// Returns a difference of two positions without the rounding of `f64`.
fn round_to_micrometres(mm: f64) -> f64 {
    (mm * 1000.0).round() / 1000.0
}
