//! The shape that every fit's outcome has, so that one printer serves all fits.
//!
//! A fit fills in a [`FitReport`]; what only it knows (the figures of ISO 230-2, the number of knots)
//! goes into [`FitReport::facts`]. Nothing is printed here: text and JSON are the command's business.

use std::fmt;

use trueup_machine::{Location, machine_file::writer::MachineFileEdit};
use trueup_numerics::line::ErrorStatistics;

/// The result of a fit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitReport {
    /// The name of the fit as the command has it: `pitch`.
    pub kind: &'static str,
    /// The column that was explained: `measured_dx_um`.
    pub column: String,
    /// The constants, in the order in which they are to be read.
    pub parameters: Vec<FitParameter>,
    /// Further figures of this fit.
    pub facts: Vec<FitDetail>,
    /// A table for people, line by line, of figures that the facts hold in part or whole.
    pub table: String,
    /// The measured values themselves on the rows that were used: what is there without any fit.
    pub before: Option<ResidualStatistics>,
    /// The residuals of the rows that were fitted.
    pub in_sample: Option<ResidualStatistics>,
    /// The residuals of rows that the constants had not seen, each row once.
    pub held_out: Option<ResidualStatistics>,
    /// How rows were held out: "each row in turn", "each of 5 cycles in turn".
    pub held_out_by: String,
    /// Rows that the fit rests on.
    pub rows_used: usize,
    /// Rows without one of the values that the fit needs.
    pub rows_incomplete: usize,
    /// Rows that were found and not used, with their reasons.
    pub excluded: Vec<ExcludedRow>,
    /// Warnings for the user before relying on it; whole sentences.
    pub warnings: Vec<String>,
    /// Requests that are not reached, though the constants are fit for use: a tolerance.
    pub unmet: Vec<String>,
    /// Whether the constants are fit for use.
    pub verdict: FitVerdict,
    /// The changes in the machine file; empty where the verdict is not to compensate.
    pub edit: MachineFileEdit,
}

impl FitReport {
    /// Returns an empty report of the fit `kind` on `column`.
    #[must_use]
    pub fn new(kind: &'static str, column: impl Into<String>) -> Self {
        Self { kind, column: column.into(), ..Self::default() }
    }

    /// Returns the parameter `name`, if the fit has it.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&FitParameter> {
        self.parameters.iter().find(|parameter| parameter.name == name)
    }
}

/// A constant and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct FitParameter {
    /// Its key in the machine file, with its unit: `um_per_count`.
    pub name: String,
    /// Its value, as it is written to the machine file.
    pub value: f64,
    /// The interval that holds the true value in 95 of 100 such measurements, if the residuals are
    /// what the fit takes them for; `None` for what was set and not fitted.
    pub ci95: Option<[f64; 2]>,
    /// Whether it is the size of the effect itself: where it may be 0, the effect may be none.
    pub is_amplitude: bool,
}

impl FitParameter {
    /// Returns a fitted constant, `half_width` from its value to either end of the interval.
    #[must_use]
    pub fn fitted(name: impl Into<String>, value: f64, half_width: f64) -> Self {
        let ci95 = Some([value - half_width, value + half_width]);
        Self { name: name.into(), value, ci95, is_amplitude: false }
    }

    /// Returns a fitted constant that is the size of the effect itself.
    #[must_use]
    pub fn amplitude(name: impl Into<String>, value: f64, half_width: f64) -> Self {
        Self { is_amplitude: true, ..Self::fitted(name, value, half_width) }
    }

    /// Returns true where it is an amplitude whose interval includes 0.
    #[must_use]
    pub(crate) fn is_insignificant_amplitude(&self) -> bool {
        self.is_amplitude && self.ci95.is_some_and(|[low, high]| low <= 0.0 && 0.0 <= high)
    }

    /// Returns a constant that was set, by the user or by convention, and not fitted.
    #[must_use]
    pub fn fixed(name: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), value, ci95: None, is_amplitude: false }
    }
}

impl fmt::Display for FitParameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.ci95 {
            None => write!(f, "{} = {} (set)", self.name, self.value),
            Some([low, high]) => {
                // Two digits of the interval: what is beyond is noise.
                let digits = significant_decimals(high - low);
                let value = self.value;
                write!(f, "{} = {value:.digits$} ({low:.digits$} to {high:.digits$})", self.name)
            }
        }
    }
}

/// Digits after the point to which a number with an uncertainty of `width` is worth printing.
fn significant_decimals(width: f64) -> usize {
    if !(width.is_finite() && width > 0.0) {
        return 9;
    }
    // At most 14 digits, so that the number always fits.
    (1.0 - width.log10().floor()).clamp(0.0, 14.0) as usize
}

/// A figure that only one kind of fit has.
#[derive(Clone, Debug, PartialEq)]
pub struct FitDetail {
    /// Its name with its unit: `repeatability_um`.
    pub name: String,
    /// Its value, in the unit that the name ends with.
    pub value: FitDetailValue,
}

/// The value of a [`FitDetail`].
#[derive(Clone, Debug, PartialEq)]
pub enum FitDetailValue {
    /// One number.
    Number(f64),
    /// Several numbers.
    Numbers(Vec<f64>),
    /// A text.
    Text(String),
}

impl FitDetail {
    /// Returns a figure of one number.
    #[must_use]
    pub fn number(name: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), value: FitDetailValue::Number(value) }
    }

    /// Returns a figure of several numbers.
    #[must_use]
    pub fn numbers(name: impl Into<String>, values: Vec<f64>) -> Self {
        Self { name: name.into(), value: FitDetailValue::Numbers(values) }
    }

    /// Returns a figure in words.
    #[must_use]
    pub fn text(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { name: name.into(), value: FitDetailValue::Text(text.into()) }
    }
}

/// How large residuals are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualStatistics {
    /// The root of the mean square, in µm.
    pub rms_um: f64,
    /// The largest magnitude, in µm.
    pub max_um: f64,
}

impl ResidualStatistics {
    /// Of the residuals that are not missing (NaN); `None` if there are none.
    #[must_use]
    pub fn from_residuals(residuals_um: &[f64]) -> Option<Self> {
        ErrorStatistics::from_residuals(residuals_um)
            .map(|ErrorStatistics { rms, max_abs }| Self { rms_um: rms, max_um: max_abs })
    }
}

/// A row that was found and not used.
#[derive(Clone, Debug, PartialEq)]
pub struct ExcludedRow {
    /// The file, line and column of the measured value.
    pub place: Location,
    /// The measured value in µm.
    pub measured_um: f64,
    /// Why: "212.4 um from the other rows, 61 times their scatter".
    pub reason: String,
}

impl fmt::Display for ExcludedRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: excluded as an outlier, {} µm is {}",
            self.place, self.measured_um, self.reason
        )
    }
}

/// Whether a fit is fit for use.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum FitVerdict {
    /// The constants hold on rows that they have not seen.
    #[default]
    Fitted,
    /// They do not: a correction would make parts worse. The figures that say so, a sentence each.
    DoNotCompensate(Vec<String>),
}

impl FitVerdict {
    /// Returns whether the constants are fit for use.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        matches!(self, Self::Fitted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_is_printed_to_the_digits_that_its_interval_gives_it() {
        for (value, half_width, expected) in [
            (1.297_531_7, 0.04, "gain = 1.298 (1.258 to 1.338)"),
            (-3.987_1, 1.22, "gain = -4.0 (-5.2 to -2.8)"),
            (1234.5678, 321.0, "gain = 1235 (914 to 1556)"),
            (0.019_798, 3.1e-7, "gain = 0.01979800 (0.01979769 to 0.01979831)"),
        ] {
            assert_eq!(FitParameter::fitted("gain", value, half_width).to_string(), expected);
        }
        assert_eq!(
            FitParameter::fixed("zero_counts", 5048.0).to_string(),
            "zero_counts = 5048 (set)"
        );
    }

    #[test]
    fn an_interval_without_a_width_is_still_printed() {
        assert!(
            FitParameter::fitted("gain", 2.0, 0.0).to_string().starts_with("gain = 2.000000000 ")
        );
        assert!(FitParameter::fitted("gain", 2.0, f64::NAN).to_string().contains("NaN"));
    }
}
