//! Every number of a machine file, held against what a machine can have.
//!
//! | page | is |
//! |---|---|
//! | `input_range` | whether a linear temperature input can give the temperatures of a machine |
//! | `numeric_values` | the numbers of a machine by their keys, each with its range |
//!
//! The ranges are declared with the keys, and for keys of one unit in `keys/plausible_range.rs`.
//! A value that is impossible is refused by every command that would use it or write it, unless the user
//! accepts its key; one that is unlikely is a warning that names the likely slip.

mod input_range;
mod numeric_values;

use super::warning::Warning;
use crate::{
    effect::BoardTerm,
    keys::plausible_range::{
        AXIS_SIGN_HINT, PlausibleRange, REVERSED_SIGN_HINT, SPINDLE_SIGN_HINT,
    },
    location::InputFileError,
    machine_file::Machine,
    sections::{LinearAxis, PitchErrorTable},
};
use numeric_values::{KeyScope, NumericEntry};

/// How far a value is from what a machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plausibility {
    /// It can be, and hardly ever is.
    Unlikely,
    /// It cannot be.
    Impossible,
}

/// A value that is doubted or refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImplausibleValue {
    /// The key of the machine file, or the column of the run: what `--accept` takes.
    pub key: String,
    /// How far off it is.
    pub grade: Plausibility,
    /// The warning about it.
    pub warning: Warning,
}

impl ImplausibleValue {
    /// Returns whether it is refused, unless its key is among those that the user accepts.
    #[must_use]
    pub fn is_refused(&self, accepted: &[String]) -> bool {
        self.grade == Plausibility::Impossible && !accepted.contains(&self.key)
    }
}

/// Returns all that is refused of these as one error; `None` where nothing is.
#[must_use]
pub fn combine_rejected_findings(
    findings: &[ImplausibleValue],
    accepted: &[String],
) -> Option<InputFileError> {
    let refused = findings.iter().filter(|finding| finding.is_refused(accepted));
    InputFileError::combine(refused.map(|ImplausibleValue { key, warning, .. }| {
        let Warning { place, what, help } = warning;
        let help = format!("{help}; if it is meant, add --accept {key}");
        InputFileError::new(place.clone(), what.clone()).with_help(help)
    }))
}

/// Returns the values of a machine file that are unlikely or impossible.
#[must_use]
pub(crate) fn find_implausible_values(machine: &Machine) -> Vec<ImplausibleValue> {
    let entries = numeric_values::collect_numeric_entries(machine).into_iter();
    let mut findings: Vec<ImplausibleValue> = entries
        .filter_map(|NumericEntry { key, unit, range, values }| {
            let range = range?;
            let (grade, value) = find_worst_value(&range, &values)?;
            Some(new_implausible_value(machine, key, unit, &range, grade, value))
        })
        .collect();
    for axis in LinearAxis::ALL {
        findings.extend(find_negative_backlash(machine, axis));
        findings.extend(find_decreasing_thermal_table(machine, axis));
    }
    findings.extend(input_range::findings(machine));
    findings
}

/// Returns the value that is farthest outside, and how far that is.
fn find_worst_value(range: &PlausibleRange, values: &[f64]) -> Option<(Plausibility, f64)> {
    let beyond = |[low, high]: [f64; 2]| {
        let outside = values.iter().copied().filter(move |value| !(low..=high).contains(value));
        outside.max_by(|a, b| a.abs().total_cmp(&b.abs()))
    };
    let impossible = beyond(range.hard).map(|value| (Plausibility::Impossible, value));
    impossible.or_else(|| beyond(range.likely).map(|value| (Plausibility::Unlikely, value)))
}

fn new_implausible_value(
    machine: &Machine,
    key: String,
    unit: &str,
    range: &PlausibleRange,
    grade: Plausibility,
    value: f64,
) -> ImplausibleValue {
    let PlausibleRange { hard, likely, usual, source, below, above } = range;
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let is_negative = value < 0.0 && likely[0] >= -0.5;
    let value_of = format_value(value);
    let typo = if value < likely[0] { below } else { above };
    let what = match grade {
        Plausibility::Impossible => {
            format!("{value_of}{unit} is impossible (possible: {} to {}): {typo}", hard[0], hard[1])
        }
        Plausibility::Unlikely if is_negative => {
            format!("{value_of}{unit} is negative: {typo}")
        }
        Plausibility::Unlikely => {
            format!("{value_of}{unit} is unlikely (usual: {} to {}): {typo}", usual[0], usual[1])
        }
    };
    let help = match [REVERSED_SIGN_HINT, SPINDLE_SIGN_HINT, AXIS_SIGN_HINT].contains(typo) {
        true => {
            "look at one reading: where the machine goes too far, the error must be positive".into()
        }
        false => format!("write the value in the unit of its key; {source}"),
    };
    let warning = Warning::for_key(machine, &key, &what, help);
    ImplausibleValue { key, grade, warning }
}

/// Returns a value as it stands in a file, or to five digits where it has more than a user would write.
fn format_value(value: f64) -> String {
    const MAX_UNROUNDED_CHARS: usize = 8;
    let whole = format!("{value}");
    if whole.len() <= MAX_UNROUNDED_CHARS {
        return whole;
    }
    let rounded: f64 = format!("{value:.4e}").parse().unwrap_or(value);
    format!("{rounded}")
}

/// Backlash of an axis by all that the file says of it: a term adds to a section.
fn find_negative_backlash(machine: &Machine, axis: LinearAxis) -> Option<ImplausibleValue> {
    let model = &machine.axes[axis.index()];
    let mut total_um = 0.0;
    let mut last = None;
    if let Some(um) = model.pitch.as_ref().and_then(mean_reversal_um) {
        total_um += um;
        last = Some(format!("axis.{}.pitch.reverse_um", axis.name()));
    }
    total_um += model.backlash.map_or(0.0, |backlash| backlash.width_um);
    let of_axis =
        machine.terms.iter().enumerate().filter(|(_, term)| term.quantity.axis() == Some(axis));
    for (index, term) in of_axis {
        let forms = term.effect.board_terms();
        let widths = forms.iter().filter_map(|form| match form {
            BoardTerm::Reversed { width_um, .. } => Some(*width_um),
            BoardTerm::Table(pitch) => mean_reversal_um(pitch),
            _ => None,
        });
        for um in widths.filter(|um| *um != 0.0) {
            total_um += um;
            let width = format!("term[{index}].width_um");
            let key =
                if machine.places.contains(&width) { width } else { format!("term[{index}]") };
            last = Some(key);
        }
    }
    // A section alone is judged by its own row.
    let key = last?;
    let (_, range) = KeyScope::FILE.find("axis.x.backlash.width_um")?;
    (total_um < range?.likely[0]).then(|| {
        let what = format!("makes a backlash of {total_um:.2} µm, which is negative: {REVERSED_SIGN_HINT}");
        let help = "look at one reversal: approached in the negative direction the axis is left behind, and the error is larger";
        let warning = Warning::for_key(machine, &key, &what, help);
        ImplausibleValue { key, grade: Plausibility::Unlikely, warning }
    })
}

/// Returns the mean of a reverse table less that of the forward one.
fn mean_reversal_um(pitch: &PitchErrorTable) -> Option<f64> {
    let reverse_um = pitch.reverse_um.as_ref()?;
    let widths =
        reverse_um.iter().zip(&pitch.forward_um).map(|(reverse, forward)| reverse - forward);
    Some(widths.sum::<f64>() / reverse_um.len().max(1) as f64)
}

/// Returns a table of an axis's heat whose slope falls as it becomes warmer.
fn find_decreasing_thermal_table(machine: &Machine, axis: LinearAxis) -> Option<ImplausibleValue> {
    let thermal = machine.axes[axis.index()].thermal.as_ref()?;
    let rows = thermal.table.as_ref().filter(|_| thermal.mode.has_position_term())?;
    let (first, last) = (rows.first()?, rows.last()?);
    let by_c =
        (last.slope_um_per_m - first.slope_um_per_m) / (last.temperature_c - first.temperature_c);
    let (slope, range) = KeyScope::FILE.find("axis.x.thermal.slope_um_per_m_per_c")?;
    let range = range?;
    let key = format!("axis.{}.thermal.table", axis.name());
    let (grade, value) = find_worst_value(&range, &[by_c])?;
    // Of a table the size of a slope is known to what its ends are.
    let is_reported = grade == Plausibility::Impossible || value < -0.1;
    is_reported.then(|| {
        let ImplausibleValue { warning, .. } =
            new_implausible_value(machine, key.clone(), slope.unit, &range, grade, value);
        ImplausibleValue { key, grade, warning }
    })
}

#[cfg(test)]
mod tests;
