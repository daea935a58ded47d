//! The block download between client and server, with a line that loses segments, and a server without room.

use std::vec::Vec;

use proptest::prelude::*;
use trueup_link::{e2e::continue_crc, layout::SDO_REQUEST_ID};

use crate::sdo::{
    client::{BlockDownload, SdoClientError, TransferProgress},
    tests::Fake,
    *,
};

const NEW: (u16, u8) = (0x2100, 2);

/// Has a client write these bytes over a line that loses the requests of these numbers. Returns the outcome, and how many
/// frames went out.
fn write(
    server: &mut SdoServer,
    fake: &mut Fake,
    bytes: &[u8],
    lost: &[usize],
) -> (Result<(), SdoClientError>, usize) {
    let (mut client, first) = BlockDownload::start(NEW, bytes);
    let mut out = std::vec![first];
    let mut sent = 0;
    for _ in 0..1_000 {
        let mut answer = None;
        for frame in out.drain(..) {
            let is_lost = lost.contains(&sent);
            sent += 1;
            if !is_lost {
                answer = server.receive(&frame, fake).or(answer);
            }
        }
        // A server that is at work answers later.
        let answer = answer.or_else(|| {
            fake.is_full = false;
            server.resume_block(fake)
        });
        let Some(answer) = answer.or_else(|| server.finish_download(Ok(()))) else { break };
        match client.receive(&answer) {
            Ok(TransferProgress::Done) => return (Ok(()), sent),
            Ok(TransferProgress::Request(frame)) => {
                out.push(frame);
                out.extend(std::iter::from_fn(|| client.next_segment()));
            }
            Ok(TransferProgress::Unchanged) => {}
            Err(error) => return (Err(error), sent),
        }
    }
    (Err(SdoClientError::TooShort { at: NEW }), sent)
}

fn bytes(count: usize) -> Vec<u8> {
    (0_u8..253).cycle().take(count).collect()
}

#[test]
fn the_crc_is_that_of_the_standard() {
    // CiA 301, 7.2.4.3.16: "123456789" gives 0x31C3.
    assert_eq!(continue_crc(0, b"123456789"), 0x31C3);
}

#[test]
fn domains_of_any_length_arrive_as_they_are() {
    for count in [0, 1, 6, 7, 8, 216, 217, 218, 600] {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let (outcome, sent) = write(&mut server, &mut fake, &bytes(count), &[]);
        assert_eq!((outcome, &fake.domain), (Ok(()), &bytes(count)), "{count}");
        assert_eq!(sent, 2 + count.div_ceil(7).max(1), "{count}: start, segments, end");
    }
}

#[test]
fn a_lost_segment_is_sent_again_and_a_lost_answer_ends_the_transfer() {
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    // Frame 5 is in the first block of 31, which goes out again from there; frame 75 in one of the next.
    let (outcome, sent) = write(&mut server, &mut fake, &bytes(600), &[5, 75]);
    assert_eq!((outcome, &fake.domain), (Ok(()), &bytes(600)));
    assert!(sent > 2 + 86 + 27, "the rest of the block went out again: {sent}");
    // The last segment of all is lost: nothing is answered, until the server gives up.
    let (outcome, _) = write(&mut server, &mut fake, &bytes(14), &[2]);
    assert_eq!(outcome, Err(SdoClientError::TooShort { at: NEW }));
    assert_eq!(server.tick(SDO_TIMEOUT_MS), None);
    let abort = server.tick(1).expect("it gives up");
    assert_eq!(abort.data(), &encode_message(ABORT_COMMAND, NEW, AbortCode::Timeout.code()));
}

#[test]
fn a_block_is_answered_once_there_is_room_for_the_next() {
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    let (mut client, first) = BlockDownload::start(NEW, &[7; 500]);
    let started = server.receive(&first, &mut fake).expect("an answer");
    let Ok(TransferProgress::Request(segment)) = client.receive(&started) else {
        panic!("{started:?}")
    };
    fake.is_full = true;
    let block = std::iter::once(segment).chain(std::iter::from_fn(|| client.next_segment()));
    let answers: Vec<_> = block.filter_map(|frame| server.receive(&frame, &mut fake)).collect();
    assert_eq!((answers.len(), fake.domain.len()), (0, 217));
    assert_eq!(server.resume_block(&fake), None);
    fake.is_full = false;
    let answer = server.resume_block(&fake).expect("there is room");
    assert_eq!(answer.data(), &[0xA2, SEGMENTS_PER_BLOCK, SEGMENTS_PER_BLOCK, 0, 0, 0, 0, 0]);
    assert_eq!(server.resume_block(&fake), None, "once");
}

#[test]
fn a_wrong_crc_length_object_or_number_is_refused() {
    let receive = |server: &mut SdoServer, fake: &mut Fake, data| {
        server
            .receive(&Frame::from_data(SDO_REQUEST_ID, data), fake)
            .map(|response| *response.data())
    };
    let aborted = |at, abort: AbortCode| Some(encode_message(ABORT_COMMAND, at, abort.code()));
    for (size, end, abort) in [
        (7, [0xC1, 0, 0, 0, 0, 0, 0, 0], AbortCode::Crc),
        (6, [0xC1, 0, 0, 0, 0, 0, 0, 0], AbortCode::Length),
        (8, [0xC1, 0, 0, 0, 0, 0, 0, 0], AbortCode::Length),
    ] {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let start = receive(&mut server, &mut fake, encode_message(0xC6, NEW, size));
        assert_eq!(start, Some(encode_message(0xA4, NEW, SEGMENTS_PER_BLOCK.into())));
        let answer = receive(&mut server, &mut fake, [0x81, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(answer, Some([0xA2, 1, SEGMENTS_PER_BLOCK, 0, 0, 0, 0, 0]));
        assert_eq!(receive(&mut server, &mut fake, end), aborted(NEW, abort), "{size} {end:?}");
    }
    let (mut server, mut fake) = (SdoServer::default(), Fake::default());
    for (at, abort) in [
        ((0x1017, 0), AbortCode::Command),
        ((0x1000, 0), AbortCode::ReadOnly),
        ((0x2100, 9), AbortCode::NoSubindex),
        ((0x1234, 0), AbortCode::NoObject),
    ] {
        let start = receive(&mut server, &mut fake, encode_message(0xC6, at, 2));
        assert_eq!(start, aborted(at, abort), "{at:04X?}");
    }
}

#[test]
fn a_new_master_is_received_where_an_old_one_has_left_a_block() {
    let name = encode_message(0x40, (0x1008, 0), 0);
    let starts = [
        name,
        encode_message(0x23, (0x2010, 6), 0),
        encode_message(0x21, NEW, 7),
        encode_message(0xC6, NEW, 7),
        encode_message(0xA4, NEW, 0),
        encode_message(ABORT_COMMAND, NEW, 0),
    ];
    for request in starts {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let (_, first) = BlockDownload::start(NEW, &[7; 500]);
        server.receive(&first, &mut fake).expect("an answer");
        for sequence in 1..SEGMENTS_PER_BLOCK {
            let segment = Frame::from_data(SDO_REQUEST_ID, [sequence, 7, 7, 7, 7, 7, 7, 7]);
            assert_eq!(server.receive(&segment, &mut fake), None);
        }
        let [mut alone, mut other] = [SdoServer::default(), server];
        let expected =
            alone.receive(&Frame::from_data(SDO_REQUEST_ID, request), &mut Fake::default());
        let answer = other.receive(&Frame::from_data(SDO_REQUEST_ID, request), &mut fake);
        assert_eq!(answer, expected, "{request:02X?}");
    }
}

proptest! {
    #[test]
    fn whatever_is_lost_what_is_accepted_is_what_was_sent(
        count in 0_usize..600, lost in prop::collection::vec(0_usize..200, 0..20),
    ) {
        let (mut server, mut fake) = (SdoServer::default(), Fake::default());
        let sent = bytes(count);
        let (outcome, _) = write(&mut server, &mut fake, &sent, &lost);
        if outcome.is_ok() {
            prop_assert_eq!(&fake.domain, &sent);
        }
    }
}
