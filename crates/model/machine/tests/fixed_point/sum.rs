//! The sum of all parts, at knots, at pitch points and at random.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use trueup_core::curve::CURVE_SEGMENT_SIZE;
use trueup_machine::Machine;

use crate::{bench::*, gantry::*};

/// Where something begins or ends on each axis: knots and pitch points, in position units.
fn corners(machine: &Machine, axis: usize) -> Vec<i32> {
    let mut places_mm: Vec<f64> = machine
        .straightness
        .iter()
        .filter(|curve| curve.along.index() == axis)
        .flat_map(|curve| curve.spline.knots_mm.iter().copied())
        .collect();
    let own = &machine.axes[axis];
    let tables = own.pitch.iter().chain(own.dual.iter().map(|dual| &dual.pitch));
    for pitch in tables {
        places_mm
            .extend((0..pitch.forward_um.len()).map(|n| pitch.start_mm + pitch.step_mm * n as f64));
    }
    if axis == 1 {
        let beam = machine.axes[0].dual.as_ref().expect("a gantry");
        places_mm.extend([beam.first_mm, beam.second_mm]);
    }
    places_mm.iter().map(|mm| (mm * UNITS_PER_MM).round() as i32).collect()
}

#[test]
fn a_whole_gantry_fits_the_board_with_at_most_24_bytes_a_segment() {
    for seed in 0..12 {
        let (_, compiled) = compiled(&whole_machine(seed));
        let calibration = compiled.calibration();
        let bytes = compiled.blob().len();
        let (mut segments, mut of_curves) = (0, 0);
        for curve in &calibration.straightness {
            let parts = (curve.segments().len(), curve.index().len());
            segments += parts.0;
            of_curves += parts.0 * CURVE_SEGMENT_SIZE + 2 * parts.1;
        }
        let each = of_curves as f64 / segments as f64;
        println!(
            "seed {seed}: {bytes} bytes, {segments} segments of {each:.2} bytes, worst part {:.4} nm",
            compiled.largest_difference_nm
        );
        assert_eq!(segments, 6 * 64);
        assert!(bytes <= 16_384 && each <= 24.0);
    }
}

#[test]
fn the_sum_of_everything_is_within_10_nm_at_every_knot_and_every_pitch_point() {
    let mut worst = Worst::default();
    let mut count = 0;
    for seed in 100..106 {
        let (machine, compiled) = compiled(&whole_machine(seed));
        let mut bench = Bench::new(&machine, &compiled);
        let random = &mut Random(seed);
        let mut time_s = 0.0;
        let start = Moment::random(random, time_s);
        bench.model_nm(&start, [0; 3], [false; 3]);
        for axis in 0..3 {
            for corner in corners(&machine, axis) {
                time_s += 0.1;
                let moment = Moment::random(random, time_s);
                bench.go_to(&moment, 1);
                for adjacent in [-1, 0, 1] {
                    let (mut position, mut reverse) = anywhere(random);
                    position[axis] = corner + adjacent;
                    for way in [false, true] {
                        reverse[axis] = way;
                        bench.compare(&moment, position, reverse);
                        count += 1;
                    }
                }
            }
        }
        worst = worst.or(bench.worst);
    }
    println!("{count} corners: {:.3} nm, {}", worst.nm, worst.inputs);
    assert!(count > 30_000);
}

fn random_points(machines: u64, count: u32) {
    let mut worst = [Worst::default(), Worst::default(), Worst::default()];
    for seed in 0..machines {
        let (machine, compiled) = compiled(&whole_machine(1_000 + seed));
        let mut bench = Bench::new(&machine, &compiled);
        bench.sweep(&mut Random(seed), count / machines as u32, 50);
        let source = machine.spindle.source.expect("every machine has one") as usize;
        worst[source] = std::mem::take(&mut worst[source]).or(bench.worst);
    }
    for worst in worst {
        println!("{count} points: {:.3} nm, {}", worst.nm, worst.inputs);
    }
}

#[test]
fn the_sum_of_everything_is_within_10_nm_at_random() {
    random_points(6, 200_000 + 4);
}

#[test]
#[ignore = "campaign: cargo test -p trueup-machine --test fixed_point -- --ignored --show-output"]
fn campaign_the_sum_of_everything_is_within_10_nm_at_ten_million_points() {
    random_points(60, 10_000_020);
}

// Signs: each part by itself, on all three ways.
