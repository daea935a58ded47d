//! Shared parts of the causes that follow a temperature, c·(lag_τ(T) − T_ref).

use super::{
    cause_spec::{LawInput, TemperatureResponse},
    data_view::DataView,
};
use crate::sections::ElongationSource;

pub(crate) fn temperature_inputs(heat: &TemperatureResponse, lag_s: f64) -> Vec<LawInput<'_>> {
    vec![LawInput::Temperature { column: &heat.column, lag_s }]
}

/// No heat of `column` yet. A time constant of 1 s says that it has one.
pub(crate) fn neutral(survey: &dyn DataView, column: &str, has_lag: bool) -> TemperatureResponse {
    TemperatureResponse {
        column: column.into(),
        um_per_c: 0.0,
        time_constant_s: if has_lag { 1.0 } else { 0.0 },
        reference_c: survey.reference_temperature_c(column),
    }
}

/// Returns the column of the sensor's own temperature, where the sensor is what is predicted by.
pub(crate) fn sensor_temperature_column(survey: &dyn DataView) -> Option<&str> {
    let sensor = survey.spindle().sensor.as_ref()?;
    sensor
        .temperature
        .as_deref()
        .filter(|_| survey.elongation_source() == Some(ElongationSource::Sensor))
}

/// Returns the temperatures that may move what is measured, and whether the model goes by them already.
/// Heat is looked for where something grows: in a spindle, or in an axis.
pub(crate) fn candidate_temperature_columns(survey: &dyn DataView) -> Vec<(&str, bool)> {
    let of_sensor = sensor_temperature_column(survey);
    let columns = survey.temperature_columns().into_iter();
    columns
        .filter(|column| survey.is_varying(column) && of_sensor != Some(column))
        .map(|column| (column, survey.is_column_in_use(column)))
        .collect()
}
