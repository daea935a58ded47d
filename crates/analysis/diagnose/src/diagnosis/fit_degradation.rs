//! Check that the written terms do not make the rows worse that they were fitted to.

use trueup_numerics::block_resampling::rms;

use crate::{
    diagnosis::residuals::remove_zero_offset, fit::FitProblem, model::Model,
    search::search_state::MIN_RELEVANT_RMS_FRACTION,
};

/// Returns whether the rows that were fitted are left worse than the current machine file leaves them, by more than is
/// worth a term.
pub(super) fn is_fit_degraded(on: &FitProblem, model: &Model) -> bool {
    let left = |model: &Model| {
        let um = on.residual(model);
        [rms(&um), rms(&remove_zero_offset(&on.data, um))]
    };
    let [before, after] = [&Model::default(), model].map(left);
    after
        .iter()
        .zip(before)
        .any(|(after, before)| *after > (1.0 + MIN_RELEVANT_RMS_FRACTION) * before)
}
