//! Files as a retrofitter has them on the first day: tables and logs of our own making, each read without an edit, with one
//! answer, or refused in at most three lines that name the form that would do. The counts are asserted.

use std::path::Path;

use trueup_import::{ImportError, import};

use crate::{QuestionTopic, answers, column, unit};

/// The result that is expected of a file.
enum Fate {
    /// It is read as it is; the first line and the first row of the run file.
    Read(&'static str),
    /// It is read after this one answer.
    OneAnswer((QuestionTopic, &'static str), &'static str),
    /// It is refused, with this form in its place.
    Refused(&'static str),
}
use Fate::{OneAnswer, Read, Refused as RefusedBy};

/// Returns a text in an encoding.
fn latin(text: &str) -> Vec<u8> {
    text.chars().map(|c| u8::try_from(u32::from(c)).expect("Latin-1")).collect()
}

fn utf16(text: &str) -> Vec<u8> {
    [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect()
}

/// A file: its name, its content, and what becomes of it.
type File = (&'static str, Vec<u8>, Fate);

fn plain(text: &str) -> Vec<u8> {
    text.as_bytes().to_vec()
}

/// Returns what people and loggers write.
fn tables() -> Vec<File> {
    vec![
        (
            "german.csv",
            plain(
                "Messprotokoll;;\nPosition X [mm];Richtung;Abweichung X [µm]\n0,0;hin;0,5\n100,0;hin;1,5\n100,0;rück;4,5\n",
            ),
            Read("x_mm,dir_x,measured_dx_um\n0,1,0.5\n"),
        ),
        (
            "latin.csv",
            latin(
                "X [mm];Abweichung X [µm];Temperatur Bett [°C]\r\n0,0;0,5;20,1\r\n50,0;1,0;20,2\r\n",
            ),
            Read("x_mm,measured_dx_um,temp_bett_c\n0,0.5,20.1\n"),
        ),
        (
            "utf16.txt",
            utf16(
                "Zeit [s]\tTemperatur Spindel [°C]\tDehnung [µm]\r\n0\t20,5\t0,0\r\n60\t21,5\t2,5\r\n",
            ),
            Read("time_s,temp_spindel_c,measured_elongation_um\n0,20.5,0\n"),
        ),
        (
            "sep.csv",
            plain("sep=;\nX [mm];Error X [µm]\n0;0.5\n10;0.7\n"),
            Read("x_mm,measured_dx_um\n0,0.5\n"),
        ),
        (
            "units-row.csv",
            plain("time,temp bed,error x\ns,°C,µm\n0,20.5,0.1\n60,20.7,0.4\n"),
            Read("time_s,temp_bed_c,measured_dx_um\n0,20.5,0.1\n"),
        ),
        (
            "fahrenheit.csv",
            plain("Time [min],Temp Spindle [°F],Elongation [µin]\n0,68.0,0\n1,77.0,100\n"),
            Read("time_s,temp_spindle_c,measured_elongation_um\n0,20,0\n60,25,2.54\n"),
        ),
        (
            "clock.csv",
            plain("Uhrzeit;Temperatur Bett [°C];Dehnung [µm]\n08:15;20,0;0\n08:20;21,0;3\n"),
            Read("time_s,temp_bett_c,measured_elongation_um\n0,20,0\n300,21,3\n"),
        ),
        (
            "iso.csv",
            plain(
                "timestamp,temp_bed_c,elongation [um]\n2026-04-03T08:15:00Z,20,0\n2026-04-03T08:16:00Z,21,3\n",
            ),
            Read("time_s,temp_bed_c,measured_elongation_um\n0,20,0\n60,21,3\n"),
        ),
        (
            "dates.csv",
            plain(
                "Datum;Temperatur Bett [°C];Dehnung [µm]\n03.04.2026 08:15;20,0;0\n03.04.2026 08:16;21,0;3\n",
            ),
            Read("time_s,temp_bett_c,measured_elongation_um\n0,20,0\n60,21,3\n"),
        ),
        (
            "thousands.csv",
            plain("Position X [mm];Abweichung X [µm]\n0,00;0,5\n1.250,00;2,5\n"),
            Read("x_mm,measured_dx_um\n0,0.5\n1250,2.5\n"),
        ),
        (
            "remarks.csv",
            plain(
                "Position X [mm];Abweichung X [µm];Bemerkung\n0;0,5;Start;;\n10;1,5;;;\nMittelwert;1,0;;;\n",
            ),
            Read("x_mm,measured_dx_um\n0,0.5\n10,1.5\n"),
        ),
        (
            "inch.csv",
            plain("X [inch],Error X [thou]\n0,0.1\n4,0.2\n"),
            Read("x_mm,measured_dx_um\n0,2.54\n101.6,5.08\n"),
        ),
    ]
}

/// Returns what is answered once, and what instruments and controls write.
fn instruments() -> Vec<File> {
    vec![
        (
            "passes.csv",
            plain(
                "Position X [mm];hin 1 [µm];rück 1 [µm];hin 2 [µm];rück 2 [µm]\n0;0;4;0;5\n100;1;5;1;6\n",
            ),
            OneAnswer((column("hin 1 [µm]"), "measured_dx_um"), "x_mm,"),
        ),
        (
            "target.csv",
            plain("Soll X [mm];Ist X [mm]\n0,000;0,001\n100,000;100,003\n"),
            Read("x_mm,measured_dx_um\n0,1\n100,3\n"),
        ),
        (
            "gauge.csv",
            plain("X [mm];Messuhr [µm]\n0;0,5\n10;1,5\n"),
            OneAnswer((column("Messuhr [µm]"), "measured_dx_um"), "x_mm,measured_dx_um\n0,0.5\n"),
        ),
        (
            "no-unit.csv",
            plain("X [mm];Abweichung X\n0;0,5\n10;1,5\n"),
            OneAnswer((unit("Abweichung X"), "µm"), "x_mm,measured_dx_um\n0,0.5\n"),
        ),
        (
            "router.csv",
            plain("X position [mm];X error [µm]\n0;0\n100;12.5\n200;21.5\n"),
            Read("x_mm,measured_dx_um\n0,0\n100,12.5\n"),
        ),
        (
            "X.com",
            plain(
                "BEGIN X.com MM\nNR AXISPOS BACKLASH X\n0 +0 +0.005 +0\n1 +100 +0.007 +0.002\n[END]\n",
            ),
            Read("run,x_mm,dir_x,measured_dx_um\n1,0,1,0\n"),
        ),
        (
            "klippy.log",
            plain(
                "// probe at 10.000,20.000 is z=0.021250\nok\n// probe at 40.000,20.000 is z=0.033750\n",
            ),
            Read("x_mm,y_mm,measured_dz_um\n10,20,0\n40,20,-12.5\n"),
        ),
        (
            "console.txt",
            plain(
                "ok\n[PRB:-90.000,-80.000,-12.345:1]\nok\n[PRB:-60.000,-80.000,-12.385:1]\n[PRB:-30.000,-80.000,-20.000:0]\n",
            ),
            OneAnswer((unit("z"), "mm"), "x_mm,y_mm,measured_dz_um\n-90,-80,0\n-60,-80,40\n"),
        ),
        (
            "probe.txt",
            plain(
                "0.000000 0.000000 -1.500000 0 0 0 0 0 0\n25.000000 0.000000 -1.490000 0 0 0 0 0 0\n",
            ),
            OneAnswer((unit("z"), "mm"), "x_mm,y_mm,measured_dz_um\n0,0,0\n25,0,-10\n"),
        ),
        (
            "duet.txt",
            plain(
                "G30 P0 X10 Y20\nStopped at height -0.123 mm\nG30 P1 X50 Y20\nStopped at height -0.101 mm\n",
            ),
            RefusedBy("heightmap.csv"),
        ),
        ("bar.b5r", vec![1, 0, 7, 3, 200, 0], RefusedBy("trueup program backlash")),
        ("capture.rtx", plain("HEADER::\nFile type: 5\n"), RefusedBy("target data (.rtl)")),
        (
            "mill.xml",
            plain("<?xml version=\"1.0\"?><profile><Preferences/></profile>"),
            RefusedBy("screw map as csv"),
        ),
        (
            "edge.txt",
            plain("[PRB:10.000,0.000,-5.000:1]\n[PRB:10.012,0.000,-5.000:1]\n"),
            RefusedBy("target [mm];actual [mm]"),
        ),
    ]
}

#[test]
fn each_file_is_read_as_it_is_with_one_answer_or_refused_in_three_lines() {
    let (mut read, mut requested, mut refused) = (0, 0, 0);
    for (name, bytes, fate) in tables().into_iter().chain(instruments()) {
        let import =
            |given: &[(QuestionTopic, &str)]| import(&bytes, Path::new(name), &answers(given));
        let starts = |run: &str, start: &str| assert!(run.starts_with(start), "{name}: {run}");
        match fate {
            Read(start) => {
                let imported = import(&[]).unwrap_or_else(|error| panic!("{name}: {error:?}"));
                starts(&imported.run, start);
                read += 1;
            }
            OneAnswer(answer, start) => {
                let Err(ImportError::Open(questions)) = import(&[]) else {
                    panic!("{name}: {:?}", import(&[]))
                };
                assert_eq!(questions.len(), 1, "{name}: {questions:?}");
                assert_eq!(questions[0].topic, answer.0, "{name}");
                let imported =
                    import(&[answer]).unwrap_or_else(|error| panic!("{name}: {error:?}"));
                starts(&imported.run, start);
                requested += 1;
            }
            RefusedBy(form) => {
                let Err(ImportError::Bad(error)) = import(&[]) else { panic!("{name}") };
                let text = format!("{error}\n{}", error.help.clone().unwrap_or_default());
                assert!(text.contains(form) && text.lines().count() <= 3, "{name}: {text}");
                refused += 1;
            }
        }
    }
    println!("{read} read as they are, {requested} with one answer, {refused} refused by name");
    assert_eq!((read, requested, refused), (16, 5, 5));
}
