//! An axis to targets there and back, cold, run warm, or both: a run planned by the caller.

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

use super::{COMPENSATION_OFF_PRECAUTION, base_plan, linear_move, measured_column_name};
use crate::{
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan, Step},
    program_error::ProgramError,
    travel::{AxisTravel, resolve_travel, retract_direction, round_to_micrometres},
};

/// Parameters of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetRun {
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
const MAX_STROKES_PER_ROUND: f64 = 9999.0;

/// The shortest over-travel that is left next to the margin, in mm: it still takes up the play of a worn axis.
const MIN_OVERTRAVEL_MM: f64 = 0.1;

/// Returns the plan; `inputs` are the columns to be filled in with the error, and `why` is what it is run for, a
/// sentence. Range, margin and approach are those of `options`; an axis that is neither vertical nor along the
/// tool and has no range or travel moves where the runs have seen it.
///
/// # Errors
/// The axis is vertical or along the tool and has no range, or the run does not fit.
pub fn plan_target_run(
    run: &TargetRun,
    machine: &Machine,
    options: &MeasurementOptions,
    inputs: &[String],
    why: &str,
) -> Result<MeasurementPlan, ProgramError> {
    options.check()?;
    let axis = run.axis;
    let index = axis.index();
    let last = run.targets_mm.len() - 1;
    let ends_mm = [run.targets_mm[0], run.targets_mm[last]];
    let [low_mm, high_mm] =
        [ends_mm[0] - run.over_mm, ends_mm[1] + run.over_mm].map(round_to_micrometres);
    let is_limited = options.range_mm[index].is_some() || machine.axes[index].travel_mm.is_some();
    let retract = retract_direction(machine, axis);
    let limits = if is_limited || retract.is_some() || machine.kind == MachineKind::Lathe {
        resolve_travel(machine, options, axis)?.map_err(ProgramError)?
    } else {
        AxisTravel { axis, low_mm, high_mm, retract }
    };
    let way = AxisTravel {
        low_mm: low_mm.max(limits.low_mm),
        high_mm: high_mm.min(limits.high_mm),
        ..limits
    };
    let over_mm = run.over_mm.min(MIN_OVERTRAVEL_MM);
    if ends_mm[0] - over_mm < way.low_mm || ends_mm[1] + over_mm > way.high_mm {
        return Err(ProgramError(format!(
            "the next run reads {name} from {} to {} mm, and {name} may move from {} to {} mm \
             only. Give a longer --range {name}=LOW:HIGH, or a smaller --margin",
            ends_mm[0],
            ends_mm[1],
            limits.low_mm,
            limits.high_mm,
            name = axis.name()
        )));
    }
    let [start, far] = way.ends_in_approach_order_mm();
    let ordered = way.arrange_in_approach_order(run.targets_mm.clone());
    let measure = |feed: f64| {
        let read = |mm: &f64| [linear_move(&way, *mm, feed), Step::Read(run.dwell_s)];
        let mut once: Vec<Step> = ordered.iter().flat_map(read).collect();
        once.push(linear_move(&way, far, feed));
        once.extend(ordered.iter().rev().flat_map(read));
        once.push(linear_move(&way, start, feed));
        Step::Repeat { times: run.times, steps: once }
    };
    let all = || run.feeds_mm_per_min.iter().map(|feed| measure(*feed));
    let mut steps = vec![way.approach_step(start)];
    if run.cold {
        steps.extend(all());
    }
    if run.heat_min > 0.0 {
        let feed = run.heat_feed_mm_per_min;
        let strokes = run.heat_min * feed / (2.0 * way.length_mm());
        let strokes = strokes.ceil().clamp(1.0, MAX_STROKES_PER_ROUND);
        // A number of strokes is whole and in range.
        let stroke = vec![linear_move(&way, far, feed), linear_move(&way, start, feed)];
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
    columns.push(Column::Empty(measured_column_name(run.axis)));
    let notes = [
        why,
        COMPENSATION_OFF_PRECAUTION,
        "Begin with a machine that has stood still over night.",
        "Set the gauge and its zero as in the runs before; write the time down at each reading.",
    ];
    Ok(MeasurementPlan {
        name: "next".into(),
        notes: notes.map(String::from).into(),
        steps,
        columns,
        then: vec!["trueup diagnose --run next.csv".into()],
        ..base_plan(machine, options)
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::MachineFile;

    use super::*;

    fn machine(travel: &str) -> Machine {
        let text = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{travel}");
        MachineFile::parse(&text, Path::new("m.toml")).expect("a machine file")
    }

    #[test]
    fn an_axis_is_read_from_both_sides_cold_and_warm_and_warmed_for_as_long_as_is_asked() {
        let run = TargetRun {
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
        let inputs = ["temp_screw_c".into()];
        let plan = plan_target_run(
            &run,
            &machine(""),
            &MeasurementOptions::default(),
            &inputs,
            "To separate a from b.",
        )
        .expect("the runs were there");
        let readings = plan.readings();
        let places: Vec<(Option<f64>, i8)> = readings[..6]
            .iter()
            .map(|reading| (reading.position_mm[1], reading.direction[1]))
            .collect();
        let to = |mm: f64, way: i8| (Some(mm), way);
        assert_eq!(places[..3], [to(50.0, 1), to(400.0, 1), to(950.0, 1)]);
        assert_eq!(places[3..], [to(950.0, -1), to(400.0, -1), to(50.0, -1)]);
        assert_eq!(readings.len(), 2 * 2 * 6);
        assert_eq!(plan.extent_mm()[1], Some([0.0, 1000.0]));
        // 24 readings of 5 s, four times there and back over a metre at 1 m/min, and ten minutes.
        let minutes = plan.min_duration_s() / 60.0;
        assert!((minutes - (2.0 + 8.0 + 10.0)).abs() < 0.21, "{minutes}");
        let text = &crate::template::run_file_templates(&plan)[0].1;
        let header = "y_mm,dir_y,feed_mm_per_min,time_s,temp_screw_c,measured_dy_um\n";
        assert!(text.contains(header), "{text}");
        // A margin is kept to the ends of travel; Z moves only where it is stated, its upper end first.
        let error_text = |run: &TargetRun, travel: &str, options: &MeasurementOptions| {
            plan_target_run(run, &machine(travel), options, &inputs, "")
        };
        let y = "[axis.y]\ntravel_mm = [0.0, 1000.0]\n";
        let plan = error_text(&run, y, &MeasurementOptions::default()).expect("it fits");
        assert_eq!(plan.extent_mm()[1], Some([2.0, 998.0]));
        let short = error_text(
            &run,
            "[axis.y]\ntravel_mm = [0.0, 952.0]\n",
            &MeasurementOptions::default(),
        );
        assert!(short.is_err_and(|why| why.0.contains("from 2 to 950 mm only")));
        let z = TargetRun { axis: LinearAxis::Z, ..run };
        let why =
            error_text(&z, "", &MeasurementOptions::default()).expect_err("it would plunge").0;
        assert!(why.contains("--range z=LOW:HIGH"), "{why}");
        let options = MeasurementOptions {
            range_mm: [None, None, Some([-2.0, 1002.0])],
            ..MeasurementOptions::default()
        };
        let plan = error_text(&z, "", &options).expect("it is reported");
        assert_eq!(plan.steps[0], Step::Approach { axis: 2, to_mm: 1000.0 });
        assert_eq!(plan.readings()[0].position_mm[2], Some(950.0));
    }
}
