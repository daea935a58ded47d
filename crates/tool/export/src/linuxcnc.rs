//! LinuxCNC: `[JOINT_n] COMP_FILE` with `COMP_FILE_TYPE = 1`.
//!
//! A line is `nominal forward reverse`, machine units, nominal rising, at most 256 lines. With type
//! 1 the two values are trims, nominal minus actual, which the motion controller adds to the
//! joint's command: **trim = −error**. Between the lines it is linear, beyond them the end values
//! hold; the sign of the joint's speed chooses the column, and at rest the last choice stays.
//! It takes the place of `BACKLASH`, so the backlash is folded into the reverse column.
//!
//! By hand: an error of +2 µm (too far) at 100 mm and a backlash of 5 µm give the line
//! `100 -0.002 -0.007`.
//!
//! The loader stops at the first line that is not three numbers and still reports success, so the
//! file has no header, no comment and no empty line; [`parse`] refuses what the loader would skip.
//! The real LinuxCNC is compared in `host-tests/tests/linuxcnc_comp.rs`: what it adds is within
//! 0.0004 µm of what [`CompensationTable::trim_at`] says.

use std::fmt::Write as _;

use trueup_machine::{Machine, machine_file::LinearAxis};

use crate::{
    ExportOptions, ExportReport, ExportResult, ExportedFile, ExportedTable,
    axis_errors::{DriveErrorModel, collect_cross_axis_errors, collect_drive_errors},
    number_format::format_number,
    report::ApproachDirection,
    table_points::{
        comparison_positions_mm, find_largest_residual, interpolate_linear, select_breakpoints,
    },
};

/// The most lines that the motion controller stores for a joint.
pub const MAX_COMPENSATION_ENTRIES: usize = 256;
/// Trims and positions are written to this many decimals: 0.01 nm in a metric machine.
const COMPENSATION_DECIMALS: usize = 8;

/// A compensation file as the motion controller holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct CompensationTable {
    /// Nominal position and trim, in machine units, for positive speeds.
    forward: Vec<(f64, f64)>,
    /// The same for negative speeds.
    reverse: Vec<(f64, f64)>,
}

/// Reads a file of type 1.
///
/// # Errors
/// A line that is not three numbers, a nominal position that does not rise, or more than
/// [`MAX_COMPENSATION_ENTRIES`]: the loader would stop there, and the machine would cut with half a table.
pub fn parse(text: &str) -> Result<CompensationTable, String> {
    let mut read = CompensationTable { forward: Vec::new(), reverse: Vec::new() };
    for (index, line) in text.lines().enumerate() {
        let line_number = index + 1;
        let numbers: Vec<f64> =
            line.split_whitespace().map_while(|word| word.parse().ok()).collect();
        let [nominal, forward, reverse] = numbers[..] else {
            return Err(format!("line {line_number} is not three numbers: the loader stops there"));
        };
        if read.forward.last().is_some_and(|&(before, _)| nominal <= before) {
            return Err(format!("line {line_number}: {nominal} does not rise"));
        }
        if index == MAX_COMPENSATION_ENTRIES {
            return Err(format!("more than {MAX_COMPENSATION_ENTRIES} lines"));
        }
        read.forward.push((nominal, forward));
        read.reverse.push((nominal, reverse));
    }
    Ok(read)
}

impl CompensationTable {
    /// Returns what is added to the joint's command, in machine units.
    #[must_use]
    pub fn trim_at(&self, position: f64, approach: ApproachDirection) -> f64 {
        match approach {
            ApproachDirection::Positive => interpolate_linear(&self.forward, position),
            ApproachDirection::Negative => interpolate_linear(&self.reverse, position),
        }
    }
}

pub(crate) fn export(machine: &Machine, options: &ExportOptions, export: &mut ExportResult) {
    for drive in collect_drive_errors(machine, options) {
        export_drive(&drive, options, export);
    }
    report_unsupported_sections(machine, &mut export.report);
    if !export.files.is_empty() {
        export.report.add_note(
            "set COMP_FILE and COMP_FILE_TYPE = 1 in [JOINT_n], and remove BACKLASH there: the \
             file takes its place",
        );
        export.report.add_note(format!(
            "LINEAR_UNITS must be {}; nothing is corrected before the first move shows a direction",
            options.units.name()
        ));
    }
}

fn export_drive(drive: &DriveErrorModel<'_>, options: &ExportOptions, export: &mut ExportResult) {
    if drive.is_constant() && drive.error_um(0.0, ApproachDirection::Positive) == 0.0 {
        return;
    }
    let mut positions_mm = drive.breakpoints_mm();
    if positions_mm.is_empty() {
        // One line holds everywhere.
        positions_mm.push(0.0);
    }
    let columns = ApproachDirection::BOTH.map(|approach| {
        positions_mm.iter().map(|&mm| drive.error_um(mm, approach)).collect::<Vec<f64>>()
    });
    let most =
        options.most_points.unwrap_or(MAX_COMPENSATION_ENTRIES).clamp(2, MAX_COMPENSATION_ENTRIES);
    let keeps_all = !drive.is_curved() && positions_mm.len() <= most;
    let (rows, off_um) = if keeps_all {
        ((0..positions_mm.len()).collect(), 0.0)
    } else {
        let tolerance_um = if drive.is_curved() { options.tolerance_um / 2.0 } else { 0.0 };
        select_breakpoints(&positions_mm, &columns, tolerance_um, most)
    };
    let is_lost = !keeps_all && (!drive.is_curved() || off_um > options.tolerance_um);
    let loss = is_lost.then(|| {
        format!(
            "{} of {} points are omitted, down to the best {}: lines up to {off_um:.3} µm off",
            positions_mm.len() - rows.len(),
            positions_mm.len(),
            rows.len()
        )
    });
    let unit_mm = options.units.mm_per_unit();
    let mut text = String::new();
    for &row in &rows {
        let [forward, reverse] = [0, 1].map(|column| {
            format_number(-columns[column][row] / 1000.0 / unit_mm, COMPENSATION_DECIMALS)
        });
        let nominal = format_number(positions_mm[row] / unit_mm, COMPENSATION_DECIMALS);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{nominal} {forward} {reverse}");
    }
    let name = format!("{}.comp", drive.name());
    let back = match parse(&text) {
        Ok(back) => back,
        Err(rule) => {
            export.report.add_omitted_section(
                drive.source_sections(),
                format!("LinuxCNC would not load it: {rule}"),
            );
            return;
        }
    };
    let range = (positions_mm[0], positions_mm[positions_mm.len() - 1]);
    let largest = find_largest_residual(
        &comparison_positions_mm(range, &positions_mm, drive.has_constant_extrapolation()),
        |mm, approach| drive.error_um(mm, approach),
        |mm, approach| back.trim_at(mm / unit_mm, approach) * unit_mm * 1000.0,
    );
    export.report.tables.push(ExportedTable {
        file: name.clone(),
        name: format!("COMP_FILE of the joint of {}", drive.name()),
        section: drive.source_sections(),
        points: rows.len(),
        range,
        spacing: None,
        constant_um: 0.0,
        largest,
        loss,
    });
    if drive.is_second {
        export.report.add_note(format!(
            "{name} is for the joint of the second drive of {}: the beam itself shares the error \
             out between the two",
            drive.axis.name()
        ));
    }
    export.files.push(ExportedFile { name, text });
}

fn report_unsupported_sections(machine: &Machine, report: &mut ExportReport) {
    for cross in collect_cross_axis_errors(machine) {
        let reason =
            "LinuxCNC's tables correct a joint by its own position only; the bridge corrects this";
        report.add_omitted_section(cross.source_sections(), reason);
    }
    report_omitted_thermal_terms(
        machine,
        report,
        "LinuxCNC has no compensation by temperature; the bridge has",
    );
}

/// The parts of the model that change while the machine runs, for controls with nothing for them.
pub(crate) fn report_omitted_thermal_terms(
    machine: &Machine,
    report: &mut ExportReport,
    reason: &str,
) {
    for axis in LinearAxis::ALL {
        if machine.axes[axis.index()].thermal.is_some() {
            report.add_omitted_section(format!("axis.{}.thermal", axis.name()), reason);
        }
    }
    if let Some(source) = machine.spindle.source {
        report.add_omitted_section(format!("spindle.{}", source.name()), reason);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_loader_would_stop_at_is_refused() {
        for (text, rule) in [
            ("# a comment\n0 0 0\n", "line 1 is not three numbers"),
            ("0 0 0\n\n1 0 0\n", "line 2 is not three numbers"),
            ("0 0\n", "line 1 is not three numbers"),
            ("0 0 0\n0 1 1\n", "line 2: 0 does not rise"),
        ] {
            assert!(parse(text).is_err_and(|error| error.starts_with(rule)), "{text:?}");
        }
        let lines = |n: usize| (0..n).map(|k| format!("{k} 0 0\n")).collect::<String>();
        assert!(parse(&lines(256)).is_ok());
        assert_eq!(parse(&lines(257)), Err("more than 256 lines".to_string()));
    }

    #[test]
    fn the_direction_chooses_the_column_and_the_ends_hold() {
        let read = parse("0 0.001 0.004\n100 0.003 -0.002\n").unwrap();
        for (mm, forward, reverse) in
            [(-50.0, 0.001, 0.004), (50.0, 0.002, 0.001), (150.0, 0.003, -0.002)]
        {
            assert!((read.trim_at(mm, ApproachDirection::Positive) - forward).abs() < 1e-15);
            assert!((read.trim_at(mm, ApproachDirection::Negative) - reverse).abs() < 1e-15);
        }
    }
}
