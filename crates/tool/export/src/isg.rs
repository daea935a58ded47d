//! TwinCAT CNC and other controls with the ISG kernel: volumetric compensation by component errors in
//! the ISG CSV format.
//!
//! A block has a header of names and rows of numbers; `#` begins the next block, `//` a comment. The block of
//! an axis begins with its position and has its six component errors of ISO 230-1, EXX … ECX: offsets in mm, angles
//! in rad, linear between the rows. A block without an argument has one row: the place of the tool tip with all axes at 0
//! (P0X …), and of each rotary axis a point of its line (PXC …) and how far that is off (X0C …, A0C …). A list next to it
//! names the axes from the workpiece to the tool (`chain`), how many of them move the workpiece, and the file.
//!
//! **Sign:** the values are errors, as ISO 230-1 has them, and the control corrects the opposite. By hand: an error of
//! +2 µm of X and a turn of 10 µrad about Y at X = 100 mm give `100 0.002 0 0 0 0.00001 0`.
//!
//! Names, units, blocks and the list are from the functional description of Beckhoff (TF5280) and ISG (FCT-C26). That
//! angles act about the machine's zero and by the right hand, and that no `negate` is needed, is assumed: check one point
//! with an indicator before cutting. The sign of an axis that moves the workpiece is not stated there: its errors are omitted.

use std::fmt::Write as _;

use trueup_machine::{
    Machine,
    machine_file::{AngleProfile, AxisChain, LinearAxis, RotaryAxis},
    model::spline_value_um,
};

use crate::{
    ExportOptions, ExportResult, ExportedFile, ExportedTable,
    axis_errors::{
        CrossAxisError, DriveErrorModel, collect_cross_axis_errors, collect_drive_errors, travel_mm,
    },
    linuxcnc::report_omitted_thermal_terms,
    number_format::format_number,
    report::{ApproachDirection, LargestDifference},
    table_points::{interpolate_linear, select_breakpoints},
};

/// The names of the two files.
const CSV_FILE_NAME: &str = "volcomp.csv";
const LIST_FILE_NAME: &str = "volcomp.lis";
/// The most rows of an axis; how many the control reads is a setting of its own (`max_records`).
const MAX_AXIS_ROWS: usize = 2_000;
/// The lines between the rows are kept this near, in µm, angles at a lever of 1 m.
const THINNING_TOLERANCE_UM: f64 = 0.02;
/// A travel is looked at in this many equal parts before its best points are chosen.
const CANDIDATE_INTERVALS: u32 = 1_000;
/// Offsets to 0.01 nm, angles to 10⁻¹¹ rad, positions to 0.1 nm.
const OFFSET_DECIMALS: usize = 8;
const ANGLE_DECIMALS: usize = 11;
const POSITION_DECIMALS: usize = 7;

/// The assumptions that no description confirms, and how to try them: part of the report and of the file itself.
const ASSUMPTIONS_NOTE: &str = "assumed, not tried on a control: values are errors as ISO 230-1 has \
    them, without negate, and angles act about machine zero. A wrong sign doubles the errors";
const VERIFICATION_HINT: &str = "before cutting: read an indicator at the point where the file \
    has its largest value, compensation off, then on. The error must go; if it doubles, set \
    negate";

/// A file as the control holds it: the columns of each block by their names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CompensationFile {
    blocks: Vec<(Vec<String>, Vec<Vec<f64>>)>,
}

/// Reads a file in the ISG CSV format.
///
/// # Errors
/// A row that has not a number for each name of its header, or a position that does not rise.
pub fn parse(text: &str) -> Result<CompensationFile, String> {
    let mut read = CompensationFile::default();
    let mut is_header = true;
    for (index, line) in text.lines().enumerate() {
        let line = line.split("//").next().unwrap_or_default().trim();
        match line {
            "" => {}
            "#" => is_header = true,
            names if is_header => {
                let names = names.split_whitespace().map(str::to_string).collect();
                read.blocks.push((names, Vec::new()));
                is_header = false;
            }
            row => {
                let numbers: Result<Vec<f64>, _> = row.split_whitespace().map(str::parse).collect();
                let numbers =
                    numbers.map_err(|_| format!("line {} is not of numbers", index + 1))?;
                let Some((names, rows)) = read.blocks.last_mut() else { continue };
                if numbers.len() != names.len() {
                    return Err(format!("line {} has not a number for each name", index + 1));
                }
                if rows.last().is_some_and(|before: &Vec<f64>| numbers[0] <= before[0]) {
                    return Err(format!("line {}: {} does not rise", index + 1, numbers[0]));
                }
                rows.push(numbers);
            }
        }
    }
    Ok(read)
}

impl CompensationFile {
    /// Returns a value in mm or rad at the position of its axis, in mm; `None` where no block has the name.
    #[must_use]
    pub fn value(&self, name: &str, position_mm: f64) -> Option<f64> {
        self.blocks.iter().find_map(|(names, rows)| {
            let column = names.iter().position(|candidate| candidate == name)?;
            let above = rows.partition_point(|row| row[0] <= position_mm);
            let around = above.saturating_sub(1)..(above + 1).min(rows.len());
            let points: Vec<(f64, f64)> =
                rows[around].iter().map(|row| (row[0], row[column])).collect();
            Some(match points[..] {
                [(_, only)] => only,
                _ => interpolate_linear(&points, position_mm),
            })
        })
    }
}

/// The six component errors of a linear axis.
struct ComponentErrors<'m> {
    axis: LinearAxis,
    machine: &'m Machine,
    drive: Option<&'m DriveErrorModel<'m>>,
    cross_axis_errors: Vec<&'m CrossAxisError<'m>>,
}

impl ComponentErrors<'_> {
    /// Returns offsets in µm along X, Y and Z, about the machine's zero, and angles in µrad about them.
    fn evaluate(&self, mm: f64) -> [f64; 6] {
        let mut um = [0.0; 3];
        // The format has no direction: the mean of both.
        um[self.axis.index()] += self.drive.map_or(0.0, |drive| {
            ApproachDirection::BOTH
                .iter()
                .map(|approach| drive.error_um(mm, *approach))
                .sum::<f64>()
                / 2.0
        });
        for cross in &self.cross_axis_errors {
            um[cross.error.index()] += cross.error_um(mm);
        }
        let mut urad = [0.0; 3];
        for angular in self.machine.volume.angular.iter().filter(|error| error.along == self.axis) {
            urad[angular.about.index()] = match &angular.angle {
                AngleProfile::Line(urad_per_m) => urad_per_m * mm / 1000.0,
                AngleProfile::Curve(spline) => spline_value_um(spline, mm),
            };
        }
        // From the point where they are stated to zero: δ − ε × P.
        let [x, y, z] = self.machine.volume.point_mm[self.axis.index()].map(|mm| mm / 1000.0);
        let [a, b, c] = urad;
        [um[0] - (b * z - c * y), um[1] - (c * x - a * z), um[2] - (a * y - b * x), a, b, c]
    }

    /// Returns the sections of the machine file that it comes from.
    fn source_sections(&self) -> String {
        let angles = self.machine.volume.angular.iter().filter(|error| error.along == self.axis);
        let drive = self.drive.map(DriveErrorModel::source_sections);
        let cross_axis_errors = self.cross_axis_errors.iter().map(|error| error.source_sections());
        let angles = angles.map(|motion| format!("angular.{}", motion.name()));
        drive.into_iter().chain(cross_axis_errors).chain(angles).collect::<Vec<_>>().join(" + ")
    }

    /// Returns where it may bend, in mm, rising.
    fn candidate_positions_mm(&self, (first, last): (f64, f64)) -> Vec<f64> {
        let part = |n: u32| first + (last - first) * f64::from(n) / f64::from(CANDIDATE_INTERVALS);
        let mut all: Vec<f64> = (0..=CANDIDATE_INTERVALS).map(part).collect();
        all.extend(self.drive.iter().flat_map(|error| error.breakpoints_mm()));
        all.extend(self.cross_axis_errors.iter().flat_map(|error| error.knot_positions_mm()));
        for angular in self.machine.volume.angular.iter().filter(|error| error.along == self.axis) {
            if let AngleProfile::Curve(spline) = &angular.angle {
                all.extend(&spline.knots_mm);
            }
        }
        all.retain(|mm| (first..=last).contains(mm));
        all.sort_by(f64::total_cmp);
        all.dedup_by(|b, a| *b - *a < 1e-6);
        all
    }
}

pub(crate) fn export(machine: &Machine, options: &ExportOptions, export: &mut ExportResult) {
    let Some(chain) = &machine.volume.chain else {
        let reason = "TwinCAT needs the chain of the axes: write chain = \"w X' b Y Z t\" with yours into [machine]";
        export.report.add_omitted_section("machine", reason);
        return;
    };
    let (all_drives, all_crosses) =
        (collect_drive_errors(machine, options), collect_cross_axis_errors(machine));
    let mut text = format!(
        "// volumetric compensation of {}: errors, mm and rad over mm\n// {ASSUMPTIONS_NOTE}\n// {VERIFICATION_HINT}\n",
        machine.name.escape_default()
    );
    let mut blocks = 0;
    for axis in LinearAxis::ALL {
        let drive = all_drives.iter().find(|drive| drive.axis == axis && !drive.is_second);
        let cross_axis_errors = all_crosses.iter().filter(|error| error.along == axis).collect();
        let component = ComponentErrors { axis, machine, drive, cross_axis_errors };
        let section = component.source_sections();
        if section.is_empty() {
            continue;
        }
        if chain.moves_workpiece(axis) {
            let reason = "TwinCAT's description does not state the sign of the errors of an axis that moves the workpiece; the bridge corrects them";
            export.report.add_omitted_section(section, reason);
            continue;
        }
        let Some(range) = axis_travel_mm(machine, options, axis) else {
            export.report.add_omitted_section(
                section,
                "it needs the travel of its axis: give it with --travel",
            );
            continue;
        };
        report_omitted_direction(&component, export);
        blocks += 1;
        add_error_table(&component, &section, range, &mut text, export);
    }
    for drive in all_drives.iter().filter(|drive| drive.is_second) {
        export.report.add_omitted_section(
            drive.source_sections(),
            "the kernel gives a slave axis the values of its master",
        );
    }
    let lines = add_tool_tip_and_rotary_axis_lines(machine, chain, &mut text, export);
    report_omitted_thermal_terms(
        machine,
        &mut export.report,
        "a volumetric compensation has no temperature; the bridge has",
    );
    if blocks == 0 && lines == 0 {
        return;
    }
    if let Err(rule) = parse(&text) {
        export.report.add_omitted_section("all", format!("it reads back wrong: {rule}"));
        return;
    }
    export.files.push(ExportedFile { name: CSV_FILE_NAME.into(), text });
    export
        .files
        .push(ExportedFile { name: LIST_FILE_NAME.into(), text: format_compensation_list(chain) });
    export.report.add_note("set the logical numbers of the axes in volcomp.lis, and vol_comp[0].max_records to its rows or more");
    export
        .report
        .add_note("take the tables of pitch and straightness out of the axes: this file has them");
    export.report.add_note(ASSUMPTIONS_NOTE);
    export.report.add_note(VERIFICATION_HINT);
}

/// Returns the travel, else as far as angles and curves reach.
fn axis_travel_mm(
    machine: &Machine,
    options: &ExportOptions,
    axis: LinearAxis,
) -> Option<(f64, f64)> {
    let own = machine.axes[axis.index()].travel_mm.map(|[first, last]| (first, last));
    let known = options.travel_mm[axis.index()].or(own);
    let angles = machine.volume.angular.iter().filter(|error| error.along == axis);
    let knots = angles.filter_map(|motion| match &motion.angle {
        AngleProfile::Curve(spline) => Some((*spline.knots_mm.first()?, *spline.knots_mm.last()?)),
        AngleProfile::Line(_) => None,
    });
    let reached = travel_mm(machine, options, axis).into_iter().chain(knots);
    known.or_else(|| reached.reduce(|(a, b), (c, d)| (a.min(c), b.max(d))))
}

fn report_omitted_direction(component: &ComponentErrors<'_>, export: &mut ExportResult) {
    let Some(drive) = component.drive else { return };
    if drive.is_bidirectional() || drive.backlash_um() != 0.0 {
        let what = format!("the direction of {}", drive.source_sections());
        export.report.add_omitted_section(
            what,
            "the format has none: the mean of both is written; keep the control's own backlash",
        );
    }
}

fn add_error_table(
    component: &ComponentErrors<'_>,
    section: &str,
    range: (f64, f64),
    text: &mut String,
    export: &mut ExportResult,
) {
    let places = component.candidate_positions_mm(range);
    let values: Vec<[f64; 6]> = places.iter().map(|mm| component.evaluate(*mm)).collect();
    let columns: Vec<Vec<f64>> =
        (0..6).map(|n| values.iter().map(|row| row[n]).collect()).collect();
    let (rows, off_um) =
        select_breakpoints(&places, &columns, THINNING_TOLERANCE_UM, MAX_AXIS_ROWS);
    let axis = component.axis.name().to_uppercase();
    let names: Vec<String> =
        ["X", "Y", "Z", "A", "B", "C"].iter().map(|along| format!("E{along}{axis}")).collect();
    let mut block = format!("{axis} {}\n", names.join(" "));
    for row in &rows {
        let [x, y, z, a, b, c] = values[*row];
        let offset = |um: f64| format_number(um / 1e3, OFFSET_DECIMALS);
        let angle = |urad: f64| format_number(urad / 1e6, ANGLE_DECIMALS);
        let place = format_number(places[*row], POSITION_DECIMALS);
        let (offsets, angles) = ([x, y, z].map(offset).join(" "), [a, b, c].map(angle).join(" "));
        writeln!(block, "{place} {offsets} {angles}").expect("a string takes everything");
    }
    let mut largest = LargestDifference::NONE;
    if let Ok(read) = parse(&block) {
        for (mm, row) in places.iter().zip(&values) {
            for (n, name) in names.iter().enumerate() {
                let per_unit = if n < 3 { 1e3 } else { 1e6 };
                let back = read.value(name, *mm).map_or(f64::NAN, |value| value * per_unit);
                largest.update_max(back - row[n], || {
                    format!("{axis} {} mm, {name}", format_number(*mm, 3))
                });
            }
        }
    }
    text.push_str("#\n");
    text.push_str(&block);
    export.report.tables.push(ExportedTable {
        file: CSV_FILE_NAME.into(),
        name: format!("component errors of {axis}, angles at a lever of 1 m"),
        section: section.into(),
        points: rows.len(),
        range,
        spacing: None,
        constant_um: 0.0,
        largest,
        loss: (rows.len() == MAX_AXIS_ROWS)
            .then(|| format!("{MAX_AXIS_ROWS} rows leave {off_um:.3} µm")),
    });
}

/// Writes the tool tip and the lines of the rotary axes. Returns how many of these are off.
fn add_tool_tip_and_rotary_axis_lines(
    machine: &Machine,
    chain: &AxisChain,
    text: &mut String,
    export: &mut ExportResult,
) -> usize {
    let tip = machine.volume.tool.tip_offset_mm(machine.tool_direction);
    let mut entries: Vec<(String, String)> = Vec::new();
    for (axis, mm) in ["X", "Y", "Z"].iter().zip(tip) {
        entries.push((format!("P0{axis}"), format_number(mm, POSITION_DECIMALS)));
    }
    let mut lines = 0;
    for axis in chain.rotary_axes() {
        let letter = axis.name().to_uppercase();
        for (along, mm) in ["X", "Y", "Z"].iter().zip(machine.volume.axis_line_point_mm(axis)) {
            entries.push((format!("P{along}{letter}"), format_number(mm, POSITION_DECIMALS)));
        }
        let off = machine
            .volume
            .rotary
            .iter()
            .find(|location| location.axis == axis && !location.is_error_free());
        let Some(off) = off else { continue };
        if chain.table.contains(&axis) {
            let reason = "TwinCAT's description does not state the sign of the errors of an axis that turns the workpiece; the bridge corrects them";
            export.report.add_omitted_section(format!("rotary.{}", axis.name()), reason);
            continue;
        }
        lines += 1;
        for (along, um) in LinearAxis::ALL.into_iter().zip(off.shift_um) {
            let along = along.name().to_uppercase();
            entries.push((format!("{along}0{letter}"), format_number(um / 1e3, OFFSET_DECIMALS)));
        }
        for (about, urad) in RotaryAxis::ALL.into_iter().zip(off.tilt_urad) {
            let about = about.name().to_uppercase();
            entries.push((format!("{about}0{letter}"), format_number(urad / 1e6, ANGLE_DECIMALS)));
        }
    }
    let (names, values): (Vec<String>, Vec<String>) = entries.into_iter().unzip();
    writeln!(text, "#\n{}\n{}", names.join(" "), values.join(" "))
        .expect("a string takes everything");
    lines
}

/// Returns the compensation list: the axes from the workpiece to the tool, and the file.
fn format_compensation_list(chain: &AxisChain) -> String {
    let letters = |axis: &str| axis.to_uppercase();
    let table = chain.table.iter().rev().map(|axis| letters(axis.name()));
    let linear = chain.linear.iter().map(|axis| letters(axis.name()));
    let head = chain.head.iter().map(|axis| letters(axis.name()));
    let all: Vec<String> = table.chain(linear).chain(head).collect();
    let on_workpiece = chain.table.len() + chain.on_workpiece;
    let mut text = format!("chain {}\nworkpiece_axes {on_workpiece}\n", all.concat());
    text.push_str("# the logical number of each axis, as in your channel\n");
    for (number, axis) in (1..).zip(&all) {
        writeln!(text, "{axis} {number}").expect("a string takes everything");
    }
    writeln!(text, "interpolation GRID\nfile[0] {CSV_FILE_NAME}\nfile_format[0] ISG_CSV")
        .expect("a string takes everything");
    text
}
