//! The driver before a converter as the data sheet describes it, and before a scripted bus.

use super::*;
use core::convert::Infallible;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation};
use embedded_hal_mock::eh1::spi::{Mock, Transaction};
use std::vec::Vec;
use trueup_core::thermometer::{Thermometer, ThermometerFault};

/// A PT100 at 25.7 °C: 110 Ω in micro-ohms.
const PLAIN: i64 = 110_000_000;

/// A converter as the data sheet describes it.
struct Chip {
    registers: [u8; REGISTER_COUNT],
    micro_ohms: i64,
    /// Fault bits that a cable check finds.
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
            let register = usize::from((address & 0x7F) + n) % REGISTER_COUNT;
            if address & WRITE_FLAG == 0 {
                *byte = self.registers[register];
            } else {
                assert!(matches!(register, 0 | 3..=6), "register {register} is read only");
                self.registers[register] = *byte;
                *byte = 0;
            }
        }
        if address == WRITE_FLAG {
            self.configured();
        }
    }

    fn configured(&mut self) {
        let bits = self.registers[0];
        if bits & CLEAR_FAULTS != 0 {
            assert_eq!(bits & 0b0010_1100, 0, "what else must not be asked with a clear");
            self.registers[7] = 0;
            self.registers[2] &= !1;
        }
        if bits & 0b1100 != 0 {
            assert_eq!(bits & 0b1110_1110, 0b1000_0100, "100X010X starts the check");
            self.registers[7] |= self.cable;
        }
        self.registers[0] &= !(CLEAR_FAULTS | 0b1100);
    }

    /// Time for a conversion, if it is asked to convert.
    fn live(&mut self) {
        if self.registers[0] & 0b1100_0000 != 0b1100_0000 {
            return;
        }
        let ratio = u16::try_from((self.micro_ohms << 15) / 430_000_000).unwrap_or(32_767);
        let ratio = ratio.min(32_767) << 1;
        let threshold = |n: usize| u16::from_be_bytes([self.registers[n], self.registers[n + 1]]);
        let (high, low) = (threshold(3), threshold(5));
        self.registers[7] |= if ratio >= high { Faults::ABOVE_HIGH_THRESHOLD } else { 0 };
        self.registers[7] |= if ratio <= low { Faults::BELOW_LOW_THRESHOLD } else { 0 };
        let fault = u16::from(self.registers[7] != 0);
        self.registers[1..3].copy_from_slice(&(ratio | fault).to_be_bytes());
    }
}

impl ErrorType for Chip {
    type Error = Infallible;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let [Operation::TransferInPlace(bytes)] = operations else { panic!("{operations:?}") };
        self.transfer(bytes);
        Ok(())
    }
}

/// A line stuck at 0 or at 1, or a bus that does not answer in time.
struct Stuck {
    level: u8,
    error: Option<ErrorKind>,
}

impl ErrorType for Stuck {
    type Error = ErrorKind;
}

impl SpiDevice for Stuck {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        for operation in operations {
            let Operation::TransferInPlace(bytes) = operation else { panic!("{operation:?}") };
            bytes.fill(self.level);
        }
        self.error.map_or(Ok(()), Err)
    }
}

fn turn(converter: &mut Max31865, chip: &mut Chip) -> ConverterReading {
    chip.live();
    converter.poll(chip)
}

fn turns(converter: &mut Max31865, chip: &mut Chip, count: u32) -> ConverterReading {
    (0..count).map(|_| turn(converter, chip)).last().expect("at least one")
}

fn good(reading: ConverterReading) -> i64 {
    let ConverterReading::Good(MicroOhms(micro)) = reading else { panic!("{reading:?}") };
    micro.into()
}

#[test]
fn the_data_sheets_examples_are_met() {
    // Table 5: ratio 0.5 is 0x8000, 0.125 is 0x2000; the lowest bit is the fault's.
    let at = |high, low| ConverterRegisters([0, high, low, 0, 0, 0, 0, 0]).resistance();
    assert_eq!(at(0x80, 0x00), MicroOhms(215_000_000));
    assert_eq!(at(0x20, 0x01), MicroOhms(53_750_000));
    assert_eq!(at(0xFF, 0xFE), MicroOhms(429_986_877));
}

#[test]
fn the_filter_is_that_of_the_mains_in_every_configuration_that_is_written() {
    // Written out: bias, 3-wire, the filter in bit 0; the check is 100X010X.
    for (mains, written) in
        [(MainsFrequency::Hz50, [0x93, 0x95, 0xD1]), (MainsFrequency::Hz60, [0x92, 0x94, 0xD0])]
    {
        let (mut converter, mut chip) = (Max31865::new(mains), Chip::new(PLAIN));
        let mut all = Vec::new();
        for _ in 0..3 * (READINGS_PER_FAULT_CHECK + 5) {
            chip.live();
            let mut spi = Recorder { chip: &mut chip, written: &mut all };
            converter.poll(&mut spi);
        }
        let ConverterReading::Good(_) = converter.reading() else {
            panic!("{:?}", converter.reading())
        };
        assert_eq!(all[..3], written);
        assert!(all.iter().all(|bits| written.contains(bits)), "{all:02x?}");
    }
}

/// A converter, and what is written to its configuration.
struct Recorder<'a> {
    chip: &'a mut Chip,
    written: &'a mut Vec<u8>,
}

impl ErrorType for Recorder<'_> {
    type Error = Infallible;
}

impl SpiDevice for Recorder<'_> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        if let [Operation::TransferInPlace([WRITE_FLAG, bits])] = operations {
            self.written.push(*bits);
        }
        self.chip.transaction(operations)
    }
}

#[test]
fn a_thermometer_is_read_from_the_fifth_turn_on_to_a_step() {
    for micro_ohms in [76_330_000, 100_000_000, 109_730_000, 138_510_000, 247_090_000] {
        let (mut converter, mut chip) = (Max31865::default(), Chip::new(micro_ohms));
        for _ in 0..4 {
            assert_eq!(
                turn(&mut converter, &mut chip).to_raw_reading(),
                RawTemperatureReading::NONE
            );
        }
        let read = good(turn(&mut converter, &mut chip));
        // The converter rounds down: 430 Ω/2¹⁵ are 13 123 µΩ.
        assert!((0..=13_123).contains(&(micro_ohms - read)), "{read} of {micro_ohms} µΩ");
        let reading = Thermometer::Pt100.convert(converter.reading().to_raw_reading());
        assert!(reading.is_ok(), "{micro_ohms} µΩ: {reading:?}");
    }
}

#[test]
fn the_reading_stands_while_the_cables_are_checked() {
    let (mut converter, mut chip) = (Max31865::default(), Chip::new(PLAIN));
    let mut checks = 0;
    turns(&mut converter, &mut chip, 5);
    for _ in 0..3 * (READINGS_PER_FAULT_CHECK + 4) {
        let was = chip.registers[0];
        good(turn(&mut converter, &mut chip));
        let ready = BIAS_ON_3_WIRE | FILTER_50_HZ;
        checks += u32::from(was == ready && chip.registers[0] == (ready | AUTO_CONVERSION));
    }
    assert_eq!(checks, 3);
}

#[test]
fn a_line_stuck_at_0_or_at_1_or_a_bus_that_hangs_is_a_missing_converter() {
    for (level, error) in [(0x00, None), (0xFF, None), (0x00, Some(ErrorKind::Other))] {
        let mut converter = Max31865::default();
        for _ in 0..50 {
            let reading = converter.poll(&mut Stuck { level, error });
            assert_eq!(
                (reading, reading.to_raw_reading()),
                (ConverterReading::Missing, RawTemperatureReading::NONE)
            );
        }
    }
}

#[test]
fn one_that_dies_is_missing_with_the_next_reading_and_one_that_comes_back_is_read() {
    let (mut converter, mut chip) = (Max31865::default(), Chip::new(PLAIN));
    good(turns(&mut converter, &mut chip, 7));
    assert_eq!(converter.poll(&mut Stuck { level: 0xFF, error: None }), ConverterReading::Missing);
    // A dip of its supply: all registers as after power-on.
    good(turns(&mut converter, &mut chip, 5));
    chip = Chip::new(PLAIN);
    assert_eq!(turn(&mut converter, &mut chip), ConverterReading::Missing);
    good(turns(&mut converter, &mut chip, 5));
}

#[test]
fn broken_and_shorted_thermometers_are_distinguished_and_recover() {
    for (micro_ohms, expected) in
        [(i64::MAX >> 16, ThermometerFault::Open), (300_000, ThermometerFault::Short)]
    {
        let (mut converter, mut chip) = (Max31865::default(), Chip::new(PLAIN));
        good(turns(&mut converter, &mut chip, 9));
        chip.micro_ohms = micro_ohms;
        // With the next reading, and as long as it lasts.
        for _ in 0..20 {
            let reading = turn(&mut converter, &mut chip);
            assert_eq!(Thermometer::Pt100.convert(reading.to_raw_reading()), Err(expected));
        }
        chip.micro_ohms = PLAIN;
        good(turns(&mut converter, &mut chip, 9));
    }
}

#[test]
fn a_cable_fault_that_the_ratio_does_not_show_is_found_by_the_check() {
    for (cable, expected) in [
        (Faults::NO_CURRENT, ThermometerFault::Open),
        (0x10, ThermometerFault::Short),
        (0x08, ThermometerFault::Short),
    ] {
        let (mut converter, mut chip) = (Max31865::default(), Chip::new(PLAIN));
        good(turns(&mut converter, &mut chip, 5));
        chip.cable = cable;
        let found =
            (0..READINGS_PER_FAULT_CHECK + 4).find_map(|_| match turn(&mut converter, &mut chip) {
                ConverterReading::Faulty(faults) => Some(faults),
                _ => None,
            });
        let found = found.expect("within one round of checks");
        assert_eq!(found, Faults(cable));
        assert_eq!(Thermometer::Pt100.convert(found.to_raw_reading()), Err(expected));
    }
}

#[test]
fn a_fault_of_a_moment_is_seen_though_it_is_over_when_it_is_read() {
    let (mut converter, mut chip) = (Max31865::default(), Chip::new(PLAIN));
    good(turns(&mut converter, &mut chip, 9));
    chip.micro_ohms = i64::MAX >> 16;
    chip.live();
    chip.micro_ohms = PLAIN;
    assert_eq!(
        turn(&mut converter, &mut chip),
        ConverterReading::Faulty(Faults(Faults::ABOVE_HIGH_THRESHOLD))
    );
    good(turns(&mut converter, &mut chip, 5));
}

/// Returns one selection: what is sent, and what comes back meanwhile.
fn selection(sent: &[u8], back: &[u8]) -> Vec<Transaction<u8>> {
    std::vec![
        Transaction::transaction_start(),
        Transaction::transfer_in_place(sent.to_vec(), back.to_vec()),
        Transaction::transaction_end(),
    ]
}

#[test]
fn the_first_reading_takes_these_bytes_and_no_others() {
    let [high, high_low, low, low_low] = FAULT_THRESHOLDS;
    let registers = |configuration, ratio, low_ratio| {
        [0, configuration, ratio, low_ratio, high, high_low, low, low_low, 0]
    };
    let expected = [
        // Clear, and the thresholds.
        selection(&[0x80, 0x93], &[0; 2]),
        selection(&[0x83, high, high_low, low, low_low], &[0; 5]),
        // The cable check, and its result.
        selection(&[0x80, 0x95], &[0; 2]),
        selection(&[0; 9], &registers(0x91, 0, 0)),
        selection(&[0x80, 0xD1], &[0; 2]),
        // Half the reference.
        selection(&[0; 9], &registers(0xD1, 0x80, 0x00)),
    ];
    let mut spi = Mock::new(&expected.concat());
    let mut converter = Max31865::default();
    let readings: Vec<_> = (0..5).map(|_| converter.poll(&mut spi)).collect();
    spi.done();
    assert_eq!(
        readings[3..],
        [ConverterReading::Starting, ConverterReading::Good(MicroOhms(215_000_000))]
    );
}
