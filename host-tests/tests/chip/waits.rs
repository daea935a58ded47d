//! How long a task waits at the longest, and how long interrupts are off, on each clock that the board may have to
//! live with: below half of the deadline (`src/main.rs`), at 16 MHz below two thirds, and no offset is lost on the serial
//! line.
//! `docs/robustness.md` has the figures.

use std::{sync::OnceLock, thread};

use trueup_bounds::report::TimingBounds;
use trueup_checks::timing_bounds;
use trueup_emulator::{
    chip::ModelRunReport,
    full_load::{self, CLOCK_SCENARIOS, ClockScenario},
};

use super::parts;

/// Lines of interrupts, the task of each, and its deadline in µs.
const LINES: [(u32, &str, f64); 7] = [
    (20, "can_receive_0", 2_000.0),
    (21, "can_receive_1", 2_000.0),
    (37, "serial_receive", 1_390.0),
    (58, "serial_receive", 1_390.0),
    (56, "sample", 1_000.0),
    (50, "modbus", 4_500.0),
    (70, "transmit", 5_000.0),
];
/// Share of a deadline that a wait may take.
const SHARE: f64 = 1.0 / 2.0;
/// The same at 16 MHz, where crystal and PLL are dead: there is no CAN, and the board reports that it is degraded.
const SLOW_SHARE: f64 = 2.0 / 3.0;
/// At 19 200 Bd the bytes in the queue of `modbus` last six times as long.
const SLOW_MODBUS_US: f64 = 27_000.0;
/// Interrupts that software starts, the task of each, and its deadline in µs: how long it is pending.
const STARTED: [(&str, &str, f64); 4] = [
    ("EXTI0", "listen", 11_000.0),
    ("SysTick", "supervise", 100_000.0),
    ("EXTI3", "service", 10_000.0),
    ("EXTI2", "thermometers", 1_000_000.0),
];

/// Work of every 10 ms, every 100 ms or once a second may fall together with bytes and frames from the lines,
/// or not: at 16 MHz the script is played as often as this, this many ms later each time.
const LATER_MS: [u32; 6] = [0, 1, 3, 7, 11, 17];

/// Returns the number before the unit behind these words, in µs.
fn behind(report: &ModelRunReport, words: &str) -> Option<f64> {
    let (_, rest) = report.stdout.split_once(words)?;
    rest.trim_start_matches([':', ' ']).split_once(" µs")?.0.parse().ok()
}

/// Offsets on the serial line, and how often one did not follow the other.
fn offsets(report: &ModelRunReport) -> (usize, usize) {
    let counter = |event: &String| {
        let (_, data) = event.split_once(" serial t2818")?;
        Some(u8::from_str_radix(&data[4..6], 16).expect("hex"))
    };
    let all: Vec<u8> = report.events.iter().filter_map(counter).collect();
    (all.len(), all.windows(2).filter(|pair| pair[1] != pair[0].wrapping_add(1)).count())
}

/// Panics if a turn was longer than its bound.
fn is_bounded(clock: &str, report: &ModelRunReport) {
    static BOUNDS: OnceLock<TimingBounds> = OnceLock::new();
    let (_, image) = parts().expect("the image was run");
    let bounds =
        BOUNDS.get_or_init(|| timing_bounds::compute_bounds(image).expect("the image is bounded"));
    let seen = full_load::parse_max_handler_times_us(report);
    for bound in bounds.all.iter().filter(|bound| bound.clock == clock) {
        if let Some([own, _]) = seen.get(&bound.exception) {
            assert!(*own <= bound.turn_us, "{clock}, {}: {own} µs, {bound:?}", bound.task);
        }
    }
    assert!(seen.len() > 6, "the model says how long turns take: {}", report.stdout);
}

#[test]
fn no_task_waits_for_half_its_deadline_nor_at_16_mhz_for_two_thirds() {
    let lived = |of: ClockScenario, later_ms: u32| {
        let (clock, .., byte_us) = of;
        let Some((model, image)) = parts() else { return };
        let report = full_load::run(model, image, &of, later_ms).expect("the model runs");
        // At 16 MHz the serial line is 2.1 % fast, which the model notes.
        let is_as_known =
            report.stdout.contains("Violation: 1") && report.stdout.contains("941176 Bd");
        assert!(report.clean || is_as_known, "{}", report.stdout);
        assert_eq!(report.stdout.matches(" 0 overruns").count(), 2, "{}", report.stdout);
        let masked = behind(&report, "PRIMASK set for").expect("some");
        let (_, plc) = report.stdout.split_once("RS-485").expect("it is reported");
        let (_, plc) = plc.split_once("waits ").expect("it is reported");
        let byte: f64 = plc.split_once(" µs").expect("a time").0.parse().expect("a number");
        let mut text =
            format!("{clock}, {later_ms} ms later: interrupts off {masked}, modbus_line {byte}");
        assert!(masked < byte_us / 2.0 && byte < byte_us / 2.0, "{text}");
        let logged = |words: &str| {
            let (_, rest) = report.stdout.split_once(words).expect("it is reported");
            rest.lines().next().expect("a line").split(", ").collect::<Vec<_>>()
        };
        let up = logged("lines up at the longest: ");
        let pending = logged("pending at the longest: ");
        let lines = LINES.map(|(line, task, deadline)| (&up, line.to_string(), task, deadline));
        let started = STARTED.map(|(name, task, deadline)| (&pending, name.into(), task, deadline));
        for (waits, name, task, deadline) in lines.into_iter().chain(started) {
            let name = format!("{name}: ");
            let wait = waits.iter().find_map(|line| line.strip_prefix(&name)?.strip_suffix(" µs"));
            // Without a crystal there is no CAN; half a ring of bytes in a row need not come; the supervisor may never
            // have waited.
            let Some(wait) = wait else {
                let is_silent = task.starts_with("can_") && clock != "168 MHz";
                let may_not = ["serial_receive", "supervise"].contains(&task);
                assert!(is_silent || may_not, "{clock}: no {task}");
                continue;
            };
            text += &format!(", {task} {wait}");
            let is_slow = clock == "16 MHz" && task == "modbus";
            let deadline = if is_slow { SLOW_MODBUS_US } else { deadline };
            let share = if clock == "16 MHz" { SLOW_SHARE } else { SHARE };
            assert!(wait.parse::<f64>().expect("a number") < deadline * share, "{text}");
        }
        is_bounded(clock, &report);
        let (count, lost) = offsets(&report);
        println!("{text} µs; {count} offsets on the serial line, {lost} lost");
        assert!(count > 600 && lost == 0, "{clock}");
    };
    let lived = &lived;
    thread::scope(|scope| {
        for clock in CLOCK_SCENARIOS {
            let later = if clock.0 == "16 MHz" { &LATER_MS[..] } else { &LATER_MS[..1] };
            for &later_ms in later {
                scope.spawn(move || lived(clock, later_ms));
            }
        }
    });
}
