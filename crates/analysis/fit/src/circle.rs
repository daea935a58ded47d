//! `fit circle`: the causes of the radial deviations of a circle, as a ball bar or a 2D indicator records them.
//!
//! The reading is dr = actual minus nominal radius, in µm, at the angle φ of the commanded position, counted from the first
//! axis u of the plane to the second one v: (x, y), (y, z) or (z, x). A counter-clockwise circle has s = +1, a clockwise
//! one s = −1. An error (eᵤ, eᵥ) of the axes, actual minus commanded, shows in the direction of the radius:
//!
//! ```text
//! dr = eᵤ·cos φ + eᵥ·sin φ
//! ```
//!
//! | cause | error of the axes | dr |
//! |---|---|---|
//! | radius, centre (set-up, no fault) | | c + a·cos φ + b·sin φ |
//! | squareness c, µm/m | eᵤ = c·v/1000 | c·R/2000·sin 2φ |
//! | scale mismatch, kᵤ − kᵥ, µm/m | eᵤ = kᵤ·u/1000, eᵥ = kᵥ·v/1000 | (kᵤ − kᵥ)·R/2000·cos 2φ |
//! | backlash B of u; of v | B where the axis moves in the negative direction | ½·B·s·sgn(sin φ)·cos φ; −½·B·s·sgn(cos φ)·sin φ |
//! | lateral play W of u; of v | the other axis by W where the axis moves in the negative direction | ½·W·s·sgn(sin φ)·sin φ; −½·W·s·sgn(cos φ)·cos φ |
//! | servo mismatch, τᵤ − τᵥ | e = −τ·velocity | ½·F·(τᵤ − τᵥ)·s·sin 2φ, F the feed |
//! | reversal spike of u; of v | a peak behind φ = 0 and π; behind ±π/2 | h·shape(angle since the reversal) |
//! | cyclic error of u; of v, period L | A·sin(2πu/L + ψ) | A·sin(2πu/L + ψ)·cos φ; A·sin(2πv/L + ψ)·sin φ |
//! | straightness of v along u, f(cos φ) = Σ cₙ·Uₙ | eᵥ = f | Σ cₙ·sin((n + 1)φ) |
//! | drift | radius and centre grow with time | t·(c + a·cos φ + b·sin φ) |
//!
//! Uₙ are Chebyshev's polynomials of the second kind: Uₙ(cos φ)·sin φ = sin((n + 1)φ), so that each harmonic is one form of
//! a straightness. Constants ½·B·cos φ belong to the centre. Sources: ISO 230-4 (figures, set-up, both directions); the
//! signatures are those of the published ball-bar diagnosis (Knapp 1983, Kakino, Ihara and Nakatsu 1987).
//!
//! | module | does |
//! |---|---|
//! | [`record`] | the readings of a circle |
//! | `read` | rows of run files as passes around circles |
//! | [`terms`] | the columns of the table above |
//! | [`search`] | periods of cyclic errors, shapes of spikes |
//! | [`term_selection`] | keeps the terms that the record shows, tests them on held-out arcs |
//! | [`findings`] | terms as causes with constants, alternatives, and the next test |
//! | `circular_deviations` | ISO 230-4 |
//! | `machine_sections` | the sections of the machine file |
//! | [`page`](html_report) | the page with the polar plots |

mod analysis;
pub(crate) mod circular_deviations;
mod circular_path;
pub mod findings;
pub mod html_report;
mod known_contributions;
pub(crate) mod machine_sections;
pub mod record;
mod record_reader;
pub mod search;
pub mod term_selection;
pub mod terms;

use trueup_machine::{InputFileError, Machine, RunFile, machine_file::writer::MachineFileEdit};

pub(crate) use self::record_reader::extract_circle_records as records;
pub use self::{
    circular_deviations::CircularDeviations,
    findings::{CircleCause, CircleFinding},
    html_report::build_circle_page,
    record::{CirclePlane, CircleRecord},
};
use crate::report::{ExcludedRow, ResidualStatistics};

/// Circles and their causes.
#[derive(Clone, Debug)]
pub struct CircleReport {
    /// One for each circle, in the order of the planes.
    pub circles: Vec<CircleResult>,
    /// The corrections by table, as sections of a machine file.
    pub edit: MachineFileEdit,
    /// Which constants the sections have, a sentence each.
    pub written: Vec<String>,
    /// Warnings for the user; whole sentences.
    pub warnings: Vec<String>,
    /// The answer in one word.
    pub verdict: CircleVerdict,
}

/// One circle: the figures, and the causes.
#[derive(Clone, Debug)]
pub struct CircleResult {
    /// The readings that were used.
    pub record: CircleRecord,
    /// The figures of ISO 230-4.
    pub figures: CircularDeviations,
    /// The causes, the largest first.
    pub findings: Vec<CircleFinding>,
    /// Readings without centre and radius of the set-up.
    pub before: ResidualStatistics,
    /// The same without the causes.
    pub after: ResidualStatistics,
    /// The standard deviation of the noise, in µm.
    pub noise_um: f64,
    /// The structure that neither the causes nor noise explain, RMS in µm.
    pub structure_um: Option<f64>,
    /// The prediction of the causes for each row, set-up included, in µm.
    pub predicted_um: Vec<f64>,
    /// Gross readings.
    pub excluded: Vec<ExcludedRow>,
}

/// The answer in one word, as `diagnose` has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CircleVerdict {
    /// Nothing but set-up and noise.
    Clean,
    /// Causes, and nothing is left.
    Explained,
    /// Causes, and structure is left or a cause is not claimed.
    PartlyExplained,
    /// Nothing is claimed and something is there.
    Unexplained,
}

impl CircleVerdict {
    /// Returns its name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Explained => "explained",
            Self::PartlyExplained => "partly-explained",
            Self::Unexplained => "unexplained",
        }
    }
}

/// Finds the causes of the circles in `runs`; what `machine` predicts is taken off first.
///
/// # Errors
/// A run lacks `measured_dr_um` or two positions that move on a circle, or has too few rows of it.
pub fn analyse_circles(
    runs: &[RunFile],
    machine: Option<&Machine>,
) -> Result<CircleReport, InputFileError> {
    let (records, mut warnings) = record_reader::extract_circle_records(runs, machine)?;
    let mut circles: Vec<CircleResult> =
        records.into_iter().map(analysis::analyse_circle).collect();
    let (edit, written) =
        machine_sections::build_machine_file_edit(&mut circles, machine, &mut warnings);
    let all = || circles.iter().flat_map(|circle| &circle.findings);
    let is_left = circles.iter().any(|circle| circle.structure_um.is_some());
    let (claimed, open) =
        (all().any(|finding| finding.claimed), all().any(|finding| !finding.claimed));
    let verdict = match (claimed, open || is_left) {
        (false, false) => CircleVerdict::Clean,
        (true, false) => CircleVerdict::Explained,
        (true, true) => CircleVerdict::PartlyExplained,
        (false, true) => CircleVerdict::Unexplained,
    };
    Ok(CircleReport { circles, edit, written, warnings, verdict })
}
