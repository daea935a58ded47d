//! What the person at the machine answers: typed, or from a file with a line for each question.

use std::{
    collections::VecDeque,
    fs,
    io::{IsTerminal as _, stdin},
    path::Path,
};

use anyhow::Result;

use crate::UserError;

/// The answers.
pub struct Answers {
    /// `None`: they are typed.
    written: Option<VecDeque<String>>,
}

impl Answers {
    /// From the file, without its empty lines and comments (`#`); typed without one.
    pub fn of(file: Option<&Path>) -> Result<Self> {
        let Some(path) = file else { return Ok(Self { written: None }) };
        let text = fs::read_to_string(path)
            .map_err(|error| UserError(format!("{}: cannot be read: {error}", path.display())))?;
        let lines = text.lines().map(str::trim);
        let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
        Ok(Self { written: Some(lines.map(str::to_owned).collect()) })
    }

    /// The answer to a question; `None`: there is none yet.
    pub fn ask(&mut self, question: &str) -> Result<Option<String>> {
        trueup_output::prompt(format_args!("{question}: "));
        if let Some(written) = &mut self.written {
            let answer = written.pop_front();
            trueup_output::diagnostic(answer.as_deref().unwrap_or("no answer is written"));
            return Ok(answer);
        }
        if !stdin().is_terminal() {
            trueup_output::diagnostic("nobody is at the terminal; --readings FILE answers");
            return Ok(None);
        }
        let mut answer = String::new();
        stdin().read_line(&mut answer)?;
        Ok(Some(answer.trim().to_owned()).filter(|answer| !answer.is_empty()))
    }
}
