//! Which two causes may be hidden in one machine.

use super::HiddenCause;

/// Pairs that a diagnosis can distinguish from every single cause and from each other.
pub const DISTINGUISHABLE_PAIRS: &[(HiddenCause, HiddenCause)] = &[
    (HiddenCause::SensorGain, HiddenCause::SensorOffset),
    (HiddenCause::SensorGain, HiddenCause::SensorTemperatureDrift),
    (HiddenCause::SensorGain, HiddenCause::CuttingLoad),
    (HiddenCause::SensorGain, HiddenCause::ExtraHeatPath),
    (HiddenCause::SensorCurvature, HiddenCause::CentrifugalGrowth),
    (HiddenCause::ThermalLag, HiddenCause::CentrifugalGrowth),
    (HiddenCause::ThermalLag, HiddenCause::ExtraHeatPath),
    (HiddenCause::GrowthAmplitude, HiddenCause::CuttingLoad),
    (HiddenCause::CentrifugalGrowth, HiddenCause::CuttingLoad),
    (HiddenCause::ExpansionSlope, HiddenCause::ThermalLag),
    (HiddenCause::PitchScale, HiddenCause::Backlash),
    (HiddenCause::PitchPeriodic, HiddenCause::Backlash),
    (HiddenCause::PitchScale, HiddenCause::PitchPeriodic),
    (HiddenCause::Backlash, HiddenCause::CrossAxis),
    (HiddenCause::CuttingLoad, HiddenCause::Outliers),
    (HiddenCause::Backlash, HiddenCause::Outliers),
];

/// Causes whose parameters are constants of one law of the spindle's growth: two of them at once are
/// a product, and the effects of a challenge are a sum.
const GROWTH_LAW_CAUSES: [HiddenCause; 5] = [
    HiddenCause::ThermalLag,
    HiddenCause::ThermometerLag,
    HiddenCause::CoolingAsymmetry,
    HiddenCause::GrowthRate,
    HiddenCause::GrowthAmplitude,
];

/// Likewise of the sensor's characteristic: where its range ends, nothing else of it shows.
const SENSOR_CHARACTERISTIC_CAUSES: [HiddenCause; 3] =
    [HiddenCause::SensorOffset, HiddenCause::SensorGain, HiddenCause::SensorCurvature];

/// The path along the axis that a cause needs of its own.
#[derive(PartialEq, Eq)]
enum RequiredPath {
    /// The same targets again and again, over hours.
    Targets,
    /// Positions anywhere in the travel.
    Anywhere,
    /// Small steps at a few stations.
    Stations,
}

fn required_path(cause: HiddenCause) -> Option<RequiredPath> {
    match cause {
        HiddenCause::PitchError | HiddenCause::AxisExpansion => Some(RequiredPath::Targets),
        HiddenCause::PitchPeriodic | HiddenCause::ReferenceInstrument => {
            Some(RequiredPath::Anywhere)
        }
        HiddenCause::PreSliding => Some(RequiredPath::Stations),
        _ => None,
    }
}

impl HiddenCause {
    /// Returns whether a challenge with both, the one next to the other, is one machine: they share a base, one
    /// path shows both, and their sum is what such a machine would do. Not so where
    ///
    /// - both are constants of one law (a lag and an amplitude of the same growth), whose joint effect
    ///   is a product;
    /// - one acts on all that is measured (a clock that is off, an instrument that errs over the
    ///   elongation that it reads), hence on the other as well;
    /// - one is of an axis across the path (straightness), the other a law along it.
    #[must_use]
    pub(crate) fn is_compatible_with(self, other: Self) -> bool {
        let has_name = |cause: Self| cause.name() == cause.expected_name();
        let shares_base = self.base_models().iter().any(|base| other.base_models().contains(base));
        // Its column is there for it alone, and any other cause is correlated with it: what one does says all. So it is with
        // what only the clock shows.
        if [self, other]
            .iter()
            .any(|cause| [Self::Dependence, Self::PeriodicInTime].contains(cause))
        {
            return false;
        }
        if self == other || !shares_base || !has_name(self) || !has_name(other) {
            return false;
        }
        let either = |one: fn(Self) -> bool, another: &[Self]| {
            one(self) && another.contains(&other) || one(other) && another.contains(&self)
        };
        let is_one_law = GROWTH_LAW_CAUSES.contains(&self) && GROWTH_LAW_CAUSES.contains(&other)
            || either(|cause| cause == Self::SensorSaturation, &SENSOR_CHARACTERISTIC_CAUSES)
            || either(
                |cause| cause == Self::ReferenceTemperature,
                &[Self::ExpansionSlope, Self::ExpansionConstant],
            );
        let is_of_a_sensor = |cause: Self| cause.base_models().contains(&super::BaseModel::Sensor);
        let acts_on_all = self == Self::TimeShift
            || other == Self::TimeShift
            || self == Self::ReferenceInstrument && is_of_a_sensor(other)
            || other == Self::ReferenceInstrument && is_of_a_sensor(self);
        let across = [Self::Backlash, Self::Step, Self::Drift, Self::Outliers];
        let is_across = [self, other].contains(&Self::Straightness)
            && !either(|cause| cause == Self::Straightness, &across);
        let one_path = match (required_path(self), required_path(other)) {
            (Some(one), Some(another)) => one == another,
            _ => true,
        };
        !is_one_law && !acts_on_all && !is_across && one_path
    }
}
