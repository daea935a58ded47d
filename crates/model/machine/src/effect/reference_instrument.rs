//! `reference-instrument`: the reference instrument errs.
//!
//! ```text
//! p + Σ aᵢ·sin(2π·hᵢ·C/(P + P₀) + φᵢ)          with P₀, as an instrument that looks at an angle
//! p + Σ aᵢ·sin(2π·hᵢ·P/C + φᵢ)                 without
//! ```
//!
//! P is what the instrument reads: the position, or about what is predicted, or a column. Only of
//! the position is it known beforehand; else the term in a file says what was found, and adds
//! nothing.

use std::f64::consts::TAU;

use super::{
    cause_spec::{
        BoardRepresentation, Candidate, Explanation, FileRepresentation, FindingParameter, FitSpec,
        LawInput, NonlinearParameter, PhysicalLaw, Target, TermEntry, Value,
    },
    data_view::{DataView, SpectrumVariable, StartValues},
    wave::{self, Wave},
};
use crate::{
    keys::{
        reader::Section,
        term::{AMPLITUDE_UM, DESCRIPTION, HARMONIC, ORIGIN_MM, PERIOD_MM, PHASE_DEG},
    },
    location::InputFileError,
};

/// The variable of a wave.
#[derive(Clone, Debug, PartialEq)]
pub enum WaveVariable {
    /// The position of the own axis.
    Position,
    /// The elongation. The prediction is near the reading; the reading itself has its own
    /// noise in it, which a wave of the reading would follow.
    Elongation,
    /// A column of what was read: set up anew, an instrument reads another number at the same
    /// position.
    Column(String),
}

/// Waves of what the instrument reads.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceInstrument {
    /// For people.
    pub description: String,
    /// C, in mm: the period; with P₀ the phase's constant. Not used without waves.
    pub period_mm: f64,
    /// P₀, in mm.
    pub origin_mm: Option<f64>,
    /// The waves; may be empty.
    pub waves: Vec<Wave>,
    /// P.
    pub read: WaveVariable,
}

impl ReferenceInstrument {
    fn neutral(is_angled: bool, read: WaveVariable) -> Self {
        Self {
            description: String::new(),
            period_mm: 1.0,
            origin_mm: is_angled.then_some(0.0),
            waves: vec![Wave::neutral(1)],
            read,
        }
    }

    /// Returns what is wrong with it, for people.
    fn describe_error(&self, values: &[f64]) -> String {
        let start = self.fit_spec().nonlinear.len();
        let amplitude = values[start].hypot(values[start + 1]);
        if self.origin_mm.is_some() {
            format!(
                "the reference instrument's own error: a wave of {amplitude:.1} µm. Its period \
                 changes with the distance, as that of an instrument that looks at an angle"
            )
        } else {
            format!(
                "the reference instrument's own error: a wave of {amplitude:.2} µm that repeats \
                 every {:.3} µm of its reading",
                values[0]
            )
        }
    }
}

impl FileRepresentation for ReferenceInstrument {
    const NAME: &'static str = "reference-instrument";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[
            DESCRIPTION.name,
            PERIOD_MM.name,
            ORIGIN_MM.name,
            HARMONIC.name,
            AMPLITUDE_UM.name,
            PHASE_DEG.name,
        ]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        let waves = wave::read(section)?.unwrap_or_default();
        let period_mm = section.positive_number(PERIOD_MM.name)?;
        Ok(Self {
            description: section.text(DESCRIPTION.name)?.unwrap_or_default().to_string(),
            period_mm: if waves.is_empty() {
                period_mm.unwrap_or(1.0)
            } else {
                section.required(PERIOD_MM.name, period_mm)?
            },
            origin_mm: section.number(ORIGIN_MM.name)?,
            waves,
            read: WaveVariable::Position,
        })
    }

    fn entries(&self) -> Vec<TermEntry> {
        let mut entries = vec![(DESCRIPTION.name, Value::Text(self.description.clone()))];
        if !self.waves.is_empty() {
            entries.push((PERIOD_MM.name, Value::Number(self.period_mm)));
            entries.extend(self.origin_mm.map(|mm| (ORIGIN_MM.name, Value::Number(mm))));
            entries.extend(wave::entries(&self.waves));
        }
        entries
    }
}

impl PhysicalLaw for ReferenceInstrument {
    fn target(&self) -> Target {
        Target::Any
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        match &self.read {
            _ if self.waves.is_empty() => Vec::new(),
            WaveVariable::Position => vec![LawInput::OwnPosition],
            WaveVariable::Elongation => vec![LawInput::Believed],
            WaveVariable::Column(column) => vec![LawInput::Column(column)],
        }
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        for (number, wave) in self.waves.iter().enumerate() {
            let turns = match *nonlinear {
                [constant, origin] => constant / (x[0] + origin),
                _ => x[0] / nonlinear[0],
            };
            let turns = f64::from(wave.harmonic) * turns;
            let (sin, cos) = (TAU * turns).sin_cos();
            add(2 * number, sin);
            add(2 * number + 1, cos);
        }
    }
}

impl BoardRepresentation for ReferenceInstrument {
    fn is_compensable(&self) -> bool {
        false
    }
}

impl Candidate for ReferenceInstrument {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            tier: 2,
            nonlinear: if self.origin_mm.is_some() {
                &[NonlinearParameter::ReadingPeriod, NonlinearParameter::Origin]
            } else {
                &[NonlinearParameter::ReadingPeriod]
            },
            amplitudes: 2 * self.waves.len(),
            is_of_instrument: true,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        let nonlinear = [self.period_mm].into_iter().chain(self.origin_mm);
        nonlinear.chain(self.waves.iter().flat_map(Wave::sin_cos_amplitudes)).collect()
    }

    fn set_values(&mut self, values: &[f64]) {
        let start = self.fit_spec().nonlinear.len();
        self.description = self.describe_error(values);
        self.period_mm = values[0];
        if self.read == WaveVariable::Position {
            self.origin_mm = self.origin_mm.map(|_| values[1]);
            wave::set_amplitudes(&mut self.waves, &values[start..]);
        } else {
            self.origin_mm = None;
            self.waves.clear();
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        const FREQUENCY_COUNT: usize = 2000;
        if survey.quantity().axis().is_none() {
            // Less than three turns are a curve, and may be the sensor's.
            if let Some(peak) = survey.spectrum_peak_start_values(
                SpectrumVariable::Elongation,
                3.0,
                FREQUENCY_COUNT,
            ) {
                with(Self::neutral(false, WaveVariable::Elongation), peak);
            }
            return;
        }
        if survey.own_position_mm().is_none() || survey.has_cause(Self::NAME) {
            return;
        }
        let mut angled = |reading: SpectrumVariable<'_>, read: WaveVariable| {
            if let Some(peak) = survey.reciprocal_wave_start_values(reading) {
                with(Self::neutral(true, read), peak);
            }
        };
        angled(SpectrumVariable::Position, WaveVariable::Position);
        for column in survey.unknown_columns().into_iter().filter(|name| name.ends_with("_mm")) {
            angled(SpectrumVariable::Column(column), WaveVariable::Column(column.into()));
        }
    }
}

impl Explanation for ReferenceInstrument {
    fn describe(&self, values: &[f64]) -> String {
        let text = self.describe_error(values);
        format!("It is {text}. The machine is not to be compensated for it.")
    }

    fn next_test(&self) -> &'static str {
        "Measure again with another instrument, or with this one shifted by a third of its period: \
         what shifts with it is its own."
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let description = Value::Text(self.describe_error(values));
        vec![
            FindingParameter::Waves("period_mm", vec![1]),
            FindingParameter::Stated("description", description),
        ]
    }
}
