//! `Zero` outlasts the power: runs of the emulated board that is switched off and on again, with the
//! same calibration, with another one, and with a store that is damaged.

use std::{
    fs,
    path::PathBuf,
    time::{Duration, Instant},
};

use trueup_core::{
    cnc::{Control, Output, Quality},
    units::Rpm,
};
use trueup_emulator::{
    board::{LARGEST_BATCH, VirtualBoard},
    firmware::{self, Board},
    front_end::FrontEnd,
    setup,
};
use trueup_link::{frames, receiver::OffsetReceiver};
use trueup_machine::{Compiled, MachineFile, compile};
use trueup_pipe::{Block, FRAMES};
use trueup_store::reference::RECORD_SIZE;

/// The paper's spindle, with a slew limit that fits a test, and growth times `gain`.
fn compiled(gain: f64) -> Compiled {
    let path = setup::root().join("data/paper_spindle.toml");
    let mut machine = MachineFile::read(&path).expect("the project's own machine file");
    machine.limits.slew_um_per_s = 100.0;
    machine.spindle.sensor.as_mut().expect("it has one").um_per_count *= gain;
    compile(&machine).expect("it compiles")
}

/// A board with what is around it.
struct Bench {
    image: PathBuf,
    board: VirtualBoard,
    front_end: FrontEnd,
    offsets: OffsetReceiver,
    counter: u8,
    ms: u32,
}

impl Bench {
    fn boot(calibration: &Compiled) -> Self {
        let image = firmware::build(Board::Virtual).expect("the image builds");
        let board = VirtualBoard::boot(&image, calibration.blob()).expect("the board boots");
        Self::around(image, board)
    }

    fn restart(self, calibration: &Compiled) -> Self {
        let board = self.board.restart(&self.image, calibration.blob()).expect("the board boots");
        Self::around(self.image, board)
    }

    fn around(image: PathBuf, board: VirtualBoard) -> Self {
        let front_end = FrontEnd::new(0.328, 3);
        Self { image, board, front_end, offsets: OffsetReceiver::new(), counter: 0, ms: 0 }
    }

    /// Engaged for so long, the spindle grown by the paper's law; gives every offset.
    fn live(&mut self, ms: u32, growth_um: f64, zero: bool) -> Vec<Output> {
        let volts = (5_048.0 + growth_um / (500.0 / 32_768.0)) * 10.0 / 32_768.0;
        let blocks: Vec<Block> = (0..ms)
            .map(|_| {
                let mut sent = [None; FRAMES];
                if self.ms.is_multiple_of(20) {
                    let engage = self.ms >= 60;
                    let control = Control { engage, zero, ..Control::REFERENCED };
                    sent[0] = Some(frames::control(control, self.counter));
                    self.counter = self.counter.wrapping_add(1);
                }
                self.ms += 1;
                let codes = self.front_end.block(|_| volts);
                Block { codes, speed: Some(Rpm(12_000)), frames: sent, ..Block::default() }
            })
            .collect();
        let batches = blocks.chunks(LARGEST_BATCH as usize);
        let sent = batches.flat_map(|batch| self.board.step(batch).expect("the board lives"));
        sent.filter_map(|(_, frame)| self.offsets.accept(&frame).expect("whole frames")).collect()
    }

    /// The line of the log that has these words in it. The log has its own way to the host.
    fn logged(&self, words: &str) -> String {
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

fn z_um(output: &Output) -> f64 {
    f64::from(output.offset.expect("available")[2].0) / 1_000.0
}

fn last_z_um(outputs: &[Output]) -> f64 {
    let last = outputs.last().expect("an offset a millisecond");
    assert_eq!(last.quality, Quality::Live);
    z_um(last)
}

/// Grown by 40 µm, and zeroed there.
fn zeroed(calibration: &Compiled) -> Bench {
    let mut bench = Bench::boot(calibration);
    bench.logged("no reference is stored");
    assert!((last_z_um(&bench.live(800, 40.0, false)) - 40.0).abs() < 0.1);
    let ramp = bench.live(800, 40.0, true);
    // No jump: 100 µm/s are 0.1 µm a tick.
    let steps = ramp.windows(2).map(|pair| (z_um(&pair[1]) - z_um(&pair[0])).abs());
    assert!(steps.fold(0.0, f64::max) < 0.111, "the way to zero is ramped");
    assert!(last_z_um(&ramp).abs() < 0.1, "zeroed");
    let said = bench.logged("reference 2 stored");
    println!("{said}");
    let elongation = said.split("elongation ").nth(1).and_then(|rest| rest.split(' ').next());
    let elongation_nm: f64 = elongation.and_then(|nm| nm.parse().ok()).expect("a number");
    assert!((elongation_nm - 40_000.0).abs() < 100.0, "{said}");
    bench
}

#[test]
fn a_restarted_board_goes_on_from_the_stored_reference_and_another_calibration_does_not() {
    let (ours, other) = (compiled(1.0), compiled(1.1));
    let bench = zeroed(&ours);
    let stored = fs::metadata(bench.board.flash()).expect("it was stored").modified().ok();

    // Grown by 12 µm more while it was off.
    let mut bench = bench.restart(&ours);
    println!("{}", bench.logged("reference 2 taken up"));
    assert!((last_z_um(&bench.live(800, 52.0, false)) - 12.0).abs() < 0.1);

    // The other law makes 44 µm of 40 µm, and knows nothing of the reference.
    let mut bench = bench.restart(&other);
    println!("{}", bench.logged("no reference is stored for this calibration"));
    println!("{}", bench.logged("of other calibrations, not used: 1"));
    assert!((last_z_um(&bench.live(800, 40.0, false)) - 44.0).abs() < 0.1);

    // The first calibration again, and with it its reference. All this has written nothing.
    let mut bench = bench.restart(&ours);
    assert!((last_z_um(&bench.live(800, 30.0, false)) + 10.0).abs() < 0.1);
    let now = fs::metadata(bench.board.flash()).expect("still there").modified().ok();
    assert_eq!(now, stored, "the file is written on Zero only");

    // A second Zero is the one that counts from then on.
    bench.live(400, 30.0, true);
    println!("{}", bench.logged("reference 4 stored"));
    let mut bench = bench.restart(&ours);
    println!("{}", bench.logged("reference 4 taken up"));
    assert!(last_z_um(&bench.live(400, 30.0, false)).abs() < 0.1);
}

#[test]
fn a_record_with_any_byte_flipped_is_refused_and_logged() {
    let ours = compiled(1.0);
    let mut bench = zeroed(&ours);
    let whole = fs::read(bench.board.flash()).expect("it was stored");
    for byte in 0..RECORD_SIZE {
        let mut damaged = whole.clone();
        // Behind the record that names the machine.
        damaged[RECORD_SIZE + byte] ^= 0xFF;
        fs::write(bench.board.flash(), damaged).expect("a file");
        bench = bench.restart(&ours);
        bench.logged("no reference is stored");
        bench.logged("damaged, refused: 1");
    }
    // What is refused has no effect, and the next Zero is stored behind it.
    assert!((last_z_um(&bench.live(800, 40.0, false)) - 40.0).abs() < 0.1);
    bench.live(400, 40.0, true);
    bench.logged("reference 5 stored");
    let mut bench = bench.restart(&ours);
    bench.logged("reference 5 taken up");
    assert!(last_z_um(&bench.live(400, 40.0, false)).abs() < 0.1);
}

#[test]
fn a_store_that_cannot_be_written_is_logged_and_the_offsets_go_on() {
    let mut bench = Bench::boot(&compiled(1.0));
    // A folder in its place: no file can be opened there.
    fs::create_dir(bench.board.flash()).expect("a folder");
    bench.live(800, 40.0, false);
    assert!(last_z_um(&bench.live(800, 40.0, true)).abs() < 0.1, "zeroed all the same");
    bench.logged("NOT stored");
    println!("{}", bench.logged("lost with the power"));
    assert!((last_z_um(&bench.live(400, 45.0, true)) - 5.0).abs() < 0.1);
}

#[test]
fn a_zero_that_finds_no_samples_is_refused_and_logged() {
    let mut bench = Bench::boot(&compiled(1.0));
    // A sensor at its rail gives no reading.
    let dead = |bench: &mut Bench, zero| bench.live(200, 1e4, zero);
    dead(&mut bench, false);
    dead(&mut bench, true);
    println!("{}", bench.logged("zero: the reference stays"));
    // The board has named its machine, and stored nothing else.
    let stored = fs::read(bench.board.flash()).expect("the name");
    assert!(stored[RECORD_SIZE..].iter().all(|byte| *byte == 0xFF), "nothing was stored");
}
