//! bxCAN 1 on its bus: arbitration, acknowledgement, error counters, what the filters let in.

use super::{
    Chip,
    can::{CAN1_RX_PINS, CAN1_TX_PINS, FrameSender, registers::*},
};
use crate::{
    frame::CanFrame,
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND, ms_to_ticks},
};

impl Chip {
    pub(crate) fn update_can_mode(&mut self) {
        self.can.mode_at = NEVER;
        let (init, sleep) = (self.can.mcr & MCR_INRQ != 0, self.can.mcr & MCR_SLEEP != 0);
        let listening = self.find_pin_with_alternate_function(CAN1_RX_PINS, 9).is_some()
            || self.can.btr >> BTR_LBKM_BIT & 1 != 0;
        if self.faults.can_stuck && !init {
            // A dominant bus: 11 recessive bits never come.
            return;
        }
        if self.can.boff && !init {
            (self.can.boff, self.can.tec, self.can.rec) = (false, 0, 0);
            let by = if self.can.inak { "through initialisation" } else { "by itself (ABOM)" };
            self.record_finding(Severity::Fact, format!("CAN: back from bus-off {by}"));
        }
        if !init && self.can.inak && !listening {
            self.report_violation("CAN: leaves initialisation without a receive pin on AF9: it never sees 11 recessive bits".into());
            return;
        }
        self.can.inak = init;
        self.can.slak = sleep && !init;
        if !init && !sleep {
            self.record_finding(
                Severity::Fact,
                format!(
                    "CAN: in normal mode after {:.2} ms",
                    self.now as f64 / ms_to_ticks(1) as f64
                ),
            );
            self.start_can_frame();
        }
    }

    /// The bus is quiet again: what waited for recessive bits goes on.
    pub(crate) fn handle_can_bus_idle(&mut self) {
        let waits = self.can.boff || self.can.inak != (self.can.mcr & MCR_INRQ != 0);
        if waits && self.can.mode_at == NEVER {
            self.can.mode_at = self.now + self.recessive_wait_ticks();
        }
    }

    /// Returns how long the bus must be recessive before the controller takes part in it.
    pub(crate) fn recessive_wait_ticks(&self) -> u64 {
        if self.can.boff {
            128 * 11 * self.can_bit_time_ticks()
        } else {
            11 * self.can_bit_time_ticks()
        }
    }

    /// Puts the next frame on the bus, if it is free and there is one.
    pub(crate) fn start_can_frame(&mut self) {
        if self.can.end_at != NEVER {
            return;
        }
        let txfp = self.can.mcr & MCR_TXFP != 0;
        let mine = (self.can.is_in_normal_mode()
            && self.can.btr >> BTR_LBKM_BIT & BTR_TEST_MODES_MASK == 0)
            .then(|| {
                (0..3).filter(|i| self.can.mb[*i].pending).min_by_key(|i| {
                    if txfp {
                        (self.can.mb[*i].order, 0)
                    } else {
                        (self.can.mb[*i].frame().arbitration_key(), *i)
                    }
                })
            })
            .flatten();
        let theirs = self.world.peek_can_frame(self.now);
        let (sender, frame) = match (mine, theirs) {
            (None, None) => return,
            (Some(i), t)
                if t.is_none_or(|t| {
                    self.can.mb[i].frame().arbitration_key() < t.arbitration_key()
                }) =>
            {
                (FrameSender::Board(i), self.can.mb[i].frame())
            }
            (_, Some(t)) => (FrameSender::Cnc, t),
            (Some(_), None) => unreachable!(),
        };
        let bit = if sender == FrameSender::Cnc {
            TICKS_PER_SECOND / 1_000_000
        } else {
            self.can_bit_time_ticks()
        };
        let len = frame.bit_length() * bit;
        self.can.current = Some((sender, frame));
        self.can.end_at = self.now + len;
        self.can.busy += len;
    }

    pub(crate) fn record_can_error(&mut self, lec: u32, tec: u32) {
        let before = self.can.read_esr();
        self.can.lec = lec;
        self.can.tec += tec;
        if self.can.tec > 255 {
            self.can.boff = true;
            self.can.tec = 255;
            if self.can.mcr & MCR_ABOM != 0 {
                // ABOM: back after 128 × 11 recessive bits.
                self.can.mode_at = self.now + self.recessive_wait_ticks();
            }
        }
        let after = self.can.read_esr();
        let ier = self.can.ier;
        if (after & !before & ESR_STATES & ier >> IER_STATE_SHIFT) != 0 || ier & IER_LECIE != 0 {
            self.can.erri = true;
        }
    }

    pub(crate) fn end_can_frame(&mut self) {
        self.can.end_at = NEVER;
        let Some((sender, frame)) = self.can.current.take() else { return };
        match sender {
            FrameSender::Board(i) => {
                let hz = TICKS_PER_SECOND as f64 / self.can_bit_time_ticks() as f64;
                let pins = self.find_pin_with_alternate_function(CAN1_TX_PINS, 9).is_some()
                    && self.find_pin_with_alternate_function(CAN1_RX_PINS, 9).is_some();
                let right = (hz - 1e6).abs() < 5e3;
                if !pins {
                    self.report_violation("CAN: sends without both pins on AF9".into());
                }
                let silent = self.faults.can_alone || self.faults.can_short || !pins || !right;
                if silent {
                    // An error-passive node's count stays when nothing but the acknowledgement is missing.
                    let ack_only = !self.faults.can_short && pins;
                    let step = if ack_only && self.can.tec >= 128 { 0 } else { 8 };
                    self.record_can_error(
                        if ack_only { LEC_ACKNOWLEDGEMENT } else { LEC_BIT_DOMINANT },
                        step,
                    );
                    if self.can.mcr & MCR_NART != 0 {
                        self.can.mb[i].pending = false;
                        self.can.mb[i].flags = TSR_RQCP | TSR_TERR;
                    }
                } else {
                    let m = &mut self.can.mb[i];
                    m.pending = false;
                    m.flags = TSR_TXOK | TSR_RQCP;
                    self.can.longest_wait = self.can.longest_wait.max(self.now - m.asked);
                    self.can.tec = self.can.tec.saturating_sub(1);
                    self.can.sent += 1;
                    self.world.record_can_frame(self.now, frame);
                }
            }
            FrameSender::Cnc => {
                self.world.pop_can_frame();
                if self.faults.can_short || self.faults.can_alone {
                    self.can.unheard += 1;
                } else if self.can.is_in_normal_mode()
                    && self.find_pin_with_alternate_function(CAN1_RX_PINS, 9).is_some()
                    && (TICKS_PER_SECOND as f64 / self.can_bit_time_ticks() as f64 - 1e6).abs()
                        < 5e3
                {
                    self.receive_can_frame(frame);
                } else {
                    self.can.unheard += 1;
                }
            }
        }
        self.start_can_frame();
    }

    pub(crate) fn receive_can_frame(&mut self, frame: CanFrame) {
        let word = (if frame.ext {
            frame.id << IR_EXID_SHIFT | IR_IDE
        } else {
            frame.id << IR_STID_SHIFT
        }) | u32::from(frame.rtr) << IR_RTR_SHIFT;
        let (std, low) = if frame.ext {
            (frame.id >> 18, frame.id >> 15 & FILTER_HALF_EXID_MASK)
        } else {
            (frame.id, 0)
        };
        let half = std << FILTER_HALF_STID_SHIFT
            | u32::from(frame.rtr) << FILTER_HALF_RTR_SHIFT
            | u32::from(frame.ext) << FILTER_HALF_IDE_SHIFT
            | low;
        // (class of priority, number, FIFO)
        let mut hit: Option<(u32, u32, usize)> = None;
        let mut numbers = [0u32; 2];
        let c = &self.can;
        if c.fmr & FMR_FINIT != 0 {
            self.record_finding(
                Severity::Remark,
                "CAN: a frame came while FINIT held reception off".into(),
            );
            return;
        }
        for bank in 0..(c.fmr >> FMR_CAN2SB_SHIFT & FMR_CAN2SB_MASK).min(28) as usize {
            let fifo = (c.ffa1r >> bank & 1) as usize;
            let [a, b] = c.filters[bank];
            let (list, wide) = (c.fm1r >> bank & 1 != 0, c.fs1r >> bank & 1 != 0);
            let tests: Vec<bool> = match (wide, list) {
                (true, false) => vec![(word ^ a) & b & !FILTER_UNUSED == 0],
                (true, true) => {
                    vec![(word ^ a) & !FILTER_UNUSED == 0, (word ^ b) & !FILTER_UNUSED == 0]
                }
                (false, false) => {
                    vec![
                        (half ^ a) & a >> FILTER_HALF_SHIFT & FILTER_HALF_MASK == 0,
                        (half ^ b) & b >> FILTER_HALF_SHIFT & FILTER_HALF_MASK == 0,
                    ]
                }
                (false, true) => {
                    vec![
                        half == a & FILTER_HALF_MASK,
                        half == a >> FILTER_HALF_SHIFT,
                        half == b & FILTER_HALF_MASK,
                        half == b >> FILTER_HALF_SHIFT,
                    ]
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
            if c.mcr & MCR_RFLM == 0 {
                c.fifo[f].pop_back();
                c.fifo[f].push_back((frame, fmi));
            }
            self.record_finding(Severity::Remark, format!("CAN: FIFO {f} overrun"));
            return;
        }
        c.fifo[f].push_back((frame, fmi));
        c.full[f] |= c.fifo[f].len() == 3;
        c.taken += 1;
    }
}
