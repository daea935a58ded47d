//! HEIDENHAIN: nonlinear axis error compensation by `.COM` and `.CMA` tables.
//!
//! A `.COM` table belongs to one axis that moves. `AXISPOS` is its position from the machine datum,
//! at any distance; the column of an axis is that axis's value there, so one table holds the pitch
//! errors of the axis and the straightness of two others; `BACKLASH` is the axis's own value
//! measured in the negative direction. At most 256 entries. The `.CMA` says which table is entered
//! for which axis: *axis in the column of the `.COM`* = F(*axis in the column of the `.CMA`*), and
//! the line with `*` is active.
//!
//! **Sign:** the value is the **error** in mm, positive where the axis goes too far, and the control
//! corrects the opposite. By hand: an error of +2 µm at 100 mm and a backlash of 5 µm give
//! `AXISPOS +100 BACKLASH +0.007 X +0.002`.
//!
//! The columns and the limit are from HEIDENHAIN's manuals; the sign is the one that they state for
//! the linear axis error (positive for a travel that is too long). That values between the entries
//! are linear, that the end values hold beyond them, and the resolution of 0.1 µm are assumed:
//! check one point with an indicator before cutting.

use std::fmt::Write as _;

use trueup_machine::{Machine, machine_file::LinearAxis};

use crate::{
    ExportOptions, ExportResult, ExportedFile, ExportedTable,
    axis_errors::{
        CrossAxisError, DriveErrorModel, collect_cross_axis_errors, collect_drive_errors,
    },
    linuxcnc::report_omitted_thermal_terms,
    number_format::format_signed,
    report::{ApproachDirection, LargestDifference},
    table_points::{
        comparison_positions_mm, find_largest_residual, interpolate_linear, select_breakpoints,
    },
};

/// The most entries of a table.
pub(crate) const MAX_TABLE_ENTRIES: usize = 256;
/// Values to 0.1 µm.
const VALUE_DECIMALS: usize = 4;
/// Positions to 0.1 µm.
const POSITION_DECIMALS: usize = 4;
/// A curve is looked at in this many equal parts before its best points are chosen, …
const CANDIDATES_PER_CURVE: f64 = 1000.0;
/// … and each of its spans in at least this many.
const CANDIDATES_PER_SPAN: f64 = 16.0;

/// A `.COM` table as the control holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct CompensationTable {
    /// The names of the columns after `NR` and `AXISPOS`.
    columns: Vec<String>,
    /// One curve a column: position and value, both in mm.
    curves: Vec<Vec<(f64, f64)>>,
}

/// Reads a `.COM` table.
///
/// # Errors
/// The frame, the column names, a number, the order of the positions or the number of entries is
/// not as it must be.
pub fn parse(text: &str) -> Result<CompensationTable, String> {
    let mut lines = text.lines();
    let head = lines.next().unwrap_or_default();
    if !(head.starts_with("BEGIN ") && head.ends_with(" MM")) {
        return Err("the first line is not BEGIN … MM".to_string());
    }
    let names: Vec<&str> = lines.next().unwrap_or_default().split_whitespace().collect();
    let ["NR", "AXISPOS", rest @ ..] = &names[..] else {
        return Err("the columns do not begin with NR AXISPOS".to_string());
    };
    let columns: Vec<String> = rest.iter().map(|name| (*name).to_string()).collect();
    let mut curves = vec![Vec::new(); columns.len()];
    let mut entries = 0;
    for line in lines.by_ref().take_while(|line| *line != "[END]") {
        let numbers: Vec<f64> =
            line.split_whitespace().map_while(|word| word.parse().ok()).collect();
        let [entry, position, values @ ..] = &numbers[..] else {
            return Err(format!("{line:?} is not an entry"));
        };
        if *entry != f64::from(entries) || values.len() != columns.len() {
            return Err(format!("{line:?} is not an entry {entries} of {} values", columns.len()));
        }
        for (curve, value) in curves.iter_mut().zip(values) {
            if curve.last().is_some_and(|&(before, _)| *position <= before) {
                return Err(format!("AXISPOS {position} does not rise"));
            }
            curve.push((*position, *value));
        }
        entries += 1;
    }
    if entries as usize > MAX_TABLE_ENTRIES {
        return Err(format!("more than {MAX_TABLE_ENTRIES} entries"));
    }
    Ok(CompensationTable { columns, curves })
}

impl CompensationTable {
    /// Returns what the control adds to the command of the axis of `column`, in µm; 0 without this column.
    #[must_use]
    pub fn correction_um(&self, column: &str, position_mm: f64) -> f64 {
        let curve = self.columns.iter().position(|name| name == column).map(|at| &self.curves[at]);
        curve.map_or(0.0, |curve| -interpolate_linear(curve, position_mm) * 1000.0)
    }
}

/// One moving axis, with the drive errors and cross errors in its table.
struct MovingAxis<'m> {
    /// `X`, or `X2` for a second drive.
    key: String,
    drive: Option<DriveErrorModel<'m>>,
    cross_axis_errors: Vec<CrossAxisError<'m>>,
}

pub(crate) fn export(machine: &Machine, options: &ExportOptions, export: &mut ExportResult) {
    let mut moving: Vec<MovingAxis<'_>> = Vec::new();
    let all_drives = collect_drive_errors(machine, options);
    for axis in LinearAxis::ALL {
        for is_second in [false, true] {
            let drive = all_drives
                .iter()
                .find(|drive| drive.axis == axis && drive.is_second == is_second)
                .filter(|drive| {
                    !(drive.is_constant()
                        && drive.error_um(0.0, ApproachDirection::Positive) == 0.0)
                });
            let mut along: Vec<CrossAxisError<'_>> = Vec::new();
            for cross in collect_cross_axis_errors(machine).into_iter().filter(|_| !is_second) {
                if cross.along != axis {
                    continue;
                }
                if cross.range_mm(machine, options).is_none() {
                    let reason = format!(
                        "an angle needs the travel of {}: give it with --travel",
                        axis.name()
                    );
                    export.report.add_omitted_section(cross.source_sections(), reason);
                    continue;
                }
                along.push(cross);
            }
            if drive.is_some() || !along.is_empty() {
                let suffix = if is_second { "2" } else { "" };
                let key = format!("{}{suffix}", axis.name().to_uppercase());
                moving.push(MovingAxis { key, drive: drive.cloned(), cross_axis_errors: along });
            }
        }
    }
    for of in &moving {
        export_moving_axis(machine, options, of, export);
    }
    let reason = "a thermal offset is given to the control by its PLC at run time, not by a table";
    report_omitted_thermal_terms(machine, &mut export.report, reason);
    if export.files.is_empty() {
        return;
    }
    let keys: Vec<&str> = moving.iter().map(|of| of.key.as_str()).collect();
    let files: Vec<String> = moving.iter().map(|of| format!("{}.com", of.key)).collect();
    let text = format!(
        "BEGIN config.cma MM\nNR ACTIVE {}\n0 * {}\n[END]\n",
        keys.join(" "),
        files.join(" ")
    );
    export.files.push(ExportedFile { name: "config.cma".to_string(), text });
    export.report.add_note(
        "the value is the error, positive where the axis goes too far: check the sign with an \
         indicator at one point before cutting",
    );
    if moving.iter().any(|of| of.key.ends_with('2')) {
        export
            .report
            .add_note("a key ending in 2 is the second drive of a gantry: use its axis key");
    }
}

fn export_moving_axis(
    machine: &Machine,
    options: &ExportOptions,
    of: &MovingAxis<'_>,
    export: &mut ExportResult,
) {
    let positions_mm = candidate_positions_mm(machine, options, of);
    // The axis itself in both directions, then the others.
    let own = of.drive.as_ref();
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    let column =
        |error_um: &dyn Fn(f64) -> f64| positions_mm.iter().map(|&mm| error_um(mm)).collect();
    if let Some(drive) = own {
        let of_drive = |approach| column(&|mm| drive.error_um(mm, approach));
        columns.push(("BACKLASH".to_string(), of_drive(ApproachDirection::Negative)));
        columns.push((of.key.clone(), of_drive(ApproachDirection::Positive)));
    }
    for cross in &of.cross_axis_errors {
        let name = cross.error.name().to_uppercase();
        columns.push((name, column(&|mm| cross.error_um(mm))));
    }
    let (names, values): (Vec<String>, Vec<Vec<f64>>) = columns.into_iter().unzip();
    let most = options.most_points.unwrap_or(MAX_TABLE_ENTRIES).clamp(2, MAX_TABLE_ENTRIES);
    let is_curved = own.is_some_and(DriveErrorModel::is_curved)
        || of.cross_axis_errors.iter().any(CrossAxisError::is_curved);
    let keeps_all = !is_curved && positions_mm.len() <= most;
    let (rows, off_um) = if keeps_all {
        ((0..positions_mm.len()).collect(), 0.0)
    } else {
        let tolerance_um = if is_curved { options.tolerance_um / 2.0 } else { 0.0 };
        select_breakpoints(&positions_mm, &values, tolerance_um, most)
    };
    let loss = (off_um > options.tolerance_um).then(|| {
        format!("thinned to the best {} entries: lines up to {off_um:.3} µm off", rows.len())
    });

    let name = format!("{}.com", of.key);
    let mut text = format!("BEGIN {name} MM\nNR AXISPOS {}\n", names.join(" "));
    for (entry, &row) in rows.iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = write!(text, "{entry} {}", format_signed(positions_mm[row], POSITION_DECIMALS));
        for column in &values {
            let _ = write!(text, " {}", format_signed(column[row] / 1000.0, VALUE_DECIMALS));
        }
        text.push('\n');
    }
    text.push_str("[END]\n");

    let sections = own.map(DriveErrorModel::source_sections).into_iter();
    let sections: Vec<String> =
        sections.chain(of.cross_axis_errors.iter().map(CrossAxisError::source_sections)).collect();
    let back = match parse(&text) {
        Ok(back) => back,
        Err(rule) => {
            export
                .report
                .add_omitted_section(sections.join(" + "), format!("it reads back wrong: {rule}"));
            return;
        }
    };
    let range = (positions_mm[0], positions_mm[positions_mm.len() - 1]);
    let mut largest = LargestDifference::NONE;
    if let Some(drive) = own {
        let read_back = |mm, approach| {
            let column = if approach == ApproachDirection::Negative { "BACKLASH" } else { &of.key };
            back.correction_um(column, mm)
        };
        let probes =
            comparison_positions_mm(range, &positions_mm, drive.has_constant_extrapolation());
        let here = find_largest_residual(&probes, |mm, way| drive.error_um(mm, way), read_back);
        largest.update_max(here.um, || format!("{}, {}", of.key, here.at));
    }
    for cross in &of.cross_axis_errors {
        let name = cross.error.name().to_uppercase();
        let here = find_largest_residual(
            &comparison_positions_mm(range, &positions_mm, cross.has_constant_extrapolation()),
            |mm, _| cross.error_um(mm),
            |mm, _| back.correction_um(&name, mm),
        );
        largest.update_max(here.um, || format!("{name} of {}, {}", of.key, here.at));
    }
    export.report.tables.push(ExportedTable {
        file: name.clone(),
        name: format!("compensation of {} over {}", names.join(", "), of.key),
        section: sections.join(" + "),
        points: rows.len(),
        range,
        spacing: None,
        constant_um: 0.0,
        largest,
        loss,
    });
    export.files.push(ExportedFile { name, text });
}

/// Returns the positions among which the entries are chosen: every point of the axis's table, and the
/// curves in small parts with all their knots. Rounded as they are written, so that the value is
/// taken where the control puts it.
fn candidate_positions_mm(
    machine: &Machine,
    options: &ExportOptions,
    of: &MovingAxis<'_>,
) -> Vec<f64> {
    let mut positions_mm = of.drive.as_ref().map_or_else(Vec::new, DriveErrorModel::breakpoints_mm);
    for cross in &of.cross_axis_errors {
        let Some((first, last)) = cross.range_mm(machine, options) else { continue };
        let mut ends_mm = cross.knot_positions_mm();
        ends_mm.extend([first, last]);
        ends_mm.sort_by(f64::total_cmp);
        let is_straight = !cross.is_curved();
        for pair in ends_mm.windows(2) {
            // Knots that are close together may have much between them.
            let share = (pair[1] - pair[0]) / (last - first) * CANDIDATES_PER_CURVE;
            let parts = if is_straight { 1.0 } else { share.ceil().max(CANDIDATES_PER_SPAN) };
            let at = |part: u32| pair[0] + (pair[1] - pair[0]) * f64::from(part) / parts;
            positions_mm.extend((0..=parts as u32).map(at));
        }
    }
    if positions_mm.len() < 2 {
        // Only a backlash: the same at every position.
        let first = positions_mm.first().copied().unwrap_or(0.0);
        positions_mm = vec![first, first + 100.0];
    }
    let scale = 10_f64.powi(POSITION_DECIMALS as i32);
    for mm in &mut positions_mm {
        *mm = (*mm * scale).round() / scale;
    }
    positions_mm.sort_by(f64::total_cmp);
    positions_mm.dedup();
    positions_mm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_is_not_in_order_is_refused() {
        let table =
            |entries: &str| format!("BEGIN X.com MM\nNR AXISPOS BACKLASH X\n{entries}[END]\n");
        assert!(parse(&table("0 +0 +0 +0\n1 +10 +0.001 +0.002\n")).is_ok());
        for entries in ["0 +0 +0 +0\n1 +0 +0 +0\n", "0 +0 +0\n", "1 +0 +0 +0\n", "0 +0 x +0\n"] {
            assert!(parse(&table(entries)).is_err(), "{entries:?}");
        }
        assert!(parse("NR AXISPOS\n").is_err());
    }

    #[test]
    fn the_control_corrects_the_opposite_of_the_value() {
        let table = "BEGIN X.com MM\nNR AXISPOS BACKLASH X Z\n0 +0 +0.005 +0 +0.001\n\
                     1 +100 +0.007 +0.002 -0.003\n[END]\n";
        let read = parse(table).unwrap();
        for (column, mm, um) in
            [("X", 100.0, -2.0), ("X", 50.0, -1.0), ("BACKLASH", 100.0, -7.0), ("Z", 500.0, 3.0)]
        {
            assert!((read.correction_um(column, mm) - um).abs() < 1e-12, "{column} at {mm}");
        }
        assert_eq!(read.correction_um("Y", 50.0), 0.0);
    }
}
