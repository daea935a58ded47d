//! A PLC on the RS-485 line of the board: its requests, as a script of the model of the chip says them.

use std::fmt::Write as _;

use trueup_core::cnc::Control;
use trueup_modbus::{cnc::Cnc, server::checksum, table::INPUT_LEN};

/// The unit of a board whose switches are open.
const UNIT: u8 = 1;

fn request(pdu: &[u8]) -> String {
    let body = [&[UNIT], pdu].concat();
    let mut hex = String::new();
    for byte in body.iter().chain(&checksum(&body)) {
        write!(hex, "{byte:02x}").expect("a string takes all");
    }
    hex
}

/// Reads the whole input block.
#[must_use]
pub fn read() -> String {
    request(&[4, 0, 0, 0, INPUT_LEN as u8])
}

/// Writes a holding block with this `Control` and nothing else.
#[must_use]
pub fn write(control: Control, counter: u16) -> String {
    let block = Cnc { control, ..Cnc::default() }.encode(counter);
    let words = block.iter().flat_map(|word| word.to_be_bytes());
    let head = [16, 0, 0, 0, block.len() as u8, 2 * block.len() as u8];
    request(&head.into_iter().chain(words).collect::<Vec<u8>>())
}
