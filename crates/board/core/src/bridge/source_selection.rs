//! Which source of the elongation is used, and how one takes over from another without a step.
//!
//! Each source has a zero of its own: a sensor's is where it was mounted, a model's where it was
//! fitted, and they disagree by micrometres. So a source that takes over is shifted by what makes
//! the elongation go on where it was: from there the spindle grows as this source says. Back on the first
//! source the shift is taken back at `rejoin_nm_per_s` of the [limits](crate::limits::CompensationLimits), and reported
//! as an offset on its way. A source
//! that returns is asked again only once it has been fresh for [`SOURCE_RETURN_DELAY_MS`].
//!
//! As long as none is used a fall-back waits until the sources before it are dead, which is known
//! within half a second: else it would be shifted against one that only has not come yet. And its zero is not
//! known where `Zero` has taken a reference by the
//! first source: until that source has been there, or the shift has outlasted the reset, there is no
//! elongation.

use super::{
    Bridge, BridgeState,
    bumpless_transfer::{BumplessTransfer, HISTORY_STEPS, RetainedTransfer, SelectedSource},
    source_agreement::ElongationSample,
};
use crate::{
    bridge::state::{ReferenceErrors, SAMPLES_TIMEOUT_MS, STALE_DURATION_AFTER_LOSS_MS},
    calibration::ElongationSource,
    cnc::OffsetQuality,
    design_parameters::THERMAL_STEP_MS,
    term::{self, OperatingPoint},
    tip_error,
    units::Nanometres,
};

/// A source that returns has to be fresh for this time: five times the longest window of the filter.
pub const SOURCE_RETURN_DELAY_MS: u32 = 1_000;
/// The same in steps of the heat; for as long the shift of a source that has taken over stays unchanged.
const SOURCE_RETURN_DELAY_STEPS: u32 = SOURCE_RETURN_DELAY_MS / THERMAL_STEP_MS;

/// (Nanometres a second)·milliseconds in a nanometre.
const MILLISECONDS_PER_SECOND: u32 = 1_000;

impl BridgeState {
    /// Returns the source that was used last and its shift, once the elongation goes on.
    #[must_use]
    pub fn retained_transfer(&self) -> Option<RetainedTransfer> {
        let BumplessTransfer { last, shift, is_anchored, .. } = self.joint;
        last.filter(|_| is_anchored).map(|source| RetainedTransfer { source, shift })
    }

    /// Goes on from where it was before a reset.
    pub fn restore_transfer(&mut self, retained: RetainedTransfer) {
        let RetainedTransfer { source, shift } = retained;
        self.joint = BumplessTransfer {
            last: Some(source),
            shift,
            is_anchored: true,
            is_resumed: true,
            ..BumplessTransfer::default()
        };
    }
}

impl Bridge<'_> {
    /// Returns the source of this tick.
    #[inline]
    pub(super) fn select_source(&self, state: &mut BridgeState, elapsed_ms: u32) -> SelectedSource {
        const SENSOR_SOURCE: SelectedSource = SelectedSource::Source(ElongationSource::Sensor);
        // As nearly always.
        if self.needs.first == Some(ElongationSource::Sensor)
            && state.joint.selected == SENSOR_SOURCE
            && state.is_sensor_fresh()
        {
            return SENSOR_SOURCE;
        }
        self.reselect_source(state, elapsed_ms)
    }

    #[inline(never)]
    fn reselect_source(&self, state: &mut BridgeState, elapsed_ms: u32) -> SelectedSource {
        let best = self.best_usable_source(state);
        let present = state.joint.selected;
        let stays = present.source().is_some_and(|source| self.is_source_fresh(state, source));
        let returned_ms = if stays && best != present && state.joint.is_anchored {
            state.joint.returned_ms.saturating_add(elapsed_ms)
        } else {
            SOURCE_RETURN_DELAY_MS
        };
        state.joint.returned_ms = if best == present { 0 } else { returned_ms };
        if best != present && returned_ms >= SOURCE_RETURN_DELAY_MS {
            self.switch_source(state, best);
        }
        state.joint.selected
    }

    fn switch_source(&self, state: &mut BridgeState, next: SelectedSource) {
        if let Some(source) = next.source() {
            if state.joint.is_resumed && state.joint.last != Some(source) {
                // What that one would say now is not known: this one counts from its own zero.
                state.joint = BumplessTransfer::default();
                if !self.has_common_zero(state, source) {
                    return;
                }
            }
            state.joint.is_resumed = false;
            if let Some(last) = state.joint.last
                && last != source
                && state.joint.is_anchored
            {
                let latest = || {
                    let sum = i64::from(self.unshifted_elongation(state, last).0)
                        .wrapping_add(state.joint.shift.0.into());
                    Nanometres::saturating_from(sum)
                };
                // A source that is still there, and only gives way, is right to the last.
                let stays =
                    self.is_source_fresh(state, last) && self.is_source_current(state, last);
                let oldest = state.joint.before.into_iter().flatten().next();
                let (joins_at, raw_value) = match oldest.filter(|_| !stays) {
                    // Where the two were at that time: it shows how the spindle has grown since.
                    Some(ElongationSample { elongation, raw }) => {
                        let raw_value = raw.get(source as usize).copied().flatten();
                        (
                            elongation,
                            raw_value.unwrap_or_else(|| self.unshifted_elongation(state, source)),
                        )
                    }
                    None => (latest(), self.unshifted_elongation(state, source)),
                };
                let shift = i64::from(joins_at.0).wrapping_sub(raw_value.0.into());
                state.joint.shift = Nanometres::saturating_from(shift);
                // The value of one before it was lost is no longer where the next goes on from.
                if !stays {
                    state.joint.before = [None; HISTORY_STEPS];
                }
            }
            state.joint.steps = 0;
            state.joint.last = Some(source);
            state.joint.is_anchored |= self.needs.first == Some(source);
        }
        state.joint.selected = next;
        state.joint.returned_ms = 0;
    }

    /// A step of the heat: on the first source the shift is taken back.
    pub(super) fn step_source_transfer(&self, state: &mut BridgeState) {
        if let SelectedSource::Source(source) = state.joint.selected {
            let raw = ElongationSource::ALL.map(|source| {
                self.is_source_fresh(state, source)
                    .then(|| self.unshifted_elongation(state, source))
            });
            let now = ElongationSample { elongation: self.elongation(state), raw };
            // A thermometer that says nothing new may be about to be given up: the next source
            // is to show what the spindle grows meanwhile.
            if self.is_source_current(state, source) {
                let [_, second, third, last] = state.joint.before;
                state.joint.before = [second, third, last, Some(now)];
            }
            state.joint.agreement.step(self.needs.first, &now);
        }
        // Not in its first second: then the offset goes on with the growth, and nothing else moves it.
        state.joint.steps = state.joint.steps.saturating_add(1);
        if state.joint.steps > SOURCE_RETURN_DELAY_STEPS && self.is_source_shift_decaying(state) {
            let rate = self.calibration.limits.rejoin_nm_per_s;
            let BumplessTransfer { shift, rest, .. } = &mut state.joint;
            let due = rate.saturating_mul(THERMAL_STEP_MS).saturating_add(*rest);
            *rest = due % MILLISECONDS_PER_SECOND;
            let most = due / MILLISECONDS_PER_SECOND;
            let step = shift.0.unsigned_abs().min(most).cast_signed();
            *shift = Nanometres(shift.0.wrapping_sub(step.wrapping_mul(shift.0.signum())));
        }
    }

    /// `Zero` makes the present error the reference: on the first source it counts as that source gives it,
    /// and there is nothing left to take back.
    pub(super) fn clear_source_shift(&self, state: &mut BridgeState) {
        if self.is_primary_source(state.joint.selected) {
            state.joint.shift = Nanometres::ZERO;
            state.joint.before = [None; HISTORY_STEPS];
        }
    }

    /// Returns whether the shift is still being taken back.
    pub(super) fn is_source_shift_decaying(&self, state: &BridgeState) -> bool {
        state.joint.shift.0 != 0 && self.is_primary_source(state.joint.selected)
    }

    fn is_primary_source(&self, selected: SelectedSource) -> bool {
        selected.source().is_some_and(|source| self.needs.first == Some(source))
    }

    /// Returns whether the source is the spindle's temperature, which changed too fast and is held.
    #[inline(never)]
    pub(super) fn is_source_held(&self, state: &BridgeState, chosen: SelectedSource) -> bool {
        const TEMPERATURE_SOURCE: SelectedSource =
            SelectedSource::Source(ElongationSource::Temperature);
        chosen == TEMPERATURE_SOURCE && self.is_spindle_temperature_held(state)
    }

    /// Returns whether the spindle's temperature is held: it was believed, and changed too fast since.
    fn is_spindle_temperature_held(&self, state: &BridgeState) -> bool {
        let law = self.calibration.spindle.temperature.as_ref();
        law.is_some_and(|law| {
            state.channels.uncertain_channels().contains(law.channel.into())
                && state.channels.temperature(law.channel).is_some()
                && state.heat.has_spindle_temperature()
                && (!state.heat.is_unknown() || !law.has_lag())
        })
    }

    /// Returns the first source that is fresh; without one the spindle's temperature, if it is held.
    #[inline(never)]
    fn best_usable_source(&self, state: &BridgeState) -> SelectedSource {
        match self.first_fresh_in_chain(state) {
            SelectedSource::Missing
                if self.is_spindle_temperature_held(state)
                    && self
                        .calibration
                        .spindle
                        .chain
                        .contains(&Some(ElongationSource::Temperature))
                    && self.has_common_zero(state, ElongationSource::Temperature) =>
            {
                SelectedSource::Source(ElongationSource::Temperature)
            }
            first => first,
        }
    }

    fn first_fresh_in_chain(&self, state: &BridgeState) -> SelectedSource {
        let mut chosen = SelectedSource::Unneeded;
        for source in self.calibration.spindle.chain.into_iter().flatten() {
            if self.is_source_fresh(state, source) && self.has_common_zero(state, source) {
                return SelectedSource::Source(source);
            }
            chosen = SelectedSource::Missing;
            let is_awaited = state.joint.selected.source().is_none();
            if is_awaited && !self.has_source_failed(state, source) {
                break;
            }
        }
        chosen
    }

    /// Returns whether what a source says counts from the same zero as the reference.
    fn has_common_zero(&self, state: &BridgeState, source: ElongationSource) -> bool {
        self.needs.first == Some(source)
            || state.joint.is_anchored
            || state.reference == ReferenceErrors::default()
    }

    fn is_source_fresh(&self, state: &BridgeState, source: ElongationSource) -> bool {
        let spindle = &self.calibration.spindle;
        match source {
            ElongationSource::Sensor => state.is_sensor_fresh(),
            ElongationSource::Temperature => spindle.temperature.is_some_and(|temperature| {
                let channel = temperature.channel;
                state.channels.temperature(channel).is_some()
                    && !state.channels.uncertain_channels().contains(channel.into())
                    && state.heat.has_spindle_temperature()
                    && (!state.heat.is_unknown() || !temperature.has_lag())
            }),
            ElongationSource::Warmup => spindle.warmup.is_some() && !state.heat.is_unknown(),
        }
    }

    /// Returns whether what a source says is of this step of the heat.
    fn is_source_current(&self, state: &BridgeState, source: ElongationSource) -> bool {
        let temperature = &self.calibration.spindle.temperature;
        source != ElongationSource::Temperature
            || temperature.is_none_or(|temperature| {
                state.channels.has_valid_last_reading(temperature.channel)
            })
    }

    /// Returns whether a source has failed and gives nothing. A source that has only not come yet is not dead.
    fn has_source_failed(&self, state: &BridgeState, source: ElongationSource) -> bool {
        let spindle = &self.calibration.spindle;
        match source {
            ElongationSource::Sensor => {
                state.codes_age.is_older_than(SAMPLES_TIMEOUT_MS)
                    || !state.believable
                    || !state.starved_age.is_older_than(STALE_DURATION_AFTER_LOSS_MS)
            }
            ElongationSource::Temperature => spindle.temperature.is_none_or(|temperature| {
                state.channels.is_faulty(temperature.channel)
                    || (state.heat.is_unknown() && temperature.has_lag())
            }),
            ElongationSource::Warmup => spindle.warmup.is_none() || state.heat.is_unknown(),
        }
    }

    /// Returns whether every source of the elongation is dead or without a zero, and there are some.
    pub(super) fn have_all_sources_failed(&self, state: &BridgeState) -> bool {
        let mut sources = self.calibration.spindle.chain.into_iter().flatten().peekable();
        sources.peek().is_some()
            && sources.all(|source| {
                self.has_source_failed(state, source) || !self.has_common_zero(state, source)
            })
    }

    /// Returns whether a fall-back could not take over if it were needed: it is watched before it is.
    #[must_use]
    pub fn has_fallback_failed(&self, state: &BridgeState) -> bool {
        let sources = self.calibration.spindle.chain.into_iter().flatten();
        sources.skip(1).any(|source| self.has_source_failed(state, source))
    }

    /// Returns whether what the sources measure no longer fits the calibration: they grow apart.
    #[must_use]
    pub const fn has_source_disagreement(&self, state: &BridgeState) -> bool {
        state.joint.agreement.has_disagreement()
    }

    /// Returns the elongation by the source in use, as it goes on from the one before.
    #[inline]
    pub(super) fn elongation(&self, state: &BridgeState) -> Nanometres {
        let raw = match state.joint.selected.source() {
            Some(source) => self.unshifted_elongation(state, source),
            None => self.terms_elongation(state),
        };
        let sum = i64::from(raw.0).wrapping_add(state.joint.shift.0.into());
        Nanometres::saturating_from(sum)
    }

    /// Returns what a source says, with what was learned and the terms of a diagnosis. Both were fitted to the first
    /// source, and say nothing of another.
    #[inline]
    fn unshifted_elongation(&self, state: &BridgeState, source: ElongationSource) -> Nanometres {
        let by_sensor = state.elongation.unwrap_or_default();
        let plain = tip_error::source_elongation(Some(source), by_sensor, &state.heat);
        if self.needs.first != Some(source) {
            return plain;
        }
        let plain = state.heat.learned.apply_to_growth(plain);
        if self.needs.terms { self.add_terms(state, plain) } else { plain }
    }

    /// Terms of an elongation that has no source.
    fn terms_elongation(&self, state: &BridgeState) -> Nanometres {
        if self.needs.terms && state.joint.selected == SelectedSource::Unneeded {
            self.add_terms(state, Nanometres::ZERO)
        } else {
            Nanometres::ZERO
        }
    }

    #[inline(never)]
    fn add_terms(&self, state: &BridgeState, plain: Nanometres) -> Nanometres {
        let terms = self.calibration.terms.get(..self.needs.walked_terms).unwrap_or_default();
        let operating = match state.spindle.latest() {
            Some(spindle) if !terms.is_empty() => OperatingPoint {
                speed: Some(spindle.speed),
                load: i32::from(spindle.load_n).saturating_mul(256),
            },
            _ => OperatingPoint::default(),
        };
        term::apply_elongation_terms(terms, plain.to_fine(), state.heat.terms(), operating)
            .rounded()
    }

    /// Returns the quality of an offset that is followed: how far down the chain its source stands.
    pub(super) fn offset_quality(&self, selected: SelectedSource) -> OffsetQuality {
        match selected.source() {
            Some(source) if self.needs.first == Some(source) => OffsetQuality::Live,
            Some(ElongationSource::Temperature) => OffsetQuality::TemperatureModel,
            Some(ElongationSource::Warmup) => OffsetQuality::WarmUpModel,
            _ => OffsetQuality::Live,
        }
    }
}
