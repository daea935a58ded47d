//! USART1 and USART3, asynchronous, with parity or without.

use super::{Chip, upset::Disturbance};
use crate::{
    report::Grade,
    time::{NEVER, TPS},
    wire::Parity,
};

/// A unit as RM0090 (tables 1 and 62) and DS8626 (alternate functions, AF7) place it.
pub(crate) struct Unit {
    name: &'static str,
    transmit: &'static [(usize, u32)],
    receive: &'static [(usize, u32)],
    apb2: bool,
}

/// The units that are modelled; the wire of the same number is behind it.
pub(crate) const UNITS: [Unit; 2] = [
    Unit { name: "USART1", transmit: &[(0, 9), (1, 6)], receive: &[(0, 10), (1, 7)], apb2: true },
    Unit {
        name: "USART3",
        transmit: &[(1, 10), (2, 10), (3, 8)],
        receive: &[(1, 11), (2, 11), (3, 9)],
        apb2: false,
    },
];

/// CR1: a word of nine bits, with its parity, which is odd.
const M: u32 = 1 << 12;
const PCE: u32 = 1 << 10;
const PS: u32 = 1 << 9;

#[derive(Default)]
pub struct Uart {
    pub(crate) sr: u32,
    pub(crate) brr: u32,
    pub(crate) cr1: u32,
    pub(crate) cr2: u32,
    pub(crate) cr3: u32,
    pub(crate) rdr: u32,
    pub(crate) tdr: Option<u8>,
    pub(crate) shift: Option<u8>,
    /// The wire was driven when the byte began.
    pub(crate) driven: bool,
    pub tx_at: u64,
    pub rx_at: u64,
    pub idle_at: u64,
    pub(crate) sr_read: bool,
    pub overruns: u64,
    pub disturbed: Disturbance,
    pub received: u64,
    pub(crate) rx_since: u64,
    pub longest: u64,
    pub longest_at: u64,
}

impl Uart {
    pub(crate) fn reset() -> Uart {
        Uart { sr: 0xc0, tx_at: NEVER, rx_at: NEVER, idle_at: NEVER, ..Uart::default() }
    }
}

impl Chip {
    pub(crate) fn uart_line(&self, n: usize) -> bool {
        let u = &self.uart[n];
        (u.sr & u.cr1 & 0xf0 != 0)
            || (u.sr & 8 != 0 && u.cr1 & 0x20 != 0)
            || (u.sr & 1 != 0 && u.cr1 & 0x100 != 0)
            || (u.sr & 0xe != 0 && u.cr3 & 0x41 == 0x41)
    }

    pub(crate) fn uart_baud(&self, n: usize) -> f64 {
        let hz = TPS as f64 / if UNITS[n].apb2 { self.pclk2 } else { self.pclk1 } as f64;
        let b = self.uart[n].brr;
        let div = if self.uart[n].cr1 & 0x8000 != 0 {
            f64::from((b >> 4) * 8 + (b & 7))
        } else {
            f64::from(b)
        };
        hz / div
    }

    pub(crate) fn uart_read(&mut self, n: usize, off: u32) -> u32 {
        let now = self.now;
        let u = &mut self.uart[n];
        if off == 4 && u.sr & 0x20 != 0 && now - u.rx_since > u.longest {
            u.longest = now - u.rx_since;
            u.longest_at = u.rx_since;
        }
        match off {
            0 => {
                u.sr_read = true;
                u.sr
            }
            4 => {
                u.sr &= !0x20;
                if u.sr_read {
                    u.sr &= !0x1f;
                    u.sr_read = false;
                }
                u.rdr
            }
            8 => u.brr,
            12 => u.cr1,
            16 => u.cr2,
            20 => u.cr3,
            _ => 0,
        }
    }

    pub(crate) fn uart_write(&mut self, n: usize, off: u32, v: u32) {
        match off {
            0 => self.uart[n].sr &= v | !0x360,
            4 => {
                if self.uart[n].cr1 & 0x2008 != 0x2008 {
                    return self.violation(format!(
                        "{}: byte written while the transmitter is off",
                        UNITS[n].name
                    ));
                }
                if self.uart[n].sr & 0x80 == 0 {
                    self.violation(format!(
                        "{}: byte written while TXE is 0: one is lost",
                        UNITS[n].name
                    ));
                }
                self.uart[n].sr &= !0x80;
                if self.uart[n].sr_read {
                    self.uart[n].sr &= !0x40;
                }
                self.uart[n].tdr = Some(v as u8);
                self.uart_load(n);
            }
            8 => {
                if self.uart[n].cr1 & 0x2000 != 0 && self.uart[n].tx_at != NEVER {
                    self.violation(format!("{}_BRR: changed while a byte goes out", UNITS[n].name));
                }
                self.uart[n].brr = v & 0xffff;
            }
            12 => {
                let old = self.uart[n].cr1;
                self.uart[n].cr1 = self.set(&format!("{}_CR1", UNITS[n].name), old, v, 0xbfff);
                if v & !old & 0x2000 != 0 || (v & 0x2000 != 0 && v & !old & 0xc != 0) {
                    let baud = self.uart_baud(n);
                    let (name, meant) = (UNITS[n].name, self.world.wires[n].baud);
                    let wrong = (baud / meant - 1.0) * 100.0;
                    self.say(
                        Grade::Fact,
                        format!("{name}: {baud:.0} Bd, {wrong:+.2} % off {meant:.0}"),
                    );
                    if wrong.abs() > 2.0 {
                        self.violation(format!("{name}: {baud:.0} Bd where {meant:.0} is meant"));
                    }
                }
                self.uart_listen(n);
            }
            16 => {
                let name = format!("{}_CR2", UNITS[n].name);
                self.uart[n].cr2 = self.set(&name, self.uart[n].cr2, v, 0x7f6f);
            }
            20 => {
                let name = format!("{}_CR3", UNITS[n].name);
                self.uart[n].cr3 = self.set(&name, self.uart[n].cr3, v, 0xfff);
                if n > 0 && v & 0xc0 != 0 {
                    self.say(Grade::Unmodelled, format!("{}: DMA", UNITS[n].name));
                }
                self.uart_dma_tx();
                self.uart_dma_rx();
            }
            _ => self.say(Grade::Unmodelled, format!("{}: write at {off:#x}", UNITS[n].name)),
        }
    }

    pub(crate) fn uart_load(&mut self, n: usize) {
        if self.uart[n].shift.is_some() {
            return;
        }
        let Some(b) = self.uart[n].tdr.take() else { return };
        if self.muxed(UNITS[n].transmit, 7).is_none() {
            self.violation(format!("{}: sends without a pin on AF7", UNITS[n].name));
        }
        self.uart[n].shift = Some(b);
        self.uart[n].sr = self.uart[n].sr & !0x40 | 0x80;
        self.uart[n].driven = self.drives(n);
        // RM0090 30.3.2 and 30.6.5: start bit, a word of 8 or 9, stop bits.
        let word = if self.uart[n].cr1 & M != 0 { 9.0 } else { 8.0 };
        let stop = [1.0, 0.5, 2.0, 1.5][(self.uart[n].cr2 >> 12 & 3) as usize];
        let bits = 1.0 + word + stop;
        self.uart[n].tx_at = self.now + (bits * TPS as f64 / self.uart_baud(n)) as u64;
    }

    /// Returns whether the bits sent reach the wire: a transceiver of RS-485 has to be switched to send.
    fn drives(&self, n: usize) -> bool {
        let Some((port, pin)) = self.world.wires[n].drive else { return true };
        self.pin_mode(port, pin) == 1 && self.gpio[port].odr >> pin & 1 != 0
    }

    /// Returns whether the unit takes the characters of the wire as they are meant (RM0090 30.3.7).
    fn agrees(&self, n: usize) -> bool {
        let settings = self.uart[n].cr1 & (M | PCE | PS);
        let meant = match self.world.wires[n].parity {
            Parity::None => 0,
            Parity::Even => M | PCE,
        };
        settings == meant && (self.uart_baud(n) / self.world.wires[n].baud - 1.0).abs() < 0.035
    }

    /// Asks the DMA for bytes as long as there is room (RM0090 30.3.13: TXE with DMAT is the request, a
    /// level: a stream that is switched on later finds it).
    pub(crate) fn uart_dma_tx(&mut self) {
        while self.uart[0].cr3 & 0x80 != 0 && self.uart[0].sr & 0x80 != 0 {
            if self.dma_request(1, 7, 4).is_none() {
                break;
            }
        }
    }

    /// Offers the DMA the byte that has come (RM0090 30.3.13: RXNE with DMAR).
    pub(crate) fn uart_dma_rx(&mut self) {
        if self.uart[0].cr3 & 0x40 != 0 && self.uart[0].sr & 0x20 != 0 {
            self.dma_request(1, 2, 4).or_else(|| self.dma_request(1, 5, 4));
        }
    }

    pub(crate) fn uart_tx_end(&mut self, n: usize) {
        self.uart[n].tx_at = NEVER;
        if let Some(b) = self.uart[n].shift.take() {
            if self.uart[n].driven && self.drives(n) {
                self.world.wires[n].hear(self.now, b);
            } else {
                let text =
                    format!("{}: a byte goes out while nothing drives the line", UNITS[n].name);
                self.say(Grade::Remark, text);
            }
        }
        if self.uart[n].tdr.is_some() {
            self.uart_load(n);
            if n == 0 {
                self.uart_dma_tx();
            }
        } else {
            self.uart[n].sr |= 0x40;
            self.world.wires[n].give();
        }
    }

    /// Plans the next byte that the host sends.
    pub(crate) fn uart_listen(&mut self, n: usize) {
        if self.uart[n].rx_at == NEVER
            && let Some(at) = self.world.wires[n].next_at()
        {
            let start = at.max(self.now);
            self.uart[n].rx_at = start + self.world.wires[n].character();
            if start < self.uart[n].idle_at {
                self.uart[n].idle_at = NEVER;
            }
        }
    }

    pub(crate) fn uart_rx_end(&mut self, n: usize) {
        self.uart[n].rx_at = NEVER;
        let Some(mut b) = self.world.wires[n].take() else { return };
        let mut disturbed = 0;
        if self.uart[n].disturbed.count > 0 {
            self.uart[n].disturbed.count -= 1;
            disturbed = self.uart[n].disturbed.flags;
            b = self.uart[n].disturbed.byte.unwrap_or(b);
        }
        if self.world.wires[n].drive.is_some() && self.drives(n) {
            let text = format!("{}: a byte of the host collides with the board's", UNITS[n].name);
            self.say(Grade::Remark, text);
        } else if self.uart[n].cr1 & 0x2004 == 0x2004 {
            if self.muxed(UNITS[n].receive, 7).is_none() {
                self.violation(format!("{}: receives without a pin on AF7", UNITS[n].name));
            }
            let agrees = self.agrees(n);
            if self.uart[n].sr & 0x20 != 0 {
                self.uart[n].sr |= 8;
                self.uart[n].overruns += 1;
                let text = format!("{}: overrun, a byte of the host is lost", UNITS[n].name);
                self.say(Grade::Remark, text);
            } else {
                // RM0090 30.6.2: with parity its bit is read above the data.
                let parity =
                    if self.uart[n].cr1 & (M | PCE) == M | PCE { b.count_ones() & 1 } else { 0 };
                let byte = if agrees { b } else { b ^ 0x55 };
                self.uart[n].rdr = u32::from(byte) | parity << 8;
                self.uart[n].sr |= 0x20 | disturbed | if agrees { 0 } else { 2 };
                self.uart[n].received += 1;
                self.uart[n].rx_since = self.now;
                if n == 0 {
                    self.uart_dma_rx();
                }
            }
        }
        // RM0090 30.3.1: idle is a whole frame of ones, unless the next start bit comes before.
        self.uart[n].idle_at = self.now + self.world.wires[n].character();
        self.uart_listen(n);
    }

    pub(crate) fn uart_idle(&mut self, n: usize) {
        self.uart[n].idle_at = NEVER;
        self.uart[n].sr |= 0x10;
    }
}
