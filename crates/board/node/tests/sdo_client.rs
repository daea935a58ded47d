//! A tool that reads and writes objects, against the real node.

use trueup_canopen::sdo::{
    AbortCode,
    client::{Download, ObjectAddress, SdoClientError, TransferProgress, Upload},
};
use trueup_core::{bridge::TickInput, cnc::Control};
use trueup_link::{frame::Frame, frames};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_store::{calibration::MAX_BLOB_SIZE, calibration_load::LoadOutcome};

fn node() -> Node<'static> {
    let buffer = Some(Box::leak(vec![0; MAX_BLOB_SIZE].into()));
    let mut node = Node::new(NodeConfiguration { buffer, ..NodeConfiguration::default() });
    let control = Control { service: true, ..Control::REFERENCED };
    node.receive(Interface::Serial, &frames::encode_control(control, 0)).expect("the first");
    node
}

/// Returns what the node says to a request, offsets and heartbeats among it; and what a board does.
fn responses_to(node: &mut Node<'_>, request: Frame) -> Vec<Frame> {
    node.receive(Interface::Can, &request).expect("an SDO");
    if let Some(load) = node.take_received_calibration() {
        node.finish_load(load, LoadOutcome::Stored);
    }
    (0..20)
        .flat_map(|_| {
            let offsets = node.tick(1, TickInput::default());
            offsets.into_iter().chain(node.next_service_frame()).collect::<Vec<_>>()
        })
        .collect()
}

fn upload(node: &mut Node<'_>, at: ObjectAddress) -> Result<Vec<u8>, SdoClientError> {
    let (mut upload, mut next) = Upload::start(at);
    let mut bytes = Vec::new();
    for _ in 0..5_000 {
        let mut requested = None;
        for frame in responses_to(node, next) {
            match upload.receive(&frame, &mut bytes)? {
                TransferProgress::Unchanged => {}
                TransferProgress::Request(request) => requested = Some(request),
                TransferProgress::Done => return Ok(bytes),
            }
        }
        next = requested.expect("an answer");
    }
    panic!("no end");
}

fn download(node: &mut Node<'_>, at: ObjectAddress, data: &[u8]) -> Result<(), SdoClientError> {
    let (mut download, mut next) = Download::start(at, data);
    for _ in 0..5_000 {
        let mut requested = None;
        for frame in responses_to(node, next) {
            match download.receive(&frame)? {
                TransferProgress::Unchanged => {}
                TransferProgress::Request(request) => requested = Some(request),
                TransferProgress::Done => return Ok(()),
            }
        }
        next = requested.expect("an answer");
    }
    panic!("no end");
}

#[test]
fn numbers_texts_and_domains_go_both_ways() {
    let mut node = node();
    assert_eq!(upload(&mut node, (0x1000, 0)), Ok(404_u32.to_le_bytes().to_vec()));
    assert_eq!(upload(&mut node, (0x1001, 0)).map(|bytes| bytes.len()), Ok(1));
    assert_eq!(upload(&mut node, (0x1008, 0)), Ok(b"trueup bridge".to_vec()));
    assert_eq!(download(&mut node, (0x1017, 0), &[44, 1]), Ok(()));
    assert_eq!(upload(&mut node, (0x1017, 0)), Ok(vec![44, 1]));
    for length in [1, 6, 7, 8, 14, 700, MAX_BLOB_SIZE] {
        // Four bytes and fewer go in one frame, which is too short for a domain.
        let bytes: Vec<u8> = (0..=u8::MAX).cycle().take(length).collect();
        let sent = download(&mut node, (0x2100, 2), &bytes);
        if length <= 4 {
            let code = AbortCode::TooShort.code();
            assert_eq!(sent, Err(SdoClientError::Aborted { at: (0x2100, 2), code }));
        } else {
            assert_eq!(sent, Ok(()), "{length} bytes");
            assert_eq!(upload(&mut node, (0x2100, 2)), Ok(bytes), "{length} bytes");
        }
    }
}

#[test]
fn a_refusal_is_reported_in_words_with_its_code() {
    let mut node = node();
    let refused = download(&mut node, (0x2100, 2), &[0; MAX_BLOB_SIZE + 1]).unwrap_err();
    assert_eq!(refused.to_string(), "object 2100:2: too long (abort code 06070012)");
    let missing = upload(&mut node, (0x1FFF, 3)).unwrap_err();
    assert_eq!(missing.to_string(), "object 1FFF:3: there is no such object (abort code 06020000)");
}
