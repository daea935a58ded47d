//! The bridge as it stands on the bus: frames in, samples in, frames out.
//!
//! This is the whole of what a board does between its converter and its wires, without any
//! hardware, so the host can run the same thing.

use heapless::Vec;
use trueup_core::{
    bridge::{self, Bridge, Input},
    calibration::Calibration,
    cnc::{Command, Flags, Output, Quality},
    health::Noise,
    units::Millis,
};

use crate::{
    frame::Frame,
    frames::{self, State},
    layout::HEARTBEAT_PERIOD_MS,
    receiver::{Receiver, Refused},
};

/// The frames of one tick: both offsets, and at times the heartbeat.
pub type Frames = Vec<Frame, 3>;

/// The bridge, its memory, and its end of the link.
#[derive(Debug)]
pub struct Node {
    /// `None` without a valid calibration: nothing can be computed then.
    bridge: Option<Bridge>,
    state: bridge::State,
    receiver: Receiver,
    now: Millis,
    blocks: u32,
    counter: u8,
    until_heartbeat_ms: u32,
    degraded: bool,
    last: Output,
}

impl Node {
    /// A node that has just been switched on. `degraded` marks every frame of a board that runs on
    /// a fall-back.
    #[must_use]
    pub fn new(calibration: Option<Calibration>, degraded: bool) -> Self {
        Self {
            bridge: calibration.map(Bridge::new),
            state: bridge::State::default(),
            receiver: Receiver::default(),
            now: Millis::default(),
            blocks: 0,
            counter: 0,
            until_heartbeat_ms: 0,
            degraded,
            last: Output::default(),
        }
    }

    /// Takes a frame from the bus. Gives the command it carried, `None` if it is nobody's here.
    ///
    /// # Errors
    /// A frame for this node that is damaged, repeated or out of order; it is counted and has no
    /// effect.
    pub fn hear(&mut self, frame: &Frame) -> Result<Option<Command>, Refused> {
        let command = self.receiver.accept(frame)?;
        if let (Some(bridge), Some(command)) = (&self.bridge, command) {
            bridge.hear(&mut self.state, command);
        }
        Ok(command)
    }

    /// One tick that ends `elapsed_ms` after the last one. Gives the frames to send.
    pub fn tick(&mut self, elapsed_ms: u32, input: Input) -> Frames {
        self.now = self.now.after(elapsed_ms);
        if input.codes.is_some() {
            self.blocks = self.blocks.wrapping_add(1);
        }
        let mut output = match &self.bridge {
            Some(bridge) => bridge.tick(&mut self.state, self.now, input),
            None => Output { quality: Quality::Fault, age_ms: u8::MAX, ..Output::default() },
        };
        output.flags = output.flags.with_if(self.degraded, Flags::BOARD_DEGRADED);
        self.last = output;

        let mut frames = Frames::new();
        let offsets =
            [frames::offset_xy(&output, self.counter), frames::offset_z(&output, self.counter)];
        self.counter = self.counter.wrapping_add(1);
        self.until_heartbeat_ms = self.until_heartbeat_ms.saturating_sub(elapsed_ms);
        frames.extend(offsets);
        if self.until_heartbeat_ms == 0 {
            self.until_heartbeat_ms = HEARTBEAT_PERIOD_MS;
            let state = match output.quality {
                Quality::Fault => State::Stopped,
                _ => State::Operational,
            };
            frames.extend([frames::heartbeat(state)]);
        }
        frames
    }

    /// The time of the last tick.
    #[must_use]
    pub fn now(&self) -> Millis {
        self.now
    }

    /// Blocks of samples taken so far; wraps.
    #[must_use]
    pub fn blocks(&self) -> u32 {
        self.blocks
    }

    /// What the last tick gave.
    #[must_use]
    pub fn last(&self) -> &Output {
        &self.last
    }

    /// What was received and refused so far.
    #[must_use]
    pub fn receiver(&self) -> &Receiver {
        &self.receiver
    }

    /// The noise of the raw codes since the last call.
    pub fn take_noise(&mut self) -> Noise {
        self.state.take_noise()
    }
}
