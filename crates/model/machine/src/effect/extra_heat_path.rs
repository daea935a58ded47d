//! `extra-heat-path`: heat that the model does not know, from a thermometer or from the spindle's speed.
//!
//! ```text
//! p + c·(lag_τ(T) − T_ref)          T a column that the model does not use, τ may be 0
//! p + c·lag_τ((n/1000)^a)           n the spindle's speed, a 1 or 2, cold (0) at the start
//! ```

use trueup_core::term::SpeedExponent;

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, HeatPath, LawInput, NonlinearParameter, PhysicalLaw,
        SpeedHeatResponse, Target, TemperatureResponse, TermEntry, Value, format_duration,
    },
    data_view::{DataView, StartValues, TIME_CONSTANT_GRID_POINTS},
    dependence::SPEED_COLUMN,
    temperature_columns,
};
use crate::{
    keys::{
        key::Key,
        reader::Section,
        table::{Table, entries, read_or_default},
        term::{COLUMN, INPUT, REFERENCE_C, TIME_CONSTANT_S, UM_PER_C, UM_PER_KRPM, UM_PER_KRPM2},
    },
    location::InputFileError,
    sections::{ElongationSource, LinearAxis},
};

/// The powers of the speed: the value of `input`, and the key of c.
const SPEED_EXPONENTS: [(SpeedExponent, &str, Key); 2] =
    [(SpeedExponent::Second, "speed2", UM_PER_KRPM2), (SpeedExponent::First, "speed", UM_PER_KRPM)];

/// Shortest time constant of heat of the speed in a search, in s: 0.2 m of cast iron settle in L²/(π²·a). A faster
/// effect is no heat, but any law of the speed.
const MIN_TIME_CONSTANT_S: f64 = 300.0;

/// Heat by a path of its own.
#[derive(Clone, Debug, PartialEq)]
pub enum ExtraHeatPath {
    /// Of a thermometer.
    OfTemperature(TemperatureResponse),
    /// Of the spindle's speed.
    OfSpeed(SpeedHeatResponse),
}

impl ExtraHeatPath {
    fn time_constant_s(&self) -> f64 {
        match self {
            Self::OfTemperature(heat) => heat.time_constant_s,
            Self::OfSpeed(heat) => heat.time_constant_s,
        }
    }

    fn has_lag(&self) -> bool {
        self.time_constant_s() != 0.0
    }

    fn column(&self) -> &str {
        match self {
            Self::OfTemperature(heat) => &heat.column,
            Self::OfSpeed(_) => SPEED_COLUMN,
        }
    }

    fn amplitude_key(&self) -> &'static str {
        match self {
            Self::OfTemperature(_) => UM_PER_C.name,
            Self::OfSpeed(heat) => input_name_and_key(heat.power)[1],
        }
    }
}

/// Returns the value of `input` and the key of c.
fn input_name_and_key(power: SpeedExponent) -> [&'static str; 2] {
    let of_it = SPEED_EXPONENTS.into_iter().filter(|(there, ..)| *there == power);
    of_it.fold([""; 2], |_, (_, input, key)| [input, key.name])
}

/// Returns the power of the speed that `section` is about: by `input`, else by the key of c.
fn infer_speed_exponent(section: &Section<'_>) -> SpeedExponent {
    let input = section.text(INPUT.name).ok().flatten();
    let keys = section.keys();
    let is_it = |(_, name, key): &(SpeedExponent, &str, Key)| match input {
        Some(input) => input == *name,
        None => keys.contains(&key.name),
    };
    SPEED_EXPONENTS.into_iter().find(is_it).map_or(SpeedExponent::Second, |(power, ..)| power)
}

/// Returns whether `section` is about the speed.
fn is_speed_driven(section: &Section<'_>) -> bool {
    let keys = section.keys();
    let is_own = |key: &&str| {
        *key == INPUT.name || SPEED_EXPONENTS.iter().any(|(.., amplitude)| *key == amplitude.name)
    };
    keys.iter().any(is_own)
        || section.text(COLUMN.name).is_ok_and(|column| column == Some(SPEED_COLUMN))
}

impl FileRepresentation for ExtraHeatPath {
    const NAME: &'static str = "extra-heat-path";

    fn keys(section: &Section<'_>) -> &'static [&'static str] {
        match (is_speed_driven(section), infer_speed_exponent(section)) {
            (false, _) => &[COLUMN.name, UM_PER_C.name, TIME_CONSTANT_S.name, REFERENCE_C.name],
            (_, SpeedExponent::First) => {
                &[COLUMN.name, INPUT.name, UM_PER_KRPM.name, TIME_CONSTANT_S.name]
            }
            (_, SpeedExponent::Second) => {
                &[COLUMN.name, INPUT.name, UM_PER_KRPM2.name, TIME_CONSTANT_S.name]
            }
        }
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        if !is_speed_driven(section) {
            return TemperatureResponse::read(section).map(Self::OfTemperature);
        }
        if section.required(COLUMN.name, section.text(COLUMN.name)?)? != SPEED_COLUMN {
            return Err(
                section.key_error(COLUMN.name, "must be \"spindle_rpm\" where the speed heats")
            );
        }
        let choices = SPEED_EXPONENTS.map(|(power, input, _)| (input, power));
        let power = section.choice(INPUT.name, &choices)?.unwrap_or(infer_speed_exponent(section));
        let [_, key] = input_name_and_key(power);
        Ok(Self::OfSpeed(SpeedHeatResponse {
            power,
            um_per_unit: section.required(key, section.number(key)?)?,
            time_constant_s: read_or_default(section, &TIME_CONSTANT_S.required())?,
        }))
    }

    fn entries(&self) -> Vec<TermEntry> {
        match self {
            Self::OfTemperature(heat) => entries(heat),
            Self::OfSpeed(heat) => {
                let [input, key] = input_name_and_key(heat.power);
                vec![
                    (COLUMN.name, Value::Text(SPEED_COLUMN.into())),
                    (INPUT.name, Value::Text(input.into())),
                    (key, Value::Number(heat.um_per_unit)),
                    (TIME_CONSTANT_S.name, Value::Number(heat.time_constant_s)),
                ]
            }
        }
    }
}

impl PhysicalLaw for ExtraHeatPath {
    fn target(&self) -> Target {
        Target::Heat
    }

    fn inputs(&self, nonlinear: &[f64]) -> Vec<LawInput<'_>> {
        let lag_s = nonlinear.first().copied().unwrap_or(0.0);
        match self {
            Self::OfTemperature(heat) => temperature_columns::temperature_inputs(heat, lag_s),
            Self::OfSpeed(heat) => vec![LawInput::SpeedHeat { power: heat.power, lag_s }],
        }
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(
            0,
            match self {
                Self::OfTemperature(heat) => x[0] - heat.reference_c,
                Self::OfSpeed(_) => x[0],
            },
        );
    }
}

impl BoardRepresentation for ExtraHeatPath {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![match self {
            Self::OfTemperature(heat) => BoardTerm::Heat(heat.clone()),
            Self::OfSpeed(heat) => BoardTerm::SpeedHeat(*heat),
        }]
    }

    fn temperature_response_mut(&mut self) -> Option<&mut TemperatureResponse> {
        match self {
            Self::OfTemperature(heat) => Some(heat),
            Self::OfSpeed(_) => None,
        }
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        match form {
            BoardTerm::Heat(heat) => Some(Self::OfTemperature(heat.clone())),
            BoardTerm::SpeedHeat(heat) => Some(Self::OfSpeed(*heat)),
            _ => None,
        }
    }
}

impl Candidate for ExtraHeatPath {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            tier: 1,
            nonlinear: if self.has_lag() { &[NonlinearParameter::TimeConstant] } else { &[] },
            nonlinear_parameter_bounds: {
                let is_slow = matches!(self, Self::OfSpeed(_)) && self.has_lag();
                is_slow.then_some([MIN_TIME_CONSTANT_S, f64::INFINITY])
            },
            has_reference: true,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        let lag_s = self.has_lag().then_some(self.time_constant_s());
        let amplitude = match self {
            Self::OfTemperature(heat) => heat.um_per_c,
            Self::OfSpeed(heat) => heat.um_per_unit,
        };
        lag_s.into_iter().chain([amplitude]).collect()
    }

    fn set_values(&mut self, values: &[f64]) {
        let (time_constant_s, amplitude) = match self {
            Self::OfTemperature(heat) => (&mut heat.time_constant_s, &mut heat.um_per_c),
            Self::OfSpeed(heat) => (&mut heat.time_constant_s, &mut heat.um_per_unit),
        };
        if let [lag_s, _] = *values {
            *time_constant_s = lag_s;
        }
        *amplitude = values[values.len() - 1];
    }

    fn heat_path(&self) -> Option<HeatPath<'_>> {
        let (column, has_lag) = (self.column(), self.has_lag());
        Some(HeatPath { column, is_second: false, has_lag })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        for (column, _) in temperature_columns::candidate_temperature_columns(survey)
            .into_iter()
            .filter(|(_, is_in_use)| !is_in_use)
        {
            let of = |has_lag| {
                Self::OfTemperature(temperature_columns::neutral(survey, column, has_lag))
            };
            with(of(false), StartValues::linear_only());
            with(of(true), survey.time_constant_start_values(TIME_CONSTANT_GRID_POINTS));
        }
        // Heat by the speed is what the warm-up model is: what is wrong with it has names of its own.
        let is_model =
            survey.has_elongation() && survey.elongation_source() == Some(ElongationSource::Warmup);
        if survey.is_varying(SPEED_COLUMN) && !survey.is_column_in_use(SPEED_COLUMN) && !is_model {
            let mut slow = survey.time_constant_start_values(TIME_CONSTANT_GRID_POINTS);
            slow.starts.retain(|start| start[0] >= MIN_TIME_CONSTANT_S);
            for (power, ..) in SPEED_EXPONENTS {
                let neutral = SpeedHeatResponse { power, um_per_unit: 0.0, time_constant_s: 1.0 };
                with(Self::OfSpeed(neutral), slow.clone());
            }
        }
    }
}

impl Explanation for ExtraHeatPath {
    fn describe(&self, values: &[f64]) -> String {
        let amplitude = values[values.len() - 1];
        let behind = if self.has_lag() {
            format!(", behind a time constant of {}", format_duration(values[0]))
        } else {
            String::new()
        };
        let how = match self {
            Self::OfTemperature(TemperatureResponse { column, .. }) => {
                format!("{amplitude:+.3} µm for each kelvin of {column}")
            }
            Self::OfSpeed(SpeedHeatResponse { power: SpeedExponent::First, .. }) => {
                format!("{amplitude:+.3} µm for each 1000 r/min of the spindle")
            }
            Self::OfSpeed(SpeedHeatResponse { power: SpeedExponent::Second, .. }) => {
                format!("{amplitude:+.3} µm for each (1000 r/min)² of the spindle")
            }
        };
        format!("Heat that the model does not know moves the tool: {how}{behind}.")
    }

    fn next_test(&self) -> &'static str {
        match self {
            Self::OfTemperature(_) => {
                "Record a run at least three times as long as the slow time constant, with a \
                 cool-down, on another day. It must be predicted without a new fit."
            }
            Self::OfSpeed(_) => {
                "Record another day from cold: two speeds, each for three time constants, and a \
                 cool-down after each: it must be predicted without a new fit."
            }
        }
    }

    fn distinguishing_test(alternative: &str) -> Option<&'static str> {
        (alternative == Self::NAME).then_some(
            "Warm the two places one after the other, not together; where one is the spindle's speed, \
             warm the other one with the spindle at rest.",
        )
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let amplitude = FindingParameter::Fitted(self.amplitude_key(), values.len() - 1, 0.0);
        let time_constant = if self.has_lag() {
            FindingParameter::Fitted("time_constant_s", 0, 0.0)
        } else {
            FindingParameter::Fixed("time_constant_s", 0.0)
        };
        let mut all = vec![amplitude, time_constant];
        if let Self::OfSpeed(heat) = self {
            all.push(FindingParameter::Stated(
                "input",
                Value::Text(input_name_and_key(heat.power)[0].into()),
            ));
        }
        all
    }
}
