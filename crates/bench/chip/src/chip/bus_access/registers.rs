//! Registers that the bus answers for itself (RM0090 sections 12.3, EXTI, and 38, DBGMCU), addresses of the data
//! registers whose reads have effects, and the lanes of a narrow write.

use crate::{
    chip::{
        adc::registers::DR_OFFSET as ADC_DR_OFFSET, spi::registers::DR_OFFSET as SPI_DR_OFFSET,
        uart::registers::DR_OFFSET as USART_DR_OFFSET,
    },
    memory_map::{ADC1_BASE, ADC2_BASE, SPI2_BASE, USART1_BASE, USART3_BASE},
};

/// Address of the data register of USART1.
pub(super) const USART1_DR: u32 = USART1_BASE + USART_DR_OFFSET;
/// Address of the data register of USART3.
pub(super) const USART3_DR: u32 = USART3_BASE + USART_DR_OFFSET;
/// Address of the data register of SPI2.
pub(super) const SPI2_DR: u32 = SPI2_BASE + SPI_DR_OFFSET;
/// Address of the regular data register of ADC1.
pub(super) const ADC1_DR: u32 = ADC1_BASE + ADC_DR_OFFSET;
/// Address of the regular data register of ADC2.
pub(super) const ADC2_DR: u32 = ADC2_BASE + ADC_DR_OFFSET;

/// Offset of EXTI_IMR, the interrupt mask (12.3.1).
pub(super) const EXTI_IMR_OFFSET: u32 = 0x00;
/// Offset of EXTI_EMR, the event mask (12.3.2).
pub(super) const EXTI_EMR_OFFSET: u32 = 0x04;
/// Offset of EXTI_RTSR, the lines that a rising edge triggers (12.3.3).
pub(super) const EXTI_RTSR_OFFSET: u32 = 0x08;
/// Offset of EXTI_FTSR, the lines that a falling edge triggers (12.3.4).
pub(super) const EXTI_FTSR_OFFSET: u32 = 0x0c;
/// Offset of EXTI_PR, the pending lines (12.3.6).
pub(super) const EXTI_PR_OFFSET: u32 = 0x14;

/// Offset of DBGMCU_IDCODE, the identity of the device.
pub(super) const DBGMCU_IDCODE_OFFSET: u32 = 0x00;
/// Offset of DBGMCU_CR, the behaviour in low-power modes under a debugger.
pub(super) const DBGMCU_CR_OFFSET: u32 = 0x04;
/// Offset of DBGMCU_APB1_FZ, the units of APB1 that a halt freezes.
pub(super) const DBGMCU_APB1_FZ_OFFSET: u32 = 0x08;
/// Offset of DBGMCU_APB2_FZ, the units of APB2 that a halt freezes.
pub(super) const DBGMCU_APB2_FZ_OFFSET: u32 = 0x0c;
/// Value of DBGMCU_IDCODE: revision 0x1007 of device 0x413, with the reserved bits 15:12 at 0b0110.
pub(super) const DBGMCU_IDCODE: u32 = 0x1007_6413;

/// Repeats a byte in all four lanes of a word, when multiplied with it.
pub(super) const BYTE_LANES: u32 = 0x0101_0101;
/// Repeats a half-word in both halves of a word, when multiplied with it.
pub(super) const HALF_WORD_LANES: u32 = 0x0001_0001;
/// The lower half-word.
pub(super) const HALF_WORD_MASK: u32 = 0xffff;
