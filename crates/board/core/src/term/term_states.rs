//! The states of the terms that follow heat and time.

use crate::{
    cnc::MachineConditions,
    design_parameters::{MAX_TERMS, TEMPERATURE_CHANNEL_COUNT},
    fixed_point::ScaledCoefficient,
    index_set::IndexSet,
    lag::{Lag, SmoothingFactor},
    retained_lags::{RetainedLag, RetainedLagKey, RetainedLags},
    term::{
        category::{CategoryFactor, ConditionLevels, UNIT_STEP, scale_level, speed_squared},
        effect::{Effect, Target, Terms},
        evaluation_order::category_factor,
    },
    units::{FineNanometres, Rpm, Temperature},
};

/// Returns what each term's lag follows; `None` without one.
fn lag_keys(terms: &Terms<'_>) -> impl Iterator<Item = Option<RetainedLagKey>> {
    terms.iter().map(|term| match term.as_ref()?.effect {
        Effect::Heat { channel, smoothing, .. } | Effect::HeatSlope { channel, smoothing, .. }
            if smoothing != SmoothingFactor::NO_LAG =>
        {
            Some(RetainedLagKey { input: channel, rising: smoothing, falling: smoothing })
        }
        Effect::SpeedHeat { power, smoothing, .. } if smoothing != SmoothingFactor::NO_LAG => {
            Some(RetainedLagKey {
                input: RetainedLagKey::speed_input(power),
                rising: smoothing,
                falling: smoothing,
            })
        }
        Effect::Time { smoothing, .. } => Some(RetainedLagKey {
            input: RetainedLagKey::TIME_INPUT,
            rising: smoothing,
            falling: smoothing,
        }),
        Effect::Condition(ConditionLevels { bit, smoothing, .. })
            if smoothing != SmoothingFactor::NO_LAG =>
        {
            let input = RetainedLagKey::CONDITION_FLAG | bit;
            Some(RetainedLagKey { input, rising: smoothing, falling: smoothing })
        }
        _ => None,
    })
}

/// Returns the binary places of a term by category; 0 of another.
const fn fraction_bits(effect: &Effect<'_>) -> u8 {
    match effect {
        Effect::Tool(tools) => tools.shift,
        Effect::Condition(it) => it.shift,
        _ => 0,
    }
}

/// The memory of the terms: their lags, and the present effects of heat and time.
#[derive(Clone, Debug, Default)]
pub struct TermStates {
    lags: [Option<Lag>; MAX_TERMS],
    values: [FineNanometres; MAX_TERMS],
    /// Terms of heat that have had a temperature, or whose heat by the speed is known.
    known: IndexSet,
    /// The conditions by the CNC, or `None` inside: the defaults hold. Nothing before either is known.
    conditions: Option<Option<MachineConditions>>,
    /// m of the terms by category.
    levels: [i32; MAX_TERMS],
    /// The sum of those of the elongation that are not multiplied by its growth, and all their constants.
    by_category: FineNanometres,
    /// m of those that are, the first ones; 0 behind them.
    by_growth: [ScaledCoefficient; MAX_TERMS],
    /// n of those that go by it.
    speed: Rpm,
}

impl TermStates {
    /// A step of 100 ms of term `index`, if it is one of heat or time. A temperature that is missing
    /// leaves it unchanged; an unknown speed does not heat.
    pub fn step(
        &mut self,
        terms: &Terms<'_>,
        index: usize,
        temperatures: &[Option<Temperature>; TEMPERATURE_CHANNEL_COUNT],
        speed: Option<Rpm>,
        is_heat_known: bool,
    ) {
        let (Some(Some(term)), Some(lag), Some(value)) =
            (terms.get(index), self.lags.get_mut(index), self.values.get_mut(index))
        else {
            return;
        };
        match term.effect {
            Effect::Heat { channel, smoothing, reference, per_temperature }
            | Effect::HeatSlope { channel, smoothing, reference, per_temperature } => {
                let temperature = temperatures.get(usize::from(channel)).copied().flatten();
                if let Some(Temperature(now)) = temperature {
                    let lag = lag.get_or_insert(Lag::settled_at(now));
                    lag.step(now, smoothing);
                    if is_heat_known || smoothing == SmoothingFactor::NO_LAG {
                        self.known.insert(index);
                    }
                    let warmer = lag.value().saturating_sub(reference.0);
                    *value = FineNanometres(per_temperature.multiply(warmer.into()));
                }
            }
            Effect::SpeedHeat { power, smoothing, per_unit } => {
                let lag = lag.get_or_insert(Lag::settled_at(0));
                lag.step(power.heat_input(speed), smoothing);
                if is_heat_known || smoothing == SmoothingFactor::NO_LAG {
                    self.known.insert(index);
                }
                *value = FineNanometres(per_unit.multiply(lag.value().into()));
            }
            Effect::Time { smoothing, amplitude } => {
                let lag = lag.get_or_insert(Lag::settled_at(0));
                lag.step(UNIT_STEP, smoothing);
                *value = FineNanometres(amplitude.multiply(lag.value().into()));
            }
            Effect::Condition(it) if it.smoothing != SmoothingFactor::NO_LAG => {
                if let (Some(conditions), Some(level)) =
                    (self.conditions, self.levels.get_mut(index))
                {
                    let input = it.lag_input(conditions);
                    let lag = lag.get_or_insert(Lag::settled_at(input));
                    lag.step(input, it.smoothing);
                    *level = it.level(lag.value());
                    self.update_category_sum(terms);
                }
            }
            _ => {}
        }
    }

    /// Takes what the CNC says of tool and conditions; `None`: the defaults hold.
    pub fn set_conditions(&mut self, terms: &Terms<'_>, conditions: Option<MachineConditions>) {
        self.conditions = Some(conditions);
        for (level, term) in self.levels.iter_mut().zip(terms.iter().flatten()) {
            match &term.effect {
                Effect::Tool(tools) => *level = tools.level(conditions),
                Effect::Condition(it) if it.smoothing == SmoothingFactor::NO_LAG => {
                    *level = it.level(it.lag_input(conditions));
                }
                _ => {}
            }
        }
        self.update_category_sum(terms);
    }

    /// Takes the speed of the spindle; returns whether it is another one.
    pub fn update_speed(&mut self, terms: &Terms<'_>, speed: Rpm) -> bool {
        let is_new = core::mem::replace(&mut self.speed, speed) != speed;
        if is_new {
            self.update_category_sum(terms);
        }
        is_new
    }

    /// A level or the speed has changed.
    #[inline(never)]
    fn update_category_sum(&mut self, terms: &Terms<'_>) {
        let mut sum = FineNanometres::ZERO;
        let mut by_growth = [ScaledCoefficient::default(); MAX_TERMS];
        let mut places = by_growth.iter_mut();
        for ((index, term), level) in terms.iter().enumerate().zip(self.levels) {
            let Some(term) = term.as_ref().filter(|term| term.target == Target::Elongation) else {
                continue;
            };
            match category_factor(&term.effect) {
                None => continue,
                Some(CategoryFactor::Growth) => {
                    // What is 0 ends the list, and adds nothing.
                    if level != 0
                        && let Some(place) = places.next()
                    {
                        *place = ScaledCoefficient {
                            mantissa: level,
                            shift: fraction_bits(&term.effect),
                        };
                    }
                }
                Some(_) => sum = sum.saturating_add(self.category_effect(index, &term.effect, 0)),
            }
            sum = sum.saturating_add(term.constant);
        }
        (self.by_category, self.by_growth) = (sum, by_growth);
    }

    /// Returns what the terms by category make of an elongation: `plain` without terms, `made` by all others.
    #[inline]
    pub(super) fn apply_category_terms(
        &self,
        plain: FineNanometres,
        made: FineNanometres,
    ) -> FineNanometres {
        let mut p = made.saturating_add(self.by_category);
        for m in &self.by_growth {
            if m.mantissa == 0 {
                break;
            }
            p = p.saturating_add(FineNanometres(m.multiply(plain.0.into())));
        }
        p
    }

    /// Returns what of it is no heat: what the CNC says.
    #[must_use]
    pub fn without_thermal_state(&self) -> Self {
        let Self { conditions, levels, by_category, by_growth, speed, .. } = *self;
        Self { conditions, levels, by_category, by_growth, speed, ..Self::default() }
    }

    /// Adds its lags to what outlasts a reset.
    pub fn store_lags(&self, terms: &Terms<'_>, memory: &mut RetainedLags) {
        for (lag, key) in self.lags.iter().zip(lag_keys(terms)) {
            if let (Some(lag), Some(key)) = (*lag, key) {
                memory.insert(RetainedLag { key, lag, running_ms: 0 });
            }
        }
    }

    /// Goes on from before a reset.
    pub fn restore_lags(
        &mut self,
        terms: &Terms<'_>,
        mut find: impl FnMut(RetainedLagKey) -> Option<RetainedLag>,
    ) {
        for (lag, key) in self.lags.iter_mut().zip(lag_keys(terms)) {
            *lag = key.and_then(&mut find).map(|retained| retained.lag);
        }
    }

    /// Returns whether each of these has had a temperature, or knows its heat by the speed.
    #[must_use]
    pub fn is_initialised(&self, terms: IndexSet) -> bool {
        self.known.is_superset(terms)
    }

    /// Returns what term `index`, by category, adds where its growth or position is `x`.
    pub(super) fn category_effect(
        &self,
        index: usize,
        effect: &Effect<'_>,
        x: i64,
    ) -> FineNanometres {
        let Some(by) = category_factor(effect) else { return FineNanometres::ZERO };
        let x = match by {
            CategoryFactor::One => 1,
            CategoryFactor::Speed2 => speed_squared(self.speed.0),
            CategoryFactor::Growth | CategoryFactor::Position => x,
        };
        FineNanometres(scale_level(
            self.levels.get(index).copied().unwrap_or_default(),
            fraction_bits(effect),
            x,
        ))
    }

    /// Returns what heat or time has made of term `index`; 0 for one of neither.
    pub(super) fn thermal_effect(&self, index: usize) -> FineNanometres {
        self.values.get(index).copied().unwrap_or_default()
    }
}
