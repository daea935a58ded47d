//! One circle: searched, chosen, reported as causes.

use trueup_numerics::block_resampling::rms;

use super::{
    CircleResult, CircularDeviations,
    findings::build_findings,
    record::CircleRecord,
    search::search_nonlinear_terms,
    term_selection::{SelectedModel, TermGroup, select_terms},
    terms::{CircleTerm, travel_since_reversal_mm},
};
use crate::report::ResidualStatistics;

/// An axis that reverses takes up its play over a travel of its width: a step at once is not expected there.
const BACKLASH_TRAVEL_FACTOR: f64 = 1.3;
/// Rows whose means are held against the noise of single rows, in degrees.
const ANGLE_BIN_WIDTH_DEG: f64 = 10.0;
/// Variances of the means in those of noise from which on there is structure.
const MIN_SYSTEMATIC_VARIANCE_RATIO: f64 = 3.0;
/// Structure below this share of the noise matters to no part.
const MIN_SYSTEMATIC_TO_NOISE_RATIO: f64 = 0.5;
/// The same in µm.
const MIN_SYSTEMATIC_RMS_UM: f64 = 0.2;

/// Explains a circle.
pub(crate) fn analyse_circle(record: CircleRecord) -> CircleResult {
    let figures = CircularDeviations::from_record(&record);
    let mut used = without_backlash_rows(&record, record.play_um);
    let mut chosen = select_terms(&used, &search_nonlinear_terms(&used));
    let without = without_backlash_rows(&used, total_backlash_um(&used, &chosen));
    if without.rows.len() < used.rows.len() {
        used = without;
        chosen = select_terms(&used, &search_nonlinear_terms(&used));
    }
    let predicted_um = used.rows.iter().zip(&chosen.residual_um).map(|(row, left)| row.um - left);
    let predicted_um: Vec<f64> = predicted_um.collect();
    let setup: Vec<f64> = used
        .rows
        .iter()
        .map(|row| {
            let of_setup = chosen.terms.iter().filter(|term| term.unit == TermGroup::Setup);
            of_setup.map(|term| term.um * term.term.evaluate(row, &used)).sum()
        })
        .collect();
    let before: Vec<f64> = used.rows.iter().zip(&setup).map(|(row, set)| row.um - set).collect();
    let none = ResidualStatistics { rms_um: 0.0, max_um: 0.0 };
    CircleResult {
        figures,
        findings: build_findings(&used, &chosen),
        before: ResidualStatistics::from_residuals(&before).unwrap_or(none),
        after: ResidualStatistics::from_residuals(&chosen.residual_um).unwrap_or(none),
        noise_um: chosen.noise_um,
        structure_um: systematic_rms_um(&used, &chosen.residual_um),
        predicted_um,
        excluded: used.excluded.clone(),
        record: used,
    }
}

/// Returns the play of both axes: of the machine file, and that was found.
fn total_backlash_um(record: &CircleRecord, chosen: &SelectedModel) -> [f64; 2] {
    let mut play_um = record.play_um;
    for it in &chosen.terms {
        if let CircleTerm::Backlash(axis) = it.term {
            play_um[axis] += it.um.abs();
        }
    }
    play_um
}

/// Returns the record without the rows in which an axis takes up this play.
fn without_backlash_rows(record: &CircleRecord, play_um: [f64; 2]) -> CircleRecord {
    let passes = record.rows.chunk_by(|a, b| a.pass == b.pass).count() as f64;
    let step = record.covered_arc_rad() * passes / record.rows.len() as f64;
    record.without_rows(|row| {
        (0..2).any(|axis| {
            let travel = travel_since_reversal_mm(row, axis, record.radius_mm, step);
            travel < BACKLASH_TRAVEL_FACTOR * play_um[axis] / 1e3
        })
    })
}

/// Returns RMS of what is left and no noise: means over arcs that vary by more than single rows let them.
fn systematic_rms_um(record: &CircleRecord, left: &[f64]) -> Option<f64> {
    let (mut differences, mut means) = (Vec::new(), Vec::new());
    let mut at = 0;
    let per_deg = 57.3 * record.rows.chunk_by(|a, b| a.pass == b.pass).count() as f64;
    let step_deg = record.covered_arc_rad() * per_deg / record.rows.len() as f64;
    let together = ((ANGLE_BIN_WIDTH_DEG / step_deg) as usize).max(3);
    for pass in record.rows.chunk_by(|a, b| a.pass == b.pass) {
        let own = &left[at..at + pass.len()];
        at += pass.len();
        differences.extend(own.windows(2).map(|pair| pair[1] - pair[0]));
        means.extend(
            own.chunks_exact(together).map(|chunk| chunk.iter().sum::<f64>() / chunk.len() as f64),
        );
    }
    let noise = rms(&differences) / std::f64::consts::SQRT_2;
    let expected = noise * noise / together as f64;
    let found = rms(&means).powi(2);
    let um = (found - expected).max(0.0).sqrt();
    let is_there = means.len() > 8
        && found > MIN_SYSTEMATIC_VARIANCE_RATIO * expected
        && um > (MIN_SYSTEMATIC_TO_NOISE_RATIO * noise).max(MIN_SYSTEMATIC_RMS_UM);
    is_there.then_some(um)
}
