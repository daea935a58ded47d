//! A CPU that answers what the test says: good ones, cut ones, and any bytes.

use super::*;
use std::{net::TcpListener, thread};

pub(in crate::s7) const CONFIRM: &[u8] = &[0x11, 0xD0, 0, 1, 0, 1, 0, 0xC0, 1, 0x0A];

pub(in crate::s7) fn tpkt(payload: &[u8]) -> Vec<u8> {
    [&[3, 0, 0, (4 + payload.len()) as u8][..], payload].concat()
}

pub(in crate::s7) fn answer(reference: u16, parameters: &[u8], data: &[u8]) -> Vec<u8> {
    let [high, low] = reference.to_be_bytes();
    let (p, d) = (parameters.len() as u8, data.len() as u8);
    let header = [2, 0xF0, 0x80, 0x32, 3, 0, 0, high, low, 0, p, 0, d, 0, 0];
    tpkt(&[&header[..], parameters, data].concat())
}

pub(in crate::s7) fn set_up(reference: u16, pdu: u8) -> Vec<u8> {
    answer(reference, &[0xF0, 0, 0, 1, 0, 1, 0, pdu], &[])
}

/// Returns a CPU that answers each request by the next of these, some bytes at a time, then goes.
pub(in crate::s7) fn cpu(answers: Vec<Vec<u8>>, at_a_time: usize) -> CpuAddress {
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
    let address = listener.local_addr().expect("bound").to_string();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a client");
        stream.set_nodelay(true).expect("a socket");
        for answer in answers {
            let mut header = [0; 4];
            if stream.read_exact(&mut header).is_err() {
                return;
            }
            let mut rest = vec![0; usize::from(header[3]) - 4];
            stream.read_exact(&mut rest).expect("the rest");
            for part in answer.chunks(at_a_time) {
                if stream.write_all(part).is_err() {
                    return;
                }
                if at_a_time < answer.len() {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        }
    });
    CpuAddress { address, rack: 0, slot: 2 }
}

#[test]
fn it_reads_and_writes_however_the_network_cuts_the_answers() {
    for at_a_time in [1, 7, 1_000] {
        let place = cpu(
            vec![
                tpkt(CONFIRM),
                set_up(1, 240),
                answer(2, &[5, 1], &[0xFF]),
                answer(3, &[4, 1], &[0xFF, 4, 0, 16, 0xAB, 0xCD]),
                answer(4, &[5, 1], &[0x0A]),
                answer(5, &[4, 1], &[5, 0, 0, 0]),
            ],
            at_a_time,
        );
        let mut client = S7Client::connect(&place).expect("a CPU");
        client.write(100, 0, &[1, 2]).expect("written");
        let mut bytes = [0; 2];
        client.read(100, 64, &mut bytes).expect("read");
        assert_eq!(bytes, [0xAB, 0xCD]);
        assert!(matches!(client.write(101, 0, &[1]), Err(Error::Item(0x0A))));
        assert!(matches!(client.read(100, 900, &mut bytes), Err(Error::Item(5))));
    }
}

#[test]
fn what_is_asked_is_what_the_protocol_says() {
    // DB 100, from byte 64, two bytes: 512 bits on.
    let expected = [5, 1, 0x12, 0x0A, 0x10, 2, 0, 2, 0, 100, 0x84, 0, 2, 0];
    assert_eq!(encode_job_parameters(FUNCTION_WRITE, 100, 64, 2).expect("fits"), expected);
}

#[test]
fn what_is_no_answer_is_reported_and_no_panic() {
    let refused = |answers: Vec<Vec<u8>>| {
        let error = match S7Client::connect(&cpu(answers, 1_000)) {
            Err(error) => error,
            Ok(mut client) => client.write(1, 0, &[0; 56]).expect_err("no answer"),
        };
        error.to_string()
    };
    let good = || vec![tpkt(CONFIRM), set_up(1, 240)];
    let then = |last: Vec<u8>| [good(), vec![last]].concat();
    for (answers, phrase) in [
        (vec![b"SSH-2.0-OpenSSH".to_vec()], "no S7: no TPKT"),
        (vec![vec![3, 0, 0, 3]], "without a length"),
        (vec![tpkt(&[])], "rack, slot"),
        (vec![tpkt(&[0x06, 0x80, 0, 0])], "rack, slot"),
        (vec![tpkt(CONFIRM), answer(1, &[0xF0, 0], &[])], "agree on a length"),
        (vec![tpkt(CONFIRM), set_up(1, 50)], "too short"),
        (vec![tpkt(CONFIRM), set_up(1, 0)], "too short"),
        (vec![tpkt(CONFIRM), set_up(9, 240)], "another job"),
        (then(answer(1, &[5, 1], &[0xFF])), "another job"),
        (then(answer(2, &[5, 1], &[])), "to a write"),
        (then(answer(2, &[4, 1], &[0xFF])), "to a write"),
        (then(answer(2, &[5, 1], &[3])), "does not let others"),
        (then(tpkt(&[2, 0xF0, 0x80, 0x32, 3])), "no answer to a job"),
        (then(tpkt(&[2, 0xF0, 0x00, 0x32, 3])), "in parts"),
        (then(tpkt(&[2, 0xF0, 0x80, 0x32, 3, 0, 0, 0, 2, 0, 9, 0, 9, 0, 0, 5])), "cut off"),
        (then(tpkt(&[2, 0xF0, 0x80, 0x32, 3, 0, 0, 0, 2, 0, 0, 0, 0, 0x81, 4])), "PUT/GET (S7"),
        (
            then(tpkt(&[2, 0xF0, 0x80, 0x32, 3, 0, 0, 0, 2, 0, 0, 0, 0, 0x84, 4])),
            "its length (trueup_db",
        ),
        (good(), "cannot be reached"),
    ] {
        let message = refused(answers);
        assert!(message.contains(phrase), "{phrase}: {message}");
    }
}

#[test]
fn an_address_may_name_its_port() {
    let nobody = connect_tcp("127.0.0.1:1").expect_err("nobody listens there");
    assert_eq!(nobody.kind(), io::ErrorKind::ConnectionRefused);
    assert!(connect_tcp("no such host").is_err());
}
