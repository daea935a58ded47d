//! Siemens SINUMERIK 840D sl: encoder (EEC) and cross-axis (CEC) tables, temperature and tool
//! direction.
//!
//! | part of the model | goes to |
//! |---|---|
//! | pitch, one table | `$AA_ENC_COMP` of the axis (`AX_EEC.INI`) |
//! | pitch, two tables | two `$AN_CEC` tables of the axis on itself, `_DIRECTION` 1 and −1 |
//! | backlash | MD32450, where the encoder sits on the screw |
//! | straightness, squareness | a `$AN_CEC` table from the moving axis to the one in error |
//! | thermal | SD43900, SD43910, SD43920 by temperature (`temperature.csv`) |
//! | elongation | SD42960, the vector of the tool, by elongation (`tool_direction.csv`) |
//!
//! **Sign:** a positive value moves the axis in the negative direction, in all of them, so the value
//! is the error itself. By hand: an error of +2 µm at 100 mm is `$AA_ENC_COMP[0,1,AX1]=0.002`; a tool
//! that has grown 60 µm downwards is an error of −60 µm in Z, `$SC_TOOL_TEMP_COMP[2]=-0.06`, and Z
//! rises (the manual's own example: −1.0 mm, and Z goes to 21 mm instead of 20).
//!
//! Tables are linear between equidistant points, and the end values hold beyond them. The value at
//! the reference point must be 0, so the error there is taken out as a constant and reported. Of
//! two tables only the forward one can be 0 there: the other holds the backlash.
//!
//! Limits taken as the format's own: 5000 points for EEC (MD38000) and 2000 for CEC (MD18342);
//! smaller controls have less, `--max-points 200` for an 828D.

mod compare;
mod read_back;
mod thermal;

use std::collections::BTreeMap;

use trueup_machine::{Machine, machine_file::LinearAxis};

pub use read_back::{IniVariables, LookupTable};

use crate::{
    ExportOptions, ExportResult, ExportedFile, LengthUnit,
    axis_errors::{
        CrossAxisError, DriveErrorModel, collect_cross_axis_errors, collect_drive_errors,
    },
    number_format::format_number,
    report::ApproachDirection,
    table_points::PointGrid,
};

/// The most points of an encoder table.
pub(crate) const MAX_EEC_POINTS: usize = 5000;
/// The most points of a cross-axis table.
pub(crate) const MAX_CEC_POINTS: usize = 2000;
/// Steps are whole multiples of this, in mm.
const POSITION_INCREMENT_MM: f64 = 1e-4;

/// Decimals of values and positions: 1 nm, and 2.5 nm in inches.
fn decimal_places(units: LengthUnit) -> usize {
    match units {
        LengthUnit::Millimetres => 6,
        LengthUnit::Inches => 7,
    }
}

/// Returns the machine axis of a drive: AX1, AX2, AX3 for X, Y, Z, then the second drives.
fn machine_axis_name(machine: &Machine, axis: LinearAxis, is_second: bool) -> String {
    if !is_second {
        return format!("AX{}", axis.index() + 1);
    }
    let is_before =
        |other: &&LinearAxis| **other < axis && machine.axes[other.index()].dual.is_some();
    let before = LinearAxis::ALL.iter().filter(is_before).count();
    format!("AX{}", 4 + before)
}

/// The files as they grow.
#[derive(Default)]
struct IniFileContents {
    eec: String,
    cec: String,
    cec_tables: usize,
    memory: String,
    enable: String,
    /// The largest sum of the tables to each machine axis, in µm.
    cec_sum_um: BTreeMap<String, f64>,
}

pub(crate) fn export(machine: &Machine, options: &ExportOptions, export: &mut ExportResult) {
    let mut files = IniFileContents::default();
    let mut planned = Vec::new();
    for drive in collect_drive_errors(machine, options) {
        if drive.is_constant() {
            let um = drive.error_um(0.0, ApproachDirection::Positive);
            export.report.add_note(format!(
                "{}: the same {um:+.3} µm everywhere is a shift of the zero, nothing to correct",
                drive.source_sections()
            ));
            continue;
        }
        planned.push(add_drive_table(machine, options, &drive, &mut files));
    }
    for cross in
        collect_cross_axis_errors(machine).iter().flat_map(CrossAxisError::split_into_terms)
    {
        match add_cross_axis_table(machine, options, &cross, &mut files) {
            Some(plan) => planned.push(plan),
            None => {
                let along = cross.along.name();
                let reason = format!("an angle needs the travel of {along}: give it with --travel");
                export.report.add_omitted_section(cross.source_sections(), reason);
            }
        }
    }
    let has_tables = !planned.is_empty();
    add_files(options, files, export);
    let read = |name: &str, export: &ExportResult| {
        let file = export.files.iter().find(|file| file.name == name);
        file.map_or_else(|| Ok(IniVariables::default()), |file| IniVariables::parse(&file.text))
    };
    let tables = ["AX_EEC.INI", "NC_CEC.INI", "ENABLE.INI"].map(|name| read(name, export));
    for plan in planned {
        compare::compare(machine, options, &plan, &tables, export);
    }
    thermal::export(machine, options, export);
    if has_tables {
        export.report.add_note(
            "load MEMORY.INI and power on (it re-formats the memory: save the NC first). Then \
             load the tables with MD32700 = 0 and MD32710 = 0, then ENABLE.INI, power on, \
             reference",
        );
        export.report.add_note(
            "the backlash and the tables of two directions suit an axis that is referenced in the \
             positive direction",
        );
    }
    if !export.files.is_empty() {
        let second = collect_drive_errors(machine, options).iter().any(|drive| drive.is_second);
        let more = if second { ", the second drives of gantries AX4 and up" } else { "" };
        export.report.add_note(format!("X, Y, Z are the machine axes AX1, AX2, AX3{more}"));
    }
}

/// A part that is written, to be compared once it is read back.
struct PlannedTable<'m> {
    part: ModelPart<'m>,
    grid: PointGrid,
    constant_um: f64,
    /// The indices of its CEC tables; none for an encoder table or a backlash.
    cec: Vec<usize>,
    was_thinned: bool,
}

enum ModelPart<'m> {
    Drive(DriveErrorModel<'m>),
    CrossAxisError(CrossAxisError<'m>),
}

fn add_drive_table<'m>(
    machine: &'m Machine,
    options: &ExportOptions,
    drive: &DriveErrorModel<'m>,
    files: &mut IniFileContents,
) -> PlannedTable<'m> {
    let axis = machine_axis_name(machine, drive.axis, drive.is_second);
    let reference_mm = options.reference_mm[drive.axis.index()];
    let constant_um = drive.error_um(reference_mm, ApproachDirection::Positive);
    let most = if drive.is_bidirectional() { MAX_CEC_POINTS } else { MAX_EEC_POINTS };
    let most = options.most_points.unwrap_or(most).clamp(2, most);
    let points_mm = drive.breakpoints_mm();
    let (grid, was_thinned) = match (drive.single_table(), &points_mm[..]) {
        (Some(pitch), _) if pitch.forward_um.len() <= most => {
            // A table of one point holds everywhere; a control's table has two ends.
            let points = pitch.forward_um.len().max(2);
            (PointGrid { start_mm: pitch.start_mm, step_mm: pitch.step_mm, points }, false)
        }
        (_, [first, .., last]) => {
            // Half of the tolerance is left for the rounding.
            let grids = ApproachDirection::BOTH.map(|approach| {
                let error_um = |mm| drive.error_um(mm, approach);
                let tolerance_um = options.tolerance_um / 2.0;
                PointGrid::with_tolerance(
                    (*first, *last),
                    POSITION_INCREMENT_MM,
                    tolerance_um,
                    most,
                    error_um,
                )
            });
            let [a, b] = grids;
            let grid = if a.points < b.points { b } else { a };
            (grid, grid.points == most)
        }
        _ => (PointGrid { start_mm: 0.0, step_mm: 0.0, points: 0 }, false),
    };
    let mut cec = Vec::new();
    let error_um = |mm: f64, approach| drive.error_um(mm, approach) - constant_um;
    if drive.is_bidirectional() {
        for approach in ApproachDirection::BOTH {
            let table = CecTable { input: &axis, output: &axis, approach: Some(approach), grid };
            cec.push(files.add_cec_table(options, &table, |mm| error_um(mm, approach)));
        }
        let largest = grid
            .positions_mm()
            .into_iter()
            .flat_map(|mm| ApproachDirection::BOTH.map(|approach| error_um(mm, approach).abs()));
        *files.cec_sum_um.entry(axis).or_default() += largest.fold(0.0, f64::max);
    } else {
        if drive.is_position_dependent() {
            // The backlash comes on top of the table, by a machine data of its own.
            files.add_eec_table(options, &axis, grid, |mm| {
                error_um(mm, ApproachDirection::Positive)
            });
        }
        if drive.backlash_um() != 0.0 {
            let mm = drive.backlash_um() / 1000.0 / options.units.mm_per_unit();
            let mm = format_number(mm, decimal_places(options.units));
            push_line(&mut files.enable, &format!("$MA_BACKLASH[0,{axis}]={mm}"));
        }
    }
    PlannedTable { part: ModelPart::Drive(drive.clone()), grid, constant_um, cec, was_thinned }
}

fn add_cross_axis_table<'m>(
    machine: &'m Machine,
    options: &ExportOptions,
    cross: &CrossAxisError<'m>,
    files: &mut IniFileContents,
) -> Option<PlannedTable<'m>> {
    let range_mm = cross.range_mm(machine, options)?;
    let constant_um = cross.error_um(options.reference_mm[cross.along.index()]);
    let error_um = |mm| cross.error_um(mm) - constant_um;
    let most = options.most_points.unwrap_or(MAX_CEC_POINTS).clamp(2, MAX_CEC_POINTS);
    // Half of the tolerance is left for the rounding.
    let grid = PointGrid::with_tolerance(
        range_mm,
        POSITION_INCREMENT_MM,
        options.tolerance_um / 2.0,
        most,
        error_um,
    );
    let [input, output] =
        [cross.along, cross.error].map(|axis| machine_axis_name(machine, axis, false));
    let table = CecTable { input: &input, output: &output, approach: None, grid };
    let index = files.add_cec_table(options, &table, error_um);
    let largest = grid.positions_mm().into_iter().map(|mm| error_um(mm).abs());
    *files.cec_sum_um.entry(output).or_default() += largest.fold(0.0, f64::max);
    let was_thinned = grid.points == most;
    Some(PlannedTable {
        part: ModelPart::CrossAxisError(cross.clone()),
        grid,
        constant_um,
        cec: vec![index],
        was_thinned,
    })
}

struct CecTable<'a> {
    input: &'a str,
    output: &'a str,
    /// `None`: the table serves both directions.
    approach: Option<ApproachDirection>,
    grid: PointGrid,
}

fn push_line(text: &mut String, line: &str) {
    text.push_str(line);
    text.push('\n');
}

impl IniFileContents {
    fn add_eec_table(
        &mut self,
        options: &ExportOptions,
        axis: &str,
        grid: PointGrid,
        error_um: impl Fn(f64) -> f64,
    ) {
        let points = format_table(options, grid, error_um);
        for (index, value) in points.values.iter().enumerate() {
            push_line(&mut self.eec, &format!("$AA_ENC_COMP[0,{index},{axis}]={value}"));
        }
        push_line(&mut self.eec, &format!("$AA_ENC_COMP_STEP[0,{axis}]={}", points.step));
        push_line(&mut self.eec, &format!("$AA_ENC_COMP_MIN[0,{axis}]={}", points.min));
        push_line(&mut self.eec, &format!("$AA_ENC_COMP_MAX[0,{axis}]={}", points.max));
        push_line(&mut self.eec, &format!("$AA_ENC_COMP_IS_MODULO[0,{axis}]=0"));
        let memory = format!("$MA_MM_ENC_COMP_MAX_POINTS[0,{axis}]={}", grid.points);
        push_line(&mut self.memory, &memory);
        push_line(&mut self.enable, &format!("$MA_ENC_COMP_ENABLE[0,{axis}]=1"));
    }

    /// Gives the table's index.
    fn add_cec_table(
        &mut self,
        options: &ExportOptions,
        table: &CecTable<'_>,
        error_um: impl Fn(f64) -> f64,
    ) -> usize {
        let t = self.cec_tables;
        self.cec_tables += 1;
        let points = format_table(options, table.grid, error_um);
        let direction = table.approach.map_or(0.0, ApproachDirection::sign);
        let cec = &mut self.cec;
        for (index, value) in points.values.iter().enumerate() {
            push_line(cec, &format!("$AN_CEC[{t},{index}]={value}"));
        }
        push_line(cec, &format!("$AN_CEC_INPUT_AXIS[{t}]=({})", table.input));
        push_line(cec, &format!("$AN_CEC_OUTPUT_AXIS[{t}]=({})", table.output));
        push_line(cec, &format!("$AN_CEC_STEP[{t}]={}", points.step));
        push_line(cec, &format!("$AN_CEC_MIN[{t}]={}", points.min));
        push_line(cec, &format!("$AN_CEC_MAX[{t}]={}", points.max));
        push_line(cec, &format!("$AN_CEC_DIRECTION[{t}]={direction}"));
        push_line(cec, &format!("$AN_CEC_MULT_BY_TABLE[{t}]=0"));
        push_line(cec, &format!("$AN_CEC_IS_MODULO[{t}]=0"));
        push_line(&mut self.memory, &format!("$MN_MM_CEC_MAX_POINTS[{t}]={}", table.grid.points));
        push_line(&mut self.enable, &format!("$SN_CEC_TABLE_ENABLE[{t}]=1"));
        let enable = format!("$MA_CEC_ENABLE[{}]=1", table.output);
        if !self.enable.lines().any(|line| line == enable) {
            push_line(&mut self.enable, &enable);
            let is_metric = u8::from(options.units == LengthUnit::Millimetres);
            let line = format!("$MA_CEC_SCALING_SYSTEM_METRIC[{}]={is_metric}", table.output);
            push_line(&mut self.enable, &line);
        }
        t
    }
}

/// A table's numbers as they are written, in the control's unit.
struct FormattedTable {
    min: String,
    step: String,
    max: String,
    values: Vec<String>,
}

fn format_table(
    options: &ExportOptions,
    grid: PointGrid,
    error_um: impl Fn(f64) -> f64,
) -> FormattedTable {
    let (unit_mm, decimals) = (options.units.mm_per_unit(), decimal_places(options.units));
    let mm = |mm: f64| format_number(mm / unit_mm, decimals + 3);
    let value = |mm: f64| format_number(error_um(mm) / 1000.0 / unit_mm, decimals);
    FormattedTable {
        min: mm(grid.start_mm),
        step: mm(grid.step_mm),
        max: mm(grid.end_mm()),
        values: grid.positions_mm().into_iter().map(value).collect(),
    }
}

fn add_files(options: &ExportOptions, mut files: IniFileContents, export: &mut ExportResult) {
    for (name, um) in &files.cec_sum_um {
        // Rounded up to a whole µm: above MD32720 the control raises an alarm.
        let mm = format_number(
            um.ceil() / 1000.0 / options.units.mm_per_unit(),
            decimal_places(options.units),
        );
        push_line(&mut files.enable, &format!("$MA_CEC_MAX_SUM[{name}]={mm}"));
    }
    for (name, header, body) in [
        ("MEMORY.INI", "%_N_MEMORY_INI", &files.memory),
        ("AX_EEC.INI", "%_N_AX_EEC_INI", &files.eec),
        ("NC_CEC.INI", "%_N_NC_CEC_INI", &files.cec),
        ("ENABLE.INI", "%_N_ENABLE_INI", &files.enable),
    ] {
        if !body.is_empty() {
            export.files.push(build_ini_file(name, header, body));
        }
    }
}

fn build_ini_file(name: &str, header: &str, body: &str) -> ExportedFile {
    ExportedFile { name: name.to_string(), text: format!("{header}\nCHANDATA(1)\n{body}M17\n") }
}
