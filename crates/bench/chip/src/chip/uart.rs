//! USART1 and USART3, asynchronous, with parity or without.

pub(super) mod registers;

use super::{Chip, fault_injection::SerialDisturbance, gpio::registers::MODE_OUTPUT};
use crate::{
    report::Severity,
    serial_line::Parity,
    simulation_time::{NEVER, TICKS_PER_SECOND},
};
use registers::*;

/// A unit as RM0090 (tables 1 and 62) and DS8626 (alternate functions, AF7) place it.
pub(crate) struct UartInstance {
    name: &'static str,
    transmit: &'static [(usize, u32)],
    receive: &'static [(usize, u32)],
    apb2: bool,
}

/// The units that are modelled; the wire of the same number is behind it.
pub(crate) const MODELLED_UARTS: [UartInstance; 2] = [
    UartInstance {
        name: "USART1",
        transmit: &[(0, 9), (1, 6)],
        receive: &[(0, 10), (1, 7)],
        apb2: true,
    },
    UartInstance {
        name: "USART3",
        transmit: &[(1, 10), (2, 10), (3, 8)],
        receive: &[(1, 11), (2, 11), (3, 9)],
        apb2: false,
    },
];

/// Bits by which a byte differs that the receiver samples at the wrong rate or format: a choice of the model.
const SETTINGS_MISMATCH_PATTERN: u8 = 0x55;

/// The registers of a unit and the characters under way.
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
    /// When the character that goes out ends; NEVER: none does.
    pub tx_at: u64,
    /// When the character that comes in ends; NEVER: none does.
    pub rx_at: u64,
    /// When the line has been idle for a frame; NEVER: not yet predicted.
    pub idle_at: u64,
    pub(crate) sr_read: bool,
    /// Characters lost because the last one was not yet read.
    pub overruns: u64,
    /// The disturbance of the characters to come.
    pub disturbed: SerialDisturbance,
    /// Characters received so far.
    pub received: u64,
    pub(crate) rx_since: u64,
    /// The longest that a character waited to be read, in ticks.
    pub longest: u64,
    /// When the character of `longest` came.
    pub longest_at: u64,
}

impl Uart {
    pub(crate) fn after_reset() -> Uart {
        Uart { sr: SR_RESET, tx_at: NEVER, rx_at: NEVER, idle_at: NEVER, ..Uart::default() }
    }
}

impl Chip {
    pub(crate) fn is_uart_irq_asserted(&self, n: usize) -> bool {
        let u = &self.uart[n];
        (u.sr & u.cr1 & CR1_FLAG_ENABLES != 0)
            || (u.sr & SR_ORE != 0 && u.cr1 & CR1_RXNEIE != 0)
            || (u.sr & SR_PE != 0 && u.cr1 & CR1_PEIE != 0)
            || (u.sr & SR_ERROR_MASK != 0 && u.cr3 & (CR3_DMAR | CR3_EIE) == CR3_DMAR | CR3_EIE)
    }

    pub(crate) fn uart_baud_rate(&self, n: usize) -> f64 {
        let hz = TICKS_PER_SECOND as f64
            / if MODELLED_UARTS[n].apb2 { self.pclk2 } else { self.pclk1 } as f64;
        let b = self.uart[n].brr;
        let div = if self.uart[n].cr1 & CR1_OVER8 != 0 {
            f64::from((b >> 4) * 8 + (b & BRR_FRACTION_OVER8_MASK))
        } else {
            f64::from(b)
        };
        hz / div
    }

    pub(crate) fn read_uart_register(&mut self, n: usize, off: u32) -> u32 {
        let now = self.now;
        let u = &mut self.uart[n];
        if off == DR_OFFSET && u.sr & SR_RXNE != 0 && now - u.rx_since > u.longest {
            u.longest = now - u.rx_since;
            u.longest_at = u.rx_since;
        }
        match off {
            SR_OFFSET => {
                u.sr_read = true;
                u.sr
            }
            DR_OFFSET => {
                u.sr &= !SR_RXNE;
                if u.sr_read {
                    u.sr &= !SR_CLEARED_BY_READ;
                    u.sr_read = false;
                }
                u.rdr
            }
            BRR_OFFSET => u.brr,
            CR1_OFFSET => u.cr1,
            CR2_OFFSET => u.cr2,
            CR3_OFFSET => u.cr3,
            _ => 0,
        }
    }

    pub(crate) fn write_uart_register(&mut self, n: usize, off: u32, v: u32) {
        match off {
            SR_OFFSET => self.uart[n].sr &= v | !SR_CLEARED_BY_ZERO,
            DR_OFFSET => {
                if self.uart[n].cr1 & (CR1_UE | CR1_TE) != CR1_UE | CR1_TE {
                    return self.report_violation(format!(
                        "{}: byte written while the transmitter is off",
                        MODELLED_UARTS[n].name
                    ));
                }
                if self.uart[n].sr & SR_TXE == 0 {
                    self.report_violation(format!(
                        "{}: byte written while TXE is 0: one is lost",
                        MODELLED_UARTS[n].name
                    ));
                }
                self.uart[n].sr &= !SR_TXE;
                if self.uart[n].sr_read {
                    self.uart[n].sr &= !SR_TC;
                }
                self.uart[n].tdr = Some(v as u8);
                self.load_uart_shift_register(n);
            }
            BRR_OFFSET => {
                if self.uart[n].cr1 & CR1_UE != 0 && self.uart[n].tx_at != NEVER {
                    self.report_violation(format!(
                        "{}_BRR: changed while a byte goes out",
                        MODELLED_UARTS[n].name
                    ));
                }
                self.uart[n].brr = v & BRR_MASK;
            }
            CR1_OFFSET => {
                let old = self.uart[n].cr1;
                self.uart[n].cr1 = self.apply_write_mask(
                    &format!("{}_CR1", MODELLED_UARTS[n].name),
                    old,
                    v,
                    CR1_WRITE_MASK,
                );
                if v & !old & CR1_UE != 0 || (v & CR1_UE != 0 && v & !old & (CR1_TE | CR1_RE) != 0)
                {
                    let baud = self.uart_baud_rate(n);
                    let (name, meant) = (MODELLED_UARTS[n].name, self.world.wires[n].baud);
                    let wrong = (baud / meant - 1.0) * 100.0;
                    self.record_finding(
                        Severity::Fact,
                        format!("{name}: {baud:.0} Bd, {wrong:+.2} % off {meant:.0}"),
                    );
                    if wrong.abs() > 2.0 {
                        self.report_violation(format!(
                            "{name}: {baud:.0} Bd where {meant:.0} is meant"
                        ));
                    }
                }
                self.schedule_uart_reception(n);
            }
            CR2_OFFSET => {
                let name = format!("{}_CR2", MODELLED_UARTS[n].name);
                self.uart[n].cr2 =
                    self.apply_write_mask(&name, self.uart[n].cr2, v, CR2_WRITE_MASK);
            }
            CR3_OFFSET => {
                let name = format!("{}_CR3", MODELLED_UARTS[n].name);
                self.uart[n].cr3 =
                    self.apply_write_mask(&name, self.uart[n].cr3, v, CR3_WRITE_MASK);
                if n > 0 && v & (CR3_DMAT | CR3_DMAR) != 0 {
                    self.record_finding(
                        Severity::Unmodelled,
                        format!("{}: DMA", MODELLED_UARTS[n].name),
                    );
                }
                self.request_uart_tx_dma();
                self.request_uart_rx_dma();
            }
            _ => self.record_finding(
                Severity::Unmodelled,
                format!("{}: write at {off:#x}", MODELLED_UARTS[n].name),
            ),
        }
    }

    pub(crate) fn load_uart_shift_register(&mut self, n: usize) {
        if self.uart[n].shift.is_some() {
            return;
        }
        let Some(b) = self.uart[n].tdr.take() else { return };
        if self.find_pin_with_alternate_function(MODELLED_UARTS[n].transmit, 7).is_none() {
            self.report_violation(format!(
                "{}: sends without a pin on AF7",
                MODELLED_UARTS[n].name
            ));
        }
        self.uart[n].shift = Some(b);
        self.uart[n].sr = self.uart[n].sr & !SR_TC | SR_TXE;
        self.uart[n].driven = self.is_uart_driver_enabled(n);
        // RM0090 30.3.2 and 30.6.5: start bit, a word of 8 or 9, stop bits.
        let word = if self.uart[n].cr1 & CR1_M != 0 { 9.0 } else { 8.0 };
        let stop =
            [1.0, 0.5, 2.0, 1.5][(self.uart[n].cr2 >> CR2_STOP_SHIFT & CR2_STOP_MASK) as usize];
        let bits = 1.0 + word + stop;
        self.uart[n].tx_at =
            self.now + (bits * TICKS_PER_SECOND as f64 / self.uart_baud_rate(n)) as u64;
    }

    /// Returns whether the bits sent reach the wire: a transceiver of RS-485 has to be switched to send.
    fn is_uart_driver_enabled(&self, n: usize) -> bool {
        let Some((port, pin)) = self.world.wires[n].drive else { return true };
        self.pin_mode(port, pin) == MODE_OUTPUT && self.gpio[port].odr >> pin & 1 != 0
    }

    /// Returns whether the unit takes the characters of the wire as they are meant (RM0090 30.3.7).
    fn has_matching_uart_settings(&self, n: usize) -> bool {
        let settings = self.uart[n].cr1 & (CR1_M | CR1_PCE | CR1_PS);
        let meant = match self.world.wires[n].parity {
            Parity::None => 0,
            Parity::Even => CR1_M | CR1_PCE,
        };
        settings == meant && (self.uart_baud_rate(n) / self.world.wires[n].baud - 1.0).abs() < 0.035
    }

    /// Asks the DMA for bytes as long as there is room (RM0090 30.3.13: TXE with DMAT is the request, a
    /// level: a stream that is switched on later finds it).
    pub(crate) fn request_uart_tx_dma(&mut self) {
        while self.uart[0].cr3 & CR3_DMAT != 0 && self.uart[0].sr & SR_TXE != 0 {
            if self.serve_dma_request(1, 7, 4).is_none() {
                break;
            }
        }
    }

    /// Offers the DMA the byte that has come (RM0090 30.3.13: RXNE with DMAR).
    pub(crate) fn request_uart_rx_dma(&mut self) {
        if self.uart[0].cr3 & CR3_DMAR != 0 && self.uart[0].sr & SR_RXNE != 0 {
            self.serve_dma_request(1, 2, 4).or_else(|| self.serve_dma_request(1, 5, 4));
        }
    }

    pub(crate) fn finish_uart_transmission(&mut self, n: usize) {
        self.uart[n].tx_at = NEVER;
        if let Some(b) = self.uart[n].shift.take() {
            if self.uart[n].driven && self.is_uart_driver_enabled(n) {
                self.world.wires[n].push_byte_from_board(self.now, b);
            } else {
                let text = format!(
                    "{}: a byte goes out while nothing drives the line",
                    MODELLED_UARTS[n].name
                );
                self.record_finding(Severity::Remark, text);
            }
        }
        if self.uart[n].tdr.is_some() {
            self.load_uart_shift_register(n);
            if n == 0 {
                self.request_uart_tx_dma();
            }
        } else {
            self.uart[n].sr |= SR_TC;
            self.world.wires[n].flush_to_client();
        }
    }

    /// Plans the next byte that the host sends.
    pub(crate) fn schedule_uart_reception(&mut self, n: usize) {
        if self.uart[n].rx_at == NEVER
            && let Some(at) = self.world.wires[n].next_host_byte_time()
        {
            let start = at.max(self.now);
            self.uart[n].rx_at = start + self.world.wires[n].character_ticks();
            if start < self.uart[n].idle_at {
                self.uart[n].idle_at = NEVER;
            }
        }
    }

    pub(crate) fn finish_uart_reception(&mut self, n: usize) {
        self.uart[n].rx_at = NEVER;
        let Some(mut b) = self.world.wires[n].pop_host_byte() else { return };
        let mut disturbed = 0;
        if self.uart[n].disturbed.count > 0 {
            self.uart[n].disturbed.count -= 1;
            disturbed = self.uart[n].disturbed.flags;
            b = self.uart[n].disturbed.byte.unwrap_or(b);
        }
        if self.world.wires[n].drive.is_some() && self.is_uart_driver_enabled(n) {
            let text =
                format!("{}: a byte of the host collides with the board's", MODELLED_UARTS[n].name);
            self.record_finding(Severity::Remark, text);
        } else if self.uart[n].cr1 & (CR1_UE | CR1_RE) == CR1_UE | CR1_RE {
            if self.find_pin_with_alternate_function(MODELLED_UARTS[n].receive, 7).is_none() {
                self.report_violation(format!(
                    "{}: receives without a pin on AF7",
                    MODELLED_UARTS[n].name
                ));
            }
            let agrees = self.has_matching_uart_settings(n);
            if self.uart[n].sr & SR_RXNE != 0 {
                self.uart[n].sr |= SR_ORE;
                self.uart[n].overruns += 1;
                let text =
                    format!("{}: overrun, a byte of the host is lost", MODELLED_UARTS[n].name);
                self.record_finding(Severity::Remark, text);
            } else {
                // RM0090 30.6.2: with parity its bit is read above the data.
                let parity = if self.uart[n].cr1 & (CR1_M | CR1_PCE) == CR1_M | CR1_PCE {
                    b.count_ones() & 1
                } else {
                    0
                };
                let byte = if agrees { b } else { b ^ SETTINGS_MISMATCH_PATTERN };
                self.uart[n].rdr = u32::from(byte) | parity << 8;
                self.uart[n].sr |= SR_RXNE | disturbed | if agrees { 0 } else { SR_FE };
                self.uart[n].received += 1;
                self.uart[n].rx_since = self.now;
                if n == 0 {
                    self.request_uart_rx_dma();
                }
            }
        }
        // RM0090 30.3.1: idle is a whole frame of ones, unless the next start bit comes before.
        self.uart[n].idle_at = self.now + self.world.wires[n].character_ticks();
        self.schedule_uart_reception(n);
    }

    pub(crate) fn handle_uart_idle(&mut self, n: usize) {
        self.uart[n].idle_at = NEVER;
        self.uart[n].sr |= SR_IDLE;
    }
}
