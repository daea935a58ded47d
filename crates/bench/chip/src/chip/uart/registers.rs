//! Registers of the USART (RM0090 section 30.6).

/// Offset of USART_SR, the status register (30.6.1).
pub(crate) const SR_OFFSET: u32 = 0x00;
/// Offset of USART_DR, the data register (30.6.2).
pub(crate) const DR_OFFSET: u32 = 0x04;
/// Offset of USART_BRR, the baud rate register (30.6.3).
pub(super) const BRR_OFFSET: u32 = 0x08;
/// Offset of USART_CR1, control register 1 (30.6.4).
pub(super) const CR1_OFFSET: u32 = 0x0c;
/// Offset of USART_CR2, control register 2 (30.6.5).
pub(super) const CR2_OFFSET: u32 = 0x10;
/// Offset of USART_CR3, control register 3 (30.6.6).
pub(super) const CR3_OFFSET: u32 = 0x14;

/// USART_SR, PE: the parity of a received character is wrong.
pub(crate) const SR_PE: u32 = 1 << 0;
/// USART_SR, FE: a character came without its stop bit, or a break.
pub(crate) const SR_FE: u32 = 1 << 1;
/// USART_SR, NF: samples of a received bit differ.
pub(crate) const SR_NF: u32 = 1 << 2;
/// USART_SR, ORE: a character came while the last one was not yet read.
pub(super) const SR_ORE: u32 = 1 << 3;
/// USART_SR, IDLE: the line was idle for a whole frame.
pub(super) const SR_IDLE: u32 = 1 << 4;
/// USART_SR, RXNE: the data register holds a received character.
pub(super) const SR_RXNE: u32 = 1 << 5;
/// USART_SR, TC: the last transmission is complete.
pub(super) const SR_TC: u32 = 1 << 6;
/// USART_SR, TXE: the data register can take the next character.
pub(super) const SR_TXE: u32 = 1 << 7;
/// USART_SR, LBD: a LIN break was detected.
pub(super) const SR_LBD: u32 = 1 << 8;
/// USART_SR, CTS: the level of nCTS has changed.
pub(super) const SR_CTS: u32 = 1 << 9;
/// Value of USART_SR after a reset: TC and TXE.
pub(super) const SR_RESET: u32 = SR_TXE | SR_TC;
/// Flags of USART_SR that a write of 0 clears.
pub(super) const SR_CLEARED_BY_ZERO: u32 = SR_CTS | SR_LBD | SR_TC | SR_RXNE;
/// Flags of USART_SR that a read of USART_SR, followed by one of USART_DR, clears.
pub(super) const SR_CLEARED_BY_READ: u32 = SR_IDLE | SR_ORE | SR_NF | SR_FE | SR_PE;
/// Flags of USART_SR for which USART_CR3.EIE enables an interrupt.
pub(super) const SR_ERROR_MASK: u32 = SR_ORE | SR_NF | SR_FE;

/// The implemented bits of USART_BRR.
pub(super) const BRR_MASK: u32 = 0xffff;
/// USART_BRR, DIV_Fraction with OVER8: three bits.
pub(super) const BRR_FRACTION_OVER8_MASK: u32 = 0x7;

/// USART_CR1, RE: enables the receiver.
pub(super) const CR1_RE: u32 = 1 << 2;
/// USART_CR1, TE: enables the transmitter.
pub(super) const CR1_TE: u32 = 1 << 3;
/// USART_CR1, IDLEIE: enables the interrupt of IDLE.
pub(super) const CR1_IDLEIE: u32 = 1 << 4;
/// USART_CR1, RXNEIE: enables the interrupt of RXNE and of ORE.
pub(super) const CR1_RXNEIE: u32 = 1 << 5;
/// USART_CR1, TCIE: enables the interrupt of TC.
pub(super) const CR1_TCIE: u32 = 1 << 6;
/// USART_CR1, TXEIE: enables the interrupt of TXE.
pub(super) const CR1_TXEIE: u32 = 1 << 7;
/// USART_CR1, PEIE: enables the interrupt of PE.
pub(super) const CR1_PEIE: u32 = 1 << 8;
/// USART_CR1, PS: the parity is odd.
pub(super) const CR1_PS: u32 = 1 << 9;
/// USART_CR1, PCE: enables the parity.
pub(super) const CR1_PCE: u32 = 1 << 10;
/// USART_CR1, M: a word of nine bits.
pub(super) const CR1_M: u32 = 1 << 12;
/// USART_CR1, UE: enables the unit.
pub(super) const CR1_UE: u32 = 1 << 13;
/// USART_CR1, OVER8: eight samples a bit instead of sixteen.
pub(super) const CR1_OVER8: u32 = 1 << 15;
/// Enable bits of USART_CR1 at the same places as their flags in USART_SR.
pub(super) const CR1_FLAG_ENABLES: u32 = CR1_TXEIE | CR1_TCIE | CR1_RXNEIE | CR1_IDLEIE;
/// Writable bits of USART_CR1.
pub(super) const CR1_WRITE_MASK: u32 = 0xbfff;

/// USART_CR2, STOP: position of the field for the number of stop bits.
pub(super) const CR2_STOP_SHIFT: u32 = 12;
/// USART_CR2, STOP: its two bits, shifted down.
pub(super) const CR2_STOP_MASK: u32 = 0x3;
/// Writable bits of USART_CR2.
pub(super) const CR2_WRITE_MASK: u32 = 0x7f6f;

/// USART_CR3, EIE: enables the interrupt of FE, ORE and NF.
pub(super) const CR3_EIE: u32 = 1 << 0;
/// USART_CR3, DMAR: the receiver requests the DMA.
pub(super) const CR3_DMAR: u32 = 1 << 6;
/// USART_CR3, DMAT: the transmitter requests the DMA.
pub(super) const CR3_DMAT: u32 = 1 << 7;
/// Writable bits of USART_CR3.
pub(super) const CR3_WRITE_MASK: u32 = 0x0fff;
