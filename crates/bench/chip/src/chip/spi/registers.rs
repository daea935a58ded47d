//! Registers of the SPI (RM0090 section 28.5).

/// Offset of SPI_CR1, control register 1 (28.5.1).
pub(super) const CR1_OFFSET: u32 = 0x00;
/// Offset of SPI_CR2, control register 2 (28.5.2).
pub(super) const CR2_OFFSET: u32 = 0x04;
/// Offset of SPI_SR, the status register (28.5.3).
pub(super) const SR_OFFSET: u32 = 0x08;
/// Offset of SPI_DR, the data register (28.5.4).
pub(crate) const DR_OFFSET: u32 = 0x0c;
/// Offset of SPI_CRCPR, the polynomial of the CRC (28.5.5).
pub(super) const CRCPR_OFFSET: u32 = 0x10;

/// SPI_CR1, CPHA: the second edge of the clock captures a bit.
pub(super) const CR1_CPHA: u32 = 1 << 0;
/// SPI_CR1, CPOL: position of the idle level of the clock.
pub(super) const CR1_CPOL_SHIFT: u32 = 1;
/// SPI_CR1, MSTR: the unit is the master.
pub(super) const CR1_MSTR: u32 = 1 << 2;
/// SPI_CR1, BR: position of the field for the division of the clock.
pub(super) const CR1_BR_SHIFT: u32 = 3;
/// SPI_CR1, BR: its three bits, shifted down.
pub(super) const CR1_BR_MASK: u32 = 0x7;
/// SPI_CR1, SPE: enables the unit.
pub(super) const CR1_SPE: u32 = 1 << 6;
/// SPI_CR1, SSI: the level that SSM puts in the place of NSS.
pub(super) const CR1_SSI: u32 = 1 << 8;
/// SPI_CR1, SSM: software drives NSS by SSI.
pub(super) const CR1_SSM: u32 = 1 << 9;
/// SPI_CR1, DFF: a frame of 16 bits instead of 8.
pub(super) const CR1_DFF: u32 = 1 << 11;
/// The implemented bits of SPI_CR1.
pub(super) const CR1_MASK: u32 = 0xffff;
/// Bits of SPI_CR1 that set the format and the clock: CPHA, CPOL, MSTR, BR, LSBFIRST, SSI, SSM and DFF.
pub(super) const CR1_SETTINGS_MASK: u32 = 0x0bbf;

/// SPI_CR2, RXDMAEN: RXNE requests the DMA.
pub(super) const CR2_RXDMAEN: u32 = 1 << 0;
/// SPI_CR2, TXDMAEN: TXE requests the DMA.
pub(super) const CR2_TXDMAEN: u32 = 1 << 1;
/// SPI_CR2, SSOE: NSS is an output in master mode.
pub(super) const CR2_SSOE: u32 = 1 << 2;
/// SPI_CR2, ERRIE: enables the interrupt of the error flags.
pub(super) const CR2_ERRIE: u32 = 1 << 5;
/// SPI_CR2, RXNEIE: enables the interrupt of RXNE.
pub(super) const CR2_RXNEIE: u32 = 1 << 6;
/// SPI_CR2, TXEIE: enables the interrupt of TXE.
pub(super) const CR2_TXEIE: u32 = 1 << 7;
/// Writable bits of SPI_CR2.
pub(super) const CR2_WRITE_MASK: u32 = 0xf7;

/// SPI_SR, RXNE: the receive buffer holds a frame.
pub(super) const SR_RXNE: u32 = 1 << 0;
/// SPI_SR, TXE: the transmit buffer is empty.
pub(super) const SR_TXE: u32 = 1 << 1;
/// SPI_SR, CRCERR: the received CRC is wrong.
pub(super) const SR_CRCERR: u32 = 1 << 4;
/// SPI_SR, MODF: a mode fault, NSS was low at a master.
pub(super) const SR_MODF: u32 = 1 << 5;
/// SPI_SR, OVR: a frame came while the last one was not yet read.
pub(super) const SR_OVR: u32 = 1 << 6;
/// SPI_SR, BSY: position of the flag of a transfer under way.
pub(super) const SR_BSY_SHIFT: u32 = 7;
/// Error flags of SPI_SR for which SPI_CR2.ERRIE enables an interrupt.
pub(super) const SR_ERROR_MASK: u32 = SR_OVR | SR_MODF | SR_CRCERR;
/// Value of SPI_SR after a reset: TXE.
pub(super) const SR_RESET: u32 = SR_TXE;

/// Value of SPI_CRCPR after a reset.
pub(super) const CRCPR_RESET: u32 = 0x7;
