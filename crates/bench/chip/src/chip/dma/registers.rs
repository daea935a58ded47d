//! Registers of the DMA (RM0090 section 10.5).

/// Offset of DMA_LISR, the flags of streams 0 to 3 (10.5.1).
pub(super) const LISR_OFFSET: u32 = 0x00;
/// Offset of DMA_HISR, the flags of streams 4 to 7 (10.5.2).
pub(super) const HISR_OFFSET: u32 = 0x04;
/// Offset of DMA_LIFCR, which clears the flags of streams 0 to 3 (10.5.3).
pub(super) const LIFCR_OFFSET: u32 = 0x08;
/// Offset of DMA_HIFCR, which clears the flags of streams 4 to 7 (10.5.4).
pub(super) const HIFCR_OFFSET: u32 = 0x0c;
/// Offset of DMA_S0CR, the first register of the first stream (10.5.5).
pub(super) const STREAMS_OFFSET: u32 = 0x10;
/// Offset of DMA_S7FCR, the last register of the last stream (10.5.10).
pub(super) const STREAMS_LAST_OFFSET: u32 = 0xcc;
/// Bytes between the registers of two streams.
pub(super) const STREAM_STRIDE: usize = 0x18;

/// DMA_SxCR, EN: the stream is on.
pub(super) const CR_EN: u32 = 1 << 0;
/// DMA_SxCR, DMEIE: enables the interrupt of DMEIF.
pub(super) const CR_DMEIE: u32 = 1 << 1;
/// DMA_SxCR, TEIE: enables the interrupt of TEIF.
pub(super) const CR_TEIE: u32 = 1 << 2;
/// DMA_SxCR, HTIE: enables the interrupt of HTIF.
pub(super) const CR_HTIE: u32 = 1 << 3;
/// DMA_SxCR, TCIE: enables the interrupt of TCIF.
pub(super) const CR_TCIE: u32 = 1 << 4;
/// DMA_SxCR, DIR: position of the direction.
pub(super) const CR_DIR_SHIFT: u32 = 6;
/// DMA_SxCR, DIR: its two bits, shifted down.
pub(super) const CR_DIR_MASK: u32 = 0x3;
/// DMA_SxCR, DIR: from the peripheral to the memory.
pub(super) const DIR_PERIPHERAL_TO_MEMORY: u32 = 0;
/// DMA_SxCR, DIR: from the memory to the peripheral.
pub(super) const DIR_MEMORY_TO_PERIPHERAL: u32 = 1;
/// DMA_SxCR, CIRC: the stream begins anew at its end.
pub(super) const CR_CIRC: u32 = 1 << 8;
/// DMA_SxCR, MINC: the memory address goes on with each item.
pub(super) const CR_MINC: u32 = 1 << 10;
/// DMA_SxCR, PSIZE: position of the power of two of the bytes of an item at the peripheral.
pub(super) const CR_PSIZE_SHIFT: u32 = 11;
/// DMA_SxCR, MSIZE: position of the power of two of the bytes of an item in the memory.
pub(super) const CR_MSIZE_SHIFT: u32 = 13;
/// DMA_SxCR, PSIZE and MSIZE: their two bits, shifted down.
pub(super) const CR_SIZE_MASK: u32 = 0x3;
/// DMA_SxCR, DBM: two buffers in turn.
pub(super) const CR_DBM: u32 = 1 << 18;
/// DMA_SxCR, CT: number of the bit.
pub(super) const CR_CT_BIT: u32 = 19;
/// DMA_SxCR, CT: the second buffer is in use.
pub(super) const CR_CT: u32 = 1 << CR_CT_BIT;
/// DMA_SxCR, CHSEL: position of the channel.
pub(super) const CR_CHSEL_SHIFT: u32 = 25;
/// DMA_SxCR, CHSEL: its three bits, shifted down.
pub(super) const CR_CHSEL_MASK: u32 = 0x7;
/// Bits of DMA_SxCR that must not change while the stream is on: all from PFCTRL on but CT.
pub(super) const CR_SETTINGS_MASK: u32 = 0x0ff7_ffe0;
/// Reserved bits of DMA_SxCR.
pub(super) const CR_RESERVED_MASK: u32 = 0xf010_0000;
/// The implemented bits of DMA_SxCR.
pub(super) const CR_MASK: u32 = 0x0fef_ffff;
/// The implemented bits of DMA_SxNDTR.
pub(super) const NDTR_MASK: u32 = 0xffff;

/// DMA_SxFCR, DMDIS: the FIFO is in use instead of the direct mode.
pub(super) const FCR_DMDIS: u32 = 1 << 2;
/// DMA_SxFCR, FS: the fill level of the FIFO, read-only.
pub(super) const FCR_FS: u32 = 0x38;
/// DMA_SxFCR, FEIE: enables the interrupt of FEIF.
pub(super) const FCR_FEIE: u32 = 1 << 7;
/// The implemented bits of DMA_SxFCR.
pub(super) const FCR_MASK: u32 = 0xbf;
/// Value of DMA_SxFCR after a reset: an empty FIFO with a threshold of half of it.
pub(super) const FCR_RESET: u32 = 0x21;

/// DMA_LISR, FEIF of stream 0: an error of the FIFO.
pub(super) const ISR_FEIF: u32 = 1 << 0;
/// DMA_LISR, DMEIF of stream 0: an error of the direct mode.
pub(super) const ISR_DMEIF: u32 = 1 << 2;
/// DMA_LISR, TEIF of stream 0: a transfer error.
pub(super) const ISR_TEIF: u32 = 1 << 3;
/// DMA_LISR, HTIF of stream 0: half of the items are done.
pub(super) const ISR_HTIF: u32 = 1 << 4;
/// DMA_LISR, TCIF of stream 0: all items are done.
pub(super) const ISR_TCIF: u32 = 1 << 5;
/// The flags of stream 0.
pub(super) const ISR_STREAM_MASK: u32 = ISR_TCIF | ISR_HTIF | ISR_TEIF | ISR_DMEIF | ISR_FEIF;
