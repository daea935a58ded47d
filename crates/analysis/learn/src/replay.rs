//! The present belief: the checkpoint, advanced by the readings of the window and the events among them.

use crate::{
    bank::Bank,
    detect::{self, Before, Finding, Row},
    event::Action,
    filter::Fate,
    memory::{Memory, StoredReading},
    readings, wear,
};

/// Readings that are kept as they were read: at two a day five months.
const WINDOW: usize = 300;
/// Of this many of the last the filters before them are at hand: the longest look back, and an open event.
const TAIL: usize = 80;
/// Readings before an instant of which bad ones may have moved the estimate: where one in twenty is bad, more than two of this many
/// are twice in a thousand times.
const BEFORE: usize = 6;

/// The filters now, and before each of the last readings.
#[derive(Clone, Debug)]
pub(crate) struct Believed {
    pub bank: Bank,
    /// Before each of the window's last readings.
    tail: Vec<Bank>,
}

impl Believed {
    /// Advances the checkpoint of `memory` by all that is in its window.
    pub fn of(memory: &Memory) -> Self {
        let mut it = Self { bank: memory.checkpoint.clone(), tail: Vec::new() };
        let tail = memory.window.len().saturating_sub(TAIL);
        for index in 0..tail {
            step(memory, index, &mut it.bank);
        }
        for index in tail..memory.window.len() {
            it.advance(memory, index);
        }
        it
    }

    /// Does again what follows the reading `sequence`, inclusive: an event there has become known.
    pub fn again(&mut self, memory: &Memory, sequence: u64) {
        let from = sequence.saturating_sub(memory.first) as usize;
        let Some(place) = (from + self.tail.len()).checked_sub(memory.window.len()) else {
            *self = Self::of(memory);
            return;
        };
        if let Some(bank) = self.tail.get(place) {
            self.bank = bank.clone();
            self.tail.truncate(place);
        }
        for index in from..memory.window.len() {
            self.advance(memory, index);
        }
    }

    /// Takes the reading `index` of the window, and returns its outcome.
    pub(crate) fn advance(&mut self, memory: &Memory, index: usize) -> Fate {
        self.tail.push(self.bank.clone());
        if self.tail.len() > TAIL {
            self.tail.remove(0);
        }
        step(memory, index, &mut self.bank)
    }

    /// Keeps a reading that was taken to the window's length.
    pub fn keep(&self, memory: &mut Memory) {
        if memory.window.len() > WINDOW {
            let mut checkpoint = memory.checkpoint.clone();
            step(memory, 0, &mut checkpoint);
            memory.checkpoint = checkpoint;
            memory.checkpoint_s = memory.window[0].t.or(memory.checkpoint_s);
            wear::leave(memory);
            memory.window.remove(0);
            memory.first += 1;
        }
    }

    /// Returns what explains the readings from `index` of the window to the reading before `end`; the zero counts without the event
    /// `own`.
    pub(crate) fn explain(
        &self,
        memory: &Memory,
        [index, end]: [usize; 2],
        own: Option<u64>,
    ) -> Option<Finding> {
        let place = (index + self.tail.len()).checked_sub(memory.window.len())?;
        let (rows, before) = seen(memory, [index, end], own, self.tail.get(place)?)?;
        detect::explain(&rows, &before, own.is_some())
    }

    /// Returns true if one of the [`BEFORE`] beliefs before that of reading `index` foresees the readings from `index` on: bad readings
    /// have moved the estimate in between, and nothing has happened to the machine.
    pub(crate) fn is_moved_back(&self, memory: &Memory, index: usize) -> bool {
        let Some(place) = (index + self.tail.len()).checked_sub(memory.window.len()) else {
            return false;
        };
        let earlier = &self.tail[place.saturating_sub(BEFORE)..place.min(self.tail.len())];
        earlier.iter().any(|bank| {
            seen(memory, [index, memory.window.len()], None, bank)
                .is_some_and(|(rows, before)| detect::is_predicted(&rows, &before))
        })
    }
}

/// Returns the readings from `index` of the window to the reading before `end`, and what `bank` believes of them.
fn seen<'a>(
    memory: &'a Memory,
    [index, end]: [usize; 2],
    own: Option<u64>,
    bank: &Bank,
) -> Option<(Vec<Row<'a>>, Before)> {
    let kept = memory.window.get(index..end)?;
    let rows = kept
        .iter()
        .enumerate()
        .map(|(n, kept)| {
            let sequence = memory.first + (index + n) as u64;
            Row { g: &kept.g, h: &kept.h, y_um: level(memory, kept, sequence, own) }
        })
        .collect();
    let constants = memory.constants.iter().enumerate();
    let constants = constants.filter(|(_, it)| !it.is_held()).map(|(index, _)| index).collect();
    let before = Before {
        x: bank.lasting(),
        constants,
        scatter_um: bank.scatter_um(),
        unknown_um: kept.iter().map(|kept| bank.unknown_um(&kept.g)).collect(),
    };
    Some((rows, before))
}

/// Advances `bank` by reading `index` of the window.
fn step(memory: &Memory, index: usize, bank: &mut Bank) -> Fate {
    let kept = &memory.window[index];
    let before_s = index.checked_sub(1).map_or(memory.checkpoint_s, |it| memory.window[it].t);
    let sequence = memory.first + index as u64;
    bank.age(readings::between_s(before_s, kept.t));
    for event in memory.events.iter().filter(|event| event.sequence == sequence) {
        match &event.action {
            Action::Shift(all) => all.iter().for_each(|it| bank.shift(*it)),
            Action::Scatter(times) => bank.scale_noise(*times),
            Action::Zero(_) | Action::Nothing => {}
        }
    }
    bank.take(&kept.g, level(memory, kept, sequence, None))
}

/// Returns a reading less the prediction of the user's file, counted from the zero of its time and by the checks of the
/// probe; without the event that begins at `own`.
pub(crate) fn level(memory: &Memory, kept: &StoredReading, sequence: u64, own: Option<u64>) -> f64 {
    let steps =
        memory.events.iter().filter(|it| it.sequence <= sequence && Some(it.sequence) != own);
    let zero: f64 = steps.map(|it| if let Action::Zero(um) = it.action { um } else { 0.0 }).sum();
    kept.y - zero - probe_um(&memory.checks, kept.t)
}

/// Returns what the probe reads too much at a time: linear between its checks, the end values outside.
pub(crate) fn probe_um(checks: &[[f64; 2]], t: Option<f64>) -> f64 {
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
        let at = |t: f64| probe_um(&checks, Some(t));
        assert_eq!(
            [at(0.0), at(100.0), at(150.0), at(200.0), at(900.0)],
            [1.0, 1.0, 2.0, 3.0, 3.0]
        );
        assert_eq!(probe_um(&[], Some(3.0)), 0.0);
    }
}
