//! Times of day, dates, Unix time, stopwatches; midnight and summer time.

use crate::{QuestionTopic, bad, open, read, unit, values};

fn seconds(cells: &[&str], given: &[(QuestionTopic, &str)]) -> Vec<f64> {
    values(&read(table(cells), given), "time_s")
}

fn table(cells: &[&str]) -> String {
    let rows: String =
        cells.iter().enumerate().map(|(at, cell)| format!("{cell};{at}\n")).collect();
    format!("Zeit;flow\n{rows}")
}

#[test]
fn times_of_day_dates_and_unix_time_are_seconds_from_the_first() {
    for (cells, expected) in [
        (["08:15", "08:16", "09:15"], [0.0, 60.0, 3600.0]),
        (["08:15:00", "08:15:01,5", "08:15:03"], [0.0, 1.5, 3.0]),
        (["23:59:30", "00:00:30", "00:01:30"], [0.0, 60.0, 120.0]),
        (["11:59 AM", "12:00 PM", "12:01 PM"], [0.0, 60.0, 120.0]),
        (
            ["2026-04-03T08:15:00Z", "2026-04-03T10:16:00+02:00", "2026-04-03T08:17:00Z"],
            [0.0, 60.0, 120.0],
        ),
        (["14.04.2026 08:15", "14.04.2026 08:16", "15.04.2026 08:15"], [0.0, 60.0, 86_400.0]),
        (["3 Apr 2026 08:15", "3 Apr 2026 08:16", "4 Apr 2026 08:15"], [0.0, 60.0, 86_400.0]),
        (["1774000000", "1774000060", "1774000120"], [0.0, 60.0, 120.0]),
        (["1774000000000", "1774000060000", "1774000120500"], [0.0, 60.0, 120.5]),
    ] {
        assert_eq!(seconds(&cells, &[]), expected, "{cells:?}");
    }
    // A column of dates belongs to the times of day next to it.
    let text = "Datum;Uhrzeit;flow\n14.04.2026;23:59;1\n15.04.2026;00:01;2\n";
    assert_eq!(values(&read(text, &[]), "time_s"), [0.0, 120.0]);
}

#[test]
fn a_stopwatch_is_distinguished_from_a_clock_or_asked() {
    assert_eq!(seconds(&["00:30", "59:30", "61:00"], &[]), [0.0, 3540.0, 3630.0]);
    assert_eq!(open(table(&["00:30", "01:00", "01:30"]), &[]), [unit("Zeit")]);
    let cells = ["00:30", "01:00", "01:30"];
    assert_eq!(seconds(&cells, &[(unit("Zeit"), "mm:ss")]), [0.0, 30.0, 60.0]);
    assert_eq!(seconds(&cells, &[(unit("Zeit"), "h:mm")]), [0.0, 1800.0, 3600.0]);
    let text = table(&cells).replace("Zeit", "Zeit [mm:ss]");
    assert_eq!(values(&read(text, &[]), "time_s"), [0.0, 30.0, 60.0]);
}

#[test]
fn a_clock_that_steps_an_hour_is_asked_about_and_one_that_runs_back_is_refused() {
    let back = ["25.10.2026 02:50", "25.10.2026 02:55", "25.10.2026 02:00", "25.10.2026 02:05"];
    assert_eq!(open(table(&back), &[]), [QuestionTopic::SummerTime]);
    assert_eq!(seconds(&back, &[(QuestionTopic::SummerTime, "yes")]), [0.0, 300.0, 600.0, 900.0]);
    assert!(
        bad(table(&back), &[(QuestionTopic::SummerTime, "no")]).contains("4:1: the time runs back")
    );
    let ahead = ["29.03.2026 01:50", "29.03.2026 01:55", "29.03.2026 03:00", "29.03.2026 03:05"];
    assert_eq!(open(table(&ahead), &[]), [QuestionTopic::SummerTime]);
    assert_eq!(seconds(&ahead, &[(QuestionTopic::SummerTime, "yes")]), [0.0, 300.0, 600.0, 900.0]);
    assert_eq!(seconds(&ahead, &[(QuestionTopic::SummerTime, "no")]), [0.0, 300.0, 4200.0, 4500.0]);
    assert!(
        bad(table(&["08:15:10", "08:15:20", "08:15:15"]), &[]).contains("4:1: the time runs back")
    );
    // A gap is reported.
    let imported = read(table(&["08:15:00", "08:15:10", "08:15:20", "10:00:00"]), &[]);
    assert!(
        imported.notes[0].contains("1.7 h without a reading before line 5"),
        "{:?}",
        imported.notes
    );
}

#[test]
fn what_is_no_time_is_named() {
    assert!(bad(table(&["08:15", "08:16", "later"]), &[]).contains("4:1: \"later\" is no time"));
    assert!(
        bad(table(&["2026-04-03T08:15:00Z", "2026-04-03T08:16:00"]), &[]).contains("no time zone")
    );
}

#[test]
fn summer_time_is_taken_out_of_plain_seconds_where_the_user_says_so() {
    let text = "time_s,flow\n0,1\n60,2\n120,3\n-3420,4\n-3360,5\n";
    let run = read(text, &[(QuestionTopic::SummerTime, "yes")]);
    assert_eq!(values(&run, "time_s"), [0.0, 60.0, 120.0, 180.0, 240.0]);
}
