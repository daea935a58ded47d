//! A server on loopback, a bridge that changes its mind every millisecond, and masters of all kinds.

use super::*;
use std::sync::atomic::AtomicBool;
use trueup_client::pinned_calibration::{CalibrationPolicy, PinnedCalibration};
use trueup_core::{
    cnc::{Control, OffsetQuality, Output},
    units::Nanometres,
};
use trueup_link::{
    frames::{encode_offset_xy, encode_offset_z},
    slcan::AdapterMessage,
};
use trueup_modbus::{
    holding_block::{CncData, registers_to_write},
    input_block::InputBlock,
    register_map::INPUT_LEN,
};

/// A served hub; everything ends with it.
struct World {
    shared: SharedHub,
    masters: MasterCounters,
    stop: Arc<AtomicBool>,
    address: std::net::SocketAddr,
}

impl World {
    fn new() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let shared = SharedHub::new(stop.clone(), PinnedCalibration::new(CalibrationPolicy::Any));
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
        let address = listener.local_addr().expect("bound");
        let masters = serve(shared.clone(), listener, 1).expect("serves");
        Self { shared, masters, stop, address }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).expect("it listens");
        stream.set_nodelay(true).expect("a socket");
        stream.set_read_timeout(Some(Duration::from_secs(5))).expect("a socket");
        stream
    }

    /// From now on a pair each millisecond, whose three offsets are one number in three forms.
    fn bridge_changes_its_mind(&self) {
        let shared = self.shared.clone();
        thread::spawn(move || {
            for n in 0_i32.. {
                if shared.is_stop_requested() {
                    return;
                }
                let nm = n % 50_000 * 10;
                let output = Output {
                    offset: Some([nm, -nm, nm + 1_000].map(Nanometres)),
                    quality: OffsetQuality::Live,
                    ..Output::default()
                };
                let mut hub = shared.lock_hub();
                for frame in [encode_offset_xy(&output, n as u8), encode_offset_z(&output, n as u8)]
                {
                    hub.receive(shared.now(), &AdapterMessage::Frame(frame));
                }
                hub.refresh_input_block(shared.now());
                drop(hub);
                thread::sleep(Duration::from_millis(1));
            }
        });
    }
}

impl Drop for World {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

fn query(stream: &mut TcpStream, pdu: &[u8]) -> Vec<u8> {
    let length = (pdu.len() as u16 + 1).to_be_bytes();
    let request = [&[0, 7, 0, 0][..], &length, &[1], pdu].concat();
    stream.write_all(&request).expect("it listens");
    let mut header = [0; 7];
    stream.read_exact(&mut header).expect("it answers");
    let mut body = vec![0; usize::from(u16::from_be_bytes([header[4], header[5]])) - 1];
    stream.read_exact(&mut body).expect("it answers");
    body
}

fn read_input(stream: &mut TcpStream) -> [u16; INPUT_LEN] {
    let body = query(stream, &[4, 0, 0, 0, INPUT_LEN as u8]);
    assert_eq!(body[..2], [4, 2 * INPUT_LEN as u8]);
    let mut block = [0; INPUT_LEN];
    for (place, word) in block.iter_mut().zip(body[2..].chunks_exact(2)) {
        *place = u16::from_be_bytes([word[0], word[1]]);
    }
    block
}

fn write(block: &[u16]) -> Vec<u8> {
    let mut pdu = vec![16, 0, 0, 0, block.len() as u8, 2 * block.len() as u8];
    pdu.extend(block.iter().flat_map(|word| word.to_be_bytes()));
    pdu
}

fn engaged(counter: u16) -> Vec<u8> {
    write(registers_to_write(
        &CncData { control: Control::ENGAGED, ..CncData::default() }.encode(counter),
    ))
}

/// Reads so often while the bridge changes its mind; how many blocks were new.
fn polls(count: u32) -> u32 {
    let world = World::new();
    world.bridge_changes_its_mind();
    let mut master = world.connect();
    let (mut last, mut new) = (None, 0);
    for _ in 0..count {
        let input = InputBlock::decode(&read_input(&mut master)).expect("never half old");
        if let Some([x, y, z]) = input.output.offset {
            assert_eq!((y.0, z.0), (-x.0, x.0 + 1_000));
        }
        new += u32::from(last.replace(input.counter) != Some(input.counter));
    }
    new
}

#[test]
fn no_block_is_half_old_while_the_values_change() {
    let new = polls(4_000);
    assert!(new > 10, "they did change: {new}");
}

#[test]
#[ignore = "long: 10⁵ polls"]
fn no_block_of_a_hundred_thousand_is_half_old_while_the_values_change_each_millisecond() {
    let new = polls(100_000);
    println!("100000 polls, {new} different blocks, 0 half old");
    // How many depends on the computer: a fast one polls all in a second.
    assert!(new > 100, "they did change: {new}");
}

#[test]
fn a_second_master_reads_but_is_busy_until_the_first_has_gone() {
    let world = World::new();
    let (mut first, mut second) = (world.connect(), world.connect());
    assert_eq!(query(&mut first, &engaged(1)), [16, 0, 0, 0, 17]);
    assert_eq!(query(&mut second, &engaged(9)), [0x90, 6]);
    read_input(&mut second);
    drop(first);
    let start = Instant::now();
    while query(&mut second, &engaged(10)) != [16, 0, 0, 0, 17] {
        assert!(start.elapsed() < Duration::from_secs(5));
        thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(query(&mut second, &[3, 0, 0, 0, 1]), [3, 2, 0, 10]);
}

#[test]
fn a_client_that_sends_nonsense_or_half_a_request_is_closed_and_no_other_notices() {
    let world = World::new();
    let mut good = world.connect();
    read_input(&mut good);
    for nonsense in [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0; 12], &[0, 1, 0, 0, 0, 6, 1, 4]] {
        let mut other = world.connect();
        other.write_all(nonsense).expect("it listens");
        let closed = other.read(&mut [0; 16]);
        assert!(matches!(closed, Ok(0) | Err(_)), "{closed:?}");
        read_input(&mut good);
    }
    // One byte at a time is slow, but whole.
    let mut slow = world.connect();
    for byte in [0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0] {
        slow.write_all(&[byte]).expect("it listens");
        thread::sleep(Duration::from_millis(5));
    }
    slow.write_all(&[1]).expect("it listens");
    let mut answered = [0; 11];
    slow.read_exact(&mut answered).expect("it answers");
    assert_eq!(answered, [0, 1, 0, 0, 0, 5, 1, 4, 2, 0, 1]);
}

#[test]
fn there_are_only_so_many_masters_and_places_become_free_again() {
    let world = World::new();
    let wait = |expected: usize| {
        let start = Instant::now();
        while world.masters.connection_count() != expected {
            assert!(
                start.elapsed() < Duration::from_secs(5),
                "{}",
                world.masters.connection_count()
            );
            thread::sleep(Duration::from_millis(5));
        }
    };
    let all: Vec<TcpStream> = (0..MAX_MASTERS).map(|_| world.connect()).collect();
    wait(MAX_MASTERS);
    assert!(matches!(world.connect().read(&mut [0]), Ok(0) | Err(_)), "one too many");
    drop(all);
    wait(0);
    read_input(&mut world.connect());
}
