//! The ports: modes, alternate functions, levels (RM0090 section 8).

pub(super) mod registers;

use super::Chip;
use crate::report::Severity;
use registers::*;

/// The registers of a port.
#[derive(Default, Clone)]
pub struct Gpio {
    /// GPIOx_MODER, the modes of the pins.
    pub moder: u32,
    pub(crate) otyper: u32,
    pub(crate) ospeedr: u32,
    /// GPIOx_PUPDR, the pull-ups and pull-downs.
    pub pupdr: u32,
    /// GPIOx_ODR, the output levels.
    pub odr: u32,
    pub(crate) lckr: u32,
    /// GPIOx_AFRL and GPIOx_AFRH, the alternate functions.
    pub afr: [u32; 2],
}

impl Chip {
    pub(crate) fn pin_mode(&self, port: usize, pin: u32) -> u32 {
        self.gpio[port].moder >> (2 * pin) & PIN_FIELD_MASK
    }
    pub(crate) fn pin_alternate_function(&self, port: usize, pin: u32) -> Option<u32> {
        (self.pin_mode(port, pin) == MODE_ALTERNATE)
            .then(|| self.gpio[port].afr[pin as usize / 8] >> (4 * (pin % 8)) & AF_FIELD_MASK)
    }
    /// Returns whether one of these pins carries that alternate function; which.
    pub(crate) fn find_pin_with_alternate_function(
        &self,
        pins: &[(usize, u32)],
        af: u32,
    ) -> Option<(usize, u32)> {
        pins.iter().copied().find(|(p, n)| self.pin_alternate_function(*p, *n) == Some(af))
    }

    pub(crate) fn read_gpio_register(&mut self, p: usize, off: u32) -> u32 {
        let g = &self.gpio[p];
        match off {
            MODER_OFFSET => g.moder,
            OTYPER_OFFSET => g.otyper,
            OSPEEDR_OFFSET => g.ospeedr,
            PUPDR_OFFSET => g.pupdr,
            IDR_OFFSET => {
                let mut v = 0;
                for n in 0..16 {
                    let level = match g.moder >> (2 * n) & PIN_FIELD_MASK {
                        MODE_OUTPUT => {
                            g.odr >> n & 1 != 0
                                && (g.otyper >> n & 1 == 0 || self.world.is_pulled_up(p, n))
                        }
                        MODE_ANALOG => false,
                        _ => self
                            .world
                            .external_pin_level(p, n)
                            .unwrap_or(g.pupdr >> (2 * n) & PIN_FIELD_MASK == PULL_UP),
                    };
                    v |= u32::from(level) << n;
                }
                v
            }
            ODR_OFFSET => g.odr,
            BSRR_OFFSET => 0,
            LCKR_OFFSET => g.lckr,
            AFRL_OFFSET => g.afr[0],
            AFRH_OFFSET => g.afr[1],
            _ => {
                self.report_violation(format!("GPIO: read at {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn write_gpio_register(&mut self, p: usize, off: u32, v: u32) {
        let letter = (b'A' + p as u8) as char;
        let before = self.gpio[p].clone();
        let g = &mut self.gpio[p];
        match off {
            MODER_OFFSET => g.moder = v,
            OTYPER_OFFSET => g.otyper = v & PINS_MASK,
            OSPEEDR_OFFSET => g.ospeedr = v,
            PUPDR_OFFSET => g.pupdr = v,
            IDR_OFFSET => self.report_violation(format!("GPIO{letter}_IDR written")),
            ODR_OFFSET => g.odr = v & PINS_MASK,
            BSRR_OFFSET => g.odr = (g.odr & !(v >> BSRR_BR_SHIFT) | v) & PINS_MASK,
            LCKR_OFFSET => g.lckr = v,
            AFRL_OFFSET => g.afr[0] = v,
            AFRH_OFFSET => g.afr[1] = v,
            _ => self.report_violation(format!("GPIO{letter}: write at {off:#x}")),
        }
        if p == 0
            && (before.moder ^ self.gpio[0].moder) >> MODER_DEBUG_SHIFT & MODER_DEBUG_MASK != 0
            && self.gpio[0].moder >> MODER_DEBUG_SHIFT & MODER_DEBUG_MASK != MODER_DEBUG_ALTERNATE
        {
            self.record_finding(Severity::Remark, "PA13 or PA14 taken from the debug port".into());
        }
        self.update_chip_selects(p, &before);
    }
}
