//! The answers of the person at the machine: typed, or from a file with a line for each question.

use std::{
    collections::VecDeque,
    fs,
    io::{IsTerminal as _, stdin},
    path::Path,
    sync::mpsc::{self, RecvTimeoutError},
    thread,
    time::Duration,
};

use anyhow::{Result, bail};

use super::board_backup::{Interrupted, check_interrupt};
use crate::UserError;

/// How often Ctrl-C is looked for.
const INTERRUPT_POLL_PERIOD: Duration = Duration::from_millis(100);
/// The character of the key Esc.
const ESCAPE_CHAR: char = '\u{1b}';

/// The answers.
pub struct AnswerSource {
    /// `None`: they are typed.
    written: Option<VecDeque<String>>,
}

impl AnswerSource {
    /// From the file, without its empty lines and comments (`#`); typed without one.
    pub fn from_file(file: Option<&Path>) -> Result<Self> {
        let Some(path) = file else { return Ok(Self { written: None }) };
        let text = fs::read_to_string(path)
            .map_err(|error| UserError(format!("{}: cannot be read: {error}", path.display())))?;
        let lines = text.lines().map(str::trim);
        let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
        Ok(Self { written: Some(lines.map(str::to_owned).collect()) })
    }

    /// Returns the answer to a question; `None`: there is none yet.
    pub fn prompt(&mut self, question: &str) -> Result<Option<String>> {
        trueup_output::write_prompt(format_args!("{question}: "));
        if let Some(written) = &mut self.written {
            let answer = written.pop_front();
            trueup_output::write_diagnostic(answer.as_deref().unwrap_or("no answer is written"));
            return Ok(answer);
        }
        if !stdin().is_terminal() {
            trueup_output::write_diagnostic(
                "there is no terminal for the questions; --readings FILE answers them",
            );
            return Ok(None);
        }
        // Of its own thread, so that Ctrl-C is seen meanwhile.
        let (sender, receiver) = mpsc::channel();
        thread::spawn(move || {
            let mut answer = String::new();
            sender.send(stdin().read_line(&mut answer).map(|_| answer)).ok();
        });
        let answer = loop {
            check_interrupt()?;
            match receiver.recv_timeout(INTERRUPT_POLL_PERIOD) {
                Ok(answer) => break answer?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => bail!("the terminal cannot be read"),
            }
        };
        if answer.starts_with(ESCAPE_CHAR) {
            bail!(Interrupted);
        }
        Ok(Some(answer.trim().to_owned()).filter(|answer| !answer.is_empty()))
    }
}
