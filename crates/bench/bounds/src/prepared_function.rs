//! A function that is ready to be priced: its blocks, the values at their starts, its loops with a bound each, its calls.

use crate::{
    control_flow::ControlFlowGraph, declarations::IterationBound, function_entry::FunctionEntry,
    loop_analysis::Loop, register_values::RegisterState,
};

/// Where a bound comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BoundOrigin {
    /// The instructions.
    Code,
    /// The table.
    Table,
}

/// A loop with its bound.
#[derive(Clone, Debug)]
pub(crate) struct BoundedLoop {
    /// The loop.
    pub one: Loop,
    /// How often it goes back to its header.
    pub rounds: IterationBound,
    /// Who says so.
    pub origin: BoundOrigin,
}

/// A function, ready to be priced.
pub(crate) struct PreparedFunction {
    /// Its blocks.
    pub graph: ControlFlowGraph,
    /// The values at the start of each block.
    pub starts: Vec<RegisterState>,
    /// Its loops.
    pub loops: Vec<BoundedLoop>,
    /// Functions that each block calls at its end.
    pub calls: Vec<Vec<FunctionEntry>>,
}
