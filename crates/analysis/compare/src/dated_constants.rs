//! Which day a file is of, and which constants it holds.
//!
//! The day is in the name, `2026-11-22` or `20261122`. A machine file holds what it says; a run file of
//! positions what a line through its readings says: a slope along the axis, and the backlash.

use trueup_machine::{
    Location, Machine, RunFile, machine_file::LinearAxis, model::is_negative_direction,
};
use trueup_numerics::{least_squares::GivensQr, robust::find_regression_outliers, t_quantile};

/// A day, counted from 1970-01-01.
pub type EpochDay = i64;

/// A constant of one day.
#[derive(Clone, Debug, PartialEq)]
pub struct ConstantEstimate {
    /// Its key in the machine file, with its unit: `axis.x.backlash.width_um`.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Half its 95 % interval, where the file shows it.
    pub half_width: Option<f64>,
}

/// Returns the day in a file's name.
///
/// ```
/// use trueup_compare::dated_constants::{find_date_in_file_name, format_day};
/// assert_eq!(find_date_in_file_name("mill 2026-11-22.csv"), Some(20_779));
/// assert_eq!(find_date_in_file_name("mill_20261122_x.toml"), Some(20_779));
/// assert_eq!(find_date_in_file_name("mill-2026-13-40.csv"), None);
/// assert_eq!(format_day(20_779), "2026-11-22");
/// ```
#[must_use]
pub fn find_date_in_file_name(name: &str) -> Option<EpochDay> {
    let number =
        |text: &str| text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok())?;
    let at = |start: usize| -> Option<EpochDay> {
        let of = |from: usize, to: usize| name.get(start + from..start + to);
        let dashed = of(4, 5) == Some("-") && of(7, 8) == Some("-");
        let (month, day) = if dashed { ((5, 7), (8, 10)) } else { ((4, 6), (6, 8)) };
        let year: EpochDay = number(of(0, 4)?)?;
        let (month, day): (EpochDay, EpochDay) =
            (number(of(month.0, month.1)?)?, number(of(day.0, day.1)?)?);
        let days = days_from_civil(year, month, day);
        // What is no day of the calendar comes back as another one.
        let is_day = (1970..2200).contains(&year) && civil_from_days(days) == (year, month, day);
        is_day.then_some(days)
    };
    (0..name.len()).filter(|start| name.is_char_boundary(*start)).find_map(at)
}

/// Returns a day as `2026-11-22`.
#[must_use]
pub fn format_day(day: EpochDay) -> String {
    let (year, month, day) = civil_from_days(day);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Days from 1970-01-01, by years that begin in March: then the leap day is the last.
fn days_from_civil(year: EpochDay, month: EpochDay, day: EpochDay) -> EpochDay {
    let year = if month <= 2 { year - 1 } else { year };
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

/// Year, month and day of a day.
fn civil_from_days(days: EpochDay) -> (EpochDay, EpochDay, EpochDay) {
    let days = days + 719_468;
    let (era, of_era) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    (year + era * 400 + i64::from(month <= 2), month, day)
}

/// Returns the constants of a machine file that wear or drift.
#[must_use]
pub fn machine_constants(machine: &Machine) -> Vec<ConstantEstimate> {
    let mut found = Vec::new();
    let mut add =
        |name: String, value| found.push(ConstantEstimate { name, value, half_width: None });
    for (axis, of) in machine.axes.iter().zip(LinearAxis::ALL) {
        let name = of.name();
        if let Some(backlash) = &axis.backlash {
            add(format!("axis.{name}.backlash.width_um"), backlash.width_um);
        }
        if let Some(pitch) = axis.pitch.as_ref().filter(|pitch| pitch.forward_um.len() > 1) {
            let points = pitch.forward_um.iter().enumerate();
            let m = |n: usize| (pitch.start_mm + pitch.step_mm * n as f64) / 1000.0;
            let mut line = GivensQr::new(2);
            points.for_each(|(n, um)| line.add_row(&[1.0, m(n)], *um));
            if let Ok(line) = line.solve() {
                add(format!("axis.{name}.pitch slope_um_per_m"), line.coefficients[1]);
            }
        }
        if let Some(thermal) = axis.thermal.as_ref().filter(|thermal| thermal.table.is_none()) {
            add(format!("axis.{name}.thermal.slope_um_per_m_per_c"), thermal.slope_um_per_m_per_c);
        }
    }
    let spindle = &machine.spindle;
    if let Some(sensor) = &spindle.sensor {
        add("spindle.sensor.k0_um".into(), sensor.k0_um);
        add("spindle.sensor.zero_counts".into(), sensor.zero_counts);
        add("spindle.sensor.um_per_count".into(), sensor.um_per_count);
    }
    if let Some(warmup) = &spindle.warmup {
        add("spindle.warmup.lag_s".into(), warmup.lag_s);
        add("spindle.warmup.warm_s".into(), warmup.warm_s);
        add("spindle.warmup.max_um".into(), warmup.max_um);
        add("spindle.warmup.exponent".into(), warmup.exponent);
    }
    if let Some(law) = &spindle.temperature {
        add("spindle.temperature.reference_c".into(), law.reference_c);
        add("spindle.temperature.k_um_per_c".into(), law.k_um_per_c);
        add("spindle.temperature.lag_s".into(), law.lag_s);
    }
    found
}

/// The constants and outliers of one day's run file.
#[derive(Clone, Debug, Default)]
pub struct RunConstantEstimates {
    /// The backlash and the slope of each axis whose position errors it measures.
    pub constants: Vec<ConstantEstimate>,
    /// Where the readings stand that were excluded as outliers, with their value in µm.
    pub outliers: Vec<(Location, f64)>,
}

/// Returns the constants of `run`, and the readings that were excluded for them.
#[must_use]
pub fn estimate_run_constants(run: &RunFile) -> RunConstantEstimates {
    let mut all = RunConstantEstimates::default();
    for of_axis in LinearAxis::ALL.into_iter().filter_map(|axis| estimate_axis_constants(run, axis))
    {
        all.constants.extend(of_axis.constants);
        all.outliers.extend(of_axis.outliers);
    }
    all
}

fn estimate_axis_constants(run: &RunFile, axis: LinearAxis) -> Option<RunConstantEstimates> {
    let name = axis.name();
    let um = run.column(&format!("measured_d{name}_um"))?;
    let at = run.column(&format!("{name}_mm"))?;
    let direction = run.column(&format!("dir_{name}"));
    let rows: Vec<usize> =
        (0..run.row_count()).filter(|row| um[*row].is_finite() && at[*row].is_finite()).collect();
    let reverse = |row: usize| direction.is_some_and(|all| is_negative_direction(all[row]));
    let both = rows.iter().any(|row| reverse(*row)) && rows.iter().any(|row| !reverse(*row));
    let spread = rows.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), row| {
        (low.min(at[*row]), high.max(at[*row]))
    });
    let moves = spread.1 > spread.0;
    let columns = |row: usize| {
        let mut x = vec![1.0];
        x.extend(moves.then(|| at[row] / 1000.0));
        x.extend(both.then(|| f64::from(u8::from(reverse(row)))));
        x
    };
    let count = 1 + usize::from(moves) + usize::from(both);
    let by_column: Vec<Vec<f64>> =
        (0..count).map(|n| rows.iter().map(|row| columns(*row)[n]).collect()).collect();
    let by_column: Vec<&[f64]> = by_column.iter().map(Vec::as_slice).collect();
    let values: Vec<f64> = rows.iter().map(|row| um[*row]).collect();
    let outliers: Vec<usize> =
        find_regression_outliers(&by_column, &values).iter().map(|outlier| outlier.row).collect();
    let measured = format!("measured_d{name}_um");
    let listed = outliers.iter().map(|n| (run.value_location(rows[*n], &measured), values[*n]));
    let listed = listed.collect();
    let mut line = GivensQr::new(count);
    for (n, row) in rows.into_iter().enumerate() {
        if !outliers.contains(&n) {
            line.add_row(&columns(row), um[row]);
        }
    }
    let line = line.solve().ok()?;
    let t = t_quantile(0.975, line.degrees_of_freedom() as f64);
    let constant = |name: String, n: usize| ConstantEstimate {
        name,
        value: line.coefficients[n],
        half_width: t.is_finite().then(|| line.confidence_half_width(n)),
    };
    let slope = moves.then(|| constant(format!("axis.{name}.pitch slope_um_per_m"), 1));
    let width =
        both.then(|| constant(format!("axis.{name}.backlash.width_um"), 1 + usize::from(moves)));
    Some(RunConstantEstimates {
        constants: slope.into_iter().chain(width).collect(),
        outliers: listed,
    })
}
