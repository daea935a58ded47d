//! A dependence on a board: levels where the tool or a switch is the category and the board knows the factor, and the
//! difference of two temperatures.

use trueup_core::design_parameters::MAX_TOOLS;

use super::{Dependence, DependenceForm, column_values::SWITCH_LEVELS};
use crate::{
    effect::cause_spec::{BoardTerm, Multiplier, TemperatureResponse},
    keys::reader::is_temperature_column,
    tool_column::TOOL_COLUMN,
};

impl Dependence {
    /// Returns a at this value of the column.
    fn level_effect(&self, value: f64) -> f64 {
        let DependenceForm::Level { levels, added, otherwise, .. } = &self.form else { return 0.0 };
        let found = levels.iter().zip(added).find(|(level, _)| **level == value);
        found.map_or(*otherwise, |(_, added)| *added)
    }

    /// Returns what it is on a board, if a board runs it.
    pub(super) fn category_term(&self) -> Option<BoardTerm> {
        let DependenceForm::Level { levels, otherwise, .. } = &self.form else { return None };
        let of = |level: f64| (level, self.level_effect(level));
        build_category_term(&self.column, &self.times, levels, of, [*otherwise, self.lag_s])
    }

    /// Returns its heat: of two thermometers where it is their difference, of one or two where it depends on the position.
    pub(super) fn heat_terms(&self) -> Vec<BoardTerm> {
        /// The reference of the second thermometer, in °C; any would do.
        const REFERENCE_TEMPERATURE_C: f64 = 20.0;
        let DependenceForm::Line { slope, reference } = self.form else { return Vec::new() };
        let of = |column: &String, um_per_c: f64, reference_c: f64| {
            let (column, time_constant_s) = (column.clone(), self.lag_s);
            let heat = TemperatureResponse { column, um_per_c, time_constant_s, reference_c };
            if self.times == Multiplier::Position {
                BoardTerm::HeatSlope(heat)
            } else {
                BoardTerm::Heat(heat)
            }
        };
        match (&self.minus, &self.times) {
            (Some(minus), Multiplier::One | Multiplier::Position) => {
                let first = of(&self.column, slope, REFERENCE_TEMPERATURE_C + reference);
                vec![first, of(minus, -slope, REFERENCE_TEMPERATURE_C)]
            }
            (None, Multiplier::Position) if is_temperature_column(&self.column) => {
                vec![of(&self.column, slope, reference)]
            }
            _ => Vec::new(),
        }
    }

    /// Returns the dependence that a form of the board stands for, if it is one.
    pub(super) fn from_board_term(form: &BoardTerm) -> Option<Self> {
        Some(match form.clone() {
            BoardTerm::Tool { tools, other, times } => {
                let (levels, added) = tools.into_iter().map(|(n, a)| (f64::from(n), a)).unzip();
                let form = DependenceForm::Level { levels, added, otherwise: other };
                Self { form, times, ..Self::from_column(TOOL_COLUMN) }
            }
            BoardTerm::Condition { column, off, on, lag_s, times } => {
                let (levels, added) = (SWITCH_LEVELS.to_vec(), vec![off, on]);
                let form = DependenceForm::Level { levels, added, otherwise: 0.0 };
                Self { form, times, lag_s, ..Self::from_column(&column) }
            }
            BoardTerm::HeatSlope(heat) => {
                let form =
                    DependenceForm::Line { slope: heat.um_per_c, reference: heat.reference_c };
                let (times, lag_s) = (Multiplier::Position, heat.time_constant_s);
                Self { form, times, lag_s, ..Self::from_column(&heat.column) }
            }
            _ => return None,
        })
    }
}

/// Returns the board's form of levels over a column; `of` gives a level with what is added there.
fn build_category_term(
    column: &str,
    times: &Multiplier,
    levels: &[f64],
    of: impl Fn(f64) -> (f64, f64),
    [otherwise, lag_s]: [f64; 2],
) -> Option<BoardTerm> {
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
        return fits.then_some(BoardTerm::Tool { tools, other: otherwise, times });
    }
    levels.iter().all(|level| SWITCH_LEVELS.contains(level)).then(|| BoardTerm::Condition {
        column: column.into(),
        off: of(0.0).1,
        on: of(1.0).1,
        lag_s,
        times,
    })
}
