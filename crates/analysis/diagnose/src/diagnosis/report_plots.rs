//! The pictures of the report: what was measured and predicted, and what is left over everything that was
//! recorded.

use std::fmt::Write as _;

use trueup_machine::machine_file::LinearAxis;
use trueup_page::choose_time_unit;

use crate::{
    columns::column_by_name,
    data::DataTable,
    diagnosis::{
        Diagnosis,
        error_curve::{abscissa_axis, compute_error_curves},
        plot::{ColourRole, PlotSeries, render_plot},
    },
};

/// More lines than that over each other are a cloud.
const MAX_PLOTTED_LINE_SERIES: usize = 12;

/// Measured and predicted, and what is left, over the main axis.
pub(super) fn write_prediction_plot(diagnosis: &Diagnosis, out: &mut String) {
    let data = &diagnosis.data;
    let over = PlotAbscissa::from_data(data);
    let (x_name, x) = over.label_and_values(data);
    let rows: Vec<usize> =
        (0..data.rows).filter(|&row| data.used[row] && !diagnosis.aside[row]).collect();
    let pick = |values: &[f64]| -> Vec<f64> { rows.iter().map(|&row| values[row]).collect() };
    let x = pick(&x);
    let measured = pick(&data.measured);
    let (before, after) = (pick(&diagnosis.before), pick(&diagnosis.after));
    let left = |p: &[f64]| -> Vec<f64> { measured.iter().zip(p).map(|(m, p)| m - p).collect() };
    let (left_before, left_after) = (left(&before), left(&after));
    let mut lists = vec![PlotSeries::dots(&x, &measured, ColourRole::Measured)];
    let dense = match over {
        PlotAbscissa::Position(axis) => compute_error_curves(diagnosis, axis),
        _ => [Vec::new(), Vec::new()],
    };
    for (error_curves, colour) in dense.iter().zip([ColourRole::Before, ColourRole::After]) {
        lists.extend(
            error_curves.iter().map(|curve| PlotSeries::line(&curve.at_mm, &curve.um, colour)),
        );
    }
    let has_curves = lists.len() > 1;
    let series = 1 + rows
        .windows(2)
        .filter(|two| data.places.series[two[0]] != data.places.series[two[1]])
        .count();
    if !has_curves && series > MAX_PLOTTED_LINE_SERIES {
        lists.push(PlotSeries::dots(&x, &before, ColourRole::Before));
        lists.push(PlotSeries::dots(&x, &after, ColourRole::After));
    } else if !has_curves {
        // A line ends where a series does.
        let mut first = 0;
        for end in 1..=rows.len() {
            if end == rows.len() || data.places.series[rows[end]] != data.places.series[rows[first]]
            {
                for (y, colour) in [(&before, ColourRole::Before), (&after, ColourRole::After)] {
                    lists.push(PlotSeries::line(&x[first..end], &y[first..end], colour));
                }
                first = end;
            }
        }
    }
    let between = if has_curves {
        " (lines: the model between the points, at the median of what else was recorded)"
    } else {
        ""
    };
    let title = format!("Measured and predicted{between}");
    out.push_str("<div class=\"grid\">");
    out.push_str(&render_plot(&title, &x_name, "µm", &lists));
    let lists = [
        PlotSeries::dots(&x, &left_before, ColourRole::Before),
        PlotSeries::dots(&x, &left_after, ColourRole::After),
    ];
    out.push_str(&render_plot("What is left: measured minus predicted", &x_name, "µm", &lists));
    // Next to an error ten times as large nothing of its shape can be seen.
    if !diagnosis.report.findings.is_empty() {
        let lists = [PlotSeries::dots(&x, &left_after, ColourRole::After)];
        let title = "What is left with the causes found, on a scale of its own";
        out.push_str(&render_plot(title, &x_name, "µm", &lists));
    }
    out.push_str("</div>\n");
}

/// The horizontal axis of the pictures.
#[derive(Clone, Copy)]
enum PlotAbscissa {
    Position(LinearAxis),
    Time,
    Rows,
}

impl PlotAbscissa {
    /// Returns the position where the axis was driven from place to place, else time, else the rows.
    fn from_data(data: &DataTable) -> Self {
        let is_driven = data.run_numbers().is_some() || data.time_s().is_none();
        match (abscissa_axis(data).filter(|_| is_driven), data.time_s()) {
            (Some(axis), _) => Self::Position(axis),
            (None, Some(_)) => Self::Time,
            (None, None) => Self::Rows,
        }
    }

    /// Its name, and its value in each row.
    fn label_and_values(self, data: &DataTable) -> (String, Vec<f64>) {
        let rows = || (0..data.rows).map(|row| row as f64 + 1.0).collect();
        match self {
            Self::Position(axis) => {
                let at_mm = data.position_mm(axis);
                (format!("{}, mm", axis.name()), at_mm.map_or_else(rows, <[f64]>::to_vec))
            }
            Self::Time => {
                let times = data.time_s().unwrap_or_default();
                let known = times.iter().copied().filter(|time| time.is_finite());
                let (first, last) = known.fold((f64::INFINITY, 0.0_f64), |(first, last), time| {
                    (first.min(time), last.max(time))
                });
                let (unit, seconds) = choose_time_unit(last - first);
                (format!("time, {unit}"), times.iter().map(|time| time / seconds).collect())
            }
            Self::Rows => ("row".into(), rows()),
        }
    }
}

/// Writes small pictures of the residual against every column that changes.
pub(super) fn write_residual_plots(diagnosis: &Diagnosis, out: &mut String) {
    let data = &diagnosis.data;
    let rows: Vec<usize> =
        (0..data.rows).filter(|&row| data.used[row] && !diagnosis.aside[row]).collect();
    let left =
        |p: &[f64]| -> Vec<f64> { rows.iter().map(|&row| data.measured[row] - p[row]).collect() };
    let (before, after) = (left(&diagnosis.before), left(&diagnosis.after));
    let mut names: Vec<String> =
        ["time_s", "run", "x_mm", "y_mm", "z_mm", "spindle_rpm", "load_n"].map(String::from).into();
    names.extend(data.temperatures().iter().map(|(name, _)| name.clone()));
    names.extend(data.unknown_columns().iter().map(|(name, _)| name.clone()));
    let mut all = String::new();
    let mut draw = |name: &str, x: &[f64]| {
        // Against what stays the same nothing can be seen.
        let Some(first) = x.iter().find(|value| !value.is_nan()) else { return };
        if x.iter().all(|value| value.is_nan() || value == first) {
            return;
        }
        let lists = [
            PlotSeries::dots(x, &before, ColourRole::Before),
            PlotSeries::dots(x, &after, ColourRole::After),
        ];
        all.push_str(&render_plot(
            &format!("What is left against {name}"),
            name,
            "left, µm",
            &lists,
        ));
    };
    for name in names {
        if let Some(values) = column_by_name(data, &name) {
            let x: Vec<f64> = rows.iter().map(|&row| values[row]).collect();
            draw(&name, &x);
        }
    }
    if let Some(direction) = data.own_approach_direction() {
        let x: Vec<f64> = rows.iter().map(|&row| direction[row]).collect();
        draw("direction", &x);
    }
    if all.is_empty() {
        return;
    }
    let _ = write!(
        out,
        "<h2>What is left, against everything that has changed</h2>\n<div class=\"grid\">{all}\
         </div>\n"
    );
}
