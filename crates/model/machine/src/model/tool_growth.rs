//! The growth with speed by tool, as a term.

use crate::{
    effect::{Dependence, DependenceForm, Effect, Multiplier, Quantity},
    machine_file::Term,
    sections::{ToolGrowth, ToolGrowthList},
    tool_column::{TOOL_COLUMN, label_code},
};

/// Returns the term that the list of `[spindle.tools]` is.
#[must_use]
pub(crate) fn tool_growth_term(list: &ToolGrowthList) -> Term {
    let levels = |tool: &ToolGrowth| {
        let code = tool.label.as_deref().map(label_code);
        let um = tool.um_per_krpm2;
        tool.number.map(f64::from).into_iter().chain(code).map(move |number| (number, um))
    };
    let (levels, added) = list.tools.iter().flat_map(levels).unzip();
    let form = DependenceForm::Level { levels, added, otherwise: list.default_um_per_krpm2 };
    let column = TOOL_COLUMN.into();
    let effect = Dependence { column, minus: None, lag_s: 0.0, form, times: Multiplier::Speed2 };
    Term { quantity: Quantity::Elongation, constant_um: 0.0, effect: Effect::Dependence(effect) }
}
