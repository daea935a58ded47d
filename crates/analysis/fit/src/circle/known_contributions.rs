//! The part of a radial reading that is known already: the offsets of a bridge, and what the machine file predicts.

use std::fmt::Write as _;

use trueup_machine::{
    InputFileError, Machine, RunFile, applied_offsets::compute_applied_offsets_um,
    machine_file::LinearAxis, predict::RunPredictor,
};

use super::record::{CircleRecord, RADIAL_DEVIATION_COLUMN};
use crate::partial_prediction::{is_non_pose_input, restrict_to_available_columns};

/// Radial readings, and the offsets that a bridge had applied.
pub(crate) struct RadialReadings {
    readings_um: Vec<f64>,
    offsets_um: Option<[Vec<f64>; 3]>,
}

impl RadialReadings {
    /// Returns the reading of a row without what was applied; NaN where that is not known.
    pub(crate) fn uncompensated_radial_um(
        &self,
        row: usize,
        axes: [LinearAxis; 2],
        angle: f64,
    ) -> f64 {
        let applied = self.offsets_um.as_ref().map_or(0.0, |offsets| {
            let [u, v] = axes.map(|axis| offsets[axis.index()][row]);
            u * angle.cos() + v * angle.sin()
        });
        self.readings_um[row] - applied
    }
}

/// Returns the readings of `run` without what a bridge had applied, once they are at an angle.
pub(crate) fn extract_radial_readings(
    run: &RunFile,
    machine: Option<&Machine>,
    warnings: &mut Vec<String>,
) -> Result<RadialReadings, InputFileError> {
    let readings_um = run.require_column(RADIAL_DEVIATION_COLUMN)?.to_vec();
    let (offsets_um, notes) = match compute_applied_offsets_um(run, machine)? {
        Some((offsets_um, notes)) => (Some(offsets_um), notes),
        None => (None, Vec::new()),
    };
    warnings.extend(notes);
    Ok(RadialReadings { readings_um, offsets_um })
}

/// Takes the prediction of `machine` off the readings. Laws whose columns the run lacks are omitted, with a warning.
pub(crate) fn subtract_prediction(
    record: &mut CircleRecord,
    runs: &[RunFile],
    machine: &Machine,
    warnings: &mut Vec<String>,
) -> Result<(), InputFileError> {
    let axes = record.plane.axes();
    let own = restrict_to_plane(machine, axes);
    record.play_um = axes.map(|axis| {
        own.axes[axis.index()].backlash.map_or(0.0, |backlash| backlash.width_um.abs())
    });
    for (file, run) in runs.iter().enumerate() {
        let rows: Vec<usize> =
            (0..record.rows.len()).filter(|at| record.rows[*at].source[0] == file).collect();
        if rows.is_empty() {
            continue;
        }
        let positions = |name: &str| LinearAxis::ALL.iter().any(|axis| name == axis.column_name());
        let (used, missing) = restrict_to_available_columns(&own, |name| {
            positions(name) || run.column(name).is_some()
        });
        if !missing.is_empty() {
            warnings.push(format!(
                "{}: what the machine file has of heat, spindle and added terms is not subtracted where it needs what the run lacks: {}",
                run.path().display(),
                missing.join(", ")
            ));
        }
        let stated = build_run_with_directions(record, run, &used, &rows)?;
        let predictor = RunPredictor::new(&used, &stated)?;
        for (at, predicted) in rows.into_iter().zip(predictor.predictions()) {
            let row = &mut record.rows[at];
            let [u, v] = axes.map(|axis| predicted.model.error_um[axis.index()]);
            row.um -= u * row.angle.cos() + v * row.angle.sin();
        }
    }
    record.rows.retain(|row| !row.um.is_nan());
    Ok(())
}

/// Returns the parts of `machine` that can move these axes.
fn restrict_to_plane(machine: &Machine, axes: [LinearAxis; 2]) -> Machine {
    let mut own = machine.clone();
    for axis in LinearAxis::ALL.into_iter().filter(|axis| !axes.contains(axis)) {
        let other = &mut own.axes[axis.index()];
        (other.thermal, other.pitch, other.backlash, other.dual) = (None, None, None, None);
    }
    let is_in_plane = |axis: &LinearAxis| axes.contains(axis);
    own.straightness.retain(|curve| is_in_plane(&curve.error));
    own.squareness.retain(|angle| is_in_plane(&angle.error));
    own.terms.retain(|term| term.quantity.axis().is_none_or(|axis| is_in_plane(&axis)));
    let reaches = axes.iter().any(|axis| own.tool_direction[axis.index()] != 0.0);
    if own.head_axes.is_empty() && !reaches {
        own.spindle.source = None;
        own.terms.retain(|term| term.quantity.axis().is_some());
    }
    own
}

/// Returns these rows as a run with the direction of each axis, and 0 for a position that stands still and is not stated.
fn build_run_with_directions(
    record: &CircleRecord,
    run: &RunFile,
    machine: &Machine,
    rows: &[usize],
) -> Result<RunFile, InputFileError> {
    let is_other = |name: &str| name.ends_with("_deg") || is_non_pose_input(machine, name);
    let others = run.columns().iter().filter(|column| is_other(&column.name));
    let others: Vec<(&str, &[f64])> = others
        .filter_map(|column| Some((column.name.as_str(), run.column(&column.name)?)))
        .collect();
    let axes = record.plane.axes();
    let mut text = String::from("x_mm,y_mm,z_mm,dir_x,dir_y,dir_z");
    others.iter().for_each(|(name, _)| text.extend([",", name]));
    for at in rows {
        let row = &record.rows[*at];
        let (mut mm, mut dir) = ([0.0; 3], [1.0; 3]);
        for axis in LinearAxis::ALL {
            let stated = run.column(&axis.column_name());
            mm[axis.index()] = stated.map_or(0.0, |all| all[row.source[1]]);
        }
        let velocity = [-row.angle.sin(), row.angle.cos()];
        for (axis, velocity) in axes.into_iter().zip(velocity) {
            dir[axis.index()] = if velocity * row.sense < 0.0 { -1.0 } else { 1.0 };
        }
        let _ = write!(text, "\n{},{},{},{},{},{}", mm[0], mm[1], mm[2], dir[0], dir[1], dir[2]);
        for (_, values) in &others {
            let value = values[row.source[1]];
            let _ = if value.is_nan() { write!(text, ",") } else { write!(text, ",{value}") };
        }
    }
    text.push('\n');
    RunFile::from_reader(text.as_bytes(), run.path())
}
