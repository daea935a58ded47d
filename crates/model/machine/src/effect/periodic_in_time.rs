//! `periodic-in-time`: it comes and goes at fixed intervals: a chiller that switches, a lubrication pulse, a
//! hall that is heated at intervals.
//!
//! ```text
//! p + a·sin(2π·(t − start)/L + φ)
//! ```
//!
//! No board corrects it: the next record has another phase. Whatever drives it is to be recorded.

use std::f64::consts::TAU;

use super::{
    cause_spec::{
        BoardRepresentation, Candidate, Explanation, FileRepresentation, FindingParameter, FitSpec,
        LawInput, NonlinearParameter, PhysicalLaw, Target, TermEntry, Value, required_number,
        required_positive_number,
    },
    data_view::{DataView, SpectrumVariable, StartValues},
    wave::{self, Wave},
};
use crate::{
    keys::{
        reader::Section,
        term::{AMPLITUDE_UM, PERIOD_S, PHASE_DEG, START_S},
    },
    location::InputFileError,
};

/// Readings in a turn, at least: what alternates from reading to reading is the way in which they are taken.
pub const MIN_READINGS_PER_PERIOD: f64 = 10.0;
/// Turns in a record: a wave of fewer is a slow law of something else.
pub const MIN_CYCLES: f64 = 3.0;

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

impl FileRepresentation for PeriodicInTime {
    const NAME: &'static str = "periodic-in-time";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[PERIOD_S.name, AMPLITUDE_UM.name, PHASE_DEG.name, START_S.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        Ok(Self {
            period_s: required_positive_number(section, PERIOD_S)?,
            start_s: section.number(START_S.name)?.unwrap_or(0.0),
            wave: Wave {
                harmonic: 1,
                amplitude_um: required_number(section, AMPLITUDE_UM)?,
                phase_deg: section.number(PHASE_DEG.name)?.unwrap_or(0.0),
            },
        })
    }

    fn entries(&self) -> Vec<TermEntry> {
        vec![
            (PERIOD_S.name, Value::Number(self.period_s)),
            (AMPLITUDE_UM.name, Value::Number(self.wave.amplitude_um)),
            (PHASE_DEG.name, Value::Number(self.wave.phase_deg)),
            (START_S.name, Value::Number(self.start_s)),
        ]
    }
}

impl PhysicalLaw for PeriodicInTime {
    fn target(&self) -> Target {
        Target::Any
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![LawInput::Time]
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let (sin, cos) = (TAU / nonlinear[0] * (x[0] - self.start_s)).sin_cos();
        add(0, sin);
        add(1, cos);
    }
}

impl BoardRepresentation for PeriodicInTime {
    fn is_compensable(&self) -> bool {
        false
    }
}

impl Candidate for PeriodicInTime {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            tier: 2,
            nonlinear: &[NonlinearParameter::TimePeriod],
            amplitudes: 2,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        [self.period_s].into_iter().chain(self.wave.sin_cos_amplitudes()).collect()
    }

    fn set_values(&mut self, values: &[f64]) {
        self.period_s = values[0];
        wave::set_amplitudes(std::slice::from_mut(&mut self.wave), &values[1..]);
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        const FREQUENCY_COUNT: usize = 8000;
        const MIN_FITTED_GROUPS: usize = 40;
        let Some([first_s, last_s]) = survey.time_range_s() else { return };
        if survey.group_count() < MIN_FITTED_GROUPS || survey.file_count() > 1 {
            return;
        }
        let shortest_s = MIN_READINGS_PER_PERIOD * (last_s - first_s) / survey.group_count() as f64;
        if let Some(peak) =
            survey.spectrum_peak_start_values(SpectrumVariable::Time, MIN_CYCLES, FREQUENCY_COUNT)
            && peak.starts[0][0] >= shortest_s
            && !any_input_has_period(survey, peak.starts[0][0])
        {
            with(Self::neutral(survey.time_origin_s()), peak);
        }
    }
}

impl Explanation for PeriodicInTime {
    fn describe(&self, values: &[f64]) -> String {
        let size = values[1].hypot(values[2]);
        let period = match values[0] {
            s if s < 180.0 => format!("{s:.1} s"),
            s if s < 10_800.0 => format!("{:.1} min", s / 60.0),
            s => format!("{:.2} h", s / 3600.0),
        };
        format!("The error has a period of {period} with an amplitude of {size:.2} µm.")
    }

    fn next_test(&self) -> &'static str {
        "Find what switches or turns at this period (chiller, hall heating, lubrication, a door), and record it \
         as a column."
    }

    fn distinguishing_test(_: &str) -> Option<&'static str> {
        Some(
            "Repeat the run there and back, at another feed: an error that is periodic in time does not return at the same position.",
        )
    }

    fn periodic_rival_in_one_pass(&self) -> Option<&'static str> {
        Some(super::PitchPeriodic::NAME)
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        vec![FindingParameter::Waves("period_s", vec![1])]
    }
}

/// Returns true where something that was recorded has this period too, or with one that the record hardly
/// shows apart: a law of that input that changes in the record has such periods next to the input's own.
fn any_input_has_period(survey: &dyn DataView, period_s: f64) -> bool {
    /// Share of an input's squares that is of this period.
    const MIN_VARIANCE_FRACTION: f64 = 0.25;
    /// Turns in the record, more and fewer.
    const CYCLE_OFFSETS: [f64; 7] = [-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5];
    let (Some(time_s), Some([first_s, last_s])) = (survey.column("time_s"), survey.time_range_s())
    else {
        return false;
    };
    let near = |turns: f64| 1.0 / (1.0 / period_s + turns / (last_s - first_s));
    let periods: Vec<f64> = CYCLE_OFFSETS.map(near).into_iter().filter(|s| *s > 0.0).collect();
    let known = ["spindle_rpm", "load_n", "x_mm", "y_mm", "z_mm"];
    let names =
        survey.temperature_columns().into_iter().chain(survey.unknown_columns()).chain(known);
    names.filter_map(|name| survey.column(name)).any(|values| {
        periods
            .iter()
            .any(|s| periodic_variance_fraction(time_s, values, *s) > MIN_VARIANCE_FRACTION)
    })
}

/// Returns the share of the squares of `values` about their mean that a wave of this period has, 0…1.
fn periodic_variance_fraction(time_s: &[f64], values: &[f64], period_s: f64) -> f64 {
    let rows = || time_s.iter().zip(values).filter(|(t, v)| t.is_finite() && v.is_finite());
    let count = rows().count() as f64;
    let mean = rows().map(|(_, value)| value).sum::<f64>() / count;
    let start_s = time_s.iter().copied().find(|t| t.is_finite()).unwrap_or(0.0);
    let [mut all, mut sine, mut cosine] = [0.0; 3];
    for (time, value) in rows() {
        let (sin, cos) = (TAU * (time - start_s) / period_s).sin_cos();
        let off = value - mean;
        all += off * off;
        sine += off * sin;
        cosine += off * cos;
    }
    // Of whole turns the squares of a sine sum to half of the rows.
    if all > 0.0 { 2.0 * (sine * sine + cosine * cosine) / (count * all) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_of_the_same_period_is_known_by_its_share() {
        let time_s: Vec<f64> = (0..600).map(|row| 1.7e9 + 10.0 * f64::from(row)).collect();
        let wave = |period: f64| -> Vec<f64> {
            time_s.iter().map(|t| 20.0 + (TAU * (t - 1.7e9) / period + 0.7).sin()).collect()
        };
        let share = |period: f64| periodic_variance_fraction(&time_s, &wave(period), 600.0);
        assert!((share(600.0) - 1.0).abs() < 1e-6 && share(300.0) < 1e-6, "{}", share(600.0));
        assert_eq!(periodic_variance_fraction(&time_s, &vec![3.0; 600], 600.0), 0.0);
    }
}
