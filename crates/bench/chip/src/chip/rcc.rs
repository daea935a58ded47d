//! Reset and clock control (RM0090 section 7) and PWR's regulator scale: oscillators, PLL, their limits, enables.

pub(crate) mod registers;

use super::{
    Chip,
    adc::Adcs,
    backup_domain::registers::PWR_CR_VOS,
    bus_access::{BUS_NAMES, CLOCK_GATES},
    can::Can,
    crc::Crc,
    dma::Dma,
    flash::registers::ACR_LATENCY_MASK,
    gpio::Gpio,
    spi::Spi,
    tim::Tim,
    tim11::Tim11,
    uart::Uart,
};
use crate::{
    memory_map::*,
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND, ms_to_ticks, us_to_ticks},
};
use registers::*;
use std::sync::atomic::Ordering;

/// Frequency of the internal oscillator (7.2.2).
pub(crate) const HSI_HZ: u64 = 16_000_000;

/// The registers of reset and clock control, and when its oscillators are ready.
#[derive(Default)]
pub struct Rcc {
    /// RCC_CR, the oscillators and the PLL.
    pub cr: u32,
    pub(crate) pllcfgr: u32,
    pub(crate) cfgr: u32,
    pub(crate) cir: u32,
    /// RCC_AHB1RSTR to RCC_APB2RSTR, the units held in reset.
    pub rstr: [u32; 5],
    /// RCC_AHB1ENR to RCC_APB2ENR, the units with a clock.
    pub enr: [u32; 5],
    pub(crate) lpenr: [u32; 5],
    /// RCC_CSR, LSI and the causes of a reset.
    pub csr: u32,
    pub(crate) sscgr: u32,
    pub(crate) plli2s: u32,
    pub(crate) hse_at: u64,
    pub(crate) pll_at: u64,
    pub(crate) lsi_at: u64,
    pub(crate) sw_wanted: u32,
}

/// Returns the number of the bus, AHB1 to AHB3 and APB1 to APB2, of a register in a group that begins at these offsets.
fn bus_index(off: u32, ahb1: u32, apb1: u32) -> usize {
    if off >= apb1 { (off - apb1) as usize / 4 + 3 } else { (off - ahb1) as usize / 4 }
}

impl Chip {
    pub(crate) fn compute_pll_hz(&mut self) -> u64 {
        let r = self.rcc.pllcfgr;
        let input = if r & RCC_PLLCFGR_PLLSRC != 0 { self.world.crystal_hz } else { HSI_HZ };
        let (m, n, p, q) = (
            u64::from(r & RCC_PLLCFGR_PLLM_MASK),
            u64::from(r >> RCC_PLLCFGR_PLLN_SHIFT & RCC_PLLCFGR_PLLN_MASK),
            u64::from((r >> RCC_PLLCFGR_PLLP_SHIFT & RCC_PLLCFGR_PLLP_MASK) * 2 + 2),
            u64::from(r >> RCC_PLLCFGR_PLLQ_SHIFT & RCC_PLLCFGR_PLLQ_MASK),
        );
        if !(2..=63).contains(&m) || !(50..=432).contains(&n) || q < 2 {
            self.report_violation(format!(
                "RCC_PLLCFGR: M {m}, N {n}, Q {q} are outside what the manual allows"
            ));
            return HSI_HZ;
        }
        let (vin, vco) = (input / m, input / m * n);
        if !(950_000..=2_100_000).contains(&vin) || !(100_000_000..=432_000_000).contains(&vco) {
            self.report_violation(format!(
                "PLL: VCO input {vin} Hz (0.95 to 2.1 MHz), output {vco} Hz (100 to 432 MHz)"
            ));
        }
        self.record_finding(Severity::Fact, format!("PLL: input {input} Hz / {m} × {n} = VCO {vco} Hz, / {p} = {} Hz, 48 MHz domain {} Hz", vco / p, vco / q));
        vco / p
    }

    pub(crate) fn update_clocks(&mut self) {
        let sws = self.rcc.cfgr >> RCC_CFGR_SWS_SHIFT & RCC_CFGR_SWS_MASK;
        self.sys_hz = match sws {
            SYSTEM_CLOCK_HSI => HSI_HZ,
            SYSTEM_CLOCK_HSE => self.world.crystal_hz,
            _ => self.compute_pll_hz(),
        };
        let ahb = match self.rcc.cfgr >> RCC_CFGR_HPRE_SHIFT & RCC_CFGR_HPRE_MASK {
            n @ 8..=11 => 1 << (n - 7),
            n @ 12..=15 => 1 << (n - 6),
            _ => 1u64,
        };
        let apb = |f: u32| if f & PPRE_DIVIDED != 0 { 2u64 << (f & PPRE_EXPONENT_MASK) } else { 1 };
        let (a1, a2) = (
            apb(self.rcc.cfgr >> RCC_CFGR_PPRE1_SHIFT & RCC_CFGR_PPRE_MASK),
            apb(self.rcc.cfgr >> RCC_CFGR_PPRE2_SHIFT & RCC_CFGR_PPRE_MASK),
        );
        let sys = TICKS_PER_SECOND / self.sys_hz;
        if !TICKS_PER_SECOND.is_multiple_of(self.sys_hz) {
            self.record_finding(
                Severity::Remark,
                format!(
                    "the model rounds {} Hz to {} Hz",
                    self.sys_hz,
                    TICKS_PER_SECOND as f64 / sys as f64
                ),
            );
        }
        for t in &mut self.tims {
            t.rebase_count(self.now);
        }
        self.hclk = sys * ahb;
        self.pclk1 = self.hclk * a1;
        self.pclk2 = self.hclk * a2;
        self.tclk1 = if a1 == 1 { self.pclk1 } else { self.pclk1 / 2 };
        self.tclk2 = if a2 == 1 { self.pclk2 } else { self.pclk2 / 2 };
        for t in &mut self.tims {
            t.tick = if t.apb2 { self.tclk2 } else { self.tclk1 };
            t.schedule_events(self.now);
        }
        self.shared.cycle.store(self.hclk, Ordering::Relaxed);
        let hz = |t: u64| TICKS_PER_SECOND / t;
        if hz(self.hclk) > 168_000_000 || hz(self.pclk1) > 42_000_000 || hz(self.pclk2) > 84_000_000
        {
            self.report_violation(format!(
                "clocks: HCLK {}, APB1 {}, APB2 {} Hz; at most 168, 42 and 84 MHz",
                hz(self.hclk),
                hz(self.pclk1),
                hz(self.pclk2)
            ));
        }
        self.check_voltage_scale();
        self.check_flash_latency();
        self.record_finding(
            Severity::Fact,
            format!(
                "clocks: source {}, SYSCLK {} Hz, HCLK {}, APB1 {}, APB2 {}, flash wait states {}",
                ["HSI", "HSE", "PLL", "?"][sws as usize],
                self.sys_hz,
                hz(self.hclk),
                hz(self.pclk1),
                hz(self.pclk2),
                self.flash.acr & ACR_LATENCY_MASK
            ),
        );
    }

    /// 3.5.1: above 144 MHz the regulator is at scale 1.
    pub(crate) fn check_voltage_scale(&mut self) {
        if TICKS_PER_SECOND / self.hclk > 144_000_000 && self.pwr_cr & PWR_CR_VOS == 0 {
            self.report_violation(
                "HCLK above 144 MHz with the regulator at scale 2 (PWR_CR.VOS 0)".into(),
            );
        }
    }

    /// The clock tree, and the lock of the flash, as the loader leaves them: 60 MHz from HSI by the PLL.
    pub(crate) fn set_bootloader_state(&mut self) {
        self.rcc.pllcfgr = RCC_PLLCFGR_RESERVED_ONES
            | 5 << RCC_PLLCFGR_PLLQ_SHIFT
            | 1 << RCC_PLLCFGR_PLLP_SHIFT
            | 240 << RCC_PLLCFGR_PLLN_SHIFT
            | 16;
        self.rcc.cr |= RCC_CR_PLLON | RCC_CR_PLLRDY;
        self.rcc.cfgr =
            4 << RCC_CFGR_PPRE1_SHIFT | SYSTEM_CLOCK_PLL << RCC_CFGR_SWS_SHIFT | SYSTEM_CLOCK_PLL;
        self.rcc.sw_wanted = SYSTEM_CLOCK_PLL;
        self.flash.acr = 2;
        self.update_accelerator(0);
        self.flash.unlock();
        self.update_clocks();
    }

    pub(crate) fn try_clock_switch(&mut self) {
        let want = self.rcc.sw_wanted;
        let ready = match want {
            SYSTEM_CLOCK_HSI => self.rcc.cr & RCC_CR_HSIRDY,
            SYSTEM_CLOCK_HSE => self.rcc.cr & RCC_CR_HSERDY,
            SYSTEM_CLOCK_PLL => self.rcc.cr & RCC_CR_PLLRDY,
            _ => 0,
        } != 0;
        if ready && self.rcc.cfgr >> RCC_CFGR_SWS_SHIFT & RCC_CFGR_SWS_MASK != want {
            self.rcc.cfgr = self.rcc.cfgr & !RCC_CFGR_SWS | want << RCC_CFGR_SWS_SHIFT;
            self.update_clocks();
        }
    }

    /// The crystal stops. With the clock security system on, the chip goes on from HSI and raises the NMI.
    pub(crate) fn inject_hse_failure(&mut self) {
        self.faults.hse_stops = 0;
        self.faults.hse_dead = true;
        self.rcc.cr &= !RCC_CR_HSERDY;
        let sws = self.rcc.cfgr >> RCC_CFGR_SWS_SHIFT & RCC_CFGR_SWS_MASK;
        let in_use = sws == SYSTEM_CLOCK_HSE
            || (sws == SYSTEM_CLOCK_PLL && self.rcc.pllcfgr & RCC_PLLCFGR_PLLSRC != 0);
        if self.rcc.cr & RCC_CR_CSSON != 0 {
            self.rcc.cr &= !(RCC_CR_HSEON | RCC_CR_PLLON | RCC_CR_PLLRDY);
            self.rcc.cr |= RCC_CR_HSIRDY | RCC_CR_HSION;
            self.rcc.cir |= RCC_CIR_CSSF;
            if in_use {
                self.rcc.cfgr &= !(RCC_CFGR_SWS | RCC_CFGR_SW_MASK);
                self.rcc.sw_wanted = SYSTEM_CLOCK_HSI;
                self.update_clocks();
            }
        } else if in_use {
            self.record_finding(
                Severity::Remark,
                "the crystal stops without the clock security system: the processor stands still"
                    .into(),
            );
        }
    }

    pub(crate) fn read_rcc_register(&mut self, off: u32) -> u32 {
        let r = &self.rcc;
        match off {
            RCC_CR_OFFSET => r.cr,
            RCC_PLLCFGR_OFFSET => r.pllcfgr,
            RCC_CFGR_OFFSET => r.cfgr,
            RCC_CIR_OFFSET => r.cir,
            RCC_AHB1RSTR_OFFSET | RCC_AHB2RSTR_OFFSET | RCC_AHB3RSTR_OFFSET
            | RCC_APB1RSTR_OFFSET | RCC_APB2RSTR_OFFSET => {
                r.rstr[bus_index(off, RCC_AHB1RSTR_OFFSET, RCC_APB1RSTR_OFFSET)]
            }
            RCC_AHB1ENR_OFFSET | RCC_AHB2ENR_OFFSET | RCC_AHB3ENR_OFFSET | RCC_APB1ENR_OFFSET
            | RCC_APB2ENR_OFFSET => r.enr[bus_index(off, RCC_AHB1ENR_OFFSET, RCC_APB1ENR_OFFSET)],
            RCC_AHB1LPENR_OFFSET | RCC_AHB2LPENR_OFFSET | RCC_AHB3LPENR_OFFSET
            | RCC_APB1LPENR_OFFSET | RCC_APB2LPENR_OFFSET => {
                r.lpenr[bus_index(off, RCC_AHB1LPENR_OFFSET, RCC_APB1LPENR_OFFSET)]
            }
            RCC_BDCR_OFFSET => self.read_bdcr(),
            RCC_CSR_OFFSET => r.csr,
            RCC_SSCGR_OFFSET => r.sscgr,
            RCC_PLLI2SCFGR_OFFSET => r.plli2s,
            _ => {
                self.report_violation(format!("RCC: read at the reserved offset {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn write_rcc_register(&mut self, off: u32, v: u32) {
        let now = self.now;
        match off {
            RCC_CR_OFFSET => self.write_rcc_cr(v),
            RCC_PLLCFGR_OFFSET => {
                if self.rcc.cr & RCC_CR_PLLON != 0 {
                    self.report_violation("RCC_PLLCFGR: written while the PLL is on".into());
                    return;
                }
                self.rcc.pllcfgr = self.apply_write_mask(
                    "RCC_PLLCFGR",
                    self.rcc.pllcfgr,
                    v,
                    RCC_PLLCFGR_WRITE_MASK,
                );
            }
            RCC_CFGR_OFFSET => self.write_rcc_cfgr(v),
            RCC_CIR_OFFSET => {
                // RDY flags and CSSF are cleared by their bits 16 higher.
                let cleared = v >> RCC_CIR_CLEAR_SHIFT & RCC_CIR_CLEAR_MASK;
                self.rcc.cir = (self.rcc.cir & !cleared) & RCC_CIR_FLAGS_MASK | v & RCC_CIR_ENABLES;
            }
            RCC_AHB1RSTR_OFFSET | RCC_AHB2RSTR_OFFSET | RCC_AHB3RSTR_OFFSET
            | RCC_APB1RSTR_OFFSET | RCC_APB2RSTR_OFFSET => {
                let i = bus_index(off, RCC_AHB1RSTR_OFFSET, RCC_APB1RSTR_OFFSET);
                let old = self.rcc.rstr[i];
                self.rcc.rstr[i] = v;
                for (base, bus, bit, _) in CLOCK_GATES {
                    if *bus == i && (!old & v) >> bit & 1 != 0 {
                        self.reset_peripheral(*base);
                    }
                }
            }
            RCC_AHB1ENR_OFFSET | RCC_AHB2ENR_OFFSET | RCC_AHB3ENR_OFFSET | RCC_APB1ENR_OFFSET
            | RCC_APB2ENR_OFFSET => {
                let i = bus_index(off, RCC_AHB1ENR_OFFSET, RCC_APB1ENR_OFFSET);
                let mask = RCC_ENR_WRITE_MASKS[i];
                self.rcc.enr[i] = self.apply_write_mask(
                    &format!("RCC_{}ENR", BUS_NAMES[i]),
                    self.rcc.enr[i],
                    v,
                    mask,
                );
            }
            RCC_AHB1LPENR_OFFSET | RCC_AHB2LPENR_OFFSET | RCC_AHB3LPENR_OFFSET
            | RCC_APB1LPENR_OFFSET | RCC_APB2LPENR_OFFSET => {
                let i = bus_index(off, RCC_AHB1LPENR_OFFSET, RCC_APB1LPENR_OFFSET);
                self.rcc.lpenr[i] = v;
            }
            RCC_BDCR_OFFSET => self.write_bdcr(v),
            RCC_CSR_OFFSET => {
                if v & RCC_CSR_LSION != 0 && self.rcc.csr & (RCC_CSR_LSIRDY | RCC_CSR_LSION) == 0 {
                    self.rcc.lsi_at = now + us_to_ticks(40);
                }
                self.rcc.csr = self.rcc.csr & !RCC_CSR_LSION | v & RCC_CSR_LSION;
                if v & RCC_CSR_LSION == 0 && !self.iwdg.running {
                    self.rcc.csr &= !RCC_CSR_LSIRDY;
                }
                if v & RCC_CSR_RMVF != 0 {
                    self.rcc.csr &= RCC_CSR_LSIRDY | RCC_CSR_LSION;
                }
            }
            RCC_SSCGR_OFFSET => self.rcc.sscgr = v,
            RCC_PLLI2SCFGR_OFFSET => self.rcc.plli2s = v,
            _ => self.report_violation(format!("RCC: write at the reserved offset {off:#x}")),
        }
    }

    /// Writes RCC_CFGR: chooses the system clock and its prescalers.
    fn write_rcc_cfgr(&mut self, v: u32) {
        self.rcc.cfgr = self.apply_write_mask(
            "RCC_CFGR",
            self.rcc.cfgr,
            v & !RCC_CFGR_SWS | self.rcc.cfgr & RCC_CFGR_SWS,
            RCC_CFGR_WRITE_MASK,
        );
        self.rcc.sw_wanted = v & RCC_CFGR_SW_MASK;
        let ready = match v & RCC_CFGR_SW_MASK {
            SYSTEM_CLOCK_HSI => self.rcc.cr & RCC_CR_HSIRDY,
            SYSTEM_CLOCK_HSE => self.rcc.cr & RCC_CR_HSERDY,
            SYSTEM_CLOCK_PLL => self.rcc.cr & RCC_CR_PLLRDY,
            _ => 0,
        } != 0;
        if !ready {
            self.report_violation(format!(
                "RCC_CFGR: SW {} chosen while that clock is not ready",
                v & RCC_CFGR_SW_MASK
            ));
        }
        let sws = self.rcc.cfgr >> RCC_CFGR_SWS_SHIFT & RCC_CFGR_SWS_MASK;
        self.try_clock_switch();
        if self.rcc.cfgr >> RCC_CFGR_SWS_SHIFT & RCC_CFGR_SWS_MASK == sws {
            self.update_clocks();
        }
    }

    /// Writes RCC_CR: switches the crystal and the PLL.
    fn write_rcc_cr(&mut self, v: u32) {
        let now = self.now;
        let ready = RCC_CR_READ_ONLY;
        let old = self.rcc.cr;
        let v = self.apply_write_mask("RCC_CR", old, v & !ready | old & ready, RCC_CR_WRITE_MASK);
        self.rcc.cr = v;
        let on = |bit: u32| (!old & v) >> bit & 1 != 0;
        let off = |bit: u32| (old & !v) >> bit & 1 != 0;
        let sws = self.rcc.cfgr >> RCC_CFGR_SWS_SHIFT & RCC_CFGR_SWS_MASK;
        if on(RCC_CR_HSEON_BIT) && !self.faults.hse_dead {
            self.rcc.hse_at = now + ms_to_ticks(2);
        }
        if off(RCC_CR_HSEON_BIT) {
            if sws == SYSTEM_CLOCK_HSE
                || (sws == SYSTEM_CLOCK_PLL && self.rcc.pllcfgr & RCC_PLLCFGR_PLLSRC != 0)
            {
                self.report_violation("RCC_CR: HSEON cleared while the system runs on it".into());
                self.rcc.cr |= RCC_CR_HSEON;
            } else {
                self.rcc.cr &= !RCC_CR_HSERDY;
                self.rcc.hse_at = NEVER;
            }
        }
        if on(RCC_CR_PLLON_BIT) {
            let source = if self.rcc.pllcfgr & RCC_PLLCFGR_PLLSRC != 0 {
                RCC_CR_HSERDY_BIT
            } else {
                RCC_CR_HSIRDY_BIT
            };
            if v >> source & 1 == 0 {
                self.report_violation("RCC_CR: PLLON set before its source is ready".into());
            } else if !self.faults.pll_dead {
                self.rcc.pll_at = now + us_to_ticks(150);
            }
        }
        if off(RCC_CR_PLLON_BIT) {
            if sws == SYSTEM_CLOCK_PLL {
                self.report_violation("RCC_CR: PLLON cleared while the system runs on it".into());
                self.rcc.cr |= RCC_CR_PLLON;
            } else {
                self.rcc.cr &= !RCC_CR_PLLRDY;
                self.rcc.pll_at = NEVER;
            }
        }
        self.rcc.cr = if v & RCC_CR_HSION != 0 {
            self.rcc.cr | RCC_CR_HSIRDY
        } else {
            self.rcc.cr & !RCC_CR_HSIRDY
        };
    }

    pub(crate) fn reset_peripheral(&mut self, base: u32) {
        match base {
            GPIOA_BASE..=GPIO_LAST => {
                self.gpio[(base as usize - GPIOA_BASE as usize) / GPIO_STRIDE] = Gpio::default()
            }
            // 7.3.9: one bit resets all three.
            ADC1_BASE => self.adc = Adcs::default(),
            CRC_BASE => self.crc = Crc::default(),
            DMA1_BASE => self.dma[0] = Dma::default(),
            DMA2_BASE => self.dma[1] = Dma::default(),
            CAN1_BASE => self.can = Can::after_reset(),
            USART1_BASE => self.uart[0] = Uart::after_reset(),
            USART3_BASE => self.uart[1] = Uart::after_reset(),
            SPI2_BASE => self.spi = Spi::after_reset(),
            TIM11_BASE => self.tim11 = Tim11::default(),
            _ => {
                let fresh = Tim::timers_after_reset();
                for (i, f) in fresh.into_iter().enumerate() {
                    if f.base == base {
                        let tick = self.tims[i].tick;
                        self.tims[i] = f;
                        self.tims[i].tick = tick;
                    }
                }
            }
        }
    }
}
