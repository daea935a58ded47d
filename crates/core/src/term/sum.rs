//! What the terms together make of the elongation, and what they add to the errors of the axes.

use crate::{
    fixed::product,
    place::Place,
    term::{
        effect::{Effect, Target, Terms},
        states::TermStates,
    },
    units::{Fine, Rpm},
};

/// What the CNC says of the spindle: the inputs of the terms over speed and load.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatingPoint {
    /// n in r/min, without a sign; `None` if nobody knows, which counts as 0.
    pub speed: Option<Rpm>,
    /// F, the axial cutting force in 1/256 N (Q8): ±65 536 N; positive pushes the tool back.
    pub load: i32,
}

/// The elongation with its terms, each applied to what those before it have made.
#[must_use]
pub fn elongation(
    terms: &Terms<'_>,
    plain: Fine,
    states: &TermStates,
    operating: OperatingPoint,
) -> Fine {
    let mut p = plain;
    for (index, term) in terms.iter().enumerate() {
        let Some(term) = term else { break };
        if term.target == Target::Elongation {
            p = match &term.effect {
                Effect::Gain(m) => p.plus(Fine(m.times(i64::from(p.0)))),
                Effect::Curvature(m) => {
                    let held = p.0.clamp(-(1 << 28), 1 << 28);
                    p.plus(Fine(m.times(product(held, held) >> 24)))
                }
                Effect::Saturation(limit) => p.min(*limit),
                Effect::Heat { .. } | Effect::SpeedHeat { .. } | Effect::Time { .. } => {
                    p.plus(states.value(index))
                }
                Effect::Speed(m) => {
                    let rpm = i64::from(operating.speed.unwrap_or_default().0);
                    p.plus(Fine(m.times(rpm.wrapping_mul(rpm))))
                }
                Effect::Load(m) => p.plus(Fine(m.times(i64::from(operating.load)))),
                effect @ (Effect::Tool(_) | Effect::Condition(_)) => {
                    p.plus(states.category(index, effect, plain.0.into()))
                }
                _ => p,
            }
            .plus(term.constant);
        }
    }
    p
}

/// What the terms of the axes add, and whether a position is outside a table.
#[must_use]
pub fn axis_errors(terms: &Terms<'_>, states: &TermStates, place: &Place) -> ([Fine; 3], bool) {
    let (mut errors, mut outside) = ([Fine::ZERO; 3], false);
    for (index, term) in terms.iter().enumerate() {
        let Some(term) = term else { break };
        let Target::Axis(own) = term.target else { continue };
        let Some(error) = errors.get_mut(own as usize) else { continue };
        let (part, beyond) = match &term.effect {
            effect @ (Effect::Tool(_) | Effect::Condition(_)) => {
                (states.category(index, effect, place.of(own).0.into()), false)
            }
            effect => effect.at(own, states.value(index), place),
        };
        *error = error.plus(part).plus(term.constant);
        outside |= beyond;
    }
    (errors, outside)
}
