//! The memory map: base addresses of the memories and of the units (RM0090 section 2.3, table 1).

/// Base address of the flash array.
pub(crate) const FLASH_BASE: u32 = 0x0800_0000;
/// First address behind the flash array of 1 MB.
pub(crate) const FLASH_END: u32 = 0x0810_0000;
/// Base address of the core-coupled memory, which the DMA does not reach.
pub(crate) const CCM_BASE: u32 = 0x1000_0000;
/// Base address of the system memory, which holds the chip's own loader.
pub(crate) const SYSTEM_MEMORY_BASE: u32 = 0x1fff_0000;
/// Base address of the SRAM on the bus matrix.
pub(crate) const SRAM_BASE: u32 = 0x2000_0000;
/// First address behind the SRAM of 128 KB.
pub(crate) const SRAM_END: u32 = 0x2002_0000;
/// Base address of the peripherals on APB1, APB2 and AHB1.
pub(crate) const PERIPHERAL_BASE: u32 = 0x4000_0000;
/// Base address of the peripherals on AHB2.
pub(crate) const AHB2_PERIPHERAL_BASE: u32 = 0x5000_0000;

/// Base address of TIM2.
pub(crate) const TIM2_BASE: u32 = 0x4000_0000;
/// Base address of TIM3.
pub(crate) const TIM3_BASE: u32 = 0x4000_0400;
/// Base address of TIM4.
pub(crate) const TIM4_BASE: u32 = 0x4000_0800;
/// Base address of TIM5.
pub(crate) const TIM5_BASE: u32 = 0x4000_0c00;
/// Base address of TIM6.
pub(crate) const TIM6_BASE: u32 = 0x4000_1000;
/// Base address of TIM7.
pub(crate) const TIM7_BASE: u32 = 0x4000_1400;
/// Base address of TIM12.
pub(crate) const TIM12_BASE: u32 = 0x4000_1800;
/// Base address of TIM13.
pub(crate) const TIM13_BASE: u32 = 0x4000_1c00;
/// Base address of TIM14.
pub(crate) const TIM14_BASE: u32 = 0x4000_2000;
/// Base address of the RTC with the backup registers.
pub(crate) const RTC_BASE: u32 = 0x4000_2800;
/// Base address of WWDG.
pub(crate) const WWDG_BASE: u32 = 0x4000_2c00;
/// Base address of the independent watchdog.
pub(crate) const IWDG_BASE: u32 = 0x4000_3000;
/// Base address of SPI2.
pub(crate) const SPI2_BASE: u32 = 0x4000_3800;
/// Base address of SPI3.
pub(crate) const SPI3_BASE: u32 = 0x4000_3c00;
/// Base address of USART2.
pub(crate) const USART2_BASE: u32 = 0x4000_4400;
/// Base address of USART3.
pub(crate) const USART3_BASE: u32 = 0x4000_4800;
/// Base address of UART4.
pub(crate) const UART4_BASE: u32 = 0x4000_4c00;
/// Base address of UART5.
pub(crate) const UART5_BASE: u32 = 0x4000_5000;
/// Base address of I2C1.
pub(crate) const I2C1_BASE: u32 = 0x4000_5400;
/// Base address of I2C2.
pub(crate) const I2C2_BASE: u32 = 0x4000_5800;
/// Base address of I2C3.
pub(crate) const I2C3_BASE: u32 = 0x4000_5c00;
/// Base address of CAN1.
pub(crate) const CAN1_BASE: u32 = 0x4000_6400;
/// Base address of CAN2.
pub(crate) const CAN2_BASE: u32 = 0x4000_6800;
/// Base address of PWR.
pub(crate) const PWR_BASE: u32 = 0x4000_7000;
/// Base address of DAC.
pub(crate) const DAC_BASE: u32 = 0x4000_7400;
/// Base address of TIM1.
pub(crate) const TIM1_BASE: u32 = 0x4001_0000;
/// Base address of TIM8.
pub(crate) const TIM8_BASE: u32 = 0x4001_0400;
/// Base address of USART1.
pub(crate) const USART1_BASE: u32 = 0x4001_1000;
/// Base address of USART6.
pub(crate) const USART6_BASE: u32 = 0x4001_1400;
/// Base address of ADC1.
pub(crate) const ADC1_BASE: u32 = 0x4001_2000;
/// Base address of ADC2.
pub(crate) const ADC2_BASE: u32 = 0x4001_2100;
/// Base address of ADC3.
pub(crate) const ADC3_BASE: u32 = 0x4001_2200;
/// Base address of SDIO.
pub(crate) const SDIO_BASE: u32 = 0x4001_2c00;
/// Base address of SPI1.
pub(crate) const SPI1_BASE: u32 = 0x4001_3000;
/// Base address of SYSCFG.
pub(crate) const SYSCFG_BASE: u32 = 0x4001_3800;
/// Base address of EXTI.
pub(crate) const EXTI_BASE: u32 = 0x4001_3c00;
/// Base address of TIM9.
pub(crate) const TIM9_BASE: u32 = 0x4001_4000;
/// Base address of TIM10.
pub(crate) const TIM10_BASE: u32 = 0x4001_4400;
/// Base address of TIM11.
pub(crate) const TIM11_BASE: u32 = 0x4001_4800;
/// Base address of GPIOA.
pub(crate) const GPIOA_BASE: u32 = 0x4002_0000;
/// Base address of GPIOB.
pub(crate) const GPIOB_BASE: u32 = 0x4002_0400;
/// Base address of GPIOC.
pub(crate) const GPIOC_BASE: u32 = 0x4002_0800;
/// Base address of GPIOD.
pub(crate) const GPIOD_BASE: u32 = 0x4002_0c00;
/// Base address of GPIOE.
pub(crate) const GPIOE_BASE: u32 = 0x4002_1000;
/// Base address of GPIOF.
pub(crate) const GPIOF_BASE: u32 = 0x4002_1400;
/// Base address of GPIOG.
pub(crate) const GPIOG_BASE: u32 = 0x4002_1800;
/// Base address of GPIOH.
pub(crate) const GPIOH_BASE: u32 = 0x4002_1c00;
/// Base address of GPIOI.
pub(crate) const GPIOI_BASE: u32 = 0x4002_2000;
/// Base address of the CRC unit.
pub(crate) const CRC_BASE: u32 = 0x4002_3000;
/// Base address of RCC.
pub(crate) const RCC_BASE: u32 = 0x4002_3800;
/// Base address of the flash interface's registers.
pub(crate) const FLASH_INTERFACE_BASE: u32 = 0x4002_3c00;
/// Base address of the backup SRAM.
pub(crate) const BACKUP_SRAM_BASE: u32 = 0x4002_4000;
/// Base address of DMA1.
pub(crate) const DMA1_BASE: u32 = 0x4002_6000;
/// Base address of DMA2.
pub(crate) const DMA2_BASE: u32 = 0x4002_6400;
/// Base address of DBGMCU.
pub(crate) const DBGMCU_BASE: u32 = 0xe004_2000;

/// Last address of the peripherals on APB1 and APB2.
pub(crate) const APB_LAST: u32 = 0x4001_ffff;
/// First address behind the timers that APB1 has in one block (TIM2 to TIM14).
pub(crate) const APB1_TIMERS_END: u32 = 0x4000_2400;
/// Last address of the three converters' own registers; behind it are the common ones.
pub(crate) const ADC_UNITS_LAST: u32 = 0x4001_22ff;
/// Last address of the ports.
pub(crate) const GPIO_LAST: u32 = 0x4002_23ff;
/// Last address of the backup SRAM.
pub(crate) const BACKUP_SRAM_LAST: u32 = 0x4002_4fff;
/// Base address of the last kilobyte of the backup SRAM.
pub(crate) const BACKUP_SRAM_LAST_KILOBYTE_BASE: u32 = 0x4002_4c00;
/// First address behind the backup SRAM.
pub(crate) const BACKUP_SRAM_END: u32 = 0x4002_5000;

/// The bits of an address that select a register within its unit, which has 1 KB of addresses.
pub(crate) const UNIT_OFFSET_MASK: u32 = 0x3ff;
/// Bytes between two ports.
pub(crate) const GPIO_STRIDE: usize = 0x400;
/// The bits of an address that select a register within one of the three converters.
pub(crate) const ADC_OFFSET_MASK: u32 = 0xff;
/// The bits of an address that select a byte of the backup SRAM.
pub(crate) const BACKUP_SRAM_OFFSET_MASK: u32 = 0xfff;
