//! What the machine's temperatures and its running time make of it: a slow part of the bridge.
//!
//! Heat is slow, so this steps every 100 ms ([`lag::STEP_MS`](crate::lag::STEP_MS)) and keeps what
//! the fast tick needs: K₀ and tanβ of each axis, and the elongation of the spindle by temperature
//! and by running time. Between steps only the position moves: ΔK = K₀ + tanβ·(P − P₀).
//!
//! The work is divided into [`ITEMS`] items that may be done in different ticks of the 100, so that
//! no tick carries it all.

use crate::{
    calibration::Calibration,
    gradient::Gradient,
    lag::{Lag, SmoothingFactor},
    term::{self, TermStates},
    thermometer::Raw,
    units::{Fine, Nanometres, Rpm, Temperature},
    warmup,
};

/// Temperature channels of a board.
pub const CHANNELS: usize = 8;
/// A channel is given up after so many bad readings in a row, 100 ms apart.
pub const FAULT_AFTER_READINGS: u8 = 4;
/// Items of a step: three axes, the spindle by temperature, the spindle by running time, and the
/// terms of a diagnosis.
pub const ITEMS: usize = FIRST_TERM + term::MAX_TERMS;
/// The item of the first term.
pub const FIRST_TERM: usize = 5;

/// A temperature channel: its last good reading, until it is given up.
#[derive(Clone, Copy, Debug, Default)]
pub struct Channel {
    temperature: Option<Temperature>,
    bad: u8,
}

impl Channel {
    /// Takes what the channel's thermometer reads.
    ///
    /// A single bad reading changes nothing, because a spark from the drives can cause one.
    pub fn hear(&mut self, reading: Option<Temperature>) {
        if reading.is_some() {
            *self = Self { temperature: reading, bad: 0 };
        } else {
            self.bad = self.bad.saturating_add(1);
            if self.bad >= FAULT_AFTER_READINGS {
                self.temperature = None;
            }
        }
    }

    /// Whether it has been read and has nothing believable: other than before the first reading.
    #[must_use]
    pub fn is_faulty(&self) -> bool {
        self.temperature.is_none() && self.bad > 0
    }

    /// The temperature, `None` before the first reading and after a fault.
    #[must_use]
    pub fn temperature(&self) -> Option<Temperature> {
        self.temperature
    }
}

/// A set of numbers from 0 to 7: channels, axes. That all of some are there is one comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IndexSet(u8);

impl IndexSet {
    /// Takes a number in; one above 7 is in no set.
    pub fn insert(&mut self, number: usize) {
        self.0 |= Self::bit(number);
    }

    /// Takes a number out.
    pub fn remove(&mut self, number: usize) {
        self.0 &= !Self::bit(number);
    }

    /// Whether every number of `others` is in it.
    #[must_use]
    pub const fn has_all(self, others: Self) -> bool {
        others.0 & !self.0 == 0
    }

    /// Whether a number of `others` is in it.
    #[must_use]
    pub const fn has_any(self, others: Self) -> bool {
        others.0 & self.0 != 0
    }

    fn bit(number: usize) -> u8 {
        u32::try_from(number).ok().and_then(|number| 1_u8.checked_shl(number)).unwrap_or(0)
    }
}

/// The temperature channels of a board.
#[derive(Clone, Copy, Debug, Default)]
pub struct Channels {
    channels: [Channel; CHANNELS],
    known: IndexSet,
    faulty: IndexSet,
}

impl Channels {
    /// Takes what the thermometer of a channel reads, as [`Channel::hear`].
    pub fn hear(&mut self, number: usize, reading: Option<Temperature>) {
        let Some(channel) = self.channels.get_mut(number) else { return };
        channel.hear(reading);
        for (set, is_in) in [
            (&mut self.known, channel.temperature().is_some()),
            (&mut self.faulty, channel.is_faulty()),
        ] {
            if is_in { set.insert(number) } else { set.remove(number) }
        }
    }

    /// The temperature of a channel, where there is one.
    #[must_use]
    pub fn temperature(&self, channel: u8) -> Option<Temperature> {
        self.channels.get(usize::from(channel)).and_then(Channel::temperature)
    }

    /// All of them.
    #[must_use]
    pub fn temperatures(&self) -> [Option<Temperature>; CHANNELS] {
        self.channels.map(|channel| channel.temperature())
    }

    /// Whether all of these have a temperature.
    #[must_use]
    pub fn all_known(&self, channels: IndexSet) -> bool {
        self.known.has_all(channels)
    }

    /// Whether one of these is faulty.
    #[must_use]
    pub fn any_faulty(&self, channels: IndexSet) -> bool {
        self.faulty.has_any(channels)
    }

    /// Whether a channel is faulty; one that does not exist is.
    #[must_use]
    pub fn is_faulty(&self, channel: u8) -> bool {
        self.channels.get(usize::from(channel)).is_none_or(Channel::is_faulty)
    }
}

/// What an axis has become by its temperature.
#[derive(Clone, Copy, Debug, Default)]
struct AxisHeat {
    lag: Option<Lag>,
    constant: Fine,
    gradient: Gradient,
}

/// The thermal state of the machine.
#[derive(Clone, Debug, Default)]
pub struct Heat {
    axes: [AxisHeat; 3],
    spindle: Option<Lag>,
    by_temperature: Fine,
    running: warmup::State,
    by_running_time: Fine,
    terms: TermStates,
    /// Axes whose law has had a temperature.
    known: IndexSet,
}

impl Heat {
    /// One step of 100 ms with these temperatures, one a channel, and this speed.
    pub fn step(
        &mut self,
        calibration: &Calibration<'_>,
        temperatures: &[Option<Temperature>; CHANNELS],
        speed: Option<Rpm>,
    ) {
        for item in 0..ITEMS {
            self.step_item(calibration, item, temperatures, speed);
        }
    }

    /// One item of a step. A temperature that is missing leaves its part as it is.
    pub fn step_item(
        &mut self,
        calibration: &Calibration<'_>,
        item: usize,
        temperatures: &[Option<Temperature>; CHANNELS],
        speed: Option<Rpm>,
    ) {
        if let (Some(heat), Some(axis)) = (self.axes.get_mut(item), calibration.axes.get(item)) {
            if let Some(thermal) = &axis.thermal
                && let Some(temperature) = channel(temperatures, thermal.channel)
            {
                let lagged = step_lag(
                    &mut heat.lag,
                    temperature,
                    [thermal.smoothing, thermal.smoothing_falling],
                );
                (heat.constant, heat.gradient) = thermal.law.at(lagged);
                self.known.insert(item);
            }
        } else if item == 3 {
            if let Some(spindle) = &calibration.spindle.temperature
                && let Some(temperature) = channel(temperatures, spindle.channel)
            {
                let lagged = step_lag(
                    &mut self.spindle,
                    temperature,
                    [spindle.smoothing, spindle.smoothing_falling],
                );
                self.by_temperature = spindle.law.at(lagged).0;
            }
        } else if let Some(term) = item.checked_sub(FIRST_TERM) {
            self.terms.step(calibration, term, temperatures);
        } else if let Some(warmup) = &calibration.spindle.warmup {
            let drive = warmup.drive(speed);
            warmup.law.step(&mut self.running, drive);
            self.by_running_time = warmup.law.elongation(&self.running);
        }
    }

    /// K₀ and tanβ of an axis; both 0 without a law.
    #[must_use]
    pub fn axis(&self, axis: usize) -> (Fine, Gradient) {
        self.axes.get(axis).map_or_else(Default::default, |heat| (heat.constant, heat.gradient))
    }

    /// Whether the laws of these axes have each had a temperature yet.
    #[must_use]
    pub fn knows(&self, axes: IndexSet) -> bool {
        self.known.has_all(axes)
    }

    /// The terms over time have begun so many steps ago.
    pub fn run_ahead(&mut self, calibration: &Calibration<'_>, term: usize, steps: u32) {
        for _ in 0..steps {
            self.terms.step(calibration, term, &[None; CHANNELS]);
        }
    }

    /// What heat and time have made of the terms of a diagnosis.
    #[must_use]
    pub fn terms(&self) -> &TermStates {
        &self.terms
    }

    /// The elongation by the spindle's temperature.
    #[must_use]
    pub fn by_temperature(&self) -> Nanometres {
        self.by_temperature.rounded()
    }

    /// The elongation by the warm-up model.
    #[must_use]
    pub fn by_running_time(&self) -> Nanometres {
        self.by_running_time.rounded()
    }
}

/// The temperature of a channel.
fn channel(temperatures: &[Option<Temperature>; CHANNELS], number: u8) -> Option<Temperature> {
    temperatures.get(usize::from(number)).copied().flatten()
}

/// The lagged temperature; a lag starts settled at the first temperature that it sees.
fn step_lag(
    lag: &mut Option<Lag>,
    temperature: Temperature,
    [rising, falling]: [SmoothingFactor; 2],
) -> Temperature {
    match lag {
        Some(lag) => {
            let smoothing = if temperature.0 < lag.value() { falling } else { rising };
            lag.step(temperature.0, smoothing);
            Temperature(lag.value())
        }
        None => {
            *lag = Some(Lag::settled(temperature.0));
            temperature
        }
    }
}

/// What every channel of a board delivers at one time.
pub type RawTemperatures = [Raw; CHANNELS];
