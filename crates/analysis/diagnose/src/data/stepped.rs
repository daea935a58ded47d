//! Temperatures that were stepped through all rows before. A fit moves its values one by one, and most of them change
//! neither how late a thermometer is nor the lag behind it: the same columns are asked for again and again.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use trueup_machine::effect::Late;

use super::lag::Start;

/// The columns that something was stepped through. The same if they are the same ones: a column that is changed is a
/// new one.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub values: Arc<[f64]>,
    pub time_s: Arc<[f64]>,
    pub restart: Arc<[bool]>,
    pub start: Start,
}

impl PartialEq for Source {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.values, &other.values)
            && Arc::ptr_eq(&self.time_s, &other.time_s)
            && Arc::ptr_eq(&self.restart, &other.restart)
            && self.start == other.start
    }
}

/// How late the thermometer is, and behind which lag: the time constants of its rise and fall, in s; none for the
/// temperature itself.
type Asked = (Option<Late>, Option<[f64; 2]>);

/// The columns that were asked for, the newest last; shared by the copies of a table.
#[derive(Clone, Debug, Default)]
pub(super) struct Stepped(Arc<Mutex<VecDeque<Known>>>);

type Known = (Source, Asked, Arc<Vec<f64>>);

impl Stepped {
    /// Numbers that are kept, 8 bytes each: 16 MB.
    const MAX_NUMBERS: usize = 2_000_000;
    /// The longest column: of more rows a few would fill the room.
    const LONGEST: usize = 100_000;

    /// Returns what may have been asked for before, else made now.
    pub(super) fn known(
        &self,
        source: &Source,
        asked: Asked,
        make: impl FnOnce() -> Vec<f64>,
    ) -> Arc<Vec<f64>> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same = |(there, what, _): &&Known| *what == asked && there == source;
        if let Some((_, _, values)) = known().iter().rev().find(is_same) {
            return values.clone();
        }
        let values = Arc::new(make());
        if values.len() <= Self::LONGEST {
            let mut known = known();
            known.push_back((source.clone(), asked, values.clone()));
            while known.len() * values.len() > Self::MAX_NUMBERS {
                known.pop_front();
            }
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use trueup_machine::effect::LateForm;

    use super::*;

    #[test]
    fn what_is_asked_for_again_is_not_made_again_and_what_differs_in_anything_is() {
        let source = Source {
            values: [1.0, 2.0].into(),
            time_s: [0.0, 1.0].into(),
            restart: [true, false].into(),
            start: Start::Settled,
        };
        let late = |by_s| Some(Late { by_s, form: LateForm::Delay });
        let (stepped, made) = (Stepped::default(), Cell::new(0.0));
        let ask = |source: &Source, asked| {
            let known = stepped.clone().known(source, asked, || {
                made.set(made.get() + 1.0);
                vec![made.get(); 2]
            });
            known[0]
        };
        // Equal values in a column of their own may be changed apart.
        let sources = [
            source.clone(),
            Source { values: [1.0, 2.0].into(), ..source.clone() },
            Source { time_s: [0.0, 1.0].into(), ..source.clone() },
            Source { restart: [true, false].into(), ..source.clone() },
            Source { start: Start::Cold, ..source },
        ];
        for _ in 0..2 {
            let mut number = 0.0;
            for source in &sources {
                for late in [None, late(1.0), late(2.0)] {
                    for lags_s in [None, Some([3.0, 3.0]), Some([3.0, 4.0]), Some([4.0, 3.0])] {
                        number += 1.0;
                        assert_eq!(ask(source, (late, lags_s)), number);
                    }
                }
            }
        }
    }
}
