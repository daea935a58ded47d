//! Check that the written terms do not make the rows worse that they were fitted to.

use trueup_numerics::blocks::rms;

use crate::{
    diagnosis::errors::remove_zero_offset, fit::FitProblem, model::Model,
    search::state::MIN_RELEVANT_RMS_SHARE,
};

/// Returns whether the rows that were fitted are left worse than the current machine file leaves them, by more than is
/// worth a term.
pub(super) fn is_fit_degraded(on: &FitProblem, model: &Model) -> bool {
    let left = |model: &Model| {
        let um = on.residual(model);
        [rms(&um), rms(&remove_zero_offset(&on.data, um))]
    };
    let [before, after] = [&Model::default(), model].map(left);
    after.iter().zip(before).any(|(after, before)| *after > (1.0 + MIN_RELEVANT_RMS_SHARE) * before)
}
