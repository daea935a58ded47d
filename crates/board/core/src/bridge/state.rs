//! The state that the bridge keeps from tick to tick.

use super::joint::Joint;
use crate::{
    calibration::AxisModel,
    channels::{Channels, RawTemperatures},
    cnc::{AxisPosition, Conditions, Control, Spindle},
    dimensions::CHANNELS,
    filter::Filter,
    geometry::{CachedErrors, ErrorSums},
    health::{Health, Noise},
    heat::Heat,
    learned::Learned,
    limits::Applied,
    place::Place,
    run_out::RunOut,
    steady::SteadyTemperature,
    supply::Scale,
    tool::Direction,
    units::{Fine, MicroDegrees, Millis, Nanometres, Position, Temperature},
};

/// Without samples for so long the converter counts as stopped, and a reading as stale.
pub const SAMPLES_TIMEOUT_MS: u32 = 20;
/// After blocks were missing the reading counts as stale for so long: many turns of the supervisor that
/// looks for them, so that it does not flicker.
pub const STARVED_MS: u32 = 100;
/// Without a temperature for so long its channel counts as bad.
pub const TEMPERATURE_TIMEOUT_MS: u32 = 1_000;

/// By this much may two positions lie nearer together in time than they were sent: a serial adapter hands on what
/// it has every 16 ms.
pub const POSITION_JITTER_MS: u32 = 20;
/// After a jump this many more have to follow from it before they are believed.
const FOLLOWING: u8 = 3;
/// A jump is reported for so long: many turns of what looks for it, so that it does not flicker.
pub const JUMP_TOLD_MS: u32 = 100;

/// Where the offset is to go.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    Follow,
    Hold,
    RampOut,
}

/// The state of the bridge from tick to tick.
#[derive(Clone, Debug, Default)]
pub struct State {
    pub(super) now: Millis,
    pub(super) health: Health,
    pub(super) filter: Filter,
    pub(super) run_out: RunOut,
    pub(super) control: Received<Control>,
    pub(super) spindle: Received<Spindle>,
    pub(super) conditions: ReceivedConditions,
    /// The angles of the head, and where they point the tool.
    pub(super) tool: Received<([MicroDegrees; 2], Direction)>,
    pub(super) place: Place,
    pub(super) position_age: [Age; 3],
    /// Axes, and as the fourth the angles, that were somewhere else in the frame before.
    moving: [bool; 4],
    said: [Said; 3],
    /// Since a position came that was not believed.
    jump_age: Age,
    pub(super) joint: Joint,
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
    pub(super) channels: Channels,
    /// Their temperatures without jitter.
    pub(super) steady: [SteadyTemperature; CHANNELS],
    pub(super) heat: Heat,
    /// Milliseconds of the present step of the heat.
    pub(super) phase_ms: u32,
    /// The errors of the axes as they are now, and their sums unless a part has changed since; `None` until they are
    /// first asked for.
    pub(super) axes: Option<(CachedErrors, Option<ErrorSums>)>,
    pub(super) reference: Reference,
    /// A `Zero` has taken it, and [`Self::take_zeroed`] has not said so.
    pub(super) zeroed: bool,
    /// How long ago the offset was last live; `None` if it is not to be held.
    live_age: Option<Age>,
    pub(super) applied: Applied,
    /// Nothing is followed, and nothing is available.
    pub(super) inhibited: bool,
    /// By what readings of the converter are multiplied.
    scale: Scale,
    /// The converter's supply is not believed, and nothing that is measured by it.
    supply_is_off: bool,
}

/// The error that counts as none: what `Zero` has taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reference {
    /// The elongation in nm, along the tool: it turns with it.
    pub elongation: Nanometres,
    /// The sums of the errors of X, Y and Z in 1/256 nm.
    pub axes: [Fine; 3],
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
    pub const NEW: Self = Self(0);

    fn grow(&mut self, elapsed_ms: u32) {
        self.0 = self.0.saturating_add(elapsed_ms);
    }

    pub fn is_above(self, ms: u32) -> bool {
        self.0 > ms
    }

    /// As it is sent: 255 stands for all beyond.
    pub fn byte(self) -> u8 {
        u8::try_from(self.0).unwrap_or(u8::MAX)
    }
}

/// The last message of a kind, with its age.
#[derive(Clone, Copy, Debug)]
pub(super) struct Received<T> {
    value: Option<T>,
    age: Age,
}

impl<T> Default for Received<T> {
    fn default() -> Self {
        Self { value: None, age: Age::default() }
    }
}

impl<T: Copy> Received<T> {
    /// Returns what it says, until it is too old.
    pub fn value(&self, timeout_ms: u32) -> Option<T> {
        if self.age.is_above(timeout_ms) { None } else { self.value }
    }

    /// Returns what it says, however old.
    pub fn latest(&self) -> Option<T> {
        self.value
    }

    pub fn receive(&mut self, value: T) {
        *self = Self { value: Some(value), age: Age::NEW };
    }
}

/// The tool and conditions last received, and their age.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ReceivedConditions {
    pub last: Option<Conditions>,
    /// Milliseconds since the last message, at first since the start; stays at its largest value.
    pub age_ms: u32,
    /// The offset goes by the defaults.
    pub by_default: bool,
}

impl ReceivedConditions {
    pub fn advance_ages(&mut self, elapsed_ms: u32) {
        self.age_ms = self.age_ms.saturating_add(elapsed_ms);
    }
}

/// Where and when an axis was last said to be, believed or not.
#[derive(Clone, Copy, Debug, Default)]
struct Said {
    position: Position,
    at: Millis,
    /// This many more have to follow.
    doubt: u8,
}

impl Said {
    /// Takes the next position; whether it is believed. A jump is one that the axis cannot have reached since the
    /// last, by its rapid traverse (10 nm a millisecond); the first is none. After one the next few have to follow
    /// from each other: then the CNC means it.
    fn follows(&mut self, position: Position, now: Millis, is_first: bool, rapid: u32) -> bool {
        let reach = rapid.saturating_mul(now.since(self.at).saturating_add(POSITION_JITTER_MS));
        let jumps = !is_first && self.position.0.abs_diff(position.0) > reach;
        let doubt = if jumps { FOLLOWING } else { self.doubt.saturating_sub(1) };
        *self = Self { position, at: now, doubt };
        doubt == 0
    }
}

impl State {
    /// Returns the time of the last tick.
    #[must_use]
    pub fn now(&self) -> Millis {
        self.now
    }

    /// Returns the elongation by the sensor, before reference and limits; `None` where it is not fresh.
    #[must_use]
    pub fn elongation(&self) -> Option<Nanometres> {
        self.elongation.filter(|_| self.sensor_is_fresh())
    }

    /// Returns the tool and the conditions that were last received, where a term needs them; and whether they are lost and
    /// the defaults stand in.
    #[must_use]
    pub fn conditions(&self) -> (Option<Conditions>, bool) {
        (self.conditions.last, self.conditions.by_default)
    }

    /// Takes by what readings of the converter are to be multiplied; `None`: its supply is not believed.
    pub fn set_supply(&mut self, scale: Option<Scale>) {
        self.supply_is_off = scale.is_none();
        self.scale = scale.unwrap_or_default();
    }

    pub(super) fn supply(&self) -> Option<Scale> {
        (!self.supply_is_off).then_some(self.scale)
    }

    /// Returns the temperature of a channel, where one is connected and believable: not what is held of one that changed
    /// too fast.
    #[must_use]
    pub fn temperature(&self, channel: u8) -> Option<Temperature> {
        let is_held = self.channels.doubtful().has(channel.into());
        self.channels.temperature(channel).filter(|_| !is_held)
    }

    /// Returns how the parts differ from what the calibration says.
    #[must_use]
    pub const fn learned(&self) -> &Learned {
        &self.heat.learned
    }

    /// They no longer do, from one tick to the next: for a bridge at rest.
    pub fn forget_learned(&mut self) {
        self.heat.learned = Learned::default();
    }

    /// Returns whether it is not known how warm the machine was before the start.
    #[must_use]
    pub fn heat_is_unknown(&self) -> bool {
        self.heat.is_unknown()
    }

    /// Returns the error that counts as none.
    #[must_use]
    pub fn reference(&self) -> Reference {
        self.reference
    }

    /// Returns whether a `Zero` has taken a reference since the last call, be it the same as before.
    pub fn take_zeroed(&mut self) -> bool {
        core::mem::take(&mut self.zeroed)
    }

    /// Takes up a reference that was stored.
    pub fn set_reference(&mut self, reference: Reference) {
        self.reference = reference;
    }

    /// Bars the offset, or gives it free: while it is barred it goes to 0, and is not available
    /// from then on.
    pub fn inhibit(&mut self, inhibited: bool) {
        self.inhibited = inhibited;
    }

    /// Returns the noise of the raw codes since the last call.
    pub fn take_noise(&mut self) -> Noise {
        self.health.take_noise()
    }

    /// Returns whether the sensor shows something that no spindle does: a jump, or another run-out at the same
    /// speed.
    #[must_use]
    pub fn sensor_is_anomalous(&self) -> bool {
        self.health.has_jumped() || self.run_out.is_anomalous()
    }

    /// Takes a position; whether the axis has moved or turned round. One that is not believed moves nothing, and the
    /// last that was grows old.
    pub(super) fn receive_position(&mut self, heard: AxisPosition, axis: &AxisModel<'_>) -> bool {
        let number = heard.axis as usize;
        let (Some(position), Some(travel), Some(age), Some(moving), Some(said)) = (
            self.place.position.get_mut(number),
            self.place.travel.get_mut(number),
            self.position_age.get_mut(number),
            self.moving.get_mut(number),
            self.said.get_mut(number),
        ) else {
            return false;
        };
        let before = (*position, travel.reversal());
        *moving = before.0 != heard.position;
        let is_first = *age == Age::default();
        if axis.rapid != 0 && !said.follows(heard.position, self.now, is_first, axis.rapid) {
            self.jump_age = Age::NEW;
            return false;
        }
        *age = Age::NEW;
        *position = heard.position;
        travel.update(&axis.travel, heard.position, heard.direction as i8);
        before != (*position, travel.reversal())
    }

    /// Returns whether a position has come of late that is not believed: its axis could not have reached it.
    #[must_use]
    pub fn position_has_jumped(&self) -> bool {
        !self.jump_age.is_above(JUMP_TOLD_MS)
    }

    /// Takes the angles of the head, and where they point the tool.
    pub(super) fn receive_angles(&mut self, angles: [MicroDegrees; 2], direction: Direction) {
        let [.., moving] = &mut self.moving;
        *moving = self.tool.latest().is_some_and(|(before, _)| before != angles);
        self.tool.receive((angles, direction));
    }

    /// Returns the age of the oldest position or angle of what moves.
    #[inline]
    pub(super) fn oldest_motion(&self) -> Age {
        let [x, y, z] = self.position_age;
        let ages = [x, y, z, self.tool.age];
        let of_moving = |(is_moving, age): (bool, Age)| if is_moving { age } else { Age::NEW };
        self.moving.into_iter().zip(ages).map(of_moving).fold(Age::NEW, Age::max)
    }

    pub(super) fn advance_ages(&mut self, elapsed_ms: u32) {
        self.control.age.grow(elapsed_ms);
        self.spindle.age.grow(elapsed_ms);
        self.tool.age.grow(elapsed_ms);
        for age in &mut self.position_age {
            age.grow(elapsed_ms);
        }
        self.jump_age.grow(elapsed_ms);
        self.codes_age.grow(elapsed_ms);
        self.starved_age.grow(elapsed_ms);
        self.elongation_age.grow(elapsed_ms);
        self.raw_age.grow(elapsed_ms);
        if let Some(age) = &mut self.live_age {
            age.grow(elapsed_ms);
        }
    }

    pub(super) fn sensor_is_fresh(&self) -> bool {
        self.elongation.is_some()
            && self.believable
            && !self.elongation_age.is_above(SAMPLES_TIMEOUT_MS)
            && self.starved_age.is_above(STARVED_MS)
    }

    /// Blocks of samples are missing, by a clock that does not count them: what the filter has is
    /// not what it takes it for.
    pub fn starve(&mut self) {
        self.filter.clear();
        self.health.interrupt();
        self.starved_age = Age::NEW;
    }

    /// Returns whether the offset was live so lately that it is held where an input is lost.
    pub(super) fn is_held(&self, hold_ms: u32) -> bool {
        self.live_age.is_some_and(|age| !age.is_above(hold_ms))
    }

    /// Decides where the offset goes, and remembers when it was last live.
    pub(super) fn mode(&mut self, control: Option<Control>, fresh: bool, hold_ms: u32) -> Mode {
        let is_free = |control: Control| control.engage && control.referenced && !self.inhibited;
        if self.inhibited || control.is_some_and(|control| !is_free(control)) {
            self.live_age = None;
        } else if control.is_some() && fresh {
            self.live_age = Some(Age::NEW);
            return Mode::Follow;
        } else if self.is_held(hold_ms) {
            return Mode::Hold;
        }
        Mode::RampOut
    }
}
