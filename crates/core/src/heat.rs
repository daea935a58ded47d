//! What the machine's temperatures and its running time make of it: a slow part of the bridge.
//!
//! Heat is slow, so this steps every 100 ms ([`STEP_MS`](crate::dimensions::STEP_MS)) and keeps what
//! the fast tick needs: K₀ and tanβ of each axis, and the elongation of the spindle by temperature
//! and by running time. Between steps only the position moves: ΔK = K₀ + tanβ·(P − P₀).
//!
//! The work is divided into [`ITEMS`] items that may be done in different ticks of the 100, so that
//! no tick carries it all.

use crate::{
    calibration::Calibration,
    dimensions::{CHANNELS, MAX_TERMS},
    gradient::Gradient,
    lag::{Lag, SmoothingFactor},
    set::IndexSet,
    term::TermStates,
    units::{Fine, Nanometres, Rpm, Temperature},
    warmup,
};

/// Items of a step: three axes, the spindle by temperature, the spindle by running time, and the
/// terms of a diagnosis.
pub const ITEMS: usize = FIRST_TERM + MAX_TERMS;
/// The item of the spindle's growth by temperature; X, Y and Z come before it.
pub const SPINDLE: usize = 3;
/// The item of the first term.
pub const FIRST_TERM: usize = 5;

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
        } else if item == SPINDLE {
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
            self.terms.step(&calibration.terms, term, temperatures);
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
            self.terms.step(&calibration.terms, term, &[None; CHANNELS]);
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
