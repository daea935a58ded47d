//! The terms that the machine file has already: parts of the model that a diagnosis begins with.

use trueup_machine::{
    Machine,
    effect::{Effect, PredictionStage},
    machine_file::{Quantity, Term},
};

/// A term of the machine file that is in what was measured.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StatedTerm {
    /// Its number in the file, from 0.
    pub index: usize,
    /// Whether it changes the elongation; else the axis.
    pub is_of_elongation: bool,
    /// With the values that the file says.
    pub effect: Effect,
}

impl StatedTerm {
    /// Returns the terms of the machine file that change `quantity`, in the order of the file.
    pub(super) fn from_machine(machine: &Machine, quantity: Quantity) -> Vec<Self> {
        let own = |(index, term): (usize, &Term)| {
            let effect = term.effect.clone();
            // What says nothing of the machine predicts nothing.
            let predicts = effect.parameter_count() > 0 && !effect.is_instrument_error();
            let is_of_elongation = term.quantity == Quantity::Elongation;
            (predicts && affects_quantity(term, quantity)).then_some(Self {
                index,
                is_of_elongation,
                effect,
            })
        };
        machine.terms.iter().enumerate().filter_map(own).collect()
    }

    /// Returns what the constants of the terms add to the elongation and to the axis, in µm.
    pub(super) fn sum_constants_um(machine: &Machine, quantity: Quantity) -> [f64; 2] {
        let sum = |is_of_elongation: bool| {
            let terms = machine.terms.iter().filter(|term| affects_quantity(term, quantity));
            let own =
                terms.filter(|term| (term.quantity == Quantity::Elongation) == is_of_elongation);
            own.map(|term| term.constant_um).sum()
        };
        [sum(true), sum(false)]
    }
}

/// Returns whether a term changes `quantity`: its own, or by the elongation along the tool, whose shift in time
/// is its own.
fn affects_quantity(term: &Term, quantity: Quantity) -> bool {
    let is_of_elongation =
        term.quantity == Quantity::Elongation && term.effect.stage() != PredictionStage::Shift;
    term.quantity == quantity || is_of_elongation
}
