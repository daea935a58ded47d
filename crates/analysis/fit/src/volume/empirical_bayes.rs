//! Constants, and how well they are known: least squares where each error is expected to be of some size, and the sizes themselves
//! are found from the readings.
//!
//! ```text
//! A = Σ XᵀX/σ² + diag(1/v)        mean = A⁻¹·Σ Xᵀy/σ²        covariance = A⁻¹
//! ```
//!
//! σ is the noise of a kind of reading, v the expected variance of a constant: τ² of its error times the share of the form. Both
//! make the readings most likely (EM for variance components):
//!
//! ```text
//! σ² ← (|y − X·mean|² + tr(XᵀX·A⁻¹) + ν·u²)/(n + ν)
//! τ² ← (Σ (mean² + A⁻¹)/share + ν·s²)/(m + ν)
//! ```
//!
//! u is the stated uncertainty of the instrument. s is the size of the family (all straightnesses, all angles): for the forms the mean
//! of the family's own τ², for a few numbers a usual size. So an error that the readings hardly see is expected to be like its
//! relatives, and what they do not show stays small.

use nalgebra::{DMatrix, DVector};

use super::{
    design_matrix::{DesignMatrix, NormalEquationsByKind},
    error_parameters::{ErrorParameter, ErrorPart, GeometricError},
    nuisance_parameters::ArtefactUncertainty,
};

/// The weight of a usual size, in constants.
const PRIOR_VARIANCE_WEIGHT: f64 = 2.0;
/// The weight of the family for a function of its own, in forms.
const FAMILY_VARIANCE_WEIGHT: f64 = 4.0;
/// The weight of the stated noise, in readings.
const STATED_NOISE_WEIGHT: f64 = 4.0;
const MAX_ITERATIONS: usize = 60;
/// Change of a logarithm of a variance at which it has settled.
const LOG_VARIANCE_TOLERANCE: f64 = 0.02;
/// The smallest noise, in µm: readings have digits.
const MIN_READING_NOISE_UM: f64 = 0.02;

/// Constants that are of one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum VarianceFamily {
    /// Lines of positions.
    Scale,
    /// Forms of positions.
    Position,
    /// Forms of straightness.
    Straightness,
    /// Squareness.
    Squareness,
    /// Lines of angles.
    AngleLine,
    /// Forms of angles.
    Angle,
    /// Shifts of rotary axes.
    Shift,
    /// Tilts of rotary axes.
    Tilt,
}

impl VarianceFamily {
    /// Returns the family of a constant.
    #[must_use]
    pub(crate) fn from_parameter(constant: ErrorParameter) -> Self {
        match (constant.error, constant.part) {
            (GeometricError::Position(_), ErrorPart::Form(_)) => Self::Position,
            (GeometricError::Position(_), _) => Self::Scale,
            (GeometricError::Straightness(..), _) => Self::Straightness,
            (GeometricError::Squareness(..), _) => Self::Squareness,
            (GeometricError::Angle(..), ErrorPart::Form(_)) => Self::Angle,
            (GeometricError::Angle(..), _) => Self::AngleLine,
            (GeometricError::Shift(..), _) => Self::Shift,
            (GeometricError::Tilt(..), _) => Self::Tilt,
        }
    }

    /// Returns a usual size: µm, µm/m, µrad or µrad/m.
    #[must_use]
    pub(crate) fn typical_std(self) -> f64 {
        match self {
            Self::Position | Self::Straightness => 3.0,
            Self::Angle => 5.0,
            Self::Scale | Self::AngleLine | Self::Shift | Self::Tilt => 20.0,
            Self::Squareness => 30.0,
        }
    }

    fn is_form_error(self) -> bool {
        matches!(self, Self::Position | Self::Straightness | Self::Angle)
    }
}

/// Expected variances.
#[derive(Clone, Debug)]
pub struct Variances {
    /// The noise of each kind of reading, a standard deviation in µm.
    pub noise_um: [f64; 4],
    /// Of each column.
    pub of_column: Vec<f64>,
}

impl Variances {
    /// Returns usual ones, `size` times as large: what a design sees without the readings.
    #[must_use]
    pub(crate) fn typical(
        design: &DesignMatrix,
        uncertainty: &ArtefactUncertainty,
        noise_um: [f64; 4],
        size: f64,
    ) -> Self {
        let of = |constant: &ErrorParameter| {
            (size * VarianceFamily::from_parameter(*constant).typical_std()).powi(2)
                * variance_fraction(design, *constant)
        };
        let of_nuisance =
            design.nuisances.iter().map(|nuisance| nuisance.prior_std(uncertainty).powi(2));
        let of_column = design.constants.all.iter().map(of).chain(of_nuisance).collect();
        Self { noise_um, of_column }
    }

    /// Returns the same without any error of the machine.
    #[must_use]
    pub(crate) fn without_machine_errors(&self, design: &DesignMatrix) -> Self {
        let mut own = self.clone();
        own.of_column[..design.constants.all.len()].fill(0.0);
        own
    }
}

fn variance_fraction(design: &DesignMatrix, constant: ErrorParameter) -> f64 {
    match (constant.part, constant.error.motion_axis()) {
        (ErrorPart::Form(n), Some(along)) => {
            design.constants.modes[along.index()].as_ref().map_or(1.0, |modes| modes.shares[n])
        }
        _ => 1.0,
    }
}

/// The constants after the readings.
#[derive(Clone, Debug)]
pub(crate) struct Posterior {
    /// Of each column.
    pub mean: DVector<f64>,
    /// Of all columns.
    pub covariance: DMatrix<f64>,
}

impl Posterior {
    /// Returns the mean and the standard deviation of a row of columns; a row may end earlier.
    #[must_use]
    pub fn predict(&self, row: &[f64]) -> [f64; 2] {
        let used: Vec<usize> = (0..row.len()).filter(|n| row[*n] != 0.0).collect();
        let mean = used.iter().map(|n| row[*n] * self.mean[*n]).sum();
        let variance: f64 = used
            .iter()
            .map(|n| {
                row[*n] * used.iter().map(|m| row[*m] * self.covariance[(*n, *m)]).sum::<f64>()
            })
            .sum();
        [mean, variance.max(0.0).sqrt()]
    }
}

/// Returns what the readings say of the columns.
///
/// # Panics
/// The equations are not finite.
#[must_use]
pub(crate) fn compute_posterior(
    normals: &NormalEquationsByKind,
    variances: &Variances,
) -> Posterior {
    let count = variances.of_column.len();
    let scale =
        DVector::from_iterator(count, variances.of_column.iter().map(|variance| variance.sqrt()));
    let (mut squares, mut products) = (DMatrix::zeros(count, count), DVector::zeros(count));
    for (normal, noise_um) in normals.iter().zip(variances.noise_um) {
        if normal.count > 0 {
            squares += &normal.squares / (noise_um * noise_um);
            products += &normal.products / (noise_um * noise_um);
        }
    }
    for column in 0..count {
        for row in 0..count {
            squares[(row, column)] *= scale[row] * scale[column];
        }
        squares[(column, column)] += 1.0;
    }
    let mut covariance = squares.cholesky().expect("1 is added to a square").inverse();
    for column in 0..count {
        for row in 0..count {
            covariance[(row, column)] *= scale[row] * scale[column];
        }
    }
    let mean = &covariance * products;
    Posterior { mean, covariance }
}

/// Returns the variances that make the readings most likely, begun at the stated noise, and the constants with them.
#[must_use]
pub(crate) fn estimate_variances(
    design: &DesignMatrix,
    normals: &NormalEquationsByKind,
    uncertainty: &ArtefactUncertainty,
    noise_um: f64,
) -> (Variances, Posterior) {
    let mut variances = Variances::typical(design, uncertainty, [noise_um; 4], 1.0);
    let mut found = compute_posterior(normals, &variances);
    for _ in 0..MAX_ITERATIONS {
        let before = variances.clone();
        update_noise_std(normals, &found, noise_um, &mut variances);
        update_variances(design, &found, &mut variances);
        found = compute_posterior(normals, &variances);
        if is_converged(&before, &variances) {
            break;
        }
    }
    (variances, found)
}

fn update_noise_std(
    normals: &NormalEquationsByKind,
    found: &Posterior,
    stated_um: f64,
    variances: &mut Variances,
) {
    for (normal, noise_um) in normals.iter().zip(&mut variances.noise_um) {
        let own = &normal.squares * &found.mean;
        let left = normal.whole - 2.0 * found.mean.dot(&normal.products) + found.mean.dot(&own);
        let of_constants = normal.squares.dot(&found.covariance);
        let sum = left.max(0.0) + of_constants + STATED_NOISE_WEIGHT * stated_um * stated_um;
        *noise_um =
            (sum / (normal.count as f64 + STATED_NOISE_WEIGHT)).sqrt().max(MIN_READING_NOISE_UM);
    }
}

fn update_variances(design: &DesignMatrix, found: &Posterior, variances: &mut Variances) {
    let all = &design.constants.all;
    let square = |at: usize| {
        (found.mean[at] * found.mean[at] + found.covariance[(at, at)])
            / variance_fraction(design, all[at])
    };
    let mut groups: Vec<(VarianceFamily, Option<GeometricError>, Vec<usize>)> = Vec::new();
    for (at, constant) in all.iter().enumerate() {
        let family = VarianceFamily::from_parameter(*constant);
        let error = family.is_form_error().then_some(constant.error);
        match groups.iter_mut().find(|group| (group.0, group.1) == (family, error)) {
            Some(group) => group.2.push(at),
            None => groups.push((family, error, vec![at])),
        }
    }
    let mean = |group: &[usize]| group.iter().map(|at| square(*at)).sum::<f64>();
    let of_families: Vec<(VarianceFamily, f64, f64)> = groups
        .iter()
        .map(|(family, _, group)| (*family, mean(group), group.len() as f64))
        .collect();
    for (family, _, group) in &groups {
        let usual = family.typical_std().powi(2);
        let (sum, count) = of_families
            .iter()
            .filter(|entry| entry.0 == *family)
            .fold((0.0, 0.0), |(sum, count), entry| (sum + entry.1, count + entry.2));
        let of_family = (sum + PRIOR_VARIANCE_WEIGHT * usual) / (count + PRIOR_VARIANCE_WEIGHT);
        let size = if family.is_form_error() {
            (mean(group) + FAMILY_VARIANCE_WEIGHT * of_family)
                / (group.len() as f64 + FAMILY_VARIANCE_WEIGHT)
        } else {
            of_family
        };
        for at in group {
            variances.of_column[*at] = size * variance_fraction(design, all[*at]);
        }
    }
}

fn is_converged(before: &Variances, after: &Variances) -> bool {
    let noise = before.noise_um.iter().zip(after.noise_um).map(|(a, b)| (b / a).ln().abs());
    let sizes = before.of_column.iter().zip(&after.of_column).filter(|(a, _)| **a > 0.0);
    let sizes = sizes.map(|(a, b)| (b / a).ln().abs());
    // The noise is a standard deviation.
    noise.map(|noise| 2.0 * noise).chain(sizes).all(|size| size < LOG_VARIANCE_TOLERANCE)
}
