//! The manual's statements on the registers, tried on the model: reset values, bits that clear on 0 or on 1,
//! what happens unclocked, keys. Section numbers are RM0090's.

use crate::bench::{
    ADC1, Bench, CAN1, DMA2, FLASH, GPIOA, GPIOB, IWDG, RCC, TIM3, TIM11, USART1, clocked,
};
use trueup_chip::{
    chip::InjectedFaults,
    simulation_time::{ms_to_ticks, us_to_ticks},
};

#[test]
fn registers_have_their_reset_values() {
    let bench = clocked();
    let fresh = Bench::new();
    for (name, address, value) in [
        ("RCC_PLLCFGR, 7.3.2", RCC + 4, 0x2400_3010),
        ("RCC_CFGR, 7.3.3", RCC + 8, 0),
        ("RCC_AHB1ENR, 7.3.10", RCC + 0x30, 0x0010_0000),
        ("RCC_CSR, 7.3.21: power-on", RCC + 0x74, 0x0e00_0000),
        ("FLASH_ACR, 3.9.1", FLASH, 0),
        ("FLASH_SR, 3.9.5", FLASH + 0x0c, 0),
        ("FLASH_CR, 3.9.7", FLASH + 0x10, 0x8000_0000),
    ] {
        assert_eq!(fresh.read(address), value, "{name}");
    }
    for (name, address, value) in [
        ("GPIOA_MODER, 8.4.1", GPIOA, 0xa800_0000),
        ("GPIOB_MODER, 8.4.1", GPIOB, 0x0000_0280),
        ("GPIOA_OSPEEDR, 8.4.3", GPIOA + 8, 0x0c00_0000),
        ("GPIOB_OSPEEDR, 8.4.3", GPIOB + 8, 0x0000_00c0),
        ("GPIOA_PUPDR, 8.4.4", GPIOA + 0x0c, 0x6400_0000),
        ("TIM3_ARR, 18.4.12", TIM3 + 0x2c, 0xffff),
        ("DMA2_S0FCR, 10.5.10", DMA2 + 0x24, 0x21),
        ("CAN_MCR, 32.9.2", CAN1, 0x0001_0002),
        ("CAN_MSR, 32.9.2", CAN1 + 4, 0x0000_0c02),
        ("CAN_TSR, 32.9.2", CAN1 + 8, 0x1c00_0000),
        ("CAN_BTR, 32.9.2", CAN1 + 0x1c, 0x0123_0000),
        ("CAN_FMR, 32.9.4", CAN1 + 0x200, 0x2a1c_0e01),
        ("USART_SR, 30.6.1", USART1, 0x00c0),
        ("ADC_HTR, 13.13.7", ADC1 + 0x24, 0xfff),
        ("IWDG_RLR, 21.4.3", IWDG + 8, 0xfff),
    ] {
        assert_eq!(bench.read(address), value, "{name}");
    }
    assert_eq!(bench.violations(""), 0);
}

#[test]
fn an_unclocked_unit_reads_0_and_drops_writes() {
    // 2.1.11: its clock has to be enabled before a unit is used. What it answers without, RM0090 does not say; that it
    // is 0 stands in RM0008, of the STM32F1.
    let bench = Bench::new();
    bench.write(TIM3 + 0x2c, 99);
    assert_eq!(bench.read(TIM3 + 0x2c), 0);
    assert_eq!(bench.violations("TIM3: "), 2);
    bench.set(RCC + 0x40, 1 << 1);
    assert_eq!(bench.read(TIM3 + 0x2c), 0xffff);
}

#[test]
fn the_crystal_and_the_pll_take_their_time_and_their_limits_are_told() {
    let mut bench = Bench::new();
    bench.set(RCC, 1 << 16);
    bench.pass(us_to_ticks(1990));
    assert_eq!(bench.read(RCC) >> 17 & 1, 0);
    bench.pass(us_to_ticks(20));
    assert_eq!(bench.read(RCC) >> 17 & 1, 1);
    // Bits 31 to 28 are reserved and stay as they are.
    bench.write(RCC + 4, 2 << 28 | 7 << 24 | 1 << 22 | 168 << 6 | 4);
    bench.set(RCC, 1 << 24);
    bench.pass(us_to_ticks(160));
    assert_eq!(bench.read(RCC) >> 25 & 1, 1);
    assert_eq!(bench.violations(""), 0);
    // 7.3.2: the settings are fixed while the PLL is on; 3.5.1: five wait states at 168 MHz.
    bench.write(RCC + 4, 0x2400_3010);
    assert_eq!(bench.violations("RCC_PLLCFGR: written while the PLL is on"), 1);
    bench.write(RCC + 8, 2);
    assert_eq!(bench.violations("wait states at HCLK 168000000"), 1);
    assert_eq!(bench.violations("at most 168, 42 and 84 MHz"), 1);
}

#[test]
fn the_scale_of_the_regulator_changes_on_the_fly_but_not_below_what_the_clock_needs() {
    const PWR: u32 = 0x4000_7000;
    // 5.1.3 and 3.5.1: 16 MHz by any scale, 168 MHz by scale 1 alone.
    let mut bench = Bench::new();
    bench.set(RCC + 0x40, 1 << 28);
    bench.write(RCC + 4, 2 << 28 | 7 << 24 | 168 << 6 | 8);
    bench.set(RCC, 1 << 24);
    bench.pass(us_to_ticks(160));
    bench.write(PWR, 0);
    bench.write(PWR, 0x4000);
    bench.write(FLASH, 5);
    bench.write(RCC + 8, 4 << 13 | 5 << 10);
    bench.write(RCC + 8, 4 << 13 | 5 << 10 | 2);
    assert_eq!(bench.violations(""), 0);
    bench.write(PWR, 0);
    assert_eq!(bench.violations("with the regulator at scale 2"), 1);
}

#[test]
fn a_dead_crystal_never_becomes_ready() {
    let mut bench = Bench::with(InjectedFaults { hse_dead: true, ..InjectedFaults::default() });
    bench.set(RCC, 1 << 16);
    bench.pass(ms_to_ticks(100));
    assert_eq!(bench.read(RCC) >> 17 & 1, 0);
}

#[test]
fn the_flash_takes_its_keys_in_order_and_only_once() {
    let bench = Bench::new();
    bench.unlock_flash();
    assert_eq!(bench.read(FLASH + 0x10) >> 31, 0);
    bench.write(FLASH + 0x10, 1 << 31);
    // 3.6.1: a wrong key locks the register until the next reset.
    bench.write(FLASH + 4, 0x1234_5678);
    bench.unlock_flash();
    assert_eq!(bench.read(FLASH + 0x10) >> 31, 1);
    assert!(bench.violations("wrong key") > 0);
}

#[test]
fn a_flash_word_is_programmed_in_16_microseconds_and_only_towards_0() {
    let mut bench = Bench::new();
    bench.unlock_flash();
    bench.write(FLASH + 0x10, 2 << 8 | 1);
    bench.program(0x8_0000, 0x1234_5678);
    assert_eq!(bench.read(FLASH + 0x0c) >> 16 & 1, 1, "BSY");
    bench.pass(us_to_ticks(17));
    assert_eq!(bench.read(FLASH + 0x0c), 0);
    bench.program(0x8_0000, 0xffff_ffff);
    assert_eq!(bench.violations("0 into a 1"), 1);
}

#[test]
fn a_flash_word_takes_100_microseconds_at_the_most() {
    // DS8626, flash memory programming: the time of a word.
    let mut bench = Bench::new();
    bench.at_once(|chip| chip.world.slow_flash = true);
    bench.unlock_flash();
    bench.write(FLASH + 0x10, 2 << 8 | 1);
    bench.program(0x8_0000, 0);
    bench.pass(us_to_ticks(99));
    assert_eq!(bench.read(FLASH + 0x0c) >> 16 & 1, 1, "BSY");
    bench.pass(us_to_ticks(2));
    assert_eq!(bench.read(FLASH + 0x0c), 0);
}

#[test]
fn error_flags_of_the_flash_clear_on_1_and_hold_up_the_next_write() {
    let mut bench = Bench::new();
    bench.unlock_flash();
    // 3.9.5: PGPERR when the width written is not PSIZE's.
    bench.write(FLASH + 0x10, 1);
    bench.program(0x8_0000, 0);
    assert_eq!(bench.read(FLASH + 0x0c), 0x40);
    bench.write(FLASH + 0x0c, 0);
    assert_eq!(bench.read(FLASH + 0x0c), 0x40, "0 leaves it");
    bench.write(FLASH + 0x10, 2 << 8 | 1);
    bench.program(0x8_0000, 0);
    assert_eq!(bench.violations("with error flags set"), 1);
    bench.write(FLASH + 0x0c, 0x40);
    assert_eq!(bench.read(FLASH + 0x0c), 0, "1 clears it");
    bench.program(0x8_0000, 0);
    bench.pass(us_to_ticks(17));
    assert_eq!(bench.read(FLASH + 0x0c), 0);
}

#[test]
fn a_timer_updates_at_its_period_and_its_flag_clears_on_0() {
    let mut bench = clocked();
    bench.write(TIM3 + 0x2c, 799);
    bench.write(TIM3, 1);
    bench.pass(us_to_ticks(49));
    assert_eq!(bench.read(TIM3 + 0x10) & 1, 0);
    bench.pass(us_to_ticks(2));
    assert_eq!(bench.read(TIM3 + 0x10) & 1, 1, "20 kHz of 16 MHz");
    bench.write(TIM3 + 0x10, 0xffff);
    assert_eq!(bench.read(TIM3 + 0x10) & 1, 1, "1 leaves it");
    bench.write(TIM3 + 0x10, 0xfffe);
    assert_eq!(bench.read(TIM3 + 0x10) & 1, 0, "0 clears it");
}

#[test]
fn the_converter_needs_3_microseconds_and_its_pin() {
    let bench = clocked();
    bench.write(ADC1 + 8, 1);
    bench.write(ADC1 + 8, 1 | 1 << 30);
    assert_eq!(bench.violations("tSTAB"), 1);
    let mut bench = clocked();
    bench.write(ADC1 + 8, 1);
    bench.pass(us_to_ticks(4));
    bench.write(ADC1 + 8, 1 | 1 << 30);
    assert_eq!(bench.violations("its pin is not analog"), 1);
    bench.pass(us_to_ticks(10));
    assert_eq!(bench.read(ADC1) & 2, 2, "EOC");
    assert_eq!(bench.read(ADC1 + 0x4c), 1000);
    assert_eq!(bench.read(ADC1) & 2, 0, "reading the data clears it");
}

/// CAN on PB8 and PB9 with these faults, 40 µs after it was to leave its initialisation: 16 MHz by 2 and 8 quanta,
/// 1 Mbit/s.
fn can(faults: InjectedFaults) -> Bench {
    let mut bench = Bench::with(faults);
    bench.set(RCC + 0x30, 2);
    bench.set(RCC + 0x40, 1 << 25);
    bench.write(GPIOB, 0x280 | 2 << 16 | 2 << 18);
    bench.write(GPIOB + 0x24, 0x99);
    bench.write(CAN1, 1);
    bench.pass(us_to_ticks(10));
    assert_eq!(bench.read(CAN1 + 4) & 3, 1, "INAK");
    bench.write(CAN1 + 0x1c, 0x0014_0001);
    bench.write(CAN1, 0);
    bench.pass(us_to_ticks(40));
    bench
}

#[test]
fn can_leaves_initialisation_after_11_recessive_bits_and_never_on_a_dominant_bus() {
    for stuck in [false, true] {
        let bench = can(InjectedFaults { can_stuck: stuck, ..InjectedFaults::default() });
        assert_eq!(bench.read(CAN1 + 4) & 1, u32::from(stuck), "32.4.2");
    }
}

#[test]
fn bus_off_is_left_after_128_times_11_recessive_bits_initialisation_or_not() {
    let mut bench = can(InjectedFaults { can_short: true, ..InjectedFaults::default() });
    // A frame that nobody receives whole is sent 32 times, 8 errors each: 256.
    bench.write(CAN1 + 0x180, 0x100 << 21 | 1);
    bench.pass(us_to_ticks(32 * 80));
    assert_eq!(bench.read(CAN1 + 0x18) & 4, 4, "BOFF");
    bench.write(CAN1, 1);
    bench.pass(us_to_ticks(40));
    assert_eq!(bench.read(CAN1 + 4) & 1, 1, "INAK");
    assert_eq!(bench.read(CAN1 + 0x18) & 4, 4, "no pin is watched there: 32.7.6");
    bench.write(CAN1, 0);
    bench.pass(us_to_ticks(1_400));
    assert_eq!(bench.read(CAN1 + 0x18) & 4, 4, "1,408 bits");
    bench.pass(us_to_ticks(20));
    assert_eq!(bench.read(CAN1 + 0x18) >> 16 & 0xff | bench.read(CAN1 + 0x18) & 4, 0, "TEC, BOFF");
}

#[test]
fn the_filter_and_the_timing_of_can_are_locked_outside_initialisation() {
    let bench = clocked();
    bench.write(CAN1 + 0x1c, 2);
    assert_eq!(bench.violations("CAN_BTR written outside initialisation"), 1);
    bench.write(CAN1 + 0x200, 0x2a1c_0e00);
    bench.write(CAN1 + 0x20c, 1);
    assert_eq!(bench.violations("filter register"), 1);
}

#[test]
fn the_watchdog_wants_its_key_and_resets_once_it_is_not_fed() {
    let mut bench = Bench::new();
    bench.write(IWDG + 8, 100);
    assert_eq!(bench.violations("without 0x5555"), 1);
    bench.write(IWDG, 0x5555);
    bench.write(IWDG + 8, 799);
    bench.pass(ms_to_ticks(1));
    bench.write(IWDG, 0xcccc);
    // 800 counts of 32 kHz / 4.
    bench.pass(ms_to_ticks(99));
    assert!(bench.board.with_chip(|chip| chip.resets.is_empty()));
    bench.write(IWDG, 0xaaaa);
    bench.pass(ms_to_ticks(99));
    assert!(bench.board.with_chip(|chip| chip.resets.is_empty()));
    bench.pass(ms_to_ticks(2));
    assert_eq!(bench.board.with_chip(|chip| chip.resets[0].1), "IWDG");
}

#[test]
fn the_watchdog_counts_from_its_reset_value_until_it_is_reloaded() {
    // 21.3: 4096 counts of 32 kHz / 4 are 512 ms, and what is to be reloaded does not count before a reload.
    for (reloads, until) in [(false, 512), (true, 100)] {
        let mut bench = Bench::new();
        bench.write(IWDG, 0x5555);
        bench.write(IWDG + 8, 799);
        bench.pass(ms_to_ticks(1));
        if reloads {
            bench.write(IWDG, 0xaaaa);
        }
        bench.write(IWDG, 0xcccc);
        bench.pass(ms_to_ticks(until - 1));
        assert!(bench.board.with_chip(|chip| chip.resets.is_empty()), "{reloads}");
        bench.pass(ms_to_ticks(2));
        assert_eq!(bench.board.with_chip(|chip| chip.resets.len()), 1, "{reloads}");
    }
}

#[test]
fn a_dma_stream_is_switched_off_before_its_settings_change() {
    let bench = clocked();
    let stream = DMA2 + 0x10 + 0x18 * 7;
    bench.write(stream + 4, 4);
    bench.write(stream + 8, USART1 + 4);
    bench.write(stream + 12, 0x2000_0000);
    bench.write(stream, 4 << 25 | 1 << 10 | 1 << 6);
    bench.write(stream, 4 << 25 | 1 << 10 | 1 << 6 | 1);
    bench.write(stream + 4, 5);
    assert_eq!(bench.violations("NDTR or PAR written while it is on"), 1);
}

#[test]
fn the_dma_does_not_reach_the_core_coupled_memory() {
    let bench = clocked();
    let stream = DMA2 + 0x10 + 0x18 * 7;
    bench.write(stream + 4, 4);
    bench.write(stream + 12, 0x1000_0000);
    bench.write(stream, 4 << 25 | 1 << 10 | 1 << 6 | 1);
    assert_eq!(bench.violations("is not in the SRAM that it reaches"), 1);
}

#[test]
fn timer_11_measures_the_crystal_against_the_internal_oscillator() {
    let mut bench = Bench::new();
    bench.set(RCC, 1 << 16);
    bench.pass(ms_to_ticks(3));
    bench.set(RCC + 8, 31 << 16);
    bench.set(RCC + 0x44, 1 << 18);
    bench.write(TIM11 + 0x50, 2);
    bench.write(TIM11 + 0x18, 3 << 2 | 1);
    bench.write(TIM11 + 0x20, 1);
    bench.write(TIM11, 1);
    // 8 periods of 8 MHz / 31 are 31 µs: 496 counts of 16 MHz.
    bench.pass(us_to_ticks(32));
    assert_eq!(bench.read(TIM11 + 0x10) & 0x202, 2, "CC1IF");
    assert_eq!(bench.read(TIM11 + 0x34), 496);
    assert_eq!(bench.read(TIM11 + 0x10) & 0x202, 0, "reading the capture clears it");
    bench.pass(us_to_ticks(31));
    assert_eq!(bench.read(TIM11 + 0x34), 992);
    bench.pass(us_to_ticks(62));
    assert_eq!(bench.read(TIM11 + 0x10) & 0x202, 0x202, "two at once: CC1OF");
    assert_eq!(bench.violations(""), 0);
}

#[test]
fn the_crc_unit_takes_words_highest_bit_first_and_begins_at_ones() {
    const CRC: u32 = 0x4002_3000;
    let bench = Bench::new();
    bench.set(RCC + 0x30, 1 << 12);
    assert_eq!(bench.read(CRC), u32::MAX, "4.4.1");
    // A word of zeros by CRC-32/MPEG-2, the same sum in the catalogues of CRCs.
    bench.write(CRC, 0);
    assert_eq!(bench.read(CRC), 0xc704_dd7b);
    bench.write(CRC + 8, 1);
    assert_eq!(bench.read(CRC), u32::MAX, "4.4.3");
    bench.write(CRC, 0x1234_5678);
    assert_eq!(bench.read(CRC), 0xdf8a_8a2b);
}

#[test]
fn a_protected_sector_raises_wrperr_and_stays() {
    let bench = Bench::new();
    bench.board.with_chip(|chip| chip.flash.optcr &= !(1 << (16 + 8)));
    bench.unlock_flash();
    bench.write(FLASH + 0x10, 0x201);
    bench.program(0x8_0000, 0);
    assert_eq!(bench.read(FLASH + 0x0c) & 0x10, 0x10, "3.9.5");
    bench.write(FLASH + 0x0c, 0x10);
    bench.program(0xa_0000, 0);
    assert_eq!(bench.read(FLASH + 0x0c) & 0x10, 0, "the next sector is not");
}
