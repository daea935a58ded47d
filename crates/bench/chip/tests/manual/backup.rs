//! The backup domain and the RTC (sections 5.1.2, 5.4, 7.3.20, 26).

use super::bench::{Bench, RCC};
use trueup_chip::simulation_time::{ms_to_ticks, us_to_ticks};

const PWR: u32 = 0x4000_7000;
const RTC: u32 = 0x4000_2800;
const BKPSRAM: u32 = 0x4002_4000;
const BDCR: u32 = RCC + 0x70;
/// A cycle of the 32 kHz crystal, and a little.
const CYCLE: u64 = us_to_ticks(31);

/// With the clocks of PWR and of the SRAM on; the domain is still closed.
fn bench(battery: bool) -> Bench {
    let bench = Bench::new();
    bench.board.with_chip(|chip| chip.world.battery = battery);
    bench.set(RCC + 0x40, 1 << 28);
    bench.set(RCC + 0x30, 1 << 18);
    bench
}

fn open(bench: &Bench) {
    bench.set(PWR, 1 << 8);
}

/// Returns the RTC from the crystal, set to 2024-02-28 23:59:58, a Wednesday.
fn started(battery: bool) -> Bench {
    let mut bench = bench(battery);
    open(&bench);
    bench.write(BDCR, 1);
    bench.pass(ms_to_ticks(2_001));
    assert_eq!(bench.read(BDCR) & 2, 2, "LSERDY");
    bench.write(BDCR, 1 | 1 << 8 | 1 << 15);
    bench.write(RTC + 0x24, 0xca);
    bench.write(RTC + 0x24, 0x53);
    bench.write(RTC + 0x0c, 1 << 7);
    bench.pass(3 * CYCLE);
    assert_eq!(bench.read(RTC + 0x0c) & 0x40, 0x40, "INITF");
    bench.write(RTC, 0x23_5958);
    bench.write(RTC + 4, 0x24_6228);
    bench.write(RTC + 0x0c, 0);
    bench
}

/// The supply goes for this many seconds and comes back; the clocks of the units are on again.
fn cut(bench: &mut Bench, seconds: u64) {
    bench.at_once(|chip| chip.cycle_power(seconds));
    bench.set(RCC + 0x40, 1 << 28);
    bench.set(RCC + 0x30, 1 << 18);
}

fn time_and_date(bench: &Bench) -> (u32, u32) {
    (bench.read(RTC), bench.read(RTC + 4))
}

#[test]
fn after_a_reset_writes_do_not_reach_the_domain() {
    let bench = bench(true);
    let before = bench.read(BKPSRAM);
    for (address, value) in [(BDCR, 1), (BKPSRAM, !before), (RTC + 0x50, 7), (PWR + 4, 1 << 9)] {
        bench.write(address, value);
    }
    assert_eq!(bench.violations("without PWR_CR.DBP"), 4, "5.4.1");
    assert_eq!((bench.read(BDCR), bench.read(BKPSRAM)), (0, before));
    open(&bench);
    bench.write(BKPSRAM + 0xffc, 0x1234_5678);
    bench.write(RTC + 0x50, 7);
    assert_eq!((bench.read(BKPSRAM + 0xffc), bench.read(RTC + 0x50)), (0x1234_5678, 7));
}

#[test]
fn the_clock_of_the_rtc_is_chosen_once_and_the_sram_outlasts_a_reset_of_the_domain() {
    let mut bench = started(true);
    bench.write(BDCR, 1 | 2 << 8 | 1 << 15);
    assert_eq!(bench.violations("RTCSEL changed"), 1, "7.3.20");
    assert_eq!(bench.read(BDCR) & 0x300, 0x100);
    bench.write(BKPSRAM, 5);
    bench.write(RTC + 0x50, 5);
    bench.write(PWR + 4, 1 << 9);
    bench.pass(ms_to_ticks(1));
    bench.write(BDCR, 1 << 16);
    bench.write(BDCR, 0);
    assert_eq!((bench.read(BDCR), bench.read(RTC + 0x50), bench.read(BKPSRAM)), (0, 0, 5));
    assert_eq!(bench.read(PWR + 4) & 0x208, 0, "7.1.3: the regulator of the SRAM is off");
    assert_eq!(bench.read(RTC + 0x10), 0x007f_00ff, "26.6.5");
    bench.write(BDCR, 1 | 2 << 8);
    assert_eq!(bench.read(BDCR) & 0x300, 0x200, "it can be chosen anew");
    bench.pass(us_to_ticks(1));
}

#[test]
fn the_calendar_counts_seconds_in_bcd_over_a_leap_day() {
    let mut bench = started(true);
    bench.pass(5 * CYCLE);
    assert_eq!(time_and_date(&bench), (0x23_5958, 0x24_6228));
    bench.pass(ms_to_ticks(1_000));
    assert_eq!(time_and_date(&bench), (0x23_5959, 0x24_6228));
    bench.pass(ms_to_ticks(1_000));
    assert_eq!(time_and_date(&bench), (0, 0x24_8229), "Thursday the 29th");
    // 26.6.11: the sub-second counts down from PREDIV_S; a quarter of a second is 64 of 256.
    bench.pass(ms_to_ticks(250));
    assert_eq!(bench.read(RTC + 0x28), 255 - 64);
    assert_eq!(bench.violations(""), 0);
}

#[test]
fn what_is_read_first_locks_what_is_read_then() {
    let mut bench = started(true);
    bench.pass(ms_to_ticks(1_900));
    assert_eq!(bench.read(RTC), 0x23_5959);
    bench.pass(ms_to_ticks(1_000));
    assert_eq!(bench.read(RTC + 4), 0x24_6228, "the date of that time (26.3.6)");
    assert_eq!(bench.read(RTC + 4), 0x24_8229);
}

#[test]
fn without_keys_or_initialisation_nothing_is_set() {
    let mut bench = started(true);
    bench.write(RTC, 0);
    assert_eq!(bench.violations("outside initialisation"), 1, "26.3.5");
    bench.write(RTC + 0x24, 0xff);
    bench.write(RTC + 0x0c, 1 << 7);
    bench.pass(4 * CYCLE);
    assert_eq!(bench.read(RTC + 0x0c) & 0xc0, 0, "INIT is behind the keys");
    assert_eq!(bench.read(RTC + 0x0c) & 0x20, 0x20, "and so is RSF: only bits 13:8 are not");
    bench.write(RTC + 0x10, 0);
    assert_eq!(bench.violations("while the keys are not"), 1);
}

#[test]
fn the_shadows_need_two_cycles_after_a_reset_of_the_system() {
    let mut bench = started(true);
    bench.pass(ms_to_ticks(1_000));
    bench.at_once(|chip| chip.reset(1 << 28));
    assert_eq!(bench.read(RTC + 0x0c) & 0x20, 0, "26.6.4: RSF");
    assert_eq!(bench.read(RTC), 0);
    bench.pass(2 * CYCLE);
    assert_eq!(bench.read(RTC + 0x0c) & 0x20, 0x20);
    assert_eq!(bench.read(RTC) & 0x7f, 0x58);
}

#[test]
fn vbat_keeps_the_time_and_the_registers_and_with_its_regulator_the_sram() {
    for regulator in [false, true] {
        let mut bench = started(true);
        if regulator {
            bench.write(PWR + 4, 1 << 9);
            assert_eq!(bench.read(PWR + 4) & 8, 0, "BRR comes later (5.4.2)");
            bench.pass(ms_to_ticks(1));
            assert_eq!(bench.read(PWR + 4) & 8, 8);
        }
        bench.write(BKPSRAM, 0x5a5a_0001);
        bench.write(RTC + 0x50, 0x1234);
        cut(&mut bench, 3_600);
        bench.pass(ms_to_ticks(3));
        assert_eq!(bench.read(BKPSRAM) == 0x5a5a_0001, regulator, "5.1.2");
        assert_eq!(bench.read(RTC + 0x50), 0x1234);
        assert_eq!(time_and_date(&bench), (0x00_5958, 0x24_8229), "an hour later");
        assert_eq!(bench.read(BDCR) & 0x8303, 0x8103, "the oscillator has gone on");
        bench.write(BKPSRAM, 0);
        assert_eq!(bench.violations("without PWR_CR.DBP"), 1, "closed again");
    }
}

#[test]
fn without_vbat_nothing_is_left() {
    let mut bench = started(false);
    bench.write(PWR + 4, 1 << 9);
    bench.pass(ms_to_ticks(1));
    bench.write(BKPSRAM, 0x5a5a_0001);
    bench.write(RTC + 0x50, 0x1234);
    cut(&mut bench, 1);
    assert_ne!(bench.read(BKPSRAM), 0x5a5a_0001);
    let left = [BDCR, RTC + 0x50, RTC + 0x0c, PWR + 4].map(|register| bench.read(register));
    assert_eq!(left, [0, 0, 7, 0x4000]);
}

#[test]
fn a_dead_crystal_never_gets_ready_and_one_that_stops_stops_the_time() {
    let mut bench = bench(true);
    bench.at_once(|chip| chip.faults.lse_dead = true);
    open(&bench);
    bench.write(BDCR, 1 | 1 << 8 | 1 << 15);
    bench.pass(ms_to_ticks(4_000));
    assert_eq!(bench.read(BDCR) & 2, 0);
    assert_eq!(bench.read(RTC + 0x0c) & 0x20, 0, "the shadows never come");
    let mut bench = started(true);
    bench.pass(ms_to_ticks(500));
    bench.at_once(|chip| chip.set_lse_running(false));
    cut(&mut bench, 3_600);
    bench.at_once(|chip| chip.set_lse_running(true));
    assert_eq!(bench.read(BDCR) & 2, 2, "LSERDY stays");
    bench.pass(ms_to_ticks(1_990));
    assert_eq!(bench.read(RTC + 0x0c) & 0x20, 0, "DS8626: a crystal takes 2 s to start, also anew");
    bench.pass(ms_to_ticks(20));
    assert_eq!(bench.read(RTC), 0x23_5958);
}
