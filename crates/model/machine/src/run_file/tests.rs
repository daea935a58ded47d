use super::*;

fn parse(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own text is right")
}

/// Values to compare: NaN is not equal to itself.
fn some(values: &[f64]) -> Vec<Option<f64>> {
    values.iter().map(|value| (!value.is_nan()).then_some(*value)).collect()
}

#[test]
fn columns_arrive_by_name_with_missing_values_as_nan() {
    let run = parse("time_s,temp_a_c,mystery\n0,21.5,-1e-3\n1,,nan\n2,NaN,+4.\n");
    assert_eq!(run.row_count(), 3);
    assert_eq!(run.column("time_s").expect("named above"), [0.0, 1.0, 2.0]);
    assert_eq!(some(run.column("temp_a_c").expect("named above")), [Some(21.5), None, None]);
    let mystery = some(run.column("mystery").expect("unknown columns are kept"));
    assert_eq!(mystery, [Some(-0.001), None, Some(4.0)]);
    assert!(run.column("spindle_rpm").is_none());
    let names: Vec<&str> = run.columns().iter().map(|column| column.name.as_str()).collect();
    assert_eq!(names, ["time_s", "temp_a_c", "mystery"]);
}

#[test]
fn every_accepted_form_gives_the_same_values() {
    let forms = [
        "a_um,b_um\n1,2.5\n3,\n",
        "a_um,b_um\n1,2.5\n3,",
        "a_um;b_um\n1;2.5\n3;\n",
        "a_um,b_um\r\n1,2.5\r\n3,\r\n",
        "\u{feff}a_um,b_um\n1,2.5\n3,\n",
        "\na_um,b_um\n\n1,2.5\n  \n3,\n\n",
        " a_um , b_um \n 1 , 2.5 \n3 , \n",
        "\"a_um\",\"b_um\"\n\"1\",\"2.5\"\n\"3\",\"\"\n",
        "a_um;b_um\n\"1\" ;  \"2.5\"\n3;nan\n",
    ];
    for form in forms {
        let run = parse(form);
        assert_eq!(run.column("a_um").expect("named above"), [1.0, 3.0], "{form:?}");
        let b = some(run.column("b_um").expect("named above"));
        assert_eq!(b, [Some(2.5), None], "{form:?}");
    }
}

#[test]
fn comments_are_no_rows_and_count_as_lines() {
    let run = parse("# made by a logger\n#\na_um,b_um\n1,2\n  # a pause; 3\n3,4\n# end\n");
    assert_eq!(run.column("a_um").expect("named above"), [1.0, 3.0]);
    assert_eq!(run.value_location(1, "b_um").line, 6);
}

#[test]
fn times_of_day_are_seconds_from_the_first() {
    let rows = |times: [&str; 4]| times.map(|time| format!("{time},1\n")).concat();
    for times in [
        ["2026-11-22T23:59:59Z", "2026-11-23T00:00:00.5Z", "", "2026-11-23T01:00:01+01:00"],
        ["2026-11-22 23:59:59", "2026-11-23 00:00:00.5", "nan", "2026-11-23 00:00:01"],
    ] {
        for name in ["time_s", "time", "Timestamp"] {
            let run = parse(&format!("{name},x_mm\n{}", rows(times)));
            let time_s = some(run.column("time_s").expect("it is the time"));
            assert_eq!(time_s[..1], [Some(0.0)], "{name} {times:?}");
            assert!((time_s[1].expect("a time") - 1.5).abs() < 1e-9, "{times:?}");
            assert_eq!(time_s[2..], [None, Some(2.0)], "{times:?}");
            assert_eq!((run.columns().len(), run.column_typos().count()), (2, 0));
        }
    }
    let epoch_s = |text: &str| parse(text).time_origin_unix_s();
    assert_eq!(epoch_s("x_mm,time\n1,\n2,2026-11-23T01:00:01+01:00\n"), Some(1_795_392_001.0));
    assert_eq!(epoch_s("time_s\n2026-11-23 00:00:01\n"), Some(1_795_392_001.0));
    assert_eq!(epoch_s("time\n1795392001\n"), None, "these are counted from 1970");
    assert_eq!(epoch_s("time_s,gauge_time_s\n5,2026-11-23T00:00:01Z\n"), None);
    // A second clock counts from the same instant; next to seconds a time of day says nothing new.
    let run = parse("time,gauge_time_s\n2026-11-22T08:00:00Z,2026-11-22T08:00:03Z\n");
    assert_eq!(run.column("gauge_time_s").expect("kept"), [3.0]);
    let run = parse("time_s,time\n5,2026-11-22T08:00:00Z\n");
    assert_eq!(run.columns().len(), 1);
}

#[test]
fn a_column_that_looks_like_a_known_one_is_reported() {
    let run = parse("time_s,X (mm),measured_dz_mm,flow\n0,1,2,3\n");
    let warnings: Vec<String> = run.column_typos().map(|typo| typo.to_string()).collect();
    assert_eq!(
        warnings,
        [
            "r.csv:1:8: X (mm) is no column that is known; did you mean x_mm?",
            "r.csv:1:15: measured_dz_mm is no column that is known; did you mean measured_dz_um?"
        ]
    );
    let bad = run.require_column("measured_dz_um").expect_err("it is missing").to_string();
    assert!(
        bad.starts_with("r.csv:1:15: column measured_dz_um is missing; measured_dz_mm"),
        "{bad}"
    );
    // Where the known one is there as well, it is something else.
    assert_eq!(parse("x_mm,x_um\n1,1000\n").column_typos().count(), 0);
}

#[test]
fn a_name_may_contain_the_separator_and_quotes_if_it_is_quoted() {
    let run = parse("\"load; \"\"z\"\", n\";x_mm\n1;2\n");
    assert_eq!(run.column("load; \"z\", n").expect("named above"), [1.0]);
}

#[test]
fn time_may_start_again_with_the_next_run() {
    let run = parse("run,time_s\n1,0\n1,5\n2,0\n2,\n2,0\n,0\n");
    assert_eq!(run.row_count(), 6);
}

#[test]
fn a_value_is_placed_by_line_and_character_for_rules_found_broken_later() {
    let run = parse("\u{feff}\"µ\";sensor_counts\r\n\r\n1.5;  40000\r\n\"2\"; \"7\"\r\n;\r\n");
    let at = |row, column| {
        let place = run.value_location(row, column);
        (place.line, place.column)
    };
    assert_eq!(at(0, "sensor_counts"), (3, 7));
    assert_eq!(at(0, "µ"), (3, 1));
    assert_eq!(at(1, "sensor_counts"), (4, 6));
    assert_eq!(at(2, "sensor_counts"), (5, 2));
    assert_eq!(at(1, "no such column"), (4, 1));
    assert_eq!(at(99, "µ"), (1, 1));
    let bad = run.value_error(0, "sensor_counts", "40000 is outside 0…32768");
    assert_eq!(bad.to_string(), "r.csv:3:7: sensor_counts 40000 is outside 0…32768");
}

#[test]
fn a_missing_column_is_reported_with_those_that_are_there() {
    let error =
        parse("time_s,sensor_conuts\n0,1\n").require_column("sensor_counts").expect_err("typo");
    assert_eq!(
        error.to_string(),
        "r.csv:1:8: column sensor_counts is missing; sensor_conuts is no column that is known: if it was \
         meant, give it as sensor_counts"
    );
}

#[test]
fn a_run_of_200_000_rows_is_read_whole() {
    let mut text = String::from("time_s,sensor_counts\n");
    for row in 0..200_000 {
        text.push_str(&format!("{row},{}\n", row % 32768));
    }
    let run = parse(&text);
    assert_eq!(run.row_count(), 200_000);
    assert_eq!(run.value_location(199_999, "sensor_counts").line, 200_001);
}

/// Returns the message about `text` where a file may have 40 bytes and 4 values.
fn out_of_bounds(text: &str) -> String {
    let bounds = RunFileSizeLimits { bytes: 40, values: 4 };
    let read = RunFile::read_within_limits(bounds, text.as_bytes(), Path::new("r.csv"));
    read.map(|_| ()).expect_err("out of bounds").to_string()
}

#[test]
fn a_file_that_goes_on_beyond_its_bounds_is_refused_there() {
    let most = "a,b\n1,2\n3,4\n";
    assert_eq!(
        out_of_bounds(&format!("{most}5,6\n")),
        "r.csv:4:1: more than 4 values (2 columns): leave out rows or columns"
    );
    // Of a pipe nobody knows how long it will be.
    let blank = format!("{most}{}\n", " ".repeat(30));
    assert!(out_of_bounds(&blank).starts_with("r.csv:4:1: the file goes on here, more than"));
    let bounds = RunFileSizeLimits { bytes: 40, values: 4 };
    let run = RunFile::read_within_limits(bounds, most.as_bytes(), Path::new("r.csv"));
    assert_eq!(run.expect("just within").row_count(), 2);
}

#[test]
fn unix_seconds_of_a_logger_are_the_time_and_other_numbers_are_not() {
    let run = parse("timestamp,x_mm\n1774000000,1\n1774000300,2\n");
    assert_eq!(run.column("time_s").expect("it is the time"), [1_774_000_000.0, 1_774_000_300.0]);
    assert_eq!(run.column_typos().count(), 0);
    // Milliseconds, and hours of operation: nothing says that these are seconds.
    for text in ["timestamp,x_mm\n1774000000000,1\n", "timestamp,x_mm\n12,1\n"] {
        let run = parse(text);
        assert!(run.column("time_s").is_none() && run.column_typos().count() == 1, "{text}");
    }
}

#[test]
fn a_line_that_states_the_separator_is_no_header() {
    for text in [
        "sep=;\na_um;b_um\n1;2\n",
        "\u{feff}sep=,\r\na_um,b_um\r\n1,2\r\n",
        "\"sep=;\"\na_um;b_um\n1;2\n",
    ] {
        let run = parse(text);
        assert_eq!(run.column("b_um").expect("the second column"), [2.0], "{text}");
        assert_eq!(run.value_location(0, "a_um").line, 3);
    }
}

#[test]
fn diameters_are_read_as_radii_and_never_together_with_radii() {
    let run = parse("time_s,x_dia_mm\n0,80\n1,50.5\n");
    assert_eq!(run.column("x_mm"), Some(&[40.0, 25.25][..]));
    assert!(run.column("x_dia_mm").is_none());
    assert_eq!(run.column_typos().count(), 0);
    for header in ["x_mm,x_dia_mm", "x_dia_mm,x_mm", "x_dia_mm,x_dia_mm"] {
        let text = format!("{header}\n1,2\n");
        let error = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect_err(header);
        assert!(error.rule.contains("the same axis"), "{error}");
    }
}

#[test]
fn an_hour_back_names_the_command_that_takes_it_out() {
    let error =
        RunFile::from_reader(&b"time_s,x_mm\n0,1\n3600,1\n60,1\n"[..], Path::new("a b.csv"))
            .expect_err("back");
    let help = error.help.expect("there is one");
    assert!(help.ends_with("trueup import 'a b.csv' --summer-time yes -o 'a b.run.csv'"), "{help}");
}
