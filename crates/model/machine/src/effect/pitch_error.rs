//! `pitch-error`: the scale or the screw is uneven.
//!
//! ```text
//! p + a table of the position, one for each direction; the end values held
//! ```

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, PhysicalLaw, Target, TermEntry,
    },
    data_view::{DataView, StartValues, find_distinct_values, peak_to_peak},
};
use crate::{
    keys::{
        reader::Section,
        table::{Table, entries},
    },
    location::InputFileError,
    sections::{LinearAxis, PitchErrorTable, axis::is_negative_direction},
};

/// A table.
#[derive(Clone, Debug, PartialEq)]
pub struct PitchError(pub PitchErrorTable);

impl PitchError {
    fn point_count(&self) -> usize {
        self.0.forward_um.len()
    }
}

impl FileRepresentation for PitchError {
    const NAME: &'static str = "pitch-error";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        PitchErrorTable::NAMES
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        // The table's keys are those of [axis.x.pitch], next to the common ones.
        Ok(Self(PitchErrorTable::read(section)?))
    }

    fn entries(&self) -> Vec<TermEntry> {
        entries(&self.0)
    }
}

impl PhysicalLaw for PitchError {
    fn target(&self) -> Target {
        Target::Axis
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        let direction = self.0.reverse_um.as_ref().map(|_| LawInput::OwnDirection);
        [LawInput::OwnPosition].into_iter().chain(direction).collect()
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let PitchErrorTable { start_mm, step_mm, forward_um, .. } = &self.0;
        let points = forward_um.len();
        let at = ((x[0] - start_mm) / step_mm).clamp(0.0, (points - 1) as f64);
        // A missing position is at no point, and what follows is missing as well.
        let low = (at as usize).min(points.saturating_sub(2));
        let share = at - low as f64;
        let offset = if x.get(1).is_some_and(|&direction| is_negative_direction(direction)) {
            points
        } else {
            0
        };
        add(offset + low, 1.0 - share);
        if points > 1 {
            add(offset + low + 1, share);
        }
    }

    fn pitch_table(&self) -> Option<&PitchErrorTable> {
        Some(&self.0)
    }
}

impl BoardRepresentation for PitchError {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![BoardTerm::Table(self.0.clone())]
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        match form {
            BoardTerm::Table(pitch) => Some(Self(pitch.clone())),
            _ => None,
        }
    }
}

impl Candidate for PitchError {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            amplitudes: self.point_count() * if self.0.reverse_um.is_some() { 2 } else { 1 },
            list_length: Some(self.point_count()),
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        let reverse_um = self.0.reverse_um.iter().flatten();
        self.0.forward_um.iter().chain(reverse_um).copied().collect()
    }

    fn set_values(&mut self, values: &[f64]) {
        let (forward_um, reverse_um) = values.split_at(self.point_count());
        self.0.forward_um = forward_um.to_vec();
        if let Some(there) = &mut self.0.reverse_um {
            *there = reverse_um.to_vec();
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(own) = survey.own_position_mm().filter(|own| peak_to_peak(own) > 0.0) else {
            return;
        };
        if survey.has_cause(Self::NAME) {
            return;
        }
        for (start_mm, step_mm, points) in candidate_table_grids(own, survey.group_count()) {
            for both_ways in [false, true] {
                if (!both_ways || survey.is_bidirectional()) && points >= 3 {
                    let forward_um = vec![0.0; points];
                    let reverse_um = both_ways.then(|| forward_um.clone());
                    with(
                        Self(PitchErrorTable { start_mm, step_mm, forward_um, reverse_um }),
                        StartValues::linear_only(),
                    );
                }
            }
        }
    }
}

impl Explanation for PitchError {
    fn describe(&self, _: &[f64]) -> String {
        format!(
            "The scale or the screw is uneven: a table of {} points{} corrects it.",
            self.point_count(),
            if self.0.reverse_um.is_some() { " for each direction" } else { "" }
        )
    }

    fn next_test(&self) -> &'static str {
        "Measure once more by ISO 230-2 at targets that are no multiples of the screw's pitch."
    }

    fn repair_advice(&self) -> Option<&'static str> {
        Some(
            "If the error has a kink, look at the pretension of the screw between its two \
             bearings. If it has a bow, check that screw and scale are parallel to the guide.",
        )
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let mut table = self.clone();
        table.set_values(values);
        let mut record: Vec<_> =
            table.entries().into_iter().map(|(key, value)| (key, Some(value))).collect();
        if self.0.reverse_um.is_none() {
            record.push(("reverse_um", None));
        }
        vec![FindingParameter::Record("table", record)]
    }
}

/// Tables (start, step, points) that the positions allow: at the targets where these are few and
/// evenly spaced, else even ones of growing fineness; five readings a point, as for the spline of a guide.
fn candidate_table_grids(own: &[f64], groups: usize) -> Vec<(f64, f64, usize)> {
    let at = find_distinct_values(own, 2e-3);
    let (Some(&first), Some(&last)) = (at.first(), at.last()) else { return Vec::new() };
    let even = (last - first) / (at.len() as f64 - 1.0);
    let is_even = at.windows(2).all(|pair| ((pair[1] - pair[0]) - even).abs() < 0.05 * even.abs());
    if is_even && at.len() >= 3 && at.len() <= 80 && groups >= 3 * at.len() {
        return vec![(first, even, at.len())];
    }
    [6, 11, 21, 41]
        .into_iter()
        .filter(|&points| groups >= 5 * points && at.len() >= points)
        .map(|points| (first, (last - first) / (points - 1) as f64, points))
        .collect()
}
