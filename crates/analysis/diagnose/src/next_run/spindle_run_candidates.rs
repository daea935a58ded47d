//! The runs that are thought of: every one begins cold, and lasts an hour and a half at most.
//!
//! No bearing is brought from rest to a high speed: each run begins with a run-in, a few minutes at each of the slower
//! speeds. It is part of the run, so that its heat is predicted.

use super::{SpindleSegment, spindle_forecast::SpindleForecaster};

/// Shares of the fastest speed that was run.
const SPEED_FRACTIONS: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// How long one speed is run, and how long the spindle then stands, in minutes.
const WARM_UP_DURATIONS_MIN: [f64; 8] = [5.0, 8.0, 12.0, 20.0, 30.0, 40.0, 50.0, 60.0];
const COOLING_DURATIONS_MIN: [f64; 5] = [0.0, 5.0, 10.0, 20.0, 30.0];
/// A quick change stays for this many minutes, and comes this many times: quick against heat, slow against the dial.
const SPEED_PULSE_DURATION_MIN: f64 = 2.0;
const SPEED_PULSE_COUNTS: [usize; 4] = [1, 2, 4, 8];

/// The longest run, in minutes.
const MAX_RUN_DURATION_MIN: f64 = 90.0;
/// How long a run-in stays at each of the slower speeds, in minutes: makers of spindles require some minutes at a
/// quarter, a half and three quarters of the highest speed.
const RUN_IN_STEP_DURATION_MIN: f64 = 3.0;

/// Returns all of them.
pub(super) fn candidate_spindle_runs(foresight: &SpindleForecaster) -> Vec<Vec<SpindleSegment>> {
    let speeds =
        SPEED_FRACTIONS.map(|share| (share * foresight.fastest_rpm / 100.0).round() * 100.0);
    let stretch = |rpm: f64, minutes: f64| SpindleSegment { rpm, minutes, load_n: 0.0 };
    let mut all = Vec::new();
    for rpm in speeds {
        for heat in WARM_UP_DURATIONS_MIN {
            for cool in COOLING_DURATIONS_MIN {
                let mut run = vec![stretch(rpm, heat)];
                run.extend((cool > 0.0).then(|| stretch(0.0, cool)));
                all.push(run);
            }
        }
        for slower in speeds.into_iter().chain([0.0]).filter(|slower| *slower < rpm) {
            for times in SPEED_PULSE_COUNTS {
                all.push(
                    [
                        stretch(rpm, SPEED_PULSE_DURATION_MIN),
                        stretch(slower, SPEED_PULSE_DURATION_MIN),
                    ]
                    .repeat(times),
                );
            }
            // Slow first, or fast first: heat that is there already, or not yet.
            for minutes in WARM_UP_DURATIONS_MIN.into_iter().filter(|minutes| *minutes <= 40.0) {
                all.push(vec![stretch(rpm, minutes), stretch(slower, minutes)]);
                all.push(vec![stretch(slower, minutes), stretch(rpm, minutes)]);
            }
        }
        if let Some(load_n) = foresight.most_load_n {
            for times in SPEED_PULSE_COUNTS {
                let cut = SpindleSegment { load_n, ..stretch(rpm, SPEED_PULSE_DURATION_MIN) };
                all.push([stretch(rpm, SPEED_PULSE_DURATION_MIN), cut].repeat(times));
            }
        }
    }
    all.retain(|run| run.iter().any(|stretch| stretch.rpm > 0.0));
    let all = all.into_iter().map(|run| insert_run_ins(run, &speeds));
    all.filter(|run| run.iter().map(|segment| segment.minutes).sum::<f64>() <= MAX_RUN_DURATION_MIN)
        .collect()
}

/// Returns `run` with a run-in before each speed that is higher than any before; `speeds` rise.
fn insert_run_ins(run: Vec<SpindleSegment>, speeds: &[f64]) -> Vec<SpindleSegment> {
    let mut highest_rpm = 0.0;
    let mut whole = Vec::new();
    for stretch in run {
        let slower = speeds.iter().filter(|rpm| **rpm > highest_rpm && **rpm < stretch.rpm);
        whole.extend(slower.map(|rpm| SpindleSegment {
            rpm: *rpm,
            minutes: RUN_IN_STEP_DURATION_MIN,
            load_n: 0.0,
        }));
        highest_rpm = stretch.rpm.max(highest_rpm);
        whole.push(stretch);
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cold_spindle_is_run_in_before_each_higher_speed() {
        let stretch = |rpm, minutes| SpindleSegment { rpm, minutes, load_n: 0.0 };
        let speeds = [3000.0, 6000.0, 9000.0, 12_000.0];
        let run = vec![stretch(0.0, 5.0), stretch(12_000.0, 8.0), stretch(6000.0, 8.0)];
        let whole = insert_run_ins(run, &speeds);
        let rpm: Vec<f64> = whole.iter().map(|segment| segment.rpm).collect();
        assert_eq!(rpm, [0.0, 3000.0, 6000.0, 9000.0, 12_000.0, 6000.0]);
        assert_eq!(whole[1].minutes, RUN_IN_STEP_DURATION_MIN);
        let slow = vec![stretch(3000.0, 5.0)];
        assert_eq!(insert_run_ins(slow.clone(), &speeds), slow);
    }
}
