//! `slow-mode`: a slow part of the growth.
//!
//! ```text
//! p + a·(1 − e^(−(t − start)/τ))          0 before the start
//! p + c·(lag_τ(T) − T_ref)                T a column that the model uses otherwise
//! ```

use super::{
    cause_spec::{
        CauseSpec, Definition, Entry, Heat, HeatPath, Input, Nonlinear, OnBoard, Parameter, Target,
        minutes,
    },
    data_view::{DataView, StartValues, TIME_CONSTANTS},
    heat,
};
use crate::file::keys::term::{
    AMPLITUDE_UM, COLUMN, REFERENCE_C, START_S, TIME_CONSTANT_S, UM_PER_C,
};
use crate::file::table::{Table, entries, table};
use crate::{file::axis::LinearAxis, file::read::Section, location::BadInput};

/// A slow part, by the time or by a temperature.
#[derive(Clone, Debug, PartialEq)]
pub enum SlowMode {
    /// By the time.
    InTime {
        /// a, in µm.
        amplitude_um: f64,
        /// τ, in s; above 0.
        time_constant_s: f64,
        /// The time of the start, in the run's `time_s`.
        start_s: f64,
    },
    /// By a temperature; τ above 0.
    OfColumn(Heat),
}

table! {
    /// The keys of one by the time.
    struct InTime {
        amplitude_um: f64 = AMPLITUDE_UM.of(Number).required();
        time_constant_s: f64 = TIME_CONSTANT_S.of(Positive).required();
        start_s: f64 = START_S.or("0.0");
    }
}

table! {
    /// The keys of one by a temperature: those of [`Heat`], with a lag.
    struct OfColumn {
        column: String = COLUMN.of(Column).required();
        um_per_c: f64 = UM_PER_C.required();
        time_constant_s: f64 = TIME_CONSTANT_S.of(Positive).required();
        reference_c: f64 = REFERENCE_C.required();
    }
}

impl CauseSpec for SlowMode {
    fn entries(&self) -> Vec<Entry> {
        match self {
            Self::InTime { amplitude_um, time_constant_s, start_s } => entries(&InTime {
                amplitude_um: *amplitude_um,
                time_constant_s: *time_constant_s,
                start_s: *start_s,
            }),
            Self::OfColumn(heat) => entries(heat),
        }
    }

    fn home(&self) -> Target {
        Target::Heat
    }

    fn tier(&self) -> u8 {
        1
    }

    fn inputs(&self, nonlinear: &[f64]) -> Vec<Input<'_>> {
        match self {
            Self::InTime { .. } => vec![Input::Time],
            Self::OfColumn(heat) => heat::inputs(heat, nonlinear[0]),
        }
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[Nonlinear::TimeConstant]
    }

    fn values(&self) -> Vec<f64> {
        match self {
            Self::InTime { amplitude_um, time_constant_s, .. } => {
                vec![*time_constant_s, *amplitude_um]
            }
            Self::OfColumn(heat) => vec![heat.time_constant_s, heat.um_per_c],
        }
    }

    fn set(&mut self, values: &[f64]) {
        match self {
            Self::InTime { amplitude_um, time_constant_s, .. } => {
                (*time_constant_s, *amplitude_um) = (values[0], values[1]);
            }
            Self::OfColumn(heat) => {
                (heat.time_constant_s, heat.um_per_c) = (values[0], values[1]);
            }
        }
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![match *self {
            Self::InTime { amplitude_um, time_constant_s, start_s } => {
                OnBoard::Time { amplitude_um, time_constant_s, start_s }
            }
            Self::OfColumn(ref heat) => OnBoard::Heat(heat.clone()),
        }]
    }

    fn has_reference(&self) -> bool {
        true
    }

    fn heat_mut(&mut self) -> Option<&mut Heat> {
        match self {
            Self::InTime { .. } => None,
            Self::OfColumn(heat) => Some(heat),
        }
    }

    fn heat_path(&self) -> Option<HeatPath<'_>> {
        match self {
            Self::InTime { .. } => None,
            Self::OfColumn(heat) => {
                Some(HeatPath { column: &heat.column, is_second: true, has_lag: true })
            }
        }
    }

    fn sentence(&self, values: &[f64]) -> String {
        let behind = minutes(values[0]);
        match self {
            Self::InTime { .. } => format!(
                "Beside what the model knows something grows by {:+.2} µm, with a time constant of \
                 {behind}.",
                values[1]
            ),
            Self::OfColumn(Heat { column, .. }) => format!(
                "A second, slower path goes with {column}: {:+.3} µm/K behind {behind}.",
                values[1]
            ),
        }
    }

    fn next_test(&self) -> &'static str {
        "Record a run at least three times as long as the slow time constant, with a cool-down, on \
         another day: it must be predicted without a new fit."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        let amplitude = match self {
            Self::InTime { .. } => "amplitude_um",
            Self::OfColumn(_) => "um_per_c",
        };
        vec![Parameter::Fitted(amplitude, 1, 0.0), Parameter::Fitted("time_constant_s", 0, 0.0)]
    }
}

impl Definition for SlowMode {
    const NAME: &'static str = "slow-mode";

    fn keys(section: &Section<'_>) -> &'static [&'static str] {
        if section.keys().contains(&COLUMN.name) { OfColumn::NAMES } else { InTime::NAMES }
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        if section.text(COLUMN.name)?.is_none() {
            let InTime { amplitude_um, time_constant_s, start_s } = InTime::read(section)?;
            return Ok(Self::InTime { amplitude_um, time_constant_s, start_s });
        }
        let OfColumn { column, um_per_c, time_constant_s, reference_c } = OfColumn::read(section)?;
        Ok(Self::OfColumn(Heat { column, um_per_c, time_constant_s, reference_c }))
    }

    fn law(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(
            0,
            match self {
                Self::InTime { start_s, .. } => {
                    // NaN stays NaN, which max() would lose.
                    let since_s = x[0] - start_s;
                    let since_s = if since_s < 0.0 { 0.0 } else { since_s };
                    -(-since_s / nonlinear[0]).exp_m1()
                }
                Self::OfColumn(heat) => x[0] - heat.reference_c,
            },
        );
    }

    fn from_board(_: Option<LinearAxis>, form: &OnBoard, _: &mut f64) -> Option<Self> {
        match *form {
            OnBoard::Time { amplitude_um, time_constant_s, start_s } => {
                Some(Self::InTime { amplitude_um, time_constant_s, start_s })
            }
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        for (column, _) in heat::columns(survey).into_iter().filter(|(_, is_in_use)| *is_in_use) {
            let time_constants = survey.time_constants(TIME_CONSTANTS);
            with(Self::OfColumn(heat::neutral(survey, column, true)), time_constants);
        }
        if survey.quantity().axis().is_none() && survey.time_s().is_some() {
            let start_s = survey.start_s();
            let neutral = Self::InTime { amplitude_um: 0.0, time_constant_s: 1.0, start_s };
            with(neutral, survey.time_constants(TIME_CONSTANTS));
        }
    }

    fn against(_: &str) -> Option<&'static str> {
        Some(
            "Record a run with two heatings and a long cool-down in between, until nothing moves: \
             only then do two slow paths part.",
        )
    }
}
