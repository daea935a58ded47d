//! From fitted parts to the terms of a machine file.

use trueup_machine::machine_file::{Quantity, Term};

use crate::{data::DataTable, model::Model, term_kind::ModelPart};

/// A reference that is a temperature, in °C: what a part may have. Beyond, the zero is a constant of the term.
const MIN_REFERENCE_TEMPERATURE_C: f64 = -40.0;
const MAX_REFERENCE_TEMPERATURE_C: f64 = 150.0;

/// The terms by which a machine file is extended.
#[derive(Clone, Debug, Default)]
pub(crate) struct ExtensionTerms {
    /// In the place of the file's terms of these numbers, from 0.
    pub replaced: Vec<(usize, Term)>,
    /// Next to them.
    pub new: Vec<Term>,
}

impl ExtensionTerms {
    /// By the terms of `model`.
    pub(crate) fn from_model(data: &DataTable, model: &Model) -> Self {
        let mut extended = Self::default();
        let parts = model.parts.iter().filter(|part| part.cause().is_some());
        for (ModelPart { kind, .. }, term) in parts.zip(terms_from_model(data, model)) {
            match kind.as_stated_term() {
                Some(stated) => extended.replaced.push((stated.index, term)),
                None => extended.new.push(term),
            }
        }
        extended
    }
}

/// Returns the terms of `model`, in its order. Where the zero of the measurement goes: into the reference
/// temperature of the first term that has one, else to the last term.
pub(crate) fn terms_from_model(data: &DataTable, model: &Model) -> Vec<Term> {
    let mut terms: Vec<Term> = model
        .parts
        .iter()
        .filter_map(|part| {
            let is_of_elongation = part.kind.affects_elongation(data);
            let quantity =
                if is_of_elongation { Quantity::Elongation } else { data.setting.quantity };
            let of_values_um = part.kind.cause()?.constant_um(&part.values);
            // What the file has keeps its constant.
            let of_file_um = part
                .kind
                .as_stated_term()
                .map_or(0.0, |stated| data.setting.machine.terms[stated.index].constant_um);
            let constant_um = of_values_um + of_file_um;
            Some(Term { quantity, constant_um, effect: part.cause()? })
        })
        .collect();
    let Some(mut constant_um) = model.constant_um.filter(|constant| *constant != 0.0) else {
        return terms;
    };
    let along = |quantity: Quantity| {
        if quantity == data.setting.quantity {
            return 1.0;
        }
        // The tool stands still where this is asked: its direction is that of any row.
        data.predicted.along.iter().copied().find(|along| *along != 0.0).unwrap_or(1.0)
    };
    for term in &mut terms {
        let factor = along(term.quantity);
        if let Some(heat) = term.effect.temperature_response_mut() {
            let reference_c = heat.reference_c - constant_um / (heat.um_per_c * factor);
            if (MIN_REFERENCE_TEMPERATURE_C..=MAX_REFERENCE_TEMPERATURE_C).contains(&reference_c) {
                heat.reference_c = reference_c;
                constant_um = 0.0;
                break;
            }
        }
    }
    // On a term that the board runs, where there is one: else it would lose the zero.
    let is_own = |term: &Term| term.quantity == data.setting.quantity;
    let on_board = |term: &Term| is_own(term) && term.effect.is_compensable();
    let own = terms.iter().rposition(on_board).or_else(|| terms.iter().rposition(is_own));
    let last = own.or_else(|| terms.len().checked_sub(1));
    if let (Some(last), true) = (last, constant_um != 0.0) {
        let term = &mut terms[last];
        term.constant_um += constant_um / along(term.quantity);
    }
    terms
}
