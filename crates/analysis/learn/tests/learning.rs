//! The promises of `trueup learn` for single records: refusals with a reason, bounds, the way back.

use std::path::Path;

use trueup_campaigns::simulated_year::{MachineKind, YearConfig, simulate_year};
use trueup_learn::{EventKind, LearnerState, LearningLimits, LearningResult, learn_from_run};
use trueup_machine::{MachineFile, RunFile};

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
                       [spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20.0\n\
                       k_um_per_c = 2.0 # the maker's\n";

/// Returns a record of readings every half hour, `um` of the temperature and the number of the reading.
fn record(first_s: f64, count: usize, um: impl Fn(f64, usize) -> f64) -> RunFile {
    let mut text = "time_s,temp_a_c,measured_elongation_um\n".to_string();
    for n in 0..count {
        let celsius = 25.0 + 10.0 * ((n % 7) as f64) / 6.0;
        let scatter = [0.6, -0.6, 0.2, -0.2, -0.4, 0.4][n % 6];
        let time_s = first_s + 1800.0 * n as f64;
        text += &format!("{time_s},{celsius:.3},{:.3}\n", um(celsius, n) + scatter);
    }
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
}

fn taught(run: &RunFile, memory: Option<LearnerState>, limits: &LearningLimits) -> LearningResult {
    learn_from_run(MACHINE, Path::new("m.toml"), run, None, memory, limits)
        .unwrap_or_else(|error| panic!("{error}"))
}

/// k of the machine file.
fn k(learned: &str) -> f64 {
    let line = learned.lines().find_map(|line| line.strip_prefix("k_um_per_c = "));
    let number = line.and_then(|line| line.split('#').next()).expect("it is there");
    number.trim().parse().expect("a number")
}

/// 30 % more than believed.
fn grown(celsius: f64, _: usize) -> f64 {
    2.6 * (celsius - 20.0)
}

#[test]
fn a_constant_that_has_changed_is_followed_and_the_comment_stays() {
    let learned = taught(&record(0.0, 60, grown), None, &LearningLimits::default());
    assert!((k(&learned.machine) - 2.6).abs() < 0.1, "{}", learned.machine);
    assert!(learned.machine.contains("# the maker's"), "{}", learned.machine);
    assert!(learned.half_widths[0] < 0.2 && learned.half_widths[0] > 0.0);
    let change = learned.memory.changes.last().expect("it is logged");
    let mut keys = change.values.iter().map(|(place, ..)| learned.memory.value_key(*place));
    assert!(keys.any(|key| key == "spindle.temperature.k_um_per_c"), "{change:?}");
    assert!(learned.notes.iter().any(|note| note.starts_with("What was learned is applied")));
}

#[test]
fn a_bad_reading_is_refused_with_the_reason_and_one_reading_changes_nothing() {
    let right = |celsius: f64, n: usize| 2.0 * (celsius - 20.0) + if n == 30 { 45.0 } else { 0.0 };
    let learned = taught(&record(0.0, 40, right), None, &LearningLimits::default());
    let bad = &learned.readings[30];
    let reason = bad.reason.as_deref().expect("a reason");
    assert!(!bad.used && reason.contains("times what a reading may differ by"), "{reason}");
    assert_eq!(learned.machine, MACHINE);
    assert!(learned.memory.changes.is_empty());
    // Nor does one alone, however far it is off.
    let one = taught(&record(0.0, 1, |_, _| 80.0), None, &LearningLimits::default());
    assert_eq!(one.machine, MACHINE);
}

#[test]
fn no_bound_is_passed_and_reaching_one_is_reported() {
    let limits = LearningLimits { share: 0.1, ..LearningLimits::default() };
    let learned = taught(&record(0.0, 60, grown), None, &limits);
    assert!(k(&learned.machine) <= 2.2 + 1e-9, "{}", learned.machine);
    assert!(learned.notes.iter().any(|note| note.contains("A bound was reached")));
    let limits = LearningLimits { total_um: 3.0, ..LearningLimits::default() };
    let learned = taught(&record(0.0, 60, grown), None, &limits);
    assert!(learned.memory.applied.iter().all(|x| x.abs() < 3.1), "{:?}", learned.memory.applied);
    // 15 K above the reference is the most: 3 µm of it are 0.2 µm/K.
    assert!(k(&learned.machine) < 2.4, "{}", learned.machine);
}

#[test]
fn a_change_is_undone_and_its_record_is_not_learned_from_again() {
    let first = taught(&record(0.0, 60, grown), None, &LearningLimits::default());
    let mut memory = first.memory.clone();
    let path = Path::new("m.toml");
    let mut undone = 0;
    while memory.undo_last_change().is_ok() {
        undone += 1;
    }
    // A change a day, over two days of readings.
    assert!((1..=2).contains(&undone), "{undone}");
    assert_eq!(memory.apply_to_source(MACHINE, path).as_deref(), Some(MACHINE));
    let again = taught(&record(0.0, 60, grown), Some(memory), &LearningLimits::default());
    assert_eq!((again.readings.len(), again.seen), (0, 60));
    assert_eq!(again.machine, MACHINE);
}

#[test]
fn what_is_known_outlives_the_program_and_a_constant_changed_by_hand_restarts() {
    let first = taught(&record(0.0, 60, grown), None, &LearningLimits::default());
    let text = first.memory.to_json().expect("it can be written");
    let memory = LearnerState::from_json(&text).expect("what was written");
    let next = record(2e5, 12, grown);
    let both = [first.memory, memory]
        .map(|memory| taught(&next, Some(memory), &LearningLimits::default()).machine);
    assert_eq!(both[0], both[1]);
    let memory = LearnerState::from_json(&text).expect("what was written");
    let edited = MACHINE.replace("2.0 #", "2.6 #");
    let learned = learn_from_run(
        &edited,
        Path::new("m.toml"),
        &next,
        None,
        Some(memory),
        &LearningLimits::default(),
    );
    let learned = learned.unwrap_or_else(|error| panic!("{error}"));
    assert!((k(&learned.machine) - 2.6).abs() < 0.1, "{}", learned.machine);
    assert!(learned.has_restarted && learned.notes[0].contains("was changed by hand (2 to 2.6)"));
    assert!(LearnerState::from_json("{}").is_err());
}

#[test]
fn a_row_without_a_temperature_teaches_nothing_and_reports_it() {
    let text = "time_s,temp_a_c,measured_elongation_um\n0,25,10\n60,,55\n";
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
    let learned = taught(&run, None, &LearningLimits::default());
    assert!(!learned.readings[1].used);
    assert!(
        learned.readings[1].reason.as_deref().is_some_and(|reason| reason.contains("temperature"))
    );
}

#[test]
fn a_reference_that_was_shifted_becomes_no_constant() {
    // Right by the file for two days, then touched off 30 µm anew.
    let right = |celsius: f64, _: usize| 2.0 * (celsius - 20.0);
    let shifted = |celsius: f64, n: usize| right(celsius, n) + 30.0;
    let mut memory = Some(taught(&record(0.0, 60, right), None, &LearningLimits::default()).memory);
    for (first_s, count) in [(2e5, 20), (3e5, 40), (5e5, 60)] {
        let learned =
            taught(&record(first_s, count, shifted), memory.take(), &LearningLimits::default());
        assert_eq!(learned.machine, MACHINE, "{:?}", learned.notes);
        memory = Some(learned.memory);
    }
    // Nor where there was no record before it; and it is reported.
    let learned = taught(&record(0.0, 60, shifted), None, &LearningLimits::default());
    assert_eq!(learned.machine, MACHINE);
    let step = &learned.news[0];
    assert_eq!(step.event, EventKind::ZeroStep);
    assert!((step.size - 30.0).abs() < 2.0 && step.check.contains("Touch off again"), "{step:?}");
}

#[test]
fn a_record_that_grows_counts_each_reading_once() {
    let whole = record(1e9, 40, grown);
    let at_once = taught(&whole, None, &LearningLimits::default());
    let mut memory = None;
    for rows in [5, 10, 25, 40] {
        let learned = taught(
            &whole.with_altered_values(rows, |_, _| {}),
            memory.take(),
            &LearningLimits::default(),
        );
        let before = [5, 10, 25, 40].into_iter().filter(|count| *count < rows).max().unwrap_or(0);
        assert_eq!(learned.readings.len(), rows - before);
        memory = Some(learned.memory);
    }
    let memory = memory.expect("four records");
    assert_eq!(memory.to_json().expect("JSON"), at_once.memory.to_json().expect("JSON"));
    // Nothing new in it.
    let again = taught(&whole, Some(memory.clone()), &LearningLimits::default());
    assert_eq!((again.readings.len(), again.seen), (0, 40));
    assert_eq!(again.memory, memory);
}

#[test]
fn a_record_of_an_earlier_date_is_refused_and_a_clock_that_begins_anew_is_reported() {
    let late = taught(&record(2e9, 20, grown), None, &LearningLimits::default()).memory;
    let early = record(1.9e9, 20, grown);
    let refused = learn_from_run(
        MACHINE,
        Path::new("m.toml"),
        &early,
        None,
        Some(late),
        &LearningLimits::default(),
    );
    let rule = refused.expect_err("it is older").rule;
    assert!(rule.contains("at or before the last reading"), "{rule}");
    let first = taught(&record(0.0, 20, grown), None, &LearningLimits::default()).memory;
    let other = record(60.0, 20, grown);
    let learned = taught(&other, Some(first), &LearningLimits::default());
    assert!(learned.notes.iter().any(|note| note.contains("taken as a later day")));
}

/// Readings of a bridge that corrects 2 µm/K; `factor`: of the CNC, `on`: whether it is engaged.
fn of_bridge(factor: f64, gain: f64, on: impl Fn(usize) -> bool) -> RunFile {
    let mut text = "time_s,temp_a_c,offset_z_um,quality,measured_elongation_um\n".to_string();
    for n in 0..80 {
        let celsius = 25.0 + 10.0 * ((n % 7) as f64) / 6.0;
        let scatter = [0.6, -0.6, 0.2, -0.2, -0.4, 0.4][n % 6];
        let lift = if on(n) { 2.0 * (celsius - 20.0) } else { 0.0 };
        let um = gain * 2.0 * (celsius - 20.0) - factor * lift + scatter;
        text += &format!("{},{celsius:.3},{lift:.2},{},{um:.3}\n", 1800 * n, u8::from(on(n)));
    }
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
}

#[test]
fn a_cnc_that_applies_the_offset_otherwise_teaches_nothing() {
    let limits = LearningLimits::default();
    for factor in [-1.0, 0.0, 0.5, 2.0] {
        let half = of_bridge(factor, 1.0, |n| n % 20 < 10);
        let refused = learn_from_run(MACHINE, Path::new("m.toml"), &half, None, None, &limits);
        let rule = refused.expect_err("the CNC is wrong").rule;
        assert!(rule.starts_with("For 1 µm of offset") && rule.contains("eoffset-scale"), "{rule}");
        let learned = taught(&of_bridge(factor, 1.0, |_| true), None, &limits);
        assert_eq!(learned.machine, MACHINE, "{factor}: {:?}", learned.notes);
    }
    // A CNC that is right, and a machine that has changed.
    let learned = taught(&of_bridge(1.0, 1.3, |n| n % 20 < 10), None, &limits);
    assert!((k(&learned.machine) - 2.6).abs() < 0.1, "{:?}", learned.notes);
    let learned = taught(&of_bridge(1.0, 1.3, |_| true), None, &limits);
    assert!((k(&learned.machine) - 2.6).abs() < 0.1, "{:?}", learned.notes);
}

#[test]
fn dates_keep_the_time_between_day_files() {
    // Three days of readings each four hours, and three more a week later: as dates and as seconds of Unix.
    const MONDAY_S: usize = 1_767_571_200;
    let file = |day: usize, is_date: bool| {
        let mut text = "time,temp_a_c,measured_elongation_um\n".to_string();
        for n in 0..6 {
            let clock = match is_date {
                true => format!("2026-01-{:02}T{:02}:00:00Z", day + 5, 4 * n),
                false => (MONDAY_S + 86_400 * day + 14_400 * n).to_string(),
            };
            let celsius = 25.0 + 10.0 * ((n % 7) as f64) / 6.0;
            text += &format!("{clock},{celsius:.3},{:.3}\n", grown(celsius, n));
        }
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
    };
    let states = [true, false].map(|is_date| {
        let mut memory = None;
        for day in [0, 1, 2, 9, 10, 11] {
            let run = file(day, is_date);
            memory = Some(taught(&run, memory.take(), &LearningLimits::default()).memory);
        }
        memory.expect("six days").to_json().expect("JSON")
    });
    assert_eq!(states[0], states[1]);
    // A clock that was set back says what to write.
    let memory = LearnerState::from_json(&states[0]).expect("what was written");
    let text = "time,temp_a_c,measured_elongation_um\n2026-01-16 19:10:00,25,10\n";
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
    let early = learn_from_run(
        MACHINE,
        Path::new("m.toml"),
        &run,
        None,
        Some(memory),
        &LearningLimits::default(),
    );
    let rule = early.expect_err("it is before the last one").rule;
    assert!(rule.contains("2026-01-16 19:10 UTC") && rule.contains("+01:00"), "{rule}");
}

#[test]
fn a_state_of_the_form_before_is_read_and_its_readings_are_known() {
    let first = taught(&record(0.0, 60, grown), None, &LearningLimits::default());
    let state: serde_json::Value =
        serde_json::from_str(&first.memory.to_json().expect("JSON")).expect("JSON");
    let old = serde_json::json!({
        "schema": 2, "base": 1, "quantity": "elongation", "constants": state["constants"],
        "bank": state["checkpoint"], "applied": state["applied"], "last_s": 106_200.0,
        "records": [], "readings": [1, 2], "recent": [], "is_applied_once": false, "changes": [],
    });
    let memory = LearnerState::from_json(&old.to_string()).expect("the form before");
    assert!(LearnerState::is_previous_schema(&old.to_string()));
    assert_eq!(memory.applied, first.memory.applied);
    let learned = taught(&record(2e5, 12, grown), Some(memory), &LearningLimits::default());
    assert!((k(&learned.machine) - 2.6).abs() < 0.1, "{}", learned.machine);
    assert!(learned.notes.iter().any(|note| note.contains("an earlier version")));
}

#[test]
fn every_decision_comes_from_the_readings_so_far() {
    // Right for four days, a crash of 25 µm, bad readings between: read once, and as the file grows by a reading.
    let um = |celsius: f64, n: usize| {
        let bad = if n % 17 == 5 { 40.0 } else { 0.0 };
        2.0 * (celsius - 20.0) + bad + if n >= 90 { 25.0 } else { 0.0 }
    };
    let whole = record(1e9, 120, um);
    let at_once = taught(&whole, None, &LearningLimits::default());
    let mut memory: Option<LearnerState> = None;
    for rows in (1..=120).rev().step_by(3).collect::<Vec<_>>().into_iter().rev() {
        let text = memory.take().map(|state: LearnerState| state.to_json().expect("JSON"));
        let memory_now = text.map(|text| LearnerState::from_json(&text).expect("what was written"));
        let learned = taught(
            &whole.with_altered_values(rows, |_, _| {}),
            memory_now,
            &LearningLimits::default(),
        );
        memory = Some(learned.memory);
    }
    let grown = memory.expect("records").to_json().expect("JSON");
    assert_eq!(grown, at_once.memory.to_json().expect("JSON"));
    let [step] = &at_once.memory.events[..] else { panic!("{:?}", at_once.memory.events) };
    assert_eq!(step.event, EventKind::ZeroStep);
    assert!((step.size - 25.0).abs() < 1.0, "{step:?}");
    assert_eq!(at_once.machine, MACHINE, "the constants stay");
}

#[test]
fn an_event_moves_the_correction_by_the_readings_it_rests_on_and_one_reading_by_one_step() {
    // Right for fifty readings, then 60 % more: 18 µm at the warmest. A step is 1 µm.
    let um = |celsius: f64, n: usize| (if n < 50 { 2.0 } else { 3.2 }) * (celsius - 20.0);
    let whole = record(1e9, 60, um);
    let limits = LearningLimits { step_um: 1.0, ..LearningLimits::default() };
    let at = |rows: usize| {
        let learned = taught(&whole.with_altered_values(rows, |_, _| {}), None, &limits);
        (learned.memory.events, k(&learned.machine))
    };
    let found = (51..60).find(|rows| !at(*rows).0.is_empty()).expect("it is found");
    let rests_on = (found - 50) as f64;
    let celsius = 25.0 + 10.0 * (((found - 1) % 7) as f64) / 6.0;
    let moved = |rows: usize| (at(rows).1 - at(rows - 1).1).abs();
    let moved_um = moved(found) * (celsius - 20.0);
    assert!(rests_on >= 3.0 && moved_um > 1.5, "{rests_on} {moved_um}");
    assert!(moved_um <= rests_on + 0.1, "{rests_on} {moved_um}");
    let celsius = 25.0 + 10.0 * ((found % 7) as f64) / 6.0;
    assert!(moved(found + 1) * (celsius - 20.0) <= 1.1, "the next reading is one");
}

#[test]
fn a_check_of_the_probe_is_taken_off_and_its_absence_is_reported() {
    // A machine that its file describes, a probe that drifts by 12 µm in eighty days, a reading each half day.
    let file = |is_checked: bool| {
        let mut text = "time_s,temp_a_c,measured_elongation_um,check_um\n".to_string();
        for n in 0..160 {
            let celsius = 25.0 + 10.0 * ((n % 7) as f64) / 6.0;
            let drift = 12.0 * f64::from(n) / 160.0;
            let scatter = [0.6, -0.6, 0.2, -0.2, -0.4, 0.4][n as usize % 6];
            let check =
                if is_checked && n % 20 == 0 { format!("{drift:.2}") } else { String::new() };
            let um = 2.0 * (celsius - 20.0) + drift + scatter;
            text += &format!("{},{celsius:.3},{um:.3},{check}\n", 43_200 * n);
        }
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
    };
    let limits = LearningLimits::default();
    let checked = taught(&file(true), None, &limits);
    assert!((checked.memory.applied[0]).abs() < 1.6, "{:?}", checked.memory.applied);
    assert!(checked.news.iter().any(|event| event.event == EventKind::ProbeDrift));
    assert!(!checked.notes.iter().any(|note| note.contains("No check of the probe")));
    let unchecked = taught(&file(false), None, &limits);
    assert!(unchecked.notes.iter().any(|note| note.contains("No check of the probe for 80 days")));
}

/// Probings with two tools at speed: each tool's own growth is the file's, and what changes is the spindle's.
#[test]
fn the_growth_of_each_tool_is_taken_off_before_a_constant_is_learned() {
    let machine = format!(
        "{MACHINE}[spindle.tools]\n7 = {{ um_per_krpm2 = 0.02 }}\ndrill = {{ number = 3, um_per_krpm2 = 0.05 }}\n\
         default = {{ um_per_krpm2 = 0.01 }}\n"
    );
    let probed = |k: f64| {
        let plain = record(0.0, 60, |celsius, n| {
            k * (celsius - 20.0) + [8.0, 20.0, 4.0][n % 3] // 20,000 r/min: 400 times the constant.
        });
        let mut text = "time_s,temp_a_c,measured_elongation_um,spindle_rpm,tool\n".to_string();
        let cells = ["time_s", "temp_a_c", "measured_elongation_um"]
            .map(|name| plain.column(name).expect("there"));
        for n in 0..60 {
            let [time, celsius, um] = [0, 1, 2].map(|column| cells[column][n]);
            text += &format!("{time},{celsius},{um},20000,{}\n", ["7", "drill", "99"][n % 3]);
        }
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
        let file = MachineFile::parse(&machine, Path::new("m.toml")).expect("it is correct");
        let run = run.with_tool_numbers(&file).expect("all are listed");
        learn_from_run(&machine, Path::new("m.toml"), &run, None, None, &LearningLimits::default())
            .unwrap_or_else(|error| panic!("{error}"))
    };
    let quiet = probed(2.0);
    assert_eq!(quiet.machine, machine, "the file is right");
    assert!(quiet.readings.iter().all(|reading| reading.used));
    let changed = probed(2.6);
    assert!((k(&changed.machine) - 2.6).abs() < 0.1, "{}", changed.machine);
    let tools = |text: &str| text.split("[spindle.tools]").nth(1).map(str::to_string);
    assert_eq!(tools(&changed.machine), tools(&machine));
}

/// A thermometer in the air that is dead in some rows, or was never there, is no reason to refuse a reading while nothing
/// depends on it.
#[test]
fn the_air_is_missed_only_where_a_rise_over_it_is_applied() {
    let drawn = simulate_year(7, MachineKind::Axis, YearConfig::default());
    let csv = &drawn.days[0].csv;
    let place =
        csv.lines().next().expect("a head").split(',').position(|column| column == "temp_air_c");
    let place = place.expect("it is there");
    let dead = csv.lines().enumerate().map(|(row, line)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if row > 0 {
            cells[place] = "";
        }
        cells.join(",") + "\n"
    });
    let run = RunFile::from_reader(dead.collect::<String>().as_bytes(), Path::new("r.csv"));
    let path = Path::new("m.toml");
    let learned = learn_from_run(
        &drawn.machine,
        path,
        &run.expect("a run"),
        None,
        None,
        &LearningLimits::default(),
    );
    let readings = learned.expect("it can learn").readings;
    assert!(!readings.is_empty() && readings.iter().all(|reading| reading.used), "{readings:?}");
}

/// Half a year of an axis whose thermometer shows 70 % of its rise over the air from June on.
#[test]
fn a_moved_thermometer_is_followed_by_a_term_over_the_air() {
    let drawn =
        simulate_year(821, MachineKind::Axis, YearConfig { events: true, ..YearConfig::default() });
    let (moved, since) = (&drawn.events[1], 30.0 * 86_400.0);
    assert_eq!(moved.name, "thermometer-moved");
    let mut memory = None;
    let mut last: Option<LearningResult> = None;
    for day in &drawn.days {
        let run = RunFile::from_reader(day.csv.as_bytes(), Path::new("r.csv")).expect("a run");
        if run.column("time_s").expect("a clock")[0] > moved.at_s + since {
            let learned = last.as_ref().expect("days before");
            // Six columns of seven: without the air what is over it is not known.
            let without = day.csv.lines().map(|line| {
                let cells: Vec<&str> = line.split(',').collect();
                [&cells[..4], &cells[5..]].concat().join(",") + "\n"
            });
            let text: String = without.collect();
            assert!(!text.contains("temp_air_c"), "{}", text.lines().next().unwrap_or_default());
            let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
            let memory = Some(learned.memory.clone());
            let path = Path::new("m.toml");
            let after = learn_from_run(
                &drawn.machine,
                path,
                &run,
                None,
                memory,
                &LearningLimits::default(),
            );
            let after = after.expect("it is read");
            assert!(
                !after.readings.is_empty() && after.readings.iter().all(|reading| !reading.used)
            );
            break;
        }
        let path = Path::new("m.toml");
        let learned =
            learn_from_run(&drawn.machine, path, &run, None, memory, &LearningLimits::default());
        let learned = learned.expect("it can learn");
        memory = Some(learned.memory.clone());
        last = Some(learned);
    }
    let learned = last.expect("it has days");
    let value = |text: &str, key: &str| -> f64 {
        let line = text.lines().find_map(|line| line.strip_prefix(key)).expect("a key");
        line.trim_start_matches(" = ").parse().expect("a number")
    };
    let term = learned.machine.split("[[term]]").nth(1).expect("a term");
    assert!(term.contains("minus = \"temp_air_c\""), "{term}");
    // Of a screw that was changed in spring, 1/0.7 − 1 of what its thermometer shows over the air.
    let screw = value(&drawn.machine, "slope_um_per_m_per_c") * (1.0 + drawn.events[0].size);
    let share = value(term, "um_per_unit_per_m") / screw / (1.0 / moved.size - 1.0);
    println!("{share:.3} of the rise that it does not show");
    assert!((share - 1.0).abs() < 0.2, "{share}");
    // Nothing but numbers before the first event.
    let first = learned.memory.events.first().expect("an event");
    assert!(first.at < Some(moved.at_s), "{first:?}");
}
