//! SPI2 as a master, and the chip selects of the MAX31865 that hang on it.

use super::{Chip, gpio::Gpio};
use crate::{
    report::Grade,
    time::{NEVER, TPS, nanos},
};

#[derive(Default)]
pub struct Spi {
    /// The byte on MISO, whichever device is selected, if its wire is stuck.
    pub stuck: Option<u8>,
    pub(crate) cr1: u32,
    pub(crate) cr2: u32,
    pub(crate) sr: u32,
    pub(crate) tdr: Option<u16>,
    pub(crate) rdr: u16,
    pub(crate) shift: Option<u16>,
    pub end_at: u64,
    pub(crate) sr_read: bool,
    pub bytes: u64,
}

impl Spi {
    pub fn reset() -> Spi {
        Spi { sr: 2, end_at: NEVER, ..Spi::default() }
    }
}

impl Chip {
    pub(crate) fn spi_line(&self) -> bool {
        let s = &self.spi;
        (s.sr & 2 != 0 && s.cr2 & 0x80 != 0)
            || (s.sr & 1 != 0 && s.cr2 & 0x40 != 0)
            || (s.sr & 0x70 != 0 && s.cr2 & 0x20 != 0)
    }

    pub(crate) fn spi_read(&mut self, off: u32) -> u32 {
        match off {
            0 => self.spi.cr1,
            4 => self.spi.cr2,
            8 => {
                self.spi.sr_read = true;
                self.spi.sr | u32::from(self.spi.shift.is_some() || self.spi.tdr.is_some()) << 7
            }
            12 => {
                self.spi.sr &= !1;
                if self.spi.sr_read {
                    self.spi.sr &= !0x40;
                }
                self.spi.rdr.into()
            }
            16 => 7,
            _ => 0,
        }
    }

    pub(crate) fn spi_write(&mut self, off: u32, v: u32) {
        match off {
            0 => {
                let old = self.spi.cr1;
                if old & 0x40 != 0 && (old ^ v) & 0x0bbf & !0x100 != 0 {
                    self.violation(format!(
                        "SPI2_CR1: {:#x} changed while it is on",
                        (old ^ v) & 0xbbf
                    ));
                }
                if old & 0x40 != 0 && v & 0x40 == 0 && self.spi.shift.is_some() {
                    self.violation("SPI2: switched off in the middle of a byte".into());
                }
                self.spi.cr1 = v & 0xffff;
                if v & 4 != 0 && v & 0x200 != 0 && v & 0x100 == 0 {
                    self.violation("SPI2: master with SSM and SSI 0: mode fault".into());
                    self.spi.cr1 &= !0x44;
                    self.spi.sr |= 0x20;
                }
                if v & 4 != 0 && v & 0x200 == 0 && self.spi.cr2 & 4 == 0 && v & 0x40 != 0 {
                    self.say(Grade::Remark, "SPI2: master with hardware NSS as an input".into());
                }
                if v & !old & 0x40 != 0 {
                    let hz = TPS / (self.pclk1 << ((v >> 3 & 7) + 1));
                    self.say(
                        Grade::Fact,
                        format!(
                            "SPI2: SCLK {hz} Hz, mode {}, {} bits",
                            (v >> 1 & 1) * 2 + (v & 1),
                            if v & 0x800 != 0 { 16 } else { 8 }
                        ),
                    );
                    if hz > 5_000_000 {
                        self.violation(format!("SPI2: {hz} Hz, a MAX31865 takes 5 MHz"));
                    }
                    if v & 1 == 0 {
                        self.violation("SPI2: CPHA 0, a MAX31865 takes modes 1 and 3".into());
                    }
                }
                self.spi_load();
            }
            4 => self.spi.cr2 = self.set("SPI2_CR2", self.spi.cr2, v, 0xf7),
            8 => self.spi.sr &= v | !0x10,
            12 => {
                if self.spi.cr1 & 0x44 != 0x44 {
                    self.violation("SPI2: written while it is off or no master".into());
                }
                if self.spi.sr & 2 == 0 {
                    self.violation("SPI2: written while TXE is 0: a byte is lost".into());
                }
                self.spi.sr &= !2;
                self.spi.tdr = Some(v as u16);
                self.spi_load();
            }
            _ => {}
        }
    }

    pub(crate) fn spi_load(&mut self) {
        if self.spi.shift.is_some() || self.spi.cr1 & 0x44 != 0x44 {
            return;
        }
        let Some(v) = self.spi.tdr.take() else { return };
        for (pins, what) in [
            (&[(1, 10), (1, 13)], "SCK"),
            (&[(1, 15), (2, 3)], "MOSI"),
            (&[(1, 14), (2, 2)], "MISO"),
        ] {
            if self.muxed(pins, 5).is_none() {
                self.violation(format!("SPI2: no {what} pin on AF5"));
            }
        }
        let now = self.now;
        let mut chosen = Vec::new();
        for n in 0..8u32 {
            if self.pin_mode(2, n) == 1 && self.gpio[2].odr >> n & 1 == 0 {
                chosen.push(n as usize);
            }
        }
        if chosen.len() != 1 {
            self.violation(format!("SPI2: a byte goes out with {} chips selected", chosen.len()));
        }
        for n in chosen {
            // tCC: 400 ns from the select to the first edge.
            let since = now - self.world.rtds[n].selected_at;
            if nanos(since) < 400 {
                self.violation(format!(
                    "MAX31865: first clock {} ns after its select, tCC is 400 ns",
                    nanos(since)
                ));
            }
        }
        self.spi.shift = Some(v);
        self.spi.sr |= 2;
        let bits = if self.spi.cr1 & 0x800 != 0 { 16 } else { 8 };
        self.spi.end_at = now + bits * (self.pclk1 << ((self.spi.cr1 >> 3 & 7) + 1));
    }

    pub(crate) fn spi_end(&mut self) {
        self.spi.end_at = NEVER;
        let Some(v) = self.spi.shift.take() else { return };
        self.spi.bytes += 1;
        let mut say = Vec::new();
        let mut answer = 0xff;
        for n in 0..8usize {
            if self.pin_mode(2, n as u32) == 1 && self.gpio[2].odr >> n & 1 == 0 {
                let chip = &mut self.world.rtds[n];
                if self.world.populated >> n & 1 != 0 {
                    answer = chip.byte(self.now, v as u8, &mut say);
                }
                chip.last_edge = self.now;
            }
        }
        for s in say {
            self.violation(s);
        }
        if self.spi.sr & 1 != 0 {
            self.spi.sr |= 0x40;
            self.say(Grade::Remark, "SPI2: overrun".into());
        } else {
            self.spi.rdr = u16::from(self.spi.stuck.unwrap_or(answer));
        }
        self.spi.sr |= 1;
        if self.spi.cr2 & 1 != 0 {
            self.dma_request(0, 3, 0);
        }
        self.spi_load();
        if self.spi.cr2 & 2 != 0 && self.spi.sr & 2 != 0 {
            self.dma_request(0, 4, 0);
        }
    }

    /// Watches the chip selects.
    pub(crate) fn pins_changed(&mut self, port: usize, before: &Gpio) {
        if port != 2 {
            return;
        }
        let low = |g: &Gpio, n: u32| g.moder >> (2 * n) & 3 == 1 && g.odr >> n & 1 == 0;
        let now = self.now;
        for n in 0..8u32 {
            let (was, is) = (low(before, n), low(&self.gpio[2], n));
            let chip = &mut self.world.rtds[n as usize];
            if is && !was {
                let since = now - chip.released_at;
                chip.selected_at = now;
                chip.address = None;
                if chip.released_at > 0 && nanos(since) < 400 {
                    self.violation(format!(
                        "MAX31865: select high for {} ns, tCWH is 400 ns",
                        nanos(since)
                    ));
                }
            } else if was && !is {
                let since = now - chip.last_edge;
                chip.released_at = now;
                if self.spi.shift.is_some() {
                    self.violation("MAX31865: select released in the middle of a byte".into());
                } else if chip.last_edge > 0 && nanos(since) < 100 {
                    self.violation(format!(
                        "MAX31865: select released {} ns after the last clock, tCCH is 100 ns",
                        nanos(since)
                    ));
                }
            }
        }
        let lamp = |g: &Gpio| low(g, 12);
        if lamp(before) != lamp(&self.gpio[2]) {
            self.world.lamp.push((now, lamp(&self.gpio[2])));
        }
    }
}
