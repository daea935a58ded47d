//! The state that the bridge keeps from tick to tick.

use super::bumpless_transfer::BumplessTransfer;
use crate::{
    axis_errors::{CachedErrors, ErrorSums},
    calibration::AxisModel,
    cnc::{AxisPosition, Control, MachineConditions, SpindleState},
    dead_band_filter::DeadBandFilter,
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    index_set::IndexSet,
    learned_changes::LearnedChanges,
    limits::AppliedOffset,
    machine_position::MachinePosition,
    run_out_filter::RunOutFilter,
    run_out_monitor::RunOutMonitor,
    sensor_health::{NoiseStatistics, SensorHealthMonitor},
    supply_monitor::SupplyScale,
    temperature_channels::{RawTemperatures, TemperatureChannels},
    thermal_state::MachineThermalState,
    tool_direction::ToolDirection,
    units::{FineNanometres, MicroDegrees, Nanometres, Position, Temperature, TimestampMs},
};

/// After this time without samples the converter counts as stopped, and a reading as stale.
pub const SAMPLES_TIMEOUT_MS: u32 = 20;
/// After blocks were missing the reading counts as stale for this time: many turns of the supervisor that
/// looks for them, so that it does not flicker.
pub const STALE_DURATION_AFTER_LOSS_MS: u32 = 100;
/// After this time without a temperature its channel counts as bad.
pub const TEMPERATURE_TIMEOUT_MS: u32 = 1_000;

/// By this much may two positions lie nearer together in time than they were sent: a serial adapter hands on what
/// it has every 16 ms.
pub const MAX_POSITION_JITTER_MS: u32 = 20;
/// After a jump this many more have to follow from it before they are believed.
const MIN_CONFIRMING_POSITIONS: u8 = 3;
/// A jump is reported for this time: many turns of what looks for it, so that it does not flicker.
pub const JUMP_REPORT_DURATION_MS: u32 = 100;

/// Where the offset is to go.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum OffsetMode {
    Follow,
    Hold,
    RampOut,
}

/// The state of the bridge from tick to tick. [`Bridge::initial_state`](super::Bridge::initial_state) makes it, with the errors where
/// the machine stands; so it has no default.
#[derive(Clone, Debug)]
pub struct BridgeState {
    pub(super) now: TimestampMs,
    pub(super) health: SensorHealthMonitor,
    pub(super) filter: RunOutFilter,
    pub(super) run_out: RunOutMonitor,
    pub(super) control: ReceivedMessage<Control>,
    pub(super) spindle: ReceivedMessage<SpindleState>,
    pub(super) conditions: ReceivedConditions,
    /// The angles of the head, and where they point the tool.
    pub(super) tool: ReceivedMessage<([MicroDegrees; 2], ToolDirection)>,
    pub(super) place: MachinePosition,
    pub(super) position_age: [Age; 3],
    /// Axes, and as the fourth the angles, that were somewhere else in the frame before.
    moving: [bool; 4],
    reported: [ReportedPosition; 3],
    /// Since a position came that was not believed.
    jump_age: Age,
    pub(super) joint: BumplessTransfer,
    /// Whether the CNC was ever received: silence is a loss only after that.
    pub(super) cnc_known: bool,
    pub(super) codes_age: Age,
    /// Since blocks were missing.
    pub(super) starved_age: Age,
    /// By the sensor.
    pub(super) elongation: Option<Nanometres>,
    pub(super) elongation_age: Age,
    pub(super) believable: bool,
    pub(super) raw: RawTemperatures,
    pub(super) raw_age: Age,
    pub(super) channels: TemperatureChannels,
    /// Their temperatures without jitter.
    pub(super) steady: [DeadBandFilter; TEMPERATURE_CHANNEL_COUNT],
    pub(super) heat: MachineThermalState,
    /// Milliseconds of the present step of the heat.
    pub(super) phase_ms: u32,
    /// The errors of the axes as they are now, without what is in [`Self::deferred`].
    pub(super) errors: CachedErrors,
    /// When what depends on each axis, and on the angles, was last computed on a message.
    pub(super) errors_updated_at: [TimestampMs; 4],
    /// The inputs that have changed since: what depends on them is computed when the errors are requested.
    pub(super) deferred: IndexSet,
    /// Their sums; `None`: a part has changed since.
    pub(super) error_sums: Option<ErrorSums>,
    pub(super) reference: ReferenceErrors,
    /// A `Zero` has taken it, and [`Self::take_zero_event`] has not reported it.
    pub(super) zeroed: bool,
    /// How long ago the offset was last live; `None` if it is not to be held.
    live_age: Option<Age>,
    pub(super) applied: AppliedOffset,
    /// Nothing is followed, and nothing is available.
    pub(super) inhibited: bool,
    /// By what readings of the converter are multiplied.
    scale: SupplyScale,
    /// The converter's supply is not believed, and nothing that is measured by it.
    supply_is_off: bool,
}

/// The error that counts as none: what `Zero` has taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReferenceErrors {
    /// The elongation in nm, along the tool: it turns with it.
    pub elongation: Nanometres,
    /// The sums of the errors of X, Y and Z in 1/256 nm.
    pub axes: [FineNanometres; 3],
}

/// Milliseconds since something happened; stays at its largest value, where it also begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Age(u32);

impl Default for Age {
    fn default() -> Self {
        Self(u32::MAX)
    }
}

impl Age {
    pub const ZERO: Self = Self(0);

    fn advance(&mut self, elapsed_ms: u32) {
        self.0 = self.0.saturating_add(elapsed_ms);
    }

    pub fn is_older_than(self, ms: u32) -> bool {
        self.0 > ms
    }

    /// The byte that is sent: 255 stands for all beyond.
    pub fn to_wire_byte(self) -> u8 {
        u8::try_from(self.0).unwrap_or(u8::MAX)
    }
}

/// The last message of a kind, with its age.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReceivedMessage<T> {
    value: Option<T>,
    age: Age,
}

impl<T> Default for ReceivedMessage<T> {
    fn default() -> Self {
        Self { value: None, age: Age::default() }
    }
}

impl<T: Copy> ReceivedMessage<T> {
    /// Returns what it says, until it is too old.
    pub fn fresh_value(&self, timeout_ms: u32) -> Option<T> {
        if self.age.is_older_than(timeout_ms) { None } else { self.value }
    }

    /// Returns what it says, however old.
    pub fn latest(&self) -> Option<T> {
        self.value
    }

    pub fn receive(&mut self, value: T) {
        *self = Self { value: Some(value), age: Age::ZERO };
    }
}

/// The tool and conditions last received, and their age.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ReceivedConditions {
    pub last: Option<MachineConditions>,
    /// Milliseconds since the last message, at first since the start; stays at its largest value.
    pub age_ms: u32,
    /// The offset goes by the defaults.
    pub by_default: bool,
    /// They differ from the conditions that the terms use, which they reach in the next tick.
    pub is_changed: bool,
}

impl ReceivedConditions {
    pub fn advance_ages(&mut self, elapsed_ms: u32) {
        self.age_ms = self.age_ms.saturating_add(elapsed_ms);
    }
}

/// Where and when an axis was last reported, believed or not.
#[derive(Clone, Copy, Debug, Default)]
struct ReportedPosition {
    position: Position,
    at: TimestampMs,
    /// This many more have to follow.
    uncertainty_ticks: u8,
}

impl ReportedPosition {
    /// Takes the next position; whether it is believed. A jump is one that the axis cannot have reached since the
    /// last, by its rapid traverse (10 nm a millisecond); the first is none. After one the next few have to follow
    /// from each other: then the CNC means it.
    fn accept_position(
        &mut self,
        position: Position,
        now: TimestampMs,
        is_first: bool,
        rapid: u32,
    ) -> bool {
        let reach = rapid
            .saturating_mul(now.duration_ms_since(self.at).saturating_add(MAX_POSITION_JITTER_MS));
        let jumps = !is_first && self.position.0.abs_diff(position.0) > reach;
        let caveat =
            if jumps { MIN_CONFIRMING_POSITIONS } else { self.uncertainty_ticks.saturating_sub(1) };
        *self = Self { position, at: now, uncertainty_ticks: caveat };
        caveat == 0
    }
}

impl BridgeState {
    /// Returns that of a bridge that has just been switched on, with the errors where it stands.
    pub(super) fn with_errors(errors: CachedErrors) -> Self {
        Self {
            now: Default::default(),
            health: Default::default(),
            filter: Default::default(),
            run_out: Default::default(),
            control: Default::default(),
            spindle: Default::default(),
            conditions: Default::default(),
            tool: Default::default(),
            place: Default::default(),
            position_age: Default::default(),
            moving: [false; 4],
            reported: Default::default(),
            jump_age: Default::default(),
            joint: Default::default(),
            cnc_known: false,
            codes_age: Default::default(),
            starved_age: Default::default(),
            elongation: None,
            elongation_age: Default::default(),
            believable: false,
            raw: Default::default(),
            raw_age: Default::default(),
            channels: Default::default(),
            steady: Default::default(),
            heat: Default::default(),
            phase_ms: 0,
            errors,
            errors_updated_at: Default::default(),
            deferred: IndexSet::default(),
            error_sums: None,
            reference: Default::default(),
            zeroed: false,
            live_age: None,
            applied: Default::default(),
            inhibited: false,
            scale: Default::default(),
            supply_is_off: false,
        }
    }

    /// Returns that of a board without a calibration, which has no bridge.
    #[must_use]
    pub fn without_calibration() -> Self {
        Self::with_errors(CachedErrors::default())
    }

    /// Returns the time of the last tick.
    #[must_use]
    pub fn now(&self) -> TimestampMs {
        self.now
    }

    /// Returns the elongation by the sensor, before reference and limits; `None` where it is not fresh.
    #[must_use]
    pub fn elongation(&self) -> Option<Nanometres> {
        self.elongation.filter(|_| self.is_sensor_fresh())
    }

    /// Returns the tool and the conditions that were last received, where a term needs them; and whether they are lost and
    /// the defaults stand in.
    #[must_use]
    pub fn conditions(&self) -> (Option<MachineConditions>, bool) {
        (self.conditions.last, self.conditions.by_default)
    }

    /// Takes by what readings of the converter are to be multiplied; `None`: its supply is not believed.
    pub fn set_supply_scale(&mut self, scale: Option<SupplyScale>) {
        self.supply_is_off = scale.is_none();
        self.scale = scale.unwrap_or_default();
    }

    pub(super) fn supply_scale(&self) -> Option<SupplyScale> {
        (!self.supply_is_off).then_some(self.scale)
    }

    /// Returns the temperature of a channel, where one is connected and believable: not what is held of one that changed
    /// too fast.
    #[must_use]
    pub fn temperature(&self, channel: u8) -> Option<Temperature> {
        let is_held = self.channels.uncertain_channels().contains(channel.into());
        self.channels.temperature(channel).filter(|_| !is_held)
    }

    /// Returns how the parts differ from what the calibration says.
    #[must_use]
    pub const fn learned_changes(&self) -> &LearnedChanges {
        &self.heat.learned
    }

    /// They no longer do, from one tick to the next: for a bridge at rest.
    pub fn clear_learned_changes(&mut self) {
        self.heat.learned = LearnedChanges::default();
    }

    /// Returns whether it is not known how warm the machine was before the start.
    #[must_use]
    pub fn is_thermal_state_unknown(&self) -> bool {
        self.heat.is_unknown()
    }

    /// Returns the error that counts as none.
    #[must_use]
    pub fn reference(&self) -> ReferenceErrors {
        self.reference
    }

    /// Returns whether a `Zero` has taken a reference since the last call, be it the same as before.
    pub fn take_zero_event(&mut self) -> bool {
        core::mem::take(&mut self.zeroed)
    }

    /// Takes up a reference that was stored.
    pub fn set_reference(&mut self, reference: ReferenceErrors) {
        self.reference = reference;
    }

    /// Inhibits the offset, or releases it: while it is inhibited it goes to 0, and is not available
    /// from then on.
    pub fn set_inhibited(&mut self, inhibited: bool) {
        self.inhibited = inhibited;
    }

    /// Returns the noise of the raw codes since the last call.
    pub fn take_noise_statistics(&mut self) -> NoiseStatistics {
        self.health.take_noise_statistics()
    }

    /// Returns whether the sensor shows something that no spindle does: a jump, or another run-out at the same
    /// speed.
    #[must_use]
    pub fn is_sensor_anomalous(&self) -> bool {
        self.health.has_jumped() || self.run_out.is_anomalous()
    }

    /// Takes a position; whether the axis has moved or turned round. One that is not believed moves nothing, and the
    /// last that was grows old.
    pub(super) fn receive_position(
        &mut self,
        received: AxisPosition,
        axis: &AxisModel<'_>,
    ) -> bool {
        let number = received.axis as usize;
        let (Some(position), Some(travel), Some(age), Some(moving), Some(reported)) = (
            self.place.position.get_mut(number),
            self.place.travel.get_mut(number),
            self.position_age.get_mut(number),
            self.moving.get_mut(number),
            self.reported.get_mut(number),
        ) else {
            return false;
        };
        let before = (*position, travel.reversal());
        *moving = before.0 != received.position;
        let is_first = *age == Age::default();
        if axis.rapid != 0
            && !reported.accept_position(received.position, self.now, is_first, axis.rapid)
        {
            self.jump_age = Age::ZERO;
            return false;
        }
        *age = Age::ZERO;
        *position = received.position;
        travel.update(&axis.travel, received.position, received.direction as i8);
        before != (*position, travel.reversal())
    }

    /// Returns whether a position has come of late that is not believed: its axis could not have reached it.
    #[must_use]
    pub fn has_position_jumped(&self) -> bool {
        !self.jump_age.is_older_than(JUMP_REPORT_DURATION_MS)
    }

    /// Receives the angles of the head. Returns whether they have changed. The first angles get the tool direction `first`, all
    /// others keep the direction before, until it is set ([`Self::tool_orientation_mut`]).
    pub(super) fn receive_angles(
        &mut self,
        angles: [MicroDegrees; 2],
        first: ToolDirection,
    ) -> bool {
        let [.., moving] = &mut self.moving;
        if let Some((known, _)) = &mut self.tool.value {
            *moving = *known != angles;
            (*known, self.tool.age) = (angles, Age::ZERO);
            *moving
        } else {
            *moving = false;
            self.tool.receive((angles, first));
            true
        }
    }

    /// Returns the angles of the head that were last received, and where they point the tool.
    #[inline]
    pub(super) fn tool_orientation_mut(
        &mut self,
    ) -> Option<&mut ([MicroDegrees; 2], ToolDirection)> {
        self.tool.value.as_mut()
    }

    /// Returns the age of the oldest position or angle of what moves.
    #[inline]
    pub(super) fn oldest_motion_age(&self) -> Age {
        let [x, y, z] = self.position_age;
        let ages = [x, y, z, self.tool.age];
        let of_moving = |(is_moving, age): (bool, Age)| if is_moving { age } else { Age::ZERO };
        self.moving.into_iter().zip(ages).map(of_moving).fold(Age::ZERO, Age::max)
    }

    pub(super) fn advance_ages(&mut self, elapsed_ms: u32) {
        self.control.age.advance(elapsed_ms);
        self.spindle.age.advance(elapsed_ms);
        self.tool.age.advance(elapsed_ms);
        for age in &mut self.position_age {
            age.advance(elapsed_ms);
        }
        self.jump_age.advance(elapsed_ms);
        self.codes_age.advance(elapsed_ms);
        self.starved_age.advance(elapsed_ms);
        self.elongation_age.advance(elapsed_ms);
        self.raw_age.advance(elapsed_ms);
        if let Some(age) = &mut self.live_age {
            age.advance(elapsed_ms);
        }
    }

    pub(super) fn is_sensor_fresh(&self) -> bool {
        self.elongation.is_some()
            && self.believable
            && !self.elongation_age.is_older_than(SAMPLES_TIMEOUT_MS)
            && self.starved_age.is_older_than(STALE_DURATION_AFTER_LOSS_MS)
    }

    /// Blocks of samples are missing, by a clock that does not count them: what the filter has is
    /// not what it takes it for.
    pub fn mark_samples_lost(&mut self) {
        self.filter.clear();
        self.health.record_gap();
        self.starved_age = Age::ZERO;
    }

    /// Returns whether the offset was live so lately that it is held where an input is lost.
    pub(super) fn is_held(&self, hold_ms: u32) -> bool {
        self.live_age.is_some_and(|age| !age.is_older_than(hold_ms))
    }

    /// Decides where the offset goes, and remembers when it was last live.
    pub(super) fn update_mode(
        &mut self,
        control: Option<Control>,
        fresh: bool,
        hold_ms: u32,
    ) -> OffsetMode {
        let is_free = |control: Control| control.engage && control.referenced && !self.inhibited;
        if self.inhibited || control.is_some_and(|control| !is_free(control)) {
            self.live_age = None;
        } else if control.is_some() && fresh {
            self.live_age = Some(Age::ZERO);
            return OffsetMode::Follow;
        } else if self.is_held(hold_ms) {
            return OffsetMode::Hold;
        }
        OffsetMode::RampOut
    }
}
