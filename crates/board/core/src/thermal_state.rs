//! The effects of the machine's temperatures and its running time: a slow part of the bridge.
//!
//! Heat is slow, so this steps every 100 ms ([`THERMAL_STEP_MS`](crate::design_parameters::THERMAL_STEP_MS)) and keeps what
//! the fast tick needs: K₀ and tanβ of each axis, and the elongation of the spindle by temperature
//! and by running time. Between steps only the position moves: ΔK = K₀ + tanβ·(P − P₀).
//!
//! The work is divided into [`THERMAL_ITEM_COUNT`] items that may be done in different ticks of the 100, so that
//! no tick carries it all.

use crate::{
    calibration::Calibration,
    cnc::MachineConditions,
    design_parameters::{MAX_TERMS, TEMPERATURE_CHANNEL_COUNT},
    gradient::Gradient,
    index_set::IndexSet,
    lag::{Lag, SmoothingFactor},
    learned_changes::LearnedChanges,
    retained_lags::{RetainedLag, RetainedLagKey, RetainedLags},
    term::{Target, TermStates},
    units::{FineNanometres, Nanometres, Rpm, Temperature},
    warmup,
};

/// Items of a step: three axes, the spindle by temperature, the spindle by running time, and the
/// terms of a diagnosis.
pub const THERMAL_ITEM_COUNT: usize = FIRST_TERM_ITEM + MAX_TERMS;
/// The item of the spindle's growth by temperature; X, Y and Z come before it.
pub const SPINDLE_ITEM: usize = 3;
/// The item of the first term.
pub const FIRST_TERM_ITEM: usize = 5;

/// The expansion of an axis by its temperature.
#[derive(Clone, Copy, Debug, Default)]
struct AxisThermalState {
    lag: Option<Lag>,
    constant: FineNanometres,
    gradient: Gradient,
}

/// The thermal state of the machine.
#[derive(Clone, Debug, Default)]
pub struct MachineThermalState {
    axes: [AxisThermalState; 3],
    spindle: Option<Lag>,
    by_temperature: FineNanometres,
    /// `by_temperature` is that of a temperature of the last step: not yet nothing, and not of before the thermometer was lost.
    has_spindle_temperature: bool,
    running: warmup::WarmupModelState,
    by_running_time: FineNanometres,
    terms: TermStates,
    /// Axes whose law has had a temperature.
    known: IndexSet,
    /// Steps until what was before the start no longer matters; 0: it is known.
    unknown_steps: u32,
    /// How the parts differ from what the calibration says.
    pub learned: LearnedChanges,
}

/// The remainder of an error of heat at which the heat counts as known: 1 µm.
const MAX_RESIDUAL_NM: i64 = 1_000;

/// Returns whether an item is the expansion of an axis or a term of its error, not one of the elongation: such a part
/// follows temperatures [without jitter](crate::dead_band_filter). The elongation goes on from another source without a delay.
#[must_use]
pub fn is_axis_item(calibration: &Calibration<'_>, item: usize) -> bool {
    let term = || calibration.terms.get(item.checked_sub(FIRST_TERM_ITEM)?)?.as_ref();
    item < SPINDLE_ITEM || term().is_some_and(|term| term.target != Target::Elongation)
}

/// Returns whether these are at least two thermometers, all of which agree within `within`. One that is
/// connected and not known agrees with none.
pub fn temperatures_agree(
    all: impl Iterator<Item = (bool, Option<Temperature>)>,
    within: Temperature,
) -> bool {
    let (mut count, mut least, mut most) = (0_u32, i32::MAX, i32::MIN);
    for (_, temperature) in all.filter(|(is_connected, _)| *is_connected) {
        let Some(Temperature(temperature)) = temperature else { return false };
        count = count.saturating_add(1);
        (least, most) = (least.min(temperature), most.max(temperature));
    }
    count >= 2 && most.saturating_sub(least) <= within.0
}

impl MachineThermalState {
    /// One step of 100 ms with these temperatures, one a channel, and this speed.
    pub fn step(
        &mut self,
        calibration: &Calibration<'_>,
        temperatures: &[Option<Temperature>; TEMPERATURE_CHANNEL_COUNT],
        speed: Option<Rpm>,
    ) {
        for item in 0..THERMAL_ITEM_COUNT {
            self.step_item(calibration, item, temperatures, speed);
        }
    }

    /// One item of a step. A temperature that is missing leaves its part unchanged.
    pub fn step_item(
        &mut self,
        calibration: &Calibration<'_>,
        item: usize,
        temperatures: &[Option<Temperature>; TEMPERATURE_CHANNEL_COUNT],
        speed: Option<Rpm>,
    ) {
        if let (Some(heat), Some(axis)) = (self.axes.get_mut(item), calibration.axes.get(item)) {
            if let Some(thermal) = &axis.thermal
                && let Some(temperature) = channel_temperature(temperatures, thermal.channel)
            {
                let smoothing = [thermal.smoothing, thermal.smoothing_falling];
                let lagged = step_lag(&mut heat.lag, temperature, smoothing);
                (heat.constant, heat.gradient) = thermal.law.evaluate(lagged);
                if self.unknown_steps == 0 || smoothing == [SmoothingFactor::NO_LAG; 2] {
                    self.known.insert(item);
                }
            }
        } else if item == SPINDLE_ITEM {
            self.has_spindle_temperature = false;
            if let Some(spindle) = &calibration.spindle.temperature
                && let Some(temperature) = channel_temperature(temperatures, spindle.channel)
            {
                let lagged = step_lag(
                    &mut self.spindle,
                    temperature,
                    [spindle.smoothing, spindle.smoothing_falling],
                );
                self.by_temperature = spindle.law.evaluate(lagged).0;
                self.has_spindle_temperature = true;
            }
        } else if let Some(term) = item.checked_sub(FIRST_TERM_ITEM) {
            let is_known = self.unknown_steps == 0;
            self.terms.step(&calibration.terms, term, temperatures, speed, is_known);
        } else if let Some(warmup) = &calibration.spindle.warmup {
            let drive = warmup.relative_heat_input(speed);
            warmup.law.step(&mut self.running, drive);
            self.by_running_time = warmup.law.elongation(&self.running);
        }
    }

    /// K₀ and tanβ of an axis; both 0 without a law.
    #[must_use]
    pub fn axis_expansion(&self, axis: usize) -> (FineNanometres, Gradient) {
        self.axes.get(axis).map_or_else(Default::default, |heat| (heat.constant, heat.gradient))
    }

    /// Returns whether it is not known how warm the machine was before the start.
    #[must_use]
    pub const fn is_unknown(&self) -> bool {
        self.unknown_steps != 0
    }

    /// A step of 100 ms in which it is not known; `is_cold`: it is, and there is no heat but that of
    /// the thermometers.
    // Once in the image.
    #[inline(never)]
    pub fn step_unknown_state(&mut self, is_cold: bool) {
        if is_cold && self.is_unknown() {
            let terms = self.terms.without_thermal_state();
            *self = Self { learned: self.learned, terms, ..Self::default() };
        } else {
            self.unknown_steps = self.unknown_steps.saturating_sub(1);
        }
    }

    /// Returns what of it outlasts a reset.
    #[must_use]
    pub fn retained_lags(&self, calibration: &Calibration<'_>) -> RetainedLags {
        let mut memory = RetainedLags::default();
        if self.is_unknown() {
            return memory;
        }
        let with_lags = self.axes.iter().map(|axis| axis.lag).zip(axis_lag_keys(calibration));
        for (lag, key) in with_lags.chain([(self.spindle, spindle_lag_key(calibration))]) {
            if let (Some(lag), Some(key)) = (lag, key) {
                memory.insert(RetainedLag { key, lag, running_ms: 0 });
            }
        }
        if let Some(key) = warmup_lag_key(calibration) {
            let warmup::WarmupModelState { running_ms, heat } = self.running;
            memory.insert(RetainedLag { key, lag: heat, running_ms });
        }
        self.terms.store_lags(&calibration.terms, &mut memory);
        memory
    }

    /// Goes on from before a reset, or this many steps of 100 ms later. Where a law that remembers finds nothing,
    /// the heat is not known until what can be left of the error is `MAX_RESIDUAL_NM`.
    pub fn restore_lags(
        &mut self,
        calibration: &Calibration<'_>,
        memory: &RetainedLags,
        steps: u32,
    ) {
        let mut slowest = 0;
        let mut find = |key: Option<RetainedLagKey>, largest: Nanometres| {
            let key = key?;
            let found = memory.find(key);
            if found.is_none() {
                slowest = slowest.max(settling_steps(key, largest));
            }
            found.map(|retained| retained.after_power_off(steps))
        };
        let max = calibration.limits.max;
        for ((axis, key), max) in self.axes.iter_mut().zip(axis_lag_keys(calibration)).zip(max) {
            axis.lag = find(key, max).map(|retained| retained.lag);
        }
        let [x, y, z] = max;
        let largest = Nanometres(x.0.max(y.0).max(z.0));
        self.spindle = find(spindle_lag_key(calibration), largest).map(|retained| retained.lag);
        if let Some(retained) = find(warmup_lag_key(calibration), largest) {
            self.running =
                warmup::WarmupModelState { running_ms: retained.running_ms, heat: retained.lag };
            let law = calibration.spindle.warmup.as_ref().map(|warmup| &warmup.law);
            self.by_running_time =
                law.map_or(FineNanometres::ZERO, |law| law.elongation(&self.running));
        }
        self.terms.restore_lags(&calibration.terms, |key| find(Some(key), largest));
        self.unknown_steps = slowest;
    }

    /// Returns whether the laws of these axes have each had a temperature yet.
    #[must_use]
    pub fn is_initialised(&self, axes: IndexSet) -> bool {
        self.known.is_superset(axes)
    }

    /// The terms over time have begun this many steps ago.
    pub fn advance_time_terms(&mut self, calibration: &Calibration<'_>, term: usize, steps: u32) {
        for _ in 0..steps {
            self.terms.step(
                &calibration.terms,
                term,
                &[None; TEMPERATURE_CHANNEL_COUNT],
                None,
                true,
            );
        }
    }

    /// Takes what the CNC says of tool and conditions; `None`: the defaults hold.
    pub fn set_conditions(
        &mut self,
        calibration: &Calibration<'_>,
        conditions: Option<MachineConditions>,
    ) {
        self.terms.set_conditions(&calibration.terms, conditions);
    }

    /// Takes the speed for the terms by category; returns whether it is another one.
    pub fn update_speed(&mut self, calibration: &Calibration<'_>, speed: Rpm) -> bool {
        self.terms.update_speed(&calibration.terms, speed)
    }

    /// Returns what heat and time have made of the terms of a diagnosis.
    #[must_use]
    pub fn terms(&self) -> &TermStates {
        &self.terms
    }

    /// Returns whether the spindle's law had a temperature at its last step.
    #[must_use]
    pub const fn has_spindle_temperature(&self) -> bool {
        self.has_spindle_temperature
    }

    /// Returns the elongation by the spindle's temperature.
    #[must_use]
    pub fn temperature_elongation(&self) -> Nanometres {
        self.by_temperature.rounded()
    }

    /// Returns the elongation by the warm-up model.
    #[must_use]
    pub fn warmup_elongation(&self) -> Nanometres {
        self.by_running_time.rounded()
    }
}

/// Steps until a law that begins anywhere within its limits is right to [`MAX_RESIDUAL_NM`]: its offset can
/// be wrong by twice the largest at the start, and no more, because it is clamped.
fn settling_steps(key: RetainedLagKey, largest: Nanometres) -> u32 {
    let parts = i64::from(largest.0).saturating_mul(2).checked_div(MAX_RESIDUAL_NM).unwrap_or(0);
    let parts = u32::try_from(parts).unwrap_or(u32::MAX).max(2);
    let slower = SmoothingFactor(key.rising.0.min(key.falling.0));
    slower.steps_to_fraction(parts)
}

/// Returns what the lags of the axes follow; `None` without a lag.
fn axis_lag_keys(calibration: &Calibration<'_>) -> impl Iterator<Item = Option<RetainedLagKey>> {
    calibration.axes.iter().map(|axis| {
        let thermal = axis.thermal.as_ref()?;
        lag_key(thermal.channel, thermal.smoothing, thermal.smoothing_falling)
    })
}

fn spindle_lag_key(calibration: &Calibration<'_>) -> Option<RetainedLagKey> {
    let spindle = calibration.spindle.temperature.as_ref()?;
    lag_key(spindle.channel, spindle.smoothing, spindle.smoothing_falling)
}

fn warmup_lag_key(calibration: &Calibration<'_>) -> Option<RetainedLagKey> {
    let law = &calibration.spindle.warmup.as_ref()?.law;
    lag_key(RetainedLagKey::SPINDLE_RUNNING_INPUT, law.smoothing_heating, law.smoothing_cooling)
}

fn lag_key(input: u8, rising: SmoothingFactor, falling: SmoothingFactor) -> Option<RetainedLagKey> {
    let has_memory = [rising, falling] != [SmoothingFactor::NO_LAG; 2];
    has_memory.then_some(RetainedLagKey { input, rising, falling })
}

/// Returns the temperature of a channel.
fn channel_temperature(
    temperatures: &[Option<Temperature>; TEMPERATURE_CHANNEL_COUNT],
    number: u8,
) -> Option<Temperature> {
    temperatures.get(usize::from(number)).copied().flatten()
}

/// Moves a lag one step. Returns the lagged temperature; a lag starts settled at the first temperature that it sees.
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
            *lag = Some(Lag::settled_at(temperature.0));
            temperature
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lag_rises_by_one_time_constant_and_falls_by_the_other() {
        let (fast, slow) = (SmoothingFactor(1 << 31), SmoothingFactor(1 << 30));
        let degrees = |kelvin: i32| Temperature(kelvin * Temperature::PER_KELVIN);
        let mut lag = None;
        assert_eq!(step_lag(&mut lag, degrees(20), [fast, slow]), degrees(20), "settled at first");
        assert_eq!(step_lag(&mut lag, degrees(24), [fast, slow]), degrees(22));
        assert_eq!(step_lag(&mut lag, degrees(14), [fast, slow]), degrees(20));
    }

    #[test]
    fn a_step_of_the_heat_steps_each_of_its_parts() {
        let mut calibration: Calibration<'_> = crate::testing::minimal_calibration();
        calibration.spindle.warmup = Some(crate::calibration::SpindleWarmupModel {
            law: warmup::WarmupModel {
                lag_ms: 0,
                max: Nanometres(30_000).to_fine(),
                smoothing_heating: SmoothingFactor::NO_LAG,
                smoothing_cooling: SmoothingFactor::NO_LAG,
                full: 1 << warmup::WarmupModel::FULL_FRACTION_BITS,
            },
            power: Default::default(),
        });
        let mut heat = MachineThermalState::default();
        heat.step(&calibration, &[None; TEMPERATURE_CHANNEL_COUNT], Some(Rpm(1_000)));
        assert_eq!(heat.warmup_elongation(), Nanometres(30_000));
        heat.step(&calibration, &[None; TEMPERATURE_CHANNEL_COUNT], Some(Rpm(0)));
        assert_eq!(heat.warmup_elongation(), Nanometres(0));
    }
}
