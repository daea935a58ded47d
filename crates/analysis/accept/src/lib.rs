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
use trueup_machine::{
    BadInput, Machine, RunFile,
    applied::{Applied, Factor},
    file::Quantity,
};
use trueup_numerics::line::Summary;

pub use advice::{Advice, Change};
use pair::{Pair, Part};
pub use trueup_page::Origin;

/// Requirements of an acceptance test.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// This much of the RMS must be gone, in percent, 0…100.
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

/// The machine's response to 1 µm of offset.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AppliedFactor {
    /// 1 is right, −1 the wrong sign, 0 not engaged.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

/// The result of an acceptance test: `acceptance.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Acceptance {
    /// Whether all that was asked for is met.
    pub passed: bool,
    /// The compared quantity: `elongation`, `dx`, `dy`, `dz`.
    pub quantity: &'static str,
    /// Readings that both runs have.
    pub rows: usize,
    /// Without the compensation.
    pub before: Size,
    /// With it.
    pub after: Size,
    /// 1 − RMS after over RMS before.
    pub reduction: f64,
    /// The required reduction, in the same terms.
    pub required_reduction: f64,
    /// The machine's response to 1 µm of offset: 1 is right; absent where the runs do not say what the bridge applied,
    /// or not well enough for any figure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub applied_factor: Option<AppliedFactor>,
    /// The largest error that is allowed, in µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit_um: Option<f64>,
    /// Part by part of the run.
    pub parts: Vec<Part>,
    /// Why it has not passed, a sentence each.
    pub unmet: Vec<String>,
    /// Advice on the machine file and the CNC.
    pub advice: Advice,
    /// Notes on the runs, a sentence each.
    pub notes: Vec<String>,
    #[serde(skip)]
    pair: Pair,
    #[serde(skip)]
    adjusted: Option<String>,
}

impl Acceptance {
    /// Returns the machine file with the constants that the run without compensation shows; none without advice
    /// that changes a constant.
    #[must_use]
    pub fn adjusted(&self) -> Option<&str> {
        self.adjusted.as_deref()
    }

    /// Returns the printable page, of this name, made of what `origin` says. `next` are the lines to be typed next.
    #[must_use]
    pub fn html(&self, name: &str, origin: &Origin, next: &[String]) -> String {
        page::html(self, name, origin, next)
    }

    /// Returns the error in both runs as a picture that stands alone, SVG.
    #[must_use]
    pub fn picture(&self) -> String {
        page::chart(self).standalone()
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
    let mut pair = Pair::of(off, on, quantity, believed.map(|(_, machine)| machine))?;
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
    let applied = pair.applied();
    let wrong = match applied {
        Applied::Otherwise(factor) => Some(factor),
        _ => None,
    };
    unmet.extend(wrong.as_ref().map(Factor::sentence));
    pair.notes.extend(unsure(applied));
    let passed = unmet.is_empty();
    let (advice, adjusted) = match wrong {
        Some(_) => (Advice::of_cnc(), None),
        None if passed => (Advice::nothing(), None),
        None => advice::advise(&pair, off, believed)?,
    };
    Ok(Acceptance {
        passed,
        quantity: pair.quantity.name(),
        rows: pair.at.len(),
        before,
        after,
        reduction,
        required_reduction,
        applied_factor: applied
            .factor()
            .map(|Factor { value, ci95 }| AppliedFactor { value, ci95 }),
        limit_um: limits.limit_um,
        parts: pair.parts(),
        unmet,
        advice,
        notes: pair.notes.clone(),
        pair,
        adjusted,
    })
}

/// Returns a note where the runs have offsets and do not show how the machine applies them.
fn unsure(applied: Applied) -> Option<String> {
    let Applied::Unknown(factor) = applied else { return None };
    let interval = factor.map_or(String::new(), |Factor { ci95: [low, high], .. }| {
        format!(" (95 %: {low:.2} … {high:.2})").replace('-', "−")
    });
    Some(format!(
        "What the machine does for 1 µm of offset cannot be told from these runs{interval}: the offset has to change by \
         several times the noise of the gauge, as it does from cold to warm."
    ))
}
