//! Whether the extended model holds on a hold-out, and what is handed out where it does not.
//!
//! A hold-out chooses nothing, with one exception: what makes it worse is not handed out. Then the
//! fewest terms leave whose removal mends it (the others as they are, or fitted again to the runs), and
//! the answer says that the hold-out has chosen.

use trueup_numerics::{block_resampling::rms, parallel::parallel_map};

use crate::{
    diagnosis::{
        compensated_model,
        final_model::without_causes,
        hold_out::HoldOut,
        hold_out_degradation::{describe_worst_interval, excess_squared_errors},
        validation_data::hold_out_residual_rms_um,
    },
    fit::{FitProblem, fit},
    model::Model,
    search::{initial_model, model_comparison::MAX_EQUIVALENT_RMS_RATIO},
    term_kind::TermKind,
};

/// Values within this factor are the same but for rounding.
const ROUNDING_TOLERANCE_FACTOR: f64 = 1.0 + 1e-9;

/// The result of a model on a hold-out.
pub(super) struct HoldOutEvaluation {
    /// The model that is handed out.
    pub model: Model,
    /// The causes of the terms that are not.
    pub dropped: Vec<TermKind>,
    /// Whether the model as it was found is not the machine's, and with it no name in it is claimed.
    pub is_disproved: bool,
    /// Errors on the hold-out with the current machine file, and with the model as it was found: RMS, in µm.
    pub before_um: f64,
    pub found_um: f64,
    /// Where it is worse, a sentence each; empty where no term is dropped.
    pub places: Vec<String>,
}

/// A model without the parts in `set`.
struct ReducedModel {
    /// On the hold-out.
    left_um: f64,
    set: u32,
    /// Whether the others were fitted again.
    is_refitted: bool,
    model: Model,
}

impl HoldOutEvaluation {
    /// Of `model`, found on `problem`.
    pub(super) fn new(problem: &FitProblem, model: Model, hold_out: &HoldOut<'_>) -> Self {
        let test = &hold_out.data;
        let believed = Model::default();
        let before_um = hold_out_residual_rms_um(test, &believed);
        // As it is, and as the board runs it.
        let left_um = |model: &Model| {
            hold_out_residual_rms_um(test, model)
                .max(hold_out_residual_rms_um(test, &compensated_model(model)))
        };
        let found_um = left_um(&model);
        if model.parts.is_empty() || found_um <= MAX_EQUIVALENT_RMS_RATIO * before_um {
            return Self {
                model,
                dropped: Vec::new(),
                is_disproved: false,
                before_um,
                found_um,
                places: Vec::new(),
            };
        }
        let count = model.parts.len();
        let runs_before_um = fit(problem, &initial_model(&problem.data), None).rms();
        let mended = (1..count).find_map(|size| {
            let sets: Vec<u32> =
                (1..1_u32 << count).filter(|set| set.count_ones() as usize == size).collect();
            let tried = parallel_map(&sets, problem.is_parallel_worthwhile(), |&set| {
                // What the others are worth may have been reported right next to a term that acted in the
                // runs alone, or wrong next to one that never was.
                let kept = without_causes(problem, &model, causes_in_set(&model, set));
                let fitted = fit(problem, &kept, None).model;
                [(kept, false), (fitted, true)].map(|(kept, is_refitted)| ReducedModel {
                    left_um: left_um(&kept),
                    set,
                    is_refitted,
                    model: kept,
                })
            });
            // Nor may the runs become worse by what remains.
            let mends = |model: &ReducedModel| {
                model.left_um <= MAX_EQUIVALENT_RMS_RATIO * before_um
                    && rms(&problem.residual(&model.model))
                        <= MAX_EQUIVALENT_RMS_RATIO * runs_before_um
            };
            let mended = tried.into_iter().flatten().filter(mends);
            mended.min_by(|a, b| a.left_um.total_cmp(&b.left_um))
        });
        // Without any term it is the current machine file.
        let ReducedModel { set, is_refitted, model: kept, .. } =
            mended.unwrap_or_else(|| ReducedModel {
                left_um: before_um,
                set: (1 << count) - 1,
                is_refitted: false,
                model: believed.clone(),
            });
        let dropped: Vec<TermKind> = causes_in_set(&model, set).cloned().collect();
        // What happened once in the runs is not expected to happen again; what is of the machine is.
        let is_disproved = is_refitted || dropped.iter().any(TermKind::is_compensable);
        let [before, after] = [&believed, &model].map(|model| model.predict(test));
        let places = describe_worst_interval(
            &problem.data,
            hold_out,
            &excess_squared_errors(test, [&before, &after], 1.0),
        );
        Self { model: kept, dropped, is_disproved, before_um, found_um, places }
    }

    /// Returns whether the hold-out is worse with the terms that are handed out, by however little.
    pub(super) fn worsens_hold_out(&self) -> bool {
        self.dropped.is_empty() && self.found_um > ROUNDING_TOLERANCE_FACTOR * self.before_um
    }
}

/// Returns the causes of the parts whose bits are in `set`.
fn causes_in_set(model: &Model, set: u32) -> impl Iterator<Item = &TermKind> {
    let parts = model.parts.iter().enumerate();
    parts.filter(move |(number, _)| set & (1 << number) != 0).map(|(_, part)| &part.kind)
}
