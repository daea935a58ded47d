//! The board: the real firmware in QEMU, or the same application in this process. Both send the same
//! frames to the bit (`host-tests/tests/virtual_board.rs`), so that a campaign of hundreds of machines
//! need not wait for an emulator.

use std::path::{Path, PathBuf};

use anyhow::Result;
use trueup_core::bridge::TickInput;
use trueup_emulator::board::VirtualBoard;
use trueup_link::frame::Frame;
use trueup_machine::compile::CompiledCalibration;
use trueup_node::node::{Interface, Node};
use trueup_pipe::Block;

use crate::calibration_loader;

/// A board that runs.
pub trait SteppedBoard {
    /// Lets it live through these blocks of 1 ms, at most 255, and gives what it sends meanwhile.
    ///
    /// # Errors
    /// The emulator has ended.
    fn step(&mut self, blocks: &[Block]) -> Result<Vec<Frame>>;
}

impl SteppedBoard for VirtualBoard {
    fn step(&mut self, blocks: &[Block]) -> Result<Vec<Frame>> {
        Ok(Self::step(self, blocks)?.into_iter().map(|(_, frame)| frame).collect())
    }
}

/// The application without its board.
struct InProcessBoard<'a>(Node<'a>);

impl SteppedBoard for InProcessBoard<'_> {
    fn step(&mut self, blocks: &[Block]) -> Result<Vec<Frame>> {
        let mut sent = Vec::with_capacity(3 * blocks.len());
        for block in blocks {
            for frame in block.frames.iter().flatten() {
                // What is refused is counted by the node, as on the board.
                self.0.receive(Interface::Can, frame).ok();
            }
            let input = TickInput {
                codes: Some(&block.codes),
                speed: block.speed,
                temperatures: Some(&block.temperatures),
            };
            sent.extend(self.0.tick(1, input));
            sent.extend(self.0.next_service_frame());
        }
        Ok(sent)
    }
}

/// A board that has just started, and the number of the CNC's next frame.
pub(crate) struct StartedBoard<'b> {
    /// The board.
    pub bridge: &'b mut dyn SteppedBoard,
    /// The number.
    pub counter: u8,
}

/// Where boards come from.
#[derive(Clone, Debug)]
pub enum BoardSource {
    /// QEMU, with this image.
    Emulated(PathBuf),
    /// This process.
    InProcess,
}

impl BoardSource {
    /// Returns what they are called in `summary.json`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Emulated(_) => "virtual",
            Self::InProcess => "host",
        }
    }

    /// Returns the image of the emulated board.
    #[must_use]
    pub fn image(&self) -> Option<&Path> {
        match self {
            Self::Emulated(image) => Some(image),
            Self::InProcess => None,
        }
    }

    /// Starts a board with the calibration `old`, loads `new` over its line as a user would, and lets
    /// `work` use it once it has restarted.
    ///
    /// # Errors
    /// The emulator does not start, the board refuses, or those of `work`.
    pub(crate) fn run_with_updated_calibration<T>(
        &self,
        old: &CompiledCalibration,
        new: &CompiledCalibration,
        work: impl FnOnce(StartedBoard<'_>) -> Result<T>,
    ) -> Result<T> {
        match self {
            Self::Emulated(image) => {
                let mut board = VirtualBoard::boot(image, old.blob())?;
                let counter = calibration_loader::load_calibration(&mut board, new)?;
                work(StartedBoard { bridge: &mut board, counter })
            }
            Self::InProcess => self.run(new, |bridge| work(StartedBoard { bridge, counter: 0 })),
        }
    }

    /// Starts a board with this calibration and lets `work` use it.
    ///
    /// # Errors
    /// The emulator does not start, or those of `work`.
    pub fn run<T>(
        &self,
        calibration: &CompiledCalibration,
        work: impl FnOnce(&mut dyn SteppedBoard) -> Result<T>,
    ) -> Result<T> {
        match self {
            Self::Emulated(image) => work(&mut VirtualBoard::boot(image, calibration.blob())?),
            Self::InProcess => {
                work(&mut InProcessBoard(Node::new(calibration.calibration().into())))
            }
        }
    }
}
