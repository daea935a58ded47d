//! SPI2 as a master, and the chip selects of the MAX31865 that hang on it.

pub(super) mod registers;

use super::{
    Chip,
    gpio::{
        Gpio,
        registers::{MODE_OUTPUT, PIN_FIELD_MASK},
    },
};
use crate::{
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND, ticks_to_ns},
};
use registers::*;

/// The byte on MISO while no device drives it.
const MISO_IDLE_BYTE: u8 = 0xff;

/// The registers of SPI2 and the transfer under way.
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
    /// When the transfer under way ends; NEVER: there is none.
    pub end_at: u64,
    pub(crate) sr_read: bool,
    /// Transfers so far.
    pub bytes: u64,
}

impl Spi {
    /// Returns the unit as a reset leaves it.
    pub fn after_reset() -> Spi {
        Spi { sr: SR_RESET, end_at: NEVER, ..Spi::default() }
    }
}

impl Chip {
    pub(crate) fn is_spi_irq_asserted(&self) -> bool {
        let s = &self.spi;
        (s.sr & SR_TXE != 0 && s.cr2 & CR2_TXEIE != 0)
            || (s.sr & SR_RXNE != 0 && s.cr2 & CR2_RXNEIE != 0)
            || (s.sr & SR_ERROR_MASK != 0 && s.cr2 & CR2_ERRIE != 0)
    }

    pub(crate) fn read_spi_register(&mut self, off: u32) -> u32 {
        match off {
            CR1_OFFSET => self.spi.cr1,
            CR2_OFFSET => self.spi.cr2,
            SR_OFFSET => {
                self.spi.sr_read = true;
                self.spi.sr
                    | u32::from(self.spi.shift.is_some() || self.spi.tdr.is_some()) << SR_BSY_SHIFT
            }
            DR_OFFSET => {
                self.spi.sr &= !SR_RXNE;
                if self.spi.sr_read {
                    self.spi.sr &= !SR_OVR;
                }
                self.spi.rdr.into()
            }
            CRCPR_OFFSET => CRCPR_RESET,
            _ => 0,
        }
    }

    pub(crate) fn write_spi_register(&mut self, off: u32, v: u32) {
        match off {
            CR1_OFFSET => {
                let old = self.spi.cr1;
                if old & CR1_SPE != 0 && (old ^ v) & CR1_SETTINGS_MASK & !CR1_SSI != 0 {
                    self.report_violation(format!(
                        "SPI2_CR1: {:#x} changed while it is on",
                        (old ^ v) & CR1_SETTINGS_MASK
                    ));
                }
                if old & CR1_SPE != 0 && v & CR1_SPE == 0 && self.spi.shift.is_some() {
                    self.report_violation("SPI2: switched off in the middle of a byte".into());
                }
                self.spi.cr1 = v & CR1_MASK;
                if v & CR1_MSTR != 0 && v & CR1_SSM != 0 && v & CR1_SSI == 0 {
                    self.report_violation("SPI2: master with SSM and SSI 0: mode fault".into());
                    self.spi.cr1 &= !(CR1_SPE | CR1_MSTR);
                    self.spi.sr |= SR_MODF;
                }
                if v & CR1_MSTR != 0
                    && v & CR1_SSM == 0
                    && self.spi.cr2 & CR2_SSOE == 0
                    && v & CR1_SPE != 0
                {
                    self.record_finding(
                        Severity::Remark,
                        "SPI2: master with hardware NSS as an input".into(),
                    );
                }
                if v & !old & CR1_SPE != 0 {
                    let hz =
                        TICKS_PER_SECOND / (self.pclk1 << ((v >> CR1_BR_SHIFT & CR1_BR_MASK) + 1));
                    self.record_finding(
                        Severity::Fact,
                        format!(
                            "SPI2: SCLK {hz} Hz, mode {}, {} bits",
                            (v >> CR1_CPOL_SHIFT & 1) * 2 + (v & CR1_CPHA),
                            if v & CR1_DFF != 0 { 16 } else { 8 }
                        ),
                    );
                    if hz > 5_000_000 {
                        self.report_violation(format!("SPI2: {hz} Hz, a MAX31865 takes 5 MHz"));
                    }
                    if v & CR1_CPHA == 0 {
                        self.report_violation(
                            "SPI2: CPHA 0, a MAX31865 takes modes 1 and 3".into(),
                        );
                    }
                }
                self.load_spi_shift_register();
            }
            CR2_OFFSET => {
                self.spi.cr2 = self.apply_write_mask("SPI2_CR2", self.spi.cr2, v, CR2_WRITE_MASK)
            }
            SR_OFFSET => self.spi.sr &= v | !SR_CRCERR,
            DR_OFFSET => {
                if self.spi.cr1 & (CR1_SPE | CR1_MSTR) != CR1_SPE | CR1_MSTR {
                    self.report_violation("SPI2: written while it is off or no master".into());
                }
                if self.spi.sr & SR_TXE == 0 {
                    self.report_violation("SPI2: written while TXE is 0: a byte is lost".into());
                }
                self.spi.sr &= !SR_TXE;
                self.spi.tdr = Some(v as u16);
                self.load_spi_shift_register();
            }
            _ => {}
        }
    }

    pub(crate) fn load_spi_shift_register(&mut self) {
        if self.spi.shift.is_some() || self.spi.cr1 & (CR1_SPE | CR1_MSTR) != CR1_SPE | CR1_MSTR {
            return;
        }
        let Some(v) = self.spi.tdr.take() else { return };
        for (pins, what) in [
            (&[(1, 10), (1, 13)], "SCK"),
            (&[(1, 15), (2, 3)], "MOSI"),
            (&[(1, 14), (2, 2)], "MISO"),
        ] {
            if self.find_pin_with_alternate_function(pins, 5).is_none() {
                self.report_violation(format!("SPI2: no {what} pin on AF5"));
            }
        }
        let now = self.now;
        let mut chosen = Vec::new();
        for n in 0..8u32 {
            if self.pin_mode(2, n) == MODE_OUTPUT && self.gpio[2].odr >> n & 1 == 0 {
                chosen.push(n as usize);
            }
        }
        if chosen.len() != 1 {
            self.report_violation(format!(
                "SPI2: a byte goes out with {} chips selected",
                chosen.len()
            ));
        }
        for n in chosen {
            // tCC: 400 ns from the select to the first edge.
            let since = now - self.world.rtds[n].selected_at;
            if ticks_to_ns(since) < 400 {
                self.report_violation(format!(
                    "MAX31865: first clock {} ns after its select, tCC is 400 ns",
                    ticks_to_ns(since)
                ));
            }
        }
        self.spi.shift = Some(v);
        self.spi.sr |= SR_TXE;
        let bits = if self.spi.cr1 & CR1_DFF != 0 { 16 } else { 8 };
        self.spi.end_at =
            now + bits * (self.pclk1 << ((self.spi.cr1 >> CR1_BR_SHIFT & CR1_BR_MASK) + 1));
    }

    pub(crate) fn finish_spi_transfer(&mut self) {
        self.spi.end_at = NEVER;
        let Some(v) = self.spi.shift.take() else { return };
        self.spi.bytes += 1;
        let mut say = Vec::new();
        let mut answer = MISO_IDLE_BYTE;
        for n in 0..8usize {
            if self.pin_mode(2, n as u32) == MODE_OUTPUT && self.gpio[2].odr >> n & 1 == 0 {
                let chip = &mut self.world.rtds[n];
                if self.world.populated >> n & 1 != 0 {
                    answer = chip.transfer_byte(self.now, v as u8, &mut say);
                }
                chip.last_edge = self.now;
            }
        }
        for s in say {
            self.report_violation(s);
        }
        if self.spi.sr & SR_RXNE != 0 {
            self.spi.sr |= SR_OVR;
            self.record_finding(Severity::Remark, "SPI2: overrun".into());
        } else {
            self.spi.rdr = u16::from(self.spi.stuck.unwrap_or(answer));
        }
        self.spi.sr |= SR_RXNE;
        if self.spi.cr2 & CR2_RXDMAEN != 0 {
            self.serve_dma_request(0, 3, 0);
        }
        self.load_spi_shift_register();
        if self.spi.cr2 & CR2_TXDMAEN != 0 && self.spi.sr & SR_TXE != 0 {
            self.serve_dma_request(0, 4, 0);
        }
    }

    /// Watches the chip selects.
    pub(crate) fn update_chip_selects(&mut self, port: usize, before: &Gpio) {
        if port != 2 {
            return;
        }
        let low = |g: &Gpio, n: u32| {
            g.moder >> (2 * n) & PIN_FIELD_MASK == MODE_OUTPUT && g.odr >> n & 1 == 0
        };
        let now = self.now;
        for n in 0..8u32 {
            let (was, is) = (low(before, n), low(&self.gpio[2], n));
            let chip = &mut self.world.rtds[n as usize];
            if is && !was {
                let since = now - chip.released_at;
                chip.selected_at = now;
                chip.address = None;
                if chip.released_at > 0 && ticks_to_ns(since) < 400 {
                    self.report_violation(format!(
                        "MAX31865: select high for {} ns, tCWH is 400 ns",
                        ticks_to_ns(since)
                    ));
                }
            } else if was && !is {
                let since = now - chip.last_edge;
                chip.released_at = now;
                if self.spi.shift.is_some() {
                    self.report_violation(
                        "MAX31865: select released in the middle of a byte".into(),
                    );
                } else if chip.last_edge > 0 && ticks_to_ns(since) < 100 {
                    self.report_violation(format!(
                        "MAX31865: select released {} ns after the last clock, tCCH is 100 ns",
                        ticks_to_ns(since)
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
