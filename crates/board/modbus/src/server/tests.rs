//! Requests by hand, as the standard writes them, and any bytes at all.

use super::*;
use crate::{
    holding_block::{CncData, registers_to_write},
    input_block::InputBlock,
};
use proptest::prelude::*;
use std::{vec, vec::Vec as List};
use trueup_core::cnc::MachineConditions;

/// Registers that count what was taken.
pub(crate) struct Mock {
    pub(crate) input: input_block::InputRegisters,
    pub(crate) taken: List<holding_block::HoldingRegisters>,
    pub(crate) is_busy: bool,
}

impl Mock {
    pub(crate) fn new() -> Self {
        Self { input: InputBlock::default().encode(), taken: vec![], is_busy: false }
    }
}

impl RegisterStore for Mock {
    fn input_registers(&mut self) -> input_block::InputRegisters {
        self.input
    }

    fn holding_registers(&mut self) -> holding_block::HoldingRegisters {
        self.taken.last().copied().unwrap_or([0; WHOLE_HOLDING_LEN])
    }

    fn write_holding_registers(
        &mut self,
        block: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy> {
        if self.is_busy {
            return Err(RegistersBusy);
        }
        self.taken.push(*block);
        Ok(())
    }
}

fn tcp(unit: u8, pdu: &[u8]) -> List<u8> {
    let length = u16::try_from(pdu.len() + 1).unwrap().to_be_bytes();
    [&[0xAB, 0xCD, 0, 0][..], &length, &[unit], pdu].concat()
}

pub(crate) fn rtu(unit: u8, pdu: &[u8]) -> List<u8> {
    let body = [&[unit], pdu].concat();
    [&body[..], &checksum(&body)].concat()
}

pub(crate) fn write(block: &[u16]) -> List<u8> {
    let count = u16::try_from(block.len()).unwrap();
    let mut pdu = vec![16, 0, 0];
    pdu.extend(count.to_be_bytes());
    pdu.push(u8::try_from(2 * block.len()).unwrap());
    pdu.extend(block.iter().flat_map(|word| word.to_be_bytes()));
    pdu
}

/// Returns what is answered to a PDU over TCP and over RTU, without header and checksum; `None`: nothing.
fn query(bridge: &mut Mock, unit: u8, pdu: &[u8]) -> [Option<List<u8>>; 2] {
    let mut response = ResponseBuffer::new();
    let over_tcp =
        handle_request(Transport::Tcp, 1, &tcp(unit, pdu), bridge, &mut response).then(|| {
            assert_eq!(response[..4], [0xAB, 0xCD, 0, 0]);
            let length = usize::from(u16::from_be_bytes([response[4], response[5]]));
            assert_eq!(length, response.len() - 6);
            assert_eq!(response[6], unit);
            response[7..].to_vec()
        });
    let over_rtu =
        handle_request(Transport::Rtu, 1, &rtu(unit, pdu), bridge, &mut response).then(|| {
            assert_eq!(rtu(response[0], &response[1..response.len() - 2]), response[..]);
            response[1..response.len() - 2].to_vec()
        });
    [over_tcp, over_rtu]
}

#[test]
fn the_whole_input_block_is_read_in_one_request() {
    let mut bridge = Mock::new();
    let mut expected = vec![4, 56];
    expected.extend(bridge.input.iter().flat_map(|word| word.to_be_bytes()));
    let answers = query(&mut bridge, 1, &[4, 0, 0, 0, 28]);
    assert_eq!(answers, [Some(expected.clone()), Some(expected)]);
    let quality = Some(vec![4, 2, 0, 0]);
    assert_eq!(query(&mut bridge, 1, &[4, 0, 8, 0, 1]), [quality.clone(), quality]);
}

#[test]
fn the_whole_holding_block_is_written_and_read_back() {
    let mut bridge = Mock::new();
    let conditions = Some(MachineConditions { tool: 9, bits: 0x8001 });
    for (cnc_data, registers) in
        [(CncData::default(), 17), (CncData { conditions, ..CncData::default() }, 20)]
    {
        let block = cnc_data.encode(5);
        let echo = Some(vec![16, 0, 0, 0, registers]);
        assert_eq!(query(&mut bridge, 1, &write(registers_to_write(&block))), [echo.clone(), echo]);
        assert_eq!(bridge.taken.split_off(0), [block, block]);
        bridge.taken.push(block);
        for count in [17, 20] {
            let [Some(read), _] = query(&mut bridge, 1, &[3, 0, 0, 0, count]) else { panic!() };
            let (words, _) = read[2..].as_chunks::<2>();
            let words: List<u16> = words.iter().map(|word| u16::from_be_bytes(*word)).collect();
            assert_eq!(words, block[..usize::from(count)]);
        }
        bridge.taken.clear();
    }
}

#[test]
fn each_fault_gets_the_exception_that_the_standard_names_and_moves_nothing() {
    let mut bridge = Mock::new();
    let part = write(&[0; 16]);
    let more = write(&[0; 18]);
    let most = write(&[0; 21]);
    let mut elsewhere = write(&[0; 17]);
    elsewhere[2] = 1;
    let mut wrong_bytes = write(&[0; 17]);
    wrong_bytes[5] = 33;
    let mut cut = write(&[0; 17]);
    cut.pop();
    let long = [write(&[0; 17]), vec![0]].concat();
    let none = write(&[]);
    for (pdu, exception) in [
        // 01: coils, discrete inputs, one register, diagnostics, mask write, file records, no such.
        (&[1, 0, 0, 0, 1][..], 1),
        (&[2, 0, 0, 0, 1], 1),
        (&[5, 0, 0, 0xFF, 0], 1),
        (&[6, 0, 0, 0, 1], 1),
        (&[8, 0, 0, 0, 0], 1),
        (&[15, 0, 0, 0, 1, 1, 1], 1),
        (&[22, 0, 0, 0, 0, 0, 0], 1),
        (&[23, 0, 0, 0, 1, 0, 0, 0, 1, 2, 0, 0], 1),
        (&[0], 1),
        (&[0x7F], 1),
        (&[0x83, 0], 1),
        (&[0xFF], 1),
        // 02: behind the block, over its end, a part of it.
        (&[4, 0, 28, 0, 1], 2),
        (&[4, 0, 27, 0, 2], 2),
        (&[4, 0xFF, 0xFF, 0, 125], 2),
        (&[3, 0, 20, 0, 1], 2),
        (&[3, 0, 0, 0, 21], 2),
        (&part, 2),
        (&more, 2),
        (&most, 2),
        (&elsewhere, 2),
        // 03: lengths.
        (&[4, 0, 0, 0, 0], 3),
        (&[4, 0, 0, 0, 126], 3),
        (&[4, 0, 0, 0xFF, 0xFF], 3),
        (&[4, 0, 0, 0], 3),
        (&[4, 0, 0, 0, 1, 0], 3),
        (&[3], 3),
        (&[16, 0, 0], 3),
        (&wrong_bytes, 3),
        (&cut, 3),
        (&long, 3),
        (&none, 3),
    ] {
        let response = Some(vec![pdu[0] | 0x80, exception]);
        assert_eq!(query(&mut bridge, 1, pdu), [response.clone(), response], "{pdu:?}");
    }
    assert_eq!(bridge.taken, [[0; WHOLE_HOLDING_LEN]; 0]);
    bridge.is_busy = true;
    let response = Some(vec![0x90, 6]);
    assert_eq!(query(&mut bridge, 1, &write(&[0; 17])), [response.clone(), response]);
}

#[test]
fn unit_0_moves_nothing_and_reads_over_tcp_alone_and_another_unit_is_not_us() {
    let mut bridge = Mock::new();
    let block = write(&CncData::default().encode(0));
    for pdu in [&block[..], &[4, 0, 0, 0, 28], &[99]] {
        let [over_tcp, serial] = query(&mut bridge, 0, pdu);
        assert_eq!(serial, None);
        let over_tcp = over_tcp.expect("a master that sends unit 0 is not left without an answer");
        match pdu[0] {
            4 => assert_eq!(over_tcp[..2], [4, 56]),
            function => assert_eq!(over_tcp, [function | 0x80, 0x0B]),
        }
        let no_target = Some(vec![pdu[0] | 0x80, 0x0B]);
        assert_eq!(query(&mut bridge, 2, pdu), [no_target, None]);
    }
    assert!(bridge.taken.is_empty());
    let [Some(read), None] = query(&mut bridge, 255, &[4, 0, 0, 0, 28]) else { panic!() };
    assert_eq!(read[..2], [4, 56]);
}

#[test]
fn the_order_of_words_is_tried_at_address_100() {
    let mut bridge = Mock::new();
    for function in [3, 4] {
        let response = Some(vec![function, 4, 1, 2, 3, 4]);
        assert_eq!(query(&mut bridge, 1, &[function, 0, 100, 0, 2]), [response.clone(), response]);
        let one = Some(vec![function, 2, 3, 4]);
        assert_eq!(query(&mut bridge, 1, &[function, 0, 101, 0, 1]), [one.clone(), one]);
        let behind = Some(vec![function | 0x80, 2]);
        assert_eq!(query(&mut bridge, 1, &[function, 0, 101, 0, 2]), [behind.clone(), behind]);
    }
}

#[test]
fn a_frame_whose_length_or_checksum_is_wrong_is_not_answered() {
    let mut bridge = Mock::new();
    let mut response = ResponseBuffer::new();
    let block = write(&CncData::default().encode(0));
    let good = [tcp(1, &block), rtu(1, &block)];
    for (transport, good) in [Transport::Tcp, Transport::Rtu].into_iter().zip(good) {
        for length in 0..good.len() {
            assert!(!handle_request(transport, 1, &good[..length], &mut bridge, &mut response));
        }
        let long = [&good[..], &[0x55]].concat();
        assert!(!handle_request(transport, 1, &long, &mut bridge, &mut response));
    }
    let good = rtu(1, &block);
    for bit in 0..8 * good.len() {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        assert!(!handle_request(Transport::Rtu, 1, &bad, &mut bridge, &mut response), "bit {bit}");
    }
    let mut other = tcp(1, &block);
    other[2] = 1;
    assert!(
        !handle_request(Transport::Tcp, 1, &other, &mut bridge, &mut response),
        "another protocol"
    );
    assert!(bridge.taken.is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4_000))]

    /// No bytes panic, and only a whole write of the whole block is ever taken.
    #[test]
    fn any_request_is_answered_or_left_and_nothing_else_moves(
        unit in 0_u8..3,
        function in prop_oneof![Just(3_u8), Just(4), Just(16), any::<u8>()],
        rest in proptest::collection::vec(any::<u8>(), 0..260),
    ) {
        let mut bridge = Mock::new();
        let pdu = [&[function], &rest[..]].concat();
        let answers = query(&mut bridge, unit, &pdu);
        if !bridge.taken.is_empty() {
            prop_assert!(pdu.starts_with(&[16, 0, 0, 0, 17, 34]) && pdu.len() == 40 && unit == 1);
        }
        prop_assert!(unit != 0 || answers[1].is_none());
        let mut response = ResponseBuffer::new();
        for transport in [Transport::Tcp, Transport::Rtu] {
            handle_request(transport, 1, &rest, &mut bridge, &mut response);
        }
    }
}

#[test]
fn a_serial_request_that_is_executed_has_the_bytes_of_the_shortest_one() {
    // The unit before it, the checksum behind it.
    let shortest = MIN_REQUEST_BYTES - 3;
    for function in [READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, WRITE_MULTIPLE_REGISTERS] {
        for fill in 0..=4 {
            for length in 0..shortest {
                let pdu = [vec![function], vec![fill; length]].concat();
                let pdu = &pdu[..length];
                assert!(validate_pdu(pdu).is_err(), "{pdu:?}");
            }
        }
    }
    assert!(validate_pdu(&[READ_INPUT_REGISTERS, 0, 0, 0, 1]).is_ok());
    // No longer read gets room for its answer.
    let read = |count: u16| {
        let [high, low] = count.to_be_bytes();
        validate_pdu(&[READ_INPUT_REGISTERS, 0, 0, high, low])
    };
    assert!(read(MAX_BLOCK_REGISTERS).is_ok());
    let more = read(MAX_BLOCK_REGISTERS + 1);
    assert_eq!(more, Err(ExceptionCode::Address));
}
