//! The prediction of the machine file for a run without the section that is to be fitted.
//!
//! A measured error is the sum of all parts of the model. Those that are known already must not be
//! fitted a second time, or the whole would count them twice.

use trueup_machine::{
    InputFileError, Machine,
    applied_offsets::UncompensatedRun,
    machine_file::{ElongationSource, LinearAxis, is_temperature_column},
    model::required_columns,
    predict::RunPredictor,
};

/// The section that is to be fitted, and is therefore omitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExcludedSection {
    /// The thermal law of an axis, `[axis.<axis>.thermal]`.
    Thermal(LinearAxis),
    /// The position errors of an axis, `[axis.<axis>.pitch]` and `[axis.<axis>.backlash]`.
    Position(LinearAxis),
    /// A straightness curve, `[straightness.<error>_of_<along>]`.
    Straightness {
        /// The axis that is in error.
        error: LinearAxis,
        /// The axis that moves.
        along: LinearAxis,
    },
}

/// The prediction of the other sections.
#[derive(Clone, Debug, PartialEq)]
pub struct PartialPrediction {
    /// The error of the axis that is fitted, row by row, in µm.
    pub um: Vec<f64>,
    /// Columns that the run lacks: what depends on them is not in `um`, which is NaN then.
    pub missing_columns: Vec<String>,
}

impl PartialPrediction {
    /// Returns whether a row is known at all.
    #[must_use]
    pub fn has_known_rows(&self) -> bool {
        self.um.iter().any(|um| !um.is_nan())
    }
}

/// Returns what `machine` says of the error of the axis that is fitted, for each row of `run`; `None` where
/// there is no other section that says anything.
///
/// # Errors
/// The run has a column with the name of a prediction.
pub fn predict_other_sections(
    machine: &Machine,
    run: &UncompensatedRun<'_>,
    without: ExcludedSection,
) -> Result<Option<PartialPrediction>, InputFileError> {
    let mut rest = machine.clone();
    let axis = match without {
        ExcludedSection::Thermal(axis) => {
            rest.axes[axis.index()].thermal = None;
            axis
        }
        ExcludedSection::Position(axis) => {
            let own = &mut rest.axes[axis.index()];
            (own.pitch, own.backlash, own.dual) = (None, None, None);
            axis
        }
        ExcludedSection::Straightness { error, along } => {
            rest.straightness.retain(|curve| (curve.error, curve.along) != (error, along));
            error
        }
    };
    // Only what can move this axis: the rest may lack its columns without harm.
    for (index, other) in rest.axes.iter_mut().enumerate() {
        if index != axis.index() {
            (other.thermal, other.pitch, other.backlash, other.dual) = (None, None, None, None);
        }
    }
    rest.straightness.retain(|curve| curve.error == axis);
    rest.volume.angular.retain(|angular| angular.about.index() != axis.index());
    rest.squareness.retain(|angle| angle.error == axis && angle.um_per_m != 0.0);
    let tool_reaches = !rest.head_axes.is_empty() || rest.tool_direction[axis.index()] != 0.0;
    if !tool_reaches || !has_elongation_model(&rest) {
        rest.spindle.source = None;
    }
    let own = &rest.axes[axis.index()];
    let is_informative = own.thermal.is_some()
        || own.pitch.is_some()
        || own.backlash.is_some()
        || !rest.straightness.is_empty()
        || !rest.squareness.is_empty()
        || rest.volume.has_geometric_errors()
        || rest.spindle.source.is_some();
    if !is_informative {
        return Ok(None);
    }
    let missing: Vec<String> =
        required_columns(&rest).into_iter().filter(|name| run.column(name).is_none()).collect();
    if !missing.is_empty() {
        return Ok(Some(PartialPrediction {
            um: vec![f64::NAN; run.row_count()],
            missing_columns: missing,
        }));
    }
    let predictor = RunPredictor::new(&rest, run)?;
    let um = predictor.predictions().map(|row| row.model.error_um[axis.index()]).collect();
    Ok(Some(PartialPrediction { um, missing_columns: Vec::new() }))
}

/// Returns `machine` with those of its laws of heat, of the spindle and added terms whose columns are there, and the columns that are
/// not. A law that is there and was omitted would be found, and written, a second time.
pub(crate) fn restrict_to_available_columns(
    machine: &Machine,
    is_there: impl Fn(&str) -> bool,
) -> (Machine, Vec<String>) {
    let lacks = |machine: &Machine| -> Vec<String> {
        required_columns(machine).into_iter().filter(|name| !is_there(name)).collect()
    };
    let missing = lacks(machine);
    if missing.is_empty() {
        return (machine.clone(), missing);
    }
    let mut used = machine.clone();
    used.axes.iter_mut().for_each(|axis| axis.thermal = None);
    (used.spindle.source, used.spindle.tools) = (None, None);
    used.terms.clear();
    // Columns that the rest of the machine needs.
    let others = lacks(&used).len();
    let add = |used: &mut Machine, change: &dyn Fn(&mut Machine)| {
        let mut more = used.clone();
        change(&mut more);
        if lacks(&more).len() == others {
            *used = more;
        }
    };
    for (n, own) in machine.axes.iter().enumerate() {
        add(&mut used, &|more| more.axes[n].thermal.clone_from(&own.thermal));
    }
    add(&mut used, &|more| more.spindle.source = machine.spindle.source);
    add(&mut used, &|more| more.spindle.tools.clone_from(&machine.spindle.tools));
    for term in &machine.terms {
        add(&mut used, &|more| more.terms.push(term.clone()));
    }
    (used, missing)
}

/// Returns whether a prediction by `machine` reads the column, but for positions, angles and directions.
pub(crate) fn is_non_pose_input(machine: &Machine, name: &str) -> bool {
    let is_pose =
        LinearAxis::ALL.iter().any(|axis| name == axis.column_name()) || name.ends_with("_deg");
    let usual = ["time_s", "run", "spindle_rpm", "sensor_counts", "feed_mm_per_min", "tool"];
    usual.contains(&name)
        || is_temperature_column(name)
        || !is_pose && required_columns(machine).iter().any(|column| column == name)
}

fn has_elongation_model(machine: &Machine) -> bool {
    let spindle = &machine.spindle;
    match spindle.source {
        None => false,
        Some(ElongationSource::Sensor) => spindle.sensor.is_some(),
        Some(ElongationSource::Warmup) => spindle.warmup.is_some(),
        Some(ElongationSource::Temperature) => spindle.temperature.is_some(),
    }
}
