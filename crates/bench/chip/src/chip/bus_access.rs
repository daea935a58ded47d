//! Accesses to the memory map: who answers where, whether its clock runs, and how wide an access may be (RM0090 section 2).

mod registers;

use super::{
    Chip,
    backup_domain::registers::{
        PWR_CR_CLEAR_MASK, PWR_CR_OFFSET, PWR_CR_WRITE_MASK, PWR_CSR_OFFSET,
    },
    gpio::registers::BSRR_OFFSET,
    iwdg::registers as iwdg,
};
use crate::{memory_map::*, report::Severity};
use registers::*;

/// Units behind a clock gate: base address, index of RCC's enable register, bit, name.
pub(crate) const CLOCK_GATES: &[(u32, usize, u32, &str)] = &[
    (TIM2_BASE, 3, 0, "TIM2"),
    (TIM3_BASE, 3, 1, "TIM3"),
    (TIM4_BASE, 3, 2, "TIM4"),
    (TIM5_BASE, 3, 3, "TIM5"),
    (TIM6_BASE, 3, 4, "TIM6"),
    (TIM7_BASE, 3, 5, "TIM7"),
    (TIM12_BASE, 3, 6, "TIM12"),
    (TIM13_BASE, 3, 7, "TIM13"),
    (TIM14_BASE, 3, 8, "TIM14"),
    (WWDG_BASE, 3, 11, "WWDG"),
    (SPI2_BASE, 3, 14, "SPI2"),
    (SPI3_BASE, 3, 15, "SPI3"),
    (USART2_BASE, 3, 17, "USART2"),
    (USART3_BASE, 3, 18, "USART3"),
    (UART4_BASE, 3, 19, "UART4"),
    (UART5_BASE, 3, 20, "UART5"),
    (I2C1_BASE, 3, 21, "I2C1"),
    (I2C2_BASE, 3, 22, "I2C2"),
    (I2C3_BASE, 3, 23, "I2C3"),
    (CAN1_BASE, 3, 25, "CAN1"),
    (CAN2_BASE, 3, 26, "CAN2"),
    (PWR_BASE, 3, 28, "PWR"),
    (DAC_BASE, 3, 29, "DAC"),
    (TIM1_BASE, 4, 0, "TIM1"),
    (TIM8_BASE, 4, 1, "TIM8"),
    (USART1_BASE, 4, 4, "USART1"),
    (USART6_BASE, 4, 5, "USART6"),
    (ADC1_BASE, 4, 8, "ADC1"),
    (ADC2_BASE, 4, 9, "ADC2"),
    (ADC3_BASE, 4, 10, "ADC3"),
    (SDIO_BASE, 4, 11, "SDIO"),
    (SPI1_BASE, 4, 12, "SPI1"),
    (SYSCFG_BASE, 4, 14, "SYSCFG"),
    (TIM9_BASE, 4, 16, "TIM9"),
    (TIM10_BASE, 4, 17, "TIM10"),
    (TIM11_BASE, 4, 18, "TIM11"),
    (GPIOA_BASE, 0, 0, "GPIOA"),
    (GPIOB_BASE, 0, 1, "GPIOB"),
    (GPIOC_BASE, 0, 2, "GPIOC"),
    (GPIOD_BASE, 0, 3, "GPIOD"),
    (GPIOE_BASE, 0, 4, "GPIOE"),
    (GPIOF_BASE, 0, 5, "GPIOF"),
    (GPIOG_BASE, 0, 6, "GPIOG"),
    (GPIOH_BASE, 0, 7, "GPIOH"),
    (GPIOI_BASE, 0, 8, "GPIOI"),
    (CRC_BASE, 0, 12, "CRC"),
    (BACKUP_SRAM_BASE, 0, 18, "backup SRAM"),
    (DMA1_BASE, 0, 21, "DMA1"),
    (DMA2_BASE, 0, 22, "DMA2"),
];
pub(crate) const BUS_NAMES: [&str; 5] = ["AHB1", "AHB2", "AHB3", "APB1", "APB2"];

impl Chip {
    /// Returns whether a unit's clock runs; if not, silicon reads 0 and drops writes.
    pub(crate) fn check_clock_enabled(&mut self, addr: u32, what: &str) -> bool {
        let base = match addr {
            // Three converters in one kilobyte, and with the first of them what they share.
            ADC1_BASE..=ADC_UNITS_LAST => addr & !ADC_OFFSET_MASK,
            BACKUP_SRAM_BASE..=BACKUP_SRAM_LAST => BACKUP_SRAM_BASE,
            _ => addr & !UNIT_OFFSET_MASK,
        };
        let Some((_, bus, bit, name)) = CLOCK_GATES.iter().find(|g| g.0 == base) else {
            return true;
        };
        if self.rcc.rstr[*bus] >> bit & 1 != 0 {
            self.report_violation(format!("{name}: {what} while it is held in reset"));
            return false;
        }
        if self.rcc.enr[*bus] >> bit & 1 == 0 {
            self.report_violation(format!(
                "{name}: {what} without its clock (RCC_{}ENR bit {bit})",
                BUS_NAMES[*bus]
            ));
            return false;
        }
        true
    }

    /// Reads for the processor; `size` in bytes.
    pub fn bus_read(&mut self, addr: u32, size: u32) -> u32 {
        let word = addr & !3;
        let shift = (addr & 3) * 8;
        if !self.check_clock_enabled(addr, "read") {
            return 0;
        }
        if addr & (size - 1) != 0 {
            self.report_violation(format!("unaligned read of {size} bytes at {addr:#010x}"));
        }
        // Reading data registers clears flags.
        self.dirty |= matches!(word, USART1_DR | USART3_DR | SPI2_DR | ADC1_DR | ADC2_DR);
        self.read_register(word) >> shift & (u32::MAX >> (32 - 8 * size))
    }

    /// Writes for the processor; `size` in bytes.
    pub fn bus_write(&mut self, addr: u32, size: u32, v: u32) {
        self.dirty = true;
        if !self.check_clock_enabled(addr, "write") {
            return;
        }
        if addr & (size - 1) != 0 {
            self.report_violation(format!("unaligned write of {size} bytes at {addr:#010x}"));
        }
        let word = addr & !3;
        if size == 4 {
            return self.write_register(word, v);
        }
        match addr {
            // RM0090 2.1.11: an APB bridge repeats a narrow write in all lanes.
            PERIPHERAL_BASE..=APB_LAST => {
                let v = if size == 1 { v * BYTE_LANES } else { v * HALF_WORD_LANES };
                // Half-words are allowed in the SPI, the USART, the timers and the watchdog.
                let narrow_ok = matches!(
                    addr & !UNIT_OFFSET_MASK,
                    IWDG_BASE | SPI2_BASE | USART3_BASE | USART1_BASE
                ) || (PERIPHERAL_BASE..APB1_TIMERS_END).contains(&addr);
                if !narrow_ok || (size == 1 && addr & !UNIT_OFFSET_MASK != SPI2_BASE) {
                    self.report_violation(format!(
                        "{size}-byte write at {addr:#010x}: the bridge repeats it in every lane"
                    ));
                }
                self.write_register(word, if narrow_ok { v & HALF_WORD_MASK } else { v });
            }
            GPIOA_BASE..=GPIO_LAST | BACKUP_SRAM_BASE..=BACKUP_SRAM_LAST => {
                let lanes = (u32::MAX >> (32 - 8 * size)) << ((addr & 3) * 8);
                let is_bsrr = word < BACKUP_SRAM_BASE && word & UNIT_OFFSET_MASK == BSRR_OFFSET;
                let keep = if is_bsrr { 0 } else { self.read_register(word) & !lanes };
                self.write_register(word, keep | v << ((addr & 3) * 8) & lanes);
            }
            _ => {
                self.report_violation(format!(
                    "{size}-byte write at {addr:#010x}, which takes words"
                ));
                let lanes = (u32::MAX >> (32 - 8 * size)) << ((addr & 3) * 8);
                let keep = self.read_register(word) & !lanes;
                self.write_register(word, keep | v << ((addr & 3) * 8) & lanes);
            }
        }
    }

    pub(crate) fn read_register(&mut self, a: u32) -> u32 {
        let off = a & UNIT_OFFSET_MASK;
        match a & !UNIT_OFFSET_MASK {
            RCC_BASE => self.read_rcc_register(off),
            FLASH_INTERFACE_BASE => self.read_flash_register(off),
            CRC_BASE => self.read_crc_register(off),
            PWR_BASE => match off {
                PWR_CR_OFFSET => self.pwr_cr,
                PWR_CSR_OFFSET => self.read_pwr_csr(),
                _ => 0,
            },
            GPIOA_BASE..=GPIOI_BASE => {
                self.read_gpio_register((a as usize - GPIOA_BASE as usize) / GPIO_STRIDE, off)
            }
            ADC1_BASE => self.read_adc_register(off),
            DMA1_BASE => self.read_dma_register(0, off),
            DMA2_BASE => self.read_dma_register(1, off),
            CAN1_BASE => self.read_can_register(off),
            USART1_BASE => self.read_uart_register(0, off),
            USART3_BASE => self.read_uart_register(1, off),
            SPI2_BASE => self.read_spi_register(off),
            RTC_BASE => self.read_rtc_register(off),
            BACKUP_SRAM_BASE..=BACKUP_SRAM_LAST_KILOBYTE_BASE => {
                self.read_backup_sram(a & BACKUP_SRAM_OFFSET_MASK)
            }
            TIM11_BASE => self.read_tim11_register(off),
            IWDG_BASE => match off {
                iwdg::KR_OFFSET => 0,
                iwdg::PR_OFFSET => self.iwdg.pr,
                iwdg::RLR_OFFSET => self.iwdg.rlr,
                iwdg::SR_OFFSET => {
                    u32::from(self.iwdg.pvu > self.now)
                        | u32::from(self.iwdg.rvu > self.now) << iwdg::SR_RVU_SHIFT
                }
                _ => 0,
            },
            SYSCFG_BASE => self.syscfg.get(off as usize / 4).copied().unwrap_or(0),
            EXTI_BASE => match off {
                EXTI_IMR_OFFSET => self.exti.imr,
                EXTI_EMR_OFFSET => self.exti.emr,
                EXTI_RTSR_OFFSET => self.exti.rtsr,
                EXTI_FTSR_OFFSET => self.exti.ftsr,
                EXTI_PR_OFFSET => self.exti.pr,
                _ => 0,
            },
            DBGMCU_BASE => match off {
                DBGMCU_IDCODE_OFFSET => DBGMCU_IDCODE,
                DBGMCU_CR_OFFSET => self.dbgmcu[1],
                DBGMCU_APB1_FZ_OFFSET => self.dbgmcu[2],
                DBGMCU_APB2_FZ_OFFSET => self.dbgmcu[3],
                _ => 0,
            },
            base => {
                if let Some(i) = self.tims.iter().position(|t| t.base == base) {
                    return self.read_tim_register(i, off);
                }
                self.record_finding(Severity::Unmodelled, format!("read of {a:#010x}"));
                0
            }
        }
    }

    pub(crate) fn write_register(&mut self, a: u32, v: u32) {
        let off = a & UNIT_OFFSET_MASK;
        match a & !UNIT_OFFSET_MASK {
            RCC_BASE => self.write_rcc_register(off, v),
            FLASH_INTERFACE_BASE => self.write_flash_register(off, v),
            CRC_BASE => self.write_crc_register(off, v),
            PWR_BASE => match off {
                PWR_CR_OFFSET => {
                    // 5.1.3: VOS may be changed on the fly; what it must be depends on the clock.
                    self.pwr_cr = self.apply_write_mask(
                        "PWR_CR",
                        self.pwr_cr,
                        v & !PWR_CR_CLEAR_MASK,
                        PWR_CR_WRITE_MASK,
                    );
                    self.check_voltage_scale();
                }
                PWR_CSR_OFFSET => self.write_pwr_csr(v),
                _ => self.report_violation(format!("PWR: write at {off:#x}")),
            },
            GPIOA_BASE..=GPIOI_BASE => {
                self.write_gpio_register((a as usize - GPIOA_BASE as usize) / GPIO_STRIDE, off, v)
            }
            ADC1_BASE => self.write_adc_register(off, v),
            DMA1_BASE => self.write_dma_register(0, off, v),
            DMA2_BASE => self.write_dma_register(1, off, v),
            CAN1_BASE => self.write_can_register(off, v),
            USART1_BASE => self.write_uart_register(0, off, v),
            USART3_BASE => self.write_uart_register(1, off, v),
            SPI2_BASE => self.write_spi_register(off, v),
            RTC_BASE => self.write_rtc_register(off, v),
            BACKUP_SRAM_BASE..=BACKUP_SRAM_LAST_KILOBYTE_BASE => {
                self.write_backup_sram(a & BACKUP_SRAM_OFFSET_MASK, v)
            }
            TIM11_BASE => self.write_tim11_register(off, v),
            IWDG_BASE => self.write_iwdg_register(off, v),
            SYSCFG_BASE => {
                if let Some(r) = self.syscfg.get_mut(off as usize / 4) {
                    *r = v;
                }
            }
            EXTI_BASE => match off {
                EXTI_IMR_OFFSET => self.exti.imr = v,
                EXTI_EMR_OFFSET => self.exti.emr = v,
                EXTI_RTSR_OFFSET => self.exti.rtsr = v,
                EXTI_FTSR_OFFSET => self.exti.ftsr = v,
                EXTI_PR_OFFSET => self.exti.pr &= !v,
                _ => {}
            },
            DBGMCU_BASE => {
                if let Some(r) = self.dbgmcu.get_mut(off as usize / 4) {
                    *r = v;
                }
            }
            base => {
                if let Some(i) = self.tims.iter().position(|t| t.base == base) {
                    return self.write_tim_register(i, off, v);
                }
                self.record_finding(Severity::Unmodelled, format!("write of {v:#x} to {a:#010x}"));
            }
        }
    }
}
