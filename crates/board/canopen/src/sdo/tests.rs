//! The server before a node of a few values; what the real node has behind it is tested there.

use super::*;
use proptest::prelude::*;
use std::vec::Vec;
use trueup_link::layout::SDO_REQUEST_ID;

/// A node of a few values: a number, a text, a domain whose acceptance takes a while.
#[derive(Default)]
pub(super) struct Fake {
    period: u32,
    pub domain: Vec<u8>,
    written: Vec<u32>,
    /// It has no room for another block.
    pub is_full: bool,
}

const MAX: usize = 600;

impl ObjectAccess for Fake {
    fn read(&self, what: EntryContent) -> Result<ObjectValue<'_>, AbortCode> {
        Ok(match what {
            EntryContent::Fixed(number) => ObjectValue::Number(number),
            EntryContent::Text(text) => ObjectValue::Bytes(text.as_bytes()),
            EntryContent::ProducerHeartbeat => ObjectValue::Number(self.period),
            EntryContent::New => ObjectValue::Bytes(&self.domain),
            _ => return Err(AbortCode::NoData),
        })
    }

    fn write(&mut self, what: EntryContent, number: u32) -> Result<(), AbortCode> {
        self.written.push(number);
        match what {
            EntryContent::ProducerHeartbeat => self.period = number,
            EntryContent::Forget => {}
            _ => return Err(AbortCode::Value),
        }
        Ok(())
    }

    fn open(&mut self, _: EntryContent, size: Option<u32>) -> Result<(), AbortCode> {
        self.domain.clear();
        if size.is_some_and(|size| size as usize > MAX) { Err(AbortCode::TooLong) } else { Ok(()) }
    }

    fn append(&mut self, _: EntryContent, bytes: &[u8]) -> Result<(), AbortCode> {
        self.domain.extend(bytes);
        if self.domain.len() > MAX { Err(AbortCode::TooLong) } else { Ok(()) }
    }

    fn has_room_for_block(&self, _: EntryContent) -> bool {
        !self.is_full
    }

    fn close(&mut self, _: EntryContent) -> Result<(), AbortCode> {
        Ok(())
    }
}

fn transact(server: &mut SdoServer, fake: &mut Fake, data: [u8; 8]) -> Option<[u8; 8]> {
    let answer = server.receive(&Frame::new(SDO_REQUEST_ID, &data).unwrap(), fake)?;
    assert_eq!(answer.id(), SDO_RESPONSE_ID);
    Some(*answer.data())
}

/// Returns the abort of this object.
fn refused(index: u16, subindex: u8, abort: AbortCode) -> Option<[u8; 8]> {
    Some(encode_message(0x80, (index, subindex), abort.code()))
}

fn to(command: u8, index: u16, subindex: u8, number: u32) -> [u8; 8] {
    encode_message(command, (index, subindex), number)
}

/// Reads all of an object, in segments where it has to.
fn read(server: &mut SdoServer, fake: &mut Fake, index: u16, subindex: u8) -> Result<Vec<u8>, u32> {
    let answer = transact(server, fake, to(0x40, index, subindex, 0)).expect("an answer");
    let number = u32::from_le_bytes(answer[4..].try_into().unwrap());
    if answer[0] == 0x80 {
        return Err(number);
    }
    if answer[0] & 2 != 0 {
        return Ok(answer[4..8 - usize::from(answer[0] >> 2 & 3)].to_vec());
    }
    let mut bytes = Vec::new();
    for toggle in [0, 0x10].into_iter().cycle() {
        let answer =
            transact(server, fake, [0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]).expect("an answer");
        assert_eq!(answer[0] & 0xF0, toggle);
        bytes.extend(&answer[1..8 - usize::from(answer[0] >> 1 & 7)]);
        if answer[0] & 1 != 0 {
            break;
        }
    }
    assert_eq!(bytes.len(), number as usize, "as announced");
    Ok(bytes)
}

/// Writes in segments; `None` where the last one is not answered yet.
fn write(
    server: &mut SdoServer,
    fake: &mut Fake,
    (index, subindex): (u16, u8),
    announced: Option<u32>,
    bytes: &[u8],
) -> Option<[u8; 8]> {
    let command = 0x20 | u8::from(announced.is_some());
    let start = to(command, index, subindex, announced.unwrap_or(0));
    let mut answer = transact(server, fake, start);
    let count = bytes.chunks(7).count();
    for (number, part) in bytes.chunks(7).enumerate() {
        if answer.is_none_or(|answer| answer[0] == 0x80) {
            return answer;
        }
        let toggle = if number % 2 == 1 { 0x10 } else { 0 };
        let mut segment = [0; 8];
        let unused = 7 - u8::try_from(part.len()).expect("7 at most");
        segment[0] = toggle | unused << 1 | u8::from(number + 1 == count);
        segment[1..=part.len()].copy_from_slice(part);
        answer = transact(server, fake, segment);
    }
    answer
}

#[test]
fn numbers_go_in_one_frame_with_their_length() {
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    let device = transact(&mut server, &mut fake, to(0x40, 0x1000, 0, 0));
    assert_eq!(device, Some([0x43, 0x00, 0x10, 0, 0x94, 0x01, 0, 0]));
    for command in [0x2B, 0x22] {
        fake.period = 0;
        let taken = transact(&mut server, &mut fake, to(command, 0x1017, 0, 500));
        assert_eq!((taken, fake.period), (Some([0x60, 0x17, 0x10, 0, 0, 0, 0, 0]), 500));
    }
    assert_eq!(read(&mut server, &mut fake, 0x1017, 0), Ok([0xF4, 0x01].into()));
    let segmented = write(&mut server, &mut fake, (0x1017, 0), Some(2), &[7, 0]);
    assert_eq!((segmented, fake.period), (Some(encode_segment_response(false)), 7));
}

#[test]
fn a_text_comes_in_segments() {
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    assert_eq!(read(&mut server, &mut fake, 0x1008, 0), Ok(b"trueup bridge".into()));
}

#[test]
fn every_misuse_gets_its_abort_code() {
    let announced_too_long = to(0x21, 0x2100, 2, 601);
    for (request, abort) in [
        (to(0x40, 0x1FFF, 0, 0), AbortCode::NoObject),
        (to(0x2F, 0x1FFF, 0, 0), AbortCode::NoObject),
        (to(0x40, 0x1018, 9, 0), AbortCode::NoSubindex),
        (to(0x40, 0x2010, 6, 0), AbortCode::WriteOnly),
        (to(0x23, 0x1000, 0, 0), AbortCode::ReadOnly),
        (to(0x23, 0x2000, 1, 0), AbortCode::ReadOnly),
        (to(0x21, 0x2100, 1, 8), AbortCode::ReadOnly),
        (to(0x23, 0x1017, 0, 0), AbortCode::Length),
        (to(0x2F, 0x1017, 0, 0), AbortCode::Length),
        (to(0x21, 0x1017, 0, 3), AbortCode::Length),
        (to(0x23, 0x2100, 2, 0), AbortCode::TooShort),
        (announced_too_long, AbortCode::TooLong),
        (to(0xA0, 0x2100, 1, 0), AbortCode::Command),
        (to(0xA4, 0x2100, 1, 0), AbortCode::Command),
        (to(0xC6, 0x1017, 0, 2), AbortCode::Command),
        (to(0xC6, 0x2100, 1, 8), AbortCode::ReadOnly),
        (to(0xC6, 0x2100, 2, 601), AbortCode::TooLong),
        (to(0x40, 0x1003, 1, 0), AbortCode::NoData),
    ] {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let index = u16::from_le_bytes([request[1], request[2]]);
        let answer = transact(&mut server, &mut fake, request);
        assert_eq!(answer, refused(index, request[3], abort), "{request:02X?}");
        assert_eq!(fake.written, []);
    }
    // A segment of no transfer, and commands that are none.
    for command in [0x00, 0x60, 0x70, 0xC1, 0xE0, 0xFF] {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let answer = transact(&mut server, &mut fake, [command, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(answer, refused(0, 0, AbortCode::Command), "{command:02X}");
    }
}

#[test]
fn a_wrong_toggle_ends_the_transfer() {
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    for (start, index, subindex, wrong) in
        [(0x40, 0x1008, 0, 0x70), (0x21, 0x2100, 2, 0x10), (0x21, 0x1017, 0, 0x1B)]
    {
        let size = if index == 0x1017 { 2 } else { 14 };
        assert_ne!(
            transact(&mut server, &mut fake, to(start, index, subindex, size)).unwrap()[0],
            0x80
        );
        let answer = transact(&mut server, &mut fake, [wrong, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(answer, refused(index, subindex, AbortCode::Toggle));
        let again = transact(&mut server, &mut fake, [wrong, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(again, refused(0, 0, AbortCode::Command), "the transfer has ended");
    }
}

#[test]
fn a_length_that_is_not_the_announced_one_is_refused() {
    for (announced, sent) in [(20, 21), (20, 19), (20, 28), (1, 2)] {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let at = (0x2100, 2);
        let answer = write(&mut server, &mut fake, at, Some(announced), &std::vec![1; sent]);
        assert_eq!(answer, refused(0x2100, 2, AbortCode::Length), "{announced}, {sent}");
    }
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    let answer = write(&mut server, &mut fake, (0x1017, 0), None, &[1; 3]);
    assert_eq!((answer, &fake.written[..]), (refused(0x1017, 0, AbortCode::Length), &[][..]));
    let unannounced = write(&mut server, &mut fake, (0x2100, 2), None, &[1; MAX + 1]);
    assert_eq!(unannounced, refused(0x2100, 2, AbortCode::TooLong));
}

#[test]
fn the_last_segment_of_a_domain_is_answered_once_it_has_been_looked_at() {
    for (outcome, expected) in [
        (Ok(()), Some(encode_segment_response(true))),
        (Err(AbortCode::Value), refused(0x2100, 2, AbortCode::Value)),
        (Err(AbortCode::CannotStore), refused(0x2100, 2, AbortCode::CannotStore)),
    ] {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let at = (0x2100, 2);
        assert_eq!(write(&mut server, &mut fake, at, Some(14), &[9; 14]), None);
        assert_eq!(server.tick(2 * SDO_TIMEOUT_MS), None, "it is not the master who is late");
        let busy = transact(&mut server, &mut Fake::default(), to(0x21, 0x2100, 2, 14)).unwrap();
        assert_eq!(Some(busy), refused(0x2100, 2, AbortCode::DeviceState));
        assert_eq!(server.finish_download(outcome), None, "the master has begun something else");

        assert_eq!(write(&mut server, &mut fake, at, Some(14), &[9; 14]), None);
        assert_eq!(server.finish_download(outcome).map(|frame| *frame.data()), expected);
        assert_eq!(server.finish_download(outcome), None);
    }
}

#[test]
fn a_silent_master_is_reported_and_one_that_aborts_is_not_answered() {
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    assert_eq!(server.tick(u32::MAX), None);
    transact(&mut server, &mut fake, to(0x40, 0x1008, 0, 0));
    assert_eq!(server.tick(SDO_TIMEOUT_MS), None);
    let late = server.tick(1).map(|frame| *frame.data());
    assert_eq!(late, refused(0x1008, 0, AbortCode::Timeout));
    assert_eq!(server.tick(SDO_TIMEOUT_MS), None);

    transact(&mut server, &mut fake, to(0x40, 0x1008, 0, 0));
    assert_eq!(transact(&mut server, &mut fake, to(0x80, 0x1008, 0, 0x0504_0000)), None);
    let after = transact(&mut server, &mut fake, [0x60, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(after, refused(0, 0, AbortCode::Command));
    for short in 0..8 {
        let request = Frame::new(SDO_REQUEST_ID, &[0x40; 8][..short]).unwrap();
        assert_eq!(server.receive(&request, &mut fake), None);
    }
}

fn request() -> impl Strategy<Value = [u8; 8]> {
    let indices: Vec<u16> = dictionary::OBJECTS.iter().map(|object| object.index).collect();
    let meant = (any::<u8>(), prop::sample::select(indices), 0_u8..10, any::<u32>());
    let meant =
        meant.prop_map(|(command, index, subindex, number)| to(command, index, subindex, number));
    let segment = (0_u8..16, prop::bool::ANY, any::<[u8; 7]>()).prop_map(|(head, up, data)| {
        let [a, b, c, d, e, f, g] = data;
        [head | if up { 0x60 } else { 0 } | head << 4 & 0x10, a, b, c, d, e, f, g]
    });
    prop_oneof![any::<[u8; 8]>(), meant, segment]
}

proptest! {
    #[test]
    fn no_requests_panic_and_each_gets_one_answer_of_its_kind_at_most(
        requests in prop::collection::vec((request(), 0_usize..=9), 0..200),
    ) {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        // Within a block download each frame is a segment, whatever it looks like.
        let mut has_block = false;
        for (request, len) in requests {
            let frame = Frame::new(SDO_REQUEST_ID, &request[..len.min(8)]).unwrap();
            let answer = server.receive(&frame, &mut fake);
            prop_assert!(fake.domain.len() <= MAX + 7);
            if let Some(answer) = answer {
                prop_assert_eq!((answer.id(), answer.len()), (SDO_RESPONSE_ID, 8));
                let (asked, kind) = (request[0] >> 5, answer.data()[0] >> 5);
                has_block |= asked == 6 && kind == 5;
                let expected = match asked { 0 => 1, 1 => 3, 2 => 2, 3 => 0, _ => 4 };
                let is_kind = kind == 4 || kind == expected || has_block && kind == 5;
                prop_assert!(is_kind, "{:02X} to {:02X}", kind, asked);
            }
        }
    }

    #[test]
    fn a_domain_of_any_length_comes_back_as_it_was_sent(
        bytes in prop::collection::vec(any::<u8>(), 1..=MAX), announce: bool,
    ) {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let announced = announce.then_some(u32::try_from(bytes.len()).expect("a short one"));
        prop_assert_eq!(write(&mut server, &mut fake, (0x2100, 2), announced, &bytes), None);
        prop_assert!(server.finish_download(Ok(())).is_some());
        prop_assert_eq!(read(&mut server, &mut fake, 0x2100, 2), Ok(bytes));
    }
}
