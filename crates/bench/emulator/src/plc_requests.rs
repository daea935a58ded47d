//! A PLC on the RS-485 line of the board: its requests, whole or damaged, as a script of the model of the chip says
//! them.

use std::fmt::Write as _;

use trueup_core::cnc::Control;
use trueup_modbus::{
    holding_block::{CncData, registers_to_write},
    register_map::INPUT_LEN,
    server::checksum,
};

/// The unit of a board whose switches are open.
pub const MODBUS_UNIT_ID: u8 = 1;

/// Returns the bytes of a request or an answer on the line: the unit, the request or answer, the checksum.
#[must_use]
pub fn encode_rtu_frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
    let body = [&[unit], pdu].concat();
    [&body[..], &checksum(&body)].concat()
}

/// Bytes as a script has them, and as the model says what it received.
#[must_use]
pub fn encode_hex(bytes: &[u8]) -> String {
    let mut hex = String::new();
    for byte in bytes {
        write!(hex, "{byte:02x}").expect("a string takes all");
    }
    hex
}

/// Returns what asks for the whole input block.
#[must_use]
pub fn build_read_request_pdu() -> Vec<u8> {
    vec![4, 0, 0, 0, INPUT_LEN as u8]
}

/// Returns what writes a holding block with this `Control` and nothing else.
#[must_use]
pub fn build_write_request_pdu(control: Control, counter: u16) -> Vec<u8> {
    let block = CncData { control, ..CncData::default() }.encode(counter);
    let block = registers_to_write(&block);
    let words = block.iter().flat_map(|word| word.to_be_bytes());
    let head = [16, 0, 0, 0, block.len() as u8, 2 * block.len() as u8];
    head.into_iter().chain(words).collect()
}

/// Reads the whole input block.
#[must_use]
pub fn build_read_request_hex() -> String {
    encode_hex(&encode_rtu_frame(MODBUS_UNIT_ID, &build_read_request_pdu()))
}

/// Writes a holding block with this `Control` and nothing else.
#[must_use]
pub fn build_write_request_hex(control: Control, counter: u16) -> String {
    encode_hex(&encode_rtu_frame(MODBUS_UNIT_ID, &build_write_request_pdu(control, counter)))
}
