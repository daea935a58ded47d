//! The ports: modes, alternate functions, levels (RM0090 section 8).

use super::Chip;
use crate::report::Grade;

#[derive(Default, Clone)]
pub struct Gpio {
    pub moder: u32,
    pub(crate) otyper: u32,
    pub(crate) ospeedr: u32,
    pub pupdr: u32,
    pub odr: u32,
    pub(crate) lckr: u32,
    pub afr: [u32; 2],
}

impl Chip {
    pub(crate) fn pin_mode(&self, port: usize, pin: u32) -> u32 {
        self.gpio[port].moder >> (2 * pin) & 3
    }
    pub(crate) fn pin_af(&self, port: usize, pin: u32) -> Option<u32> {
        (self.pin_mode(port, pin) == 2)
            .then(|| self.gpio[port].afr[pin as usize / 8] >> (4 * (pin % 8)) & 15)
    }
    /// Returns whether one of these pins carries that alternate function; which.
    pub(crate) fn muxed(&self, pins: &[(usize, u32)], af: u32) -> Option<(usize, u32)> {
        pins.iter().copied().find(|(p, n)| self.pin_af(*p, *n) == Some(af))
    }

    pub(crate) fn gpio_read(&mut self, p: usize, off: u32) -> u32 {
        let g = &self.gpio[p];
        match off {
            0x00 => g.moder,
            0x04 => g.otyper,
            0x08 => g.ospeedr,
            0x0c => g.pupdr,
            0x10 => {
                let mut v = 0;
                for n in 0..16 {
                    let level = match g.moder >> (2 * n) & 3 {
                        1 => {
                            g.odr >> n & 1 != 0
                                && (g.otyper >> n & 1 == 0 || self.world.pulled_up(p, n))
                        }
                        3 => false,
                        _ => self.world.level(p, n).unwrap_or(g.pupdr >> (2 * n) & 3 == 1),
                    };
                    v |= u32::from(level) << n;
                }
                v
            }
            0x14 => g.odr,
            0x18 => 0,
            0x1c => g.lckr,
            0x20 => g.afr[0],
            0x24 => g.afr[1],
            _ => {
                self.violation(format!("GPIO: read at {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn gpio_write(&mut self, p: usize, off: u32, v: u32) {
        let letter = (b'A' + p as u8) as char;
        let before = self.gpio[p].clone();
        let g = &mut self.gpio[p];
        match off {
            0x00 => g.moder = v,
            0x04 => g.otyper = v & 0xffff,
            0x08 => g.ospeedr = v,
            0x0c => g.pupdr = v,
            0x10 => self.violation(format!("GPIO{letter}_IDR written")),
            0x14 => g.odr = v & 0xffff,
            0x18 => g.odr = (g.odr & !(v >> 16) | v) & 0xffff,
            0x1c => g.lckr = v,
            0x20 => g.afr[0] = v,
            0x24 => g.afr[1] = v,
            _ => self.violation(format!("GPIO{letter}: write at {off:#x}")),
        }
        if p == 0
            && (before.moder ^ self.gpio[0].moder) >> 26 & 15 != 0
            && self.gpio[0].moder >> 26 & 15 != 0b1010
        {
            self.say(Grade::Remark, "PA13 or PA14 taken from the debug port".into());
        }
        self.pins_changed(p, &before);
    }
}
