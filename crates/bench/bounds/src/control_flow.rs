//! The control flow of a function: blocks of instructions, the edges between them, calls and ends.
//!
//! A block ends with a branch, a call, a change of the mask of interrupts, or before the target of a branch.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context as _, Result, bail};

pub use crate::basic_block::Call;
pub(crate) use crate::basic_block::{BasicBlock, ControlFlowEdge};
use crate::{
    decode::{self, ControlFlow, Instruction, PC},
    image::{FirmwareImage, Function},
    outlined_code,
};

/// A function as blocks; the first one is its entry.
#[derive(Clone, Debug)]
pub(crate) struct ControlFlowGraph {
    /// Its name.
    pub name: String,
    /// Its blocks.
    pub blocks: Vec<BasicBlock>,
    /// The blocks that lead to each.
    pub before: Vec<Vec<usize>>,
}

impl ControlFlowGraph {
    /// Reads a function. `targets` gives what a branch by register may lead to, by its address.
    ///
    /// # Errors
    /// It branches by a register, or into the midst of another function, or its end is no branch.
    pub fn read(image: &FirmwareImage, function: &Function) -> Result<Self> {
        Self::read_at_outline_depth(image, function, 0)
    }

    /// As [`Self::read`], as part of another function, that many deep.
    pub(crate) fn read_at_outline_depth(
        image: &FirmwareImage,
        function: &Function,
        depth: usize,
    ) -> Result<Self> {
        ControlFlowGraphBuilder::read(image, function)?.build_control_flow_graph(image, depth)
    }
}

struct ControlFlowGraphBuilder<'a> {
    function: &'a Function,
    code: BTreeMap<u32, Instruction>,
    /// Targets of a jump by table.
    tables: BTreeMap<u32, Vec<u32>>,
}

impl<'a> ControlFlowGraphBuilder<'a> {
    fn read(image: &FirmwareImage, function: &'a Function) -> Result<Self> {
        let mut reader = Self { function, code: BTreeMap::new(), tables: BTreeMap::new() };
        let mut at = function.start;
        while at < function.end {
            let end = image.region_end(at).min(function.end);
            if !image.is_data(at) {
                let bytes = image.bytes(at, end).context("its bytes are not in the image")?;
                for one in decode::decode(bytes, at) {
                    reader.code.insert(one.at, one);
                }
            }
            at = end;
        }
        let code: Vec<Instruction> = reader.code.values().copied().collect();
        for one in code {
            let targets = match one.flow {
                ControlFlow::TableBranch { size } => reader.read_jump_table(image, &one, size)?,
                ControlFlow::JumpRegister(register) if register != PC => {
                    reader.jump_table_targets(&one)
                }
                _ => continue,
            };
            if !targets.is_empty() {
                reader.tables.insert(one.at, targets);
            }
        }
        Ok(reader)
    }

    /// The places of a table that stands behind its jump, up to where the mapping symbols say that code goes on.
    fn read_jump_table(
        &self,
        image: &FirmwareImage,
        one: &Instruction,
        size: u32,
    ) -> Result<Vec<u32>> {
        let end = image.region_end(one.end_address()).min(self.function.end);
        let bytes =
            image.bytes(one.end_address(), end).filter(|_| image.is_data(one.end_address()));
        let bytes = bytes
            .with_context(|| self.format_problem(one, "jumps by a table that is not there"))?;
        let entries: Vec<u32> = if size == 1 {
            bytes.iter().map(|byte| u32::from(*byte)).collect()
        } else {
            bytes.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]]).into()).collect()
        };
        // The byte that aligns the code behind it is none of the table; as an entry of 0 it would lead into the table.
        let targets = entries.into_iter().map(|entry| one.end_address() + 2 * entry);
        Ok(targets.filter(|target| self.code.contains_key(target)).collect())
    }

    /// A row of branches behind a jump by register is its table.
    fn jump_table_targets(&self, one: &Instruction) -> Vec<u32> {
        let mut targets = Vec::new();
        let mut at = (one.end_address() + 3) & !3;
        while let Some(next) = self.code.get(&at) {
            if next.size != 4
                || next.condition.is_some()
                || !matches!(next.flow, ControlFlow::Jump(_))
            {
                break;
            }
            targets.push(at);
            at += 4;
        }
        targets
    }

    fn format_problem(&self, one: &Instruction, what: &str) -> String {
        format!("{} {what}, at {:#x}", self.function.name, one.at)
    }

    fn contains_address(&self, at: u32) -> bool {
        (self.function.start..self.function.end).contains(&at)
    }

    /// Addresses at which a block begins.
    fn block_start_addresses(&self) -> BTreeSet<u32> {
        let mut starts = BTreeSet::from([self.function.start]);
        for one in self.code.values() {
            match one.flow {
                ControlFlow::Jump(target) | ControlFlow::CompareAndBranch { target, .. } => {
                    starts.extend([target, one.end_address()]);
                }
                ControlFlow::Next if one.mask.is_none() => {}
                _ => {
                    starts.insert(one.end_address());
                }
            }
        }
        starts.extend(self.tables.values().flatten());
        starts
    }

    fn build_control_flow_graph(
        &self,
        image: &FirmwareImage,
        depth: usize,
    ) -> Result<ControlFlowGraph> {
        let starts = self.block_start_addresses();
        let mut blocks: Vec<BasicBlock> = Vec::new();
        for one in self.code.values() {
            let is_behind = blocks.last().is_none_or(|block| block.end_address() != one.at);
            if starts.contains(&one.at) || is_behind {
                blocks.push(BasicBlock::default());
            }
            blocks.last_mut().expect("one was pushed").instructions.push(*one);
        }
        let numbers: BTreeMap<u32, usize> = blocks
            .iter()
            .enumerate()
            .map(|(number, block)| (block.start_address(), number))
            .collect();
        for block in &mut blocks {
            self.connect_block(image, block, &numbers)?;
        }
        let read = |piece: &Function| {
            Ok(ControlFlowGraph::read_at_outline_depth(image, piece, depth + 1)?.blocks)
        };
        let blocks = outlined_code::inline_outlined_code(image, blocks, depth, read)?;
        Ok(reachable_subgraph(self.function.name.clone(), blocks))
    }

    fn connect_block(
        &self,
        image: &FirmwareImage,
        block: &mut BasicBlock,
        numbers: &BTreeMap<u32, usize>,
    ) -> Result<()> {
        let one = *block.last_instruction();
        let fall = || ControlFlowEdge {
            to: numbers.get(&one.end_address()).copied().unwrap_or(usize::MAX),
            is_taken: false,
        };
        let may_fall = one.condition.is_some();
        match one.flow {
            ControlFlow::Next => block.next.push(fall()),
            ControlFlow::Jump(target) | ControlFlow::CompareAndBranch { target, .. } => {
                if self.contains_address(target) {
                    let to = *numbers
                        .get(&target)
                        .with_context(|| self.format_problem(&one, "jumps into an instruction"))?;
                    block.next.push(ControlFlowEdge { to, is_taken: true });
                } else {
                    // A function that ends by calling another one.
                    block.call =
                        Some(Call::Direct(BTreeSet::from([function_start_at(image, target)
                            .with_context(|| {
                                self.format_problem(&one, "jumps to no function")
                            })?])));
                    block.returns = true;
                }
                if may_fall || matches!(one.flow, ControlFlow::CompareAndBranch { .. }) {
                    block.next.push(fall());
                }
            }
            ControlFlow::Call(target) => {
                let start = function_start_at(image, target)
                    .with_context(|| self.format_problem(&one, "calls what is no function"))?;
                block.call = Some(Call::Direct(BTreeSet::from([start])));
                block.next.push(ControlFlowEdge { is_taken: true, ..fall() });
            }
            ControlFlow::CallRegister(register) => {
                block.call = Some(Call::Indirect(register));
                block.next.push(ControlFlowEdge { is_taken: true, ..fall() });
            }
            ControlFlow::Return => {
                block.returns = true;
                if may_fall {
                    block.next.push(fall());
                }
            }
            ControlFlow::TableBranch { .. } | ControlFlow::JumpRegister(_) => match self
                .tables
                .get(&one.at)
            {
                Some(targets) => {
                    let all: BTreeSet<usize> =
                        targets.iter().filter_map(|target| numbers.get(target).copied()).collect();
                    block
                        .next
                        .extend(all.into_iter().map(|to| ControlFlowEdge { to, is_taken: true }));
                }
                None => match one.flow {
                    ControlFlow::JumpRegister(register) => {
                        block.call = Some(Call::Indirect(register));
                        block.returns = true;
                        if may_fall {
                            block.next.push(fall());
                        }
                    }
                    _ => bail!(self.format_problem(&one, "jumps by a table without entries")),
                },
            },
            ControlFlow::Trap => {}
        }
        Ok(())
    }
}

fn function_start_at(image: &FirmwareImage, target: u32) -> Option<u32> {
    image.function_at(target).map(|function| function.start).filter(|start| *start == target & !1)
}

/// Leaves out what the entry does not lead to.
fn reachable_subgraph(name: String, blocks: Vec<BasicBlock>) -> ControlFlowGraph {
    let mut seen = vec![false; blocks.len()];
    let mut open = vec![0];
    while let Some(number) = open.pop() {
        if number < blocks.len() && !std::mem::replace(&mut seen[number], true) {
            open.extend(blocks[number].next.iter().map(|edge| edge.to));
        }
    }
    subgraph(name, blocks, &seen)
}

/// Returns a graph of some of the blocks, the first one among them.
#[must_use]
pub(crate) fn subgraph(
    name: String,
    blocks: Vec<BasicBlock>,
    is_kept: &[bool],
) -> ControlFlowGraph {
    let mut numbers = vec![usize::MAX; blocks.len()];
    let mut count = 0;
    for (number, kept) in is_kept.iter().enumerate() {
        if *kept {
            numbers[number] = count;
            count += 1;
        }
    }
    let kept = blocks.into_iter().zip(is_kept).filter(|(_, kept)| **kept);
    let blocks: Vec<BasicBlock> = kept
        .map(|(mut block, _)| {
            // One that falls off the end of the function comes back from nowhere: what it calls does not return.
            block.next.retain(|edge| is_kept.get(edge.to).copied().unwrap_or(false));
            for edge in &mut block.next {
                edge.to = numbers[edge.to];
            }
            block.next.sort_unstable();
            block.next.dedup();
            block
        })
        .collect();
    let mut before = vec![Vec::new(); blocks.len()];
    for (number, block) in blocks.iter().enumerate() {
        for edge in &block.next {
            before[edge.to].push(number);
        }
    }
    ControlFlowGraph { name, blocks, before }
}

/// Returns which blocks the entry leads to and that lead back to the caller; where no call in between stays away.
pub(crate) fn find_returning_blocks(
    graph: &ControlFlowGraph,
    returns: &dyn Fn(u32) -> bool,
) -> Vec<bool> {
    let comes_back = |number: usize| match &graph.blocks[number].call {
        Some(Call::Direct(all)) => all.iter().any(|to| returns(*to)),
        _ => true,
    };
    let count = graph.blocks.len();
    let mut leads_back = vec![false; count];
    let mut open: Vec<usize> = Vec::new();
    for number in 0..count {
        if graph.blocks[number].returns && comes_back(number) {
            open.push(number);
        }
    }
    while let Some(number) = open.pop() {
        if std::mem::replace(&mut leads_back[number], true) {
            continue;
        }
        for before in &graph.before[number] {
            // A call that is not always made leaves the way past it.
            let is_conditional = graph.blocks[*before].last_instruction().condition.is_some();
            if comes_back(*before) || is_conditional {
                open.push(*before);
            }
        }
    }
    let mut is_kept = vec![false; count];
    let mut open = vec![0];
    while let Some(number) = open.pop() {
        if leads_back[number] && !std::mem::replace(&mut is_kept[number], true) {
            open.extend(graph.blocks[number].next.iter().map(|edge| edge.to));
        }
    }
    is_kept
}
