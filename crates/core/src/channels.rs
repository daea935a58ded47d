//! The temperature channels of a board: the last good reading of each, until it is given up.

use crate::{dimensions::CHANNELS, set::IndexSet, thermometer::Raw, units::Temperature};

/// What every channel of a board delivers at one time.
pub type RawTemperatures = [Raw; CHANNELS];

/// A channel is given up after so many bad readings in a row, 100 ms apart.
pub const FAULT_AFTER_READINGS: u8 = 4;

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
