//! Rows of run files as readings.
//!
//! | columns of a row | reading |
//! |---|---|
//! | two or three of `measured_dx_um`, `measured_dy_um`, `measured_dz_um` | a ball, or a point of a plate |
//! | one of them; two, where the third axis alone moves | a gauge, or two, on a straight edge; along the axis that moves, a length |
//! | `measured_diagonal_um` | the error along the way from the first to the last position of the set-up |
//! | `measured_dr_um` | a circle, read as `fit circle` reads it |
//!
//! Rows of one file with one `setup` have one zero; rows with one number in `square` are touches of one square, whose faces share
//! their alignment. Angles that the run does not state are 0.

use trueup_machine::{
    InputFileError, Location, Machine, RunFile,
    applied_offsets::compute_applied_offsets_um,
    machine_file::{LinearAxis, RotaryAxis},
};

use super::{
    prediction::{PoseWithApproach, predict_errors_um},
    reading::{CirclePosition, EdgePosition, Pose, ReadingKind, VolumeReading, dot},
};
use crate::circle::{self, record::RADIAL_DEVIATION_COLUMN as RADIAL};

/// The columns of components, of X, Y and Z.
pub(crate) const COMPONENT_COLUMNS: [&str; 3] =
    ["measured_dx_um", "measured_dy_um", "measured_dz_um"];
/// The column of diagonals.
pub(crate) const DIAGONAL_COLUMN: &str = "measured_diagonal_um";
/// Readings of one pass of a circle; more are thinned.
const MAX_READINGS_PER_PASS: usize = 180;
/// The alignment of a square, in the place of an axis.
const SQUARE_ALIGNMENT_CODE: u64 = 4;
/// Fewer readings are no measurement of a volume.
pub(crate) const MIN_VOLUME_READINGS: usize = 24;

/// Returns the readings of `runs` without what `machine` predicts. `is_certified`: the form of a straight edge is right.
///
/// # Errors
/// See [`super::fit`].
pub fn read(
    runs: &[RunFile],
    machine: &Machine,
    is_certified: bool,
    warnings: &mut Vec<String>,
) -> Result<Vec<VolumeReading>, InputFileError> {
    let mut readings: Vec<VolumeReading> = Vec::new();
    for (file, run) in runs.iter().enumerate() {
        let own = read_rows(run, file, machine, is_certified, warnings)?;
        let first = readings
            .iter()
            .map(|reading| reading.setup.max(reading.aligned) + 1)
            .max()
            .unwrap_or(0);
        // Edges of another file are other ones.
        let edge =
            readings.iter().filter_map(|reading| reading.on_edge).map(|edge| edge.edge + 1).max();
        readings.extend(own.into_iter().map(|reading| VolumeReading {
            setup: reading.setup + first,
            aligned: reading.aligned + first,
            on_edge:
                reading.on_edge.map(|on| EdgePosition { edge: on.edge + edge.unwrap_or(0), ..on }),
            ..reading
        }));
    }
    let start = runs.first().map_or_else(|| "".as_ref(), RunFile::path);
    if readings.len() < MIN_VOLUME_READINGS {
        let rule = format!(
            "{} readings in all runs: {MIN_VOLUME_READINGS} are needed. A row has x_mm, y_mm, z_mm and one of {}, {DIAGONAL_COLUMN}, {RADIAL}",
            readings.len(),
            COMPONENT_COLUMNS.join(", ")
        );
        return Err(InputFileError::new(Location::start_of_file(start), rule));
    }
    Ok(readings)
}

/// The columns of a run that each row is read from.
struct RunColumns<'r> {
    position_mm: [&'r [f64]; 3],
    angle_deg: [Option<&'r [f64]>; 3],
    tool_mm: Option<&'r [f64]>,
    setup: Option<&'r [f64]>,
    point: Option<&'r [f64]>,
    square: Option<&'r [f64]>,
    direction: [Option<&'r [f64]>; 3],
    offsets_um: Option<[Vec<f64>; 3]>,
    nominal_tool_mm: f64,
}

impl<'r> RunColumns<'r> {
    fn from_run(
        run: &'r RunFile,
        machine: &Machine,
        warnings: &mut Vec<String>,
    ) -> Result<Self, InputFileError> {
        let mut position_mm = [[].as_slice(); 3];
        for (values, axis) in position_mm.iter_mut().zip(LinearAxis::ALL) {
            *values = run.require_column(&axis.column_name())?;
        }
        let angle_deg = RotaryAxis::ALL.map(|axis| run.column(&format!("{}_deg", axis.name())));
        for axis in machine
            .volume
            .chain
            .iter()
            .flat_map(trueup_machine::machine_file::AxisChain::rotary_axes)
        {
            if angle_deg[axis.index()].is_none() {
                warnings.push(format!(
                    "{}: {1}_deg is missing: {2} is taken to stand at 0°",
                    run.path().display(),
                    axis.name(),
                    axis.name().to_uppercase()
                ));
            }
        }
        let offsets_um =
            compute_applied_offsets_um(run, Some(machine))?.map(|(offsets_um, notes)| {
                warnings.extend(notes);
                offsets_um
            });
        Ok(Self {
            position_mm,
            angle_deg,
            tool_mm: run.column("tool_length_mm"),
            setup: run.column("setup"),
            point: run.column("point"),
            square: run.column("square"),
            direction: LinearAxis::ALL.map(|axis| run.column(&format!("dir_{}", axis.name()))),
            offsets_um,
            nominal_tool_mm: machine.volume.tool.length_mm,
        })
    }

    fn pose(&self, row: usize) -> Pose {
        Pose {
            position_mm: self.position_mm.map(|values| values[row]),
            angle_deg: self.angle_deg.map(|values| values.map_or(0.0, |values| values[row])),
            tool_mm: self.tool_mm.map_or(self.nominal_tool_mm, |values| values[row]),
        }
    }

    /// Returns what a bridge had applied towards a direction.
    fn applied_correction_um(&self, row: usize, toward: [f64; 3]) -> f64 {
        let offsets = self.offsets_um.as_ref();
        offsets.map_or(0.0, |offsets| dot(toward, [0, 1, 2].map(|n| offsets[n][row])))
    }
}

fn is_finite_pose(pose: &Pose) -> bool {
    let Pose { position_mm, angle_deg, tool_mm } = pose;
    position_mm.iter().chain(angle_deg).chain([tool_mm]).all(|coordinate| coordinate.is_finite())
}

/// Numbers of zeros, by what distinguishes them.
#[derive(Default)]
struct SetupIndex(Vec<[u64; 4]>);

impl SetupIndex {
    fn index_or_insert(&mut self, key: [u64; 4]) -> usize {
        self.0.iter().position(|candidate| *candidate == key).unwrap_or_else(|| {
            self.0.push(key);
            self.0.len() - 1
        })
    }
}

fn read_rows(
    run: &RunFile,
    file: usize,
    machine: &Machine,
    is_certified: bool,
    warnings: &mut Vec<String>,
) -> Result<Vec<VolumeReading>, InputFileError> {
    let columns = RunColumns::from_run(run, machine, warnings)?;
    let mut setups = SetupIndex::default();
    let (mut readings, mut stated) = (Vec::new(), Vec::new());
    let mut add = |reading: VolumeReading, direction: [f64; 3]| {
        if is_finite_pose(&reading.pose) && reading.measured_um.is_finite() {
            let VolumeReading { pose, source: [_, row], .. } = reading;
            stated.push(PoseWithApproach { row, pose, direction });
            readings.push(reading);
        }
    };
    let directions =
        |row: usize| columns.direction.map(|direction| direction.map_or(1.0, |values| values[row]));
    read_component_readings(run, (file, is_certified), &columns, &mut setups, |component| {
        add(component, directions(component.source[1]));
    });
    read_diagonal_readings(run, file, &columns, &mut setups, &mut |component| {
        add(component, directions(component.source[1]))
    })?;
    read_circle_readings(run, file, machine, &columns, &mut setups, &mut add)?;
    if readings.is_empty() {
        run.require_column(COMPONENT_COLUMNS[0])?;
    }
    let predicted = predict_errors_um(run, machine, &stated, warnings)?;
    for (reading, um) in readings.iter_mut().zip(predicted) {
        reading.um = reading.measured_um - dot(um, reading.toward);
    }
    readings.retain(|reading| reading.um.is_finite());
    Ok(readings)
}

/// Adds balls and readings in one direction.
fn read_component_readings(
    run: &RunFile,
    (file, is_certified): (usize, bool),
    columns: &RunColumns<'_>,
    setups: &mut SetupIndex,
    mut add: impl FnMut(VolumeReading),
) {
    let measured = COMPONENT_COLUMNS.map(|name| run.column(name));
    for row in 0..run.row_count() {
        let there: Vec<usize> =
            (0..3).filter(|n| measured[*n].is_some_and(|values| !values[row].is_nan())).collect();
        let is_edge = match there[..] {
            [_] => true,
            [first, second] => sole_moving_axis(columns, run, row) == Some(3 - first - second),
            _ => false,
        };
        let kind = if is_edge { ReadingKind::Edge } else { ReadingKind::Ball };
        let setup = columns.setup.map_or(0, |values| values[row].to_bits());
        let point = columns.point.map(|values| values[row]).filter(|value| value.is_finite());
        for n in &there {
            let mut toward = [0.0; 3];
            toward[*n] = 1.0;
            // An edge is another artefact for each direction; its points have numbers below 0.
            let key = if kind == ReadingKind::Edge { *n as u64 } else { 3 };
            let number = setups.index_or_insert([kind as u64, key, setup, 0]);
            let square = columns.square.map(|values| values[row]).filter(|value| value.is_finite());
            let aligned = match square.filter(|_| kind == ReadingKind::Edge) {
                Some(square) => setups.index_or_insert([
                    kind as u64,
                    SQUARE_ALIGNMENT_CODE,
                    square.to_bits(),
                    setup,
                ]),
                None => number,
            };
            let on_edge = match (kind, is_certified) {
                (ReadingKind::Edge, false) => edge_position(columns, run, row, [*n, number]),
                _ => None,
            };
            let point = point.map(|point| match kind {
                ReadingKind::Edge => -1 - point.abs() as i64,
                _ => point.abs() as i64,
            });
            let reading = columns.applied_correction_um(row, toward);
            let value = measured[*n].map_or(f64::NAN, |values| values[row]);
            add(VolumeReading {
                kind,
                pose: columns.pose(row),
                toward,
                um: f64::NAN,
                measured_um: value - reading,
                setup: number,
                aligned,
                on_circle: None,
                on_edge,
                point,
                source: [file, row],
                column: COMPONENT_COLUMNS[*n],
            });
        }
    }
}

/// Returns the place on an edge: by its points, which are the same in all set-ups, else by the axis that moves along it in this
/// set-up. `None` where the reading is along that axis: a length.
fn edge_position(
    columns: &RunColumns<'_>,
    run: &RunFile,
    row: usize,
    [axis, setup]: [usize; 2],
) -> Option<EdgePosition> {
    let share = |values: &dyn Fn(usize) -> f64, rows: &[usize]| {
        let at = || rows.iter().map(|row| values(*row)).filter(|value| value.is_finite());
        let [low, high] = [at().fold(f64::MAX, f64::min), at().fold(f64::MIN, f64::max)];
        (high > low).then(|| (values(row) - low) / (high - low))
    };
    if let Some(point) = columns.point.filter(|point| point[row].is_finite()) {
        let all: Vec<usize> = (0..run.row_count()).collect();
        return Some(EdgePosition { edge: axis, share: share(&|row| point[row], &all)? });
    }
    let (rows, range) = setup_rows_and_travels(columns, run, row);
    let along =
        (0..3).max_by(|a, b| range[*a].total_cmp(&range[*b])).filter(|other| *other != axis)?;
    // Numbers below 3 are those of edges with points.
    let share = share(&|row| columns.position_mm[along][row], &rows)?;
    Some(EdgePosition { edge: 3 + setup, share })
}

/// Returns the rows of the set-up of a row, and how far X, Y and Z move in them.
fn setup_rows_and_travels(
    columns: &RunColumns<'_>,
    run: &RunFile,
    row: usize,
) -> (Vec<usize>, [f64; 3]) {
    let is_same = |other: &usize| {
        columns.setup.is_none_or(|setup| setup[*other].to_bits() == setup[row].to_bits())
    };
    let rows: Vec<usize> = (0..run.row_count()).filter(is_same).collect();
    let range = columns.position_mm.map(|values| {
        let at = || rows.iter().map(|row| values[*row]).filter(|value| !value.is_nan());
        at().fold(f64::MIN, f64::max) - at().fold(f64::MAX, f64::min)
    });
    (rows, range)
}

/// Returns the axis that moves in the set-up of a row, where no other one does.
fn sole_moving_axis(columns: &RunColumns<'_>, run: &RunFile, row: usize) -> Option<usize> {
    let (_, range) = setup_rows_and_travels(columns, run, row);
    let is_still = |axis: usize, along: usize| axis == along || range[axis] < 0.01 * range[along];
    (0..3).find(|along| (0..3).all(|axis| is_still(axis, *along)))
}

fn read_diagonal_readings(
    run: &RunFile,
    file: usize,
    columns: &RunColumns<'_>,
    setups: &mut SetupIndex,
    add: &mut dyn FnMut(VolumeReading),
) -> Result<(), InputFileError> {
    let Some(values) = run.column(DIAGONAL_COLUMN) else { return Ok(()) };
    let key = |row: usize| columns.setup.map_or(0, |setup| setup[row].to_bits());
    let rows: Vec<usize> = (0..run.row_count()).filter(|row| !values[*row].is_nan()).collect();
    for &row in &rows {
        let own: Vec<usize> =
            rows.iter().copied().filter(|other| key(*other) == key(row)).collect();
        let [first, last] = [own[0], own[own.len() - 1]]
            .map(|row| columns.position_mm.map(|position| position[row]));
        let way = [0, 1, 2].map(|n| last[n] - first[n]);
        let length = dot(way, way).sqrt();
        if length.is_nan() || length <= 1.0 {
            let rule = "ends where it began: a diagonal goes from its first row to its last one. Give each diagonal its own \
                        number in the column setup";
            return Err(run.value_error(row, DIAGONAL_COLUMN, rule));
        }
        let toward = way.map(|mm| mm / length);
        let setup = setups.index_or_insert([ReadingKind::Diagonal as u64, 0, key(row), 0]);
        add(VolumeReading {
            kind: ReadingKind::Diagonal,
            pose: columns.pose(row),
            toward,
            um: f64::NAN,
            measured_um: values[row] - columns.applied_correction_um(row, toward),
            setup,
            aligned: setup,
            on_circle: None,
            on_edge: None,
            point: None,
            source: [file, row],
            column: DIAGONAL_COLUMN,
        });
    }
    Ok(())
}

fn read_circle_readings(
    run: &RunFile,
    file: usize,
    machine: &Machine,
    columns: &RunColumns<'_>,
    setups: &mut SetupIndex,
    add: &mut dyn FnMut(VolumeReading, [f64; 3]),
) -> Result<(), InputFileError> {
    if run.column(RADIAL).is_none() {
        return Ok(());
    }
    let (records, _) = circle::records(std::slice::from_ref(run), Some(machine))?;
    for (number, record) in records.iter().enumerate() {
        let [u, v] = record.plane.axes().map(LinearAxis::index);
        for pass in record.rows.chunk_by(|a, b| a.pass == b.pass) {
            let step = pass.len().div_ceil(MAX_READINGS_PER_PASS);
            for row in pass.iter().step_by(step) {
                let mut pose = columns.pose(row.source[1]);
                (pose.position_mm[u], pose.position_mm[v]) = (row.at_mm[0], row.at_mm[1]);
                let (sin, cos) = row.angle.sin_cos();
                let mut toward = [0.0; 3];
                (toward[u], toward[v]) = (cos, sin);
                let mut direction = [1.0; 3];
                let back = |velocity: f64| if velocity * row.sense < 0.0 { -1.0 } else { 1.0 };
                (direction[u], direction[v]) = (back(-sin), back(cos));
                let still_mm = pose.position_mm[3 - u - v];
                let key = [
                    ReadingKind::Circle as u64,
                    number as u64,
                    row.setup as u64,
                    still_mm.to_bits() ^ pose.tool_mm.to_bits().rotate_left(1),
                ];
                let setup = setups.index_or_insert(key);
                let reading = VolumeReading {
                    kind: ReadingKind::Circle,
                    pose,
                    toward,
                    um: f64::NAN,
                    measured_um: row.measured_um,
                    setup,
                    aligned: setup,
                    on_circle: Some(CirclePosition { angle: row.angle, sense: row.sense }),
                    on_edge: None,
                    point: None,
                    source: [file, row.source[1]],
                    column: RADIAL,
                };
                add(reading, direction);
            }
        }
    }
    Ok(())
}
