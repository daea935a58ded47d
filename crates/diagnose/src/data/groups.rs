//! Neighbouring rows put together, so that a search costs no more where more was written down.

use trueup_numerics::noise::Steps;

use super::table::Data;

/// Rows put together for the search: `size` neighbours of one series are one group, so that its cost
/// does not depend on how often a slow thing was written down. What is linear stays exact: means of
/// what was measured are compared with means of what is predicted.
#[derive(Clone, Debug)]
pub(crate) struct Groups {
    /// The group of each row; none for rows that do not count.
    of_row: Vec<Option<u32>>,
    count: Vec<f64>,
    /// Rows in a full group.
    pub size: usize,
    /// Mean row number of each group.
    pub steps: Steps,
    /// The series and the file of each group.
    pub series: Vec<usize>,
    pub file: Vec<usize>,
    /// The first row of each group.
    pub first_row: Vec<usize>,
}

impl Groups {
    /// Groups of `size` rows.
    pub(crate) fn new(data: &Data, used: &[bool], size: usize) -> Self {
        let mut it = Self {
            of_row: vec![None; data.rows],
            count: Vec::new(),
            size,
            steps: Steps(Vec::new()),
            series: Vec::new(),
            file: Vec::new(),
            first_row: Vec::new(),
        };
        let mut clock: Vec<f64> = Vec::new();
        let mut open: Option<(usize, usize)> = None;
        for row in 0..data.rows {
            if !used[row] {
                continue;
            }
            let begins = match open {
                Some((series, in_group)) => series != data.series[row] || in_group >= size,
                None => true,
            };
            if begins {
                it.count.push(0.0);
                it.series.push(data.series[row]);
                it.file.push(data.file[row]);
                it.first_row.push(row);
                clock.push(0.0);
                open = Some((data.series[row], 0));
            }
            let group = it.count.len() - 1;
            it.of_row[row] = Some(group as u32);
            it.count[group] += 1.0;
            let time = data.time_s.as_ref().map_or(row as f64, |times| times[row]);
            clock[group] += if time.is_nan() { row as f64 } else { time };
            if let Some((_, in_group)) = &mut open {
                *in_group += 1;
            }
        }
        for (clock, count) in clock.iter_mut().zip(&it.count) {
            *clock /= count;
        }
        let mut gaps: Vec<f64> = (1..clock.len())
            .filter(|&group| it.series[group] == it.series[group - 1])
            .map(|group| clock[group] - clock[group - 1])
            .filter(|&gap| gap > 0.0)
            .collect();
        gaps.sort_by(f64::total_cmp);
        let step = gaps.get(gaps.len() / 2).copied().unwrap_or(1.0);
        it.steps.0 = (0..clock.len())
            .map(|group| {
                if group == 0 || it.series[group] != it.series[group - 1] {
                    f64::INFINITY
                } else {
                    // Rows at one time are still one after the other; and what a pause does to the
                    // noise is not known: it is not believed to end it.
                    ((clock[group] - clock[group - 1]) / step).clamp(0.1, 2.0)
                }
            })
            .collect();
        it
    }

    pub(crate) fn len(&self) -> usize {
        self.count.len()
    }

    /// Rows in all groups.
    pub(crate) fn rows(&self) -> f64 {
        self.count.iter().sum()
    }

    /// The mean of `values` in each group.
    pub(crate) fn means(&self, values: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.count.len()];
        for (value, group) in values.iter().zip(&self.of_row) {
            if let Some(group) = group {
                sums[*group as usize] += value;
            }
        }
        sums.iter_mut().zip(&self.count).for_each(|(sum, count)| *sum /= count);
        sums
    }
}
