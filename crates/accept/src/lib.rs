//! The acceptance of a compensation (S5–S7 of the warm-up paper): a run recorded without it and one with
//! it are compared; if not enough of the error is gone, it says which constant to change by how much.
//!
//! ```text
//!  off.csv, on.csv ─► pair ─► how much is gone, by part of the run ─► passed or not
//!  off.csv, machine file ─► advice: each constant of the file against what the run without it shows
//! ```
#![forbid(unsafe_code)]

mod advice;
mod page;
mod pair;

use serde::Serialize;
use trueup_machine::{BadInput, Machine, RunFile, file::Quantity};
use trueup_numerics::line::Summary;

pub use advice::{Advice, Change};
use pair::{Pair, Part};

/// What is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// So much of the RMS must be gone, in percent, 0…100.
    pub require_percent: f64,
    /// No error may be larger, in µm, above 0.
    pub limit_um: Option<f64>,
}

impl Default for Limits {
    fn default() -> Self {
        Self { require_percent: 90.0, limit_um: None }
    }
}

/// Size of an error over a run, in µm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Size {
    /// Root mean square.
    pub rms_um: f64,
    /// Largest absolute value.
    pub max_um: f64,
}

impl Size {
    fn of(um: &[f64]) -> Self {
        Summary::of(um).map_or(Self { rms_um: f64::NAN, max_um: f64::NAN }, |it| Self {
            rms_um: it.rms,
            max_um: it.max_abs,
        })
    }
}

/// What came out: `acceptance.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Acceptance {
    /// Whether all that was asked for is met.
    pub passed: bool,
    /// What was compared: `elongation`, `dx`, `dy`, `dz`.
    pub quantity: &'static str,
    /// Readings that both runs have.
    pub rows: usize,
    /// Without the compensation.
    pub before: Size,
    /// With it.
    pub after: Size,
    /// 1 − RMS after over RMS before.
    pub reduction: f64,
    /// What was asked for, in the same terms.
    pub required_reduction: f64,
    /// The largest error that is allowed, in µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit_um: Option<f64>,
    /// Part by part of the run.
    pub parts: Vec<Part>,
    /// Why it has not passed, a sentence each.
    pub unmet: Vec<String>,
    /// What to change.
    pub advice: Advice,
    /// What the reader must know of the runs, a sentence each.
    pub notes: Vec<String>,
    #[serde(skip)]
    pair: Pair,
    #[serde(skip)]
    adjusted: Option<String>,
}

impl Acceptance {
    /// The machine file with the constants that the run without compensation shows; none without advice
    /// that changes a constant.
    #[must_use]
    pub fn adjusted(&self) -> Option<&str> {
        self.adjusted.as_deref()
    }

    /// The printable page, of this name.
    #[must_use]
    pub fn html(&self, name: &str) -> String {
        page::html(self, name)
    }
}

/// Compares the run `off`, recorded without compensation, with `on`, recorded with it. `believed`: the
/// machine file that the bridge ran, its text first.
///
/// # Errors
/// The runs do not measure the same, have no time or positions in common, or the machine file cannot be
/// compared with them.
pub fn accept(
    off: &RunFile,
    on: &RunFile,
    quantity: Option<Quantity>,
    believed: Option<(&str, &Machine)>,
    limits: Limits,
) -> Result<Acceptance, BadInput> {
    let pair = Pair::of(off, on, quantity)?;
    let (before, after) = (Size::of(&pair.off_um), Size::of(&pair.on_um));
    let reduction = 1.0 - after.rms_um / before.rms_um;
    let required_reduction = limits.require_percent / 100.0;
    let mut unmet = Vec::new();
    // What is not a number is not enough either.
    let is_enough = reduction >= required_reduction;
    if !is_enough {
        unmet.push(format!(
            "{:.1} % of the error is gone, {:.1} % is required.",
            100.0 * reduction,
            limits.require_percent
        ));
    }
    if let Some(limit_um) = limits.limit_um.filter(|limit_um| {
        let is_within = after.max_um <= *limit_um;
        !is_within
    }) {
        unmet.push(format!(
            "The largest error is {:.2} µm, {limit_um} µm are allowed.",
            after.max_um
        ));
    }
    let passed = unmet.is_empty();
    let (advice, adjusted) =
        if passed { (Advice::nothing(), None) } else { advice::advise(&pair, off, believed)? };
    Ok(Acceptance {
        passed,
        quantity: pair.quantity.name(),
        rows: pair.at.len(),
        before,
        after,
        reduction,
        required_reduction,
        limit_um: limits.limit_um,
        parts: pair.parts(),
        unmet,
        advice,
        notes: pair.notes.clone(),
        pair,
        adjusted,
    })
}
