//! A constant over the days it was measured: wear of a backlash, drift of a pitch (seed 004).
//!
//! ```text
//! value = a + b·t,   b with its 95 % interval by Student's t from what the line leaves
//! ```
//!
//! "Measure again" is the day on which the constant may have changed by so much that it matters, at the
//! fastest rate that the record allows (|b| and its half interval). What matters is the user's limit, else
//! what a single measurement can tell: half its own interval, or twice what the line leaves.

use serde::Serialize;
use trueup_numerics::least_squares::Triangle;

use crate::dated::{Constant, Day, text_of};

/// Days of a year.
const YEAR: f64 = 365.25;
/// A line needs as many days for an interval.
const FEWEST: usize = 3;

/// One measurement of a constant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// `2026-11-22`.
    pub date: String,
    /// Days since the first.
    pub days: f64,
    /// The value, in the unit of the name.
    pub value: f64,
    /// Half its 95 % interval, where the file shows it.
    pub half_width: Option<f64>,
}

/// A constant over its days.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trend {
    /// Its key in the machine file.
    pub name: String,
    /// In the order of the days.
    pub points: Vec<Point>,
    /// Change in a year and half its 95 % interval; `None` below three days.
    pub per_year: Option<[f64; 2]>,
    /// Whether the change is beyond chance.
    pub changes: bool,
    /// A change that matters, in the unit of the name.
    pub matters: Option<f64>,
    /// The day by which to measure again.
    pub measure_again_by: Option<String>,
    /// What it means.
    pub sentence: String,
}

/// The trends of these days' constants; `limit`: a change that matters.
#[must_use]
pub fn trends(days: &[(Day, Vec<Constant>)], limit: Option<f64>) -> Vec<Trend> {
    let mut days: Vec<&(Day, Vec<Constant>)> = days.iter().collect();
    days.sort_by_key(|(day, _)| *day);
    let mut names: Vec<&str> = Vec::new();
    for constant in days.iter().flat_map(|(_, constants)| constants) {
        if !names.contains(&constant.name.as_str()) {
            names.push(&constant.name);
        }
    }
    let of = |name: &&str| {
        let of_day = |(day, constants): &&(Day, Vec<Constant>)| {
            let mine = constants.iter().filter(|it| it.name == *name);
            mine.map(|it| (*day, it.clone())).collect::<Vec<_>>()
        };
        trend(name, &days.iter().flat_map(of_day).collect::<Vec<_>>(), limit)
    };
    names.iter().map(of).collect()
}

fn trend(name: &str, found: &[(Day, Constant)], limit: Option<f64>) -> Trend {
    let first = found.first().map_or(0, |(day, _)| *day);
    let point = |(day, constant): &(Day, Constant)| Point {
        date: text_of(*day),
        days: (day - first) as f64,
        value: constant.value,
        half_width: constant.half_width,
    };
    let points: Vec<Point> = found.iter().map(point).collect();
    let last = found.last().map_or(0, |(day, _)| *day);
    let mut dates: Vec<Day> = found.iter().map(|(day, _)| *day).collect();
    dates.dedup();
    let mut it = Trend {
        name: name.into(),
        points,
        per_year: None,
        changes: false,
        matters: limit,
        measure_again_by: None,
        sentence: String::new(),
    };
    let mut line = Triangle::new(2);
    it.points.iter().for_each(|point| line.add(&[1.0, point.days / YEAR], point.value));
    let solved = if dates.len() >= FEWEST { line.solve().ok() } else { None };
    let Some(line) = solved else {
        it.sentence = format!(
            "measured on {} {}: a trend needs {FEWEST}.",
            dates.len(),
            if dates.len() == 1 { "day" } else { "days" }
        );
        return it;
    };
    let (rate, half) = (line.coefficients[1], line.half_width(1));
    it.per_year = Some([rate, half]);
    it.changes = rate.abs() > half;
    let told: Vec<f64> = it.points.iter().filter_map(|point| point.half_width).collect();
    let own = (!told.is_empty()).then(|| told.iter().sum::<f64>() / told.len() as f64);
    let matters = limit.or(own).unwrap_or(2.0 * line.variance().sqrt());
    it.matters = Some(matters);
    let fastest = rate.abs() + half;
    let years = matters / fastest;
    let said = if it.changes {
        format!("changes by {rate:+.2} ± {half:.2} a year.")
    } else {
        format!("no change that can be told ({rate:+.2} ± {half:.2} a year).")
    };
    // A century is beyond any plan, and beyond what the days can count.
    if fastest > 0.0 && years < 100.0 {
        let day = text_of(last + (years * YEAR).floor() as Day);
        it.sentence = format!(
            "{said} By {day} it may have changed by {matters:.2} since the last measurement: measure again \
             until then."
        );
        it.measure_again_by = Some(day);
    } else {
        it.sentence = said;
    }
    it
}
