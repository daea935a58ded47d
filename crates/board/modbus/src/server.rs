//! One request of a master, answered: Modbus Application Protocol V1.1b3, over TCP or a serial line.
//!
//! | function | here |
//! |---|---|
//! | 4 read input registers | any part of the input block, out of one snapshot |
//! | 3 read holding registers | any part of the holding block that was last taken |
//! | 16 write multiple registers | the whole holding block, at address 0: 17 registers, or 20 with tool and conditions |
//! | every other | exception 01 |
//!
//! | exception | when |
//! |---|---|
//! | 01 illegal function | no such function here |
//! | 02 illegal data address | an address, or address and length together, outside the block; a write of a part of it |
//! | 03 illegal data value | a length of 0 or beyond the standard's, or one that does not fit the request |
//! | 06 server device busy | another master writes |
//! | 0B gateway target device failed to respond | TCP: a unit that is not there; a command to unit 0 |
//!
//! Unit 0 over TCP reads as the one that listens: some masters send no other number.
//!
//! No answer: a serial broadcast (unit 0; a command that engages one bridge is addressed to one, so nothing
//! moves), a serial frame for another unit or with a wrong checksum, bytes that are no request.
//!
//! The library builds and parses frames. Errors that it would let pass are checked before it sees them: a byte
//! count that is not twice the quantity, a quantity of 0, bytes behind the end, an unknown function in
//! a serial frame that is damaged.

use crc::{CRC_16_MODBUS, Crc, NoTable};
use heapless::Vec;
use rmodbus::{
    ModbusProto,
    server::{ModbusFrame, Read, Write},
};

use crate::{
    holding_block, input_block,
    register_map::{
        HOLDING_LEN, INPUT_LEN, WHOLE_HOLDING_LEN, WORD_ORDER_ADDRESS, WORD_ORDER_PATTERN,
    },
};

/// The largest frame: 253 bytes of a request, the header of TCP before them.
pub const MAX_FRAME_BYTES: usize = 260;
/// Bytes before the unit in a frame of TCP.
pub const MBAP_PREFIX_LEN: usize = 6;
/// A broadcast.
const BROADCAST_UNIT_ID: u8 = 0;
/// Over TCP, the one that listens, whatever its number.
const ANY_UNIT_ID: u8 = 255;
const READ_HOLDING_REGISTERS: u8 = 3;
const READ_INPUT_REGISTERS: u8 = 4;
const WRITE_MULTIPLE_REGISTERS: u8 = 16;
/// The most registers that one request reads, or writes.
const MAX_READ_REGISTERS: u16 = 125;
const MAX_WRITE_REGISTERS: u16 = 123;
/// Registers of the longest block. A longer read is refused before its answer gets room: the bounds of time rest on this (`cargo
/// xtask bounds`).
#[expect(
    clippy::cast_possible_truncation,
    reason = "at most `MAX_READ_REGISTERS`, which is asserted"
)]
const MAX_BLOCK_REGISTERS: u16 = {
    let longest = if INPUT_LEN > WHOLE_HOLDING_LEN { INPUT_LEN } else { WHOLE_HOLDING_LEN };
    assert!(longest >= WORD_ORDER_PATTERN.len() && longest <= MAX_READ_REGISTERS as usize);
    longest as u16
};
/// Bytes of the shortest serial request that is executed: unit, function, address, length, checksum.
pub const MIN_REQUEST_BYTES: usize = 8;

/// Without a table, which would be half a kilobyte of a board's flash.
static MODBUS_CRC: Crc<u16, NoTable> = Crc::<u16, NoTable>::new(&CRC_16_MODBUS);

/// Returns the two bytes behind a serial frame.
#[must_use]
pub fn checksum(bytes: &[u8]) -> [u8; 2] {
    MODBUS_CRC.checksum(bytes).to_le_bytes()
}

/// An answer.
pub type ResponseBuffer = Vec<u8, MAX_FRAME_BYTES>;

/// The transport that a request comes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// TCP: a header with transaction and length before the unit.
    Tcp,
    /// A serial line in RTU mode: a checksum at the end.
    Rtu,
}

/// Another master writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RegistersBusy;

/// The bridge behind the registers.
pub trait RegisterStore {
    /// Returns the current input block, of one moment.
    fn input_registers(&mut self) -> input_block::InputRegisters;
    /// Returns the holding block that was last taken; zeros before.
    fn holding_registers(&mut self) -> holding_block::HoldingRegisters;
    /// Takes a block as it was written. Whether it may be used is for [`holding_block::HoldingBlockChecker`]; one that may
    /// not is acknowledged, refused and counted.
    ///
    /// # Errors
    /// Another master writes.
    fn write_holding_registers(
        &mut self,
        block: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy>;
}

/// The exceptions that are given, by the standard's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ExceptionCode {
    Function = 1,
    Address = 2,
    Value = 3,
    Busy = 6,
    NoTarget = 0x0B,
}

/// Answers one whole frame, addressed to `unit`. Whether there is an answer to send.
// A function of its own in the image: its time is bounded by the silence before each frame (`cargo xtask bounds`).
#[inline(never)]
pub fn handle_request(
    transport: Transport,
    unit: u8,
    request: &[u8],
    bridge: &mut impl RegisterStore,
    response: &mut ResponseBuffer,
) -> bool {
    response.clear();
    let Some((addressed, pdu)) = parse_adu(transport, request) else { return false };
    let &[function, ..] = pdu else { return false };
    if addressed == BROADCAST_UNIT_ID && transport == Transport::Rtu {
        return false;
    }
    let is_read = matches!(function, READ_HOLDING_REGISTERS | READ_INPUT_REGISTERS);
    let is_any_unit = addressed == ANY_UNIT_ID || (addressed == BROADCAST_UNIT_ID && is_read);
    let is_ours = addressed == unit || (transport == Transport::Tcp && is_any_unit);
    let answered = if is_ours {
        validate_pdu(pdu)
            .and_then(|()| execute_request(transport, addressed, request, bridge, response))
    } else if transport == Transport::Rtu {
        return false;
    } else {
        Err(ExceptionCode::NoTarget)
    };
    match answered {
        Ok(()) => true,
        Err(exception) => {
            write_exception(transport, request, addressed, function, exception, response)
        }
    }
}

/// Returns the unit and what it is asked; `None`: no whole frame.
fn parse_adu(transport: Transport, request: &[u8]) -> Option<(u8, &[u8])> {
    match transport {
        Transport::Tcp => {
            let &[_, _, 0, 0, high, low, unit, ref pdu @ ..] = request else { return None };
            let length = usize::from(u16::from_be_bytes([high, low]));
            (request.len().checked_sub(MBAP_PREFIX_LEN) == Some(length)).then_some((unit, pdu))
        }
        Transport::Rtu => {
            let (covered, checksum) = request.split_last_chunk::<2>()?;
            let is_whole = self::checksum(covered) == *checksum;
            let (unit, pdu) = covered.split_first()?;
            is_whole.then_some((*unit, pdu))
        }
    }
}

/// Whether the request has the standard's form.
fn validate_pdu(pdu: &[u8]) -> Result<(), ExceptionCode> {
    match *pdu {
        [READ_HOLDING_REGISTERS | READ_INPUT_REGISTERS, _, _, high, low] => {
            let count = u16::from_be_bytes([high, low]);
            match count {
                1..=MAX_BLOCK_REGISTERS => Ok(()),
                ..=MAX_READ_REGISTERS if count > 0 => Err(ExceptionCode::Address),
                _ => Err(ExceptionCode::Value),
            }
        }
        [WRITE_MULTIPLE_REGISTERS, _, _, high, low, bytes, ref data @ ..] => {
            let count = u16::from_be_bytes([high, low]);
            let is_right = (1..=MAX_WRITE_REGISTERS).contains(&count)
                && u16::from(bytes) == count.saturating_mul(2)
                && data.len() == usize::from(bytes);
            if is_right { Ok(()) } else { Err(ExceptionCode::Value) }
        }
        [READ_HOLDING_REGISTERS | READ_INPUT_REGISTERS | WRITE_MULTIPLE_REGISTERS, ..] => {
            Err(ExceptionCode::Value)
        }
        _ => Err(ExceptionCode::Function),
    }
}

/// Reads or writes, and puts the answer together.
// A function of its own in the image: its time is bounded by the bytes of a request (`cargo xtask bounds`).
#[inline(never)]
fn execute_request(
    transport: Transport,
    unit: u8,
    request: &[u8],
    bridge: &mut impl RegisterStore,
    response: &mut ResponseBuffer,
) -> Result<(), ExceptionCode> {
    let proto = match transport {
        Transport::Tcp => ModbusProto::TcpUdp,
        Transport::Rtu => ModbusProto::Rtu,
    };
    // What it may find wrong has been found before; nothing is read or written then.
    let odd = |_| ExceptionCode::Value;
    let mut frame = ModbusFrame::new(unit, request, proto, response).with_broadcast_units(&[]);
    frame.parse().map_err(odd)?;
    if frame.readonly {
        let holding = frame.func == rmodbus::consts::ModbusFunction::GetHoldings;
        let Read::Words(words) = frame.get_external_read().map_err(odd)? else {
            return Err(ExceptionCode::Function);
        };
        let place = usize::from(words.address)..;
        let place = place.start..place.start.saturating_add(usize::from(words.count));
        let (read, written);
        let block = if let Some(at) = place.start.checked_sub(WORD_ORDER_ADDRESS) {
            WORD_ORDER_PATTERN.get(at..at.saturating_add(usize::from(words.count)))
        } else if holding {
            written = bridge.holding_registers();
            written.get(place)
        } else {
            read = bridge.input_registers();
            read.get(place)
        };
        let block = block.ok_or(ExceptionCode::Address)?;
        for (place, word) in words.buf.chunks_exact_mut(2).zip(block) {
            place.copy_from_slice(&word.to_be_bytes());
        }
        frame.process_external_read(Ok(())).map_err(odd)?;
    } else {
        let Write::Words(words) = frame.get_external_write().map_err(odd)? else {
            return Err(ExceptionCode::Function);
        };
        let is_whole = [HOLDING_LEN, WHOLE_HOLDING_LEN].contains(&words.count.into());
        if words.address != 0 || !is_whole {
            return Err(ExceptionCode::Address);
        }
        let mut block = [0; WHOLE_HOLDING_LEN];
        let (pairs, _) = words.data.as_chunks::<2>();
        for (place, word) in block.iter_mut().zip(pairs) {
            *place = u16::from_be_bytes(*word);
        }
        bridge.write_holding_registers(&block).map_err(|RegistersBusy| ExceptionCode::Busy)?;
        frame.process_external_write(Ok(())).map_err(odd)?;
    }
    frame.finalize_response().map_err(odd)
}

/// An exception in place of an answer. Always to be sent.
fn write_exception(
    transport: Transport,
    request: &[u8],
    unit: u8,
    function: u8,
    exception: ExceptionCode,
    response: &mut ResponseBuffer,
) -> bool {
    response.clear();
    let body = [unit, function | 0x80, exception as u8];
    // Nine bytes at most go into an answer.
    let written = match (transport, request) {
        (Transport::Tcp, &[a, b, ..]) => response
            .extend_from_slice(&[a, b, 0, 0, 0, 3])
            .and_then(|()| response.extend_from_slice(&body)),
        _ => {
            let ending = checksum(&body);
            response.extend_from_slice(&body).and_then(|()| response.extend_from_slice(&ending))
        }
    };
    written.is_ok()
}

#[cfg(test)]
pub(crate) mod tests;
