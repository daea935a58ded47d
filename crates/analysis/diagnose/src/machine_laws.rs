//! The machine's own laws with the constants that the parts of a model correct, in columns: what
//! `trueup predict` steps row by row.

use std::{borrow::Cow, sync::Arc};

use trueup_machine::{
    effect::{ModelConstants, ThermometerDelay},
    machine_file::{ElongationSource, Spindle, TemperatureModel, ThermalLaw},
    model::{WarmupState, thermal_error_um},
};

use crate::{
    data::{DataTable, RowPredictions, forward_fill},
    term_kind::{ModelPart, own_axis_thermal_law},
};

/// The machine's own laws; none where nothing is corrected.
#[derive(Debug, Default)]
pub(crate) struct MachineLaws {
    spindle: Option<Spindle>,
    spindle_falling_s: Option<f64>,
    spindle_late: Option<ThermometerDelay>,
    thermal: Option<ThermalLaw>,
    thermal_falling_s: Option<f64>,
    thermal_late: Option<ThermometerDelay>,
}

/// A growth that is a factor times a temperature.
pub(crate) struct ThermalGrowth<'l> {
    pub model: &'l TemperatureModel,
    /// How late its thermometer is, and the lags behind the part's temperature, in s.
    pub late: Option<ThermometerDelay>,
    pub lags_s: [f64; 2],
}

impl ThermalGrowth<'_> {
    /// Returns the temperature behind the lags, in each row.
    pub(crate) fn lagged_temperature_c(&self, data: &DataTable) -> Arc<Vec<f64>> {
        data.lagged_part_temperature(&self.model.sensor, self.late, self.lags_s)
    }
}

impl MachineLaws {
    /// Returns the laws of the machine file with what `parts` correct.
    pub(crate) fn with_corrections(data: &DataTable, parts: &[ModelPart]) -> Self {
        let mut laws = Self::default();
        for part in parts.iter().filter(|part| part.kind.is_constant_correction()) {
            let Some(cause) = part.cause() else { continue };
            let is_of_elongation = part.kind.affects_elongation(data);
            if let Some(late) = cause.thermometer_delay() {
                let own =
                    if is_of_elongation { &mut laws.spindle_late } else { &mut laws.thermal_late };
                *own = Some(late);
            }
            cause.correct_constants(&mut if is_of_elongation {
                let spindle =
                    laws.spindle.get_or_insert_with(|| data.setting.machine.spindle.clone());
                ModelConstants {
                    spindle: Some(spindle),
                    thermal: None,
                    falling_s: &mut laws.spindle_falling_s,
                }
            } else {
                laws.thermal = laws.thermal.take().or_else(|| own_axis_thermal_law(data).cloned());
                ModelConstants {
                    spindle: None,
                    thermal: laws.thermal.as_mut(),
                    falling_s: &mut laws.thermal_falling_s,
                }
            });
        }
        laws
    }

    /// Returns the laws of the machine file.
    fn from_machine(data: &DataTable) -> Self {
        let spindle = &data.setting.machine.spindle;
        let is_thermal = spindle.source == Some(ElongationSource::Temperature);
        Self {
            spindle: is_thermal.then(|| spindle.clone()),
            thermal: own_axis_thermal_law(data).cloned(),
            ..Self::default()
        }
    }

    /// Returns the columns of their thermometers.
    fn thermometer_columns(&self) -> impl Iterator<Item = &str> {
        let of_spindle = self.spindle.as_ref().and_then(|spindle| spindle.temperature.as_ref());
        let columns = [
            self.thermal.as_ref().map(|thermal| &thermal.sensor),
            of_spindle.map(|thermal| &thermal.sensor),
        ];
        columns.into_iter().flatten().map(String::as_str)
    }

    /// `data` as if the thermometers of the machine's own laws, and that of `column`, were smoothed over
    /// `width_s`, without being late.
    pub(crate) fn table_with_smooth_temperatures(
        data: &DataTable,
        column: Option<&str>,
        width_s: f64,
    ) -> DataTable {
        if let Some(whole) = &data.whole {
            let smooth = Self::table_with_smooth_temperatures(&whole.data, column, width_s);
            return data.with_parent_table(smooth);
        }
        let laws = Self::from_machine(data);
        let others = column.filter(|column| !laws.thermometer_columns().any(|own| own == *column));
        let mut changed = data.clone();
        laws.thermometer_columns()
            .chain(others)
            .for_each(|column| changed.smooth_temperature(column, width_s));
        if laws.thermometer_columns().next().is_some() {
            let axis: Arc<[f64]> = laws.axis_error_um(&changed).into();
            let law: Arc<[f64]> = laws.elongation_um(&changed).into();
            let before = &data.predicted;
            let moved = |um: &[f64], new: &[f64], old: &[f64]| {
                um.iter()
                    .zip(new.iter().zip(old))
                    .map(|(um, (new, old))| um + (new - old))
                    .collect()
            };
            changed.predicted = RowPredictions {
                thermal: moved(&before.thermal, &axis, &before.axis),
                elongation: moved(&before.elongation, &law, &before.law),
                along: before.along.clone(),
                axis,
                law,
            };
        }
        changed
    }

    /// Returns the law of the elongation, where it is corrected and the axis's is not, and it is a factor times a
    /// temperature.
    pub(crate) fn thermal_growth(&self, data: &DataTable) -> Option<ThermalGrowth<'_>> {
        let spindle = self.spindle.as_ref().filter(|_| self.thermal.is_none())?;
        self.spindle_growth(spindle, data)
    }

    fn spindle_growth<'l>(
        &self,
        spindle: &'l Spindle,
        data: &DataTable,
    ) -> Option<ThermalGrowth<'l>> {
        let is_thermal = spindle.source == Some(ElongationSource::Temperature);
        let model = spindle.temperature.as_ref().filter(|_| is_thermal)?;
        data.temperature_c(&model.sensor)?;
        let fall_s = self.spindle_falling_s.unwrap_or(model.lag_s);
        Some(ThermalGrowth { model, late: self.spindle_late, lags_s: [model.lag_s, fall_s] })
    }

    /// Returns the elongation of each row.
    pub(crate) fn elongation_um<'d>(&self, data: &'d DataTable) -> Cow<'d, [f64]> {
        let Some(spindle) = &self.spindle else { return Cow::Borrowed(&data.predicted.law) };
        if let Some(growth) = self.spindle_growth(spindle, data) {
            let ThermalGrowth { model, .. } = growth;
            let grown = |c: &f64| model.k_um_per_c * (c - model.reference_c);
            return growth.lagged_temperature_c(data).iter().map(grown).collect();
        }
        match (spindle.source, &spindle.warmup) {
            (Some(ElongationSource::Warmup), Some(model)) => {
                if let Some(whole) = &data.whole {
                    return whole.aggregate_values(&self.elongation_um(&whole.data)).into();
                }
                let Some(time_s) = data.time_s() else { return Cow::Borrowed(&data.predicted.law) };
                let rated_rpm = model.rated_rpm.unwrap_or(1.0);
                let mut state = WarmupState::default();
                let grown: Vec<f64> = (0..data.rows)
                    .map(|row| {
                        if data.places.restart[row] {
                            state = WarmupState::default();
                        }
                        let rpm = data.spindle_rpm().map_or(rated_rpm, |rpm| rpm[row]);
                        state.step(model, time_s[row], rpm)
                    })
                    .collect();
                forward_fill(&grown).into()
            }
            _ => Cow::Borrowed(&data.predicted.law),
        }
    }

    /// Returns the axis's error of each row.
    pub(crate) fn axis_error_um<'d>(&self, data: &'d DataTable) -> Cow<'d, [f64]> {
        let thermal = self.thermal.as_ref();
        let Some(thermal) = thermal.filter(|thermal| data.temperature_c(&thermal.sensor).is_some())
        else {
            return Cow::Borrowed(&data.predicted.axis);
        };
        let fall_s = self.thermal_falling_s.unwrap_or(thermal.lag_s);
        let lags_s = [thermal.lag_s, fall_s];
        let lagged = data.lagged_part_temperature(&thermal.sensor, self.thermal_late, lags_s);
        let position = data.own_position_mm();
        (0..data.rows)
            .map(|row| {
                let mm = position.map_or(f64::NAN, |mm| mm[row]);
                data.predicted.axis[row] - data.predicted.thermal[row]
                    + thermal_error_um(thermal, lagged[row], mm)
            })
            .collect()
    }
}
