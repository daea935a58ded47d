//! The pictures of the report: what was measured and predicted, and what is left over everything that was
//! recorded.

use std::fmt::Write as _;

use trueup_machine::file::LinearAxis;
use trueup_page::time_unit;

use crate::{
    answer::{
        Diagnosis,
        curve::{curves, moving_axis},
        figure::{Colour, Points, picture},
    },
    columns::named,
    data::Data,
};

/// More lines than that over each other are a cloud.
const MAX_LINES: usize = 12;

/// Measured and predicted, and what is left, over the main axis.
pub(super) fn predicted_and_left(diagnosis: &Diagnosis, out: &mut String) {
    let data = &diagnosis.data;
    let over = Over::of(data);
    let (x_name, x) = over.axis(data);
    let rows: Vec<usize> =
        (0..data.rows).filter(|&row| data.used[row] && !diagnosis.aside[row]).collect();
    let pick = |values: &[f64]| -> Vec<f64> { rows.iter().map(|&row| values[row]).collect() };
    let x = pick(&x);
    let measured = pick(&data.measured);
    let (before, after) = (pick(&diagnosis.before), pick(&diagnosis.after));
    let left = |p: &[f64]| -> Vec<f64> { measured.iter().zip(p).map(|(m, p)| m - p).collect() };
    let (left_before, left_after) = (left(&before), left(&after));
    let mut lists = vec![Points::dots(&x, &measured, Colour::Measured)];
    let dense = match over {
        Over::Position(axis) => curves(diagnosis, axis),
        _ => [Vec::new(), Vec::new()],
    };
    for (curves, colour) in dense.iter().zip([Colour::Before, Colour::After]) {
        lists.extend(curves.iter().map(|it| Points::line(&it.at_mm, &it.um, colour)));
    }
    let has_curves = lists.len() > 1;
    let series =
        1 + rows.windows(2).filter(|two| data.series[two[0]] != data.series[two[1]]).count();
    if !has_curves && series > MAX_LINES {
        lists.push(Points::dots(&x, &before, Colour::Before));
        lists.push(Points::dots(&x, &after, Colour::After));
    } else if !has_curves {
        // A line ends where a series does.
        let mut first = 0;
        for end in 1..=rows.len() {
            if end == rows.len() || data.series[rows[end]] != data.series[rows[first]] {
                for (y, colour) in [(&before, Colour::Before), (&after, Colour::After)] {
                    lists.push(Points::line(&x[first..end], &y[first..end], colour));
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
    out.push_str(&picture(&title, &x_name, "µm", &lists));
    let lists = [
        Points::dots(&x, &left_before, Colour::Before),
        Points::dots(&x, &left_after, Colour::After),
    ];
    out.push_str(&picture("What is left: measured minus predicted", &x_name, "µm", &lists));
    // Next to an error ten times as large nothing of its shape can be seen.
    if !diagnosis.report.findings.is_empty() {
        let lists = [Points::dots(&x, &left_after, Colour::After)];
        let title = "What is left with the causes found, on a scale of its own";
        out.push_str(&picture(title, &x_name, "µm", &lists));
    }
    out.push_str("</div>\n");
}

/// The horizontal axis of the pictures.
#[derive(Clone, Copy)]
enum Over {
    Position(LinearAxis),
    Time,
    Rows,
}

impl Over {
    /// Returns the position where the axis was driven from place to place, else time, else the rows.
    fn of(data: &Data) -> Self {
        let is_driven = data.run.is_some() || data.time_s.is_none();
        match (moving_axis(data).filter(|_| is_driven), &data.time_s) {
            (Some(axis), _) => Self::Position(axis),
            (None, Some(_)) => Self::Time,
            (None, None) => Self::Rows,
        }
    }

    /// Its name, and its value in each row.
    fn axis(self, data: &Data) -> (String, Vec<f64>) {
        let rows = || (0..data.rows).map(|row| row as f64 + 1.0).collect();
        match self {
            Self::Position(axis) => {
                let at_mm = data.position_mm[axis.index()].as_deref();
                (format!("{}, mm", axis.name()), at_mm.map_or_else(rows, <[f64]>::to_vec))
            }
            Self::Time => {
                let times = data.time_s.as_deref().unwrap_or_default();
                let known = times.iter().copied().filter(|time| time.is_finite());
                let (first, last) = known.fold((f64::INFINITY, 0.0_f64), |(first, last), time| {
                    (first.min(time), last.max(time))
                });
                let (unit, seconds) = time_unit(last - first);
                (format!("time, {unit}"), times.iter().map(|time| time / seconds).collect())
            }
            Self::Rows => ("row".into(), rows()),
        }
    }
}

/// Writes small pictures of the residual against every column that changes.
pub(super) fn against_inputs(diagnosis: &Diagnosis, out: &mut String) {
    let data = &diagnosis.data;
    let rows: Vec<usize> =
        (0..data.rows).filter(|&row| data.used[row] && !diagnosis.aside[row]).collect();
    let left =
        |p: &[f64]| -> Vec<f64> { rows.iter().map(|&row| data.measured[row] - p[row]).collect() };
    let (before, after) = (left(&diagnosis.before), left(&diagnosis.after));
    let mut names: Vec<String> =
        ["time_s", "run", "x_mm", "y_mm", "z_mm", "spindle_rpm", "load_n"].map(String::from).into();
    names.extend(data.temperatures.iter().map(|(name, _)| name.clone()));
    names.extend(data.others.iter().map(|(name, _)| name.clone()));
    let mut all = String::new();
    let mut draw = |name: &str, x: &[f64]| {
        // Against what stays the same nothing can be seen.
        let Some(first) = x.iter().find(|it| !it.is_nan()) else { return };
        if x.iter().all(|it| it.is_nan() || it == first) {
            return;
        }
        let lists =
            [Points::dots(x, &before, Colour::Before), Points::dots(x, &after, Colour::After)];
        all.push_str(&picture(&format!("What is left against {name}"), name, "left, µm", &lists));
    };
    for name in names {
        if let Some(values) = named(data, &name) {
            let x: Vec<f64> = rows.iter().map(|&row| values[row]).collect();
            draw(&name, &x);
        }
    }
    if let Some(direction) = data.own_direction() {
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
