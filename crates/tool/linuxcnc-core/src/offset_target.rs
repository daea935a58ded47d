//! Where the offsets are to go: from the bridge's frames, their age, and the lack of them.
//!
//! | what was received | the offset | `OffsetTarget` |
//! |---|---|---|
//! | a valid pair of frames, not older than `stale` | what it says, within the largest permitted | follow |
//! | none, or "not available" | stays where it is, for `hold` | hold |
//! | the same, after `hold` | goes to 0 | ramp out |
//!
//! Valid is what [`OffsetReceiver`] lets through: both frames whole, new, in order, of one cycle.

use core::time::Duration;

use trueup_core::cnc::{OffsetQuality, Output};
use trueup_link::{
    frame::Frame,
    receiver::{FrameCounters, OffsetReceiver},
};

/// A pair's counter comes round after 256 ms, so nothing older may count as fresh.
pub(crate) const MAX_FRESH_AGE: Duration = Duration::from_millis(250);

/// How long silence is tolerated, and how large an offset may be.
#[derive(Clone, Copy, Debug)]
pub struct OffsetLimits {
    /// The largest offset on X, Y and Z, in nanometres, either way.
    pub max_nm: [i32; 3],
    /// After this time without a valid pair the bridge counts as silent; at most `MAX_FRESH_AGE`.
    pub stale: Duration,
    /// How long the last offset is then held.
    pub hold: Duration,
}

/// The target of the offsets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OffsetTarget {
    /// Go to these offsets, in nanometres.
    Follow([i32; 3]),
    /// Keep the present offsets.
    Hold,
    /// Go to 0 at the rate of the limits.
    RampOut,
}

/// The bridge's offsets, as they are received: the newest valid pair and its age.
#[derive(Debug)]
pub(crate) struct ReceivedOffsets {
    receiver: OffsetReceiver,
    malformed_lines: u32,
    last: Option<(Duration, Output)>,
    /// When there was last something to follow; the start counts, so that a component that is
    /// started while offsets act does not take them back at once.
    followed: Duration,
    clamped: bool,
}

impl ReceivedOffsets {
    /// Nothing received yet, at this time.
    #[must_use]
    pub fn new(now: Duration) -> Self {
        let receiver = OffsetReceiver::new();
        Self { receiver, malformed_lines: 0, last: None, followed: now, clamped: false }
    }

    /// Takes a frame. Frames that must not be used are counted.
    pub fn receive(&mut self, now: Duration, frame: &Frame) {
        if let Ok(Some(output)) = self.receiver.accept(frame) {
            self.last = Some((now, output));
        }
    }

    /// Takes note of a line that was not a frame.
    pub(crate) fn count_malformed_line(&mut self) {
        self.malformed_lines = self.malformed_lines.saturating_add(1);
    }

    /// Returns the newest valid pair, unless it is stale.
    #[must_use]
    pub(crate) fn fresh_output(&self, now: Duration, limits: &OffsetLimits) -> Option<&Output> {
        let (received, output) = self.last.as_ref()?;
        (now.saturating_sub(*received) <= limits.stale.min(MAX_FRESH_AGE)).then_some(output)
    }

    /// Returns what the offsets are to do now.
    pub(crate) fn update_target(&mut self, now: Duration, limits: &OffsetLimits) -> OffsetTarget {
        let available = self.fresh_output(now, limits).and_then(|output| match output.quality {
            OffsetQuality::Fault => None,
            _ => output.offset,
        });
        self.clamped = false;
        if let Some(mut offset) = available.map(|offset| offset.map(|axis| axis.0)) {
            self.followed = now;
            for (offset, max) in offset.iter_mut().zip(limits.max_nm) {
                let held = (*offset).max(-max.max(0)).min(max.max(0));
                self.clamped |= held != *offset;
                *offset = held;
            }
            OffsetTarget::Follow(offset)
        } else if now.saturating_sub(self.followed) <= limits.hold {
            OffsetTarget::Hold
        } else {
            OffsetTarget::RampOut
        }
    }

    /// The newest valid pair had more than is permitted here.
    #[must_use]
    pub(crate) fn is_clamped(&self) -> bool {
        self.clamped
    }

    /// Milliseconds since the sample on which the newest offset rests; `None` before the first.
    #[must_use]
    pub fn age_ms(&self, now: Duration) -> Option<u32> {
        let (received, output) = self.last.as_ref()?;
        let waited = u32::try_from(now.saturating_sub(*received).as_millis()).unwrap_or(u32::MAX);
        Some(waited.saturating_add(output.age_ms.into()))
    }

    /// Returns what has arrived so far, in frames; lines that were none are among the malformed.
    #[must_use]
    pub fn counters(&self) -> FrameCounters {
        let counters = self.receiver.counters();
        FrameCounters {
            malformed: counters.malformed.saturating_add(self.malformed_lines),
            ..counters
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::{cnc::OffsetFlags, units::Nanometres};
    use trueup_link::frames::{encode_offset_xy, encode_offset_z};

    const LIMITS: OffsetLimits = OffsetLimits {
        max_nm: [200_000, 200_000, 500_000],
        stale: Duration::from_millis(100),
        hold: Duration::from_millis(2_000),
    };

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn receive_offset(
        offsets: &mut ReceivedOffsets,
        now: Duration,
        counter: u8,
        offset: Option<i32>,
    ) {
        let quality = if offset.is_some() { OffsetQuality::Live } else { OffsetQuality::Fault };
        let output = Output {
            offset: offset.map(|nm| [Nanometres(nm); 3]),
            quality,
            flags: OffsetFlags::NONE,
            age_ms: 3,
        };
        offsets.receive(now, &encode_offset_xy(&output, counter));
        offsets.receive(now, &encode_offset_z(&output, counter));
    }

    #[test]
    fn silence_holds_then_ramps_out_and_a_word_brings_it_back() {
        let mut offsets = ReceivedOffsets::new(ms(0));
        assert_eq!(offsets.update_target(ms(0), &LIMITS), OffsetTarget::Hold, "just started");
        receive_offset(&mut offsets, ms(1_000), 0, Some(50_000));
        assert_eq!(offsets.update_target(ms(1_100), &LIMITS), OffsetTarget::Follow([50_000; 3]));
        assert_eq!(offsets.age_ms(ms(1_100)), Some(103));
        assert_eq!(offsets.update_target(ms(1_101), &LIMITS), OffsetTarget::Hold);
        assert_eq!(offsets.update_target(ms(3_100), &LIMITS), OffsetTarget::Hold);
        assert_eq!(offsets.update_target(ms(3_101), &LIMITS), OffsetTarget::RampOut);
        receive_offset(&mut offsets, ms(9_000), 1, Some(40_000));
        assert_eq!(offsets.update_target(ms(9_000), &LIMITS), OffsetTarget::Follow([40_000; 3]));
    }

    #[test]
    fn not_available_is_held_as_silence_is() {
        let mut offsets = ReceivedOffsets::new(ms(0));
        receive_offset(&mut offsets, ms(10), 0, Some(1_000));
        offsets.update_target(ms(10), &LIMITS);
        for cycle in 1..=250_u8 {
            receive_offset(&mut offsets, ms(10 + 10 * u64::from(cycle)), cycle, None);
            let expected = if cycle <= 200 { OffsetTarget::Hold } else { OffsetTarget::RampOut };
            assert_eq!(offsets.update_target(ms(10 + 10 * u64::from(cycle)), &LIMITS), expected);
        }
    }

    #[test]
    fn damaged_and_repeated_frames_are_silence_and_are_counted() {
        let mut offsets = ReceivedOffsets::new(ms(0));
        receive_offset(&mut offsets, ms(10), 5, Some(1_000));
        receive_offset(&mut offsets, ms(100), 5, Some(9_000));
        assert_eq!(offsets.update_target(ms(100), &LIMITS), OffsetTarget::Follow([1_000; 3]));
        assert_eq!(offsets.counters().sequence_errors, 2);
        assert_eq!(offsets.update_target(ms(111), &LIMITS), OffsetTarget::Hold);
        let damaged = Frame::new(0x181, &[0; 8]).unwrap();
        offsets.receive(ms(112), &damaged);
        assert_eq!(offsets.counters().crc_errors, 1);
        offsets.count_malformed_line();
        assert_eq!(offsets.counters().malformed, 1);
    }

    #[test]
    fn more_than_permitted_is_held_to_the_limit_and_reported() {
        let mut offsets = ReceivedOffsets::new(ms(0));
        receive_offset(&mut offsets, ms(10), 0, Some(-300_000));
        let expected = OffsetTarget::Follow([-200_000, -200_000, -300_000]);
        assert_eq!(offsets.update_target(ms(10), &LIMITS), expected);
        assert!(offsets.is_clamped());
    }
}
