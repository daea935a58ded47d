//! Sections that hold other tasks off: those in which BASEPRI is raised to the ceiling of a resource, and those in which
//! interrupts are off.
//!
//! A section begins behind the instruction that raises the mask and ends with the one that restores it, in the same
//! function; what is called in between is part of it. Interrupts may be switched off by one function and on again by
//! another (`acquire` and `release` of the log): then the section goes on in the caller. One that finds them off
//! already leaves them off, so the branch around `cpsie` ends a section as well.

use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use crate::{
    control_flow::ControlFlowGraph,
    decode::InterruptMaskChange,
    function_entry::FunctionEntry,
    longest_path,
    prepared_function::PreparedFunction,
    program::Program,
    wcet::{FunctionCosts, WcetAnalysis},
};

/// A section.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CriticalSection {
    /// The highest priority that it holds off; `None`: all.
    pub ceiling: Option<u8>,
    /// Its cycles at the longest.
    pub cycles: u64,
    /// The function in which it begins.
    pub function: String,
    /// The address at which it begins.
    pub at: u32,
}

/// Bits of a priority on this chip.
const PRIORITY_BITS: u32 = 4;

/// The sections below functions, by the functions.
pub struct CriticalSectionAnalysis<'a> {
    program: &'a Program<'a>,
    worst: &'a WcetAnalysis<'a>,
    known: BTreeMap<FunctionEntry, Rc<InterruptMaskEffects>>,
}

/// What one function does to the mask of interrupts.
#[derive(Default)]
struct InterruptMaskEffects {
    sections: Vec<CriticalSection>,
    /// It comes back with interrupts off.
    opens: bool,
    /// It switches on interrupts that were off at its entry.
    closes: bool,
    calls: BTreeSet<FunctionEntry>,
}

/// What a search for the end of a section follows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum MaskingMechanism {
    Ceiling,
    Interrupts,
}

impl<'a> CriticalSectionAnalysis<'a> {
    /// Returns an empty collection, priced as `worst` prices.
    #[must_use]
    pub fn new(program: &'a Program<'a>, worst: &'a WcetAnalysis<'a>) -> Self {
        Self { program, worst, known: BTreeMap::new() }
    }

    /// Returns the sections of a function and all that it calls.
    pub fn find_critical_sections_in_call_tree(
        &mut self,
        entry: FunctionEntry,
    ) -> Vec<CriticalSection> {
        let (mut seen, mut open, mut found) = (BTreeSet::new(), vec![entry], Vec::new());
        while let Some(entry) = open.pop() {
            if seen.insert(entry)
                && let Some(own) = self.analyse_interrupt_masking(entry)
            {
                found.extend(own.sections.iter().cloned());
                open.extend(own.calls.iter().copied());
            }
        }
        found
    }

    fn analyse_interrupt_masking(
        &mut self,
        entry: FunctionEntry,
    ) -> Option<Rc<InterruptMaskEffects>> {
        if let Some(own) = self.known.get(&entry) {
            return Some(own.clone());
        }
        let prepared = self.program.prepare_function(entry)?;
        let calls: BTreeSet<FunctionEntry> = prepared.calls.iter().flatten().copied().collect();
        // A circle has no price, and there is a complaint about it.
        self.known.insert(entry, Rc::default());
        for call in &calls {
            self.analyse_interrupt_masking(*call);
        }
        let priced = self.worst.compute_function_costs(&prepared);
        let mut own =
            InterruptMaskEffects { sections: Vec::new(), opens: false, closes: false, calls };
        for number in 0..prepared.graph.blocks.len() {
            self.add_section(&prepared, &priced, number, &mut own);
        }
        let from_entry = self.find_section_blocks(&prepared, MaskingMechanism::Interrupts, &[0]);
        let has_on = |block: &usize| self.unmasks_interrupts(&prepared, *block);
        own.closes = from_entry.blocks.iter().any(has_on);
        let own = Rc::new(own);
        self.known.insert(entry, own.clone());
        Some(own)
    }

    /// Adds the section that begins at the end of a block, if one does.
    fn add_section(
        &self,
        prepared: &Rc<PreparedFunction>,
        priced: &FunctionCosts,
        number: usize,
        own: &mut InterruptMaskEffects,
    ) {
        let block = &prepared.graph.blocks[number];
        let last = block.last_instruction();
        let opened = prepared.calls[number]
            .iter()
            .filter(|call| self.callee_satisfies(call, |own| own.opens));
        // What the callee itself takes while they are off is part of it, at most all that it takes.
        let called = opened.map(|call| self.worst.function_cycles(*call)).max();
        let (kind, ceiling) = match (last.mask, called) {
            (Some(InterruptMaskChange::Raise(register)), _) => {
                let mut state = prepared.starts[number];
                for one in &block.instructions[..block.instructions.len() - 1] {
                    state.execute_checking_condition(self.program.image, one);
                }
                let Some(value) = state.register_value(register).as_constant() else {
                    self.program.record_problem(format!(
                        "ceiling that is no number in {}, at {:#x}",
                        prepared.graph.name, last.at
                    ));
                    return;
                };
                // A hardware priority counts downwards (Armv7-M, B1.4.3).
                let logical = (1 << PRIORITY_BITS) - (value >> (8 - PRIORITY_BITS));
                (MaskingMechanism::Ceiling, Some(logical as u8))
            }
            (Some(InterruptMaskChange::Disable), _) | (_, Some(_)) => {
                (MaskingMechanism::Interrupts, None)
            }
            _ => return,
        };
        let first: Vec<usize> = block.next.iter().map(|edge| edge.to).collect();
        let found = self.find_section_blocks(prepared, kind, &first);
        if found.returns {
            if kind == MaskingMechanism::Ceiling {
                self.program.record_problem(format!(
                    "{} comes back with its ceiling raised at {:#x}",
                    prepared.graph.name, last.at
                ));
            }
            own.opens |= kind == MaskingMechanism::Interrupts;
        }
        let mut cycles = 0;
        for entry in first {
            if found.blocks.contains(&entry) {
                let ways = longest_path::longest_paths::<u64>(
                    &prepared.graph,
                    priced,
                    &found.blocks,
                    entry,
                );
                cycles = cycles.max(ways.values().copied().max().unwrap_or(0));
            }
        }
        let cycles = cycles + called.unwrap_or(0) + u64::from(last.cycles);
        own.sections.push(CriticalSection {
            ceiling,
            cycles,
            function: prepared.graph.name.clone(),
            at: last.at,
        });
    }

    fn callee_satisfies(
        &self,
        call: &FunctionEntry,
        what: impl Fn(&InterruptMaskEffects) -> bool,
    ) -> bool {
        self.known.get(call).is_some_and(|own| what(own))
    }

    fn unmasks_interrupts(&self, prepared: &PreparedFunction, number: usize) -> bool {
        let graph = &prepared.graph;
        let has_on = |block: usize| {
            graph.blocks[block].last_instruction().mask == Some(InterruptMaskChange::Enable)
        };
        let calls = &prepared.calls[number];
        has_on(number) || calls.iter().any(|call| self.callee_satisfies(call, |own| own.closes))
    }

    /// Finds the blocks from `first` on to the end of the section.
    fn find_section_blocks(
        &self,
        prepared: &PreparedFunction,
        kind: MaskingMechanism,
        first: &[usize],
    ) -> SectionBlocks {
        let graph: &ControlFlowGraph = &prepared.graph;
        let mut found = SectionBlocks::default();
        let mut seen = BTreeSet::new();
        let mut open: Vec<(usize, u32)> = first.iter().map(|block| (*block, 1)).collect();
        while let Some((number, depth)) = open.pop() {
            if !seen.insert((number, depth)) {
                continue;
            }
            found.blocks.insert(number);
            let block = &graph.blocks[number];
            let depth = match (kind, block.last_instruction().mask) {
                (MaskingMechanism::Ceiling, Some(InterruptMaskChange::Raise(_))) => depth + 1,
                (MaskingMechanism::Ceiling, Some(InterruptMaskChange::Restore)) => depth - 1,
                _ => depth,
            };
            let is_over = depth == 0
                || depth > 8
                || kind == MaskingMechanism::Interrupts
                    && (self.unmasks_interrupts(prepared, number)
                        || block.next.iter().any(|edge| {
                            let next = &graph.blocks[edge.to];
                            next.last_instruction().mask == Some(InterruptMaskChange::Enable)
                                && next.instructions.len() <= 2
                        }));
            if depth > 8 {
                self.program
                    .record_problem(format!("{} raises its ceiling without end", graph.name));
            }
            if is_over {
                // The instruction that ends it may stand in the next block.
                let ends = block.next.iter().map(|edge| edge.to);
                if kind == MaskingMechanism::Interrupts
                    && !self.unmasks_interrupts(prepared, number)
                {
                    found.blocks.extend(ends.filter(|next| {
                        graph.blocks[*next].last_instruction().mask
                            == Some(InterruptMaskChange::Enable)
                    }));
                }
                continue;
            }
            found.returns |= block.returns;
            open.extend(block.next.iter().map(|edge| (edge.to, depth)));
        }
        found
    }
}

/// The blocks of a section.
#[derive(Default)]
struct SectionBlocks {
    blocks: BTreeSet<usize>,
    /// It is not over where the function comes back.
    returns: bool,
}
