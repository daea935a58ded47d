//! The data that a page requires before it proposes itself, and the values where a search begins.
//!
//! A diagnosis answers; the pages say which causes the machine and the data allow. Nonlinear values
//! are tried on a grid; the best point is then refined with everything else.

use super::quantity::Quantity;
use crate::sections::{AxisModel, ElongationSource, Feedback, LinearAxis, Spindle, ThermalLaw};

/// Trials of a time constant.
pub(crate) const TIME_CONSTANT_GRID_POINTS: usize = 12;
/// The same where a constant is corrected by a factor: the next point of a coarse grid may be worse
/// than none.
pub(crate) const FINE_TIME_CONSTANT_GRID_POINTS: usize = 3 * TIME_CONSTANT_GRID_POINTS;

/// Nonlinear values to begin from; one empty list where there are none.
#[derive(Clone, Debug, PartialEq)]
pub struct StartValues {
    /// A list for each trial; none: nothing is to be tried.
    pub starts: Vec<Vec<f64>>,
    /// ln of the number of settings that were looked at to find these.
    pub searched: f64,
}

impl StartValues {
    /// Nothing nonlinear.
    #[must_use]
    pub(crate) fn linear_only() -> Self {
        Self { starts: vec![Vec::new()], searched: 0.0 }
    }

    /// Returns one value at each of these.
    #[must_use]
    pub fn from_values(values: impl IntoIterator<Item = f64>) -> Self {
        Self { starts: values.into_iter().map(|value| vec![value]).collect(), searched: 0.0 }
    }
}

/// The variable over which a periodic error is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpectrumVariable<'a> {
    /// The position of the own axis.
    Position,
    /// The clock.
    Time,
    /// The elongation that is predicted.
    Elongation,
    /// A column.
    Column(&'a str),
}

/// The data that a cause is looked for in, the current model, and what that leaves.
pub trait DataView {
    /// Returns what was measured.
    fn quantity(&self) -> Quantity;
    /// Returns how the spindle is believed to grow.
    fn spindle(&self) -> &Spindle;
    /// Returns what is believed of the quantity's own axis.
    fn own_axis(&self) -> Option<&AxisModel>;
    /// Returns whether the tool's growth is in what was measured.
    fn has_elongation(&self) -> bool;
    /// Returns the elongation by the source's own law, without terms, in µm.
    fn source_elongation_um(&self) -> &[f64];
    /// Returns the spread of what the machine file predicts, in µm; at least 0.
    fn predicted_peak_to_peak_um(&self) -> f64;
    /// Returns a column of the run by its name.
    fn column(&self, name: &str) -> Option<&[f64]>;
    /// Returns the names of the temperatures.
    fn temperature_columns(&self) -> Vec<&str>;
    /// Returns the names of the columns that this project does not know.
    fn unknown_columns(&self) -> Vec<&str>;
    /// Returns the position of the own axis.
    fn own_position_mm(&self) -> Option<&[f64]>;
    /// Returns whether the own axis was approached from both sides.
    fn is_bidirectional(&self) -> bool;
    /// Returns whether the model goes by this temperature already.
    fn is_column_in_use(&self, column: &str) -> bool;
    /// Returns whether the model has a cause of this name already.
    fn has_cause(&self, cause: &str) -> bool;
    /// Returns whether the model has added a cause of this name to what the machine file says.
    fn has_added_cause(&self, cause: &str) -> bool;
    /// Returns whether the model has an error of the reference instrument already.
    fn has_instrument_error(&self) -> bool;
    /// Returns whether the model has a zero of its own.
    fn has_constant(&self) -> bool;
    /// Returns the temperature that a term on `column` is counted from, in °C.
    fn reference_temperature_c(&self, column: &str) -> f64;
    /// Returns the time that a term in time is counted from, in s.
    fn time_origin_s(&self) -> f64;
    /// Returns the first and the last time of the record, in s; `None` without a clock.
    fn time_range_s(&self) -> Option<[f64; 2]>;
    /// Returns how many files there are.
    fn file_count(&self) -> usize;
    /// Returns how many groups of rows are fitted to.
    fn group_count(&self) -> usize;
    /// Returns the time of the first row of a group, in s.
    fn group_time_s(&self, group: usize) -> f64;
    /// This many time constants in equal ratios, from the spacing of the rows to what the longest
    /// series can show; none without a clock.
    fn time_constant_start_values(&self, count: usize) -> StartValues;
    /// Shifts in time that the record can show, in s, in equal ratios from the spacing of the rows; those
    /// below 0 too where the run has a second clock; none without a clock.
    fn time_shift_start_values(&self) -> StartValues;
    /// Returns how late a thermometer may be for the record to show it, in s, in equal ratios from the spacing of
    /// the rows; none without a clock.
    fn thermometer_lag_start_values(&self) -> StartValues;
    /// Returns the longest period that the travel can show, in mm.
    fn longest_period_mm(&self) -> f64;
    /// Returns the period of the strongest wave in what is left, if it turns so often over the whole length;
    /// at most `frequencies` are looked at.
    fn spectrum_peak_start_values(
        &self,
        over: SpectrumVariable<'_>,
        least_turns: f64,
        frequencies: usize,
    ) -> Option<StartValues>;
    /// C and P₀ of the strongest wave of C/(P + P₀).
    fn reciprocal_wave_start_values(&self, over: SpectrumVariable<'_>) -> Option<StartValues>;

    /// Returns what is believed of the own axis's growth.
    fn thermal_law(&self) -> Option<&ThermalLaw> {
        self.own_axis().and_then(|axis| axis.thermal.as_ref())
    }
}

impl dyn DataView + '_ {
    /// Where the tool's growth comes from, where it is in what was measured.
    #[must_use]
    pub(crate) fn elongation_source(&self) -> Option<ElongationSource> {
        if self.has_elongation() { self.spindle().source } else { None }
    }

    /// Returns whether the tool's growth is measured, or is in what was measured.
    #[must_use]
    pub(crate) fn includes_elongation(&self) -> bool {
        self.has_elongation() || self.quantity().axis().is_none()
    }

    /// Returns whether the own axis is moved by a screw that nothing looks after.
    #[must_use]
    pub(crate) fn has_screw_feedback(&self) -> bool {
        self.own_axis().is_some_and(|axis| axis.feedback == Feedback::Screw)
    }

    /// Returns whether a column is there and not always the same.
    #[must_use]
    pub fn is_varying(&self, column: &str) -> bool {
        self.column(column).is_some_and(|values| peak_to_peak(values) > 0.0)
    }

    /// Returns whether the own axis has moved.
    #[must_use]
    pub(crate) fn has_own_axis_moved(&self) -> bool {
        self.own_position_mm().is_some_and(|mm| peak_to_peak(mm) > 0.0)
    }

    /// Returns whether the own axis has a thermal law whose thermometer has moved.
    #[must_use]
    pub(crate) fn active_thermal_law(&self) -> Option<&ThermalLaw> {
        self.thermal_law().filter(|thermal| self.is_varying(&thermal.sensor))
    }

    /// Returns the lag that is believed between the thermometer and the growth by it, in s; `None` where no
    /// growth goes by a thermometer that has moved.
    #[must_use]
    pub(crate) fn modelled_lag_s(&self) -> Option<f64> {
        match (self.active_thermal_law(), self.elongation_source()) {
            (Some(thermal), _) => Some(thermal.lag_s),
            (None, Some(ElongationSource::Temperature)) => {
                Some(self.spindle().temperature.as_ref().map_or(0.0, |model| model.lag_s))
            }
            _ => None,
        }
    }

    /// Returns the columns of the positions of the other axes that have moved, for an axis's error.
    #[must_use]
    pub(crate) fn other_moving_axes(&self) -> Vec<LinearAxis> {
        let Some(own) = self.quantity().axis() else { return Vec::new() };
        let others = LinearAxis::ALL.into_iter();
        others.filter(|&axis| axis != own && self.is_varying(&axis.column_name())).collect()
    }
}

/// From the least to the largest of the numbers that are there; at least 0.
#[must_use]
pub fn peak_to_peak(values: &[f64]) -> f64 {
    let finite = values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if high > low { high - low } else { 0.0 }
}

/// Returns the places that the positions stand at, sorted, nearer ones than `share` of the travel as one.
pub(crate) fn find_distinct_values(values: &[f64], share: f64) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let least = share * peak_to_peak(values);
    let mut targets: Vec<(f64, f64)> = Vec::new();
    for value in sorted {
        match targets.last_mut() {
            Some((sum, count)) if value - *sum / *count <= least => {
                *sum += value;
                *count += 1.0;
            }
            _ => targets.push((value, 1.0)),
        }
    }
    targets.into_iter().map(|(sum, count)| sum / count).collect()
}

/// Returns the knots of a cubic spline with this many control points over these places.
pub(crate) fn uniform_knots(at: &[f64], controls: usize) -> Vec<f64> {
    let (low, high) = (at[0], at[at.len() - 1]);
    let spans = controls - 3;
    let mut knots = vec![low; 4];
    knots.extend((1..spans).map(|n| low + (high - low) * n as f64 / spans as f64));
    knots.extend([high; 4]);
    knots
}
