//! One thermometer's values, judged by its own noise, its last digit and its own steps.
//!
//! | fault | is recognised by |
//! |---|---|
//! | absent | a value beyond what a resistance thermometer can show; one that a converter sends for a fault; or always the same one, apart from all the others, entered and left in one step |
//! | frozen | a run of equal values that is far longer than the noise on its last digit allows; or one that is entered or left by a step which no other is near |
//! | jump | one step that no other is near, complete from one row to the next, as no thermal mass moves |
//!
//! No threshold is a temperature of a machine: each is a probability, an end of IEC 60751, or from a data sheet.

use std::{f64::consts::SQRT_2, ops::Range};

use statrs::function::erf::erfc;

/// The chance behaviour of a sound channel is believed down to this probability: one false alarm in a
/// million channels for a step, whose tail is fitted. A tenth or ten times of it is a step of 8 % further or nearer.
const STEP_FALSE_ALARM_RATE: f64 = 1e-6;
/// And one in 10⁹ for a run of equal values, for which the noise is taken to be white, or for two channels that change
/// alike.
pub const EQUALITY_FALSE_ALARM_RATE: f64 = 1e-9;
/// IEC 60751: a platinum thermometer ends at −200 °C and at 850 °C, which is what an open or a shorted
/// one shows.
const RTD_RANGE_C: [f64; 2] = [-200.0, 850.0];
/// The value that a DS18B20's driver sends where the sensor does not answer; no machine is as cold.
const DEVICE_DISCONNECTED_C: f64 = -127.0;
/// The value of a DS18B20 from its power-on until its first conversion (data sheet).
const POWER_ON_RESET_C: f64 = 85.0;
/// A step to or from the value of a power-on that no thermal mass of a machine makes within
/// [`MAX_ROW_GAP_S`], in K: 4 K/min.
const MIN_POWER_ON_STEP_K: f64 = 20.0;
/// Rows nearer than this are near enough to distinguish such a step from heat, in s.
pub const MAX_ROW_GAP_S: f64 = 300.0;
/// The largest steps of a channel by which their tail is known: as many as make its scale known to a
/// fifth (1/√20).
const TAIL_STEP_COUNT: usize = 20;
/// A step whose neighbour goes on by more than this share of it is the way of a thermal mass: one with a
/// time constant of a third of a row and more (e⁻³).
const MAX_CONTINUATION_RATIO: f64 = 0.05;
/// Rows on each side by which a value is compared with its neighbours' median.
const NEIGHBOUR_ROWS_PER_SIDE: usize = 3;
/// Parts of a channel of which the quietest says how much noise there is.
const NOISE_SEGMENT_COUNT: usize = 4;
/// Values of a part that are looked at: they show its share of flickering to a hundredth.
const MAX_VALUES_PER_SEGMENT: usize = 4096;
/// The most that a sound channel changes from row to row: a logger that is faster than its thermometers
/// writes each reading down twice.
const MAX_CHANGE_PROBABILITY: f64 = 0.5;
/// Levels of the last digit that a channel must have been at: only then its noise was seen at all
/// phases between two of them.
const MIN_QUANTISATION_LEVELS: usize = 5;

/// A fault of a channel, in rows of its file.
#[derive(Clone, Debug, PartialEq)]
pub enum ThermometerFault {
    /// It shows no temperature.
    Absent {
        /// The value shown, in °C; of values beyond the ends of IEC 60751 the first.
        shown: f64,
        /// Where.
        rows: Vec<Range<usize>>,
    },
    /// It stands still.
    Frozen {
        /// At this, in °C.
        shown: f64,
        /// Where.
        rows: Range<usize>,
    },
    /// It is higher from a row on, which only a thermometer's own fault can do if none near it moves.
    Jump {
        /// By this, in K.
        by: f64,
        /// From this row on.
        row: usize,
    },
}

/// Values that are there, each with its row, and whether the next is one row's time away.
struct ThermometerChannel {
    rows: Vec<usize>,
    values: Vec<f64>,
    /// From each value to the next; 0 over a pause, which may be of any length.
    steps: Vec<f64>,
}

/// Returns the faults of a channel of one file. `follows`: whether a row is an ordinary time after the one
/// before; `near`: whether it is at most [`MAX_ROW_GAP_S`] after it.
#[must_use]
pub fn find_thermometer_faults(
    values: &[f64],
    follows: &[bool],
    near: &[bool],
) -> Vec<ThermometerFault> {
    let mut faults = Vec::new();
    let beyond = |value: f64| {
        value <= RTD_RANGE_C[0] || value >= RTD_RANGE_C[1] || value == DEVICE_DISCONNECTED_C
    };
    let mut sound: Vec<f64> = values.to_vec();
    let mut ends = Vec::new();
    (0..values.len())
        .filter(|&row| beyond(values[row]))
        .for_each(|row| push_row_to_ranges(&mut ends, row));
    if let Some(first) = ends.first() {
        let fault = ThermometerFault::Absent { shown: values[first.start], rows: ends };
        fault.mask_faulty_rows(&mut sound);
        faults.push(fault);
    }
    if let Some(fault) = find_power_on_fault(&sound, near) {
        fault.mask_faulty_rows(&mut sound);
        faults.push(fault);
    }
    loop {
        let mut by_step = ThermometerChannel::from_values(&sound, follows).find_step_faults();
        // What is between two absent values is judged once they are gone.
        let is_absent = |fault: &ThermometerFault| matches!(fault, ThermometerFault::Absent { .. });
        let is_last = !by_step.iter().any(is_absent);
        by_step.retain(|fault| is_last || is_absent(fault));
        by_step.iter().for_each(|fault| fault.mask_faulty_rows(&mut sound));
        faults.extend(by_step);
        if is_last {
            break;
        }
    }
    // What stands still without a step is seen on what is left.
    faults.extend(ThermometerChannel::from_values(&sound, follows).find_frozen_value_faults());
    faults
}

/// Stretches at the value of a power-on that are entered and left by a step that heat does not make; one at
/// the start of the file has nothing to be entered from. One that lasts to the end may be an oven.
fn find_power_on_fault(values: &[f64], near: &[bool]) -> Option<ThermometerFault> {
    let is_far = |a: f64, b: f64| (a - b).abs() >= MIN_POWER_ON_STEP_K;
    let mut rows = Vec::new();
    let mut start = 0;
    while let Some(first) = (start..values.len()).find(|&row| values[row] == POWER_ON_RESET_C) {
        let end = (first..values.len())
            .find(|&row| values[row] != POWER_ON_RESET_C)
            .unwrap_or(values.len());
        let before = values[..first].iter().rposition(|value| !value.is_nan());
        let is_entered = before.is_none_or(|row| {
            is_far(values[row], POWER_ON_RESET_C) && near.get(first) == Some(&true)
        });
        let is_left = values.get(end).is_some_and(|&after| is_far(after, POWER_ON_RESET_C))
            && near.get(end) == Some(&true);
        if is_entered && is_left {
            rows.push(first..end);
        }
        start = end;
    }
    (!rows.is_empty()).then_some(ThermometerFault::Absent { shown: POWER_ON_RESET_C, rows })
}

impl ThermometerFault {
    /// Takes the rows in which nothing was measured out of `values`.
    fn mask_faulty_rows(&self, values: &mut [f64]) {
        match self {
            Self::Absent { rows, .. } => {
                rows.iter().for_each(|rows| values[rows.clone()].fill(f64::NAN));
            }
            Self::Frozen { rows, .. } => values[rows.clone()].fill(f64::NAN),
            Self::Jump { .. } => {}
        }
    }
}

/// A row more, at the end of the last range where it follows it.
fn push_row_to_ranges(rows: &mut Vec<Range<usize>>, row: usize) {
    match rows.last_mut() {
        Some(last) if last.end == row => last.end = row + 1,
        _ => rows.push(row..row + 1),
    }
}

impl ThermometerChannel {
    fn from_values(all: &[f64], follows: &[bool]) -> Self {
        let rows: Vec<usize> = (0..all.len()).filter(|&row| !all[row].is_nan()).collect();
        let values: Vec<f64> = rows.iter().map(|&row| all[row]).collect();
        let steps = rows.windows(2).zip(values.windows(2)).map(|(rows, values)| {
            // Over a cell that is missing it may be two rows.
            let is_near = rows[1] - rows[0] <= 2;
            let is_next = is_near && follows[rows[0] + 1..=rows[1]].iter().all(|follows| *follows);
            if is_next { values[1] - values[0] } else { 0.0 }
        });
        Self { steps: steps.collect(), rows, values }
    }

    /// Returns the largest ordinary step. The spacings of the largest of many values with an exponential tail are
    /// exponential, with the scale of the tail; a wider one parts steps of another kind from them.
    fn find_largest_ordinary_step(&self) -> Option<f64> {
        let mut sizes: Vec<f64> = self.steps.iter().map(|step| step.abs()).collect();
        sizes.sort_unstable_by(|a, b| b.total_cmp(a));
        let digit = sizes.iter().rev().copied().find(|size| *size > 0.0)?;
        let chances = (sizes.len() as f64 / STEP_FALSE_ALARM_RATE).ln();
        // More than a quarter of all is no fault any more, but what the channel does.
        let most = (sizes.len() / 4).min(sizes.len().saturating_sub(TAIL_STEP_COUNT + 1));
        let is_wide = |&count: &usize| {
            let tail = &sizes[count..count + TAIL_STEP_COUNT];
            let scale =
                tail.iter().sum::<f64>() / TAIL_STEP_COUNT as f64 - sizes[count + TAIL_STEP_COUNT];
            sizes[count - 1] - sizes[count] > scale.max(digit) * chances
        };
        (1..=most).rev().find(is_wide).map(|count| sizes[count])
    }

    /// Stretches between steps that no other is near: those that stand still, and single jumps.
    fn find_step_faults(&self) -> Vec<ThermometerFault> {
        let Some(ordinary) = self.find_largest_ordinary_step() else { return Vec::new() };
        let cuts: Vec<usize> =
            (0..self.steps.len()).filter(|&step| self.steps[step].abs() > ordinary).collect();
        let mut ends = vec![0];
        ends.extend(cuts.iter().map(|cut| cut + 1));
        ends.push(self.values.len());
        let stretches: Vec<Range<usize>> = ends.windows(2).map(|ends| ends[0]..ends[1]).collect();
        let last = stretches.len() - 1;
        let stands = |(number, stretch): &(usize, &Range<usize>)| {
            let values = &self.values[(*stretch).clone()];
            // A single one at an end cannot be distinguished from a jump, and is no loss.
            let is_spike = match *number {
                0 => self.is_complete_step(stretch.end - 1),
                number if number == last => self.is_complete_step(stretch.start - 1),
                _ => self.steps[stretch.start - 1] * self.steps[stretch.end - 1] < 0.0,
            };
            values.iter().all(|value| *value == values[0]) && (values.len() > 1 || is_spike)
        };
        let (standing, moving): (Vec<_>, Vec<_>) =
            stretches.iter().enumerate().partition(|stretch| stands(stretch));
        let rest: Vec<f64> = moving
            .iter()
            .flat_map(|(_, stretch)| self.values[(*stretch).clone()].iter().copied())
            .collect();
        let (low, high) =
            rest.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| {
                (low.min(value), high.max(value))
            });
        // Nothing moves: it is set, and not measured.
        if low >= high {
            return Vec::new();
        }
        let mut absent: Vec<(f64, Vec<Range<usize>>)> = Vec::new();
        let mut faults = Vec::new();
        for (_, stretch) in standing {
            let shown = self.values[stretch.start];
            let rows = self.rows[stretch.start]..self.rows[stretch.end - 1] + 1;
            if shown > high + ordinary || shown < low - ordinary || stretch.len() == 1 {
                match absent.iter_mut().find(|(known, _)| *known == shown) {
                    Some((_, all)) => all.push(rows),
                    None => absent.push((shown, vec![rows])),
                }
            } else if self.has_abrupt_ends(stretch, last, &stretches) {
                faults.push(ThermometerFault::Frozen { shown, rows });
            }
        }
        faults.extend(
            absent.into_iter().map(|(shown, rows)| ThermometerFault::Absent { shown, rows }),
        );
        // There, and perhaps back: what does it more often does it for a reason.
        let jumps: Vec<usize> = (1..moving.len())
            .filter(|&at| moving[at - 1].0 + 1 == moving[at].0)
            .map(|at| moving[at].1.start - 1)
            .collect();
        if jumps.len() <= 2 && jumps.iter().all(|&step| self.is_complete_step(step)) {
            let jump = |&step: &usize| {
                let jump =
                    ThermometerFault::Jump { by: self.steps[step], row: self.rows[step + 1] };
                self.find_frozen_fault_at_step(step).unwrap_or(jump)
            };
            faults.extend(jumps.iter().map(jump));
        }
        faults
    }

    /// Returns the run of equal values that a step begins or ends, if there is none half as long elsewhere: then
    /// the channel stood still there, and the step is what it missed.
    fn find_frozen_fault_at_step(&self, step: usize) -> Option<ThermometerFault> {
        let mut runs = find_equal_value_runs(&self.values);
        runs.sort_by_key(|run| std::cmp::Reverse(run.len()));
        let [longest, second, ..] = &runs[..] else { return None };
        let is_adjacent = longest.end == step + 1 || longest.start == step + 1;
        let is_long = longest.len() > 2 * second.len()
            && longest.len() as f64 > self.max_chance_run_length(MAX_CHANGE_PROBABILITY);
        (is_adjacent && is_long).then(|| self.frozen_fault(longest))
    }

    /// Readings that are equal by chance, at most, where each changes with this probability.
    fn max_chance_run_length(&self, changes: f64) -> f64 {
        (self.values.len() as f64 / EQUALITY_FALSE_ALARM_RATE).ln() / -(-changes).ln_1p()
    }

    fn frozen_fault(&self, run: &Range<usize>) -> ThermometerFault {
        let rows = self.rows[run.start]..self.rows[run.end - 1] + 1;
        ThermometerFault::Frozen { shown: self.values[run.start], rows }
    }

    /// Returns whether a stretch that stands still begins and ends, where it does, by a complete step.
    fn has_abrupt_ends(&self, stretch: &Range<usize>, last: usize, all: &[Range<usize>]) -> bool {
        let before = (*stretch != all[0]).then(|| stretch.start - 1);
        let after = (*stretch != all[last]).then(|| stretch.end - 1);
        before.into_iter().chain(after).all(|step| self.is_complete_step(step))
    }

    /// Returns whether a step is complete from one row to the next.
    fn is_complete_step(&self, step: usize) -> bool {
        let by = self.steps[step];
        let neighbours = [step.checked_sub(1), Some(step + 1)].into_iter().flatten();
        neighbours
            .filter_map(|at| self.steps.get(at))
            .all(|next| next * by <= MAX_CONTINUATION_RATIO * by * by)
    }

    /// Runs of equal values longer than the noise allows. White noise of σ on a last digit q changes what
    /// is shown from row to row with at least p = 2·(1 − Φ(q/2σ)), that of a value midway between two
    /// steps of the digit; the share of values that differ from their neighbours' median is 0.8·σ/q.
    fn find_frozen_value_faults(&self) -> Vec<ThermometerFault> {
        let mut runs = find_equal_value_runs(&self.values);
        let longest = runs.iter().map(Range::len).max().unwrap_or(0);
        // Most channels are done here.
        if longest as f64 <= self.max_chance_run_length(MAX_CHANGE_PROBABILITY) {
            return Vec::new();
        }
        let hold = tenth_percentile_hold_rows(&runs);
        let readings = |run: &Range<usize>| (run.len() / hold) as f64;
        runs.sort_by_key(|run| std::cmp::Reverse(run.len()));
        // Without the longest, which may be what is asked about.
        let requested = &runs[..runs.len().min(3)];
        let is_requested = |at: usize| requested.iter().any(|run| run.contains(&at));
        let rest: Vec<f64> = (0..self.values.len())
            .filter(|&at| !is_requested(at))
            .step_by(hold)
            .map(|at| self.values[at])
            .collect();
        let part = rest.len() / NOISE_SEGMENT_COUNT;
        let mut levels = rest.clone();
        levels.sort_unstable_by(f64::total_cmp);
        levels.dedup();
        if part <= 4 * NEIGHBOUR_ROWS_PER_SIDE || levels.len() < MIN_QUANTISATION_LEVELS {
            return Vec::new();
        }
        let quietest = rest
            .chunks_exact(part)
            .map(|part| non_median_fraction(&part[..part.len().min(MAX_VALUES_PER_SEGMENT)]))
            .fold(f64::INFINITY, f64::min);
        let digits_per_sigma = 0.8 / quietest;
        let changes = erfc(digits_per_sigma / 2.0 / SQRT_2).min(MAX_CHANGE_PROBABILITY);
        if changes == 0.0 {
            return Vec::new();
        }
        let is_longer = |run: &&Range<usize>| readings(run) > self.max_chance_run_length(changes);
        requested.iter().filter(is_longer).map(|run| self.frozen_fault(run)).collect()
    }
}

/// Where values are equal one after the other.
fn find_equal_value_runs(values: &[f64]) -> Vec<Range<usize>> {
    let mut runs = Vec::new();
    let mut start = 0;
    for at in 1..=values.len() {
        if at == values.len() || values[at] != values[start] {
            runs.push(start..at);
            start = at;
        }
    }
    runs
}

/// For how many rows a reading is shown before there is a new one: of the runs the tenth of the
/// shortest.
fn tenth_percentile_hold_rows(runs: &[Range<usize>]) -> usize {
    let mut lengths: Vec<usize> = runs.iter().map(Range::len).collect();
    lengths.sort_unstable();
    lengths.get(lengths.len() / 10).copied().unwrap_or(1)
}

/// Returns the share of values that are not the median of those around them: of anything that rises or falls,
/// none; of noise, some.
fn non_median_fraction(values: &[f64]) -> f64 {
    let differs = |window: &&[f64]| {
        let mut sorted = window.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted[NEIGHBOUR_ROWS_PER_SIDE] != window[NEIGHBOUR_ROWS_PER_SIDE]
    };
    let windows = values.windows(2 * NEIGHBOUR_ROWS_PER_SIDE + 1);
    let count = windows.len();
    windows.filter(differs).count() as f64 / count as f64
}

#[cfg(test)]
mod tests;
