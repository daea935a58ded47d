//! How old what comes over a line can be, and whether what is sent arrives in time.
//!
//! A line can stall without being cut: a network, a proxy, a computer that stands still. Later it delivers all that
//! has waited, in order and whole, so protection and counters do not show it. Therefore the adapter is asked
//! something all the time (its version and its number in turn). Let q be the instant of the question whose answer
//! came last:
//!
//! ```text
//! what comes behind the answer was sent after q      a frame that comes at t is used while t − q ≤ limit of 200 ms
//! the question itself has arrived                    a frame is sent at t while t − q ≤ limit of 100 ms
//! either limit is at least 3 · the fastest answer    a bridge that is emulated on a busy computer lives slower
//! ```
//!
//! An answer that is lost is no proof; the next one is. Questions that a bridge lost while it restarted are never
//! answered: an answer counts for the earliest question that it can belong to, and the letter changes only when no
//! question with the other one is open, so after two answers it can belong to the newest alone. Where no adapter answers (a CAN interface) only the pace
//! is known: after a silence, what comes faster than the bridge sends has waited, and is not used until the pace
//! is right for two windows in a row; nothing is sent during a silence.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use trueup_link::{
    layout::{OFFSET_PERIOD_MS, OFFSET_Z_ID},
    slcan::AdapterMessage,
};

/// From one question to the next.
const QUERY_PERIOD: Duration = Duration::from_millis(20);
/// A frame that can be older than this is not used: twice the silence after which a bridge counts as lost.
pub(crate) const MAX_FRAME_AGE: Duration = Duration::from_millis(200);
/// Nothing is sent into a line that has not answered for this time: what is on its way into a line that stalls is executed
/// when it goes on, so it is to be little, five frames of `Control`.
const MAX_RESPONSE_AGE: Duration = Duration::from_millis(100);
/// Answers that may take longer than the fastest of a connection, times this.
const MAX_LATENCY_RATIO: u32 = 3;
/// Questions without an answer after which the next one waits for [`MAX_FRAME_AGE`]: a stalled line is not filled with them.
const MAX_PENDING_QUERIES: usize = 4;
/// An adapter that has not answered within this time after its first byte never will.
const FIRST_RESPONSE_TIMEOUT: Duration = Duration::from_secs(1);
/// Without an adapter: a silence after which what comes may have waited.
const SILENCE_THRESHOLD: Duration = Duration::from_millis(100);
/// Without an adapter: how long the pace is looked at, and how many windows have to be right.
const FRAME_RATE_WINDOW: Duration = Duration::from_millis(100);
const MIN_CONSECUTIVE_WINDOWS: u32 = 2;
/// Pairs of offset frames in a window that are still the bridge's own pace: a third more than it sends.
const MAX_PAIRS_PER_WINDOW: u32 = 4 * FRAME_RATE_WINDOW.as_millis() as u32 / OFFSET_PERIOD_MS / 3;
/// The questions, and the first letter of their answers.
const LATENCY_QUERIES: [(&[u8], u8); 2] = [(b"V\r", b'V'), (b"N\r", b'N')];

/// Times of the questions and answers of one connection.
#[derive(Debug, Default)]
pub(crate) struct LatencyMonitor {
    /// Requests without an answer: when they were sent, and which.
    requests: VecDeque<(Instant, usize)>,
    last_request: Option<Instant>,
    /// The request that was sent last.
    last: usize,
    /// When the request was sent whose answer came last.
    proven: Option<Instant>,
    fastest: Option<Duration>,
    first_byte: Option<Instant>,
    last_byte: Option<Instant>,
    pace: FrameRateMonitor,
}

/// How many offset frames come.
#[derive(Debug, Default)]
struct FrameRateMonitor {
    began: Option<Instant>,
    frames: u32,
    windows_in_step: u32,
}

impl FrameRateMonitor {
    /// Takes an offset frame.
    fn count_frame(&mut self, now: Instant) {
        let began = *self.began.get_or_insert(now);
        if now.saturating_duration_since(began) >= FRAME_RATE_WINDOW {
            let is_in_step = self.frames <= MAX_PAIRS_PER_WINDOW;
            self.windows_in_step = if is_in_step { self.windows_in_step + 1 } else { 0 };
            (self.began, self.frames) = (Some(now), 0);
        }
        self.frames = self.frames.saturating_add(1);
    }
}

impl LatencyMonitor {
    /// Returns the line to be written now, if a question is due.
    pub(crate) fn next_query(&mut self, now: Instant) -> Option<&'static [u8]> {
        let waits =
            if self.requests.len() < MAX_PENDING_QUERIES { QUERY_PERIOD } else { MAX_FRAME_AGE };
        if self
            .last_request
            .is_some_and(|requested| now.saturating_duration_since(requested) < waits)
        {
            return None;
        }
        self.last_request = Some(now);
        let other = 1 - self.last;
        if self.requests.iter().all(|(_, which)| *which != other) {
            self.last = other;
        }
        self.requests.push_back((now, self.last));
        Some(LATENCY_QUERIES[self.last].0)
    }

    /// Takes note that bytes have come.
    pub(crate) fn record_reception(&mut self, now: Instant) {
        self.first_byte.get_or_insert(now);
        let before = self.last_byte.replace(now);
        if before.is_none_or(|before| now.saturating_duration_since(before) > SILENCE_THRESHOLD) {
            self.pace = FrameRateMonitor::default();
        }
    }

    /// Takes what has come, and returns whether it is to be used.
    pub fn accept(&mut self, now: Instant, event: &AdapterMessage) -> bool {
        match event {
            AdapterMessage::Other(line) => {
                self.record_response(now, line);
                true
            }
            AdapterMessage::Frame(frame) => {
                if frame.id() == OFFSET_Z_ID {
                    self.pace.count_frame(now);
                }
                self.is_fresh(now)
            }
            _ => true,
        }
    }

    fn record_response(&mut self, now: Instant, line: &[u8]) {
        let Some(letter) = line.first() else { return };
        let place =
            self.requests.iter().position(|(_, which)| LATENCY_QUERIES[*which].1 == *letter);
        // Answers come in the order of their questions: those before it are lost.
        let Some((requested, _)) =
            place.and_then(|place| self.requests.drain(..=place).next_back())
        else {
            return;
        };
        let took = now.saturating_duration_since(requested);
        self.proven = Some(requested);
        self.fastest = Some(self.fastest.map_or(took, |fastest| fastest.min(took)));
    }

    /// Returns whether what comes now was sent a moment ago.
    pub fn is_fresh(&self, now: Instant) -> bool {
        if self.is_adapter_missing(now) {
            self.pace.windows_in_step >= MIN_CONSECUTIVE_WINDOWS
        } else {
            self.is_responsive(now, MAX_FRAME_AGE)
        }
    }

    /// Returns whether what is sent now arrives in a moment, as far as can be known.
    pub(crate) fn can_send(&self, now: Instant) -> bool {
        let is_received = self
            .last_byte
            .is_some_and(|last| now.saturating_duration_since(last) <= SILENCE_THRESHOLD);
        if self.is_adapter_missing(now) {
            is_received
        } else {
            self.is_responsive(now, MAX_RESPONSE_AGE)
        }
    }

    fn is_responsive(&self, now: Instant, limit: Duration) -> bool {
        let limit = self.fastest.map_or(limit, |fastest| limit.max(MAX_LATENCY_RATIO * fastest));
        self.proven.is_some_and(|requested| now.saturating_duration_since(requested) <= limit)
    }

    /// Returns whether no adapter answers here.
    fn is_adapter_missing(&self, now: Instant) -> bool {
        let received_for = self.first_byte.map(|first| now.saturating_duration_since(first));
        self.fastest.is_none()
            && received_for.is_some_and(|elapsed| elapsed > FIRST_RESPONSE_TIMEOUT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_link::{
        frame::Frame,
        slcan::{Port, SlcanClient},
    };

    const MS: Duration = Duration::from_millis(1);

    fn offset() -> AdapterMessage {
        AdapterMessage::Frame(Frame::new(OFFSET_Z_ID, &[0; 8]).expect("a frame"))
    }

    /// Returns a line on which each way takes `delay`, and which stands still from 1 s to `until`: how many of the
    /// offset frames of each are used, by how old they are when they come, in ms; and the age of what is sent.
    fn play(
        delay: Duration,
        until: Duration,
        answers: bool,
    ) -> (Vec<u128>, Vec<u128>, LatencyMonitor) {
        let start = Instant::now();
        let at = |ms: u32| start + ms * MS;
        let arrives = |sent: Instant| {
            let is_stalled = sent + delay > at(1_000) && sent + delay < start + until;
            if is_stalled { start + until } else { sent + delay }
        };
        let mut dating = LatencyMonitor::default();
        let (mut down, mut up) = (VecDeque::new(), VecDeque::new());
        let (mut used, mut sent) = (Vec::new(), Vec::new());
        let (mut port, mut client) = (Port::new(7), SlcanClient::new());
        for ms in 0..8_000 {
            let now = at(ms);
            down.push_back((now, arrives(now), offset()));
            if let Some(line) = dating.next_query(now) {
                up.push_back((arrives(now), line));
            }
            while up.front().is_some_and(|(arrives, _)| *arrives <= now) {
                let (_, line) = up.pop_front().expect("looked at");
                for byte in line {
                    port.receive(*byte);
                }
                let bytes: Vec<u8> = std::iter::from_fn(|| port.pop()).collect();
                for event in bytes.iter().filter_map(|byte| client.receive(*byte)) {
                    if answers {
                        down.push_back((now, arrives(now), event));
                    }
                }
            }
            if down.front().is_some_and(|(_, arrives, _)| *arrives <= now) {
                dating.record_reception(now);
            }
            while down.front().is_some_and(|(_, arrives, _)| *arrives <= now) {
                let (was_sent, _, event) = down.pop_front().expect("looked at");
                if dating.accept(now, &event) && matches!(event, AdapterMessage::Frame(_)) {
                    used.push((now - was_sent).as_millis());
                }
            }
            if dating.can_send(now) {
                sent.push((arrives(now) - now).as_millis());
            }
        }
        (used, sent, dating)
    }

    #[test]
    fn of_a_line_that_stalled_nothing_old_is_used_and_it_is_used_again_at_once() {
        for (delay, stall_ms) in [(MS, 5_000), (MS, 700), (20 * MS, 5_000), (MS, 250)] {
            let (used, sent, _) = play(delay, 1_000 * MS + stall_ms * MS, true);
            let oldest = used.iter().max().copied().unwrap_or_default();
            assert!(oldest <= MAX_FRAME_AGE.as_millis(), "{delay:?}, {stall_ms}: {oldest} ms");
            // All that came in time, but for the stall and a few answers.
            let least = 8_000 - stall_ms as usize - 400;
            assert!(used.len() >= least, "{delay:?}, {stall_ms}: {} used", used.len());
            // What was sent before the stall can be known is on its way; nothing is added to it.
            let late = sent.iter().filter(|age| **age > MAX_FRAME_AGE.as_millis()).count();
            assert!(
                late <= MAX_RESPONSE_AGE.as_millis() as usize,
                "{delay:?}, {stall_ms}: {late} sent late"
            );
        }
    }

    #[test]
    fn a_line_that_is_in_time_loses_nothing_however_slow_its_answers_are() {
        for delay in [MS, 30 * MS, 300 * MS] {
            let (used, sent, _) = play(delay, Duration::ZERO, true);
            let most = 8_000 - 3 * delay.as_millis() as usize - 10;
            assert!(used.len() >= most && sent.len() >= most, "{delay:?}: {}", used.len());
        }
    }

    /// A board that is reset behind a line that stays open.
    #[test]
    fn questions_that_were_lost_in_a_restart_do_not_age_the_answers_after_it() {
        for lost_ms in [30, 90, 300, 3_000, 60_000] {
            let start = Instant::now();
            let (mut dating, mut client) = (LatencyMonitor::default(), SlcanClient::new());
            let mut stale_until = 0;
            for ms in 0..lost_ms + 3_000 {
                let now = start + ms * MS;
                let Some(question) = dating.next_query(now) else { continue };
                if !(1_000..1_000 + lost_ms).contains(&ms) {
                    client.receive(question[0]);
                    let answer = client.receive(b'\r').expect("a line");
                    dating.accept(now + MS, &answer);
                }
                if ms > 1_000 + lost_ms && !dating.is_fresh(now + MS) {
                    stale_until = ms - lost_ms - 1_000;
                }
            }
            println!("{lost_ms} ms lost: in time again after {stale_until} ms");
            assert!(
                stale_until <= 3 * MAX_FRAME_AGE.as_millis() as u32,
                "{lost_ms}: {stale_until}"
            );
        }
    }

    #[test]
    fn without_an_adapter_a_burst_is_not_used() {
        let (used, sent, _) = play(MS, 6_000 * MS, false);
        let oldest = used.iter().max().copied().unwrap_or_default();
        assert!(oldest <= SILENCE_THRESHOLD.as_millis(), "{oldest} ms");
        assert!(used.len() > 1_500, "{} used", used.len());
        let late = sent.iter().filter(|age| **age > SILENCE_THRESHOLD.as_millis()).count();
        assert!(late <= SILENCE_THRESHOLD.as_millis() as usize, "{late} sent late");
    }

    #[test]
    fn an_answer_that_is_lost_costs_no_more_than_itself() {
        let start = Instant::now();
        let mut dating = LatencyMonitor::default();
        let answer = |letter: u8| {
            let mut client = SlcanClient::new();
            client.receive(letter);
            client.receive(b'\r').expect("a line")
        };
        for turn in 0..20_u32 {
            let now = start + turn * QUERY_PERIOD;
            let question = dating.next_query(now).expect("due");
            // Each third is lost.
            if turn % 3 != 1 {
                dating.accept(now + MS, &answer(question[0]));
                assert!(dating.is_fresh(now + MS), "turn {turn}");
            }
        }
        assert!(dating.requests.len() < MAX_PENDING_QUERIES, "{:?}", dating.requests);
    }
}
