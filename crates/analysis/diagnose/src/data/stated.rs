//! The terms that the machine file has already: parts of the model that a diagnosis begins with.

use trueup_machine::{
    Machine,
    effect::{Effect, Stage},
    file::{Quantity, Term},
};

/// A term of the machine file that is in what was measured.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Stated {
    /// Its number in the file, from 0.
    pub index: usize,
    /// Whether it changes the elongation; else the axis.
    pub is_of_elongation: bool,
    /// With the values that the file says.
    pub effect: Effect,
}

impl Stated {
    /// Returns the terms of the machine file that change `quantity`, in the order of the file.
    pub(super) fn all(machine: &Machine, quantity: Quantity) -> Vec<Self> {
        let own = |(index, term): (usize, &Term)| {
            let effect = term.effect.clone();
            // What says nothing of the machine predicts nothing.
            let predicts = effect.degrees() > 0 && !effect.is_of_instrument();
            let is_of_elongation = term.quantity == Quantity::Elongation;
            (predicts && is_part(term, quantity)).then_some(Self {
                index,
                is_of_elongation,
                effect,
            })
        };
        machine.terms.iter().enumerate().filter_map(own).collect()
    }

    /// Returns what the constants of the terms add to the elongation and to the axis, in µm.
    pub(super) fn constants_um(machine: &Machine, quantity: Quantity) -> [f64; 2] {
        let sum = |is_of_elongation: bool| {
            let terms = machine.terms.iter().filter(|term| is_part(term, quantity));
            let own =
                terms.filter(|term| (term.quantity == Quantity::Elongation) == is_of_elongation);
            own.map(|term| term.constant_um).sum()
        };
        [sum(true), sum(false)]
    }
}

/// Returns whether a term changes `quantity`: its own, or by the elongation along the tool, whose shift in time
/// is its own.
fn is_part(term: &Term, quantity: Quantity) -> bool {
    let is_of_elongation =
        term.quantity == Quantity::Elongation && term.effect.stage() != Stage::Shift;
    term.quantity == quantity || is_of_elongation
}
