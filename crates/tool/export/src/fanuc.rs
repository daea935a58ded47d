//! FANUC: stored pitch error compensation, backlash and straightness.
//!
//! | file | holds |
//! |---|---|
//! | `CNC-PARA.TXT` | `N03620A1P…`: parameters, one value an axis |
//! | `PITCH.TXT` | `N10000P…`: the value of point 0, and so on |
//! | `SERIES-0.TXT` | for the old Series 0 instead of both: a sheet to be keyed in |
//!
//! Point number `ref` (3620) is at the reference point; number N is the section that ends at
//! reference + (N − ref)·spacing (3624). Its value is −7 … +7 times the magnification (3623), in
//! detection units, **relative to the point before**, looking in the positive direction. The ends
//! are 3621 = ref − (negative travel/spacing) + 1 and 3622 = ref + positive travel/spacing. Each
//! axis has the 128 numbers from 128·(its order): 0 … 127, 128 … 255.
//!
//! **Sign:** a positive value moves the axis in the positive direction: the opposite of the error.
//! By hand: errors of 0, −2 and +3 µm at 0, 100 and 200 mm, spacing 100 mm, unit 1 µm: the points
//! after the reference are +2 and −5, which add up to +2 and −3.
//!
//! **Rounding:** not each value is rounded but the sum up to each point, and the value is the
//! difference of two sums. So the sum is within half a unit times the magnification everywhere, and
//! never drifts. The smallest magnification that the slope permits is taken; if 8 is not enough,
//! the spacing is divided; if that needs more than 128 points, the axis is omitted.
//!
//! **In between:** without the option of interpolated compensation, the control gives out each
//! value at once, taken here to be in the middle of its section; with it, evenly over the section.
//! The report has the difference for the first as the table's, and for the second in a note. More than a
//! unit and the tolerance is a loss, and the export is not whole.
//!
//! Two tables (3605#0): the second one's numbers begin at 3626, and 3627 is its sum at the reference
//! point, for an axis that is referenced in the positive direction. One table: the backlash is 1851.
//!
//! Straightness has four points for each of three pairs of axes (57xx), straight between them. These
//! numbers, the middle of the section and `N10000` are from memory of the parameter manuals; look
//! them up in the manual of the control before loading.

mod read_back;
mod series0;
mod straightness;

use std::fmt::Write as _;

use trueup_machine::{Machine, machine_file::LinearAxis};

pub use read_back::{AxisTables, CompensationData};
pub use series0::parse_series_0_sheet;

use crate::{
    ExportOptions, ExportResult, ExportedFile, ExportedTable,
    axis_errors::{CrossAxisError, DriveErrorModel, collect_drive_errors},
    linuxcnc::report_omitted_thermal_terms,
    number_format::format_number,
    report::ApproachDirection,
    table_points::{comparison_positions_mm, find_largest_residual},
};

/// Which FANUC: the numbers of its parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FanucSeries {
    /// 0i, 16i, 18i, 30i and their kin: parameters from 3620.
    #[default]
    I,
    /// The old Series 0 (paper 4): parameters 1000, 2000, 0011, 756, 757, keyed in by hand.
    Zero,
}

/// This many point numbers has an axis.
pub(crate) const MAX_POINTS_PER_AXIS: usize = 128;
/// A value is at most this, times the magnification.
pub(crate) const MAX_COMPENSATION_VALUE: i64 = 7;
/// The magnifications there are.
const MAGNIFICATIONS: [u8; 4] = [1, 2, 4, 8];
/// Spacings are whole multiples of this, in mm (increment system IS-B).
const SPACING_INCREMENT_MM: f64 = 0.001;
/// A moving axis without a pitch table gets this many sections for its straightness.
const DEFAULT_INTERVAL_COUNT: usize = 60;

/// Where an axis's points are.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CompensationPoints {
    reference_mm: f64,
    spacing_mm: f64,
    /// Sections on the negative and on the positive side of the reference.
    negative: usize,
    positive: usize,
}

impl CompensationPoints {
    /// Points from the reference over `range_mm`.
    fn from_range(range_mm: (f64, f64), reference_mm: f64, spacing_mm: f64) -> Self {
        // A point that is a rounding away from the end is the end.
        let sections = |mm: f64| (mm / spacing_mm - 1e-6).ceil().max(0.0) as usize;
        Self {
            reference_mm,
            spacing_mm,
            negative: sections(reference_mm - range_mm.0),
            positive: sections(range_mm.1 - reference_mm),
        }
    }

    fn interval_count(&self) -> usize {
        self.negative + self.positive
    }

    /// Returns the ends of all sections, one more than there are sections.
    fn positions_mm(&self) -> Vec<f64> {
        (0..=self.interval_count())
            .map(|k| self.reference_mm + self.spacing_mm * (k as f64 - self.negative as f64))
            .collect()
    }
}

/// An axis as it will be written.
struct AxisCompensation<'m> {
    axis: LinearAxis,
    is_second: bool,
    drive: Option<DriveErrorModel<'m>>,
    cross_axis_errors: Vec<CrossAxisError<'m>>,
    points: CompensationPoints,
    magnification: u8,
    /// The values in the positive direction, and in the negative one where there are two tables.
    tables: Vec<Vec<i64>>,
    /// The second table's sum at the reference, in detection units.
    at_reference: i64,
    constant_um: f64,
    was_thinned: bool,
}

pub(crate) fn export(machine: &Machine, options: &ExportOptions, export: &mut ExportResult) {
    let chosen = match options.fanuc {
        FanucSeries::I => {
            straightness::select_cross_axis_errors(machine, options, &mut export.report)
        }
        FanucSeries::Zero => series0::report_omitted_straightness(machine, &mut export.report),
    };
    let all_drives = collect_drive_errors(machine, options);
    for drive in all_drives.iter().filter(|drive| drive.is_constant()) {
        let section = drive.source_sections();
        let note = "the same error everywhere is a shift of the zero, nothing to correct";
        export.report.add_note(format!("{section}: {note}"));
    }
    let mut planned = Vec::new();
    for axis in LinearAxis::ALL {
        for is_second in [false, true] {
            let drive = all_drives
                .iter()
                .find(|drive| drive.axis == axis && drive.is_second == is_second)
                .filter(|drive| !drive.is_constant());
            if options.fanuc == FanucSeries::Zero
                && let Some(drive) = drive
                && let Some(reason) = series0::unsupported_reason(drive)
            {
                export.report.add_omitted_section(drive.source_sections(), reason);
                continue;
            }
            let along: Vec<CrossAxisError<'_>> =
                chosen.iter().filter(|cross| cross.along == axis && !is_second).cloned().collect();
            if drive.is_none() && along.is_empty() {
                continue;
            }
            let mut sections: Vec<String> =
                drive.map(DriveErrorModel::source_sections).into_iter().collect();
            sections.extend(along.iter().map(CrossAxisError::source_sections));
            match plan_axis(machine, options, (axis, is_second), drive.cloned(), along) {
                Ok(plan) => planned.push(plan),
                Err(reason) => export.report.add_omitted_section(sections.join(" + "), reason),
            }
        }
    }
    match options.fanuc {
        _ if planned.is_empty() => {}
        FanucSeries::I => add_files(&planned, options, export),
        FanucSeries::Zero => series0::add_parameter_sheet(planned, options, export),
    }
    let reason = "the growth is given to the control by its PMC at run time, not by a table. It \
        is one scalar along the tool, in small steps; a jump of 9999 units is an alarm";
    report_omitted_thermal_terms(machine, &mut export.report, reason);
}

fn plan_axis<'m>(
    machine: &Machine,
    options: &ExportOptions,
    (axis, is_second): (LinearAxis, bool),
    drive: Option<DriveErrorModel<'m>>,
    cross_axis_errors: Vec<CrossAxisError<'m>>,
) -> Result<AxisCompensation<'m>, String> {
    let reference_mm = options.reference_mm[axis.index()];
    let table_mm = drive.as_ref().and_then(|drive| {
        let points = drive.breakpoints_mm();
        Some((*points.first()?, *points.last()?))
    });
    let curves = cross_axis_errors.iter().filter_map(|cross| cross.range_mm(machine, options));
    let range = table_mm.into_iter().chain(curves).reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
    // Only a backlash: the sections are empty.
    let (first_mm, last_mm) = range.unwrap_or((reference_mm, reference_mm + 100.0));
    let range_mm = (first_mm.min(reference_mm), last_mm.max(reference_mm));
    let is_bidirectional = drive.as_ref().is_some_and(DriveErrorModel::is_bidirectional);
    let fits = |points: &CompensationPoints| {
        points.interval_count() * if is_bidirectional { 2 } else { 1 } < MAX_POINTS_PER_AXIS
            && (cross_axis_errors.is_empty() || points.interval_count() >= 3)
    };
    let rounded = |mm: f64| {
        ((mm / SPACING_INCREMENT_MM).round() * SPACING_INCREMENT_MM).max(SPACING_INCREMENT_MM)
    };
    let target_mm = drive
        .as_ref()
        .and_then(|drive| drive.single_table().map(|pitch| pitch.step_mm))
        .unwrap_or((range_mm.1 - range_mm.0) / DEFAULT_INTERVAL_COUNT as f64);
    let at = |spacing_mm: f64| {
        CompensationPoints::from_range(range_mm, reference_mm, rounded(spacing_mm))
    };
    let finer: Vec<CompensationPoints> =
        (1..MAX_POINTS_PER_AXIS).map(|parts| at(target_mm / parts as f64)).filter(fits).collect();
    let coarser = || (2..=4096).map(|times| at(target_mm * f64::from(times))).find(fits);
    let was_thinned = finer.is_empty();
    let candidates = if was_thinned { coarser().into_iter().collect() } else { finer };

    let constant_um = drive
        .as_ref()
        .map_or(0.0, |drive| drive.error_um(reference_mm, ApproachDirection::Positive));
    for &points in &candidates {
        for magnification in MAGNIFICATIONS {
            let mut planned = AxisCompensation {
                axis,
                is_second,
                drive: drive.clone(),
                cross_axis_errors: cross_axis_errors.clone(),
                points,
                magnification,
                tables: Vec::new(),
                at_reference: 0,
                constant_um,
                was_thinned,
            };
            if planned.compute_tables(options) {
                return Ok(planned);
            }
        }
    }
    Err(format!(
        "it rises by more than {MAX_COMPENSATION_VALUE} times 8 units of {} µm a section, and finer sections \
         would take more than {MAX_POINTS_PER_AXIS} points",
        format_number(options.unit_um, 4)
    ))
}

impl AxisCompensation<'_> {
    /// Rounds the sums and takes their differences; `false` if one of them is above 7.
    fn compute_tables(&mut self, options: &ExportOptions) -> bool {
        let Some(drive) = self.drive.as_ref().filter(|drive| drive.is_position_dependent()) else {
            self.tables = vec![vec![0; self.points.interval_count()]];
            return true;
        };
        let scale = f64::from(self.magnification);
        let correction = |mm: f64, approach| {
            -(drive.error_um(mm, approach) - self.constant_um) / options.unit_um
        };
        let ways = if drive.is_bidirectional() {
            &ApproachDirection::BOTH[..]
        } else {
            &ApproachDirection::BOTH[..1]
        };
        let mut tables = Vec::new();
        for &way in ways {
            // The backlash of one table is a parameter of its own.
            let start = correction(self.points.reference_mm, way).round();
            if way == ApproachDirection::Negative {
                self.at_reference = start as i64;
            }
            let sums: Vec<i64> = self
                .points
                .positions_mm()
                .into_iter()
                .map(|mm| ((correction(mm, way) - start) / scale).round() as i64)
                .collect();
            tables.push(sums.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<i64>>());
        }
        self.tables = tables;
        self.tables.iter().flatten().all(|value| value.abs() <= MAX_COMPENSATION_VALUE)
    }
}

fn add_files(planned: &[AxisCompensation<'_>], options: &ExportOptions, export: &mut ExportResult) {
    // Parameter number → axis number → value.
    let mut parameters: Vec<(u32, usize, i64)> = Vec::new();
    let mut pitch = String::from("%\n");
    let seconds = planned.iter().filter(|plan| plan.is_second).map(|plan| plan.axis);
    let seconds: Vec<LinearAxis> = seconds.collect();
    let number_of = |plan: &AxisCompensation<'_>| {
        let second = seconds.iter().position(|&axis| axis == plan.axis).unwrap_or(0);
        if plan.is_second { 4 + second } else { plan.axis.index() + 1 }
    };
    for (order, plan) in planned.iter().enumerate() {
        let axis = number_of(plan);
        let base = (order * MAX_POINTS_PER_AXIS) as i64;
        let (negative, sections) =
            (plan.points.negative as i64, plan.points.interval_count() as i64);
        let reference = base + negative;
        let first = reference - negative + 1;
        let last = reference + plan.points.positive as i64;
        let spacing = (plan.points.spacing_mm / SPACING_INCREMENT_MM).round() as i64;
        let mut set = |number: u32, value: i64| parameters.push((number, axis, value));
        set(3620, reference);
        set(3621, first);
        set(3622, last);
        set(3623, plan.magnification.into());
        set(3624, spacing);
        if plan.tables.len() == 2 {
            set(1851, 0);
            set(3626, base + sections + 1);
            set(3627, plan.at_reference);
        } else if let Some(drive) = &plan.drive {
            set(1851, (drive.backlash_um() / options.unit_um).round() as i64);
        }
        for (point, value) in (first..).zip(plan.tables.iter().flatten()) {
            // Writing to a string cannot fail.
            let _ = writeln!(pitch, "N{}P{value}", 10_000 + point);
        }
    }
    pitch.push_str("%\n");
    let pairs = straightness::plan_axis_pairs(planned, options, number_of, &mut export.report);
    let text = format_parameters(&parameters, &pairs);
    let (para, pitch) =
        ("CNC-PARA.TXT".to_string(), ExportedFile { name: "PITCH.TXT".into(), text: pitch });
    match CompensationData::parse(&text, &pitch.text) {
        Ok(control) => {
            for plan in planned {
                compare(plan, number_of(plan), &control, options, export);
            }
            straightness::compare_axis_pairs(&pairs, &control, options, export);
        }
        Err(rule) => {
            export.report.add_omitted_section("all", format!("it reads back wrong: {rule}"))
        }
    }
    export.files.push(ExportedFile { name: para, text });
    export.files.push(pitch);
    let report = &mut export.report;
    if planned.iter().any(|plan| plan.tables.len() == 2) {
        report
            .add_note("set 3605#0 to 1 on the axes with 3626: two tables, one for each direction");
        report.add_note("3627 suits an axis that is referenced in the positive direction");
    }
    report.add_note(format!(
        "X, Y, Z are the axes 1, 2, 3{}; detection unit {} µm; 3624 in 0.001 mm",
        if seconds.is_empty() { "" } else { ", the second drives of gantries 4 and up" },
        format_number(options.unit_um, 4)
    ));
    report.add_note(
        "compare the parameter numbers with the manual of the control, switch the power off \
                 and on after loading, and reference",
    );
}

/// `N03620A1P40A2P168`, one line a parameter, in rising order; then the straightness.
fn format_parameters(
    parameters: &[(u32, usize, i64)],
    pairs: &[straightness::AxisPair<'_>],
) -> String {
    let mut sorted = parameters.to_vec();
    sorted.sort_unstable();
    let mut text = String::from("%");
    let mut before = None;
    for (number, axis, value) in sorted {
        if before != Some(number) {
            let _ = write!(text, "\nN{number:05}");
            before = Some(number);
        }
        let _ = write!(text, "A{axis}P{value}");
    }
    for (number, value) in pairs.iter().flat_map(straightness::AxisPair::parameters) {
        let _ = write!(text, "\nN{number:05}P{value}");
    }
    text.push_str("\n%\n");
    text
}

fn compare(
    plan: &AxisCompensation<'_>,
    axis: usize,
    control: &CompensationData,
    options: &ExportOptions,
    export: &mut ExportResult,
) {
    let Some(drive) = &plan.drive else { return };
    match control.axis_tables(axis) {
        Ok(back) => compare_axis_tables(plan, drive, &back, (axis, "PITCH.TXT"), options, export),
        Err(rule) => {
            export.report.add_omitted_section(
                drive.source_sections(),
                format!("it reads back wrong: {rule}"),
            );
        }
    }
}

fn compare_axis_tables(
    plan: &AxisCompensation<'_>,
    drive: &DriveErrorModel<'_>,
    back: &AxisTables,
    (axis, file): (usize, &str),
    options: &ExportOptions,
    export: &mut ExportResult,
) {
    let CompensationPoints { reference_mm, spacing_mm, .. } = plan.points;
    let positions_mm = plan.points.positions_mm();
    let range = (positions_mm[0], positions_mm[positions_mm.len() - 1]);
    // A step is looked at on both of its sides.
    let mut special = drive.breakpoints_mm();
    special.extend(positions_mm.iter().flat_map(|mm| [*mm, mm + spacing_mm / 2.0]));
    let probes = comparison_positions_mm(range, &special, drive.has_constant_extrapolation());
    let error_um = |mm, way| drive.error_um(mm, way) - plan.constant_um;
    let with = |is_interpolated: bool| {
        find_largest_residual(&probes, error_um, |mm, way| {
            back.correction_in_detection_units(mm - reference_mm, way, is_interpolated)
                * options.unit_um
        })
    };
    let (stepped, interpolated) = (with(false), with(true));
    export.report.add_note(format!(
        "{}: with the option of interpolated compensation the largest difference is {:.4} µm at {}",
        drive.name(),
        interpolated.um,
        interpolated.at
    ));
    let count = plan.points.interval_count();
    // Half a unit is rounded away in each sum, and a step of one unit comes half of it too early and half
    // too late: what is further off is no rounding.
    let is_off = stepped.um > options.tolerance_um + options.unit_um;
    let loss = if plan.was_thinned {
        Some(format!("thinned to sections of {spacing_mm} mm"))
    } else {
        is_off.then(|| {
            format!(
                "each value is given out at once, in the middle of its section, up to {:.1} µm \
                 off. With the option of interpolated compensation it is {:.1} µm",
                stepped.um, interpolated.um
            )
        })
    };
    export.report.tables.push(ExportedTable {
        file: file.to_string(),
        name: format!(
            "axis {axis}, points {} to {}, magnification {}",
            back.first, back.last, plan.magnification
        ),
        section: drive.source_sections(),
        points: count,
        range,
        spacing: Some(spacing_mm),
        constant_um: plan.constant_um,
        largest: stepped,
        loss,
    });
}
