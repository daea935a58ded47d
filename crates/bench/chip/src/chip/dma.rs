//! The two DMA controllers: single transfers in direct mode, circular and double-buffered.

use super::Chip;
use crate::report::Grade;

#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct Stream {
    pub(crate) cr: u32,
    pub(crate) ndtr: u32,
    pub(crate) par: u32,
    pub(crate) m0: u32,
    pub(crate) m1: u32,
    pub(crate) fcr: u32,
    pub(crate) left: u32,
    pub(crate) at: u32,
}

pub struct Dma {
    pub(crate) isr: [u32; 2],
    pub(crate) s: [Stream; 8],
    pub transfers: [u64; 8],
    pub(crate) full_at: [u64; 8],
    /// From a full block to its flag being cleared, at the longest, by stream.
    pub longest: [u64; 8],
    pub longest_at: [u64; 8],
}

impl Default for Dma {
    fn default() -> Dma {
        Dma {
            isr: [0; 2],
            s: [Stream { fcr: 0x21, ..Stream::default() }; 8],
            transfers: [0; 8],
            full_at: [0; 8],
            longest: [0; 8],
            longest_at: [0; 8],
        }
    }
}

const SHIFT: [u32; 4] = [0, 6, 16, 22];
const LINES: [[usize; 8]; 2] = [[11, 12, 13, 14, 15, 16, 17, 47], [56, 57, 58, 59, 60, 68, 69, 70]];

impl Chip {
    pub(crate) fn dma_lines(&self, want: &mut [bool; 82]) {
        for d in 0..2 {
            for n in 0..8 {
                let f = self.dma[d].isr[n / 4] >> SHIFT[n % 4] & 0x3d;
                let cr = self.dma[d].s[n].cr;
                let on = (f & 4 != 0 && cr & 2 != 0)
                    || (f & 8 != 0 && cr & 4 != 0)
                    || (f & 16 != 0 && cr & 8 != 0)
                    || (f & 32 != 0 && cr & 16 != 0)
                    || (f & 1 != 0 && self.dma[d].s[n].fcr & 0x80 != 0);
                want[LINES[d][n]] |= on;
            }
        }
    }

    pub(crate) fn dma_read(&mut self, d: usize, off: u32) -> u32 {
        match off {
            0 | 4 => self.dma[d].isr[off as usize / 4],
            8 | 12 => 0,
            0x10..=0xcc => {
                let s = self.dma[d].s[(off as usize - 0x10) / 0x18];
                [s.cr, s.left, s.par, s.m0, s.m1, s.fcr][(off as usize - 0x10) % 0x18 / 4]
            }
            _ => 0,
        }
    }

    pub(crate) fn dma_write(&mut self, d: usize, off: u32, v: u32) {
        let name = |n: usize| format!("DMA{} stream {n}", d + 1);
        match off {
            0 | 4 => self.violation(format!("DMA{}: a status register written", d + 1)),
            8 | 12 => {
                let i = (off as usize - 8) / 4;
                for n in 4 * i..4 * i + 4 {
                    if v & self.dma[d].isr[i] >> SHIFT[n % 4] << SHIFT[n % 4] & 32 << SHIFT[n % 4]
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
            0x10..=0xcc => {
                let n = (off as usize - 0x10) / 0x18;
                let s = self.dma[d].s[n];
                let on = s.cr & 1 != 0;
                let reg = (off as usize - 0x10) % 0x18 / 4;
                match reg {
                    0 => {
                        if on && (s.cr ^ v) & 0x0ff7_ffe0 != 0 {
                            self.violation(format!(
                                "{}: settings {:#x} changed while it is on",
                                name(n),
                                (s.cr ^ v) & 0x0ff7_ffe0
                            ));
                        }
                        if v & 0xf010_0000 != 0 {
                            self.violation(format!(
                                "{}: reserved bits set in CR ({v:#x})",
                                name(n)
                            ));
                        }
                        let s = &mut self.dma[d].s[n];
                        s.cr = v & 0x0fef_ffff;
                        if v & 1 != 0 && !on {
                            s.left = s.ndtr;
                            s.at = 0;
                            self.dma_start(d, n);
                            // Requests are levels: what waits is served at once.
                            self.uart_dma_tx();
                            self.uart_dma_rx();
                        } else if v & 1 == 0 && on {
                            // RM0090 10.3.14: switching a stream off ends it, and says so.
                            self.dma[d].isr[n / 4] |= 32 << SHIFT[n % 4];
                        }
                    }
                    1 | 2 if on => {
                        self.violation(format!("{}: NDTR or PAR written while it is on", name(n)))
                    }
                    1 => {
                        self.dma[d].s[n].ndtr = v & 0xffff;
                        self.dma[d].s[n].left = v & 0xffff
                    }
                    2 => self.dma[d].s[n].par = v,
                    3 | 4 => {
                        let ct = s.cr >> 19 & 1;
                        if on && (s.cr & 1 << 18 == 0 || ct == reg as u32 - 3) {
                            self.violation(format!(
                                "{}: M{}AR written while the stream uses it",
                                name(n),
                                reg - 3
                            ));
                            return;
                        }
                        if reg == 3 { self.dma[d].s[n].m0 = v } else { self.dma[d].s[n].m1 = v }
                    }
                    _ => self.dma[d].s[n].fcr = v & 0xbf & !0x38 | self.dma[d].s[n].fcr & 0x38,
                }
            }
            _ => self.violation(format!("DMA{}: write at {off:#x}", d + 1)),
        }
    }

    pub(crate) fn dma_start(&mut self, d: usize, n: usize) {
        let s = self.dma[d].s[n];
        let name = format!("DMA{} stream {n}", d + 1);
        if self.dma[d].isr[n / 4] >> SHIFT[n % 4] & 0x3d != 0 {
            self.violation(format!(
                "{name}: switched on with flags of the last transfer still set"
            ));
        }
        let (psize, msize) = (1u32 << (s.cr >> 11 & 3), 1u32 << (s.cr >> 13 & 3));
        if s.fcr & 4 == 0 && psize != msize {
            self.say(Grade::Remark, format!("{name}: direct mode takes PSIZE for MSIZE"));
        }
        if s.ndtr == 0 {
            self.violation(format!("{name}: switched on with NDTR 0"));
        }
        let buffers: &[u32] = if s.cr & 1 << 18 != 0 { &[s.m0, s.m1] } else { &[s.m0] };
        for m in buffers {
            if m % psize != 0 {
                self.violation(format!("{name}: buffer {m:#010x} is not aligned to {psize}"));
            }
            let len = s.ndtr * psize;
            if !(0x2000_0000..0x2002_0000).contains(m) || m + len > 0x2002_0000 {
                self.say(
                    Grade::Violation,
                    format!(
                        "{name}: buffer {m:#010x} of {len} bytes is not in the SRAM that it reaches"
                    ),
                );
            }
        }
        self.say(
            Grade::Fact,
            format!(
                "{name}: channel {}, {} items of {psize} bytes, {:#010x} -> {}{}",
                s.cr >> 25 & 7,
                s.ndtr,
                s.par,
                buffers.iter().map(|b| format!("{b:#010x}")).collect::<Vec<_>>().join(" and "),
                if s.cr & 1 << 18 != 0 {
                    ", double buffer"
                } else if s.cr & 0x100 != 0 {
                    ", circular"
                } else {
                    ""
                }
            ),
        );
    }

    /// 10.3.18: a transfer error raises TEIF and switches the stream off.
    pub(crate) fn dma_fails(&mut self, d: usize, n: usize) {
        self.dma[d].isr[n / 4] |= 8 << SHIFT[n % 4];
        self.dma[d].s[n].cr &= !1;
    }

    /// Serves one request of a peripheral. Returns `None` if no stream listens, else whether it was the last item.
    pub(crate) fn dma_request(&mut self, d: usize, n: usize, channel: u32) -> Option<bool> {
        let s = self.dma[d].s[n];
        if self.faults.serial_dma_stuck && (d, channel) == (1, 4) {
            return None;
        }
        if s.cr & 1 == 0 || s.cr >> 25 & 7 != channel || self.rcc.enr[0] >> (21 + d) & 1 == 0 {
            return None;
        }
        let size = 1u32 << (s.cr >> 11 & 3);
        let base = if s.cr & 1 << 18 != 0 && s.cr & 1 << 19 != 0 { s.m1 } else { s.m0 };
        let memory = base + if s.cr & 1 << 10 != 0 { s.at * size } else { 0 };
        let bytes = size as usize;
        let reachable = (0x2000_0000..0x2002_0000).contains(&memory)
            || (s.cr >> 6 & 3 == 1 && (0x0800_0000..0x0810_0000).contains(&memory));
        if !reachable {
            // A transfer error: RM0090 10.3.18.
            self.violation(format!("DMA{} stream {n}: transfer error at {memory:#010x}", d + 1));
            self.dma_fails(d, n);
            return Some(true);
        }
        match s.cr >> 6 & 3 {
            0 => {
                let v = self.read(s.par & !3).to_le_bytes();
                self.sram
                    .write_at(u64::from(memory - 0x2000_0000), &v[..bytes])
                    .expect("in the SRAM");
            }
            1 => {
                let mut v = [0; 4];
                if memory >= 0x2000_0000 {
                    self.sram
                        .read_at(u64::from(memory - 0x2000_0000), &mut v[..bytes])
                        .expect("in the SRAM");
                } else {
                    self.rom
                        .read_at(u64::from(memory - 0x0800_0000), &mut v[..bytes])
                        .expect("in the flash");
                }
                self.write(s.par & !3, u32::from_le_bytes(v));
            }
            _ => self.violation("DMA: a peripheral's request on a memory-to-memory stream".into()),
        }
        self.dma[d].transfers[n] += 1;
        let s = &mut self.dma[d].s[n];
        s.at += 1;
        s.left -= 1;
        let (left, all) = (s.left, s.ndtr);
        let flag = &mut self.dma[d].isr[n / 4];
        if left == all / 2 {
            *flag |= 16 << SHIFT[n % 4];
        }
        if left > 0 {
            return Some(false);
        }
        let before = *flag >> SHIFT[n % 4] & 32;
        *flag |= 32 << SHIFT[n % 4];
        self.dma[d].full_at[n] = self.now;
        let s = &mut self.dma[d].s[n];
        s.at = 0;
        if s.cr & 1 << 18 != 0 {
            s.cr ^= 1 << 19;
            s.left = s.ndtr;
        } else if s.cr & 0x100 != 0 {
            s.left = s.ndtr;
        } else {
            s.cr &= !1;
        }
        if before != 0 && s.cr & 1 != 0 {
            self.say(
                Grade::Remark,
                format!(
                    "DMA{} stream {n}: a block was full before the last one's flag was cleared",
                    d + 1
                ),
            );
        }
        Some(true)
    }
}
