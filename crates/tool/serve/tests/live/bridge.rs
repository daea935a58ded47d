//! A bridge in this process: the node and the SLCAN port of the firmware, for one client after the other, engaged by a
//! CNC that it has elsewhere. It lives on while clients come and go, and can be switched off.

use std::{
    io::{ErrorKind, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    path::Path,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use trueup_core::{
    bridge::TickInput,
    cnc::{AxisPosition, Control, LinearAxis, TravelDirection},
    design_parameters::CODES_PER_TICK,
    units::{AdcCode, Position, Rpm},
};
use trueup_link::{frame::Frame, frames, layout::SDO_REQUEST_ID, slcan::Port};
use trueup_machine::{MachineFile, compile};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_store::calibration::decode;

const MACHINE: &str = include_str!("../../../../../data/paper_spindle.toml");

/// The switches by which a test acts on the bridge, and what it notes.
#[derive(Clone, Default)]
pub struct Switches {
    /// Its CNC wants no offsets.
    pub is_disengaged: Arc<AtomicBool>,
    /// It is off: no client is served.
    pub is_off: Arc<AtomicBool>,
    /// Frames of clients that are anything but a question for an object.
    pub written: Arc<Mutex<Vec<Frame>>>,
    /// By how many ms this computer held it up at most.
    pub late_ms: Arc<AtomicU64>,
}

/// Starts a bridge; returns its address.
pub fn start(switches: Switches) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = format!("tcp:{}", listener.local_addr().expect("bound"));
    listener.set_nonblocking(true).expect("a socket");
    thread::spawn(move || live(&listener, &switches));
    address
}

fn live(listener: &TcpListener, switches: &Switches) {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the project's own");
    let blob: &'static [u8] = Box::leak(compile(&machine).expect("it fits").blob().into());
    let calibration = decode(blob).expect("a calibration");
    let mut node = Node::new(NodeConfiguration { blob, ..calibration.into() });
    let mut port = Port::new(1);
    let codes: [AdcCode; CODES_PER_TICK] = std::array::from_fn(|n| AdcCode(727 + (n % 2) as u16));
    let (start, mut control, mut client) = (Instant::now(), 0_u32, None::<TcpStream>);
    for ms in 0_u32.. {
        let due = Duration::from_millis(ms.into());
        thread::sleep(due.saturating_sub(start.elapsed()));
        let late = start.elapsed().saturating_sub(due).as_millis() as u64;
        switches.late_ms.fetch_max(late, Ordering::Relaxed);
        if switches.is_off.load(Ordering::Relaxed) {
            client = None;
        } else if let Ok((stream, _)) = listener.accept() {
            stream.set_nonblocking(true).expect("a socket");
            stream.set_nodelay(true).expect("a socket");
            (client, port) = (Some(stream), Port::new(1));
        }
        let mut bytes = [0; 512];
        let read = client.as_mut().map(|client| client.read(&mut bytes));
        match read {
            Some(Ok(0)) => client = None,
            Some(Ok(length)) => {
                for frame in bytes[..length].iter().filter_map(|&byte| port.receive(byte)) {
                    // The commands of an upload: its start, and its segments.
                    let is_question = matches!(frame.data()[0], 0x40 | 0x60 | 0x70);
                    if frame.id() != SDO_REQUEST_ID || !is_question {
                        switches.written.lock().expect("whole").push(frame);
                    }
                    node.receive(Interface::Serial, &frame).ok();
                }
            }
            Some(Err(error)) if error.kind() != ErrorKind::WouldBlock => client = None,
            _ => {}
        }
        if ms % 20 == 0 {
            let requests = control >= 3 && !switches.is_disengaged.load(Ordering::Relaxed);
            let command = Control { engage: requests, ..Control::REFERENCED };
            node.receive(Interface::Can, &frames::encode_control(command, control as u8))
                .expect("in order");
            for axis in LinearAxis::ALL {
                let at = AxisPosition {
                    axis,
                    position: Position(0),
                    direction: TravelDirection::Positive,
                };
                node.receive(Interface::Can, &frames::encode_position(at, control as u8))
                    .expect("in order");
            }
            control += 1;
        }
        let speed = Some(Rpm(24_000));
        let sent = node.tick(1, TickInput { codes: Some(&codes), speed, ..TickInput::default() });
        for frame in sent.into_iter().chain(node.next_service_frame()) {
            port.send(&frame);
        }
        let waiting: Vec<u8> = std::iter::from_fn(|| port.pop()).collect();
        if client.as_mut().is_some_and(|client| client.write_all(&waiting).is_err()) {
            client = None;
        }
    }
}
