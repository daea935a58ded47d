//! Which two causes may be hidden in one machine.

use super::Hidden;

/// Pairs that a diagnosis can distinguish from every single cause and from each other.
pub const PAIRS: &[(Hidden, Hidden)] = &[
    (Hidden::SensorGain, Hidden::SensorOffset),
    (Hidden::SensorGain, Hidden::SensorTemperatureDrift),
    (Hidden::SensorGain, Hidden::CuttingLoad),
    (Hidden::SensorGain, Hidden::ExtraHeatPath),
    (Hidden::SensorCurvature, Hidden::CentrifugalGrowth),
    (Hidden::ThermalLag, Hidden::CentrifugalGrowth),
    (Hidden::ThermalLag, Hidden::ExtraHeatPath),
    (Hidden::GrowthAmplitude, Hidden::CuttingLoad),
    (Hidden::CentrifugalGrowth, Hidden::CuttingLoad),
    (Hidden::ExpansionSlope, Hidden::ThermalLag),
    (Hidden::PitchScale, Hidden::Backlash),
    (Hidden::PitchPeriodic, Hidden::Backlash),
    (Hidden::PitchScale, Hidden::PitchPeriodic),
    (Hidden::Backlash, Hidden::CrossAxis),
    (Hidden::CuttingLoad, Hidden::Outliers),
    (Hidden::Backlash, Hidden::Outliers),
];

/// Causes whose parameters are constants of one law of the spindle's growth: two of them at once are
/// a product, and the effects of a challenge are a sum.
const ONE_GROWTH: [Hidden; 5] = [
    Hidden::ThermalLag,
    Hidden::ThermometerLag,
    Hidden::CoolingAsymmetry,
    Hidden::GrowthRate,
    Hidden::GrowthAmplitude,
];

/// Likewise of the sensor's characteristic: where its range ends, nothing else of it shows.
const OF_THE_SIGNAL: [Hidden; 3] =
    [Hidden::SensorOffset, Hidden::SensorGain, Hidden::SensorCurvature];

/// The path along the axis that a cause needs of its own.
#[derive(PartialEq, Eq)]
enum Path {
    /// The same targets again and again, over hours.
    Targets,
    /// Positions anywhere in the travel.
    Anywhere,
    /// Small steps at a few stations.
    Stations,
}

fn path(cause: Hidden) -> Option<Path> {
    match cause {
        Hidden::PitchError | Hidden::AxisExpansion => Some(Path::Targets),
        Hidden::PitchPeriodic | Hidden::ReferenceInstrument => Some(Path::Anywhere),
        Hidden::PreSliding => Some(Path::Stations),
        _ => None,
    }
}

impl Hidden {
    /// Returns whether a challenge with both, the one next to the other, is one machine: they share a base, one
    /// path shows both, and their sum is what such a machine would do. Not so where
    ///
    /// - both are constants of one law (a lag and an amplitude of the same growth), whose joint effect
    ///   is a product;
    /// - one acts on all that is measured (a clock that is off, an instrument that errs over the
    ///   elongation that it reads), hence on the other as well;
    /// - one is of an axis across the path (straightness), the other a law along it.
    #[must_use]
    pub fn stands_beside(self, other: Self) -> bool {
        let has_name = |cause: Self| cause.name() == cause.answer();
        let shares_base = self.bases().iter().any(|base| other.bases().contains(base));
        // Its column is there for it alone, and any other cause goes with it: what one does says all. So it is with
        // what only the clock tells.
        if [self, other].iter().any(|it| [Self::Dependence, Self::PeriodicInTime].contains(it)) {
            return false;
        }
        if self == other || !shares_base || !has_name(self) || !has_name(other) {
            return false;
        }
        let either = |one: fn(Self) -> bool, another: &[Self]| {
            one(self) && another.contains(&other) || one(other) && another.contains(&self)
        };
        let is_one_law = ONE_GROWTH.contains(&self) && ONE_GROWTH.contains(&other)
            || either(|it| it == Self::SensorSaturation, &OF_THE_SIGNAL)
            || either(
                |it| it == Self::ReferenceTemperature,
                &[Self::ExpansionSlope, Self::ExpansionConstant],
            );
        let is_of_a_sensor = |cause: Self| cause.bases().contains(&super::Base::Sensor);
        let acts_on_all = self == Self::TimeShift
            || other == Self::TimeShift
            || self == Self::ReferenceInstrument && is_of_a_sensor(other)
            || other == Self::ReferenceInstrument && is_of_a_sensor(self);
        let across = [Self::Backlash, Self::Step, Self::Drift, Self::Outliers];
        let is_across = [self, other].contains(&Self::Straightness)
            && !either(|it| it == Self::Straightness, &across);
        let one_path = match (path(self), path(other)) {
            (Some(one), Some(another)) => one == another,
            _ => true,
        };
        !is_one_law && !acts_on_all && !is_across && one_path
    }
}
