//! Whatever the bytes are: a run file, a question, or an error with a place in the file.

use std::path::Path;

use trueup_import::{ImportAnswers, ImportError, import, is_foreign_format};
use trueup_machine::RunFile;

#[test]
fn no_change_of_bytes_makes_it_panic_or_write_what_is_no_run_file() {
    let samples: [(&str, &str); 6] = [
        (
            "a.csv",
            "Titel;\nZeit;X;Messuhr\ns;mm;µm\n08:15;1,5;2 µm\n08:16;2.000,5;-3\n08:17;3;1E-3\nMittel;;2\n",
        ),
        (
            "b.csv",
            "sep=,\n\"Date\",\"X (in)\",\"Error X (mil)\"\n\"03/04/2026 8:15 PM\",\"1,234.5\",1\n3/5/2026 0:01 AM,2,3\n",
        ),
        (
            "c.tsv",
            "Soll X [mm]\thin 1 [µm]\trück 1\thin 2\trück 2\n0\t0,1\t1\t2\t3\n50\t1\t2\t3\t4\n",
        ),
        ("d.comp", "0 0 0.005\n100 100.002 100.007\n"),
        (
            "e.csv",
            "RepRapFirmware height map file v2\nxmin,xmax,ymin,ymax,radius,xspacing,yspacing,xnum,ynum\n0,10,0,10,-1,10,10,2,2\n0.1,0.2\n0,0.3\n",
        ),
        (
            "f.rtl",
            "TARGET DATA::\nTarget-count: 2\nTargets :\n0 50\nFlags: 1\nDEVIATIONS::\nRun Target Data:\n1 1 0.1\n1 2 0.2\n2 2 0.3\n2 1 0.4\n",
        ),
    ];
    let mut state = 1_u64;
    let mut below = |most: usize| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from(state >> 33).expect("31 bits") % most.max(1)
    };
    let (mut read, mut open, mut bad, mut foreign) = (0, 0, 0, 0);
    for round in 0..3000 {
        let (name, text) = samples[round % samples.len()];
        let mut bytes = text.as_bytes().to_vec();
        for _ in 0..below(4) {
            let at = below(bytes.len());
            match below(5) {
                0 => bytes[at] = u8::try_from(below(256)).expect("a byte"),
                1 => drop(bytes.remove(at)),
                2 => bytes.insert(at, b";,.\n\"#\t -:/[]=1"[below(15)]),
                3 => bytes.truncate(at),
                _ => bytes.extend_from_within(at..),
            }
            if bytes.is_empty() {
                break;
            }
        }
        let path = Path::new(name);
        foreign += usize::from(is_foreign_format(&bytes, path));
        let mut answers = ImportAnswers::default();
        for _ in 0..6 {
            match import(&bytes, path, &answers) {
                Ok(imported) => {
                    let run = RunFile::from_reader(imported.run.as_bytes(), path);
                    assert_eq!(run.expect("a run file").row_count(), imported.rows);
                    read += 1;
                    break;
                }
                Err(ImportError::Bad(error)) => {
                    assert!(
                        error.place.line >= 1 && error.place.column >= 1 && !error.rule.is_empty()
                    );
                    bad += 1;
                    break;
                }
                Err(ImportError::Open(questions)) => {
                    assert!(!questions.is_empty());
                    open += 1;
                    for question in questions {
                        let value = question.choices.first().map_or("3", String::as_str);
                        answers.record_answer(&question.topic, value).expect("its own choice");
                    }
                }
            }
        }
    }
    assert!(read.min(open).min(bad).min(foreign) > 300, "{read} {open} {bad} {foreign}");
}
