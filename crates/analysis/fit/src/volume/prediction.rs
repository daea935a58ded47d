//! The prediction of the machine file at the poses of readings.

use std::fmt::Write as _;

use trueup_machine::{
    InputFileError, Machine, RunFile, machine_file::LinearAxis, predict::RunPredictor,
};

use super::reading::Pose;
use crate::partial_prediction::{is_non_pose_input, restrict_to_available_columns};

/// A pose, the row of the run that it comes from, and the directions of approach.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseWithApproach {
    /// The row.
    pub row: usize,
    /// The pose.
    pub pose: Pose,
    /// +1 or −1 of X, Y and Z.
    pub direction: [f64; 3],
}

/// Returns the error that `machine` predicts at each of `stated`. Laws whose columns the run lacks are omitted, with a warning.
///
/// # Errors
/// The run has a column with the name of a prediction.
pub(crate) fn predict_errors_um(
    run: &RunFile,
    machine: &Machine,
    stated: &[PoseWithApproach],
    warnings: &mut Vec<String>,
) -> Result<Vec<[f64; 3]>, InputFileError> {
    if stated.is_empty() {
        return Ok(Vec::new());
    }
    let is_pose = |name: &str| {
        let axes = LinearAxis::ALL.iter().map(|axis| axis.name()).chain(["a", "b", "c"]);
        axes.into_iter().any(|axis| name == format!("{axis}_mm") || name == format!("{axis}_deg"))
    };
    let (mut used, missing) =
        restrict_to_available_columns(machine, |name| is_pose(name) || run.column(name).is_some());
    if !missing.is_empty() {
        warnings.push(format!(
            "{}: what the machine file has of heat, spindle and added terms is not subtracted where it needs what the run lacks: {}",
            run.path().display(),
            missing.join(", ")
        ));
    }
    let mut lengths: Vec<f64> = stated.iter().map(|approach| approach.pose.tool_mm).collect();
    lengths.sort_unstable_by(f64::total_cmp);
    lengths.dedup();
    let text = format_poses_as_run(run, &used, stated);
    let stated_run = RunFile::from_reader(text.as_bytes(), run.path())?;
    let mut predicted = vec![[0.0; 3]; stated.len()];
    for length_mm in lengths {
        used.volume.tool.length_mm = length_mm;
        let predictor = RunPredictor::new(&used, &stated_run)?;
        for ((into, it), of) in predicted.iter_mut().zip(stated).zip(predictor.predictions()) {
            if it.pose.tool_mm == length_mm {
                *into = of.model.error_um;
            }
        }
    }
    Ok(predicted)
}

/// Returns the poses as a run, with the inputs of its rows.
fn format_poses_as_run(run: &RunFile, machine: &Machine, stated: &[PoseWithApproach]) -> String {
    let others: Vec<(&str, &[f64])> = run
        .columns()
        .iter()
        .filter(|column| is_non_pose_input(machine, &column.name))
        .filter_map(|column| Some((column.name.as_str(), run.column(&column.name)?)))
        .collect();
    let mut text = String::from("x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,dir_x,dir_y,dir_z");
    others.iter().for_each(|(name, _)| text.extend([",", name]));
    for PoseWithApproach { row, pose, direction } in stated {
        let [x, y, z] = pose.position_mm;
        let [a, b, c] = pose.angle_deg;
        let [dx, dy, dz] = direction;
        let _ = write!(text, "\n{x},{y},{z},{a},{b},{c},{dx},{dy},{dz}");
        for (_, values) in &others {
            let value = values[*row];
            let _ = if value.is_nan() { write!(text, ",") } else { write!(text, ",{value}") };
        }
    }
    text.push('\n');
    text
}
