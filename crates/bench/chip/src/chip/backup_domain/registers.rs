//! Registers of the power controller (RM0090 section 5.4) and the control register of the backup domain (7.3.20).

/// Offset of PWR_CR, the control register (5.4.1).
pub(crate) const PWR_CR_OFFSET: u32 = 0x00;
/// Offset of PWR_CSR, control and status (5.4.2).
pub(crate) const PWR_CSR_OFFSET: u32 = 0x04;

/// PWR_CR, CWUF and CSBF: they clear flags and read as 0.
pub(crate) const PWR_CR_CLEAR_MASK: u32 = 0xc;
/// PWR_CR, DBP: opens the backup domain to writes.
pub(super) const PWR_CR_DBP: u32 = 1 << 8;
/// PWR_CR, VOS: the regulator is at scale 1.
pub(crate) const PWR_CR_VOS: u32 = 1 << 14;
/// Writable bits of PWR_CR.
pub(crate) const PWR_CR_WRITE_MASK: u32 = 0x43ff;
/// Value of PWR_CR after a reset: scale 1.
pub(crate) const PWR_CR_RESET: u32 = PWR_CR_VOS;

/// PWR_CSR, BRR: position of the flag that the backup regulator is ready.
pub(super) const PWR_CSR_BRR_SHIFT: u32 = 3;
/// PWR_CSR, BRE: position of the enable bit of the backup regulator.
pub(super) const PWR_CSR_BRE_SHIFT: u32 = 9;
/// PWR_CSR, BRE: enables the backup regulator.
pub(super) const PWR_CSR_BRE: u32 = 1 << PWR_CSR_BRE_SHIFT;
/// PWR_CSR, VOSRDY: the regulator has reached its scale; at the place of VOS in PWR_CR.
pub(super) const PWR_CSR_VOSRDY: u32 = 1 << 14;

/// RCC_BDCR, LSEON: switches the 32 kHz oscillator on.
pub(super) const BDCR_LSEON: u32 = 1 << 0;
/// RCC_BDCR, LSERDY: position of the flag that the 32 kHz oscillator is stable.
pub(super) const BDCR_LSERDY_SHIFT: u32 = 1;
/// RCC_BDCR, LSERDY: the 32 kHz oscillator is stable.
pub(super) const BDCR_LSERDY: u32 = 1 << BDCR_LSERDY_SHIFT;
/// RCC_BDCR, LSEBYP: an external clock takes the place of the 32 kHz crystal.
pub(super) const BDCR_LSEBYP: u32 = 1 << 2;
/// RCC_BDCR, RTCSEL: the field for the clock of the RTC.
pub(super) const BDCR_RTCSEL: u32 = 3 << 8;
/// RCC_BDCR, RTCSEL: the RTC runs from LSE.
pub(super) const BDCR_RTCSEL_LSE: u32 = 1 << 8;
/// RCC_BDCR, RTCSEL: the RTC runs from LSI.
pub(super) const BDCR_RTCSEL_LSI: u32 = 2 << 8;
/// RCC_BDCR, RTCEN: enables the clock of the RTC.
pub(super) const BDCR_RTCEN: u32 = 1 << 15;
/// RCC_BDCR, BDRST: resets the backup domain.
pub(super) const BDCR_BDRST: u32 = 1 << 16;
