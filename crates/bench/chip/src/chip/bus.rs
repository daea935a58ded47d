//! The memory map: who answers where, whether its clock runs, and how wide an access may be (RM0090 section 2).

use super::Chip;
use crate::report::Grade;

/// Units behind a clock gate: base address, index of RCC's enable register, bit, name.
pub(crate) const GATES: &[(u32, usize, u32, &str)] = &[
    (0x4000_0000, 3, 0, "TIM2"),
    (0x4000_0400, 3, 1, "TIM3"),
    (0x4000_0800, 3, 2, "TIM4"),
    (0x4000_0c00, 3, 3, "TIM5"),
    (0x4000_1000, 3, 4, "TIM6"),
    (0x4000_1400, 3, 5, "TIM7"),
    (0x4000_1800, 3, 6, "TIM12"),
    (0x4000_1c00, 3, 7, "TIM13"),
    (0x4000_2000, 3, 8, "TIM14"),
    (0x4000_2c00, 3, 11, "WWDG"),
    (0x4000_3800, 3, 14, "SPI2"),
    (0x4000_3c00, 3, 15, "SPI3"),
    (0x4000_4400, 3, 17, "USART2"),
    (0x4000_4800, 3, 18, "USART3"),
    (0x4000_4c00, 3, 19, "UART4"),
    (0x4000_5000, 3, 20, "UART5"),
    (0x4000_5400, 3, 21, "I2C1"),
    (0x4000_5800, 3, 22, "I2C2"),
    (0x4000_5c00, 3, 23, "I2C3"),
    (0x4000_6400, 3, 25, "CAN1"),
    (0x4000_6800, 3, 26, "CAN2"),
    (0x4000_7000, 3, 28, "PWR"),
    (0x4000_7400, 3, 29, "DAC"),
    (0x4001_0000, 4, 0, "TIM1"),
    (0x4001_0400, 4, 1, "TIM8"),
    (0x4001_1000, 4, 4, "USART1"),
    (0x4001_1400, 4, 5, "USART6"),
    (0x4001_2000, 4, 8, "ADC1"),
    (0x4001_2100, 4, 9, "ADC2"),
    (0x4001_2200, 4, 10, "ADC3"),
    (0x4001_2c00, 4, 11, "SDIO"),
    (0x4001_3000, 4, 12, "SPI1"),
    (0x4001_3800, 4, 14, "SYSCFG"),
    (0x4001_4000, 4, 16, "TIM9"),
    (0x4001_4400, 4, 17, "TIM10"),
    (0x4001_4800, 4, 18, "TIM11"),
    (0x4002_0000, 0, 0, "GPIOA"),
    (0x4002_0400, 0, 1, "GPIOB"),
    (0x4002_0800, 0, 2, "GPIOC"),
    (0x4002_0c00, 0, 3, "GPIOD"),
    (0x4002_1000, 0, 4, "GPIOE"),
    (0x4002_1400, 0, 5, "GPIOF"),
    (0x4002_1800, 0, 6, "GPIOG"),
    (0x4002_1c00, 0, 7, "GPIOH"),
    (0x4002_2000, 0, 8, "GPIOI"),
    (0x4002_3000, 0, 12, "CRC"),
    (0x4002_4000, 0, 18, "backup SRAM"),
    (0x4002_6000, 0, 21, "DMA1"),
    (0x4002_6400, 0, 22, "DMA2"),
];
pub(crate) const BUSES: [&str; 5] = ["AHB1", "AHB2", "AHB3", "APB1", "APB2"];

impl Chip {
    /// Returns whether a unit's clock runs; if not, silicon reads 0 and drops writes.
    pub(crate) fn clocked(&mut self, addr: u32, what: &str) -> bool {
        let base = match addr {
            // Three converters in one kilobyte, and with the first of them what they share.
            0x4001_2000..=0x4001_22ff => addr & !0xff,
            0x4002_4000..=0x4002_4fff => 0x4002_4000,
            _ => addr & !0x3ff,
        };
        let Some((_, bus, bit, name)) = GATES.iter().find(|g| g.0 == base) else { return true };
        if self.rcc.rstr[*bus] >> bit & 1 != 0 {
            self.violation(format!("{name}: {what} while it is held in reset"));
            return false;
        }
        if self.rcc.enr[*bus] >> bit & 1 == 0 {
            self.violation(format!(
                "{name}: {what} without its clock (RCC_{}ENR bit {bit})",
                BUSES[*bus]
            ));
            return false;
        }
        true
    }

    /// Reads for the processor; `size` in bytes.
    pub fn bus_read(&mut self, addr: u32, size: u32) -> u32 {
        let word = addr & !3;
        let shift = (addr & 3) * 8;
        if !self.clocked(addr, "read") {
            return 0;
        }
        if addr & (size - 1) != 0 {
            self.violation(format!("unaligned read of {size} bytes at {addr:#010x}"));
        }
        // Reading data registers clears flags.
        self.dirty |=
            matches!(word, 0x4001_1004 | 0x4000_4804 | 0x4000_380c | 0x4001_204c | 0x4001_214c);
        self.read(word) >> shift & (u32::MAX >> (32 - 8 * size))
    }

    pub fn bus_write(&mut self, addr: u32, size: u32, v: u32) {
        self.dirty = true;
        if !self.clocked(addr, "write") {
            return;
        }
        if addr & (size - 1) != 0 {
            self.violation(format!("unaligned write of {size} bytes at {addr:#010x}"));
        }
        let word = addr & !3;
        if size == 4 {
            return self.write(word, v);
        }
        match addr {
            // RM0090 2.1.11: an APB bridge repeats a narrow write in all lanes.
            0x4000_0000..=0x4001_ffff => {
                let v = if size == 1 { v * 0x0101_0101 } else { v * 0x0001_0001 };
                // Half-words are allowed in the SPI, the USART, the timers and the watchdog.
                let narrow_ok =
                    matches!(addr & !0x3ff, 0x4000_3000 | 0x4000_3800 | 0x4000_4800 | 0x4001_1000)
                        || (0x4000_0000..0x4000_2400).contains(&addr);
                if !narrow_ok || (size == 1 && addr & !0x3ff != 0x4000_3800) {
                    self.violation(format!(
                        "{size}-byte write at {addr:#010x}: the bridge repeats it in every lane"
                    ));
                }
                self.write(word, if narrow_ok { v & 0xffff } else { v });
            }
            0x4002_0000..=0x4002_23ff | 0x4002_4000..=0x4002_4fff => {
                let lanes = (u32::MAX >> (32 - 8 * size)) << ((addr & 3) * 8);
                let is_bsrr = word < 0x4002_4000 && word & 0x3ff == 0x18;
                let keep = if is_bsrr { 0 } else { self.read(word) & !lanes };
                self.write(word, keep | v << ((addr & 3) * 8) & lanes);
            }
            _ => {
                self.violation(format!("{size}-byte write at {addr:#010x}, which takes words"));
                let lanes = (u32::MAX >> (32 - 8 * size)) << ((addr & 3) * 8);
                let keep = self.read(word) & !lanes;
                self.write(word, keep | v << ((addr & 3) * 8) & lanes);
            }
        }
    }

    pub(crate) fn read(&mut self, a: u32) -> u32 {
        let off = a & 0x3ff;
        match a & !0x3ff {
            0x4002_3800 => self.rcc_read(off),
            0x4002_3c00 => self.flash_read(off),
            0x4002_3000 => self.crc_read(off),
            0x4000_7000 => match off {
                0 => self.pwr_cr,
                4 => self.pwr_csr_read(),
                _ => 0,
            },
            0x4002_0000..=0x4002_2000 => self.gpio_read((a as usize - 0x4002_0000) / 0x400, off),
            0x4001_2000 => self.adc_read(off),
            0x4002_6000 => self.dma_read(0, off),
            0x4002_6400 => self.dma_read(1, off),
            0x4000_6400 => self.can_read(off),
            0x4001_1000 => self.uart_read(0, off),
            0x4000_4800 => self.uart_read(1, off),
            0x4000_3800 => self.spi_read(off),
            0x4000_2800 => self.rtc_read(off),
            0x4002_4000..=0x4002_4c00 => self.backup_sram_read(a & 0xfff),
            0x4001_4800 => self.tim11_read(off),
            0x4000_3000 => match off {
                0 => 0,
                4 => self.iwdg.pr,
                8 => self.iwdg.rlr,
                12 => {
                    u32::from(self.iwdg.pvu > self.now) | u32::from(self.iwdg.rvu > self.now) << 1
                }
                _ => 0,
            },
            0x4001_3800 => self.syscfg.get(off as usize / 4).copied().unwrap_or(0),
            0x4001_3c00 => match off {
                0 => self.exti.imr,
                4 => self.exti.emr,
                8 => self.exti.rtsr,
                12 => self.exti.ftsr,
                20 => self.exti.pr,
                _ => 0,
            },
            0xe004_2000 => match off {
                0 => 0x1007_6413,
                4 => self.dbgmcu[1],
                8 => self.dbgmcu[2],
                12 => self.dbgmcu[3],
                _ => 0,
            },
            base => {
                if let Some(i) = self.tims.iter().position(|t| t.base == base) {
                    return self.tim_read(i, off);
                }
                self.say(Grade::Unmodelled, format!("read of {a:#010x}"));
                0
            }
        }
    }

    pub(crate) fn write(&mut self, a: u32, v: u32) {
        let off = a & 0x3ff;
        match a & !0x3ff {
            0x4002_3800 => self.rcc_write(off, v),
            0x4002_3c00 => self.flash_write(off, v),
            0x4002_3000 => self.crc_write(off, v),
            0x4000_7000 => match off {
                0 => {
                    // 5.1.3: VOS may be changed on the fly; what it must be depends on the clock.
                    self.pwr_cr = self.set("PWR_CR", self.pwr_cr, v & !0xc, 0x43ff);
                    self.scale_check();
                }
                4 => self.pwr_csr_write(v),
                _ => self.violation(format!("PWR: write at {off:#x}")),
            },
            0x4002_0000..=0x4002_2000 => {
                self.gpio_write((a as usize - 0x4002_0000) / 0x400, off, v)
            }
            0x4001_2000 => self.adc_write(off, v),
            0x4002_6000 => self.dma_write(0, off, v),
            0x4002_6400 => self.dma_write(1, off, v),
            0x4000_6400 => self.can_write(off, v),
            0x4001_1000 => self.uart_write(0, off, v),
            0x4000_4800 => self.uart_write(1, off, v),
            0x4000_3800 => self.spi_write(off, v),
            0x4000_2800 => self.rtc_write(off, v),
            0x4002_4000..=0x4002_4c00 => self.backup_sram_write(a & 0xfff, v),
            0x4001_4800 => self.tim11_write(off, v),
            0x4000_3000 => self.iwdg_write(off, v),
            0x4001_3800 => {
                if let Some(r) = self.syscfg.get_mut(off as usize / 4) {
                    *r = v;
                }
            }
            0x4001_3c00 => match off {
                0 => self.exti.imr = v,
                4 => self.exti.emr = v,
                8 => self.exti.rtsr = v,
                12 => self.exti.ftsr = v,
                20 => self.exti.pr &= !v,
                _ => {}
            },
            0xe004_2000 => {
                if let Some(r) = self.dbgmcu.get_mut(off as usize / 4) {
                    *r = v;
                }
            }
            base => {
                if let Some(i) = self.tims.iter().position(|t| t.base == base) {
                    return self.tim_write(i, off, v);
                }
                self.say(Grade::Unmodelled, format!("write of {v:#x} to {a:#010x}"));
            }
        }
    }
}
