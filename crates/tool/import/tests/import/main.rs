//! Tables of our own making, as spreadsheets, loggers and instruments write them, read as run files.

mod clocks;
mod corpus;
mod hostile;
mod instruments;
mod questions;
mod tables;
mod units;
mod workbooks;

use std::path::Path;

use trueup_import::{ImportAnswers, ImportError, ImportedRun, QuestionTopic, import};
use trueup_machine::RunFile;

/// Returns what the user has stated.
fn answers(given: &[(QuestionTopic, &str)]) -> ImportAnswers {
    let mut answers = ImportAnswers::default();
    for (topic, value) in given {
        answers.record_answer(topic, value).expect("an answer");
    }
    answers
}

fn column(name: &str) -> QuestionTopic {
    QuestionTopic::Column(name.into())
}

fn unit(name: &str) -> QuestionTopic {
    QuestionTopic::Unit(name.into())
}

/// Returns the file, read with what the user has stated.
fn read(text: impl AsRef<[u8]>, given: &[(QuestionTopic, &str)]) -> ImportedRun {
    read_as("table.csv", text.as_ref(), given)
}

fn read_as(name: &str, bytes: &[u8], given: &[(QuestionTopic, &str)]) -> ImportedRun {
    import(bytes, Path::new(name), &answers(given)).unwrap_or_else(|refused| panic!("{refused:?}"))
}

/// Returns the topics that are open.
fn open(text: impl AsRef<[u8]>, given: &[(QuestionTopic, &str)]) -> Vec<QuestionTopic> {
    match import(text.as_ref(), Path::new("table.csv"), &answers(given)) {
        Err(ImportError::Open(questions)) => {
            questions.into_iter().map(|question| question.topic).collect()
        }
        other => panic!("{other:?}"),
    }
}

/// Returns what is wrong with the file: `line:column: rule`.
fn bad(text: impl AsRef<[u8]>, given: &[(QuestionTopic, &str)]) -> String {
    match import(text.as_ref(), Path::new("table.csv"), &answers(given)) {
        Err(ImportError::Bad(error)) => {
            error.to_string().trim_start_matches("table.csv:").to_string()
        }
        other => panic!("{other:?}"),
    }
}

/// Returns the values of a column of the run file.
fn values(imported: &ImportedRun, name: &str) -> Vec<f64> {
    let run = RunFile::from_reader(imported.run.as_bytes(), Path::new("run.csv"));
    let run = run.unwrap_or_else(|error| panic!("{error}: {}", imported.run));
    run.column(name).unwrap_or_else(|| panic!("no {name}: {}", imported.run)).to_vec()
}
