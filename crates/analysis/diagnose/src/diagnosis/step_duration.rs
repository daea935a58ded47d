//! How long a step took: something that creeps, or a hand that pushes, is slower than a reading.
//!
//! Around the step's instant a ramp between the two levels is put through the readings, over each pair of rows that may
//! be its ends. It is reported where it leaves clearly less than the step at once does, and takes longer than two rows.

use serde_json::json;
use trueup_machine::effect::Effect;

use super::report::Finding;
use crate::{
    data::DataTable, search::model_comparison::STRONG_EVIDENCE_BIC_DIFFERENCE, term_kind::ModelPart,
};

/// Rows before and after that are looked at: a cap of work, which grows with their cube.
const STEP_HALF_WINDOW_ROWS: usize = 40;

/// Adds to the finding of a step how long it took, where it was slower than a reading; `after` is what the answer says
/// of each row, in µm.
pub(super) fn append_duration_sentence(
    finding: &mut Finding,
    part: &ModelPart,
    data: &DataTable,
    after: &[f64],
) {
    let Some(Effect::Step(step)) = part.cause() else { return };
    let Some(duration_s) = estimate_step_duration_s(step.at_s, step.size_um, data, after) else {
        return;
    };
    let took = format!("It took about {duration_s:.0} s, not one reading.");
    finding.sentence = format!("{} {took}", finding.sentence);
    finding.evidence.push(took);
    finding.parameters.insert("duration_s".into(), json!({ "value": duration_s }));
}

fn estimate_step_duration_s(
    at_s: f64,
    size_um: f64,
    data: &DataTable,
    after: &[f64],
) -> Option<f64> {
    let time_s = data.time_s()?;
    let rows: Vec<(f64, f64)> = (0..data.rows)
        .filter(|&row| time_s[row].is_finite() && data.measured[row].is_finite())
        .map(|row| {
            let old = if time_s[row] >= at_s { size_um } else { 0.0 };
            (time_s[row], data.measured[row] - after[row] + old)
        })
        .filter(|(_, um)| um.is_finite())
        .collect();
    let at = rows.iter().position(|(time_s, _)| *time_s >= at_s)?;
    let rows = &rows
        [at.saturating_sub(STEP_HALF_WINDOW_ROWS)..(at + STEP_HALF_WINDOW_ROWS).min(rows.len())];
    estimate_ramp_duration_s(rows, at_s, size_um)
}

/// Returns how long a ramp of this size takes through rows of time and error; `None` where it is a step.
fn estimate_ramp_duration_s(rows: &[(f64, f64)], at_s: f64, size_um: f64) -> Option<f64> {
    let squares = |first_s: f64, last_s: f64| -> f64 {
        let left = |&(time_s, um): &(f64, f64)| {
            let share = if last_s > first_s {
                ((time_s - first_s) / (last_s - first_s)).clamp(0.0, 1.0)
            } else {
                f64::from(u8::from(time_s >= at_s))
            };
            (um - size_um * share).powi(2)
        };
        rows.iter().map(left).sum()
    };
    let step = squares(at_s, at_s);
    let mut best = (f64::INFINITY, 0, 0);
    for first in 0..rows.len() {
        for last in first + 1..rows.len() {
            if rows[first].0 < at_s && at_s <= rows[last].0 {
                let left = squares(rows[first].0, rows[last].0);
                if left < best.0 {
                    best = (left, first, last);
                }
            }
        }
    }
    let (left, first, last) = best;
    let noise = left / (rows.len() as f64 - 3.0).max(1.0);
    // Strong evidence by BIC: a ramp has two ends where a step has one instant.
    let least = STRONG_EVIDENCE_BIC_DIFFERENCE + (rows.len() as f64).ln();
    (last > first + 2 && step - left > least * noise).then(|| rows[last].0 - rows[first].0)
}

#[cfg(test)]
mod tests {
    use trueup_numerics::random::RandomGenerator;

    use super::*;

    /// Returns a creep of 15 µm over `rows` rows of 60 s, from 3000 s on.
    fn creep(rows: usize) -> Option<f64> {
        let mut noise = RandomGenerator::new(4);
        let share = |row: usize| ((row as f64 - 50.0) / rows as f64).clamp(0.0, 1.0);
        let all: Vec<(f64, f64)> = (10..90)
            .map(|row| (60.0 * row as f64, 15.0 * share(row) + 0.5 * noise.normal()))
            .collect();
        estimate_ramp_duration_s(&all, 60.0 * (50 + rows.div_ceil(2)) as f64, 15.0)
    }

    #[test]
    fn a_creep_is_told_with_its_duration_and_a_step_is_none() {
        for rows in [5, 10, 25] {
            let found = creep(rows).expect("slower than a reading");
            assert!((found / 60.0 - rows as f64).abs() <= 2.0, "{rows}: {found}");
        }
        assert_eq!(creep(1), None);
    }
}
