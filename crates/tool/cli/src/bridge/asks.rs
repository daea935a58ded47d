//! The questions of a bridge to its operator, read and said: until they are answered nothing is engaged.

use anyhow::Result;
use trueup_client::{
    object,
    questions::{CONFIRM, open_questions},
    session::Session,
};
use trueup_link::status::StateBits;

use crate::output;

/// The questions that are open.
pub struct Asks(StateBits);

impl Asks {
    /// Asks the bridge for them.
    pub fn of(session: &mut Session) -> Result<Self> {
        Ok(Self(StateBits(object::number(session, object::STATE_BITS)?)))
    }

    /// Returns the state that they were read from.
    pub fn state(&self) -> StateBits {
        self.0
    }

    /// Returns whether the calibration is of another machine or board than this one.
    pub fn is_foreign(&self) -> bool {
        self.0.contains(StateBits::FOREIGN_MACHINE)
    }

    /// Returns whether there are none that bar every offset.
    pub fn is_empty(&self) -> bool {
        self.words().iter().all(|word| *word == "heat-unknown")
    }

    /// Returns a word each, in the order in which `Confirm` answers them.
    pub fn words(&self) -> Vec<&'static str> {
        open_questions(self.0).into_iter().map(|(word, _)| word).collect()
    }

    /// Prints each with what to do about it.
    pub fn print(&self) -> Result<()> {
        let open = open_questions(self.0);
        if open.is_empty() {
            return Ok(());
        }
        output::print(format_args!("the bridge asks its operator; {CONFIRM}:"))?;
        open.iter().try_for_each(|(word, remedy)| output::print(format_args!("  {word}: {remedy}")))
    }
}
