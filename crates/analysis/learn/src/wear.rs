//! Backlashes that grow slowly: a straight line over all readings since the width was last another one.
//!
//! ```text
//! r = g·x + e − ē          what a reading in the negative direction says of the width, as a share of it; e what the prediction
//!                         before it missed, held to two scatters; ē the mean of e of the last readings in the positive one
//! r = g·(s₀ + s·t) + ε    least squares; s₀ is 0 where that agrees with the readings: the file was right when they began
//! ```
//!
//! A lag in the other constants (a season after a thermometer was moved) shifts both directions alike: ē takes it off.
//!
//! A line over all readings knows the growth far better than the estimate of today less that of the first weeks: that
//! forgets, and lags behind. It is wear when s differs from 0 by [`MIN_SLOPE_SIGMAS`] standard errors.

use crate::{
    event::{DetectedEvent, EventAction, EventKind, round_to_three_digits},
    learnable_constants::LearnableConstant,
    learner_state::{LearnerState, StoredReading},
    wear_regression::{MIN_SLOPE_SIGMAS, RegressionSums},
};

/// Days that a line needs: a month.
const MIN_WEAR_SPAN_S: f64 = 30.0 * 86_400.0;
/// Scatters by which one reading counts at most.
const CLIPPING_LIMIT_SIGMAS: f64 = 2.0;
/// Readings in the positive direction that say what misses both alike: ten days of two a day. Fewer add more noise than they take off.
const COMMON_MODE_READINGS: usize = 10;
/// The unit of t, in s.
const SECONDS_PER_YEAR: f64 = 365.25 * 86_400.0;

/// Returns true for a constant that wears.
pub(crate) fn is_subject_to_wear(constant: &LearnableConstant) -> bool {
    constant.key.ends_with("backlash.width_um")
}

/// Returns what a reading says of each backlash, in µm: the readings before it, its sensitivities, what is believed before it, what
/// that misses, and the scatter of a reading.
pub(crate) fn backlash_observations(
    constants: &[LearnableConstant],
    before: &[StoredReading],
    g: &[f64],
    believed: &[f64],
    missed_um: f64,
    scatter_um: f64,
) -> Vec<f64> {
    let held_um =
        missed_um.clamp(-CLIPPING_LIMIT_SIGMAS * scatter_um, CLIPPING_LIMIT_SIGMAS * scatter_um);
    let worn = constants.iter().enumerate().filter(|(_, constant)| is_subject_to_wear(constant));
    worn.enumerate()
        .map(|(number, (index, _))| {
            let width_um = g[index + 1];
            if width_um == 0.0 {
                return held_um;
            }
            let others = before.iter().rev().filter(|stored| stored.g[index + 1] == 0.0);
            let others =
                others.filter_map(|stored| stored.worn.get(number)).take(COMMON_MODE_READINGS);
            let (sum, count) = others.fold((0.0, 0), |(sum, count), um| (sum + um, count + 1));
            let alike_um =
                if count == COMMON_MODE_READINGS { sum / COMMON_MODE_READINGS as f64 } else { 0.0 };
            width_um * believed[index + 1] + held_um - alike_um
        })
        .collect()
}

/// Takes the window's first reading into the sums: it leaves the window.
pub(crate) fn accumulate_oldest_reading(memory: &mut LearnerState) {
    let mut worn = std::mem::take(&mut memory.worn);
    add_readings(memory, 0..1, &mut worn);
    memory.worn = worn;
}

/// Adds readings of the window to the sums.
fn add_readings(
    memory: &LearnerState,
    rows: std::ops::Range<usize>,
    worn: &mut Vec<RegressionSums>,
) {
    let all =
        memory.constants.iter().enumerate().filter(|(_, constant)| is_subject_to_wear(constant));
    for (number, (index, _)) in all.enumerate() {
        if worn.len() <= number {
            worn.push(RegressionSums::default());
        }
        // Where the width has become another one by an event it begins anew.
        let is_new = |event: &&DetectedEvent| match &event.action {
            EventAction::Shift(all) => {
                all.iter().any(|entry| entry.0 == index + 1 && entry.1 != 0.0)
            }
            _ => false,
        };
        let since = memory.events.iter().filter(is_new).map(|event| event.sequence).max();
        for (n, stored) in memory.window[rows.clone()].iter().enumerate() {
            let sequence = memory.first + (rows.start + n) as u64;
            if since == Some(sequence) {
                worn[number] = RegressionSums::default();
            }
            let (Some(t), Some(first_s)) = (stored.t, memory.first_s) else { continue };
            let (g, r) = (stored.g[index + 1], stored.worn.get(number));
            if let Some(r) = r.filter(|_| g.abs() > 0.0) {
                worn[number].add_reading(g, *r, (t - first_s) / SECONDS_PER_YEAR);
            }
        }
    }
}

/// Looks at the backlashes after the window's last reading; `scatter_um` of a reading, at the upper end of what it may be.
/// A wear whose interval no longer excludes zero is taken back.
pub(crate) fn detect_wear(memory: &mut LearnerState, scatter_um: f64) {
    let Some(t_s) = memory.first_s.zip(memory.last_s).map(|(first, last)| last - first) else {
        return;
    };
    if t_s < MIN_WEAR_SPAN_S || !memory.constants.iter().any(is_subject_to_wear) {
        return;
    }
    let mut worn = memory.worn.clone();
    add_readings(memory, 0..memory.window.len(), &mut worn);
    let places =
        (0..memory.constants.len()).filter(|index| is_subject_to_wear(&memory.constants[*index]));
    for (place, sums) in places.collect::<Vec<_>>().into_iter().zip(&worn) {
        let (key, width_um) =
            (memory.constants[place].key.clone(), memory.constants[place].believed);
        let known = memory.events.iter().rposition(|event| {
            event.event == EventKind::Wear && event.constant.as_deref() == Some(&key)
        });
        let Some([slope, error]) = sums.slope_with_standard_error(scatter_um) else { continue };
        if known.is_none() && slope.abs() <= MIN_SLOPE_SIGMAS * error {
            continue;
        }
        let [size, half] = [slope * width_um, 1.96 * (error * width_um).abs()]
            .map(|rate| rate * t_s / SECONDS_PER_YEAR);
        let [size, low, high] = [size, size - half, size + half].map(round_to_three_digits);
        if let Some(place) = known.filter(|_| slope.abs() <= 1.96 * error) {
            memory.events.remove(place);
            continue;
        }
        if let Some(place) = known {
            let event = &mut memory.events[place];
            (event.size, event.ci95) = (size, [low, high]);
            continue;
        }
        memory.events.push(DetectedEvent {
            event: EventKind::Wear,
            constant: Some(key),
            at: memory.first_s,
            certain_at: memory.last_s,
            size,
            unit: "µm".into(),
            ci95: [low, high],
            check: DetectedEvent::advice(EventKind::Wear, &[]),
            alternatives: Vec::new(),
            sequence: memory.next_sequence_number() - 1,
            action: EventAction::Nothing,
            is_open: false,
        });
    }
}
