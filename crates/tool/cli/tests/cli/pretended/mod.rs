//! A bridge that runs in this process: the node and the SLCAN port of the firmware, without its hardware.

use std::{
    collections::BTreeMap,
    io::{ErrorKind, Read, Write},
    net::TcpListener,
    path::Path,
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use trueup_core::{
    bridge::{ReferenceErrors, TickInput},
    cnc::{AxisPosition, Control, LinearAxis, TravelDirection},
    design_parameters::CODES_PER_TICK,
    units::{AdcCode, Nanometres, Position, Rpm},
};
use trueup_link::{frame::Frame, frames, layout::SDO_RESPONSE_ID, slcan::Port};
use trueup_machine::{CompiledCalibration, Machine, MachineFile, compile};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_store::{
    calibration::{MAX_BLOB_SIZE, calibration_crc, decode},
    calibration_load::LoadOutcome,
    reference::ReferenceStatus,
};

use crate::wire::{ReceivedBytes, Tools, damaged, write_all};

/// The paper's spindle.
pub const PAPER: &str = include_str!("../../../../../../data/paper_spindle.toml");

/// The fault of the bridge.
#[derive(Clone, Copy, PartialEq)]
pub enum PretendedFault {
    None,
    /// A bit of every hundredth frame is flipped.
    Noise,
    /// It answers, but sends no frame.
    NoFrames,
    /// Of what the tool sends, this frame is lost, counted from 0.
    Loses(usize),
    /// It says nothing at all.
    Silent,
    /// It closes the line after a while.
    Leaves,
    /// Its store gives back other bytes than it was given.
    Forgetful,
    /// Its store takes nothing.
    Full,
    /// Its firmware is of another commit than the tool.
    OtherSource,
    /// Its CNC has set `Zero` where the spindle had grown by 2.5 µm.
    Zeroed,
    /// Its firmware does not let a reference be written.
    Older,
    /// Its CNC says nothing more once a second tool has opened the line.
    CncLeaves,
}

/// Returns a bridge at a port of this machine, engaged by a CNC that it has elsewhere.
pub fn bridge(fault: PretendedFault) -> (String, Arc<Mutex<ReceivedBytes>>) {
    bridge_with(fault, true)
}

pub fn bridge_with(fault: PretendedFault, engage: bool) -> (String, Arc<Mutex<ReceivedBytes>>) {
    listening(fault, move || engage, false)
}

/// Returns the same for one tool after the other.
pub fn bridge_many(fault: PretendedFault, engage: bool) -> (String, Arc<Mutex<ReceivedBytes>>) {
    listening(fault, move || engage, true)
}

/// Returns the same, engaged when its CNC says so.
pub fn bridge_steered(
    is_engaged: impl Fn() -> bool + Send + 'static,
) -> (String, Arc<Mutex<ReceivedBytes>>) {
    listening(PretendedFault::None, is_engaged, true)
}

fn listening(
    fault: PretendedFault,
    is_engaged: impl Fn() -> bool + Send + 'static,
    many: bool,
) -> (String, Arc<Mutex<ReceivedBytes>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = format!("tcp:{}", listener.local_addr().expect("bound above"));
    let received = Arc::new(Mutex::new(ReceivedBytes::default()));
    let shared = received.clone();
    thread::spawn(move || {
        let (stream, _) = listener.accept().expect("the tool connects");
        stream.set_nonblocking(true).expect("a plain socket");
        // As the virtual board has it: a frame would wait for the answer to the one before, 40 ms.
        stream.set_nodelay(true).expect("a plain socket");
        if many {
            listener.set_nonblocking(true).expect("a plain socket");
            live(Tools { listener, stream: Some(stream) }, fault, is_engaged, &shared);
        } else {
            live(stream, fault, is_engaged, &shared);
        }
    });
    (address, received)
}

pub fn paper_machine() -> Machine {
    MachineFile::parse(PAPER, Path::new("m.toml")).expect("the project's own file")
}

pub fn paper() -> CompiledCalibration {
    compile(&paper_machine()).expect("the paper's sensor fits")
}

/// Returns a node that runs on this blob, as after a start.
pub fn started(blob: &'static [u8]) -> (Node<'static>, Port) {
    of_commit(blob, 0)
}

/// The same of an image from this commit.
fn of_commit(blob: &'static [u8], commit: u32) -> (Node<'static>, Port) {
    let calibration = decode(blob).expect("a calibration");
    let buffer = Some(Box::leak(vec![0; MAX_BLOB_SIZE].into()));
    let node = Node::new(NodeConfiguration { blob, buffer, commit, ..calibration.into() });
    (node, Port::new(0x00A1))
}

/// A control that wants offsets, and positions of axes that stand.
fn speak_as_cnc(node: &mut Node<'_>, control: u32, engage: bool) {
    // As after every start: three times not engaged.
    let engaged =
        Control { engage: engage && control >= 3, service: !engage, ..Control::REFERENCED };
    node.receive(Interface::Can, &frames::encode_control(engaged, control as u8))
        .expect("in order");
    // Its axes stand.
    for axis in LinearAxis::ALL {
        let stands =
            AxisPosition { axis, position: Position(0), direction: TravelDirection::Positive };
        node.receive(Interface::Can, &frames::encode_position(stands, control as u8))
            .expect("in order");
    }
}

/// Returns true if the tool has opened its channel a second time.
fn is_opened_again(received: &Mutex<ReceivedBytes>) -> bool {
    let received = received.lock().expect("no holder panics");
    received.bytes.windows(3).filter(|bytes| bytes == b"\rO\r").count() > 1
}

/// Takes a calibration that has arrived.
fn take_load(node: &mut Node<'_>, fault: PretendedFault, stored: &mut Option<Vec<u8>>) {
    if let Some(mut load) = node.take_received_calibration() {
        let mut outcome = LoadOutcome::Stored;
        match load.validate_blob() {
            Err(_) => outcome = LoadOutcome::Rejected,
            Ok(_) if fault == PretendedFault::Full => outcome = LoadOutcome::NotStored,
            Ok(blob) => *stored = Some(blob.to_vec()),
        }
        node.finish_load(load, outcome);
    }
}

/// Returns the node after a restart with what was loaded, or with the calibration that it has; the reference of that
/// calibration is in force again.
fn restarted(
    node: &Node<'_>,
    loaded: Option<Vec<u8>>,
    standings: &BTreeMap<u32, ReferenceStatus>,
) -> (Node<'static>, Port) {
    let is_loaded = loaded.is_some();
    let blob = loaded.unwrap_or_else(|| node.calibration_blob().to_vec());
    let (mut node, port) = started(Box::leak(blob.into()));
    if let Some(mut standing) = standings.get(&calibration_crc(node.calibration_blob())).copied() {
        standing.is_offered |= is_loaded && standing.reference != ReferenceErrors::default();
        node.restore_reference_status(standing, None);
    }
    (node, port)
}

/// Returns whether the line damages this frame.
fn is_damaged(fault: PretendedFault, frame: &Frame, ms: u32) -> bool {
    match fault {
        PretendedFault::Noise => ms % 100 == 99,
        // A segment that is read: the first byte says which.
        PretendedFault::Forgetful => frame.id() == SDO_RESPONSE_ID && frame.data()[0] == 0x10,
        _ => false,
    }
}

pub fn live(
    mut stream: impl Read + Write,
    fault: PretendedFault,
    is_engaged: impl Fn() -> bool,
    received: &Mutex<ReceivedBytes>,
) {
    let compiled = paper();
    let commit = if fault == PretendedFault::OtherSource { 7 } else { 0 };
    let (mut node, mut port) = of_commit(Box::leak(compiled.blob().into()), commit);
    let mut stored: Option<Vec<u8>> = None;
    // By the CRC of their calibrations.
    let mut standings = BTreeMap::new();
    if fault == PretendedFault::Zeroed {
        let elongation = Nanometres(2_500);
        let standing =
            ReferenceStatus::in_force(ReferenceErrors { elongation, ..ReferenceErrors::default() });
        node.restore_reference_status(standing, None);
        standings.insert(calibration_crc(node.calibration_blob()), standing);
    }
    let mut control = 0_u32;
    // The paper's zero is 5048 of its 32768 counts at 10 V: 627.2 codes behind the divider. 100 codes
    // above it, 805.4 counts, are 12.3 µm, which the slew limit reaches in 0.6 s.
    let codes: [AdcCode; CODES_PER_TICK] = std::array::from_fn(|n| AdcCode(727 + (n % 2) as u16));
    let start = Instant::now();
    let mut bytes = [0; 256];
    for ms in 0_u32.. {
        let due = Duration::from_millis(ms.into());
        thread::sleep(due.saturating_sub(start.elapsed()));
        if fault == PretendedFault::Leaves && ms > 1_300 {
            return;
        }
        match stream.read(&mut bytes) {
            Ok(0) => return,
            Ok(length) => {
                let mut received = received.lock().expect("no holder panics");
                received.bytes.extend(&bytes[..length]);
                let frames = bytes[..length].iter().filter_map(|&byte| port.receive(byte));
                for frame in frames.collect::<Vec<_>>() {
                    received.frames += 1;
                    let is_new = matches!(frame.data(), [0x23, 0x10, 0x20, ..]);
                    if fault == PretendedFault::Older && is_new {
                        let read_only = [0x80, 0x10, 0x20, frame.data()[3], 2, 0, 1, 6];
                        let answer = Frame::new(SDO_RESPONSE_ID, &read_only).expect("eight bytes");
                        port.send(&answer);
                        continue;
                    }
                    if fault == PretendedFault::Loses(received.frames - 1) {
                        continue;
                    }
                    // A tool that speaks where a CNC has spoken counts from 0.
                    let refused = node.receive(Interface::Serial, &frame).err();
                    assert!(
                        refused.is_none_or(|error| error.is_sequence_error()),
                        "no tool sends damaged frames"
                    );
                }
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return,
        }
        take_load(&mut node, fault, &mut stored);
        if node.take_calibration_to_restore().is_some() {
            stored = None;
            node.finish_calibration_drop(true);
        }
        if let Some(standing) = node.take_reference_status() {
            standings.insert(calibration_crc(node.calibration_blob()), standing);
        }
        while let Some(write) = node.take_pending_write() {
            let stored = trueup_store::write_log::WriteRecord { sequence: 7, ..write };
            node.finish_write(&write, Some(stored));
        }
        if node.take_restart_request() {
            (node, port) = restarted(&node, stored.take(), &standings);
            control = 0;
        }
        let is_gone = fault == PretendedFault::CncLeaves && is_opened_again(received);
        if ms % 20 == 0 && !is_gone {
            speak_as_cnc(&mut node, control, is_engaged());
            control += 1;
        }
        let speed = Some(Rpm(24_000));
        let sent = node.tick(1, TickInput { codes: Some(&codes), speed, ..TickInput::default() });
        let sent = sent.into_iter().chain(node.next_service_frame());
        if fault != PretendedFault::NoFrames {
            for frame in &sent.collect::<Vec<_>>() {
                let flip = is_damaged(fault, frame, ms);
                port.send(&if flip { damaged(frame) } else { *frame });
            }
        }
        let answer: Vec<u8> = std::iter::from_fn(|| port.pop()).collect();
        if fault != PretendedFault::Silent && write_all(&mut stream, &answer).is_err() {
            return;
        }
    }
}

/// The bridge's end of a pseudo terminal, which fails while the tool has not opened the other.
#[cfg(unix)]
pub struct Tty(pub serialport::TTYPort);

#[cfg(unix)]
impl Read for Tty {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.0.read(buffer).map_err(|_| ErrorKind::WouldBlock.into())
    }
}

#[cfg(unix)]
impl Write for Tty {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
