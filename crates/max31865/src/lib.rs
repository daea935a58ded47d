//! A MAX31865, which turns the resistance of a PT100 into a number: its registers, and the order in
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
//!      ┌──────────── a fault, or CHECK_TURNS are over ────────────┐
//!      ▼                                                          │
//!   clear ─► start the cable check ─► read its result ─► settle ─► read … read
//!      ▲                                    │               │
//!      └── no answer, or a cable is broken ─┴───────────────┘
//! ```
//!
//! Each arrow is one turn; a turn must come no sooner than [`TURN_MS`] after the last one, which is
//! longer than the 66 ms of a first conversion with the 50 Hz filter and than the cable check's
//! 0.6 ms. Whether a converter answers is seen from its configuration and thresholds, which are
//! read back with every ratio: a dead line, all 0 or all 1, is none, and a converter that has lost
//! its supply for a moment is found and set up anew.
//!
//! Ratio to resistance: R = ratio·R_ref/2¹⁵, rounded to a micro-ohm. One step of the ratio is
//! 13.1 mΩ, 0.034 K.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

use trueup_core::{
    pt100::{OPEN_ABOVE, SHORT_BELOW},
    thermometer::Raw,
    units::MicroOhms,
};

/// R_ref: what PT100 boards with this converter carry. Its tolerance is that of the temperature:
/// 0.1 % of it reads as 0.26 K at 0 °C.
pub const REFERENCE: MicroOhms = MicroOhms(430_000_000);
/// The shortest time between two turns of one converter.
pub const TURN_MS: u32 = 80;
/// The cables are checked anew after so many readings: every 10 s at 100 ms a turn.
pub const CHECK_TURNS: u32 = 96;

/// Binary places of the ratio.
const RATIO_BITS: u32 = 15;
/// The addresses for writing begin here.
const WRITE: u8 = 0x80;
/// The registers, from the first to the last, are read in one go: this address, and eight bytes.
const REGISTERS: usize = 8;
/// The first register of the thresholds.
const THRESHOLDS: u8 = 0x03;

/// Bias on, 3-wire, 50 Hz; nothing else runs.
const READY: u8 = 0b1001_0001;
/// With it in the configuration, the latched faults are cleared.
const CLEAR: u8 = 0b0000_0010;
/// With it in the configuration, the cables are checked once; the converter takes it back then.
const CHECK: u8 = 0b0000_0100;
/// With it in the configuration, it converts without end.
const AUTOMATIC: u8 = 0b0100_0000;

/// High threshold, low threshold: beyond the thermometer's range a reading is latched as a fault.
const LIMITS: [u8; 4] = {
    let [high, high_low] = ratio_of(OPEN_ABOVE).to_be_bytes();
    let [low, low_low] = ratio_of(SHORT_BELOW).to_be_bytes();
    [high, high_low, low, low_low]
};

/// The register's content for a resistance: the ratio, rounded down, above the fault bit.
#[allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "run by the compiler, which refuses to build what overflows; a test checks the result"
)]
const fn ratio_of(resistance: MicroOhms) -> u16 {
    ((((resistance.0 as u64) << RATIO_BITS) / REFERENCE.0 as u64) << 1) as u16
}

/// What is latched in the fault register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Faults(pub u8);

impl Faults {
    /// The resistance is above the high threshold.
    pub const HIGH: u8 = 0x80;
    /// It is below the low threshold.
    pub const LOW: u8 = 0x40;
    /// REFIN− above 85 % of the bias: no current flows, a wire is broken.
    pub const NO_CURRENT: u8 = 0x20;
    /// An input is beyond the supply.
    pub const VOLTAGE: u8 = 0x04;

    /// As a thermometer's delivery: a resistance far beyond its range, on the side of the cause.
    #[must_use]
    pub fn raw(self) -> Raw {
        let is_open = self.0 & (Self::HIGH | Self::NO_CURRENT | Self::VOLTAGE) != 0;
        Raw(if is_open { i32::MAX } else { 0 })
    }
}

/// What a converter says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reading {
    /// Nothing answers.
    #[default]
    Missing,
    /// It answers, and has not measured yet.
    Starting,
    /// It measures, and the thermometer or its cable is broken.
    Faulty(Faults),
    /// The resistance.
    Good(MicroOhms),
}

impl Reading {
    /// As a thermometer's delivery.
    #[must_use]
    pub fn raw(self) -> Raw {
        match self {
            Self::Missing | Self::Starting => Raw::NONE,
            Self::Faulty(faults) => faults.raw(),
            Self::Good(resistance) => Raw(resistance.0),
        }
    }
}

/// What comes next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Step {
    #[default]
    Clear,
    StartCheck,
    EndCheck,
    Settle,
    Read {
        left: u32,
    },
}

/// One converter.
#[derive(Clone, Copy, Debug, Default)]
pub struct Converter {
    step: Step,
    reading: Reading,
}

impl Converter {
    /// What it said last.
    #[must_use]
    pub fn reading(&self) -> Reading {
        self.reading
    }

    /// One turn. `transfer` selects the converter, sends the bytes while it replaces them by what
    /// comes back, deselects it, and gives whether the bus did all that.
    ///
    /// The last good reading, or the last fault, stands while the cables are checked: four turns.
    pub fn turn(&mut self, mut transfer: impl FnMut(&mut [u8]) -> bool) -> Reading {
        let mut configure = |bits: u8| transfer(&mut [WRITE, READY | bits]);
        self.step = match self.step {
            Step::Clear => {
                let [a, b, c, d] = LIMITS;
                let sent = configure(CLEAR) && transfer(&mut [WRITE | THRESHOLDS, a, b, c, d]);
                if sent { Step::StartCheck } else { self.fail(Reading::Missing) }
            }
            Step::StartCheck => match configure(CHECK) {
                true => Step::EndCheck,
                false => self.fail(Reading::Missing),
            },
            Step::EndCheck => match Registers::read(READY, &mut transfer) {
                Err(failure) => self.fail(failure),
                Ok(_) if transfer(&mut [WRITE, READY | AUTOMATIC]) => Step::Settle,
                Ok(_) => self.fail(Reading::Missing),
            },
            Step::Settle => {
                if self.reading == Reading::Missing {
                    self.reading = Reading::Starting;
                }
                Step::Read { left: CHECK_TURNS }
            }
            Step::Read { left } => match Registers::read(READY | AUTOMATIC, &mut transfer) {
                Err(failure) => self.fail(failure),
                Ok(registers) => {
                    self.reading = Reading::Good(registers.resistance());
                    match left.saturating_sub(1) {
                        0 => Step::Clear,
                        left => Step::Read { left },
                    }
                }
            },
        };
        self.reading
    }

    fn fail(&mut self, reading: Reading) -> Step {
        self.reading = reading;
        Step::Clear
    }
}

/// All registers, as they were read.
struct Registers([u8; REGISTERS]);

impl Registers {
    /// Reads them. A converter whose configuration or thresholds are not as they were set is not
    /// there.
    fn read(configuration: u8, transfer: impl FnOnce(&mut [u8]) -> bool) -> Result<Self, Reading> {
        let mut bytes = [0; REGISTERS + 1];
        let answered = transfer(&mut bytes);
        let [_, registers @ ..] = bytes;
        let [found, _, low, limits @ .., faults] = registers;
        if !answered || found != configuration || limits != LIMITS {
            Err(Reading::Missing)
        } else if faults != 0 || low & 1 != 0 && configuration & AUTOMATIC != 0 {
            Err(Reading::Faulty(Faults(faults)))
        } else {
            Ok(Self(registers))
        }
    }

    fn resistance(&self) -> MicroOhms {
        const HALF: i64 = 1 << (RATIO_BITS - 1);
        let [_, high, low, ..] = self.0;
        let ratio = i64::from(u16::from_be_bytes([high, low]) >> 1);
        let scaled = ratio.saturating_mul(i64::from(REFERENCE.0)).saturating_add(HALF);
        MicroOhms(i32::try_from(scaled >> RATIO_BITS).unwrap_or(i32::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::thermometer::{Fault, Thermometer};

    /// 25.7 °C.
    const PLAIN: i64 = 110_000_000;

    /// A converter as the data sheet describes it.
    struct Chip {
        registers: [u8; REGISTERS],
        micro_ohms: i64,
        /// What a cable check finds.
        cable: u8,
    }

    impl Chip {
        fn new(micro_ohms: i64) -> Self {
            Self { registers: [0, 0, 0, 0xFF, 0xFF, 0, 0, 0], micro_ohms, cable: 0 }
        }

        /// One selection.
        fn transfer(&mut self, bytes: &mut [u8]) {
            let address = bytes[0];
            for (n, byte) in (0..).zip(&mut bytes[1..]) {
                let register = usize::from((address & 0x7F) + n) % REGISTERS;
                if address & WRITE == 0 {
                    *byte = self.registers[register];
                } else {
                    assert!(matches!(register, 0 | 3..=6), "register {register} is read only");
                    self.registers[register] = *byte;
                    *byte = 0;
                }
            }
            if address == WRITE {
                self.configured();
            }
        }

        fn configured(&mut self) {
            let bits = self.registers[0];
            if bits & CLEAR != 0 {
                assert_eq!(bits & 0b0010_1100, 0, "what else must not be asked with a clear");
                self.registers[7] = 0;
                self.registers[2] &= !1;
            }
            if bits & 0b1100 != 0 {
                assert_eq!(bits & 0b1110_1110, 0b1000_0100, "100X010X starts the check");
                self.registers[7] |= self.cable;
            }
            self.registers[0] &= !(CLEAR | 0b1100);
        }

        /// Time for a conversion, if it is asked to convert.
        fn live(&mut self) {
            if self.registers[0] & 0b1100_0000 != 0b1100_0000 {
                return;
            }
            let ratio = u16::try_from((self.micro_ohms << 15) / 430_000_000).unwrap_or(32_767);
            let ratio = ratio.min(32_767) << 1;
            let threshold =
                |n: usize| u16::from_be_bytes([self.registers[n], self.registers[n + 1]]);
            let (high, low) = (threshold(3), threshold(5));
            self.registers[7] |= if ratio >= high { Faults::HIGH } else { 0 };
            self.registers[7] |= if ratio <= low { Faults::LOW } else { 0 };
            let fault = u16::from(self.registers[7] != 0);
            self.registers[1..3].copy_from_slice(&(ratio | fault).to_be_bytes());
        }
    }

    fn turn(converter: &mut Converter, chip: &mut Chip) -> Reading {
        chip.live();
        converter.turn(|bytes| {
            chip.transfer(bytes);
            true
        })
    }

    fn turns(converter: &mut Converter, chip: &mut Chip, count: u32) -> Reading {
        (0..count).map(|_| turn(converter, chip)).last().expect("at least one")
    }

    fn good(reading: Reading) -> i64 {
        let Reading::Good(MicroOhms(micro)) = reading else { panic!("{reading:?}") };
        micro.into()
    }

    #[test]
    fn the_data_sheets_examples_are_met() {
        // Table 5: ratio 0.5 is 0x8000, 0.125 is 0x2000; the lowest bit is the fault's.
        let at = |high, low| Registers([0, high, low, 0, 0, 0, 0, 0]).resistance();
        assert_eq!(at(0x80, 0x00), MicroOhms(215_000_000));
        assert_eq!(at(0x20, 0x01), MicroOhms(53_750_000));
        assert_eq!(at(0xFF, 0xFE), MicroOhms(429_986_877));
        // Written out: bias, 3-wire, 50 Hz; the check is 100X010X.
        assert_eq!([READY | CLEAR, READY | CHECK, READY | AUTOMATIC], [0x93, 0x95, 0xD1]);
    }

    #[test]
    fn a_thermometer_is_read_from_the_fifth_turn_on_to_a_step() {
        for micro_ohms in [76_330_000, 100_000_000, 109_730_000, 138_510_000, 247_090_000] {
            let (mut converter, mut chip) = (Converter::default(), Chip::new(micro_ohms));
            for _ in 0..4 {
                assert_eq!(turn(&mut converter, &mut chip).raw(), Raw::NONE);
            }
            let read = good(turn(&mut converter, &mut chip));
            // The converter rounds down: 430 Ω/2¹⁵ are 13 123 µΩ.
            assert!((0..=13_123).contains(&(micro_ohms - read)), "{read} of {micro_ohms} µΩ");
            let reading = Thermometer::Pt100.read(converter.reading().raw());
            assert!(reading.is_ok(), "{micro_ohms} µΩ: {reading:?}");
        }
    }

    #[test]
    fn the_reading_stands_while_the_cables_are_checked() {
        let (mut converter, mut chip) = (Converter::default(), Chip::new(PLAIN));
        let mut checks = 0;
        turns(&mut converter, &mut chip, 5);
        for _ in 0..3 * (CHECK_TURNS + 4) {
            let was = chip.registers[0];
            good(turn(&mut converter, &mut chip));
            checks += u32::from(was == READY && chip.registers[0] == (READY | AUTOMATIC));
        }
        assert_eq!(checks, 3);
    }

    #[test]
    fn a_line_stuck_at_0_or_at_1_or_a_bus_that_hangs_is_a_missing_converter() {
        for (stuck, bus) in [(0x00, true), (0xFF, true), (0x00, false)] {
            let mut converter = Converter::default();
            for _ in 0..50 {
                let reading = converter.turn(|bytes| {
                    bytes.fill(stuck);
                    bus
                });
                assert_eq!((reading, reading.raw()), (Reading::Missing, Raw::NONE));
            }
        }
    }

    #[test]
    fn one_that_dies_is_missing_with_the_next_reading_and_one_that_comes_back_is_read() {
        let (mut converter, mut chip) = (Converter::default(), Chip::new(PLAIN));
        good(turns(&mut converter, &mut chip, 7));
        assert_eq!(
            converter.turn(|bytes| {
                bytes.fill(0xFF);
                true
            }),
            Reading::Missing
        );
        // A dip of its supply: all registers as after power-on.
        good(turns(&mut converter, &mut chip, 5));
        chip = Chip::new(PLAIN);
        assert_eq!(turn(&mut converter, &mut chip), Reading::Missing);
        good(turns(&mut converter, &mut chip, 5));
    }

    #[test]
    fn broken_and_shorted_thermometers_are_told_apart_and_recover() {
        for (micro_ohms, expected) in [(i64::MAX >> 16, Fault::Open), (300_000, Fault::Short)] {
            let (mut converter, mut chip) = (Converter::default(), Chip::new(PLAIN));
            good(turns(&mut converter, &mut chip, 9));
            chip.micro_ohms = micro_ohms;
            // With the next reading, and as long as it lasts.
            for _ in 0..20 {
                let reading = turn(&mut converter, &mut chip);
                assert_eq!(Thermometer::Pt100.read(reading.raw()), Err(expected));
            }
            chip.micro_ohms = PLAIN;
            good(turns(&mut converter, &mut chip, 9));
        }
    }

    #[test]
    fn a_cable_fault_that_the_ratio_does_not_show_is_found_by_the_check() {
        for (cable, expected) in
            [(Faults::NO_CURRENT, Fault::Open), (0x10, Fault::Short), (0x08, Fault::Short)]
        {
            let (mut converter, mut chip) = (Converter::default(), Chip::new(PLAIN));
            good(turns(&mut converter, &mut chip, 5));
            chip.cable = cable;
            let found = (0..CHECK_TURNS + 4).find_map(|_| match turn(&mut converter, &mut chip) {
                Reading::Faulty(faults) => Some(faults),
                _ => None,
            });
            let found = found.expect("within one round of checks");
            assert_eq!(found, Faults(cable));
            assert_eq!(Thermometer::Pt100.read(found.raw()), Err(expected));
        }
    }

    #[test]
    fn a_fault_of_a_moment_is_seen_though_it_is_over_when_it_is_read() {
        let (mut converter, mut chip) = (Converter::default(), Chip::new(PLAIN));
        good(turns(&mut converter, &mut chip, 9));
        chip.micro_ohms = i64::MAX >> 16;
        chip.live();
        chip.micro_ohms = PLAIN;
        assert_eq!(turn(&mut converter, &mut chip), Reading::Faulty(Faults(Faults::HIGH)));
        good(turns(&mut converter, &mut chip, 5));
    }
}
