//! Checks of the probe against a certified reference: with one reference alone a probe that drifts is learned as the machine.

use crate::{
    event::{DetectedEvent, EventAction, EventKind, round_to_three_digits},
    learner_state::LearnerState,
};

const SECONDS_PER_DAY: f64 = 86_400.0;
/// After this many days without a check one is requested: four weeks.
const MAX_CHECK_INTERVAL_DAYS: f64 = 28.0;
/// This many checks say whether they drift: two of them are on a line.
const MIN_DRIFT_CHECKS: usize = 4;
/// Standard errors of the slope at which a drift is certain: once in 10⁶ of normal noise.
const MIN_DRIFT_T_VALUE: f64 = 5.0;

/// Adds a check; readings are corrected linearly between checks from then on.
pub(crate) fn add_check_and_detect_drift(
    memory: &mut LearnerState,
    time_s: Option<f64>,
    um: f64,
    scatter_um: f64,
) {
    memory.checks.push([time_s.or(memory.last_s).unwrap_or(0.0), um]);
    memory.first_s = memory.first_s.or(time_s);
    memory.last_s = time_s.or(memory.last_s);
    if let Some([size, half]) = estimate_drift(&memory.checks, scatter_um) {
        let ci95 = [round_to_three_digits(size - half), round_to_three_digits(size + half)];
        let known = memory.events.iter().position(|event| event.event == EventKind::ProbeDrift);
        if let Some(place) = known {
            (memory.events[place].size, memory.events[place].ci95) =
                (round_to_three_digits(size), ci95);
            return;
        }
        memory.events.push(DetectedEvent {
            event: EventKind::ProbeDrift,
            constant: None,
            at: memory.checks.first().map(|check| check[0]),
            certain_at: memory.last_s,
            size: round_to_three_digits(size),
            unit: "µm".into(),
            ci95,
            check: DetectedEvent::advice(EventKind::ProbeDrift, &[]),
            alternatives: Vec::new(),
            sequence: memory.next_sequence_number(),
            action: EventAction::Nothing,
            is_open: false,
        });
    }
}

/// Returns the drift from the first check to the last in µm and half its 95 % interval, where it is certain. A check
/// repeats to what checks scatter about their line, and no better than a tenth of the scatter of a reading.
fn estimate_drift(checks: &[[f64; 2]], scatter_um: f64) -> Option<[f64; 2]> {
    if checks.len() < MIN_DRIFT_CHECKS {
        return None;
    }
    let count = checks.len() as f64;
    let mean = |index: usize| checks.iter().map(|check| check[index]).sum::<f64>() / count;
    let (t, um) = (mean(0), mean(1));
    let sum = |of: &dyn Fn(&[f64; 2]) -> f64| checks.iter().map(of).sum::<f64>();
    let tt = sum(&|check| (check[0] - t).powi(2));
    let slope = sum(&|check| (check[0] - t) * (check[1] - um)) / tt;
    let left = sum(&|check| (check[1] - um - slope * (check[0] - t)).powi(2)) / (count - 2.0);
    let error = left.sqrt().max(scatter_um / 10.0) / tt.sqrt();
    let span = checks[checks.len() - 1][0] - checks[0][0];
    // Few checks know their scatter badly: Student's distribution.
    let student = 1.0 + 4.0 / (count - 2.0);
    (slope.abs() > MIN_DRIFT_T_VALUE * student * error)
        .then_some([slope * span, 1.96 * student * error * span])
}

/// Returns the sentence that requests a check, where the last one is too long ago.
pub(crate) fn overdue_check_note(memory: &LearnerState) -> Option<String> {
    let last_s = memory.last_s?;
    let since_s = memory.checks.last().map(|check| check[0]).or(memory.first_s)?;
    let days = (last_s - since_s) / SECONDS_PER_DAY;
    (days >= MAX_CHECK_INTERVAL_DAYS).then(|| {
        format!(
            "No check of the probe for {days:.0} days. With one reference the drift of a probe is learned as an error of the machine, and the readings cannot show it. Measure a certified reference (a ring, a gauge block at a known temperature, or with another probe). Write the reading less its value at 20 °C into the column check_um."
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checks_that_drift_are_reported_and_checks_that_scatter_are_not() {
        let month = 28.0 * SECONDS_PER_DAY;
        let noise = [0.1, -0.2, 0.15, -0.05, 0.2, -0.15, 0.0, 0.1];
        let checks = |per_month: f64| -> Vec<[f64; 2]> {
            (0..8).map(|n| [month * n as f64, per_month * n as f64 + noise[n]]).collect()
        };
        assert_eq!(estimate_drift(&checks(0.0), 2.0), None);
        let [size, half] = estimate_drift(&checks(0.5), 2.0).expect("it drifts");
        assert!((size - 3.5).abs() < half && half < 1.5, "{size} {half}");
    }
}
