//! Collects the frames of a bridge: frames come in, a [`BridgeSnapshot`] comes out, and now and then a question to the
//! bridge who it is. Nothing is written to the bridge.

use std::time::{Duration, Instant};

use trueup_client::{
    cnc::CncState,
    connection::ConnectionEvent,
    poll::{ObjectPoller, PollOutcome},
    sdo_object::{self, ObjectAddress},
    state_text::{flag_names, offset_um},
    status::BoardStatus,
};
use trueup_core::cnc::{OffsetQuality, Output};
use trueup_link::{
    frame::Frame,
    frames::{self, NmtState as NodeState},
    receiver::OffsetReceiver,
    slcan::AdapterMessage,
    status::StatusItem,
};
use trueup_output::escape::escape_line;

use crate::snapshot::{BridgeIdentity, BridgeSnapshot};

/// Offsets older than this are not of now: a thousand cycles.
const MAX_OFFSET_AGE: Duration = Duration::from_secs(1);
/// Each item of the status comes every 1.5 s; three missed, and all of it counts as unknown.
const MAX_STATUS_AGE: Duration = Duration::from_millis(4_600);
/// An answered request is sent again after this: a bridge may be exchanged while the line stays.
const IDENTITY_POLL_INTERVAL: Duration = Duration::from_secs(600);
/// The questions, in this order, one after the other.
const IDENTITY_OBJECTS: [ObjectAddress; 3] =
    [sdo_object::SERIAL_NUMBER, sdo_object::MACHINE_NAME, sdo_object::SOFTWARE_VERSION];
/// Maximum length of a name, in bytes.
const MAX_IDENTITY_TEXT_BYTES: usize = 64;

/// A bridge, as far as it is known.
pub struct BridgeMonitor {
    start: Instant,
    board: BoardStatus,
    offsets: OffsetReceiver,
    lost_before: u32,
    output: Option<(Output, Instant)>,
    status_at: Option<Instant>,
    cnc: CncState,
    is_open: bool,
    why: Option<String>,
    identity: BridgeIdentity,
    polls: [ObjectPoller; IDENTITY_OBJECTS.len()],
    starts: u32,
}

impl BridgeMonitor {
    /// Returns a bridge that has sent nothing yet.
    #[must_use]
    pub fn new(now: Instant) -> Self {
        Self {
            start: now,
            board: BoardStatus::default(),
            offsets: OffsetReceiver::new(),
            lost_before: 0,
            output: None,
            status_at: None,
            cnc: CncState::default(),
            is_open: false,
            why: None,
            identity: BridgeIdentity::default(),
            polls: IDENTITY_OBJECTS.map(|at| ObjectPoller::new(at, IDENTITY_POLL_INTERVAL, now)),
            starts: 0,
        }
    }

    /// Takes what happened on the line, and returns what is to be sent, if anything.
    pub fn receive(&mut self, event: ConnectionEvent, now: Instant) -> Option<Frame> {
        match event {
            ConnectionEvent::Up => {
                self.is_open = true;
                self.restart_polls(now);
            }
            ConnectionEvent::Down(why) => {
                self.lost_before = self.lost_frame_count();
                self.is_open = false;
                self.why = Some(why);
                self.board = BoardStatus::default();
                self.offsets = OffsetReceiver::new();
                (self.output, self.status_at) = (None, None);
            }
            ConnectionEvent::Received(AdapterMessage::Frame(frame)) => {
                return self.handle_frame(&frame, now);
            }
            ConnectionEvent::Received(_) | ConnectionEvent::Late => {}
        }
        None
    }

    fn handle_frame(&mut self, frame: &Frame, now: Instant) -> Option<Frame> {
        if let Ok(Some(output)) = self.offsets.accept(frame) {
            (self.output, self.why) = (Some((output, now)), None);
            return None;
        }
        // The state comes last of all that is waited for after a start.
        if let Some(StatusItem::State(_)) = self.board.receive(frame) {
            self.status_at = Some(now);
        }
        let ms = now.saturating_duration_since(self.start).as_millis();
        self.cnc.receive(frame, u64::try_from(ms).unwrap_or(u64::MAX));
        if frames::decode_heartbeat(frame) == Ok(NodeState::BootUp) {
            self.starts = self.starts.saturating_add(1);
            self.restart_polls(now);
        }
        self.handle_response(frame, now)
    }

    /// Returns the next part of an answer's question.
    fn handle_response(&mut self, frame: &Frame, now: Instant) -> Option<Frame> {
        let running = self.polls.iter().position(ObjectPoller::is_running)?;
        match self.polls[running].receive(frame, now) {
            PollOutcome::Request(request) => Some(request),
            PollOutcome::Bytes(bytes) => {
                let text = || {
                    let text =
                        String::from_utf8_lossy(&bytes[..bytes.len().min(MAX_IDENTITY_TEXT_BYTES)]);
                    Some(escape_line(text.trim_end_matches('\0'))).filter(|text| !text.is_empty())
                };
                match running {
                    0 => {
                        self.identity.serial = bytes.first_chunk().copied().map(u32::from_le_bytes)
                    }
                    1 => self.identity.machine = text(),
                    _ => self.identity.firmware = text(),
                }
                None
            }
            PollOutcome::Rejected | PollOutcome::Nothing => None,
        }
    }

    fn restart_polls(&mut self, now: Instant) {
        self.polls = IDENTITY_OBJECTS.map(|at| ObjectPoller::new(at, IDENTITY_POLL_INTERVAL, now));
    }

    /// Returns the question that is due, if any; one at a time.
    pub fn take_due_request(&mut self, now: Instant) -> Option<Frame> {
        if !self.is_open {
            return None;
        }
        for poll in &mut self.polls {
            if let Some(request) = poll.take_due_request(now) {
                return Some(request);
            }
            if poll.is_running() {
                return None;
            }
        }
        None
    }

    fn lost_frame_count(&self) -> u32 {
        self.lost_before.saturating_add(self.offsets.counters().lost)
    }

    /// Returns what is known now.
    #[must_use]
    pub fn snapshot(&self, now: Instant) -> BridgeSnapshot {
        let is_fresh = |at: Instant, lasts| now.saturating_duration_since(at) <= lasts;
        let output =
            self.output.as_ref().filter(|(_, at)| self.is_open && is_fresh(*at, MAX_OFFSET_AGE));
        let mut snapshot = BridgeSnapshot {
            is_up: output.is_some(),
            why: self.why.clone(),
            identity: self.identity.clone(),
            lost_frames: self.lost_frame_count(),
            starts: self.starts,
            ..BridgeSnapshot::default()
        };
        let Some((output, _)) = output else { return snapshot };
        snapshot.quality = Some(output.quality);
        snapshot.flags = flag_names(output.flags);
        if output.quality != OffsetQuality::Fault {
            snapshot.offset_um =
                offset_um(output).map_or([None; 3], |offset_um| offset_um.map(Some));
        }
        let ms = now.saturating_duration_since(self.start).as_millis();
        snapshot.position_mm = self.cnc.position_mm(u64::try_from(ms).unwrap_or(u64::MAX));
        if self.status_at.is_some_and(|at| is_fresh(at, MAX_STATUS_AGE)) {
            let celsius = |centi_c: i16| f64::from(centi_c) / 100.0;
            snapshot.temperature_c = self.board.centi_c.map(|centi_c| centi_c.map(celsius));
            snapshot.elongation_um = self.board.elongation_um();
            snapshot.has_status = true;
            snapshot.faults = self.board.fault_names();
            snapshot.state = trueup_client::state_text::state_names(self.board.state);
            snapshot.calibration = self.board.calibration;
        }
        snapshot
    }
}
