//! The effect of all terms together on the elongation and on the errors of the axes.

use crate::{
    fixed_point::widening_mul,
    machine_position::MachinePosition,
    term::{
        effect::{Effect, Target, Term, Terms},
        term_states::TermStates,
    },
    units::{FineNanometres, Rpm},
};

/// Speed and load of the spindle by the CNC: the inputs of the terms over speed and load.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatingPoint {
    /// n in r/min, without a sign; `None`: not known, which counts as 0.
    pub speed: Option<Rpm>,
    /// F, the axial cutting force in 1/256 N (Q8): ±65 536 N; positive pushes the tool back.
    pub load: i32,
}

/// Returns the elongation with its terms, each applied to what those before it have made; those by category come last,
/// of which `states` knows all. So `terms` need not be more than those that a tick has to [walk](crate::term::elongation_term_prefix_length)
/// through.
#[must_use]
#[inline]
pub fn apply_elongation_terms(
    terms: &[Option<Term<'_>>],
    plain: FineNanometres,
    states: &TermStates,
    operating: OperatingPoint,
) -> FineNanometres {
    let made = if terms.is_empty() {
        plain
    } else {
        apply_terms_in_order(terms, plain, states, operating)
    };
    states.apply_category_terms(plain, made)
}

#[inline(never)]
fn apply_terms_in_order(
    terms: &[Option<Term<'_>>],
    plain: FineNanometres,
    states: &TermStates,
    operating: OperatingPoint,
) -> FineNanometres {
    let mut p = plain;
    for (index, term) in terms.iter().enumerate() {
        let Some(term) = term else { break };
        let is_category = matches!(term.effect, Effect::Tool(_) | Effect::Condition(_));
        if term.target == Target::Elongation && !is_category {
            p = match &term.effect {
                Effect::Gain(m) => p.saturating_add(FineNanometres(m.multiply(i64::from(p.0)))),
                Effect::Curvature(m) => {
                    let held = p.0.clamp(-(1 << 28), 1 << 28);
                    p.saturating_add(FineNanometres(m.multiply(widening_mul(held, held) >> 24)))
                }
                Effect::Saturation(limit) => p.min(*limit),
                Effect::Heat { .. } | Effect::SpeedHeat { .. } | Effect::Time { .. } => {
                    p.saturating_add(states.thermal_effect(index))
                }
                Effect::Speed(m) => {
                    let rpm = i64::from(operating.speed.unwrap_or_default().0);
                    p.saturating_add(FineNanometres(m.multiply(rpm.wrapping_mul(rpm))))
                }
                Effect::Load(m) => {
                    p.saturating_add(FineNanometres(m.multiply(i64::from(operating.load))))
                }
                _ => p,
            }
            .saturating_add(term.constant);
        }
    }
    p
}

/// Returns what the terms of the axes add, and whether a position is outside a table.
#[must_use]
pub fn compute_axis_errors(
    terms: &Terms<'_>,
    states: &TermStates,
    place: &MachinePosition,
) -> ([FineNanometres; 3], bool) {
    let (mut errors, mut outside) = ([FineNanometres::ZERO; 3], false);
    for (index, term) in terms.iter().enumerate() {
        let Some(term) = term else { break };
        let Target::Axis(own) = term.target else { continue };
        let Some(error) = errors.get_mut(own as usize) else { continue };
        let (part, beyond) = match &term.effect {
            effect @ (Effect::Tool(_) | Effect::Condition(_)) => {
                (states.category_effect(index, effect, place.axis_position(own).0.into()), false)
            }
            effect => effect.error_at(own, states.thermal_effect(index), place),
        };
        *error = error.saturating_add(part).saturating_add(term.constant);
        outside |= beyond;
    }
    (errors, outside)
}
