//! The manual's statements on the serial units, tried on USART3 with a wire of RS-485. Section numbers are RM0090's.

use crate::bench::{Bench, GPIOB, RCC, clocked};
use trueup_chip::{report::Severity, simulation_time::us_to_ticks};

const USART3: u32 = 0x4000_4800;
/// UE, M, PCE, RXNEIE, TE, RE; and without M and PCE.
const EVEN: u32 = 0x342c;
const PLAIN: u32 = 0x202c;
/// A character of 11 bits at 19 200 Bd.
const CHARACTER_US: u64 = 573;

/// 19 200 Bd from the 16 MHz of a reset, pins on AF7, PB12 an output.
fn line(settings: u32) -> Bench {
    let bench = clocked();
    bench.set(RCC + 0x40, 1 << 18);
    bench.write(GPIOB + 0x24, 0x7700);
    bench.set(GPIOB, 0x01a0_0000);
    bench.write(USART3 + 8, 833);
    bench.write(USART3 + 12, settings);
    bench
}

fn send_byte(bench: &Bench, byte: u8) {
    let now = bench.now;
    bench.at_once(|chip| chip.world.wires[1].to_board.push_back((now, byte)));
    bench.write(USART3 + 12, bench.read(USART3 + 12));
}

#[test]
fn parity_is_the_ninth_bit_of_the_word_and_is_read_above_the_data() {
    // 30.3.7 and 30.6.2; with an even number of ones it is 0.
    for (byte, parity) in [(0x03, 0), (0x07, 1)] {
        let mut bench = line(EVEN);
        send_byte(&bench, byte);
        bench.pass(us_to_ticks(CHARACTER_US - 5));
        assert_eq!(bench.read(USART3) & 0x20, 0, "it is still coming");
        bench.pass(us_to_ticks(10));
        assert_eq!(bench.read(USART3) & 0x3f, 0x20);
        assert_eq!(bench.read(USART3 + 4), u32::from(byte) | parity << 8);
        assert_eq!(bench.read(USART3) & 0x20, 0, "reading it has cleared RXNE");
    }
}

#[test]
fn a_character_of_another_form_and_a_wrong_parity_raise_their_flags_which_two_reads_clear() {
    // 30.6.1: PE and FE, cleared by a read of SR and one of DR.
    let mut bench = line(PLAIN);
    send_byte(&bench, 0x55);
    bench.pass(us_to_ticks(CHARACTER_US + 5));
    assert_eq!(bench.read(USART3) & 0x22, 0x22, "FE: the wire has parity, the unit none");
    let mut bench = line(EVEN);
    bench.at_once(|chip| chip.uart[1].disturbed.count = 1);
    bench.at_once(|chip| chip.uart[1].disturbed.flags = 1);
    send_byte(&bench, 0x55);
    bench.pass(us_to_ticks(CHARACTER_US + 5));
    assert_eq!(bench.read(USART3) & 0x21, 0x21);
    bench.read(USART3 + 4);
    assert_eq!(bench.read(USART3) & 0x21, 0);
    assert_eq!(bench.violations(""), 0);
}

#[test]
fn what_goes_out_while_nothing_drives_the_line_is_heard_by_nobody() {
    for is_driven in [false, true] {
        let mut bench = line(EVEN);
        bench.write(GPIOB + 0x14, u32::from(is_driven) << 12);
        bench.read(USART3);
        bench.write(USART3 + 4, 0x41);
        assert_eq!(bench.read(USART3) & 0xc0, 0x80, "TXE at once, TC not yet");
        bench.pass(us_to_ticks(CHARACTER_US + 5));
        assert_eq!(bench.read(USART3) & 0xc0, 0xc0, "TC when its stop bit is out");
        let (heard, remarks) = bench
            .at_once(|chip| (chip.world.wires[1].heard.len(), chip.report.count(Severity::Remark)));
        assert_eq!((heard, remarks), (usize::from(is_driven), usize::from(!is_driven)));
    }
}
