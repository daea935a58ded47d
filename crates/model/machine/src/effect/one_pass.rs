//! A record that goes along an axis once: the position only grows with the time, so that an error over the position and one
//! over the time are one question.

use super::{Drift, Effect, FileRepresentation as _, LawInput};
use crate::sections::LinearAxis;

impl Effect {
    /// Returns the cause that would look the same in a record that goes along each of the axes `passed` once: of one over
    /// their positions alone one over the time, and the other way round. `own`: the axis whose error it is.
    #[must_use]
    pub fn rival_in_one_pass(
        &self,
        own: Option<LinearAxis>,
        passed: &[LinearAxis],
    ) -> Option<&'static str> {
        let mut inputs = self.required_inputs();
        let is_of_position = !inputs.contains(&LawInput::Time) && !self.is_instrument_error();
        let drift = is_of_position.then_some(Drift::NAME);
        let rival = self.periodic_rival_in_one_pass().or(drift)?;
        let is_passed = |input: LawInput<'_>| match input {
            LawInput::Position(axis) => passed.contains(&axis),
            LawInput::OwnPosition | LawInput::Time => own.is_some_and(|own| passed.contains(&own)),
            _ => false,
        };
        // Both sides of each place follow each other: a drift does not look like their difference alone.
        inputs.retain(|input| *input != LawInput::OwnDirection);
        (!inputs.is_empty() && inputs.into_iter().all(is_passed)).then_some(rival)
    }
}
