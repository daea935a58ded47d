//! A driver of the MAX31865, which turns the resistance of a PT100 into a number: its registers, and the order in
//! which they are written and read (data sheet 19-6478).
//!
//! | register | read | write | |
//! |---|---|---|---|
//! | configuration | 0x00 | 0x80 | bias, automatic, single, 3-wire, 2 bits fault cycle, clear, 50 Hz |
//! | ratio | 0x01, 0x02 | | 15 bits of R/R_ref, and in bit 0 whether there is a fault |
//! | thresholds | 0x03…0x06 | 0x83…0x86 | high, low, as the ratio |
//! | faults | 0x07 | | latched until they are cleared |
//!
//! ```text
//!      ┌──────────── a fault, or READINGS_PER_FAULT_CHECK are over ────────────┐
//!      ▼                                                          │
//!   clear ─► start the cable check ─► read its result ─► settle ─► read … read
//!      ▲                                    │               │
//!      └── no answer, or a cable is broken ─┴───────────────┘
//! ```
//!
//! The filter suppresses the hum of the mains, of 50 Hz or of 60 Hz: bit 0 of the configuration.
//!
//! Each arrow is one turn; a turn must come no sooner than [`MIN_POLL_PERIOD_MS`] after the last one, which is
//! longer than the 66 ms of a first conversion with the 50 Hz filter and than the cable check's
//! 0.6 ms. Whether a converter answers is seen from its configuration and thresholds, which are
//! read back with every ratio: a dead line, all 0 or all 1, is none, and a converter that has lost
//! its supply for a moment is found and set up again.
//!
//! It speaks through embedded-hal's [`SpiDevice`], in mode 1 and at 5 MHz at most, and never waits
//! itself: how long a transfer may take is for the board's device to bound. An error of it counts as
//! an answer that did not come.
//!
//! Ratio to resistance: R = ratio·R_ref/2¹⁵, rounded to a micro-ohm. One step of the ratio is
//! 13.1 mΩ, 0.034 K.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

use embedded_hal::spi::SpiDevice;
use trueup_core::{
    calibration::MainsFrequency,
    pt100::{OPEN_THRESHOLD, SHORT_THRESHOLD},
    thermometer::RawTemperatureReading,
    units::MicroOhms,
};

/// R_ref: what PT100 boards with this converter carry. Its tolerance is that of the temperature:
/// 0.1 % of it reads as 0.26 K at 0 °C.
pub const REFERENCE_RESISTANCE: MicroOhms = MicroOhms(430_000_000);
/// The shortest time between two turns of one converter.
pub const MIN_POLL_PERIOD_MS: u32 = 80;
/// The cables are checked again after this many readings: every 10 s at 100 ms a turn.
pub const READINGS_PER_FAULT_CHECK: u32 = 96;

/// Binary places of the ratio.
const RATIO_FRACTION_BITS: u32 = 15;
/// The addresses for writing begin here.
const WRITE_FLAG: u8 = 0x80;
/// The registers, from the first to the last, are read in one go: this address, and eight bytes.
const REGISTER_COUNT: usize = 8;
/// The first register of the thresholds.
const THRESHOLD_REGISTER: u8 = 0x03;

/// Bias on, 3-wire; nothing else runs.
const BIAS_ON_3_WIRE: u8 = 0b1001_0000;
/// With it in the configuration, the filter suppresses 50 Hz, without it 60 Hz.
const FILTER_50_HZ: u8 = 0b0000_0001;
/// With it in the configuration, the latched faults are cleared.
const CLEAR_FAULTS: u8 = 0b0000_0010;
/// With it in the configuration, the cables are checked once; the converter takes it back then.
const RUN_FAULT_DETECTION: u8 = 0b0000_0100;
/// With it in the configuration, it converts without end.
const AUTO_CONVERSION: u8 = 0b0100_0000;

/// High threshold, low threshold: beyond the thermometer's range a reading is latched as a fault.
const FAULT_THRESHOLDS: [u8; 4] = {
    let [high, high_low] = ratio_from_resistance(OPEN_THRESHOLD).to_be_bytes();
    let [low, low_low] = ratio_from_resistance(SHORT_THRESHOLD).to_be_bytes();
    [high, high_low, low, low_low]
};

/// Returns the register's content for a resistance: the ratio, rounded down, above the fault bit.
#[allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "run by the compiler, which refuses to build what overflows; a test checks the result"
)]
const fn ratio_from_resistance(resistance: MicroOhms) -> u16 {
    ((((resistance.0 as u64) << RATIO_FRACTION_BITS) / REFERENCE_RESISTANCE.0 as u64) << 1) as u16
}

/// Bits that are latched in the fault register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Faults(pub u8);

impl Faults {
    /// The resistance is above the high threshold.
    pub const ABOVE_HIGH_THRESHOLD: u8 = 0x80;
    /// It is below the low threshold.
    pub const BELOW_LOW_THRESHOLD: u8 = 0x40;
    /// REFIN− above 85 % of the bias: no current flows, a wire is broken.
    pub const NO_CURRENT: u8 = 0x20;
    /// An input is beyond the supply.
    pub const OVER_UNDERVOLTAGE: u8 = 0x04;

    /// As a thermometer's delivery: a resistance far beyond its range, on the side of the cause.
    #[must_use]
    pub fn to_raw_reading(self) -> RawTemperatureReading {
        let is_open =
            self.0 & (Self::ABOVE_HIGH_THRESHOLD | Self::NO_CURRENT | Self::OVER_UNDERVOLTAGE) != 0;
        RawTemperatureReading(if is_open { i32::MAX } else { 0 })
    }
}

/// The result of reading a converter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ConverterReading {
    /// No converter answers.
    #[default]
    Missing,
    /// It answers, and has not measured yet.
    Starting,
    /// It measures, and the thermometer or its cable is broken.
    Faulty(Faults),
    /// The resistance in micro-ohms, 0…429 986 877.
    Good(MicroOhms),
}

impl ConverterReading {
    /// As a thermometer's delivery.
    #[must_use]
    pub fn to_raw_reading(self) -> RawTemperatureReading {
        match self {
            Self::Missing | Self::Starting => RawTemperatureReading::NONE,
            Self::Faulty(faults) => faults.to_raw_reading(),
            Self::Good(resistance) => RawTemperatureReading(resistance.0),
        }
    }
}

/// The step that comes next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum ConversionStep {
    #[default]
    Clear,
    StartCheck,
    EndCheck,
    Settle,
    Read {
        left: u32,
    },
}

/// One converter: the sequence of its turns, and its newest reading.
#[derive(Clone, Copy, Debug, Default)]
pub struct Max31865 {
    step: ConversionStep,
    reading: ConverterReading,
    mains: MainsFrequency,
}

impl Max31865 {
    /// Returns a converter that was not spoken to, and is to suppress the hum of these mains.
    #[must_use]
    pub fn new(mains: MainsFrequency) -> Self {
        Self { mains, ..Self::default() }
    }

    /// Returns its last reading.
    #[must_use]
    pub fn reading(&self) -> ConverterReading {
        self.reading
    }

    /// Takes one turn, of at most two selections of 9 bytes together 11.
    ///
    /// The last good reading, or the last fault, stands while the cables are checked: four turns.
    pub fn poll(&mut self, spi: &mut impl SpiDevice) -> ConverterReading {
        let mut transfer = |bytes: &mut [u8]| spi.transfer_in_place(bytes).is_ok();
        let ready =
            BIAS_ON_3_WIRE | if self.mains == MainsFrequency::Hz50 { FILTER_50_HZ } else { 0 };
        let mut configure = |bits: u8| transfer(&mut [WRITE_FLAG, ready | bits]);
        self.step = match self.step {
            ConversionStep::Clear => {
                let [a, b, c, d] = FAULT_THRESHOLDS;
                let sent = configure(CLEAR_FAULTS)
                    && transfer(&mut [WRITE_FLAG | THRESHOLD_REGISTER, a, b, c, d]);
                if sent {
                    ConversionStep::StartCheck
                } else {
                    self.record_failure(ConverterReading::Missing)
                }
            }
            ConversionStep::StartCheck => match configure(RUN_FAULT_DETECTION) {
                true => ConversionStep::EndCheck,
                false => self.record_failure(ConverterReading::Missing),
            },
            ConversionStep::EndCheck => match ConverterRegisters::read(ready, &mut transfer) {
                Err(failure) => self.record_failure(failure),
                Ok(_) if transfer(&mut [WRITE_FLAG, ready | AUTO_CONVERSION]) => {
                    ConversionStep::Settle
                }
                Ok(_) => self.record_failure(ConverterReading::Missing),
            },
            ConversionStep::Settle => {
                if self.reading == ConverterReading::Missing {
                    self.reading = ConverterReading::Starting;
                }
                ConversionStep::Read { left: READINGS_PER_FAULT_CHECK }
            }
            ConversionStep::Read { left } => {
                match ConverterRegisters::read(ready | AUTO_CONVERSION, &mut transfer) {
                    Err(failure) => self.record_failure(failure),
                    Ok(registers) => {
                        self.reading = ConverterReading::Good(registers.resistance());
                        match left.saturating_sub(1) {
                            0 => ConversionStep::Clear,
                            left => ConversionStep::Read { left },
                        }
                    }
                }
            }
        };
        self.reading
    }

    fn record_failure(&mut self, reading: ConverterReading) -> ConversionStep {
        self.reading = reading;
        ConversionStep::Clear
    }
}

/// All registers, as they were read.
struct ConverterRegisters([u8; REGISTER_COUNT]);

impl ConverterRegisters {
    /// Reads them. A converter whose configuration or thresholds are not as they were set is not
    /// there.
    fn read(
        configuration: u8,
        transfer: impl FnOnce(&mut [u8]) -> bool,
    ) -> Result<Self, ConverterReading> {
        let mut bytes = [0; REGISTER_COUNT + 1];
        let answered = transfer(&mut bytes);
        let [_, registers @ ..] = bytes;
        let [found, _, low, limits @ .., faults] = registers;
        if !answered || found != configuration || limits != FAULT_THRESHOLDS {
            Err(ConverterReading::Missing)
        } else if faults != 0 || low & 1 != 0 && configuration & AUTO_CONVERSION != 0 {
            Err(ConverterReading::Faulty(Faults(faults)))
        } else {
            Ok(Self(registers))
        }
    }

    fn resistance(&self) -> MicroOhms {
        const ROUNDING_HALF: i64 = 1 << (RATIO_FRACTION_BITS - 1);
        let [_, high, low, ..] = self.0;
        let ratio = i64::from(u16::from_be_bytes([high, low]) >> 1);
        let scaled =
            ratio.saturating_mul(i64::from(REFERENCE_RESISTANCE.0)).saturating_add(ROUNDING_HALF);
        MicroOhms(i32::try_from(scaled >> RATIO_FRACTION_BITS).unwrap_or(i32::MAX))
    }
}

#[cfg(test)]
mod tests;
