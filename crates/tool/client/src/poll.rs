//! An object that is requested again and again while frames flow by, so that none of them is missed.
//!
//! The bridge serves one client of its objects at a time. Where another one is served (a master that
//! loads), nothing is requested until that one has been silent for five seconds.

use std::time::{Duration, Instant};

use trueup_canopen::sdo::client::{ObjectAddress, TransferProgress, Upload};
use trueup_link::{
    frame::Frame,
    layout::{SDO_REQUEST_ID, SDO_RESPONSE_ID},
};

/// An answer that takes longer than this is given up: a bridge answers within 10 ms.
const RESPONSE_TIMEOUT: Duration = Duration::from_millis(500);
/// The pause after another client's transfer: longer than a calibration takes to be stored.
const BACKOFF_DELAY: Duration = Duration::from_secs(5);

/// The result of a received frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PollOutcome {
    /// Nothing of this object.
    Nothing,
    /// This is to be sent.
    Request(Frame),
    /// The object's bytes.
    Bytes(Vec<u8>),
    /// The bridge does not give it.
    Rejected,
}

/// One object, and when it is requested next.
#[derive(Debug)]
pub struct ObjectPoller {
    at: ObjectAddress,
    period: Duration,
    due: Instant,
    running: Option<(Upload, Vec<u8>, Instant)>,
}

impl ObjectPoller {
    /// Requests the object `at` every `period`, from now on.
    #[must_use]
    pub fn new(at: ObjectAddress, period: Duration, now: Instant) -> Self {
        Self { at, period, due: now, running: None }
    }

    /// Returns the request, if one is due.
    pub fn take_due_request(&mut self, now: Instant) -> Option<Frame> {
        if self
            .running
            .as_ref()
            .is_some_and(|(_, _, last)| now.duration_since(*last) > RESPONSE_TIMEOUT)
        {
            self.running = None;
            // What is requested once an hour is not to be missed for the hour.
            self.due = self.due.min(now);
        }
        if self.running.is_some() || now < self.due {
            return None;
        }
        self.due = now + self.period;
        let (upload, first) = Upload::start(self.at);
        self.running = Some((upload, Vec::new(), now));
        Some(first)
    }

    /// Takes a frame from the bus.
    pub fn receive(&mut self, frame: &Frame, now: Instant) -> PollOutcome {
        let is_of_sdo = [SDO_RESPONSE_ID, SDO_REQUEST_ID].contains(&frame.id());
        let Some((upload, bytes, last)) = &mut self.running else {
            if is_of_sdo {
                self.due = now + BACKOFF_DELAY;
            }
            return PollOutcome::Nothing;
        };
        match upload.receive(frame, bytes) {
            Ok(TransferProgress::Unchanged) => {
                if is_of_sdo {
                    self.running = None;
                    self.due = now + BACKOFF_DELAY;
                }
                PollOutcome::Nothing
            }
            Ok(TransferProgress::Request(request)) => {
                *last = now;
                PollOutcome::Request(request)
            }
            Ok(TransferProgress::Done) => {
                let bytes = std::mem::take(bytes);
                self.running = None;
                PollOutcome::Bytes(bytes)
            }
            Err(_) => {
                self.running = None;
                PollOutcome::Rejected
            }
        }
    }

    /// An answer is waited for.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Returns how much has come of how many bytes, while the object comes in parts.
    #[must_use]
    pub fn progress(&self) -> Option<(usize, u32)> {
        let (upload, bytes, _) = self.running.as_ref()?;
        Some((bytes.len(), upload.indicated_size()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: ObjectAddress = crate::sdo_object::ELONGATION;

    fn answer(data: [u8; 8]) -> Frame {
        Frame::new(SDO_RESPONSE_ID, &data).expect("eight bytes")
    }

    /// Returns an answer of the object that is asked for.
    fn own_answer(command: u8, [a, b, c, d]: [u8; 4]) -> Frame {
        let ([low, high], subindex) = (AT.0.to_le_bytes(), AT.1);
        answer([command, low, high, subindex, a, b, c, d])
    }

    #[test]
    fn an_object_is_asked_for_once_a_period_and_its_bytes_are_given() {
        let start = Instant::now();
        let period = Duration::from_millis(200);
        let mut poll = ObjectPoller::new(AT, period, start);
        assert!(poll.take_due_request(start).is_some_and(|frame| frame.id() == SDO_REQUEST_ID));
        assert_eq!(poll.take_due_request(start + period), None, "the answer has not come");
        let value = own_answer(0x43, [1, 2, 3, 4]);
        assert_eq!(poll.receive(&value, start), PollOutcome::Bytes(vec![1, 2, 3, 4]));
        assert_eq!(poll.take_due_request(start + period / 2), None);
        assert!(poll.take_due_request(start + period).is_some());
        // One that never comes is given up.
        assert_eq!(poll.take_due_request(start + 3 * period), None);
        assert!(poll.take_due_request(start + 6 * period).is_some());
        let abort = own_answer(0x80, [0, 0, 2, 6]);
        assert_eq!(poll.receive(&abort, start + 6 * period), PollOutcome::Rejected);
    }

    #[test]
    fn what_is_asked_for_once_is_asked_for_again_where_no_answer_comes() {
        let start = Instant::now();
        let mut poll = ObjectPoller::new(AT, Duration::from_secs(3_600), start);
        assert!(poll.take_due_request(start).is_some());
        assert_eq!(poll.take_due_request(start + RESPONSE_TIMEOUT), None);
        let late = start + 2 * RESPONSE_TIMEOUT;
        assert!(
            poll.take_due_request(late).is_some(),
            "a bridge that is slow to answer is asked again"
        );
        let value = own_answer(0x43, [1, 2, 3, 4]);
        assert_eq!(poll.receive(&value, late), PollOutcome::Bytes(vec![1, 2, 3, 4]));
        assert_eq!(poll.take_due_request(late + 4 * RESPONSE_TIMEOUT), None, "it has come");
    }

    #[test]
    fn who_is_served_meanwhile_is_not_disturbed() {
        let start = Instant::now();
        let mut poll = ObjectPoller::new(AT, Duration::from_millis(200), start);
        // A segment of another client's load is answered.
        assert_eq!(poll.receive(&answer([0x20, 0, 0, 0, 0, 0, 0, 0]), start), PollOutcome::Nothing);
        assert_eq!(poll.take_due_request(start + BACKOFF_DELAY / 2), None);
        assert!(poll.take_due_request(start + BACKOFF_DELAY).is_some());
        // Or while an answer of our own is waited for.
        poll.receive(&answer([0x60, 0, 0x21, 2, 0, 0, 0, 0]), start + BACKOFF_DELAY);
        assert_eq!(poll.take_due_request(start + BACKOFF_DELAY + RESPONSE_TIMEOUT), None);
    }
}
