//! Statements of RM0090 section 13 and of the data sheet on the converters, tried on the model.

use crate::bench::{ADC1, Bench, DMA2, GPIOA, RCC, TIM3, clocked};
use trueup_chip::{
    report::Severity,
    simulation_time::{ms_to_ticks, us_to_ticks},
};

const ADC2: u32 = ADC1 + 0x100;
const COMMON: u32 = ADC1 + 0x304;
const ON: u32 = 1;
const SWSTART: u32 = 1 << 30;
const JSWSTART: u32 = 1 << 22;
/// 16 MHz / 2: a cycle of the converters is an eighth of a microsecond.
const CLOCK_HZ: u64 = 8_000_000;

/// PA0 to PA3 analog, ADC1 and ADC2 clocked, on, and ready.
fn ready() -> Bench {
    let mut bench = clocked();
    bench.set(RCC + 0x44, 1 << 9);
    bench.set(GPIOA, 0xff);
    bench.write(ADC1 + 8, ON);
    bench.write(ADC2 + 8, ON);
    bench.pass(us_to_ticks(4));
    bench
}

fn remarks(bench: &Bench) -> usize {
    bench.board.with_chip(|chip| chip.report.count(Severity::Remark))
}

/// Ticks of this many cycles of the converter.
fn cycles(count: u64) -> u64 {
    count * trueup_chip::simulation_time::TICKS_PER_SECOND / CLOCK_HZ
}

#[test]
fn each_converter_has_its_own_clock_and_reset_values() {
    let bench = clocked();
    assert_eq!(bench.read(ADC2 + 0x24), 0);
    assert_eq!(bench.violations("ADC2: read without its clock"), 1, "7.3.14");
    bench.set(RCC + 0x44, 1 << 9);
    assert_eq!(bench.read(ADC2 + 0x24), 0xfff, "13.13.7");
}

#[test]
fn the_second_converter_reads_its_own_pin_while_the_first_reads_another() {
    let mut bench = ready();
    bench.at_once(|chip| chip.world.inputs[3] = 1.65);
    bench.write(ADC2 + 0x34, 3);
    bench.write(ADC1 + 8, ON | SWSTART);
    bench.write(ADC2 + 8, ON | SWSTART);
    bench.pass(us_to_ticks(10));
    assert_eq!(bench.read(ADC1 + 0x4c), 1000);
    let half = bench.read(ADC2 + 0x4c);
    assert!((2047..=2049).contains(&half), "{half}");
    assert_eq!(bench.violations(""), 0);
}

#[test]
fn the_internal_reference_needs_its_switch_its_time_and_10_microseconds() {
    // 13.3.3, 13.13.16 (TSVREFE) and DS8626, embedded reference voltage.
    let mut bench = ready();
    bench.write(ADC1 + 0x38, 17 << 15);
    let inject = |bench: &mut Bench| {
        bench.write(ADC1 + 8, ON | JSWSTART);
        bench.pass(us_to_ticks(70));
        bench.read(ADC1 + 0x3c)
    };
    inject(&mut bench);
    assert_eq!(bench.violations("without TSVREFE"), 1);
    assert_eq!(bench.violations("sampled for less than 10 µs"), 1);
    bench.write(COMMON, 1 << 23);
    inject(&mut bench);
    assert_eq!(bench.violations("within 10 µs of TSVREFE"), 1);
    bench.write(ADC1 + 0x0c, 5 << 21);
    let before = bench.violations("");
    let nominal = inject(&mut bench);
    assert!((1500..=1504).contains(&nominal), "its factory value is 1502: {nominal}");
    assert_eq!(bench.read(ADC1) & 4, 4, "JEOC");
    // The supply is the scale: a lower one makes every code larger.
    bench.at_once(|chip| chip.world.supply = 3.0);
    let lower = inject(&mut bench);
    assert!((1650..=1654).contains(&lower), "1502 × 3.3 / 3.0: {lower}");
    assert_eq!(bench.violations(""), before);
    // It is the first converter's alone.
    bench.write(ADC2 + 0x34, 17);
    bench.write(ADC2 + 8, ON | SWSTART);
    assert_eq!(bench.violations("ADC2: nothing is at channel 17"), 1);
}

#[test]
fn an_injected_conversion_between_two_regular_ones_disturbs_neither() {
    // 13.3.9, triggered injection; the events of tables 69 and 70: TIM3's update and its compare 4.
    let mut bench = ready();
    bench.write(COMMON, 1 << 23);
    bench.pass(us_to_ticks(11));
    bench.write(ADC1 + 0x10, 6);
    bench.write(ADC1 + 0x0c, 5 << 21);
    bench.write(ADC1 + 0x38, 17 << 15);
    bench.write(ADC1 + 8, ON | 1 << 28 | 8 << 24 | 1 << 20 | 5 << 16);
    bench.write(TIM3 + 0x2c, 799);
    bench.write(TIM3 + 4, 2 << 4);
    bench.write(TIM3 + 0x40, 400);
    bench.write(TIM3 + 0x1c, 7 << 12);
    bench.write(TIM3 + 0x20, 1 << 12);
    bench.write(TIM3, 1);
    bench.pass(ms_to_ticks(1) + us_to_ticks(49));
    let (regular, injected) = bench.board.with_chip(|chip| {
        let adc = &chip.adc.unit[0];
        (adc.conversions, adc.injections)
    });
    assert_eq!((regular, injected), (20, 21));
    assert_eq!((bench.violations(""), remarks(&bench)), (0, 0));
}

#[test]
fn an_injected_conversion_breaks_off_a_regular_one_which_is_then_done_again() {
    let mut bench = ready();
    bench.write(COMMON, 1 << 23);
    bench.pass(us_to_ticks(11));
    bench.write(ADC1 + 0x0c, 5 << 21);
    bench.write(ADC1 + 0x38, 17 << 15);
    bench.write(ADC1 + 8, ON | SWSTART);
    bench.write(ADC1 + 8, ON | JSWSTART);
    // 112 + 12 cycles of the injected one, then 3 + 12.
    bench.pass(cycles(124));
    assert_eq!(bench.read(ADC1) & 6, 4, "the injected one has ended, the other not");
    bench.pass(cycles(15));
    assert_eq!(bench.read(ADC1) & 2, 2);
    assert_eq!(remarks(&bench), 1);
}

#[test]
fn a_discontinuous_sequence_goes_on_by_one_at_each_trigger() {
    // 13.3.10, with the DMA in circles: table 44, DMA2 stream 3 channel 1.
    let mut bench = ready();
    bench.at_once(|chip| chip.world.inputs[1..4].copy_from_slice(&[0.33, 0.66, 0.99]));
    let stream = DMA2 + 0x10 + 0x18 * 3;
    bench.write(stream + 4, 3);
    bench.write(stream + 8, ADC2 + 0x4c);
    bench.write(stream + 12, 0x2000_1000);
    bench.write(stream, 1 << 25 | 1 << 13 | 1 << 11 | 1 << 10 | 1 << 8 | 1);
    bench.write(ADC2 + 4, 1 << 11 | 1 << 8);
    bench.write(ADC2 + 0x2c, 2 << 20);
    bench.write(ADC2 + 0x34, 1 | 2 << 5 | 3 << 10);
    for _ in 0..3 {
        bench.write(ADC2 + 8, ON | 1 << 8 | 1 << 9 | SWSTART);
        bench.pass(us_to_ticks(10));
    }
    let codes: Vec<u16> = bench.board.with_chip(|chip| {
        let mut bytes = [0; 6];
        chip.sram.read_at(0x1000, &mut bytes).expect("in the SRAM");
        bytes.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect()
    });
    for (code, expected) in codes.iter().zip([410, 819, 1229]) {
        assert!(code.abs_diff(expected) <= 1, "{codes:?}");
    }
    assert_eq!(bench.violations(""), 0);
}

#[test]
fn a_converter_that_stalls_ends_nothing_until_it_is_switched_off() {
    let mut bench = ready();
    bench.at_once(|chip| chip.faults.adc_stalls = 1);
    bench.write(ADC1 + 8, ON | SWSTART);
    bench.pass(ms_to_ticks(1));
    assert_eq!(bench.read(ADC1) & 2, 0);
    bench.write(ADC1 + 8, 0);
    bench.write(ADC1 + 8, ON);
    bench.pass(us_to_ticks(4));
    bench.write(ADC1 + 8, ON | SWSTART);
    bench.pass(us_to_ticks(10));
    assert_eq!(bench.read(ADC1) & 2, 2);
}
