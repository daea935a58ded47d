//! What `trueup learn` has learned, brought to the emulated board while it is engaged: from the two machine files
//! to the offset, and no farther than the calibration permits.

use trueup_canopen::emergency::{self, Fault};
use trueup_core::{
    cnc::{Control, Output, Quality},
    learned::{Change, PARTS, named},
    units::Rpm,
};
use trueup_emulator::{
    board::{LARGEST_BATCH, VirtualBoard},
    firmware::{self, Board},
    front_end::FrontEnd,
    setup,
};
use trueup_learn::Live;
use trueup_link::{frames, receiver::OffsetReceiver};
use trueup_machine::{Machine, MachineFile, compile, file::LearnedCaps};
use trueup_pipe::{Block, FRAMES};

const GROWN_UM: f64 = 40.0;
/// The offset without what was learned is known to so much.
const NOISE_UM: f64 = 0.1;
/// A part of 1 % takes so long.
const WAY_MS: u32 = 100_000;

/// The paper's spindle, with a slew limit that fits a test, and these caps.
fn paper(learned: LearnedCaps) -> Machine {
    let path = setup::root().join("data/paper_spindle.toml");
    let mut machine = MachineFile::read(&path).expect("the project's own machine file");
    machine.limits.slew_um_per_s = 100.0;
    machine.limits.learned = learned;
    machine
}

/// A board with its CNC.
struct Bench {
    board: VirtualBoard,
    front_end: FrontEnd,
    offsets: OffsetReceiver,
    crc: u32,
    counter: u8,
    ms: u32,
    emergencies: Vec<Fault>,
}

impl Bench {
    fn boot(machine: &Machine) -> Self {
        let calibration = compile(machine).expect("it compiles");
        let image = firmware::build(Board::Virtual).expect("the image builds");
        let board = VirtualBoard::boot(&image, calibration.blob()).expect("the board boots");
        Self {
            board,
            front_end: FrontEnd::new(0.328, 3),
            offsets: OffsetReceiver::new(),
            crc: calibration.crc(),
            counter: 0,
            ms: 0,
            emergencies: Vec::new(),
        }
    }

    /// Engaged for so long; each `Control` says a part of these amounts. Gives every offset of Z in µm.
    fn live(&mut self, ms: u32, amounts: Option<[i16; PARTS]>) -> Vec<f64> {
        let volts = (5_048.0 + GROWN_UM / (500.0 / 32_768.0)) * 10.0 / 32_768.0;
        let mut all = Vec::new();
        for start in (0..ms).step_by(LARGEST_BATCH as usize) {
            let blocks: Vec<Block> = (start..ms.min(start + LARGEST_BATCH))
                .map(|_| {
                    let mut sent = [None; FRAMES];
                    if self.ms.is_multiple_of(20) {
                        let part = self.counter % PARTS as u8;
                        let learned = amounts.map(|all| Change {
                            part: part + 1,
                            amount: all[usize::from(part)],
                            calibration: named(self.crc),
                        });
                        let learned = learned.unwrap_or_default();
                        let engage = self.ms >= 60;
                        let control = Control { engage, learned, ..Control::REFERENCED };
                        sent[0] = Some(frames::control(control, self.counter));
                        self.counter = self.counter.wrapping_add(1);
                    }
                    self.ms += 1;
                    let codes = self.front_end.block(|_| volts);
                    Block { codes, speed: Some(Rpm(12_000)), frames: sent, ..Block::default() }
                })
                .collect();
            for (_, frame) in self.board.step(&blocks).expect("the board lives") {
                let fault = emergency::decode(&frame).ok().filter(|it| it.code != 0);
                self.emergencies.extend(fault.map(|it| it.fault));
                let output = self.offsets.accept(&frame).expect("whole frames");
                all.extend(output.as_ref().and_then(z_um));
            }
        }
        all
    }
}

fn z_um(output: &Output) -> Option<f64> {
    output.offset.filter(|_| output.quality == Quality::Live).map(|[_, _, z]| f64::from(z.0) / 1e3)
}

/// Over the last second.
fn mean(all: &[f64]) -> f64 {
    let last = &all[all.len().saturating_sub(1_000)..];
    last.iter().sum::<f64>() / last.len() as f64
}

#[test]
fn what_was_learned_ends_in_the_offset_of_a_board_that_is_engaged_and_is_taken_back() {
    let runs = paper(LearnedCaps { growth_percent: 2.0, zero_um: 1.0, ..LearnedCaps::default() });
    let mut learned = runs.clone();
    let sensor = learned.spindle.sensor.as_mut().expect("it has one");
    sensor.um_per_count *= 1.01;
    sensor.k0_um += 0.5;
    let live = Live::between(&runs, &learned).expect("both are for a board");
    assert_eq!((live.amounts, live.rest), ([1_000, 0, 0, 0, 500], vec![]));

    let mut bench = Bench::boot(&runs);
    let before = mean(&bench.live(2_000, None));
    assert!((before - GROWN_UM).abs() < NOISE_UM, "{before}");
    let way = bench.live(WAY_MS + 2_000, Some(live.amounts));
    let after = mean(&way);
    let expected = before + 0.01 * GROWN_UM + 0.5;
    println!("{before:.3} µm, then {after:.3} µm, of {expected:.3}");
    assert!((after - expected).abs() < 0.02, "{after} instead of {expected}");
    // Its way is a ramp: after half of the time half of the share, and all of the zero.
    let half = mean(&way[..way.len() / 2]);
    assert!((half - (before + 0.005 * GROWN_UM + 0.5)).abs() < 0.02, "{half}");
    let back = mean(&bench.live(WAY_MS + 2_000, Some([0; PARTS])));
    assert!((back - before).abs() < 0.02, "{back} instead of {before}");
    assert!(!bench.emergencies.contains(&Fault::LearnedRefused), "{:?}", bench.emergencies);
}

#[test]
fn a_board_whose_calibration_permits_nothing_refuses_and_tells_and_goes_on_as_before() {
    let mut bench = Bench::boot(&paper(LearnedCaps::default()));
    let before = mean(&bench.live(2_000, None));
    let after = mean(&bench.live(10_000, Some([1_000, 0, 0, 0, 500])));
    assert!((after - before).abs() < 0.02, "{after} instead of {before}");
    assert!(bench.emergencies.contains(&Fault::LearnedRefused), "{:?}", bench.emergencies);
}
