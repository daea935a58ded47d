//! bxCAN 1 as the processor sees it: registers, mailboxes, filters, both receive FIFOs (RM0090 section 32).

pub(super) mod registers;

use super::Chip;
use crate::{
    frame::CanFrame,
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND},
};
use registers::*;
use std::collections::VecDeque;

#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct TxMailbox {
    pub(crate) tir: u32,
    pub(crate) tdtr: u32,
    pub(crate) tdlr: u32,
    pub(crate) tdhr: u32,
    pub(crate) pending: bool,
    pub(crate) order: u64,
    pub(crate) asked: u64,
    pub(crate) flags: u32,
}

impl TxMailbox {
    pub(crate) fn frame(&self) -> CanFrame {
        let ext = self.tir & IR_IDE != 0;
        let mut data = [0; 8];
        data[..4].copy_from_slice(&self.tdlr.to_le_bytes());
        data[4..].copy_from_slice(&self.tdhr.to_le_bytes());
        CanFrame {
            id: if ext { self.tir >> IR_EXID_SHIFT } else { self.tir >> IR_STID_SHIFT },
            ext,
            rtr: self.tir & IR_RTR != 0,
            len: (self.tdtr & TDTR_DLC_MASK) as u8,
            data,
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum FrameSender {
    Board(usize),
    Cnc,
}

/// CAN 1: its registers, mailboxes, FIFOs and counters.
#[derive(Default)]
pub struct Can {
    pub(crate) mcr: u32,
    pub(crate) inak: bool,
    pub(crate) slak: bool,
    pub(crate) erri: bool,
    pub(crate) mb: [TxMailbox; 3],
    pub(crate) last_code: u32,
    pub(crate) fifo: [VecDeque<(CanFrame, u32)>; 2],
    pub(crate) full: [bool; 2],
    pub(crate) over: [bool; 2],
    pub(crate) ier: u32,
    pub(crate) lec: u32,
    /// The transmit error counter.
    pub tec: u32,
    /// The receive error counter.
    pub rec: u32,
    /// The controller is off the bus.
    pub boff: bool,
    pub(crate) btr: u32,
    pub(crate) fmr: u32,
    pub(crate) fm1r: u32,
    pub(crate) fs1r: u32,
    pub(crate) ffa1r: u32,
    pub(crate) fa1r: u32,
    pub(crate) filters: [[u32; 2]; 28],
    /// When it changes to the mode that CAN_MCR requests; NEVER: no change is due.
    pub mode_at: u64,
    /// When the frame on the bus ends; NEVER: the bus is idle.
    pub end_at: u64,
    pub(crate) current: Option<(FrameSender, CanFrame)>,
    pub(crate) orders: u64,
    /// Frames sent so far.
    pub sent: u64,
    /// Frames that a FIFO has taken.
    pub taken: u64,
    /// Frames that no filter let in.
    pub filtered: u64,
    /// Frames lost in a full FIFO.
    pub lost: u64,
    /// Frames of others that the controller did not receive, by its mode, its pins or its bit rate.
    pub unheard: u64,
    /// For how long the bus was busy, in ticks.
    pub busy: u64,
    /// The longest that a frame waited in a mailbox, in ticks.
    pub longest_wait: u64,
}

/// Pins that carry CAN1_TX and CAN1_RX by alternate function 9 (DS8626 table 9).
pub(crate) const CAN1_TX_PINS: &[(usize, u32)] = &[(0, 12), (1, 9), (3, 1)];
pub(crate) const CAN1_RX_PINS: &[(usize, u32)] = &[(0, 11), (1, 8), (3, 0)];

impl Can {
    pub(crate) fn after_reset() -> Can {
        Can {
            mcr: MCR_RESET,
            slak: true,
            btr: BTR_RESET,
            fmr: FMR_RESET,
            mode_at: NEVER,
            end_at: NEVER,
            ..Can::default()
        }
    }
    pub(crate) fn read_esr(&self) -> u32 {
        let (t, r) = (self.tec.min(255), self.rec.min(255));
        u32::from(t >= 96 || r >= 96)
            | u32::from(t >= 128 || r >= 128) << ESR_EPVF_SHIFT
            | u32::from(self.boff) << ESR_BOFF_SHIFT
            | self.lec << ESR_LEC_SHIFT
            | t << ESR_TEC_SHIFT
            | r << ESR_REC_SHIFT
    }
    pub(crate) fn read_tsr(&self) -> u32 {
        let mut v = 0;
        for (i, m) in self.mb.iter().enumerate() {
            v |= m.flags << (TSR_MAILBOX_STRIDE_BITS * i);
            v |= u32::from(!m.pending) << (TSR_TME0_SHIFT + i);
        }
        let free = self.mb.iter().position(|m| !m.pending);
        v |= (free.unwrap_or(self.last_code as usize) as u32) << TSR_CODE_SHIFT;
        // The mailbox with the lowest priority, where more than one waits.
        let waiting: Vec<usize> = (0..3).filter(|i| self.mb[*i].pending).collect();
        if waiting.len() > 1 {
            let low = *waiting
                .iter()
                .max_by_key(|i| (self.mb[**i].frame().arbitration_key(), **i))
                .unwrap();
            v |= 1 << (TSR_LOW0_SHIFT + low);
        }
        v
    }
    pub(crate) fn is_in_normal_mode(&self) -> bool {
        !self.inak && !self.slak && !self.boff
    }
    /// Ticks of a bit in quanta.
    pub(crate) fn bit_timing_parameters(&self) -> (u64, u64, u64) {
        (
            u64::from(self.btr & BTR_BRP_MASK) + 1,
            u64::from(self.btr >> BTR_TS1_SHIFT & BTR_TS1_MASK) + 1,
            u64::from(self.btr >> BTR_TS2_SHIFT & BTR_TS2_MASK) + 1,
        )
    }
}

impl Chip {
    pub(crate) fn collect_can_interrupt_lines(&self, want: &mut [bool; 82]) {
        let c = &self.can;
        want[19] = c.ier & IER_TMEIE != 0 && c.mb.iter().any(|m| m.flags & TSR_RQCP != 0);
        for f in 0..2 {
            let e = c.ier >> (IER_FIFO_SHIFT + IER_FIFO_STRIDE_BITS * f);
            want[20 + f] = (e & IER_FMPIE != 0 && !c.fifo[f].is_empty())
                || (e & IER_FFIE != 0 && c.full[f])
                || (e & IER_FOVIE != 0 && c.over[f]);
        }
        want[22] = c.erri && c.ier & IER_ERRIE != 0;
    }

    pub(crate) fn can_bit_time_ticks(&self) -> u64 {
        let (brp, t1, t2) = self.can.bit_timing_parameters();
        self.pclk1 * brp * (1 + t1 + t2)
    }

    pub(crate) fn read_can_register(&mut self, off: u32) -> u32 {
        let c = &mut self.can;
        match off {
            MCR_OFFSET => c.mcr,
            MSR_OFFSET => {
                u32::from(c.inak)
                    | u32::from(c.slak) << MSR_SLAK_SHIFT
                    | u32::from(c.erri) << MSR_ERRI_SHIFT
                    | u32::from(matches!(c.current, Some((FrameSender::Board(_), _))))
                        << MSR_TXM_SHIFT
                    | u32::from(matches!(c.current, Some((FrameSender::Cnc, _)))) << MSR_RXM_SHIFT
                    | MSR_RX_SAMP
            }
            TSR_OFFSET => c.read_tsr(),
            RF0R_OFFSET | RF1R_OFFSET => {
                let f = (off as usize - RF0R_OFFSET as usize) / 4;
                c.fifo[f].len() as u32
                    | u32::from(c.full[f]) << RFR_FULL_SHIFT
                    | u32::from(c.over[f]) << RFR_FOVR_SHIFT
            }
            IER_OFFSET => c.ier,
            ESR_OFFSET => c.read_esr(),
            BTR_OFFSET => c.btr,
            TI0R_OFFSET..=TDH2R_OFFSET => {
                let m = &c.mb[(off as usize - TI0R_OFFSET as usize) / MAILBOX_STRIDE];
                [m.tir, m.tdtr, m.tdlr, m.tdhr]
                    [(off as usize - TI0R_OFFSET as usize) % MAILBOX_STRIDE / 4]
            }
            RI0R_OFFSET..=RDH1R_OFFSET => {
                let f = (off as usize - RI0R_OFFSET as usize) / MAILBOX_STRIDE;
                let Some((frame, fmi)) = c.fifo[f].front().copied() else {
                    self.report_violation(format!("CAN: FIFO {f} read while it is empty"));
                    return 0;
                };
                let word = |i: usize| u32::from_le_bytes(frame.data[i..i + 4].try_into().unwrap());
                match (off - RI0R_OFFSET) % MAILBOX_STRIDE as u32 / 4 {
                    0 => {
                        (if frame.ext {
                            frame.id << IR_EXID_SHIFT | IR_IDE
                        } else {
                            frame.id << IR_STID_SHIFT
                        }) | u32::from(frame.rtr) << IR_RTR_SHIFT
                    }
                    1 => u32::from(frame.len) | fmi << RDTR_FMI_SHIFT,
                    2 => word(0),
                    _ => word(4),
                }
            }
            FMR_OFFSET => c.fmr,
            FM1R_OFFSET => c.fm1r,
            FS1R_OFFSET => c.fs1r,
            FFA1R_OFFSET => c.ffa1r,
            FA1R_OFFSET => c.fa1r,
            F0R1_OFFSET..=F27R2_OFFSET => {
                c.filters[(off as usize - F0R1_OFFSET as usize) / FILTER_STRIDE]
                    [(off as usize - F0R1_OFFSET as usize) % FILTER_STRIDE / 4]
            }
            _ => {
                self.report_violation(format!("CAN: read at the reserved offset {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn write_can_register(&mut self, off: u32, v: u32) {
        match off {
            MCR_OFFSET => self.write_can_mcr(v),
            MSR_OFFSET => {
                if v & MSR_ERRI != 0 {
                    self.can.erri = false;
                }
            }
            TSR_OFFSET => self.write_can_tsr(v),
            RF0R_OFFSET | RF1R_OFFSET => {
                let f = (off as usize - RF0R_OFFSET as usize) / 4;
                if v & RFR_FULL != 0 {
                    self.can.full[f] = false
                }
                if v & RFR_FOVR != 0 {
                    self.can.over[f] = false
                }
                if v & RFR_RFOM != 0 && self.can.fifo[f].pop_front().is_none() {
                    self.report_violation(format!("CAN: FIFO {f} released while it is empty"));
                }
            }
            IER_OFFSET => {
                self.can.ier = self.apply_write_mask("CAN_IER", self.can.ier, v, IER_WRITE_MASK)
            }
            ESR_OFFSET => self.can.lec = v >> ESR_LEC_SHIFT & ESR_LEC_MASK,
            BTR_OFFSET => self.write_can_btr(v),
            TI0R_OFFSET..=TDH2R_OFFSET => self.write_can_mailbox(off, v),
            FMR_OFFSET => self.can.fmr = v & FMR_WRITE_MASK | FMR_RESERVED,
            FM1R_OFFSET | FS1R_OFFSET | FFA1R_OFFSET if self.can.fmr & FMR_FINIT == 0 => self
                .report_violation(format!(
                    "CAN: filter register {off:#x} written outside filter initialisation"
                )),
            FM1R_OFFSET => self.can.fm1r = v,
            FS1R_OFFSET => self.can.fs1r = v,
            FFA1R_OFFSET => self.can.ffa1r = v,
            FA1R_OFFSET => self.can.fa1r = v & FA1R_MASK,
            F0R1_OFFSET..=F27R2_OFFSET => {
                let bank = (off as usize - F0R1_OFFSET as usize) / FILTER_STRIDE;
                if self.can.fmr & FMR_FINIT == 0 && self.can.fa1r >> bank & 1 != 0 {
                    return self.report_violation(format!(
                        "CAN: filter bank {bank} written while active and outside initialisation"
                    ));
                }
                self.can.filters[bank][(off as usize - F0R1_OFFSET as usize) % FILTER_STRIDE / 4] =
                    v;
            }
            _ => self.report_violation(format!("CAN: write at the reserved offset {off:#x}")),
        }
    }

    /// Writes CAN_MCR: mode requests and reset.
    fn write_can_mcr(&mut self, v: u32) {
        let now = self.now;
        if v & MCR_SOFTWARE_RESET != 0 {
            self.can = Can::after_reset();
            return;
        }
        let old = self.can.mcr;
        self.can.mcr = self.apply_write_mask("CAN_MCR", old, v, MCR_WRITE_MASK);
        if (self.can.mcr ^ old) & (MCR_SLEEP | MCR_INRQ) != 0 {
            // Into a mode at once if the bus is quiet; out of it after 11 recessive bits, off the bus
            // after 128 times as many.
            let wait = if v & MCR_INRQ != 0 && old & MCR_INRQ == 0 {
                let frame_ends = if self.can.end_at == NEVER { now } else { self.can.end_at };
                frame_ends.max(now) - now
            } else {
                self.recessive_wait_ticks()
            };
            self.can.mode_at = now + wait.max(self.pclk1 * 4);
        }
    }

    /// Writes CAN_TSR: clears what is done and aborts what waits.
    fn write_can_tsr(&mut self, v: u32) {
        for i in 0..3 {
            let f = v >> (TSR_MAILBOX_STRIDE_BITS * i);
            if f & TSR_RQCP != 0 {
                self.can.mb[i].flags = 0;
            }
            if f & TSR_ABRQ != 0
                && self.can.mb[i].pending
                && !matches!(self.can.current, Some((FrameSender::Board(n), _)) if n == i)
            {
                self.can.mb[i].pending = false;
                self.can.mb[i].flags = TSR_RQCP;
            }
        }
        self.start_can_frame();
    }

    /// Writes CAN_BTR, and says which bit timing that is.
    fn write_can_btr(&mut self, v: u32) {
        if !self.can.inak {
            return self.report_violation("CAN_BTR written outside initialisation".into());
        }
        self.can.btr = self.apply_write_mask("CAN_BTR", self.can.btr, v, BTR_WRITE_MASK);
        let (brp, t1, t2) = self.can.bit_timing_parameters();
        let hz = TICKS_PER_SECOND as f64 / self.can_bit_time_ticks() as f64;
        let sjw = (v >> BTR_SJW_SHIFT & BTR_SJW_MASK) + 1;
        self.record_finding(
            Severity::Fact,
            format!(
                "CAN: {hz:.0} bit/s, sample point {:.1} %, {} quanta, SJW {sjw}{}{}",
                100.0 * (1 + t1) as f64 / (1 + t1 + t2) as f64,
                1 + t1 + t2,
                if v >> BTR_SILM_BIT != 0 { ", silent" } else { "" },
                if v >> BTR_LBKM_BIT & 1 != 0 { ", loop-back" } else { "" }
            ),
        );
        if u64::from(sjw) > t2 {
            self.report_violation(format!(
                "CAN: SJW {sjw} is longer than the second segment, {t2}"
            ));
        }
        let _ = brp;
    }

    /// Writes a register of a transmit mailbox.
    fn write_can_mailbox(&mut self, off: u32, v: u32) {
        let now = self.now;
        let i = (off as usize - TI0R_OFFSET as usize) / MAILBOX_STRIDE;
        if self.can.mb[i].pending {
            return self
                .report_violation(format!("CAN: mailbox {i} written while it waits to be sent"));
        }
        let m = &mut self.can.mb[i];
        match (off - TI0R_OFFSET) % MAILBOX_STRIDE as u32 / 4 {
            1 => m.tdtr = v & TDTR_MASK,
            2 => m.tdlr = v,
            3 => m.tdhr = v,
            _ => {
                m.tir = v & !TIR_TXRQ;
                if v & TIR_TXRQ != 0 {
                    self.can.orders += 1;
                    let m = &mut self.can.mb[i];
                    (m.pending, m.order, m.asked, m.flags) = (true, self.can.orders, now, 0);
                    self.can.last_code = i as u32;
                    if m.tdtr & TDTR_DLC_MASK > 8 {
                        self.report_violation(format!(
                            "CAN: mailbox {i} with DLC {}",
                            self.can.mb[i].tdtr & TDTR_DLC_MASK
                        ));
                    }
                    if self.can.inak || self.can.slak {
                        self.record_finding(
                            Severity::Remark,
                            "CAN: a frame asked for outside normal mode: it waits".into(),
                        );
                    }
                    self.start_can_frame();
                }
            }
        }
    }
}
