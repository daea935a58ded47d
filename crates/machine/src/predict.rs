//! For each row of a run: what the model says, and what the board's integers make of it.
//!
//! Two columns a quantity, both before filter, limits, slew and wire rounding:
//!
//! ```text
//! counts ─► model, f64 ──────────────────────────────► predicted_<quantity>_um
//!        └► nearest reading ─► the board's own code ─► bridge_<quantity>_um
//! ```
//!
//! The bridge's side runs the functions of `trueup-core` that the firmware runs, on the integers
//! that [`compile`](mod@crate::compile) gives the board, so the difference between the two columns
//! is what fixed-point arithmetic costs. Errors are along the tool: elongation times tool direction.

use std::io::{self, Write};

use trueup_core::{
    calibration::Calibration,
    units::{NANOMETRES_PER_MICROMETRE, Nanometres},
};

use crate::{
    compile::compile,
    inputs::SensorInput,
    machine_file::{Machine, Source},
    model,
    place::{BadInput, Place},
    run_file::RunFile,
};

/// The columns that a prediction adds to those of the run, in their order.
pub const COLUMNS: [&str; 8] = [
    "predicted_elongation_um",
    "bridge_elongation_um",
    "predicted_dx_um",
    "bridge_dx_um",
    "predicted_dy_um",
    "bridge_dy_um",
    "predicted_dz_um",
    "bridge_dz_um",
];

const NM_PER_UM: f64 = NANOMETRES_PER_MICROMETRE as f64;

/// One side's values for one row, in µm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Values {
    /// Positive when the tool grows out of the spindle.
    pub elongation_um: f64,
    /// The error of the tool tip on X, Y and Z.
    pub error_um: [f64; 3],
}

impl Values {
    fn all(self) -> [f64; 4] {
        let [dx, dy, dz] = self.error_um;
        [self.elongation_um, dx, dy, dz]
    }
}

/// Both sides for one row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// The reference arithmetic.
    pub model: Values,
    /// The board's arithmetic; `None` where the machine does not say how the sensor is connected.
    pub bridge: Option<Values>,
}

impl Prediction {
    /// The largest difference between the two sides, in nm.
    #[must_use]
    pub fn difference_nm(&self) -> Option<f64> {
        let bridge = self.bridge?.all();
        let apart = self.model.all().into_iter().zip(bridge).map(|(model, bridge)| model - bridge);
        Some(apart.fold(0.0, |worst, um| worst.max(um.abs() * NM_PER_UM)))
    }
}

/// A machine's prediction for a run, checked and ready to be written.
#[derive(Clone, Debug)]
pub struct Predictor<'a> {
    machine: &'a Machine,
    run: &'a RunFile,
    /// The counts that the source needs; `None` if it needs none.
    sensor_counts: Option<&'a [f64]>,
    bridge: Option<Bridge>,
}

/// The board's side.
#[derive(Clone, Copy, Debug)]
struct Bridge {
    /// `None` if the law needs no reading.
    input: Option<SensorInput>,
    calibration: Calibration,
}

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Written {
    /// Rows of the run.
    pub rows: usize,
    /// Rows without a prediction, because their counts are missing.
    pub rows_without_counts: usize,
    /// Rows whose counts the sensor cannot give. They are predicted like all others.
    pub rows_out_of_range: usize,
    /// Where the first of these stands.
    pub first_out_of_range: Option<Place>,
    /// The largest difference between model and bridge, in nm; `None` without a bridge or rows.
    pub largest_difference_nm: Option<f64>,
}

impl<'a> Predictor<'a> {
    /// The prediction of `machine` for `run`.
    ///
    /// `[inputs]` may be missing: there is no bridge side then.
    ///
    /// # Errors
    /// A column that the source needs is missing; a column of the run has the name of one that is
    /// to be written; the machine describes its inputs but does not compile.
    pub fn new(machine: &'a Machine, run: &'a RunFile) -> Result<Self, BadInput> {
        for name in COLUMNS {
            if run.column(name).is_some() {
                let rule = format!("column {name} is already there, and would be repeated");
                return Err(BadInput::new(run.header_place(), rule));
            }
        }
        let needs_counts = machine.spindle.source == Some(Source::Sensor);
        let sensor_counts = needs_counts.then(|| run.require("sensor_counts")).transpose()?;
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor);
        let bridge = if needs_counts && input.is_none() {
            None
        } else {
            Some(Bridge { input, calibration: compile(machine)?.calibration })
        };
        Ok(Self { machine, run, sensor_counts, bridge })
    }

    /// Whether there is a bridge side: the machine says how the sensor is connected.
    #[must_use]
    pub fn has_bridge(&self) -> bool {
        self.bridge.is_some()
    }

    /// Both sides for `row` (from 0); `None` where the counts are missing.
    #[must_use]
    pub fn row(&self, row: usize) -> Option<Prediction> {
        let counts = self.counts(row);
        if self.sensor_counts.is_some() && counts.is_nan() {
            return None;
        }
        let elongation_um = self.machine.elongation_um(counts);
        let error_um = model::error_um(elongation_um, self.machine.tool_direction);
        let model = Values { elongation_um, error_um };
        Some(Prediction { model, bridge: self.bridge.map(|bridge| bridge.values(counts)) })
    }

    /// Writes the run as CSV with [`COLUMNS`] after its own; a value that is missing is an empty
    /// cell. `row_done` hears of every row.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn write(&self, mut out: impl Write, mut row_done: impl FnMut()) -> io::Result<Written> {
        let mut written = Written {
            rows: self.run.rows(),
            rows_without_counts: 0,
            rows_out_of_range: 0,
            first_out_of_range: None,
            largest_difference_nm: None,
        };
        for column in self.run.columns() {
            write_name(&mut out, &column.name)?;
            out.write_all(b",")?;
        }
        writeln!(out, "{}", COLUMNS.join(","))?;
        for row in 0..self.run.rows() {
            for column in self.run.columns() {
                let value = column.values.get(row).copied().unwrap_or(f64::NAN);
                if !value.is_nan() {
                    write!(out, "{value}")?;
                }
                out.write_all(b",")?;
            }
            let prediction = self.row(row);
            write_prediction(&mut out, prediction)?;
            self.note(row, prediction, &mut written);
            row_done();
        }
        out.flush()?;
        Ok(written)
    }

    fn counts(&self, row: usize) -> f64 {
        self.sensor_counts.and_then(|counts| counts.get(row)).copied().unwrap_or(f64::NAN)
    }

    fn note(&self, row: usize, prediction: Option<Prediction>, written: &mut Written) {
        let Some(prediction) = prediction else {
            written.rows_without_counts += 1;
            return;
        };
        if let Some(difference_nm) = prediction.difference_nm() {
            let before = written.largest_difference_nm.unwrap_or(0.0);
            written.largest_difference_nm = Some(before.max(difference_nm));
        }
        let input = self.bridge.and_then(|bridge| bridge.input);
        if self.sensor_counts.is_some()
            && input.is_some_and(|input| !input.is_in_range(self.counts(row)))
        {
            written.rows_out_of_range += 1;
            let place = || self.run.place(row, "sensor_counts");
            written.first_out_of_range.get_or_insert_with(place);
        }
    }
}

impl Bridge {
    fn values(&self, counts: f64) -> Values {
        let um = |length: Nanometres| f64::from(length.0) / NM_PER_UM;
        // Without a source the law is 0 at every reading.
        let reading = self.input.map(|input| input.reading_from_counts(counts)).unwrap_or_default();
        let elongation = self.calibration.sensor.elongation(reading);
        let error = self.calibration.tool_direction.error(elongation);
        Values { elongation_um: um(elongation), error_um: error.map(um) }
    }
}

/// A column's name, in quotes where it would otherwise be read as something else.
fn write_name(out: &mut impl Write, name: &str) -> io::Result<()> {
    if name.contains([',', ';', '"']) {
        write!(out, "\"{}\"", name.replace('"', "\"\""))
    } else {
        out.write_all(name.as_bytes())
    }
}

/// The cells of [`COLUMNS`], to 1 pm, and the end of the line.
fn write_prediction(out: &mut impl Write, prediction: Option<Prediction>) -> io::Result<()> {
    let model = prediction.map(|prediction| prediction.model.all());
    let bridge = prediction.and_then(|prediction| prediction.bridge).map(Values::all);
    for quantity in 0..COLUMNS.len() / 2 {
        for (side, values) in [model, bridge].into_iter().enumerate() {
            if quantity + side > 0 {
                out.write_all(b",")?;
            }
            if let Some(values) = values {
                write!(out, "{:.6}", values[quantity])?;
            }
        }
    }
    out.write_all(b"\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MachineFile;
    use std::path::Path;

    const PAPER: &str = include_str!("../../../data/paper_spindle.toml");
    const INPUT: &str =
        "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }";

    fn machine(text: &str) -> Machine {
        MachineFile::parse(text, Path::new("m.toml")).expect("the test's own machine file")
    }

    fn run(text: &str) -> RunFile {
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run")
    }

    /// What is written, and the account of it.
    fn written(machine_text: &str, run_text: &str) -> (String, Written) {
        let (machine, run) = (machine(machine_text), run(run_text));
        let predictor = Predictor::new(&machine, &run).expect("can be predicted");
        let (mut out, mut rows) = (Vec::new(), 0);
        let account = predictor.write(&mut out, || rows += 1).expect("a Vec can be written");
        assert_eq!(rows, account.rows);
        (String::from_utf8(out).expect("CSV is text"), account)
    }

    #[test]
    fn both_sides_stand_beside_what_was_read() {
        let (csv, account) = written(PAPER, "sensor_counts,mystery\n9164,-1e-3\n5048,\n");
        let header = format!("sensor_counts,mystery,{}\n", COLUMNS.join(","));
        // 62.80517578125 µm: the board rounds it to a nanometre, and the error once more.
        let grown = "9164,-0.001,62.805176,62.805000,0.000000,0.000000,0.000000,0.000000,\
                     -62.805176,-62.805000\n";
        let cold = format!("5048,{}\n", ",0.000000".repeat(8));
        assert_eq!(csv, [header.as_str(), grown, &cold].concat());
        assert_eq!((account.rows, account.rows_without_counts), (2, 0));
        let difference_nm = account.largest_difference_nm.expect("there is a bridge");
        assert!((difference_nm - 0.175_781_25).abs() < 1e-9);
    }

    #[test]
    fn a_row_without_counts_has_empty_cells() {
        let (csv, account) = written(PAPER, "x_mm;sensor_counts\n1;\n2;5048\n3;nan\n");
        assert!(csv.contains("\n1,,,,,,,,,\n") && csv.contains("\n3,,,,,,,,,\n"), "{csv}");
        assert_eq!((account.rows, account.rows_without_counts), (3, 2));
    }

    #[test]
    fn without_inputs_the_model_predicts_alone() {
        let (csv, account) = written(&PAPER.replace(INPUT, ""), "sensor_counts\n9164\n");
        assert!(csv.ends_with("\n9164,62.805176,,0.000000,,0.000000,,-62.805176,\n"), "{csv}");
        assert_eq!(account.largest_difference_nm, None);
    }

    #[test]
    fn without_a_source_both_sides_are_zero_and_no_counts_are_needed() {
        let text = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";
        let (csv, account) = written(text, "x_mm\n1\n");
        assert!(csv.ends_with(&format!("\n1{}\n", ",0.000000".repeat(8))), "{csv}");
        assert_eq!(account.largest_difference_nm, Some(0.0));
    }

    #[test]
    fn an_inclined_tool_shares_its_growth_between_the_axes() {
        let text = PAPER
            .replace("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0.0, 0.6, -0.8]");
        let (csv, account) = written(&text, "sensor_counts\n9164\n");
        let cells = "62.805176,62.805000,0.000000,0.000000,37.683105,37.683000,\
                     -50.244141,-50.244000\n";
        assert!(csv.ends_with(cells), "{csv}");
        assert!(account.largest_difference_nm.expect("there is a bridge") < 1.0);
    }

    #[test]
    fn the_bridge_is_within_2_nm_of_the_model_at_every_count() {
        let text = PAPER
            .replace("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0.1, -0.7, -0.8]");
        let counts: String = (0..=32_768).map(|count| format!("{count}\n")).collect();
        let (_, account) = written(&text, &format!("sensor_counts\n{counts}"));
        let difference_nm = account.largest_difference_nm.expect("there is a bridge");
        assert!((0.5..1.1).contains(&difference_nm), "{difference_nm} nm");
    }

    #[test]
    fn what_was_written_is_a_run_file_with_the_same_values() {
        let text = "\"load; \"\"z\"\", n\",sensor_counts,time_s\n1e-7,5048.5,\n-2e300,0.1,3\n";
        let (csv, _) = written(PAPER, text);
        let (before, after) = (run(text), run(&csv));
        assert_eq!(after.columns().len(), 3 + COLUMNS.len());
        for (before, after) in before.columns().iter().zip(after.columns()) {
            assert_eq!(before.name, after.name);
            for (before, after) in before.values.iter().zip(&after.values) {
                assert!(before == after || before.is_nan() && after.is_nan());
            }
        }
    }

    #[test]
    fn counts_that_the_sensor_cannot_give_are_told() {
        let (_, account) = written(PAPER, "sensor_counts\n0\n32768\n40000\n-1\n\n");
        assert_eq!(account.rows_out_of_range, 2);
        assert_eq!(account.first_out_of_range.expect("two").line, 4);
    }

    #[test]
    fn what_cannot_be_predicted_is_refused_with_its_place() {
        let steep = PAPER.replace("0.0152587890625", "2.0");
        for (machine_text, run_text, complaint) in [
            (PAPER, "x_mm\n1\n", "r.csv:1:1: column sensor_counts is missing"),
            (
                PAPER,
                "sensor_counts,bridge_dx_um\n1,2\n",
                "r.csv:1:1: column bridge_dx_um is already there",
            ),
            (&steep, "sensor_counts\n1\n", "m.toml:16:16: spindle.sensor.um_per_count 2 is"),
        ] {
            let (machine, run) = (machine(machine_text), run(run_text));
            let error = Predictor::new(&machine, &run).expect_err(complaint).to_string();
            assert!(error.starts_with(complaint), "{error}");
        }
    }
}
