//! The two DMA controllers: single transfers in direct mode, circular and double-buffered.

mod registers;

use super::{Chip, rcc::registers::RCC_AHB1ENR_DMA1EN_BIT};
use crate::{memory_map::*, report::Severity};
use registers::*;

#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct DmaStream {
    pub(crate) cr: u32,
    pub(crate) ndtr: u32,
    pub(crate) par: u32,
    pub(crate) m0: u32,
    pub(crate) m1: u32,
    pub(crate) fcr: u32,
    pub(crate) left: u32,
    pub(crate) at: u32,
}

/// A controller with its eight streams.
pub struct Dma {
    pub(crate) isr: [u32; 2],
    pub(crate) s: [DmaStream; 8],
    /// Items moved so far, by stream.
    pub transfers: [u64; 8],
    pub(crate) full_at: [u64; 8],
    /// From a full block to its flag being cleared, at the longest, by stream.
    pub longest: [u64; 8],
    /// When the block of `longest` was full, by stream.
    pub longest_at: [u64; 8],
}

impl Default for Dma {
    fn default() -> Dma {
        Dma {
            isr: [0; 2],
            s: [DmaStream { fcr: FCR_RESET, ..DmaStream::default() }; 8],
            transfers: [0; 8],
            full_at: [0; 8],
            longest: [0; 8],
            longest_at: [0; 8],
        }
    }
}

/// Positions of the flags of four streams in a status register (10.5.1).
const STREAM_FLAG_SHIFTS: [u32; 4] = [0, 6, 16, 22];
/// Interrupts of the streams of both controllers (table 62).
const STREAM_IRQ_NUMBERS: [[usize; 8]; 2] =
    [[11, 12, 13, 14, 15, 16, 17, 47], [56, 57, 58, 59, 60, 68, 69, 70]];

impl Chip {
    pub(crate) fn collect_dma_interrupt_lines(&self, want: &mut [bool; 82]) {
        for d in 0..2 {
            for n in 0..8 {
                let f = self.dma[d].isr[n / 4] >> STREAM_FLAG_SHIFTS[n % 4] & ISR_STREAM_MASK;
                let cr = self.dma[d].s[n].cr;
                let on = (f & ISR_DMEIF != 0 && cr & CR_DMEIE != 0)
                    || (f & ISR_TEIF != 0 && cr & CR_TEIE != 0)
                    || (f & ISR_HTIF != 0 && cr & CR_HTIE != 0)
                    || (f & ISR_TCIF != 0 && cr & CR_TCIE != 0)
                    || (f & ISR_FEIF != 0 && self.dma[d].s[n].fcr & FCR_FEIE != 0);
                want[STREAM_IRQ_NUMBERS[d][n]] |= on;
            }
        }
    }

    pub(crate) fn read_dma_register(&mut self, d: usize, off: u32) -> u32 {
        match off {
            LISR_OFFSET | HISR_OFFSET => self.dma[d].isr[off as usize / 4],
            LIFCR_OFFSET | HIFCR_OFFSET => 0,
            STREAMS_OFFSET..=STREAMS_LAST_OFFSET => {
                let s = self.dma[d].s[(off as usize - STREAMS_OFFSET as usize) / STREAM_STRIDE];
                [s.cr, s.left, s.par, s.m0, s.m1, s.fcr]
                    [(off as usize - STREAMS_OFFSET as usize) % STREAM_STRIDE / 4]
            }
            _ => 0,
        }
    }

    pub(crate) fn write_dma_register(&mut self, d: usize, off: u32, v: u32) {
        let name = |n: usize| format!("DMA{} stream {n}", d + 1);
        match off {
            LISR_OFFSET | HISR_OFFSET => {
                self.report_violation(format!("DMA{}: a status register written", d + 1))
            }
            LIFCR_OFFSET | HIFCR_OFFSET => {
                let i = (off as usize - LIFCR_OFFSET as usize) / 4;
                for n in 4 * i..4 * i + 4 {
                    if v & self.dma[d].isr[i] >> STREAM_FLAG_SHIFTS[n % 4]
                        << STREAM_FLAG_SHIFTS[n % 4]
                        & ISR_TCIF << STREAM_FLAG_SHIFTS[n % 4]
                        != 0
                    {
                        let wait = self.now - self.dma[d].full_at[n];
                        if wait > self.dma[d].longest[n] {
                            self.dma[d].longest[n] = wait;
                            self.dma[d].longest_at[n] = self.dma[d].full_at[n];
                        }
                    }
                }
                self.dma[d].isr[i] &= !v;
            }
            STREAMS_OFFSET..=STREAMS_LAST_OFFSET => {
                let n = (off as usize - STREAMS_OFFSET as usize) / STREAM_STRIDE;
                let s = self.dma[d].s[n];
                let on = s.cr & CR_EN != 0;
                let reg = (off as usize - STREAMS_OFFSET as usize) % STREAM_STRIDE / 4;
                match reg {
                    0 => {
                        if on && (s.cr ^ v) & CR_SETTINGS_MASK != 0 {
                            self.report_violation(format!(
                                "{}: settings {:#x} changed while it is on",
                                name(n),
                                (s.cr ^ v) & CR_SETTINGS_MASK
                            ));
                        }
                        if v & CR_RESERVED_MASK != 0 {
                            self.report_violation(format!(
                                "{}: reserved bits set in CR ({v:#x})",
                                name(n)
                            ));
                        }
                        let s = &mut self.dma[d].s[n];
                        s.cr = v & CR_MASK;
                        if v & CR_EN != 0 && !on {
                            s.left = s.ndtr;
                            s.at = 0;
                            self.start_dma_stream(d, n);
                            // Requests are levels: what waits is served at once.
                            self.request_uart_tx_dma();
                            self.request_uart_rx_dma();
                        } else if v & CR_EN == 0 && on {
                            // RM0090 10.3.14: switching a stream off ends it, and says so.
                            self.dma[d].isr[n / 4] |= ISR_TCIF << STREAM_FLAG_SHIFTS[n % 4];
                        }
                    }
                    1 | 2 if on => self.report_violation(format!(
                        "{}: NDTR or PAR written while it is on",
                        name(n)
                    )),
                    1 => {
                        self.dma[d].s[n].ndtr = v & NDTR_MASK;
                        self.dma[d].s[n].left = v & NDTR_MASK
                    }
                    2 => self.dma[d].s[n].par = v,
                    3 | 4 => {
                        let ct = s.cr >> CR_CT_BIT & 1;
                        if on && (s.cr & CR_DBM == 0 || ct == reg as u32 - 3) {
                            self.report_violation(format!(
                                "{}: M{}AR written while the stream uses it",
                                name(n),
                                reg - 3
                            ));
                            return;
                        }
                        if reg == 3 { self.dma[d].s[n].m0 = v } else { self.dma[d].s[n].m1 = v }
                    }
                    _ => {
                        self.dma[d].s[n].fcr =
                            v & FCR_MASK & !FCR_FS | self.dma[d].s[n].fcr & FCR_FS
                    }
                }
            }
            _ => self.report_violation(format!("DMA{}: write at {off:#x}", d + 1)),
        }
    }

    pub(crate) fn start_dma_stream(&mut self, d: usize, n: usize) {
        let s = self.dma[d].s[n];
        let name = format!("DMA{} stream {n}", d + 1);
        if self.dma[d].isr[n / 4] >> STREAM_FLAG_SHIFTS[n % 4] & ISR_STREAM_MASK != 0 {
            self.report_violation(format!(
                "{name}: switched on with flags of the last transfer still set"
            ));
        }
        let (psize, msize) = (
            1u32 << (s.cr >> CR_PSIZE_SHIFT & CR_SIZE_MASK),
            1u32 << (s.cr >> CR_MSIZE_SHIFT & CR_SIZE_MASK),
        );
        if s.fcr & FCR_DMDIS == 0 && psize != msize {
            self.record_finding(
                Severity::Remark,
                format!("{name}: direct mode takes PSIZE for MSIZE"),
            );
        }
        if s.ndtr == 0 {
            self.report_violation(format!("{name}: switched on with NDTR 0"));
        }
        let buffers: &[u32] = if s.cr & CR_DBM != 0 { &[s.m0, s.m1] } else { &[s.m0] };
        for m in buffers {
            if m % psize != 0 {
                self.report_violation(format!(
                    "{name}: buffer {m:#010x} is not aligned to {psize}"
                ));
            }
            let len = s.ndtr * psize;
            if !(SRAM_BASE..SRAM_END).contains(m) || m + len > SRAM_END {
                self.record_finding(
                    Severity::Violation,
                    format!(
                        "{name}: buffer {m:#010x} of {len} bytes is not in the SRAM that it reaches"
                    ),
                );
            }
        }
        self.record_finding(
            Severity::Fact,
            format!(
                "{name}: channel {}, {} items of {psize} bytes, {:#010x} -> {}{}",
                s.cr >> CR_CHSEL_SHIFT & CR_CHSEL_MASK,
                s.ndtr,
                s.par,
                buffers.iter().map(|b| format!("{b:#010x}")).collect::<Vec<_>>().join(" and "),
                if s.cr & CR_DBM != 0 {
                    ", double buffer"
                } else if s.cr & CR_CIRC != 0 {
                    ", circular"
                } else {
                    ""
                }
            ),
        );
    }

    /// 10.3.18: a transfer error raises TEIF and switches the stream off.
    pub(crate) fn raise_dma_transfer_error(&mut self, d: usize, n: usize) {
        self.dma[d].isr[n / 4] |= ISR_TEIF << STREAM_FLAG_SHIFTS[n % 4];
        self.dma[d].s[n].cr &= !CR_EN;
    }

    /// Serves one request of a peripheral. Returns `None` if no stream listens, else whether it was the last item.
    pub(crate) fn serve_dma_request(&mut self, d: usize, n: usize, channel: u32) -> Option<bool> {
        let s = self.dma[d].s[n];
        if self.faults.serial_dma_stuck && (d, channel) == (1, 4) {
            return None;
        }
        if s.cr & CR_EN == 0
            || s.cr >> CR_CHSEL_SHIFT & CR_CHSEL_MASK != channel
            || self.rcc.enr[0] >> (RCC_AHB1ENR_DMA1EN_BIT + d) & 1 == 0
        {
            return None;
        }
        let size = 1u32 << (s.cr >> CR_PSIZE_SHIFT & CR_SIZE_MASK);
        let base = if s.cr & CR_DBM != 0 && s.cr & CR_CT != 0 { s.m1 } else { s.m0 };
        let memory = base + if s.cr & CR_MINC != 0 { s.at * size } else { 0 };
        let bytes = size as usize;
        let reachable = (SRAM_BASE..SRAM_END).contains(&memory)
            || (s.cr >> CR_DIR_SHIFT & CR_DIR_MASK == DIR_MEMORY_TO_PERIPHERAL
                && (FLASH_BASE..FLASH_END).contains(&memory));
        if !reachable {
            // A transfer error: RM0090 10.3.18.
            self.report_violation(format!(
                "DMA{} stream {n}: transfer error at {memory:#010x}",
                d + 1
            ));
            self.raise_dma_transfer_error(d, n);
            return Some(true);
        }
        match s.cr >> CR_DIR_SHIFT & CR_DIR_MASK {
            DIR_PERIPHERAL_TO_MEMORY => {
                let v = self.read_register(s.par & !3).to_le_bytes();
                self.sram
                    .write_at(u64::from(memory - SRAM_BASE), &v[..bytes])
                    .expect("in the SRAM");
            }
            DIR_MEMORY_TO_PERIPHERAL => {
                let mut v = [0; 4];
                if memory >= SRAM_BASE {
                    self.sram
                        .read_at(u64::from(memory - SRAM_BASE), &mut v[..bytes])
                        .expect("in the SRAM");
                } else {
                    self.rom
                        .read_at(u64::from(memory - FLASH_BASE), &mut v[..bytes])
                        .expect("in the flash");
                }
                self.write_register(s.par & !3, u32::from_le_bytes(v));
            }
            _ => self.report_violation(
                "DMA: a peripheral's request on a memory-to-memory stream".into(),
            ),
        }
        self.dma[d].transfers[n] += 1;
        let s = &mut self.dma[d].s[n];
        s.at += 1;
        s.left -= 1;
        let (left, all) = (s.left, s.ndtr);
        let flag = &mut self.dma[d].isr[n / 4];
        if left == all / 2 {
            *flag |= ISR_HTIF << STREAM_FLAG_SHIFTS[n % 4];
        }
        if left > 0 {
            return Some(false);
        }
        let before = *flag >> STREAM_FLAG_SHIFTS[n % 4] & ISR_TCIF;
        *flag |= ISR_TCIF << STREAM_FLAG_SHIFTS[n % 4];
        self.dma[d].full_at[n] = self.now;
        let s = &mut self.dma[d].s[n];
        s.at = 0;
        if s.cr & CR_DBM != 0 {
            s.cr ^= CR_CT;
            s.left = s.ndtr;
        } else if s.cr & CR_CIRC != 0 {
            s.left = s.ndtr;
        } else {
            s.cr &= !CR_EN;
        }
        if before != 0 && s.cr & CR_EN != 0 {
            self.record_finding(
                Severity::Remark,
                format!(
                    "DMA{} stream {n}: a block was full before the last one's flag was cleared",
                    d + 1
                ),
            );
        }
        Some(true)
    }
}
