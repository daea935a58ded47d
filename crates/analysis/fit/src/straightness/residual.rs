//! The residuals of the readings from a curve, in the figures of the paper's Table 1.

/// The differences between readings and a curve, over the positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualSummary {
    /// Largest minus smallest, in µm.
    pub range_um: f64,
    /// Mean, in µm.
    pub mean_um: f64,
    /// Mean square about the mean, in µm²: so the paper's Table 1 has it, where 16.4² is more than
    /// 98.2.
    pub mean_square_um2: f64,
    /// Root mean square about zero, in µm.
    pub rms_um: f64,
    /// Largest absolute value, in µm.
    pub largest_um: f64,
}

impl ResidualSummary {
    /// Of at least one value.
    pub(super) fn from_residuals(residuals: &[f64]) -> Self {
        let count = residuals.len() as f64;
        let mean_um = residuals.iter().sum::<f64>() / count;
        let square =
            |about: f64| residuals.iter().map(|r| (r - about).powi(2)).sum::<f64>() / count;
        let (low, high) = residuals
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &r| (low.min(r), high.max(r)));
        Self {
            range_um: high - low,
            mean_um,
            mean_square_um2: square(mean_um),
            rms_um: square(0.0).sqrt(),
            largest_um: high.max(-low),
        }
    }
}
