//! Straightness on a FANUC: four points for each of three pairs of axes.
//!
//! For a moving axis (5711 …) and the one that is corrected (5721 …), the numbers of four points of
//! the moving axis (5731 …, 5741 …, 5751 …) and the correction at each, in detection units (5761 …,
//! 5771 …, 5781 …). It is straight between them; the ends are the first and the last point of the
//! axis, and the two in between are where they keep the lines nearest to the curve. A curve of which four
//! points take less than nine tenths is not written: it is omitted, with what they would lose.

use trueup_machine::Machine;

use super::{AxisCompensation, CompensationData};
use crate::{
    ExportOptions, ExportReport, ExportResult, ExportedTable,
    axis_errors::{CrossAxisError, collect_cross_axis_errors},
    table_points::{
        comparison_positions_mm, find_largest_residual, interpolate_linear, select_breakpoints,
    },
};

/// This many pairs of axes there are.
const MAX_AXIS_PAIRS: usize = 3;
/// This many points has a pair.
const POINTS_PER_PAIR: usize = 4;

/// Returns the pairs that are exported: the three that reach furthest.
pub(super) fn select_cross_axis_errors<'m>(
    machine: &'m Machine,
    options: &ExportOptions,
    report: &mut ExportReport,
) -> Vec<CrossAxisError<'m>> {
    let mut with_span = Vec::new();
    for cross in collect_cross_axis_errors(machine) {
        let Some((first, last)) = cross.range_mm(machine, options) else {
            let along = cross.along.name();
            let reason = format!("an angle needs the travel of {along}: give it with --travel");
            report.add_omitted_section(cross.source_sections(), reason);
            continue;
        };
        let values = (0..=EVALUATION_INTERVALS).map(|k| {
            cross.error_um(first + (last - first) * f64::from(k) / f64::from(EVALUATION_INTERVALS))
        });
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), um| {
            (low.min(um), high.max(um))
        });
        with_span.push((high - low, cross));
    }
    with_span.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (span_um, cross) in with_span.drain(MAX_AXIS_PAIRS.min(with_span.len())..) {
        let reason = format!(
            "straightness has {MAX_AXIS_PAIRS} pairs of axes, and this one is among the smaller \
             ({span_um:.1} µm)"
        );
        report.add_omitted_section(cross.source_sections(), reason);
    }
    with_span.into_iter().map(|(_, cross)| cross).collect()
}

/// A curve of which more than this stays is not written: nine tenths gone is what a compensation is for
/// (paper 3; `trueup accept`).
const MAX_RESIDUAL_RATIO: f64 = 0.1;
/// This many places of a curve are looked at before it is taken.
const EVALUATION_INTERVALS: u32 = 1000;

/// One pair of axes as it is written.
pub(super) struct AxisPair<'m> {
    order: u32,
    cross: CrossAxisError<'m>,
    /// The numbers of the axes.
    moving: usize,
    corrected: usize,
    /// Point numbers, and the corrections there in detection units.
    points: [i64; POINTS_PER_PAIR],
    values: [i64; POINTS_PER_PAIR],
    reference_mm: f64,
    constant_um: f64,
    range_mm: (f64, f64),
    special_mm: Vec<f64>,
}

impl AxisPair<'_> {
    /// Number and value of each of its parameters.
    pub fn parameters(&self) -> Vec<(u32, i64)> {
        let mut all = vec![
            (5711 + self.order, self.moving as i64),
            (5721 + self.order, self.corrected as i64),
        ];
        for (offset, (&point, &value)) in (0..).zip(self.points.iter().zip(&self.values)) {
            all.push((5731 + 10 * self.order + offset, point));
            all.push((5761 + 10 * self.order + offset, value));
        }
        all.sort_unstable();
        all
    }
}

pub(super) fn plan_axis_pairs<'m>(
    planned: &[AxisCompensation<'m>],
    options: &ExportOptions,
    number_of: impl Fn(&AxisCompensation<'m>) -> usize,
    report: &mut ExportReport,
) -> Vec<AxisPair<'m>> {
    let mut pairs = Vec::new();
    for (index, plan) in planned.iter().enumerate() {
        let base = (index * super::MAX_POINTS_PER_AXIS) as i64;
        let positions_mm = plan.points.positions_mm();
        for cross in &plan.cross_axis_errors {
            let constant_um = cross.error_um(plan.points.reference_mm);
            let error_um: Vec<f64> =
                positions_mm.iter().map(|&mm| cross.error_um(mm) - constant_um).collect();
            let (mut rows, _) = select_breakpoints(
                &positions_mm,
                std::slice::from_ref(&error_um),
                0.0,
                POINTS_PER_PAIR,
            );
            // A curve that needs fewer gets the others anywhere: on its lines.
            let mut spare = (0..positions_mm.len()).filter(|row| !rows.contains(row));
            let missing: Vec<usize> = spare.by_ref().take(POINTS_PER_PAIR - rows.len()).collect();
            rows.extend(missing);
            rows.sort_unstable();
            let at = |k: usize| rows.get(k).copied().unwrap_or(positions_mm.len() - 1);
            let nodes: Vec<(f64, f64)> =
                [0, 1, 2, 3].map(|k| (positions_mm[at(k)], error_um[at(k)])).into();
            let (first, last) = (positions_mm[0], positions_mm[positions_mm.len() - 1]);
            let (mut off_um, mut low, mut high) = (0.0_f64, f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..=EVALUATION_INTERVALS {
                let mm = first + (last - first) * f64::from(k) / f64::from(EVALUATION_INTERVALS);
                let um = cross.error_um(mm) - constant_um;
                off_um = off_um.max((um - interpolate_linear(&nodes, mm)).abs());
                (low, high) = (low.min(um), high.max(um));
            }
            if off_um > MAX_RESIDUAL_RATIO * (high - low)
                && off_um > options.tolerance_um + options.unit_um
            {
                let reason = format!(
                    "straightness has {POINTS_PER_PAIR} points, and lines between the best {POINTS_PER_PAIR} are \
                     {off_um:.1} µm off, of {:.1} µm: not written",
                    high - low
                );
                report.add_omitted_section(cross.source_sections(), reason);
                continue;
            }
            let corrected = cross.error.index() + 1;
            pairs.push(AxisPair {
                order: pairs.len() as u32,
                cross: cross.clone(),
                moving: number_of(plan),
                corrected,
                points: [0, 1, 2, 3].map(|k| base + at(k) as i64),
                values: [0, 1, 2, 3].map(|k| (-error_um[at(k)] / options.unit_um).round() as i64),
                reference_mm: plan.points.reference_mm,
                constant_um,
                range_mm: (positions_mm[0], positions_mm[positions_mm.len() - 1]),
                special_mm: [positions_mm.clone(), cross.knot_positions_mm()].concat(),
            });
        }
    }
    pairs
}

pub(super) fn compare_axis_pairs(
    pairs: &[AxisPair<'_>],
    control: &CompensationData,
    options: &ExportOptions,
    export: &mut ExportResult,
) {
    for pair in pairs {
        match compare_axis_pair(pair, control, options) {
            Ok(table) => export.report.tables.push(table),
            Err(rule) => {
                let reason = format!("it reads back wrong: {rule}");
                export.report.add_omitted_section(pair.cross.source_sections(), reason);
            }
        }
    }
}

fn compare_axis_pair(
    pair: &AxisPair<'_>,
    control: &CompensationData,
    options: &ExportOptions,
) -> Result<ExportedTable, String> {
    let of = |number: u32| control.parameter(number + pair.order, 0);
    let (moving, corrected) = (of(5711)?, of(5721)?);
    let moving_axis = usize::try_from(moving).map_err(|_| format!("5711 is {moving}"))?;
    let (reference, spacing) =
        (control.parameter(3620, moving_axis)?, control.parameter(3624, moving_axis)?);
    let mut points = Vec::new();
    for offset in 0..POINTS_PER_PAIR as u32 {
        let point = control.parameter(5731 + 10 * pair.order + offset, 0)?;
        let value = control.parameter(5761 + 10 * pair.order + offset, 0)?;
        let mm = pair.reference_mm + (point - reference) as f64 * spacing as f64 / 1000.0;
        points.push((mm, value as f64 * options.unit_um));
    }
    let cross = &pair.cross;
    let largest = find_largest_residual(
        &comparison_positions_mm(
            pair.range_mm,
            &pair.special_mm,
            cross.has_constant_extrapolation(),
        ),
        |mm, _| cross.error_um(mm) - pair.constant_um,
        |mm, _| interpolate_linear(&points, mm),
    );
    // Half a unit is the rounding, not the four points.
    let is_lost = largest.um > options.tolerance_um + options.unit_um / 2.0;
    Ok(ExportedTable {
        file: "CNC-PARA.TXT".to_string(),
        name: format!("straightness, axis {corrected} along axis {moving}"),
        section: cross.source_sections(),
        points: POINTS_PER_PAIR,
        range: pair.range_mm,
        spacing: None,
        constant_um: pair.constant_um,
        largest,
        loss: is_lost.then(|| format!("the best {POINTS_PER_PAIR} points, which is all there are")),
    })
}
