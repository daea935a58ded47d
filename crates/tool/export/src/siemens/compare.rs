//! The tables as they were read back, against the model.

use std::fmt::Write as _;

use trueup_machine::Machine;

use super::{IniVariables, LookupTable, ModelPart, PlannedTable, machine_axis_name};
use crate::{
    ExportOptions, ExportResult, ExportedTable,
    report::{ApproachDirection, LargestDifference},
    table_points::{PointGrid, comparison_positions_mm, find_largest_residual},
};

/// Variables that were read back, or why they could not be: EEC, CEC and machine data.
pub(super) type ReadBackVariables = [Result<IniVariables, String>; 3];

pub(super) fn compare(
    machine: &Machine,
    options: &ExportOptions,
    plan: &PlannedTable<'_>,
    read: &ReadBackVariables,
    export: &mut ExportResult,
) {
    let section = match &plan.part {
        ModelPart::Drive(drive) => drive.source_sections(),
        ModelPart::CrossAxisError(cross) => cross.source_sections(),
    };
    match compare_table(machine, options, plan, read) {
        Ok((file, name, largest)) => {
            let lost = plan.was_thinned && largest.um > options.tolerance_um;
            let loss = lost.then(|| format!("thinned to {} equidistant points", plan.grid.points));
            let (PointGrid { start_mm, step_mm, points }, last_mm) =
                (plan.grid, plan.grid.end_mm());
            export.report.tables.push(ExportedTable {
                file,
                name,
                section,
                points,
                range: (start_mm, last_mm),
                spacing: (points > 1).then_some(step_mm),
                constant_um: plan.constant_um,
                largest,
                loss,
            });
        }
        Err(rule) => {
            export.report.add_omitted_section(section, format!("it reads back wrong: {rule}"))
        }
    }
}

fn compare_table(
    machine: &Machine,
    options: &ExportOptions,
    plan: &PlannedTable<'_>,
    read: &ReadBackVariables,
) -> Result<(String, String, LargestDifference), String> {
    let [eec, cec, data] = read.each_ref().map(|read| read.as_ref().map_err(Clone::clone));
    let unit_mm = options.units.mm_per_unit();
    let um = 1000.0 * unit_mm;
    let tables: Vec<LookupTable> = plan
        .cec
        .iter()
        .map(|&t| LookupTable::from_cec_variables(cec.clone()?, t))
        .collect::<Result<_, String>>()?;
    let mut name = String::new();
    for (t, lookup) in plan.cec.iter().zip(&tables) {
        let direction = ["-1", "0", "1"][(lookup.direction + 1.0) as usize];
        let _ = write!(name, "$AN_CEC[{t}] direction {direction} ");
    }
    let grid = plan.grid;
    let range = (grid.start_mm, grid.end_mm());
    match &plan.part {
        ModelPart::Drive(drive) => {
            let axis = machine_axis_name(machine, drive.axis, drive.is_second);
            let own = match (drive.is_bidirectional(), drive.is_position_dependent()) {
                (false, true) => {
                    let _ = write!(name, "$AA_ENC_COMP of {axis} ");
                    Some(LookupTable::from_eec_variables(eec?, &axis)?)
                }
                _ => None,
            };
            let backlash = if drive.backlash_um() == 0.0 {
                0.0
            } else {
                let _ = write!(name, "with MD32450 of {axis}");
                data?.number(&format!("$MA_BACKLASH[0,{axis}]"))?
            };
            // A positive value moves the axis in the negative direction.
            let correction_um = |mm: f64, approach: ApproachDirection| {
                let at = mm / unit_mm;
                let from_tables: f64 =
                    own.iter().chain(&tables).map(|table| table.value(at, approach)).sum();
                let lash = if approach == ApproachDirection::Negative { backlash } else { 0.0 };
                -(from_tables + lash) * um
            };
            let error_um = |mm, approach| drive.error_um(mm, approach) - plan.constant_um;
            let mut special = drive.breakpoints_mm();
            special.extend(grid.positions_mm());
            let probes =
                comparison_positions_mm(range, &special, drive.has_constant_extrapolation());
            let file = match (drive.is_bidirectional(), drive.is_position_dependent()) {
                (true, _) => "NC_CEC.INI",
                (false, true) => "AX_EEC.INI",
                (false, false) => "ENABLE.INI",
            };
            let largest = find_largest_residual(&probes, error_um, correction_um);
            Ok((file.to_string(), name.trim_end().to_string(), largest))
        }
        ModelPart::CrossAxisError(cross) => {
            let _ = write!(name, "from {} to {}", cross.along.name(), cross.error.name());
            let probes = comparison_positions_mm(
                range,
                &[cross.knot_positions_mm(), grid.positions_mm()].concat(),
                cross.has_constant_extrapolation(),
            );
            let largest = find_largest_residual(
                &probes,
                |mm, _| cross.error_um(mm) - plan.constant_um,
                |mm, approach| {
                    -tables.iter().map(|table| table.value(mm / unit_mm, approach)).sum::<f64>()
                        * um
                },
            );
            Ok(("NC_CEC.INI".to_string(), name, largest))
        }
    }
}
