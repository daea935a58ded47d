//! The questions of a bridge to its operator, read and printed: until they are answered nothing is engaged.

use anyhow::Result;
use trueup_client::{
    operator_questions::{CONFIRM_INSTRUCTIONS, unanswered_questions},
    sdo_object,
    session::Session,
};
use trueup_link::status::StateBits;

use crate::output;

/// The questions that are open.
pub struct OpenQuestions(StateBits);

impl OpenQuestions {
    /// Reads them from the bridge.
    pub fn read(session: &mut Session) -> Result<Self> {
        Ok(Self(StateBits(sdo_object::read_number(session, sdo_object::STATE_BITS)?)))
    }

    /// Returns the state that they were read from.
    pub fn state_bits(&self) -> StateBits {
        self.0
    }

    /// Returns whether the calibration is of another machine or board than this one.
    pub fn has_foreign_calibration(&self) -> bool {
        self.0.contains(StateBits::FOREIGN_MACHINE)
    }

    /// Returns whether there are none that bar every offset.
    pub fn permits_offsets(&self) -> bool {
        self.keywords().iter().all(|word| *word == "heat-unknown")
    }

    /// Returns a word each, in the order in which `Confirm` answers them.
    pub fn keywords(&self) -> Vec<&'static str> {
        unanswered_questions(self.0).into_iter().map(|(word, _)| word).collect()
    }

    /// Prints each with what to do about it.
    pub fn print(&self) -> Result<()> {
        let open = unanswered_questions(self.0);
        if open.is_empty() {
            return Ok(());
        }
        output::print(format_args!(
            "the bridge requires confirmation by its operator; {CONFIRM_INSTRUCTIONS}:"
        ))?;
        open.iter().try_for_each(|(word, remedy)| output::print(format_args!("  {word}: {remedy}")))
    }
}
