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
//! | [`modes`] | forms of a smooth function |
//! | [`constants`] | the errors, and what a unit of each does |
//! | [`frame`], [`setup`] | the workpiece and the tool, and what is unknown of a set-up |
//! | `design` | the equations |
//! | [`mod@estimate`] | constants, noise and sizes |
//! | [`judge`] | what is known, and readings that were held out |
//! | [`next`] | the measurement that would settle the rest |
//! | [`written`] | sections of the machine file |
//! | `page` | the page with the curves |

pub mod constants;
pub(crate) mod design;
pub mod estimate;
pub mod frame;
pub mod judge;
pub mod modes;
pub mod next;
mod page;
mod predicted;
mod read;
pub mod reading;
pub mod setup;
pub mod written;

use std::collections::BTreeMap;

use trueup_machine::{BadInput, Location, Machine, RunFile, file::write::Edit};
use trueup_numerics::robust;

use self::{
    constants::Constants,
    design::{Design, normals},
    estimate::{Posterior, Variances, estimate},
    frame::Frame,
    judge::{HeldOut, Known},
    reading::{Kind, Pose, Reading, dot},
    setup::Uncertainty,
};
use crate::report::SetAside;

pub use self::{constants::Error, judge::HALF_WIDTH, page::page};

/// A reading further from the fit, in standard deviations by the median, is a gross error.
const GROSS: f64 = 6.0;
/// The scale of an artefact that nothing is known of, in µm/m.
const ANY_SCALE: f64 = 100.0;
/// The noise before the readings say more, in µm.
const USUAL_NOISE_UM: f64 = 1.0;

/// The stated uncertainties of the instrument.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Standard uncertainty of a reading in µm; `None`: that of the machine file, else by the readings alone.
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
    pub known: Vec<Known>,
    /// The errors that are written.
    pub written: Vec<Error>,
    /// The sections of the machine file.
    pub edit: Edit,
    /// Readings that were held out.
    pub held_out: HeldOut,
    /// The noise of each kind of reading in µm; `None` where there is none of the kind.
    pub noise_um: [Option<f64>; 4],
    /// Readings of each kind.
    pub readings: [usize; 4],
    /// Gross readings.
    pub set_aside: Vec<SetAside>,
    /// Warnings to the user; whole sentences.
    pub warnings: Vec<String>,
    /// The constants, to predict with.
    pub model: Model,
}

impl VolumeReport {
    /// Returns whether the correction gains on held-out readings by more than the standard error.
    #[must_use]
    pub fn is_better(&self) -> bool {
        self.held_out.is_better
    }
}

/// The constants, and how well they predict.
#[derive(Clone, Debug)]
pub struct Model {
    constants: Constants,
    posterior: Posterior,
}

impl Model {
    /// Returns the difference of the errors of two poses in a direction, µm, and its standard deviation.
    #[must_use]
    pub fn difference_um(&mut self, from: &Pose, to: &Pose, toward: [f64; 3]) -> [f64; 2] {
        let [from, to] = [from, to].map(|pose| self.constants.at(pose));
        let row: Vec<f64> =
            to.iter().zip(&from).map(|(to, from)| dot(toward, *to) - dot(toward, *from)).collect();
        self.posterior.of(&row)
    }
}

/// Finds the errors of the volume in `runs`; what `machine` predicts is taken off first, and the errors are added to it.
///
/// # Errors
/// The machine has no chain; a run lacks positions or readings, or has too few of them; a diagonal or a circle is none.
pub fn fit(
    runs: &[RunFile],
    machine: &Machine,
    options: &Options,
) -> Result<VolumeReport, BadInput> {
    let Some(chain) = &machine.volume.chain else {
        let rule = "machine.chain is missing: the sign and the lever of an error depend on what each axis carries";
        let help = "write the axes into [machine] from the workpiece over the bed to the tool: chain = \"w X' b Y Z t\"";
        let path = runs.first().map_or_else(|| "".as_ref(), RunFile::path);
        let place = machine.places.of("machine");
        let place =
            if place.file.as_os_str().is_empty() { Location::start_of(path) } else { place };
        return Err(BadInput::new(place, rule).with_help(help));
    };
    let mut warnings = Vec::new();
    let readings = read::read(runs, machine, options.artefact_um.is_some(), &mut warnings)?;
    let uncertainty = Uncertainty {
        scale_um_per_m: options.scale_um_per_m.unwrap_or(ANY_SCALE),
        artefact_um: options.artefact_um.unwrap_or(0.0),
    };
    // The file states an expanded uncertainty.
    let of_file = machine.instrument_um.map(|um| 0.5 * um);
    let noise_um = options.instrument_um.or(of_file).unwrap_or(USUAL_NOISE_UM);
    let poses: Vec<Pose> = readings.iter().map(|it| it.pose).collect();
    let points_mm = points(machine, &Frame::of(machine, chain), &poses);
    let mut own = machine.clone();
    if let Some(points_mm) = points_mm {
        own.volume.point_mm = points_mm;
    }
    say_of_lines(&own, &mut warnings);
    let constants = Constants::of(&own, &poses);
    let design = Design::of(&own, constants.clone(), &readings);
    let all = normals(&design, &readings, |_| true);
    let (variances, found) = estimate(&design, &all, &uncertainty, noise_um);
    let gross = gross(&design, &readings, &variances, &found);
    let is_in = |n: usize| !gross[n];
    let all = if gross.contains(&true) { normals(&design, &readings, is_in) } else { all };
    let (variances, found) = match gross.contains(&true) {
        true => estimate(&design, &all, &uncertainty, noise_um),
        false => (variances, found),
    };
    let held_out = judge::held_out(&design, &readings, is_in, &all, &variances);
    let sight = judge::sight(&design, &all, &uncertainty, variances.noise_um);
    let mut known = judge::known(&design, &found, &sight, &readings);
    let used: Vec<Reading> =
        (0..readings.len()).filter(|n| is_in(*n)).map(|n| readings[n]).collect();
    next::propose(&own, &constants, &used, &uncertainty, variances.noise_um, &mut known);
    if options.scale_um_per_m.is_none()
        && known.iter().any(|it| it.error.unit() == "µm" && !it.is_known)
    {
        warnings.push(
            "the scale of the artefact is not stated, so that the mean scale of the axes is not known: --scale-um-per-m"
                .into(),
        );
    }
    let count = constants.all.len();
    let mean: Vec<f64> = found.mean.iter().take(count).copied().collect();
    let (edit, written) = match held_out.is_better {
        true => written::edit(machine, &constants, &mean, &known, points_mm, &mut warnings),
        false => (Edit::default(), Vec::new()),
    };
    let kinds = |kind: Kind| used.iter().filter(|it| it.kind == kind).count();
    let readings_of = Kind::ALL.map(kinds);
    Ok(VolumeReport {
        known,
        written,
        edit,
        held_out,
        noise_um: Kind::ALL.map(|kind| (kinds(kind) > 0).then(|| variances.noise_um[kind.index()])),
        readings: readings_of,
        set_aside: set_aside(runs, &readings, &gross),
        warnings,
        model: Model { constants, posterior: found },
    })
}

/// Returns where straightness is to be stated: in the middle of what was measured. `None` where the file has angles or points.
fn points(machine: &Machine, frame: &Frame<'_>, poses: &[Pose]) -> Option<[[f64; 3]; 3]> {
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
    let tip = frame.tip_mm(&Pose { position_mm: middle, angle_deg: [0.0; 3], tool_mm });
    let chain = volume.chain.as_ref()?;
    Some(trueup_machine::file::LinearAxis::ALL.map(|along| {
        let mut point = tip;
        for axis in chain.in_lever(along) {
            point[axis.index()] += middle[axis.index()];
        }
        point.map(|mm| trueup_machine::file::write::rounded(mm, 3))
    }))
}

/// Warns where the line of a rotary axis is not stated.
fn say_of_lines(machine: &Machine, warnings: &mut Vec<String>) {
    for axis in machine.volume.chain.iter().flat_map(trueup_machine::file::Chain::rotary) {
        if !machine.volume.rotary.iter().any(|it| it.axis == axis) {
            warnings.push(format!(
                "rotary.{}.point_mm is not stated: its line is taken to go through machine zero",
                axis.name()
            ));
        }
    }
}

/// Returns for each reading whether it is a gross error.
fn gross(
    design: &Design,
    readings: &[Reading],
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
    let mut by_kind: BTreeMap<Kind, Vec<f64>> = BTreeMap::new();
    for (reading, left) in readings.iter().zip(&left) {
        by_kind.entry(reading.kind).or_default().push(left.abs());
    }
    // A standard deviation is 1.4826 medians; a fit that is near all readings leaves less than their noise.
    let limits: BTreeMap<Kind, f64> = by_kind
        .into_iter()
        .map(|(kind, mut left)| {
            let scatter = 1.4826 * robust::median(&mut left);
            (kind, GROSS * scatter.max(0.5 * variances.noise_um[kind.index()]))
        })
        .collect();
    readings.iter().zip(left).map(|(reading, left)| left.abs() > limits[&reading.kind]).collect()
}

fn set_aside(runs: &[RunFile], readings: &[Reading], gross: &[bool]) -> Vec<SetAside> {
    let found = readings.iter().zip(gross).filter(|(_, is_gross)| **is_gross);
    found
        .map(|(reading, _)| SetAside {
            place: runs[reading.source[0]].place(reading.source[1], reading.column),
            measured_um: reading.measured_um,
            reason: "far from what all other readings say together".into(),
        })
        .collect()
}
