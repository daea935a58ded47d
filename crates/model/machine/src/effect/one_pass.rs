//! A record that goes along an axis once: the position only grows with the time, so that an error over the position and one
//! over the time are one question.

use super::{Drift, Effect, FileRepresentation as _, LawInput};
use crate::sections::LinearAxis;

impl Effect {
    /// Returns the cause that would look the same in a record that goes through each of the positions `passed` once, by
    /// column: of one over these alone one over the time, and the other way round. `own`: the axis whose error it is.
    #[must_use]
    pub fn rival_in_one_pass(
        &self,
        own: Option<LinearAxis>,
        passed: &[String],
    ) -> Option<&'static str> {
        let mut inputs = self.required_inputs();
        let is_of_position = !inputs.contains(&LawInput::Time) && !self.is_instrument_error();
        let drift = is_of_position.then_some(Drift::NAME);
        let rival = self.periodic_rival_in_one_pass().or(drift)?;
        let has = |axis: LinearAxis| passed.contains(&axis.column_name());
        let is_passed = |input: LawInput<'_>| match input {
            LawInput::Position(axis) => has(axis),
            LawInput::OwnPosition | LawInput::Time => own.is_some_and(has),
            LawInput::Column(column) => passed.iter().any(|name| name == column),
            _ => false,
        };
        // Both sides of each place follow each other: a drift does not look like their difference alone.
        inputs.retain(|input| *input != LawInput::OwnDirection);
        (!inputs.is_empty() && inputs.into_iter().all(is_passed)).then_some(rival)
    }
}
