//! Units in headers, in rows of units and behind values; none is guessed.

use crate::{QuestionTopic, column, open, read, unit, values};

#[test]
fn each_unit_of_a_header_becomes_the_run_files() {
    for (header, name, before, after) in [
        ("Zeit [s]", "time_s", "12,5", 12.5),
        ("Zeit [ms]", "time_s", "12500", 12.5),
        ("Zeit [min]", "time_s", "1,5", 90.0),
        ("Time in hours", "time_s", "0,5", 1800.0),
        ("X [mm]", "x_mm", "25,4", 25.4),
        ("X (inch)", "x_mm", "1", 25.4),
        ("X [m]", "x_mm", "0,0254", 25.4),
        ("Fehler X [mm]", "measured_dx_um", "0,0123", 12.3),
        ("Fehler X [µm]", "measured_dx_um", "12,3", 12.3),
        ("Error X [µin]", "measured_dx_um", "100", 2.54),
        ("Error X [thou]", "measured_dx_um", "1", 25.4),
        ("Error X [in]", "measured_dx_um", "0,0001", 2.54),
        ("Fehler X [1/100 mm]", "measured_dx_um", "1,5", 15.0),
        ("Spindle °F", "temp_spindle_c", "68", 20.0),
        ("Spindle [K]", "temp_spindle_c", "293,15", 20.0),
        ("Spindle [1/10 °C]", "temp_spindle_c", "203", 20.3),
        ("Spindle [°C]", "temp_spindle_c", "20,3", 20.3),
        ("Drehzahl [1000 r/min]", "spindle_rpm", "8", 8000.0),
        ("Spannung [mV]", "spannung_v", "1540", 1.54),
        ("Kraft [kN]", "load_n", "1,2", 1200.0),
        ("measured_dx_mm", "measured_dx_um", "0,0123", 12.3),
        ("temp_bed_f", "temp_bed_c", "68", 20.0),
    ] {
        let text = format!("{header};run\n{before};1\n{before};2\n");
        let imported = read(&text, &[]);
        assert_eq!(values(&imported, name), [after; 2], "{header}");
    }
}

#[test]
fn a_unit_behind_each_value_is_the_columns() {
    let imported = read("Weg X;Fehler X\n1,5 mm;3 µm\n2,5 mm;4 µm\n", &[]);
    assert_eq!(imported.run, "x_mm,measured_dx_um\n1.5,3\n2.5,4\n");
}

#[test]
fn a_column_without_a_unit_is_asked_and_never_guessed() {
    let text = "Zeit;X;Fehler X;Temperatur Bett\n0;1;2,5;20\n1;2;3,5;21\n";
    assert_eq!(open(text, &[]), [unit("X"), unit("Fehler X"), unit("Temperatur Bett"),]);
    let given = [(unit("X"), "inch"), (unit("fehler x"), "mm"), (unit("4"), "°F")];
    assert_eq!(open(text, &given), [unit("Zeit")]);
    let given = [&given[..], &[(unit("time_s"), "min")]].concat();
    let imported = read(text, &given);
    assert_eq!(values(&imported, "time_s"), [0.0, 60.0]);
    assert_eq!(values(&imported, "x_mm"), [25.4, 50.8]);
    assert_eq!(values(&imported, "measured_dx_um"), [2500.0, 3500.0]);
    assert_eq!(values(&imported, "temp_bett_c")[0], -6.666_666_666_67);
    // A unit that is none is asked too.
    assert_eq!(open("Zeit [Takte];flow\n0;1\n1;1\n", &[]), [unit("Zeit [Takte]")]);
}

#[test]
fn volts_of_the_sensor_become_counts_by_the_inputs_scale() {
    let text = "Zeit [s];Sensor [mV]\n0;1540\n1;1541\n";
    assert_eq!(open(text, &[]), [QuestionTopic::CountsPerV]);
    let imported = read(text, &[(QuestionTopic::CountsPerV, "2764.8")]);
    assert_eq!(values(&imported, "sensor_counts"), [4257.792, 4260.5568]);
}

#[test]
fn a_sign_is_turned_where_the_user_says_so() {
    let text = "X [mm];Messuhr [µm]\n0;0\n1;2,5\n";
    let mut answers = crate::answers(&[(column("Messuhr"), "measured_dz_um")]);
    answers.negate.push("Messuhr".into());
    let path = std::path::Path::new("t.csv");
    let imported = trueup_import::import(text.as_bytes(), path, &answers).expect("a table");
    assert_eq!(imported.run, "x_mm,measured_dz_um\n0,0\n1,-2.5\n");
}
