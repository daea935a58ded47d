//! Content that can be read in two ways raises a question.

use std::path::Path;

use trueup_import::{ImportAnswers, ImportError, import, is_foreign_format};

use crate::{QuestionTopic, bad, column, open, read, unit, values};

#[test]
fn what_may_be_a_thousand_or_a_decimal_is_asked() {
    let text = "Zeit [s];Weg X [mm]\n1;1.234\n2;2.345\n";
    assert_eq!(open(text, &[]), [QuestionTopic::Decimal]);
    assert_eq!(values(&read(text, &[(QuestionTopic::Decimal, "comma")]), "x_mm"), [1234.0, 2345.0]);
    assert_eq!(values(&read(text, &[(QuestionTopic::Decimal, "point")]), "x_mm"), [1.234, 2.345]);
    // One number that is sure settles it, wherever it stands.
    assert_eq!(values(&read(text.replace("2;2", "2,5;2"), &[]), "x_mm"), [1234.0, 2345.0]);
    assert_eq!(values(&read(text.replace("2;2", "2.5;2"), &[]), "x_mm"), [1.234, 2.345]);
    assert_eq!(values(&read(text.replace("2.345", "0.345"), &[]), "x_mm"), [1.234, 0.345]);
    assert_eq!(open(text.replace('.', ","), &[]), [QuestionTopic::Decimal]);
    // A comma between columns leaves it no other reading.
    assert_eq!(values(&read(text.replace(';', ","), &[]), "x_mm"), [1.234, 2.345]);
}

#[test]
fn an_order_of_dates_is_asked_only_where_it_matters() {
    let table =
        |dates: [&str; 3]| format!("Datum;flow\n{};1\n{};2\n{};3\n", dates[0], dates[1], dates[2]);
    let days = |text: &str, given: &[(QuestionTopic, &str)]| {
        values(&read(text, given), "time_s")
            .iter()
            .map(|value| value / 86_400.0)
            .collect::<Vec<_>>()
    };
    let text = table(["03.04.2026 08:00", "04.04.2026 08:00", "05.04.2026 08:00"]);
    assert_eq!(open(&text, &[]), [QuestionTopic::Date]);
    assert_eq!(days(&text, &[(QuestionTopic::Date, "dmy")]), [0.0, 1.0, 2.0]);
    assert_eq!(days(&text, &[(QuestionTopic::Date, "mdy")]), [0.0, 31.0, 61.0]);
    // 13 is no month.
    assert_eq!(days(&table(["11.04.2026", "12.04.2026", "13.04.2026"]), &[]), [0.0, 1.0, 2.0]);
    assert_eq!(days(&table(["04/11/2026", "04/12/2026", "04/13/2026"]), &[]), [0.0, 1.0, 2.0]);
    // Read the other way it would run back.
    assert_eq!(days(&table(["12.01.2026", "01.02.2026", "02.02.2026"]), &[]), [0.0, 20.0, 21.0]);
    // One day: both readings are the same times.
    assert_eq!(
        values(
            &read(table(["03.04.2026 08:00", "03.04.2026 08:01", "03.04.2026 08:02"]), &[]),
            "time_s"
        ),
        [0.0, 60.0, 120.0]
    );
    assert_eq!(open(table(["03.04.", "04.04.", "05.04."]), &[]), [QuestionTopic::Date]);
    assert!(
        bad(table(["31.04.2026", "31.04.2026", "31.04.2026"]), &[])
            .contains("Datum holds no dates")
    );
}

#[test]
fn the_axis_of_a_position_and_of_a_gauge_is_asked() {
    let text = "Position [mm];Richtung;Messuhr [µm]\n0;+;1,5\n1;-;2,5\n";
    assert_eq!(open(text, &[]), [column("Position [mm]"), column("Messuhr [µm]")]);
    let given = [(column("Position"), "y_mm"), (column("Messuhr"), "measured_dz_um")];
    assert_eq!(read(text, &given).run, "y_mm,dir_y,measured_dz_um\n0,1,1.5\n1,-1,2.5\n");
}

#[test]
fn each_question_names_its_flag_and_any_answer_to_it_is_taken() {
    let texts = [
        "Zeit;X;Messuhr\n1;1.234;2\n2;2.345;3\n",
        "Zeit;flow\n00:01;1\n00:02;1\n",
        "Datum;flow\n03.04.2026;1\n04.04.2026;1\n",
        "Zeit [s];Sensor [V]\n0;1\n1;2\n",
    ];
    for text in texts {
        let mut answers = ImportAnswers::default();
        let mut requested = 0;
        while let Err(ImportError::Open(questions)) =
            import(text.as_bytes(), Path::new("t.csv"), &answers)
        {
            for question in questions {
                assert!(question.flag().starts_with("--"), "{question:?}");
                let value = question.choices.first().map_or("3", String::as_str);
                answers.record_answer(&question.topic, value).expect("its own choice");
                requested += 1;
            }
            assert!(requested < 10, "{text}");
        }
        assert!(
            requested > 0 && import(text.as_bytes(), Path::new("t.csv"), &answers).is_ok(),
            "{text}"
        );
    }
    assert_eq!(open(texts[1], &[]), [unit("Zeit")]);
}

#[test]
fn a_run_file_with_a_fault_is_no_table_to_import() {
    let is = |text: &str| is_foreign_format(text.as_bytes(), Path::new("t.csv"));
    assert!(is("Zeit [s];Weg X [mm]\n0;1,5\n1;2,5\n"));
    assert!(is("Position;Messuhr\n0;1,5\n1;2,5\n"));
    assert!(!is("time_s;x_mm\n0;1,5\n1;2,5\n"));
    assert!(!is("time_s,flow\n0,1\n1,2\n"));
    assert!(!is("not a table at all\n"));
}
