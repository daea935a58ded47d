//! `periodic-in-time`: it comes and goes with the clock: a chiller that switches, a lubrication pulse, a
//! hall that is heated at intervals.
//!
//! ```text
//! p + a·sin(2π·(t − start)/L + φ)
//! ```
//!
//! No board corrects it: the next record has another phase. Whatever drives it is to be recorded.

use std::f64::consts::TAU;

use super::{
    page::{Definition, Entry, Home, Input, Nonlinear, Page, Parameter, Value, number, positive},
    survey::{Reading, Settings, Survey},
    wave::{self, Wave},
};
use crate::{file::read::Section, location::BadInput};

/// One wave over the time.
#[derive(Clone, Debug, PartialEq)]
pub struct PeriodicInTime {
    /// L, in s; above 0.
    pub period_s: f64,
    /// Where φ is counted from: the first time of the record, since a clock may count from anywhere.
    pub start_s: f64,
    /// a, in µm, and φ.
    pub wave: Wave,
}

impl PeriodicInTime {
    fn neutral(start_s: f64) -> Self {
        Self { period_s: 1.0, start_s, wave: Wave::neutral(1) }
    }
}

impl Page for PeriodicInTime {
    fn entries(&self) -> Vec<Entry> {
        vec![
            ("period_s", Value::Number(self.period_s)),
            ("amplitude_um", Value::Number(self.wave.amplitude_um)),
            ("phase_deg", Value::Number(self.wave.phase_deg)),
            ("start_s", Value::Number(self.start_s)),
        ]
    }

    fn home(&self) -> Home {
        Home::Any
    }

    fn tier(&self) -> u8 {
        2
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Time]
    }

    fn is_compensated(&self) -> bool {
        false
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[Nonlinear::TimePeriod]
    }

    fn amplitudes(&self) -> usize {
        2
    }

    fn values(&self) -> Vec<f64> {
        [self.period_s].into_iter().chain(self.wave.values()).collect()
    }

    fn set(&mut self, values: &[f64]) {
        self.period_s = values[0];
        wave::set(std::slice::from_mut(&mut self.wave), &values[1..]);
    }

    fn sentence(&self, values: &[f64]) -> String {
        let size = values[1].hypot(values[2]);
        let period = match values[0] {
            s if s < 180.0 => format!("{s:.1} s"),
            s if s < 10_800.0 => format!("{:.1} min", s / 60.0),
            s => format!("{:.2} h", s / 3600.0),
        };
        format!("The error comes and goes every {period} with an amplitude of {size:.2} µm.")
    }

    fn next_test(&self) -> &'static str {
        "Find what switches or turns at this period (chiller, hall heating, lubrication, a door), and record it \
         as a column."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Waves("period_s", vec![1])]
    }
}

impl Definition for PeriodicInTime {
    const NAME: &'static str = "periodic-in-time";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["period_s", "amplitude_um", "phase_deg", "start_s"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self {
            period_s: positive(section, "period_s")?,
            start_s: section.number("start_s")?.unwrap_or(0.0),
            wave: Wave {
                harmonic: 1,
                amplitude_um: number(section, "amplitude_um")?,
                phase_deg: section.number("phase_deg")?.unwrap_or(0.0),
            },
        })
    }

    fn law(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let (sin, cos) = (TAU / nonlinear[0] * (x[0] - self.start_s)).sin_cos();
        add(0, sin);
        add(1, cos);
    }

    fn against(_: &str) -> Option<&'static str> {
        Some(
            "Repeat the run there and back, at another feed: what goes with the clock does not come back with \
             the place.",
        )
    }

    fn propose(survey: &dyn Survey, with: &mut dyn FnMut(Self, Settings)) {
        const FREQUENCIES: usize = 8000;
        /// What turns less often is a slow law of something else.
        const LEAST_TURNS: f64 = 3.0;
        const LEAST_GROUPS: usize = 40;
        if survey.time_s().is_none() || survey.groups() < LEAST_GROUPS || survey.files() > 1 {
            return;
        }
        if let Some(peak) = survey.peak(Reading::Time, LEAST_TURNS, FREQUENCIES) {
            with(Self::neutral(survey.start_s()), peak);
        }
    }
}
