//! Registers of TIM11 that differ from those of TIM2 to TIM5 (RM0090 section 19.5).

/// Offset of TIM11_OR, the choice of the input (19.5.11).
pub(super) const OR_OFFSET: u32 = 0x50;
/// TIM11_OR, TI1_RMP: its two bits.
pub(super) const OR_TI1_RMP_MASK: u32 = 0x3;
/// TIM11_OR, TI1_RMP: the input is HSE_RTC.
pub(super) const TI1_RMP_HSE_RTC: u32 = 2;

/// Writable bits of TIM11_CR1.
pub(super) const CR1_WRITE_MASK: u32 = 0x387;
/// TIM11_CCMR1, CC1S: the channel captures TI1.
pub(super) const CCMR1_CC1S_TI1: u32 = 1;
/// TIM11_CCMR1, IC1PSC: position of the power of two of the edges in a capture.
pub(super) const CCMR1_IC1PSC_SHIFT: u32 = 2;
/// TIM11_CCMR1, IC1PSC: its two bits, shifted down.
pub(super) const CCMR1_IC1PSC_MASK: u32 = 0x3;
/// The implemented bits of TIM11_CCMR1.
pub(super) const CCMR1_MASK: u32 = 0xff;
/// Writable bits of TIM11_CCER.
pub(super) const CCER_WRITE_MASK: u32 = 0xb;
