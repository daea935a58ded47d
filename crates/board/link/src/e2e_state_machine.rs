//! Whether a stream of protected frames is to be trusted: the state machine of AUTOSAR E2E (PRS E2E
//! Protocol, E2E_SMCheck) over the verdicts of profile 5 on its last frames.
//!
//! ```text
//!           the first whole frame             3 of the last 3 whole and in order
//!  Initial ──────────────────────► Valid ◄──────────────────────────────────────── Invalid
//!     │                              └── more than 4 of the last 8 damaged,          ▲ ▲
//!     │                                  or none of them whole and in order ─────────┘ │
//!     └── more than 4 of the last 8 damaged ───────────────────────────────────────────┘
//! ```
//!
//! A CRC of 16 bits passes one in 65 536 frames of pure noise. On a line that brings noise only, what
//! passes by chance must not be used: it would have to pass three times in a row, with counters that
//! follow each other. One damaged frame, or four of eight, costs nothing but these frames.
//!
//! | AUTOSAR | here | |
//! |---|---|---|
//! | WindowSizeInit, WindowSizeValid | [`WINDOW_FRAMES`] | frames, not times: no clock here, silence is for the caller |
//! | WindowSizeInvalid, MinOkStateInvalid | [`MIN_CONSECUTIVE_FRAMES`] | with MaxErrorStateInvalid 0 |
//! | MaxErrorStateInit, MaxErrorStateValid | [`MAX_DAMAGED_FRAMES`] | |
//! | MinOkStateInit, MinOkStateValid | 1 | the frame that ends `NODATA` is the first of the window |
//! | ClearToInvalid | true | |
//!
//! Frames that are repeated or out of sequence are neither sound nor damaged, as there.

use crate::{
    e2e::{E2eChecker, E2eError},
    frame::Frame,
};

/// Frames that are looked back at.
///
/// As many as fit a byte. At 500 frames a second they are 16 ms, of 50 a second 160 ms: both less
/// than the shortest silence after which a CNC counts as lost by default (500 ms).
pub const WINDOW_FRAMES: u32 = u8::BITS;

/// Damaged frames among the last [`WINDOW_FRAMES`] with which a stream is still trusted.
///
/// Half of them: noise alone passes with 2⁻¹⁶ a frame, so after a frame that was right the fifth
/// damaged one in a row ends it; a line that damages one frame in four at random gets there once in
/// 36 windows (binomial), and is back after three good ones.
pub const MAX_DAMAGED_FRAMES: u32 = WINDOW_FRAMES / 2;

/// Frames in a row, whole and in order, after which a stream is trusted again.
///
/// As many as an engage sequence requires. Noise does it with a chance of
/// 2⁻⁴⁸·(15/256)² = 10⁻¹⁷ a frame: at 2,000 frames a second once in a million years.
pub const MIN_CONSECUTIVE_FRAMES: u32 = 3;

const CONSECUTIVE_FRAMES_MASK: u8 = (1 << MIN_CONSECUTIVE_FRAMES) - 1;

/// How far a stream is trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum E2eState {
    /// Nothing whole was received yet: NODATA and INIT.
    #[default]
    Initial,
    /// Its frames are used: VALID.
    Valid,
    /// Its frames are not used, however whole: INVALID.
    Invalid,
}

/// The frames of one identifier, one after the other.
#[derive(Clone, Copy, Debug)]
pub struct E2eStateMachine {
    checker: E2eChecker,
    trust: E2eState,
    /// The last frames, the newest in bit 0: whole and in order.
    sound: u8,
    /// Likewise: damaged.
    damaged: u8,
    /// The last error.
    last_error: Option<E2eError>,
}

impl E2eStateMachine {
    /// Returns a stream of which no frame was received; `data_id` is the CAN identifier of its frames.
    #[must_use]
    pub const fn new(data_id: u16) -> Self {
        let checker = E2eChecker::new(data_id);
        Self { checker, trust: E2eState::Initial, sound: 0, damaged: 0, last_error: None }
    }

    /// Returns how many frames were lost before this one, if it is to be used.
    ///
    /// # Errors
    /// The frame must not be used: for what it is, as [`E2eChecker::check`], or for what came before it.
    pub fn accept(&mut self, frame: &Frame) -> Result<u8, E2eStateMachineError> {
        let verdict = self.checker.check(frame);
        let is_damaged = matches!(verdict, Err(E2eError::Crc { .. } | E2eError::TooShort { .. }));
        self.update_state(verdict.is_ok(), is_damaged);
        match verdict {
            Err(error) => {
                self.last_error = Some(error);
                Err(E2eStateMachineError::Frame(error))
            }
            // It got there by an error, so there is one.
            Ok(lost) => match self.last_error {
                Some(error) if self.trust == E2eState::Invalid => {
                    Err(E2eStateMachineError::Untrusted(error))
                }
                _ => Ok(lost),
            },
        }
    }

    /// Takes note of a frame of this identifier that has no protection to check.
    pub fn record_damaged_frame(&mut self, error: E2eError) {
        self.last_error = Some(error);
        self.update_state(false, true);
    }

    /// Returns how far it is trusted after the last frame.
    #[must_use]
    pub const fn state(&self) -> E2eState {
        self.trust
    }

    fn update_state(&mut self, is_sound: bool, is_damaged: bool) {
        self.sound = self.sound << 1 | u8::from(is_sound);
        self.damaged = self.damaged << 1 | u8::from(is_damaged);
        let is_bad = self.damaged.count_ones() > MAX_DAMAGED_FRAMES;
        let next = match self.trust {
            E2eState::Initial if is_bad => E2eState::Invalid,
            E2eState::Initial if is_sound => E2eState::Valid,
            E2eState::Valid if is_bad || self.sound == 0 => E2eState::Invalid,
            E2eState::Invalid
                if self.sound & CONSECUTIVE_FRAMES_MASK == CONSECUTIVE_FRAMES_MASK =>
            {
                E2eState::Valid
            }
            same => same,
        };
        if self.trust != next {
            self.trust = next;
            if next == E2eState::Invalid {
                (self.sound, self.damaged) = (0, 0);
            }
        }
    }
}

/// Why a frame of a stream must not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum E2eStateMachineError {
    /// Its own protection does not hold.
    Frame(E2eError),
    /// It is whole and in order, but too many before it were not; the last of these was wrong so.
    Untrusted(E2eError),
}

#[cfg(test)]
mod tests;
