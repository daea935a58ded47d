//! What heat and time have made of the terms that follow them.

use crate::{
    dimensions::{CHANNELS, MAX_TERMS},
    lag::Lag,
    set::IndexSet,
    term::effect::{Effect, Terms, UNIT_STEP},
    units::{Fine, Temperature},
};

/// What the terms remember: their lags, and what heat and time have made of them.
#[derive(Clone, Debug, Default)]
pub struct TermStates {
    lags: [Option<Lag>; MAX_TERMS],
    values: [Fine; MAX_TERMS],
    /// Terms of heat that have had a temperature.
    known: IndexSet,
}

impl TermStates {
    /// A step of 100 ms of term `index`, if it is one of heat or time. A temperature that is missing
    /// leaves it as it is.
    pub fn step(
        &mut self,
        terms: &Terms<'_>,
        index: usize,
        temperatures: &[Option<Temperature>; CHANNELS],
    ) {
        let (Some(Some(term)), Some(lag), Some(value)) =
            (terms.get(index), self.lags.get_mut(index), self.values.get_mut(index))
        else {
            return;
        };
        match term.effect {
            Effect::Heat { channel, smoothing, reference, per_temperature } => {
                let temperature = temperatures.get(usize::from(channel)).copied().flatten();
                if let Some(Temperature(now)) = temperature {
                    let lag = lag.get_or_insert(Lag::settled(now));
                    lag.step(now, smoothing);
                    self.known.insert(index);
                    let warmer = lag.value().saturating_sub(reference.0);
                    *value = Fine(per_temperature.times(warmer.into()));
                }
            }
            Effect::Time { smoothing, amplitude } => {
                let lag = lag.get_or_insert(Lag::settled(0));
                lag.step(UNIT_STEP, smoothing);
                *value = Fine(amplitude.times(lag.value().into()));
            }
            _ => {}
        }
    }

    /// Whether each of these has had a temperature.
    #[must_use]
    pub fn knows(&self, terms: IndexSet) -> bool {
        self.known.has_all(terms)
    }

    /// What heat or time has made of term `index`; 0 for one of neither.
    pub(super) fn value(&self, index: usize) -> Fine {
        self.values.get(index).copied().unwrap_or_default()
    }
}
