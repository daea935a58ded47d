//! `[straightness.z_of_x]`: the curve of a run, as a report and a section.
//!
//! The curve itself is found by [`straightness`]. Readings that stand alone among the repeats of their position are excluded
//! first, as in `fit pitch`.

use trueup_machine::{
    InputFileError,
    applied_offsets::UncompensatedRun,
    machine_file::writer::{MachineFileEdit, NewSection, round_to_decimals},
};
use trueup_numerics::repeats;

use crate::{
    elongation::section_comment,
    report::{ExcludedRow, FitDetail, FitParameter, FitReport, FitVerdict, ResidualStatistics},
    straightness::{self, CurveMethod, ReferenceLine, StraightnessCurve, StraightnessFitOptions},
};

/// Digits after the point of coefficients in µm: 0.1 nm, the board's own step is 1 nm.
const COEFFICIENT_DECIMALS: i32 = 4;

/// Fits the curve of `quantity` over the axis that moves; `known_um` is taken off first, and must
/// have a value for each row.
///
/// # Errors
/// See [`straightness::fit_straightness_run`].
pub fn fit_curve(
    run: &UncompensatedRun<'_>,
    quantity: Option<&str>,
    known_um: impl FnOnce(&StraightnessCurve) -> Result<Option<Vec<f64>>, InputFileError>,
    options: &StraightnessFitOptions,
) -> Result<FitReport, InputFileError> {
    let mut curve = straightness::fit_straightness_run(run, quantity, options)?;
    let column = format!("measured_d{}_um", curve.error.name());
    let position = format!("{}_mm", curve.along.name());
    let (positions, measured) = (run.require_column(&position)?, run.require_column(&column)?);
    let mut y = measured.to_vec();
    let known_um = known_um(&curve)?;
    if let Some(known_um) = &known_um {
        y.iter_mut().zip(known_um).for_each(|(y, known)| *y -= known);
    }
    let direction = run.column(&format!("dir_{}", curve.along.name()));
    let found = find_outlier_rows(positions, direction, &y);
    let outliers = found.iter().map(|row| ExcludedRow {
        place: run.value_location(*row, &column),
        measured_um: measured[*row],
        reason: "far from the other readings at its position".into(),
    });
    let outliers: Vec<ExcludedRow> = outliers.collect();
    found.iter().for_each(|row| y[*row] = f64::NAN);
    if known_um.is_some() || !found.is_empty() {
        let there = |row: &usize| !positions[*row].is_nan() && !y[*row].is_nan();
        let rows: Vec<usize> = (0..y.len()).filter(there).collect();
        let take = |values: &[f64]| -> Vec<f64> { rows.iter().map(|row| values[*row]).collect() };
        curve.fit = straightness::fit(&take(positions), &take(&y), options)
            .map_err(|fault| run.value_error(0, &position, fault))?;
        curve.rows_incomplete = y.len() - rows.len() - found.len();
    }
    Ok(FitReport { excluded: outliers, ..build_report(&curve, &y, positions, column) })
}

/// Returns the rows that stand alone among the repeats of their position and direction.
fn find_outlier_rows(positions: &[f64], direction: Option<&[f64]>, y: &[f64]) -> Vec<usize> {
    let there = |row: &usize| positions[*row].is_finite() && y[*row].is_finite();
    let rows: Vec<usize> = (0..y.len()).filter(there).collect();
    let at: Vec<f64> = rows.iter().map(|row| positions[*row]).collect();
    // Only equal positions: a curve may be read anywhere.
    let (_, place_of) = repeats::group_positions(&at, 0.0);
    let side = |row: usize| usize::from(direction.is_some_and(|all| all[row] < 0.0));
    let stops: Vec<(usize, usize)> =
        rows.iter().zip(place_of).map(|(row, place)| (place, side(*row))).collect();
    let cycles = repeats::cycle_numbers(&stops);
    let readings = rows.iter().zip(stops).zip(cycles).map(|((row, (place, side)), cycle)| {
        repeats::RepeatReading { place, side, cycle, value: y[*row] }
    });
    let found = repeats::find_gross_errors(&readings.collect::<Vec<_>>());
    rows.into_iter().zip(found).filter(|(_, found)| *found).map(|(row, _)| row).collect()
}

fn build_report(
    curve: &StraightnessCurve,
    y: &[f64],
    positions: &[f64],
    column: String,
) -> FitReport {
    let fit = &curve.fit;
    let mut report = FitReport::new("straightness", column);
    let mut spline = fit.spline.clone();
    spline.control_um.iter_mut().for_each(|um| *um = round_to_decimals(*um, COEFFICIENT_DECIMALS));
    let less_line: Vec<f64> =
        y.iter().zip(positions).map(|(y, x)| y - fit.line.evaluate(*x)).collect();
    let residuals: Vec<f64> = less_line
        .iter()
        .zip(positions)
        .map(|(y, x)| y - trueup_machine::model::spline_value_um(&spline, *x))
        .collect();
    report.rows_used = fit.rows;
    report.rows_incomplete = curve.rows_incomplete;
    report.before = ResidualStatistics::from_residuals(&less_line);
    report.in_sample = ResidualStatistics::from_residuals(&residuals);
    let compared = fit.compare_methods();
    let own = CurveMethod::from_fit_method(fit.method);
    let judged = compared.iter().find(|way| way.way == own).and_then(|way| way.held_out);
    report.held_out =
        judged.map(|left| ResidualStatistics { rms_um: left.rms_um, max_um: left.largest_um });
    report.held_out_by = "every second position, by a curve through the others".into();
    report.table = compared.iter().map(|way| format!("{way}\n")).collect();
    for way in &compared {
        let held_out = way.held_out.map_or(f64::NAN, |left| left.rms_um);
        report.facts.push(FitDetail::text(
            format!("compared: {}", way.way),
            format!(
                "{} coefficients, {:.3} µm RMS, at held-out positions {held_out:.3} µm RMS",
                way.coefficients, way.residual.rms_um
            ),
        ));
    }
    report.facts.push(FitDetail::number("coefficients", spline.control_um.len() as f64));
    report.facts.push(FitDetail::number("positions", fit.positions as f64));
    report.facts.push(FitDetail::text("reference_line", fit.reference.to_string()));
    if fit.reference != ReferenceLine::AsMeasured {
        report.parameters.push(FitParameter::fixed("line_offset_um", fit.line.offset_um));
        report
            .parameters
            .push(FitParameter::fixed("line_slope_um_per_mm", fit.line.slope_um_per_mm));
    }
    if let Some(noise) = fit.noise {
        report.facts.push(FitDetail::number("noise_um", noise.um));
    }
    if let Some(um) = fit.standard_error_um {
        report.facts.push(FitDetail::number("curve_standard_error_um", um));
    }
    report.facts.push(FitDetail::text("stopped_because", fit.stopped.to_string()));
    if let Some(tolerance) = fit.tolerance_um.filter(|_| !fit.is_within_tolerance) {
        report.unmet.push(format!(
            "the largest residual is {:.3} µm, the tolerance {tolerance} µm: {}",
            fit.residual.largest_um, fit.stopped
        ));
    }
    report.warnings.extend(fit.warnings.iter().cloned());
    if let (Some(before), Some(left)) = (report.before, report.held_out)
        && left.rms_um >= before.rms_um
    {
        report.verdict = FitVerdict::DoNotCompensate(vec![
            format!("held-out positions are {:.3} µm RMS away from the curve", left.rms_um),
            format!("they are {:.3} µm RMS without any", before.rms_um),
        ]);
        return report;
    }
    let section = NewSection::new(format!("straightness.{}", curve.section_name()))
        .with_integer("order", u32::try_from(spline.order).expect("an order is 2, 3 or 4"))
        .with_numbers("knots_mm", spline.knots_mm)
        .with_numbers("control_um", spline.control_um)
        .with_header_comment(section_comment(&report));
    report.edit = MachineFileEdit::from_section(section);
    report
}

#[cfg(test)]
mod tests {
    use std::{borrow::Cow, path::Path};

    use trueup_machine::RunFile;

    use super::*;

    #[test]
    fn each_line_of_the_comparison_begins_with_the_name_of_its_way() {
        let mut text = String::from("x_mm,measured_dz_um\n");
        for row in 0..40 {
            let x = f64::from(row) * 10.0;
            text += &format!("{x},{}\n", (x / 60.0).sin() * 8.0);
        }
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let (run, _) = UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("no bridge");
        let report = fit_curve(&run, None, |_| Ok(None), &StraightnessFitOptions::default())
            .expect("a curve");
        let names: Vec<&str> = report
            .table
            .lines()
            .filter_map(|line| line.split_once(": "))
            .map(|parts| parts.0)
            .collect();
        let ways = [
            "paper's way",
            "paper's points, least squares",
            "least squares",
            "polynomial of degree 7",
            "straight lines",
        ];
        assert_eq!(names, ways);
    }
}
