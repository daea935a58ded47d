//! A gateway whose line to the bridge stalls without being cut: a proxy stands still in both directions, and then
//! delivers all that has waited. All that the bridge and the PLC say carries the time at which it was sent.
#![allow(clippy::print_stdout, reason = "a test says what it measured")]

use std::{
    io::{ErrorKind, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use trueup_client::duplex_stream::DuplexStream;
use trueup_core::{
    cnc::{AxisPosition, CncMessage, Control, LinearAxis, OffsetQuality, Output, TravelDirection},
    units::{Nanometres, Position},
};
use trueup_gateway::{
    bridge::{SharedHub, spawn_bridge_thread},
    pinned_calibration::{CalibrationPolicy, PinnedCalibration},
};
use trueup_link::{frames, receiver::CncReceiver, slcan::Port};
use trueup_modbus::{holding_block::CncData, input_block::InputBlock};

const MS: Duration = Duration::from_millis(1);
/// The oldest that may be used, and the arithmetic of a busy computer.
const OLDEST_MS: i64 = 350;
/// Time after the start of a stall in which data still go into the line: they cannot be called back.
const ON_ITS_WAY_MS: i64 = 250;

fn ms(start: Instant) -> i32 {
    i32::try_from(start.elapsed().as_millis()).expect("a short test")
}

fn listen() -> (TcpListener, u16) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
    let port = listener.local_addr().expect("bound").port();
    (listener, port)
}

/// The wire carries 5.24 mm at most: a minute.
const NANOMETRES_PER_MS: i32 = 80;

/// Returns a bridge with one client at a time, whose offset on Z is its time; positions of X that come, in ms, with the
/// time at which they do.
fn bridge(start: Instant, received: Arc<Mutex<Vec<(i32, i32)>>>) -> u16 {
    let (listener, port) = listen();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { return };
            stream.set_nonblocking(true).expect("a socket");
            let (mut port, mut receiver, mut bytes) = (Port::new(1), CncReceiver::new(), [0; 512]);
            let (mut counter, mut waiting) = (0_u8, Vec::new());
            'client: loop {
                match stream.read(&mut bytes) {
                    Ok(0) => break,
                    Ok(length) => {
                        for byte in &bytes[..length] {
                            let frame = port.receive(*byte);
                            let command =
                                frame.and_then(|frame| receiver.accept(&frame).ok().flatten());
                            if let Some(CncMessage::Position(at)) = command {
                                received.lock().expect("whole").push((at.position.0, ms(start)));
                            }
                        }
                    }
                    Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                    Err(_) => break,
                }
                if port.is_open() {
                    let z = Nanometres(ms(start) * NANOMETRES_PER_MS);
                    let offset = Some([Nanometres(0), Nanometres(0), z]);
                    let output =
                        Output { offset, quality: OffsetQuality::Live, ..Output::default() };
                    port.send(&frames::encode_offset_xy(&output, counter));
                    port.send(&frames::encode_offset_z(&output, counter));
                    counter = counter.wrapping_add(1);
                }
                waiting.extend(std::iter::from_fn(|| port.pop()));
                match stream.write(&waiting) {
                    Ok(length) => drop(waiting.drain(..length)),
                    Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                    Err(_) => break 'client,
                }
                thread::sleep(MS);
            }
        }
    });
    port
}

/// Hands on what comes, both ways, except while it stands still.
fn proxy(to: u16, stands: Arc<AtomicBool>) -> u16 {
    let (listener, port) = listen();
    thread::spawn(move || {
        for client in listener.incoming() {
            let Ok(client) = client else { return };
            let Ok(server) = TcpStream::connect(("127.0.0.1", to)) else { return };
            let clone = |stream: &TcpStream| stream.try_clone().expect("a socket");
            for (mut from, mut into) in [(clone(&client), clone(&server)), (server, client)] {
                let stands = stands.clone();
                thread::spawn(move || {
                    let mut bytes = [0; 65_536];
                    loop {
                        while stands.load(Ordering::Relaxed) {
                            thread::sleep(MS);
                        }
                        let length = from.read(&mut bytes).unwrap_or(0);
                        while stands.load(Ordering::Relaxed) {
                            thread::sleep(MS);
                        }
                        if length == 0 || into.write_all(&bytes[..length]).is_err() {
                            into.shutdown(std::net::Shutdown::Both).ok();
                            return;
                        }
                    }
                });
            }
        }
    });
    port
}

/// Checks what a PLC sees and says through a line that stalls for this time.
fn stalls_for(stall: Duration) {
    let (start, stop) = (Instant::now(), Arc::new(AtomicBool::new(false)));
    let (received, stands) = (Arc::default(), Arc::new(AtomicBool::new(false)));
    let port = proxy(bridge(start, Arc::clone(&received)), stands.clone());
    let open = move || -> std::io::Result<DuplexStream> {
        let stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(20 * MS))?;
        Ok((Box::new(stream.try_clone()?), Box::new(stream)))
    };
    let shared = SharedHub::new(stop.clone(), PinnedCalibration::new(CalibrationPolicy::Any));
    let line = spawn_bridge_thread(shared.clone(), open);
    let begins = 1_500 * MS;
    let ends = begins + stall;
    let (mut counter, mut seen) = (0, Vec::new());
    while start.elapsed() < ends + 1_500 * MS {
        let now = start.elapsed();
        stands.store((begins..ends).contains(&now), Ordering::Relaxed);
        let position = AxisPosition {
            axis: LinearAxis::X,
            position: Position(ms(start)),
            direction: TravelDirection::Positive,
        };
        let positions = [Some(position), None, None];
        let cnc_data = CncData { control: Control::ENGAGED, positions, ..CncData::default() };
        shared
            .lock_hub()
            .accept_block(shared.now(), 1, &cnc_data.encode(counter))
            .expect("the only master");
        counter = counter.wrapping_add(1);
        let input = InputBlock::decode(&shared.lock_hub().input_registers()).expect("whole");
        if let Some([_, _, z]) = input.output.offset {
            seen.push((z.0 / NANOMETRES_PER_MS, ms(start), input.age_ms));
        }
        thread::sleep(5 * MS);
    }
    stop.store(true, Ordering::Relaxed);
    line.join().expect("it ends");

    let age = |(cnc_data, came): (i32, i32)| i64::from(came - cnc_data);
    let oldest =
        seen.iter().map(|&(cnc_data, came, _)| age((cnc_data, came))).max().expect("offsets");
    println!("{stall:?}: the oldest offset served is {oldest} ms old");
    assert!(oldest <= OLDEST_MS, "{stall:?}: an offset of {oldest} ms is served");
    let again =
        seen.iter().filter(|(cnc_data, _, _)| Duration::from_millis(*cnc_data as u64) > ends);
    assert!(again.count() > 50, "{stall:?}: it goes on afterwards");

    let received = received.lock().expect("whole");
    let begins = i64::try_from(begins.as_millis()).expect("short");
    let late: Vec<_> = received.iter().filter(|&&arrival| age(arrival) > OLDEST_MS).collect();
    println!("{stall:?}: {} of {} positions came late", late.len(), received.len());
    for (cnc_data, came) in &late {
        let after = i64::from(*cnc_data) - begins;
        assert!(after <= ON_ITS_WAY_MS, "{stall:?}: sent at {cnc_data} ms, executed at {came} ms");
    }
    let last = received.last().expect("positions");
    assert!(age(*last) <= OLDEST_MS, "{stall:?}: it goes on afterwards: {last:?}");
}

#[test]
fn a_line_that_stalls_for_a_second_delivers_nothing_old() {
    stalls_for(1_200 * MS);
}

#[test]
fn a_line_that_stalls_for_so_long_that_it_is_opened_again_delivers_nothing_old() {
    stalls_for(4_500 * MS);
}
