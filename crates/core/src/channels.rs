//! The temperature channels of a board: the last good reading of each, until it is given up.

use crate::{
    dimensions::CHANNELS, set::IndexSet, stillness::Stillness, thermometer::Raw, units::Temperature,
};

/// What every channel of a board delivers at one time.
pub type RawTemperatures = [Raw; CHANNELS];

/// A channel is given up after so many bad readings in a row, 100 ms apart.
pub const FAULT_AFTER_READINGS: u8 = 4;

/// From one reading to the next no thermometer moves by more: its element follows what it touches with a
/// time constant of a second or more (a sheathed PT100 in flowing water; on a machine's part it is slower), and what
/// it touches does not jump by more than from ice to boiling coolant: 100 K·(1 − e^(−0.1 s/1 s)) = 9.5 K.
pub const MOST_PER_READING: Temperature = Temperature(10 * Temperature::PER_KELVIN);

/// A temperature channel: its last good reading, until it is given up.
#[derive(Clone, Copy, Debug, Default)]
pub struct Channel {
    temperature: Option<Temperature>,
    /// The last reading, good or not.
    before: Option<Temperature>,
    bad: u8,
    /// How many have agreed with the one before since the start, up to [`FAULT_AFTER_READINGS`]; a channel that was
    /// given up counts as one of which all have.
    agreed: u8,
}

impl Channel {
    /// Takes what the channel's thermometer reads. None is bad, and so is a jump by more than
    /// [`MOST_PER_READING`].
    ///
    /// A single bad reading changes nothing, because a spark from the drives can cause one. After
    /// [`FAULT_AFTER_READINGS`] in a row the channel is given up, until as many agree among themselves. After a start
    /// any is taken until so many have agreed: a converter's first results are none, or not yet settled.
    pub fn hear(&mut self, reading: Option<Temperature>) {
        /// So many still count as bad when the last of those that have to agree is heard.
        const LAST: u8 = 2;
        let before = core::mem::replace(&mut self.before, reading);
        let is_new = self.agreed < FAULT_AFTER_READINGS;
        let near = |it: Temperature, now: Temperature| {
            it.0.abs_diff(now.0) <= MOST_PER_READING.0.unsigned_abs()
        };
        let follows = |now: &Temperature| {
            is_new || self.temperature.or(before).is_some_and(|it| near(it, *now))
        };
        match reading.filter(follows) {
            Some(_) if !is_new && self.temperature.is_none() && self.bad > LAST => {
                self.bad = self.bad.saturating_sub(1);
            }
            Some(now) => {
                if is_new {
                    let agrees = self.temperature.is_some_and(|it| near(it, now));
                    self.agreed = if agrees { self.agreed.saturating_add(1) } else { 0 };
                }
                (self.temperature, self.bad) = (reading, 0);
            }
            None => {
                self.bad = self.bad.saturating_add(1).min(FAULT_AFTER_READINGS);
                if self.bad == FAULT_AFTER_READINGS && self.temperature.take().is_some() {
                    self.agreed = FAULT_AFTER_READINGS;
                }
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

/// The temperature channels of a board.
#[derive(Clone, Copy, Debug, Default)]
pub struct Channels {
    channels: [Channel; CHANNELS],
    stillness: [Stillness; CHANNELS],
    known: IndexSet,
    faulty: IndexSet,
    going: IndexSet,
}

impl Channels {
    /// Takes what the thermometer of a channel reads, as [`Channel::hear`]. One that has stopped beside one that has not
    /// reads nothing that could be believed ([`Stillness`]).
    pub fn hear(&mut self, number: usize, reading: Option<Temperature>) {
        let Some(stillness) = self.stillness.get_mut(number) else { return };
        stillness.hear(reading);
        let is_going = stillness.is_going();
        let is_stuck = stillness.is_still() && self.going != IndexSet::default();
        let Some(channel) = self.channels.get_mut(number) else { return };
        channel.hear(reading.filter(|_| !is_stuck));
        for (set, is_in) in [
            (&mut self.known, channel.temperature().is_some()),
            (&mut self.faulty, channel.is_faulty()),
            (&mut self.going, is_going),
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

    /// Whether the last reading of a channel was a good one; of one that does not exist none is.
    #[must_use]
    pub fn is_current(&self, channel: u8) -> bool {
        self.channels
            .get(usize::from(channel))
            .is_some_and(|it| it.temperature.is_some() && it.bad == 0)
    }

    /// Whether a channel is faulty; one that does not exist is.
    #[must_use]
    pub fn is_faulty(&self, channel: u8) -> bool {
        self.channels.get(usize::from(channel)).is_none_or(Channel::is_faulty)
    }
}
