//! The heat that outlasts a reset: what each lag has reached, by what it follows and how fast.
//!
//! A machine does not cool because its board restarts. A lag is known again by the channel that it
//! follows and its time constants, not by the calibration that it stood in: another one may be
//! loaded meanwhile, and a part is as warm as it was.

use crate::{
    dimensions::MAX_TERMS,
    lag::{Lag, SmoothingFactor},
};

/// Lags of a calibration at most: three axes, the spindle, its running time, the terms.
pub const MOST_LAGS: usize = 5 + MAX_TERMS;

/// What a lag follows, and how fast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// A temperature channel, 0…7, or one of the numbers below.
    pub input: u8,
    /// α while it rises.
    pub rising: SmoothingFactor,
    /// α while it falls.
    pub falling: SmoothingFactor,
}

impl Key {
    /// In place of a channel: whether the spindle runs.
    pub const RUNNING: u8 = 255;
    /// In place of a channel: time since the start.
    pub const TIME: u8 = 254;
}

/// One lag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeptLag {
    /// Which.
    pub key: Key,
    /// What it has reached.
    pub lag: Lag,
    /// How long the spindle has run, for [`Key::RUNNING`]; else 0.
    pub running_ms: u32,
}

/// All of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeatMemory {
    /// As many as there are, from the first on.
    pub lags: [Option<KeptLag>; MOST_LAGS],
}

impl Default for HeatMemory {
    fn default() -> Self {
        Self { lags: [None; MOST_LAGS] }
    }
}

impl HeatMemory {
    /// Takes in one more; the same one again is no more.
    pub fn keep(&mut self, kept: KeptLag) {
        let is_its = |place: &&mut Option<KeptLag>| place.is_none_or(|there| there.key == kept.key);
        if let Some(place) = self.lags.iter_mut().find(is_its) {
            *place = Some(kept);
        }
    }

    /// What the lag with this key had reached.
    #[must_use]
    pub fn find(&self, key: Key) -> Option<KeptLag> {
        self.lags.into_iter().flatten().find(|kept| kept.key == key)
    }
}
