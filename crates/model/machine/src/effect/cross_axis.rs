//! `cross-axis`: another axis, as it moves, tilts or shifts this one.
//!
//! ```text
//! p + c·P/1000          P of another axis
//! ```

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, PhysicalLaw, Target, TermContext, TermEntry, Value,
    },
    data_view::{DataView, StartValues},
};
use crate::{
    keys::{
        reader::Section,
        table::{Table, entries, table},
        term::{AXIS, UM_PER_M},
    },
    location::InputFileError,
    sections::LinearAxis,
};

table! {
    /// A slope along another axis.
    #[derive(Clone, Debug, PartialEq)]
    pub struct CrossAxis {
        /// The axis that moves.
        axis: LinearAxis = AXIS.required();
        /// c, in µm/m.
        um_per_m: f64 = UM_PER_M.required();
    }
}

impl FileRepresentation for CrossAxis {
    const NAME: &'static str = "cross-axis";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[UM_PER_M.name, AXIS.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        Table::read(section)
    }

    fn entries(&self) -> Vec<TermEntry> {
        entries(self)
    }
}

impl PhysicalLaw for CrossAxis {
    fn target(&self) -> Target {
        Target::Axis
    }

    fn refusal(&self, host: &TermContext<'_>) -> Option<String> {
        (host.quantity.axis() == Some(self.axis))
            .then(|| "is the error of another axis than the one that moves".into())
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![LawInput::Position(self.axis)]
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0] / 1000.0);
    }
}

impl BoardRepresentation for CrossAxis {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![BoardTerm::Position { axis: self.axis, um_per_m: self.um_per_m }]
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        match *form {
            BoardTerm::Position { axis, um_per_m } => Some(Self { axis, um_per_m }),
            _ => None,
        }
    }
}

impl Candidate for CrossAxis {
    fn fit_spec(&self) -> FitSpec {
        FitSpec { tier: 1, ..FitSpec::DEFAULT }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.um_per_m]
    }

    fn set_values(&mut self, values: &[f64]) {
        self.um_per_m = values[0];
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        for axis in survey.other_moving_axes() {
            with(Self { axis, um_per_m: 0.0 }, StartValues::linear_only());
        }
    }
}

impl Explanation for CrossAxis {
    fn describe(&self, values: &[f64]) -> String {
        let axis = self.axis.name().to_uppercase();
        format!("The axis moves by {:+.2} µm for each metre of {axis}.", values[0])
    }

    fn next_test(&self) -> &'static str {
        "Turn the straight edge by 180° and measure again: what turns with it is the edge's."
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        let axis = Value::Text(self.axis.name().into());
        vec![FindingParameter::Fitted("um_per_m", 0, 0.0), FindingParameter::Stated("axis", axis)]
    }
}
