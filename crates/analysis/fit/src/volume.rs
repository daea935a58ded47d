//! `fit volume`: the 21 errors of three axes and the lines of rotary axes, from any mix of measurements.
//!
//! Each reading is the error of the tool tip at a pose, e, in the direction of the reading, n, and what is unknown of its set-up:
//!
//! ```text
//! reading = n·e(pose) + zero, alignment, scale, beam, circle of the set-up + noise
//! e = Σ constants × what a unit of each does at the pose
//! ```
//!
//! It is linear in all of them, so that one system of equations has all measurements.
//!
//! | module | does |
//! |---|---|
//! | [`reading`] | a reading and its pose |
//! | `read`, `predicted` | rows of run files, without what the machine file predicts |
//! | `spline_modes` | forms of a smooth function |
//! | `error_parameters` | the errors, and what a unit of each does |
//! | `kinematics`, `nuisance_parameters` | the workpiece and the tool, and what is unknown of a set-up |
//! | `design` | the equations |
//! | `empirical_bayes` | constants, noise and sizes |
//! | [`identifiability`] | what is known, and readings that were held out |
//! | `next_tests` | the measurement that would settle the rest |
//! | `section_writer` | sections of the machine file |
//! | `page` | the page with the curves |

pub(crate) mod design_matrix;
mod empirical_bayes;
pub(crate) mod error_parameters;
mod html_report;
pub mod identifiability;
pub(crate) mod kinematics;
pub(crate) mod next_tests;
mod nuisance_parameters;
mod prediction;
pub mod reading;
mod run_reader;
pub(crate) mod section_writer;
mod spline_modes;

use std::collections::BTreeMap;

use trueup_machine::{
    InputFileError, Location, Machine, RunFile, machine_file::writer::MachineFileEdit,
};
use trueup_numerics::robust;

use self::{
    design_matrix::{DesignMatrix, normal_equations},
    empirical_bayes::{Posterior, Variances, estimate_variances},
    error_parameters::ErrorParameters,
    identifiability::{ErrorAssessment, HeldOutResult},
    kinematics::ForwardKinematics,
    nuisance_parameters::ArtefactUncertainty,
    reading::{Pose, ReadingKind, VolumeReading, dot},
};
use crate::report::ExcludedRow;

pub use self::{
    error_parameters::GeometricError, html_report::build_page, identifiability::NORMAL_QUANTILE_975,
};

/// A reading further from the fit, in standard deviations by the median, is a gross error.
const GROSS_ERROR_THRESHOLD_SIGMAS: f64 = 6.0;
/// The scale of an artefact that nothing is known of, in µm/m.
const PRIOR_SCALE_STD_UM_PER_M: f64 = 100.0;
/// The noise before the readings say more, in µm.
const DEFAULT_READING_NOISE_UM: f64 = 1.0;

/// The stated uncertainties of the instrument.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VolumeFitOptions {
    /// Standard uncertainty of a reading in µm; `None`: that of the machine file, else from the readings alone.
    pub instrument_um: Option<f64>,
    /// Standard uncertainty of the scale of artefact and laser in µm/m; `None`: the scale is not known.
    pub scale_um_per_m: Option<f64>,
    /// Standard uncertainty of a point of the artefact in µm; `None`: balls are right, a straight edge is not known.
    pub artefact_um: Option<f64>,
}

/// The result of a fit.
#[derive(Clone, Debug)]
pub struct VolumeReport {
    /// Each error, in the order of ISO 230-1, rotary axes after them.
    pub known: Vec<ErrorAssessment>,
    /// The errors that are written.
    pub written: Vec<GeometricError>,
    /// The sections of the machine file.
    pub edit: MachineFileEdit,
    /// Readings that were held out.
    pub held_out: HeldOutResult,
    /// The noise of each kind of reading in µm; `None` where there is none of the kind.
    pub noise_um: [Option<f64>; 4],
    /// Readings of each kind.
    pub readings: [usize; 4],
    /// Gross readings.
    pub excluded: Vec<ExcludedRow>,
    /// Warnings to the user; whole sentences.
    pub warnings: Vec<String>,
    /// The constants, to predict with.
    pub model: VolumetricModel,
}

impl VolumeReport {
    /// Returns whether the correction gains on held-out readings by more than the standard error.
    #[must_use]
    pub fn has_significant_improvement(&self) -> bool {
        self.held_out.is_better
    }
}

/// The constants, and how well they predict.
#[derive(Clone, Debug)]
pub struct VolumetricModel {
    constants: ErrorParameters,
    posterior: Posterior,
}

impl VolumetricModel {
    /// Returns the difference of the errors of two poses in a direction, µm, and its standard deviation.
    #[must_use]
    pub fn error_difference_with_std_um(
        &mut self,
        from: &Pose,
        to: &Pose,
        toward: [f64; 3],
    ) -> [f64; 2] {
        let [from, to] = [from, to].map(|pose| self.constants.tip_sensitivities(pose));
        let row: Vec<f64> =
            to.iter().zip(&from).map(|(to, from)| dot(toward, *to) - dot(toward, *from)).collect();
        self.posterior.predict(&row)
    }
}

/// Finds the errors of the volume in `runs`; what `machine` predicts is taken off first, and the errors are added to it.
///
/// # Errors
/// The machine has no chain; a run lacks positions or readings, or has too few of them; a diagonal or a circle is none.
pub fn fit(
    runs: &[RunFile],
    machine: &Machine,
    options: &VolumeFitOptions,
) -> Result<VolumeReport, InputFileError> {
    let Some(chain) = &machine.volume.chain else {
        let rule = "machine.chain is missing: the sign and the lever of an error depend on what each axis carries";
        let help = "write the axes into [machine] from the workpiece over the bed to the tool: chain = \"w X' b Y Z t\"";
        let path = runs.first().map_or_else(|| "".as_ref(), RunFile::path);
        let place = machine.places.locate("machine");
        let place =
            if place.file.as_os_str().is_empty() { Location::start_of_file(path) } else { place };
        return Err(InputFileError::new(place, rule).with_help(help));
    };
    let mut warnings = Vec::new();
    let readings = run_reader::read(runs, machine, options.artefact_um.is_some(), &mut warnings)?;
    let uncertainty = ArtefactUncertainty {
        scale_um_per_m: options.scale_um_per_m.unwrap_or(PRIOR_SCALE_STD_UM_PER_M),
        artefact_um: options.artefact_um.unwrap_or(0.0),
    };
    // The file states an expanded uncertainty.
    let of_file = machine.instrument_um.map(|um| 0.5 * um);
    let noise_um = options.instrument_um.or(of_file).unwrap_or(DEFAULT_READING_NOISE_UM);
    let poses: Vec<Pose> = readings.iter().map(|reading| reading.pose).collect();
    let points_mm = reference_points_mm(machine, &ForwardKinematics::new(machine, chain), &poses);
    let mut own = machine.clone();
    if let Some(points_mm) = points_mm {
        own.volume.point_mm = points_mm;
    }
    warn_missing_rotary_axis_lines(&own, &mut warnings);
    let constants = ErrorParameters::new(&own, &poses);
    let design = DesignMatrix::new(&own, constants.clone(), &readings);
    let all = normal_equations(&design, &readings, |_| true);
    let (variances, found) = estimate_variances(&design, &all, &uncertainty, noise_um);
    let gross = find_gross_errors(&design, &readings, &variances, &found);
    let is_in = |n: usize| !gross[n];
    let all = if gross.contains(&true) { normal_equations(&design, &readings, is_in) } else { all };
    let (variances, found) = match gross.contains(&true) {
        true => estimate_variances(&design, &all, &uncertainty, noise_um),
        false => (variances, found),
    };
    let held_out = identifiability::cross_validate(&design, &readings, is_in, &all, &variances);
    let observability =
        identifiability::assess_observability(&design, &all, &uncertainty, variances.noise_um);
    let mut known = identifiability::assess_errors(&design, &found, &observability, &readings);
    let used: Vec<VolumeReading> =
        (0..readings.len()).filter(|n| is_in(*n)).map(|n| readings[n]).collect();
    next_tests::propose_next_tests(
        &own,
        &constants,
        &used,
        &uncertainty,
        variances.noise_um,
        &mut known,
    );
    if options.scale_um_per_m.is_none()
        && known.iter().any(|assessment| assessment.error.unit() == "µm" && !assessment.is_known)
    {
        warnings.push(
            "the scale of the artefact is not stated, so that the mean scale of the axes is not known: --scale-um-per-m"
                .into(),
        );
    }
    let count = constants.all.len();
    let mean: Vec<f64> = found.mean.iter().take(count).copied().collect();
    let (edit, written) = match held_out.is_better {
        true => section_writer::build_machine_file_edit(
            machine,
            &constants,
            &mean,
            &known,
            points_mm,
            &mut warnings,
        ),
        false => (MachineFileEdit::default(), Vec::new()),
    };
    let kinds = |kind: ReadingKind| used.iter().filter(|reading| reading.kind == kind).count();
    let readings_of = ReadingKind::ALL.map(kinds);
    Ok(VolumeReport {
        known,
        written,
        edit,
        held_out,
        noise_um: ReadingKind::ALL
            .map(|kind| (kinds(kind) > 0).then(|| variances.noise_um[kind.index()])),
        readings: readings_of,
        excluded: list_excluded_rows(runs, &readings, &gross),
        warnings,
        model: VolumetricModel { constants, posterior: found },
    })
}

/// Returns where straightness is to be stated: in the middle of what was measured. `None` where the file has angles or points.
fn reference_points_mm(
    machine: &Machine,
    frame: &ForwardKinematics<'_>,
    poses: &[Pose],
) -> Option<[[f64; 3]; 3]> {
    let volume = &machine.volume;
    if !volume.angular.is_empty() || volume.point_mm != [[0.0; 3]; 3] {
        return None;
    }
    let middle = [0, 1, 2].map(|n| {
        let at = || poses.iter().map(|pose| pose.position_mm[n]);
        0.5 * (at().fold(f64::INFINITY, f64::min) + at().fold(f64::MIN, f64::max))
    });
    let count = poses.len() as f64;
    let tool_mm = poses.iter().map(|pose| pose.tool_mm).sum::<f64>() / count;
    let tip = frame.tip_offset_mm(&Pose { position_mm: middle, angle_deg: [0.0; 3], tool_mm });
    let chain = volume.chain.as_ref()?;
    Some(trueup_machine::machine_file::LinearAxis::ALL.map(|along| {
        let mut point = tip;
        for axis in chain.lever_axes(along) {
            point[axis.index()] += middle[axis.index()];
        }
        point.map(|mm| trueup_machine::machine_file::writer::round_to_decimals(mm, 3))
    }))
}

/// Warns where the line of a rotary axis is not stated.
fn warn_missing_rotary_axis_lines(machine: &Machine, warnings: &mut Vec<String>) {
    for axis in
        machine.volume.chain.iter().flat_map(trueup_machine::machine_file::AxisChain::rotary_axes)
    {
        if !machine.volume.rotary.iter().any(|location| location.axis == axis) {
            warnings.push(format!(
                "rotary.{}.point_mm is not stated: its line is taken to go through machine zero",
                axis.name()
            ));
        }
    }
}

/// Returns for each reading whether it is a gross error.
fn find_gross_errors(
    design: &DesignMatrix,
    readings: &[VolumeReading],
    variances: &Variances,
    found: &Posterior,
) -> Vec<bool> {
    let left: Vec<f64> = readings
        .iter()
        .zip(&design.rows)
        .map(|(reading, row)| {
            let fitted: f64 = row.iter().zip(found.mean.iter()).map(|(a, b)| a * b).sum();
            reading.um - fitted
        })
        .collect();
    let mut by_kind: BTreeMap<ReadingKind, Vec<f64>> = BTreeMap::new();
    for (reading, left) in readings.iter().zip(&left) {
        by_kind.entry(reading.kind).or_default().push(left.abs());
    }
    // A standard deviation is 1.4826 medians; a fit that is near all readings leaves less than their noise.
    let limits: BTreeMap<ReadingKind, f64> = by_kind
        .into_iter()
        .map(|(kind, mut left)| {
            let scatter = 1.4826 * robust::median(&mut left);
            (
                kind,
                GROSS_ERROR_THRESHOLD_SIGMAS * scatter.max(0.5 * variances.noise_um[kind.index()]),
            )
        })
        .collect();
    readings.iter().zip(left).map(|(reading, left)| left.abs() > limits[&reading.kind]).collect()
}

fn list_excluded_rows(
    runs: &[RunFile],
    readings: &[VolumeReading],
    gross: &[bool],
) -> Vec<ExcludedRow> {
    let found = readings.iter().zip(gross).filter(|(_, is_gross)| **is_gross);
    found
        .map(|(reading, _)| ExcludedRow {
            place: runs[reading.source[0]].value_location(reading.source[1], reading.column),
            measured_um: reading.measured_um,
            reason: "far from all other readings together".into(),
        })
        .collect()
}
