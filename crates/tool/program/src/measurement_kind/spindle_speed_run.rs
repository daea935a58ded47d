//! Speeds of the spindle one after the other, from cold, read all the while: a run planned by the caller.

use super::NON_CONTACT_PRECAUTION;
use crate::{
    options::DEFAULT_APPROACH_FEED_MM_PER_MIN,
    plan::{Column, MeasurementPlan, Step},
};

/// A part of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedSegment {
    /// The spindle's speed in r/min; 0: it stands.
    pub rpm: f64,
    /// How long, in minutes, above 0.
    pub minutes: f64,
    /// The axial cutting force in N; 0: in the air.
    pub load_n: f64,
}

/// How long a reading takes, in s, where there is this much time.
const MAX_READING_DWELL_S: f64 = 5.0;

/// Returns the plan of `stretches`, read every `every_s` seconds (above 0); `inputs` are the columns to be filled in
/// next to the growth, and `why` is what it is run for, a sentence.
#[must_use]
pub fn plan_speed_run(
    stretches: &[SpeedSegment],
    every_s: f64,
    inputs: &[String],
    why: &str,
) -> MeasurementPlan {
    let dwell_s = MAX_READING_DWELL_S.min(0.5 * every_s);
    let mut steps = vec![Step::Read(dwell_s)];
    for stretch in stretches {
        if stretch.load_n > 0.0 {
            steps.push(Step::Note(format!("cut here, with about {:.0} N axially", stretch.load_n)));
        }
        steps.push(Step::Spindle(stretch.rpm));
        let readings = (60.0 * stretch.minutes / every_s).round().max(1.0);
        let reading = vec![Step::Dwell(every_s - dwell_s), Step::Read(dwell_s)];
        // Minutes of a run over seconds: whole, and in range.
        steps.push(Step::Repeat { times: readings as u32, steps: reading });
    }
    steps.push(Step::Spindle(0.0));
    let mut columns = vec![Column::Time, Column::Speed];
    columns.extend(inputs.iter().cloned().map(Column::Empty));
    columns.push(Column::Empty("measured_elongation_um".into()));
    let notes = [
        why,
        "Begin with a machine that has stood still over night.",
        "Set the gauge and its zero as in the runs before. Growth out of the spindle is positive.",
    ];
    MeasurementPlan {
        name: "next".into(),
        notes: notes.map(String::from).into(),
        precautions: vec![NON_CONTACT_PRECAUTION.into()],
        approach_mm_per_min: DEFAULT_APPROACH_FEED_MM_PER_MIN,
        steps,
        columns,
        then: vec!["trueup diagnose --run next.csv".into()],
        ..MeasurementPlan::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_come_in_their_order_and_are_read_from_cold_to_the_end() {
        let stretch = |rpm, minutes, load_n| SpeedSegment { rpm, minutes, load_n };
        let stretches =
            [stretch(6000.0, 12.0, 0.0), stretch(6000.0, 2.0, 300.0), stretch(0.0, 8.0, 0.0)];
        let plan =
            plan_speed_run(&stretches, 60.0, &["temp_front_c".into()], "to separate a from b");
        let readings = plan.readings();
        let speeds: Vec<f64> = readings.iter().map(|reading| reading.spindle_rpm).collect();
        assert_eq!(readings.len(), 1 + 12 + 2 + 8);
        assert_eq!(speeds[0], 0.0);
        assert!(speeds[1..15].iter().all(|rpm| *rpm == 6000.0));
        assert!(speeds[15..].iter().all(|rpm| *rpm == 0.0));
        // What was read first, and 22 minutes.
        assert_eq!(readings.last().map(|reading| reading.dwelt_s), Some(5.0 + 22.0 * 60.0));
        assert!(plan.steps.contains(&Step::Note("cut here, with about 300 N axially".into())));
    }
}
