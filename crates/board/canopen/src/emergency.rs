//! Emergencies (CiA 301): every fault of the bridge is reported once when it comes and once when it has
//! gone.
//!
//! | bytes | content |
//! |---|---|
//! | 0–1 | error code, see [`Fault::code`]; 0x0000: the fault of byte 3 has gone |
//! | 2 | error register, of what is left: bit 0 any fault, bit 2 the supply, bit 4 communication, bit 7 the board |
//! | 3 | which fault: its place in [`Fault::ALL`] |
//! | 4 | the flags, as in `OffsetZ` |
//! | 5 | the quality, as in `OffsetZ` |
//! | 6–7 | 0 |
//!
//! Between two emergencies at least the inhibit time passes. A fault that comes and goes meanwhile
//! is reported all the same, so a flickering one costs no more of the bus than a lasting one, and none
//! is overlooked.

use trueup_core::cnc::{OffsetFlags, OffsetQuality, Output};
use trueup_link::{
    frame::Frame,
    frames::{self, DecodeError},
    layout::{
        EMERGENCY_CODE, EMERGENCY_FAULT, EMERGENCY_FLAGS, EMERGENCY_ID, EMERGENCY_INHIBIT_TIME_MS,
        EMERGENCY_QUALITY, EMERGENCY_REGISTER,
    },
};

pub use crate::fault::{Fault, Faults};

/// Emergencies that are remembered.
pub(crate) const ERROR_HISTORY_LEN: usize = 8;

/// Returns the faults that an output reports by its flags. `SensorFault` and `CncLost` stand for several sources; each
/// of these has its own fault.
#[must_use]
pub fn faults_from_output(output: &Output) -> Faults {
    Faults::default()
        .with_fault_if(output.flags.contains(OffsetFlags::SAMPLES_MISSING), Fault::SamplesMissing)
        .with_fault_if(output.flags.contains(OffsetFlags::SPEED_UNKNOWN), Fault::SpeedUnknown)
        .with_fault_if(output.flags.contains(OffsetFlags::OUTSIDE_TABLE), Fault::OutsideTable)
        .with_fault_if(output.flags.contains(OffsetFlags::CLAMPED), Fault::Clamped)
}

/// Content of an emergency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// The error code; 0: the fault has gone.
    pub code: u16,
    /// The error register of what is left.
    pub register: u8,
    /// Which fault has come or gone.
    pub fault: Fault,
    /// The flags of that moment.
    pub flags: OffsetFlags,
    /// The quality of that moment.
    pub quality: OffsetQuality,
}

/// Returns the frame that says this.
#[must_use]
pub fn encode(emergency: &Emergency) -> Frame {
    let mut data = [0; 8];
    EMERGENCY_CODE.insert(&mut data, emergency.code.into());
    EMERGENCY_REGISTER.insert(&mut data, emergency.register.into());
    EMERGENCY_FAULT.insert(&mut data, emergency.fault as i32);
    EMERGENCY_FLAGS.insert(&mut data, emergency.flags.0.into());
    EMERGENCY_QUALITY.insert(&mut data, emergency.quality as i32);
    Frame::from_data(EMERGENCY_ID, data)
}

/// Returns what an emergency frame says. It is not protected: it informs, and nothing rests on it.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a fault or quality that has no meaning.
pub fn decode(frame: &Frame) -> Result<Emergency, DecodeError> {
    let data = frames::checked_frame_data(frame, EMERGENCY_ID, 8)?;
    let [low, high, ..] = EMERGENCY_CODE.extract(data).to_le_bytes();
    let (fault, quality) = (
        frames::extract_byte(EMERGENCY_FAULT, data),
        frames::extract_byte(EMERGENCY_QUALITY, data),
    );
    Ok(Emergency {
        code: u16::from_le_bytes([low, high]),
        register: frames::extract_byte(EMERGENCY_REGISTER, data),
        fault: Fault::ALL
            .into_iter()
            .find(|candidate| *candidate as u8 == fault)
            .ok_or(DecodeError::Value { signal: "Fault", raw: fault.into() })?,
        flags: OffsetFlags(frames::extract_byte(EMERGENCY_FLAGS, data)),
        quality: OffsetQuality::from_wire(quality)
            .ok_or(DecodeError::Value { signal: "Quality", raw: quality.into() })?,
    })
}

/// Faults that are reported, those that were seen, and the history.
#[derive(Clone, Debug)]
pub struct EmergencyProducer {
    /// Reported as present.
    reported: Faults,
    /// Present at some time since they were last reported as gone.
    seen: Faults,
    history: heapless::Deque<u32, ERROR_HISTORY_LEN>,
    /// In 0.1 ms.
    inhibit: u16,
    since_ms: u32,
}

impl Default for EmergencyProducer {
    fn default() -> Self {
        Self {
            reported: Faults::default(),
            seen: Faults::default(),
            history: heapless::Deque::new(),
            inhibit: default_inhibit_time_100us(),
            since_ms: u32::MAX,
        }
    }
}

fn default_inhibit_time_100us() -> u16 {
    u16::try_from(EMERGENCY_INHIBIT_TIME_MS.saturating_mul(10)).unwrap_or(u16::MAX)
}

impl EmergencyProducer {
    /// Sets the shortest time between two emergencies to what it is at the start.
    pub fn reset_inhibit_time(&mut self) {
        self.inhibit = default_inhibit_time_100us();
    }

    /// Notes the faults of a tick.
    pub fn update(&mut self, elapsed_ms: u32, now: Faults) {
        self.since_ms = self.since_ms.saturating_add(elapsed_ms);
        self.seen = self.seen.union(now);
    }

    /// Returns the next emergency, if one is due and may be sent.
    pub fn next_frame(&mut self, now: Faults, output: &Output) -> Option<Frame> {
        if self.since_ms.saturating_mul(10) < self.inhibit.into() {
            return None;
        }
        let has_come =
            |fault: &Fault| self.seen.contains(*fault) && !self.reported.contains(*fault);
        let has_gone = |fault: &Fault| self.reported.contains(*fault) && !now.contains(*fault);
        let (fault, code) = if let Some(fault) = Fault::ALL.into_iter().find(has_come) {
            (fault, fault.code())
        } else {
            (Fault::ALL.into_iter().find(has_gone)?, 0)
        };
        if code == 0 {
            self.reported = self.reported.without_fault(fault);
            self.seen = self.seen.without_fault(fault);
        } else {
            self.reported = self.reported.with_fault_if(true, fault);
            self.push_history(code, fault);
        }
        self.since_ms = 0;
        let (register, flags, quality) =
            (self.reported.error_register(), output.flags, output.quality);
        Some(encode(&Emergency { code, register, fault, flags, quality }))
    }

    /// The error code below, the fault's number above it.
    fn push_history(&mut self, code: u16, fault: Fault) {
        if self.history.is_full() {
            self.history.pop_back();
        }
        // There is room now.
        self.history.push_front(u32::from(code) | (fault as u32) << 16).ok();
    }

    /// Returns how many errors are remembered.
    #[must_use]
    pub fn history_len(&self) -> usize {
        self.history.len()
    }

    /// Returns a remembered error, the newest being 0: the code, and in bits 16…23 the fault.
    #[must_use]
    pub fn history_entry(&self, number: u8) -> Option<u32> {
        self.history.iter().nth(number.into()).copied()
    }

    /// Forgets the errors of the past.
    pub fn clear_history(&mut self) {
        self.history.clear();
    }

    /// Returns the shortest time between two emergencies in 0.1 ms.
    #[must_use]
    pub const fn inhibit_time_100us(&self) -> u16 {
        self.inhibit
    }

    /// Sets the shortest time between two emergencies, in 0.1 ms; 0: none.
    pub const fn set_inhibit_time_100us(&mut self, tenths_of_ms: u16) {
        self.inhibit = tenths_of_ms;
    }
}

#[cfg(test)]
mod tests;
