//! The columns of a run that the model knows, and one row of them.

use crate::{
    effect::LawInput,
    keys::reader::is_temperature_column,
    machine_file::Machine,
    model::RowInputs,
    run_file::RunFile,
    sections::{LinearAxis, RotaryAxis},
    tool_column::TOOL_COLUMN,
};

/// The columns of the run that the model knows.
#[derive(Clone, Debug)]
pub(super) struct ModelColumns<'a> {
    pub(super) time_s: Option<&'a [f64]>,
    pub(super) run: Option<&'a [f64]>,
    pub(super) sensor_counts: Option<&'a [f64]>,
    pub(super) spindle_rpm: Option<&'a [f64]>,
    pub(super) load_n: Option<&'a [f64]>,
    pub(super) feed_mm_per_min: Option<&'a [f64]>,
    pub(super) temperatures_c: Vec<(&'a str, &'a [f64])>,
    /// Those that a term reads and no law of the machine.
    pub(super) others: Vec<(&'a str, &'a [f64])>,
    pub(super) position_mm: [Option<&'a [f64]>; 3],
    pub(super) angle_deg: [Option<&'a [f64]>; 3],
    pub(super) direction: [Option<&'a [f64]>; 3],
    pub(super) tool_length_mm: Option<&'a [f64]>,
}

impl<'a> ModelColumns<'a> {
    pub(super) fn new(machine: &Machine, run: &'a RunFile) -> Self {
        let linear =
            |name: fn(&str) -> String| LinearAxis::ALL.map(|axis| run.column(&name(axis.name())));
        let temperatures =
            run.columns().iter().filter(|column| is_temperature_column(&column.name));
        let by_tool = machine.spindle.tools.as_ref().map(|_| TOOL_COLUMN);
        let reads = machine.terms.iter().flat_map(|term| term.effect.required_inputs());
        let names: Vec<&str> = reads
            .filter_map(|input| match input {
                LawInput::Column(column) | LawInput::Lagged { column, .. } => Some(column),
                _ => None,
            })
            .chain(by_tool)
            .collect();
        let others = run.columns().iter().filter(|column| names.contains(&column.name.as_str()));
        Self {
            time_s: run.column("time_s"),
            run: run.column("run"),
            sensor_counts: run.column("sensor_counts"),
            spindle_rpm: run.column("spindle_rpm"),
            load_n: run.column("load_n"),
            feed_mm_per_min: run.column("feed_mm_per_min"),
            temperatures_c: temperatures
                .map(|column| (column.name.as_str(), &column.values[..]))
                .collect(),
            others: others.map(|column| (column.name.as_str(), &column.values[..])).collect(),
            position_mm: linear(|axis| format!("{axis}_mm")),
            angle_deg: RotaryAxis::ALL.map(|axis| run.column(&format!("{}_deg", axis.name()))),
            direction: linear(|axis| format!("dir_{axis}")),
            tool_length_mm: run.column("tool_length_mm"),
        }
    }

    pub(super) fn temperatures_in_row(&self, row: usize) -> Vec<(&'a str, f64)> {
        values_in_row(&self.temperatures_c, row)
    }

    pub(super) fn other_column_values_in_row(&self, row: usize) -> Vec<(&'a str, f64)> {
        values_in_row(&self.others, row)
    }

    pub(super) fn row_inputs<'t>(
        &self,
        row: usize,
        temperatures_c: &'t [(&'a str, f64)],
        others: &'t [(&'a str, f64)],
    ) -> RowInputs<'t> {
        RowInputs {
            time_s: self.time_s.map(|times| value_at_row(Some(times), row)),
            run: self.run.map(|runs| value_at_row(Some(runs), row)),
            sensor_counts: value_at_row(self.sensor_counts, row),
            spindle_rpm: self.spindle_rpm.map(|speeds| value_at_row(Some(speeds), row)),
            load_n: self.load_n.map(|loads| value_at_row(Some(loads), row)),
            feed_mm_per_min: value_at_row(self.feed_mm_per_min, row),
            temperatures_c,
            others,
            position_mm: self.position_mm.map(|values| value_at_row(values, row)),
            angle_deg: self.angle_deg.map(|values| value_at_row(values, row)),
            direction: self.direction.map(|values| value_at_row(values, row)),
            tool_length_mm: self.tool_length_mm.map(|lengths| value_at_row(Some(lengths), row)),
        }
    }
}

fn values_in_row<'a>(columns: &[(&'a str, &'a [f64])], row: usize) -> Vec<(&'a str, f64)> {
    columns.iter().map(|(name, values)| (*name, value_at_row(Some(values), row))).collect()
}

pub(super) fn value_at_row(column: Option<&[f64]>, row: usize) -> f64 {
    column.and_then(|values| values.get(row)).copied().unwrap_or(f64::NAN)
}
