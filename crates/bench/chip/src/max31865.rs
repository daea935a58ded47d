//! The converter of one platinum thermometer on its SPI: registers, times and limits of the MAX31865
//! (data sheet 19-6478, rev 3).

use crate::time::{NEVER, ms};

/// A converter for one platinum thermometer.
#[derive(Clone, Debug, Default)]
pub struct Rtd {
    /// The measured temperature; `None`: the wire is broken.
    pub celsius: Option<f64>,
    pub(crate) config: u8,
    pub(crate) data: u16,
    pub(crate) limits: [u8; 4],
    pub(crate) fault: u8,
    /// The first byte of a transfer is its address.
    pub(crate) address: Option<u8>,
    pub(crate) write: bool,
    pub(crate) selected_at: u64,
    pub(crate) released_at: u64,
    pub(crate) last_edge: u64,
    pub(crate) ready_at: u64,
    pub(crate) fresh: bool,
    pub(crate) bias_at: u64,
    pub conversions: u64,
    pub reads: u64,
    pub stale: u64,
}

impl Rtd {
    pub fn new(celsius: Option<f64>) -> Rtd {
        Rtd { celsius, limits: [0xff, 0xff, 0, 0], ready_at: NEVER, ..Rtd::default() }
    }
    fn convert(&mut self, now: u64) {
        while self.ready_at <= now {
            let code = match self.celsius {
                Some(t) => ((100.0 * (1.0 + 3.9083e-3 * t - 5.775e-7 * t * t)) / 430.0 * 32768.0)
                    .round() as u16,
                None => 0x7fff,
            };
            self.data = code << 1;
            if code >= u16::from_be_bytes([self.limits[0], self.limits[1]]) >> 1 {
                self.fault |= 0x80;
            }
            if code <= u16::from_be_bytes([self.limits[2], self.limits[3]]) >> 1 {
                self.fault |= 0x40;
            }
            self.data |= u16::from(self.fault != 0);
            self.fresh = true;
            self.conversions += 1;
            let period = if self.config & 1 != 0 { ms(20) } else { ms(1) * 167 / 10 };
            self.ready_at = if self.config & 0x40 != 0 { self.ready_at + period } else { NEVER };
        }
    }
    pub(crate) fn byte(&mut self, now: u64, out: u8, say: &mut Vec<String>) -> u8 {
        self.convert(now);
        let Some(a) = self.address else {
            self.address = Some(out & 0x7f);
            self.write = out & 0x80 != 0;
            if out & 0x7f > 7 {
                say.push(format!("MAX31865: register {:#x} does not exist", out & 0x7f));
            }
            return 0xff;
        };
        self.address = Some((a + 1) & 0x7f);
        if self.write {
            match a {
                0 => {
                    let old = self.config;
                    if out & !old & 0x80 != 0 {
                        self.bias_at = now;
                    }
                    if old & 0x40 != 0 && out & 0x40 != 0 && (old ^ out) & 1 != 0 {
                        say.push("MAX31865: notch frequency changed in automatic mode".into());
                    }
                    if out & 2 != 0 {
                        self.fault = 0;
                    }
                    let first = if out & 1 != 0 { ms(63) } else { ms(52) };
                    if (out & 0x40 != 0 && old & 0x40 == 0) || out & 0x20 != 0 {
                        if out & 0x80 == 0 {
                            say.push("MAX31865: converts without VBIAS".into());
                        } else if out & 0x20 != 0 && now < self.bias_at + ms(10) {
                            say.push("MAX31865: one-shot within 10 ms of VBIAS".into());
                        }
                        self.ready_at = now + first;
                    }
                    if out & 0x60 == 0 {
                        self.ready_at = NEVER;
                    }
                    self.config = out & 0xd1;
                }
                3..=6 => self.limits[a as usize - 3] = out,
                _ => say.push(format!("MAX31865: read-only register {a} written")),
            }
            return 0xff;
        }
        match a {
            0 => self.config,
            1 => {
                self.reads += 1;
                self.stale += u64::from(!self.fresh);
                self.fresh = false;
                (self.data >> 8) as u8
            }
            2 => self.data as u8,
            3..=6 => self.limits[a as usize - 3],
            7 => self.fault,
            _ => 0,
        }
    }
}
