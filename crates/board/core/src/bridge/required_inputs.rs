//! The inputs without which a calibration cannot be followed.

use super::CONDITIONS_TIMEOUT_FACTOR;
use crate::{
    calibration::{Calibration, ElongationSource, STRAIGHTNESS_AXIS_PAIRS},
    cnc::LinearAxis,
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    index_set::IndexSet,
    temperature_rate::{DEFAULT_RATE_DECIKELVIN_PER_MIN, TemperatureRateLimit},
    term::{self, CategoryFactor, Effect, Target, Tilt, category_factor},
    units::FineNanometres,
};

/// The required inputs, found out once and not in every tick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RequiredInputs {
    /// How old the position of an axis may be, in milliseconds; for ever where nothing depends on
    /// it.
    pub position_ms: [u32; 3],
    /// The angles of the rotary axes.
    pub rotary: bool,
    /// The errors of the axes change with them, not the tool direction alone.
    pub volume_angles: bool,
    /// Channels of the axes; that of the spindle is one source among others.
    pub temperatures: IndexSet,
    /// Every channel that something depends on, in use or not.
    pub watched: IndexSet,
    /// How fast each channel may change.
    pub rates: [TemperatureRateLimit; TEMPERATURE_CHANNEL_COUNT],
    /// Axes with a law over temperature.
    pub laws: IndexSet,
    /// Whether the sensor is one of the sources of the elongation.
    pub sensor: bool,
    /// The spindle's speed and load, from the CNC.
    pub operating_point: bool,
    /// The tool and the conditions, from the CNC.
    pub conditions: bool,
    /// How old they may be, in milliseconds.
    pub conditions_ms: u32,
    /// The terms by category that go by the speed.
    pub category_speed: bool,
    /// Terms that follow a temperature.
    pub heat_terms: IndexSet,
    /// Whether there are terms of the elongation.
    pub terms: bool,
    /// How many terms a tick has to walk through for it.
    pub walked_terms: usize,
    /// The source of the elongation that is asked first.
    pub first: Option<ElongationSource>,
}

impl RequiredInputs {
    pub fn from_calibration(calibration: &Calibration<'_>) -> Self {
        let chain = calibration.spindle.chain;
        let terms = || calibration.terms.iter().flatten();
        let of_elongation = terms().any(|term| term.target == Target::Elongation);
        let by_speed =
            terms().any(|term| category_factor(&term.effect) == Some(CategoryFactor::Speed2));
        let volume_angles =
            calibration.volume.is_some_and(|volume| volume.depends_on_rotary_angles());
        let turns_growth = calibration.kinematics.axes.iter().any(Option::is_some)
            && (of_elongation || chain.iter().any(Option::is_some));
        let mut needs = Self {
            rotary: turns_growth || volume_angles,
            volume_angles,
            conditions_ms: calibration
                .limits
                .link_timeout_ms
                .saturating_mul(CONDITIONS_TIMEOUT_FACTOR),
            conditions: terms().any(|term| category_factor(&term.effect).is_some()),
            category_speed: by_speed,
            operating_point: by_speed
                || terms().any(|term| {
                    let effect = &term.effect;
                    matches!(effect, Effect::Speed(_) | Effect::SpeedHeat { .. } | Effect::Load(_))
                }),
            heat_terms: term::thermal_term_indices(&calibration.terms),
            terms: of_elongation,
            walked_terms: term::elongation_term_prefix_length(&calibration.terms),
            sensor: chain.contains(&Some(ElongationSource::Sensor)),
            position_ms: [u32::MAX; 3],
            first: chain.into_iter().flatten().next(),
            ..Self::default()
        };
        let mut position = |axis: LinearAxis| {
            if let Some(longest) = needs.position_ms.get_mut(axis as usize) {
                *longest = calibration.limits.link_timeout_ms;
            }
        };
        for (axis, name) in calibration.axes.iter().zip(LinearAxis::ALL) {
            let moves = axis.thermal.is_some_and(|thermal| thermal.law.depends_on_position());
            if moves
                || axis.pitch.is_some()
                || axis.dual.is_some()
                || axis.backlash != FineNanometres::ZERO
            {
                position(name);
            }
            if let Some(dual) = &axis.dual {
                position(dual.across);
            }
        }
        for (((_, over), curve), gradient) in STRAIGHTNESS_AXIS_PAIRS
            .into_iter()
            .zip(&calibration.straightness)
            .zip(&calibration.squareness)
        {
            if !curve.is_empty() || gradient.0 != 0 {
                position(over);
            }
        }
        if let Some(volume) = &calibration.volume {
            LinearAxis::ALL
                .into_iter()
                .filter(|axis| volume.depends_on_position(*axis))
                .for_each(&mut position);
        }
        for term in terms() {
            match (term.effect, term.target) {
                (Effect::Position { axis, .. } | Effect::Curve { axis, .. }, _)
                | (
                    Effect::Reversed { .. } | Effect::Table(_) | Effect::Wave { .. },
                    Target::Axis(axis),
                ) => position(axis),
                (Effect::TiltLine(Tilt { along, lever, .. }), _)
                | (Effect::TiltCurve(Tilt { along, lever, .. }), _) => {
                    position(along);
                    position(lever);
                }
                (effect, Target::Axis(axis))
                    if category_factor(&effect) == Some(CategoryFactor::Position) =>
                {
                    position(axis);
                }
                (Effect::Heat { channel, .. }, _) => needs.temperatures.insert(channel.into()),
                (Effect::HeatSlope { channel, .. }, target) => {
                    needs.temperatures.insert(channel.into());
                    if let Target::Axis(axis) = target {
                        position(axis);
                    }
                }
                _ => {}
            }
        }
        needs.add_temperature_channels(calibration);
        needs.rates =
            core::array::from_fn(|channel| needs.temperature_rate_limit(calibration, channel));
        needs
    }

    /// Adds the channels of the laws over temperature, those of the axes and that of the spindle.
    fn add_temperature_channels(&mut self, calibration: &Calibration<'_>) {
        if let Some(temperature) = &calibration.spindle.temperature
            && calibration.spindle.chain.contains(&Some(ElongationSource::Temperature))
        {
            self.watched.insert(temperature.channel.into());
        }
        for (number, axis) in calibration.axes.iter().enumerate() {
            if let Some(thermal) = &axis.thermal {
                self.temperatures.insert(thermal.channel.into());
                self.laws.insert(number);
            }
        }
        self.watched = self.watched.union(self.temperatures);
    }

    /// Returns how fast a channel may change.
    fn temperature_rate_limit(
        &self,
        calibration: &Calibration<'_>,
        channel: usize,
    ) -> TemperatureRateLimit {
        let stated = calibration.guards.max_rates.get(channel).copied().unwrap_or_default();
        let tenths = match stated {
            0 if self.watched.contains(channel) => DEFAULT_RATE_DECIKELVIN_PER_MIN,
            stated => stated,
        };
        let connected = calibration.thermometers.get(channel).copied().flatten();
        connected.map_or_else(TemperatureRateLimit::default, |thermometer| {
            TemperatureRateLimit::new(
                tenths,
                thermometer.resolution(),
                partner_channels(calibration, channel),
            )
        })
    }
}

/// Returns the other channels of the laws that use a channel: those of the same target.
fn partner_channels(calibration: &Calibration<'_>, channel: usize) -> IndexSet {
    let chain = calibration.spindle.chain;
    let spindle = calibration.spindle.temperature.as_ref();
    let spindle = spindle.filter(|_| chain.contains(&Some(ElongationSource::Temperature)));
    let laws = [
        (Target::Elongation, spindle.map(|law| law.channel)),
        (Target::Axis(LinearAxis::X), None),
        (Target::Axis(LinearAxis::Y), None),
        (Target::Axis(LinearAxis::Z), None),
    ];
    let mut partners = IndexSet::default();
    for (target, first) in laws {
        let axis = match target {
            Target::Axis(axis) => calibration.axes.get(axis as usize),
            Target::Elongation => None,
        };
        let of_axis = axis.and_then(|axis| axis.thermal.as_ref()).map(|law| law.channel);
        let of_terms = calibration.terms.iter().flatten().filter_map(|term| match term.effect {
            Effect::Heat { channel, .. } | Effect::HeatSlope { channel, .. }
                if term.target == target =>
            {
                Some(channel)
            }
            _ => None,
        });
        let mut all = IndexSet::default();
        first.into_iter().chain(of_axis).chain(of_terms).for_each(|input| all.insert(input.into()));
        if all.contains(channel) {
            partners = partners.union(all);
        }
    }
    partners.remove(channel);
    partners
}
