//! The section of the machine file, and what the report says of its constants.

use trueup_machine::{
    machine_file::writer::NewSection,
    machine_file::{LinearAxis, ThermalLaw, ThermalMode, ThermalRow},
};

use crate::{elongation::section_comment, report::FitReport};

/// Reports the constants that the data cannot separate.
pub(super) fn report_inseparable_constants(
    report: &mut FitReport,
    mode: ThermalMode,
    is_table: bool,
) {
    if is_table {
        return;
    }
    report.warnings.push(match mode {
        ThermalMode::Position => {
            "reference_c and a constant error per metre cannot be separated: reference_c contains the scale error of the axis that is the same at every temperature"
                .into()
        }
        ThermalMode::Constant => {
            "reference_c and the zero of the instrument cannot be separated: reference_c contains the zero of the instrument"
                .into()
        }
        ThermalMode::Both => "reference_c takes the instrument to have been at zero, and the \
             axis's scale right, at one and the same temperature"
            .to_string(),
    });
}

/// Returns the section of the machine file for a fitted law.
pub(super) fn thermal_section(
    axis: LinearAxis,
    thermal: &ThermalLaw,
    report: &FitReport,
) -> NewSection {
    let mut section = NewSection::new(format!("axis.{}.thermal", axis.name()))
        .with_text("mode", thermal.mode.name())
        .with_text("sensor", thermal.sensor.clone());
    match &thermal.table {
        Some(table) => {
            let row = |row: &ThermalRow| [row.temperature_c, row.constant_um, row.slope_um_per_m];
            section = section.with_rows("table", table.iter().map(row).collect::<Vec<_>>());
        }
        None => {
            section = section.with_number("reference_c", thermal.reference_c);
            if thermal.mode.has_constant_term() {
                section = section.with_number("constant_um_per_c", thermal.constant_um_per_c);
            }
            if thermal.mode.has_position_term() {
                section = section.with_number("slope_um_per_m_per_c", thermal.slope_um_per_m_per_c);
            }
        }
    }
    section
        .with_number("origin_mm", thermal.origin_mm)
        .with_number("lag_s", thermal.lag_s)
        .with_header_comment(section_comment(report))
}
