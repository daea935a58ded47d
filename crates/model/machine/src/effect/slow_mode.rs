//! `slow-mode`: a slow part of the growth.
//!
//! ```text
//! p + a·(1 − e^(−(t − start)/τ))          0 before the start
//! p + c·(lag_τ(T) − T_ref)                T a column that the model uses otherwise
//! ```

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, HeatPath, LawInput, NonlinearParameter, PhysicalLaw, Target,
        TemperatureResponse, TermEntry, format_duration,
    },
    data_view::{DataView, StartValues, TIME_CONSTANT_GRID_POINTS},
    temperature_columns,
};
use crate::{
    keys::{
        plausible_range::{GROWTH_SOURCE, NANOMETRES_HINT, PlausibleRange, range},
        reader::Section,
        table::{Table, entries, table},
        term::{AMPLITUDE_UM, COLUMN, REFERENCE_C, START_S, TIME_CONSTANT_S, UM_PER_C},
    },
    location::InputFileError,
    sections::LinearAxis,
};

/// A slow part, by the time or by a temperature.
#[derive(Clone, Debug, PartialEq)]
pub enum SlowMode {
    /// By the time.
    TimeDriven {
        /// a, in µm.
        amplitude_um: f64,
        /// τ, in s; above 0.
        time_constant_s: f64,
        /// The time of the start, in the run's `time_s`.
        start_s: f64,
    },
    /// By a temperature; τ above 0.
    ColumnDriven(TemperatureResponse),
}

table! {
    /// The keys of one by the time.
    struct TimeDrivenKeys {
        amplitude_um: f64 = AMPLITUDE_UM.with_value_type(Number).required();
        time_constant_s: f64 = TIME_CONSTANT_S.with_value_type(Positive).required();
        start_s: f64 = START_S.with_default("0.0");
    }
}

table! {
    /// The keys of one by a temperature: those of heat by a temperature, with a lag.
    struct ColumnDrivenKeys {
        column: String = COLUMN.with_value_type(Column).required();
        um_per_c: f64 = UM_PER_C.required();
        time_constant_s: f64 = TIME_CONSTANT_S.with_value_type(Positive).required();
        reference_c: f64 = REFERENCE_C.required();
    }
}

/// A slow part of the growth is not as large as a wave may be.
const AMPLITUDE_RANGE: PlausibleRange =
    range([-2e4, 2e4], [-500.0, 500.0], [-100.0, 100.0], GROWTH_SOURCE)
        .with_hint_above(NANOMETRES_HINT);

impl FileRepresentation for SlowMode {
    const NAME: &'static str = "slow-mode";

    fn range_override(key: &str) -> Option<PlausibleRange> {
        (key == AMPLITUDE_UM.name).then_some(AMPLITUDE_RANGE)
    }

    fn keys(section: &Section<'_>) -> &'static [&'static str] {
        if section.keys().contains(&COLUMN.name) {
            ColumnDrivenKeys::NAMES
        } else {
            TimeDrivenKeys::NAMES
        }
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        if section.text(COLUMN.name)?.is_none() {
            let TimeDrivenKeys { amplitude_um, time_constant_s, start_s } =
                TimeDrivenKeys::read(section)?;
            return Ok(Self::TimeDriven { amplitude_um, time_constant_s, start_s });
        }
        let ColumnDrivenKeys { column, um_per_c, time_constant_s, reference_c } =
            ColumnDrivenKeys::read(section)?;
        Ok(Self::ColumnDriven(TemperatureResponse {
            column,
            um_per_c,
            time_constant_s,
            reference_c,
        }))
    }

    fn entries(&self) -> Vec<TermEntry> {
        match self {
            Self::TimeDriven { amplitude_um, time_constant_s, start_s } => {
                entries(&TimeDrivenKeys {
                    amplitude_um: *amplitude_um,
                    time_constant_s: *time_constant_s,
                    start_s: *start_s,
                })
            }
            Self::ColumnDriven(heat) => entries(heat),
        }
    }
}

impl PhysicalLaw for SlowMode {
    fn target(&self) -> Target {
        Target::Heat
    }

    fn inputs(&self, nonlinear: &[f64]) -> Vec<LawInput<'_>> {
        match self {
            Self::TimeDriven { .. } => vec![LawInput::Time],
            Self::ColumnDriven(heat) => temperature_columns::temperature_inputs(heat, nonlinear[0]),
        }
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(
            0,
            match self {
                Self::TimeDriven { start_s, .. } => {
                    // NaN stays NaN, which max() would lose.
                    let since_s = x[0] - start_s;
                    let since_s = if since_s < 0.0 { 0.0 } else { since_s };
                    -(-since_s / nonlinear[0]).exp_m1()
                }
                Self::ColumnDriven(heat) => x[0] - heat.reference_c,
            },
        );
    }
}

impl BoardRepresentation for SlowMode {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![match *self {
            Self::TimeDriven { amplitude_um, time_constant_s, start_s } => {
                BoardTerm::Time { amplitude_um, time_constant_s, start_s }
            }
            Self::ColumnDriven(ref heat) => BoardTerm::Heat(heat.clone()),
        }]
    }

    fn temperature_response_mut(&mut self) -> Option<&mut TemperatureResponse> {
        match self {
            Self::TimeDriven { .. } => None,
            Self::ColumnDriven(heat) => Some(heat),
        }
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        match *form {
            BoardTerm::Time { amplitude_um, time_constant_s, start_s } => {
                Some(Self::TimeDriven { amplitude_um, time_constant_s, start_s })
            }
            _ => None,
        }
    }
}

impl Candidate for SlowMode {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            tier: 1,
            nonlinear: &[NonlinearParameter::TimeConstant],
            has_reference: true,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        match self {
            Self::TimeDriven { amplitude_um, time_constant_s, .. } => {
                vec![*time_constant_s, *amplitude_um]
            }
            Self::ColumnDriven(heat) => vec![heat.time_constant_s, heat.um_per_c],
        }
    }

    fn set_values(&mut self, values: &[f64]) {
        match self {
            Self::TimeDriven { amplitude_um, time_constant_s, .. } => {
                (*time_constant_s, *amplitude_um) = (values[0], values[1]);
            }
            Self::ColumnDriven(heat) => {
                (heat.time_constant_s, heat.um_per_c) = (values[0], values[1]);
            }
        }
    }

    fn heat_path(&self) -> Option<HeatPath<'_>> {
        match self {
            Self::TimeDriven { .. } => None,
            Self::ColumnDriven(heat) => {
                Some(HeatPath { column: &heat.column, is_second: true, has_lag: true })
            }
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        for (column, _) in temperature_columns::candidate_temperature_columns(survey)
            .into_iter()
            .filter(|(_, is_in_use)| *is_in_use)
        {
            let time_constants = survey.time_constant_start_values(TIME_CONSTANT_GRID_POINTS);
            with(
                Self::ColumnDriven(temperature_columns::neutral(survey, column, true)),
                time_constants,
            );
        }
        if survey.quantity().axis().is_none() && survey.time_range_s().is_some() {
            let start_s = survey.time_origin_s();
            let neutral = Self::TimeDriven { amplitude_um: 0.0, time_constant_s: 1.0, start_s };
            with(neutral, survey.time_constant_start_values(TIME_CONSTANT_GRID_POINTS));
        }
    }
}

impl Explanation for SlowMode {
    fn describe(&self, values: &[f64]) -> String {
        let behind = format_duration(values[0]);
        match self {
            Self::TimeDriven { .. } => format!(
                "In addition to the model, an unknown part grows by {:+.2} µm, with a time constant of \
                 {behind}.",
                values[1]
            ),
            Self::ColumnDriven(TemperatureResponse { column, .. }) => format!(
                "A second, slower path depends on {column}: {:+.3} µm/K behind {behind}.",
                values[1]
            ),
        }
    }

    fn next_test(&self) -> &'static str {
        "Record a run at least three times as long as the slow time constant, with a cool-down, \
         on another day. It must be predicted without a new fit."
    }

    fn distinguishing_test(_: &str) -> Option<&'static str> {
        Some(
            "Record a run with two heatings and a long cool-down in between, until nothing moves: \
             only then do two slow paths part.",
        )
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        let amplitude = match self {
            Self::TimeDriven { .. } => "amplitude_um",
            Self::ColumnDriven(_) => "um_per_c",
        };
        vec![
            FindingParameter::Fitted(amplitude, 1, 0.0),
            FindingParameter::Fitted("time_constant_s", 0, 0.0),
        ]
    }
}
