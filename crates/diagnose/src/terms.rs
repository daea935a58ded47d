//! From fitted parts to the terms of a machine file.

use trueup_machine::machine_file::{Quantity, Term};

use crate::{data::Data, model::Model};

/// The terms of `model`, in the order in which they are to be applied. Where the zero of the
/// measurement goes: into the reference temperature of the first term that has one, else to the
/// last term.
pub(crate) fn terms(data: &Data, model: &Model) -> Vec<Term> {
    let mut terms: Vec<Term> = model
        .parts
        .iter()
        .filter_map(|part| {
            let is_of_elongation = part.kind.is_of_elongation(data);
            let quantity = if is_of_elongation { Quantity::Elongation } else { data.quantity };
            let constant_um = part.kind.cause()?.constant_um(&part.values);
            Some(Term { quantity, constant_um, effect: part.cause()? })
        })
        .collect();
    let Some(mut constant_um) = model.constant_um.filter(|constant| *constant != 0.0) else {
        return terms;
    };
    let along = |quantity: Quantity| {
        if quantity == data.quantity {
            return 1.0;
        }
        // The tool stands still where this is asked: its direction is that of any row.
        data.along.iter().copied().find(|along| *along != 0.0).unwrap_or(1.0)
    };
    for term in &mut terms {
        let factor = along(term.quantity);
        if let Some(heat) = term.effect.heat_mut() {
            let shift_c = constant_um / (heat.um_per_c * factor);
            if shift_c.abs() < 1000.0 {
                heat.reference_c -= shift_c;
                constant_um = 0.0;
                break;
            }
        }
    }
    let own = terms.iter().rposition(|term| term.quantity == data.quantity);
    let last = own.or_else(|| terms.len().checked_sub(1));
    if let (Some(last), true) = (last, constant_um != 0.0) {
        let term = &mut terms[last];
        term.constant_um += constant_um / along(term.quantity);
    }
    terms
}
