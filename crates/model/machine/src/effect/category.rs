//! How large a form by tool or condition is, and where.

use super::cause_spec::BoardTerm;

impl BoardTerm {
    /// Returns the largest a of a form by tool or condition, without its sign; 0 of all others.
    #[must_use]
    pub(crate) fn max_category_amplitude(&self) -> f64 {
        match self {
            Self::Tool { tools, other, .. } => {
                tools.iter().fold(other.abs(), |largest, (_, a)| largest.max(a.abs()))
            }
            Self::Condition { off, on, .. } => off.abs().max(on.abs()),
            _ => 0.0,
        }
    }

    /// Returns the value of the category at which a form by tool or condition does most.
    #[must_use]
    pub(crate) fn dominant_category(&self) -> Option<f64> {
        match self {
            Self::Tool { tools, .. } => {
                let largest = tools.iter().max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
                largest.map(|(number, _)| f64::from(*number))
            }
            Self::Condition { off, on, .. } => Some(if on.abs() >= off.abs() { 1.0 } else { 0.0 }),
            _ => None,
        }
    }
}
