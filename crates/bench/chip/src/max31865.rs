//! The converter of one platinum thermometer on its SPI: registers, times and limits of the MAX31865
//! (data sheet 19-6478, rev 3).

mod registers;

use crate::simulation_time::{NEVER, ms_to_ticks};
use registers::*;

/// A converter for one platinum thermometer.
#[derive(Clone, Debug, Default)]
pub struct RtdConverter {
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
    /// Conversions so far.
    pub conversions: u64,
    /// Results read so far.
    pub reads: u64,
    /// Results that were read again before a new conversion had ended.
    pub stale: u64,
}

impl RtdConverter {
    /// Returns a converter after power-on; `None`: its wire is broken.
    pub fn new(celsius: Option<f64>) -> RtdConverter {
        RtdConverter {
            celsius,
            limits: THRESHOLD_RESETS,
            ready_at: NEVER,
            ..RtdConverter::default()
        }
    }
    fn update_conversions(&mut self, now: u64) {
        while self.ready_at <= now {
            let code = match self.celsius {
                Some(t) => ((100.0 * (1.0 + 3.9083e-3 * t - 5.775e-7 * t * t)) / 430.0 * 32768.0)
                    .round() as u16,
                None => MAX_RATIO,
            };
            self.data = code << 1;
            if code >= u16::from_be_bytes([self.limits[0], self.limits[1]]) >> 1 {
                self.fault |= FAULT_HIGH_THRESHOLD;
            }
            if code <= u16::from_be_bytes([self.limits[2], self.limits[3]]) >> 1 {
                self.fault |= FAULT_LOW_THRESHOLD;
            }
            self.data |= u16::from(self.fault != 0);
            self.fresh = true;
            self.conversions += 1;
            let period = if self.config & CONFIG_NOTCH_50_HZ != 0 {
                ms_to_ticks(20)
            } else {
                ms_to_ticks(1) * 167 / 10
            };
            self.ready_at =
                if self.config & CONFIG_AUTO != 0 { self.ready_at + period } else { NEVER };
        }
    }
    pub(crate) fn transfer_byte(&mut self, now: u64, out: u8, say: &mut Vec<String>) -> u8 {
        self.update_conversions(now);
        let Some(a) = self.address else {
            self.address = Some(out & ADDRESS_MASK);
            self.write = out & ADDRESS_WRITE != 0;
            if out & ADDRESS_MASK > FAULT_STATUS {
                say.push(format!("MAX31865: register {:#x} does not exist", out & ADDRESS_MASK));
            }
            return MISO_IDLE;
        };
        self.address = Some((a + 1) & ADDRESS_MASK);
        if self.write {
            match a {
                CONFIGURATION => {
                    let old = self.config;
                    if out & !old & CONFIG_VBIAS != 0 {
                        self.bias_at = now;
                    }
                    if old & CONFIG_AUTO != 0
                        && out & CONFIG_AUTO != 0
                        && (old ^ out) & CONFIG_NOTCH_50_HZ != 0
                    {
                        say.push("MAX31865: notch frequency changed in automatic mode".into());
                    }
                    if out & CONFIG_FAULT_CLEAR != 0 {
                        self.fault = 0;
                    }
                    let first = if out & CONFIG_NOTCH_50_HZ != 0 {
                        ms_to_ticks(63)
                    } else {
                        ms_to_ticks(52)
                    };
                    if (out & CONFIG_AUTO != 0 && old & CONFIG_AUTO == 0)
                        || out & CONFIG_ONE_SHOT != 0
                    {
                        if out & CONFIG_VBIAS == 0 {
                            say.push("MAX31865: converts without VBIAS".into());
                        } else if out & CONFIG_ONE_SHOT != 0 && now < self.bias_at + ms_to_ticks(10)
                        {
                            say.push("MAX31865: one-shot within 10 ms of VBIAS".into());
                        }
                        self.ready_at = now + first;
                    }
                    if out & (CONFIG_AUTO | CONFIG_ONE_SHOT) == 0 {
                        self.ready_at = NEVER;
                    }
                    self.config = out & CONFIG_STORED_MASK;
                }
                HIGH_THRESHOLD_MSB..=LOW_THRESHOLD_LSB => {
                    self.limits[a as usize - HIGH_THRESHOLD_MSB as usize] = out
                }
                _ => say.push(format!("MAX31865: read-only register {a} written")),
            }
            return MISO_IDLE;
        }
        match a {
            CONFIGURATION => self.config,
            RTD_MSB => {
                self.reads += 1;
                self.stale += u64::from(!self.fresh);
                self.fresh = false;
                (self.data >> 8) as u8
            }
            RTD_LSB => self.data as u8,
            HIGH_THRESHOLD_MSB..=LOW_THRESHOLD_LSB => {
                self.limits[a as usize - HIGH_THRESHOLD_MSB as usize]
            }
            FAULT_STATUS => self.fault,
            _ => 0,
        }
    }
}
