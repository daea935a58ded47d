//! The temperature channels of a board: the last good reading of each, until it is given up.

use crate::{
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    freeze_detector::FreezeDetector,
    index_set::IndexSet,
    temperature_rate::{
        MAX_TEMPERATURE_DISAGREEMENT, TemperatureRateLimit, TemperatureRateMonitor,
    },
    thermometer::{FAULT_AFTER_READINGS, RawTemperatureReading, ThermometerFault},
    units::Temperature,
};

/// The raw readings of all channels of a board at one time.
pub type RawTemperatures = [RawTemperatureReading; TEMPERATURE_CHANNEL_COUNT];

/// From one reading to the next no thermometer moves by more: its element follows what it touches with a
/// time constant of a second or more (a sheathed PT100 in flowing water; on a machine's part it is slower), and what
/// it touches does not jump by more than from ice to boiling coolant: 100 K·(1 − e^(−0.1 s/1 s)) = 9.5 K.
pub const MAX_CHANGE_PER_READING: Temperature = Temperature(10 * Temperature::PER_KELVIN);

/// A temperature channel: its last good reading, until it is given up.
#[derive(Clone, Copy, Debug, Default)]
pub struct TemperatureChannel {
    temperature: Option<Temperature>,
    /// The last reading, good or not.
    before: Option<Temperature>,
    bad: u8,
    /// How many have agreed with the one before since the start, up to [`FAULT_AFTER_READINGS`]; a channel that was
    /// given up counts as one of which all have.
    agreed: u8,
    rate: TemperatureRateMonitor,
}

impl TemperatureChannel {
    /// Takes a reading of a channel that no law uses, as [`Self::receive_reading_with_limit`].
    pub fn receive(&mut self, reading: Option<Temperature>) {
        self.receive_reading_with_limit(
            reading.ok_or(ThermometerFault::Missing),
            &TemperatureRateLimit::default(),
            false,
        );
    }

    /// Takes what the channel's thermometer reads. None is bad, and so is a change that is faster than the limit, or
    /// without one a jump by more than [`MAX_CHANGE_PER_READING`]; `agrees`: another one of the same law does.
    ///
    /// A single bad reading changes nothing, because a spark from the drives can cause one. After
    /// [`FAULT_AFTER_READINGS`] in a row the channel is given up, until as many agree among themselves. After a start
    /// any is taken until this many have agreed: a converter's first results are none, or not yet settled.
    pub fn receive_reading_with_limit(
        &mut self,
        reading: Result<Temperature, ThermometerFault>,
        limit: &TemperatureRateLimit,
        agrees: bool,
    ) {
        // The mean of 20 ms at a rail is no spark.
        let weight =
            if reading == Err(ThermometerFault::AtRail) { FAULT_AFTER_READINGS / 2 } else { 1 };
        let reading = reading.ok();
        /// This many still count as bad when the last of those that have to agree is received.
        const MAX_BAD_READINGS_TO_ACCEPT: u8 = 2;
        let before = core::mem::replace(&mut self.before, reading);
        let is_new = self.agreed < FAULT_AFTER_READINGS;
        let near = |temperature: Temperature, now: Temperature| {
            temperature.0.abs_diff(now.0) <= MAX_CHANGE_PER_READING.0.unsigned_abs()
        };
        let follows = match reading {
            None => {
                self.rate.record_missed_reading();
                false
            }
            Some(now) if is_new => {
                self.rate.restart(now);
                true
            }
            Some(now) if limit.is_enabled() => self.rate.check_reading(now, limit, agrees),
            Some(now) => {
                self.temperature.or(before).is_some_and(|temperature| near(temperature, now))
            }
        };
        // A doubt holds the last believed value, where a loss gives it up.
        let is_held = reading.is_some() && limit.is_enabled() && !self.rate.has_timed_out();
        match reading.filter(|_| follows) {
            Some(_)
                if !is_new
                    && self.temperature.is_none()
                    && self.bad > MAX_BAD_READINGS_TO_ACCEPT =>
            {
                self.bad = self.bad.saturating_sub(1);
            }
            Some(now) => {
                if is_new {
                    let agrees = self.temperature.is_some_and(|temperature| near(temperature, now));
                    self.agreed = if agrees { self.agreed.saturating_add(1) } else { 0 };
                }
                (self.temperature, self.bad) = (reading, 0);
            }
            None => {
                self.bad = self.bad.saturating_add(weight).min(FAULT_AFTER_READINGS);
                if self.bad == FAULT_AFTER_READINGS && !is_held && self.temperature.take().is_some()
                {
                    self.agreed = FAULT_AFTER_READINGS;
                }
            }
        }
    }

    /// Returns whether it has been read and has nothing believable: other than before the first reading.
    #[must_use]
    pub fn is_faulty(&self) -> bool {
        self.temperature.is_none() && self.bad > 0
    }

    /// Returns whether its last readings came too fast and are not believed.
    #[must_use]
    pub const fn is_uncertain(&self) -> bool {
        self.rate.is_uncertain()
    }

    /// Returns the temperature: the last one that was believed. `None` before the first reading and after a fault.
    #[must_use]
    pub fn temperature(&self) -> Option<Temperature> {
        self.temperature
    }
}

/// The temperature channels of a board.
#[derive(Clone, Copy, Debug, Default)]
pub struct TemperatureChannels {
    channels: [TemperatureChannel; TEMPERATURE_CHANNEL_COUNT],
    stillness: [FreezeDetector; TEMPERATURE_CHANNEL_COUNT],
    known: IndexSet,
    faulty: IndexSet,
    doubtful: IndexSet,
    going: IndexSet,
}

impl TemperatureChannels {
    /// Takes a reading of a channel that no law uses, as [`Self::receive_reading_with_limit`].
    pub fn receive(&mut self, number: usize, reading: Option<Temperature>) {
        self.receive_reading_with_limit(
            number,
            reading.ok_or(ThermometerFault::Missing),
            &TemperatureRateLimit::default(),
        );
    }

    /// Takes what the thermometer of a channel reads, as [`TemperatureChannel::receive_reading_with_limit`]. One that has stopped while another has not
    /// reads nothing that could be believed ([`FreezeDetector`]). Returns the temperature that is believed now.
    pub fn receive_reading_with_limit(
        &mut self,
        number: usize,
        reading: Result<Temperature, ThermometerFault>,
        limit: &TemperatureRateLimit,
    ) -> Option<Temperature> {
        let stillness = self.stillness.get_mut(number)?;
        stillness.receive(reading.ok());
        let is_active = stillness.is_active();
        let is_stuck = stillness.is_frozen() && self.going != IndexSet::default();
        let agrees = reading.is_ok_and(|now| self.has_agreeing_partner(limit.partners, now));
        let reading = if is_stuck { Err(ThermometerFault::Missing) } else { reading };
        let channel = self.channels.get_mut(number)?;
        channel.receive_reading_with_limit(reading, limit, agrees);
        for (set, is_in) in [
            (&mut self.known, channel.temperature().is_some()),
            (&mut self.faulty, channel.is_faulty()),
            (&mut self.doubtful, channel.is_uncertain()),
            (&mut self.going, is_active),
        ] {
            if is_in { set.insert(number) } else { set.remove(number) }
        }
        channel.temperature()
    }

    /// Returns whether the last reading of one of these agrees with a reading.
    fn has_agreeing_partner(&self, partners: IndexSet, now: Temperature) -> bool {
        partners != IndexSet::default()
            && self.channels.iter().enumerate().any(|(number, partner)| {
                let near = |temperature: Temperature| {
                    temperature.0.abs_diff(now.0) <= MAX_TEMPERATURE_DISAGREEMENT.0.unsigned_abs()
                };
                partners.contains(number) && partner.before.is_some_and(near)
            })
    }

    /// Returns the temperature of a channel, where there is one.
    #[must_use]
    pub fn temperature(&self, channel: u8) -> Option<Temperature> {
        self.channels.get(usize::from(channel)).and_then(TemperatureChannel::temperature)
    }

    /// Returns all of them.
    #[must_use]
    pub fn temperatures(&self) -> [Option<Temperature>; TEMPERATURE_CHANNEL_COUNT] {
        self.channels.map(|channel| channel.temperature())
    }

    /// Returns whether all of these have a temperature.
    #[must_use]
    pub fn has_all_temperatures(&self, channels: IndexSet) -> bool {
        self.known.is_superset(channels)
    }

    /// Returns whether one of these is faulty.
    #[must_use]
    pub fn has_faulty_channel(&self, channels: IndexSet) -> bool {
        self.faulty.intersects(channels)
    }

    /// Returns the channels that are lost.
    #[must_use]
    pub const fn faulty_channels(&self) -> IndexSet {
        self.faulty
    }

    /// Returns the channels whose last readings came too fast and are not believed.
    #[must_use]
    pub const fn uncertain_channels(&self) -> IndexSet {
        self.doubtful
    }

    /// Returns whether the last reading of a channel was a good one; of one that does not exist none is.
    #[must_use]
    pub fn has_valid_last_reading(&self, channel: u8) -> bool {
        self.channels
            .get(usize::from(channel))
            .is_some_and(|channel| channel.temperature.is_some() && channel.bad == 0)
    }

    /// Returns whether a channel is faulty; one that does not exist is.
    #[must_use]
    pub fn is_faulty(&self, channel: u8) -> bool {
        self.channels.get(usize::from(channel)).is_none_or(TemperatureChannel::is_faulty)
    }
}
