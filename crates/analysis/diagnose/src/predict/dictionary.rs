//! The terms that a correction is chosen from: what the board can run and only adds to the prediction, at each setting
//! of what enters nonlinearly.

use crate::{
    candidates::single_input_candidates, fit::FitProblem, search::initial_model,
    term_kind::ModelPart,
};

/// A table or curve of more values is judged by its repeats, not by blocks.
const MAX_TERM_AMPLITUDES: usize = 16;

/// A term at one setting; amplitudes 0.
pub(super) struct DictionaryEntry {
    pub part: ModelPart,
    /// Its columns in the columns of all entries.
    pub columns: std::ops::Range<usize>,
    /// The number of its kind: a correction has one setting of a kind.
    pub kind: usize,
    /// Values that count where simplicity counts.
    pub degrees: usize,
}

/// All terms, and what each adds to each group at an amplitude of 1.
pub(super) struct TermDictionary {
    pub entries: Vec<DictionaryEntry>,
    pub columns: Vec<Vec<f64>>,
    /// Whether the measurement's zero is arbitrary.
    has_zero: bool,
}

impl TermDictionary {
    /// Returns the terms that the machine and the data allow.
    pub(super) fn new(problem: &FitProblem) -> Self {
        let base = initial_model(&problem.data);
        let residual = problem.residual(&base);
        let groups = residual.len() as f64;
        let has_zero = base.constant_um.is_some();
        let mut dictionary = Self { entries: Vec::new(), columns: Vec::new(), has_zero };
        let candidates = single_input_candidates(problem, &base, &residual);
        for (kind, candidate) in candidates.iter().enumerate() {
            let of = &candidate.kind;
            // A wave's period is found in what was measured, and would not be held out with a part of it.
            let is_open = of.is_compensable() && of.is_additive() && of.as_stated_term().is_none();
            let amplitudes = of.amplitude_count();
            // Nor is what happens once a record predicted by its other parts.
            let is_once = of.has_spatial_period() || of.is_settling_from_start();
            if !is_open || is_once || !(1..=MAX_TERM_AMPLITUDES).contains(&amplitudes) {
                continue;
            }
            for setting in &candidate.settings {
                // What the record does not show all of is continued at will.
                if of.has_time_constant() && !problem.is_time_constant_short(setting[0]) {
                    continue;
                }
                let columns = problem.basis_columns(of, setting, true);
                let varies = |column: &Vec<f64>| {
                    let mean = column.iter().sum::<f64>() / groups;
                    let spread = column.iter().map(|c| (c - mean).powi(2)).sum::<f64>();
                    spread.is_finite() && spread > 1e-18 * groups * (1.0 + mean * mean)
                };
                if !columns.iter().all(varies) {
                    continue;
                }
                let mut values = setting.clone();
                values.resize(of.degrees_of_freedom(), 0.0);
                let first = dictionary.columns.len();
                dictionary.columns.extend(columns.iter().cloned());
                dictionary.entries.push(DictionaryEntry {
                    part: ModelPart { kind: of.clone(), values },
                    columns: first..dictionary.columns.len(),
                    kind,
                    degrees: of.degrees_of_freedom(),
                });
            }
        }
        dictionary
    }

    /// Returns whether a constant comes with one of these terms.
    pub(super) fn has_constant(&self, terms: &[usize]) -> bool {
        self.has_zero || terms.iter().any(|&term| self.entries[term].part.kind.has_reference())
    }
}
