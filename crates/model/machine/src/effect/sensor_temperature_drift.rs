//! `sensor-temperature-drift`: the sensor follows its own temperature.
//!
//! ```text
//! p + c·(T − T_ref)          T the sensor's own temperature
//! ```

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, PhysicalLaw, Target, TemperatureResponse, TermEntry,
    },
    data_view::{DataView, StartValues, peak_to_peak},
    temperature_columns,
};
use crate::{
    keys::{
        reader::Section,
        table::{Table, entries},
        term::{COLUMN, REFERENCE_C, TIME_CONSTANT_S, UM_PER_C},
    },
    location::InputFileError,
};

/// Heat without a lag.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorTemperatureDrift(pub TemperatureResponse);

impl FileRepresentation for SensorTemperatureDrift {
    const NAME: &'static str = "sensor-temperature-drift";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[COLUMN.name, UM_PER_C.name, REFERENCE_C.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        // Without a time constant, which is no key of it.
        TemperatureResponse::read(section).map(Self)
    }

    fn entries(&self) -> Vec<TermEntry> {
        entries(&self.0).into_iter().filter(|(key, _)| *key != TIME_CONSTANT_S.name).collect()
    }
}

impl PhysicalLaw for SensorTemperatureDrift {
    fn target(&self) -> Target {
        Target::Elongation
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        temperature_columns::temperature_inputs(&self.0, 0.0)
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0] - self.0.reference_c);
    }
}

impl BoardRepresentation for SensorTemperatureDrift {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![BoardTerm::Heat(self.0.clone())]
    }

    fn temperature_response_mut(&mut self) -> Option<&mut TemperatureResponse> {
        Some(&mut self.0)
    }
}

impl Candidate for SensorTemperatureDrift {
    fn fit_spec(&self) -> FitSpec {
        FitSpec { has_reference: true, ..FitSpec::DEFAULT }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.0.um_per_c]
    }

    fn set_values(&mut self, values: &[f64]) {
        self.0.um_per_c = values[0];
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(column) = temperature_columns::sensor_temperature_column(survey) else { return };
        if peak_to_peak(survey.source_elongation_um()) > 0.0 && survey.is_varying(column) {
            with(
                Self(temperature_columns::neutral(survey, column, false)),
                StartValues::linear_only(),
            );
        }
    }
}

impl Explanation for SensorTemperatureDrift {
    fn describe(&self, values: &[f64]) -> String {
        let (um_per_c, column) = (-values[0], &self.0.column);
        format!("The sensor shows {um_per_c:+.3} µm for each kelvin of its own {column}.")
    }

    fn next_test(&self) -> &'static str {
        "Warm the sensor alone in front of a target that stands still."
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        vec![FindingParameter::Fitted("um_per_c", 0, 0.0)]
    }
}
