//! The worst case of a function, in cycles on one clock: the longest path through its blocks, what it calls included.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use crate::{
    clock_configuration::{ClockConfiguration, FLASH_CACHE_LINES, FLASH_LINE_BYTES},
    control_flow::ControlFlowEdge,
    declarations::IterationBound,
    decode::AddressingMode,
    function_entry::FunctionEntry,
    longest_path::{self, CycleCosts, LoopIterations, PathCost, TracedPath},
    loop_analysis::Loop,
    prepared_function::{BoundedLoop, PreparedFunction},
    program::Program,
};

/// Prices on one clock.
pub struct WcetAnalysis<'a> {
    program: &'a Program<'a>,
    clock: ClockConfiguration,
    waiting: Option<u32>,
    known: RefCell<BTreeMap<(FunctionEntry, bool), u64>>,
    /// The lines of the flash of a function and all that it calls; `None`: more than the cache holds.
    lines: RefCell<BTreeMap<FunctionEntry, Option<Rc<BTreeSet<u32>>>>>,
    above: RefCell<Vec<FunctionEntry>>,
    /// Functions that count as free.
    free: BTreeSet<u32>,
    /// Those of them that were called.
    asked: RefCell<BTreeSet<FunctionEntry>>,
}

impl<'a> WcetAnalysis<'a> {
    /// Returns the prices on a clock, with this many bytes waiting for loops that have a round for each.
    #[must_use]
    pub fn new(program: &'a Program<'a>, clock: ClockConfiguration, waiting: Option<u32>) -> Self {
        let (known, above) = (RefCell::default(), RefCell::default());
        Self {
            program,
            clock,
            waiting,
            known,
            lines: RefCell::default(),
            above,
            free: BTreeSet::new(),
            asked: RefCell::default(),
        }
    }

    /// Has functions count as free.
    #[must_use]
    pub(crate) fn with_zero_cost_functions(self, free: BTreeSet<u32>) -> Self {
        Self { free, ..self }
    }

    /// Returns the cycles of a turn of a task without the functions that it calls once.
    #[must_use]
    pub(crate) fn cycles_without_once_calls(
        program: &'a Program<'a>,
        clock: ClockConfiguration,
        waiting: Option<u32>,
        entry: FunctionEntry,
    ) -> u64 {
        let once: BTreeSet<u32> = program.rate_limited_functions().into_keys().collect();
        Self::new(program, clock, waiting).with_zero_cost_functions(once).function_cycles(entry)
    }

    /// Returns the cycles of a turn of a task without the functions that it calls once, and those of each of these, with the
    /// arguments that take the longest. One that another calls is counted for itself.
    #[must_use]
    pub(crate) fn compute_task_wcet(
        program: &'a Program<'a>,
        clock: ClockConfiguration,
        waiting: Option<u32>,
        entry: FunctionEntry,
    ) -> (u64, BTreeMap<u32, (FunctionEntry, u64)>) {
        let once: BTreeSet<u32> = program.rate_limited_functions().into_keys().collect();
        let plain = Self::new(program, clock, waiting).with_zero_cost_functions(once.clone());
        let cycles = plain.function_cycles(entry);
        let mut open = plain.asked.take();
        let (mut all, mut alone) = (open.clone(), BTreeMap::new());
        while let Some(it) = open.pop_first() {
            let others = once.iter().copied().filter(|start| *start != it.start).collect();
            let worst = Self::new(program, clock, waiting).with_zero_cost_functions(others);
            let own = worst.function_cycles(it);
            let known = alone.entry(it.start).or_insert((it, own));
            if own > known.1 {
                *known = (it, own);
            }
            open.extend(worst.asked.take().into_iter().filter(|within| all.insert(*within)));
        }
        (cycles, alone)
    }

    /// Returns the cycles of a function from its first instruction to its return. Where it cannot be priced it is
    /// 0, and the program has the complaint.
    pub fn function_cycles(&self, entry: FunctionEntry) -> u64 {
        self.compute_function_cycles(entry, false)
    }

    /// As [`Self::function_cycles`]; `is_kept`: the cache of the flash has its instructions.
    fn compute_function_cycles(&self, entry: FunctionEntry, is_kept: bool) -> u64 {
        if let Some(known) = self.known.borrow().get(&(entry, is_kept)) {
            return *known;
        }
        if self.free.contains(&entry.start) {
            self.asked.borrow_mut().insert(entry);
            return 0;
        }
        let Some(prepared) = self.program.prepare_function(entry) else { return 0 };
        if self.above.borrow().iter().any(|above| above.start == entry.start) {
            self.program
                .record_problem(format!("{} calls itself, in a circle", prepared.graph.name));
            return 0;
        }
        self.above.borrow_mut().push(entry);
        let priced = self.compute_function_costs(&prepared);
        let within: BTreeSet<usize> = (0..prepared.graph.blocks.len()).collect();
        let longest: u64 =
            longest_path_to_return(&prepared, &priced.with_cache_state(is_kept), &within);
        self.above.borrow_mut().pop();
        self.known.borrow_mut().insert((entry, is_kept), longest);
        longest
    }

    /// Returns the longest path of a function: its cycles, its own among them, and how often it calls which functions.
    #[must_use]
    pub(crate) fn longest_path(&self, entry: FunctionEntry, is_kept: bool) -> Option<LongestPath> {
        let cycles = self.compute_function_cycles(entry, is_kept);
        let prepared =
            self.program.prepare_function(entry).filter(|_| !self.free.contains(&entry.start))?;
        let priced = self.compute_function_costs(&prepared).with_cache_state(is_kept);
        let within: BTreeSet<usize> = (0..prepared.graph.blocks.len()).collect();
        let way: TracedPath = longest_path_to_return(&prepared, &priced, &within);
        let (mut calls, mut own) = (BTreeMap::new(), cycles);
        for ((block, in_cache), count) in way.visits {
            let is_kept = is_kept || in_cache;
            let called = prepared.calls[block]
                .iter()
                .map(|to| (self.compute_function_cycles(*to, is_kept), *to));
            if let Some((cost, to)) = called.max_by_key(|(cost, _)| *cost) {
                own = own.saturating_sub(cost * count);
                *calls.entry((to, is_kept)).or_default() += count;
            }
        }
        Some(LongestPath { cycles, own, calls })
    }

    /// The lines of the flash of some blocks, and of what they call.
    fn flash_lines_of_blocks(
        &self,
        prepared: &PreparedFunction,
        blocks: &[usize],
    ) -> Option<BTreeSet<u32>> {
        let mut lines = BTreeSet::new();
        for number in blocks {
            let block = &prepared.graph.blocks[*number];
            lines.extend(
                block.start_address() / FLASH_LINE_BYTES
                    ..=(block.end_address() - 1) / FLASH_LINE_BYTES,
            );
            for call in &prepared.calls[*number] {
                lines.extend(self.flash_lines_of_function(*call)?.iter());
            }
            if lines.len() > FLASH_CACHE_LINES {
                return None;
            }
        }
        Some(lines)
    }

    fn flash_lines_of_function(&self, entry: FunctionEntry) -> Option<Rc<BTreeSet<u32>>> {
        if let Some(known) = self.lines.borrow().get(&entry) {
            return known.clone();
        }
        // A circle of calls has a complaint already.
        self.lines.borrow_mut().insert(entry, None);
        let prepared = self.program.prepare_function(entry)?;
        let all: Vec<usize> = (0..prepared.graph.blocks.len()).collect();
        let lines = self.flash_lines_of_blocks(&prepared, &all).map(Rc::new);
        self.lines.borrow_mut().insert(entry, lines.clone());
        lines
    }

    /// Returns the prices of the blocks of a function.
    #[must_use]
    pub(crate) fn compute_function_costs(&self, prepared: &Rc<PreparedFunction>) -> FunctionCosts {
        let count = prepared.graph.blocks.len();
        let of = |is_kept| {
            (0..count).map(|block| self.compute_block_cycles(prepared, block, is_kept)).collect()
        };
        let blocks: [Vec<u64>; 2] = [of(false), of(true)];
        let fills = prepared.loops.iter().filter_map(|bounded| {
            let all: Vec<usize> = bounded.one.blocks.iter().copied().collect();
            let lines = self.flash_lines_of_blocks(prepared, &all)?.len() as u64;
            // Each line of the flash is read once, and waited for once more where a branch has asked ahead.
            Some((bounded.one.blocks.clone(), 2 * lines * u64::from(self.clock.flash)))
        });
        let fills = fills.collect();
        let mut rounds: BTreeMap<usize, IterationBound> = BTreeMap::new();
        let joined = find_merged_loops(prepared);
        for bounded in &prepared.loops {
            let own = match bounded.rounds {
                IterationBound::PerWaitingByte => {
                    IterationBound::AtMost(self.waiting.unwrap_or_else(|| {
                        let name = &prepared.graph.name;
                        self.program.record_problem(format!(
                            "{name} has a round for each byte that waits, and its task says none"
                        ));
                        0
                    }))
                }
                IterationBound::Together(_)
                    if joined.values().any(|blocks| blocks.contains(&bounded.one.header)) =>
                {
                    IterationBound::AtMost(0)
                }
                IterationBound::Together(times) => IterationBound::AtMost(times),
                other => other,
            };
            rounds.insert(bounded.one.header, own);
        }
        FunctionCosts {
            prepared: prepared.clone(),
            clock: self.clock,
            blocks,
            fills,
            rounds,
            joined,
            is_kept: false,
        }
    }

    fn compute_block_cycles(
        &self,
        prepared: &PreparedFunction,
        number: usize,
        is_kept: bool,
    ) -> u64 {
        let block = &prepared.graph.blocks[number];
        let mut state = prepared.starts[number];
        let lines = if is_kept {
            0
        } else {
            self.clock.flash_line_wait_cycles(block.start_address(), block.end_address())
        };
        let mut cycles = u64::from(lines);
        for one in &block.instructions {
            cycles += u64::from(one.cycles);
            if let Some(access) = &one.access {
                let address = match access.at {
                    AddressingMode::Literal => None,
                    AddressingMode::ImmediateOffset(base, offset) => {
                        match state.register_value(base) {
                            value if value.as_constant().is_some() => {
                                Some(value.offset.wrapping_add(offset))
                            }
                            value => value.peripheral_base_address(),
                        }
                    }
                    AddressingMode::RegisterOffset(base, other) => {
                        let (a, b) = (state.register_value(base), state.register_value(other));
                        let sum = a.as_constant().zip(b.as_constant());
                        sum.map(|(a, b)| a.wrapping_add(b))
                            .or(a.peripheral_base_address())
                            .or(b.peripheral_base_address())
                    }
                };
                let is_ram = match access.at {
                    AddressingMode::Literal => false,
                    AddressingMode::ImmediateOffset(base, _) => state.is_ram_pointer(base),
                    AddressingMode::RegisterOffset(base, other) => {
                        state.is_ram_pointer(base) || state.is_ram_pointer(other)
                    }
                };
                cycles += u64::from(self.clock.access_wait_cycles(access, address, is_ram));
            }
            state.execute_checking_condition(self.program.image, one);
        }
        let calls = prepared.calls[number]
            .iter()
            .map(|entry| self.compute_function_cycles(*entry, is_kept))
            .max();
        match calls {
            Some(called) => {
                cycles + self.clock.taken_branch_cycles(block.end_address(), is_kept) + called
            }
            None => cycles,
        }
    }
}

/// The longest path through a function.
#[derive(Clone, Debug)]
pub(crate) struct LongestPath {
    /// Its cycles, with all that it calls.
    pub cycles: u64,
    /// Those of its own instructions.
    pub own: u64,
    /// How often it calls what, with the cache and without.
    pub calls: BTreeMap<(FunctionEntry, bool), u64>,
}

/// The longest way to a return.
fn longest_path_to_return<W: PathCost>(
    prepared: &PreparedFunction,
    prices: &FunctionCosts,
    within: &BTreeSet<usize>,
) -> W {
    let ways = longest_path::longest_paths::<W>(&prepared.graph, prices, within, 0);
    let blocks = &prepared.graph.blocks;
    let back = ways.into_iter().filter(|(block, _)| blocks[*block].returns);
    longest_path::max_by_cycles(back.map(|(_, way)| way)).unwrap_or_default()
}

/// The prices of one function.
pub(crate) struct FunctionCosts {
    prepared: Rc<PreparedFunction>,
    clock: ClockConfiguration,
    /// Without the cache, and with it.
    blocks: [Vec<u64>; 2],
    /// Cycles in which the cache takes a loop that fits it.
    fills: BTreeMap<BTreeSet<usize>, u64>,
    is_kept: bool,
    rounds: BTreeMap<usize, IterationBound>,
    /// By the header of a loop those of the loops within it that are one with it in the source.
    joined: BTreeMap<usize, BTreeSet<usize>>,
}

/// The headers of loops within others that are one with them in the source.
fn find_merged_loops(prepared: &PreparedFunction) -> BTreeMap<usize, BTreeSet<usize>> {
    let mut joined: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    let is_one =
        |bounded_loop: &&BoundedLoop| matches!(bounded_loop.rounds, IterationBound::Together(_));
    for inner in prepared.loops.iter().filter(is_one) {
        let around = prepared.loops.iter().filter(is_one).filter(|outer| {
            outer.one.header != inner.one.header && outer.one.blocks.is_superset(&inner.one.blocks)
        });
        if let Some(outer) = around.max_by_key(|outer| outer.one.blocks.len()) {
            joined.entry(outer.one.header).or_default().insert(inner.one.header);
        }
    }
    joined
}

impl FunctionCosts {
    /// Returns the same, all of it in the cache or not.
    #[must_use]
    fn with_cache_state(self, is_kept: bool) -> Self {
        Self { is_kept, ..self }
    }
}

impl CycleCosts for FunctionCosts {
    fn block_cycles(&self, block: usize, is_kept: bool) -> u64 {
        self.blocks[usize::from(is_kept || self.is_kept)][block]
    }

    fn edge_cycles(&self, from: usize, edge: &ControlFlowEdge, is_kept: bool) -> u64 {
        let end = self.prepared.graph.blocks[from].end_address();
        match (edge.is_taken, is_kept || self.is_kept) {
            (true, is_kept) => self.clock.taken_branch_cycles(end, is_kept),
            (false, true) => 0,
            (false, false) => self.clock.fall_through_cycles(end),
        }
    }

    fn cache_fill_cycles(&self, one: &Loop) -> Option<u64> {
        self.fills.get(&one.blocks).copied()
    }

    fn merged_loops(&self, one: &Loop) -> BTreeSet<usize> {
        self.joined.get(&one.header).cloned().unwrap_or_default()
    }

    fn loop_iterations(&self, one: &Loop) -> LoopIterations {
        let repeated = |rounds: IterationBound| match rounds {
            IterationBound::AtMost(times) => LoopIterations { times: times.into(), wait: 0 },
            IterationBound::Microseconds(us) => {
                LoopIterations { times: 1, wait: u64::from(us) * u64::from(self.clock.mhz) }
            }
            _ => LoopIterations::default(),
        };
        let own = self.rounds.get(&one.header).map(|rounds| repeated(*rounds));
        // One of which only a part is looked at may be entered elsewhere: it turns no more often than the whole.
        own.unwrap_or_else(|| {
            let around = self.prepared.loops.iter();
            let around = around.filter(|outer| outer.one.blocks.is_superset(&one.blocks));
            let all = around.filter_map(|outer| self.rounds.get(&outer.one.header));
            let all: Vec<LoopIterations> = all.map(|rounds| repeated(*rounds)).collect();
            LoopIterations {
                times: all.iter().map(|iterations| iterations.times).max().unwrap_or(0),
                wait: all.iter().map(|iterations| iterations.wait).max().unwrap_or(0),
            }
        })
    }
}
