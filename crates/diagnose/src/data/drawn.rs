//! Some of the rows of a table, as a table: for the fit with which the search begins.

use std::sync::Arc;

use super::{
    lag::filled,
    table::{Data, DrawnFrom},
};

impl Data {
    /// The rows of `mask` alone; what has a memory is still stepped through all of them.
    pub(crate) fn subset(self: &Arc<Self>, mask: &[bool]) -> Self {
        let rows: Vec<usize> = (0..self.rows).filter(|&row| mask[row]).collect();
        let pick =
            |values: &Vec<f64>| -> Vec<f64> { rows.iter().map(|&row| values[row]).collect() };
        let maybe = |values: &Option<Vec<f64>>| values.as_ref().map(pick);
        // A missing value holds the one before it, also if that one is not drawn.
        let held = |values: &Option<Vec<f64>>| values.as_ref().map(|it| pick(&filled(it)));
        let series: Vec<usize> = rows.iter().map(|&row| self.series[row]).collect();
        Self {
            rows: rows.len(),
            file: rows.iter().map(|&row| self.file[row]).collect(),
            restart: (0..rows.len()).map(|n| n == 0 || series[n] != series[n - 1]).collect(),
            series,
            time_s: maybe(&self.time_s),
            gauge_time_s: maybe(&self.gauge_time_s),
            run: maybe(&self.run),
            temperatures: self
                .temperatures
                .iter()
                .map(|(name, values)| (name.clone(), pick(&filled(values))))
                .collect(),
            others: self.others.iter().map(|(name, values)| (name.clone(), pick(values))).collect(),
            spindle_rpm: held(&self.spindle_rpm),
            load_n: held(&self.load_n),
            position_mm: self.position_mm.each_ref().map(maybe),
            direction: self.direction.each_ref().map(maybe),
            reversal_decay: self
                .reversal_decay
                .iter()
                .map(|(name, values)| (name.clone(), pick(values)))
                .collect(),
            measured: pick(&self.measured),
            stated: self.stated.clone(),
            constants_um: self.constants_um,
            elongation: pick(&self.elongation),
            law: pick(&self.law),
            along: pick(&self.along),
            axis: pick(&self.axis),
            thermal: pick(&self.thermal),
            used: rows.iter().map(|&row| self.used[row]).collect(),
            machine: self.machine.clone(),
            quantity: self.quantity,
            files: self.files,
            has_elongation: self.has_elongation,
            references_c: self.references_c.clone(),
            start_s: self.start_s,
            notes: Vec::new(),
            whole: Some(DrawnFrom { data: self.clone(), rows, lagged: Arc::default() }),
        }
    }
}
