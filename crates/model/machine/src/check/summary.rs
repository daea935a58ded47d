//! The effects of a machine file: how far each axis may be moved and by what, how fast, how finely the
//! sensor is read, and how much of the board's memory it takes.

use trueup_store::calibration::MAX_BLOB_SIZE;

use super::{
    error_bounds::{ErrorBound, axis_error_bounds, elongation_bounds, elongation_fraction},
    limits::max_negligible_slew_um_per_s,
};
use crate::{
    compile::{DECOMPILED_SENSOR_INPUT, compile},
    location::InputFileError,
    machine_file::Machine,
    sections::LinearAxis,
};

/// The effects of a machine file.
#[derive(Clone, Debug)]
pub struct MachineSummary {
    /// X, Y and Z.
    pub axes: [AxisSummary; 3],
    /// The fastest change of an offset, in µm/s.
    pub slew_um_per_s: f64,
    /// The slowest rapid traverse, in mm/min, of which the slew is 1 %.
    pub slowest_rapid_mm_per_min: f64,
    /// The axes on which the board cannot detect a jump of the CNC's position: their rapid traverse is not stated.
    pub jumps_pass: Vec<LinearAxis>,
    /// How finely the displacement sensor is read; `None` where none is connected.
    pub sensor: Option<SensorSummary>,
    /// Bytes of the calibration, or why the board cannot have it.
    pub bytes: Result<usize, InputFileError>,
    /// Bytes that a calibration may have.
    pub most_bytes: usize,
}

/// The correction of one axis.
#[derive(Clone, Debug)]
pub struct AxisSummary {
    /// Which.
    pub axis: LinearAxis,
    /// The parts of the correction, each with its largest error.
    pub parts: Vec<ErrorBound>,
    /// The largest offset on X, Y or Z that the board gives, in µm.
    pub limit_um: f64,
}

/// How finely a displacement sensor is read.
#[derive(Clone, Copy, Debug)]
pub struct SensorSummary {
    /// µm for one count of the run file.
    pub um_per_count: f64,
    /// µm for one code of the board's converter, before it averages.
    pub um_per_code: f64,
    /// µm from 0 to full scale.
    pub range_um: f64,
    /// The sensor's output at full scale, in V.
    pub volts_full_scale: f64,
    /// The counts at full scale.
    pub counts_full_scale: f64,
}

impl AxisSummary {
    /// Returns the largest error of all parts together, in µm: what they make if all are at their largest and of
    /// one sign. `None` where one of them grows with a travel that is not known.
    #[must_use]
    pub fn max_total_error_um(&self) -> Option<f64> {
        // Not `sum`, for which nothing at all is −0.
        self.parts.iter().try_fold(0.0, |sum, part| Some(sum + part.largest_um?))
    }
}

impl MachineSummary {
    /// Of a machine.
    #[must_use]
    pub fn from_machine(machine: &Machine) -> Self {
        let compiled = compile(machine);
        let slew_um_per_s = machine.limits.slew_um_per_s;
        Self {
            axes: LinearAxis::ALL.map(|axis| AxisSummary {
                axis,
                parts: axis_error_bounds_with_elongation(machine, axis),
                limit_um: machine.limits.max_um[axis.index()],
            }),
            slew_um_per_s,
            slowest_rapid_mm_per_min: slew_um_per_s / max_negligible_slew_um_per_s(1.0),
            jumps_pass: LinearAxis::ALL
                .into_iter()
                .filter(|axis| machine.axes[axis.index()].rapid_mm_per_min.is_none())
                .collect(),
            sensor: sensor_summary(machine),
            bytes: compiled.map(|compiled| compiled.blob().len()),
            most_bytes: MAX_BLOB_SIZE,
        }
    }
}

/// Returns the parts of an axis, and the share of the growth that comes to lie along it: all of it where a head
/// can turn the tool there.
fn axis_error_bounds_with_elongation(machine: &Machine, axis: LinearAxis) -> Vec<ErrorBound> {
    let share = elongation_fraction(machine, axis);
    let source = machine.spindle.source.map(|source| format!("spindle.{}", source.name()));
    let growth =
        elongation_bounds(machine).into_iter().filter(|part| Some(&part.key) == source.as_ref());
    let growth =
        growth.map(|part| ErrorBound { largest_um: part.largest_um.map(|um| um * share), ..part });
    growth
        .filter(|part| part.largest_um != Some(0.0))
        .chain(axis_error_bounds(machine, axis))
        .collect()
}

fn sensor_summary(machine: &Machine) -> Option<SensorSummary> {
    let model = machine.spindle.sensor.as_ref()?;
    let input = machine.inputs.as_ref()?.sensor?;
    let um_per_count = model.um_per_count.abs();
    Some(SensorSummary {
        um_per_count,
        um_per_code: um_per_count
            * input.counts_from_codes(DECOMPILED_SENSOR_INPUT.codes_from_counts(1.0)),
        range_um: um_per_count * input.counts_full_scale,
        volts_full_scale: input.volts_full_scale,
        counts_full_scale: input.counts_full_scale,
    })
}
