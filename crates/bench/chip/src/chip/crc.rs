//! The CRC calculation unit (RM0090 section 4): CRC-32 by 0x04C1_1DB7, highest bit first, a word at a time.

mod registers;

use super::Chip;
use crate::report::Severity;
use registers::*;

/// The registers of the CRC unit.
#[derive(Debug)]
pub struct Crc {
    pub(crate) dr: u32,
    pub(crate) idr: u32,
}

impl Default for Crc {
    fn default() -> Crc {
        // 4.4.1: reset value.
        Crc { dr: DR_RESET, idr: 0 }
    }
}

impl Chip {
    pub(crate) fn read_crc_register(&mut self, off: u32) -> u32 {
        match off {
            DR_OFFSET if self.faults.crc_dead => 0,
            DR_OFFSET => self.crc.dr,
            IDR_OFFSET => self.crc.idr,
            CR_OFFSET => 0,
            _ => {
                self.record_finding(Severity::Unmodelled, format!("CRC: read at {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn write_crc_register(&mut self, off: u32, v: u32) {
        match off {
            DR_OFFSET => {
                self.crc.dr = (0..32).fold(self.crc.dr ^ v, |sum, _| {
                    sum << 1 ^ if sum >> 31 != 0 { POLYNOMIAL } else { 0 }
                });
            }
            // 4.4.2: the byte register, which a reset of the unit leaves.
            IDR_OFFSET => self.crc.idr = v & IDR_MASK,
            CR_OFFSET => {
                if v & !CR_COMPUTATION_RESET != 0 {
                    self.report_violation(format!("CRC_CR: reserved bits set ({v:#x})"));
                }
                if v & CR_COMPUTATION_RESET != 0 {
                    self.crc.dr = DR_RESET;
                }
            }
            _ => self.report_violation(format!("CRC: write at {off:#x}")),
        }
    }
}
