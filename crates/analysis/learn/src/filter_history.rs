//! The present belief: the checkpoint, advanced by the readings of the window and the events among them.

use crate::{
    change_detection::{self, DetectedChange, DetectionRow, PriorBelief},
    event::EventAction,
    filter_bank::FilterBank,
    learner_state::{LearnerState, StoredReading},
    readings,
    rls_filter::FilterOutcome,
    wear,
};

/// Readings that are kept as they were read: at two a day five months.
const MAX_WINDOW_READINGS: usize = 300;
/// Of this many of the last the filters before them are at hand: the longest look back, and an open event.
const MAX_BANK_SNAPSHOTS: usize = 80;
/// Readings before an instant of which bad ones may have moved the estimate: where one in twenty is bad, more than two of this many
/// are twice in a thousand times.
const LOOKBACK_READINGS: usize = 6;

/// The filters now, and before each of the last readings.
#[derive(Clone, Debug)]
pub(crate) struct FilterHistory {
    pub bank: FilterBank,
    /// Before each of the window's last readings.
    tail: Vec<FilterBank>,
}

impl FilterHistory {
    /// Advances the checkpoint of `memory` by all that is in its window.
    pub(crate) fn from_state(memory: &LearnerState) -> Self {
        let mut it = Self { bank: memory.checkpoint.clone(), tail: Vec::new() };
        let tail = memory.window.len().saturating_sub(MAX_BANK_SNAPSHOTS);
        for index in 0..tail {
            advance_filters(memory, index, &mut it.bank);
        }
        for index in tail..memory.window.len() {
            it.process_window_reading(memory, index);
        }
        it
    }

    /// Does again what follows the reading `sequence`, inclusive: an event there has become known.
    pub(crate) fn replay_from(&mut self, memory: &LearnerState, sequence: u64) {
        let from = sequence.saturating_sub(memory.first) as usize;
        let Some(place) = (from + self.tail.len()).checked_sub(memory.window.len()) else {
            *self = Self::from_state(memory);
            return;
        };
        if let Some(bank) = self.tail.get(place) {
            self.bank = bank.clone();
            self.tail.truncate(place);
        }
        for index in from..memory.window.len() {
            self.process_window_reading(memory, index);
        }
    }

    /// Takes the reading `index` of the window, and returns its outcome.
    pub(crate) fn process_window_reading(
        &mut self,
        memory: &LearnerState,
        index: usize,
    ) -> FilterOutcome {
        self.tail.push(self.bank.clone());
        if self.tail.len() > MAX_BANK_SNAPSHOTS {
            self.tail.remove(0);
        }
        advance_filters(memory, index, &mut self.bank)
    }

    /// Keeps a reading that was taken to the window's length.
    pub(crate) fn trim_window(&self, memory: &mut LearnerState) {
        if memory.window.len() > MAX_WINDOW_READINGS {
            let mut checkpoint = memory.checkpoint.clone();
            advance_filters(memory, 0, &mut checkpoint);
            memory.checkpoint = checkpoint;
            memory.checkpoint_s = memory.window[0].t.or(memory.checkpoint_s);
            wear::accumulate_oldest_reading(memory);
            memory.window.remove(0);
            memory.first += 1;
        }
    }

    /// Returns what explains the readings from `index` of the window to the reading before `end`; the zero counts without the event
    /// `own`.
    pub(crate) fn explain_readings(
        &self,
        memory: &LearnerState,
        [index, end]: [usize; 2],
        own: Option<u64>,
    ) -> Option<DetectedChange> {
        let place = (index + self.tail.len()).checked_sub(memory.window.len())?;
        let (rows, before) = window_rows(memory, [index, end], own, self.tail.get(place)?)?;
        change_detection::find_best_explanation(&rows, &before, own.is_some())
    }

    /// Returns true if one of the [`LOOKBACK_READINGS`] beliefs before that of reading `index` predicts the readings from `index` on: bad readings
    /// have moved the estimate in between, and nothing has happened to the machine.
    pub(crate) fn is_outlier_artefact(&self, memory: &LearnerState, index: usize) -> bool {
        let Some(place) = (index + self.tail.len()).checked_sub(memory.window.len()) else {
            return false;
        };
        let earlier =
            &self.tail[place.saturating_sub(LOOKBACK_READINGS)..place.min(self.tail.len())];
        earlier.iter().any(|bank| {
            window_rows(memory, [index, memory.window.len()], None, bank).is_some_and(
                |(rows, before)| change_detection::is_explained_by_prior(&rows, &before),
            )
        })
    }
}

/// Returns the readings from `index` of the window to the reading before `end`, and what `bank` believes of them.
fn window_rows<'a>(
    memory: &'a LearnerState,
    [index, end]: [usize; 2],
    own: Option<u64>,
    bank: &FilterBank,
) -> Option<(Vec<DetectionRow<'a>>, PriorBelief)> {
    let stored = memory.window.get(index..end)?;
    let rows = stored
        .iter()
        .enumerate()
        .map(|(n, stored)| {
            let sequence = memory.first + (index + n) as u64;
            DetectionRow {
                g: &stored.g,
                h: &stored.h,
                y_um: corrected_reading_um(memory, stored, sequence, own),
            }
        })
        .collect();
    let constants = memory.constants.iter().enumerate();
    let constants =
        constants.filter(|(_, constant)| !constant.is_held()).map(|(index, _)| index).collect();
    let before = PriorBelief {
        x: bank.persistent_values(),
        constants,
        scatter_um: bank.scatter_um(),
        unknown_um: stored.iter().map(|stored| bank.prediction_std_um(&stored.g)).collect(),
    };
    Some((rows, before))
}

/// Advances `bank` by reading `index` of the window.
fn advance_filters(memory: &LearnerState, index: usize, bank: &mut FilterBank) -> FilterOutcome {
    let stored = &memory.window[index];
    let before_s =
        index.checked_sub(1).map_or(memory.checkpoint_s, |previous| memory.window[previous].t);
    let sequence = memory.first + index as u64;
    bank.advance_time(readings::elapsed_s(before_s, stored.t));
    for event in memory.events.iter().filter(|event| event.sequence == sequence) {
        match &event.action {
            EventAction::Shift(all) => all.iter().for_each(|shift| bank.shift_value(*shift)),
            EventAction::Scatter(times) => bank.scale_noise(*times),
            EventAction::Zero(_) | EventAction::Nothing => {}
        }
    }
    bank.process_reading(&stored.g, corrected_reading_um(memory, stored, sequence, None))
}

/// Returns a reading less the prediction of the user's file, counted from the zero of its time and by the checks of the
/// probe; without the event that begins at `own`.
pub(crate) fn corrected_reading_um(
    memory: &LearnerState,
    stored: &StoredReading,
    sequence: u64,
    own: Option<u64>,
) -> f64 {
    let steps = memory
        .events
        .iter()
        .filter(|event| event.sequence <= sequence && Some(event.sequence) != own);
    let zero: f64 =
        steps.map(|event| if let EventAction::Zero(um) = event.action { um } else { 0.0 }).sum();
    stored.y - zero - probe_error_um(&memory.checks, stored.t)
}

/// Returns what the probe reads too much at a time: linear between its checks, the end values outside.
pub(crate) fn probe_error_um(checks: &[[f64; 2]], t: Option<f64>) -> f64 {
    let (Some(t), Some(first), Some(last)) = (t, checks.first(), checks.last()) else {
        return checks.last().map_or(0.0, |check| check[1]);
    };
    if t <= first[0] {
        return first[1];
    }
    let pair = checks.windows(2).find(|pair| t < pair[1][0]);
    pair.map_or(last[1], |pair| {
        let share = (t - pair[0][0]) / (pair[1][0] - pair[0][0]);
        pair[0][1] + share * (pair[1][1] - pair[0][1])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_probe_is_corrected_linearly_between_its_checks() {
        let checks = [[100.0, 1.0], [200.0, 3.0]];
        let at = |t: f64| probe_error_um(&checks, Some(t));
        assert_eq!(
            [at(0.0), at(100.0), at(150.0), at(200.0), at(900.0)],
            [1.0, 1.0, 2.0, 3.0, 3.0]
        );
        assert_eq!(probe_error_um(&[], Some(3.0)), 0.0);
    }
}
