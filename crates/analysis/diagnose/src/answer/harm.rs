//! Check that the written terms do not make the rows worse that they were fitted to.

use trueup_numerics::blocks::rms;

use crate::{answer::errors::about_zero, fit::Problem, model::Model};

/// Returns whether the rows that were fitted are left worse.
pub(super) fn is_worse(on: &Problem, model: &Model) -> bool {
    /// They are never left worse than this times what the machine file as it is leaves.
    const NEVER_WORSE: f64 = 1.01;
    let left = |model: &Model| {
        let um = on.residual(model);
        [rms(&um), rms(&about_zero(&on.data, um))]
    };
    let [before, after] = [&Model::default(), model].map(left);
    after.iter().zip(before).any(|(after, before)| *after > NEVER_WORSE * before)
}
