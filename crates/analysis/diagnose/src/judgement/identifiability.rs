//! Whether the data identify a term: whether another record would give the same values.

use trueup_machine::effect::Effect;

use crate::{
    columns::column_by_name,
    data::DataTable,
    judgement::context::JudgementContext,
    model::MIN_DISTINCT_RATE_RATIO,
    search::model_comparison::{MAX_EQUIVALENT_RMS_RATIO, MAX_HELD_OUT_SQUARES_RATIO},
    term_kind::TermKind,
};

/// Returns whether a term is identified; `is_known`: by the intervals of its values.
pub(crate) fn is_identified(case: &JudgementContext<'_>, cause: &TermKind, is_known: bool) -> bool {
    // What acts late is known if the model predicts data not used for the fit. A growth from the start
    // alone is excepted: without the start it cannot be.
    let is_late = cause.has_time_constant() && !cause.cause().is_some_and(Effect::depends_on_time);
    let is_at_most = |times: f64| case.left_out_um <= times * case.found.fitted.rms();
    // A model that predicts whole records that it was not fitted to equally well has been seen again there, however wide
    // the intervals of its constants are.
    let is_predicted = case.found.folds.has_record_folds() && is_at_most(MAX_EQUIVALENT_RMS_RATIO);
    is_predicted
        || is_known
            && has_stable_time_constant(case, cause)
            && (is_at_most(MAX_HELD_OUT_SQUARES_RATIO.sqrt()) || !is_late)
            && is_heat_path_repeated(&case.problem.data, cause)
}

/// Returns whether a time constant is about the same whatever part of the record is held out, or short next to
/// the record.
fn has_stable_time_constant(case: &JudgementContext<'_>, cause: &TermKind) -> bool {
    if !cause.is_log_scaled(0) || cause.tier() > 1 {
        return true;
    }
    let folded = case.folded.iter();
    let (low, high) = folded
        .filter_map(|model| model.parts.iter().find(|part| part.kind == *cause))
        .map(|part| part.values[0])
        .fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    high <= MIN_DISTINCT_RATE_RATIO * low || case.problem.is_time_constant_short(high)
}

/// Returns whether a slow path of a column was seen more than once: over one heating and one cooling, whatever
/// rises late and falls late is a path. The column must have turned three times by a tenth of its
/// range, in all records together.
fn is_heat_path_repeated(data: &DataTable, kind: &TermKind) -> bool {
    let Some(path) = kind.heat_path().filter(|path| path.has_lag) else { return true };
    let Some(values) = column_by_name(data, path.column) else { return true };
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &c| (low.min(c), high.max(c)));
    let least = 0.1 * (high - low);
    let (mut ways, mut lowest, mut highest, mut is_rising) = (0, f64::NAN, f64::NAN, None);
    for (row, &c) in values.iter().enumerate() {
        if data.places.restart[row] {
            (lowest, highest, is_rising) = (c, c, None);
        }
        (lowest, highest) = (lowest.min(c), highest.max(c));
        if is_rising != Some(true) && c - lowest > least {
            (ways, highest, is_rising) = (ways + 1, c, Some(true));
        } else if is_rising != Some(false) && highest - c > least {
            (ways, lowest, is_rising) = (ways + 1, c, Some(false));
        }
    }
    ways >= 3
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, RunFile, machine_file::Quantity};

    use super::*;

    /// Returns a record in which the table warms and cools as often as stated.
    fn record(cycles: usize) -> DataTable {
        let mut text = String::from("time_s,temp_table_c,measured_elongation_um\n");
        for second in 0..40 * cycles {
            let up = (second % 40).min(40 - second % 40);
            text += &format!("{second},{},0.0\n", 20.0 + up as f64);
        }
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        DataTable::new(&machine, &[run], Quantity::Elongation).expect("comparable")
    }

    #[test]
    fn a_slow_path_is_seen_again_once_it_has_warmed_twice() {
        let slow = TermKind::heat_of("temp_table_c", true);
        assert!(!is_heat_path_repeated(&record(1), &slow));
        assert!(is_heat_path_repeated(&record(2), &slow));
        let plain = TermKind::heat_of("temp_table_c", false);
        assert!(is_heat_path_repeated(&record(1), &plain));
    }
}
