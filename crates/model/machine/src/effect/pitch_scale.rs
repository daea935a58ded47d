//! `pitch-scale`: the scale or the screw is long or short.
//!
//! ```text
//! p + c·P/1000
//! ```

use super::{
    cause_spec::{CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Target, Value, number},
    data_view::{DataView, StartValues},
};
use crate::{file::axis::LinearAxis, file::read::Section, location::BadInput};

/// A slope along the own axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PitchScale {
    /// c, in µm/m.
    pub um_per_m: f64,
}

impl CauseSpec for PitchScale {
    fn entries(&self) -> Vec<Entry> {
        vec![("um_per_m", Value::Number(self.um_per_m))]
    }

    fn home(&self) -> Target {
        Target::Axis
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::OwnPosition]
    }

    fn values(&self) -> Vec<f64> {
        vec![self.um_per_m]
    }

    fn set(&mut self, values: &[f64]) {
        self.um_per_m = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        // The constant alone.
        if self.um_per_m == 0.0 {
            return Vec::new();
        }
        vec![OnBoard::OwnPosition(self.um_per_m)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The scale or the screw is off by {:+.2} µm for each metre.", values[0])
    }

    fn next_test(&self) -> &'static str {
        "Measure once more by ISO 230-2 at targets that are no multiples of the screw's pitch."
    }

    fn repair(&self) -> Option<&'static str> {
        Some(
            "Before you correct it, look at what can be repaired: the pretension of a screw between two bearings, and a \
             screw or scale that is not parallel to the guide.",
        )
    }

    fn same_in_one_pass(&self) -> Option<&'static str> {
        Some(super::Drift::NAME)
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_m", 0, 0.0)]
    }
}

impl Definition for PitchScale {
    const NAME: &'static str = "pitch-scale";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["um_per_m"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { um_per_m: number(section, "um_per_m")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0] / 1000.0);
    }

    fn from_board(own: Option<LinearAxis>, form: &OnBoard, constant_um: &mut f64) -> Option<Self> {
        match form {
            // The constant alone.
            OnBoard::Offset(um) if own.is_some() => {
                *constant_um += um;
                Some(Self::default())
            }
            OnBoard::OwnPosition(um_per_m) => Some(Self { um_per_m: *um_per_m }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.moves() {
            with(Self::default(), StartValues::none());
        }
    }

    fn against(rival: &str) -> Option<&'static str> {
        match rival {
            "reference-temperature" => Some(
                "While the expansion is linear both are the same error for each metre at every temperature: no measurement of \
                 the axis distinguishes them, and either correction removes it. Look where the reference temperature comes \
                 from (20 °C by ISO 1), and measure a certified length to know whether the scale is right.",
            ),
            "expansion-slope" => Some(
                "Measure the axis cold and warm: a scale stays, an expansion grows with temperature.",
            ),
            _ => None,
        }
    }
}
