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
//! Rows in which it is not known what was applied are set aside: their measured value becomes a missing
//! one, and the rest of the row stays, for what has a memory. Columns of the bridge's state are no
//! longer columns of the run, so that they explain nothing.

mod estimate;
mod factor;
mod interval;
mod places;

use std::{borrow::Cow, ops::Deref};

use crate::{
    compile::compile,
    file::{LinearAxis, Machine, Quantity, RotaryAxis},
    location::BadInput,
    model::tool_direction,
    run_file::RunFile,
};

pub use factor::{Applied, Pairs, applied, leaves_nothing, predicted_um, require_applied_once};
pub use interval::Factor;
pub use places::decisive_record;

/// The quality of the offsets in a row, 0…6.
const QUALITY: &str = "quality";
/// The CRC of the calibration that the bridge ran, as a decimal number; 0: none.
const CRC: &str = "calibration_crc";
/// Further columns by which a bridge reports its state.
const STATE: [&str; 2] = ["flags", "age_ms"];
/// From this quality on (hold, ramping out, fault) the offset is not the error's opposite, or not
/// known to be followed (`docs/book/src/offsets.md`).
const FIRST_UNUSABLE: f64 = 4.0;
/// The last quality that there is.
const LAST_QUALITY: f64 = 6.0;

/// A CNC may be this much later than its limits say, in seconds: it learns of a fault, and starts.
const LATE_S: f64 = 1.0;

/// A run as it would have been measured without a bridge: the one kind of run that constants of a machine are
/// made of.
#[derive(Clone, Debug)]
pub struct Uncompensated<'r> {
    run: Cow<'r, RunFile>,
    /// The offset applied in each row, by quantity: see [`Uncompensated::offset_um`].
    offset_um: Vec<(Quantity, Vec<f64>)>,
}

impl Deref for Uncompensated<'_> {
    type Target = RunFile;

    fn deref(&self) -> &RunFile {
        &self.run
    }
}

impl<'r> Uncompensated<'r> {
    /// Returns `run` without what a bridge applied, and the notes for the user, a sentence each. A run without the
    /// columns of a bridge is unchanged.
    ///
    /// `machine` says where the tool points, and which calibration was to run; without one the tool points
    /// down and the calibration is not compared. A quantity that lacks the column of its offset is left
    /// out, and the notes say so.
    ///
    /// # Errors
    /// There are offsets without a quality; the `wanted` quantity, or every one, lacks the column of its
    /// offset; a quality other than 0…6; the bridge ran the calibration of another machine file.
    pub fn of(
        run: Cow<'r, RunFile>,
        machine: Option<&Machine>,
        wanted: Option<Quantity>,
    ) -> Result<(Self, Vec<String>), BadInput> {
        let (without, notes) = taken_out(&run, machine, wanted)?;
        let unaided = match without {
            Some((without, offset_um)) => Self { run: Cow::Owned(without), offset_um },
            None => Self { run, offset_um: Vec::new() },
        };
        Ok((unaided, notes))
    }

    /// Returns the offset along `quantity` that was taken out of each row, in µm: 0 where none was applied, NaN in
    /// rows that are set aside; `None` where the run has no columns of a bridge.
    #[must_use]
    pub fn offset_um(&self, quantity: Quantity) -> Option<&[f64]> {
        self.offset_um.iter().find(|(of, _)| *of == quantity).map(|(_, um)| &um[..])
    }

    /// Returns the same run where the machine applies `factor` times the offset: error = measured − factor·offset.
    #[must_use]
    pub fn with_factor(mut self, quantity: Quantity, factor: f64) -> Self {
        let name = format!("measured_{}_um", quantity.name());
        let offset_um = self.offset_um.iter().find(|(of, _)| *of == quantity);
        if let (Some((_, offset_um)), Some(error)) = (offset_um, self.run.column(&name)) {
            let rows = error.iter().zip(offset_um);
            let values = rows.map(|(error, offset)| error + (1.0 - factor) * offset).collect();
            self.run.to_mut().replace(&name, values);
        }
        self
    }
}

/// Offsets along X, Y and Z, row by row, and what the user should know.
type Offsets = ([Vec<f64>; 3], Vec<String>);

/// Returns the offset along each linear axis that a bridge had applied in each row of `run`, in µm: 0 where none was
/// applied, NaN where it is not known; and what the user should know, a sentence each. It is for
/// errors that are measured across axes; `None` where the run has no columns of a bridge.
///
/// # Errors
/// As [`Uncompensated::of`].
pub fn offsets_um(run: &RunFile, machine: Option<&Machine>) -> Result<Option<Offsets>, BadInput> {
    let mut notes = Vec::new();
    let Some(record) = Record::of(run, machine, &mut notes)? else { return Ok(None) };
    let nothing = vec![0.0; run.rows()];
    let mut account = Account::default();
    let offsets = LinearAxis::ALL.map(|axis| {
        let quantity = Quantity::of_axis(axis);
        if record.offsets[axis.index()].is_none() {
            let is_known = record.lacks(quantity).is_none();
            return vec![if is_known { 0.0 } else { f64::NAN }; run.rows()];
        }
        let (left_um, of_axis) = record.without(&nothing, quantity);
        account = of_axis;
        left_um.into_iter().map(|um| -um).collect()
    });
    let file = run.path().display();
    notes.extend(account.notes("radial deviation").map(|note| format!("{file}: {note}")));
    Ok(Some((offsets, notes)))
}

/// A run without what was applied, and what that was, by quantity.
type Without = (RunFile, Vec<(Quantity, Vec<f64>)>);

/// `run` without what was applied; `None` where nothing was. The notes and the errors are those of
/// [`Uncompensated::of`].
fn taken_out(
    run: &RunFile,
    machine: Option<&Machine>,
    wanted: Option<Quantity>,
) -> Result<(Option<Without>, Vec<String>), BadInput> {
    let mut notes = Vec::new();
    let Some(record) = Record::of(run, machine, &mut notes)? else {
        return Ok((None, notes));
    };
    let file = run.path().display();
    let mut cleaned = run.clone();
    let mut not_known = None;
    let mut offset_um = Vec::new();
    for quantity in Quantity::ALL {
        let name = format!("measured_{}_um", quantity.name());
        let Some(measured) = run.column(&name) else { continue };
        match record.lacks(quantity) {
            Some(missing) => {
                let rule = format!(
                    "column {missing} is missing: what the bridge applied cannot be taken out of {name}"
                );
                notes.push(format!("{file}: {rule}; {name} is left out"));
                let bad = BadInput::new(run.header_place(), rule);
                if wanted == Some(quantity) {
                    return Err(bad);
                }
                not_known.get_or_insert(bad);
                cleaned.remove(|column| column == name);
            }
            None => {
                let (values, account) = record.without(measured, quantity);
                notes.extend(account.notes(&name).map(|note| format!("{file}: {note}")));
                let rows = measured.iter().zip(&values);
                offset_um
                    .push((quantity, rows.map(|(measured, error)| measured - error).collect()));
                cleaned.replace(&name, values);
            }
        }
    }
    if let (true, Some(bad)) = (offset_um.is_empty(), not_known) {
        return Err(bad);
    }
    let says_state = |name: &str| {
        [QUALITY, CRC].contains(&name)
            || STATE.contains(&name)
            || LinearAxis::ALL.iter().any(|axis| offset_name(*axis) == name)
    };
    cleaned.remove(says_state);
    Ok((Some((cleaned, offset_um)), notes))
}

fn offset_name(axis: LinearAxis) -> String {
    format!("offset_{}_um", axis.name())
}

fn check_quality(run: &RunFile, quality: &[f64]) -> Result<(), BadInput> {
    let is_one = |value: f64| value.fract() == 0.0 && (0.0..=LAST_QUALITY).contains(&value);
    match quality.iter().position(|&value| !value.is_nan() && !is_one(value)) {
        None => Ok(()),
        Some(row) => {
            let rule = format!("must be 0 to {LAST_QUALITY}, not {}", quality[row]);
            Err(run.bad(row, QUALITY, rule))
        }
    }
}

/// Compares the calibration that ran with that of `machine`; says so where it cannot.
fn calibration(run: &RunFile, machine: Option<&Machine>) -> Result<Option<String>, BadInput> {
    let Some(machine) = machine else { return Ok(None) };
    // A bridge without a calibration applies nothing.
    let ran = |crc: f64| !crc.is_nan() && crc != 0.0;
    let crcs = run.column(CRC).unwrap_or_default();
    if !crcs.iter().any(|&crc| ran(crc)) {
        return Ok(Some(format!(
            "there is no {CRC}: nobody knows whether the bridge ran the calibration of this machine file"
        )));
    }
    let own = match compile(machine) {
        Ok(compiled) => compiled.crc(),
        Err(why) => {
            return Ok(Some(format!(
                "{CRC} cannot be compared: this machine file does not compile ({why})"
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
            Err(run.bad(row, CRC, rule))
        }
    }
}

/// A run with what the bridge says in it.
struct Record<'r> {
    run: &'r RunFile,
    machine: Option<&'r Machine>,
    quality: &'r [f64],
    offsets: [Option<&'r [f64]>; 3],
    /// The rows in which a CNC has taken back what it applied, because it was given no offset for so long.
    taken_back: Vec<bool>,
}

/// Returns the rows from which on no offset was available for longer than a CNC takes to go to 0.
fn taken_back(run: &RunFile, machine: Option<&Machine>, quality: &[f64]) -> Vec<bool> {
    let limits = machine.map(|machine| machine.limits).unwrap_or_default();
    let way_um = limits.max_um.into_iter().fold(0.0, f64::max);
    let lasts_s = f64::from(limits.hold_ms) / 1e3 + way_um / limits.slew_um_per_s + LATE_S;
    let Some(time_s) = run.column("time_s") else { return vec![false; quality.len()] };
    let (mut since, mut before) = (None, f64::NAN);
    let rows = quality.iter().zip(time_s).map(|(&quality, &now)| {
        if quality != LAST_QUALITY || now.is_nan() || now < before {
            since = None;
        }
        before = now;
        if quality != LAST_QUALITY || now.is_nan() {
            return false;
        }
        now - *since.get_or_insert(now) > lasts_s
    });
    rows.collect()
}

/// How many measured rows could not be used.
#[derive(Default)]
struct Account {
    rows: usize,
    unusable: usize,
    unknown: usize,
}

impl Account {
    fn notes(&self, name: &str) -> impl Iterator<Item = String> {
        let told = |count: usize, why: &str| {
            let rows = self.rows;
            (count > 0).then(|| format!("{name}: {count} of {rows} rows are set aside: {why}"))
        };
        let unusable = "the bridge held, ramped out or was not available (quality 4 and above), or not for long enough that \
                        a CNC has taken its offset back";
        let unknown = "quality or offset is missing, so what the bridge applied is not known";
        [told(self.unusable, unusable), told(self.unknown, unknown)].into_iter().flatten()
    }
}

impl<'r> Record<'r> {
    /// Returns the columns of a bridge, `None` where `run` has none; adds to `notes` what the user should know.
    fn of(
        run: &'r RunFile,
        machine: Option<&'r Machine>,
        notes: &mut Vec<String>,
    ) -> Result<Option<Self>, BadInput> {
        let offsets = LinearAxis::ALL.map(|axis| run.column(&offset_name(axis)));
        if run.column(QUALITY).is_none() && offsets.iter().all(Option::is_none) {
            return Ok(None);
        }
        let quality = run.require(QUALITY).map_err(|mut bad| {
            bad.rule += "; without it nobody knows in which rows an offset was applied";
            bad
        })?;
        check_quality(run, quality)?;
        let file = run.path().display();
        notes.extend(calibration(run, machine)?.map(|note| format!("{file}: {note}")));
        let taken_back = taken_back(run, machine, quality);
        Ok(Some(Self { run, machine, quality, offsets, taken_back }))
    }
}

impl Record<'_> {
    fn head_axes(&self) -> &[RotaryAxis] {
        self.machine.map_or(&[], |machine| &machine.head_axes)
    }

    /// Returns the column without which nothing is known of `quantity` in any row in which the bridge was on.
    fn lacks(&self, quantity: Quantity) -> Option<String> {
        let is_without = |(&quality, taken_back): (&f64, &bool)| quality == 0.0 || *taken_back;
        if self.quality.iter().zip(&self.taken_back).all(is_without) {
            return None;
        }
        let missing = |axis: &LinearAxis| self.offsets[axis.index()].is_none();
        if let Some(axis) = quantity.axis() {
            return missing(&axis).then(|| offset_name(axis));
        }
        let turns = !self.head_axes().is_empty();
        let at_zero = self.direction_at_zero();
        let of_tool = |axis: &LinearAxis| turns || at_zero[axis.index()] != 0.0;
        if let Some(axis) = LinearAxis::ALL.into_iter().find(|axis| of_tool(axis) && missing(axis))
        {
            return Some(offset_name(axis));
        }
        let angle = |axis: &&RotaryAxis| self.angle(**axis).is_none();
        self.head_axes().iter().find(angle).map(|axis| format!("{}_deg", axis.name()))
    }

    fn direction_at_zero(&self) -> [f64; 3] {
        self.machine.map_or([0.0, 0.0, -1.0], |machine| machine.tool_direction)
    }

    /// Returns the angles of a rotary axis that turns the tool. A record that was made without a machine file
    /// numbers them in the order of the head.
    fn angle(&self, axis: RotaryAxis) -> Option<&[f64]> {
        let number = self.head_axes().iter().position(|it| *it == axis)? + 1;
        let by_name = self.run.column(&format!("{}_deg", axis.name()));
        by_name.or_else(|| self.run.column(&format!("angle{number}_deg")))
    }

    /// `measured` without what was applied, NaN where that is not known.
    fn without(&self, measured: &[f64], quantity: Quantity) -> (Vec<f64>, Account) {
        let angles = RotaryAxis::ALL.map(|axis| self.angle(axis));
        let mut account = Account::default();
        let values = (0..measured.len()).map(|row| {
            if measured[row].is_nan() {
                return f64::NAN;
            }
            account.rows += 1;
            if self.taken_back[row] {
                return measured[row];
            }
            if self.quality[row] >= FIRST_UNUSABLE {
                account.unusable += 1;
                return f64::NAN;
            }
            // A column that is not there is not needed: see `lacks`.
            let at = |column: Option<&[f64]>| column.map_or(0.0, |all| all[row]);
            let offset = self.offsets.map(at);
            let applied = match quantity.axis() {
                Some(axis) => offset[axis.index()],
                None => along_tool(
                    offset,
                    tool_direction(self.direction_at_zero(), self.head_axes(), angles.map(at)),
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
fn along_tool(offset: [f64; 3], tool: [f64; 3]) -> f64 {
    if offset == [0.0; 3] {
        return 0.0;
    }
    let parts = offset.into_iter().zip(tool);
    parts.map(|(offset, v)| if v == 0.0 { 0.0 } else { offset * v }).sum()
}
