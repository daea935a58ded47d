//! Tables of spreadsheets and loggers: their forms, what is left out around them, and what is wrong in them.

use crate::{bad, column, read, unit, values};

const GERMAN: &str = "\
Messprotokoll Fräse;;;;
Datum;03.04.2026;;;
;;;;
Position X;Richtung;Messuhr;Temperatur Spindel;Bemerkung
[mm];;[µm];[°C];
0,000;hin;0,0;20,3;Start
100,000;hin;1,5;20,4;
200,000;hin;-2,25;20,6;
1.000,000;hin;3,5;;
200,000;rück;4,0;20,9;
Mittelwert;;1,35;20,5;
";

#[test]
fn a_german_table_with_title_units_and_remarks_needs_one_answer() {
    let given = [(column("Messuhr"), "measured_dx_um")];
    let imported = read(GERMAN, &given);
    assert_eq!(
        imported.run,
        "x_mm,dir_x,measured_dx_um,temp_spindel_c\n0,1,0,20.3\n100,1,1.5,20.4\n\
         200,1,-2.25,20.6\n1000,1,3.5,\n200,-1,4,20.9\n"
    );
    let names: Vec<&str> = imported.columns.iter().map(|column| column.header.as_str()).collect();
    assert_eq!(names, ["Position X", "Richtung", "Messuhr", "Temperatur Spindel"]);
    assert_eq!(imported.columns[2].unit_before, "µm");
    assert_eq!(imported.columns[0].samples[1], ["100,000", "100"]);
    assert_eq!(imported.skipped[0].0, "Bemerkung");
    let notes = imported.notes.join("\n");
    for phrase in ["line 1 is skipped", "line 2 is skipped", "line 11 is skipped: Mittelwert"] {
        assert!(notes.contains(phrase), "{phrase}: {notes}");
    }
}

#[test]
fn one_table_in_every_encoding_separator_and_decimal_sign_is_the_same_run() {
    let given = [(column("Messuhr"), "measured_dx_um")];
    let expected = read(GERMAN, &given).run;
    let latin: Vec<u8> =
        GERMAN.chars().map(|c| u8::try_from(u32::from(c)).expect("Latin-1")).collect();
    let utf16: Vec<u8> =
        [0xfeff].into_iter().chain(GERMAN.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let mut forms: Vec<(&str, Vec<u8>)> = vec![
        ("Latin-1", latin),
        ("UTF-16", utf16),
        ("a mark", format!("\u{feff}{GERMAN}").into_bytes()),
        ("CRLF", GERMAN.replace('\n', "\r\n").into_bytes()),
        ("CR", GERMAN.replace('\n', "\r").into_bytes()),
        ("sep=", format!("sep=;\n{GERMAN}").into_bytes()),
        ("tabs", GERMAN.replace(';', "\t").into_bytes()),
        ("trailing", GERMAN.replace('\n', ";;\n").into_bytes()),
        ("no end", GERMAN.trim_end().as_bytes().to_vec()),
        (
            "comments",
            format!("# a logger\n{}", GERMAN.replace("200,000;r", "# pause\n200,000;r")).into(),
        ),
        (
            "Swiss",
            GERMAN
                .replace('.', "'")
                .replace(",0", ".0")
                .replace("20,", "20.")
                .replace("1,35", "1.35")
                .replace("1,5", "1.5")
                .replace("2,25", "2.25")
                .replace("3,5", "3.5")
                .replace("4,0", "4.0")
                .replace("03'04'2026", "03.04.2026")
                .into(),
        ),
    ];
    let quoted: String = GERMAN
        .lines()
        .map(|line| {
            line.split(';').map(|part| format!("\"{part}\"")).collect::<Vec<_>>().join(",") + "\n"
        })
        .collect();
    forms.push(("quoted", quoted.into_bytes()));
    for (form, bytes) in forms {
        assert_eq!(read(bytes, &given).run, expected, "{form}");
    }
}

#[test]
fn a_run_file_is_read_as_it_is() {
    // Any numbers that a run may have, by a fixed recurrence.
    let mut state = 7_u64;
    let mut next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 10_f64.powi((state % 9) as i32 - 4)
    };
    for separator in [",", ";"] {
        for _ in 0..20 {
            let names = [
                "time_s",
                "run",
                "sensor_counts",
                "spindle_rpm",
                "load_n",
                "temp_bed_2_c",
                "x_mm",
                "a_deg",
                "dir_x",
                "measured_dx_um",
                "measured_elongation_um",
                "feed_mm_per_min",
                "offset_x_um",
                "quality",
                "flow",
                "pressure_bar",
                "age_ms",
                "predicted_dx_um",
                "coolant_on",
            ];
            let mut text = names.join(separator) + "\n";
            for row in 0..30 {
                let cells: Vec<String> = names
                    .iter()
                    .map(|name| match *name {
                        "time_s" => (f64::from(row) * 0.1).to_string(),
                        "dir_x" => if row % 2 == 0 { "1" } else { "-1" }.to_string(),
                        "load_n" if row % 3 == 0 => String::new(),
                        _ => next().to_string(),
                    })
                    .collect();
                text += &(cells.join(separator) + "\n");
            }
            assert_eq!(read(&text, &[]).run, text.replace(';', ","));
        }
    }
}

#[test]
fn passes_side_by_side_are_one_reading_a_row_in_the_order_of_measuring() {
    let text = "Soll X [mm];hin 1 [µm];rück 1;hin 2;rück 2\n0;0,1;1,1;0,2;1,2\n50;2,0;3,1;2,1;\n";
    let imported = read(text, &[(column("hin 1 [µm]"), "measured_dx_um")]);
    assert_eq!(
        imported.run,
        "x_mm,run,dir_x,measured_dx_um\n0,1,1,0.1\n50,1,1,2\n50,1,-1,3.1\n0,1,-1,1.1\n\
         0,2,1,0.2\n50,2,1,2.1\n0,2,-1,1.2\n"
    );
}

#[test]
fn passes_that_have_numbers_for_names_are_repeats() {
    let text = "Position [mm];1;2;3\n0;0,0;0,1;0,2\n100;1,0;1,1;1,2\n";
    let given = [
        (column("Position"), "x_mm"),
        (column("pass 1"), "measured_dx_um"),
        (unit("measured_dx_um"), "µm"),
    ];
    let imported = read(text, &given);
    assert_eq!(
        imported.run,
        "x_mm,run,measured_dx_um\n0,1,0\n100,1,1\n0,2,0.1\n100,2,1.1\n0,3,0.2\n100,3,1.2\n"
    );
}

#[test]
fn passes_that_say_what_they_measure_leave_no_question() {
    let text = "Pos. X (mm);Abw. X (µm) Hinfahrt;Abw. X (µm) Rückfahrt\n0;0,5;1,5\n100;1,0;2\n";
    let expected = "x_mm,run,dir_x,measured_dx_um\n0,1,1,0.5\n100,1,1,1\n100,1,-1,2\n0,1,-1,1.5\n";
    assert_eq!(read(text, &[]).run, expected);
}

#[test]
fn an_abbreviated_position_is_no_pass() {
    let text = "Pos.;Abw. ↑ 1;Abw. ↓ 1\nmm;µm;µm\n0;0,5;1\n100;1,5;2\n";
    let given = [(column("Pos."), "y_mm"), (column("Abw. ↑ 1"), "measured_dy_um")];
    let expected = "y_mm,run,dir_y,measured_dy_um\n0,1,1,0.5\n100,1,1,1.5\n100,1,-1,2\n0,1,-1,1\n";
    assert_eq!(read(text, &given).run, expected);
}

#[test]
fn an_actual_position_is_an_error_once_the_target_is_taken_off() {
    let text = "Soll X [mm],Ist X [mm]\n0,0.0001\n100,100.0023\n200,199.9991\n";
    let imported = read(text, &[]);
    assert_eq!(values(&imported, "measured_dx_um"), [0.1, 2.3, -0.9]);
    assert!(imported.notes.iter().any(|note| note.contains("Ist X [mm] minus Soll X [mm]")));
}

#[test]
fn what_is_wrong_has_its_line_and_column() {
    for (text, phrase) in [
        ("Zeit [s];X [mm]\n0;1,5\n1;zwei\n2;3\n", "3:3: \"zwei\" is no number in X [mm]"),
        ("Zeit [s];X [mm]\n0;1,5\n1;2.5\n", "3:3: 1,5 has a decimal comma, 2.5 a point"),
        ("Zeit [s];X [mm]\n0;1\n1;2 µm\n", "3:3: \"2 µm\" has another unit"),
        ("Zeit [s],X [mm]\n0,1,5\n1,2,5\n", "2:5: the row has 3 fields, the header 2"),
        ("Zeit [s];Zeit [s]\n0;1\n", "1:10: two columns are called Zeit [s]"),
        ("Zeit [s];X [mm];x (mm)\n0;1;2\n", "1:17: X [mm] and x (mm) would both be x_mm"),
        ("Zeit [s];Richtung X\n0;hin\n1;quer\n", "3:3: \"quer\" is no direction"),
        ("Zeit [s];X [mm]\n0;1\n5;2\n3;2\n", "4:1: the time runs back to 3"),
        ("a;b\nc;d\n", "1:1: has no row of numbers"),
        ("", "1:1: has no row of numbers"),
        ("0.1,0.2\n0.3,0.4\n", "1:1: no column is one that a run file knows: column 1, column 2"),
        ("X [mm]\n1\n2\n", "1:1: has only one column"),
        (
            "a;b;c\n1;2;3\n1;2;3\n1;2;3\nd;e;f\n4;5;6\n4;5;6\n4;5;6\n",
            "6:1: a second table begins here",
        ),
        ("\"Zeit;X\n1;2\n", "1:1: a quoted field has no end"),
    ] {
        assert!(bad(text, &[]).starts_with(phrase), "{text}: {}", bad(text, &[]));
    }
    assert!(
        bad("Zeit [s];X [mm]\n0;1\n", &[(unit("Weg"), "mm")]).contains("there is no column Weg")
    );
    let given = [(column("Zeit [s]"), "x_mm")];
    assert!(bad("Zeit [s];T [°C]\n0;1\n", &given).contains("s, which is no unit of"));
}

#[test]
fn a_last_line_that_is_cut_off_is_omitted_and_reported() {
    let imported = read("Zeit [s];X [mm];Y [mm]\n0;1;2\n1;2;3\n2;3", &[]);
    assert_eq!((imported.rows, imported.notes.len()), (2, 1));
    // A spreadsheet leaves out empty cells at the end of a line.
    let imported = read("Zeit [s];X [mm];Y [mm]\n0;1;2\n1;2\n2;3;4\n", &[]);
    assert_eq!(imported.rows, 3);
    assert!(values(&imported, "y_mm")[1].is_nan());
}

#[test]
fn a_table_without_headers_is_named_by_numbers() {
    let text = "0 1.5 20.1\n10 2.5 20.2\n20 3.5 20.3\n";
    let given = [
        (column("1"), "time_s"),
        (column("2"), "measured_dx_um"),
        (column("3"), "-"),
        (unit("1"), "s"),
        (unit("2"), "mm"),
    ];
    assert_eq!(read(text, &given).run, "time_s,measured_dx_um\n0,1500\n10,2500\n20,3500\n");
}

#[test]
fn a_header_in_a_comment_and_a_repeated_one_are_headers() {
    let text = "# time_s,flow\n0,1\n1,2\n# time_s,flow\n2,3\n";
    assert_eq!(read(text, &[]).run, "time_s,flow\n0,1\n1,2\n2,3\n");
    let text = "time_s;flow\n0;1,5\n1;2\n\ntime_s;flow\n2;3\n";
    assert_eq!(read(text, &[]).run, "time_s,flow\n0,1.5\n1,2\n2,3\n");
}

/// A logger's week: rows are counted once, not once for each row below.
#[test]
fn a_table_of_many_rows_takes_seconds_not_hours() {
    let mut text = "Time (s);Temp front (°C);Growth (µm)\n".to_string();
    for row in 0..100_000 {
        text += &format!("{row};{},25;{},5\n", 20 + row % 7, row % 90);
    }
    let began = std::time::Instant::now();
    let imported = read(&text, &[]);
    assert_eq!(imported.run.lines().count(), 100_001);
    let took = began.elapsed();
    assert!(took.as_secs() < 20, "{took:?}");
}
