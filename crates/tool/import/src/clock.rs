//! The time column: dates, times of day, Unix time, and what a clock on a wall does at night.

use std::path::Path;

use trueup_machine::InputFileError;

use crate::{
    answers::{ImportError, Question, QuestionTopic},
    cell_grid::{Cell, CellContent, CellRow},
    timestamp::{self, DateOrder, Timestamp, TwoPartTimeFormat},
    unit::round_to_significant_digits,
};

/// How the cells of the time column are read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TimeFormat {
    pub(crate) order: DateOrder,
    pub(crate) pair: TwoPartTimeFormat,
}

/// Returns the moment that a cell says.
pub(crate) fn parse_timestamp(cell: &Cell, reading: TimeFormat) -> Option<Timestamp> {
    match &cell.content {
        CellContent::Text(text) => timestamp::parse(text, reading.order, reading.pair),
        CellContent::Number(days) | CellContent::Date(days) => {
            Some(timestamp::from_serial_date(*days))
        }
    }
}

/// Returns the seconds of one count of Unix time if `values` can only be that: of the years 2001 to 2096.
pub(crate) fn detect_unix_time_scale(values: &[f64]) -> Option<(f64, &'static str)> {
    [(1.0, "s"), (1e-3, "ms"), (1e-6, "µs")].into_iter().find(|(factor, _)| {
        !values.is_empty() && values.iter().all(|value| (1e9..4e9).contains(&(value * factor)))
    })
}

/// Returns the order of the numbers of the dates in `cells`.
///
/// # Errors
/// Two orders make different times: a question.
pub(crate) fn detect_date_order(
    rows: &[CellRow],
    columns: &[usize],
    stated: Option<DateOrder>,
    path: &Path,
) -> Result<Option<DateOrder>, ImportError> {
    use DateOrder::{DayMonth, MonthDay, Year};
    let first = rows.iter().find_map(|row| {
        let open = |at: &&usize| {
            matches!(&row.cells[**at].content, CellContent::Text(text) if timestamp::has_ambiguous_order(text) && timestamp::is_timestamp(text))
        };
        columns.iter().find(open).map(|at| (row, *at))
    });
    let Some((row, at)) = first else { return Ok(None) };
    if stated.is_some() {
        return Ok(stated);
    }
    let days = |order| -> Option<Vec<i64>> {
        let reading = TimeFormat { order, pair: TwoPartTimeFormat::HoursMinutes };
        let cells = rows.iter().map(|row| &row.cells[at]).filter(|cell| !cell.is_empty());
        cells.map(|cell| parse_timestamp(cell, reading).and_then(|stamp| stamp.day)).collect()
    };
    let from_first =
        |days: Vec<i64>| -> Vec<i64> { days.iter().map(|day| day - days[0]).collect() };
    let readings: Vec<(DateOrder, Vec<i64>)> = [DayMonth, MonthDay, Year]
        .into_iter()
        .filter_map(|order| Some((order, days(order).filter(|days| !days.is_empty())?)))
        .map(|(order, days)| (order, from_first(days)))
        .collect();
    let rising: Vec<&(DateOrder, Vec<i64>)> = readings
        .iter()
        .filter(|(_, days)| days.windows(2).all(|pair| pair[0] <= pair[1]))
        .collect();
    let left: Vec<&(DateOrder, Vec<i64>)> =
        if rising.is_empty() { readings.iter().collect() } else { rising };
    match &left[..] {
        [] => Err(InputFileError::new(
            row.location(path, at),
            format!("{} is no date of the calendar", row.cells[at].text()),
        )
        .with_help("write 2026-04-03, or state the order: --date dmy")
        .into()),
        [(order, first), others @ ..] if others.iter().all(|(_, days)| days == first) => {
            Ok(Some(*order))
        }
        [..] => Err(ImportError::Open(vec![Question {
            place: row.location(path, at),
            text: format!("{} reads as more than one date", row.cells[at].text()),
            topic: QuestionTopic::Date,
            choices: left.iter().map(|(order, _)| order.name().into()).collect(),
            is_open: false,
        }])),
    }
}

/// Returns how times of two numbers are read: `08:15`.
///
/// # Errors
/// They may be of a stopwatch: a question.
pub(crate) fn detect_two_part_format(
    rows: &[CellRow],
    at: usize,
    header: &str,
    form: &str,
    path: &Path,
) -> Result<TwoPartTimeFormat, ImportError> {
    const TIME_OF_DAY_KEYWORDS: [&str; 7] =
        ["uhr", "clock", "day", "heure", "hora", "ora", "tageszeit"];
    if !form.is_empty() {
        let is_minutes = form.to_lowercase().starts_with('m');
        return Ok(if is_minutes {
            TwoPartTimeFormat::MinutesSeconds
        } else {
            TwoPartTimeFormat::HoursMinutes
        });
    }
    let texts: Vec<&str> = rows
        .iter()
        .filter_map(|row| match &row.cells[at].content {
            CellContent::Text(text) if !text.trim().is_empty() => Some(text.trim()),
            _ => None,
        })
        .collect();
    let Some(first) = texts.iter().find(|text| timestamp::is_two_part_time(text)) else {
        return Ok(TwoPartTimeFormat::HoursMinutes);
    };
    let parts = |text: &str| -> Option<(u32, u32)> {
        let (first, second) = text.split_once(':')?;
        Some((first.parse().ok()?, second.parse().ok()?))
    };
    let Some(start) = parts(first) else { return Ok(TwoPartTimeFormat::HoursMinutes) };
    let numbers: Vec<(u32, u32)> = texts.iter().filter_map(|text| parts(text)).collect();
    if numbers.iter().any(|(first, _)| *first >= 24) {
        return Ok(TwoPartTimeFormat::MinutesSeconds);
    }
    if TIME_OF_DAY_KEYWORDS.iter().any(|word| header.to_lowercase().contains(word)) {
        return Ok(TwoPartTimeFormat::HoursMinutes);
    }
    // A working day does not begin in the night, and a stopwatch begins near 0.
    const EARLIEST_WORK_HOUR: u32 = 5;
    let is_whole = numbers.iter().all(|(_, second)| *second == 0);
    if start.0 >= EARLIEST_WORK_HOUR && !is_whole {
        return Ok(TwoPartTimeFormat::HoursMinutes);
    }
    let row = rows.iter().find(|row| row.cells[at].text() == *first);
    Err(ImportError::Open(vec![Question {
        place: row.unwrap_or(&rows[0]).location(path, at),
        text: format!("{first} reads as hours and minutes, or as minutes and seconds"),
        topic: QuestionTopic::Unit(header.into()),
        choices: vec!["h:mm".into(), "mm:ss".into()],
        is_open: false,
    }]))
}

/// Seconds of the rows, and notes on how the clock was read.
pub(crate) struct ElapsedSeconds {
    pub(crate) values: Vec<f64>,
    pub(crate) notes: Vec<String>,
}

/// An hour, and what a clock may be off by when it changes.
const SECONDS_PER_HOUR: f64 = 3600.0;

/// Returns the seconds from the first moment, for each row; midnight passed by clocks without a date.
///
/// # Errors
/// The clock steps by an hour, which may be summer time: a question. It runs back: an error.
pub(crate) fn compute_elapsed_seconds(
    stamps: &[Option<Timestamp>],
    rows: &[CellRow],
    at: usize,
    runs: Option<&[f64]>,
    summer_time: Option<bool>,
    path: &Path,
) -> Result<ElapsedSeconds, ImportError> {
    let has_date = stamps.iter().flatten().any(|stamp| stamp.day.is_some());
    let has_zone = stamps.iter().flatten().any(|stamp| stamp.has_zone);
    let zones = stamps.iter().flatten().filter(|stamp| stamp.has_zone).count();
    if has_zone && zones != stamps.iter().flatten().count() {
        let row =
            stamps.iter().position(|stamp| stamp.is_some_and(|stamp| !stamp.has_zone)).unwrap_or(0);
        let rule = "has no time zone, other times of the file have one";
        return Err(InputFileError::new(rows[row].location(path, at), rule)
            .with_help("give all of them a zone, or none")
            .into());
    }
    let start_s = stamps.iter().flatten().next().map_or(0.0, Timestamp::seconds_since_epoch);
    let raw: Vec<f64> = stamps
        .iter()
        .map(|stamp| stamp.map_or(f64::NAN, |stamp| stamp.seconds_since_epoch() - start_s))
        .collect();
    let is_wall_clock = has_date || stamps.iter().flatten().any(|stamp| stamp.seconds.is_some());
    accumulate_elapsed_seconds(
        &raw,
        rows,
        at,
        runs,
        AllowedClockJumps { has_midnight: !has_date, has_hours: is_wall_clock && !has_zone },
        summer_time,
        path,
    )
}

/// The jumps that a clock may make and time does not.
#[derive(Clone, Copy)]
pub(crate) struct AllowedClockJumps {
    /// It begins again at midnight.
    pub(crate) has_midnight: bool,
    /// It may change to and from summer time.
    pub(crate) has_hours: bool,
}

/// Follows a clock row by row.
pub(crate) fn accumulate_elapsed_seconds(
    raw: &[f64],
    rows: &[CellRow],
    at: usize,
    runs: Option<&[f64]>,
    wall: AllowedClockJumps,
    summer_time: Option<bool>,
    path: &Path,
) -> Result<ElapsedSeconds, ImportError> {
    let mut steps: Vec<f64> = Vec::new();
    let there: Vec<usize> = (0..raw.len()).filter(|row| !raw[*row].is_nan()).collect();
    steps.extend(
        there.windows(2).map(|pair| raw[pair[1]] - raw[pair[0]]).filter(|step| *step > 0.0),
    );
    steps.sort_by(f64::total_cmp);
    let usual_s = steps.get(steps.len() / 2).copied().unwrap_or(f64::INFINITY);
    let mut values = vec![f64::NAN; raw.len()];
    let mut notes = Vec::new();
    let mut added_s = 0.0;
    let mut before: Option<usize> = None;
    for row in there {
        if let Some(last) = before {
            let step_s = raw[row] - raw[last];
            let is_new_run = runs.is_some_and(|runs| runs[row] != runs[last]);
            let rest_s = |hours: f64| step_s - hours * SECONDS_PER_HOUR;
            let fits = |rest_s: f64| rest_s >= 0.0 && rest_s <= 2.0 * usual_s;
            let is_regular = wall.has_hours && usual_s < SECONDS_PER_HOUR / 2.0 && !is_new_run;
            let back = is_regular && step_s < 0.0 && fits(rest_s(-1.0));
            let ahead = is_regular && step_s > 0.0 && fits(rest_s(1.0)) && rest_s(1.0) > 0.0;
            if wall.has_midnight && step_s < -12.0 * SECONDS_PER_HOUR && !is_new_run {
                added_s += 24.0 * SECONDS_PER_HOUR;
            } else if back || ahead {
                match summer_time {
                    Some(true) => {
                        added_s += if back { SECONDS_PER_HOUR } else { -SECONDS_PER_HOUR }
                    }
                    Some(false) if ahead => {}
                    Some(false) | None => {
                        let rule = if back {
                            "goes back by an hour"
                        } else {
                            "is an hour ahead of its step"
                        };
                        if summer_time.is_some() {
                            return Err(backward_clock_error(rows, row, at, path).into());
                        }
                        return Err(ImportError::Open(vec![Question {
                            place: rows[row].location(path, at),
                            text: format!("the clock {rule} here: the change of summer time?"),
                            topic: QuestionTopic::SummerTime,
                            choices: vec!["yes".into(), "no".into()],
                            is_open: false,
                        }]));
                    }
                }
            } else if step_s < 0.0 && !is_new_run {
                return Err(backward_clock_error(rows, row, at, path).into());
            } else if step_s > 20.0 * usual_s && step_s > 60.0 {
                notes.push(format!(
                    "{} without a reading before line {}",
                    format_duration(step_s),
                    rows[row].line
                ));
            }
        }
        values[row] = round_to_significant_digits(raw[row] + added_s);
        before = Some(row);
    }
    if notes.len() > 3 {
        notes = vec![format!("{} gaps in the clock, the first one: {}", notes.len(), notes[0])];
    }
    Ok(ElapsedSeconds { values, notes })
}

fn backward_clock_error(rows: &[CellRow], row: usize, at: usize, path: &Path) -> InputFileError {
    InputFileError::new(
        rows[row].location(path, at),
        format!("the time runs back to {}", rows[row].cells[at].text()),
    )
    .with_help("sort the rows by time, or number the repeats in a column run")
}

fn format_duration(seconds: f64) -> String {
    if seconds < SECONDS_PER_HOUR {
        format!("{:.0} min", seconds / 60.0)
    } else {
        format!("{:.1} h", seconds / SECONDS_PER_HOUR)
    }
}
