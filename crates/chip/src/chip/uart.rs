//! USART1, asynchronous, eight bits.

use super::{Chip, upset::Disturbance};
use crate::{
    report::Grade,
    time::{NEVER, TPS},
};

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
    pub(crate) fn uart_line(&self) -> bool {
        let u = &self.uart;
        (u.sr & u.cr1 & 0xf0 != 0)
            || (u.sr & 8 != 0 && u.cr1 & 0x20 != 0)
            || (u.sr & 1 != 0 && u.cr1 & 0x100 != 0)
            || (u.sr & 0xe != 0 && u.cr3 & 0x41 == 0x41)
    }

    pub(crate) fn uart_baud(&self) -> f64 {
        let hz = TPS as f64 / self.pclk2 as f64;
        let b = self.uart.brr;
        let div = if self.uart.cr1 & 0x8000 != 0 {
            f64::from((b >> 4) * 8 + (b & 7))
        } else {
            f64::from(b)
        };
        hz / div
    }

    pub(crate) fn uart_read(&mut self, off: u32) -> u32 {
        let now = self.now;
        let u = &mut self.uart;
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

    pub(crate) fn uart_write(&mut self, off: u32, v: u32) {
        match off {
            0 => self.uart.sr &= v | !0x360,
            4 => {
                if self.uart.cr1 & 0x2008 != 0x2008 {
                    return self
                        .violation("USART1: byte written while the transmitter is off".into());
                }
                if self.uart.sr & 0x80 == 0 {
                    self.violation("USART1: byte written while TXE is 0: one is lost".into());
                }
                self.uart.sr &= !0x80;
                if self.uart.sr_read {
                    self.uart.sr &= !0x40;
                }
                self.uart.tdr = Some(v as u8);
                self.uart_load();
            }
            8 => {
                if self.uart.cr1 & 0x2000 != 0 && self.uart.tx_at != NEVER {
                    self.violation("USART1_BRR: changed while a byte goes out".into());
                }
                self.uart.brr = v & 0xffff;
            }
            12 => {
                let old = self.uart.cr1;
                self.uart.cr1 = self.set("USART1_CR1", old, v, 0xbfff);
                if v & !old & 0x2000 != 0 || (v & 0x2000 != 0 && v & !old & 0xc != 0) {
                    let baud = self.uart_baud();
                    let wrong = (baud / self.world.baud - 1.0) * 100.0;
                    self.say(
                        Grade::Fact,
                        format!("USART1: {baud:.0} Bd, {wrong:+.2} % off {:.0}", self.world.baud),
                    );
                    if wrong.abs() > 2.0 {
                        self.violation(format!(
                            "USART1: {baud:.0} Bd where {:.0} is meant",
                            self.world.baud
                        ));
                    }
                }
                self.uart_listen();
            }
            16 => self.uart.cr2 = self.set("USART1_CR2", self.uart.cr2, v, 0x7f6f),
            20 => {
                self.uart.cr3 = self.set("USART1_CR3", self.uart.cr3, v, 0xfff);
                self.uart_dma_tx();
                self.uart_dma_rx();
            }
            _ => self.say(Grade::Unmodelled, format!("USART1: write at {off:#x}")),
        }
    }

    pub(crate) fn uart_load(&mut self) {
        if self.uart.shift.is_some() {
            return;
        }
        let Some(b) = self.uart.tdr.take() else { return };
        if self.muxed(&[(0, 9), (1, 6)], 7).is_none() {
            self.violation("USART1: sends without a pin on AF7".into());
        }
        self.uart.shift = Some(b);
        self.uart.sr = self.uart.sr & !0x40 | 0x80;
        self.uart.tx_at = self.now + (10.0 * TPS as f64 / self.uart_baud()) as u64;
    }

    /// Asks the DMA for bytes as long as there is room (RM0090 30.3.13: TXE with DMAT is the request, a
    /// level: a stream that is switched on later finds it).
    pub(crate) fn uart_dma_tx(&mut self) {
        while self.uart.cr3 & 0x80 != 0 && self.uart.sr & 0x80 != 0 {
            if self.dma_request(1, 7, 4).is_none() {
                break;
            }
        }
    }

    /// Offers the DMA the byte that has come (RM0090 30.3.13: RXNE with DMAR).
    pub(crate) fn uart_dma_rx(&mut self) {
        if self.uart.cr3 & 0x40 != 0 && self.uart.sr & 0x20 != 0 {
            self.dma_request(1, 2, 4).or_else(|| self.dma_request(1, 5, 4));
        }
    }

    pub(crate) fn uart_tx_end(&mut self) {
        self.uart.tx_at = NEVER;
        if let Some(b) = self.uart.shift.take() {
            self.world.byte(self.now, b);
        }
        if self.uart.tdr.is_some() {
            self.uart_load();
            self.uart_dma_tx();
        } else {
            self.uart.sr |= 0x40;
        }
    }

    /// Plans the next byte that the host sends.
    pub(crate) fn uart_listen(&mut self) {
        if self.uart.rx_at == NEVER
            && let Some(at) = self.world.byte_at(self.now)
        {
            let start = at.max(self.now);
            self.uart.rx_at = start + (10.0 * TPS as f64 / self.world.baud) as u64;
            if start < self.uart.idle_at {
                self.uart.idle_at = NEVER;
            }
        }
    }

    pub(crate) fn uart_rx_end(&mut self) {
        self.uart.rx_at = NEVER;
        let Some(mut b) = self.world.byte_take() else { return };
        let mut disturbed = 0;
        if self.uart.disturbed.count > 0 {
            self.uart.disturbed.count -= 1;
            disturbed = self.uart.disturbed.flags;
            b = self.uart.disturbed.byte.unwrap_or(b);
        }
        if self.uart.cr1 & 0x2004 == 0x2004 {
            if self.muxed(&[(0, 10), (1, 7)], 7).is_none() {
                self.violation("USART1: receives without a pin on AF7".into());
            }
            let off = (self.uart_baud() / self.world.baud - 1.0).abs();
            if self.uart.sr & 0x20 != 0 {
                self.uart.sr |= 8;
                self.uart.overruns += 1;
                self.say(Grade::Remark, "USART1: overrun, a byte of the host is lost".into());
            } else {
                self.uart.rdr = u32::from(if off < 0.035 { b } else { b ^ 0x55 });
                self.uart.sr |= 0x20 | disturbed | if off < 0.035 { 0 } else { 2 };
                self.uart.received += 1;
                self.uart.rx_since = self.now;
                self.uart_dma_rx();
            }
        }
        // RM0090 30.3.3: idle is a whole frame of ones, unless the next start bit comes before.
        self.uart.idle_at = self.now + (10.0 * TPS as f64 / self.world.baud) as u64;
        self.uart_listen();
    }

    pub(crate) fn uart_idle(&mut self) {
        self.uart.idle_at = NEVER;
        self.uart.sr |= 0x10;
    }
}
