//! bxCAN 1 as the processor sees it: registers, mailboxes, filters, both receive FIFOs (RM0090 section 32).

use super::Chip;
use crate::{
    frame::Frame,
    report::Grade,
    time::{NEVER, TPS},
};
use std::collections::VecDeque;

#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct Mailbox {
    pub(crate) tir: u32,
    pub(crate) tdtr: u32,
    pub(crate) tdlr: u32,
    pub(crate) tdhr: u32,
    pub(crate) pending: bool,
    pub(crate) order: u64,
    pub(crate) asked: u64,
    pub(crate) flags: u32,
}

impl Mailbox {
    pub(crate) fn frame(&self) -> Frame {
        let ext = self.tir & 4 != 0;
        let mut data = [0; 8];
        data[..4].copy_from_slice(&self.tdlr.to_le_bytes());
        data[4..].copy_from_slice(&self.tdhr.to_le_bytes());
        Frame {
            id: if ext { self.tir >> 3 } else { self.tir >> 21 },
            ext,
            rtr: self.tir & 2 != 0,
            len: (self.tdtr & 15) as u8,
            data,
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Sender {
    Board(usize),
    Cnc,
}

#[derive(Default)]
pub struct Can {
    pub(crate) mcr: u32,
    pub(crate) inak: bool,
    pub(crate) slak: bool,
    pub(crate) erri: bool,
    pub(crate) mb: [Mailbox; 3],
    pub(crate) last_code: u32,
    pub(crate) fifo: [VecDeque<(Frame, u32)>; 2],
    pub(crate) full: [bool; 2],
    pub(crate) over: [bool; 2],
    pub(crate) ier: u32,
    pub(crate) lec: u32,
    pub tec: u32,
    pub rec: u32,
    pub boff: bool,
    pub(crate) btr: u32,
    pub(crate) fmr: u32,
    pub(crate) fm1r: u32,
    pub(crate) fs1r: u32,
    pub(crate) ffa1r: u32,
    pub(crate) fa1r: u32,
    pub(crate) filters: [[u32; 2]; 28],
    pub mode_at: u64,
    pub end_at: u64,
    pub(crate) current: Option<(Sender, Frame)>,
    pub(crate) orders: u64,
    pub sent: u64,
    pub taken: u64,
    pub filtered: u64,
    pub lost: u64,
    pub unheard: u64,
    pub busy: u64,
    pub longest_wait: u64,
}

/// Pins that carry CAN1_TX and CAN1_RX by alternate function 9 (DS8626 table 9).
pub(crate) const TX: &[(usize, u32)] = &[(0, 12), (1, 9), (3, 1)];
pub(crate) const RX: &[(usize, u32)] = &[(0, 11), (1, 8), (3, 0)];

impl Can {
    pub(crate) fn reset() -> Can {
        Can {
            mcr: 0x0001_0002,
            slak: true,
            btr: 0x0123_0000,
            fmr: 0x2a1c_0e01,
            mode_at: NEVER,
            end_at: NEVER,
            ..Can::default()
        }
    }
    pub(crate) fn esr(&self) -> u32 {
        let (t, r) = (self.tec.min(255), self.rec.min(255));
        u32::from(t >= 96 || r >= 96)
            | u32::from(t >= 128 || r >= 128) << 1
            | u32::from(self.boff) << 2
            | self.lec << 4
            | t << 16
            | r << 24
    }
    pub(crate) fn tsr(&self) -> u32 {
        let mut v = 0;
        for (i, m) in self.mb.iter().enumerate() {
            v |= m.flags << (8 * i);
            v |= u32::from(!m.pending) << (26 + i);
        }
        let free = self.mb.iter().position(|m| !m.pending);
        v |= (free.unwrap_or(self.last_code as usize) as u32) << 24;
        // The mailbox with the lowest priority, where more than one waits.
        let waiting: Vec<usize> = (0..3).filter(|i| self.mb[*i].pending).collect();
        if waiting.len() > 1 {
            let low = *waiting.iter().max_by_key(|i| (self.mb[**i].frame().rank(), **i)).unwrap();
            v |= 1 << (29 + low);
        }
        v
    }
    pub(crate) fn normal(&self) -> bool {
        !self.inak && !self.slak && !self.boff
    }
    /// Ticks of a bit in quanta.
    pub(crate) fn quanta(&self) -> (u64, u64, u64) {
        (
            u64::from(self.btr & 0x3ff) + 1,
            u64::from(self.btr >> 16 & 15) + 1,
            u64::from(self.btr >> 20 & 7) + 1,
        )
    }
}

impl Chip {
    pub(crate) fn can_lines(&self, want: &mut [bool; 82]) {
        let c = &self.can;
        want[19] = c.ier & 1 != 0 && c.mb.iter().any(|m| m.flags & 1 != 0);
        for f in 0..2 {
            let e = c.ier >> (1 + 3 * f);
            want[20 + f] = (e & 1 != 0 && !c.fifo[f].is_empty())
                || (e & 2 != 0 && c.full[f])
                || (e & 4 != 0 && c.over[f]);
        }
        want[22] = c.erri && c.ier & 1 << 15 != 0;
    }

    pub(crate) fn can_bit(&self) -> u64 {
        let (brp, t1, t2) = self.can.quanta();
        self.pclk1 * brp * (1 + t1 + t2)
    }

    pub(crate) fn can_read(&mut self, off: u32) -> u32 {
        let c = &mut self.can;
        match off {
            0x00 => c.mcr,
            0x04 => {
                u32::from(c.inak)
                    | u32::from(c.slak) << 1
                    | u32::from(c.erri) << 2
                    | u32::from(matches!(c.current, Some((Sender::Board(_), _)))) << 8
                    | u32::from(matches!(c.current, Some((Sender::Cnc, _)))) << 9
                    | 0xc00
            }
            0x08 => c.tsr(),
            0x0c | 0x10 => {
                let f = (off as usize - 0x0c) / 4;
                c.fifo[f].len() as u32 | u32::from(c.full[f]) << 3 | u32::from(c.over[f]) << 4
            }
            0x14 => c.ier,
            0x18 => c.esr(),
            0x1c => c.btr,
            0x180..=0x1ac => {
                let m = &c.mb[(off as usize - 0x180) / 16];
                [m.tir, m.tdtr, m.tdlr, m.tdhr][(off as usize - 0x180) % 16 / 4]
            }
            0x1b0..=0x1cc => {
                let f = (off as usize - 0x1b0) / 16;
                let Some((frame, fmi)) = c.fifo[f].front().copied() else {
                    self.violation(format!("CAN: FIFO {f} read while it is empty"));
                    return 0;
                };
                let word = |i: usize| u32::from_le_bytes(frame.data[i..i + 4].try_into().unwrap());
                match (off - 0x1b0) % 16 / 4 {
                    0 => {
                        (if frame.ext { frame.id << 3 | 4 } else { frame.id << 21 })
                            | u32::from(frame.rtr) << 1
                    }
                    1 => u32::from(frame.len) | fmi << 8,
                    2 => word(0),
                    _ => word(4),
                }
            }
            0x200 => c.fmr,
            0x204 => c.fm1r,
            0x20c => c.fs1r,
            0x214 => c.ffa1r,
            0x21c => c.fa1r,
            0x240..=0x31c => c.filters[(off as usize - 0x240) / 8][(off as usize - 0x240) % 8 / 4],
            _ => {
                self.violation(format!("CAN: read at the reserved offset {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn can_write(&mut self, off: u32, v: u32) {
        match off {
            0x00 => self.can_control(v),
            0x04 => {
                if v & 4 != 0 {
                    self.can.erri = false;
                }
            }
            0x08 => self.can_abort(v),
            0x0c | 0x10 => {
                let f = (off as usize - 0x0c) / 4;
                if v & 8 != 0 {
                    self.can.full[f] = false
                }
                if v & 16 != 0 {
                    self.can.over[f] = false
                }
                if v & 32 != 0 && self.can.fifo[f].pop_front().is_none() {
                    self.violation(format!("CAN: FIFO {f} released while it is empty"));
                }
            }
            0x14 => self.can.ier = self.set("CAN_IER", self.can.ier, v, 0x0003_8f7f),
            0x18 => self.can.lec = v >> 4 & 7,
            0x1c => self.can_timing(v),
            0x180..=0x1ac => self.can_mailbox(off, v),
            0x200 => self.can.fmr = v & 0x3f01 | 0x2a1c_0000,
            0x204 | 0x20c | 0x214 if self.can.fmr & 1 == 0 => self.violation(format!(
                "CAN: filter register {off:#x} written outside filter initialization"
            )),
            0x204 => self.can.fm1r = v,
            0x20c => self.can.fs1r = v,
            0x214 => self.can.ffa1r = v,
            0x21c => self.can.fa1r = v & 0x0fff_ffff,
            0x240..=0x31c => {
                let bank = (off as usize - 0x240) / 8;
                if self.can.fmr & 1 == 0 && self.can.fa1r >> bank & 1 != 0 {
                    return self.violation(format!(
                        "CAN: filter bank {bank} written while active and outside initialization"
                    ));
                }
                self.can.filters[bank][(off as usize - 0x240) % 8 / 4] = v;
            }
            _ => self.violation(format!("CAN: write at the reserved offset {off:#x}")),
        }
    }

    /// Writes CAN_MCR: mode requests and reset.
    fn can_control(&mut self, v: u32) {
        let now = self.now;
        if v & 0x8000 != 0 {
            self.can = Can::reset();
            return;
        }
        let old = self.can.mcr;
        self.can.mcr = self.set("CAN_MCR", old, v, 0x0001_80ff);
        if (self.can.mcr ^ old) & 3 != 0 {
            // Into a mode at once if the bus is quiet; out of it after 11 recessive bits, off the bus
            // after 128 times as many.
            let wait = if v & 1 != 0 && old & 1 == 0 {
                let frame_ends = if self.can.end_at == NEVER { now } else { self.can.end_at };
                frame_ends.max(now) - now
            } else {
                self.can_recessive()
            };
            self.can.mode_at = now + wait.max(self.pclk1 * 4);
        }
    }

    /// Writes CAN_TSR: clears what is done and aborts what waits.
    fn can_abort(&mut self, v: u32) {
        for i in 0..3 {
            let f = v >> (8 * i);
            if f & 1 != 0 {
                self.can.mb[i].flags = 0;
            }
            if f & 0x80 != 0
                && self.can.mb[i].pending
                && !matches!(self.can.current, Some((Sender::Board(n), _)) if n == i)
            {
                self.can.mb[i].pending = false;
                self.can.mb[i].flags = 1;
            }
        }
        self.can_start();
    }

    /// Writes CAN_BTR, and says which bit timing that is.
    fn can_timing(&mut self, v: u32) {
        if !self.can.inak {
            return self.violation("CAN_BTR written outside initialization".into());
        }
        self.can.btr = self.set("CAN_BTR", self.can.btr, v, 0xc37f_03ff);
        let (brp, t1, t2) = self.can.quanta();
        let hz = TPS as f64 / self.can_bit() as f64;
        let sjw = (v >> 24 & 3) + 1;
        self.say(
            Grade::Fact,
            format!(
                "CAN: {hz:.0} bit/s, sample point {:.1} %, {} quanta, SJW {sjw}{}{}",
                100.0 * (1 + t1) as f64 / (1 + t1 + t2) as f64,
                1 + t1 + t2,
                if v >> 31 != 0 { ", silent" } else { "" },
                if v >> 30 & 1 != 0 { ", loop-back" } else { "" }
            ),
        );
        if u64::from(sjw) > t2 {
            self.violation(format!("CAN: SJW {sjw} is longer than the second segment, {t2}"));
        }
        let _ = brp;
    }

    /// Writes a register of a transmit mailbox.
    fn can_mailbox(&mut self, off: u32, v: u32) {
        let now = self.now;
        let i = (off as usize - 0x180) / 16;
        if self.can.mb[i].pending {
            return self.violation(format!("CAN: mailbox {i} written while it waits to be sent"));
        }
        let m = &mut self.can.mb[i];
        match (off - 0x180) % 16 / 4 {
            1 => m.tdtr = v & 0xffff_010f,
            2 => m.tdlr = v,
            3 => m.tdhr = v,
            _ => {
                m.tir = v & !1;
                if v & 1 != 0 {
                    self.can.orders += 1;
                    let m = &mut self.can.mb[i];
                    (m.pending, m.order, m.asked, m.flags) = (true, self.can.orders, now, 0);
                    self.can.last_code = i as u32;
                    if m.tdtr & 15 > 8 {
                        self.violation(format!(
                            "CAN: mailbox {i} with DLC {}",
                            self.can.mb[i].tdtr & 15
                        ));
                    }
                    if self.can.inak || self.can.slak {
                        self.say(
                            Grade::Remark,
                            "CAN: a frame asked for outside normal mode: it waits".into(),
                        );
                    }
                    self.can_start();
                }
            }
        }
    }
}
