//! Position tables.

use trueup_core::{
    pitch_table::PitchErrorTable,
    reversal::{Fraction, Interval},
    units::Position,
};

use crate::{
    machine_file, model,
    unit_conversion::{
        FINE_UNITS_PER_UM, NM_PER_UM, POSITION_UNITS_PER_MM, round_to_i32, round_to_u32,
        to_user_value,
    },
};

/// The tables of one pitch section.
pub(super) struct OwnedPitchTable {
    start: Position,
    step: Interval,
    forward: Vec<[u8; 4]>,
    reverse: Option<Vec<[u8; 4]>>,
}

impl OwnedPitchTable {
    pub(super) fn view(&self) -> PitchErrorTable<'_> {
        PitchErrorTable {
            start: self.start,
            step: self.step,
            forward: &self.forward,
            reverse: self.reverse.as_deref(),
        }
    }
}

/// Returns a pitch table, and its largest difference from the model in nm.
pub(super) fn compile_pitch(
    pitch: &machine_file::PitchErrorTable,
) -> Result<(OwnedPitchTable, f64), String> {
    let start = round_to_i32(pitch.start_mm * POSITION_UNITS_PER_MM)
        .map(Position)
        .ok_or_else(|| format!("starts at {} mm, beyond the board's ±21474 mm", pitch.start_mm))?;
    let step = round_to_u32(pitch.step_mm * POSITION_UNITS_PER_MM).filter(|&step| step > 0);
    let step = step.ok_or_else(|| {
        format!("has a step of {} mm; the board's are 10 nm to 42949 mm", pitch.step_mm)
    })?;
    let points = |errors: &[f64]| {
        let stored = errors.iter().map(|&um| {
            let point = round_to_i32(um * FINE_UNITS_PER_UM).map(i32::to_le_bytes);
            point.ok_or_else(|| format!("has {um} µm, beyond the board's ±8388 µm"))
        });
        stored.collect::<Result<Vec<_>, _>>()
    };
    let tables = OwnedPitchTable {
        start,
        step: Interval::new(step),
        forward: points(&pitch.forward_um)?,
        reverse: pitch.reverse_um.as_deref().map(points).transpose()?,
    };
    let difference_nm = pitch_difference_nm(pitch, &tables.view());
    Ok((tables, difference_nm))
}

/// At every point and at places between, from both sides.
fn pitch_difference_nm(pitch: &machine_file::PitchErrorTable, board: &PitchErrorTable<'_>) -> f64 {
    const SAMPLES_PER_INTERVAL: usize = 8;
    let mut worst: f64 = 0.0;
    for place in 0..=(pitch.forward_um.len() - 1) * SAMPLES_PER_INTERVAL {
        let mm = pitch.start_mm + pitch.step_mm * place as f64 / SAMPLES_PER_INTERVAL as f64;
        let Some(units) = round_to_i32(mm * POSITION_UNITS_PER_MM) else { continue };
        let mm = f64::from(units) / POSITION_UNITS_PER_MM;
        for (direction, blend) in [(1.0, Fraction::ZERO), (-1.0, Fraction::ONE)] {
            let stored = f64::from(board.error_at(Position(units), blend).0.0) / FINE_UNITS_PER_UM
                * NM_PER_UM;
            worst =
                worst.max((stored - model::pitch_error_um(pitch, mm, direction) * NM_PER_UM).abs());
        }
    }
    worst
}

/// Returns the table as a user writes it.
pub(super) fn decompile(pitch: &PitchErrorTable<'_>) -> machine_file::PitchErrorTable {
    let errors = |points: &[[u8; 4]]| -> Vec<f64> {
        points
            .iter()
            .map(|point| to_user_value(i32::from_le_bytes(*point), FINE_UNITS_PER_UM))
            .collect()
    };
    machine_file::PitchErrorTable {
        start_mm: to_user_value(pitch.start.0, POSITION_UNITS_PER_MM),
        step_mm: to_user_value(pitch.step.length(), POSITION_UNITS_PER_MM),
        forward_um: errors(pitch.forward),
        reverse_um: pitch.reverse.map(errors),
    }
}
