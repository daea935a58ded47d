//! A dependence on a board: levels where the tool or a switch is the category and the board knows the factor, and the
//! difference of two temperatures.

use trueup_core::dimensions::MAX_TOOLS;

use super::{Dependence, Form, values::SWITCH};
use crate::{
    effect::cause_spec::{Heat, OnBoard, Times},
    tool::TOOL_COLUMN,
};

impl Dependence {
    /// Returns a at this value of the column.
    fn level(&self, value: f64) -> f64 {
        let Form::Level { levels, added, otherwise, .. } = &self.form else { return 0.0 };
        let found = levels.iter().zip(added).find(|(level, _)| **level == value);
        found.map_or(*otherwise, |(_, added)| *added)
    }

    /// Returns what it is on a board, if a board runs it.
    pub(super) fn by_category(&self) -> Option<OnBoard> {
        let Form::Level { levels, otherwise, .. } = &self.form else { return None };
        let of = |level: f64| (level, self.level(level));
        by_category(&self.column, &self.times, levels, of, [*otherwise, self.lag_s])
    }

    /// Returns its heat by two thermometers, where it is their difference.
    pub(super) fn of_two(&self) -> Option<[OnBoard; 2]> {
        /// The reference of the second thermometer, in °C; any would do.
        const REFERENCE_C: f64 = 20.0;
        let (Form::Line { slope, reference }, Some(minus), Times::One) =
            (&self.form, &self.minus, &self.times)
        else {
            return None;
        };
        let of = |column: &String, um_per_c: f64, reference_c: f64| {
            let column = column.clone();
            OnBoard::Heat(Heat { column, um_per_c, time_constant_s: self.lag_s, reference_c })
        };
        let first = of(&self.column, *slope, REFERENCE_C + reference);
        Some([first, of(minus, -slope, REFERENCE_C)])
    }
}

/// Returns the board's form of levels over a column; `of` gives a level with what is added there.
fn by_category(
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
