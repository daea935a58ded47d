//! The machine's own laws with the constants that the parts of a model correct, in columns: what
//! `trueup predict` steps row by row.

use std::{borrow::Cow, sync::Arc};

use trueup_machine::{
    effect::{Constants, Late},
    file::{ElongationSource, Spindle, TemperatureModel, Thermal, Warmup},
    model::{WarmupState, thermal_um},
};

use crate::{
    data::{Data, filled},
    kind::{Part, own_thermal},
};

/// The machine's own laws; none where nothing is corrected.
#[derive(Debug, Default)]
pub(crate) struct Laws {
    spindle: Option<Spindle>,
    spindle_falling_s: Option<f64>,
    spindle_late: Option<Late>,
    thermal: Option<Thermal>,
    thermal_falling_s: Option<f64>,
    thermal_late: Option<Late>,
}

/// A growth that is a factor times a temperature.
pub(crate) struct Growth<'l> {
    pub model: &'l TemperatureModel,
    /// How late its thermometer is, and the lags behind the part's temperature, in s.
    pub late: Option<Late>,
    pub lags_s: [f64; 2],
}

impl Growth<'_> {
    /// Returns the temperature behind the lags, in each row.
    pub(crate) fn behind_c(&self, data: &Data) -> Arc<Vec<f64>> {
        data.followed(&self.model.sensor, self.late, self.lags_s)
    }
}

impl Laws {
    /// Returns the laws of the machine file with what `parts` correct.
    pub(crate) fn corrected(data: &Data, parts: &[Part]) -> Self {
        let mut laws = Self::default();
        for part in parts.iter().filter(|part| part.kind.corrects()) {
            let Some(cause) = part.cause() else { continue };
            let is_of_elongation = part.kind.is_of_elongation(data);
            if let Some(late) = cause.late() {
                let own =
                    if is_of_elongation { &mut laws.spindle_late } else { &mut laws.thermal_late };
                *own = Some(late);
            }
            cause.correct(&mut if is_of_elongation {
                let spindle = laws.spindle.get_or_insert_with(|| data.machine.spindle.clone());
                Constants {
                    spindle: Some(spindle),
                    thermal: None,
                    falling_s: &mut laws.spindle_falling_s,
                }
            } else {
                laws.thermal = laws.thermal.take().or_else(|| own_thermal(data).cloned());
                Constants {
                    spindle: None,
                    thermal: laws.thermal.as_mut(),
                    falling_s: &mut laws.thermal_falling_s,
                }
            });
        }
        laws
    }

    /// Returns the laws of the machine file.
    fn own(data: &Data) -> Self {
        let spindle = &data.machine.spindle;
        let is_thermal = spindle.source == Some(ElongationSource::Temperature);
        Self {
            spindle: is_thermal.then(|| spindle.clone()),
            thermal: own_thermal(data).cloned(),
            ..Self::default()
        }
    }

    /// Returns the columns of their thermometers.
    fn columns(&self) -> impl Iterator<Item = &str> {
        let of_spindle = self.spindle.as_ref().and_then(|it| it.temperature.as_ref());
        let columns = [self.thermal.as_ref().map(|it| &it.sensor), of_spindle.map(|it| &it.sensor)];
        columns.into_iter().flatten().map(String::as_str)
    }

    /// `data` as if the thermometers of the machine's own laws, and that of `column`, were smoothed over
    /// `width_s`, without being late.
    pub(crate) fn smoothed(data: &Data, column: Option<&str>, width_s: f64) -> Data {
        let own = Self::own(data);
        let others = column.filter(|column| !own.columns().any(|own| own == *column));
        let columns: Vec<&str> = own.columns().chain(others).collect();
        Self::with_thermometers(data, &columns, &|data, column| data.smooth(column, width_s))
    }

    /// `data` as if a term's temperature of `column`, or (none) those of the machine's own laws, came behind a
    /// lag of `late_s`.
    pub(crate) fn behind(data: &Data, column: Option<&str>, late_s: f64) -> Data {
        let delay = |data: &mut Data, column: &str| data.delay(column, late_s);
        match (column, &data.whole) {
            (None, _) => {
                let own = Self::own(data);
                Self::with_thermometers(data, &own.columns().collect::<Vec<_>>(), &delay)
            }
            (Some(_), Some(whole)) => data.drawn_from(Self::behind(&whole.data, column, late_s)),
            (Some(column), None) => {
                let mut late = data.clone();
                delay(&mut late, column);
                late
            }
        }
    }

    /// `data` with the thermometers of `columns` changed, and the machine's own laws with them.
    fn with_thermometers(data: &Data, columns: &[&str], change: &dyn Fn(&mut Data, &str)) -> Data {
        if let Some(whole) = &data.whole {
            return data.drawn_from(Self::with_thermometers(&whole.data, columns, change));
        }
        let mut changed = data.clone();
        columns.iter().for_each(|column| change(&mut changed, column));
        let laws = Self::own(data);
        if laws.columns().any(|own| columns.contains(&own)) {
            let axis = laws.axis(&changed).into_owned();
            let law = laws.elongation(&changed).into_owned();
            for row in 0..data.rows {
                changed.thermal[row] += axis[row] - data.axis[row];
                changed.elongation[row] += law[row] - data.law[row];
            }
            (changed.axis, changed.law) = (axis, law);
        }
        changed
    }

    /// Returns the time constant with which the model's own heat rises.
    pub(crate) fn rise_s(&self, data: &Data) -> Option<f64> {
        let spindle = self.spindle.as_ref().unwrap_or(&data.machine.spindle);
        let rise_s = match (self.thermal.as_ref().or(own_thermal(data)), spindle.source) {
            (Some(thermal), _) => Some(thermal.lag_s),
            (None, Some(ElongationSource::Temperature)) => {
                spindle.temperature.as_ref().map(|it| it.lag_s)
            }
            (None, Some(ElongationSource::Warmup)) => {
                spindle.warmup.as_ref().map(Warmup::time_constant_s)
            }
            _ => None,
        };
        rise_s.filter(|rise_s| *rise_s > 0.0)
    }

    /// Returns the law of the elongation, where it is corrected and the axis's is not, and it is a factor times a
    /// temperature.
    pub(crate) fn growth(&self, data: &Data) -> Option<Growth<'_>> {
        let spindle = self.spindle.as_ref().filter(|_| self.thermal.is_none())?;
        self.growth_of(spindle, data)
    }

    fn growth_of<'l>(&self, spindle: &'l Spindle, data: &Data) -> Option<Growth<'l>> {
        let is_thermal = spindle.source == Some(ElongationSource::Temperature);
        let model = spindle.temperature.as_ref().filter(|_| is_thermal)?;
        data.temperature(&model.sensor)?;
        let fall_s = self.spindle_falling_s.unwrap_or(model.lag_s);
        Some(Growth { model, late: self.spindle_late, lags_s: [model.lag_s, fall_s] })
    }

    /// Returns the elongation of each row.
    pub(crate) fn elongation<'d>(&self, data: &'d Data) -> Cow<'d, [f64]> {
        let Some(spindle) = &self.spindle else { return Cow::Borrowed(&data.law) };
        if let Some(growth) = self.growth_of(spindle, data) {
            let Growth { model, .. } = growth;
            let grown = |c: &f64| model.k_um_per_c * (c - model.reference_c);
            return growth.behind_c(data).iter().map(grown).collect();
        }
        match (spindle.source, &spindle.warmup) {
            (Some(ElongationSource::Warmup), Some(model)) => {
                if let Some(whole) = &data.whole {
                    return whole.pick(&self.elongation(&whole.data)).into();
                }
                let Some(time_s) = data.time_s.as_deref() else { return Cow::Borrowed(&data.law) };
                let rated_rpm = model.rated_rpm.unwrap_or(1.0);
                let mut state = WarmupState::default();
                let grown: Vec<f64> = (0..data.rows)
                    .map(|row| {
                        if data.restart[row] {
                            state = WarmupState::default();
                        }
                        let rpm = data.spindle_rpm.as_ref().map_or(rated_rpm, |rpm| rpm[row]);
                        state.step(model, time_s[row], rpm)
                    })
                    .collect();
                filled(&grown).into()
            }
            _ => Cow::Borrowed(&data.law),
        }
    }

    /// Returns the axis's error of each row.
    pub(crate) fn axis<'d>(&self, data: &'d Data) -> Cow<'d, [f64]> {
        let thermal = self.thermal.as_ref();
        let Some(thermal) = thermal.filter(|it| data.temperature(&it.sensor).is_some()) else {
            return Cow::Borrowed(&data.axis);
        };
        let fall_s = self.thermal_falling_s.unwrap_or(thermal.lag_s);
        let lags_s = [thermal.lag_s, fall_s];
        let lagged = data.followed(&thermal.sensor, self.thermal_late, lags_s);
        let position = data.own_position();
        (0..data.rows)
            .map(|row| {
                let mm = position.map_or(f64::NAN, |mm| mm[row]);
                data.axis[row] - data.thermal[row] + thermal_um(thermal, lagged[row], mm)
            })
            .collect()
    }
}
