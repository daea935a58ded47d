//! The CRC calculation unit (RM0090 section 4): CRC-32 by 0x04C1_1DB7, highest bit first, a word at a time.

use super::Chip;
use crate::report::Grade;

const POLYNOMIAL: u32 = 0x04c1_1db7;

#[derive(Debug)]
pub struct Crc {
    pub(crate) dr: u32,
    pub(crate) idr: u32,
}

impl Default for Crc {
    fn default() -> Crc {
        // 4.4.1: reset value.
        Crc { dr: u32::MAX, idr: 0 }
    }
}

impl Chip {
    pub(crate) fn crc_read(&mut self, off: u32) -> u32 {
        match off {
            0 if self.faults.crc_dead => 0,
            0 => self.crc.dr,
            4 => self.crc.idr,
            8 => 0,
            _ => {
                self.say(Grade::Unmodelled, format!("CRC: read at {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn crc_write(&mut self, off: u32, v: u32) {
        match off {
            0 => {
                self.crc.dr = (0..32).fold(self.crc.dr ^ v, |sum, _| {
                    sum << 1 ^ if sum >> 31 != 0 { POLYNOMIAL } else { 0 }
                });
            }
            // 4.4.2: the byte register, which a reset of the unit leaves.
            4 => self.crc.idr = v & 0xff,
            8 => {
                if v & !1 != 0 {
                    self.violation(format!("CRC_CR: reserved bits set ({v:#x})"));
                }
                if v & 1 != 0 {
                    self.crc.dr = u32::MAX;
                }
            }
            _ => self.violation(format!("CRC: write at {off:#x}")),
        }
    }
}
