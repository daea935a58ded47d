//! The runs that are thought of: every one begins cold, and lasts an hour and a half at most.

use super::{Stretch, foresight::Foresight};

/// Shares of the fastest speed that was run.
const SPEEDS: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// How long one speed is run, and how long the spindle then stands, in minutes.
const HEAT_MIN: [f64; 8] = [5.0, 8.0, 12.0, 20.0, 30.0, 40.0, 50.0, 60.0];
const COOL_MIN: [f64; 5] = [0.0, 5.0, 10.0, 20.0, 30.0];
/// What changes quickly stays for so long, in minutes, and comes so often: quick against heat, slow against the dial.
const QUICK_MIN: f64 = 2.0;
const QUICK_TIMES: [usize; 4] = [1, 2, 4, 8];

/// All of them.
pub(super) fn candidates(foresight: &Foresight) -> Vec<Vec<Stretch>> {
    let speeds = SPEEDS.map(|share| (share * foresight.fastest_rpm / 100.0).round() * 100.0);
    let stretch = |rpm: f64, minutes: f64| Stretch { rpm, minutes, load_n: 0.0 };
    let mut all = Vec::new();
    for rpm in speeds {
        for heat in HEAT_MIN {
            for cool in COOL_MIN {
                let mut run = vec![stretch(rpm, heat)];
                run.extend((cool > 0.0).then(|| stretch(0.0, cool)));
                all.push(run);
            }
        }
        for slower in speeds.into_iter().chain([0.0]).filter(|slower| *slower < rpm) {
            for times in QUICK_TIMES {
                all.push([stretch(rpm, QUICK_MIN), stretch(slower, QUICK_MIN)].repeat(times));
            }
            // Slow first, or fast first: heat that is there already, or not yet.
            for minutes in HEAT_MIN.into_iter().filter(|minutes| *minutes <= 40.0) {
                all.push(vec![stretch(rpm, minutes), stretch(slower, minutes)]);
                all.push(vec![stretch(slower, minutes), stretch(rpm, minutes)]);
            }
        }
        if let Some(load_n) = foresight.most_load_n {
            for times in QUICK_TIMES {
                let cut = Stretch { load_n, ..stretch(rpm, QUICK_MIN) };
                all.push([stretch(rpm, QUICK_MIN), cut].repeat(times));
            }
        }
    }
    all.retain(|run| run.iter().any(|stretch| stretch.rpm > 0.0));
    all
}
