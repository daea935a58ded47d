//! One tick of the bridge: a millisecond of samples in, one offset out.
//!
//! ```text
//! codes ─► health ─► filter ─► sensor ─┐
//! temperatures ─► heat ────────────────┼► elongation ─► along the tool ─┐
//!                  └─► thermal ─┐      (the first source that is fresh) │
//! Position ─► place ─► screw ───┼► errors of the axes ─────────────────┴► minus the reference
//!                  └─► guides ──┘                                         ─► limits ─► offset
//! Control ────────────────────────────────► engaged? held? ──────────────────┘
//! ```
//!
//! One place decides which inputs the offset follows ([`Bridge::tick`]). An input is what the
//! calibration needs: the sensor or another source of the elongation, temperatures, the positions of
//! those axes that something depends on, the angles of the axes that turn the tool.
//!
//! | the CNC | the inputs | offset | quality |
//! |---|---|---|---|
//! | engages | all fresh | −(error − reference), at the slew limit | live |
//! | engages | the sensor is lost, another source is configured | the same | temperature or warm-up model |
//! | engages | a temperature changed too fast, no other source | the same, by the last believed temperature | hold |
//! | engages | tool and conditions are lost, after `hold_ms` | the same, by their stated defaults | temperature model |
//! | engages, or was lost while engaged | any is lost | unchanged, for `hold_ms` | hold |
//! | the same, after `hold_ms` | | to 0, at the slew limit | ramping out |
//! | does not engage, or is not referenced | | to 0, at the slew limit | ramping out |
//! | any of these, offset arrived at 0 | sensor and temperatures believable | 0 | off |
//! | any of these, offset arrived at 0 | faulty or missing | none | fault |
//! | any, while the offset is inhibited ([`BridgeState::set_inhibited`]) | | to 0, at the slew limit; then none | ramping out; fault |
//!
//! Lost and returned is no jump: every way back goes through the slew limit. From one source of the
//! elongation to another the offset goes on where it was (`sources`).
//!
//! Work is done when its input changes. A tick does what comes every millisecond: samples, the
//! errors added up, limits. The errors that depend on a position are computed when it is received, the tool
//! direction when the angles are, each at most once in [`ERROR_UPDATE_PERIOD_MS`] and else in the next tick;
//! expansion once in 100 ms. On the gantry of `data/`, all axes on their way at the slew limit, `cargo measure`
//! counts for a whole tick of the node 1,669 instructions (median; 2,194 where the spindle speed has changed and a
//! part of the heat is stepped; the sources are asked what they would say in a millisecond of their own). With a
//! volume the tick that follows a message adds it up
//! ([`CachedErrors::sum_guideway_errors`](crate::axis_errors::CachedErrors::sum_guideway_errors), 374), once for all positions and angles that came:
//!
//! | in the tick | | when received | |
//! |---|---|---|---|
//! | [`SensorHealthMonitor`](crate::sensor_health::SensorHealthMonitor::check_and_clean_codes) | 294 | position: [`CachedErrors::update_axis_position`](crate::axis_errors::CachedErrors::update_axis_position) | 444 |
//! | [`Filter::tick`](crate::run_out_filter::RunOutFilter::tick) | 300 | angles: [`Kinematics::tool_direction`](crate::kinematics::Kinematics::tool_direction) | 221 |
//! | [`SensorLaw::elongation`](crate::displacement_sensor::SensorLaw::elongation) | 33 | speed, in the next tick: [`RevolutionWindow::for_speed`](crate::revolution_window::RevolutionWindow::for_speed) | 49 |
//! | [`AppliedOffset::step`](crate::limits::AppliedOffset::step) | 180 | | |
//! | both frames | 215 | | |
//! | ages, what is fresh, course, target, flags | ~460 | | |

mod bumpless_transfer;
mod cached_errors;
mod conditions;
mod lost_inputs;
mod reference;
mod required_inputs;
mod rotary_angles;
mod slope;
mod source_agreement;
mod source_selection;
mod state;

pub use self::bumpless_transfer::RetainedTransfer;
use self::bumpless_transfer::SelectedSource;
use self::cached_errors::ErrorInput;
pub use self::conditions::CONDITIONS_TIMEOUT_FACTOR;
pub use self::lost_inputs::LostInputs;
use self::required_inputs::RequiredInputs;
pub use self::slope::{ConstantAndSlope, SLOPE_RESOLUTION_NM};
pub use self::source_agreement::{DISAGREEMENT_THRESHOLD_NM, MIN_DISAGREEMENT_STEPS};
pub use self::source_selection::SOURCE_RETURN_DELAY_MS;
use self::state::{Age, OffsetMode};
pub use self::state::{
    BridgeState, JUMP_REPORT_DURATION_MS, MAX_POSITION_JITTER_MS, ReferenceErrors,
    SAMPLES_TIMEOUT_MS, STALE_DURATION_AFTER_LOSS_MS, TEMPERATURE_TIMEOUT_MS,
};
use crate::{
    axis_errors::ErrorSums,
    calibration::{Calibration, ElongationSource},
    cnc::{CncMessage, Control, LinearAxis, OffsetFlags, OffsetQuality, Output, RotaryAxisAngles},
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT, THERMAL_STEP_MS},
    index_set::IndexSet,
    learned_changes::LearnedChangeRequest,
    limits::LimitStatus,
    retained_lags::RetainedLags,
    revolution_window,
    temperature_channels::RawTemperatures,
    thermal_state,
    thermometer::RawTemperatureReading,
    tip_error,
    tool_direction::ToolDirection,
    units::{AdcCode, FineNanometres, Nanometres, Rpm, TimestampMs},
};

/// The bridge: the calibration, the inputs it requires and the limits of the offsets.
#[derive(Clone, Debug)]
pub struct Bridge<'a> {
    calibration: Calibration<'a>,
    needs: RequiredInputs,
    /// The largest part of an error of X, Y and Z: the limits of the offsets, not below 0.
    largest: [FineNanometres; 3],
}

/// The inputs of one tick.
#[derive(Clone, Copy, Debug, Default)]
pub struct TickInput<'a> {
    /// A millisecond of conversions; `None` where none came.
    pub codes: Option<&'a [AdcCode; CODES_PER_TICK]>,
    /// The spindle speed as the board knows it; a fresh one from the CNC wins.
    pub speed: Option<Rpm>,
    /// The readings of the temperature channels; `None` where nothing new came.
    pub temperatures: Option<&'a RawTemperatures>,
}

/// Minimum time between two computations on reception of the errors that depend on the same input: the cycle of a fast CNC. For
/// further messages the tick computes them. The bounds of time rest on this (`cargo xtask bounds`).
pub const ERROR_UPDATE_PERIOD_MS: u32 = 2;

/// The millisecond of each 100 in which the sources are asked, after temperatures and heat have had theirs.
const SOURCE_SELECTION_PHASE: usize = TEMPERATURE_CHANNEL_COUNT + thermal_state::THERMAL_ITEM_COUNT;

impl<'a> Bridge<'a> {
    /// Returns a bridge for this machine.
    #[must_use]
    pub fn new(calibration: Calibration<'a>) -> Self {
        let largest = calibration.limits.max.map(|max| FineNanometres(max.to_fine().0.max(0)));
        Self { calibration, needs: RequiredInputs::from_calibration(&calibration), largest }
    }

    /// Returns what it knows of the machine.
    #[must_use]
    pub fn calibration(&self) -> &Calibration<'a> {
        &self.calibration
    }

    /// Takes a valid message of the CNC. It counts from now on, that is from the last tick.
    ///
    /// The effects of a message are computed here and not in every tick: the errors of the axes that
    /// depend on this position, the tool direction. A CNC that stands still sends the same again,
    /// and that costs nothing.
    pub fn receive(&self, state: &mut BridgeState, command: CncMessage) {
        match command {
            CncMessage::Control(control) => self.receive_control(state, control),
            value => self.receive_command(state, value),
        }
    }

    /// Takes a `Control`.
    pub fn receive_control(&self, state: &mut BridgeState, control: Control) {
        // An edge needs a known `Control` before it: a CNC that starts with the bit
        // already set has asked for nothing.
        let was = state.control.fresh_value(self.calibration.limits.link_timeout_ms);
        if control.zero && control.referenced && was.is_some_and(|was| !was.zero) {
            state.zeroed |= self.try_set_reference(state);
        }
        state.control.receive(control);
        state.cnc_known = true;
    }

    /// Takes any other command than `Control`, which it ignores.
    // Apart from it, because a `Zero` takes long and no value does: a test bounds the time of each (host-tests, `bounds`).
    pub fn receive_command(&self, state: &mut BridgeState, value: CncMessage) {
        match value {
            CncMessage::Control(_) => {}
            CncMessage::Spindle(spindle) => {
                state.spindle.receive(spindle);
                if self.needs.category_speed
                    && state.heat.update_speed(&self.calibration, spindle.speed)
                {
                    self.update_term_errors(state);
                }
            }
            CncMessage::Conditions(conditions) => self.receive_conditions(state, conditions),
            CncMessage::Rotary(RotaryAxisAngles { angles }) => self.receive_angles(state, angles),
            CncMessage::Position(received) => {
                if let Some(axis) = self.calibration.axes.get(received.axis as usize)
                    && state.receive_position(received, axis)
                {
                    self.update_or_defer_errors(state, ErrorInput::Axis(received.axis));
                }
            }
        }
    }

    /// Takes a change that was learned; whether the calibration permits it.
    pub fn apply_learned_change(
        &self,
        state: &mut BridgeState,
        change: LearnedChangeRequest,
    ) -> bool {
        state.heat.learned.request(change, self.calibration.limits.learned)
    }

    /// Computes one tick: `now` is the time at its end.
    // A part of the node's tick, also where an image has that twice: a call costs 20 instructions.
    #[inline(always)]
    pub fn tick(&self, state: &mut BridgeState, now: TimestampMs, input: TickInput<'_>) -> Output {
        let limits = &self.calibration.limits;
        let elapsed_ms = now.duration_ms_since(state.now);
        state.now = now;
        state.advance_ages(elapsed_ms);

        let spindle = state.spindle.fresh_value(limits.link_timeout_ms);
        let speed = spindle.map(|spindle| spindle.speed).or(input.speed);
        if let Some(codes) = input.codes {
            self.process_samples(state, codes, speed);
        }
        if let Some(raw) = input.temperatures {
            // Word by word: as a whole it is a call of `memmove`, at ten times the cost.
            let [a, b, c, d, e, f, g, h] = *raw;
            state.raw = [a, b, c, d, e, f, g, h];
            state.raw_age = Age::ZERO;
        }
        self.step_thermal(state, elapsed_ms, speed);

        let chosen = self.select_source(state, elapsed_ms);
        let place = self.has_cnc_inputs(state);
        let fresh = self.step_conditions(state, elapsed_ms)
            && chosen != SelectedSource::Missing
            && place
            && self.has_temperatures(state);
        let control = state.control.fresh_value(limits.link_timeout_ms);
        let mode = state.update_mode(control, fresh, limits.hold_ms);
        let (mut status, mut outside, mut rejoins) = (LimitStatus::default(), false, false);
        match mode {
            OffsetMode::Follow => {
                let errors = self.axis_errors(state);
                let (target, clamped) =
                    self.compute_target_offset(state, self.elongation(state), &errors);
                state.joint.is_anchored = true;
                status = state.applied.step(limits, target, elapsed_ms);
                status.clamped |= clamped | errors.clamped;
                outside = errors.outside;
                rejoins = self.is_source_shift_decaying(state);
            }
            // What is applied is held; it does not travel on to where it was going.
            OffsetMode::Hold => {}
            OffsetMode::RampOut => {
                status = state.applied.step(limits, [Nanometres::ZERO; 3], elapsed_ms);
            }
        }

        let missing = self.are_samples_missing(state);
        let unbelievable = self.is_sensor_lost(state, missing)
            || state.channels.has_faulty_channel(self.needs.watched);
        let quality = match mode {
            OffsetMode::Follow if self.is_temperature_held(state, chosen) => OffsetQuality::Hold,
            OffsetMode::Follow => match self.offset_quality(chosen) {
                OffsetQuality::Live if state.conditions.by_default => {
                    OffsetQuality::TemperatureModel
                }
                quality => quality,
            },
            OffsetMode::Hold => OffsetQuality::Hold,
            OffsetMode::RampOut if !state.applied.is_zero() => OffsetQuality::RampingOut,
            OffsetMode::RampOut if state.inhibited || self.has_input_fault(state, chosen) => {
                OffsetQuality::Fault
            }
            OffsetMode::RampOut => OffsetQuality::Off,
        };
        let flags = OffsetFlags::NONE
            .with_if(status.clamped, OffsetFlags::CLAMPED)
            .with_if(status.slewing || rejoins, OffsetFlags::SLEWING)
            .with_if(unbelievable, OffsetFlags::SENSOR_FAULT)
            .with_if(missing, OffsetFlags::SAMPLES_MISSING)
            .with_if(state.cnc_known && (control.is_none() || !place), OffsetFlags::CNC_LOST)
            .with_if(speed.is_none(), OffsetFlags::SPEED_UNKNOWN)
            .with_if(outside, OffsetFlags::OUTSIDE_TABLE);
        Output {
            offset: (quality != OffsetQuality::Fault).then(|| state.applied.offset()),
            quality,
            flags,
            age_ms: oldest_input_age(state, chosen).to_wire_byte(),
        }
    }

    #[inline]
    fn are_samples_missing(&self, state: &BridgeState) -> bool {
        self.needs.sensor
            && (state.codes_age.is_older_than(SAMPLES_TIMEOUT_MS)
                || !state.starved_age.is_older_than(STALE_DURATION_AFTER_LOSS_MS))
    }

    #[inline]
    fn is_sensor_lost(&self, state: &BridgeState, missing: bool) -> bool {
        self.needs.sensor && !missing && !state.believable
    }

    /// Codes to elongation.
    fn process_samples(
        &self,
        state: &mut BridgeState,
        codes: &[AdcCode; CODES_PER_TICK],
        speed: Option<Rpm>,
    ) {
        if state.codes_age.is_older_than(1) {
            state.health.record_gap();
        }
        state.codes_age = Age::ZERO;
        let supply = state.supply_scale();
        let turns =
            speed.is_some_and(|speed| speed.0 > revolution_window::MIN_SPEED_FOR_REVOLUTION_MEAN.0);
        let clean = state.health.check_and_clean_codes(codes, turns).zip(supply);
        state.believable = clean.is_some();
        match clean {
            None => state.filter.clear(),
            Some((clean, scale)) => {
                if let Some(reading) = state.filter.tick(clean, speed) {
                    match speed.filter(|_| turns) {
                        Some(speed) => state.run_out.receive(clean, reading, speed),
                        None => state.run_out.record_standstill(),
                    }
                    let reading = scale.scale_reading(reading);
                    state.elongation = Some(self.calibration.spindle.sensor.elongation(reading));
                    state.elongation_age = Age::ZERO;
                }
            }
        }
    }

    /// Every 100 ms each temperature is read once, then each part of the heat is stepped once, and then the
    /// sources are asked what they say: one of them a millisecond, and in most milliseconds none.
    fn step_thermal(&self, state: &mut BridgeState, elapsed_ms: u32, speed: Option<Rpm>) {
        for _ in 0..elapsed_ms.min(THERMAL_STEP_MS) {
            let phase = if state.phase_ms >= THERMAL_STEP_MS { 0 } else { state.phase_ms };
            state.phase_ms = phase.saturating_add(1);
            let phase = phase as usize;
            if phase <= SOURCE_SELECTION_PHASE {
                self.step_thermal_phase(state, phase, speed);
            }
        }
    }

    /// Does the work of one of the first milliseconds of each 100: a temperature channel, the shift of a source, or a
    /// part of the heat.
    #[inline(never)]
    fn step_thermal_phase(&self, state: &mut BridgeState, phase: usize, speed: Option<Rpm>) {
        let Some(item) = phase.checked_sub(TEMPERATURE_CHANNEL_COUNT) else {
            return self.read_temperature(state, phase);
        };
        if phase == SOURCE_SELECTION_PHASE {
            return self.step_source_transfer(state);
        }
        if item == 0 {
            self.update_thermal_state_validity(state);
        }
        // As many items have no term as there are parts: one a millisecond.
        state.heat.learned.step(item);
        let temperatures = if thermal_state::is_axis_item(&self.calibration, item) {
            state.steady.map(|steady| steady.temperature())
        } else {
            state.channels.temperatures()
        };
        state.heat.step_item(&self.calibration, item, &temperatures, speed);
        if let Some(axis) = LinearAxis::ALL.get(item) {
            self.update_axis_thermal_error(state, *axis);
        } else if let Some(term) = item.checked_sub(thermal_state::FIRST_TERM_ITEM)
            && self.calibration.terms.get(term).is_some_and(Option::is_some)
        {
            self.update_term_errors(state);
        }
    }

    /// Heat that is not known is, once its thermometers agree, or what can be left of it is small.
    fn update_thermal_state_validity(&self, state: &mut BridgeState) {
        if state.heat.is_unknown() {
            let connected = self.calibration.thermometers.iter().map(Option::is_some);
            let temperatures = state.channels.temperatures();
            let is_cold = thermal_state::temperatures_agree(
                connected.zip(temperatures),
                self.calibration.cold_within,
            );
            state.heat.step_unknown_state(is_cold);
        }
    }

    /// The operator says that the machine is cold.
    pub fn confirm_cold(&self, state: &mut BridgeState) {
        state.heat.step_unknown_state(true);
    }

    /// Returns the heat that outlasts a reset.
    #[must_use]
    pub fn retained_lags(&self, state: &BridgeState) -> RetainedLags {
        state.heat.retained_lags(&self.calibration)
    }

    /// Goes on with the heat from before a reset, or from this many steps of 100 ms without power ago; without
    /// one it is not known, where something has to know it.
    pub fn restore_lags(&self, state: &mut BridgeState, memory: &RetainedLags, steps: u32) {
        state.heat.restore_lags(&self.calibration, memory, steps);
        self.compute_errors(state);
    }

    /// Reads a temperature channel, if something is connected to it.
    fn read_temperature(&self, state: &mut BridgeState, number: usize) {
        if let (Some(Some(thermometer)), Some(raw)) =
            (self.calibration.thermometers.get(number), state.raw.get(number))
        {
            let fresh = !state.raw_age.is_older_than(TEMPERATURE_TIMEOUT_MS);
            let raw = if fresh { *raw } else { RawTemperatureReading::NONE };
            let reading = thermometer.convert_with_supply(raw, state.supply_scale());
            let limit = self.needs.rates.get(number).copied().unwrap_or_default();
            let believed = state.channels.receive_reading_with_limit(number, reading, &limit);
            if let Some(steady) = state.steady.get_mut(number) {
                steady.update(believed, thermometer.dead_band());
            }
        }
    }

    /// Returns whether a temperature that the offset rests on changed too fast, and is held.
    #[inline]
    fn is_temperature_held(&self, state: &BridgeState, chosen: SelectedSource) -> bool {
        let doubtful = state.channels.uncertain_channels();
        doubtful != IndexSet::default()
            && (doubtful.intersects(self.needs.temperatures) || self.is_source_held(state, chosen))
    }

    /// Returns whether the temperatures of the axes are there.
    fn has_temperatures(&self, state: &BridgeState) -> bool {
        state.channels.has_all_temperatures(self.needs.temperatures)
            && state.heat.is_initialised(self.needs.laws)
            && state.heat.terms().is_initialised(self.needs.heat_terms)
    }

    /// Returns whether the positions and angles are there that the CNC sends.
    fn has_cnc_inputs(&self, state: &BridgeState) -> bool {
        let mut positions = self.needs.position_ms.iter().zip(&state.position_age);
        let timeout_ms = self.calibration.limits.link_timeout_ms;
        positions.all(|(longest, age)| !age.is_older_than(*longest))
            && (!self.needs.rotary || state.tool.fresh_value(timeout_ms).is_some())
            && (!self.needs.operating_point || state.spindle.fresh_value(timeout_ms).is_some())
    }

    /// Returns whether an input of the board itself is broken for which there is no other, or what it would
    /// follow is not known. An input that has only not come yet is not broken.
    fn has_input_fault(&self, state: &BridgeState, chosen: SelectedSource) -> bool {
        let lacks_heat = || {
            state.heat.is_unknown()
                && (chosen == SelectedSource::Missing || !self.has_temperatures(state))
        };
        self.have_all_sources_failed(state)
            || state.channels.has_faulty_channel(self.needs.temperatures)
            || lacks_heat()
    }

    /// Returns the offset that undoes the error since the reference; and whether the elongation along an
    /// axis was held at its limit.
    // A part of the tick: a call costs 17 instructions.
    #[inline(always)]
    fn compute_target_offset(
        &self,
        state: &BridgeState,
        elongation: Nanometres,
        axes: &ErrorSums,
    ) -> ([Nanometres; 3], bool) {
        let since = i64::from(elongation.0).wrapping_sub(i64::from(state.reference.elongation.0));
        let since = Nanometres::saturating_from(since);
        let direction = self.tool_direction(state);
        let ([x, y, z], clamped) =
            tip_error::compute_tip_error(since, direction, axes.sums, self.largest);
        let [zero_x, zero_y, zero_z] = state.reference.axes;
        let target = [(x, zero_x), (y, zero_y), (z, zero_z)].map(|(error, zero)| {
            error.saturating_add(FineNanometres(zero.0.saturating_neg())).rounded().saturating_neg()
        });
        (target, clamped)
    }

    /// Returns the tool direction at the present angles.
    fn tool_direction(&self, state: &BridgeState) -> ToolDirection {
        match state.tool.latest() {
            Some((_, direction)) => direction,
            None => self.calibration.kinematics.zero,
        }
    }
}

/// Returns the age of the oldest input that the offset rests on: the newest sample, and the positions and
/// angles of axes that move. Temperatures are slow, and have a limit of their own.
#[inline]
fn oldest_input_age(state: &BridgeState, chosen: SelectedSource) -> Age {
    let sampled = match chosen {
        SelectedSource::Source(ElongationSource::Sensor) | SelectedSource::Missing => {
            state.elongation_age
        }
        SelectedSource::Source(ElongationSource::Temperature) => state.raw_age,
        SelectedSource::Source(ElongationSource::Warmup) | SelectedSource::Unneeded => Age::ZERO,
    };
    sampled.max(state.oldest_motion_age())
}

#[cfg(test)]
mod tests;
