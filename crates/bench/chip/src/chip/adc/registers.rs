//! Registers of the converters (RM0090 section 13.13).

/// Offset of ADC_SR, the status register (13.13.1).
pub(super) const SR_OFFSET: u32 = 0x00;
/// Offset of ADC_CR1, control register 1 (13.13.2).
pub(super) const CR1_OFFSET: u32 = 0x04;
/// Offset of ADC_CR2, control register 2 (13.13.3).
pub(super) const CR2_OFFSET: u32 = 0x08;
/// Offset of ADC_SMPR1, the sampling times of channels 10 to 18 (13.13.4).
pub(super) const SMPR1_OFFSET: u32 = 0x0c;
/// Offset of ADC_SMPR2, the sampling times of channels 0 to 9 (13.13.5).
pub(super) const SMPR2_OFFSET: u32 = 0x10;
/// Offset of ADC_JOFR1, the first offset of an injected channel (13.13.6).
pub(super) const JOFR1_OFFSET: u32 = 0x14;
/// Offset of ADC_JOFR4, the last offset of an injected channel (13.13.6).
pub(super) const JOFR4_OFFSET: u32 = 0x20;
/// Offset of ADC_HTR, the upper threshold of the watchdog (13.13.7).
pub(super) const HTR_OFFSET: u32 = 0x24;
/// Offset of ADC_LTR, the lower threshold of the watchdog (13.13.8).
pub(super) const LTR_OFFSET: u32 = 0x28;
/// Offset of ADC_SQR1, the length and the end of the regular sequence (13.13.9).
pub(super) const SQR1_OFFSET: u32 = 0x2c;
/// Offset of ADC_SQR3, the beginning of the regular sequence (13.13.11).
pub(super) const SQR3_OFFSET: u32 = 0x34;
/// Offset of ADC_JSQR, the injected sequence (13.13.12).
pub(super) const JSQR_OFFSET: u32 = 0x38;
/// Offset of ADC_JDR1, the first result of the injected sequence (13.13.13).
pub(super) const JDR1_OFFSET: u32 = 0x3c;
/// Offset of ADC_JDR4, the last result of the injected sequence (13.13.13).
pub(super) const JDR4_OFFSET: u32 = 0x48;
/// Offset of ADC_DR, the regular result (13.13.14).
pub(crate) const DR_OFFSET: u32 = 0x4c;
/// Offset of the first register that the three converters share.
pub(super) const COMMON_OFFSET: u32 = 0x300;
/// Offset of ADC_CSR, the status of all three (13.13.15).
pub(super) const CSR_OFFSET: u32 = 0x300;
/// Offset of ADC_CCR, the common control register (13.13.16).
pub(super) const CCR_OFFSET: u32 = 0x304;
/// Offset of ADC_CDR, the result of converters in common (13.13.17).
pub(super) const CDR_OFFSET: u32 = 0x308;
/// Position of the number of a converter in an offset.
pub(super) const UNIT_SHIFT: u32 = 8;

/// ADC_SR, AWD: number of the flag of the analog watchdog.
pub(super) const SR_AWD_BIT: u32 = 0;
/// ADC_SR, EOC: number of the flag of a regular conversion's end.
pub(super) const SR_EOC_BIT: u32 = 1;
/// ADC_SR, EOC: a regular conversion has ended.
pub(crate) const SR_EOC: u32 = 1 << SR_EOC_BIT;
/// ADC_SR, JEOC: number of the flag of the injected sequence's end.
pub(super) const SR_JEOC_BIT: u32 = 2;
/// ADC_SR, JEOC: the injected sequence has ended.
pub(crate) const SR_JEOC: u32 = 1 << SR_JEOC_BIT;
/// ADC_SR, JSTRT: an injected sequence has begun.
pub(crate) const SR_JSTRT: u32 = 1 << 3;
/// ADC_SR, STRT: a regular sequence has begun.
pub(crate) const SR_STRT: u32 = 1 << 4;
/// ADC_SR, OVR: number of the flag of an overrun.
pub(super) const SR_OVR_BIT: u32 = 5;
/// ADC_SR, OVR: a result was lost.
pub(crate) const SR_OVR: u32 = 1 << SR_OVR_BIT;
/// The flags of ADC_SR, as ADC_CSR repeats them.
pub(super) const SR_MASK: u32 = 0x3f;

/// ADC_CR1, EOCIE: number of the enable bit of EOC.
pub(super) const CR1_EOCIE_BIT: u32 = 5;
/// ADC_CR1, AWDIE: number of the enable bit of AWD.
pub(super) const CR1_AWDIE_BIT: u32 = 6;
/// ADC_CR1, JEOCIE: number of the enable bit of JEOC.
pub(super) const CR1_JEOCIE_BIT: u32 = 7;
/// ADC_CR1, SCAN: the whole sequence is converted.
pub(crate) const CR1_SCAN: u32 = 1 << 8;
/// ADC_CR1, DISCEN: the regular sequence is discontinuous.
pub(crate) const CR1_DISCEN: u32 = 1 << 11;
/// ADC_CR1, DISCNUM: position of the channels of a discontinuous part, less one.
pub(crate) const CR1_DISCNUM_SHIFT: u32 = 13;
/// ADC_CR1, DISCNUM: its three bits, shifted down.
pub(crate) const CR1_DISCNUM_MASK: u32 = 0x7;
/// ADC_CR1, RES: position of the resolution.
pub(crate) const CR1_RES_SHIFT: u32 = 24;
/// ADC_CR1, RES: its two bits, shifted down.
pub(crate) const CR1_RES_MASK: u32 = 0x3;
/// ADC_CR1, OVRIE: number of the enable bit of OVR.
pub(super) const CR1_OVRIE_BIT: u32 = 26;
/// Writable bits of ADC_CR1.
pub(super) const CR1_WRITE_MASK: u32 = 0x07c0_ffff;

/// ADC_CR2, ADON: switches the converter on.
pub(crate) const CR2_ADON: u32 = 1 << 0;
/// ADC_CR2, CONT: the sequence begins anew at its end.
pub(crate) const CR2_CONT: u32 = 1 << 1;
/// ADC_CR2, DMA: a result requests the DMA.
pub(crate) const CR2_DMA: u32 = 1 << 8;
/// ADC_CR2, DDS: requests go on after the DMA's last transfer.
pub(crate) const CR2_DDS: u32 = 1 << 9;
/// ADC_CR2, EOCS: EOC at the end of each conversion.
pub(crate) const CR2_EOCS: u32 = 1 << 10;
/// ADC_CR2, ALIGN: the result stands at the left.
pub(crate) const CR2_ALIGN: u32 = 1 << 11;
/// ADC_CR2, JEXTSEL: position of the source that starts the injected sequence.
pub(crate) const CR2_JEXTSEL_SHIFT: u32 = 16;
/// ADC_CR2, JEXTEN: position of the edge that starts the injected sequence.
pub(crate) const CR2_JEXTEN_SHIFT: u32 = 20;
/// ADC_CR2, JSWSTART: starts the injected sequence.
pub(super) const CR2_JSWSTART: u32 = 1 << 22;
/// ADC_CR2, EXTSEL: position of the source that starts the regular sequence.
pub(crate) const CR2_EXTSEL_SHIFT: u32 = 24;
/// ADC_CR2, EXTEN: position of the edge that starts the regular sequence.
pub(crate) const CR2_EXTEN_SHIFT: u32 = 28;
/// ADC_CR2, EXTSEL and JEXTSEL: their four bits, shifted down.
pub(crate) const CR2_EXTSEL_MASK: u32 = 0xf;
/// ADC_CR2, EXTEN and JEXTEN: their two bits, shifted down; 0: no edge.
pub(crate) const CR2_EXTEN_MASK: u32 = 0x3;
/// ADC_CR2, SWSTART: starts the regular sequence.
pub(super) const CR2_SWSTART: u32 = 1 << 30;
/// Writable bits of ADC_CR2.
pub(super) const CR2_WRITE_MASK: u32 = 0x7f7f_0f03;

/// Writable bits of ADC_SMPR1: three for each of channels 10 to 18.
pub(super) const SMPR1_WRITE_MASK: u32 = 0x07ff_ffff;
/// Writable bits of ADC_SMPR2: three for each of channels 0 to 9.
pub(super) const SMPR2_WRITE_MASK: u32 = 0x3fff_ffff;
/// ADC_SMPRx: the three bits of a channel, shifted down.
pub(crate) const SMP_MASK: u32 = 0x7;

/// The twelve bits of an offset or of a threshold.
pub(super) const TWELVE_BITS_MASK: u32 = 0xfff;
/// Value of ADC_HTR after a reset (13.13.7).
pub(super) const HTR_RESET: u32 = 0xfff;

/// ADC_SQRx and ADC_JSQR: the five bits of a channel, shifted down.
pub(crate) const SQ_CHANNEL_MASK: u32 = 0x1f;
/// ADC_SQR1, L, and ADC_JSQR, JL: position of the length of a sequence, less one.
pub(crate) const SEQUENCE_LENGTH_SHIFT: u32 = 20;
/// ADC_SQR1, L: its four bits, shifted down.
pub(crate) const SQR1_L_MASK: u32 = 0xf;
/// ADC_JSQR, JL: its two bits, shifted down.
pub(crate) const JSQR_JL_MASK: u32 = 0x3;
/// The implemented bits of ADC_JSQR.
pub(super) const JSQR_MASK: u32 = 0x003f_ffff;

/// ADC_CCR, MULTI: converters in common, five bits.
pub(super) const CCR_MULTI_MASK: u32 = 0x1f;
/// ADC_CCR, ADCPRE: position of the prescaler.
pub(crate) const CCR_ADCPRE_SHIFT: u32 = 16;
/// ADC_CCR, ADCPRE: its two bits, shifted down.
pub(crate) const CCR_ADCPRE_MASK: u32 = 0x3;
/// ADC_CCR, VBATE: number of the bit that connects the battery's channel.
pub(crate) const CCR_VBATE_BIT: u32 = 22;
/// ADC_CCR, TSVREFE: number of the bit that connects the temperature sensor and VREFINT.
pub(crate) const CCR_TSVREFE_BIT: u32 = 23;
/// ADC_CCR, TSVREFE: connects the temperature sensor and VREFINT.
pub(super) const CCR_TSVREFE: u32 = 1 << CCR_TSVREFE_BIT;
/// Writable bits of ADC_CCR.
pub(super) const CCR_WRITE_MASK: u32 = 0x00c3_ef1f;
