//! Check that the written terms do not make the rows worse that they were fitted to.

use trueup_numerics::blocks::rms;

use crate::{answer::errors::about_zero, fit::Problem, model::Model, search::state::RELEVANT};

/// Returns whether the rows that were fitted are left worse than the machine file as it is leaves them, by more than is
/// worth a term.
pub(super) fn is_worse(on: &Problem, model: &Model) -> bool {
    let left = |model: &Model| {
        let um = on.residual(model);
        [rms(&um), rms(&about_zero(&on.data, um))]
    };
    let [before, after] = [&Model::default(), model].map(left);
    after.iter().zip(before).any(|(after, before)| *after > (1.0 + RELEVANT) * before)
}
