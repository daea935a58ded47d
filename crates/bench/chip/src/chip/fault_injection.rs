//! Faults from outside that no program asks for: a bit that flips, a converter or a stream that fails, a line that is
//! disturbed, a bus whose wire is stuck, a battery that is flat, a calendar that was set. Their effects on the chip are
//! the manual's.

use super::{
    Chip,
    adc::registers::SR_OVR,
    uart::registers::{SR_FE, SR_NF, SR_PE},
};
use crate::{memory_map::*, report::Severity};

/// A disturbance of bytes on the serial line.
#[derive(Clone, Copy, Default)]
pub struct SerialDisturbance {
    /// Bytes that are still to be disturbed.
    pub count: u32,
    /// Flags that the receiver raises with them (RM0090 30.6.1): `SR_PE`, `SR_FE`, `SR_NF`.
    pub flags: u32,
    /// The byte that it sees; `None`: the one that was sent.
    pub byte: Option<u8>,
}

impl Chip {
    /// Does what a line of a script says. Returns `false` if it is no upset.
    pub(crate) fn inject_fault(&mut self, words: &[String]) -> bool {
        let hex = |i: usize| {
            let word = words.get(i).map(|word| word.trim_start_matches("0x"));
            word.and_then(|word| u32::from_str_radix(word, 16).ok())
                .unwrap_or_else(|| panic!("script: {words:?}"))
        };
        match words[0].as_str() {
            // Bits of a word of the SRAMs, of the flash or of a register flip.
            "poke" => {
                let (address, bits) = (hex(1), hex(2));
                if (SRAM_BASE..SRAM_END).contains(&address) {
                    let at = u64::from(address - SRAM_BASE);
                    let mut word = [0; 4];
                    self.sram.read_at(at, &mut word).expect("in the SRAM");
                    let flipped = u32::from_le_bytes(word) ^ bits;
                    self.sram.write_at(at, &flipped.to_le_bytes()).expect("in the SRAM");
                } else if (FLASH_BASE..FLASH_END).contains(&address) {
                    let at = u64::from(address - FLASH_BASE);
                    let mut word = [0; 4];
                    self.rom.read_at(at, &mut word).expect("in the flash");
                    let flipped = u32::from_le_bytes(word) ^ bits;
                    self.rom.write_at(at, &flipped.to_le_bytes()).expect("in the flash");
                } else if (BACKUP_SRAM_BASE..BACKUP_SRAM_END).contains(&address) {
                    self.flip_backup_sram_bits(address & BACKUP_SRAM_OFFSET_MASK, bits);
                } else {
                    let flipped = self.read_register(address) ^ bits;
                    self.write_register(address, flipped);
                }
                self.record_finding(
                    Severity::Fact,
                    format!("upset: {bits:#x} flips at {address:#010x}"),
                );
            }
            // 13.8.1: OVR ends the requests to the DMA.
            "adc_overrun" => {
                self.adc.unit[0].sr |= SR_OVR;
                self.adc.unit[0].dma_over = true;
                self.record_finding(Severity::Fact, "upset: ADC1 is overrun".into());
            }
            // 10.3.18: a transfer error switches the stream off and raises TEIF.
            "dma_error" => self.raise_dma_transfer_error(1, hex(1) as usize),
            // 30.3.3 and 30.6.1: a break is a frame of zeros with a framing error.
            "serial_error" | "modbus_error" => {
                let (flags, byte) = match words[1].as_str() {
                    "break" => (SR_FE, Some(0)),
                    "framing" => (SR_FE, None),
                    "parity" => (SR_PE, None),
                    _ => (SR_NF, None),
                };
                let unit = usize::from(words[0] == "modbus_error");
                self.uart[unit].disturbed = SerialDisturbance { count: hex(2), flags, byte };
            }
            "calendar" => self.overwrite_rtc_calendar(hex(1), hex(2)),
            "battery" => self.world.battery = hex(1) != 0,
            "miso" => self.spi.stuck = Some(if hex(1) != 0 { 0xff } else { 0 }),
            _ => return false,
        }
        self.mark_dirty();
        true
    }
}
