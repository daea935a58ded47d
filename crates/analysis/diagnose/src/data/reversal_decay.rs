//! Columns that follow from where the axis turned.

use super::{data_table::DataTable, table_columns::NamedColumn};

/// For ways in equal ratios between the shortest and the longest steps: u ← (u + Δd)·e^(−|ΔP|/way),
/// Δd the change of the direction. Nothing where the axis never turns.
pub(super) fn reversal_decay_columns(data: &DataTable) -> Vec<NamedColumn> {
    const DECAY_LENGTH_COUNT: i32 = 6;
    let (Some(own), Some(direction)) = (data.own_position_mm(), data.own_approach_direction())
    else {
        return Vec::new();
    };
    let is_next = |row: usize| row > 0 && data.places.series[row] == data.places.series[row - 1];
    let step = |row: usize| (own[row] - own[row - 1]).abs();
    let mut steps: Vec<f64> =
        (0..data.rows).filter(|&row| is_next(row)).map(step).filter(|mm| *mm > 0.0).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let turns = |row: usize| is_next(row) && direction[row] * direction[row - 1] < 0.0;
    let (Some(&short), true) = (steps.get(steps.len() / 20), (0..data.rows).any(turns)) else {
        return Vec::new();
    };
    // Beyond twenty of the shortest steps nothing would be left of it at once.
    (0..DECAY_LENGTH_COUNT)
        .map(|n| {
            let way_mm = short * 20.0_f64.powf(f64::from(n + 1) / f64::from(DECAY_LENGTH_COUNT));
            let mut left = 0.0;
            let values = (0..data.rows)
                .map(|row| {
                    if !is_next(row) {
                        left = 0.0;
                    } else if !step(row).is_nan() {
                        if turns(row) {
                            left += direction[row] - direction[row - 1];
                        }
                        left *= (-step(row) / way_mm).exp();
                    }
                    left
                })
                .collect();
            (format!("the last reversal, taken up over {way_mm:.3} mm"), values)
        })
        .collect()
}
