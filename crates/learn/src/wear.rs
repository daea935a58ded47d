//! Backlashes that grow slowly: a straight line over all readings since the width was last another one.
//!
//! ```text
//! r = g·x + e             what a reading in the negative direction says of the width, as a share of it; e what the prediction
//!                         before it missed, held to two scatters
//! r = g·(s₀ + s·t) + ε    least squares; s₀ is 0 where that agrees with the readings: the file was right when they began
//! ```
//!
//! A line over all readings knows the growth far better than the estimate of today less that of the first weeks: that
//! forgets, and lags behind. It is wear when s differs from 0 by [`CERTAIN`] standard errors.

use serde::{Deserialize, Serialize};

use crate::{
    constants::Constant,
    event::{Action, Event, EventKind, digits},
    memory::Memory,
    replay::Believed,
};

/// Standard errors of the slope: once in 10⁶ by chance.
const CERTAIN: f64 = 5.0;
/// Standard errors from which s₀ is another one: as alternatives are distinguished.
const AGREES: f64 = 4.0;
/// Readings in the negative direction, and days, that a line needs: a month of two a day, and a month.
const FEWEST: f64 = 30.0;
const SHORTEST_S: f64 = 30.0 * 86_400.0;
/// Scatters by which one reading counts at most.
const COUNTS: f64 = 2.0;
/// The unit of t, in s.
const YEAR_S: f64 = 365.25 * 86_400.0;

/// Sums over the readings of one backlash, as far as they have left the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Sums {
    /// Readings.
    n: f64,
    /// Σ g², Σ g²·t, Σ g²·t².
    gg: [f64; 3],
    /// Σ g·r, Σ g·r·t.
    gr: [f64; 2],
}

impl Sums {
    /// Adds a reading: its sensitivity to the width in µm, what it says of it in µm, its time in years.
    fn add(&mut self, g: f64, r: f64, t: f64) {
        self.n += 1.0;
        (0..3).for_each(|power| self.gg[power] += g * g * t.powi(power as i32));
        (0..2).for_each(|power| self.gr[power] += g * r * t.powi(power as i32));
    }

    /// Returns s and its standard error, for a scatter in µm; `None` where there is no line.
    fn slope(&self, scatter_um: f64) -> Option<[f64; 2]> {
        let ([one, t, tt], [r, rt]) = (self.gg, self.gr);
        let determinant = one * tt - t * t;
        // Readings at one time have no line.
        if self.n < FEWEST || determinant <= 1e-9 * one * tt {
            return None;
        }
        let start = (tt * r - t * rt) / determinant;
        if start.abs() < AGREES * scatter_um * (tt / determinant).sqrt() {
            return Some([rt / tt, scatter_um / tt.sqrt()]);
        }
        Some([(one * rt - t * r) / determinant, scatter_um * (one / determinant).sqrt()])
    }
}

/// Returns true for a constant that wears.
pub(crate) fn wears(constant: &Constant) -> bool {
    constant.key.ends_with("backlash.width_um")
}

/// Returns what a reading says of each backlash, in µm: its sensitivities, what is believed before it, what that misses, and the
/// scatter of a reading.
pub(crate) fn said(
    constants: &[Constant],
    g: &[f64],
    believed: &[f64],
    missed_um: f64,
    scatter_um: f64,
) -> Vec<f64> {
    let held_um = missed_um.clamp(-COUNTS * scatter_um, COUNTS * scatter_um);
    let worn = constants.iter().enumerate().filter(|(_, it)| wears(it));
    worn.map(|(index, _)| g[index + 1] * believed[index + 1] + held_um).collect()
}

/// Takes the window's first reading into the sums: it leaves the window.
pub(crate) fn leave(memory: &mut Memory) {
    let mut worn = std::mem::take(&mut memory.worn);
    add(memory, 0..1, &mut worn);
    memory.worn = worn;
}

/// Adds readings of the window to the sums.
fn add(memory: &Memory, rows: std::ops::Range<usize>, worn: &mut Vec<Sums>) {
    let all = memory.constants.iter().enumerate().filter(|(_, it)| wears(it));
    for (number, (index, _)) in all.enumerate() {
        if worn.len() <= number {
            worn.push(Sums::default());
        }
        // Where the width has become another one by an event it begins anew.
        let is_new = |event: &&Event| match &event.action {
            Action::Shift(all) => all.iter().any(|it| it.0 == index + 1 && it.1 != 0.0),
            _ => false,
        };
        let since = memory.events.iter().filter(is_new).map(|event| event.sequence).max();
        for (n, kept) in memory.window[rows.clone()].iter().enumerate() {
            let sequence = memory.first + (rows.start + n) as u64;
            if since == Some(sequence) {
                worn[number] = Sums::default();
            }
            let (Some(t), Some(first_s)) = (kept.t, memory.first_s) else { continue };
            let (g, r) = (kept.g[index + 1], kept.worn.get(number));
            if let Some(r) = r.filter(|_| g.abs() > 0.0) {
                worn[number].add(g, *r, (t - first_s) / YEAR_S);
            }
        }
    }
}

/// Looks at the backlashes after the window's last reading.
pub(crate) fn watch(memory: &mut Memory, believed: &Believed) {
    let Some(t_s) = memory.first_s.zip(memory.last_s).map(|(first, last)| last - first) else {
        return;
    };
    if t_s < SHORTEST_S || !memory.constants.iter().any(wears) {
        return;
    }
    let mut worn = memory.worn.clone();
    add(memory, 0..memory.window.len(), &mut worn);
    let scatter_um = believed.bank.scatter_um()[0];
    let places = (0..memory.constants.len()).filter(|index| wears(&memory.constants[*index]));
    for (place, sums) in places.collect::<Vec<_>>().into_iter().zip(&worn) {
        let (key, width_um) =
            (memory.constants[place].key.clone(), memory.constants[place].believed);
        let known = memory.events.iter().rposition(|event| {
            event.event == EventKind::Wear && event.constant.as_deref() == Some(&key)
        });
        let Some([slope, error]) = sums.slope(scatter_um) else { continue };
        if known.is_none() && slope.abs() <= CERTAIN * error {
            continue;
        }
        let [size, half] =
            [slope * width_um, 1.96 * (error * width_um).abs()].map(|it| it * t_s / YEAR_S);
        let [size, low, high] = [size, size - half, size + half].map(digits);
        if let Some(place) = known {
            let event = &mut memory.events[place];
            (event.size, event.ci95) = (size, [low, high]);
            continue;
        }
        memory.events.push(Event {
            event: EventKind::Wear,
            constant: Some(key),
            at: memory.first_s,
            certain_at: memory.last_s,
            size,
            unit: "µm".into(),
            ci95: [low, high],
            check: Event::advice(EventKind::Wear, &[]),
            alternatives: Vec::new(),
            sequence: memory.next() - 1,
            action: Action::Nothing,
            is_open: false,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_width_that_grows_is_a_line_and_one_that_was_wrong_from_the_start_is_not() {
        let noise = [1.5, -2.0, 0.5, -1.0, 2.0, -0.5, 0.0, -1.5, 1.0];
        let sums = |start: f64, per_year: f64| {
            let mut sums = Sums::default();
            for n in 0..250 {
                let t = f64::from(n) / 250.0;
                let g = 4.0;
                sums.add(g, g * (start + per_year * t) + noise[n as usize % 9], t);
            }
            sums.slope(1.3).expect("a line")
        };
        let [slope, error] = sums(0.0, 1.25);
        assert!((slope - 1.25).abs() < 2.0 * error && error < 0.05, "{slope} {error}");
        let [slope, error] = sums(1.0, 0.0);
        assert!(slope.abs() < CERTAIN * error, "{slope} {error}");
    }
}
