//! Readings at equal positions: what repeats, and what does not.
//!
//! What scatters is what the model leaves: an axis that grows with its temperature as the model says
//! repeats. What repeats is looked for in the readings themselves: a machine that does what its model
//! says repeats, also where nothing else is left but noise.

use crate::data::Data;

/// Scatter and systematic part of what is left at equal positions, approached the same way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Repeats {
    /// Standard deviation of readings at one position and direction, pooled.
    pub scatter_um: f64,
    /// Standard deviation of the means, less what scatter makes of it.
    pub systematic_um: f64,
}

/// None where there are too few repeats: less than three runs, or positions that do not come back.
pub(crate) fn analyse(data: &Data, predicted: &[f64]) -> Option<Repeats> {
    let run = data.run.as_deref()?;
    let own = data.own_position()?;
    let direction = data.own_direction();
    let mut rows: Vec<(i64, i8, usize)> = (0..data.rows)
        .filter(|&row| data.used[row] && !run[row].is_nan() && !own[row].is_nan())
        .map(|row| {
            // Positions to a micrometre.
            let at = (own[row] * 1000.0).round() as i64;
            let back = direction.is_some_and(|d| d[row] < 0.0);
            (at, i8::from(back), row)
        })
        .collect();
    rows.sort_unstable();
    let (mut within, mut freedom) = (0.0, 0.0);
    let mut means: Vec<(f64, f64)> = Vec::new();
    for group in rows.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if group.len() < 2 {
            continue;
        }
        let count = group.len() as f64;
        let mean_of = |of: &dyn Fn(usize) -> f64| {
            group.iter().map(|&(_, _, row)| of(row)).sum::<f64>() / count
        };
        let left = |row: usize| data.measured[row] - predicted[row];
        let (mean, mean_left) = (mean_of(&|row| data.measured[row]), mean_of(&left));
        within += group.iter().map(|&(_, _, row)| (left(row) - mean_left).powi(2)).sum::<f64>();
        freedom += count - 1.0;
        means.push((mean, count));
    }
    if means.len() < 3 || freedom < 6.0 {
        return None;
    }
    let scatter = within / freedom;
    let count = means.len() as f64;
    let mean = means.iter().map(|(mean, _)| mean).sum::<f64>() / count;
    let between = means.iter().map(|(m, _)| (m - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let by_chance = means.iter().map(|(_, n)| scatter / n).sum::<f64>() / count;
    Some(Repeats {
        scatter_um: scatter.sqrt(),
        systematic_um: (between - by_chance).max(0.0).sqrt(),
    })
}
