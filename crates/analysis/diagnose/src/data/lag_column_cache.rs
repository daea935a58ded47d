//! Temperatures that were stepped through all rows before. A fit moves its values one by one, and most of them change
//! neither how late a thermometer is nor the lag behind it: the same columns are requested again and again.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use trueup_machine::effect::ThermometerDelay;

use super::lag_filter::LagInitialState;

/// The columns that something was stepped through. The same if they are the same ones: a column that is changed is a
/// new one.
#[derive(Clone, Debug)]
pub(super) struct LagSource {
    pub values: Arc<[f64]>,
    pub time_s: Arc<[f64]>,
    pub restart: Arc<[bool]>,
    pub start: LagInitialState,
}

impl PartialEq for LagSource {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.values, &other.values)
            && Arc::ptr_eq(&self.time_s, &other.time_s)
            && Arc::ptr_eq(&self.restart, &other.restart)
            && self.start == other.start
    }
}

/// How late the thermometer is, and behind which lag: the time constants of its rise and fall, in s; none for the
/// temperature itself.
type LagRequest = (Option<ThermometerDelay>, Option<[f64; 2]>);

/// The columns that were requested, the newest last; shared by the copies of a table.
#[derive(Clone, Debug, Default)]
pub(super) struct LagColumnCache(Arc<Mutex<VecDeque<CachedLagColumn>>>);

type CachedLagColumn = (LagSource, LagRequest, Arc<Vec<f64>>);

impl LagColumnCache {
    /// Numbers that are kept, 8 bytes each: 16 MB.
    const MAX_CACHED_VALUES: usize = 2_000_000;
    /// The longest column: of more rows a few would fill the room.
    const MAX_CACHED_ROWS: usize = 100_000;

    /// Returns what may have been requested before, else made now.
    pub(super) fn memoise(
        &self,
        source: &LagSource,
        asked: LagRequest,
        make: impl FnOnce() -> Vec<f64>,
    ) -> Arc<Vec<f64>> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same = |(there, what, _): &&CachedLagColumn| *what == asked && there == source;
        if let Some((_, _, values)) = known().iter().rev().find(is_same) {
            return values.clone();
        }
        let values = Arc::new(make());
        if values.len() <= Self::MAX_CACHED_ROWS {
            let mut known = known();
            known.push_back((source.clone(), asked, values.clone()));
            while known.len() * values.len() > Self::MAX_CACHED_VALUES {
                known.pop_front();
            }
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use trueup_machine::effect::DelayKind;

    use super::*;

    #[test]
    fn what_is_asked_for_again_is_not_made_again_and_what_differs_in_anything_is() {
        let source = LagSource {
            values: [1.0, 2.0].into(),
            time_s: [0.0, 1.0].into(),
            restart: [true, false].into(),
            start: LagInitialState::Settled,
        };
        let late = |by_s| Some(ThermometerDelay { by_s, form: DelayKind::Delay });
        let (stepped, made) = (LagColumnCache::default(), Cell::new(0.0));
        let ask = |source: &LagSource, asked| {
            let known = stepped.clone().memoise(source, asked, || {
                made.set(made.get() + 1.0);
                vec![made.get(); 2]
            });
            known[0]
        };
        // Equal values in a column of their own may be changed apart.
        let sources = [
            source.clone(),
            LagSource { values: [1.0, 2.0].into(), ..source.clone() },
            LagSource { time_s: [0.0, 1.0].into(), ..source.clone() },
            LagSource { restart: [true, false].into(), ..source.clone() },
            LagSource { start: LagInitialState::Cold, ..source },
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
