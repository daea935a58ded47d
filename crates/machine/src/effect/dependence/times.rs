//! What a dependence on a column is multiplied by.

use crate::{
    effect::{forms::Times, page::Input},
    file::is_temperature_column,
};

/// The column of the cutting force.
pub(super) const LOAD: &str = "load_n";

impl Times {
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

    /// The second column, where there is one.
    #[must_use]
    pub fn column(&self) -> Option<&str> {
        if let Self::Column { column, .. } = self { Some(column) } else { None }
    }

    /// What is read of a run for it.
    pub(super) fn input(&self) -> Option<Input<'_>> {
        match self {
            Self::One => None,
            Self::Speed2 => Some(Input::Speed),
            Self::Growth => Some(Input::Law),
            Self::Position => Some(Input::OwnPosition),
            Self::Column { column, .. } if column == LOAD => Some(Input::Load),
            Self::Column { column, .. } if is_temperature_column(column) => {
                Some(Input::Temperature { column, lag_s: 0.0 })
            }
            Self::Column { column, .. } => Some(Input::Column(column)),
        }
    }

    /// The keys of a slope and of the levels, which carry the unit.
    pub(super) fn keys(&self) -> [&'static str; 2] {
        match self {
            Self::One => ["um_per_unit", "level_um"],
            Self::Speed2 => ["um_per_unit_per_krpm2", "level_um_per_krpm2"],
            Self::Growth => ["factor_per_unit", "level_factor"],
            Self::Position => ["um_per_unit_per_m", "level_um_per_m"],
            Self::Column { .. } => ["um_per_unit_per_unit", "level_um_per_unit"],
        }
    }

    /// The unit of what a level adds.
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
