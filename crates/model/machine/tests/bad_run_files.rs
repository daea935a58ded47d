//! Run files that must be refused, each with its place and the rule it breaks.

use std::{
    io::{self, BufReader, Read},
    path::Path,
};

use trueup_machine::{
    InputFileError, RunFile, location::MAX_LISTED_ERRORS, run_file::MAX_RUN_FILE_COLUMNS,
};

fn error_of(bytes: &[u8]) -> InputFileError {
    match RunFile::from_reader(bytes, Path::new("bad.csv")) {
        Ok(_) => panic!("{:?} was accepted", String::from_utf8_lossy(bytes)),
        Err(error) => error,
    }
}

/// Source text, the place `line:column`, and a phrase of the rule.
const BAD: &[(&str, &str, &str)] = &[
    // Nothing to read.
    ("", "1:1", "is empty"),
    ("\u{feff}", "1:1", "is empty"),
    ("\n\n  \n", "1:1", "is empty"),
    ("time_s,x_mm\n", "1:1", "no row of values"),
    ("\ntime_s,x_mm\r\n\r\n", "2:1", "no row of values"),
    // The header.
    ("1,2\n3,4\n", "1:1", "must name the columns, but 1 is a number"),
    ("nan,x_mm\n3,4\n", "1:1", "must name the columns"),
    ("time_s,,x_mm\n1,2,3\n", "1:8", "column 2 has no name"),
    ("time_s,x_mm,\n1,2,\n", "1:13", "column 3 has no name"),
    ("time_s;x_mm;time_s\n1;2;3\n", "1:13", "column time_s is repeated: it is also column 1"),
    ("x_mm,\" x_mm\"\n1,2\n", "1:6", "column x_mm is repeated"),
    ("time_s\tx_mm\n1\t2\n", "1:1", "not by tabs"),
    ("time_s,\"x_mm\n1,2\n", "1:8", "must end on its own line"),
    // Fields that are no numbers.
    ("time_s,x_mm\n0,1\n1,abc\n", "3:3", "x_mm \"abc\" is not a number"),
    ("time_s,x_mm\n0,1\n1,1 2\n", "3:3", "x_mm \"1 2\" is not a number"),
    ("time_s,x_mm\n0,0x10\n", "2:3", "x_mm \"0x10\" is not a number"),
    ("time_s,x_mm\n0,1 µm\n", "2:3", "\"1 µm\" is not a number"),
    ("a,b\n!note,1\n", "2:1", "a \"!note\" is not a number"),
    ("a\n12345678901234567890x12345678901234567890x1\n", "2:1", "x1234567890123456789…\""),
    ("operator,x_mm\nLi,1\n", "2:1", "operator \"Li\" is not a number"),
    // Comments count as lines.
    ("# a logger\n\na,b\n#note,1\n1,x\n", "5:3", "b \"x\" is not a number"),
    ("# a logger\n", "1:1", "is empty"),
    ("a,b\n#1,2\n", "1:1", "no row of values"),
    ("#a,b\n1,2\n", "2:1", "must name the columns, but 1 is a number"),
    // Times of day.
    ("time,a\n2026-11-22T08:00:00Z,1\n7,2\n", "3:1", "time 7 is a number, the first value a time"),
    (
        "time_s,a\n7,1\n2026-11-22T08:00:00Z,2\n",
        "3:1",
        "is a time of day, the first value a number",
    ),
    (
        "time,a\n2026-13-22T08:00:00Z,1\n",
        "2:1",
        "time 2026-13-22T08:00:00Z is no time that is known",
    ),
    ("time,a\n2026-11-22T08:00:00Z,1\n2026-11-22T08:00:01,1\n", "3:1", "has no time zone"),
    (
        "time,a\n2026-11-22T08:00:01Z,1\n2026-11-22T08:00:00Z,1\n",
        "3:1",
        "time runs back from 0 to -1",
    ),
    ("time,a\n5 o'clock,1\n", "2:1", "time \"5 o'clock\" is not a number"),
    ("day,a\n2026-11-22,1\n", "2:1", "is not a number: a time of day stands in a column time"),
    // Decimal commas.
    ("time_s;x_mm\n0;1,5\n", "2:3", "x_mm 1,5 has a decimal comma"),
    ("time_s;x_mm\n0;-1.234,5e3\n", "2:3", "x_mm -1.234,5e3 has a decimal comma"),
    ("time_s,x_mm\n0,\"1,5\"\n", "2:3", "x_mm 1,5 has a decimal comma"),
    ("time_s,x_mm\n0,1,5\n", "2:5", "3 fields, the header 2 (decimals are written with a point)"),
    ("x_mm\n1,5\n", "2:3", "2 fields, the header 1 (decimals are written with a point)"),
    // Infinite values.
    ("time_s,x_mm\n0,inf\n", "2:3", "x_mm inf is infinite"),
    ("time_s,x_mm\n0,-Infinity\n", "2:3", "x_mm -Infinity is infinite"),
    ("time_s,x_mm\n0,1e999\n", "2:3", "x_mm 1e999 is infinite"),
    // Ragged rows.
    ("a,b,c\n1,2,3\n1,2\n", "3:4", "the row has 2 fields, the header 3: no c"),
    ("a,b\n1,2\n\n1\n", "4:2", "the row has 1 fields, the header 2: no b"),
    ("a;b\n1;2;3;4\n", "2:5", "the row has 4 fields, the header 2"),
    ("a;b\r\n1,2\r\n", "2:1", "a 1,2 has a decimal comma"),
    // Quotes.
    ("a,b\n\"1,2\n", "2:1", "must end on its own line"),
    ("a,b\n1, \"2\"x\n", "2:7", "must be followed by a separator"),
    // Time.
    ("time_s,x_mm\n0,1\n5,1\n4.5,1\n", "4:1", "time_s runs back from 5 to 4.5 within a run"),
    ("x_mm,time_s\n1,5\n1,\n1,4\n", "4:3", "time_s runs back from 5 to 4"),
    ("run,time_s\n1,0\n2,5\n2,3\n", "4:3", "time_s runs back from 5 to 3"),
    ("run,time_s\n,5\n,3\n", "3:2", "time_s runs back from 5 to 3"),
    // Directions.
    ("dir_x,x_mm\n1,1\n-1,1\n0,1\n", "4:1", "dir_x must be 1 or -1, not 0"),
    ("x_mm,dir_z\n1,0.5\n", "2:3", "dir_z must be 1 or -1, not 0.5"),
    // Places count characters, after a byte order mark and blanks, in lines of any ending.
    ("\u{feff}µ,b\n1,x\n", "2:3", "b \"x\""),
    ("\u{feff}a,a\n1,2\n", "1:3", "repeated"),
    ("\"µ°\",b\r\n\r\n\"1\",   x\r\n", "3:8", "b \"x\""),
    ("a,b\r1,2\r", "1:4", "carriage return alone"),
];

#[test]
fn each_is_refused_at_its_place_with_its_rule() {
    for (text, place, phrase) in BAD {
        let error = error_of(text.as_bytes());
        let line = error.to_string();
        assert!(line.starts_with(&format!("bad.csv:{place}: ")), "{text:?}: {line}");
        assert!(line.contains(phrase), "{text:?}: {line}");
        assert!(!line.contains('\n'), "{text:?}: {line}");
    }
}

#[test]
fn text_that_is_not_utf_8_is_refused_where_it_begins() {
    let latin_1 = error_of(b"time_s,x_\xb5m\n1,2\n");
    assert_eq!(latin_1.to_string(), "bad.csv:1:10: is not UTF-8 text");
    let later = error_of(b"a,b\n1,2\n\xc2\xb5\xff,2\n");
    assert_eq!(later.to_string(), "bad.csv:3:2: is not UTF-8 text");
    let utf_16 = error_of(b"\xff\xfea\0,\0b\0");
    assert_eq!(utf_16.to_string(), "bad.csv:1:1: is not UTF-8 text");
}

#[test]
fn a_file_that_cannot_be_read_is_refused_by_name() {
    let missing = RunFile::read(Path::new("no/such/run.csv")).expect_err("is not there");
    assert!(missing.to_string().starts_with("no/such/run.csv:1:1: cannot be read: "));
    let folder = RunFile::read(Path::new(env!("CARGO_MANIFEST_DIR"))).expect_err("is a folder");
    assert!(folder.rule.starts_with("cannot be read: "), "{folder}");
}

/// Returns the complaint about a source that is never in memory as a whole.
fn error_of_source(source: impl Read) -> String {
    let read = RunFile::from_reader(BufReader::new(source), Path::new("bad.csv"));
    read.map(|_| ()).expect_err("out of bounds").to_string()
}

/// Many columns: `c0,c1,…`
fn header(columns: usize) -> String {
    let names: Vec<String> = (0..columns).map(|number| format!("c{number}")).collect();
    names.join(",") + "\n"
}

#[test]
fn a_line_without_an_end_is_refused_where_it_begins() {
    let rest = io::repeat(b'1').take(1 << 30);
    let error = error_of_source("a,b\n1,2\n".as_bytes().chain(rest));
    assert!(error.starts_with("bad.csv:3:1: the line is longer than 1048576 bytes"), "{error}");
    let header = error_of_source(io::repeat(0).take(1 << 30));
    assert!(header.starts_with("bad.csv:1:1: the line is longer"), "{header}");
}

#[test]
fn a_column_too_many_is_refused_at_its_name() {
    let most = header(MAX_RUN_FILE_COLUMNS) + &"1,".repeat(MAX_RUN_FILE_COLUMNS - 1) + "1\n";
    let run = RunFile::from_reader(most.as_bytes(), Path::new("r.csv")).expect("as many as may be");
    assert_eq!(run.columns().len(), MAX_RUN_FILE_COLUMNS);
    let error = error_of(header(MAX_RUN_FILE_COLUMNS + 1).as_bytes()).to_string();
    let column = header(MAX_RUN_FILE_COLUMNS).len() + 1;
    assert_eq!(error, format!("bad.csv:1:{column}: more than 4096 columns"));
}

/// Lines and columns of all that is reported of `text`, and how much more there is.
fn places_of(text: &str) -> (Vec<(usize, usize)>, usize) {
    let error = error_of(text.as_bytes());
    let unlisted = error.unlisted;
    (
        error.into_single_errors().map(|fault| (fault.place.line, fault.place.column)).collect(),
        unlisted,
    )
}

#[test]
fn all_that_is_wrong_with_a_file_is_reported_at_once_in_its_order() {
    let text = "time_s,x_mm,x_mm,,dir_x\n\
                0,1,2,3,1\n\
                1,abc,2,inf,0\n\
                2,1,2,3\n\
                3,1,2,3,1,9\n\
                4,\"1,2,3,1\n\
                # a comment\n\
                2.5,1,2,3,1\n\
                2.6,1,2,3,-1\n";
    let expected = [(1, 13), (1, 18), (3, 3), (3, 9), (3, 13), (4, 8), (5, 11), (6, 3)];
    assert_eq!(places_of(text), (expected.to_vec(), 0));
    // Of a row that is wrong the time counts, where it can be read: this one runs back.
    let late = "time_s,x_mm\n5,x\n4,1\n4,2\n";
    assert_eq!(places_of(late), (vec![(2, 3), (3, 1)], 0));
    // Each says what to do about it.
    for error in error_of(text.as_bytes()).into_single_errors() {
        assert!(error.help.is_some(), "{error}");
    }
    let latin_1 = error_of(b"a,b\n1,x\n\xb5,2\n3,y\n");
    let places: Vec<usize> = latin_1.into_single_errors().map(|fault| fault.place.line).collect();
    assert_eq!(places, [2, 3, 4]);
}

#[test]
fn of_a_file_that_is_wrong_everywhere_twenty_faults_are_reported_and_the_others_counted() {
    let text = "time_s;x_mm\n".to_string() + &"0;1,5\n".repeat(332);
    let (places, unlisted) = places_of(&text);
    assert_eq!((places.len(), unlisted), (MAX_LISTED_ERRORS, 312));
    assert_eq!((places[0], places[19]), ((2, 3), (21, 3)));
    // What stops the reading is among them.
    let cut = text + &"1".repeat(2 << 20);
    assert_eq!(places_of(&cut).1, 313);
}
