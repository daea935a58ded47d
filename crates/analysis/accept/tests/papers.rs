//! The paper's own limits (paper 0) as an acceptance: growth of 0.05 mm is allowed, 0.015 mm is left.

use std::path::Path;

use trueup_accept::{AcceptanceCriteria, evaluate_acceptance};
use trueup_machine::RunFile;

/// Table 1, µm: what the sensor says, and the dial.
const TABLE: [[f64; 2]; 15] = [
    [5.0, 3.0],
    [9.0, 8.0],
    [20.0, 22.0],
    [22.8, 24.5],
    [24.6, 29.0],
    [25.5, 29.0],
    [36.2, 42.0],
    [42.5, 50.0],
    [44.5, 53.0],
    [46.5, 56.0],
    [48.0, 60.0],
    [62.4, 76.0],
    [62.7, 78.0],
    [62.8, 78.0],
    [62.8, 78.0],
];

fn run(um: impl Fn([f64; 2]) -> f64) -> RunFile {
    let rows: String = TABLE.into_iter().map(|row| format!("{}\n", um(row))).collect();
    let text = format!("measured_elongation_um\n{rows}");
    RunFile::from_reader(text.as_bytes(), Path::new("table1.csv")).expect("a run file")
}

#[test]
fn the_papers_limits_are_an_acceptance() {
    // Without compensation the dial's readings, with it what the sensor does not see of them.
    let (off, on) = (run(|[_, dial]| dial), run(|[sensor, dial]| dial - sensor));
    let passed = |require_percent, limit_um| {
        let limits = AcceptanceCriteria { require_percent, limit_um: Some(limit_um) };
        let it = evaluate_acceptance(&off, &on, None, None, limits).expect("the same rows");
        println!(
            "{:.1} % gone, largest {:.1} um: {:?}",
            100.0 * it.reduction,
            it.after.max_um,
            it.unmet
        );
        it.passed
    };
    assert!(passed(80.0, 50.0), "0.05 mm");
    assert!(passed(80.0, 15.35), "0.015 mm, as the paper rounds its 15.3 µm");
    assert!(!passed(80.0, 15.0), "15.3 µm are not 15.0");
    assert!(!passed(90.0, 50.0), "sufficient by the paper is not nine tenths gone");
}
