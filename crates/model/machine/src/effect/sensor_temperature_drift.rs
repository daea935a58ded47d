//! `sensor-temperature-drift`: the sensor follows its own temperature.
//!
//! ```text
//! p + c·(T − T_ref)          T the sensor's own temperature
//! ```

use super::{
    cause_spec::{CauseSpec, Definition, Entry, Heat, Input, OnBoard, Parameter, Target},
    data_view::{DataView, StartValues, spread},
    heat,
};
use crate::file::keys::term::{COLUMN, REFERENCE_C, TIME_CONSTANT_S, UM_PER_C};
use crate::file::table::{Table, entries};
use crate::{file::read::Section, location::BadInput};

/// Heat without a lag.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorTemperatureDrift(pub Heat);

impl CauseSpec for SensorTemperatureDrift {
    fn entries(&self) -> Vec<Entry> {
        entries(&self.0).into_iter().filter(|(key, _)| *key != TIME_CONSTANT_S.name).collect()
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        heat::inputs(&self.0, 0.0)
    }

    fn values(&self) -> Vec<f64> {
        vec![self.0.um_per_c]
    }

    fn set(&mut self, values: &[f64]) {
        self.0.um_per_c = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Heat(self.0.clone())]
    }

    fn has_reference(&self) -> bool {
        true
    }

    fn heat_mut(&mut self) -> Option<&mut Heat> {
        Some(&mut self.0)
    }

    fn sentence(&self, values: &[f64]) -> String {
        let (um_per_c, column) = (-values[0], &self.0.column);
        format!("The sensor shows {um_per_c:+.3} µm for each kelvin of its own {column}.")
    }

    fn next_test(&self) -> &'static str {
        "Warm the sensor alone in front of a target that stands still."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_c", 0, 0.0)]
    }
}

impl Definition for SensorTemperatureDrift {
    const NAME: &'static str = "sensor-temperature-drift";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[COLUMN.name, UM_PER_C.name, REFERENCE_C.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        // Without a time constant, which is no key of it.
        Heat::read(section).map(Self)
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0] - self.0.reference_c);
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(column) = heat::of_sensor(survey) else { return };
        if spread(survey.law()) > 0.0 && survey.varies(column) {
            with(Self(heat::neutral(survey, column, false)), StartValues::none());
        }
    }
}
