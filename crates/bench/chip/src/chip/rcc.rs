//! Reset and clock control (RM0090 section 7) and PWR's regulator scale: oscillators, PLL, their limits, enables.

use super::{
    Chip,
    adc::Adcs,
    bus::{BUSES, GATES},
    can::Can,
    crc::Crc,
    dma::Dma,
    gpio::Gpio,
    spi::Spi,
    tim::Tim,
    tim11::Tim11,
    uart::Uart,
};
use crate::{
    report::Grade,
    time::{NEVER, TPS, ms, us},
};
use std::sync::atomic::Ordering;

#[derive(Default)]
pub struct Rcc {
    pub cr: u32,
    pub(crate) pllcfgr: u32,
    pub(crate) cfgr: u32,
    pub(crate) cir: u32,
    pub rstr: [u32; 5],
    pub enr: [u32; 5],
    pub(crate) lpenr: [u32; 5],
    pub csr: u32,
    pub(crate) sscgr: u32,
    pub(crate) plli2s: u32,
    pub(crate) hse_at: u64,
    pub(crate) pll_at: u64,
    pub(crate) lsi_at: u64,
    pub(crate) sw_wanted: u32,
}

impl Chip {
    pub(crate) fn pll_hz(&mut self) -> u64 {
        let r = self.rcc.pllcfgr;
        let input = if r & 1 << 22 != 0 { self.world.crystal_hz } else { 16_000_000 };
        let (m, n, p, q) = (
            u64::from(r & 63),
            u64::from(r >> 6 & 511),
            u64::from((r >> 16 & 3) * 2 + 2),
            u64::from(r >> 24 & 15),
        );
        if !(2..=63).contains(&m) || !(50..=432).contains(&n) || q < 2 {
            self.violation(format!(
                "RCC_PLLCFGR: M {m}, N {n}, Q {q} are outside what the manual allows"
            ));
            return 16_000_000;
        }
        let (vin, vco) = (input / m, input / m * n);
        if !(950_000..=2_100_000).contains(&vin) || !(100_000_000..=432_000_000).contains(&vco) {
            self.violation(format!(
                "PLL: VCO input {vin} Hz (0.95 to 2.1 MHz), output {vco} Hz (100 to 432 MHz)"
            ));
        }
        self.say(Grade::Fact, format!("PLL: input {input} Hz / {m} × {n} = VCO {vco} Hz, / {p} = {} Hz, 48 MHz domain {} Hz", vco / p, vco / q));
        vco / p
    }

    pub(crate) fn clocks(&mut self) {
        let sws = self.rcc.cfgr >> 2 & 3;
        self.sys_hz = match sws {
            0 => 16_000_000,
            1 => self.world.crystal_hz,
            _ => self.pll_hz(),
        };
        let ahb = match self.rcc.cfgr >> 4 & 15 {
            n @ 8..=11 => 1 << (n - 7),
            n @ 12..=15 => 1 << (n - 6),
            _ => 1u64,
        };
        let apb = |f: u32| if f & 4 != 0 { 2u64 << (f & 3) } else { 1 };
        let (a1, a2) = (apb(self.rcc.cfgr >> 10 & 7), apb(self.rcc.cfgr >> 13 & 7));
        let sys = TPS / self.sys_hz;
        if !TPS.is_multiple_of(self.sys_hz) {
            self.say(
                Grade::Remark,
                format!("the model rounds {} Hz to {} Hz", self.sys_hz, TPS as f64 / sys as f64),
            );
        }
        for t in &mut self.tims {
            t.freeze(self.now);
        }
        self.hclk = sys * ahb;
        self.pclk1 = self.hclk * a1;
        self.pclk2 = self.hclk * a2;
        self.tclk1 = if a1 == 1 { self.pclk1 } else { self.pclk1 / 2 };
        self.tclk2 = if a2 == 1 { self.pclk2 } else { self.pclk2 / 2 };
        for t in &mut self.tims {
            t.tick = if t.apb2 { self.tclk2 } else { self.tclk1 };
            t.thaw(self.now);
        }
        self.shared.cycle.store(self.hclk, Ordering::Relaxed);
        let hz = |t: u64| TPS / t;
        if hz(self.hclk) > 168_000_000 || hz(self.pclk1) > 42_000_000 || hz(self.pclk2) > 84_000_000
        {
            self.violation(format!(
                "clocks: HCLK {}, APB1 {}, APB2 {} Hz; at most 168, 42 and 84 MHz",
                hz(self.hclk),
                hz(self.pclk1),
                hz(self.pclk2)
            ));
        }
        self.scale_check();
        self.flash_check();
        self.say(
            Grade::Fact,
            format!(
                "clocks: source {}, SYSCLK {} Hz, HCLK {}, APB1 {}, APB2 {}, flash wait states {}",
                ["HSI", "HSE", "PLL", "?"][sws as usize],
                self.sys_hz,
                hz(self.hclk),
                hz(self.pclk1),
                hz(self.pclk2),
                self.flash.acr & 7
            ),
        );
    }

    /// 3.5.1: above 144 MHz the regulator is at scale 1.
    pub(crate) fn scale_check(&mut self) {
        if TPS / self.hclk > 144_000_000 && self.pwr_cr & 0x4000 == 0 {
            self.violation(
                "HCLK above 144 MHz with the regulator at scale 2 (PWR_CR.VOS 0)".into(),
            );
        }
    }

    /// The clock tree, and the lock of the flash, as the loader leaves them: 60 MHz from HSI by the PLL.
    pub(crate) fn as_from_loader(&mut self) {
        self.rcc.pllcfgr = 2 << 28 | 5 << 24 | 1 << 16 | 240 << 6 | 16;
        self.rcc.cr |= 1 << 24 | 1 << 25;
        self.rcc.cfgr = 4 << 10 | 2 << 2 | 2;
        self.rcc.sw_wanted = 2;
        self.flash.acr = 2;
        self.tell_acr(0);
        self.flash.unlock();
        self.clocks();
    }

    pub(crate) fn try_switch(&mut self) {
        let want = self.rcc.sw_wanted;
        let ready = match want {
            0 => self.rcc.cr & 2,
            1 => self.rcc.cr & 1 << 17,
            2 => self.rcc.cr & 1 << 25,
            _ => 0,
        } != 0;
        if ready && self.rcc.cfgr >> 2 & 3 != want {
            self.rcc.cfgr = self.rcc.cfgr & !0xc | want << 2;
            self.clocks();
        }
    }

    /// The crystal stops. With the clock security system on, the chip goes on from HSI and raises the NMI.
    pub(crate) fn hse_stop(&mut self) {
        self.faults.hse_stops = 0;
        self.faults.hse_dead = true;
        self.rcc.cr &= !(1 << 17);
        let sws = self.rcc.cfgr >> 2 & 3;
        let in_use = sws == 1 || (sws == 2 && self.rcc.pllcfgr & 1 << 22 != 0);
        if self.rcc.cr & 1 << 19 != 0 {
            self.rcc.cr &= !(1 << 16 | 1 << 24 | 1 << 25);
            self.rcc.cr |= 3;
            self.rcc.cir |= 0x80;
            if in_use {
                self.rcc.cfgr &= !0xf;
                self.rcc.sw_wanted = 0;
                self.clocks();
            }
        } else if in_use {
            self.say(
                Grade::Remark,
                "the crystal stops without the clock security system: the processor stands still"
                    .into(),
            );
        }
    }

    pub(crate) fn rcc_read(&mut self, off: u32) -> u32 {
        let r = &self.rcc;
        match off {
            0x00 => r.cr,
            0x04 => r.pllcfgr,
            0x08 => r.cfgr,
            0x0c => r.cir,
            0x10 | 0x14 | 0x18 => r.rstr[(off as usize - 0x10) / 4],
            0x20 => r.rstr[3],
            0x24 => r.rstr[4],
            0x30 | 0x34 | 0x38 => r.enr[(off as usize - 0x30) / 4],
            0x40 => r.enr[3],
            0x44 => r.enr[4],
            0x50 | 0x54 | 0x58 => r.lpenr[(off as usize - 0x50) / 4],
            0x60 => r.lpenr[3],
            0x64 => r.lpenr[4],
            0x70 => self.bdcr_read(),
            0x74 => r.csr,
            0x80 => r.sscgr,
            0x84 => r.plli2s,
            _ => {
                self.violation(format!("RCC: read at the reserved offset {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn rcc_write(&mut self, off: u32, v: u32) {
        let now = self.now;
        match off {
            0x00 => self.rcc_control(v),
            0x04 => {
                if self.rcc.cr & 1 << 24 != 0 {
                    self.violation("RCC_PLLCFGR: written while the PLL is on".into());
                    return;
                }
                self.rcc.pllcfgr = self.set("RCC_PLLCFGR", self.rcc.pllcfgr, v, 0x0f43_7fff);
            }
            0x08 => {
                self.rcc.cfgr = self.set(
                    "RCC_CFGR",
                    self.rcc.cfgr,
                    v & !0xc | self.rcc.cfgr & 0xc,
                    0xffff_fcf3,
                );
                self.rcc.sw_wanted = v & 3;
                let ready = match v & 3 {
                    0 => self.rcc.cr & 2,
                    1 => self.rcc.cr & 1 << 17,
                    2 => self.rcc.cr & 1 << 25,
                    _ => 0,
                } != 0;
                if !ready {
                    self.violation(format!(
                        "RCC_CFGR: SW {} chosen while that clock is not ready",
                        v & 3
                    ));
                }
                let sws = self.rcc.cfgr >> 2 & 3;
                self.try_switch();
                if self.rcc.cfgr >> 2 & 3 == sws {
                    self.clocks();
                }
            }
            0x0c => {
                // RDY flags and CSSF are cleared by their bits 16 higher.
                let cleared = v >> 16 & 0xbf;
                self.rcc.cir = (self.rcc.cir & !cleared) & 0xff | v & 0x3f00;
            }
            0x10 | 0x14 | 0x18 | 0x20 | 0x24 => {
                let i = if off >= 0x20 {
                    (off as usize - 0x20) / 4 + 3
                } else {
                    (off as usize - 0x10) / 4
                };
                let old = self.rcc.rstr[i];
                self.rcc.rstr[i] = v;
                for (base, bus, bit, _) in GATES {
                    if *bus == i && (!old & v) >> bit & 1 != 0 {
                        self.reset_unit(*base);
                    }
                }
            }
            0x30 | 0x34 | 0x38 | 0x40 | 0x44 => {
                let i = if off >= 0x40 {
                    (off as usize - 0x40) / 4 + 3
                } else {
                    (off as usize - 0x30) / 4
                };
                let mask = [0x7e7411ff, 0xf1, 1, 0x36fec9ff, 0x00075f33][i];
                self.rcc.enr[i] =
                    self.set(&format!("RCC_{}ENR", BUSES[i]), self.rcc.enr[i], v, mask);
            }
            0x50 | 0x54 | 0x58 | 0x60 | 0x64 => {
                let i = if off >= 0x60 {
                    (off as usize - 0x60) / 4 + 3
                } else {
                    (off as usize - 0x50) / 4
                };
                self.rcc.lpenr[i] = v;
            }
            0x70 => self.bdcr_write(v),
            0x74 => {
                if v & 1 != 0 && self.rcc.csr & 3 == 0 {
                    self.rcc.lsi_at = now + us(40);
                }
                self.rcc.csr = self.rcc.csr & !1 | v & 1;
                if v & 1 == 0 && !self.iwdg.running {
                    self.rcc.csr &= !2;
                }
                if v & 1 << 24 != 0 {
                    self.rcc.csr &= 3;
                }
            }
            0x80 => self.rcc.sscgr = v,
            0x84 => self.rcc.plli2s = v,
            _ => self.violation(format!("RCC: write at the reserved offset {off:#x}")),
        }
    }

    /// Writes RCC_CR: switches the crystal and the PLL.
    fn rcc_control(&mut self, v: u32) {
        let now = self.now;
        let ready = 1 << 1 | 0xff00 | 1 << 17 | 1 << 25 | 1 << 27;
        let old = self.rcc.cr;
        let v = self.set("RCC_CR", old, v & !ready | old & ready, 0x050d_00f9);
        self.rcc.cr = v;
        let on = |bit: u32| (!old & v) >> bit & 1 != 0;
        let off = |bit: u32| (old & !v) >> bit & 1 != 0;
        let sws = self.rcc.cfgr >> 2 & 3;
        if on(16) && !self.faults.hse_dead {
            self.rcc.hse_at = now + ms(2);
        }
        if off(16) {
            if sws == 1 || (sws == 2 && self.rcc.pllcfgr & 1 << 22 != 0) {
                self.violation("RCC_CR: HSEON cleared while the system runs on it".into());
                self.rcc.cr |= 1 << 16;
            } else {
                self.rcc.cr &= !(1 << 17);
                self.rcc.hse_at = NEVER;
            }
        }
        if on(24) {
            let source = if self.rcc.pllcfgr & 1 << 22 != 0 { 17 } else { 1 };
            if v >> source & 1 == 0 {
                self.violation("RCC_CR: PLLON set before its source is ready".into());
            } else if !self.faults.pll_dead {
                self.rcc.pll_at = now + us(150);
            }
        }
        if off(24) {
            if sws == 2 {
                self.violation("RCC_CR: PLLON cleared while the system runs on it".into());
                self.rcc.cr |= 1 << 24;
            } else {
                self.rcc.cr &= !(1 << 25);
                self.rcc.pll_at = NEVER;
            }
        }
        self.rcc.cr = if v & 1 != 0 { self.rcc.cr | 2 } else { self.rcc.cr & !2 };
    }

    pub(crate) fn reset_unit(&mut self, base: u32) {
        match base {
            0x4002_0000..=0x4002_23ff => {
                self.gpio[(base as usize - 0x4002_0000) / 0x400] = Gpio::default()
            }
            // 7.3.9: one bit resets all three.
            0x4001_2000 => self.adc = Adcs::default(),
            0x4002_3000 => self.crc = Crc::default(),
            0x4002_6000 => self.dma[0] = Dma::default(),
            0x4002_6400 => self.dma[1] = Dma::default(),
            0x4000_6400 => self.can = Can::reset(),
            0x4001_1000 => self.uart[0] = Uart::reset(),
            0x4000_4800 => self.uart[1] = Uart::reset(),
            0x4000_3800 => self.spi = Spi::reset(),
            0x4001_4800 => self.tim11 = Tim11::default(),
            _ => {
                let fresh = Tim::all();
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
