//! `straightness`: the guide of another axis is not straight.
//!
//! ```text
//! p + spline(P)          P of the axis that moves
//! ```

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, PhysicalLaw, Target, TermContext, TermEntry, Value,
        required_axis,
    },
    data_view::{DataView, StartValues, find_distinct_values, uniform_knots},
};
use crate::{
    keys::{
        reader::Section,
        term::{ALONG, CONTROL_UM, KNOTS_MM, ORDER},
    },
    location::InputFileError,
    sections::{
        LinearAxis,
        straightness::{SplineKeys, read_spline, spline_entries},
    },
    spline::{BSpline, spline_basis_values},
};

/// A spline over another axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Straightness {
    /// The axis that moves.
    pub along: LinearAxis,
    /// The spline.
    pub spline: BSpline,
}

/// Control points of the curves that are tried.
const CONTROL_POINT_COUNTS: [usize; 4] = [5, 8, 12, 20];

/// Returns the knots of the cubic spline that passes through a value at each of these places, at least 4, in
/// order: one at each but for the second and the last but one.
fn interpolation_knots(at: &[f64]) -> Vec<f64> {
    let last = at.len() - 1;
    let mut knots = vec![at[0]; 4];
    knots.extend(&at[2..last - 1]);
    knots.extend([at[last]; 4]);
    knots
}

/// The keys of the spline.
const SPLINE_KEYS: SplineKeys = [ORDER, KNOTS_MM, CONTROL_UM];

impl FileRepresentation for Straightness {
    const NAME: &'static str = "straightness";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[ALONG.name, ORDER.name, KNOTS_MM.name, CONTROL_UM.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        Ok(Self {
            along: required_axis(section, ALONG)?,
            spline: read_spline(section, &SPLINE_KEYS)?,
        })
    }

    fn entries(&self) -> Vec<TermEntry> {
        let along = (ALONG.name, Value::Text(self.along.name().into()));
        [along].into_iter().chain(spline_entries(&self.spline, &SPLINE_KEYS)).collect()
    }
}

impl PhysicalLaw for Straightness {
    fn target(&self) -> Target {
        Target::Axis
    }

    fn refusal(&self, host: &TermContext<'_>) -> Option<String> {
        (host.quantity.axis() == Some(self.along))
            .then(|| "is the error of another axis than the one that moves".into())
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![LawInput::Position(self.along)]
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let (first, weights) = spline_basis_values(&self.spline, x[0]);
        for (number, weight) in weights.into_iter().take(self.spline.order).enumerate() {
            add(first + number, weight);
        }
    }
}

impl BoardRepresentation for Straightness {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![BoardTerm::Curve(self.along, self.spline.clone())]
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        match form {
            BoardTerm::Curve(along, spline) => Some(Self { along: *along, spline: spline.clone() }),
            _ => None,
        }
    }
}

impl Candidate for Straightness {
    fn fit_spec(&self) -> FitSpec {
        let amplitudes = self.spline.control_um.len();
        FitSpec { tier: 1, amplitudes, list_length: Some(amplitudes), ..FitSpec::DEFAULT }
    }

    fn values(&self) -> Vec<f64> {
        self.spline.control_um.clone()
    }

    fn set_values(&mut self, values: &[f64]) {
        self.spline.control_um = values.to_vec();
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        for along in survey.other_moving_axes() {
            let column = along.column_name();
            let at = find_distinct_values(survey.column(&column).unwrap_or(&[]), 1e-3);
            let mut try_knots = |knots_mm: Vec<f64>| {
                let controls = knots_mm.len() - 4;
                if survey.group_count() >= 5 * controls {
                    let spline = BSpline { order: 4, knots_mm, control_um: vec![0.0; controls] };
                    with(Self { along, spline }, StartValues::linear_only());
                }
            };
            for controls in
                CONTROL_POINT_COUNTS.into_iter().filter(|controls| at.len() >= controls + 2)
            {
                try_knots(uniform_knots(&at, controls));
            }
            // Of few places a map has seen each often, whatever the other axis did.
            if (4..=CONTROL_POINT_COUNTS[CONTROL_POINT_COUNTS.len() - 1]).contains(&at.len()) {
                try_knots(interpolation_knots(&at));
            }
        }
    }
}

impl Explanation for Straightness {
    fn describe(&self, _: &[f64]) -> String {
        format!("The guide of the {} axis is not straight.", self.along.name().to_uppercase())
    }

    fn next_test(&self) -> &'static str {
        "Turn the straight edge by 180° and measure again: what turns with it is the edge's."
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let mut fitted = self.clone();
        fitted.set_values(values);
        let entries = fitted.entries().into_iter();
        vec![FindingParameter::Record(
            "spline",
            entries.map(|(key, value)| (key, Some(value))).collect(),
        )]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_through_all_places_has_a_control_point_for_each_and_takes_any_values() {
        for at in [&[0.0, 10.0, 25.0, 40.0][..], &[0.0, 1.0, 7.0, 8.0, 20.0, 30.0]] {
            let knots_mm = interpolation_knots(at);
            assert_eq!(knots_mm.len() - 4, at.len());
            // Each control point weighs at its own place: the fit is determined.
            let spline = BSpline { order: 4, knots_mm, control_um: vec![0.0; at.len()] };
            for (place, &mm) in at.iter().enumerate() {
                let (first, weights) = spline_basis_values(&spline, mm);
                assert!((first..first + 4).contains(&place) && weights[place - first] > 0.01);
            }
        }
    }
}
