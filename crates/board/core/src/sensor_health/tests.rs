//! Codes that the sensor may give, and codes that it may not.

use super::*;
extern crate std;

/// Codes that never repeat, around `level`.
fn lively(level: u16) -> [AdcCode; CODES_PER_TICK] {
    core::array::from_fn(|n| AdcCode(level + (n % 2) as u16))
}

#[test]
fn a_spike_is_replaced_by_the_last_good_code() {
    let mut health = SensorHealthMonitor::default();
    let mut codes = lively(700);
    codes[5] = AdcCode(4095);
    codes[6] = AdcCode(0);
    let clean = health.check_and_clean_codes(&codes, false).expect("two codes are a spike");
    assert_eq!(clean[5], codes[4]);
    assert_eq!(clean[6], codes[4]);
    assert_eq!(clean[7], codes[7]);
}

#[test]
fn four_codes_at_a_rail_are_a_fault_until_10_ms_are_good() {
    for rail in [AdcCode(0), AdcCode(8), AdcCode(4087), AdcCode(4095)] {
        let mut health = SensorHealthMonitor::default();
        assert!(health.check_and_clean_codes(&lively(700), false).is_some());
        let mut codes = lively(700);
        codes[..3].fill(rail);
        assert!(health.check_and_clean_codes(&codes, false).is_some(), "three are not yet a fault");
        codes[..4].fill(rail);
        assert!(health.check_and_clean_codes(&codes, false).is_none(), "four are");
        let blind = (0..)
            .take_while(|_| health.check_and_clean_codes(&lively(700), false).is_none())
            .count();
        // 16 good codes came with the fault.
        assert_eq!(blind * CODES_PER_TICK, 180);
    }
}

#[test]
fn a_sensor_at_the_rail_that_noise_takes_off_at_times_is_a_fault() {
    for pattern in [&[0, 0, 0, 20][..], &[0, 20], &[0, 0, 20, 20], &[4095, 4000, 4095]] {
        let mut health = SensorHealthMonitor::default();
        assert!(health.check_and_clean_codes(&lively(700), false).is_some());
        let codes = core::array::from_fn(|n| AdcCode(pattern[n % pattern.len()]));
        let blind = (0..20)
            .map(|_| health.check_and_clean_codes(&codes, false).is_none())
            .collect::<std::vec::Vec<_>>();
        assert!(blind[2..].iter().all(|is_blind| *is_blind), "{pattern:?}: {blind:?}");
    }
    // A spike in twenty codes is none.
    let mut health = SensorHealthMonitor::default();
    let mut codes = lively(700);
    codes[7] = AdcCode(0);
    assert!((0..1_000).all(|_| health.check_and_clean_codes(&codes, false).is_some()));
}

#[test]
fn a_board_that_starts_with_a_broken_wire_is_blind() {
    let mut health = SensorHealthMonitor::default();
    for _ in 0..100 {
        assert!(health.check_and_clean_codes(&[AdcCode(0); CODES_PER_TICK], false).is_none());
    }
}

#[test]
fn a_frozen_converter_is_found_after_200_ms_and_a_lively_one_never() {
    let mut health = SensorHealthMonitor::default();
    assert!(
        (0..300).all(|_| health
            .check_and_clean_codes(&[AdcCode(700); CODES_PER_TICK], false)
            .is_none()),
        "from the start"
    );
    let before =
        (0..1_000).take_while(|_| health.check_and_clean_codes(&lively(700), false).is_some());
    assert_eq!(before.count(), 1_000);
    let alive = (0..).take_while(|_| {
        health.check_and_clean_codes(&[AdcCode(701); CODES_PER_TICK], false).is_some()
    });
    assert_eq!(alive.count(), 199, "the last code of the block before is the same");
    assert!(health.check_and_clean_codes(&lively(700), false).is_some(), "one change ends it");
    for _ in 0..1000 {
        assert!(health.check_and_clean_codes(&lively(700), false).is_some());
    }
}

#[test]
fn a_quiet_sensor_is_not_frozen_and_neither_is_one_whose_spindle_has_stopped() {
    let mut health = SensorHealthMonitor::default();
    // A change in ten blocks: noise far below 0.3 codes, and then none for seconds.
    for n in 0..10_000 {
        let code = if n % 10 == 0 { lively(700) } else { [AdcCode(701); CODES_PER_TICK] };
        assert!(health.check_and_clean_codes(&code, false).is_some(), "at {n}");
    }
    assert!(
        (0..10_000).all(|_| health
            .check_and_clean_codes(&[AdcCode(701); CODES_PER_TICK], false)
            .is_some())
    );
    // Run-out of ±10 codes without any noise, and then a spindle that stands.
    let mut health = SensorHealthMonitor::default();
    for ms in 0..5_000_u32 {
        let codes = core::array::from_fn(|n| {
            let angle = (f64::from(ms) + n as f64 / 20.0) * 0.2 * core::f64::consts::TAU;
            AdcCode((700.0 + 10.0 * angle.sin()).round() as u16)
        });
        assert!(health.check_and_clean_codes(&codes, true).is_some());
    }
    assert!(
        (0..10_000).all(|_| health
            .check_and_clean_codes(&[AdcCode(701); CODES_PER_TICK], false)
            .is_some())
    );
    // And turns again, without a change: that is no spindle, once run-out must have shown.
    let starts = (0..)
        .take_while(|_| {
            health.check_and_clean_codes(&[AdcCode(701); CODES_PER_TICK], true).is_some()
        })
        .count();
    assert_eq!(starts, 199, "the last code before is the same");
}

#[test]
fn noise_is_measured_through_growth_and_run_out() {
    // ±1 code alternating has an RMS of 1 and second differences of ±4, where white noise of
    // the same RMS has √6: so the estimate of this stream is 4/√6.
    let mut health = SensorHealthMonitor::default();
    let codes = core::array::from_fn(|n| AdcCode(if n % 2 == 0 { 999 } else { 1001 }));
    health.check_and_clean_codes(&codes, false);
    health.take_noise_statistics();
    health.check_and_clean_codes(&codes, false);
    let noise = health.take_noise_statistics();
    assert_eq!((noise.squares, noise.count), (20 * 16, 20));
    assert_eq!(health.take_noise_statistics(), NoiseStatistics::default());
}

#[test]
fn the_codes_next_to_the_rails_are_a_measurement() {
    for edge in [9, 4086] {
        let mut health = SensorHealthMonitor::default();
        assert!(health.check_and_clean_codes(&lively(700), false).is_some());
        // Alive, and at the edge in every other code.
        let inside = if edge == 9 { 10 } else { 4085 };
        let codes = core::array::from_fn(|n| AdcCode(if n % 2 == 0 { edge } else { inside }));
        // As another level.
        assert!(health.check_and_clean_codes(&codes, false).is_some());
        for _ in 0..100 {
            assert_eq!(health.check_and_clean_codes(&codes, false), Some(&codes), "{edge}");
        }
    }
}

/// Returns a number of 16 bits that looks drawn (splitmix64).
fn drawn(number: u32) -> u32 {
    let mut z = u64::from(number).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (z >> 48) as u32
}

/// Milliseconds of a spindle at 24,000 r/min with run-out of 5 µm, a part of it with three waves in a turn, that shakes by
/// `shakes` codes at 1 kHz; and noise that is drawn, of up to ±`noise` codes, evenly.
fn running(from_ms: u32, shakes: f64, noise: u32) -> [AdcCode; CODES_PER_TICK] {
    core::array::from_fn(|n| {
        let number = from_ms * 20 + n as u32;
        let turns = f64::from(number) / 50.0 * core::f64::consts::TAU;
        let even = f64::from(drawn(number)) / f64::from(1 << 15) - 1.0;
        let moved = 35.0 * turns.sin() + 6.0 * (3.0 * turns).sin() + shakes * (2.5 * turns).sin();
        AdcCode((700.0 + moved + f64::from(noise) * even).round() as u16)
    })
}

/// Returns a sensor that has been received for half a second.
fn running_health(noise: u32) -> SensorHealthMonitor {
    let mut health = SensorHealthMonitor::default();
    (0..500).for_each(|ms| {
        assert!(health.check_and_clean_codes(&running(ms, 0.0, noise), true).is_some())
    });
    health
}

#[test]
fn a_machine_that_runs_out_and_shakes_passes_as_it_is() {
    for (shakes, noise) in [(0.0, 0), (0.0, 5), (82.0, 0), (41.0, 2)] {
        let mut health = SensorHealthMonitor::default();
        for ms in 0..5_000 {
            let codes = running(ms, shakes, noise);
            assert_eq!(
                health.check_and_clean_codes(&codes, true),
                Some(&codes),
                "{shakes}, {noise}, {ms}"
            );
            assert!(!health.has_jumped());
        }
    }
}

#[test]
fn up_to_three_codes_out_of_reach_are_a_spike_and_no_jump() {
    for (by, noise) in [(33, 0), (70, 5), (2_000, 5), (-70, 5), (-600, 0)] {
        for length in 1..=3 {
            let mut health = running_health(noise);
            let mut codes = running(500, 0.0, noise);
            let whole = codes;
            for code in &mut codes[7..7 + length] {
                *code = AdcCode(code.0.wrapping_add_signed(by));
            }
            let mended = *health.check_and_clean_codes(&codes, true).expect("a spike");
            assert_eq!(mended[7..7 + length], [whole[6]; 3][..length], "{by}");
            assert_eq!((&mended[..7], &mended[7 + length..]), (&whole[..7], &whole[7 + length..]));
            assert!(!health.has_jumped());
        }
    }
}

#[test]
fn a_level_out_of_reach_is_believed_with_its_fourth_code_and_reported_for_100_ms() {
    for by in [60, 300, 2_000, -60, -600] {
        let mut health = running_health(2);
        let jumped = |ms| running(ms, 0.0, 2).map(|code| AdcCode(code.0.wrapping_add_signed(by)));
        let mut codes = running(500, 0.0, 2);
        let after = jumped(500);
        codes[9..].copy_from_slice(&after[9..]);
        let passed = *health.check_and_clean_codes(&codes, true).expect("another level");
        assert_eq!(passed[9..12], [codes[8]; 3]);
        assert_eq!(passed[12..], codes[12..]);
        let mut reported_ms = 0;
        while health.has_jumped() {
            reported_ms += 1;
            let codes = jumped(500 + reported_ms);
            assert_eq!(health.check_and_clean_codes(&codes, true), Some(&codes));
        }
        assert_eq!(reported_ms, 100, "{by}");
    }
}

#[test]
fn a_level_is_reported_wherever_in_a_block_it_begins() {
    for by in [60, 300, -600] {
        for first in 0..CODES_PER_TICK {
            let mut health = running_health(2);
            let jumped =
                |ms| running(ms, 0.0, 2).map(|code| AdcCode(code.0.wrapping_add_signed(by)));
            let mut codes = running(500, 0.0, 2);
            codes[first..].copy_from_slice(&jumped(500)[first..]);
            assert!(health.check_and_clean_codes(&codes, true).is_some());
            let is_reported = (501..503).any(|ms| {
                assert!(health.check_and_clean_codes(&jumped(ms), true).is_some());
                health.has_jumped()
            });
            assert!(is_reported, "{by} from code {first} of a block on");
        }
    }
}

#[test]
fn a_step_before_the_analogue_low_pass_is_reported_from_30_um_on() {
    // Two poles at 2 kHz: 1 − (1 + ωt)·e^(−ωt).
    let is_detected = |by: f64| {
        let mut health = running_health(1);
        (500..510).any(|ms| {
            let mut codes = running(ms, 0.0, 1);
            for (n, code) in codes.iter_mut().enumerate() {
                let x = 0.2 * core::f64::consts::PI * (f64::from(ms - 500) * 20.0 + n as f64);
                code.0 += (by * (1.0 - (1.0 + x) * (-x).exp())) as u16;
            }
            assert!(health.check_and_clean_codes(&codes, true).is_some(), "a step is no fault");
            health.has_jumped()
        })
    };
    let first =
        (0..400).find(|codes| is_detected(f64::from(*codes))).expect("a large one is detected");
    std::println!("detected from {first} codes on");
    assert!((139..=245).contains(&first));
    assert!((first..3_000).step_by(20).all(|codes| is_detected(f64::from(codes))));
}

#[test]
fn codes_that_follow_from_nothing_are_a_fault_in_2_ms_until_10_ms_are_good() {
    for wide in [200, 1_000, 3_000] {
        let mut health = running_health(2);
        let wild = |ms: u32| {
            core::array::from_fn(|n| AdcCode(500 + (drawn(ms * 20 + n as u32) % wide) as u16))
        };
        let found = (500..)
            .take_while(|ms| health.check_and_clean_codes(&wild(*ms), true).is_some())
            .count();
        assert!(found < 3, "{wide}: {found}");
        assert!(
            (510..2_000).all(|ms| health.check_and_clean_codes(&wild(ms), true).is_none()),
            "{wide}"
        );
        let mut blind = (2_000..)
            .take_while(|ms| health.check_and_clean_codes(&running(*ms, 0.0, 2), true).is_none());
        assert!((9..=11).contains(&blind.by_ref().count()));
    }
}

#[test]
fn codes_after_a_gap_have_not_jumped() {
    for missing in 1..5 {
        let mut health = running_health(2);
        for turn in 0..100 {
            health.record_gap();
            let codes = running(500 + 7 * turn + missing, 0.0, 2);
            assert_eq!(health.check_and_clean_codes(&codes, true), Some(&codes));
            assert!(!health.has_jumped());
        }
    }
}
