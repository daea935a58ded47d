use std::path::Path;

use trueup_campaigns::hidden_effects::{HiddenCause, draw_test_case};
use trueup_machine::{Machine, MachineFile, RunFile, machine_file::Quantity};
use trueup_measured_data::find_measured_file as measured;

use super::*;

fn machine(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("right")
}

fn run(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("right")
}

fn quantity(run: &RunFile) -> Quantity {
    let is_measured =
        |quantity: &Quantity| run.column(&format!("measured_{}_um", quantity.name())).is_some();
    Quantity::ALL.into_iter().find(is_measured).expect("one")
}

/// Returns what is reported of the runs, and the columns that are left.
fn searched(machine: &Machine, runs: &[RunFile]) -> (Vec<String>, DataTable) {
    let data = DataTable::new(machine, runs, quantity(&runs[0]))
        .expect("comparable")
        .without_untrusted_columns();
    (data.notes.clone(), data)
}

const NOTHING: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";

#[test]
fn no_channel_that_was_measured_is_set_aside() {
    let sets = [
        "spindle_sjtu/run.csv",
        "voron_frame_expansion/run1.csv",
        "voron_frame_expansion/run3.csv",
        "voron_frame_expansion/run4.csv",
        "strangers/voron_run2/run2_heat.csv",
        "strangers/voron_run2/run2_cool.csv",
        "strangers/rods/aluminium_1s.csv",
        "strangers/rods/brass_1s.csv",
        "strangers/rods/copper_1s.csv",
    ];
    let mut channels = 0;
    for set in sets {
        let Some(path) = measured(set) else { return };
        let run = RunFile::read(&path).expect("a run file");
        let (notes, data) = searched(&machine(NOTHING), &[run]);
        assert!(notes.iter().all(|note| note.contains("did you mean")), "{set}: {notes:?}");
        channels += data.temperatures().len();
    }
    println!("{channels} channels");
    assert!(channels >= 34, "{channels}");
}

#[test]
fn no_channel_of_the_score_cards_draws_is_set_aside() {
    let (mut channels, mut draws) = (0, 0);
    for cause in HiddenCause::ALL {
        for seed in 1..=4 {
            let challenge = draw_test_case(*cause, 3.0, seed);
            let believed = machine(&challenge.machine);
            let runs: Vec<RunFile> = challenge.runs.iter().map(|text| run(text)).collect();
            for runs in [runs, vec![run(&challenge.holdout)]] {
                let columns = runs[0]
                    .columns()
                    .iter()
                    .filter(|column| column.name.starts_with("temp_"))
                    .count();
                let (notes, data) = searched(&believed, &runs);
                assert_eq!(notes, [""; 0], "{} {seed}", cause.name());
                assert_eq!(data.temperatures().len(), columns);
                channels += columns * runs.len();
                draws += 1;
            }
        }
    }
    println!("{channels} channels of {draws} sets of runs");
}

/// Returns a thermometer, warmed and cooled with noise, as cells.
fn celsius(row: usize, lag: f64) -> f64 {
    let phase = ((row as f64 - lag) / 300.0).sin();
    let mixed = (row as u64 + lag as u64 * 7_919).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    30.0 + 8.0 * phase + ((mixed ^ (mixed >> 31)) % 100) as f64 / 2_000.0
}

/// Three thermometers over 6,000 rows; `altered` says what the second shows.
fn run_with(altered: impl Fn(usize, f64) -> f64) -> RunFile {
    let mut text = String::from("time_s,temp_a_c,temp_b_c,temp_c_c,measured_dz_um\n");
    for row in 0..6_000 {
        let [a, b, c] = [0.0, 40.0, 90.0].map(|lag| celsius(row, lag));
        text += &format!("{row},{a:.3},{:.3},{c:.3},{:.2}\n", altered(row, b), 3.0 * a);
    }
    run(&text)
}

#[test]
fn rows_in_which_a_thermometer_is_frozen_or_absent_do_not_count() {
    for (what, shown) in [("stands still", 33.125), ("shows -180", -180.0)] {
        let lies = run_with(|row, b| if (1_000..3_000).contains(&row) { shown } else { b });
        let (notes, data) = searched(&machine(NOTHING), &[lies]);
        assert!(notes[0].contains("temp_b_c") && notes[0].contains(what), "{notes:?}");
        assert_eq!(data.temperatures().len(), 3);
        let counted = data.used.iter().filter(|used| **used).count();
        assert_eq!(counted, 4_000, "{notes:?}");
        // What has a memory goes along the line between.
        let values = &data.temperatures()[1].1;
        assert!(values[1_000..3_000].iter().all(|c| (20.0..40.0).contains(c)));
    }
    // For most of the time: then it says nothing at all, and the rows count.
    let lies = run_with(|row, b| if row > 1_000 { -180.0 } else { b });
    let (notes, data) = searched(&machine(NOTHING), &[lies]);
    assert!(notes.iter().any(|note| note.contains("temp_b_c is excluded")), "{notes:?}");
    assert_eq!((data.temperatures().len(), data.used.iter().all(|used| *used)), (2, true));
}

#[test]
fn rows_beyond_a_jump_do_not_count_and_a_copy_is_no_column_any_more() {
    let jumps = run_with(|row, b| if row > 2_500 { b + 5.0 } else { b });
    let (notes, data) = searched(&machine(NOTHING), &[jumps]);
    assert!(notes[0].contains("temp_b_c jumps by ") && notes[0].contains("row 2502"), "{notes:?}");
    // The longer part is believed; what has a memory does not see the jump.
    assert_eq!(data.used.iter().filter(|used| **used).count(), 3_499);
    let values = &data.temperatures()[1].1;
    assert!((values[2_501] - values[2_500]).abs() < 0.3);
    let back = run_with(|row, b| if (1_000..1_600).contains(&row) { b - 5.0 } else { b });
    let (notes, data) = searched(&machine(NOTHING), &[back]);
    assert_eq!(data.used.iter().filter(|used| **used).count(), 5_400, "{notes:?}");
    let copies = run_with(|row, _| celsius(row, 0.0));
    let (notes, data) = searched(&machine(NOTHING), &[copies]);
    assert!(notes[0].contains("temp_b_c is excluded: in every row it is a copy of temp_a_c"));
    assert_eq!(data.temperatures().len(), 2);
}

#[test]
fn what_the_machine_file_needs_is_kept_and_told() {
    let needs = format!(
        "{NOTHING}[spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \"temp_b_c\"\n\
         reference_c = 20.0\nk_um_per_c = 2.0\nlag_s = 0.0\n"
    );
    let jumps = run_with(|row, b| if row >= 4_500 { b + 5.0 } else { b });
    let (notes, data) = searched(&machine(&needs), &[jumps]);
    assert!(notes[0].contains("temp_b_c jumps by "), "{notes:?}");
    assert_eq!(data.temperatures().len(), 3);
    assert_eq!(data.used.iter().filter(|used| **used).count(), 4_500);
    let copies = run_with(|row, _| celsius(row, 0.0));
    let (notes, _) = searched(&machine(&needs), &[copies]);
    assert!(notes[0].contains("temp_a_c is excluded: in every row it is a copy of temp_b_c"));
}

#[test]
fn a_step_that_another_thermometer_follows_is_the_machines() {
    // The coolant comes on: one falls at once, another begins to cool.
    let mut text = String::from("time_s,temp_coolant_c,temp_body_c,measured_dz_um\n");
    let mut body = 40.0;
    for row in 0..3_000 {
        let coolant = if row < 1_500 { 35.0 } else { 20.0 } + celsius(row, 3.0) / 100.0;
        body += (coolant - body) / 600.0;
        text +=
            &format!("{row},{coolant:.3},{:.3},{:.2}\n", body + celsius(row, 9.0) / 1_000.0, body);
    }
    let (notes, data) = searched(&machine(NOTHING), &[run(&text)]);
    assert_eq!((notes.len(), data.temperatures().len()), (0, 2), "{notes:?}");
}
