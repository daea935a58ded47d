//! A board with two firmware slots that runs in this process: the node of the firmware, the decisions of its boot program,
//! and both flashes in RAM. Its clock is this computer's.

use std::{
    fs,
    io::{ErrorKind, Read as _},
    net::TcpListener,
    path::Path,
    sync::{Arc, Mutex},
    thread,
    time::Duration,
};

use trueup_boot::{
    flash_layout::{SLOT_SIZE, Slot},
    handover::StartInfo,
    image_header::FirmwareVersion,
    journal::Journal,
    public_key::PublicKey,
    reject_reason::FirmwareRejectReason,
    start::{ClockSpeed, StartOutcome, StartSelection, select_image},
    update::{self, ImageUpdate},
};
use trueup_core::{bridge::TickInput, cnc::Control};
use trueup_emulator::slot_images::build_signed_update;
use trueup_link::{frames, layout::SDO_RESPONSE_ID, slcan::Port};
use trueup_node::node::{
    Interface, Node,
    firmware_update::{FirmwareChunk, SlotStates, UpdateStep},
};
use trueup_signature::PrivateKey;
use trueup_store::simulated_nor_flash::SimulatedNorFlash;

use crate::{
    pretended::{paper, started},
    wire::{Tools, write_all},
};

type Records = SimulatedNorFlash<4096>;
type SlotFlash = SimulatedNorFlash<{ SLOT_SIZE as usize }>;

/// Bytes of an image of these tests behind its header.
pub const BODY: usize = 2_100;
/// Bytes of its file for one slot.
pub const PART: usize = 512 + BODY;

/// The version 1.`minor`.0.
pub fn version(minor: u8) -> FirmwareVersion {
    FirmwareVersion::new(1, minor, 0, 0)
}

/// Returns the key of the board's maker.
pub fn maker() -> PrivateKey {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../data/keys/development.pem");
    PrivateKey::from_pem(&fs::read_to_string(path).expect("the key")).expect("a key")
}

/// Returns the file for one slot.
pub fn part(slot: Slot, minor: u8, key: &PrivateKey) -> Vec<u8> {
    let body: Vec<u8> = (0..BODY).map(|at| (at % 251) as u8 ^ minor ^ slot.number()).collect();
    build_signed_update(&body, slot, version(minor), version(0), key)
}

/// Returns the file for both.
pub fn both(minor: u8) -> Vec<u8> {
    let key = maker();
    [part(Slot::A, minor, &key), part(Slot::B, minor, &key)].concat()
}

/// The board and its line, as a test wants them.
#[derive(Clone, Copy, Default)]
pub struct Setup {
    /// It runs firmware 1.1.0 from slot B on trial; else 1.1.0 from slot A, confirmed, and B is blank.
    pub is_on_trial: bool,
    /// Its firmware has no slots.
    pub has_no_slots: bool,
    /// A CNC is there that does not set `Service`.
    pub has_cnc: bool,
    /// It is deaf and silent while it erases.
    pub erase: Duration,
    /// The line breaks, once, when this many bytes of a new firmware have come.
    pub cut_at: Option<u32>,
    /// The first answer to a block behind this many bytes of a new firmware is lost.
    pub lost_answer_at: Option<u32>,
    /// A new firmware crashes as soon as it runs.
    pub crashes: bool,
}

/// Events at the board, counted for the test.
#[derive(Default)]
pub struct Seen {
    /// Bytes of images, without headers, that have come, in all updates.
    pub written: usize,
    /// Erases of a slot.
    pub erases: usize,
    /// Bytes of the new firmware that it has.
    pub received: u32,
    /// Content of both slots.
    pub flash: Vec<u8>,
}

/// Returns the port of a board, and what it sees.
pub fn board(setup: Setup) -> (String, Arc<Mutex<Seen>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = format!("tcp:{}", listener.local_addr().expect("bound above"));
    listener.set_nonblocking(true).expect("a plain socket");
    let seen = Arc::new(Mutex::new(Seen::default()));
    let shared = seen.clone();
    thread::spawn(move || {
        Board::new(setup).live(Tools { listener, stream: None }, &shared);
    });
    (port, seen)
}

struct Board {
    setup: Setup,
    node: Node<'static>,
    port: Port,
    journal: Journal<Records>,
    slots: SlotFlash,
    key: PublicKey,
    running: StartSelection,
    update: Option<ImageUpdate>,
}

impl Board {
    fn new(setup: Setup) -> Self {
        let key = PublicKey::new(&maker().public_key().to_bytes()).expect("a key");
        let mut journal = Journal::open(Records::erased());
        let mut slots = SlotFlash::erased();
        slots.bytes[..PART].copy_from_slice(&part(Slot::A, 1, &maker()));
        let mut running = boot(&mut journal, &mut slots, &key, StartOutcome::PowerCycle);
        update::confirm(&mut journal, &running.image).expect("room");
        running = boot(&mut journal, &mut slots, &key, StartOutcome::PowerCycle);
        if setup.is_on_trial {
            let start = SLOT_SIZE as usize;
            slots.bytes[start..start + PART].copy_from_slice(&part(Slot::B, 2, &maker()));
            running = boot(&mut journal, &mut slots, &key, StartOutcome::PowerCycle);
            assert_eq!(running.image.header.slot, Slot::B);
        }
        let (node, port) = started(Box::leak(paper().blob().into()));
        let mut board = Self { setup, node, port, journal, slots, key, running, update: None };
        board.set_slots();
        board
    }

    fn set_slots(&mut self) {
        if self.setup.has_no_slots {
            return;
        }
        let state = self.journal.state();
        let images = Slot::ALL.map(|slot| {
            trueup_boot::image_check::read_header(&mut self.slots, slot, state.floor).ok()
        });
        let status = Slot::ALL.map(|slot| {
            state.status(slot, slot.element_of(&images).map_or(0, |image| image.tag)).encode()
        });
        let versions = images.map(|image| image.map_or(0, |image| image.header.version.0));
        let running = self.running.image.header.slot.number();
        let choice = StartInfo::from(&self.running).encode();
        self.node.set_slot_states(SlotStates {
            running,
            versions,
            status,
            floor: state.floor.0,
            choice,
        });
    }

    fn take(
        &mut self,
        step: UpdateStep,
        piece: &FirmwareChunk,
    ) -> Result<(), FirmwareRejectReason> {
        let Self { journal, slots, .. } = self;
        match step {
            UpdateStep::Begin => {
                self.update = None;
                let header = piece.first_chunk().expect("512 bytes");
                self.update =
                    Some(ImageUpdate::begin(journal, slots, &self.running.image, header)?);
            }
            UpdateStep::Write => {
                self.update.as_mut().expect("under way").append(slots, piece)?;
            }
            UpdateStep::Finish => {
                let update = self.update.take().expect("under way");
                update.finish(journal, slots, &self.key, || ())?;
            }
        }
        Ok(())
    }

    fn restart(&mut self) {
        update::announce_reset(&mut self.journal, &self.running.image).expect("room");
        let before = self.running.image.header.slot;
        let boot = |board: &mut Self, ending| {
            boot(&mut board.journal, &mut board.slots, &board.key, ending)
        };
        self.running = boot(self, StartOutcome::Reset);
        if self.setup.crashes && self.running.image.header.slot != before {
            self.running = boot(self, StartOutcome::Reset);
        }
        (self.node, self.port) = started(Box::leak(self.node.calibration_blob().into()));
        self.set_slots();
    }

    fn live(mut self, mut tools: Tools, seen: &Mutex<Seen>) {
        let mut bytes = [0; 256];
        let mut received = 0;
        for ms in 0_u32.. {
            thread::sleep(Duration::from_millis(1));
            match tools.read(&mut bytes) {
                Ok(length) => self.receive(&bytes[..length]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(_) => tools.stream = None,
            }
            if self.setup.has_cnc && ms % 20 == 0 {
                let control = frames::encode_control(Control::REFERENCED, (ms / 20) as u8);
                self.node.receive(Interface::Can, &control).expect("in order");
            }
            let mut piece = FirmwareChunk::new();
            while let Some(step) = self.node.take_firmware_step(&mut piece) {
                let is_begin = step == UpdateStep::Begin;
                let outcome = self.take(step, &piece);
                if is_begin && outcome.is_ok() {
                    seen.lock().expect("no holder panics").erases += 1;
                    thread::sleep(self.setup.erase);
                    while tools.read(&mut bytes).is_ok_and(|length| length > 0) {}
                }
                received = match (step, &outcome) {
                    (UpdateStep::Begin, Ok(())) => 512,
                    (UpdateStep::Write, Ok(())) => received + piece.len() as u32,
                    (UpdateStep::Finish, Ok(())) => received,
                    (_, Err(_)) => 0,
                };
                self.set_slots();
                self.node.finish_firmware_step(step, outcome.map_err(FirmwareRejectReason::number));
                let mut seen = seen.lock().expect("no holder panics");
                if step == UpdateStep::Write {
                    seen.written += piece.len();
                }
                seen.received = received;
                seen.flash.clone_from(&self.slots.bytes);
            }
            if self.node.take_restart_request() {
                self.restart();
            }
            if self.setup.cut_at.is_some_and(|at| received >= at) {
                (tools.stream, self.setup.cut_at) = (None, None);
            }
            let offsets = self.node.tick(1, TickInput::default());
            for frame in
                offsets.into_iter().chain(self.node.next_service_frame()).collect::<Vec<_>>()
            {
                let is_answer =
                    frame.id() == SDO_RESPONSE_ID && matches!(frame.data()[0], 0xA1 | 0xA2);
                if is_answer && self.setup.lost_answer_at.is_some_and(|at| received >= at) {
                    self.setup.lost_answer_at = None;
                    continue;
                }
                self.port.send(&frame);
            }
            let answer: Vec<u8> = std::iter::from_fn(|| self.port.pop()).collect();
            if write_all(&mut tools, &answer).is_err() {
                tools.stream = None;
            }
        }
    }

    fn receive(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let Some(frame) = self.port.receive(*byte) else { continue };
            // A tool that comes back counts its `Control` from 0.
            self.node.receive(Interface::Serial, &frame).ok();
        }
    }
}

/// The boot program: returns the start that it chooses.
fn boot(
    journal: &mut Journal<Records>,
    slots: &mut SlotFlash,
    key: &PublicKey,
    ending: StartOutcome,
) -> StartSelection {
    select_image(journal, slots, key, ending, ClockSpeed::Full, || ()).expect("an image holds")
}
