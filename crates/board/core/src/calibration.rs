//! The calibration: built once by the host from the user's machine file, and run by the board.
//!
//! Scalars are values; tables are slices of the blob that the board was given, read in place.

use crate::{
    cnc::LinearAxis,
    curve::Curve,
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    displacement_sensor::SensorLaw,
    gradient::Gradient,
    kinematics::Kinematics,
    lag::SmoothingFactor,
    limits::CompensationLimits,
    pitch_table::{GantryBeam, PitchErrorTable},
    reversal,
    term::Terms,
    thermal::ThermalExpansionLaw,
    thermometer::Thermometer,
    units::{FineNanometres, Position, Rpm, Temperature},
    volumetric_error::VolumetricErrorModel,
    warmup,
};

/// Everything that a tick needs to know about the machine; it never changes while the board runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Calibration<'a> {
    /// The thermometer on each temperature channel.
    pub thermometers: [Option<Thermometer>; TEMPERATURE_CHANNEL_COUNT],
    /// How the spindle grows.
    pub spindle: SpindleModel<'a>,
    /// From the spindle nose to the tool tip, and the axes that turn it.
    pub kinematics: Kinematics,
    /// The models of X, Y and Z alone.
    pub axes: [AxisModel<'a>; 3],
    /// Straightness, in the order of [`STRAIGHTNESS_AXIS_PAIRS`].
    pub straightness: [Curve<'a>; 6],
    /// Squareness, in the order of [`STRAIGHTNESS_AXIS_PAIRS`].
    pub squareness: [Gradient; 6],
    /// Angular and location errors, with the chain of the axes; `None` where none is known.
    pub volume: Option<VolumetricErrorModel<'a>>,
    /// The terms that a diagnosis has added; those that are there come first.
    pub terms: Terms<'a>,
    /// How far and how fast an offset may go, and how long silence is tolerated.
    pub limits: CompensationLimits,
    /// Thermometers that agree within this belong to a machine that has no heat of its own.
    pub cold_within: Temperature,
    /// The guards of the inputs and of the calibration.
    pub guards: InputSettings,
    /// The machine and the board that it is for.
    pub names: MachineIdentity<'a>,
}

/// The guards of a calibration's inputs and of the calibration itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InputSettings {
    /// How fast each temperature channel may change, in tenths of a kelvin a minute, up to
    /// [`MAX_RATE_DECIKELVIN_PER_MIN`](crate::temperature_rate::MAX_RATE_DECIKELVIN_PER_MIN). 0: by [`DEFAULT_RATE_DECIKELVIN_PER_MIN`](crate::temperature_rate::DEFAULT_RATE_DECIKELVIN_PER_MIN) where a law
    /// uses the channel, else not judged.
    pub max_rates: [u16; TEMPERATURE_CHANNEL_COUNT],
    /// Nothing is written to the board unless its service switch is closed.
    pub service_switch: bool,
    /// The hum that the temperature inputs suppress.
    pub mains: MainsFrequency,
}

/// The frequency of the mains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MainsFrequency {
    /// 50 Hz.
    #[default]
    Hz50,
    /// 60 Hz.
    Hz60,
}

/// The machine and the board that a calibration is for, as the user names them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MachineIdentity<'a> {
    /// The machine's name, in UTF-8; empty: none was given.
    pub machine: &'a [u8],
    /// The machine's serial number, in UTF-8; empty: none was given.
    pub serial: &'a [u8],
    /// The number of the board's chip, 96 bits, the lowest word first; 0: any board.
    pub board: [u32; 3],
}

/// The six pairs of axes: the error is along the first while the second moves.
pub const STRAIGHTNESS_AXIS_PAIRS: [(LinearAxis, LinearAxis); 6] = [
    (LinearAxis::X, LinearAxis::Y),
    (LinearAxis::X, LinearAxis::Z),
    (LinearAxis::Y, LinearAxis::X),
    (LinearAxis::Y, LinearAxis::Z),
    (LinearAxis::Z, LinearAxis::X),
    (LinearAxis::Z, LinearAxis::Y),
];

/// How the spindle grows: by up to three models, of which the first that has its input is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpindleModel<'a> {
    /// The models in the order in which they are asked.
    pub chain: [Option<ElongationSource>; 3],
    /// By the displacement sensor.
    pub sensor: SensorLaw,
    /// By a temperature.
    pub temperature: Option<SpindleTemperatureModel<'a>>,
    /// By running time.
    pub warmup: Option<SpindleWarmupModel<'a>>,
}

/// Where an elongation comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElongationSource {
    /// The displacement sensor.
    Sensor,
    /// A temperature.
    Temperature,
    /// Running time.
    Warmup,
}

impl ElongationSource {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Sensor, Self::Temperature, Self::Warmup];
}

/// Elongation by a temperature: k·(T − T₀), with a lag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpindleTemperatureModel<'a> {
    /// The channel of T, 0…7.
    pub channel: u8,
    /// α of the lag of T while it rises, per step of 100 ms.
    pub smoothing: SmoothingFactor,
    /// α while T falls.
    pub smoothing_falling: SmoothingFactor,
    /// Its K₀(T) is the elongation, in 1/256 nm.
    pub law: ThermalExpansionLaw<'a>,
}

impl SpindleTemperatureModel<'_> {
    /// Returns whether it lags, and so has to know what was before.
    #[must_use]
    pub fn has_lag(&self) -> bool {
        [self.smoothing, self.smoothing_falling] != [SmoothingFactor::NO_LAG; 2]
    }
}

/// The warm-up model, and what drives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpindleWarmupModel<'a> {
    /// The model: lag, largest growth, and how fast it heats and cools.
    pub law: warmup::WarmupModel,
    /// (n/n_rated)^p in Q28 over n in r/min; empty where every speed heats fully.
    pub power: Curve<'a>,
}

impl SpindleWarmupModel<'_> {
    /// Returns how hard the spindle heats at this speed, Q28. An unknown speed does not heat.
    #[must_use]
    pub fn relative_heat_input(&self, speed: Option<Rpm>) -> i32 {
        /// 1 in Q28.
        const ONE_Q28: i32 = 1 << 28;
        match speed {
            None | Some(Rpm(0)) => 0,
            Some(_) if self.power.is_empty() => ONE_Q28,
            Some(Rpm(rpm)) => self.power.evaluate(Position(i32::from(rpm))).0.0.max(1),
        }
    }
}

/// The models of one linear axis alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisModel<'a> {
    /// Its expansion.
    pub thermal: Option<AxisThermalModel<'a>>,
    /// The error of its screw or scale.
    pub pitch: Option<PitchErrorTable<'a>>,
    /// The second drive of a gantry.
    pub dual: Option<DualDrive<'a>>,
    /// Its backlash in 1/256 nm, −B of ISO 230-2: the error where it is approached in the negative direction.
    pub backlash: FineNanometres,
    /// How a reversal is distinguished from dither, and over which travel backlash comes in.
    pub travel: reversal::ReversalConfig,
    /// Its rapid traverse in 10 nm a millisecond: what it cannot have come to faster is a jump. 0: not judged.
    pub rapid: u32,
}

/// The expansion of an axis: ΔK = K₀(T) + tanβ(T)·(P − P₀).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisThermalModel<'a> {
    /// The channel of T, 0…7.
    pub channel: u8,
    /// α of the lag of T while it rises, per step of 100 ms.
    pub smoothing: SmoothingFactor,
    /// α while T falls.
    pub smoothing_falling: SmoothingFactor,
    /// P₀, the position at which tanβ adds nothing, in 10 nm.
    pub origin: Position,
    /// K₀(T) in 1/256 nm and tanβ(T) in Q36 nm per 10 nm.
    pub law: ThermalExpansionLaw<'a>,
}

/// The second drive of an axis that is driven at both ends of a beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DualDrive<'a> {
    /// The axis along the beam.
    pub across: LinearAxis,
    /// Where along the beam the two drives are.
    pub beam: GantryBeam,
    /// The second drive's own table.
    pub pitch: PitchErrorTable<'a>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{curve::CurveSegment, units::FineNanometres};

    #[test]
    fn a_spindle_heats_by_its_speed_and_one_that_stands_or_is_not_known_does_not() {
        const ONE_Q28: i32 = 1 << 28;
        // A quarter of full up to 1000 r/min, less than nothing from there to 2000, full beyond.
        let segments = [(1_000, ONE_Q28 / 4), (2_000, -ONE_Q28), (3_000, ONE_Q28)]
            .map(|(end, drive)| CurveSegment::new(Position(end), 16, [drive, 0, 0, 0]).to_bytes());
        let power = Curve::new(Position(0), &segments, &[[0, 0]], 16);
        let law = warmup::WarmupModel {
            lag_ms: 0,
            max: FineNanometres(1),
            smoothing_heating: SmoothingFactor::NO_LAG,
            smoothing_cooling: SmoothingFactor::NO_LAG,
            full: 0,
        };
        let by_speed = SpindleWarmupModel { law, power };
        let fully = SpindleWarmupModel { power: Curve::default(), ..by_speed };
        for (rpm, drive) in
            [(1, ONE_Q28 / 4), (1_000, ONE_Q28 / 4), (3_000, ONE_Q28), (60_000, ONE_Q28)]
        {
            let apart = by_speed.relative_heat_input(Some(Rpm(rpm))).abs_diff(drive);
            assert!(apart <= 8, "{rpm} r/min: {apart} places of a curve");
            assert_eq!(fully.relative_heat_input(Some(Rpm(rpm))), ONE_Q28, "{rpm} r/min");
        }
        assert_eq!(
            by_speed.relative_heat_input(Some(Rpm(1_500))),
            1,
            "it turns, which is not to stand"
        );
        for warmup in [by_speed, fully] {
            assert_eq!(
                [warmup.relative_heat_input(None), warmup.relative_heat_input(Some(Rpm(0)))],
                [0, 0]
            );
        }
    }

    #[test]
    fn a_temperature_that_lags_either_way_has_a_memory() {
        let lag = SmoothingFactor(1 << 30);
        let law = SpindleTemperatureModel {
            channel: 0,
            smoothing: SmoothingFactor::NO_LAG,
            smoothing_falling: SmoothingFactor::NO_LAG,
            law: ThermalExpansionLaw { pieces: &[] },
        };
        assert!(!law.has_lag());
        assert!(SpindleTemperatureModel { smoothing: lag, ..law }.has_lag());
        assert!(SpindleTemperatureModel { smoothing_falling: lag, ..law }.has_lag());
    }
}
