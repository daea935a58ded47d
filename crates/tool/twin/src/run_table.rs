//! Columns of numbers, and the run file (CSV) that they are written to.
//!
//! A value is rounded to its column's decimals when it is put in, not when it is written: a computation
//! with a column has the values that the reader of the file will see.

use std::{
    fmt::Write as _,
    io::{self, Write},
};

/// A run: named columns of equal length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunTable {
    columns: Vec<TableColumn>,
}

/// A column with its name and decimals.
#[derive(Clone, Debug, PartialEq)]
struct TableColumn {
    name: String,
    /// NaN: a missing value, an empty cell.
    values: Vec<f64>,
    /// 10 to the power of the decimals that are kept.
    scale: f64,
}

impl RunTable {
    /// No columns yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a column, or puts other values into the one of this name. `decimals` (0 to 12) are
    /// kept.
    pub fn set_column(&mut self, name: &str, decimals: u8, values: impl IntoIterator<Item = f64>) {
        let scale = 10_f64.powi(decimals.min(12).into());
        // + 0.0 turns −0 into 0, which is what a table should show.
        let values = values.into_iter().map(|value| (value * scale).round() / scale + 0.0);
        let column = TableColumn { name: name.to_string(), values: values.collect(), scale };
        match self.columns.iter_mut().find(|there| there.name == name) {
            Some(there) => *there = column,
            None => self.columns.push(column),
        }
    }

    /// Adds one value to the end of the column `name`, which is made where there is none.
    pub fn push_value(&mut self, name: &str, decimals: u8, value: f64) {
        if !self.columns.iter().any(|there| there.name == name) {
            self.set_column(name, decimals, []);
        }
        if let Some(there) = self.columns.iter_mut().find(|there| there.name == name) {
            there.values.push((value * there.scale).round() / there.scale + 0.0);
        }
    }

    /// Returns the values of `name`, as they will be read from the file; NaN where missing. `None` if there
    /// is no such column.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|column| column.name == name).map(|column| &column.values[..])
    }

    /// Returns the names of the columns, in the order of the file.
    pub fn column_names(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|column| column.name.as_str())
    }

    /// Returns how many rows there are: the length of the longest column.
    #[must_use]
    pub fn row_count(&self) -> usize {
        self.columns.iter().map(|column| column.values.len()).max().unwrap_or(0)
    }

    /// Writes the run file: a header row and one row of numbers for each observation.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn write_csv(&self, mut out: impl Write) -> io::Result<()> {
        let header: Vec<&str> = self.column_names().collect();
        writeln!(out, "{}", header.join(","))?;
        let mut line = String::new();
        for row in 0..self.row_count() {
            line.clear();
            for (number, column) in self.columns.iter().enumerate() {
                if number > 0 {
                    line.push(',');
                }
                if let Some(value) = column.values.get(row)
                    && !value.is_nan()
                {
                    // The shortest text that reads back as the same number.
                    write!(line, "{value}").map_err(io::Error::other)?;
                }
            }
            line.push('\n');
            out.write_all(line.as_bytes())?;
        }
        out.flush()
    }

    /// Returns the run file as text.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut bytes = Vec::new();
        self.write_csv(&mut bytes).expect("a Vec can always be written");
        String::from_utf8(bytes).expect("only text was written")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_value_is_an_empty_cell() {
        let mut table = RunTable::new();
        table.set_column("time_s", 1, [0.0, 0.26, 10.0]);
        table.set_column("sensor_counts", 0, [5048.4, f64::NAN, -0.2]);
        assert_eq!(table.to_csv(), "time_s,sensor_counts\n0,5048\n0.3,\n10,0\n");
    }

    #[test]
    fn what_is_read_from_a_column_is_what_is_written() {
        let mut table = RunTable::new();
        table.push_value("x_mm", 3, 1.000_4);
        table.push_value("x_mm", 3, 2.000_6);
        assert_eq!(table.column("x_mm"), Some(&[1.0, 2.001][..]));
        assert_eq!(table.to_csv(), "x_mm\n1\n2.001\n");
    }

    #[test]
    fn a_column_that_is_set_again_keeps_its_place() {
        let mut table = RunTable::new();
        table.set_column("a", 0, [1.0]);
        table.set_column("b", 0, [2.0]);
        table.set_column("a", 0, [3.0]);
        assert_eq!(table.to_csv(), "a,b\n3,2\n");
    }
}
