//! The bounds of the nonlinear values of a fit, from the extent of a record: what is faster, slower, longer or later cannot
//! be distinguished from noise, from a curve, or from another cause.

use trueup_machine::effect::{MIN_CYCLES, MIN_READINGS_PER_PERIOD};
use trueup_numerics::block_resampling::MIN_CORRELATION_TIMES_PER_BLOCK;

use crate::{
    data::{DataTable, KnownColumn, RowGroups},
    model::Model,
};

/// Bounds of the nonlinear values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ParameterBounds {
    /// Time constants, in s.
    pub time_constant_s: [f64; 2],
    /// The longest series, in s.
    pub longest_s: f64,
    /// Times of the record, in s.
    pub time_s: [f64; 2],
    /// From row to row, in s; above 0.
    pub step_s: f64,
    /// Shifts of the prediction, in s: at most a tenth of the longest series, below 0 only where the
    /// run has a second clock, or the machine file such a shift.
    pub shift_s: [f64; 2],
    /// How late a thermometer may be, in s: from the spacing of the rows, which shows less of it, to a
    /// tenth of the longest series.
    pub late_s: [f64; 2],
    /// How far the quantity's own axis went, in mm; above 0.
    pub travel_mm: f64,
    /// Periods, in mm.
    pub period_mm: [f64; 2],
    /// Periods, in s.
    pub period_s: [f64; 2],
    /// The model's prediction, in µm.
    pub prediction_um: [f64; 2],
}

/// The latest that a thermometer on a machine is, in s. A sheathed one in still air has shown nine tenths of a
/// change within ten minutes (IEC 60751: 2.3 time constants of 260 s), and as much again where it sits on
/// another body than it stands for; what is later than a quarter of an hour is another part's temperature.
const MAX_THERMOMETER_LAG_S: f64 = 900.0;

/// The share of the longest series by which the prediction, or a thermometer, may be late. Rows shifted out of a record
/// cannot be compared any more: nine tenths of it still are.
const MAX_TIME_SHIFT_FRACTION: f64 = 0.1;
/// The longest, in records: of one that is longer less than a third is in the record.
const MAX_TIME_CONSTANT_TO_RECORD_RATIO: f64 = 3.0;
/// The longest period, in travels: a wave that turns less than one and a half times is a curve.
const MAX_PERIOD_TO_TRAVEL_RATIO: f64 = 0.7;

/// Returns the bounds of a fit to the `groups` of `data`.
pub(super) fn compute_parameter_bounds(data: &DataTable, groups: &RowGroups) -> ParameterBounds {
    let extent = |values: &mut dyn Iterator<Item = f64>| {
        values
            .filter(|value| value.is_finite())
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
                [low.min(value), high.max(value)]
            })
    };
    let finite =
        |[low, high]: [f64; 2], none: [f64; 2]| if low < high { [low, high] } else { none };
    let time_s = data
        .time_s()
        .map_or([0.0, 1.0], |times| finite(extent(&mut times.iter().copied()), [0.0, 1.0]));
    // The longest of the series: what is slower than that is not seen.
    let longest_s = data.time_s().map_or(1.0, |times| {
        let mut longest: f64 = 0.0;
        let mut start = 0;
        for row in 1..=data.rows {
            if row == data.rows || data.places.restart[row] {
                let range = extent(&mut times[start..row].iter().copied());
                longest = longest.max(range[1] - range[0]);
                start = row;
            }
        }
        if longest > 0.0 { longest } else { 1.0 }
    });
    let step_s =
        longest_s * data.setting.files.len() as f64 / (data.recorded_row_count() as f64).max(2.0);
    // Of a shorter one less than a hundredth is left after a row.
    let fastest_s = (step_s / MIN_CORRELATION_TIMES_PER_BLOCK).max(data.min_resolved_lag_s());
    let own = data.own_position_mm();
    let range = own.map_or([0.0, 1.0], |mm| finite(extent(&mut mm.iter().copied()), [0.0, 1.0]));
    let prediction = Model::default().predict(data);
    let prediction_um = finite(extent(&mut prediction.iter().copied()), [0.0, 1.0]);
    ParameterBounds {
        time_constant_s: [fastest_s, MAX_TIME_CONSTANT_TO_RECORD_RATIO * longest_s],
        longest_s,
        time_s,
        step_s,
        late_s: [fastest_s, (MAX_TIME_SHIFT_FRACTION * longest_s).min(MAX_THERMOMETER_LAG_S)],
        shift_s: {
            let states_early =
                data.setting.stated.iter().any(|stated| stated.effect.time_shift_s() < 0.0);
            let has_early = data.columns[KnownColumn::GaugeTime].is_some() || states_early;
            let most_s = MAX_TIME_SHIFT_FRACTION * longest_s;
            [if has_early { -most_s } else { 0.0 }, most_s]
        },
        travel_mm: range[1] - range[0],
        period_mm: [
            (range[1] - range[0]) / groups.len().max(2) as f64,
            MAX_PERIOD_TO_TRAVEL_RATIO * (range[1] - range[0]),
        ],
        period_s: [
            MIN_READINGS_PER_PERIOD * longest_s / groups.len().max(2) as f64,
            longest_s / MIN_CYCLES,
        ],
        prediction_um,
    }
}
