//! The factors that a dependence on a column is multiplied by.

use crate::{
    effect::{
        board_term::Multiplier,
        cause_spec::LawInput,
        data_view::{DataView, StartValues, peak_to_peak},
    },
    keys::{
        key::Key,
        reader::is_temperature_column,
        term::{
            FACTOR_PER_UNIT, LEVEL_FACTOR, LEVEL_UM, LEVEL_UM_PER_KRPM2, LEVEL_UM_PER_M,
            LEVEL_UM_PER_UNIT, UM_PER_UNIT, UM_PER_UNIT_PER_KRPM2, UM_PER_UNIT_PER_M,
            UM_PER_UNIT_PER_UNIT,
        },
    },
};

/// The column of the spindle's speed.
pub(in crate::effect) const SPEED_COLUMN: &str = "spindle_rpm";
/// The column of the cutting force.
pub(super) const LOAD_COLUMN: &str = "load_n";

impl Multiplier {
    pub(super) const ALL: [(&'static str, Self); 3] =
        [("speed2", Self::Speed2), ("growth", Self::Growth), ("position", Self::Position)];

    /// Its name in files; none of 1.
    #[must_use]
    pub fn name(&self) -> Option<&str> {
        match self {
            Self::Column { column, .. } => Some(column),
            _ => Self::ALL.iter().find(|(_, times)| times == self).map(|(name, _)| *name),
        }
    }

    /// Returns the second column, where there is one.
    #[must_use]
    pub fn column(&self) -> Option<&str> {
        if let Self::Column { column, .. } = self { Some(column) } else { None }
    }

    /// Returns what is read of a run for it.
    pub(super) fn input(&self) -> Option<LawInput<'_>> {
        match self {
            Self::One => None,
            Self::Speed2 => Some(LawInput::Speed),
            Self::Growth => Some(LawInput::Law),
            Self::Position => Some(LawInput::OwnPosition),
            Self::Column { column, .. } if column == LOAD_COLUMN => Some(LawInput::Load),
            Self::Column { column, .. } if is_temperature_column(column) => {
                Some(LawInput::Temperature { column, lag_s: 0.0 })
            }
            Self::Column { column, .. } => Some(LawInput::Column(column)),
        }
    }

    /// Lets the reference of a temperature be fitted, and returns values to begin from; none of other columns.
    pub(super) fn enable_reference_fit(&mut self, survey: &dyn DataView) -> Option<StartValues> {
        let Self::Column { column, range, .. } = self else { return None };
        let values = survey.column(column).filter(|_| is_temperature_column(column))?;
        let finite = values.iter().copied().filter(|value| value.is_finite());
        let low = finite.clone().fold(f64::INFINITY, f64::min);
        let width = peak_to_peak(values);
        *range = [low - width, low + 2.0 * width];
        Some(StartValues::from_values([
            low - 0.5 * width,
            low + 0.25 * width,
            low + 0.75 * width,
            low + 1.5 * width,
        ]))
    }

    /// Returns the range of its reference, where that is fitted.
    pub(super) fn fitted_reference_range(&self) -> Option<[f64; 2]> {
        match self {
            Self::Column { range, .. } if range[0] < range[1] => Some(*range),
            _ => None,
        }
    }

    /// Returns the keys of a slope and of the levels, which carry the unit.
    pub(super) fn keys(&self) -> [Key; 2] {
        match self {
            Self::One => [UM_PER_UNIT, LEVEL_UM],
            Self::Speed2 => [UM_PER_UNIT_PER_KRPM2, LEVEL_UM_PER_KRPM2],
            Self::Growth => [FACTOR_PER_UNIT, LEVEL_FACTOR],
            Self::Position => [UM_PER_UNIT_PER_M, LEVEL_UM_PER_M],
            Self::Column { .. } => [UM_PER_UNIT_PER_UNIT, LEVEL_UM_PER_UNIT],
        }
    }

    /// Returns the unit of what a level adds.
    pub(super) fn unit(&self) -> String {
        match self {
            Self::One => " µm".into(),
            Self::Speed2 => " µm per (1000 r/min)²".into(),
            Self::Growth => " times the growth".into(),
            Self::Position => " µm/m".into(),
            Self::Column { column, .. } => format!(" µm per unit of {column}"),
        }
    }
}
