//! Eight inputs that come from outside, fuzzed: a seed of the corpus, cut, flipped and filled with what
//! bolero draws. Nothing panics, and what is taken is within its range.
//!
//! Among the tests each runs for a thousand inputs; `cargo xtask fuzz --minutes 15` gives each that long
//! and prints its count. The seeds are `corpus/` and what is compiled from `data/`.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{
    env, fs,
    io::Write as _,
    net::TcpListener,
    path::Path,
    sync::atomic::{AtomicU64, Ordering::Relaxed},
    thread,
    time::Duration,
};

use bolero::check;
use crc::{CRC_32_AUTOSAR, Crc};
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use trueup_core::cnc::Control;
use trueup_emulator::{plant::Plant, setup};
use trueup_link::{
    e2e,
    frame::Frame,
    frames,
    receiver::{CncReceiver, OffsetReceiver, StatusReceiver},
    slcan::{Port, SlcanClient},
};
use trueup_machine::{MachineFile, RunFile, compile};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_store::{
    calibration::{self, MAX_BLOB_SIZE, MAX_OFFSET_NM, MAX_SLEW_NM_PER_S},
    calibration_store::{CalibrationStore, SLOT_SIZE},
    reference::ReferenceStore,
};

/// Inputs of a test of the quick tier.
const FEW: usize = 1_000;
/// Bytes that are drawn for an input: sixteen changes.
const DRAWN: usize = 1 + 16 * 4;

/// Gives a target its inputs: seeds, changed. `feed` is one input's whole life.
fn fuzz(name: &str, seeds: &[Vec<u8>], feed: fn(&mut Vec<u8>)) {
    assert!(!seeds.is_empty(), "{name} has a corpus");
    let count = AtomicU64::new(0);
    let target = check!().with_max_len(DRAWN);
    let run = |drawn: &[u8]| {
        count.fetch_add(1, Relaxed);
        feed(&mut changed(seeds, drawn));
    };
    match env::var("TRUEUP_FUZZ_S") {
        Ok(seconds) => {
            let seconds = seconds.parse().expect("seconds");
            target.with_test_time(Duration::from_secs(seconds)).for_each(run);
        }
        Err(_) => target.with_iterations(FEW).for_each(run),
    }
    println!("{name}: {} inputs", count.load(Relaxed));
}

/// Returns a seed with what was drawn done to it: four bytes a change, what, where (two), and with what.
fn changed(seeds: &[Vec<u8>], drawn: &[u8]) -> Vec<u8> {
    let (which, changes) = drawn.split_first().unwrap_or((&0, &[]));
    let mut bytes = seeds[usize::from(*which) % seeds.len()].clone();
    for change in changes.as_chunks::<4>().0 {
        let [what, high, low, with] = *change;
        let at = usize::from(u16::from_be_bytes([high, low])) % (bytes.len() + 1);
        match what % 8 {
            0 if at < bytes.len() => bytes[at] ^= 1 << (with % 8),
            1 if at < bytes.len() => bytes[at] = with,
            2 => bytes.insert(at, with),
            3 if at < bytes.len() => drop(bytes.remove(at)),
            4 => bytes.truncate(at.max(1)),
            // A stretch again, somewhere else.
            5 => {
                let end = (at + usize::from(with)).min(bytes.len());
                let stretch = bytes[at..end].to_vec();
                bytes.splice(at..at, stretch);
            }
            // Numbers as text and as bytes, where parsers and tables have their edges.
            6 => drop(bytes.splice(at..at, EDGES[usize::from(with) % EDGES.len()].bytes())),
            _ => {
                bytes.iter_mut().skip(at).take(4).for_each(|byte| *byte = (with % 2).wrapping_neg())
            }
        }
        if bytes.len() > 1 << 20 {
            break;
        }
    }
    bytes
}

const EDGES: [&str; 12] = [
    "-",
    "1e308",
    "-1e999",
    "nan",
    "0",
    "99999999999999999999",
    "\"",
    "\r",
    "\n",
    "[[",
    "\u{feff}",
    "é",
];

fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = setup::project_root().join("host-tests/corpus").join(name);
    let mut paths: Vec<_> =
        fs::read_dir(folder).expect("it is ours").flatten().map(|entry| entry.path()).collect();
    paths.sort();
    paths.iter().map(|path| fs::read(path).expect("it is ours")).collect()
}

fn blobs() -> Vec<Vec<u8>> {
    ["data/paper_spindle.toml", "data/gantry.toml", "host-tests/corpus/toml/all.toml"]
        .map(|name| {
            let machine = MachineFile::read(&setup::project_root().join(name)).expect("it is ours");
            compile(&machine).expect("it runs on a board").blob().to_vec()
        })
        .into()
}

#[test]
fn any_blob_is_refused_or_within_the_caps() {
    fuzz("blob", &blobs(), |blob| {
        assert!(calibration::decode(blob).is_ok() || calibration::decode(blob).is_err());
        // And with a length and a CRC that are right.
        let Ok(length) = u16::try_from(blob.len()) else { return };
        if blob.len() < 8 {
            return;
        }
        blob[6..8].copy_from_slice(&length.to_le_bytes());
        let end = blob.len() - 4;
        let crc = Crc::<u32>::new(&CRC_32_AUTOSAR).checksum(&blob[..end]);
        blob[end..].copy_from_slice(&crc.to_le_bytes());
        if let Ok(calibration) = calibration::decode(blob) {
            let limits = calibration.limits;
            assert!(limits.slew_nm_per_s <= MAX_SLEW_NM_PER_S);
            assert!(limits.max.iter().all(|max| (0..=MAX_OFFSET_NM).contains(&max.0)));
        }
    });
}

/// Two sectors of memory that take any write.
#[derive(Clone)]
struct Memory(Vec<u8>);

impl ErrorType for Memory {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }
    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4;
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.0[offset as usize..][..bytes.len()].copy_from_slice(bytes);
        Ok(())
    }
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.0[from as usize..to as usize].fill(0xFF);
        Ok(())
    }
}

#[test]
fn any_bytes_in_the_flash_can_be_started_on_and_stored_over() {
    // A flash as a board leaves it: calibrations, and references behind them.
    let blob = &blobs()[0];
    let empty = Memory(vec![0xFF; 4 * SLOT_SIZE as usize]);
    let (mut slots, _) = CalibrationStore::open(empty, None, &mut [0; MAX_BLOB_SIZE]);
    for _ in 0..3 {
        slots.store(blob, || ()).expect("there is room");
    }
    let seeds = [slots.flash().0.clone()];
    fuzz("store", &seeds, |bytes| {
        bytes.resize(4 * SLOT_SIZE as usize, 0xFF);
        let (mut slots, found) =
            CalibrationStore::open(Memory(bytes.clone()), None, &mut [0; MAX_BLOB_SIZE]);
        assert!(found.newest.is_none_or(|newest| newest.length <= MAX_BLOB_SIZE));
        let _ = slots.erase_spare_half(|| ());
        let _ = slots.store(&[7; 700], || ());
        let (mut references, _) = ReferenceStore::open(Memory(bytes.clone()), 7);
        let _ = references.erase_spare_half();
        let _ = references.append(Default::default());
    });
}

/// Returns a node that a master may change.
fn node_in_service(buffer: Option<&mut [u8]>) -> Node<'_> {
    let mut node = Node::new(NodeConfiguration { buffer, ..NodeConfiguration::default() });
    for counter in 0..4 {
        let control = Control { service: true, ..Control::REFERENCED };
        node.receive(Interface::Can, &frames::encode_control(control, counter))
            .expect("it is whole");
    }
    node
}

#[test]
fn any_sdo_requests_are_answered_or_aborted() {
    let session = [
        [0x40, 0x18, 0x10, 0x01, 0, 0, 0, 0],
        [0x2B, 0x17, 0x10, 0x00, 0xF4, 0x01, 0, 0],
        [0x21, 0x50, 0x1F, 0x01, 0x00, 0x03, 0, 0],
        [0x00, 1, 2, 3, 4, 5, 6, 7],
        [0x11, 1, 2, 3, 4, 5, 6, 7],
        [0xC2, 0x50, 0x1F, 0x01, 0x00, 0x03, 0, 0],
        [0x80, 0x00, 0x10, 0x00, 0, 0, 0, 0],
    ];
    fuzz("sdo", &[session.concat()], |bytes| {
        let mut buffer = [0; 1_024];
        let mut node = node_in_service(Some(&mut buffer));
        for request in bytes.as_chunks::<8>().0 {
            let frame = Frame::new(0x601, request).expect("8 bytes");
            let _ = node.receive(Interface::Can, &frame);
            for _ in 0..4 {
                node.tick(5, Default::default());
                if let Some(answer) = node.next_service_frame() {
                    assert!(answer.len() <= 8);
                }
            }
        }
    });
}

#[test]
fn any_bytes_on_the_serial_line_are_answered_or_passed_over() {
    fuzz("slcan", &corpus("slcan"), |bytes| {
        let (mut port, mut client) = (Port::new(1), SlcanClient::new());
        for byte in bytes {
            if let Some(frame) = port.receive(*byte) {
                assert!(frame.id() <= Frame::MAX_ID);
            }
            let _ = client.receive(*byte);
            while let Some(answer) = port.pop() {
                let _ = client.receive(answer);
            }
        }
    });
}

/// Frames of eight bytes under the identifiers of the wire, protected, as these bytes say.
fn frames_of(bytes: &[u8]) -> impl Iterator<Item = Frame> {
    const IDS: [u16; 10] = [0x201, 0x301, 0x401, 0x501, 0x202, 0x302, 0x402, 0x181, 0x281, 0x381];
    bytes.as_chunks::<10>().0.iter().map(|bytes| {
        let id = IDS[usize::from(bytes[0]) % IDS.len()];
        let mut data: [u8; 8] = bytes[1..9].try_into().expect("8 of 10");
        if bytes[9] % 4 != 0 {
            e2e::protect(id, data[2], &mut data);
        }
        Frame::new(id, &data[..if bytes[9] == 255 { 5 } else { 8 }]).expect("8 bytes at the most")
    })
}

#[test]
fn any_frames_are_received_or_refused_by_the_board() {
    fuzz("board's receiver", &[(0..200).collect()], |bytes| {
        let mut receiver = CncReceiver::new();
        let count = frames_of(bytes).filter(|frame| receiver.accept(frame).is_ok()).count();
        assert!(receiver.counters().accepted as usize <= count);
    });
}

#[test]
fn any_frames_are_received_or_refused_by_the_cnc() {
    fuzz("CNC's receivers", &[(0..200).collect()], |bytes| {
        let (mut offsets, mut status) = (OffsetReceiver::new(), StatusReceiver::new());
        for frame in frames_of(bytes) {
            if let Ok(Some(output)) = offsets.accept(&frame) {
                let axes = output.offset.into_iter().flatten();
                assert!(axes.into_iter().all(|axis| axis.0.unsigned_abs() <= 5_242_870));
            }
            let _ = status.accept(&frame);
        }
    });
}

#[test]
fn any_machine_file_is_read_or_refused_with_its_place() {
    let mut seeds = corpus("toml");
    seeds.extend(["data/paper_spindle.toml", "data/gantry.toml"].map(|name| {
        let text = fs::read(setup::project_root().join(name)).expect("it is ours");
        text[..text.len().min(6_000)].to_vec()
    }));
    fuzz("TOML", &seeds, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        match MachineFile::parse(&text, Path::new("fuzz.toml")) {
            Ok(machine) => drop(compile(&machine)),
            Err(error) => assert!(error.to_string().contains("fuzz.toml"), "{error}"),
        }
    });
}

#[test]
fn any_run_file_is_read_or_refused_with_its_place() {
    fuzz("CSV", &corpus("csv"), |bytes| {
        match RunFile::from_reader(&bytes[..], Path::new("fuzz.csv")) {
            Ok(run) => {
                for column in run.columns() {
                    let values = run.column(&column.name).expect("it is listed");
                    assert!(values.iter().all(|value| !value.is_infinite()), "{}", column.name);
                }
            }
            Err(error) => assert!(error.to_string().contains("fuzz.csv"), "{error}"),
        }
    });
}

#[test]
fn any_lines_of_a_plant_are_steps_or_refused_with_their_number() {
    fuzz("plant", &corpus("plant"), |bytes| {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port of our own");
        let address = listener.local_addr().expect("it is bound").to_string();
        thread::scope(|scope| {
            scope.spawn(|| {
                let (mut stream, _) = listener.accept().expect("it connects");
                // It may have hung up on a line that it does not take.
                let _ = stream.write_all(bytes);
            });
            let mut plant = Plant::connect(&address, Default::default()).expect("it listens");
            loop {
                match plant.next_step(|| Ok(false)) {
                    Ok(Some((situation, ms))) => {
                        assert!(situation.sensor_volts.abs() <= 100.0 && ms <= 3_600_000);
                    }
                    Ok(None) => break,
                    Err(error) => {
                        assert!(format!("{error:#}").contains("plant at tcp:"), "{error:#}");
                        break;
                    }
                }
            }
        });
    });
}
