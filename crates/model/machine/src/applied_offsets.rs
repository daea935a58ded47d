//! The offsets that a bridge applied while a run was measured, taken out again.
//!
//! A record of the monitor has the offsets that the CNC added (`offset_x_um`, …) and their `quality`.
//! An instrument next to it reads what is left, so that the machine's own error is
//!
//! ```text
//! dx, dy, dz:  error = measured − offset
//! elongation:  s = measured − offset·V      V the tool's direction: (0, 0, −1) gives measured + offset_z
//! ```
//!
//! A CNC that is given no offset (quality 6) takes back what it applies: after `hold_ms`, and the way from the
//! largest offset at the slew limit. So what was measured after that is the machine's own, also before a CNC
//! has engaged for the first time.
//!
//! Rows in which it is not known what was applied are excluded: their measured value becomes a missing
//! one, and the rest of the row stays, for what has a memory. Columns of the bridge's state are no
//! longer columns of the run, so that they explain nothing.

mod factor;
mod factor_estimate;
mod troubleshooting;
mod two_stage_least_squares;

use std::{borrow::Cow, ops::Deref};

use crate::{
    compile::compile,
    effect::Quantity,
    location::InputFileError,
    machine_file::Machine,
    model::tool_direction,
    run_file::RunFile,
    sections::{LinearAxis, RotaryAxis},
};

pub use factor::{
    OffsetApplication, PairedRuns, estimate_offset_application, is_fully_compensated, predict_um,
    require_unit_factor,
};
pub use factor_estimate::FactorEstimate;
pub use troubleshooting::repeat_run_instruction;

/// The quality of the offsets in a row, 0…6.
const QUALITY_COLUMN: &str = "quality";
/// The CRC of the calibration that the bridge ran, as a decimal number; 0: none.
const CALIBRATION_CRC_COLUMN: &str = "calibration_crc";
/// Further columns by which a bridge reports its state.
const BRIDGE_STATE_COLUMNS: [&str; 2] = ["flags", "age_ms"];
/// From this quality on (hold, ramping out, fault) the offset is not the error's opposite, or not
/// known to be followed (`docs/book/src/offsets.md`).
const MIN_UNUSABLE_QUALITY: f64 = 4.0;
/// The last quality that there is.
const FAULT_QUALITY: f64 = 6.0;

/// A CNC may be this much later than its limits say, in seconds: it learns of a fault, and starts.
const MAX_CNC_DELAY_S: f64 = 1.0;

/// A run as it would have been measured without a bridge: the one kind of run that constants of a machine are
/// made of.
#[derive(Clone, Debug)]
pub struct UncompensatedRun<'r> {
    run: Cow<'r, RunFile>,
    /// The offset applied in each row, by quantity: see [`UncompensatedRun::applied_offset_um`].
    offset_um: Vec<(Quantity, Vec<f64>)>,
}

impl Deref for UncompensatedRun<'_> {
    type Target = RunFile;

    fn deref(&self) -> &RunFile {
        &self.run
    }
}

impl<'r> UncompensatedRun<'r> {
    /// Returns `run` without what a bridge applied, and the notes for the user, a sentence each. A run without the
    /// columns of a bridge is unchanged.
    ///
    /// `machine` says where the tool points, and which calibration was to run; without one the tool points
    /// down and the calibration is not compared. A quantity that lacks the column of its offset is
    /// omitted, and the notes say so.
    ///
    /// # Errors
    /// There are offsets without a quality; the `quantity`, or every one, lacks the column of its
    /// offset; a quality other than 0…6; the bridge ran the calibration of another machine file.
    pub fn from_run(
        run: Cow<'r, RunFile>,
        machine: Option<&Machine>,
        quantity: Option<Quantity>,
    ) -> Result<(Self, Vec<String>), InputFileError> {
        let (without, notes) = subtract_applied_offsets(&run, machine, quantity)?;
        let unaided = match without {
            Some((without, offset_um)) => Self { run: Cow::Owned(without), offset_um },
            None => Self { run, offset_um: Vec::new() },
        };
        Ok((unaided, notes))
    }

    /// Returns the offset along `quantity` that was taken out of each row, in µm: 0 where none was applied, NaN in
    /// rows that are excluded; `None` where the run has no columns of a bridge.
    #[must_use]
    pub fn applied_offset_um(&self, quantity: Quantity) -> Option<&[f64]> {
        self.offset_um.iter().find(|(of, _)| *of == quantity).map(|(_, um)| &um[..])
    }

    /// Returns the same run where the machine applies `factor` times the offset: error = measured − factor·offset.
    #[must_use]
    pub fn with_offset_factor(mut self, quantity: Quantity, factor: f64) -> Self {
        let name = format!("measured_{}_um", quantity.name());
        let offset_um = self.offset_um.iter().find(|(of, _)| *of == quantity);
        if let (Some((_, offset_um)), Some(error)) = (offset_um, self.run.column(&name)) {
            let rows = error.iter().zip(offset_um);
            let values = rows.map(|(error, offset)| error + (1.0 - factor) * offset).collect();
            self.run.to_mut().replace_column(&name, values);
        }
        self
    }
}

/// Offsets along X, Y and Z, row by row, and what the user should know.
type OffsetsAndNotes = ([Vec<f64>; 3], Vec<String>);

/// Returns the offset along each linear axis that a bridge had applied in each row of `run`, in µm: 0 where none was
/// applied, NaN where it is not known; and what the user should know, a sentence each. It is for
/// errors that are measured across axes; `None` where the run has no columns of a bridge.
///
/// # Errors
/// As [`UncompensatedRun::from_run`].
pub fn compute_applied_offsets_um(
    run: &RunFile,
    machine: Option<&Machine>,
) -> Result<Option<OffsetsAndNotes>, InputFileError> {
    let mut notes = Vec::new();
    let Some(record) = BridgeRecord::from_run(run, machine, &mut notes)? else { return Ok(None) };
    let nothing = vec![0.0; run.row_count()];
    let mut account = ExcludedRowCounts::default();
    let offsets = LinearAxis::ALL.map(|axis| {
        let quantity = Quantity::from_axis(axis);
        if record.offsets[axis.index()].is_none() {
            let is_known = record.find_missing_column(quantity).is_none();
            return vec![if is_known { 0.0 } else { f64::NAN }; run.row_count()];
        }
        let (left_um, of_axis) = record.subtract_offset(&nothing, quantity);
        account = of_axis;
        left_um.into_iter().map(|um| -um).collect()
    });
    let file = run.path().display();
    notes.extend(account.exclusion_notes("radial deviation").map(|note| format!("{file}: {note}")));
    Ok(Some((offsets, notes)))
}

/// A run without what was applied, and what that was, by quantity.
type RunAndOffsets = (RunFile, Vec<(Quantity, Vec<f64>)>);

/// `run` without what was applied; `None` where nothing was. The notes and the errors are those of
/// [`UncompensatedRun::from_run`].
fn subtract_applied_offsets(
    run: &RunFile,
    machine: Option<&Machine>,
    requested: Option<Quantity>,
) -> Result<(Option<RunAndOffsets>, Vec<String>), InputFileError> {
    let mut notes = Vec::new();
    let Some(record) = BridgeRecord::from_run(run, machine, &mut notes)? else {
        return Ok((None, notes));
    };
    let file = run.path().display();
    let mut cleaned = run.clone();
    let mut not_known = None;
    let mut offset_um = Vec::new();
    for quantity in Quantity::ALL {
        let name = format!("measured_{}_um", quantity.name());
        let Some(measured) = run.column(&name) else { continue };
        match record.find_missing_column(quantity) {
            Some(missing) => {
                let rule = format!(
                    "column {missing} is missing: what the bridge applied cannot be taken out of {name}"
                );
                notes.push(format!("{file}: {rule}; {name} is ignored"));
                let bad = InputFileError::new(run.header_location(), rule);
                if requested == Some(quantity) {
                    return Err(bad);
                }
                not_known.get_or_insert(bad);
                cleaned.remove_columns(|column| column == name);
            }
            None => {
                let (values, account) = record.subtract_offset(measured, quantity);
                notes.extend(account.exclusion_notes(&name).map(|note| format!("{file}: {note}")));
                let rows = measured.iter().zip(&values);
                offset_um
                    .push((quantity, rows.map(|(measured, error)| measured - error).collect()));
                cleaned.replace_column(&name, values);
            }
        }
    }
    if let (true, Some(bad)) = (offset_um.is_empty(), not_known) {
        return Err(bad);
    }
    let states_quality = |name: &str| {
        [QUALITY_COLUMN, CALIBRATION_CRC_COLUMN].contains(&name)
            || BRIDGE_STATE_COLUMNS.contains(&name)
            || LinearAxis::ALL.iter().any(|axis| offset_column_name(*axis) == name)
    };
    cleaned.remove_columns(states_quality);
    Ok((Some((cleaned, offset_um)), notes))
}

fn offset_column_name(axis: LinearAxis) -> String {
    format!("offset_{}_um", axis.name())
}

fn check_quality(run: &RunFile, quality: &[f64]) -> Result<(), InputFileError> {
    let is_one = |value: f64| value.fract() == 0.0 && (0.0..=FAULT_QUALITY).contains(&value);
    match quality.iter().position(|&value| !value.is_nan() && !is_one(value)) {
        None => Ok(()),
        Some(row) => {
            let rule = format!("must be 0 to {FAULT_QUALITY}, not {}", quality[row]);
            Err(run.value_error(row, QUALITY_COLUMN, rule))
        }
    }
}

/// Compares the calibration that ran with that of `machine`; says so where it cannot.
fn check_calibration(
    run: &RunFile,
    machine: Option<&Machine>,
) -> Result<Option<String>, InputFileError> {
    let Some(machine) = machine else { return Ok(None) };
    // A bridge without a calibration applies nothing.
    let ran = |crc: f64| !crc.is_nan() && crc != 0.0;
    let crcs = run.column(CALIBRATION_CRC_COLUMN).unwrap_or_default();
    if !crcs.iter().any(|&crc| ran(crc)) {
        return Ok(Some(format!(
            "there is no {CALIBRATION_CRC_COLUMN}: so it is not known whether the bridge ran the calibration of this machine file"
        )));
    }
    let own = match compile(machine) {
        Ok(compiled) => compiled.crc(),
        Err(why) => {
            return Ok(Some(format!(
                "{CALIBRATION_CRC_COLUMN} cannot be compared: this machine file does not compile ({why})"
            )));
        }
    };
    match crcs.iter().position(|&crc| ran(crc) && crc != f64::from(own)) {
        None => Ok(None),
        Some(row) => {
            let rule = format!(
                "{} is another calibration than that of this machine file, {own} ({own:08x}): give the \
                 machine file that the bridge ran",
                crcs[row]
            );
            Err(run.value_error(row, CALIBRATION_CRC_COLUMN, rule))
        }
    }
}

/// A run with what the bridge says in it.
struct BridgeRecord<'r> {
    run: &'r RunFile,
    machine: Option<&'r Machine>,
    quality: &'r [f64],
    offsets: [Option<&'r [f64]>; 3],
    /// The rows in which a CNC has taken back what it applied, because it received no offset until its timeout.
    offset_withdrawn: Vec<bool>,
}

/// Returns the rows from which on no offset was available for longer than a CNC takes to go to 0.
fn offset_withdrawn_mask(run: &RunFile, machine: Option<&Machine>, quality: &[f64]) -> Vec<bool> {
    let limits = machine.map(|machine| machine.limits).unwrap_or_default();
    let way_um = limits.max_um.into_iter().fold(0.0, f64::max);
    let lasts_s = f64::from(limits.hold_ms) / 1e3 + way_um / limits.slew_um_per_s + MAX_CNC_DELAY_S;
    let Some(time_s) = run.column("time_s") else { return vec![false; quality.len()] };
    let (mut since, mut before) = (None, f64::NAN);
    let rows = quality.iter().zip(time_s).map(|(&quality, &now)| {
        if quality != FAULT_QUALITY || now.is_nan() || now < before {
            since = None;
        }
        before = now;
        if quality != FAULT_QUALITY || now.is_nan() {
            return false;
        }
        now - *since.get_or_insert(now) > lasts_s
    });
    rows.collect()
}

/// How many measured rows could not be used.
#[derive(Default)]
struct ExcludedRowCounts {
    rows: usize,
    unusable: usize,
    unknown: usize,
}

impl ExcludedRowCounts {
    fn exclusion_notes(&self, name: &str) -> impl Iterator<Item = String> {
        let excluded_rows = |count: usize, why: &str| {
            let rows = self.rows;
            (count > 0).then(|| format!("{name}: {count} of {rows} rows are excluded: {why}"))
        };
        let unusable = "the bridge held, ramped out or was not available (quality 4 and above), or too briefly for the CNC to remove its offset";
        let unknown = "quality or offset is missing, so what the bridge applied is not known";
        [excluded_rows(self.unusable, unusable), excluded_rows(self.unknown, unknown)]
            .into_iter()
            .flatten()
    }
}

impl<'r> BridgeRecord<'r> {
    /// Returns the columns of a bridge, `None` where `run` has none; adds to `notes` what the user should know.
    fn from_run(
        run: &'r RunFile,
        machine: Option<&'r Machine>,
        notes: &mut Vec<String>,
    ) -> Result<Option<Self>, InputFileError> {
        let offsets = LinearAxis::ALL.map(|axis| run.column(&offset_column_name(axis)));
        if run.column(QUALITY_COLUMN).is_none() && offsets.iter().all(Option::is_none) {
            return Ok(None);
        }
        let quality = run.require_column(QUALITY_COLUMN).map_err(|mut bad| {
            bad.rule += "; without it the rows with an offset are not known";
            bad
        })?;
        check_quality(run, quality)?;
        let file = run.path().display();
        notes.extend(check_calibration(run, machine)?.map(|note| format!("{file}: {note}")));
        let offset_withdrawn = offset_withdrawn_mask(run, machine, quality);
        Ok(Some(Self { run, machine, quality, offsets, offset_withdrawn }))
    }
}

impl BridgeRecord<'_> {
    fn head_axes(&self) -> &[RotaryAxis] {
        self.machine.map_or(&[], |machine| &machine.head_axes)
    }

    /// Returns the column without which nothing is known of `quantity` in any row in which the bridge was on.
    fn find_missing_column(&self, quantity: Quantity) -> Option<String> {
        let is_without =
            |(&quality, offset_withdrawn): (&f64, &bool)| quality == 0.0 || *offset_withdrawn;
        if self.quality.iter().zip(&self.offset_withdrawn).all(is_without) {
            return None;
        }
        let missing = |axis: &LinearAxis| self.offsets[axis.index()].is_none();
        if let Some(axis) = quantity.axis() {
            return missing(&axis).then(|| offset_column_name(axis));
        }
        let turns = !self.head_axes().is_empty();
        let at_zero = self.tool_direction_at_zero_angles();
        let of_tool = |axis: &LinearAxis| turns || at_zero[axis.index()] != 0.0;
        if let Some(axis) = LinearAxis::ALL.into_iter().find(|axis| of_tool(axis) && missing(axis))
        {
            return Some(offset_column_name(axis));
        }
        let angle = |axis: &&RotaryAxis| self.angles_deg(**axis).is_none();
        self.head_axes().iter().find(angle).map(|axis| format!("{}_deg", axis.name()))
    }

    fn tool_direction_at_zero_angles(&self) -> [f64; 3] {
        self.machine.map_or([0.0, 0.0, -1.0], |machine| machine.tool_direction)
    }

    /// Returns the angles of a rotary axis that turns the tool. A record that was made without a machine file
    /// numbers them in the order of the head.
    fn angles_deg(&self, axis: RotaryAxis) -> Option<&[f64]> {
        let number = self.head_axes().iter().position(|candidate| *candidate == axis)? + 1;
        let by_name = self.run.column(&format!("{}_deg", axis.name()));
        by_name.or_else(|| self.run.column(&format!("angle{number}_deg")))
    }

    /// `measured` without what was applied, NaN where that is not known.
    fn subtract_offset(
        &self,
        measured: &[f64],
        quantity: Quantity,
    ) -> (Vec<f64>, ExcludedRowCounts) {
        let angles = RotaryAxis::ALL.map(|axis| self.angles_deg(axis));
        let mut account = ExcludedRowCounts::default();
        let values = (0..measured.len()).map(|row| {
            if measured[row].is_nan() {
                return f64::NAN;
            }
            account.rows += 1;
            if self.offset_withdrawn[row] {
                return measured[row];
            }
            if self.quality[row] >= MIN_UNUSABLE_QUALITY {
                account.unusable += 1;
                return f64::NAN;
            }
            // A column that is not there is not needed: see `find_missing_column`.
            let at = |column: Option<&[f64]>| column.map_or(0.0, |all| all[row]);
            let offset = self.offsets.map(at);
            let applied = match quantity.axis() {
                Some(axis) => offset[axis.index()],
                None => project_onto_tool(
                    offset,
                    tool_direction(
                        self.tool_direction_at_zero_angles(),
                        self.head_axes(),
                        angles.map(at),
                    ),
                ),
            };
            let value = measured[row] - applied;
            if self.quality[row].is_nan() || value.is_nan() {
                account.unknown += 1;
                return f64::NAN;
            }
            value
        });
        let values = values.collect();
        (values, account)
    }
}

/// Returns the share of an offset along the tool. An input without effect need not be known: a component of the
/// tool that is 0, and an offset of 0.
fn project_onto_tool(offset: [f64; 3], tool: [f64; 3]) -> f64 {
    if offset == [0.0; 3] {
        return 0.0;
    }
    let parts = offset.into_iter().zip(tool);
    parts.map(|(offset, v)| if v == 0.0 { 0.0 } else { offset * v }).sum()
}
