//! Waves of a periodic error: what the causes have in common that have some.

use super::cause_spec::{TermEntry, Value};
use crate::{
    keys::{
        reader::Section,
        term::{AMPLITUDE_UM, HARMONIC, PHASE_DEG},
    },
    location::InputFileError,
};

/// One wave of a periodic error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// h: how often in a period; 1 to 1000.
    pub harmonic: u32,
    /// a, in µm.
    pub amplitude_um: f64,
    /// φ, in degrees.
    pub phase_deg: f64,
}

impl Wave {
    /// Returns one that is not there yet.
    pub(crate) fn neutral(harmonic: u32) -> Self {
        Self { harmonic, amplitude_um: 0.0, phase_deg: 0.0 }
    }

    /// Its sine's and its cosine's amplitude.
    pub(crate) fn sin_cos_amplitudes(&self) -> [f64; 2] {
        let (sin, cos) = self.phase_deg.to_radians().sin_cos();
        [self.amplitude_um * cos, self.amplitude_um * sin]
    }

    pub(crate) fn to_entries(self) -> Vec<TermEntry> {
        vec![
            (HARMONIC.name, Value::Whole(self.harmonic)),
            (AMPLITUDE_UM.name, Value::Number(self.amplitude_um)),
            (PHASE_DEG.name, Value::Number(self.phase_deg)),
        ]
    }
}

/// Puts a·sin + b·cos in, two values a wave.
pub(crate) fn set_amplitudes(waves: &mut [Wave], values: &[f64]) {
    for (wave, pair) in waves.iter_mut().zip(values.chunks(2)) {
        wave.amplitude_um = pair[0].hypot(pair[1]);
        wave.phase_deg = pair[1].atan2(pair[0]).to_degrees();
    }
}

pub(crate) fn entries(waves: &[Wave]) -> [TermEntry; 3] {
    let list = |of: fn(&Wave) -> f64| Value::Numbers(waves.iter().map(of).collect());
    [
        (HARMONIC.name, Value::Wholes(waves.iter().map(|wave| wave.harmonic).collect())),
        (AMPLITUDE_UM.name, list(|wave| wave.amplitude_um)),
        (PHASE_DEG.name, list(|wave| wave.phase_deg)),
    ]
}

/// `harmonic`, `amplitude_um` and `phase_deg`: three numbers of one wave, or three arrays.
pub(crate) fn read(section: &Section<'_>) -> Result<Option<Vec<Wave>>, InputFileError> {
    let Some(amplitudes) = section.number_or_numbers(AMPLITUDE_UM.name)? else { return Ok(None) };
    let alike = |key, or: fn(usize) -> f64| {
        let values = section.number_or_numbers(key)?;
        let values = values.unwrap_or_else(|| (0..amplitudes.len()).map(or).collect());
        if values.len() == amplitudes.len() {
            return Ok(values);
        }
        let rule = format!(
            "has {} elements, but amplitude_um has {}: one of each for a wave",
            values.len(),
            amplitudes.len()
        );
        Err(section.key_error(key, rule))
    };
    let harmonics = alike(HARMONIC.name, |index| (index + 1) as f64)?;
    let phases = alike(PHASE_DEG.name, |_| 0.0)?;
    let mut waves = Vec::new();
    for ((&harmonic, &amplitude_um), &phase_deg) in harmonics.iter().zip(&amplitudes).zip(&phases) {
        if harmonic.fract() != 0.0 || !(1.0..=1000.0).contains(&harmonic) {
            let rule = format!("must be whole numbers from 1 to 1000, not {harmonic}");
            return Err(section.key_error(HARMONIC.name, rule));
        }
        // Held to 1000 above.
        waves.push(Wave { harmonic: harmonic as u32, amplitude_um, phase_deg });
    }
    Ok(Some(waves))
}
