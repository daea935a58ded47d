//! An axis to targets there and back, cold, run warm, or both: a run that somebody has planned.

use trueup_machine::file::LinearAxis;

use super::{WITHOUT_CORRECTION, measured};
use crate::plan::{Column, Plan, Step};

/// What is done.
#[derive(Clone, Debug, PartialEq)]
pub struct Targets {
    /// Which axis.
    pub axis: LinearAxis,
    /// Where it is read, rising, in mm; at least 2.
    pub targets_mm: Vec<f64>,
    /// How far it goes beyond the first and the last, in mm.
    pub over_mm: f64,
    /// How often there and back, at each feed.
    pub times: u32,
    /// One after the other, in mm/min.
    pub feeds_mm_per_min: Vec<f64>,
    /// How long it stands for a reading, in s.
    pub dwell_s: f64,
    /// For how long it is run to and fro, in minutes; 0: not at all.
    pub heat_min: f64,
    /// How fast, in mm/min.
    pub heat_feed_mm_per_min: f64,
    /// Measured before it is run warm, too; and when it was.
    pub cold: bool,
    /// Measured when it was run warm.
    pub warm: bool,
}

/// The most strokes in a row: FANUC repeats no more often.
const MOST_STROKES: f64 = 9999.0;

/// The plan; `inputs` are the columns to be filled in beside the error, and `why` is what it is run for, a sentence.
#[must_use]
pub fn targets(run: &Targets, inputs: &[String], why: &str) -> Plan {
    let index = run.axis.index();
    let at = |mm: f64| {
        let mut to_mm = [None; 3];
        to_mm[index] = Some(mm);
        to_mm
    };
    let go = |mm: f64, feed_mm_per_min: f64| Step::Move { to_mm: at(mm), feed_mm_per_min };
    let last = run.targets_mm.len() - 1;
    let [low, high] = [run.targets_mm[0] - run.over_mm, run.targets_mm[last] + run.over_mm];
    let measure = |feed: f64| {
        let read = |mm: &f64| [go(*mm, feed), Step::Read(run.dwell_s)];
        let mut once: Vec<Step> = run.targets_mm.iter().flat_map(read).collect();
        once.push(go(high, feed));
        once.extend(run.targets_mm.iter().rev().flat_map(read));
        once.push(go(low, feed));
        Step::Repeat { times: run.times, steps: once }
    };
    let all = || run.feeds_mm_per_min.iter().map(|feed| measure(*feed));
    let mut steps = vec![Step::Rapid(at(low))];
    if run.cold {
        steps.extend(all());
    }
    if run.heat_min > 0.0 {
        let feed = run.heat_feed_mm_per_min;
        let strokes = (run.heat_min * feed / (2.0 * (high - low))).ceil().clamp(1.0, MOST_STROKES);
        // A number of strokes is whole and in range.
        let stroke = vec![go(high, feed), go(low, feed)];
        steps.push(Step::Note(format!("run warm for {:.0} minutes", run.heat_min)));
        steps.push(Step::Repeat { times: strokes as u32, steps: stroke });
    }
    if run.warm {
        steps.extend(all());
    }
    let own = format!("{}_mm", run.axis.name());
    let other = |name: &&String| **name != own;
    let mut columns = vec![Column::Position(index), Column::Direction(index), Column::Feed];
    let filled = inputs.iter().filter(other).cloned();
    columns.extend(std::iter::once("time_s".to_string()).chain(filled).map(Column::Empty));
    columns.push(Column::Empty(measured(run.axis)));
    let notes = [
        why,
        WITHOUT_CORRECTION,
        "Begin with a machine that has stood still over night.",
        "Set the gauge and its zero as in the runs before; write the time down at each reading.",
    ];
    Plan {
        name: "next".into(),
        notes: notes.map(String::from).into(),
        steps,
        columns,
        then: "trueup diagnose with the runs before and --run next.csv".into(),
        records: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_read_from_both_sides_cold_and_warm_and_warmed_for_as_long_as_is_asked() {
        let run = Targets {
            axis: LinearAxis::Y,
            targets_mm: vec![50.0, 400.0, 950.0],
            over_mm: 50.0,
            times: 2,
            feeds_mm_per_min: vec![1000.0],
            dwell_s: 5.0,
            heat_min: 10.0,
            heat_feed_mm_per_min: 10_000.0,
            cold: true,
            warm: true,
        };
        let plan = targets(&run, &["temp_screw_c".into()], "To tell a from b.");
        let readings = plan.readings();
        let places: Vec<(Option<f64>, i8)> =
            readings[..6].iter().map(|it| (it.position_mm[1], it.direction[1])).collect();
        let to = |mm: f64, way: i8| (Some(mm), way);
        assert_eq!(places[..3], [to(50.0, 1), to(400.0, 1), to(950.0, 1)]);
        assert_eq!(places[3..], [to(950.0, -1), to(400.0, -1), to(50.0, -1)]);
        assert_eq!(readings.len(), 2 * 2 * 6);
        assert_eq!(plan.extent_mm()[1], Some([0.0, 1000.0]));
        // 24 readings of 5 s, four times there and back over a metre at 1 m/min, and ten minutes.
        let minutes = plan.least_seconds() / 60.0;
        assert!((minutes - (2.0 + 8.0 + 10.0)).abs() < 0.21, "{minutes}");
        let text = &crate::template::templates(&plan)[0].1;
        let header = "y_mm,dir_y,feed_mm_per_min,time_s,temp_screw_c,measured_dy_um\n";
        assert!(text.contains(header), "{text}");
    }
}
