//! `Zero` outlasts the power: runs of the emulated board that is switched off and on again, with the
//! same calibration, with another one, and with a store that is damaged.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod support;

use std::fs;

use support::bench::{Bench, paper};
use trueup_canopen::emergency::Fault;
use trueup_core::cnc::{Control, OffsetQuality, Output};
use trueup_machine::{CompiledCalibration, compile};
use trueup_store::reference::RECORD_SIZE;

/// The CNC goes on, or takes the error of now as the reference.
const ON: Control = Control::REFERENCED;
const ZERO: Control = Control { zero: true, ..Control::REFERENCED };

/// Returns the paper's spindle, and growth times `gain`.
fn compiled(gain: f64) -> CompiledCalibration {
    let mut machine = paper();
    machine.spindle.sensor.as_mut().expect("it has one").um_per_count *= gain;
    compile(&machine).expect("it compiles")
}

fn z_um(output: &Output) -> f64 {
    f64::from(output.offset.expect("available")[2].0) / 1_000.0
}

fn last_z_um(outputs: &[Output]) -> f64 {
    let last = outputs.last().expect("an offset a millisecond");
    assert_eq!(last.quality, OffsetQuality::Live);
    z_um(last)
}

/// Grown by 40 µm, and zeroed there.
fn zeroed(calibration: &CompiledCalibration) -> Bench {
    let mut bench = Bench::boot(calibration);
    bench.logged("no reference is stored");
    assert!((last_z_um(&bench.live(800, 40.0, |_| ON)) - 40.0).abs() < 0.1);
    let ramp = bench.live(800, 40.0, |_| ZERO);
    // No jump: 100 µm/s are 0.1 µm a tick.
    let steps = ramp.windows(2).map(|pair| (z_um(&pair[1]) - z_um(&pair[0])).abs());
    assert!(steps.fold(0.0, f64::max) < 0.111, "the way to zero is ramped");
    assert!(last_z_um(&ramp).abs() < 0.1, "zeroed");
    let stored_line = bench.logged("reference 2 stored");
    println!("{stored_line}");
    let elongation =
        stored_line.split("elongation ").nth(1).and_then(|rest| rest.split(' ').next());
    let elongation_nm: f64 = elongation.and_then(|nm| nm.parse().ok()).expect("a number");
    assert!((elongation_nm - 40_000.0).abs() < 100.0, "{stored_line}");
    bench
}

/// Answers what the board asks: an edge of `Confirm` every 200 ms.
fn confirming(number: u8) -> Control {
    Control { confirm: number % 10 >= 5, ..Control::REFERENCED }
}

#[test]
fn a_restarted_board_goes_on_from_the_stored_reference_and_an_old_one_is_offered() {
    let (ours, other) = (compiled(1.0), compiled(1.1));
    let bench = zeroed(&ours);
    let stored = fs::metadata(bench.board.flash_path()).expect("it was stored").modified().ok();

    // Grown by 12 µm more while it was off.
    let mut bench = bench.restart(&ours);
    println!("{}", bench.logged("reference 2 taken up"));
    assert!((last_z_um(&bench.live(800, 52.0, |_| ON)) - 12.0).abs() < 0.1);
    let now = fs::metadata(bench.board.flash_path()).expect("still there").modified().ok();
    assert_eq!(now, stored, "the file is written on Zero only");

    // The other law makes 44 µm of 40 µm, and knows nothing of the reference. It came while no CNC was there.
    let mut bench = bench.restart(&other);
    println!("{}", bench.logged("no reference is stored for this calibration"));
    println!("{}", bench.logged("of other calibrations, not used: 1"));
    let inhibited = bench.live(800, 40.0, |_| ON);
    assert!(
        inhibited
            .iter()
            .all(|output| output.quality == OffsetQuality::Fault && output.offset.is_none())
    );
    assert!(bench.faults.contains(&Fault::CalibrationChanged), "{:?}", bench.faults);
    bench.live(800, 40.0, confirming);
    assert!((last_z_um(&bench.live(800, 40.0, |_| ON)) - 44.0).abs() < 0.1);
    // Answered once, and zeroed under this one.
    bench.live(400, 40.0, |_| ZERO);
    let mut bench = bench.restart(&other);
    assert!(last_z_um(&bench.live(800, 40.0, |_| ON)).abs() < 0.1);

    // The first calibration again: its reference is offered, and nothing is engaged until it is confirmed.
    let mut bench = bench.restart(&ours);
    println!("{}", bench.logged("reference 2 offered"));
    let inhibited = bench.live(800, 30.0, |_| ON);
    assert!(
        inhibited
            .iter()
            .all(|output| output.quality == OffsetQuality::Fault && output.offset.is_none())
    );
    assert!(bench.faults.contains(&Fault::ReferenceOffered), "{:?}", bench.faults);
    // Nor after the next start.
    let mut bench = bench.restart(&ours);
    assert_eq!(
        bench.live(400, 30.0, |_| ON).last().map(|output| output.quality),
        Some(OffsetQuality::Fault)
    );
    bench.live(800, 30.0, confirming);
    assert!((last_z_um(&bench.live(800, 30.0, |_| ON)) + 10.0).abs() < 0.1);

    // A second Zero is the one that counts from then on.
    bench.live(400, 30.0, |_| ZERO);
    let mut bench = bench.restart(&ours);
    println!("{}", bench.logged("taken up"));
    assert!(last_z_um(&bench.live(400, 30.0, |_| ON)).abs() < 0.1);
}

#[test]
fn a_record_with_any_byte_flipped_is_refused_and_logged() {
    let ours = compiled(1.0);
    let mut bench = zeroed(&ours);
    let whole = fs::read(bench.board.flash_path()).expect("it was stored");
    for byte in 0..RECORD_SIZE {
        let mut damaged = whole.clone();
        // Behind the record that names the machine.
        damaged[RECORD_SIZE + byte] ^= 0xFF;
        fs::write(bench.board.flash_path(), damaged).expect("a file");
        bench = bench.restart(&ours);
        bench.logged("no reference is stored");
        bench.logged("damaged, refused: 1");
    }
    // What is refused has no effect, and the next Zero is stored behind it.
    assert!((last_z_um(&bench.live(800, 40.0, |_| ON)) - 40.0).abs() < 0.1);
    bench.live(400, 40.0, |_| ZERO);
    bench.logged("reference 5 stored");
    let mut bench = bench.restart(&ours);
    bench.logged("reference 5 taken up");
    assert!(last_z_um(&bench.live(400, 40.0, |_| ON)).abs() < 0.1);
}

#[test]
fn a_store_that_cannot_be_written_is_logged_and_the_offsets_go_on() {
    let mut bench = Bench::boot(&compiled(1.0));
    // A folder in its place: no file can be opened there.
    fs::create_dir(bench.board.flash_path()).expect("a folder");
    bench.live(800, 40.0, |_| ON);
    assert!(last_z_um(&bench.live(800, 40.0, |_| ZERO)).abs() < 0.1, "zeroed all the same");
    bench.logged("NOT stored");
    println!("{}", bench.logged("lost with the power"));
    assert!((last_z_um(&bench.live(400, 45.0, |_| ZERO)) - 5.0).abs() < 0.1);
}

#[test]
fn a_zero_that_finds_no_samples_is_refused_and_logged() {
    let mut bench = Bench::boot(&compiled(1.0));
    // A sensor at its rail gives no reading.
    let dead = |bench: &mut Bench, control| bench.live(200, 1e4, |_| control);
    dead(&mut bench, ON);
    dead(&mut bench, ZERO);
    println!("{}", bench.logged("zero: the reference stays"));
    // The board has named its machine, and stored nothing else.
    let stored = fs::read(bench.board.flash_path()).expect("the name");
    assert!(stored[RECORD_SIZE..].iter().all(|byte| *byte == 0xFF), "nothing was stored");
}
