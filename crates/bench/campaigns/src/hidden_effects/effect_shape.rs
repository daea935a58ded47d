//! A run, and an effect on it whose size is not known yet.

use super::cause::HiddenCause;
use trueup_twin::run_table::RunTable;

/// A run, and what is believed of each of its rows.
#[derive(Clone, Debug)]
pub(super) struct PredictedRun {
    pub table: RunTable,
    pub believed_um: Vec<f64>,
}

impl PredictedRun {
    pub(super) fn column(&self, name: &str) -> &[f64] {
        self.table.column(name).unwrap_or_default()
    }
}

/// An effect before its size is known: what it does to each row of each run, and how its parameters
/// follow from its size.
pub(super) struct EffectShape {
    pub cause: HiddenCause,
    pub column: Option<String>,
    /// One list a run, the hold-out last.
    pub um: Vec<Vec<f64>>,
    /// Whether the effect is proportional to a factor; else its size is fixed, and the noise follows.
    pub is_linear: bool,
    /// Whether the factor may be negative.
    pub has_sign: bool,
    /// Parameters and tables at a factor.
    pub at: Box<dyn Fn(f64) -> NamedParameters>,
    /// Other causes, each with a column over the training rows: what it does, but for a factor and a
    /// constant.
    pub imitators: Vec<(HiddenCause, Vec<f64>)>,
}

/// Parameters and lists by name.
#[derive(Clone, Debug, Default)]
pub(super) struct NamedParameters {
    pub parameters: Vec<(&'static str, f64)>,
    pub tables: Vec<(&'static str, Vec<f64>)>,
}

impl NamedParameters {
    pub(super) fn from_parameters(parameters: &[(&'static str, f64)]) -> Self {
        Self { parameters: parameters.to_vec(), tables: Vec::new() }
    }
}

/// Returns a law that is linear in its one parameter, which has a sign.
pub(super) fn linear_effect(
    cause: HiddenCause,
    parameter: &'static str,
    um: Vec<Vec<f64>>,
) -> EffectShape {
    EffectShape {
        cause,
        column: None,
        um,
        is_linear: true,
        has_sign: true,
        at: Box::new(move |factor| NamedParameters::from_parameters(&[(parameter, factor)])),
        imitators: Vec::new(),
    }
}

/// Returns an effect whose parameters are drawn, and whose size follows.
pub(super) fn fixed_parameter_effect(
    cause: HiddenCause,
    parameters: Vec<(&'static str, f64)>,
    um: Vec<Vec<f64>>,
) -> EffectShape {
    EffectShape {
        at: Box::new(move |_| NamedParameters::from_parameters(&parameters)),
        is_linear: false,
        has_sign: false,
        ..linear_effect(cause, "", um)
    }
}

/// `law` on each run.
pub(super) fn map_runs(
    runs: &[PredictedRun],
    law: impl Fn(&PredictedRun) -> Vec<f64>,
) -> Vec<Vec<f64>> {
    runs.iter().map(law).collect()
}
