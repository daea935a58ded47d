//! The emulated board on a bench: the sensor of the paper's spindle, and a CNC that engages it.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use trueup_canopen::emergency::{self, Fault};
use trueup_core::{
    cnc::{Control, Output},
    units::Rpm,
};
use trueup_emulator::{
    analogue_front_end::AnalogueFrontEnd,
    board::{MAX_BATCH_BLOCKS, VirtualBoard},
    firmware_images, setup,
};
use trueup_link::{frames, receiver::OffsetReceiver};
use trueup_machine::{CompiledCalibration, Machine, MachineFile};
use trueup_pipe::{Block, FRAMES_PER_BLOCK};

/// Returns the paper's spindle, with a slew limit that fits a test.
pub fn paper() -> Machine {
    let path = setup::project_root().join("data/paper_spindle.toml");
    let mut machine = MachineFile::read(&path).expect("the project's own machine file");
    machine.limits.slew_um_per_s = 100.0;
    machine
}

/// A board with what is around it.
pub struct Bench {
    image: PathBuf,
    /// The board itself.
    pub board: VirtualBoard,
    /// Faults that it has reported since its start.
    pub faults: Vec<Fault>,
    front_end: AnalogueFrontEnd,
    offsets: OffsetReceiver,
    counter: u8,
    ms: u32,
}

impl Bench {
    pub fn boot(calibration: &CompiledCalibration) -> Self {
        let image = firmware_images::build_virtual_board_image().expect("the image builds");
        let board = VirtualBoard::boot(&image, calibration.blob()).expect("the board boots");
        Self::around(image, board)
    }

    /// Off and on again, perhaps with another calibration.
    pub fn restart(self, calibration: &CompiledCalibration) -> Self {
        let board = self.board.restart(&self.image, calibration.blob()).expect("the board boots");
        Self::around(self.image, board)
    }

    fn around(image: PathBuf, board: VirtualBoard) -> Self {
        let front_end = AnalogueFrontEnd::new(0.328, 3);
        let offsets = OffsetReceiver::new();
        Self { image, board, faults: Vec::new(), front_end, offsets, counter: 0, ms: 0 }
    }

    /// For so long, the spindle grown by the paper's law; gives every offset. The CNC says what `control` makes of
    /// the number of its frame, and engages after the first three.
    pub fn live(
        &mut self,
        ms: u32,
        growth_um: f64,
        control: impl Fn(u8) -> Control,
    ) -> Vec<Output> {
        let volts = (5_048.0 + growth_um / (500.0 / 32_768.0)) * 10.0 / 32_768.0;
        let mut all = Vec::new();
        for start in (0..ms).step_by(MAX_BATCH_BLOCKS as usize) {
            let blocks: Vec<Block> = (start..ms.min(start + MAX_BATCH_BLOCKS))
                .map(|_| {
                    let mut sent = [None; FRAMES_PER_BLOCK];
                    if self.ms.is_multiple_of(20) {
                        let control = Control { engage: self.ms >= 60, ..control(self.counter) };
                        sent[0] = Some(frames::encode_control(control, self.counter));
                        self.counter = self.counter.wrapping_add(1);
                    }
                    self.ms += 1;
                    let codes = self.front_end.convert_block(|_| volts);
                    Block { codes, speed: Some(Rpm(12_000)), frames: sent, ..Block::default() }
                })
                .collect();
            for (_, frame) in self.board.step(&blocks).expect("the board lives") {
                let emergency_frame =
                    emergency::decode(&frame).ok().filter(|emergency| emergency.code != 0);
                self.faults.extend(emergency_frame.map(|emergency| emergency.fault));
                all.extend(self.offsets.accept(&frame).expect("whole frames"));
            }
        }
        all
    }

    /// Returns the line of the log that has these words in it. The log has its own way to the host.
    pub fn logged(&self, words: &str) -> String {
        let end = Instant::now() + Duration::from_secs(10);
        loop {
            let log = self.board.log();
            if let Some(line) = log.iter().find(|line| line.contains(words)) {
                return line.clone();
            }
            assert!(Instant::now() < end, "the log does not say \"{words}\": {log:#?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
