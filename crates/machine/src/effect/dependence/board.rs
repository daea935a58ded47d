//! Levels on a board: where the tool or a switch is the category, and the board knows the factor.

use trueup_core::dimensions::MAX_TOOLS;

use super::values::SWITCH;
use crate::{
    effect::page::{OnBoard, Times},
    tool::TOOL_COLUMN,
};

/// Returns the board's form of levels over a column; `of` gives a level with what is added there.
pub(super) fn by_category(
    column: &str,
    times: &Times,
    levels: &[f64],
    of: impl Fn(f64) -> (f64, f64),
    [otherwise, lag_s]: [f64; 2],
) -> Option<OnBoard> {
    if times.column().is_some() {
        return None;
    }
    let times = times.clone();
    if column == TOOL_COLUMN {
        // A label has its number as well, or `compile` refuses it.
        let is_number = |level: &&f64| (0.0..=65535.0).contains(*level) && level.fract() == 0.0;
        let numbers = levels.iter().filter(is_number).map(|level| of(*level));
        let tools: Vec<(u16, f64)> = numbers.map(|(level, a)| (level as u16, a)).collect();
        let fits = !tools.is_empty() && tools.len() <= MAX_TOOLS;
        return fits.then_some(OnBoard::Tool { tools, other: otherwise, times });
    }
    levels.iter().all(|level| SWITCH.contains(level)).then(|| OnBoard::Condition {
        column: column.into(),
        off: of(0.0).1,
        on: of(1.0).1,
        lag_s,
        times,
    })
}

/// Levels as the board has them.
pub(super) struct Levels {
    pub(super) column: String,
    pub(super) levels: Vec<f64>,
    pub(super) added: Vec<f64>,
    pub(super) otherwise: f64,
    pub(super) lag_s: f64,
    pub(super) times: Times,
}

/// Returns the levels of a board's form, if it has some.
pub(super) fn levels_of(form: &OnBoard) -> Option<Levels> {
    Some(match form.clone() {
        OnBoard::Tool { tools, other, times } => {
            let (levels, added) = tools.into_iter().map(|(n, a)| (f64::from(n), a)).unzip();
            let column = TOOL_COLUMN.into();
            Levels { column, levels, added, otherwise: other, lag_s: 0.0, times }
        }
        OnBoard::Condition { column, off, on, lag_s, times } => {
            let (levels, added) = (SWITCH.to_vec(), vec![off, on]);
            Levels { column, levels, added, otherwise: 0.0, lag_s, times }
        }
        _ => return None,
    })
}
