//! The result of `trueup learn`, brought to the emulated board while it is engaged: from the two machine files
//! to the offset, and no farther than the calibration permits.

mod support;

use support::bench::{self, Bench};
use trueup_canopen::emergency::Fault;
use trueup_core::{
    cnc::{Control, OffsetQuality, Output},
    learned_changes::{LEARNED_PART_COUNT, LearnedChangeRequest, calibration_id},
};
use trueup_learn::LiveUpdate;
use trueup_machine::{Machine, compile, machine_file::LearnedChangeLimits};

const GROWN_UM: f64 = 40.0;
/// The offset without what was learned is known to this much.
const NOISE_UM: f64 = 0.1;
/// A part of 1 % takes so long.
const WAY_MS: u32 = 100_000;

/// Returns the paper's spindle with these caps.
fn paper(learned: LearnedChangeLimits) -> Machine {
    let mut machine = bench::paper();
    machine.limits.learned = learned;
    machine
}

/// A board with its CNC, which says what was learned.
struct Lesson {
    bench: Bench,
    crc: u32,
}

impl Lesson {
    fn boot(machine: &Machine) -> Self {
        let calibration = compile(machine).expect("it compiles");
        Self { bench: Bench::boot(&calibration), crc: calibration.crc() }
    }

    /// Engaged for so long; each `Control` says a part of these amounts. Gives every offset of Z in µm.
    fn live(&mut self, ms: u32, amounts: Option<[i16; LEARNED_PART_COUNT]>) -> Vec<f64> {
        let calibration = calibration_id(self.crc);
        let learned_frame = |counter: u8| {
            let part = counter % LEARNED_PART_COUNT as u8;
            let amount = |all: [i16; LEARNED_PART_COUNT]| all[usize::from(part)];
            let change =
                |all| LearnedChangeRequest { part: part + 1, amount: amount(all), calibration };
            let learned = amounts.map(change).unwrap_or_default();
            Control { learned, ..Control::REFERENCED }
        };
        self.bench.live(ms, GROWN_UM, learned_frame).iter().filter_map(z_um).collect()
    }

    fn is_refused(&self) -> bool {
        self.bench.faults.contains(&Fault::LearnedRefused)
    }
}

fn z_um(output: &Output) -> Option<f64> {
    output
        .offset
        .filter(|_| output.quality == OffsetQuality::Live)
        .map(|[_, _, z]| f64::from(z.0) / 1e3)
}

/// Over the last second.
fn mean(all: &[f64]) -> f64 {
    let last = &all[all.len().saturating_sub(1_000)..];
    last.iter().sum::<f64>() / last.len() as f64
}

#[test]
fn what_was_learned_ends_in_the_offset_of_a_board_that_is_engaged_and_is_taken_back() {
    let runs = paper(LearnedChangeLimits {
        growth_percent: 2.0,
        zero_um: 1.0,
        ..LearnedChangeLimits::default()
    });
    let mut learned = runs.clone();
    let sensor = learned.spindle.sensor.as_mut().expect("it has one");
    sensor.um_per_count *= 1.01;
    sensor.k0_um += 0.5;
    let live = LiveUpdate::from_difference(&runs, &learned).expect("both are for a board");
    assert_eq!((live.amounts, live.rest), ([1_000, 0, 0, 0, 500], vec![]));

    let mut lesson = Lesson::boot(&runs);
    let before = mean(&lesson.live(2_000, None));
    assert!((before - GROWN_UM).abs() < NOISE_UM, "{before}");
    let way = lesson.live(WAY_MS + 2_000, Some(live.amounts));
    let after = mean(&way);
    let expected = before + 0.01 * GROWN_UM + 0.5;
    println!("{before:.3} µm, then {after:.3} µm, of {expected:.3}");
    assert!((after - expected).abs() < 0.02, "{after} instead of {expected}");
    // Its way is a ramp: after half of the time half of the share, and all of the zero.
    let half = mean(&way[..way.len() / 2]);
    assert!((half - (before + 0.005 * GROWN_UM + 0.5)).abs() < 0.02, "{half}");
    let back = mean(&lesson.live(WAY_MS + 2_000, Some([0; LEARNED_PART_COUNT])));
    assert!((back - before).abs() < 0.02, "{back} instead of {before}");
    assert!(!lesson.is_refused(), "{:?}", lesson.bench.faults);
}

#[test]
fn a_board_whose_calibration_permits_nothing_refuses_reports_and_goes_on_as_before() {
    let mut lesson = Lesson::boot(&paper(LearnedChangeLimits::default()));
    let before = mean(&lesson.live(2_000, None));
    let after = mean(&lesson.live(10_000, Some([1_000, 0, 0, 0, 500])));
    assert!((after - before).abs() < 0.02, "{after} instead of {before}");
    assert!(lesson.is_refused(), "{:?}", lesson.bench.faults);
}
