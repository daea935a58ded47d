//! Registers of the CRC unit (RM0090 section 4.4).

/// Offset of CRC_DR, the data register (4.4.1).
pub(super) const DR_OFFSET: u32 = 0x00;
/// Offset of CRC_IDR, a byte that the unit only stores (4.4.2).
pub(super) const IDR_OFFSET: u32 = 0x04;
/// Offset of CRC_CR, the control register (4.4.3).
pub(super) const CR_OFFSET: u32 = 0x08;

/// Value of CRC_DR after a reset.
pub(super) const DR_RESET: u32 = u32::MAX;
/// The implemented bits of CRC_IDR.
pub(super) const IDR_MASK: u32 = 0xff;
/// CRC_CR, RESET: sets the data register to its reset value.
pub(super) const CR_COMPUTATION_RESET: u32 = 1 << 0;
/// The generator polynomial of CRC-32.
pub(super) const POLYNOMIAL: u32 = 0x04c1_1db7;
