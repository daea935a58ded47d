//! Registers of bxCAN (RM0090 section 32.9).

/// Offset of CAN_MCR, the master control register (32.9.2).
pub(super) const MCR_OFFSET: u32 = 0x00;
/// Offset of CAN_MSR, the master status register (32.9.2).
pub(super) const MSR_OFFSET: u32 = 0x04;
/// Offset of CAN_TSR, the transmit status (32.9.2).
pub(super) const TSR_OFFSET: u32 = 0x08;
/// Offset of CAN_RF0R, the first receive FIFO (32.9.2).
pub(super) const RF0R_OFFSET: u32 = 0x0c;
/// Offset of CAN_RF1R, the second receive FIFO (32.9.2).
pub(super) const RF1R_OFFSET: u32 = 0x10;
/// Offset of CAN_IER, the enable bits of interrupts (32.9.2).
pub(super) const IER_OFFSET: u32 = 0x14;
/// Offset of CAN_ESR, the error status (32.9.2).
pub(super) const ESR_OFFSET: u32 = 0x18;
/// Offset of CAN_BTR, the bit timing (32.9.2).
pub(super) const BTR_OFFSET: u32 = 0x1c;
/// Offset of CAN_TI0R, the first register of the transmit mailboxes (32.9.3).
pub(super) const TI0R_OFFSET: u32 = 0x180;
/// Offset of CAN_TDH2R, the last register of the transmit mailboxes (32.9.3).
pub(super) const TDH2R_OFFSET: u32 = 0x1ac;
/// Offset of CAN_RI0R, the first register of the receive mailboxes (32.9.3).
pub(super) const RI0R_OFFSET: u32 = 0x1b0;
/// Offset of CAN_RDH1R, the last register of the receive mailboxes (32.9.3).
pub(super) const RDH1R_OFFSET: u32 = 0x1cc;
/// Offset of CAN_FMR, the filter master register (32.9.4).
pub(super) const FMR_OFFSET: u32 = 0x200;
/// Offset of CAN_FM1R, which makes a filter bank a list (32.9.4).
pub(super) const FM1R_OFFSET: u32 = 0x204;
/// Offset of CAN_FS1R, which gives a filter bank 32 bits (32.9.4).
pub(super) const FS1R_OFFSET: u32 = 0x20c;
/// Offset of CAN_FFA1R, which assigns a filter bank to a FIFO (32.9.4).
pub(super) const FFA1R_OFFSET: u32 = 0x214;
/// Offset of CAN_FA1R, which activates a filter bank (32.9.4).
pub(super) const FA1R_OFFSET: u32 = 0x21c;
/// Offset of CAN_F0R1, the first register of the filter banks (32.9.4).
pub(super) const F0R1_OFFSET: u32 = 0x240;
/// Offset of CAN_F27R2, the last register of the filter banks (32.9.4).
pub(super) const F27R2_OFFSET: u32 = 0x31c;
/// Bytes between two mailboxes.
pub(super) const MAILBOX_STRIDE: usize = 16;
/// Bytes between two filter banks.
pub(super) const FILTER_STRIDE: usize = 8;

/// CAN_MCR, INRQ: requests initialisation.
pub(crate) const MCR_INRQ: u32 = 1 << 0;
/// CAN_MCR, SLEEP: requests sleep.
pub(crate) const MCR_SLEEP: u32 = 1 << 1;
/// CAN_MCR, TXFP: mailboxes are sent in the order of their requests.
pub(crate) const MCR_TXFP: u32 = 1 << 2;
/// CAN_MCR, RFLM: a full FIFO keeps what it has.
pub(crate) const MCR_RFLM: u32 = 1 << 3;
/// CAN_MCR, NART: no frame is sent again.
pub(crate) const MCR_NART: u32 = 1 << 4;
/// CAN_MCR, ABOM: the controller leaves bus-off by itself.
pub(crate) const MCR_ABOM: u32 = 1 << 6;
/// CAN_MCR, RESET: resets the controller.
pub(super) const MCR_SOFTWARE_RESET: u32 = 1 << 15;
/// Writable bits of CAN_MCR.
pub(super) const MCR_WRITE_MASK: u32 = 0x0001_80ff;
/// Value of CAN_MCR after a reset: asleep, and frozen under a debugger.
pub(super) const MCR_RESET: u32 = 0x0001_0002;

/// CAN_MSR, SLAK: position of the flag of sleep.
pub(super) const MSR_SLAK_SHIFT: u32 = 1;
/// CAN_MSR, ERRI: position of the flag of an error interrupt.
pub(super) const MSR_ERRI_SHIFT: u32 = 2;
/// CAN_MSR, ERRI: an error interrupt; a write of 1 clears it.
pub(super) const MSR_ERRI: u32 = 1 << MSR_ERRI_SHIFT;
/// CAN_MSR, TXM: position of the flag of a frame that is sent.
pub(super) const MSR_TXM_SHIFT: u32 = 8;
/// CAN_MSR, RXM: position of the flag of a frame that is received.
pub(super) const MSR_RXM_SHIFT: u32 = 9;
/// CAN_MSR, RX and SAMP: the levels of the receive pin, recessive.
pub(super) const MSR_RX_SAMP: u32 = 0xc00;

/// CAN_TSR, RQCP0: the request of mailbox 0 is done.
pub(crate) const TSR_RQCP: u32 = 1 << 0;
/// CAN_TSR, TXOK0: the frame of mailbox 0 was sent.
pub(crate) const TSR_TXOK: u32 = 1 << 1;
/// CAN_TSR, TERR0: the frame of mailbox 0 failed by an error.
pub(crate) const TSR_TERR: u32 = 1 << 3;
/// CAN_TSR, ABRQ0: aborts the request of mailbox 0.
pub(super) const TSR_ABRQ: u32 = 1 << 7;
/// CAN_TSR: bits from one mailbox to the next.
pub(super) const TSR_MAILBOX_STRIDE_BITS: usize = 8;
/// CAN_TSR, CODE: position of the next empty mailbox.
pub(super) const TSR_CODE_SHIFT: u32 = 24;
/// CAN_TSR, TME0: position of the flag that mailbox 0 is empty.
pub(super) const TSR_TME0_SHIFT: usize = 26;
/// CAN_TSR, LOW0: position of the flag that mailbox 0 has the lowest priority.
pub(super) const TSR_LOW0_SHIFT: usize = 29;

/// CAN_RFxR, FULL: position of the flag of a full FIFO.
pub(super) const RFR_FULL_SHIFT: u32 = 3;
/// CAN_RFxR, FULL: the FIFO is full; a write of 1 clears it.
pub(super) const RFR_FULL: u32 = 1 << RFR_FULL_SHIFT;
/// CAN_RFxR, FOVR: position of the flag of an overrun.
pub(super) const RFR_FOVR_SHIFT: u32 = 4;
/// CAN_RFxR, FOVR: a frame was lost; a write of 1 clears it.
pub(super) const RFR_FOVR: u32 = 1 << RFR_FOVR_SHIFT;
/// CAN_RFxR, RFOM: releases the oldest frame.
pub(super) const RFR_RFOM: u32 = 1 << 5;

/// CAN_IER, TMEIE: enables the interrupt of RQCP.
pub(super) const IER_TMEIE: u32 = 1 << 0;
/// CAN_IER, FMPIE0: position of the enable bits of FIFO 0, FMPIE, FFIE and FOVIE.
pub(super) const IER_FIFO_SHIFT: usize = 1;
/// CAN_IER: bits from one FIFO to the next.
pub(super) const IER_FIFO_STRIDE_BITS: usize = 3;
/// CAN_IER, FMPIE: enables the interrupt of a frame in a FIFO, shifted down.
pub(super) const IER_FMPIE: u32 = 1 << 0;
/// CAN_IER, FFIE: enables the interrupt of a full FIFO, shifted down.
pub(super) const IER_FFIE: u32 = 1 << 1;
/// CAN_IER, FOVIE: enables the interrupt of an overrun, shifted down.
pub(super) const IER_FOVIE: u32 = 1 << 2;
/// CAN_IER, EWGIE: position of the enable bits of EWGF, EPVF and BOFF.
pub(crate) const IER_STATE_SHIFT: u32 = 8;
/// CAN_IER, LECIE: an error sets ERRI.
pub(crate) const IER_LECIE: u32 = 1 << 11;
/// CAN_IER, ERRIE: enables the interrupt of ERRI.
pub(super) const IER_ERRIE: u32 = 1 << 15;
/// Writable bits of CAN_IER.
pub(super) const IER_WRITE_MASK: u32 = 0x0003_8f7f;

/// CAN_ESR, EPVF: position of the flag of the error-passive state.
pub(super) const ESR_EPVF_SHIFT: u32 = 1;
/// CAN_ESR, BOFF: position of the flag of bus-off.
pub(super) const ESR_BOFF_SHIFT: u32 = 2;
/// CAN_ESR, EWGF, EPVF and BOFF: the states of errors.
pub(crate) const ESR_STATES: u32 = 0x7;
/// CAN_ESR, LEC: position of the last error code.
pub(super) const ESR_LEC_SHIFT: u32 = 4;
/// CAN_ESR, LEC: its three bits, shifted down.
pub(super) const ESR_LEC_MASK: u32 = 0x7;
/// CAN_ESR, LEC: no acknowledgement.
pub(crate) const LEC_ACKNOWLEDGEMENT: u32 = 3;
/// CAN_ESR, LEC: a dominant bit was sent and a recessive one read.
pub(crate) const LEC_BIT_DOMINANT: u32 = 5;
/// CAN_ESR, TEC: position of the transmit error counter.
pub(super) const ESR_TEC_SHIFT: u32 = 16;
/// CAN_ESR, REC: position of the receive error counter.
pub(super) const ESR_REC_SHIFT: u32 = 24;

/// CAN_BTR, BRP: the prescaler less one, ten bits.
pub(super) const BTR_BRP_MASK: u32 = 0x3ff;
/// CAN_BTR, TS1: position of the first segment less one.
pub(super) const BTR_TS1_SHIFT: u32 = 16;
/// CAN_BTR, TS1: its four bits, shifted down.
pub(super) const BTR_TS1_MASK: u32 = 0xf;
/// CAN_BTR, TS2: position of the second segment less one.
pub(super) const BTR_TS2_SHIFT: u32 = 20;
/// CAN_BTR, TS2: its three bits, shifted down.
pub(super) const BTR_TS2_MASK: u32 = 0x7;
/// CAN_BTR, SJW: position of the jump width less one.
pub(super) const BTR_SJW_SHIFT: u32 = 24;
/// CAN_BTR, SJW: its two bits, shifted down.
pub(super) const BTR_SJW_MASK: u32 = 0x3;
/// CAN_BTR, LBKM: number of the bit for loop-back.
pub(crate) const BTR_LBKM_BIT: u32 = 30;
/// CAN_BTR, SILM: number of the bit for silence.
pub(super) const BTR_SILM_BIT: u32 = 31;
/// CAN_BTR, LBKM and SILM: both bits, shifted down.
pub(crate) const BTR_TEST_MODES_MASK: u32 = 0x3;
/// Writable bits of CAN_BTR.
pub(super) const BTR_WRITE_MASK: u32 = 0xc37f_03ff;
/// Value of CAN_BTR after a reset.
pub(super) const BTR_RESET: u32 = 0x0123_0000;

/// CAN_TIxR, TXRQ: requests transmission of the mailbox.
pub(super) const TIR_TXRQ: u32 = 1 << 0;
/// CAN_TIxR and CAN_RIxR, RTR: position of the flag of a remote frame.
pub(crate) const IR_RTR_SHIFT: u32 = 1;
/// CAN_TIxR and CAN_RIxR, RTR: a remote frame.
pub(super) const IR_RTR: u32 = 1 << IR_RTR_SHIFT;
/// CAN_TIxR and CAN_RIxR, IDE: the identifier is extended.
pub(crate) const IR_IDE: u32 = 1 << 2;
/// CAN_TIxR and CAN_RIxR, EXID: position of the extended identifier.
pub(crate) const IR_EXID_SHIFT: u32 = 3;
/// CAN_TIxR and CAN_RIxR, STID: position of the standard identifier.
pub(crate) const IR_STID_SHIFT: u32 = 21;
/// CAN_TDTxR, DLC: the number of bytes, four bits.
pub(super) const TDTR_DLC_MASK: u32 = 0xf;
/// The implemented bits of CAN_TDTxR.
pub(super) const TDTR_MASK: u32 = 0xffff_010f;
/// CAN_RDTxR, FMI: position of the number of the filter that matched.
pub(super) const RDTR_FMI_SHIFT: u32 = 8;

/// CAN_FMR, FINIT: the filters are being initialised, and nothing is received.
pub(crate) const FMR_FINIT: u32 = 1 << 0;
/// CAN_FMR, CAN2SB: position of the first filter bank of CAN 2.
pub(crate) const FMR_CAN2SB_SHIFT: u32 = 8;
/// CAN_FMR, CAN2SB: its six bits, shifted down.
pub(crate) const FMR_CAN2SB_MASK: u32 = 0x3f;
/// Writable bits of CAN_FMR.
pub(super) const FMR_WRITE_MASK: u32 = 0x3f01;
/// Reserved bits of CAN_FMR, which read as after a reset.
pub(super) const FMR_RESERVED: u32 = 0x2a1c_0000;
/// Value of CAN_FMR after a reset.
pub(super) const FMR_RESET: u32 = 0x2a1c_0e01;
/// CAN_FA1R: a bit for each of the 28 filter banks.
pub(super) const FA1R_MASK: u32 = 0x0fff_ffff;
/// A filter of 16 bits in a register.
pub(crate) const FILTER_HALF_MASK: u32 = 0xffff;
/// Position of the upper filter of 16 bits in a register.
pub(crate) const FILTER_HALF_SHIFT: u32 = 16;
/// A filter of 16 bits: position of the standard identifier.
pub(crate) const FILTER_HALF_STID_SHIFT: u32 = 5;
/// A filter of 16 bits: position of RTR.
pub(crate) const FILTER_HALF_RTR_SHIFT: u32 = 4;
/// A filter of 16 bits: position of IDE.
pub(crate) const FILTER_HALF_IDE_SHIFT: u32 = 3;
/// A filter of 16 bits: EXID[17:15], three bits.
pub(crate) const FILTER_HALF_EXID_MASK: u32 = 0x7;
/// A filter of 32 bits: the lowest bit, which is no part of it.
pub(crate) const FILTER_UNUSED: u32 = 1 << 0;
