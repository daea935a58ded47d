//! Straightness from a run file: which axis moved, which error was measured.

use trueup_machine::{
    InputFileError, Location,
    applied_offsets::UncompensatedRun,
    machine_file::{LinearAxis, Straightness},
};

use super::{StraightnessFit, StraightnessFitError, StraightnessFitOptions, fit};

/// A curve from a run, with its place in the machine file.
#[derive(Clone, Debug)]
pub struct StraightnessCurve {
    /// The axis that is in error.
    pub error: LinearAxis,
    /// The axis that moves.
    pub along: LinearAxis,
    /// The fit; its rows are those that have both values.
    pub fit: StraightnessFit,
    /// Rows without the position or the error.
    pub rows_incomplete: usize,
}

impl StraightnessCurve {
    /// As the machine file has it: its section is `[straightness.<name>]`.
    #[must_use]
    pub fn straightness(&self) -> Straightness {
        Straightness { error: self.error, along: self.along, spline: self.fit.spline.clone() }
    }

    /// Returns the name of its section under `[straightness]`: `z_of_x`.
    #[must_use]
    pub fn section_name(&self) -> String {
        self.straightness().name()
    }
}

/// Returns the curve of `quantity` (`dx`, `dy`, `dz`; where the run has only one it need not be named) over
/// the position of the one axis that moves. Several passes are repeats.
///
/// # Errors
/// The quantity is not there, or there are several and none is named; no axis moves, several do, or
/// it is the axis that is in error; a [`StraightnessFitError`], with its row.
pub fn fit_straightness_run(
    run: &UncompensatedRun<'_>,
    quantity: Option<&str>,
    options: &StraightnessFitOptions,
) -> Result<StraightnessCurve, InputFileError> {
    let error = resolve_error_axis(run, quantity)?;
    let column = error_column_name(error);
    let errors = run.require_column(&column)?;
    let along = find_moving_axis(run, error, errors)?;
    let position_column = along.column_name();
    let positions = run.require_column(&position_column)?;

    let there = |row: &usize| !positions[*row].is_nan() && !errors[*row].is_nan();
    let rows: Vec<usize> = (0..run.row_count()).filter(there).collect();
    let take = |values: &[f64]| -> Vec<f64> { rows.iter().map(|&row| values[row]).collect() };
    let fit = fit(&take(positions), &take(errors), options).map_err(|fault| match fault {
        StraightnessFitError::NotFinite { row, is_position, value } => {
            let column = if is_position { &position_column } else { &column };
            run.value_error(rows[row], column, format_args!("is {value}"))
        }
        other => run.value_error(0, &position_column, other),
    })?;
    Ok(StraightnessCurve { error, along, fit, rows_incomplete: run.row_count() - rows.len() })
}

pub(super) fn error_column_name(axis: LinearAxis) -> String {
    format!("measured_d{}_um", axis.name())
}

/// Returns the axis whose error is to be fitted.
pub(super) fn resolve_error_axis(
    run: &UncompensatedRun<'_>,
    quantity: Option<&str>,
) -> Result<LinearAxis, InputFileError> {
    let whole = |rule: String| InputFileError::new(Location::start_of_file(run.path()), rule);
    if let Some(quantity) = quantity {
        let axis = LinearAxis::ALL.into_iter().find(|axis| quantity == format!("d{}", axis.name()));
        let axis = axis
            .ok_or_else(|| whole(format!("straightness needs dx, dy or dz, not {quantity:?}")))?;
        return run.require_column(&error_column_name(axis)).map(|_| axis);
    }
    let measured = LinearAxis::ALL.into_iter().filter(|&axis| {
        run.column(&error_column_name(axis))
            .is_some_and(|values| values.iter().any(|v| !v.is_nan()))
    });
    match measured.collect::<Vec<_>>()[..] {
        [axis] => Ok(axis),
        [] => Err(whole(
            "no column has a measured error: one of measured_dx_um, measured_dy_um, \
             measured_dz_um is needed"
                .into(),
        )),
        ref several => {
            let names: Vec<String> =
                several.iter().map(|axis| format!("d{}", axis.name())).collect();
            Err(whole(format!(
                "the run measures {}: choose one with --axis or --quantity",
                names.join(", ")
            )))
        }
    }
}

/// Returns the axes whose positions a run has, each with how far it goes in mm where the error is measured.
fn axis_travels(run: &UncompensatedRun<'_>, errors: &[f64]) -> Vec<(LinearAxis, f64)> {
    let travel = |axis: LinearAxis| -> Option<f64> {
        let positions = run.column(&axis.column_name())?.iter().zip(errors);
        let there = positions.filter(|(x, y)| !x.is_nan() && !y.is_nan()).map(|(&x, _)| x);
        let (low, high) = there
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        Some(f64::max(high - low, 0.0))
    };
    LinearAxis::ALL.into_iter().filter_map(|axis| Some((axis, travel(axis)?))).collect()
}

/// Those of `axis_travels` that move.
pub(super) fn moving_axes(run: &UncompensatedRun<'_>, errors: &[f64]) -> Vec<(LinearAxis, f64)> {
    /// An axis that stands still reads back a little of the other's travel.
    const MAX_STATIONARY_TRAVEL_RATIO: f64 = 1e-3;
    let mut travels = axis_travels(run, errors);
    let longest = travels.iter().map(|(_, mm)| *mm).fold(0.0, f64::max);
    travels.retain(|(_, mm)| *mm > MAX_STATIONARY_TRAVEL_RATIO * longest);
    travels
}

/// Returns the one axis that moves while the error is measured.
fn find_moving_axis(
    run: &UncompensatedRun<'_>,
    error: LinearAxis,
    errors: &[f64],
) -> Result<LinearAxis, InputFileError> {
    let travels = axis_travels(run, errors);
    let moving = moving_axes(run, errors);
    let whole = |rule: String| InputFileError::new(Location::start_of_file(run.path()), rule);
    match moving[..] {
        [(axis, _)] if axis != error => Ok(axis),
        [_] => Err(whole(format!(
            "{} while {} itself moves is a positioning error: `trueup fit pitch`",
            error_column_name(error),
            error.name()
        ))),
        [] if travels.is_empty() => {
            Err(whole("no column has a position: one of x_mm, y_mm, z_mm is needed".into()))
        }
        [] => {
            let names: Vec<String> = travels.iter().map(|(axis, _)| axis.column_name()).collect();
            let verb = if names.len() == 1 { "stays" } else { "stay" };
            Err(whole(format!(
                "no axis moves: {} {verb} the same where {} is measured",
                names.join(", "),
                error_column_name(error)
            )))
        }
        ref several => {
            let named = |(axis, mm): &(LinearAxis, f64)| format!("{}_mm by {mm} mm", axis.name());
            let names: Vec<String> = several.iter().map(named).collect();
            Err(whole(format!(
                "several axes move ({}): a straightness is measured with one moving alone",
                names.join(", ")
            )))
        }
    }
}
