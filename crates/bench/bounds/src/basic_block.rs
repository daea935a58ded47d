//! A block: instructions that follow each other, where it leads on, and what it calls at its end.

use std::collections::BTreeSet;

use crate::decode::Instruction;

/// How control goes on from a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ControlFlowEdge {
    /// The number of the next block.
    pub to: usize,
    /// The pipeline is refilled.
    pub is_taken: bool,
}

/// The call at the end of a block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Call {
    /// Of functions that begin here.
    Direct(BTreeSet<u32>),
    /// Of what a register holds: which, the values or a table have to say.
    Indirect(u8),
}

/// A block.
#[derive(Clone, Debug, Default)]
pub(crate) struct BasicBlock {
    /// Its instructions.
    pub instructions: Vec<Instruction>,
    /// Where it leads on.
    pub next: Vec<ControlFlowEdge>,
    /// The call that it ends with.
    pub call: Option<Call>,
    /// It may go back to the caller of the function, after its call if it has one.
    pub returns: bool,
}

impl BasicBlock {
    /// Its first address.
    #[must_use]
    pub(crate) fn start_address(&self) -> u32 {
        self.instructions[0].at
    }

    /// The address behind it.
    #[must_use]
    pub(crate) fn end_address(&self) -> u32 {
        self.last_instruction().end_address()
    }

    /// Its last instruction.
    #[must_use]
    pub(crate) fn last_instruction(&self) -> &Instruction {
        self.instructions.last().expect("a block is never empty")
    }
}
