//! Thermometers that are late (`thermometer-lag`): the temperature of the part from a whole column.
//!
//! ```text
//! as it was τ ago:      T(t + τ)
//! behind a lag of τ:    T(t) + d·(T(t − Δ/2 + w/2) − T(t − Δ/2 − w/2))/w          d = Δ/(e^(Δ/τ) − 1)
//! ```
//!
//! Δ is the time since the row before. A row's value holds over the interval that ends with it
//! ([`Lag`](super::Lag)), so that of what rises steadily the lag is not τ behind but d, about τ − Δ/2; the
//! step from the row before undoes it exactly, whose slope is that of the middle between the two. Over a
//! longer time w, or what of that is in the record, the slope is less noisy. A record begins at the first row
//! with a thermometer that has settled, and mostly with a start: there w reaches no farther ahead than back,
//! for what comes has not yet come. After a gap that is much longer than τ the thermometer has arrived, and d
//! is 0.
//!
//! Both look ahead, so that they are made of the recorded run before it is stepped through. A model that
//! steps without them takes the thermometer's word.

use std::{borrow::Cow, cmp::Ordering, ops::Range};

use super::RowInputs;
use crate::{
    effect::{DelayKind, Quantity, ThermometerDelay},
    machine_file::Machine,
    sections::ElongationSource,
};

/// Returns the part's temperature in °C at each time, from that of its thermometer: linear between the rows, the
/// end values held; of one series, whose time does not run back. NaN where either is missing.
///
/// ```
/// use trueup_machine::{effect::{ThermometerDelay, DelayKind}, model::part_temperature_c};
/// // It warms by 1 K in 10 s.
/// let time_s = [0.0, 10.0, 20.0, 30.0, 40.0];
/// let shown_c = [20.0, 21.0, 22.0, 23.0, 24.0];
/// let delay = part_temperature_c(ThermometerDelay { by_s: 20.0, form: DelayKind::Delay }, &time_s, &shown_c);
/// assert_eq!(delay, [22.0, 23.0, 24.0, 24.0, 24.0]);
/// let lag = part_temperature_c(ThermometerDelay { by_s: 20.0, form: DelayKind::Lag { slope_over: 1.0 } }, &time_s, &shown_c);
/// let behind_c = 1.0 / (0.5_f64.exp() - 1.0); // 10 s/(e^(10/20) − 1) at 0.1 K/s
/// assert!((lag[2] - (22.0 + behind_c)).abs() < 1e-12);
/// ```
#[must_use]
pub fn part_temperature_c(late: ThermometerDelay, time_s: &[f64], shown_c: &[f64]) -> Vec<f64> {
    if let Some(inner) = EvenlySpacedRows::from_readings(late, time_s, shown_c) {
        let apart_s = |row: usize| if row == 0 { 0.0 } else { time_s[row] - time_s[row - 1] };
        return compute_part_temperatures(late, time_s, shown_c, &inner, apart_s);
    }
    let mut before_s = f64::NAN;
    let apart_s = |row: usize| {
        let now_s: f64 = time_s[row];
        let before_s = std::mem::replace(&mut before_s, now_s);
        if before_s.is_nan() { 0.0 } else { now_s - before_s }
    };
    compute_part_temperatures(late, time_s, shown_c, &EvenlySpacedRows::default(), apart_s)
}

/// Returns the same where a thermometer's values are means over several rows each, at the mean of their times: what its
/// lag did to them goes by how far those rows were `apart_s`.
#[must_use]
pub fn part_temperature_from_means_c(
    late: ThermometerDelay,
    time_s: &[f64],
    apart_s: &[f64],
    mean_c: &[f64],
) -> Vec<f64> {
    compute_part_temperatures(late, time_s, mean_c, &EvenlySpacedRows::default(), |row| {
        apart_s[row]
    })
}

/// Of those rows in the middle of a series that are equally far apart, what the part's temperature is made of:
/// both ends of a slope lie equally far from each.
#[derive(Default)]
struct EvenlySpacedRows {
    rows: Range<usize>,
    /// The value of a row, that at the first end and that at the second one are taken this many times.
    times: [f64; 3],
    /// How far the ends are from a row: whole rows, and the rest.
    ends: [(isize, f64); 2],
}

impl EvenlySpacedRows {
    /// None where rows are not equally far apart, or a value is missing.
    fn from_readings(late: ThermometerDelay, time_s: &[f64], shown_c: &[f64]) -> Option<Self> {
        let last = time_s.len().checked_sub(1).filter(|last| *last > 0)?;
        let apart_s = (time_s[last] - time_s[0]) / last as f64;
        let off = |(row, now_s): (usize, &f64)| (now_s - (time_s[0] + apart_s * row as f64)).abs();
        // But for the rounding of their times.
        let are_even = time_s.iter().enumerate().all(|row| off(row) <= 1e-9 * apart_s);
        if apart_s.partial_cmp(&0.0) != Some(Ordering::Greater)
            || late.by_s.partial_cmp(&0.0) != Some(Ordering::Greater)
            || !are_even
            || shown_c.iter().any(|c| c.is_nan())
        {
            return None;
        }
        let (times, ends) = match late.form {
            DelayKind::Delay => ([0.0, 0.0, 1.0], [late.by_s / apart_s; 2]),
            DelayKind::Lag { slope_over } => {
                let width_s = (slope_over * late.by_s).max(apart_s);
                let ratio = apart_s / late.by_s;
                let times = apart_s / ratio.exp_m1() / width_s;
                let half = 0.5 * width_s / apart_s;
                ([1.0, -times, times], [-0.5 - half, -0.5 + half])
            }
        };
        let ends = ends.map(|end| (end.floor() as isize, end - end.floor()));
        let first = (-ends[0].0).max(1);
        let end = last as isize - ends[1].0.max(0);
        let rows = (first < end).then_some(first as usize..end as usize)?;
        Some(Self { rows, times, ends })
    }

    /// The part's temperature in its rows.
    fn append_part_temperatures(&self, shown_c: &[f64], out: &mut Vec<f64>) {
        let Self { rows, times: [own, first, second], ends } = self;
        let shown = |whole: isize| &shown_c[rows.start.wrapping_add_signed(whole)..][..rows.len()];
        let [begin, end] = ends.map(|(whole, rest)| (shown(whole), shown(whole + 1), rest));
        let here = &shown_c[rows.clone()];
        out.extend((0..rows.len()).map(|n| {
            let along =
                |(low, high, rest): (&[f64], &[f64], f64)| low[n] + (high[n] - low[n]) * rest;
            own * here[n] + first * along(begin) + second * along(end)
        }));
    }
}

/// `apart_s`: since the reading before that of a row, of those that have both; asked for in their order, but for
/// the `inner` rows.
fn compute_part_temperatures(
    late: ThermometerDelay,
    time_s: &[f64],
    shown_c: &[f64],
    inner: &EvenlySpacedRows,
    mut apart_s: impl FnMut(usize) -> f64,
) -> Vec<f64> {
    let (known_s, known_c) = drop_missing_rows(time_s, shown_c);
    let mut shown = ReadingInterpolator { time_s: &known_s, shown_c: &known_c, begin: 0, end: 0 };
    // Most rows are as far apart as the rows before them, but for the rounding of their times.
    let (mut before_s, mut share) = (0.0, 1.0);
    let mut of = |row: usize| {
        let (now_s, now_c) = (time_s[row], shown_c[row]);
        if now_s.is_nan() || now_c.is_nan() {
            return f64::NAN;
        }
        let DelayKind::Lag { slope_over } = late.form else {
            return shown.end_temperature_c(now_s + late.by_s);
        };
        let elapsed_s = apart_s(row);
        if (elapsed_s - before_s).abs() > 1e-9 * elapsed_s {
            before_s = elapsed_s;
            let ratio = elapsed_s / late.by_s;
            // The limit for rows at the same time.
            share = if ratio == 0.0 { 1.0 } else { ratio / ratio.exp_m1() };
        }
        let middle_s = now_s - elapsed_s / 2.0;
        let back_s = middle_s - known_s[0];
        // The first mean stands for rows that have others before them.
        let reach_s = if back_s < 0.0 { f64::INFINITY } else { 2.0 * back_s };
        let width_s = (slope_over * late.by_s).min(reach_s).max(elapsed_s);
        now_c + share * late.by_s * shown.slope(middle_s, width_s)
    };
    let mut out = Vec::with_capacity(shown_c.len());
    out.extend((0..inner.rows.start).map(&mut of));
    inner.append_part_temperatures(shown_c, &mut out);
    out.extend((inner.rows.end..shown_c.len()).map(of));
    out
}

/// Returns the rows that have both.
fn drop_missing_rows<'a>(
    time_s: &'a [f64],
    shown_c: &'a [f64],
) -> (Cow<'a, [f64]>, Cow<'a, [f64]>) {
    let rows = || time_s.iter().zip(shown_c);
    let is_known = |(t, c): &(&f64, &f64)| !(**t + **c).is_nan();
    if rows().all(|row| is_known(&row)) {
        return (Cow::Borrowed(time_s), Cow::Borrowed(shown_c));
    }
    let (time_s, shown_c): (Vec<f64>, Vec<f64>) = rows().filter(is_known).unzip();
    (time_s.into(), shown_c.into())
}

/// The readings of a thermometer at any time. Calls go forward in time, so that each of two ends has a
/// row of its own from which it looks on.
struct ReadingInterpolator<'a> {
    time_s: &'a [f64],
    shown_c: &'a [f64],
    begin: usize,
    end: usize,
}

impl ReadingInterpolator<'_> {
    /// Returns the slope in K/s over `width_s` around a time, of which what is in the record counts.
    fn slope(&mut self, middle_s: f64, width_s: f64) -> f64 {
        let last = self.time_s.len() - 1;
        let begin_s = (middle_s - width_s / 2.0).max(self.time_s[0]);
        let end_s = (middle_s + width_s / 2.0).min(self.time_s[last]);
        let risen_c = self.end_temperature_c(end_s) - self.start_temperature_c(begin_s);
        if end_s > begin_s { risen_c / (end_s - begin_s) } else { 0.0 }
    }

    fn start_temperature_c(&mut self, at_s: f64) -> f64 {
        self.begin = self.last_row_at_or_before(at_s, self.begin);
        self.interpolate_from(self.begin, at_s)
    }

    fn end_temperature_c(&mut self, at_s: f64) -> f64 {
        self.end = self.last_row_at_or_before(at_s, self.end);
        self.interpolate_from(self.end, at_s)
    }

    /// Returns the last row that is not after a time, or the first of all, looked for from the row `near` it.
    fn last_row_at_or_before(&self, at_s: f64, mut near: usize) -> usize {
        while near > 0 && self.time_s[near] > at_s {
            near -= 1;
        }
        while near + 1 < self.time_s.len() && self.time_s[near + 1] <= at_s {
            near += 1;
        }
        near
    }

    /// Linear between a row and the next, the end values held.
    fn interpolate_from(&self, low: usize, at_s: f64) -> f64 {
        let high = (low + 1).min(self.time_s.len() - 1);
        let width_s = self.time_s[high] - self.time_s[low];
        let share = if width_s > 0.0 { (at_s - self.time_s[low]) / width_s } else { 0.0 };
        self.shown_c[low] + (self.shown_c[high] - self.shown_c[low]) * share.clamp(0.0, 1.0)
    }
}

/// Returns the temperatures of the parts whose thermometers are late by `machine`'s terms, for each row of a run,
/// by the names under which [`ReferenceModel`](super::ReferenceModel) looks for them among the others;
/// `column` gives a column of the run.
#[must_use]
pub fn part_temperature_columns<'r>(
    machine: &Machine,
    column: impl Fn(&str) -> Option<&'r [f64]>,
) -> Vec<(String, Vec<f64>)> {
    let Some(time_s) = column("time_s") else { return Vec::new() };
    let of = |quantity: Quantity| {
        let (sensor, late) = find_delayed_thermometer(machine, quantity)?;
        let part_c = part_temperature_c(late, time_s, column(sensor)?);
        Some((part_column_name(quantity), part_c))
    };
    Quantity::ALL.into_iter().filter_map(of).collect()
}

/// The parts whose thermometers are late.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DelayedParts([bool; 4]);

impl DelayedParts {
    pub(super) fn from_machine(machine: &Machine) -> Self {
        Self(Quantity::ALL.map(|quantity| find_delayed_thermometer(machine, quantity).is_some()))
    }

    /// Returns the temperature that `quantity` follows: its thermometer's, or what is known of the part.
    pub(super) fn driving_temperature_c(
        self,
        quantity: Quantity,
        sensor: &str,
        situation: &RowInputs<'_>,
    ) -> f64 {
        let is_late =
            self.0[Quantity::ALL.iter().position(|other| *other == quantity).unwrap_or(0)];
        let part = is_late
            .then(|| part_column_name(quantity))
            .and_then(|name| situation.temperatures_c.iter().find(|(there, _)| *there == name));
        part.map_or_else(|| situation.temperature_c(sensor), |&(_, part_c)| part_c)
    }
}

/// No column of a run has this name: it ends with no unit.
fn part_column_name(quantity: Quantity) -> String {
    format!("the part of {}", quantity.name())
}

/// Returns the thermometer of `quantity`'s own law, and how late it is.
fn find_delayed_thermometer(
    machine: &Machine,
    quantity: Quantity,
) -> Option<(&str, ThermometerDelay)> {
    let of_quantity = machine.terms.iter().filter(|term| term.quantity == quantity);
    let late = of_quantity.filter_map(|term| term.effect.thermometer_delay()).next_back()?;
    let sensor = match quantity.axis() {
        Some(axis) => &machine.axes[axis.index()].thermal.as_ref()?.sensor,
        None if machine.spindle.source == Some(ElongationSource::Temperature) => {
            &machine.spindle.temperature.as_ref()?.sensor
        }
        None => return None,
    };
    Some((sensor, late))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Lag;

    fn behind(by_s: f64, slope_over: f64) -> ThermometerDelay {
        ThermometerDelay { by_s, form: DelayKind::Lag { slope_over } }
    }

    #[test]
    fn over_the_whole_time_constant_the_noise_of_a_thermometer_counts_less_than_twice() {
        let time_s: Vec<f64> = (0..2000).map(f64::from).collect();
        let mut state = 1_u32;
        let noise_c: Vec<f64> = time_s
            .iter()
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                f64::from(state >> 16) / 65_536.0 - 0.5
            })
            .collect();
        let rms = |c: &[f64]| (c.iter().map(|c| c * c).sum::<f64>() / c.len() as f64).sqrt();
        let times = |over: f64| {
            rms(&part_temperature_c(behind(30.0, over), &time_s, &noise_c)) / rms(&noise_c)
        };
        assert!(times(1.0) < 2.0, "{}", times(1.0));
        assert!(times(0.0) > 30.0, "{}", times(0.0));
    }

    /// A part that warms and cools as 20 + 5·sin(t/500), and a thermometer 40 s behind it.
    #[test]
    fn what_a_lag_has_done_to_a_slow_temperature_is_undone() {
        for spacing_s in [5.0, 20.0] {
            let time_s: Vec<f64> = (0..400).map(|n| f64::from(n) * spacing_s).collect();
            let part_c: Vec<f64> = time_s.iter().map(|t| 20.0 + 5.0 * (t / 500.0).sin()).collect();
            let mut lag = Lag::default();
            let rows = time_s.iter().zip(&part_c);
            let shown_c: Vec<f64> = rows.map(|(&t, &c)| lag.step(40.0, t, c)).collect();
            let exact_c = part_temperature_c(behind(40.0, 0.0), &time_s, &shown_c);
            assert!(exact_c.iter().zip(&part_c).skip(1).all(|(a, b)| (a - b).abs() < 1e-9));
            let found_c = part_temperature_c(behind(40.0, 1.0), &time_s, &shown_c);
            // From where the start has passed: the thermometer was off by 0.4 K.
            let inner = 20..380;
            let off = |c: &[f64]| {
                inner.clone().map(|row| (c[row] - part_c[row]).abs()).fold(0.0, f64::max)
            };
            assert!(
                off(&shown_c) > 0.3 && off(&found_c) < 0.003,
                "{} {}",
                off(&shown_c),
                off(&found_c)
            );
        }
    }

    /// A start right after the first row: a slope that looked ahead of it would have it before it came.
    #[test]
    fn what_a_part_does_after_the_first_row_is_not_seen_in_it() {
        let time_s: Vec<f64> = (0..200).map(|n| f64::from(n) * 5.0).collect();
        let part_c: Vec<f64> = time_s.iter().map(|t| if *t > 0.0 { 25.0 } else { 20.0 }).collect();
        let mut lag = Lag::default();
        let shown_c: Vec<f64> =
            time_s.iter().zip(&part_c).map(|(&t, &c)| lag.step(60.0, t, c)).collect();
        for over in [0.0, 0.3, 1.0] {
            let found_c = part_temperature_c(behind(60.0, over), &time_s, &shown_c);
            let off = found_c.iter().zip(&part_c).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 0.25, "{over}: {off} of 5 K");
        }
    }

    #[test]
    fn rows_that_are_equally_far_apart_have_the_temperature_that_each_has_alone() {
        let time_s: Vec<f64> = (0..500).map(|n| f64::from(n) * 0.7).collect();
        let shown_c: Vec<f64> = time_s.iter().map(|t| 20.0 + (t / 9.0).sin()).collect();
        // The last one comes late by more than rounding.
        let uneven_s = [&time_s[..499], &[349.3 + 1e-6]].concat();
        let forms = [DelayKind::Delay, DelayKind::Lag { slope_over: 0.3 }];
        for form in [forms[0], forms[1], DelayKind::Lag { slope_over: 1.0 }] {
            for by_s in [0.05, 0.7, 13.3, 100.0, 400.0] {
                let late = ThermometerDelay { by_s, form };
                let even_c = part_temperature_c(late, &time_s, &shown_c);
                let uneven_c = part_temperature_c(late, &uneven_s, &shown_c);
                for (row, (a, b)) in even_c.iter().zip(&uneven_c).enumerate().take(499) {
                    assert!((a - b).abs() < 1e-6, "{late:?}, row {row}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn a_missing_row_is_missing_and_no_other_is() {
        let late = ThermometerDelay { by_s: 10.0, form: DelayKind::Delay };
        let found_c = part_temperature_c(late, &[0.0, 10.0, 20.0], &[20.0, f64::NAN, 22.0]);
        assert_eq!([found_c[0], found_c[2]], [21.0, 22.0]);
        assert!(found_c[1].is_nan());
    }
}
