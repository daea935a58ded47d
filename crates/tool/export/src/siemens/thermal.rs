//! Errors that change while the machine runs: with the temperature of an axis, with the growth of the tool.
//!
//! The control holds one value at a time, which its PLC writes: K₀ to SD43900 and tanβ to SD43910
//! for an axis, the vector of the tool to SD42960. So two things are written: the setting data at
//! one temperature (`TEMP_COMP.INI`, at the reference unless the options say otherwise), and the law as a
//! table for the PLC (`temperature.csv`, `tool_direction.csv`), linear between its rows and held
//! beyond them. Both are read back and compared.

use std::fmt::Write as _;

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, RotaryAxis, ThermalLaw},
    model::{elongation_error_um, thermal_constant_and_slope, thermal_error_um, tool_direction},
};

use super::{IniVariables, build_ini_file, decimal_places, machine_axis_name};
use crate::{
    ExportOptions, ExportResult, ExportedFile, ExportedTable, axis_errors::travel_mm,
    number_format::format_number, report::LargestDifference, table_points::interpolate_linear,
};

/// A law that goes on for ever is written so far to both sides of its reference, in °C.
const TABLE_HALF_SPAN_C: f64 = 50.0;
/// MD20392: the control limits each component of the tool's vector to this, in mm, in silence.
const MAX_TOOL_COMPONENT_MM: f64 = 1.0;
/// A slope has no unit: 1e-9 is 1 nm over a metre.
const SLOPE_DECIMALS: usize = 12;

pub(super) fn export(machine: &Machine, options: &ExportOptions, export: &mut ExportResult) {
    let mut settings = String::new();
    let mut csv =
        "axis,temperature_c,SD43900_abs_value,SD43910_slope,SD43920_ref_position\n".to_string();
    let mut types = [0_u8; 3];
    for axis in LinearAxis::ALL {
        let Some(thermal) = &machine.axes[axis.index()].thermal else { continue };
        types[axis.index()] |= u8::from(thermal.mode.has_constant_term())
            | u8::from(thermal.mode.has_position_term()) << 1;
        write_thermal_compensation(
            &machine_axis_name(machine, axis, false),
            thermal,
            options,
            &mut settings,
            &mut csv,
        );
    }
    let has_thermal = types.iter().any(|&kind| kind != 0);
    let has_tool = machine.spindle.source.is_some();
    if has_tool {
        for (kind, index) in types.iter_mut().zip(0..) {
            *kind |= 4;
            let mm = options.elongation_um / 1000.0 * machine.tool_direction[index];
            let value =
                format_number(mm / options.units.mm_per_unit(), decimal_places(options.units));
            let _ = writeln!(settings, "$SC_TOOL_TEMP_COMP[{index}]={value}");
        }
    }
    if !(has_thermal || has_tool) {
        return;
    }
    for axis in LinearAxis::ALL.into_iter().filter(|axis| types[axis.index()] != 0) {
        let name = machine_axis_name(machine, axis, false);
        let _ = writeln!(settings, "$MA_TEMP_COMP_TYPE[{name}]={}", types[axis.index()]);
    }
    if has_tool {
        settings.push_str("$MC_TOOL_TEMP_COMP_ON=1\n");
    }
    let settings = build_ini_file("TEMP_COMP.INI", "%_N_TEMP_COMP_INI", &settings);
    let read = IniVariables::parse(&settings.text);
    export.files.push(settings);
    if has_thermal {
        export.files.push(ExportedFile { name: "temperature.csv".to_string(), text: csv.clone() });
        for axis in LinearAxis::ALL {
            let Some(thermal) = &machine.axes[axis.index()].thermal else { continue };
            let section = format!("axis.{}.thermal", axis.name());
            let of = ThermalReadBackCheck { machine, options, axis, thermal };
            match read.clone().and_then(|read| of.compare(&read, &csv)) {
                Ok(table) => export.report.tables.push(table),
                Err(rule) => {
                    export
                        .report
                        .add_omitted_section(&section, format!("it reads back wrong: {rule}"));
                }
            }
            if thermal.lag_s > 0.0 {
                let reason = format!(
                    "the control has no lag: the PLC must let {} pass a first-order lag of {} s",
                    thermal.sensor,
                    format_number(thermal.lag_s, 3)
                );
                export.report.add_omitted_section(format!("{section}.lag_s"), reason);
            }
        }
        export.report.add_note(
            "the PLC writes SD43900 and SD43910 by temperature.csv, linear between its rows and \
             held beyond; MD32760 limits how fast they take effect, in silence",
        );
    }
    if has_tool {
        export_tool_compensation(machine, options, read, export);
    }
}

/// Returns the temperatures at which a law is written: its rows, or its reference and as far as one goes.
fn table_temperatures_c(thermal: &ThermalLaw) -> Vec<f64> {
    match &thermal.table {
        Some(table) => table.iter().map(|row| row.temperature_c).collect(),
        None => {
            [-TABLE_HALF_SPAN_C, 0.0, TABLE_HALF_SPAN_C].map(|c| thermal.reference_c + c).to_vec()
        }
    }
}

/// Where the axis has no thermal error, or the first row of its table.
fn zero_error_temperature_c(thermal: &ThermalLaw) -> f64 {
    thermal
        .table
        .as_ref()
        .and_then(|table| table.first())
        .map_or(thermal.reference_c, |row| row.temperature_c)
}

/// K₀ in the control's unit and tanβ, as they are written.
fn format_thermal_coefficients(
    thermal: &ThermalLaw,
    temperature_c: f64,
    options: &ExportOptions,
) -> (String, String) {
    let (constant_um, slope_um_per_m) = thermal_constant_and_slope(thermal, temperature_c);
    let constant_um = if thermal.mode.has_constant_term() { constant_um } else { 0.0 };
    let slope = if thermal.mode.has_position_term() { slope_um_per_m * 1e-6 } else { 0.0 };
    let value = format_number(
        constant_um / 1000.0 / options.units.mm_per_unit(),
        decimal_places(options.units),
    );
    (value, format_number(slope, SLOPE_DECIMALS))
}

fn write_thermal_compensation(
    name: &str,
    thermal: &ThermalLaw,
    options: &ExportOptions,
    settings: &mut String,
    csv: &mut String,
) {
    let position = format_number(
        thermal.origin_mm / options.units.mm_per_unit(),
        decimal_places(options.units),
    );
    let now_c = options.temperatures_c.get(&thermal.sensor);
    let (value, slope) = format_thermal_coefficients(
        thermal,
        now_c.copied().unwrap_or(zero_error_temperature_c(thermal)),
        options,
    );
    // Writing to a string cannot fail.
    let _ = writeln!(settings, "$SA_TEMP_COMP_ABS_VALUE[{name}]={value}");
    let _ = writeln!(settings, "$SA_TEMP_COMP_SLOPE[{name}]={slope}");
    let _ = writeln!(settings, "$SA_TEMP_COMP_REF_POSITION[{name}]={position}");
    for c in table_temperatures_c(thermal) {
        let (value, slope) = format_thermal_coefficients(thermal, c, options);
        let _ = writeln!(csv, "{name},{},{value},{slope},{position}", format_number(c, 6));
    }
}

struct ThermalReadBackCheck<'m> {
    machine: &'m Machine,
    options: &'m ExportOptions,
    axis: LinearAxis,
    thermal: &'m ThermalLaw,
}

impl ThermalReadBackCheck<'_> {
    /// Reads the setting data and the PLC's table back, and compares both over the travel.
    fn compare(&self, settings: &IniVariables, csv: &str) -> Result<ExportedTable, String> {
        let Self { machine, options, axis, thermal } = *self;
        let name = machine_axis_name(machine, axis, false);
        let unit_mm = options.units.mm_per_unit();
        let mut rows: Vec<[f64; 4]> = Vec::new();
        for line in csv.lines().filter(|line| line.starts_with(&format!("{name},"))) {
            let numbers: Vec<f64> =
                line.split(',').skip(1).map_while(|word| word.parse().ok()).collect();
            rows.push(numbers.try_into().map_err(|_| format!("{line:?} is not a row"))?);
        }
        let column = |index: usize| -> Vec<(f64, f64)> {
            rows.iter().map(|row| (row[0], row[index])).collect()
        };
        let (constants, slopes) = (column(1), column(2));
        let [first, .., last] = &rows[..] else { return Err(format!("{name} has no rows")) };
        let (mut low, mut high) = (first[0], last[0]);
        // Beyond a table the model holds as the PLC does; a law goes on, and its rows end.
        if thermal.table.is_some() {
            (low, high) = (low - TABLE_HALF_SPAN_C, high + TABLE_HALF_SPAN_C);
        }
        let (from_mm, to_mm) = travel_mm(machine, options, axis)
            .unwrap_or((thermal.origin_mm - 1000.0, thermal.origin_mm + 1000.0));
        // ΔK = K₀ + tanβ·(P − P₀); a positive one moves the axis in the negative direction.
        let correction_um = |constant: f64, slope: f64, position: f64, mm: f64| {
            -(constant + slope * (mm / unit_mm - position)) * unit_mm * 1000.0
        };
        let mut largest = LargestDifference::NONE;
        for place in 0..=20 {
            let mm = from_mm + (to_mm - from_mm) * f64::from(place) / 20.0;
            for part in 0..=2000 {
                let c = low + (high - low) * f64::from(part) / 2000.0;
                let (constant, slope) =
                    (interpolate_linear(&constants, c), interpolate_linear(&slopes, c));
                let left =
                    correction_um(constant, slope, first[3], mm) + thermal_error_um(thermal, c, mm);
                largest.update_max(left, || format!("{c:.2} C, {mm:.1} mm"));
            }
            let now_c = options.temperatures_c.get(&thermal.sensor).copied();
            let now_c = now_c.unwrap_or(zero_error_temperature_c(thermal));
            let set = |what: &str| settings.number(&format!("$SA_TEMP_COMP_{what}[{name}]"));
            let correction =
                correction_um(set("ABS_VALUE")?, set("SLOPE")?, set("REF_POSITION")?, mm);
            let left = correction + thermal_error_um(thermal, now_c, mm);
            largest.update_max(left, || format!("{now_c:.2} C, {mm:.1} mm, in TEMP_COMP.INI"));
        }
        let bits = settings.number(&format!("$MA_TEMP_COMP_TYPE[{name}]"))? as u8;
        let requested = u8::from(thermal.mode.has_constant_term())
            | u8::from(thermal.mode.has_position_term()) << 1;
        if bits & 3 != requested {
            return Err(format!("MD32750 of {name} is {bits}"));
        }
        Ok(ExportedTable {
            file: "temperature.csv".to_string(),
            name: format!("SD43900 and SD43910 of {name} by {} in C", thermal.sensor),
            section: format!("axis.{}.thermal", axis.name()),
            points: rows.len(),
            range: (first[0], last[0]),
            spacing: None,
            constant_um: 0.0,
            largest,
            loss: None,
        })
    }
}

fn export_tool_compensation(
    machine: &Machine,
    options: &ExportOptions,
    settings: Result<IniVariables, String>,
    export: &mut ExportResult,
) {
    let unit_mm = options.units.mm_per_unit();
    let ends_um = [-1.0, 0.0, 1.0].map(|sign| sign * MAX_TOOL_COMPONENT_MM * 1000.0);
    let mut csv = "elongation_um,SD42960_0,SD42960_1,SD42960_2\n".to_string();
    for s_um in ends_um {
        let components = machine
            .tool_direction
            .map(|v| format_number(s_um / 1000.0 * v / unit_mm, decimal_places(options.units)));
        let _ = writeln!(csv, "{},{}", format_number(s_um, 3), components.join(","));
    }
    let source = machine.spindle.source.map_or("", |source| source.name());
    let reason = "the law itself stays outside: the PLC writes SD42960 by tool_direction.csv from the growth that the bridge sends";
    export.report.add_omitted_section(format!("spindle.{source}"), reason);
    match settings.and_then(|settings| compare_tool_compensation(machine, options, &settings, &csv))
    {
        Ok(largest) => export.report.tables.push(ExportedTable {
            file: "tool_direction.csv".to_string(),
            name: "SD42960, the tool's vector, by elongation in µm".to_string(),
            section: format!("machine.tool_direction of spindle.{source}"),
            points: ends_um.len(),
            range: (ends_um[0], ends_um[2]),
            spacing: Some(MAX_TOOL_COMPONENT_MM * 1000.0),
            constant_um: 0.0,
            largest,
            loss: None,
        }),
        Err(rule) => export.report.add_omitted_section("machine.tool_direction", rule),
    }
    export.files.push(ExportedFile { name: "tool_direction.csv".to_string(), text: csv });
    export.report.add_note(
        "MD20392 limits each component of SD42960 to 1 mm in silence; TRAORI turns the vector \
         with the head, else it stays as at angle 0",
    );
}

/// Returns the vector at angle 0, turned by the head's axes as the transformation does, against the model.
fn compare_tool_compensation(
    machine: &Machine,
    options: &ExportOptions,
    settings: &IniVariables,
    csv: &str,
) -> Result<LargestDifference, String> {
    let um = options.units.mm_per_unit() * 1000.0;
    let mut rows: Vec<[f64; 4]> = Vec::new();
    for line in csv.lines().skip(1) {
        let numbers: Vec<f64> = line.split(',').map_while(|word| word.parse().ok()).collect();
        rows.push(numbers.try_into().map_err(|_| format!("{line:?} is not a row"))?);
    }
    let vector_um = |s_um: f64| {
        [1, 2, 3].map(|component| {
            let points: Vec<(f64, f64)> = rows.iter().map(|row| (row[0], row[component])).collect();
            interpolate_linear(&points, s_um) * um
        })
    };
    let mut cases: Vec<(f64, [f64; 3])> = (-10..=10)
        .map(|tenth| f64::from(tenth) * 100.0)
        .map(|s_um| (s_um, vector_um(s_um)))
        .collect();
    let set = |index: usize| settings.number(&format!("$SC_TOOL_TEMP_COMP[{index}]"));
    cases.push((options.elongation_um, [set(0)? * um, set(1)? * um, set(2)? * um]));
    let mut largest = LargestDifference::NONE;
    for (s_um, at_zero_um) in cases {
        for first in -6..=6 {
            for second in -6..=6 {
                let mut angle_deg = [0.0; 3];
                for (axis, step) in machine.head_axes.iter().zip([first, second]) {
                    angle_deg[axis.index()] = f64::from(step) * 30.0;
                }
                let turned = machine
                    .head_axes
                    .iter()
                    .rev()
                    .fold(at_zero_um, |v, &axis| rotate(v, axis, angle_deg[axis.index()]));
                let direction =
                    tool_direction(machine.tool_direction, &machine.head_axes, angle_deg);
                // A positive component moves its axis in the negative direction.
                for (value, error) in turned.iter().zip(elongation_error_um(s_um, direction)) {
                    largest
                        .update_max(error - value, || format!("{s_um:.0} µm at {angle_deg:?} deg"));
                }
            }
        }
    }
    Ok(largest)
}

/// Rodrigues' rotation about a coordinate axis: another way than the model's, so that a turn the
/// wrong way round would be seen.
fn rotate(v: [f64; 3], about: RotaryAxis, angle_deg: f64) -> [f64; 3] {
    let mut k = [0.0; 3];
    k[about.index()] = 1.0;
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let cross = [k[1] * v[2] - k[2] * v[1], k[2] * v[0] - k[0] * v[2], k[0] * v[1] - k[1] * v[0]];
    let along: f64 = k.iter().zip(&v).map(|(k, v)| k * v).sum();
    [0, 1, 2].map(|i| v[i] * cos + cross[i] * sin + k[i] * along * (1.0 - cos))
}
