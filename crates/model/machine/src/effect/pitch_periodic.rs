//! `pitch-periodic`: the error repeats with each turn of a screw, or with each graduation.
//!
//! ```text
//! p + Σ aᵢ·sin(2π·hᵢ·P/L + φᵢ)
//! ```

use std::f64::consts::TAU;

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, NonlinearParameter, PhysicalLaw, Target, TermEntry,
        Value, required_positive_number,
    },
    data_view::{DataView, SpectrumVariable, StartValues, find_distinct_values},
    wave::{self, Wave},
};
use crate::{
    keys::{
        reader::Section,
        term::{AMPLITUDE_UM, HARMONIC, PERIOD_MM, PHASE_DEG},
    },
    location::InputFileError,
    sections::LinearAxis,
};

/// Waves of one period.
#[derive(Clone, Debug, PartialEq)]
pub struct PitchPeriodic {
    /// L, in mm; above 0.
    pub period_mm: f64,
    /// The waves.
    pub waves: Vec<Wave>,
}

impl PitchPeriodic {
    fn neutral(harmonics: impl IntoIterator<Item = u32>) -> Self {
        Self { period_mm: 1.0, waves: harmonics.into_iter().map(Wave::neutral).collect() }
    }
}

impl FileRepresentation for PitchPeriodic {
    const NAME: &'static str = "pitch-periodic";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[PERIOD_MM.name, HARMONIC.name, AMPLITUDE_UM.name, PHASE_DEG.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        Ok(Self {
            period_mm: required_positive_number(section, PERIOD_MM)?,
            waves: section.required(AMPLITUDE_UM.name, wave::read(section)?)?,
        })
    }

    fn entries(&self) -> Vec<TermEntry> {
        let period_mm = (PERIOD_MM.name, Value::Number(self.period_mm));
        [period_mm].into_iter().chain(wave::entries(&self.waves)).collect()
    }
}

impl PhysicalLaw for PitchPeriodic {
    fn target(&self) -> Target {
        Target::Axis
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![LawInput::OwnPosition]
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        for (number, wave) in self.waves.iter().enumerate() {
            let turn = TAU * f64::from(wave.harmonic) / nonlinear[0];
            let (sin, cos) = (turn * x[0]).sin_cos();
            add(2 * number, sin);
            add(2 * number + 1, cos);
        }
    }
}

impl BoardRepresentation for PitchPeriodic {
    fn board_terms(&self) -> Vec<BoardTerm> {
        let period_mm = self.period_mm;
        let waves = self.waves.iter();
        waves
            .map(|&Wave { harmonic, amplitude_um, phase_deg }| BoardTerm::Wave {
                period_mm,
                harmonic,
                amplitude_um,
                phase_deg,
            })
            .collect()
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        match *form {
            BoardTerm::Wave { period_mm, harmonic, amplitude_um, phase_deg } => {
                Some(Self { period_mm, waves: vec![Wave { harmonic, amplitude_um, phase_deg }] })
            }
            _ => None,
        }
    }
}

impl Candidate for PitchPeriodic {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            nonlinear: &[NonlinearParameter::Period],
            amplitudes: 2 * self.waves.len(),
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        [self.period_mm]
            .into_iter()
            .chain(self.waves.iter().flat_map(Wave::sin_cos_amplitudes))
            .collect()
    }

    fn set_values(&mut self, values: &[f64]) {
        self.period_mm = values[0];
        wave::set_amplitudes(&mut self.waves, &values[1..]);
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        const FREQUENCY_COUNT: usize = 8000;
        // At the targets of a test, the same again and again, a short wave looks like many longer ones.
        const MIN_TARGET_POSITIONS: usize = 40;
        // Where the instrument has waves of its own, what is periodic may be its as well.
        if survey.quantity().axis().is_none() || survey.has_instrument_error() {
            return;
        }
        let places = find_distinct_values(survey.own_position_mm().unwrap_or(&[]), 1e-3);
        if places.len() < MIN_TARGET_POSITIONS {
            return;
        }
        let Some(peak) =
            survey.spectrum_peak_start_values(SpectrumVariable::Position, 2.0, FREQUENCY_COUNT)
        else {
            return;
        };
        // Whatever turns once in two, three or four of these periods is the same screw.
        if survey.has_cause(Self::NAME) {
            with(Self::neutral([1, 2]), peak);
            return;
        }
        for harmonics in 1..=3 {
            with(Self::neutral(1..=harmonics), peak.clone());
        }
        // The peak may be a harmonic of a turn that has all of them.
        let period_mm = peak.starts[0][0];
        let longest_mm = survey.longest_period_mm();
        let turns = (1..=6).map(|turns| f64::from(turns) * period_mm);
        let starts: Vec<_> = turns.filter(|mm| *mm <= longest_mm).map(|mm| vec![mm]).collect();
        if survey.group_count() > 600 {
            with(Self::neutral(1..=12), StartValues { starts, ..peak });
        }
    }
}

impl Explanation for PitchPeriodic {
    fn describe(&self, values: &[f64]) -> String {
        let (harmonic, size) = self
            .waves
            .iter()
            .zip(values[1..].chunks(2))
            .map(|(wave, pair)| (f64::from(wave.harmonic), pair[0].hypot(pair[1])))
            .fold((1.0, 0.0), |most, wave| if wave.1 > most.1 { wave } else { most });
        let period_mm = values[0] / harmonic;
        format!("The error repeats every {period_mm:.4} mm with an amplitude of {size:.2} µm.")
    }

    fn next_test(&self) -> &'static str {
        "Measure one turn of the screw in steps of a twentieth of the period, and a second turn \
         elsewhere. It must repeat with the same phase."
    }

    fn periodic_rival_in_one_pass(&self) -> Option<&'static str> {
        Some(super::PeriodicInTime::NAME)
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let harmonics = self.waves.iter().map(|wave| wave.harmonic).collect();
        let mut parameters = vec![FindingParameter::Waves("period_mm", harmonics)];
        if self.waves.len() > 1 {
            let mut fitted = self.clone();
            fitted.set_values(values);
            let records = fitted.waves.iter().copied().map(Wave::to_entries).collect();
            parameters.push(FindingParameter::Records("harmonics", records));
            parameters.push(FindingParameter::Stated("turn_mm", Value::Number(values[0])));
        }
        parameters
    }
}
