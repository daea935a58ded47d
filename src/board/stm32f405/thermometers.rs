//! The thermometers: up to eight PT100s, each behind a MAX31865 on SPI2 (section 28).
//!
//! SCK, MISO and MOSI are shared, and each converter is selected by a pin of its own. The bus runs
//! at 1.3 MHz, a quarter of what they can do, in mode 1. One converter has its turn every 10 ms, so
//! each has one every 100 ms, of at most two selections and 0.1 ms. It is polled, by a task that
//! no other one waits for.
//!
//! The protocol is in [`trueup_max31865`], which the host tests. Here it is only carried: every wait
//! has a bound, and a bus that does not answer within it is a missing converter.

use embedded_hal::{
    digital::OutputPin,
    spi::{Error, ErrorKind, ErrorType, MODE_1, Operation, SpiDevice},
};
use stm32f4xx_hal::{
    gpio::{
        ErasedPin, Output, PB13, PB14, PB15, PC0, PC1, PC2, PC3, PC4, PC5, PC6, PC7,
        PinState::High, Pull,
    },
    pac::SPI2,
    prelude::*,
    rcc::Rcc,
    spi::Spi,
};
use trueup_core::{
    calibration::MainsFrequency,
    temperature_channels::RawTemperatures,
    thermometer::{RawTemperatureReading, Thermometer},
};
use trueup_max31865::{ConverterReading, MIN_POLL_PERIOD_MS, Max31865};

use super::{super::TEMPERATURE_CHANNEL_COUNT, linear_inputs::LinearInputs, poll_until};

/// Turns in a round: one for each channel, and two that are left over.
const STEPS_PER_ROUND: usize = 10;
/// Milliseconds between two turns.
const STEP_PERIOD_MS: u32 = 10;
const _: () = assert!(
    STEPS_PER_ROUND > TEMPERATURE_CHANNEL_COUNT
        && STEPS_PER_ROUND as u32 * STEP_PERIOD_MS >= MIN_POLL_PERIOD_MS
);
/// After this many rounds a converter that is there has answered.
const MAX_RESPONSE_ROUNDS: u32 = 5;
/// Polls that a byte may take: some 20 times what it needs at 1.3 MHz.
const MAX_BYTE_POLLS: u32 = 4_096;
/// Core cycles between selection and clock, and between two selections: 0.5 µs at the full clock,
/// of 0.4 µs (data sheet, t_CC and t_CWH).
const CHIP_SELECT_DELAY_CYCLES: u32 = 84;

/// The pins that the converters share.
pub type BusPins = (PB13, PB14, PB15);
/// The pins that select them, in the order of the channels.
pub type ChipSelectPins = (PC0, PC1, PC2, PC3, PC4, PC5, PC6, PC7);

/// One channel.
struct Channel {
    select: ErasedPin<Output>,
    converter: Max31865,
    /// Its thermometer in the calibration.
    thermometer: Option<Thermometer>,
    /// How often it was another kind of reading than before.
    changes: u32,
}

/// All channels.
pub struct Thermometers {
    spi: Spi<SPI2>,
    channels: [Channel; TEMPERATURE_CHANNEL_COUNT],
    /// Where the machine file has some.
    linear: Option<LinearInputs>,
    turn: usize,
    rounds: u32,
}

/// Sets the bus up; the converters are set up by their first turns.
pub fn start(
    spi: SPI2,
    (sck, miso, mosi): BusPins,
    selects: ChipSelectPins,
    thermometers: [Option<Thermometer>; TEMPERATURE_CHANNEL_COUNT],
    mains: MainsFrequency,
    rcc: &mut Rcc,
) -> Thermometers {
    let selects = [
        selects.0.into_push_pull_output_in_state(High).erase(),
        selects.1.into_push_pull_output_in_state(High).erase(),
        selects.2.into_push_pull_output_in_state(High).erase(),
        selects.3.into_push_pull_output_in_state(High).erase(),
        selects.4.into_push_pull_output_in_state(High).erase(),
        selects.5.into_push_pull_output_in_state(High).erase(),
        selects.6.into_push_pull_output_in_state(High).erase(),
        selects.7.into_push_pull_output_in_state(High).erase(),
    ];
    // Pulled up, so that a line without a device reads as 1.
    let miso = miso.into_alternate().internal_resistor(Pull::Up);
    let pins = (Some(sck), Some(miso), Some(mosi));
    let spi = Spi::new(spi, pins, MODE_1, 1.MHz(), rcc);
    let mut thermometers = thermometers.into_iter();
    let channels = selects.map(|select| Channel {
        select,
        converter: Max31865::new(mains),
        thermometer: thermometers.next().flatten(),
        changes: 0,
    });
    Thermometers { spi, channels, linear: None, turn: 0, rounds: 0 }
}

impl Thermometers {
    /// Linear channels are read by these.
    pub fn set_linear_inputs(&mut self, inputs: LinearInputs) {
        self.linear = Some(inputs);
    }

    /// Takes one turn, every 10 ms. Returns what all channels deliver after each round.
    pub fn poll_next_channel(&mut self) -> Option<RawTemperatures> {
        let number = self.turn;
        self.turn = (self.turn + 1) % STEPS_PER_ROUND;
        if let Some(channel) = self.channels.get_mut(number) {
            channel.poll(number, &mut self.spi);
            return None;
        }
        if number > TEMPERATURE_CHANNEL_COUNT {
            return None;
        }
        self.rounds = self.rounds.saturating_add(1);
        if self.rounds == MAX_RESPONSE_ROUNDS {
            self.log_responding_channels();
        }
        let linear = self.linear.as_mut().map(LinearInputs::read_means);
        Some(core::array::from_fn(|number| {
            let channel = &self.channels[number];
            if channel.is_linear() {
                linear.map_or(RawTemperatureReading::NONE, |all| all[number])
            } else {
                channel.converter.reading().to_raw_reading()
            }
        }))
    }

    fn log_responding_channels(&self) {
        let bits = |is_so: fn(&Channel) -> bool| {
            self.channels.iter().rev().fold(0, |bits, channel| bits << 1 | u8::from(is_so(channel)))
        };
        let answering = bits(|channel| channel.converter.reading() != ConverterReading::Missing);
        let wanted = bits(|channel| channel.thermometer.is_some() && !channel.is_linear());
        defmt::info!(
            "temperature converters that answer: {=u8:#010b}, in the machine file: {=u8:#010b}",
            answering,
            wanted
        );
        if wanted & !answering != 0 {
            defmt::error!("dead: temperature converters {=u8:#010b}", wanted & !answering);
        }
    }
}

impl Channel {
    fn is_linear(&self) -> bool {
        matches!(self.thermometer, Some(Thermometer::Linear { .. }))
    }

    fn poll(&mut self, number: usize, spi: &mut Spi<SPI2>) {
        let before = self.converter.reading();
        let now = self.converter.poll(&mut SelectedConverter { spi, select: &mut self.select });
        if core::mem::discriminant(&now) != core::mem::discriminant(&before) {
            self.changes = self.changes.saturating_add(1);
            // A loose contact must not fill the log.
            if self.changes.is_power_of_two() {
                log_reading(number, now);
            }
        }
    }
}

fn log_reading(channel: usize, reading: ConverterReading) {
    match reading {
        ConverterReading::Missing => defmt::warn!("temperature channel {}: no answer", channel),
        ConverterReading::Starting => defmt::info!("temperature channel {}: answers", channel),
        ConverterReading::Good(ohms) => {
            defmt::info!("temperature channel {}: {=i32} micro-ohms", channel, ohms.0);
        }
        ConverterReading::Faulty(faults) => {
            defmt::warn!("temperature channel {}: fault {=u8:#010b}", channel, faults.0);
        }
    }
}

/// One converter on the bus that all of them share.
struct SelectedConverter<'a> {
    spi: &'a mut Spi<SPI2>,
    select: &'a mut ErasedPin<Output>,
}

/// The bus did not answer in time, or with an error.
#[derive(Debug)]
struct SpiBusError;

impl Error for SpiBusError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for SelectedConverter<'_> {
    type Error = SpiBusError;
}

impl SpiDevice for SelectedConverter<'_> {
    /// One selection, of one exchange: the driver makes no other. What it does not make gets no answer.
    // Once in the image: every step of a converter comes here.
    #[inline(never)]
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), SpiBusError> {
        // A byte that came too late last time would be taken for the first of this time.
        let _empty = poll_until(2, || self.spi.read_nonblocking().is_err());
        let Ok(()) = OutputPin::set_low(self.select);
        cortex_m::asm::delay(CHIP_SELECT_DELAY_CYCLES);
        let answered = match operations {
            [Operation::TransferInPlace(bytes)] => {
                bytes.iter_mut().all(|byte| self.exchange_byte(byte))
            }
            _ => false,
        };
        cortex_m::asm::delay(CHIP_SELECT_DELAY_CYCLES);
        let Ok(()) = OutputPin::set_high(self.select);
        cortex_m::asm::delay(CHIP_SELECT_DELAY_CYCLES);
        if answered { Ok(()) } else { Err(SpiBusError) }
    }
}

impl SelectedConverter<'_> {
    /// One byte each way. An error of the bus, too, is an answer that did not come.
    fn exchange_byte(&mut self, byte: &mut u8) -> bool {
        poll_until(MAX_BYTE_POLLS, || self.spi.write_nonblocking(*byte).is_ok())
            && poll_until(MAX_BYTE_POLLS, || match self.spi.read_nonblocking() {
                Ok(received) => {
                    *byte = received;
                    true
                }
                Err(_) => false,
            })
    }
}
