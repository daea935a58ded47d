//! The old FANUC Series 0, by the numbers of paper 4: a sheet that is keyed in by hand.
//!
//! | parameter | is |
//! |---|---|
//! | `1000`, `2000` | the number of the point at the reference, X and Z |
//! | `0011` PML2 PML1 | the magnification, one for both: 00 ×1, 01 ×2, 10 ×4, 11 ×8 |
//! | `0756`, `0757` | the spacing of X and Z, in 0.001 mm |
//! | `1001 + n`, `2001 + n` | the value of point n (0 … 127), −7 … +7, relative to the point before |
//!
//! The ends have no parameter: the first point is reference − (negative travel/spacing) + 1, the last one
//! reference + positive travel/spacing. The control has X and Z, one table an axis and no straightness.

use std::{collections::BTreeMap, fmt::Write as _};

use trueup_machine::{Machine, machine_file::LinearAxis};

use super::{
    AxisCompensation, AxisTables, MAGNIFICATIONS, MAX_COMPENSATION_VALUE, SPACING_INCREMENT_MM,
    compare_axis_tables,
};
use crate::{
    ExportOptions, ExportReport, ExportResult, ExportedFile,
    axis_errors::{CrossAxisError, DriveErrorModel, collect_cross_axis_errors},
    number_format::format_number,
};

const SHEET_FILE_NAME: &str = "SERIES-0.TXT";

/// Returns the parameters of an axis: that of its reference point, and that of its spacing.
fn parameter_numbers(axis: LinearAxis) -> Option<(u32, u32)> {
    match axis {
        LinearAxis::X => Some((1000, 756)),
        LinearAxis::Z => Some((2000, 757)),
        LinearAxis::Y => None,
    }
}

/// Why the control cannot hold a drive, if it cannot.
pub(super) fn unsupported_reason(drive: &DriveErrorModel<'_>) -> Option<String> {
    if parameter_numbers(drive.axis).is_none() || drive.is_second {
        return Some("Series 0 has numbers for X and Z with one drive each".into());
    }
    drive.is_bidirectional().then(|| {
        "Series 0 has one table an axis: fit one table and a backlash (fit pitch --ways one)".into()
    })
}

/// All curves are omitted.
pub(super) fn report_omitted_straightness<'m>(
    machine: &'m Machine,
    report: &mut ExportReport,
) -> Vec<CrossAxisError<'m>> {
    for cross in collect_cross_axis_errors(machine) {
        report.add_omitted_section(
            cross.source_sections(),
            "Series 0 has no straightness compensation",
        );
    }
    Vec::new()
}

pub(super) fn add_parameter_sheet(
    mut planned: Vec<AxisCompensation<'_>>,
    options: &ExportOptions,
    export: &mut ExportResult,
) {
    // PML1 and PML2 hold for both axes; a coarser step always suffices where a finer one did.
    let common = planned.iter().map(|plan| plan.magnification).max().unwrap_or(1);
    for plan in &mut planned {
        plan.magnification = common;
        if !plan.compute_tables(options) {
            let section =
                plan.drive.as_ref().map_or(String::new(), DriveErrorModel::source_sections);
            let rule = format!("magnification {common}, which the other axis needs, is too coarse");
            export.report.add_omitted_section(section, rule);
            plan.tables.clear();
        }
    }
    planned.retain(|plan| !plan.tables.is_empty());
    let text = format_parameter_sheet(&planned, common);
    let report = &mut export.report;
    report
        .add_note("key it in by hand: MDI mode, PWE = 1; alarm 1000 comes: CAN and RESET together");
    report.add_note("at the end PWE = 0, then switch the power off and on, and reference");
    report.add_note(format!("detection unit {} µm", format_number(options.unit_um, 4)));
    for plan in &planned {
        let Some(drive) = &plan.drive else { continue };
        let backlash = (drive.backlash_um() / options.unit_um).round() as i64;
        if backlash != 0 {
            export.report.add_note(format!(
                "{}: set the backlash to {backlash} units in its own parameter, too",
                drive.name()
            ));
        }
        match parse_series_0_sheet(&text, drive.axis) {
            Ok((negative, spacing_mm, values)) => {
                let back = AxisTables::from_single_table(negative, spacing_mm, values, backlash);
                let axis = drive.axis.index() + 1;
                compare_axis_tables(plan, drive, &back, (axis, SHEET_FILE_NAME), options, export);
            }
            Err(rule) => {
                export.report.add_omitted_section(
                    drive.source_sections(),
                    format!("it reads back wrong: {rule}"),
                );
            }
        }
    }
    export.files.push(ExportedFile { name: SHEET_FILE_NAME.into(), text });
}

/// Returns what is keyed in, a line each: the number, the value, and what it is.
fn format_parameter_sheet(planned: &[AxisCompensation<'_>], magnification: u8) -> String {
    let bits = MAGNIFICATIONS.iter().position(|candidate| *candidate == magnification).unwrap_or(0);
    let mut text = format!(
        "FANUC SERIES 0, STORED PITCH ERROR COMPENSATION\n\
         MDI MODE, PWE = 1; ALARM 1000 COMES: PRESS CAN AND RESET TOGETHER\n\
         0011 PML2={} PML1={} (X{magnification}, BOTH AXES)\n",
        bits / 2,
        bits % 2
    );
    for plan in planned {
        let Some((reference, spacing)) = parameter_numbers(plan.axis) else { continue };
        let axis = plan.axis.name().to_uppercase();
        let at = plan.points.negative;
        let step = (plan.points.spacing_mm / SPACING_INCREMENT_MM).round();
        let last = at + plan.points.positive;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{reference:04} {at} ({axis}: POINT AT THE REFERENCE; POINTS 1 TO {last})"
        );
        let _ = writeln!(text, "{spacing:04} {step} ({axis}: SPACING, 0.001 MM)");
        for (point, value) in (1_u32..).zip(plan.tables.iter().flatten()) {
            let _ = writeln!(text, "{} {value} ({axis}: POINT {point})", reference + 1 + point);
        }
    }
    text + "PWE = 0; POWER OFF AND ON; REFERENCE\n"
}

/// Reads a sheet back: how many sections of the axis are before its reference point, its spacing in mm, and
/// the value of each section in detection units.
///
/// # Errors
/// A line is missing, or a value is outside −7 … +7.
pub fn parse_series_0_sheet(
    sheet: &str,
    axis: LinearAxis,
) -> Result<(usize, f64, Vec<i64>), String> {
    let (reference, spacing) = parameter_numbers(axis).ok_or("Series 0 has X and Z")?;
    let mut values: BTreeMap<u32, i64> = BTreeMap::new();
    let mut magnification = None;
    for line in sheet.lines() {
        let mut words = line.split(' ');
        let (Some(number), Some(value)) = (words.next(), words.next()) else { continue };
        let Ok(number) = number.parse::<u32>() else { continue };
        if number == 11 {
            let bit = |word: Option<&str>, name: &str| {
                word.and_then(|word| word.strip_prefix(name)?.parse::<usize>().ok())
            };
            let (high, low) = (bit(Some(value), "PML2="), bit(words.next(), "PML1="));
            let index = high.zip(low).map(|(high, low)| 2 * high + low);
            magnification = index.and_then(|index| MAGNIFICATIONS.get(index)).copied();
            continue;
        }
        let value = value.parse().map_err(|_| format!("{line:?} has no value"))?;
        if values.insert(number, value).is_some() {
            return Err(format!("{number} is there twice"));
        }
    }
    let of = |number: u32| values.get(&number).copied().ok_or(format!("{number:04} is missing"));
    let scale = i64::from(magnification.ok_or("0011 is missing")?);
    let negative = usize::try_from(of(reference)?).map_err(|_| "a point is below 0")?;
    let spacing_mm = of(spacing)? as f64 * SPACING_INCREMENT_MM;
    // Point 0 is 1001: the first section's is the next.
    let points = values.range(reference + 2..=reference + 128).map(|(number, value)| {
        if value.abs() > MAX_COMPENSATION_VALUE {
            return Err(format!("{number} is {value}: a value is from -7 to 7"));
        }
        Ok(value * scale)
    });
    Ok((negative, spacing_mm, points.collect::<Result<_, String>>()?))
}
