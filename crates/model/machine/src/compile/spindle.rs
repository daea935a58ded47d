//! How the spindle grows: its source, and what the board falls back to.

use trueup_core::{
    calibration, displacement_sensor::SensorLaw, lag::SmoothingFactor,
    thermal::ThermalExpansionLaw, warmup,
};

use super::{
    curve::OwnedCurve,
    inputs::find_channel,
    lag,
    part_differences::PartDifferences,
    sensor,
    thermal::{self, ThermalLawSegments},
    warmup as warm_up,
};
use crate::{
    location::InputFileError,
    machine_file::{self, Machine},
    sections::Spindle,
};

/// The compiled models of the spindle.
pub(super) struct OwnedSpindle {
    sensor: SensorLaw,
    /// With the smoothing factors of its lag, rising and falling.
    temperature: Option<(ThermalLawSegments, [SmoothingFactor; 2])>,
    warmup: Option<(warmup::WarmupModel, OwnedCurve)>,
}

impl OwnedSpindle {
    pub(super) fn compile(
        machine: &Machine,
        falling_s: Option<f64>,
        account: &mut PartDifferences<'_>,
    ) -> Result<Self, InputFileError> {
        let spindle = &machine.spindle;
        let mut law = SensorLaw::default();
        if let Some(model) = machine.board_sensor_model() {
            let difference_nm;
            (law, difference_nm) = sensor::compile(machine, model)?;
            account.parts.push(("spindle.sensor".into(), difference_nm));
        }
        let temperature = spindle.temperature.as_ref().map(|model| {
            let key = "spindle.temperature";
            let law = thermal::compile_spindle_law(model.k_um_per_c, model.reference_c);
            let law = account.check_and_record_difference(key, law.map(|law| (law, 0.0)))?;
            let factors =
                lag::smoothing_factors(model.lag_s, falling_s).map(|factors| (factors, 0.0));
            Ok((law, account.check_and_record_difference(&format!("{key}.lag_s"), factors)?))
        });
        let warmup = spindle.warmup.as_ref().map(|model| {
            let made = warm_up::compile(model);
            account.check_and_record_difference("spindle.warmup", made.map(|made| (made, 0.0)))
        });
        Ok(Self { sensor: law, temperature: temperature.transpose()?, warmup: warmup.transpose()? })
    }

    /// Returns the source first, then what else is configured, the better first.
    pub(super) fn view(
        &self,
        machine: &Machine,
    ) -> Result<calibration::SpindleModel<'_>, InputFileError> {
        let spindle = &machine.spindle;
        let temperature = match (&self.temperature, &spindle.temperature) {
            (Some((law, [smoothing, smoothing_falling])), Some(model)) => {
                let law = ThermalExpansionLaw { pieces: law };
                match find_channel(machine, "spindle.temperature", &model.sensor) {
                    Ok(channel) => Some(calibration::SpindleTemperatureModel {
                        channel,
                        smoothing: *smoothing,
                        smoothing_falling: *smoothing_falling,
                        law,
                    }),
                    // A fall-back whose thermometer is not connected is none.
                    Err(_)
                        if spindle.source != Some(machine_file::ElongationSource::Temperature) =>
                    {
                        None
                    }
                    Err(error) => return Err(error),
                }
            }
            _ => None,
        };
        let warmup = self
            .warmup
            .as_ref()
            .map(|(law, power)| calibration::SpindleWarmupModel { law: *law, power: power.view() });
        let board = |source| match source {
            machine_file::ElongationSource::Sensor => calibration::ElongationSource::Sensor,
            machine_file::ElongationSource::Temperature => {
                calibration::ElongationSource::Temperature
            }
            machine_file::ElongationSource::Warmup => calibration::ElongationSource::Warmup,
        };
        let mut chain = [None; 3];
        if let Some(first) = spindle.source {
            let there = |source: &machine_file::ElongationSource| match source {
                machine_file::ElongationSource::Sensor => self.sensor != SensorLaw::default(),
                machine_file::ElongationSource::Temperature => temperature.is_some(),
                machine_file::ElongationSource::Warmup => warmup.is_some(),
            };
            let others = [
                machine_file::ElongationSource::Sensor,
                machine_file::ElongationSource::Temperature,
                machine_file::ElongationSource::Warmup,
            ]
            .into_iter();
            let others = others.filter(|&source| source != first).filter(there);
            for (place, source) in chain.iter_mut().zip([first].into_iter().chain(others)) {
                *place = Some(board(source));
            }
        }
        Ok(calibration::SpindleModel { chain, sensor: self.sensor, temperature, warmup })
    }
}

/// Returns whether a law of the sensor is there.
pub(super) fn has_sensor(spindle: &calibration::SpindleModel<'_>) -> bool {
    spindle.sensor != SensorLaw::default()
        || spindle.chain.contains(&Some(calibration::ElongationSource::Sensor))
}

/// Returns the spindle as a user writes it.
pub(super) fn decompile(spindle: &calibration::SpindleModel<'_>) -> Spindle {
    let source = |source: calibration::ElongationSource| match source {
        calibration::ElongationSource::Sensor => machine_file::ElongationSource::Sensor,
        calibration::ElongationSource::Temperature => machine_file::ElongationSource::Temperature,
        calibration::ElongationSource::Warmup => machine_file::ElongationSource::Warmup,
    };
    Spindle {
        source: spindle.chain[0].map(source),
        sensor: has_sensor(spindle).then(|| sensor::decompile(&spindle.sensor)),
        warmup: spindle.warmup.as_ref().map(warm_up::decompile),
        temperature: spindle.temperature.as_ref().map(thermal::decompile_spindle_temperature),
        // Among the terms until they are known.
        tools: None,
    }
}
