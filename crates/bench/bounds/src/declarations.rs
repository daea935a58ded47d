//! What the code itself does not say: bounds of loops, lengths of copies, targets of calls by register. Each with its reason.

/// How often a loop goes back to its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IterationBound {
    /// At the most as often as this.
    AtMost(u32),
    /// Once for each `per` bytes of a length that is the argument of this number, and as often as `more`.
    Length {
        /// Number of the argument, from 0.
        argument: usize,
        /// Bytes of a round.
        per: u32,
        /// Rounds beyond.
        more: u32,
    },
    /// Once for each `per` bytes that it stores, of a length that is the argument of this number. A round that stores more
    /// words, because the compiler has unrolled the loop, counts for as many.
    PerStoredBytes {
        /// Number of the argument, from 0.
        argument: usize,
        /// Bytes of a store.
        per: u32,
    },
    /// Once for each bit of a mask that every round moves down by one; by as many as the code says where it is unrolled.
    Mask(u32),
    /// At the most as often as this, with all loops within it that the same declaration is for: it is one loop in the
    /// source, of which the compiler has made several.
    Together(u32),
    /// Once for each byte that no whole word has: all of a length below 16, otherwise 3 (`compiler_builtins`). Unrolled as
    /// [`Self::PerStoredBytes`].
    RemainderBytes {
        /// Number of the argument, from 0.
        argument: usize,
    },
    /// Until this many microseconds are over, on any clock.
    Microseconds(u32),
    /// Once for each term of the calibration.
    PerTerm,
    /// Once for each tool that a term of the calibration knows.
    PerTool,
    /// Once for each byte that waits (the column `arrives` of the tasks).
    PerWaitingByte,
}

/// The sizes of a calibration that loops go by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CalibrationSizes {
    /// Terms of a diagnosis.
    pub terms: u32,
    /// Tools of one of them.
    pub tools: u32,
}

impl CalibrationSizes {
    /// The largest that a board takes (`MAX_TERMS` and `MAX_TOOLS`, `core/src/design_parameters.rs`).
    pub const MAX: Self = Self { terms: 16, tools: 32 };
    /// A calibration without terms.
    pub const EMPTY: Self = Self { terms: 0, tools: 0 };
}

/// A place in the source: a function, or a part of its path, and what stands in the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourcePattern {
    /// Part of the path of the function.
    pub function: &'static str,
    /// Part of the source line; empty: any line of the function.
    pub line: &'static str,
}

/// A declared bound.
#[derive(Clone, Copy, Debug)]
pub struct LoopBound {
    /// The loop.
    pub at: SourcePattern,
    /// Its bound.
    pub rounds: IterationBound,
    /// The reason.
    pub reason: &'static str,
}

/// The longest that a copy of an unknown length can be.
#[derive(Clone, Copy, Debug)]
pub struct CopyLengthBound {
    /// The call.
    pub at: SourcePattern,
    /// Bytes.
    pub bytes: u32,
    /// The reason.
    pub reason: &'static str,
}

/// Functions that a call by register may reach.
#[derive(Clone, Copy, Debug)]
pub struct CallTargets {
    /// The call.
    pub at: SourcePattern,
    /// Parts of the names of the functions.
    pub functions: &'static [&'static str],
    /// The reason.
    pub reason: &'static str,
}

/// Code that is not part of a turn with a deadline.
#[derive(Clone, Copy, Debug)]
pub struct ExcludedCode {
    /// A whole function, where no line is named; else the code that stands for this line alone.
    pub at: SourcePattern,
    /// The reason.
    pub reason: &'static str,
}

/// A function that a turn calls once, though a loop or several paths have it.
#[derive(Clone, Copy, Debug)]
pub struct RateLimitedFunction {
    /// Part of the function's name; of several that share the calls, with `|` between them.
    pub function: &'static str,
    /// Microseconds between two calls in the long run, at the least, of all callers together.
    pub period_us: f64,
    /// Calls that may come at once in addition.
    pub burst: u32,
    /// The reason.
    pub reason: &'static str,
}

/// All declarations.
#[derive(Clone, Copy, Debug, Default)]
pub struct DeclarationTable {
    /// Bounds of loops.
    pub loops: &'static [LoopBound],
    /// Lengths of copies.
    pub copies: &'static [CopyLengthBound],
    /// Targets of calls.
    pub calls: &'static [CallTargets],
    /// Calls that no turn with a deadline makes.
    pub excluded: &'static [ExcludedCode],
    /// Code that a loop over bytes comes to at the end of a line alone.
    pub lines: &'static [ExcludedCode],
    /// Functions that a turn calls once.
    pub once: &'static [RateLimitedFunction],
}

/// Returns the bound of a loop, with its reason.
pub(crate) const fn loop_bound(
    function: &'static str,
    line: &'static str,
    rounds: IterationBound,
    reason: &'static str,
) -> LoopBound {
    LoopBound { at: SourcePattern { function, line }, rounds, reason }
}

/// Returns the length of a copy, with its reason.
pub(crate) const fn copy_length_bound(
    function: &'static str,
    line: &'static str,
    bytes: u32,
    reason: &'static str,
) -> CopyLengthBound {
    CopyLengthBound { at: SourcePattern { function, line }, bytes, reason }
}

/// Returns code that is excluded, with its reason.
pub(crate) const fn excluded_code(
    function: &'static str,
    line: &'static str,
    reason: &'static str,
) -> ExcludedCode {
    ExcludedCode { at: SourcePattern { function, line }, reason }
}

/// Functions whose time depends on a length: part of the name, and the number of that argument.
pub(crate) const LENGTH_DEPENDENT_FUNCTIONS: [(&str, usize); 16] = [
    // The milliseconds since the last tick. There is one node, so it is no argument.
    ("trueup_node::node::Node::tick", 1),
    ("trueup_firmware::app::run_tick", 1),
    ("_defmt_write", 1),
    ("trueup_store::flash_log::write_and_verify", 3),
    ("embedded_storage::nor_flash::NorFlash>::write", 3),
    ("embedded_storage::nor_flash::ReadNorFlash>::read", 3),
    ("crc::crc32::update_table", 2),
    ("crc::crc32::<impl crc::Crc", 1),
    ("rmodbus::calc_crc16", 1),
    ("__aeabi_memset", 1),
    ("__aeabi_memclr", 1),
    ("memcpy", 2),
    ("memmove", 2),
    ("memset", 2),
    ("memcmp", 2),
    ("bcmp", 2),
];

/// Returns which argument of a function is its length, if its time depends on one.
#[must_use]
pub(crate) fn length_argument_index(function: &str) -> Option<usize> {
    LENGTH_DEPENDENT_FUNCTIONS
        .iter()
        .find(|(name, _)| function.contains(name))
        .map(|(_, argument)| *argument)
}
