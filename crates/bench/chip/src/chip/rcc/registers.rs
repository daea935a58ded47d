//! Registers of reset and clock control (RM0090 section 7.3).

/// Offset of RCC_CR, the oscillators and the PLL (7.3.1).
pub(super) const RCC_CR_OFFSET: u32 = 0x00;
/// Offset of RCC_PLLCFGR, the factors of the PLL (7.3.2).
pub(super) const RCC_PLLCFGR_OFFSET: u32 = 0x04;
/// Offset of RCC_CFGR, the system clock and its prescalers (7.3.3).
pub(super) const RCC_CFGR_OFFSET: u32 = 0x08;
/// Offset of RCC_CIR, the interrupts (7.3.4).
pub(super) const RCC_CIR_OFFSET: u32 = 0x0c;
/// Offset of RCC_AHB1RSTR, the resets on AHB1 (7.3.5).
pub(super) const RCC_AHB1RSTR_OFFSET: u32 = 0x10;
/// Offset of RCC_AHB2RSTR, the resets on AHB2 (7.3.6).
pub(super) const RCC_AHB2RSTR_OFFSET: u32 = 0x14;
/// Offset of RCC_AHB3RSTR, the resets on AHB3 (7.3.7).
pub(super) const RCC_AHB3RSTR_OFFSET: u32 = 0x18;
/// Offset of RCC_APB1RSTR, the resets on APB1 (7.3.8).
pub(super) const RCC_APB1RSTR_OFFSET: u32 = 0x20;
/// Offset of RCC_APB2RSTR, the resets on APB2 (7.3.9).
pub(super) const RCC_APB2RSTR_OFFSET: u32 = 0x24;
/// Offset of RCC_AHB1ENR, the clocks on AHB1 (7.3.10).
pub(super) const RCC_AHB1ENR_OFFSET: u32 = 0x30;
/// Offset of RCC_AHB2ENR, the clocks on AHB2 (7.3.11).
pub(super) const RCC_AHB2ENR_OFFSET: u32 = 0x34;
/// Offset of RCC_AHB3ENR, the clocks on AHB3 (7.3.12).
pub(super) const RCC_AHB3ENR_OFFSET: u32 = 0x38;
/// Offset of RCC_APB1ENR, the clocks on APB1 (7.3.13).
pub(super) const RCC_APB1ENR_OFFSET: u32 = 0x40;
/// Offset of RCC_APB2ENR, the clocks on APB2 (7.3.14).
pub(super) const RCC_APB2ENR_OFFSET: u32 = 0x44;
/// Offset of RCC_AHB1LPENR, the clocks on AHB1 in sleep (7.3.15).
pub(super) const RCC_AHB1LPENR_OFFSET: u32 = 0x50;
/// Offset of RCC_AHB2LPENR, the clocks on AHB2 in sleep (7.3.16).
pub(super) const RCC_AHB2LPENR_OFFSET: u32 = 0x54;
/// Offset of RCC_AHB3LPENR, the clocks on AHB3 in sleep (7.3.17).
pub(super) const RCC_AHB3LPENR_OFFSET: u32 = 0x58;
/// Offset of RCC_APB1LPENR, the clocks on APB1 in sleep (7.3.18).
pub(super) const RCC_APB1LPENR_OFFSET: u32 = 0x60;
/// Offset of RCC_APB2LPENR, the clocks on APB2 in sleep (7.3.19).
pub(super) const RCC_APB2LPENR_OFFSET: u32 = 0x64;
/// Offset of RCC_BDCR, the backup domain (7.3.20).
pub(super) const RCC_BDCR_OFFSET: u32 = 0x70;
/// Offset of RCC_CSR, LSI and the causes of a reset (7.3.21).
pub(super) const RCC_CSR_OFFSET: u32 = 0x74;
/// Offset of RCC_SSCGR, the spread spectrum of the PLL (7.3.22).
pub(super) const RCC_SSCGR_OFFSET: u32 = 0x80;
/// Offset of RCC_PLLI2SCFGR, the factors of the PLL for I2S (7.3.23).
pub(super) const RCC_PLLI2SCFGR_OFFSET: u32 = 0x84;

/// RCC_CR, HSION: switches the internal oscillator on.
pub(super) const RCC_CR_HSION: u32 = 1 << 0;
/// RCC_CR, HSIRDY: number of the bit.
pub(super) const RCC_CR_HSIRDY_BIT: u32 = 1;
/// RCC_CR, HSIRDY: the internal oscillator is stable.
pub(super) const RCC_CR_HSIRDY: u32 = 1 << RCC_CR_HSIRDY_BIT;
/// RCC_CR, HSICAL: the field for the calibration of the internal oscillator.
pub(super) const RCC_CR_HSICAL: u32 = 0xff00;
/// RCC_CR, HSEON: number of the bit.
pub(super) const RCC_CR_HSEON_BIT: u32 = 16;
/// RCC_CR, HSEON: switches the crystal on.
pub(super) const RCC_CR_HSEON: u32 = 1 << RCC_CR_HSEON_BIT;
/// RCC_CR, HSERDY: number of the bit.
pub(super) const RCC_CR_HSERDY_BIT: u32 = 17;
/// RCC_CR, HSERDY: the crystal is stable.
pub(crate) const RCC_CR_HSERDY: u32 = 1 << RCC_CR_HSERDY_BIT;
/// RCC_CR, CSSON: switches the clock security system on.
pub(super) const RCC_CR_CSSON: u32 = 1 << 19;
/// RCC_CR, PLLON: number of the bit.
pub(super) const RCC_CR_PLLON_BIT: u32 = 24;
/// RCC_CR, PLLON: switches the PLL on.
pub(super) const RCC_CR_PLLON: u32 = 1 << RCC_CR_PLLON_BIT;
/// RCC_CR, PLLRDY: the PLL has locked.
pub(crate) const RCC_CR_PLLRDY: u32 = 1 << 25;
/// RCC_CR, PLLI2SRDY: the PLL for I2S has locked.
pub(super) const RCC_CR_PLLI2SRDY: u32 = 1 << 27;
/// Bits of RCC_CR that only the hardware sets.
pub(super) const RCC_CR_READ_ONLY: u32 =
    RCC_CR_HSIRDY | RCC_CR_HSICAL | RCC_CR_HSERDY | RCC_CR_PLLRDY | RCC_CR_PLLI2SRDY;
/// Writable bits of RCC_CR.
pub(super) const RCC_CR_WRITE_MASK: u32 = 0x050d_00f9;
/// Value of RCC_CR after a reset, with a calibration of HSI of 0x80.
pub(crate) const RCC_CR_RESET: u32 = 0x0000_8083;

/// RCC_PLLCFGR, PLLM: the division of the input, six bits.
pub(super) const RCC_PLLCFGR_PLLM_MASK: u32 = 0x3f;
/// RCC_PLLCFGR, PLLN: position of the factor of the VCO.
pub(super) const RCC_PLLCFGR_PLLN_SHIFT: u32 = 6;
/// RCC_PLLCFGR, PLLN: its nine bits, shifted down.
pub(super) const RCC_PLLCFGR_PLLN_MASK: u32 = 0x1ff;
/// RCC_PLLCFGR, PLLP: position of the division for the system clock.
pub(super) const RCC_PLLCFGR_PLLP_SHIFT: u32 = 16;
/// RCC_PLLCFGR, PLLP: its two bits, shifted down.
pub(super) const RCC_PLLCFGR_PLLP_MASK: u32 = 0x3;
/// RCC_PLLCFGR, PLLSRC: the input of the PLL is the crystal.
pub(super) const RCC_PLLCFGR_PLLSRC: u32 = 1 << 22;
/// RCC_PLLCFGR, PLLQ: position of the division for the 48 MHz domain.
pub(super) const RCC_PLLCFGR_PLLQ_SHIFT: u32 = 24;
/// RCC_PLLCFGR, PLLQ: its four bits, shifted down.
pub(super) const RCC_PLLCFGR_PLLQ_MASK: u32 = 0xf;
/// Reserved bits of RCC_PLLCFGR that are 1 after a reset.
pub(super) const RCC_PLLCFGR_RESERVED_ONES: u32 = 2 << 28;
/// Writable bits of RCC_PLLCFGR.
pub(super) const RCC_PLLCFGR_WRITE_MASK: u32 = 0x0f43_7fff;
/// Value of RCC_PLLCFGR after a reset.
pub(crate) const RCC_PLLCFGR_RESET: u32 = 0x2400_3010;

/// RCC_CFGR, SW: the requested system clock, two bits.
pub(super) const RCC_CFGR_SW_MASK: u32 = 0x3;
/// RCC_CFGR, SWS: position of the system clock in use.
pub(super) const RCC_CFGR_SWS_SHIFT: u32 = 2;
/// RCC_CFGR, SWS: its two bits, shifted down.
pub(super) const RCC_CFGR_SWS_MASK: u32 = 0x3;
/// RCC_CFGR, SWS: the field in its place.
pub(super) const RCC_CFGR_SWS: u32 = RCC_CFGR_SWS_MASK << RCC_CFGR_SWS_SHIFT;
/// RCC_CFGR, SW and SWS: the system clock is the internal oscillator.
pub(super) const SYSTEM_CLOCK_HSI: u32 = 0;
/// RCC_CFGR, SW and SWS: the system clock is the crystal.
pub(super) const SYSTEM_CLOCK_HSE: u32 = 1;
/// RCC_CFGR, SW and SWS: the system clock is the PLL.
pub(super) const SYSTEM_CLOCK_PLL: u32 = 2;
/// RCC_CFGR, HPRE: position of the prescaler of AHB.
pub(super) const RCC_CFGR_HPRE_SHIFT: u32 = 4;
/// RCC_CFGR, HPRE: its four bits, shifted down.
pub(super) const RCC_CFGR_HPRE_MASK: u32 = 0xf;
/// RCC_CFGR, PPRE1: position of the prescaler of APB1.
pub(super) const RCC_CFGR_PPRE1_SHIFT: u32 = 10;
/// RCC_CFGR, PPRE2: position of the prescaler of APB2.
pub(super) const RCC_CFGR_PPRE2_SHIFT: u32 = 13;
/// RCC_CFGR, PPRE1 and PPRE2: their three bits, shifted down.
pub(super) const RCC_CFGR_PPRE_MASK: u32 = 0x7;
/// RCC_CFGR, PPRE1 and PPRE2: the clock is divided.
pub(super) const PPRE_DIVIDED: u32 = 0x4;
/// RCC_CFGR, PPRE1 and PPRE2: the power of two of the division, less one.
pub(super) const PPRE_EXPONENT_MASK: u32 = 0x3;
/// RCC_CFGR, RTCPRE: position of the division of the crystal for HSE_RTC.
pub(crate) const RCC_CFGR_RTCPRE_SHIFT: u32 = 16;
/// RCC_CFGR, RTCPRE: its five bits, shifted down.
pub(crate) const RCC_CFGR_RTCPRE_MASK: u32 = 0x1f;
/// Writable bits of RCC_CFGR.
pub(super) const RCC_CFGR_WRITE_MASK: u32 = 0xffff_fcf3;

/// RCC_CIR: the six flags of an oscillator or PLL that has become ready.
pub(crate) const RCC_CIR_READY_FLAGS: u32 = 0x3f;
/// RCC_CIR: position of the enable bits of those flags.
pub(crate) const RCC_CIR_ENABLE_SHIFT: u32 = 8;
/// RCC_CIR: the enable bits in their place.
pub(super) const RCC_CIR_ENABLES: u32 = RCC_CIR_READY_FLAGS << RCC_CIR_ENABLE_SHIFT;
/// RCC_CIR, CSSF: the clock security system has found the crystal dead.
pub(crate) const RCC_CIR_CSSF: u32 = 1 << 7;
/// RCC_CIR: position of the bits that clear the flags.
pub(super) const RCC_CIR_CLEAR_SHIFT: u32 = 16;
/// RCC_CIR: the bits that clear a flag, shifted down.
pub(super) const RCC_CIR_CLEAR_MASK: u32 = RCC_CIR_CSSF | RCC_CIR_READY_FLAGS;
/// RCC_CIR: the byte of the flags.
pub(super) const RCC_CIR_FLAGS_MASK: u32 = 0xff;

/// Writable bits of RCC_AHB1ENR to RCC_APB2ENR.
pub(super) const RCC_ENR_WRITE_MASKS: [u32; 5] = [0x7e74_11ff, 0xf1, 0x1, 0x36fe_c9ff, 0x0007_5f33];
/// Values of RCC_AHB1ENR to RCC_APB2ENR after a reset: the clock of the core-coupled memory.
pub(crate) const RCC_ENR_RESETS: [u32; 5] = [0x0010_0000, 0, 0, 0, 0];
/// Values of RCC_AHB1LPENR to RCC_APB2LPENR after a reset.
pub(crate) const RCC_LPENR_RESETS: [u32; 5] = [0x7e67_91ff, 0xf1, 0x1, 0x36fe_c9ff, 0x0007_5f33];
/// RCC_AHB1ENR, DMA1EN: number of the bit; the one of DMA2 is the next.
pub(crate) const RCC_AHB1ENR_DMA1EN_BIT: usize = 21;

/// RCC_CSR, LSION: switches the oscillator of the watchdog on.
pub(super) const RCC_CSR_LSION: u32 = 1 << 0;
/// RCC_CSR, LSIRDY: the oscillator of the watchdog is stable.
pub(crate) const RCC_CSR_LSIRDY: u32 = 1 << 1;
/// RCC_CSR, RMVF: removes the causes of a reset.
pub(super) const RCC_CSR_RMVF: u32 = 1 << 24;
/// RCC_CSR, BORRSTF: a brown-out reset.
pub(crate) const RCC_CSR_BORRSTF: u32 = 1 << 25;
/// RCC_CSR, PINRSTF: a reset by the pin NRST.
pub(crate) const RCC_CSR_PINRSTF: u32 = 1 << 26;
/// RCC_CSR, PORRSTF: a power-on reset.
pub(crate) const RCC_CSR_PORRSTF: u32 = 1 << 27;
/// RCC_CSR, SFTRSTF: a reset by software.
pub(crate) const RCC_CSR_SFTRSTF: u32 = 1 << 28;
/// RCC_CSR, IWDGRSTF: a reset by the independent watchdog.
pub(crate) const RCC_CSR_IWDGRSTF: u32 = 1 << 29;
/// RCC_CSR: the causes of a reset.
pub(crate) const RCC_CSR_CAUSES_MASK: u32 = 0xfe00_0000;

/// Value of RCC_PLLI2SCFGR after a reset.
pub(crate) const RCC_PLLI2SCFGR_RESET: u32 = 0x2000_3000;
