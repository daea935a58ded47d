//! A function call: with the arguments on which its time depends, where they are known.

/// Numbers in the first four registers at the entry of a function, where they are known.
pub type KnownArguments = [Option<u32>; 4];

/// A function call: its start and its arguments, if its time depends on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FunctionEntry {
    /// Its first address.
    pub start: u32,
    /// Its arguments; none where its time depends on none.
    pub arguments: KnownArguments,
    /// Those of its arguments that point into the RAM in this call, a bit each; none where its time depends on no argument.
    pub ram: u16,
}

impl FunctionEntry {
    /// Returns a function whose arguments are not known.
    #[must_use]
    pub const fn new(start: u32) -> Self {
        Self { start, arguments: [None; 4], ram: 0 }
    }
}
