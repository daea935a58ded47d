//! Registers of the timers (RM0090 sections 17.4, 18.4, 19.5 and 20.4): the same places in all of them.

/// Offset of TIMx_CR1, control register 1 (18.4.1).
pub(crate) const CR1_OFFSET: u32 = 0x00;
/// Offset of TIMx_CR2, control register 2 (18.4.2).
pub(super) const CR2_OFFSET: u32 = 0x04;
/// Offset of TIMx_SMCR, the slave mode (18.4.3).
pub(super) const SMCR_OFFSET: u32 = 0x08;
/// Offset of TIMx_DIER, the enable bits of interrupts and DMA requests (18.4.4).
pub(crate) const DIER_OFFSET: u32 = 0x0c;
/// Offset of TIMx_SR, the status register (18.4.5).
pub(crate) const SR_OFFSET: u32 = 0x10;
/// Offset of TIMx_EGR, which generates events (18.4.6).
pub(crate) const EGR_OFFSET: u32 = 0x14;
/// Offset of TIMx_CCMR1, the modes of channels 1 and 2 (18.4.7).
pub(crate) const CCMR1_OFFSET: u32 = 0x18;
/// Offset of TIMx_CCMR2, the modes of channels 3 and 4 (18.4.8).
pub(super) const CCMR2_OFFSET: u32 = 0x1c;
/// Offset of TIMx_CCER, the enable bits of the channels (18.4.9).
pub(crate) const CCER_OFFSET: u32 = 0x20;
/// Offset of TIMx_CNT, the counter (18.4.10).
pub(crate) const CNT_OFFSET: u32 = 0x24;
/// Offset of TIMx_PSC, the prescaler (18.4.11).
pub(crate) const PSC_OFFSET: u32 = 0x28;
/// Offset of TIMx_ARR, the last value before the counter begins anew (18.4.12).
pub(crate) const ARR_OFFSET: u32 = 0x2c;
/// Offset of TIMx_CCR1, the capture or compare value of channel 1 (18.4.13).
pub(crate) const CCR1_OFFSET: u32 = 0x34;
/// Offset of TIMx_CCR4, the capture or compare value of channel 4 (18.4.16).
pub(super) const CCR4_OFFSET: u32 = 0x40;

/// TIMx_CR1, CEN: the counter runs.
pub(crate) const CR1_CEN: u32 = 1 << 0;
/// TIMx_CR1, UDIS: no update events.
pub(super) const CR1_UDIS: u32 = 1 << 1;
/// TIMx_CR1, URS: UG raises no flag.
pub(super) const CR1_URS: u32 = 1 << 2;
/// TIMx_CR1, OPM: the counter stops at an update.
pub(super) const CR1_OPM: u32 = 1 << 3;
/// TIMx_CR1, DIR and CMS: counts down or up and down.
pub(super) const CR1_DIR_CMS_MASK: u32 = 0x70;
/// TIMx_CR1, ARPE: TIMx_ARR takes effect at an update.
pub(super) const CR1_ARPE: u32 = 1 << 7;
/// Writable bits of TIMx_CR1.
pub(super) const CR1_WRITE_MASK: u32 = 0x3ff;

/// TIMx_CR2, MMS: position of the source of the trigger output.
pub(super) const CR2_MMS_SHIFT: u32 = 4;
/// TIMx_CR2, MMS: its three bits, shifted down.
pub(super) const CR2_MMS_MASK: u32 = 0x7;
/// TIMx_CR2, MMS: the update event.
pub(super) const MMS_UPDATE: u32 = 2;
/// TIMx_CR2, MMS: a pulse at a match of channel 1.
pub(super) const MMS_COMPARE_PULSE: u32 = 3;
/// TIMx_CR2, MMS: the output of channel 1; those of channels 2 to 4 follow.
pub(super) const MMS_OC1REF: u32 = 4;
/// Writable bits of TIMx_CR2.
pub(super) const CR2_WRITE_MASK: u32 = 0xf8;

/// TIMx_SMCR, SMS: the slave mode, three bits.
pub(super) const SMCR_SMS_MASK: u32 = 0x7;
/// TIMx_SMCR, SMS: no slave mode.
pub(super) const SMS_OFF: u32 = 0;
/// TIMx_SMCR, SMS: the trigger clears the counter.
pub(super) const SMS_RESET: u32 = 4;
/// TIMx_SMCR, SMS: the trigger starts the counter.
pub(super) const SMS_TRIGGER: u32 = 6;
/// TIMx_SMCR, SMS: the counter counts the trigger's pulses.
pub(super) const SMS_EXTERNAL_CLOCK: u32 = 7;
/// TIMx_SMCR, TS: position of the trigger.
pub(super) const SMCR_TS_SHIFT: u32 = 4;
/// TIMx_SMCR, TS: its three bits, shifted down.
pub(super) const SMCR_TS_MASK: u32 = 0x7;
/// TIMx_SMCR, TS: the last of the internal triggers, ITR3.
pub(super) const TS_ITR3: u32 = 3;
/// TIMx_SMCR, TS: the number of an internal trigger, shifted down.
pub(super) const TS_ITR_MASK: u32 = 0x3;

/// TIMx_SR, UIF: an update event.
pub(super) const SR_UIF: u32 = 1 << 0;
/// TIMx_SR, CC1IF: a match or capture of channel 1; those of channels 2 to 4 follow.
pub(crate) const SR_CC1IF: u32 = 1 << 1;
/// TIMx_SR, CC1OF: a capture of channel 1 was lost.
pub(crate) const SR_CC1OF: u32 = 1 << 9;
/// TIMx_SR: the flags with an enable bit at the same place of TIMx_DIER: UIF, CC1IF to CC4IF, TIF.
pub(crate) const SR_INTERRUPT_FLAGS: u32 = 0x5f;

/// Writable bits of TIMx_DIER.
pub(super) const DIER_WRITE_MASK: u32 = 0x5f5f;

/// TIMx_EGR, UG: generates an update event.
pub(super) const EGR_UG: u32 = 1 << 0;
/// TIMx_EGR: the other events, whose flags stand at the same places of TIMx_SR.
pub(super) const EGR_FLAGS_MASK: u32 = 0x5e;

/// TIMx_CCMRx, CCxS: the direction of a channel, two bits.
pub(crate) const CCMR_CCS_MASK: u32 = 0x3;
/// TIMx_CCMRx: bits from one channel to the next.
pub(super) const CCMR_CHANNEL_BITS: usize = 8;
/// TIMx_CCMRx, OCxPE: number of the bit by which TIMx_CCRx takes effect at an update.
pub(super) const CCMR_OCPE_BIT: usize = 3;
/// TIMx_CCMRx, OCxM: position of the mode of an output.
pub(super) const CCMR_OCM_SHIFT: usize = 4;
/// TIMx_CCMRx, OCxM: its three bits, shifted down.
pub(super) const CCMR_OCM_MASK: u32 = 0x7;
/// TIMx_CCMRx, OCxM: the output goes active at a match.
pub(super) const OCM_ACTIVE: u32 = 1;
/// TIMx_CCMRx, OCxM: the output toggles at a match.
pub(super) const OCM_TOGGLE: u32 = 3;
/// TIMx_CCMRx, OCxM: PWM mode 1, active until a match.
pub(super) const OCM_PWM1: u32 = 6;
/// TIMx_CCMRx, OCxM: PWM mode 2, active from a match on.
pub(super) const OCM_PWM2: u32 = 7;

/// TIMx_CCER: bits from one channel to the next.
pub(super) const CCER_CHANNEL_BITS: usize = 4;
/// TIMx_CCER, CC1E: enables channel 1.
pub(crate) const CCER_CC1E: u32 = 1 << 0;
/// Writable bits of TIMx_CCER.
pub(super) const CCER_WRITE_MASK: u32 = 0xbbbb;

/// The 16 bits of a register or of a counter.
pub(crate) const HALF_WORD_MASK: u32 = 0xffff;
/// Value of TIMx_ARR after a reset, of a counter of 16 bits (18.4.12).
pub(crate) const ARR_RESET: u32 = 0xffff;
