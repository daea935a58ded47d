//! bxCAN 1 on its bus: arbitration, acknowledgement, error counters, what the filters let in.

use super::{
    Chip,
    can::{RX, Sender, TX},
};
use crate::{
    frame::Frame,
    report::Grade,
    time::{NEVER, TPS, ms},
};

impl Chip {
    pub(crate) fn can_mode(&mut self) {
        self.can.mode_at = NEVER;
        let (init, sleep) = (self.can.mcr & 1 != 0, self.can.mcr & 2 != 0);
        let listening = self.muxed(RX, 9).is_some() || self.can.btr >> 30 & 1 != 0;
        if self.faults.can_stuck && !init {
            // A dominant bus: 11 recessive bits never come.
            return;
        }
        if self.can.boff && !init {
            (self.can.boff, self.can.tec, self.can.rec) = (false, 0, 0);
            let by = if self.can.inak { "through initialization" } else { "by itself (ABOM)" };
            self.say(Grade::Fact, format!("CAN: back from bus-off {by}"));
        }
        if !init && self.can.inak && !listening {
            self.violation("CAN: leaves initialization without a receive pin on AF9: it never sees 11 recessive bits".into());
            return;
        }
        self.can.inak = init;
        self.can.slak = sleep && !init;
        if !init && !sleep {
            self.say(
                Grade::Fact,
                format!("CAN: in normal mode after {:.2} ms", self.now as f64 / ms(1) as f64),
            );
            self.can_start();
        }
    }

    /// The bus is quiet again: what waited for recessive bits goes on.
    pub(crate) fn can_quiet(&mut self) {
        let waits = self.can.boff || self.can.inak != (self.can.mcr & 1 != 0);
        if waits && self.can.mode_at == NEVER {
            self.can.mode_at = self.now + self.can_recessive();
        }
    }

    /// Returns how long the bus must be recessive before the controller takes part in it.
    pub(crate) fn can_recessive(&self) -> u64 {
        if self.can.boff { 128 * 11 * self.can_bit() } else { 11 * self.can_bit() }
    }

    /// Puts the next frame on the bus, if it is free and there is one.
    pub(crate) fn can_start(&mut self) {
        if self.can.end_at != NEVER {
            return;
        }
        let txfp = self.can.mcr & 4 != 0;
        let mine = (self.can.normal() && self.can.btr >> 30 & 3 == 0)
            .then(|| {
                (0..3).filter(|i| self.can.mb[*i].pending).min_by_key(|i| {
                    if txfp {
                        (self.can.mb[*i].order, 0)
                    } else {
                        (self.can.mb[*i].frame().rank(), *i)
                    }
                })
            })
            .flatten();
        let theirs = self.world.can_head(self.now);
        let (sender, frame) = match (mine, theirs) {
            (None, None) => return,
            (Some(i), t) if t.is_none_or(|t| self.can.mb[i].frame().rank() < t.rank()) => {
                (Sender::Board(i), self.can.mb[i].frame())
            }
            (_, Some(t)) => (Sender::Cnc, t),
            (Some(_), None) => unreachable!(),
        };
        let bit = if sender == Sender::Cnc { TPS / 1_000_000 } else { self.can_bit() };
        let len = frame.bits() * bit;
        self.can.current = Some((sender, frame));
        self.can.end_at = self.now + len;
        self.can.busy += len;
    }

    pub(crate) fn can_error(&mut self, lec: u32, tec: u32) {
        let before = self.can.esr();
        self.can.lec = lec;
        self.can.tec += tec;
        if self.can.tec > 255 {
            self.can.boff = true;
            self.can.tec = 255;
            if self.can.mcr & 0x40 != 0 {
                // ABOM: back after 128 × 11 recessive bits.
                self.can.mode_at = self.now + self.can_recessive();
            }
        }
        let after = self.can.esr();
        let ier = self.can.ier;
        if (after & !before & 7 & ier >> 8) != 0 || ier & 1 << 11 != 0 {
            self.can.erri = true;
        }
    }

    pub(crate) fn can_end(&mut self) {
        self.can.end_at = NEVER;
        let Some((sender, frame)) = self.can.current.take() else { return };
        match sender {
            Sender::Board(i) => {
                let hz = TPS as f64 / self.can_bit() as f64;
                let pins = self.muxed(TX, 9).is_some() && self.muxed(RX, 9).is_some();
                let right = (hz - 1e6).abs() < 5e3;
                if !pins {
                    self.violation("CAN: sends without both pins on AF9".into());
                }
                let silent = self.faults.can_alone || self.faults.can_short || !pins || !right;
                if silent {
                    // An error-passive node's count stays when nothing but the acknowledgement is missing.
                    let ack_only = !self.faults.can_short && pins;
                    let step = if ack_only && self.can.tec >= 128 { 0 } else { 8 };
                    self.can_error(if ack_only { 3 } else { 5 }, step);
                    if self.can.mcr & 0x10 != 0 {
                        self.can.mb[i].pending = false;
                        self.can.mb[i].flags = 1 | 8;
                    }
                } else {
                    let m = &mut self.can.mb[i];
                    m.pending = false;
                    m.flags = 3;
                    self.can.longest_wait = self.can.longest_wait.max(self.now - m.asked);
                    self.can.tec = self.can.tec.saturating_sub(1);
                    self.can.sent += 1;
                    self.world.heard(self.now, frame);
                }
            }
            Sender::Cnc => {
                self.world.can_pop();
                if self.faults.can_short || self.faults.can_alone {
                    self.can.unheard += 1;
                } else if self.can.normal()
                    && self.muxed(RX, 9).is_some()
                    && (TPS as f64 / self.can_bit() as f64 - 1e6).abs() < 5e3
                {
                    self.can_take(frame);
                } else {
                    self.can.unheard += 1;
                }
            }
        }
        self.can_start();
    }

    pub(crate) fn can_take(&mut self, frame: Frame) {
        let word = (if frame.ext { frame.id << 3 | 4 } else { frame.id << 21 })
            | u32::from(frame.rtr) << 1;
        let (std, low) =
            if frame.ext { (frame.id >> 18, frame.id >> 15 & 7) } else { (frame.id, 0) };
        let half = std << 5 | u32::from(frame.rtr) << 4 | u32::from(frame.ext) << 3 | low;
        // (class of priority, number, FIFO)
        let mut hit: Option<(u32, u32, usize)> = None;
        let mut numbers = [0u32; 2];
        let c = &self.can;
        if c.fmr & 1 != 0 {
            self.say(Grade::Remark, "CAN: a frame came while FINIT held reception off".into());
            return;
        }
        for bank in 0..(c.fmr >> 8 & 0x3f).min(28) as usize {
            let fifo = (c.ffa1r >> bank & 1) as usize;
            let [a, b] = c.filters[bank];
            let (list, wide) = (c.fm1r >> bank & 1 != 0, c.fs1r >> bank & 1 != 0);
            let tests: Vec<bool> = match (wide, list) {
                (true, false) => vec![(word ^ a) & b & !1 == 0],
                (true, true) => vec![(word ^ a) & !1 == 0, (word ^ b) & !1 == 0],
                (false, false) => {
                    vec![(half ^ a) & a >> 16 & 0xffff == 0, (half ^ b) & b >> 16 & 0xffff == 0]
                }
                (false, true) => {
                    vec![half == a & 0xffff, half == a >> 16, half == b & 0xffff, half == b >> 16]
                }
            };
            for ok in tests {
                let class = u32::from(!wide) * 2 + u32::from(!list);
                if ok
                    && c.fa1r >> bank & 1 != 0
                    && hit.is_none_or(|h| (class, numbers[fifo]) < (h.0, h.1))
                {
                    hit = Some((class, numbers[fifo], fifo));
                }
                numbers[fifo] += 1;
            }
        }
        let Some((_, fmi, f)) = hit else {
            self.can.filtered += 1;
            return;
        };
        let c = &mut self.can;
        if c.fifo[f].len() == 3 {
            c.over[f] = true;
            c.lost += 1;
            if c.mcr & 8 == 0 {
                c.fifo[f].pop_back();
                c.fifo[f].push_back((frame, fmi));
            }
            self.say(Grade::Remark, format!("CAN: FIFO {f} overrun"));
            return;
        }
        c.fifo[f].push_back((frame, fmi));
        c.full[f] |= c.fifo[f].len() == 3;
        c.taken += 1;
    }
}
