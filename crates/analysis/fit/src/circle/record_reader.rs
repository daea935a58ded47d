//! Rows of run files as passes around circles.
//!
//! Two positions that move give the plane, least squares through them the circle. The direction is that of the column
//! `dir` (+1 counter-clockwise), else of `dir_*`, else of the order of the rows. Rows of one file with one `setup` have
//! one zero of the instrument.

use std::f64::consts::{PI, TAU};

use trueup_machine::{InputFileError, Location, Machine, RunFile, machine_file::LinearAxis};
use trueup_numerics::robust;

use super::{
    circular_path::{angle_difference_rad, fit_circle, rotation_directions},
    known_contributions,
    record::{CirclePlane, CircleReading, CircleRecord, RADIAL_DEVIATION_COLUMN},
    terms::angle_since_reversal_rad,
};
use crate::report::ExcludedRow;

/// Fewer rows of a circle are no record.
const MIN_RECORD_ROWS: usize = 24;
/// A shorter arc distinguishes nothing, in rad.
const MIN_ARC_RAD: f64 = 170.0 / 360.0 * TAU;
/// A position that moves less than this share of the largest movement stands still.
const MAX_STATIONARY_TRAVEL_RATIO: f64 = 0.02;
/// A row farther from the circle than this share of the radius is a feed-in or a feed-out.
const MAX_RELATIVE_RADIUS_DEVIATION: f64 = 0.01;
/// Rows to which a record is thinned by means of neighbours.
const MAX_RECORD_ROWS: usize = 4_000;
/// Circles whose centres and radii differ less, in mm, are the same.
const CIRCLE_MATCH_TOLERANCE_MM: f64 = 0.5;
/// A gross reading, in scatters of a reading from its neighbours.
const GROSS_ERROR_THRESHOLD_SIGMAS: f64 = 12.0;
/// Around reversals steps and spikes are no gross readings, in rad.
const REVERSAL_ZONE_HALF_WIDTH_RAD: f64 = 6.0 / 360.0 * TAU;

/// Rows that belong to one circle and one zero of the instrument.
struct RowGroup {
    plane: CirclePlane,
    rows: Vec<usize>,
}

/// Returns the circles of `runs`, and what the user should know.
///
/// # Errors
/// See [`super::analyse_circles`].
pub(crate) fn extract_circle_records(
    runs: &[RunFile],
    machine: Option<&Machine>,
) -> Result<(Vec<CircleRecord>, Vec<String>), InputFileError> {
    let mut records: Vec<CircleRecord> = Vec::new();
    let mut warnings = Vec::new();
    for (file, run) in runs.iter().enumerate() {
        let measured = known_contributions::extract_radial_readings(run, machine, &mut warnings)?;
        for group in group_rows(run)? {
            add_group_to_record(&mut records, run, file, &group, &measured)?;
        }
    }
    let Some(first) = runs.first() else {
        return Err(InputFileError::new(Location::start_of_file("".as_ref()), "no run is given"));
    };
    if records.is_empty() {
        let rule = format!("column {RADIAL_DEVIATION_COLUMN} has no value in any row of a circle");
        return Err(InputFileError::new(Location::start_of_file(first.path()), rule));
    }
    records.sort_by_key(|record| record.plane);
    for record in &mut records {
        if let Some(machine) = machine {
            known_contributions::subtract_prediction(record, runs, machine, &mut warnings)?;
        }
        exclude_gross_errors(record, runs);
        check_record_coverage(record, runs)?;
        average_neighbouring_rows(record);
        let clocks = || record.rows.iter().map(|row| row.clock);
        let clock = [clocks().fold(f64::INFINITY, f64::min), clocks().fold(f64::MIN, f64::max)];
        record.clock = clock;
    }
    Ok((records, warnings))
}

fn position_column(run: &RunFile, axis: LinearAxis) -> Option<&[f64]> {
    run.column(&axis.column_name())
}

/// Returns the groups of rows with one `run` and `setup`, each in one plane.
fn group_rows(run: &RunFile) -> Result<Vec<RowGroup>, InputFileError> {
    let readings = run.require_column(RADIAL_DEVIATION_COLUMN)?;
    let columns = [run.column("run"), run.column("setup")];
    let key = |row: usize| columns.map(|column| column.map(|values| values[row].to_bits()));
    let mut keys: Vec<[Option<u64>; 2]> = Vec::new();
    let mut of_keys: Vec<Vec<usize>> = Vec::new();
    for row in 0..run.row_count() {
        let there = LinearAxis::ALL.iter().filter_map(|axis| position_column(run, *axis));
        if readings[row].is_nan() || there.into_iter().any(|values| values[row].is_nan()) {
            continue;
        }
        match keys.iter().position(|candidate| *candidate == key(row)) {
            Some(known) => of_keys[known].push(row),
            None => {
                keys.push(key(row));
                of_keys.push(vec![row]);
            }
        }
    }
    let mut all = Vec::new();
    for rows in of_keys {
        all.extend(split_by_plane(run, rows)?);
    }
    Ok(all)
}

/// Returns the largest minus the smallest value of a position in some rows; 0 without the column.
fn position_range_mm(run: &RunFile, axis: LinearAxis, rows: &[usize]) -> f64 {
    let Some(values) = position_column(run, axis) else { return 0.0 };
    let of = rows.iter().map(|row| values[*row]);
    of.clone().fold(f64::MIN, f64::max) - of.fold(f64::MAX, f64::min)
}

/// Splits rows where another axis stands still.
fn split_by_plane(run: &RunFile, rows: Vec<usize>) -> Result<Vec<RowGroup>, InputFileError> {
    let ranges = LinearAxis::ALL.map(|axis| position_range_mm(run, axis, &rows));
    let most = ranges.into_iter().fold(0.0, f64::max);
    let still: Vec<LinearAxis> = LinearAxis::ALL
        .into_iter()
        .filter(|axis| ranges[axis.index()] <= MAX_STATIONARY_TRAVEL_RATIO * most)
        .collect();
    match still[..] {
        [axis] => return Ok(vec![RowGroup { plane: CirclePlane::perpendicular_to(axis), rows }]),
        [] => {}
        _ => {
            let rule =
                "a circle needs two of x_mm, y_mm and z_mm that move; one or none moves here";
            return Err(InputFileError::new(
                run.value_location(rows[0], RADIAL_DEVIATION_COLUMN),
                rule,
            ));
        }
    }
    /// Rows on both sides of one, in which the axis that stands still is looked for.
    const NEIGHBOUR_ROWS_PER_SIDE: usize = 12;
    let mut groups: Vec<RowGroup> = Vec::new();
    for at in 0..rows.len() {
        let near = &rows[at.saturating_sub(NEIGHBOUR_ROWS_PER_SIDE)
            ..rows.len().min(at + NEIGHBOUR_ROWS_PER_SIDE + 1)];
        let axes = LinearAxis::ALL.into_iter();
        let still = axes
            .min_by(|a, b| {
                position_range_mm(run, *a, near).total_cmp(&position_range_mm(run, *b, near))
            })
            .expect("three");
        let plane = CirclePlane::perpendicular_to(still);
        match groups.last_mut() {
            Some(group) if group.plane == plane => group.rows.push(rows[at]),
            _ => groups.push(RowGroup { plane, rows: vec![rows[at]] }),
        }
    }
    groups.retain(|group| group.rows.len() >= MIN_RECORD_ROWS);
    Ok(groups)
}

/// Adds the rows of a group to the record of its circle.
fn add_group_to_record(
    records: &mut Vec<CircleRecord>,
    run: &RunFile,
    file: usize,
    group: &RowGroup,
    measured: &known_contributions::RadialReadings,
) -> Result<(), InputFileError> {
    let axes = group.plane.axes();
    let [u, v] = axes.map(|axis| position_column(run, axis).unwrap_or_default());
    let mut rows = group.rows.clone();
    let place = run.value_location(group.rows[0], RADIAL_DEVIATION_COLUMN);
    let bad = |rule: String| InputFileError::new(place.clone(), rule);
    let mut found = None;
    for _ in 0..3 {
        let points: Vec<[f64; 2]> = rows.iter().map(|row| [u[*row], v[*row]]).collect();
        let Some((centre, radius)) = fit_circle(&points) else {
            return Err(bad("the positions lie on no circle: give the commanded positions".into()));
        };
        found = Some((centre, radius));
        rows.retain(|row| {
            let off = (u[*row] - centre[0]).hypot(v[*row] - centre[1]) - radius;
            off.abs() <= MAX_RELATIVE_RADIUS_DEVIATION * radius
        });
    }
    let (centre, radius) = found.expect("three turns");
    if rows.len() * 5 < group.rows.len() * 4 || rows.len() < MIN_RECORD_ROWS {
        return Err(bad(format!(
            "{} of {} rows lie on one circle in the plane {}: {MIN_RECORD_ROWS} and four fifths are needed. Give each plane and \
             each circle its own number in the column run",
            rows.len(),
            group.rows.len(),
            group.plane.name()
        )));
    }
    let is_near = |one: f64, other: f64| (one - other).abs() < CIRCLE_MATCH_TOLERANCE_MM;
    let is_same = |record: &CircleRecord| {
        record.plane == group.plane
            && is_near(record.radius_mm, radius)
            && record.centre_mm.iter().zip(centre).all(|(one, other)| is_near(*one, other))
    };
    let has_time = run.column("time_s").is_some();
    let index = records.iter().position(is_same).unwrap_or_else(|| {
        records.push(CircleRecord {
            plane: group.plane,
            centre_mm: centre,
            radius_mm: radius,
            rows: Vec::new(),
            has_time,
            clock: [0.0; 2],
            play_um: [0.0; 2],
            setups: 0,
            excluded: Vec::new(),
        });
        records.len() - 1
    });
    let record = &mut records[index];
    record.has_time &= has_time;
    let angle = |row: &usize| (v[*row] - centre[1]).atan2(u[*row] - centre[0]);
    let angles: Vec<f64> = rows.iter().map(angle).collect();
    let rotation_directions = rotation_directions(run, axes, &rows, &angles);
    let number = |name: &str, row: usize| run.column(name).map_or(f64::NAN, |all| all[row]);
    // A file without a column setup is one set-up.
    let key = (file, run.column("setup").map(|all| all[rows[0]].to_bits()));
    let setup = record
        .rows
        .iter()
        .find(|row| {
            let [of, row] = row.source;
            (of, run.column("setup").filter(|_| of == file).map(|all| all[row].to_bits())) == key
        })
        .map_or(record.setups, |row| row.setup);
    record.setups = record.setups.max(setup + 1);
    let mut pass = record.rows.last().map_or(0, |row| row.pass + 1);
    let mut before: Option<CircleReading> = None;
    for ((&row, &angle), &sense) in rows.iter().zip(&angles).zip(&rotation_directions) {
        let um = measured.uncompensated_radial_um(row, axes, angle);
        if sense == 0.0 || um.is_nan() {
            continue;
        }
        let is_gap = |before: &CircleReading| angle_difference_rad(before.angle, angle).abs() > 0.5;
        if before.is_some_and(|before| before.sense != sense || is_gap(&before)) {
            pass += 1;
        }
        let next = CircleReading {
            angle,
            sense,
            measured_um: um,
            um,
            at_mm: [u[row], v[row]],
            clock: Some(number("time_s", row)).filter(|time| !time.is_nan()).unwrap_or(row as f64),
            feed_mm_per_min: number("feed_mm_per_min", row),
            setup,
            pass,
            source: [file, row],
        };
        record.rows.push(next);
        before = Some(next);
    }
    Ok(())
}

/// Takes single readings out that stand far from their neighbours on both sides.
fn exclude_gross_errors(record: &mut CircleRecord, runs: &[RunFile]) {
    let rows = &record.rows;
    let near = |at: usize| {
        let all = at.saturating_sub(3)..(at + 4).min(rows.len());
        let mut values: Vec<f64> = all
            .filter(|other| *other != at && rows[*other].pass == rows[at].pass)
            .map(|other| rows[other].um)
            .collect();
        if values.len() < 3 { rows[at].um } else { robust::median(&mut values) }
    };
    let away: Vec<f64> = (0..rows.len()).map(|at| rows[at].um - near(at)).collect();
    let mut sizes: Vec<f64> = away.iter().map(|deviation| deviation.abs()).collect();
    let scatter = (1.4826 * robust::median(&mut sizes)).max(0.02);
    let is_gross = |at: usize| {
        let row = &rows[at];
        let is_near = |axis: usize, end: bool| {
            angle_since_reversal_rad(row, axis, end).abs() < REVERSAL_ZONE_HALF_WIDTH_RAD
        };
        let near = (0..2).any(|axis| is_near(axis, true) || is_near(axis, false));
        !near && away[at].abs() > GROSS_ERROR_THRESHOLD_SIGMAS * scatter
    };
    let gross: Vec<bool> = (0..rows.len()).map(is_gross).collect();
    for (at, _) in gross.iter().enumerate().filter(|(_, is)| **is) {
        let [file, row] = rows[at].source;
        record.excluded.push(ExcludedRow {
            place: runs[file].value_location(row, RADIAL_DEVIATION_COLUMN),
            measured_um: rows[at].measured_um,
            reason: format!("{:.3} µm from its neighbours", away[at]),
        });
    }
    let mut gross = gross.into_iter();
    record.rows.retain(|_| !gross.next().unwrap_or(false));
}

fn check_record_coverage(record: &CircleRecord, runs: &[RunFile]) -> Result<(), InputFileError> {
    let place = record.rows.first().map_or_else(
        || Location::start_of_file(runs[0].path()),
        |row| runs[row.source[0]].value_location(row.source[1], RADIAL_DEVIATION_COLUMN),
    );
    let plane = record.plane.name();
    if record.rows.len() < MIN_RECORD_ROWS {
        let rule = format!(
            "the circle in {plane} has {} rows: {MIN_RECORD_ROWS} are needed",
            record.rows.len()
        );
        return Err(InputFileError::new(place, rule));
    }
    let arc = record.covered_arc_rad();
    if arc < MIN_ARC_RAD {
        let rule = format!(
            "the circle in {plane} covers {:.0}°: less than half a circle distinguishes no causes. Measure 180° or more",
            arc * 180.0 / PI
        );
        return Err(InputFileError::new(place, rule));
    }
    Ok(())
}

/// Replaces neighbours by their means until there are few enough rows.
fn average_neighbouring_rows(record: &mut CircleRecord) {
    let together = record.rows.len().div_ceil(MAX_RECORD_ROWS);
    if together < 2 {
        return;
    }
    let mut thinned = Vec::new();
    for pass in record.rows.chunk_by(|a, b| a.pass == b.pass) {
        for part in pass.chunks(together) {
            let mean = |of: fn(&CircleReading) -> f64| {
                part.iter().map(of).sum::<f64>() / part.len() as f64
            };
            let first = part[0];
            let turn =
                part.iter().map(|row| angle_difference_rad(first.angle, row.angle)).sum::<f64>();
            thinned.push(CircleReading {
                angle: first.angle + turn / part.len() as f64,
                um: mean(|row| row.um),
                measured_um: mean(|row| row.measured_um),
                at_mm: [mean(|row| row.at_mm[0]), mean(|row| row.at_mm[1])],
                clock: mean(|row| row.clock),
                ..first
            });
        }
    }
    record.rows = thinned;
}
