//! A run, and an effect on it whose size is not known yet.

use super::cause::Hidden;
use trueup_twin::table::RunTable;

/// A run, and what is believed of each of its rows.
#[derive(Clone, Debug)]
pub(super) struct Run {
    pub table: RunTable,
    pub believed_um: Vec<f64>,
}

impl Run {
    pub(super) fn column(&self, name: &str) -> &[f64] {
        self.table.column(name).unwrap_or_default()
    }
}

/// An effect before its size is known: what it does to each row of each run, and how its parameters
/// follow from its size.
pub(super) struct Shape {
    pub cause: Hidden,
    pub column: Option<String>,
    /// One list a run, the hold-out last.
    pub um: Vec<Vec<f64>>,
    /// Whether the effect goes with a factor; else it is as large as it is, and the noise follows.
    pub is_linear: bool,
    /// Whether the factor may be negative.
    pub has_sign: bool,
    /// Parameters and tables at a factor.
    pub at: Box<dyn Fn(f64) -> Named>,
    /// Other causes, each with a column over the training rows: what it does, but for a factor and a
    /// constant.
    pub imitators: Vec<(Hidden, Vec<f64>)>,
}

/// Parameters and lists by name.
#[derive(Clone, Debug, Default)]
pub(super) struct Named {
    pub parameters: Vec<(&'static str, f64)>,
    pub tables: Vec<(&'static str, Vec<f64>)>,
}

impl Named {
    pub(super) fn of(parameters: &[(&'static str, f64)]) -> Self {
        Self { parameters: parameters.to_vec(), tables: Vec::new() }
    }
}

/// Returns a law that is linear in its one parameter, which has a sign.
pub(super) fn linear(cause: Hidden, parameter: &'static str, um: Vec<Vec<f64>>) -> Shape {
    Shape {
        cause,
        column: None,
        um,
        is_linear: true,
        has_sign: true,
        at: Box::new(move |factor| Named::of(&[(parameter, factor)])),
        imitators: Vec::new(),
    }
}

/// Returns an effect whose parameters are drawn, and whose size follows.
pub(super) fn fixed(
    cause: Hidden,
    parameters: Vec<(&'static str, f64)>,
    um: Vec<Vec<f64>>,
) -> Shape {
    Shape {
        at: Box::new(move |_| Named::of(&parameters)),
        is_linear: false,
        has_sign: false,
        ..linear(cause, "", um)
    }
}

/// `law` on each run.
pub(super) fn on_each(runs: &[Run], law: impl Fn(&Run) -> Vec<f64>) -> Vec<Vec<f64>> {
    runs.iter().map(law).collect()
}
