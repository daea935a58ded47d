//! A CNC that applies the offset otherwise than once is not accepted, and no constant is changed for it; one that applies
//! it once is judged as before.

use std::{fmt::Write as _, path::Path};

use trueup_accept::{AcceptanceCriteria, AcceptanceResult, evaluate_acceptance};
use trueup_machine::{MachineFile, RunFile};
use trueup_numerics::random::RandomGenerator;

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
    [spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\nlag_s = 0.0\n\
    [axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_a_c\"\nreference_c = 20.0\n\
    slope_um_per_m_per_c = 11.0\norigin_mm = 0.0\n";

/// Returns a warm-up by 15 K; `factor`: of an engaged bridge, and the machine does `gain` of what its file says.
fn run(quantity: &str, gain: f64, factor: Option<f64>, noise_um: f64, seed: u64) -> RunFile {
    let mut generator = RandomGenerator::new(seed);
    let axis = if quantity == "dx" { "x" } else { "z" };
    let mut text =
        format!("time_s,x_mm,temp_a_c,offset_{axis}_um,quality,measured_{quantity}_um\n");
    for row in 0..120 {
        let c = 15.0 * (1.0 - (-f64::from(row) / 40.0).exp());
        let x_mm = [100.0, 500.0, 900.0][row as usize % 3];
        // Of the elongation, of dz (a spindle that grows is too low), or of dx.
        let (error, lift) = match quantity {
            "dx" => (11.0 * x_mm / 1000.0 * c, 1.0),
            "dz" => (-2.0 * c, 1.0),
            _ => (2.0 * c, -1.0),
        };
        let offset = if factor.is_some() { -error * lift } else { 0.0 };
        let left = gain * error + factor.unwrap_or(0.0) * offset * lift;
        let measured = left + noise_um * generator.normal();
        let quality = u8::from(factor.is_some());
        let time_s = 60 * row;
        let c = 20.0 + c;
        writeln!(text, "{time_s},{x_mm},{c:.3},{offset:.2},{quality},{measured:.3}")
            .expect("a string grows");
    }
    RunFile::from_reader(text.as_bytes(), Path::new("on.csv")).expect("a run file")
}

fn judged(
    quantity: &str,
    gain: f64,
    factor: f64,
    noise_um: f64,
    with_file: bool,
) -> AcceptanceResult {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("right");
    let off = run(quantity, gain, None, noise_um, 1);
    let on = run(quantity, gain, Some(factor), noise_um, 2);
    let believed = with_file.then_some((MACHINE, &machine));
    evaluate_acceptance(&off, &on, None, believed, AcceptanceCriteria::default())
        .expect("comparable")
}

#[test]
fn another_factor_than_1_fails_names_the_places_and_changes_no_constant() {
    for quantity in ["elongation", "dx", "dz"] {
        for (factor, noise_um) in [(-1.0, 0.3), (0.0, 1.0), (0.5, 0.6), (2.0, 0.3), (-0.5, 1.0)] {
            for with_file in [true, false] {
                let it = judged(quantity, 1.0, factor, noise_um, with_file);
                let found = it.applied_factor.expect("the record has the offsets");
                let what = format!("{quantity} {factor}: {found:?}");
                assert!(!it.passed && it.advice.changes.is_empty(), "{what}");
                assert!(it.adjusted_machine_file().is_none(), "{what}");
                let [low, high] = found.ci95;
                assert!(low < factor && factor < high && high - low < 0.3, "{what}");
                assert!(
                    it.unmet
                        .iter()
                        .any(|requirement| requirement.starts_with("For 1 µm of offset")),
                    "{what}"
                );
                let sentences = it.advice.sentences.join(" ");
                assert!(
                    !sentences.contains("Change ") && sentences.contains("eoffset-scale"),
                    "{sentences}"
                );
            }
        }
    }
}

#[test]
fn a_cnc_that_applies_the_offset_once_is_judged_as_before() {
    for quantity in ["elongation", "dx", "dz"] {
        let it = judged(quantity, 1.0, 1.0, 0.3, true);
        let [low, high] = it.applied_factor.expect("known").ci95;
        assert!(low < 1.0 && 1.0 < high, "{low} {high}");
        assert!(
            it.passed && it.notes.iter().all(|note| !note.contains("offset")),
            "{:?}",
            it.notes
        );
        // A wrong constant is still one; of dz there is none in this file to be fitted.
        if quantity == "dz" {
            continue;
        }
        let it = judged(quantity, 1.4, 1.0, 0.3, true);
        assert!(!it.passed && !it.advice.changes.is_empty(), "{:?}", it.advice);
        let first = &it.advice.changes[0];
        assert!((first.to / first.from - 1.4).abs() < 0.03, "{first:?}");
        assert!(
            it.render_html("m", &trueup_accept::Provenance::default(), &[])
                .contains("Constants to change")
        );
    }
}

#[test]
fn what_the_runs_do_not_show_is_reported_and_fails_nothing() {
    let it = judged("dz", 1.0, 1.0, 60.0, true);
    assert!(it.notes.iter().any(|note| note.contains("These runs do not show")));
    assert!(!it.unmet.iter().any(|requirement| requirement.contains("For 1 µm")), "{:?}", it.unmet);
    let plain = |um: f64| {
        let rows: String = (0..20).map(|row| format!("{}\n", um * f64::from(row))).collect();
        let text = format!("measured_dz_um\n{rows}");
        RunFile::from_reader(text.as_bytes(), Path::new("plain.csv")).expect("a run")
    };
    let it =
        evaluate_acceptance(&plain(1.0), &plain(-1.0), None, None, AcceptanceCriteria::default())
            .expect("comparable");
    assert!(
        it.applied_factor.is_none() && it.notes.iter().all(|note| !note.contains("1 µm of offset"))
    );
}

/// µm per count is a small number: two decimals show nothing of it.
#[test]
fn the_table_of_constants_has_the_digits_that_the_interval_has() {
    let machine = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"sensor\"\n[spindle.sensor]\n\
                   k0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0153\n";
    let run = |left: f64| {
        let mut text = String::from("time_s,sensor_counts,measured_elongation_um\n");
        for row in 0..60 {
            let um = f64::from(row);
            let noise = 0.05 * f64::from(row % 3 - 1);
            writeln!(text, "{},{:.1},{:.3}", 60 * row, 5048.0 + um / 0.0191, left * um + noise)
                .expect("a string grows");
        }
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
    };
    let parsed = MachineFile::parse(machine, Path::new("m.toml")).expect("right");
    let believed = Some((machine, &parsed));
    let it =
        evaluate_acceptance(&run(1.0), &run(0.2), None, believed, AcceptanceCriteria::default())
            .expect("comparable");
    let html = it.render_html("m", &trueup_accept::Provenance::default(), &[]);
    let (_, table) = html.split_once("Constants to change").expect("a table");
    let (table, _) = table.split_once("Part by part").expect("what follows");
    assert!(table.contains("0.0153") && table.contains("0.0191"), "{table}");
    let [low, high] = it.advice.changes[0].ci95.expect("fitted");
    assert!(high > low && !table.contains("0.02 … 0.02") && !table.contains("0.01 … 0.01"));
}

#[test]
fn a_bad_reading_is_excluded_by_its_line_and_what_lasts_counts() {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("right");
    for quantity in ["elongation", "dx"] {
        let off = run(quantity, 1.0, None, 0.3, 1);
        let on = run(quantity, 1.0, Some(1.0), 0.3, 2);
        let spoiled = |run: &RunFile, rows: std::ops::Range<usize>| {
            run.with_altered_values(run.row_count(), |column, values| {
                if column.starts_with("measured_") {
                    values[rows.clone()].iter_mut().for_each(|um| *um += 45.0);
                }
            })
        };
        let limits = AcceptanceCriteria { limit_um: Some(5.0), ..AcceptanceCriteria::default() };
        let judged = |off: &RunFile, on: &RunFile| {
            evaluate_acceptance(off, on, None, Some((MACHINE, &machine)), limits)
                .expect("comparable")
        };
        let it = judged(&spoiled(&off, 30..31), &spoiled(&on, 70..71));
        assert!(it.passed, "{quantity}: {:?} {:?}", it.unmet, it.notes);
        let listed: Vec<&String> =
            it.notes.iter().filter(|note| note.starts_with("Excluded as outliers")).collect();
        assert!(listed.len() == 2 && listed[0].contains("line 32 (+"), "{listed:?}");
        assert!(listed[1].contains("line 72 (+"), "{listed:?}");
        // Three readings in a row are what the machine does.
        let it = judged(&off, &spoiled(&on, 70..73));
        assert!(!it.passed && it.after.max_um > 40.0, "{quantity}: {:?}", it.notes);
    }
}
