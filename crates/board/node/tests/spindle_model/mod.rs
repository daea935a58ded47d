//! A spindle with all three sources of its growth, as the boards of the tests know it.

use trueup_core::{
    calibration::{ElongationSource, SpindleModel, SpindleTemperatureModel, SpindleWarmupModel},
    displacement_sensor::{SensorLaw, SensorSlope},
    lag::SmoothingFactor,
    thermal::{ThermalExpansionLaw, ThermalLawSegment},
    units::{FineNanometres, Nanometres, SensorReading, Temperature},
    warmup::WarmupModel,
};

/// Its parameters: the sensor first, then a thermometer, then its running time.
pub struct KnownSpindle {
    /// The sensor reads this many codes without growth, and one more for this many nanometres.
    pub zero_code: f64,
    pub nm_per_code: f64,
    /// The thermometer's channel, its law in nanometres per kelvin above 20 °C, and its lag.
    pub channel: u8,
    pub nm_per_kelvin: f64,
    pub lag: SmoothingFactor,
    /// Growth when warm through, in nanometres, and time constant in seconds.
    pub growth_nm: f64,
    pub tau_s: f64,
}

impl KnownSpindle {
    pub fn model(&self) -> SpindleModel<'static> {
        let sources =
            [ElongationSource::Sensor, ElongationSource::Temperature, ElongationSource::Warmup];
        let heating = per_step(self.tau_s);
        SpindleModel {
            chain: sources.map(Some),
            sensor: SensorLaw {
                k0: Nanometres(0),
                zero: SensorReading((self.zero_code * 1024.0) as i32),
                slope: SensorSlope((self.nm_per_code / 1024.0 * 2_f64.powi(28)).round() as i32),
            },
            temperature: Some(SpindleTemperatureModel {
                channel: self.channel,
                smoothing: self.lag,
                smoothing_falling: self.lag,
                law: law(self.nm_per_kelvin),
            }),
            warmup: Some(SpindleWarmupModel {
                law: WarmupModel {
                    lag_ms: 0,
                    max: FineNanometres((self.growth_nm * 256.0) as i32),
                    smoothing_heating: heating,
                    smoothing_cooling: heating,
                    full: 1 << WarmupModel::FULL_FRACTION_BITS,
                },
                power: Default::default(),
            }),
        }
    }
}

/// Returns a lag of this many seconds, stepped every 100 ms.
pub fn per_step(tau_s: f64) -> SmoothingFactor {
    SmoothingFactor((-(-0.1 / tau_s).exp_m1() * 2_f64.powi(32)).round() as u32)
}

/// K₀(T) that rises by this much a kelvin from 20 °C.
pub fn law(nm_per_kelvin: f64) -> ThermalExpansionLaw<'static> {
    // 1/16 of 1/256 nm by 1.024 K.
    let slope = nm_per_kelvin * 256.0 * 1.024 * 16.0;
    let start = Temperature(20 * Temperature::PER_KELVIN);
    let piece = ThermalLawSegment {
        start,
        constant_slope: slope.round() as i32,
        ..ThermalLawSegment::default()
    };
    ThermalExpansionLaw { pieces: Box::leak(Box::new([piece.to_bytes()])) }
}
