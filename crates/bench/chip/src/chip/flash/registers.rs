//! Registers of the flash interface (RM0090 section 3.9), and the sizes of the sectors.

/// Offset of FLASH_ACR, access control (3.9.1).
pub(super) const ACR_OFFSET: u32 = 0x00;
/// Offset of FLASH_KEYR, the keys of FLASH_CR.
pub(super) const KEYR_OFFSET: u32 = 0x04;
/// Offset of FLASH_OPTKEYR, the keys of FLASH_OPTCR.
pub(super) const OPTKEYR_OFFSET: u32 = 0x08;
/// Offset of FLASH_SR, the status register (3.9.5).
pub(super) const SR_OFFSET: u32 = 0x0c;
/// Offset of FLASH_CR, the control register (3.9.7).
pub(super) const CR_OFFSET: u32 = 0x10;
/// Offset of FLASH_OPTCR, the option bytes.
pub(super) const OPTCR_OFFSET: u32 = 0x14;

/// FLASH_ACR, LATENCY: the wait states.
pub(crate) const ACR_LATENCY_MASK: u32 = 0x7;
/// FLASH_ACR, PRFTEN: position of the enable bit of the prefetch.
pub(super) const ACR_PRFTEN_SHIFT: u32 = 8;
/// FLASH_ACR, ICEN: position of the enable bit of the instruction cache; DCEN is the next.
pub(super) const ACR_CACHES_SHIFT: u32 = 9;
/// FLASH_ACR, ICEN and DCEN: both bits, shifted down.
pub(super) const ACR_CACHES_MASK: u32 = 0x3;
/// FLASH_ACR, DCEN: the bit of the data cache, shifted down with the one of the instruction cache.
pub(super) const ACR_DATA_CACHE: u32 = 0x2;
/// FLASH_ACR, ICEN: enables the instruction cache.
pub(super) const ACR_ICEN: u32 = 1 << 9;
/// FLASH_ACR, DCEN: enables the data cache.
pub(super) const ACR_DCEN: u32 = 1 << 10;
/// FLASH_ACR, ICRST: empties the instruction cache.
pub(crate) const ACR_ICRST: u32 = 1 << 11;
/// FLASH_ACR, DCRST: empties the data cache.
pub(super) const ACR_DCRST: u32 = 1 << 12;
/// Bits of FLASH_ACR that set what the accelerator does: LATENCY, PRFTEN, ICEN and DCEN.
pub(super) const ACR_SETTINGS_MASK: u32 = 0x707;
/// Writable bits of FLASH_ACR.
pub(super) const ACR_WRITE_MASK: u32 = 0x1f07;

/// FLASH_KEYR: the first key.
pub(super) const KEY1: u32 = 0x4567_0123;
/// FLASH_KEYR: the second key.
pub(super) const KEY2: u32 = 0xcdef_89ab;
/// FLASH_OPTKEYR: the first key.
pub(super) const OPTKEY1: u32 = 0x0819_2a3b;
/// FLASH_OPTKEYR: the second key.
pub(super) const OPTKEY2: u32 = 0x4c5d_6e7f;

/// FLASH_SR, EOP: an operation has ended.
pub(super) const SR_EOP: u32 = 1 << 0;
/// FLASH_SR, OPERR: an operation has failed.
pub(super) const SR_OPERR: u32 = 1 << 1;
/// FLASH_SR, WRPERR: the sector is protected against writes.
pub(super) const SR_WRPERR: u32 = 1 << 4;
/// FLASH_SR, PGAERR: the address of a write is not aligned.
pub(super) const SR_PGAERR: u32 = 1 << 5;
/// FLASH_SR, PGPERR: the width of a write is not the one of PSIZE.
pub(super) const SR_PGPERR: u32 = 1 << 6;
/// FLASH_SR, PGSERR: FLASH_CR was not set up for a write.
pub(super) const SR_PGSERR: u32 = 1 << 7;
/// FLASH_SR, BSY: position of the flag of an operation under way.
pub(super) const SR_BSY_SHIFT: u32 = 16;
/// Flags of FLASH_SR for which a write is refused.
pub(super) const SR_PROGRAM_ERROR_MASK: u32 = SR_PGSERR | SR_PGPERR | SR_PGAERR | SR_WRPERR;
/// Flags of FLASH_SR for which an erase is refused.
pub(super) const SR_ERROR_MASK: u32 = SR_PROGRAM_ERROR_MASK | SR_OPERR;
/// Flags of FLASH_SR that a write of 1 clears.
pub(super) const SR_WRITE_ONE_CLEAR_MASK: u32 = SR_ERROR_MASK | SR_EOP;

/// FLASH_CR, PG: writes program the array.
pub(super) const CR_PG: u32 = 1 << 0;
/// FLASH_CR, PG, SER and MER: the kind of the operation.
pub(super) const CR_OPERATION_MASK: u32 = 0x7;
/// FLASH_CR, SER alone: an erase of a sector.
pub(super) const CR_SER: u32 = 1 << 1;
/// FLASH_CR, MER alone: an erase of all sectors.
pub(super) const CR_MER: u32 = 1 << 2;
/// FLASH_CR, SNB: position of the number of the sector.
pub(super) const CR_SNB_SHIFT: u32 = 3;
/// FLASH_CR, SNB: its four bits, shifted down.
pub(super) const CR_SNB_MASK: u32 = 0xf;
/// FLASH_CR, PSIZE: position of the power of two of the bytes of a write.
pub(super) const CR_PSIZE_SHIFT: u32 = 8;
/// FLASH_CR, PSIZE: its two bits, shifted down.
pub(super) const CR_PSIZE_MASK: u32 = 0x3;
/// FLASH_CR, STRT: starts an erase.
pub(super) const CR_STRT: u32 = 1 << 16;
/// FLASH_CR, EOPIE: enables the interrupt of EOP.
pub(super) const CR_EOPIE: u32 = 1 << 24;
/// FLASH_CR, ERRIE: enables the interrupt of OPERR.
pub(super) const CR_ERRIE: u32 = 1 << 25;
/// FLASH_CR, LOCK: number of the bit.
pub(super) const CR_LOCK_BIT: u32 = 31;
/// FLASH_CR, LOCK: the register takes no write.
pub(super) const CR_LOCK: u32 = 1 << CR_LOCK_BIT;
/// Writable bits of FLASH_CR.
pub(super) const CR_WRITE_MASK: u32 = 0x8301_037f;
/// Value of FLASH_CR after a reset: locked.
pub(super) const CR_RESET: u32 = CR_LOCK;

/// FLASH_OPTCR, OPTLOCK: the register takes no write.
pub(crate) const OPTCR_OPTLOCK: u32 = 1 << 0;
/// FLASH_OPTCR, OPTSTRT: starts the programming of the option bytes.
pub(super) const OPTCR_OPTSTRT: u32 = 1 << 1;
/// FLASH_OPTCR, BOR_LEV: position of the level of the brown-out reset.
pub(super) const OPTCR_BOR_LEV_SHIFT: u32 = 2;
/// FLASH_OPTCR, BOR_LEV: its two bits, shifted down.
pub(super) const OPTCR_BOR_LEV_MASK: u32 = 0x3;
/// FLASH_OPTCR, WDG_SW: software starts the watchdog.
pub(super) const OPTCR_WDG_SW: u32 = 1 << 5;
/// FLASH_OPTCR, RDP: position of the read protection.
pub(super) const OPTCR_RDP_SHIFT: u32 = 8;
/// FLASH_OPTCR, RDP: its eight bits, shifted down.
pub(super) const OPTCR_RDP_MASK: u32 = 0xff;
/// FLASH_OPTCR, nWRP: position of the write protection, a bit for each sector.
pub(super) const OPTCR_NWRP_SHIFT: u32 = 16;
/// FLASH_OPTCR, nWRP: its twelve bits, shifted down.
pub(super) const OPTCR_NWRP_MASK: u32 = 0xfff;
/// Writable bits of FLASH_OPTCR.
pub(super) const OPTCR_WRITE_MASK: u32 = 0x0fff_ffef;
/// Value of FLASH_OPTCR as from the factory.
pub(super) const OPTCR_RESET: u32 = 0x0fff_aaed;

/// Bytes of sectors 0 to 3.
pub(super) const SMALL_SECTOR_BYTES: u32 = 0x4000;
/// Bytes of sector 4, and its offset.
pub(super) const MIDDLE_SECTOR_BYTES: u32 = 0x1_0000;
/// Bytes of sectors 5 to 11.
pub(super) const LARGE_SECTOR_BYTES: u32 = 0x2_0000;
/// A byte of the array that is erased.
pub(super) const ERASED_BYTE: u8 = 0xff;
