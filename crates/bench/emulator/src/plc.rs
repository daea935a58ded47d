//! A PLC on the RS-485 line of the board: its requests, whole or damaged, as a script of the model of the chip says
//! them.

use std::fmt::Write as _;

use trueup_core::cnc::Control;
use trueup_modbus::{
    cnc::{Cnc, written},
    server::checksum,
    table::INPUT_LEN,
};

/// The unit of a board whose switches are open.
pub const UNIT: u8 = 1;

/// Returns a request or an answer as it is on the line: the unit, what it is asked or answers, the checksum.
#[must_use]
pub fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
    let body = [&[unit], pdu].concat();
    [&body[..], &checksum(&body)].concat()
}

/// Bytes as a script has them, and as the model says what it received.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    let mut hex = String::new();
    for byte in bytes {
        write!(hex, "{byte:02x}").expect("a string takes all");
    }
    hex
}

/// Returns what asks for the whole input block.
#[must_use]
pub fn read_pdu() -> Vec<u8> {
    vec![4, 0, 0, 0, INPUT_LEN as u8]
}

/// Returns what writes a holding block with this `Control` and nothing else.
#[must_use]
pub fn write_pdu(control: Control, counter: u16) -> Vec<u8> {
    let block = Cnc { control, ..Cnc::default() }.encode(counter);
    let block = written(&block);
    let words = block.iter().flat_map(|word| word.to_be_bytes());
    let head = [16, 0, 0, 0, block.len() as u8, 2 * block.len() as u8];
    head.into_iter().chain(words).collect()
}

/// Reads the whole input block.
#[must_use]
pub fn read() -> String {
    hex(&frame(UNIT, &read_pdu()))
}

/// Writes a holding block with this `Control` and nothing else.
#[must_use]
pub fn write(control: Control, counter: u16) -> String {
    hex(&frame(UNIT, &write_pdu(control, counter)))
}
