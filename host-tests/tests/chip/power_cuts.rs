//! The machine's heat over a power cut: with a battery and a crystal the lags go on over the time that has passed,
//! and without either, or with anything of it wrong, the heat is not known and no offset is given.

use std::{sync::OnceLock, thread};

use trueup_emulator::chip::ModelRunReport;
use trueup_link::{
    frame::Frame,
    layout::STATUS_ID,
    status::{self, StateBits, StatusItem},
};

use crate::{is_clean, logs, offsets_z, support::chip::Chip};

/// Growth by a temperature with a lag of two hours; a second thermometer.
const MACHINE: &str = r#"
[machine]
name = "cut"
kind = "3-axis"

[inputs]
temp_front_c = { channel = 0, kind = "pt100" }
temp_back_c = { channel = 1, kind = "pt100" }

[spindle]
source = "temperature"

[spindle.temperature]
sensor = "temp_front_c"
reference_c = 20.0
k_um_per_c = 10.0
lag_s = 7200.0

[limits]
max_um = { x = 200.0, y = 200.0, z = 500.0 }
slew_um_per_s = 1000.0
link_timeout_ms = 200
hold_ms = 200
"#;
const UM_PER_C: f64 = 10.0;
const LAG_S: f64 = 7_200.0;
/// Temperature of the machine before the cut, and of its front after it.
const WARM_C: f64 = 45.0;
const COOL_C: f64 = 25.0;

/// By then the crystal swings (2 s), the clock is set, and the heat is kept with its time in both copies.
const CUT_MS: u32 = 4_300;
const END_MS: u32 = CUT_MS + 1_500;

fn chip() -> Option<&'static Chip> {
    static CHIP: OnceLock<Option<Chip>> = OnceLock::new();
    CHIP.get_or_init(|| Chip::of_machine(MACHINE).expect("model and image build")).as_ref()
}

/// Warm through until the power goes for so long, `faults` and all; then its front has cooled.
fn life(off_s: u32, faults: &str, options: &[&str]) -> Option<ModelRunReport> {
    let script = format!(
        "0 rtd 0 {WARM_C}\n0 rtd 1 {WARM_C}\n0 flags 2\n300 flags 3\n{CUT_MS} flags 2\n{CUT_MS} rtd 0 {COOL_C}\n\
         {faults}\n{CUT_MS} reset power {off_s}\n{} flags 3\n",
        CUT_MS + 500
    );
    let report = chip()?.live(END_MS, &script, options).expect("the model runs");
    is_clean(&report);
    let before = offsets_z(&report, f64::from(CUT_MS) - 5.0).first().expect("an offset").1;
    assert!((before - (WARM_C - 20.0) * UM_PER_C).abs() < 0.4, "{before} µm before the cut");
    Some(report)
}

/// Z at the end, µm, and its quality.
fn end(report: &ModelRunReport) -> (f64, u8) {
    let line = crate::line(report, &["OffsetZ at", "(last)"]).expect("an offset");
    let quality = line.split("quality ").nth(1).and_then(|rest| rest.split(',').next());
    let quality = quality.and_then(|text| text.trim().parse().ok()).expect("a quality");
    (offsets_z(report, 0.0).last().expect("an offset").1, quality)
}

/// Returns whether the board reported last that its heat is not known.
fn is_heat_unknown(report: &ModelRunReport) -> bool {
    let mut states = report.events.iter().filter_map(|event| {
        let data = event.split(" can 381 ").nth(1)?;
        let bytes: [u8; 8] =
            std::array::from_fn(|n| u8::from_str_radix(&data[2 * n..2 * n + 2], 16).expect("hex"));
        let frame = Frame::new(STATUS_ID, &bytes).expect("eight bytes");
        match status::decode(&frame).expect("a status").item {
            StatusItem::State(bits) => Some(bits),
            _ => None,
        }
    });
    states.next_back().expect("a state").0 & StateBits::HEAT_UNKNOWN.0 != 0
}

/// Returns what the lag makes of the cut: the front at `COOL_C` for all of it, and a second since.
fn expected_um(off_s: f64) -> f64 {
    let lagged = COOL_C + (WARM_C - COOL_C) * (-(off_s + 1.0) / LAG_S).exp();
    (lagged - 20.0) * UM_PER_C
}

#[test]
fn with_battery_and_crystal_the_heat_goes_on_over_the_time_that_has_passed() {
    if chip().is_none() {
        return;
    }
    thread::scope(|scope| {
        // A second, an hour, a week: by then it is as cool as its front.
        for off_s in [1, 3_600, 604_800] {
            scope.spawn(move || {
                let report = life(off_s, "", &["--battery"]).expect("it is there");
                logs(&report, "the clock that outlasts a power cut is set");
                let off_reported_s =
                    report.log.iter().find_map(|line| line.split("power was gone for ").nth(1));
                let off_reported_s =
                    off_reported_s.and_then(|text| text.split(' ').next()?.parse::<u32>().ok());
                // Since it was kept, up to a second before the cut; a crystal is good to 20 ppm.
                let off_reported_s = off_reported_s.expect("it says for how long");
                assert!(
                    (off_s..=off_s + 2 + off_s / 50_000).contains(&off_reported_s),
                    "{off_reported_s}"
                );
                let (got, quality) = end(&report);
                let expected = expected_um(f64::from(off_s));
                println!("off for {off_s} s: {got:.2} µm, without a cut {expected:.2} µm");
                // A step of the converter is 0.03 K, 0.3 µm; the clock tells whole seconds, 0.02 µm.
                assert!((got - expected).abs() < 0.4, "{off_s} s: {got} for {expected}");
                assert_eq!(quality, 1);
                assert!(!is_heat_unknown(&report));
            });
        }
    });
}

/// Returns what makes the backup worth nothing, and how long the power is gone.
fn worthless() -> Vec<(&'static str, String, &'static [&'static str], u32)> {
    let cut = CUT_MS;
    let battery: &[&str] = &["--battery"];
    // Both copies, in the middle.
    let damaged = format!("{cut} poke 0x40024080 100\n{cut} poke 0x40024300 100");
    vec![
        ("no battery", String::new(), &[], 3_600),
        ("a battery that is flat", format!("{cut} battery 0"), battery, 3_600),
        ("no crystal", String::new(), &["--battery", "--lse-dead"], 3_600),
        ("a crystal that stops", format!("{cut} lse 0"), battery, 3_600),
        ("one that swings again", format!("{cut} lse 0\n{} lse 1", cut + 1), battery, 3_600),
        ("content that is damaged", damaged, battery, 3_600),
        ("a clock that was set back", format!("{cut} calendar 0 1231"), battery, 1),
        ("a clock years ahead", format!("{cut} calendar 0 92101"), battery, 1),
    ]
}

#[test]
fn with_anything_of_it_wrong_the_heat_is_not_known_and_no_offset_is_given() {
    if chip().is_none() {
        return;
    }
    thread::scope(|scope| {
        for (what, faults, options, off_s) in worthless() {
            scope.spawn(move || {
                let report = life(off_s, &faults, options).expect("it is there");
                logs(&report, "nothing is known of before the power cut");
                let (_, quality) = end(&report);
                println!("{what}: quality {quality}");
                assert_eq!(quality, 6, "{what}");
                assert!(is_heat_unknown(&report), "{what}");
            });
        }
    });
}

#[test]
fn one_damaged_copy_costs_a_second_and_what_was_not_believed_once_is_not_believed_later() {
    if chip().is_none() {
        return;
    }
    let again = CUT_MS + 150;
    thread::scope(|scope| {
        for copy in ["0x40024080", "0x40024300"] {
            scope.spawn(move || {
                let faults = format!("{CUT_MS} poke {copy} 100");
                let report = life(3_600, &faults, &["--battery"]).expect("it is there");
                let (got, quality) = end(&report);
                assert_eq!(quality, 1);
                assert!((got - expected_um(3_600.0)).abs() < 0.4, "{got}");
            });
        }
        // Set back, and right again before the next cut: the first start has wiped what it did not believe.
        scope.spawn(move || {
            let faults = format!(
                "{CUT_MS} calendar 0 1231\n{again} calendar 500 12101\n{again} reset power 1"
            );
            let report = life(1, &faults, &["--battery"]).expect("it is there");
            assert_eq!(end(&report).1, 6);
            assert!(is_heat_unknown(&report));
        });
        // Known, and cut again at once: the hour counts once, by what is seen in the end.
        scope.spawn(move || {
            let faults = format!("{again} reset software");
            let report = life(3_600, &faults, &["--battery"]).expect("it is there");
            let (got, quality) = end(&report);
            assert_eq!(quality, 1);
            assert!((got - expected_um(3_600.0)).abs() < 0.4, "{got}");
        });
    });
}
