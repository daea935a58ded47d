//! A constant over the days it was measured: wear of a backlash, drift of a pitch (paper 4).
//!
//! ```text
//! value = a + b·t,   b with its 95 % interval by Student's t from what the line leaves
//! value = a | a + d  two levels, where BIC has strong evidence (6, Kass and Raftery 1995) for them instead of the line
//! ```
//!
//! "Measure again" is the day on which the constant may have changed by this much that it matters, at the
//! fastest rate that the record allows (|b| and its half interval). The change that matters is the user's limit, else
//! the resolution of a single measurement: half its own interval, or twice what the line leaves.

use serde::Serialize;
use trueup_numerics::{least_squares::GivensQr, t_quantile};

use crate::dated_constants::{ConstantEstimate, EpochDay, format_day};

/// Days of a year.
const DAYS_PER_YEAR: f64 = 365.25;
/// A line needs as many days for an interval.
const MIN_TREND_DAYS: usize = 3;

/// One measurement of a constant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrendPoint {
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
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ConstantTrend {
    /// Its key in the machine file.
    pub name: String,
    /// In the order of the days.
    pub points: Vec<TrendPoint>,
    /// Change in a year and half its 95 % interval; `None` below three days.
    pub per_year: Option<[f64; 2]>,
    /// Whether the change is beyond chance.
    pub changes: bool,
    /// A change that matters, in the unit of the name.
    pub matters: Option<f64>,
    /// The day by which to measure again.
    pub measure_again_by: Option<String>,
    /// Whether that day has passed.
    pub overdue: bool,
    /// A step between two days, where it explains the values better than a line.
    pub step: Option<StepChange>,
    /// The trend in words.
    pub sentence: String,
}

/// Two levels with a step between.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepChange {
    /// The last day before it and the first one after it.
    pub between: [String; 2],
    /// Its size, and half its 95 % interval.
    pub size: f64,
    /// Half the interval.
    pub half_width: f64,
}

/// A difference of BIC from which evidence is strong.
const STRONG_EVIDENCE_BIC_DIFFERENCE: f64 = 6.0;

/// Returns the best two levels, and by how much their BIC is below that of the line, which leaves `squares`.
fn fit_step_change(
    points: &[TrendPoint],
    squares: f64,
    own: Option<f64>,
) -> Option<(StepChange, f64)> {
    let count = points.len() as f64;
    // No value is known better than a tenth of what one measurement says of itself.
    let least = own.map_or(f64::MIN_POSITIVE, |half| count * (half / 19.6).powi(2));
    let bic = |squares: f64, constants: f64| {
        count * (squares.max(least) / count).ln() + constants * count.ln()
    };
    let mean =
        |all: &[TrendPoint]| all.iter().map(|point| point.value).sum::<f64>() / all.len() as f64;
    let left =
        |all: &[TrendPoint]| all.iter().map(|point| (point.value - mean(all)).powi(2)).sum::<f64>();
    // A level of one day may be a bad measurement.
    let cuts =
        (2..points.len().saturating_sub(1)).filter(|cut| points[*cut].days > points[*cut - 1].days);
    let best = cuts.map(|cut| (cut, left(&points[..cut]) + left(&points[cut..])));
    let (cut, two) = best.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let (before, after) = points.split_at(cut);
    let freedom = count - 2.0;
    let scatter = (two.max(least) / freedom).sqrt();
    let shares = (1.0 / before.len() as f64 + 1.0 / after.len() as f64).sqrt();
    let step = StepChange {
        between: [before[cut - 1].date.clone(), after[0].date.clone()],
        size: mean(after) - mean(before),
        half_width: t_quantile(0.975, freedom) * scatter * shares,
    };
    // The day of the step is a constant too.
    Some((step, bic(squares, 2.0) - bic(two, 3.0)))
}

/// Returns the trends of these days' constants; `limit`: a change that matters; `today` says whether a measurement is
/// overdue.
#[must_use]
pub fn fit_trends(
    days: &[(EpochDay, Vec<ConstantEstimate>)],
    limit: Option<f64>,
    today: Option<EpochDay>,
) -> Vec<ConstantTrend> {
    let mut days: Vec<&(EpochDay, Vec<ConstantEstimate>)> = days.iter().collect();
    days.sort_by_key(|(day, _)| *day);
    let mut names: Vec<&str> = Vec::new();
    for constant in days.iter().flat_map(|(_, constants)| constants) {
        if !names.contains(&constant.name.as_str()) {
            names.push(&constant.name);
        }
    }
    let of = |name: &&str| {
        let of_day = |(day, constants): &&(EpochDay, Vec<ConstantEstimate>)| {
            let mine = constants.iter().filter(|constant| constant.name == *name);
            mine.map(|constant| (*day, constant.clone())).collect::<Vec<_>>()
        };
        fit_trend(name, &days.iter().flat_map(of_day).collect::<Vec<_>>(), limit, today)
    };
    names.iter().map(of).collect()
}

fn fit_trend(
    name: &str,
    found: &[(EpochDay, ConstantEstimate)],
    limit: Option<f64>,
    today: Option<EpochDay>,
) -> ConstantTrend {
    let first = found.first().map_or(0, |(day, _)| *day);
    let point = |(day, constant): &(EpochDay, ConstantEstimate)| TrendPoint {
        date: format_day(*day),
        days: (day - first) as f64,
        value: constant.value,
        half_width: constant.half_width,
    };
    let points: Vec<TrendPoint> = found.iter().map(point).collect();
    let last = found.last().map_or(0, |(day, _)| *day);
    let mut dates: Vec<EpochDay> = found.iter().map(|(day, _)| *day).collect();
    dates.dedup();
    let mut it =
        ConstantTrend { name: name.into(), points, matters: limit, ..ConstantTrend::default() };
    let mut line = GivensQr::new(2);
    it.points
        .iter()
        .for_each(|point| line.add_row(&[1.0, point.days / DAYS_PER_YEAR], point.value));
    let solved = if dates.len() >= MIN_TREND_DAYS { line.solve().ok() } else { None };
    let Some(line) = solved else {
        it.sentence = format!(
            "measured on {} {}: a trend needs {MIN_TREND_DAYS}.",
            dates.len(),
            if dates.len() == 1 { "day" } else { "days" }
        );
        return it;
    };
    let (rate, half) = (line.coefficients[1], line.confidence_half_width(1));
    it.per_year = Some([rate, half]);
    it.changes = rate.abs() > half;
    let half_widths: Vec<f64> = it.points.iter().filter_map(|point| point.half_width).collect();
    let own = (!half_widths.is_empty())
        .then(|| half_widths.iter().sum::<f64>() / half_widths.len() as f64);
    let squares = line.residual_variance() * line.degrees_of_freedom() as f64;
    if let Some((step, evidence)) = fit_step_change(&it.points, squares, own)
        && evidence >= STRONG_EVIDENCE_BIC_DIFFERENCE
    {
        let [from, to] = &step.between;
        it.sentence = format!(
            "has changed by {:+.2} ± {:.2} in a step between {from} and {to}, and not by an \
             amount a year. Look for what happened then, and measure again after it is repaired.",
            step.size, step.half_width
        );
        (it.changes, it.per_year, it.step) = (true, None, Some(step));
        return it;
    }
    let matters = limit.or(own).unwrap_or(2.0 * line.residual_variance().sqrt());
    it.matters = Some(matters);
    let fastest = rate.abs() + half;
    let years = matters / fastest;
    let text = if it.changes {
        format!("changes by {rate:+.2} ± {half:.2} a year.")
    } else {
        format!("no detectable change ({rate:+.2} ± {half:.2} a year).")
    };
    // A century is beyond any plan, and beyond what the days can count.
    if fastest > 0.0 && years < 100.0 {
        let by = last + (years * DAYS_PER_YEAR).floor() as EpochDay;
        let day = format_day(by);
        it.overdue = today.is_some_and(|today| by < today);
        if it.overdue {
            it.sentence = format!(
                "{text} It may have changed by {matters:.2} since the last measurement: the next one is overdue since {day}."
            );
            it.measure_again_by = Some(day);
            return it;
        }
        it.sentence = format!(
            "{text} By {day} it may have changed by {matters:.2} since the last measurement: measure again \
             until then."
        );
        it.measure_again_by = Some(day);
    } else {
        it.sentence = text;
    }
    it
}
